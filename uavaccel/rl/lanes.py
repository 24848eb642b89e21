"""The environments that a learner flies: a batch or, in timing `wall`, one environment in this process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector.utils import batch_space

from uavaccel.envs.arrays import stacked_observations
from uavaccel.envs.batch import EnvironmentBatch, TurnBatch
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.simulators import EXACT
from uavaccel.envs.values import Actions, Answer, Info, Observation, Steps
from uavaccel.rl.config import LearnerConfig


class LanesHere(TurnBatch):
    """Environments in this process, which fly one after another; a game that ends is followed by the next one."""

    def __init__(self, environments: Sequence[Callable[[], FlightEnv[Any]]]) -> None:
        self._environments = [make() for make in environments]
        first = self._environments[0]
        self.num_envs, self.render_mode = len(environments), None
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        self.observation_space = batch_space(first.observation_space, self.num_envs)
        self.action_space = batch_space(first.action_space, self.num_envs)
        self._seen: dict[int, Observation] = {}
        self._actions: dict[int, Any] = {}

    def reset_each(
        self,
        seeds: Sequence[int | None],
        options: Sequence[Mapping[str, object] | None],
        slots: Sequence[int] | None = None,
    ) -> list[Info]:
        return [self._begin(*each) for each in zip(self._all(slots), seeds, options, strict=True)]

    def _begin(self, slot: int, seed: int | None = None, options: Mapping[str, object] | None = None) -> Info:
        self._seen[slot], info = self._environments[slot].reset(seed=seed, options=options)
        return info

    def step_async(self, actions: Actions, slots: Sequence[int] | None = None) -> None:
        self._actions |= dict(zip(self._all(slots), actions, strict=True))

    def step_wait(self, slots: Sequence[int] | None = None) -> Steps:
        steps = []
        for slot in self._all(slots):
            seen, reward, terminated, truncated, info = self._environments[slot].step(self._actions.pop(slot))
            self._seen[slot] = seen
            if terminated or truncated:
                info = self._begin(slot) | {"final_info": info, "final_obs": seen}
            steps.append((reward, terminated, truncated, info))
        rewards, *ends, infos = zip(*steps, strict=True)
        ended = np.array(rewards, float), *(np.array(each, bool) for each in ends)
        return stacked_observations([self._seen[slot] for slot in self._all(slots)]), *ended, list(infos)

    def call_each(
        self, name: str, arguments: Sequence[tuple[object, ...]], slots: Sequence[int] | None = None
    ) -> list[Answer]:
        pairs = zip(self._all(slots), arguments, strict=True)
        return [getattr(self._environments[slot], name)(*argument) for slot, argument in pairs]

    def observations(self) -> Observation:
        return stacked_observations([self._seen[slot] for slot in range(self.num_envs)])

    def _all(self, slots: Sequence[int] | None) -> Sequence[int]:
        return range(self.num_envs) if slots is None else slots

    def close_extras(self, **_: object) -> None:
        for environment in self._environments:
            environment.close()


def start_exact_lanes(config: LearnerConfig) -> EnvironmentBatch:
    """Start the processes of the exact simulator's lanes, and return while they load. Raises UserError as they do."""
    return EnvironmentBatch(config.environment_class, config.environments, **_keywords(config))


def _keywords(config: LearnerConfig) -> dict[str, Any]:
    """Return the keywords of a training's batch, whose infos include host times."""
    return {**config.task.model_dump(mode="json"), "report_host_times": True, "autoreset_mode": "SameStep"}


def make_lanes(config: LearnerConfig, begun: EnvironmentBatch | None = None) -> Any:
    """Make the environments of a training, of a batch of exact lanes that has `begun` already if there is one.

    In timing `wall` the one lane is flown in this process, so that nothing learns meanwhile and disturbs its clock.
    """
    environment, count, keywords = config.environment_class, config.environments, _keywords(config)
    if config.task.timing == "wall":
        del keywords["autoreset_mode"]
        return LanesHere([lambda: environment(**keywords)])
    if config.simulator == EXACT:
        return begun or start_exact_lanes(config)
    if not config.on_device:
        from uavaccel.envs.kernel_batch import KernelBatch  # its machine code is loaded where it flies

        return KernelBatch(environment, count, **keywords)
    if config.algorithm == "ppo":
        from uavaccel.envs.cuda_batch import CudaBatch  # needs numba-cuda and a GPU

        return CudaBatch(environment, count, **keywords)
    import torch as th

    from uavaccel.envs.cuda_lanes import CudaLanes

    return CudaLanes(config.task, count, th.device(config.device))
