"""The processes of a batch, as the one that started them sees them: questions to environments, and their answers."""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from typing import TypedDict

from uavaccel.child import single_core_drawing, start_python
from uavaccel.clock import MonotonicClock
from uavaccel.envs.batch_memory import Size
from uavaccel.envs.values import Answer
from uavaccel.errors import UserError
from uavaccel.sim.rendering.camera import RendererGoneError
from uavaccel.sim.rendering.service import RenderService, stop
from uavaccel.standstill import FIRST_LOOKS, LOOK_S, LOOKS, Standstill, is_stopped
from uavaccel.units import NS_PER_S


def _poll_of(connection: Connection) -> select.poll:
    """Whether its answer is there, at less cost than the connection itself would say."""
    poll = select.poll()
    poll.register(connection.fileno(), select.POLLIN)
    return poll


class Place(TypedDict):
    """One environment's: its slot, its end of a connection, and, where one is shared, its place at the renderer."""

    slot: int
    connection: int
    renderer: dict[str, int] | None


class BatchOptions(TypedDict):
    """What the processes of a batch are told."""

    environment: str
    """Its module and class."""
    keys: dict[str, object]
    memory: int
    """Of the observations, as a file descriptor."""
    observations: Size
    autoreset: str


class ProcessOptions(BatchOptions):
    """What one of them is told."""

    slots: list[Place]
    parent: int


class BatchError(RuntimeError):
    """An environment of a batch failed, or its process has ended."""


class EnvironmentProcesses:
    """`slots` environments over `processes` processes; `options` are environment_process's, but for slots."""

    def __init__(
        self, options: BatchOptions, slots: int, processes: int, service: RenderService | None
    ) -> None:
        self._connections: list[Connection] = []
        self._asked = [False] * slots
        self._service = service
        theirs = []
        for _ in range(slots):
            mine, other = socket.socketpair()
            self._connections.append(Connection(mine.detach()))
            theirs.append(other.detach())
        self._polls = [_poll_of(connection) for connection in self._connections]
        self._answered_once = False
        self._standstill, self._clock = Standstill(), MonotonicClock()
        self._looked_ns = self._clock.now_ns()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._process_of = [slot % processes for slot in range(slots)]
        for process in range(processes):
            flown = [slot for slot in range(slots) if self._process_of[slot] == process]
            self._processes.append(self._start(options, {slot: theirs[slot] for slot in flown}))
        for descriptor in theirs:
            os.close(descriptor)

    def _start(self, options: BatchOptions, flown: dict[int, int]) -> subprocess.Popen[bytes]:
        service, inherited = self._service, {options["memory"], *flown.values()}
        places: list[Place] = []
        for slot, connection in flown.items():
            renderer = None
            if service is not None:
                descriptors = service.descriptors(slot)
                inherited |= set(descriptors.values())
                renderer = {"number": slot, "count": service.cameras, **descriptors}
            places.append({"slot": slot, "connection": connection, "renderer": renderer})
        told: ProcessOptions = {**options, "slots": places, "parent": os.getpid()}
        return start_python(
            *("-m", "uavaccel.envs.environment_process", json.dumps(told)),
            environment=single_core_drawing(),
            pass_fds=sorted(inherited),
        )

    def ask(self, slot: int, method: str, *arguments: object) -> None:
        """Send a question; its `answer` has to be taken before the next."""
        if not self._connections:
            raise self._ended(slot)
        if self._asked[slot]:
            raise BatchError(
                f"environment {slot} is still flying: take its last answer before you ask for more"
            )
        try:
            self._connections[slot].send((method, arguments))
        except OSError:
            raise self._ended(slot) from None
        self._asked[slot] = True

    def answer(self, slot: int) -> Answer:
        """The answer to the last question. Raises UserError or BatchError where there is none."""
        try:
            while self._connections and not self._polls[slot].poll(LOOK_S * 1e3):
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
        """A slot whose answer to a question is there; waits for one. Raises BatchError where none was asked."""
        asked = {self._connections[slot]: slot for slot, waiting in enumerate(self._asked) if waiting}
        if not asked:
            raise BatchError("no environment was asked for anything")
        while not (answered := wait(list(asked), LOOK_S)):
            self._look()
        if self._clock.now_ns() - self._looked_ns > LOOK_S * NS_PER_S:
            self._look()  # others answer, and one might never be missed
        return asked[answered[0]]  # type: ignore[index]

    def _look(self) -> None:
        """See after those whose answers are overdue. Raises BatchError for those that stand still, which it ends."""
        self._looked_ns = self._clock.now_ns()
        waiting = {self._process_of[slot] for slot, asked in enumerate(self._asked) if asked}
        pids = {self._processes[number].pid: number for number in waiting}
        renderer = self._service.process if self._service is not None else None
        looks = LOOKS if self._answered_once else FIRST_LOOKS
        standing = self._standstill.look(pids, None if renderer is None else renderer.pid, looks)
        if not standing:
            return
        if renderer is not None and is_stopped(renderer.pid):
            renderer.kill()
            raise BatchError("the renderer of all environments stands still: it was stopped")
        slots = [
            slot for slot, number in enumerate(self._process_of) if self._processes[number].pid in standing
        ]
        how = "was stopped" if is_stopped(standing[0]) else "waits for what does not come"
        for pid in standing:
            self._processes[pids[pid]].kill()
        raise BatchError(f"the process of environment {slots[0]} stands still: it {how}")

    def ask_all(
        self, method: str, arguments: Sequence[tuple[object, ...]], slots: Sequence[int]
    ) -> list[Answer]:
        """A question to each of some slots, all asked before the first answer is taken."""
        for slot, each in zip(slots, arguments, strict=True):
            self.ask(slot, method, *each)
        return self.answers(slots)

    def answers(self, slots: Sequence[int]) -> list[Answer]:
        """The answers of some slots. Raises the first error, after all have been taken."""
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
        if self._service is not None and RendererGoneError.__name__ in text:  # as the wire's own error, too
            return BatchError(f"the renderer of all environments {self._service.status()}")
        return BatchError(f"environment {slot} failed:\n{text}")

    @property
    def process_ids(self) -> list[int]:
        return [process.pid for process in self._processes]

    def close(self) -> None:
        """End the processes; what they still fly is given up."""
        for connection in self._connections:
            connection.close()
        self._connections = []
        if any(self._asked):  # a question may be a whole game, and nobody waits for its answer any more
            for process in self._processes:
                process.terminate()
        stop(*self._processes)
        self._processes = []
