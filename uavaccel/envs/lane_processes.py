"""The processes of a batch, as the one that started them sees them: questions to lanes, and their answers."""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from typing import Any

from uavaccel.clock import MonotonicClock
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


class BatchError(RuntimeError):
    """An environment of a batch failed, or its process has ended."""


class LaneProcesses:
    """`lanes` environments over `processes` processes; `options` are those of lane_process, but for its lanes."""

    def __init__(
        self, options: dict[str, Any], lanes: int, processes: int, service: RenderService | None
    ) -> None:
        self._connections: list[Connection] = []
        self._asked = [False] * lanes
        self._service = service
        theirs = []
        for _ in range(lanes):
            mine, other = socket.socketpair()
            self._connections.append(Connection(mine.detach()))
            theirs.append(other.detach())
        self._polls = [_poll_of(connection) for connection in self._connections]
        self._answered_once = False
        self._standstill, self._clock = Standstill(), MonotonicClock()
        self._looked_ns = self._clock.now_ns()
        self._processes: list[subprocess.Popen[Any]] = []
        self._process_of = [lane % processes for lane in range(lanes)]
        for process in range(processes):
            flown = [lane for lane in range(lanes) if self._process_of[lane] == process]
            self._processes.append(self._start(options, {lane: theirs[lane] for lane in flown}))
        for descriptor in theirs:
            os.close(descriptor)

    def _start(self, options: dict[str, Any], flown: dict[int, int]) -> subprocess.Popen[Any]:
        service, places, inherited = self._service, [], {options["memory"], *flown.values()}
        for lane, connection in flown.items():
            renderer = None
            if service is not None:
                descriptors = service.descriptors(lane)
                inherited |= set(descriptors.values())
                renderer = {"number": lane, "count": service.cameras, **descriptors}
            places.append({"lane": lane, "connection": connection, "renderer": renderer})
        told = {**options, "lanes": places, "parent": os.getpid()}
        return subprocess.Popen(
            [sys.executable, "-m", "uavaccel.envs.lane_process", json.dumps(told)],
            pass_fds=sorted(inherited),
            env={"LP_NUM_THREADS": "0", **os.environ},  # in software, each draws on its own core
            start_new_session=True,  # Ctrl-C is for the process that flies the batch
        )

    def ask(self, lane: int, method: str, *arguments: Any) -> None:
        """Send a question; its `answer` has to be taken before the next."""
        if not self._connections:
            raise self._ended(lane)
        if self._asked[lane]:
            raise BatchError(f"lane {lane} is still flying: take its last answer before you ask for more")
        try:
            self._connections[lane].send((method, arguments))
        except OSError:
            raise self._ended(lane) from None
        self._asked[lane] = True

    def answer(self, lane: int) -> Any:
        """The answer to the last question. Raises UserError or BatchError where there is none."""
        try:
            while self._connections and not self._polls[lane].poll(LOOK_S * 1e3):
                self._look()
            answer = self._connections[lane].recv()
        except (EOFError, OSError):
            raise self._ended(lane) from None
        finally:
            self._asked[lane] = False
        self._answered_once = True
        if answer[0]:
            return answer[1]
        raise self._error(lane, *answer[1:])

    def first_answered(self) -> int:
        """A lane whose answer to a question is there; waits for one. Raises BatchError where none was asked."""
        asked = {self._connections[lane]: lane for lane, waiting in enumerate(self._asked) if waiting}
        if not asked:
            raise BatchError("no lane was asked for anything")
        while not (answered := wait(list(asked), LOOK_S)):
            self._look()
        if self._clock.now_ns() - self._looked_ns > LOOK_S * NS_PER_S:
            self._look()  # others answer, and one might never be missed
        return asked[answered[0]]  # type: ignore[index]

    def _look(self) -> None:
        """See after those whose answers are overdue. Raises BatchError for those that stand still, which it ends."""
        self._looked_ns = self._clock.now_ns()
        waiting = {self._process_of[lane] for lane, asked in enumerate(self._asked) if asked}
        pids = {self._processes[number].pid: number for number in waiting}
        renderer = self._service.process if self._service is not None else None
        looks = LOOKS if self._answered_once else FIRST_LOOKS
        standing = self._standstill.look(pids, None if renderer is None else renderer.pid, looks)
        if not standing:
            return
        if renderer is not None and is_stopped(renderer.pid):
            renderer.kill()
            raise BatchError("the renderer of all lanes stands still: it was stopped")
        lanes = [
            lane for lane, number in enumerate(self._process_of) if self._processes[number].pid in standing
        ]
        how = "was stopped" if is_stopped(standing[0]) else "waits for what does not come"
        for pid in standing:
            self._processes[pids[pid]].kill()
        raise BatchError(f"the process of lane {lanes[0]} stands still: it {how}")

    def ask_all(self, method: str, arguments: Sequence[tuple[Any, ...]], lanes: Sequence[int]) -> list[Any]:
        """A question to each of some lanes, all asked before the first answer is taken."""
        for lane, each in zip(lanes, arguments, strict=True):
            self.ask(lane, method, *each)
        return self.answers(lanes)

    def answers(self, lanes: Sequence[int]) -> list[Any]:
        """The answers of some lanes. Raises the first error, after all have been taken."""
        answers, errors = [], []
        for lane in lanes:
            try:
                answers.append(self.answer(lane))
            except (UserError, AttributeError, BatchError) as error:
                errors.append(error)
        if errors:
            raise errors[0]
        return answers

    def _ended(self, lane: int) -> BatchError:
        if not self._connections:
            return BatchError("this batch is closed")
        process = self._processes[self._process_of[lane]]
        return BatchError(f"the process of lane {lane} ended with status {process.wait()}")

    def _error(self, lane: int, kind: str, text: str) -> Exception:
        if kind == "UserError":
            return UserError(text)
        if kind == "AttributeError":
            return AttributeError(text)
        if self._service is not None and RendererGoneError.__name__ in text:  # as the wire's own error, too
            return BatchError(f"the renderer of all lanes {self._service.status()}")
        return BatchError(f"lane {lane} failed:\n{text}")

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
