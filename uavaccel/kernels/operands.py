"""Names for the arguments of compiled functions, whose types numba infers when it compiles them; vectors of three."""

from __future__ import annotations

from typing import Any, TypeAlias

from uavaccel.sim.parts import part

Operand: TypeAlias = Any
"""A NumPy array or, on a GPU, a numba array on a tensor's memory; a tuple of those; or a float32 or float64."""
Launchable: TypeAlias = Any
"""A compiled function, or a CUDA kernel, which takes its launch configuration in brackets first."""
Float: TypeAlias = Any
"""A float32 or float64."""
Vector: TypeAlias = tuple[Float, Float, Float]


@part(error_model="numpy")
def dot(a: Vector, b: Vector) -> Float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part(error_model="numpy")
def plus(a: Vector, b: Vector, times: Float) -> Vector:
    """Return a + b * times."""
    return a[0] + b[0] * times, a[1] + b[1] * times, a[2] + b[2] * times


@part(error_model="numpy")
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
