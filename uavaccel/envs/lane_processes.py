"""The processes of a batch, as the one that started them sees them: questions to lanes, and their answers."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from typing import Any

from uavaccel.errors import UserError
from uavaccel.sim.rendering.camera import RendererGoneError
from uavaccel.sim.rendering.service import RenderService, stop


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
            answer = self._connections[lane].recv()
        except (EOFError, OSError):
            raise self._ended(lane) from None
        finally:
            self._asked[lane] = False
        if answer[0]:
            return answer[1]
        raise self._error(lane, *answer[1:])

    def first_answered(self) -> int:
        """A lane whose answer to a question is there; waits for one. Raises BatchError where none was asked."""
        asked = {self._connections[lane]: lane for lane, waiting in enumerate(self._asked) if waiting}
        if not asked:
            raise BatchError("no lane was asked for anything")
        return asked[wait(list(asked))[0]]  # type: ignore[index]

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
        for process in self._processes:
            stop(process)
        self._processes = []
