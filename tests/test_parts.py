"""Parts of compiled functions compute what numba's own functions do, within others and from Python."""

from functools import cache
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit, types

from uavaccel.sim import pcg64
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
    specialised: Any = power
    assert len(specialised.overloads) == 2  # of real numbers and of whole ones


# --- numbers that parts draw ------------------------------------------------------------------------------------------


@cache
def in_python() -> Any:
    """The parts of pcg64 as Python runs them, each calling the others."""
    names = dict(vars(pcg64))
    for name, value in vars(pcg64).items():
        if code := getattr(getattr(value, "py_func", None), "__code__", None):
            names[name] = FunctionType(code, names)
    return SimpleNamespace(**names)


@given(st.integers(0, 2**64 - 1), st.integers(0, 2**32 - 1), st.integers(0, 2**70), st.integers(1, 2**32 - 1))
def test_a_stream_is_numpys_generator(entropy: int, key: int, far: int, limit: int) -> None:
    """From any seed, from a seed's child, and from a state that is many steps further on."""
    part, numbers = in_python(), np.zeros(pcg64.STREAM_FIELDS, np.uint64)
    with np.errstate(over="ignore"):
        pool = part.pool_of(np.uint64(entropy))
        for at, keys in ((pool, ()), (part.spawned(pool, np.uint64(key)), (key,))):
            seeds = np.random.SeedSequence(entropy, spawn_key=keys)
            assert part.first_word(at) == seeds.generate_state(1)[0]
            part.start(numbers, at)
            bits: Any = np.random.PCG64(seeds)
            own = np.random.Generator(bits)
            for _ in range(2):
                assert np.array_equal(numbers, pcg64.stream_of(own))
                assert part.unit(numbers) == own.random()
                for most in map(np.uint64, (limit, 1 << 31)):  # below a power of two nothing is drawn again
                    assert [part.below(numbers, most) for _ in range(3)] == own.integers(int(most), size=3).tolist()
                assert part.word(numbers) == bits.random_raw()
                part.advance(numbers, far)
                bits.advance(far)
                numbers[pcg64.HAS_HALF :] = 0  # of which NumPy knows nothing after that
