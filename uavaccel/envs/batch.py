"""Vectorised environments of one task in the exact simulator, in several processes.

`TurnBatch` is what learners fly, the kernels' too. In the exact simulator each environment flies as it would alone, to
the last bit, and draws in its own process.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy import bool_, float64, int64
from numpy.typing import NDArray

from uavaccel.config import MOST_GAMES, MOST_PROCESSES
from uavaccel.envs.arrays import mapped, select
from uavaccel.envs.checks import actions_of, check_render_mode, lanes_of, make_task, refuse_copy, seeds_of, whole_number
from uavaccel.envs.environment_process import EnvironmentProcesses, Options, SlotsHere, observations_of
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.values import Actions, Answer, Batch, Info, Observation, Steps
from uavaccel.errors import UserError
from uavaccel.machine import usable_cores
from uavaccel.own_code import check_not_importing, folder_of, place_of
from uavaccel.sim.camera.gl import choose_backend
from uavaccel.units import NS_PER_S

Seeds = Sequence[int | None]
GameOptions = Sequence[Mapping[str, object] | None]
Arguments = Sequence[tuple[Any, ...]]
"""The seeds and options of games, and arguments of a method: one for each of the slots."""

Slots: TypeAlias = Sequence[int] | None
"""Environments of a batch by their numbers; None for all."""


def set_up(batch: Any, environment: type[FlightEnv[Any]], num_envs: int, mode: object, keys: Mapping[str, Any]) -> Any:
    """Give a batch what Gymnasium's vectors have, and its task, which is returned. Raises UserError for wrong keys."""
    task = make_task(environment.task_class, keys, environment.__name__)
    whole_number("num_envs", num_envs, MOST_GAMES)
    if mode not in (known := [each.value for each in AutoresetMode]) and not isinstance(mode, AutoresetMode):
        raise UserError(f"autoreset_mode = {mode!r} is unknown; there are {', '.join(known)}")
    batch.num_envs, batch.metadata = num_envs, {**environment.metadata, "autoreset_mode": AutoresetMode(mode)}
    batch.single_observation_space, batch.single_action_space = task.observation_space(), task.action_space()
    batch.observation_space = batch_space(batch.single_observation_space, num_envs)
    batch.action_space = batch_space(batch.single_action_space, num_envs)
    return task


class TurnBatch(Batch, ABC):
    """A vector environment whose `step` is the start of a command in some environments and the wait for its end."""

    __getstate__ = refuse_copy
    _begun = False

    # --- Gymnasium --------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, object] | None = None
    ) -> tuple[Observation, Info]:
        """Begin a game in every environment; environment i gets `seed` + i, or the i-th of several seeds.

        With the option `reset_mask`, truth values (N,), in those alone. Raises UserError where the first is not of all.
        """
        seeds, (which, others) = seeds_of(seed, self.num_envs), lanes_of(options, self.num_envs)
        if len(which) < self.num_envs and not self._begun:
            raise UserError("reset: option reset_mask: reset all environments first")
        begun = self.reset_each([seeds[slot] for slot in which], [others] * len(which), which)
        self._begun = True
        infos = dict(zip(which, begun, strict=True))
        return self.observations(), self._merged([infos.get(slot, {}) for slot in range(self.num_envs)])

    def step(self, actions: Actions) -> tuple[Observation, NDArray[float64], NDArray[bool_], NDArray[bool_], Info]:
        """Fly one command in every environment."""
        self.step_async(actions)
        observations, rewards, terminated, truncated, infos = self.step_wait()
        return observations, rewards, terminated, truncated, self._merged(infos)

    def _merged(self, infos: Sequence[Info]) -> Info:
        """Merge infos as Gymnasium's VectorEnv does: for each key an array of values, and a mask."""
        merged: Info = {}
        for slot, info in enumerate(infos):
            merged = self._add_info(merged, info, slot)
        return merged

    # --- learners ---------------------------------------------------------------------------------

    @abstractmethod
    def reset_each(self, seeds: Seeds, options: GameOptions, slots: Slots = None) -> list[Info]:
        """Begin a game in each of `slots`, by default all, with its own seed and options; return the infos."""

    @abstractmethod
    def step_async(self, actions: Actions, slots: Slots = None) -> None:
        """Start one command in each of `slots`, by default all, and return while they fly."""

    @abstractmethod
    def step_wait(self, slots: Slots = None) -> Steps:
        """Wait for what `step_async` started in the same `slots`.

        Returns observations, rewards, terminations, truncations and infos. With autoreset SAME_STEP the last info of a
        finished game is in `final_info` and its last observation in `final_obs`.
        """

    @abstractmethod
    def call_each(self, name: str, arguments: Arguments, slots: Slots = None) -> list[Answer]:
        """Call a method of `slots`, by default all, each with its own arguments; return the results."""

    def charge_each(self, durations_ns: NDArray[int64]) -> None:
        """In timing `virtual`, charge each environment (N,) for its agent's work since its last command."""
        charged = durations_ns.nonzero()[0].tolist()
        self.call_each("charge", [(durations_ns[slot] / NS_PER_S,) for slot in charged], charged)

    @abstractmethod
    def observations(self) -> Observation:
        """Return the present observations of all environments."""


class EnvironmentBatch(TurnBatch):
    """`num_envs` environments of the class `environment`, a FlightEnv, with that class's keywords.

    They fly in `processes` processes, by default at most two per core. Raises UserError for keywords that do not fit,
    and without OpenGL if they observe pictures; methods raise UserError or BatchError for errors in an environment.
    """

    def __init__(
        self,
        environment: type[FlightEnv[Any]],
        num_envs: int = 1,
        processes: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **keys: Any,
    ) -> None:
        check_not_importing()
        self.render_mode = check_render_mode(keys.pop("render_mode", None))
        self.task = task = set_up(self, environment, num_envs, autoreset_mode, keys)
        if processes is not None:
            whole_number("processes", processes, MOST_PROCESSES)
        if task.timing == "wall" and num_envs > 1:
            raise UserError("timing = 'wall': a batch flies in virtual or lockstep, neighbours would disturb the clock")
        if task.sensor().picture is not None:
            choose_backend()  # for all processes
        self._observations = observations_of(self.single_observation_space, num_envs)
        self.processes = min(processes or 2 * usable_cores(), num_envs)
        options = {
            "environment": place_of(environment),
            "folder": str(folder) if (folder := folder_of(environment)) else None,
            "keys": {**task.model_dump(mode="json"), "render_mode": self.render_mode},
            "memory": self._observations.memory,
            "form": self._observations.form,
            "autoreset": self.metadata["autoreset_mode"].value,
        }
        self._slots = self._started(environment, options)

    def _started(self, environment: type[FlightEnv[Any]], options: Options) -> EnvironmentProcesses:
        return EnvironmentProcesses(options, self.num_envs, self.processes)

    # --- Gymnasium --------------------------------------------------------------------------------

    def render(self) -> tuple[Answer, ...] | None:
        """Return each front camera's picture; None without a render mode."""
        return self.call("render") if self.render_mode is not None else None

    def call(self, name: str, *arguments: object) -> tuple[Answer, ...]:
        """Call a method of every environment with the same arguments, or return the values of an attribute."""
        return tuple(self.call_each(name, [arguments] * self.num_envs))

    def get_attr(self, name: str) -> tuple[Answer, ...]:
        """Return the values of an attribute."""
        return self.call(name)

    def set_attr(self, name: str, values: object) -> None:
        """Set an attribute to one value or, from a list, to one for each environment."""
        each = values if isinstance(values, (list, tuple)) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise UserError(f"set_attr: {len(each)} values for {self.num_envs} environments")
        self._slots.request_all("set_attribute", [(name, value) for value in each], range(self.num_envs))

    def close_extras(self, **_: object) -> None:
        """End the processes."""
        if hasattr(self, "_slots"):
            self._slots.close()
            os.close(self._observations.memory)

    def __del__(self) -> None:
        self.close()

    @property
    def process_ids(self) -> list[int]:
        """Ids of the processes in which the environments fly."""
        return self._slots.process_ids

    # --- learners ---------------------------------------------------------------------------------

    def step_async(self, actions: Actions, slots: Slots = None) -> None:
        """Start one command in each of `slots`, by default all, and return while they fly."""
        which = self._all(slots)
        for slot, action in zip(which, actions_of(self.single_action_space, actions, len(which)), strict=True):
            self._slots.ask(slot, "step", action)

    def step_wait(self, slots: Slots = None) -> Steps:
        """As `TurnBatch` has it; raises BatchError where an environment has failed or its process has ended."""
        which = list(self._all(slots))
        rewards, terminated, truncated, infos, lasts = zip(*self._slots.answers(which), strict=True)
        for slot, info, last in zip(which, infos, lasts, strict=True):
            if last is not None:
                info |= {"final_obs": mapped(np.copy, select(self._observations.last, slot)), "final_info": last}
        seen = select(self._observations.present, which)
        return seen, np.array(rewards), np.array(terminated), np.array(truncated), list(infos)

    def reset_each(self, seeds: Seeds, options: GameOptions, slots: Slots = None) -> list[Info]:
        """As `TurnBatch` has it."""
        return self._slots.request_all("reset", list(zip(seeds, options, strict=True)), self._all(slots))

    def call_each(self, name: str, arguments: Arguments, slots: Slots = None) -> list[Answer]:
        """Call a method of `slots`, by default all, each with its own arguments; returns the results."""
        return self._slots.request_all("call", [(name, *argument) for argument in arguments], self._all(slots))

    def call_async(self, slot: int, name: str, *arguments: object) -> None:
        """Start a method of one environment and return at once; `call_wait` returns the result."""
        self._slots.ask(slot, "call", name, *arguments)

    def call_wait(self) -> tuple[int, Answer]:
        """Wait for any environment that `call_async` started; returns its slot and the result."""
        slot = self._slots.first_answered()
        return slot, self._slots.answer(slot)

    def observations(self) -> Observation:
        """Return the present observations of all environments."""
        return mapped(np.copy, self._observations.present)

    def _all(self, slots: Slots) -> Sequence[int]:
        return range(self.num_envs) if slots is None else slots


class LanesHere(EnvironmentBatch):
    """Environments in this process, where nothing else goes on while one of them flies."""

    def _started(self, environment: type[FlightEnv[Any]], options: Options) -> Any:
        return SlotsHere(environment, options, self.num_envs)
