"""What kernels work on, by name: numba finds the types when it compiles them, and none is written down twice."""

from __future__ import annotations

from typing import Any, TypeAlias

Operand: TypeAlias = Any
"""An array, of NumPy on the CPU and a tensor's memory on a GPU, a tuple of those, or a number of either precision."""
Launchable: TypeAlias = Any
"""A compiled function, or a kernel that takes a grid in brackets first."""
