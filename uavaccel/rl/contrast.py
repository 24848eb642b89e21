"""What networks see of event images: grey levels about "no events", with faint events amplified."""

from __future__ import annotations

import torch as th

from uavaccel.vision.observation import NEUTRAL_LEVEL

HALF_CONTRAST = 24.0  # grey levels from neutral that are seen at half strength


def contrast(levels: th.Tensor) -> th.Tensor:
    """Turn float grey levels, in place, into the network's input of -1 to 1, 0 for "no events"."""
    distance = levels.sub_(NEUTRAL_LEVEL)
    return distance.div_(distance.abs().add_(HALF_CONTRAST))
