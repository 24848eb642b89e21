"""Parts of compiled functions compute what numba's own functions do, within others and from Python."""

import numpy as np
from numba import njit

from uavaccel.sim.parts import part


@part
def third(value: float) -> float:
    return value / 3.0


@part(inline=False, error_model="numpy")
def summed(values: np.ndarray) -> float:
    total = 0.0
    for value in values:
        total += third(value)
    return total


@part
def twice(function, values):  # type: ignore[no-untyped-def]
    """A part may be another's argument."""
    return function(values) + summed(values[::2])


@njit
def of_parts(values: np.ndarray) -> float:
    return twice(summed, values) + third(values[0])


def test_parts_are_linked_into_the_function_that_calls_them() -> None:
    values = np.random.default_rng(0).normal(size=9)

    def added(numbers: np.ndarray) -> float:
        total = 0.0
        for number in numbers:
            total += number / 3.0
        return total

    assert of_parts(values) == (added(values) + added(values[::2])) + values[0] / 3.0
    assert summed(values) == added(values)
