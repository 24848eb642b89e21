"""Arguments as they would arrive at a server, and answers at a client, for calls that no wire carries."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from uavaccel.airsim.connection import plain

_AS_THEY_ARE = (bool, int, float, str, bytes, type(None))


def as_sent(value: object) -> object:
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


def as_received(value: object) -> object:
    """Arrays of an answer, or of the maps in it, as lists of single precision: what a wire makes of them."""
    if isinstance(value, np.ndarray):
        return value.astype(np.float32).ravel().tolist()
    if isinstance(value, list):
        return [as_received(inner) for inner in value] if value and type(value[0]) is not float else value
    if isinstance(value, dict) and any(isinstance(inner, np.ndarray) for inner in value.values()):
        return {key: as_received(inner) for key, inner in value.items()}
    return value
