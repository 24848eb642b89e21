"""Batches of environments for loops of other libraries.

A batch is a vector environment of Gymnasium, which loops like CleanRL's take as it is. `TensorLoop` gives it the form
of TorchRL's environments, in plain dictionaries of tensors, and `vec_env` that of stable-baselines3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch as th

from uavaccel.envs.arrays import assign, assign_where, mapped, select
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
        now, lost, cut = self._tensors(seen), self._tensors(terminated), self._tensors(truncated)
        over, after = lost | cut, now
        if bool(over.any()):
            after, last = mapped(th.clone, now), infos["final_obs"]
            if self.device.type == "cuda":
                assign_where(after, over, last)
            for slot in th.nonzero(over)[:, 0].tolist() if self.device.type != "cuda" else ():
                assign(after, slot, self._tensors(select(last, slot)))
        told = {"reward": self._tensors(rewards).float(), "terminated": lost, "truncated": cut, "done": over}
        flown = {**data, "next": {"observation": after, **{name: each[:, None] for name, each in told.items()}}}
        return flown, {"observation": now}

    def _tensors(self, arrays: Any) -> Any:
        return mapped(lambda part: th.as_tensor(part, device=self.device), arrays)
