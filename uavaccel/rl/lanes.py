"""The vectorised environments that a learner flies: a batch or, in timing `wall`, one lane in this process."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, TypeAlias

import gymnasium
import numpy as np
import torch as th
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.flyable import Simulator
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.simulators import EXACT
from uavaccel.envs.turn_batch import TurnBatch
from uavaccel.envs.values import Action, Answer, Frame
from uavaccel.rl.exact_lanes import start_exact_lanes, training_keywords


class BatchVecEnv(VecEnv):
    """Adapts a batch with autoreset SAME_STEP to stable-baselines3's VecEnv; methods may address some lanes only."""

    def __init__(self, batch: TurnBatch) -> None:
        self.batch = batch
        super().__init__(batch.num_envs, batch.single_observation_space, batch.single_action_space)

    def reset(self) -> VecEnvObs:
        options = [option or None for option in self._options]
        infos = self.batch.reset_each(self._seeds, options)
        self.reset_infos = infos
        self._reset_seeds()
        self._reset_options()
        return self.batch.observations()

    def step_async(self, actions: np.ndarray, lanes: Sequence[int] | None = None) -> None:
        """Start one command in each of `lanes`, by default in all."""
        self.batch.step_async(actions, lanes)

    def step_wait(self, lanes: Sequence[int] | None = None) -> VecEnvStepReturn:
        """Wait for the commands that `step_async` started in the same lanes."""
        observations, rewards, terminated, truncated, infos = self.batch.step_wait(lanes)
        cut_off = (truncated & ~terminated).tolist()
        flown = range(self.num_envs) if lanes is None else lanes
        for place, (lane, info, cut) in enumerate(zip(flown, infos, cut_off, strict=True)):
            if "final_info" in info:
                self.reset_infos[lane] = info
                infos[place] = {**info.pop("final_info"), "terminal_observation": info.pop("final_obs")}
            infos[place]["TimeLimit.truncated"] = cut
        return observations, rewards, terminated | truncated, infos

    def close(self) -> None:
        self.batch.close()

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Answer]:
        if not isinstance(self.batch, EnvironmentBatch) or attr_name == "render_mode":
            # A learner asks for it when it is made; lanes that are still starting need not answer.
            return [getattr(self.batch, attr_name) for _ in self._get_indices(indices)]
        return self.env_method(attr_name, indices=indices)

    def set_attr(self, attr_name: str, value: object, indices: int | Iterable[int] | None = None) -> None:
        assert isinstance(self.batch, EnvironmentBatch), "lanes over arrays have no attributes of their own"
        self.batch.set_each(attr_name, value, list(self._get_indices(indices)))

    def env_method(
        self,
        method_name: str,
        *method_args: object,
        indices: int | Iterable[int] | None = None,
        **method_kwargs: object,
    ) -> list[Answer]:
        if method_kwargs:
            raise TypeError(f"{method_name}: keywords do not travel, pass the arguments by position")
        lanes = list(self._get_indices(indices))
        return self.batch.call_each(method_name, [method_args] * len(lanes), lanes)

    def env_is_wrapped(
        self,
        wrapper_class: type[gymnasium.Wrapper[Frame, Action, Frame, Action]],
        indices: int | Iterable[int] | None = None,
    ) -> list[bool]:
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        return self.env_method("render")


Lanes = VecEnv
AnyLanes: TypeAlias = Any  # Lanes, or CudaLanes


def make_lanes(
    task: LaneTask, count: int, simulator: Simulator = EXACT, device: str = "cpu", begun: EnvironmentBatch | None = None
) -> AnyLanes:
    """Make the environments of a training, of a batch of exact lanes that has `begun` already if there is one.

    In timing `wall` the one lane is flown in this process, so that nothing learns meanwhile and disturbs its clock.
    """
    if task.timing == "wall":
        return DummyVecEnv([partial(ObstacleLane, **training_keywords(task))])
    if simulator == EXACT:
        return BatchVecEnv(begun or start_exact_lanes(task, count))
    if not device.startswith("cuda"):
        from uavaccel.envs.kernel_batch import KernelBatch  # its machine code is loaded where it flies

        return BatchVecEnv(KernelBatch(ObstacleLane, count, autoreset_mode="SameStep", **training_keywords(task)))
    from uavaccel.envs.cuda_lanes import CudaLanes  # needs numba-cuda and a GPU

    return CudaLanes(task, count, th.device(device))


def seed_lanes(lanes: AnyLanes, seed: int) -> None:
    """Seed the lanes; a hash keeps the consecutive seeds of different trainings apart."""
    lanes.seed(int(np.random.SeedSequence([seed, 1]).generate_state(1)[0]) >> 1)
