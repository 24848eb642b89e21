"""The parent's side of a batch: it starts the processes of the environments, sends requests and takes answers."""

from __future__ import annotations

import json
import mmap
import os
import select
import socket
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any, TypedDict

import numpy as np
from gymnasium import spaces

from uavaccel.clock import MonotonicClock
from uavaccel.envs.values import Answer, Observation
from uavaccel.errors import UserError
from uavaccel.processes.forks import CAN_FORK, WITHOUT_THREADS, Fork, Forks
from uavaccel.processes.lifetime import Process, end_within, single_core_rendering, start_python
from uavaccel.processes.stalls import FIRST_POLLS, IDLE_POLLS, POLL_S, StallDetector, is_stopped
from uavaccel.units import NS_PER_S

STOP_S = 3.0  # for all processes, from the end of their connections to their own

Seat = tuple[int, int]
"""The slot of an environment, and the file descriptor of its end of the connection."""


def _poll_of(connection: Connection) -> select.poll:
    """Make a poll for incoming data, which is cheaper than Connection.poll."""
    poll = select.poll()
    poll.register(connection.fileno(), select.POLLIN)
    return poll


class ObservationForm(TypedDict):
    """Number of environments, and shape and type of each part of an observation; of the only part the name is ""."""

    slots: int
    parts: list[tuple[str, str, tuple[int, ...]]]


def form_of(space: spaces.Space[Any], slots: int) -> ObservationForm:
    """Return the form of the observations of a space."""
    parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
    return {
        "slots": slots,
        "parts": [(name, np.dtype(each.dtype).str, each.shape or ()) for name, each in parts.items()],
    }


class SharedObservations:
    """Observations of all environments in memory that the processes share: (slots, *shape), or a mapping of these.

    `present` are the current ones; `last` are the final ones of games that an autoreset has replaced. `descriptor` is
    the memory's file descriptor; without one new memory is made.
    """

    def __init__(self, form: ObservationForm, descriptor: int | None = None) -> None:
        self.form = form
        fields = [(name or "all", kind, tuple(shape)) for name, kind, shape in form["parts"]]
        dtype = np.dtype(fields, align=True)
        size = 2 * form["slots"] * dtype.itemsize
        self.descriptor = _anonymous_memory(size) if descriptor is None else descriptor
        both = np.frombuffer(mmap.mmap(self.descriptor, size), dtype).reshape(2, form["slots"])
        views: list[Observation] = [{name: each[name] for name, _, _ in fields} for each in both]
        self.present, self.last = views if form["parts"][0][0] else (view["all"] for view in views)


def _anonymous_memory(size: int) -> int:
    """Return a file descriptor of `size` zero bytes, of which nothing remains after the last process that has it."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("uavaccel")
    else:
        descriptor, path = tempfile.mkstemp()
        os.unlink(path)
    os.ftruncate(descriptor, size)
    return descriptor


class BatchOptions(TypedDict):
    """Options of all processes of a batch."""

    environment: str
    """Module and class, as "module:class", of an environment or of its task."""
    folder: str | None
    """Folder from which the module is imported; None for one of this package."""
    keys: dict[str, object]
    memory: int
    """File descriptor of the SharedObservations."""
    observations: ObservationForm
    autoreset: str


class ProgramOptions(BatchOptions):
    """Options of the program that flies the environments of one process, or forks a process for each of several."""

    processes: list[list[Seat]]
    parent: int
    reports: int | None
    """Pipe in which it reports about the processes that it forks."""


class BatchError(RuntimeError):
    """An environment of a batch failed, or its process has ended."""


class EnvironmentProcesses:
    """`slots` environments distributed over `processes` processes; raises BatchError if one ends or hangs."""

    def __init__(self, options: BatchOptions, slots: int, processes: int) -> None:
        self._connections: list[Connection] = []
        self._asked = [False] * slots
        theirs = []
        for _ in range(slots):
            mine, other = socket.socketpair()
            self._connections.append(Connection(mine.detach()))
            theirs.append(other.detach())
        self._polls = [_poll_of(connection) for connection in self._connections]
        self._answered_once = False
        self._stalls, self._clock = StallDetector(), MonotonicClock()
        self._polled_ns = self._clock.now_ns()
        self._process_of = [slot % processes for slot in range(slots)]
        flown = [list(enumerate(theirs))[process::processes] for process in range(processes)]
        self._processes: list[Process | Fork] = []
        self._forks: Forks | None = None
        if CAN_FORK and processes > 1:
            self._forks = self._start_forks(options, flown)
            self._processes += self._forks.each()
        else:
            self._processes += [self._start(options, [each]) for each in flown]
        for descriptor in theirs:
            os.close(descriptor)

    def _start_forks(self, options: BatchOptions, flown: list[list[Seat]]) -> Forks:
        """Start the processes as forks of one, which loads for all of them."""
        reports, theirs = os.pipe()
        template = self._start(options, flown, theirs)
        os.close(theirs)
        return Forks(template, len(flown), reports)

    def _start(self, options: BatchOptions, flown: list[list[Seat]], reports: int | None = None) -> Process:
        program: ProgramOptions = {**options, "processes": flown, "parent": os.getpid(), "reports": reports}
        inherited = [options["memory"], *(connection for process in flown for _, connection in process)]
        if reports is not None:
            inherited.append(reports)
        process = start_python(
            *("-m", "uavaccel.envs.environment_process"),
            environment={**WITHOUT_THREADS, **single_core_rendering()},
            stdin=subprocess.PIPE,  # a thousand environments' options are too long for an argument
            pass_fds=inherited,
        )
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin:  # where it has ended, its connections will say so
            process.stdin.write(json.dumps(program).encode())
        return process

    def ask(self, slot: int, method: str, *arguments: object) -> None:
        """Send a request; its `answer` has to be taken before the next one."""
        if not self._connections:
            raise self._ended(slot)
        if self._asked[slot]:
            raise BatchError(f"environment {slot} is still flying: take its last answer before you ask for more")
        try:
            self._connections[slot].send((method, arguments))
        except OSError:
            raise self._ended(slot) from None
        self._asked[slot] = True

    def answer(self, slot: int) -> Answer:
        """Wait for the answer to the last request. Raises UserError or BatchError for an error there, or no request."""
        if self._connections and not self._asked[slot]:
            raise BatchError(f"environment {slot} was not asked for anything: there is no answer to wait for")
        try:
            while self._connections and not self._polls[slot].poll(POLL_S * 1e3):
                self._look()
            answer = self._connections[slot].recv()
        except (EOFError, OSError):
            raise self._ended(slot) from None
        finally:
            self._asked[slot] = False
        self._answered_once = True
        if answer[0]:
            return answer[1]
        raise self._error(slot, *answer[1:])

    def first_answered(self) -> int:
        """Wait for the first slot that answers, and return it. Raises BatchError if none was asked."""
        asked = {self._connections[slot]: slot for slot, waiting in enumerate(self._asked) if waiting}
        if not asked:
            raise BatchError("no environment was asked for anything")
        while not (answered := wait(list(asked), POLL_S)):
            self._look()
        if self._clock.now_ns() - self._polled_ns > POLL_S * NS_PER_S:
            self._look()  # while others answer, one that hangs might go unnoticed
        return asked[answered[0]]  # type: ignore[index]

    def _look(self) -> None:
        """Check processes whose answers are due. Kills those that hang, and raises BatchError."""
        self._polled_ns = self._clock.now_ns()
        waiting = {self._process_of[slot] for slot, asked in enumerate(self._asked) if asked}
        pids = {self._processes[number].pid: number for number in waiting}
        standing = self._stalls.poll(pids, IDLE_POLLS if self._answered_once else FIRST_POLLS)
        if not standing:
            return
        slots = [slot for slot, number in enumerate(self._process_of) if self._processes[number].pid in standing]
        how = "was stopped" if is_stopped(standing[0]) else "waits for what does not come"
        for pid in standing:
            self._processes[pids[pid]].kill()
        raise BatchError(f"the process of environment {slots[0]} hangs: it {how}")

    def request_all(self, method: str, arguments: Sequence[tuple[object, ...]], slots: Sequence[int]) -> list[Answer]:
        """Send a request to each of `slots` before the first answer is taken; returns the answers."""
        for slot, argument in zip(slots, arguments, strict=True):
            self.ask(slot, method, *argument)
        return self.answers(slots)

    def answers(self, slots: Sequence[int]) -> list[Answer]:
        """Return the answers of `slots`. Raises the first error, after all have been taken."""
        answers, errors = [], []
        for slot in slots:
            try:
                answers.append(self.answer(slot))
            except (UserError, AttributeError, BatchError) as error:
                errors.append(error)
        if errors:
            raise errors[0]
        return answers

    def _ended(self, slot: int) -> BatchError:
        if not self._connections:
            return BatchError("this batch is closed")
        process = self._processes[self._process_of[slot]]
        return BatchError(f"the process of environment {slot} ended with status {process.wait()}")

    def _error(self, slot: int, kind: str, text: str) -> Exception:
        if kind == "UserError":
            return UserError(text)
        if kind == "AttributeError":
            return AttributeError(text)
        return BatchError(f"environment {slot} failed:\n{text}")

    @property
    def process_ids(self) -> list[int]:
        return [process.pid for process in self._processes]

    def close(self) -> None:
        """End the processes, and abandon what they still fly."""
        for connection in self._connections:
            connection.close()
        self._connections = []
        if any(self._asked):  # a request may be a whole game, and nobody waits for its answer any more
            for process in self._processes:
                process.terminate()
        end_ns = self._clock.now_ns() + round(STOP_S * NS_PER_S)
        for process in self._processes:
            end_within(process, max(end_ns - self._clock.now_ns(), 0) / NS_PER_S)
        if self._forks is not None:
            self._forks.close()
        self._processes, self._forks = [], None
