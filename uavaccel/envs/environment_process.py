"""The processes in which the environments of a batch fly, each in a thread, so that one flies while another waits.

    python -m uavaccel.envs.environment_process <<< '{"environment": "uavaccel.envs.obstacle_lane:ObstacleLane", ...}'

Started by uavaccel.envs.environment_processes for one process, or for all: then it loads what each of them needs, and
forks them. A process ends when its last connection to the batch is closed.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Mapping
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from gymnasium.vector import AutoresetMode

from uavaccel.envs.environment_processes import ProgramOptions, Seat, SharedObservations
from uavaccel.envs.flight_env import FlightEnv, environment_of
from uavaccel.envs.values import Action, Info, Observation, rows_of, write
from uavaccel.errors import UserError
from uavaccel.own_code import errors_named, file_of
from uavaccel.processes.forks import fork_each
from uavaccel.processes.lifetime import descriptor_of_parent, end_with_process
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World

NICENESS = 5  # the learner, for whom all environments wait, goes first


class Slot:
    """One environment of a batch; requests over its connection name a method of this class."""

    def __init__(
        self, environment: FlightEnv[Any], seen: Observation, last: Observation, autoreset: AutoresetMode
    ) -> None:
        self._environment, self._autoreset = environment, autoreset
        self._seen, self._last = seen, last
        self._over = False

    def reset(self, seed: int | None, options: Mapping[str, object] | None) -> Info:
        """Begin a game and return its info; the observation goes into shared memory."""
        observation, info = self._environment.reset(seed=seed, options=options)
        write(self._seen, observation)
        self._over = False
        return info

    def step(self, action: Action) -> tuple[float, bool, bool, Info, Info | None]:
        """Fly a command; returns reward, termination, truncation, info and, if it was reset, the last game's info."""
        if self._over and self._autoreset == AutoresetMode.NEXT_STEP:
            return 0.0, False, False, self.reset(None, None), None
        observation, reward, terminated, truncated, info = self._environment.step(action)
        self._over, last = terminated or truncated, None
        if self._over and self._autoreset == AutoresetMode.SAME_STEP:
            write(self._last, observation)
            last = info
            info = self.reset(None, None)
        else:
            write(self._seen, observation)
        return reward, terminated, truncated, info, last

    def call(self, name: str, *arguments: object) -> object:
        """Call a method of the environment, or a function "module:name" with it, or return an attribute's value."""
        module, _, function = name.rpartition(":")
        attribute: Any = None if module else getattr(self._environment, name)
        if module:
            attribute = partial(getattr(importlib.import_module(module), function), self._environment)
        result = attribute(*arguments) if callable(attribute) else attribute
        if name == "set_state":  # which returns the game's last observation
            write(self._seen, result)
            self._over = False
        return result

    def set_attribute(self, name: str, value: object) -> None:
        setattr(self._environment, name, value)

    def close(self) -> None:
        self._environment.close()


def fly(options: ProgramOptions, number: int, descriptor: int) -> None:
    """Serve slot `number` until its connection ends. Answers are (True, result) or, for errors, (False, kind, text)."""
    shared, connection = SharedObservations(options["observations"], options["memory"]), Connection(descriptor)
    module, _, name = options["environment"].partition(":")
    slot: Slot | None = None
    own: Path | None = None
    try:
        while True:
            method, arguments = connection.recv()
            try:
                if slot is None:
                    found: Any = environment_of(getattr(importlib.import_module(module), name))
                    environment, own = found(**options["keys"]), file_of(found)
                    autoreset = AutoresetMode(options["autoreset"])
                    seen, last = (rows_of(each, number) for each in (shared.present, shared.last))
                    slot = Slot(environment, seen, last, autoreset)
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
    load(options["environment"])
    processes = options["processes"]
    descriptors = [{options["memory"], *(connection for _, connection in process)} for process in processes]
    fork_each(descriptors, options["reports"], lambda number: fly_together(options, processes[number], parent))


def load(environment: str) -> None:
    """Load what every process needs: modules, if they are this package's own, and the machine code of a flight."""
    module, _, _ = environment.partition(":")
    if module.startswith("uavaccel."):  # another's may start threads, and what has threads cannot be forked
        importlib.import_module(module)
    World("blocks", NATIVE).advance(1)


def fly_together(options: ProgramOptions, seats: list[Seat], parent: int | None) -> None:
    """Fly the environments of one process until their connections end, or the parent does."""
    end_with_process(parent)
    threads = [threading.Thread(target=fly, args=(options, *seat)) for seat in seats]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


if __name__ == "__main__":
    main()
