"""Luma and events of a quad, 2 x 2 pixels whose visible faces are known.

Scalar functions, for loops on the CPU and for CUDA threads. What the pixels share is computed once: a face's
coefficients, and its mipmap level, from the texel positions of three of the pixels. The arithmetic is that of
`kernels.spans` and `kernels.events`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from uavaccel.kernels import events
from uavaccel.kernels import fields as at
from uavaccel.kernels.operands import Operand
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
    Float,
    Integer,
    Texels,
    Textures,
    level_of,
    linear,
    lit,
    sky_index,
    texel_index,
)
from uavaccel.kernels.spans import HUGE
from uavaccel.sim.camera.pixels import luma_of
from uavaccel.sim.parts import times
from uavaccel.vision.dvs_kernels import count_single_pixel
from uavaccel.vision.dvs_sensor import MIN_THRESHOLD

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
def sky_texel(faces: Faces, x: Float, y: Float, base: Integer, size: Integer) -> Integer:
    """Return the index of a pixel's texel in the sky."""
    return sky_index(
        linear(faces, I0, at.RAYS, x, y),
        linear(faces, I0, at.RAYS + 3, x, y),
        linear(faces, I0, at.RAYS + 6, x, y),
        base,
        size,
    )


@njit(error_model="numpy")
def plain_luma(texel: Integer) -> Integer:
    """Return the luma of an unlit texel."""
    red, green = np.int32(texel & BYTE), np.int32(np.int32(texel >> I8) & BYTE)
    return luma_of(red, green, np.int32(np.int32(texel >> I16) & BYTE))


@njit(error_model="numpy")
def sky_lumas(faces: Faces, texels: Texels, textures: Textures, row: Integer, column: Integer) -> Four:
    """Return the luma of a quad's pixels in the sky."""
    x, y = np.float32(column), np.float32(row)
    base, size = textures[0, at.BASE], textures[0, at.LOG2_SIZE]
    t00 = texels[np.uint32(sky_texel(faces, x, y, base, size))]
    t01 = texels[np.uint32(sky_texel(faces, x + ONE, y, base, size))]
    t10 = texels[np.uint32(sky_texel(faces, x, y + ONE, base, size))]
    t11 = texels[np.uint32(sky_texel(faces, x + ONE, y + ONE, base, size))]
    return (plain_luma(np.int32(t00)), plain_luma(np.int32(t01)), plain_luma(np.int32(t10)), plain_luma(np.int32(t11)))


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
