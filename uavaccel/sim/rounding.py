"""A product that is rounded before anything is added to it, on CPU and GPU alike.

A GPU's compiler fuses a product with a following sum, which rounds once where v2e rounds twice. With numba-cuda
`uavaccel.kernels.cuda` defines `times` for the GPU.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numba.extending import overload

Real = TypeVar("Real", float, np.float32)


def times(a: Real, b: Real) -> Real:
    """Return a * b, rounded."""
    return a * b


@overload(times)
def _on_cpu(a, b):  # type: ignore[no-untyped-def]  # numba compares its signature with the lambda's
    return lambda a, b: a * b
