"""Many environments of one task on one GPU, as PyTorch tensors: `simulator="kernels"`, `device="cuda"`.

Observations, rewards and ends stay on the device; the host samples games ahead and reads the results of those that end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch as th
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from uavaccel.envs.checks import ROUNDING, autoreset_of, make_task, seeds_of
from uavaccel.envs.cuda_lanes import AT, CudaLanes
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.flyable import CUDA, check_flyable
from uavaccel.errors import UserError

DEVICE = CUDA
Steps = tuple[th.Tensor, th.Tensor, th.Tensor, th.Tensor, dict[str, Any]]


class CudaBatch(VectorEnv[Any, Any, Any]):
    """`num_envs` environments of `environment`, a subclass of FlightEnv, with its keywords.

    `step` takes actions as a NumPy array or PyTorch tensor, and returns new tensors on the device: observations (N,
    ...), rewards (N,) float64, terminations and truncations (N,) bool. A game that ends is followed by the next one in
    the same step. Infos have `position_m` (N, 3) and `commands` (N,) as tensors, and `final_info` and `final_obs` for
    each game that ended. Raises UserError for keywords that do not fit, and for tasks that only the exact simulator
    flies.
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
        if autoreset_of(autoreset_mode) != AutoresetMode.SAME_STEP:
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
        """Begin a game in every environment; environment i gets `seed` + i, or the i-th of several seeds.

        Without a seed the environments' random sequences continue. With `options`, games sampled ahead are discarded.
        """
        seeds = seeds_of(seed, self.num_envs)
        if not self._begun or any(each is not None for each in seeds):
            self._lanes.seed(seeds)
            self._begun = [0] * self.num_envs
            self._sample_first(options)
        elif options:
            self._begun = self._lanes.games.available.tolist()
            self._lanes.games.begun.copy_(self._lanes.games.available)
            self._sample_first(options)
        self._lanes.begin()
        self._begun = [begun + 1 for begun in self._begun]
        self._lanes.games.refill(self._begun)
        return self._lanes.observations.clone(), self._infos()

    def _sample_first(self, options: dict[str, Any] | None) -> None:
        self._lanes.games.sample_games([options] * self.num_envs)

    def step(self, actions: Any) -> Steps:
        """Fly one command in every environment. Raises UserError for invalid actions, or before `reset`."""
        if not self._begun:
            raise UserError("reset the environments before their first step")
        lanes = self._lanes
        self._fly(self._to_tensor(actions))
        rewards, terminated, truncated = (each.clone() for each in (lanes.rewards, lanes.terminated, lanes.truncated))
        outcomes = lanes.ended.tolist()  # the host waits for the device here
        over = [lane for lane, row in enumerate(outcomes) if row[AT.over]]
        ended = {
            lane: {
                "final_info": lanes.info(lane, outcomes[lane], lanes.course_of(lane)),
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

    def _to_tensor(self, actions: Any) -> th.Tensor:
        """Return actions (N, ...) on the device. Raises UserError for actions outside the action space."""
        given = th.as_tensor(actions, device=self.device)
        space = self.single_action_space
        if given.shape == (self.num_envs, *(space.shape or ())):
            if isinstance(space, spaces.Discrete):
                if not given.is_floating_point() and bool(((given >= 0) & (given < int(space.n))).all()):
                    return given.long()
            elif isinstance(space, spaces.Box):
                low, high = (th.as_tensor(end, device=self.device) for end in (space.low, space.high))
                clipped = given.to(low.dtype).clamp(low, high)
                if bool(((clipped - given).abs() <= ROUNDING).all()):  # which NaN fails
                    return clipped
        raise UserError(
            f"actions {tuple(given.shape)} of {given.dtype} are not in the action space: {self.action_space}"
        )
