"""Arguments as they would arrive at a server, for calls that no wire carries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uavaccel.airsim.connection import plain

_AS_THEY_ARE = (bool, int, float, str, bytes, type(None))


def as_sent(value: Any) -> Any:
    """AirSim's types as maps, NumPy's numbers as numbers, tuples as lists. Raises TypeError as packing would."""
    if type(value) in _AS_THEY_ARE:
        return value
    if isinstance(value, Mapping):
        return {key: as_sent(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [as_sent(inner) for inner in value]
    if isinstance(value, int | float | str):  # an enumeration's member, NumPy's float64
        return next(kind(value) for kind in (int, float, str) if isinstance(value, kind))
    return as_sent(plain(value))
