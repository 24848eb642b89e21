"""The processes in which the environments of a batch fly, each in a thread, so that one flies while another waits.

    python -m uavaccel.envs.environment_process <<< '{"environment": "uavaccel.envs.obstacle_lane:ObstacleLane", ...}'

`EnvironmentProcesses`, the parent's side, starts this for one process, or for all: then it loads what each of them
needs, and forks them. A process ends when its last connection to the batch is closed.
"""

from __future__ import annotations

import importlib
import json
import mmap
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from operator import attrgetter
from pathlib import Path
from select import POLLIN, poll
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from uavaccel.clock import MonotonicClock
from uavaccel.envs.arrays import assign, select
from uavaccel.envs.flight_env import FlightEnv, environment_of
from uavaccel.envs.values import Action, Answer, Info, Observation
from uavaccel.errors import UserError
from uavaccel.own_code import errors_named, files_of, import_alone
from uavaccel.processes.forks import CAN_FORK, WITHOUT_THREADS, Fork, Forks, fork_each
from uavaccel.processes.lifetime import (
    Process,
    descriptor_of_parent,
    end_with_process,
    end_within,
    single_core_rendering,
    start_python,
)
from uavaccel.processes.stalls import FIRST_POLLS, IDLE_POLLS, POLL_S, StallDetector, is_stopped
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S

STOP_S = 3.0  # for all processes, from the end of their connections to their own
NICENESS = 5  # the learner, for whom all environments wait, goes first

Seat = tuple[int, int]
"""The slot of an environment, and the file descriptor of its end of the connection."""

Options = dict[str, Any]
"""Options of all processes of a batch: `environment`, module and class, as "module:class", of an environment or of its
task; `folder`, from which the module is imported, or None; `keys`; `autoreset`; and of the `SharedObservations` the
`memory` and the `form`. Of one program beside these its `processes`, the seats of each; its `parent`; and `reports`, a
pipe in which it reports about the processes that it forks, or None.
"""


class SharedObservations:
    """Observations of all environments in memory that the processes share: (slots, *shape), or a mapping of these.

    `form` is the number of slots, and name, type and shape of each part, "" the name of the only one. `present` are the
    current ones; `last` are the final ones of games that an autoreset has replaced. `memory` is the file descriptor of
    the memory; without one new memory is made, of which nothing remains after the last process that has it.
    """

    def __init__(self, form: tuple[int, list[tuple[str, str, tuple[int, ...]]]], memory: int | None = None) -> None:
        slots, parts = self.form = form
        dtype = np.dtype([(name or "all", kind, tuple(shape)) for name, kind, shape in parts], align=True)
        size = 2 * slots * dtype.itemsize
        if memory is None:
            if hasattr(os, "memfd_create"):
                memory = os.memfd_create("uavaccel")
            else:
                memory, path = tempfile.mkstemp()
                os.unlink(path)
            os.ftruncate(memory, size)
        self.memory, both = memory, np.frombuffer(mmap.mmap(memory, size), dtype).reshape(2, slots)
        views: list[Observation] = [{name: each[name] for name in dtype.names or ()} for each in both]
        self.present, self.last = views if parts[0][0] else (view["all"] for view in views)


def observations_of(space: spaces.Space[Any], slots: int) -> SharedObservations:
    """Make the memory for observations of a space."""
    parts = space.spaces if isinstance(space, spaces.Dict) else {"": space}
    return SharedObservations(
        (slots, [(name, np.dtype(each.dtype).str, each.shape or ()) for name, each in parts.items()])
    )


class BatchError(RuntimeError):
    """An environment of a batch failed, or its process has ended."""


def still_flying(slot: int) -> BatchError:
    """Return the error for a request to an environment whose last answer was not taken."""
    return BatchError(f"environment {slot} is still flying: take its last answer before you ask for more")


def game_over(slot: int) -> UserError:
    """Return the error for a step in an ended game that no autoreset follows."""
    what = f"the game of environment {slot} has ended: with autoreset_mode = Disabled, reset it by option reset_mask"
    return UserError(f"step: {what}")


class EnvironmentProcesses:
    """`slots` environments distributed over `processes` processes; raises BatchError if one ends or hangs."""

    def __init__(self, options: Options, slots: int, processes: int) -> None:
        self._asked = [False] * slots
        pairs = [socket.socketpair() for _ in range(slots)]
        self._connections, theirs = (
            [Connection(mine.detach()) for mine, _ in pairs],
            [each.detach() for _, each in pairs],
        )
        self._polls = [poll() for _ in self._connections]  # cheaper than Connection.poll
        for each, connection in zip(self._polls, self._connections, strict=True):
            each.register(connection.fileno(), POLLIN)
        self._answered_once = False
        self._stalls, self._clock = StallDetector(), MonotonicClock()
        self._polled_ns = self._clock.now_ns()
        self._process_of = [slot % processes for slot in range(slots)]
        flown = [list(enumerate(theirs))[process::processes] for process in range(processes)]
        self._processes: list[Process | Fork] = []
        self._forks: Forks | None = None
        if CAN_FORK and processes > 1:
            reports, told = os.pipe()
            self._forks = Forks(self._start(options, flown, told), processes, reports)
            self._processes += self._forks.each()
            os.close(told)
        else:
            self._processes += [self._start(options, [each]) for each in flown]
        for descriptor in theirs:
            os.close(descriptor)

    def _start(self, options: Options, flown: list[list[Seat]], reports: int | None = None) -> Process:
        """Start a process that flies these seats, or with `reports` one that forks, and loads for, all of them."""
        program = {**options, "processes": flown, "parent": os.getpid(), "reports": reports}
        inherited = [options["memory"], *(connection for process in flown for _, connection in process)]
        process = start_python(
            *("-m", "uavaccel.envs.environment_process"),
            environment={**WITHOUT_THREADS, **single_core_rendering()},
            stdin=subprocess.PIPE,  # a thousand environments' options are too long for an argument
            pass_fds=inherited if reports is None else [*inherited, reports],
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
            raise still_flying(slot)
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
        kind, text = answer[1:]
        known = {"UserError": UserError, "AttributeError": AttributeError}
        raise known[kind](text) if kind in known else BatchError(f"environment {slot} failed:\n{text}")

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


class SlotsHere:
    """Environments in this process, which fly one after another, each when its answer is waited for."""

    def __init__(self, environment: type[FlightEnv[Any]], options: Options, slots: int) -> None:
        shared = SharedObservations(options["form"], options["memory"])
        self._slots = [Slot(environment, options, shared, number) for number in range(slots)]
        self._asked: dict[int, tuple[str, tuple[object, ...]]] = {}

    def ask(self, slot: int, method: str, *arguments: object) -> None:
        """Note a request."""
        self._asked[slot] = method, arguments

    def request_all(self, method: str, arguments: Sequence[tuple[object, ...]], slots: Sequence[int]) -> list[Answer]:
        """Return the answers of `slots` to a request of each."""
        self._asked |= {slot: (method, argument) for slot, argument in zip(slots, arguments, strict=True)}
        return self.answers(slots)

    def answers(self, slots: Sequence[int]) -> list[Answer]:
        """Return the answers of `slots` to what they were asked."""
        return [self.answer(slot) for slot in slots]

    def answer(self, slot: int) -> Answer:
        """Return one slot's answer."""
        method, arguments = self._asked.pop(slot)
        return getattr(self._slots[slot], method)(*arguments)

    def first_answered(self) -> int:
        """Return the slot that was asked first."""
        return next(iter(self._asked))

    def close(self) -> None:
        """End the environments."""
        for slot in self._slots:
            slot.close()


class Slot:
    """One environment of a batch; requests over its connection name a method of this class."""

    def __init__(
        self, environment: type[FlightEnv[Any]], options: Options, shared: SharedObservations, number: int
    ) -> None:
        self._environment, self._autoreset = environment(**options["keys"]), AutoresetMode(options["autoreset"])
        self._number = number
        self._seen, self._last = (select(each, number) for each in (shared.present, shared.last))

    def reset(self, seed: int | None, options: Mapping[str, object] | None) -> Info:
        """Begin a game and return its info; the observation goes into shared memory."""
        observation, info = self._environment.reset(seed=seed, options=options)
        assign(self._seen, ..., observation)
        return info

    def step(self, action: Action) -> tuple[float, bool, bool, Info, Info | None]:
        """Fly a command; returns reward, termination, truncation, info and, if it was reset, the last game's info."""
        if self._environment.over and self._autoreset == AutoresetMode.NEXT_STEP:
            return 0.0, False, False, self.reset(None, None), None
        if self._environment.over and self._autoreset == AutoresetMode.DISABLED:
            raise game_over(self._number)
        observation, reward, terminated, truncated, info = self._environment.step(action)
        last = None
        if self._environment.over and self._autoreset == AutoresetMode.SAME_STEP:
            assign(self._last, ..., observation)
            last = info
            info = self.reset(None, None)
        else:
            assign(self._seen, ..., observation)
        return reward, terminated, truncated, info, last

    def call(self, name: str, *arguments: object) -> object:
        """Call a method of the environment, or a function "module:name" with it, or return an attribute's value."""
        module, _, function = name.rpartition(":")
        if module:
            return getattr(importlib.import_module(module), function)(self._environment, *arguments)
        attribute = getattr(self._environment, name)
        result = attribute(*arguments) if callable(attribute) else attribute
        if name == "set_state":  # which returns the game's last observation
            assign(self._seen, ..., result)
        return result

    def set_attribute(self, name: str, value: object) -> None:
        setattr(self._environment, name, value)

    def close(self) -> None:
        self._environment.close()


def fly(options: Options, number: int, descriptor: int) -> None:
    """Serve slot `number` until its connection ends. Answers are (True, result) or, for errors, (False, kind, text)."""
    shared, connection = SharedObservations(options["form"], options["memory"]), Connection(descriptor)
    module, _, name = options["environment"].partition(":")
    slot: Slot | None = None
    own: list[Path] = []
    try:
        while True:
            method, arguments = connection.recv()
            try:
                if slot is None:
                    found: Any = environment_of(attrgetter(name)(import_alone(module)))
                    slot, own = Slot(found, options, shared, number), files_of(found, found.task_class)
                with errors_named(own):
                    answer = getattr(slot, method)(*arguments)
                connection.send((True, answer))
            except (UserError, AttributeError) as error:
                connection.send((False, type(error).__name__, str(error)))
            except Exception:
                connection.send((False, "", traceback.format_exc()))
    except (EOFError, OSError):  # nobody listens any more
        pass
    finally:
        if slot is not None:
            slot.close()


def main() -> None:
    options = json.load(sys.stdin)
    if options["folder"] is not None:
        sys.path.insert(0, options["folder"])
    os.nice(NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    parent = descriptor_of_parent(options["parent"])
    if options["reports"] is None:
        fly_together(options, options["processes"][0], parent)
        return
    module, _, _ = options["environment"].partition(":")
    if module.startswith("uavaccel."):  # another's may start threads, and what has threads cannot be forked
        importlib.import_module(module)
    World("blocks", NATIVE).advance(1)  # the machine code of a flight
    processes = options["processes"]
    descriptors = [{options["memory"], *(connection for _, connection in process)} for process in processes]
    fork_each(descriptors, options["reports"], lambda number: fly_together(options, processes[number], parent))


def fly_together(options: Options, seats: list[Seat], parent: int | None) -> None:
    """Fly the environments of one process until their connections end, or the parent does."""
    end_with_process(parent)
    threads = [threading.Thread(target=fly, args=(options, *seat)) for seat in seats]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


if __name__ == "__main__":
    main()
