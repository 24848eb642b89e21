"""The pixels of a quad, two by two, of which it is known what they show: luma, and what an event camera makes of it.

Scalar functions, for loops on the CPU and for CUDA threads. What a quad's pixels have in common is read and worked out
once: a face's coefficients, and its mipmap level, from the texels of three of the quad's own pixels. The arithmetic is
that of `kernels.spans` and `kernels.events`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from uavaccel.kernels import events
from uavaccel.kernels import fields as at
from uavaccel.kernels.rays import (
    I0,
    I1,
    I2,
    I4,
    I8,
    I15,
    ONE,
    SHORTEST_W,
    Faces,
    Float,
    Integer,
    Texels,
    Textures,
    level_of,
    linear,
    lit,
    luma,
    sky_colour,
    texel_index,
)
from uavaccel.vision.dvs_kernels import advanced, count_single_pixel

Four = tuple[Integer, Integer, Integer, Integer]
Draw = tuple[Float, Float]


@njit(error_model="numpy")
def on_face(faces: Faces, face: Integer, x: Float, y: Float) -> tuple[Float, Float]:
    """Metres across and down a face to a pixel."""
    depth = ONE / max(linear(faces, face, at.W, x, y), SHORTEST_W)
    return linear(faces, face, at.ACROSS, x, y) * depth, linear(faces, face, at.DOWN, x, y) * depth


@njit(error_model="numpy")
def luma_on(
    faces: Faces, face: Integer, level: Integer, texels: Texels, base: Integer, size: Integer, place: Draw
) -> Integer:
    """Luma of a pixel, from its metres across and down a face."""
    along, down = place
    u = along * faces[face, at.TU] + faces[face, at.TU + 1]
    v = down * faces[face, at.TV] + faces[face, at.TV + 1]
    texel = np.int32(texels[np.uint32(texel_index(u, v, level, base, size))])
    red, green, blue = lit(
        texel,
        faces[face, at.COLOUR] + faces[face, at.SLOPE] * along,
        faces[face, at.COLOUR + 1] + faces[face, at.SLOPE + 1] * along,
        faces[face, at.COLOUR + 2] + faces[face, at.SLOPE + 2] * along,
    )
    return luma(red, green, blue)


@njit(error_model="numpy")
def sky_luma(faces: Faces, texels: Texels, textures: Textures, row: Integer, column: Integer) -> Integer:
    """Luma of a pixel that shows the sky."""
    red, green, blue = sky_colour(faces, texels, textures, row, column)
    return luma(red, green, blue)


@njit(error_model="numpy")
def face_lumas(
    faces: Faces,
    face: Integer,
    mine: Integer,
    texels: Texels,
    textures: Textures,
    row: Integer,
    column: Integer,
    lumas: Four,
) -> Four:
    """`lumas`, with those of the pixels that show a face: bits of `mine`."""
    x, y, texture = np.float32(column), np.float32(row), np.uint32(faces[face, at.TEXTURE])
    base, size = textures[texture, at.BASE], textures[texture, at.LOG2_SIZE]
    p00, p01 = on_face(faces, face, x, y), on_face(faces, face, x + ONE, y)
    p10, p11 = on_face(faces, face, x, y + ONE), on_face(faces, face, x + ONE, y + ONE)
    tu, tv = faces[face, at.TU], faces[face, at.TV]
    level = level_of(
        (p11[0] - p10[0]) * tu, (p11[1] - p10[1]) * tv, (p00[0] - p10[0]) * tu, (p00[1] - p10[1]) * tv, size
    )
    l00, l01, l10, l11 = lumas
    if mine & I1 != 0:
        l00 = luma_on(faces, face, level, texels, base, size, p00)
    if mine & I2 != 0:
        l01 = luma_on(faces, face, level, texels, base, size, p01)
    if mine & I4 != 0:
        l10 = luma_on(faces, face, level, texels, base, size, p10)
    if mine & I8 != 0:
        l11 = luma_on(faces, face, level, texels, base, size, p11)
    return l00, l01, l10, l11


@njit(error_model="numpy")
def sky_lumas(
    faces: Faces,
    mine: Integer,
    texels: Texels,
    textures: Textures,
    row: Integer,
    column: Integer,
    lumas: Four,
) -> Four:
    """`lumas`, with those of the pixels that show the sky: bits of `mine`."""
    l00, l01, l10, l11 = lumas
    below, right = np.int32(row + I1), np.int32(column + I1)
    if mine & I1 != 0:
        l00 = sky_luma(faces, texels, textures, row, column)
    if mine & I2 != 0:
        l01 = sky_luma(faces, texels, textures, row, right)
    if mine & I4 != 0:
        l10 = sky_luma(faces, texels, textures, below, column)
    if mine & I8 != 0:
        l11 = sky_luma(faces, texels, textures, below, right)
    return l00, l01, l10, l11


@njit(error_model="numpy")
def quad_lumas(
    faces: Faces, shown: Four, texels: Texels, textures: Textures, row: Integer, column: Integer
) -> Four:
    """Luma of the pixels (row, column), (row, column + 1), and of the two below, which show these faces; both even."""
    f00, f01, f10, f11 = shown
    lumas, left = (I0, I0, I0, I0), I15
    while left != 0:  # once for most quads
        face = f00 if left & I1 != 0 else (f01 if left & I2 != 0 else (f10 if left & I4 != 0 else f11))
        mine = I1 if f00 == face else I0
        mine = np.int32(mine | (I2 if f01 == face else I0))
        mine = np.int32(mine | (I4 if f10 == face else I0))
        mine = np.int32(mine | (I8 if f11 == face else I0))
        left = np.int32(left & ~mine)
        if face == 0:
            lumas = sky_lumas(faces, mine, texels, textures, row, column, lumas)
        else:
            lumas = face_lumas(faces, face, mine, texels, textures, row, column, lumas)
    return lumas


@njit(error_model="numpy")
def quick_count(log: Float, base: Float, positive: Float, negative: Float) -> Integer:
    """`count_single_pixel` without a division where it is 0, as nearly always, and else in single precision.

    A quotient that is not whole after rounding was not rounded past a whole number, either.
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
def see_plainly(level: Integer, camera: Any, sensor: Any, base: Any, y: Any, x: Any) -> Integer:
    """`events.see_pixel` for a camera without noise: a write only where there are events."""
    before = base[y, x]
    positive = events.threshold(before, camera[events.POSITIVE], camera[events.SIGMA], sensor.up[y, x])
    negative = events.threshold(before, camera[events.NEGATIVE], camera[events.SIGMA], sensor.down[y, x])
    signed = events.due(sensor.logs[np.uint32(level)], before, positive, negative)
    if signed != 0:
        base[y, x] = advanced(before, signed, positive, negative)
    return signed
