"""Many environments of one task on one GPU, as PyTorch tensors: `simulator="kernels"`, `device="cuda"`.

A step is one CUDA graph: flight, images, judging, and the start of the next games. The host waits for nothing in it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from uavaccel.envs.arrays import mapped
from uavaccel.envs.batch import set_up
from uavaccel.envs.checks import ROUNDING, refuse_copy, seeds_of
from uavaccel.envs.cuda_games import SampledAhead
from uavaccel.envs.cuda_lanes import CudaLanes
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.simulators import CUDA
from uavaccel.envs.values import State
from uavaccel.errors import UserError

DEVICE = CUDA
BEHIND = 2  # steps after which the host reads what it must know of one; games sampled ahead last longer
FAR_BEHIND = 32  # the same where no games are sampled ahead, and only the check of actions is to be read
Steps = tuple[Any, th.Tensor, th.Tensor, th.Tensor, dict[str, Any]]


class CudaBatch(VectorEnv[Any, Any, Any]):
    """`num_envs` environments of `environment`, a subclass of FlightEnv, with its keywords.

    `step` takes actions as a NumPy array or PyTorch tensor, and returns new tensors on the device: observations (N,
    ...), or a mapping of those, rewards (N,) float64, terminations and truncations (N,) bool. A game that ends is
    followed by the next one in the same step. Infos have `position_m` (N, 3) and `commands` (N,); of games that ended,
    `final_obs` (N, ...) and the tensors of `final_info`, each beside its mask `_final_obs`, `_final_info` (N,) bool,
    outside of which values mean nothing. `final_info["collision"]` (N,) is an index into `object_names`, -1 without a
    collision.

    Raises UserError for keywords that do not fit, and for tasks that only the exact simulator flies.
    """

    def __init__(
        self,
        environment: type[FlightEnv],
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **keys: Any,
    ) -> None:
        self.task = task = set_up(self, environment, num_envs, autoreset_mode, keys)
        if self.metadata["autoreset_mode"] != AutoresetMode.SAME_STEP:
            raise UserError("autoreset_mode: with device = cuda it is SameStep")
        self.render_mode, self.device = None, th.device(DEVICE)
        self._lanes = CudaLanes(task, num_envs, self.device, reports=True)
        self._fly = self._lanes.recorded_flight()
        self._actions = _Actions(self.single_action_space, num_envs, self.device)
        self._unread: deque[tuple[Any, th.Tensor, th.Tensor]] = deque()
        self._behind = BEHIND if isinstance(self._lanes.games, SampledAhead) else FAR_BEHIND

    __getstate__ = refuse_copy

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of what a vehicle can collide with."""
        return self._lanes.judge.objects

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin a game in every environment; environment i gets `seed` + i, or the i-th of several seeds.

        Without a seed the environments' random sequences continue.
        """
        seeds, games = seeds_of(seed, self.num_envs), self._lanes.games
        self._forget_steps()
        if not games.has_games or any(given is not None for given in seeds):
            games.seed(seeds)
            games.sample_games([options] * self.num_envs)
        elif options:
            games.discard()
            games.sample_games([options] * self.num_envs)
        self._lanes.begin()
        games.refill(games.begun.tolist())
        return mapped(th.clone, self._lanes.observations), self._infos()

    def step(self, actions: Any) -> Steps:
        """Fly one command in every environment.

        Raises UserError for invalid actions, or before `reset`. A tensor of the device is checked without waiting for
        it: the error comes with a later step, and meanwhile its actions have been clipped.
        """
        lanes = self._lanes
        if not lanes.games.has_games:
            raise UserError("reset the environments before their first step")
        self._fly(self._actions.checked(actions))
        self._read_an_earlier_step()
        over = lanes.terminated | lanes.truncated
        infos = self._infos() | {"final_obs": mapped(th.clone, lanes.final_observations), "_final_obs": over}
        infos |= {"final_info": _with_masks(lanes.final_info, over), "_final_info": over}
        ended = lanes.rewards.clone(), lanes.terminated.clone(), lanes.truncated.clone()
        return mapped(th.clone, lanes.observations), *ended, infos

    def charge_each(self, durations_ns: NDArray[np.int64], phase: str = "inference") -> None:
        """In timing `virtual`, charge each environment (N,) for its agent's work since its last command."""
        if self._lanes.clocks is not None and self.task.timing == "virtual":
            self._lanes.clocks.charge(th.as_tensor(durations_ns, device=self.device), phase)

    def _read_an_earlier_step(self) -> None:
        """Let games be sampled where they have begun, and check the actions, of the step some steps ago."""
        games = self._lanes.games
        read = th.cuda.Event()  # type: ignore[no-untyped-call]
        parts = (part.to("cpu", non_blocking=True, copy=True) for part in (games.begun, self._actions.wrong))
        self._unread.append((read, *parts))  # type: ignore[arg-type]
        self._actions.wrong.zero_()  # so that each copy is of one step
        read.record()
        if len(self._unread) > self._behind:
            read, begun, wrong = self._unread.popleft()
            read.synchronize()
            games.refill(begun.tolist())
            if wrong:
                raise UserError(f"actions of an earlier step were not in the action space: {self.action_space}")

    def _forget_steps(self) -> None:
        self._unread.clear()
        self._actions.wrong.zero_()

    def get_states(self) -> list[State]:
        """Return each environment's running game for np.savez: another batch of this task continues them."""
        return self._lanes.get_states()

    def set_states(self, states: Sequence[Mapping[str, Any]]) -> Any:
        """Restore states that `get_states` returned, and return the environments' observations as arrays."""
        self._forget_steps()
        return self._lanes.set_states(states)

    def _infos(self) -> dict[str, Any]:
        games = self._lanes.running
        return {"position_m": games.position_m.clone(), "commands": games.commands.clone()}


class _Actions:
    """Checks of the actions of `count` environments; `wrong` () bool says whether any on the device were invalid.

    `waits` says whether a check of tensors of the device waits for what comes of it.
    """

    def __init__(self, space: Any, count: int, device: th.device) -> None:
        self._space, self._device, self._shape = space, device, (count, *(space.shape or ()))
        self.wrong, self.waits = th.zeros((), dtype=th.bool, device=device), device.type == "cpu"
        box = isinstance(space, spaces.Box)
        self._low: Any
        self._high: Any
        self._low, self._high = (
            (th.as_tensor(end, device=device) for end in (space.low, space.high)) if box else (0, int(space.n) - 1)
        )

    def checked(self, actions: Any) -> th.Tensor:
        """Return actions (N, ...) on the device, clipped to the space. Raises UserError for the host's outside it."""
        on_device = isinstance(actions, th.Tensor) and actions.device.type == self._device.type and not self.waits
        given = th.as_tensor(actions, device=self._device)
        box = isinstance(self._space, spaces.Box)
        if given.shape != self._shape or (given.is_floating_point() and not box):
            raise self._outside(given)
        numbers = given.to(self._low.dtype) if box else given.long()
        clipped = numbers.clamp(self._low, self._high)
        wrong = ~((clipped - numbers).abs() <= (ROUNDING if box else 0)).all()  # NaN is wrong, too
        if on_device:
            self.wrong.copy_(wrong)
        elif wrong:
            raise self._outside(given)
        return clipped.nan_to_num() if box else clipped

    def _outside(self, given: th.Tensor) -> UserError:
        return UserError(f"actions {tuple(given.shape)} of {given.dtype} are not in the action space: {self._space}")


def _with_masks(info: dict[str, Any], over: th.Tensor) -> dict[str, Any]:
    """Return new tensors of an info, each with the mask `over` beside it, as Gymnasium's vectors have it."""
    found: dict[str, Any] = {}
    for name, value in info.items():
        found[name] = _with_masks(value, over) if isinstance(value, dict) else value.clone()
        found[f"_{name}"] = over
    return found
