"""The batch that learners fly in turns: some of its environments fly while others are learned from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from numpy import bool_, float64, int64
from numpy.typing import NDArray

from uavaccel.envs.checks import seeds_of
from uavaccel.envs.values import Actions, Answer, Batch, Info, Observation, Steps
from uavaccel.units import NS_PER_S


class TurnBatch(Batch, ABC):
    """A vector environment whose `step` is the start of a command in some environments and the wait for its end."""

    # --- Gymnasium --------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, object] | None = None
    ) -> tuple[Observation, Info]:
        """Begin a game in every environment; environment i gets `seed` + i, or the i-th of several seeds."""
        infos = self.reset_each(seeds_of(seed, self.num_envs), [options] * self.num_envs)
        return self.observations(), self._merged(infos)

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
    def reset_each(self, seeds: Sequence[int | None], options: Sequence[Mapping[str, object] | None]) -> list[Info]:
        """Begin a game in every environment with its own seed and options; return the infos."""

    @abstractmethod
    def step_async(self, actions: Actions, slots: Sequence[int] | None = None) -> None:
        """Start one command in each of `slots`, by default all, and return while they fly."""

    @abstractmethod
    def step_wait(self, slots: Sequence[int] | None = None) -> Steps:
        """Wait for what `step_async` started in the same `slots`.

        Returns observations, rewards, terminations, truncations and infos. With autoreset SAME_STEP the last info of a
        finished game is in `final_info` and its last observation in `final_obs`.
        """

    @abstractmethod
    def call_each(
        self, name: str, arguments: Sequence[tuple[object, ...]], slots: Sequence[int] | None = None
    ) -> list[Answer]:
        """Call a method of `slots`, by default all, each with its own arguments; return the results."""

    def charge_each(self, durations_ns: NDArray[int64]) -> None:
        """In timing `virtual`, charge each environment (N,) for its agent's work since its last command."""
        charged = durations_ns.nonzero()[0].tolist()
        self.call_each("charge", [(durations_ns[slot] / NS_PER_S,) for slot in charged], charged)

    @abstractmethod
    def observations(self) -> Observation:
        """Return the present observations of all environments."""
