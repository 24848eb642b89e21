"""NumPy's default generator as arithmetic on a row of numbers: SeedSequence and PCG64, for loops and for CUDA kernels.

A stream is a row of six uint64. It yields the same numbers as `numpy.random.default_rng` in the same state (O'Neill,
PCG, 2014; NumPy's numpy/random), so that a game is the same whether the host samples it or a GPU.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.parts import part

STATE_HIGH, STATE_LOW, STEP_HIGH, STEP_LOW, HAS_HALF, HALF = range(6)  # HALF: the unused half of the last 64 bits
STREAM_FIELDS = 6

Word = Any  # np.uint64: with a signed integer numba would compute in float64
Stream = NDArray[np.uint64]

MASK, ONE, ZERO = np.uint64(0xFFFFFFFF), np.uint64(1), np.uint64(0)
B11, B16, B32, B58, B63, B64 = (np.uint64(bits) for bits in (11, 16, 32, 58, 63, 64))
FACTOR_HIGH, FACTOR_LOW = np.uint64(0x2360ED051FC65DA4), np.uint64(0x4385DF649FCCF645)
TO_UNIT = 2.0**-53


def _constants(first: int, factor: int, count: int) -> list[np.uint64]:
    """Return the constants of SeedSequence's hash, each the one before times a factor."""
    return [np.uint64(first * pow(factor, power, 2**32) % 2**32) for power in range(count)]


A0, A1, A2, A3, A4, A5, A6, A7, A8, A9, A10, A11, A12, A13, A14, A15, A16, A17, A18, A19 = _constants(
    0x43B0D7E5, 0x931E8875, 20
)
C0, C1, C2, C3, C4, C5, C6, C7 = _constants(0x8B51F9DD, 0x58F38DED, 8)
A_FACTOR, C_FACTOR = np.uint64(0x931E8875), np.uint64(0x58F38DED)
LEFT, RIGHT = np.uint64(0xCA01F9DD), np.uint64(0x4973F715)

Pool = tuple[Word, Word, Word, Word]
Pair = tuple[Word, Word]


# --- SeedSequence -----------------------------------------------------------------------------------------------------


@part
def hashed(value: Word, constant: Word, factor: Word) -> Word:
    """Return a word after SeedSequence's hash."""
    value = ((value ^ constant) * ((constant * factor) & MASK)) & MASK
    return value ^ (value >> B16)


@part
def mixed(x: Word, y: Word, constant: Word) -> Word:
    """Return word x of the pool after mixing in word y."""
    value = (LEFT * x - RIGHT * hashed(y, constant, A_FACTOR)) & MASK
    return value ^ (value >> B16)


@part
def pool_of(entropy: Word) -> Pool:
    """Return the pool of SeedSequence(entropy), below 2**64."""
    a, b = hashed(entropy & MASK, A0, A_FACTOR), hashed(entropy >> B32, A1, A_FACTOR)
    c, d = hashed(ZERO, A2, A_FACTOR), hashed(ZERO, A3, A_FACTOR)
    b, c, d = mixed(b, a, A4), mixed(c, a, A5), mixed(d, a, A6)
    a, c, d = mixed(a, b, A7), mixed(c, b, A8), mixed(d, b, A9)
    a, b, d = mixed(a, c, A10), mixed(b, c, A11), mixed(d, c, A12)
    return mixed(a, d, A13), mixed(b, d, A14), mixed(c, d, A15), d


@part
def spawned(pool: Pool, key: Word) -> Pool:
    """Return the pool of SeedSequence(entropy, spawn_key=(key,)) from that of the entropy."""
    a, b, c, d = pool
    return mixed(a, key, A16), mixed(b, key, A17), mixed(c, key, A18), mixed(d, key, A19)


@part
def first_word(pool: Pool) -> Word:
    """Return generate_state(1, uint32)."""
    return hashed(pool[0], C0, C_FACTOR)


@part
def start(stream: Stream, pool: Pool) -> None:
    """Start a stream as PCG64(SeedSequence)."""
    a, b, c, d = pool
    high = hashed(a, C0, C_FACTOR) | (hashed(b, C1, C_FACTOR) << B32)
    low = hashed(c, C2, C_FACTOR) | (hashed(d, C3, C_FACTOR) << B32)
    step_high = hashed(a, C4, C_FACTOR) | (hashed(b, C5, C_FACTOR) << B32)
    step_low = hashed(c, C6, C_FACTOR) | (hashed(d, C7, C_FACTOR) << B32)
    stream[STEP_HIGH], stream[STEP_LOW] = (step_high << ONE) | (step_low >> B63), (step_low << ONE) | ONE
    stream[STATE_LOW] = stream[STEP_LOW] + low
    carry = ONE if stream[STATE_LOW] < low else ZERO
    stream[STATE_HIGH] = stream[STEP_HIGH] + high + carry
    step(stream)
    stream[HAS_HALF], stream[HALF] = ZERO, ZERO


# --- PCG64 ------------------------------------------------------------------------------------------------------------


@part
def product_high(a: Word, b: Word) -> Word:
    """Return the upper 64 bits of a product."""
    a0, a1, b0, b1 = a & MASK, a >> B32, b & MASK, b >> B32
    middle = a1 * b0 + ((a0 * b0) >> B32)
    other = a0 * b1 + (middle & MASK)
    return a1 * b1 + (middle >> B32) + (other >> B32)


@part
def step(stream: Stream) -> None:
    """Advance the state by one."""
    high, low = stream[STATE_HIGH], stream[STATE_LOW]
    upper = product_high(low, FACTOR_LOW) + low * FACTOR_HIGH + high * FACTOR_LOW
    lower = low * FACTOR_LOW + stream[STEP_LOW]
    carry = ONE if lower < stream[STEP_LOW] else ZERO
    stream[STATE_HIGH], stream[STATE_LOW] = upper + stream[STEP_HIGH] + carry, lower


@part
def product(a: Pair, b: Pair) -> Pair:
    """Return the lower 128 bits of a product, as upper and lower 64."""
    return product_high(a[1], b[1]) + a[1] * b[0] + a[0] * b[1], a[1] * b[1]


@part
def total(a: Pair, b: Pair) -> Pair:
    """Return the lower 128 bits of a sum."""
    low = a[1] + b[1]
    return a[0] + b[0] + (ONE if low < b[1] else ZERO), low


@part
def advance(stream: Stream, steps: int) -> None:
    """Advance the state by so many steps at once (Brown, Random number generation with arbitrary strides, 1994)."""
    factor, plus, left = (FACTOR_HIGH, FACTOR_LOW), (stream[STEP_HIGH], stream[STEP_LOW]), steps
    state = stream[STATE_HIGH], stream[STATE_LOW]
    while left > 0:
        if left % 2 == 1:
            state = total(product(state, factor), plus)
        plus = product(total(factor, (ZERO, ONE)), plus)
        factor, left = product(factor, factor), left // 2
    stream[STATE_HIGH], stream[STATE_LOW] = state


@part
def word(stream: Stream) -> Word:
    """Return the next 64 random bits."""
    step(stream)
    value, turn = stream[STATE_HIGH] ^ stream[STATE_LOW], stream[STATE_HIGH] >> B58
    return (value >> turn) | (value << ((B64 - turn) & B63))


@part
def half_word(stream: Stream) -> Word:
    """Return the next 32 random bits."""
    if stream[HAS_HALF] != ZERO:
        stream[HAS_HALF] = ZERO
        return stream[HALF]
    value = word(stream)
    stream[HAS_HALF], stream[HALF] = ONE, value >> B32
    return value & MASK


@part
def unit(stream: Stream) -> float:
    """Return Generator.random()."""
    return np.float64(word(stream) >> B11) * TO_UNIT


@part
def below(stream: Stream, limit: Word) -> Word:
    """Return Generator.integers(limit), by Lemire's method; `limit` is from 1 to 2**32 - 1."""
    if limit == ONE:
        return ZERO
    scaled = half_word(stream) * limit
    if (scaled & MASK) < limit:
        threshold = (MASK - (limit - ONE)) % limit
        while (scaled & MASK) < threshold:
            scaled = half_word(stream) * limit
    return scaled >> B32


def stream_of(generator: np.random.Generator) -> NDArray[np.uint64]:
    """Return the stream (6,) of a generator of type PCG64 in its present state."""
    found = generator.bit_generator.state
    state, increment, low = found["state"]["state"], found["state"]["inc"], 2**64 - 1
    numbers = state >> 64, state & low, increment >> 64, increment & low, found["has_uint32"], found["uinteger"]
    return np.array(numbers, np.uint64)
