"""Luma and events of a quad, 2 x 2 pixels whose visible faces are known.

Scalar functions, for loops on the CPU and for CUDA threads. What the pixels share is computed once: a face's
coefficients, and its mipmap level, from the texel positions of three of the pixels. The arithmetic is that of
`kernels.pictures` and `kernels.events`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from uavaccel.kernels import events
from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Float, Integer, Operand
from uavaccel.kernels.pictures import HUGE, edge_line, line_of, whole_rows
from uavaccel.kernels.rays import (
    BYTE,
    I0,
    I1,
    I2,
    I4,
    I8,
    I15,
    I16,
    MOST_TEXELS,
    ONE,
    SHORTEST_W,
    ZERO,
    Faces,
    Texels,
    Textures,
    level_of,
    linear,
    lit,
    sky_index,
    texel_index,
)
from uavaccel.sim.camera.pixels import luma_of
from uavaccel.sim.parts import times
from uavaccel.vision.dvs_kernels import count_single_pixel
from uavaccel.vision.dvs_sensor import MIN_THRESHOLD

MOST_INTERVALS = 32  # per column; 3 on average, rarely more than 20; of more, the nearest are kept
MOST_PIECES = 48
ROWS, BYTE_BITS, FACE_BITS = (np.int32(number) for number in (at.ROWS, 8, 16))


class Column(NamedTuple):
    """Working memory of adjacent columns, arrays (n, columns): on a GPU those of a thread block."""

    rows: Operand
    """(MOST_INTERVALS, ...) int32: face << 16 | begin << 8 | end."""
    start: Operand
    """(MOST_INTERVALS, ...) float32: w at row 0."""
    slope: Operand
    """(MOST_INTERVALS, ...) float32: w per row."""
    pieces: Operand
    """(MOST_PIECES, ...) int32: visible face << 8 | end, from the top row down."""


@njit(error_model="numpy")
def within(
    faces: Faces, row: Integer, field: int, edges: int, x: Float, low: Float, high: Float
) -> tuple[Float, Float]:
    """Clip the rows [low, high] of column `x` to several edges."""
    for edge in range(edges):
        begin, begin_slope, end, end_slope = edge_line(faces, row, field + 3 * edge)
        low, high = max(low, begin + begin_slope * x), min(high, end + end_slope * x)
    return low, high


@njit(error_model="numpy")
def rows_of(faces: Faces, face: Integer, x: Float) -> tuple[Integer, Integer]:
    """Return a face's rows in a column, [begin, end)."""
    low, high = within(faces, face, at.EDGES, 4, x, -HUGE, HUGE)
    extra = np.int32(faces[face, at.EXTRA])
    if extra > 0:
        low, high = within(faces, extra, 0, at.SLICES, x, low, high)
    if faces[face, at.NEAREST_W] >= faces[0, at.NEAR_W]:
        rest = faces[0, at.NEAR_W] - faces[face, at.W + 2]
        begin, begin_slope, end, end_slope = line_of(-faces[face, at.W], -faces[face, at.W + 1], rest)
        low, high = max(low, begin + begin_slope * x), min(high, end + end_slope * x)
    return whole_rows(low, high)


@njit(error_model="numpy")
def add_interval(
    faces: Faces, face: Integer, column: Integer, scratch: Column, place: Operand, count: Integer
) -> Integer:
    """Add a face's interval to a column, if it has one, and return the column's number of intervals."""
    x = np.float32(column)
    if x < faces[face, at.FIRST_COLUMN] or x > faces[face, at.LAST_COLUMN]:
        return count
    begin, end = rows_of(faces, face, x)
    if begin >= end:
        return count
    start, slope = faces[face, at.W] * x + faces[face, at.W + 2], faces[face, at.W + 1]
    number = np.uint32(count)
    if count >= MOST_INTERVALS:
        number, farthest = least_near(scratch, place)
        if nearest_w(start, slope, begin, end) <= farthest:
            return count
        count = np.int32(count - I1)
    scratch.rows[number, place] = np.int32(
        np.int32(np.int32(np.int32(face) << FACE_BITS) | np.int32(begin << BYTE_BITS)) | end
    )
    scratch.start[number, place], scratch.slope[number, place] = start, slope
    return np.int32(count + I1)


@njit(error_model="numpy")
def nearest_w(start: Float, slope: Float, begin: Integer, end: Integer) -> Float:
    """Return the largest w of an interval."""
    return max(start + slope * np.float32(begin), start + slope * np.float32(np.int32(end - I1)))


@njit(error_model="numpy")
def least_near(scratch: Column, place: Operand) -> tuple[Any, Float]:
    """Return the farthest interval of a full column, and its largest w."""
    number, farthest = np.uint32(0), HUGE
    for other in range(np.uintp(MOST_INTERVALS)):
        rows = scratch.rows[other, place]
        begin, end = np.int32(np.int32(rows >> BYTE_BITS) & BYTE), np.int32(rows & BYTE)
        w = nearest_w(scratch.start[other, place], scratch.slope[other, place], begin, end)
        if w < farthest:
            number, farthest = np.uint32(other), w
    return number, farthest


@njit(error_model="numpy")
def overtaken(start: Float, slope: Float, begin: Integer, end: Integer, limit: Integer) -> Integer:
    """Return the first row of [begin, end) in which a linear function is positive, or `limit`."""
    last = np.int32(end - I1)
    if start + slope * np.float32(begin) > ZERO:
        return begin
    if start + slope * np.float32(last) > ZERO:
        row = np.int32(np.int32(-start / slope) + I1)
        return min(max(row, begin), last)
    return limit


@njit(error_model="numpy")
def settle(far: Float, scratch: Column, place: Operand, count: Integer) -> Integer:
    """Resolve visibility in a column: write its pieces and return their number. Face 0 is the sky."""
    row, number = I0, I0
    while row < ROWS and number < MOST_PIECES:
        y = np.float32(row)
        best, start, slope, shown, limit = far, far, ZERO, I0, ROWS
        for other in range(np.uintp(count)):
            rows = scratch.rows[other, place]
            begin, end = np.int32(np.int32(rows >> BYTE_BITS) & BYTE), np.int32(rows & BYTE)
            if begin <= row and row < end:
                w0, w1 = scratch.start[other, place], scratch.slope[other, place]
                w = w0 + w1 * y
                if w > best:
                    best, start, slope, shown, limit = w, w0, w1, np.int32(rows >> FACE_BITS), end
        for other in range(np.uintp(count)):
            rows = scratch.rows[other, place]
            begin, end = np.int32(np.int32(rows >> BYTE_BITS) & BYTE), np.int32(rows & BYTE)
            begin, end = max(begin, np.int32(row + I1)), min(end, limit)
            if begin < end and np.int32(rows >> FACE_BITS) != shown:
                w0, w1 = scratch.start[other, place] - start, scratch.slope[other, place] - slope
                limit = overtaken(w0, w1, begin, end, limit)
        scratch.pieces[np.uint32(number), place] = np.int32(np.int32(shown << BYTE_BITS) | limit)
        row, number = limit, np.int32(number + I1)
    return number


@njit(error_model="numpy")
def fill_column(scratch: Column, place: Operand, shown: Operand, column: Operand) -> None:
    """Write the visible face of each pixel of a column, 0 for the sky, to `shown` (ROWS, COLUMNS) int16."""
    number, limit, face = np.uint32(0), I0, I0
    for row in range(np.uintp(at.ROWS)):
        if np.int32(row) >= limit and number < MOST_PIECES:
            piece = scratch.pieces[number, place]
            face, limit = np.int32(piece >> BYTE_BITS), np.int32(piece & BYTE)
            number = np.uint32(number + np.uint32(1))
        shown[row, column] = face


Four = tuple[Integer, Integer, Integer, Integer]
RIGHT, BELOW = np.uintp(1), np.uintp(at.COLUMNS)  # index offsets to neighbouring pixels

Place = tuple[Float, Float]
Patch = tuple[np.uint32, Float, Float, Float, Float, np.uint32, Integer, np.uint32]
"""A mipmap level: base index; texels per metre and at the edge, across, then down; log2 size, mask, level."""
Light = tuple[Float, Float, Float, Float, Float, Float]


@njit(error_model="numpy")
def on_face(faces: Faces, face: Integer, x: Float, y: Float) -> tuple[Float, Float]:
    """Return a pixel's position on a face, metres across and down."""
    depth = ONE / max(linear(faces, face, at.W, x, y), SHORTEST_W)
    return linear(faces, face, at.ACROSS, x, y) * depth, linear(faces, face, at.DOWN, x, y) * depth


@njit(error_model="numpy")
def texel_on(patch: Patch, place: Place) -> np.uint32:
    """Return the index of a pixel's texel, as `texel_index` does."""
    u, v = place[0] * patch[1] + patch[2], place[1] * patch[3] + patch[4]
    column = np.uint32(np.int32(min(max(u, ZERO), MOST_TEXELS)) & patch[6])
    row = np.uint32(np.int32(min(max(v, ZERO), MOST_TEXELS)) & patch[6])
    column, row = (np.uint32(column >> patch[7]), np.uint32(row >> patch[7]))  # unsigned: shifts stay 32 bits wide
    return np.uint32(patch[0] + np.uint32(np.uint32(row << patch[5]) + column))


@njit(error_model="numpy")
def luma_on(texel: Integer, light: Light, along: Float) -> Integer:
    """Return the luma of a texel lit at `along` metres from a face's low edge."""
    red, green, blue = lit(texel, light[0] + light[3] * along, light[1] + light[4] * along, light[2] + light[5] * along)
    return luma_of(red, green, blue)


@njit(error_model="numpy")
def face_lumas(faces: Faces, face: Operand, texels: Texels, textures: Textures, row: Integer, column: Integer) -> Four:
    """Return the luma of a quad's pixels on a face; values of pixels that it does not cover are meaningless."""
    x, y, texture = np.float32(column), np.float32(row), np.uint32(faces[face, at.TEXTURE])
    base, size = textures[texture, at.BASE], textures[texture, at.LOG2_SIZE]
    p00, p01 = on_face(faces, face, x, y), on_face(faces, face, x + ONE, y)
    p10, p11 = on_face(faces, face, x, y + ONE), on_face(faces, face, x + ONE, y + ONE)
    tu, tv = faces[face, at.TU], faces[face, at.TV]
    level = level_of(
        (p11[0] - p10[0]) * tu, (p11[1] - p10[1]) * tv, (p00[0] - p10[0]) * tu, (p00[1] - p10[1]) * tv, size
    )
    first, width = np.uint32(texel_index(ZERO, ZERO, level, base, size)), np.uint32(size & I15)
    last, down = np.int32(np.int32(I1 << (size & I15)) - I1), np.uint32(level & I15)
    patch = (first, tu, faces[face, at.TU + 1], tv, faces[face, at.TV + 1], width, last, down)
    t00, t01 = texels[texel_on(patch, p00)], texels[texel_on(patch, p01)]
    t10, t11 = texels[texel_on(patch, p10)], texels[texel_on(patch, p11)]
    light = (
        faces[face, at.COLOUR],
        faces[face, at.COLOUR + 1],
        faces[face, at.COLOUR + 2],
        faces[face, at.SLOPE],
        faces[face, at.SLOPE + 1],
        faces[face, at.SLOPE + 2],
    )
    return (
        luma_on(np.int32(t00), light, p00[0]),
        luma_on(np.int32(t01), light, p01[0]),
        luma_on(np.int32(t10), light, p10[0]),
        luma_on(np.int32(t11), light, p11[0]),
    )


@njit(error_model="numpy")
def sky_luma(faces: Faces, x: Float, y: Float, texels: Texels, base: Integer, size: Integer) -> Integer:
    """Return the luma of a pixel's unlit texel in the sky."""
    across, along = linear(faces, I0, at.RAYS, x, y), linear(faces, I0, at.RAYS + 3, x, y)
    index = sky_index(across, along, linear(faces, I0, at.RAYS + 6, x, y), base, size)
    texel = np.int32(texels[np.uint32(index)])
    red, green = np.int32(texel & BYTE), np.int32(np.int32(texel >> I8) & BYTE)
    return luma_of(red, green, np.int32(np.int32(texel >> I16) & BYTE))


@njit(error_model="numpy")
def sky_lumas(faces: Faces, texels: Texels, textures: Textures, row: Integer, column: Integer) -> Four:
    """Return the luma of a quad's pixels in the sky."""
    x, y = np.float32(column), np.float32(row)
    base, size = textures[0, at.BASE], textures[0, at.LOG2_SIZE]
    return (
        sky_luma(faces, x, y, texels, base, size),
        sky_luma(faces, x + ONE, y, texels, base, size),
        sky_luma(faces, x, y + ONE, texels, base, size),
        sky_luma(faces, x + ONE, y + ONE, texels, base, size),
    )


@njit(error_model="numpy")
def quad_lumas(faces: Faces, shown: Four, texels: Texels, textures: Textures, row: Integer, column: Integer) -> Four:
    """Return the luma of the pixels (row, column), (row, column + 1) and of the two below; row and column are even."""
    f00, f01, f10, f11 = shown
    l00, l01, l10, l11 = I0, I0, I0, I0
    left = I15
    while left != 0:  # a single pass for most quads
        face = f00 if left & I1 != 0 else (f01 if left & I2 != 0 else (f10 if left & I4 != 0 else f11))
        if face == 0:
            n00, n01, n10, n11 = sky_lumas(faces, texels, textures, row, column)
        else:
            n00, n01, n10, n11 = face_lumas(faces, np.uintp(face), texels, textures, row, column)
        if f00 == face:
            l00, left = n00, np.int32(left & ~I1)
        if f01 == face:
            l01, left = n01, np.int32(left & ~I2)
        if f10 == face:
            l10, left = n10, np.int32(left & ~I4)
        if f11 == face:
            l11, left = n11, np.int32(left & ~I8)
    return l00, l01, l10, l11


@njit(error_model="numpy")
def quick_count(log: Float, base: Float, positive: Float, negative: Float) -> Integer:
    """Return `count_single_pixel` without dividing where it is 0, as nearly always, and else in single precision.

    A quotient that is not an integer after rounding did not cross an integer in rounding either.
    """
    change = log - base
    rises = change > np.float32(0.0)
    size, threshold = abs(change), positive if rises else negative
    if size < threshold:
        return I0
    quotient = size / threshold
    count = np.int32(quotient)
    if np.float32(count) == quotient:
        return count_single_pixel(log, base, positive, negative)
    return count if rises else np.int32(-count)


@njit(error_model="numpy")
def threshold_of(nominal: Float, sigma: Float, least: Float, normal: Float) -> Float:
    """Return `events.single_threshold` without a branch; `least` is MIN_THRESHOLD, or -HUGE if sigma is 0."""
    return max(nominal + times(sigma, normal), least)


@njit(error_model="numpy")
def update_quad(
    lumas: Four,
    before: tuple[Float, Float, Float, Float],
    camera: Operand,
    sensor: Operand,
    base: Operand,
    first: Operand,
    place: Operand,
) -> Integer:
    """Do as `events.update_pixel` for a quad of a camera without noise: return ON minus OFF events and update `base`.

    `first` is the quad's first pixel counted over all lanes, `place` within the image: indexing by lane, row and column
    multiplies by array sizes unknown to the compiler, which would cost more than everything else here.
    """
    sigma, rise, fall = np.float32(camera[events.SIGMA]), camera[events.POSITIVE], camera[events.NEGATIVE]
    rise, fall, least = np.float32(rise), np.float32(fall), MIN_THRESHOLD if sigma != ZERO else -HUGE
    up00 = threshold_of(rise, sigma, least, sensor.up[0, place])
    up01 = threshold_of(rise, sigma, least, sensor.up[0, place + RIGHT])
    up10 = threshold_of(rise, sigma, least, sensor.up[0, place + BELOW])
    up11 = threshold_of(rise, sigma, least, sensor.up[0, place + BELOW + RIGHT])
    down00 = threshold_of(fall, sigma, least, sensor.down[0, place])
    down01 = threshold_of(fall, sigma, least, sensor.down[0, place + RIGHT])
    down10 = threshold_of(fall, sigma, least, sensor.down[0, place + BELOW])
    down11 = threshold_of(fall, sigma, least, sensor.down[0, place + BELOW + RIGHT])
    log00, log01 = sensor.logs[np.uint32(lumas[0])], sensor.logs[np.uint32(lumas[1])]
    log10, log11 = sensor.logs[np.uint32(lumas[2])], sensor.logs[np.uint32(lumas[3])]
    total = update_one(log00, before[0], up00, down00, base, first)
    total = np.int32(total + update_one(log01, before[1], up01, down01, base, first + RIGHT))
    total = np.int32(total + update_one(log10, before[2], up10, down10, base, first + BELOW))
    return np.int32(total + update_one(log11, before[3], up11, down11, base, first + BELOW + RIGHT))


@njit(error_model="numpy")
def update_one(log: Float, before: Float, positive: Float, negative: Float, base: Operand, place: Operand) -> Integer:
    """Return a pixel's signed count and update its memory: `dvs_kernels.advanced` without its zero term."""
    signed = quick_count(log, before, positive, negative)
    if signed > 0:
        base[0, 0, place] = before + times(np.float32(signed), positive)
    elif signed < 0:
        base[0, 0, place] = before - times(np.float32(-signed), negative)
    return signed
