"""Batches of environments for loops of other libraries.

A batch is a vector environment of Gymnasium, which loops like CleanRL's take as it is. `TensorLoop` gives it the form
of TorchRL's environments, in plain dictionaries of tensors, and `vec_env` that of stable-baselines3.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch as th

from uavaccel.envs.batch import TurnBatch
from uavaccel.resources import require

Tensors = dict[str, Any]


def vec_env(batch: TurnBatch) -> Any:
    """Return a batch of the host, with autoreset SAME_STEP, as stable-baselines3's VecEnv.

    Raises UserError without stable-baselines3.
    """
    require("stable_baselines3", "vec_env", "sb3", "stable-baselines3")
    from uavaccel.rl.baseline import BatchVecEnv

    return BatchVecEnv(batch)


class TensorLoop:
    """A batch with autoreset SAME_STEP whose data are dictionaries of tensors (n, ...), as TorchRL's TensorDicts.

    Keys are `observation` and `action`, and below `next` those after a command: `observation`, `reward`, `terminated`,
    `truncated` and `done`, all but the first (n, 1).
    """

    def __init__(self, batch: Any) -> None:
        self.batch, self.device = batch, th.device(getattr(batch, "device", "cpu"))

    def reset(self, seed: int | None = None) -> Tensors:
        """Begin a game in every environment."""
        return {"observation": self._tensors(self.batch.reset(seed=seed)[0])}

    def step_and_maybe_reset(self, data: Tensors) -> tuple[Tensors, Tensors]:
        """Fly `action`; returns the data with `next`, where ended games show their last observation, and new data."""
        action = data["action"]
        seen, rewards, terminated, truncated, infos = self.batch.step(
            action if self.device.type == "cuda" else np.asarray(action)
        )
        now = self._tensors(seen)
        lost, cut = (th.as_tensor(each, device=self.device) for each in (terminated, truncated))
        over = lost | cut
        after = self._with_last(now, infos, over) if bool(over.any()) else now
        reward = th.as_tensor(rewards, device=self.device).float()
        told = {"reward": reward, "terminated": lost, "truncated": cut, "done": over}
        flown = {**data, "next": {"observation": after, **{name: each[:, None] for name, each in told.items()}}}
        return flown, {"observation": now}

    def _tensors(self, observations: Any) -> Any:
        if isinstance(observations, Mapping):
            return {name: self._tensors(part) for name, part in observations.items()}
        return th.as_tensor(observations, device=self.device)

    def _with_last(self, now: Any, infos: Any, over: th.Tensor) -> Any:
        """Return the observations, those of ended games replaced by their last."""
        last = infos["final_obs"]
        if isinstance(now, Mapping):
            parts = {name: [each and each[name] for each in last] for name in now}
            return {name: self._replaced(part, parts[name], over) for name, part in now.items()}
        return self._replaced(now, last, over)

    def _replaced(self, now: th.Tensor, last: Any, over: th.Tensor) -> th.Tensor:
        if isinstance(last, th.Tensor):
            return th.where(over.view(-1, *(1,) * (now.ndim - 1)), last, now)
        after = now.clone()
        for slot in th.nonzero(over)[:, 0].tolist():
            after[slot] = th.as_tensor(last[slot])
        return after
