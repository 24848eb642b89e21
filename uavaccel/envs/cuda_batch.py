"""Many environments of one task on one GPU, as torch tensors: `simulator="kernels"`, `device="cuda"`.

Observations, rewards and ends stay on the device; the host draws games ahead, and tells how those that end came out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch as th
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from uavaccel.envs.checks import ROUNDING, make_task, seeds_of
from uavaccel.envs.cuda_lanes import AT, CudaLanes
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.flyable import CUDA, check_flyable
from uavaccel.errors import UserError

DEVICE = CUDA
Steps = tuple[th.Tensor, th.Tensor, th.Tensor, th.Tensor, dict[str, Any]]


class CudaBatch(VectorEnv[Any, Any, Any]):
    """`num_envs` environments of `environment`, a class of FlightEnv's kind, with the keywords that it takes.

    A step takes actions as numpy or torch, and gives tensors of its own on the device: observations (N, ...), rewards
    (N,) float64, ends and truncations (N,) bool. A game that ends gives way to the next one in the same step; infos
    have `position_m` (N, 3) and `commands` (N,) as tensors, and for each game that ended `final_info` and `final_obs`.
    Raises UserError for keywords that do not fit, and for what only the exact simulator flies.
    """

    def __init__(
        self,
        environment: type[FlightEnv],
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **keys: Any,
    ) -> None:
        self.task: Any = make_task(environment.task_class, keys, environment.__name__)
        check_flyable(self.task, num_envs, CUDA)
        if AutoresetMode(autoreset_mode) != AutoresetMode.SAME_STEP:
            raise UserError("autoreset_mode: with device = cuda it is SameStep")
        self.num_envs, self.render_mode, self.device = num_envs, None, th.device(DEVICE)
        self.metadata = {**environment.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space = self.task.observation_space()
        self.single_action_space = self.task.action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._lanes = CudaLanes(self.task, num_envs, self.device, renews=False)
        self._fly = self._lanes.recorded_flight()
        self._begun: list[int] = []

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[th.Tensor, dict[str, Any]]:
        """New games everywhere; environment i gets `seed` + i, or the i-th of several; without one games go on.

        With `options` games that were drawn ahead are left out.
        """
        seeds = seeds_of(seed, self.num_envs)
        if not self._begun or any(each is not None for each in seeds):
            self._lanes.seed(seeds)
            self._begun = [0] * self.num_envs
            self._draw_first(options)
        elif options:
            self._begun = self._lanes.games.available.tolist()
            self._lanes.games.begun.copy_(self._lanes.games.available)
            self._draw_first(options)
        self._lanes.begin()
        self._begun = [begun + 1 for begun in self._begun]
        self._lanes.games.refill(self._begun)
        return self._lanes.observations.clone(), self._infos()

    def _draw_first(self, options: dict[str, Any] | None) -> None:
        self._lanes.games.draw_one_each([options] * self.num_envs)

    def step(self, actions: Any) -> Steps:
        """One command each."""
        if not self._begun:
            raise UserError("reset the environments before their first step")
        lanes = self._lanes
        self._fly(self._taken(actions))
        rewards, terminated, truncated = (
            each.clone() for each in (lanes.rewards, lanes.terminated, lanes.truncated)
        )
        told = lanes.ended.tolist()  # the host waits for the device here
        over = [lane for lane, row in enumerate(told) if row[AT.over]]
        ended = {
            lane: {
                "final_info": lanes.info(lane, told[lane], lanes.course_of(lane)),
                "final_obs": lanes.observations[lane].clone(),
            }
            for lane in over
        }
        if over:
            lanes.renew(lanes.going == 0)
            for lane in over:
                self._begun[lane] += 1
            lanes.games.refill(self._begun)
        infos = self._infos()
        for lane, info in ended.items():
            infos = self._add_info(infos, info, lane)
        return lanes.observations.clone(), rewards, terminated, truncated, infos

    def _infos(self) -> dict[str, Any]:
        return {"position_m": self._lanes.positions(), "commands": self._lanes.commands.clone()}

    def _taken(self, actions: Any) -> th.Tensor:
        """Actions (N, ...) on the device. Raises UserError for those that are not in the space."""
        given = th.as_tensor(actions, device=self.device)
        space = self.single_action_space
        if given.shape == (self.num_envs, *(space.shape or ())):
            if isinstance(space, spaces.Discrete):
                if not given.is_floating_point() and bool(((given >= 0) & (given < int(space.n))).all()):
                    return given.long()
            elif isinstance(space, spaces.Box):
                low, high = (th.as_tensor(end, device=self.device) for end in (space.low, space.high))
                clipped = given.to(low.dtype).clamp(low, high)
                if bool(((clipped - given).abs() <= ROUNDING).all()):  # not so for NaN
                    return clipped
        raise UserError(
            f"actions {tuple(given.shape)} of {given.dtype} are not in the action space: {self.action_space}"
        )
