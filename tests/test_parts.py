"""Parts of compiled functions compute what numba's own functions do, within others and from Python."""

import numpy as np
from numba import njit, types

from uavaccel.sim.parts import chosen_by_types, part


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


@part
def power(value: float, times: int) -> float:
    raised = 1.0
    for _ in range(times):
        raised *= value
    return raised


@part
def of_whole(value, times):  # type: ignore[no-untyped-def]
    return power(value, 2) - power(value, 3)


@chosen_by_types
def chosen(value, times):  # type: ignore[no-untyped-def]
    return of_whole if isinstance(value, types.Integer) else power


@njit
def of_constants(value):  # type: ignore[no-untyped-def]
    return chosen(value, 2), chosen(value, 4)


def test_a_part_is_compiled_for_types_and_may_be_chosen_by_them() -> None:
    """Not for each constant that it is called with."""
    assert of_constants(3.0) == (9.0, 81.0)
    assert of_constants(3) == (-18.0, -18.0)
    assert len(power.overloads) == 2  # of real numbers and of whole ones
