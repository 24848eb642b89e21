"""Loss and mean Q of the gradient steps, summed on the learner's device and read only where games end."""

from __future__ import annotations

import math
from typing import Any

import torch as th

from uavaccel.files import Plain


class StepStatistics:
    """Means over the gradient steps between two reads: `loss`, and `mean_q`, the online network's value of the
    actions in the batches. None before the first step, and where a mean is not finite.
    """

    def __init__(self, device: th.device) -> None:
        self.sums = th.zeros(3, dtype=th.float64, device=device)  # of losses, of mean Qs, of steps
        self._read = [0.0, 0.0, 0.0]  # what the sums were at the last read
        self.loss: float | None = None
        self.mean_q: float | None = None

    def add(self, loss: th.Tensor, chosen_q: th.Tensor) -> None:
        """Add a gradient step by its loss and the Qs (n,) of its batch's actions, without waiting for the device."""
        loss_sum, q_sum, steps = self.sums
        loss_sum.add_(loss.detach())
        q_sum.add_(chosen_q.detach().mean())
        steps.add_(1.0)

    def read(self, sums: th.Tensor) -> None:
        """Take the means of the steps since the last read from `sums`, by now perhaps copied to the host."""
        now: list[float] = sums.tolist()
        loss, q, steps = (after - before for after, before in zip(now, self._read, strict=True))
        if steps:
            self.loss, self.mean_q = (total / steps if math.isfinite(total) else None for total in (loss, q))
            self._read = now

    def get_state(self) -> dict[str, Plain]:
        """Return sums and means as plain values for JSON."""
        return {"sums": self.sums.tolist(), "read": self._read, "loss": self.loss, "mean_q": self.mean_q}

    def set_state(self, state: dict[str, Any] | None) -> None:
        """Restore what `get_state` returned; checkpoints of earlier versions have none."""
        if state is not None:
            self.sums.copy_(th.tensor(state["sums"], dtype=th.float64))
            self._read, self.loss, self.mean_q = state["read"], state["loss"], state["mean_q"]
