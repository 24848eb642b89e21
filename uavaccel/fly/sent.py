"""Converts arguments and answers of in-process calls to what the wire would make of them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from uavaccel.airsim.connection import plain

_AS_THEY_ARE = (bool, int, float, str, bytes, type(None))


def as_sent(value: object) -> object:
    """An argument as a server would receive it: plain maps, lists and numbers. Raises TypeError as packing would."""
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
    """An answer as a client would receive it: arrays become lists of single precision."""
    if isinstance(value, np.ndarray):
        return value.astype(np.float32).ravel().tolist()
    if isinstance(value, list):
        return [as_received(inner) for inner in value] if value and type(value[0]) is not float else value
    if isinstance(value, dict) and any(isinstance(inner, np.ndarray) for inner in value.values()):
        return {key: as_received(inner) for key, inner in value.items()}
    return value
