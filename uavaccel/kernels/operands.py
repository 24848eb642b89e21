"""Names for the arguments of compiled functions, whose types numba infers when it compiles them."""

from __future__ import annotations

from typing import Any, TypeAlias

Operand: TypeAlias = Any
"""A NumPy array or, on a GPU, a numba array on a tensor's memory; a tuple of those; or a float32 or float64."""
Launchable: TypeAlias = Any
"""A compiled function, or a CUDA kernel, which takes its launch configuration in brackets first."""
