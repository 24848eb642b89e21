"""One picture on the CPU, row by row: which face each pixel shows, then where its texel lies, then the texel in light.

The arithmetic is that of `kernels.rays`. Loops run along rows, without branches and without looking up, so that the
compiler takes eight pixels at once; a stretch of one face is drawn in whole eights: what is too much at its end is
drawn over by the next.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Looks
from uavaccel.kernels.rays import (
    ONE,
    SHORTEST_W,
    ZERO,
    Faces,
    Float,
    Texels,
    Textures,
    level_of,
    linear,
    lit,
    luma,
    sky_index,
    texel_index,
)

ROOM = at.COLUMNS + 16  # of a row, and what a stretch at its end draws too much
HUGE = np.float32(1e30)
Floats = NDArray[np.float32]
Integers = NDArray[np.int32]


# What one thread works with, beside the faces: lines of ROOM numbers, float32 and int32.
COLUMN, CORNER, BEST, RED, GREEN, BLUE = range(6)  # 0, 1, ...; 0, 2, ...; the largest w yet; the light's colour
SHOWN, LEVEL, PLACE, TEXEL = range(4)  # face, 0 for the sky, -1 behind the row; mipmap level; the texel's place, and it


class Desk(NamedTuple):
    """What one thread works with; of its own, so that threads can share the rest."""

    faces: Faces
    roots: Floats  # (FACES, 4): columns per unit of each edge's function
    floats: Floats  # (6, ROOM)
    integers: Integers  # (4, ROOM)


@njit(error_model="numpy")
def make_desk() -> Desk:
    floats, integers = np.zeros((6, ROOM), np.float32), np.zeros((4, ROOM), np.int32)
    for column in range(ROOM):
        floats[COLUMN, column], floats[CORNER, column] = column, 2 * column
    integers[SHOWN, at.COLUMNS :] = -1
    return Desk(np.zeros((at.FACES, at.FIELDS), np.float32), np.zeros((at.FACES, 4), np.float32), floats, integers)


@njit(error_model="numpy")
def find_roots(faces: Faces, roots: Floats) -> None:
    """Columns per unit of each edge's function: by how much to move to the column at which it is 0."""
    for face in range(1, int(faces[0, at.COUNT])):
        for edge in range(4):
            slope = faces[face, at.EDGES + 3 * edge]
            roots[face, edge] = ONE / slope if abs(slope) > ONE / HUGE else HUGE


@njit(error_model="numpy", inline="always")
def narrowed(root: Float, rest: Float, low: Float, high: Float) -> tuple[Float, Float]:
    """The columns of low..high at which column / root + rest >= 0."""
    column = -rest * root
    return max(low, column if root > ZERO else -HUGE), min(high, HUGE if root > ZERO else column)


@njit(error_model="numpy")
def span(faces: Faces, roots: Floats, face: int, row: Float) -> tuple[int, int]:
    """First column at which a face may be seen in a row, and the one behind the last."""
    low, high = ZERO, np.float32(at.COLUMNS - 1)
    for edge in range(4):
        field = at.EDGES + 3 * edge
        rest = faces[face, field + 1] * row + faces[face, field + 2]
        low, high = narrowed(roots[face, edge], rest, low, high)
    extra = int(faces[face, at.EXTRA])
    if extra > 0:
        for edge in range(at.SLICES):
            rest = faces[extra, 3 * edge + 1] * row + faces[extra, 3 * edge + 2]
            low, high = narrowed(ONE / faces[extra, 3 * edge], rest, low, high)
    if faces[face, at.NEAREST_W] >= faces[0, at.NEAR_W]:
        rest = faces[0, at.NEAR_W] - (faces[face, at.W + 1] * row + faces[face, at.W + 2])
        low, high = narrowed(-ONE / faces[face, at.W], rest, low, high)
    low = min(low, np.float32(at.COLUMNS))
    begin = np.int32(low)
    begin += np.int32(low > np.float32(begin))
    return begin, np.int32(max(high, -ONE) + ONE)


@njit(error_model="numpy")
def show_faces(faces: Faces, roots: Floats, floats: Floats, integers: Integers, row: int) -> None:
    """The nearest face of each pixel of a row, 0 for the sky."""
    y = np.float32(row)
    for column in range(at.COLUMNS):
        floats[BEST, column] = faces[0, at.FAR_W]
        integers[SHOWN, column] = 0
    for face in range(1, int(faces[0, at.COUNT])):
        if faces[face, at.NEAREST_W] > ZERO and faces[face, at.TOP_ROW] <= y <= faces[face, at.BOTTOM_ROW]:
            begin, end = span(faces, roots, face, y)
            a, rest, number = faces[face, at.W], faces[face, at.W + 1] * y + faces[face, at.W + 2], np.int32(face)
            for pixel in range(np.uintp(begin), np.uintp(max(begin, end))):
                w = a * floats[COLUMN, pixel] + rest
                nearer = w > floats[BEST, pixel]
                floats[BEST, pixel] = w if nearer else floats[BEST, pixel]
                integers[SHOWN, pixel] = number if nearer else integers[SHOWN, pixel]


@njit(error_model="numpy", inline="always")
def eights(begin: int, end: int) -> int:
    """The end of a stretch, if its length is rounded up to a multiple of eight."""
    return np.uintp(begin + ((end - begin + 7) & ~7))


@njit(error_model="numpy")
def find_levels(
    textures: Textures, faces: Faces, floats: Floats, integers: Integers, face: int, row: int, begin: int, end: int
) -> None:
    """The mipmap level of each quad of a stretch, at both of its columns."""
    last = textures[int(faces[face, at.TEXTURE]), at.LAST_LEVEL]
    y = np.float32(row | 1)
    a, r = faces[face, at.W], linear(faces, face, at.W, ZERO, y)
    tu, tv, up = faces[face, at.TU], faces[face, at.TV], faces[face, at.W + 1]
    ua, va, ur, vr = faces[face, at.ACROSS] * tu, faces[face, at.DOWN] * tv, linear(faces, face, at.ACROSS, ZERO, y) * tu, linear(faces, face, at.DOWN, ZERO, y) * tv
    u_up, v_up = faces[face, at.ACROSS + 1] * tu, faces[face, at.DOWN + 1] * tv
    first = begin >> 1
    for quad in range(np.uintp(first), eights(first, (end + 1) >> 1)):
        x = floats[CORNER, quad]
        w, u, v = a * x + r, ua * x + ur, va * x + vr
        at_0 = ONE / max(w, SHORTEST_W)
        at_x = ONE / max(w + a, SHORTEST_W)
        at_y = ONE / max(w - up, SHORTEST_W)
        u_0, v_0 = u * at_0, v * at_0
        level = level_of(
            (u + ua) * at_x - u_0, (v + va) * at_x - v_0, (u - u_up) * at_y - u_0, (v - v_up) * at_y - v_0, last
        )
        integers[LEVEL, quad] = level


@njit(error_model="numpy")
def place_face(
    textures: Textures, faces: Faces, floats: Floats, integers: Integers, face: int, row: int, begin: int, end: int
) -> None:
    """Where the texels of a stretch of one face lie, and the light on it."""
    texture = int(faces[face, at.TEXTURE])
    base, wide, high = textures[texture, at.BASE], textures[texture, at.LOG2_WIDTH], textures[texture, at.LOG2_HEIGHT]
    y = np.float32(row)
    a, r = faces[face, at.W], linear(faces, face, at.W, ZERO, y)
    ea, er = faces[face, at.ACROSS], linear(faces, face, at.ACROSS, ZERO, y)
    va, vr = faces[face, at.DOWN], linear(faces, face, at.DOWN, ZERO, y)
    tu, cu, tv, cv = faces[face, at.TU], faces[face, at.TU + 1], faces[face, at.TV], faces[face, at.TV + 1]
    r0, g0, b0 = faces[face, at.COLOUR], faces[face, at.COLOUR + 1], faces[face, at.COLOUR + 2]
    r1, g1, b1 = faces[face, at.SLOPE], faces[face, at.SLOPE + 1], faces[face, at.SLOPE + 2]
    for pixel in range(np.uintp(begin), eights(begin, end)):
        x, level = floats[COLUMN, pixel], integers[LEVEL, pixel >> np.uintp(1)]
        depth = ONE / max(a * x + r, SHORTEST_W)
        along = (ea * x + er) * depth
        integers[PLACE, pixel] = texel_index(along * tu + cu, (va * x + vr) * depth * tv + cv, level, base, wide, high)
        floats[RED, pixel], floats[GREEN, pixel], floats[BLUE, pixel] = r0 + r1 * along, g0 + g1 * along, b0 + b1 * along


@njit(error_model="numpy")
def place_sky(textures: Textures, faces: Faces, floats: Floats, integers: Integers, row: int, begin: int, end: int) -> None:
    """Where the texels of a stretch of sky lie; they shine by themselves."""
    y = np.float32(row)
    xa, xr = faces[0, at.RAYS], linear(faces, 0, at.RAYS, ZERO, y)
    ya, yr = faces[0, at.RAYS + 3], linear(faces, 0, at.RAYS + 3, ZERO, y)
    za, zr = faces[0, at.RAYS + 6], linear(faces, 0, at.RAYS + 6, ZERO, y)
    base, wide = textures[0, at.BASE], textures[0, at.LOG2_WIDTH]
    for pixel in range(np.uintp(begin), eights(begin, end)):
        x = floats[COLUMN, pixel]
        integers[PLACE, pixel] = sky_index(xa * x + xr, ya * x + yr, za * x + zr, base, wide)
        floats[RED, pixel] = floats[GREEN, pixel] = floats[BLUE, pixel] = ONE


@njit(error_model="numpy")
def place_row(textures: Textures, faces: Faces, floats: Floats, integers: Integers, row: int) -> None:
    """Texel and light of each pixel of a row."""
    begin = 0
    while begin < at.COLUMNS:
        face, end = integers[SHOWN, begin], begin + 1
        while integers[SHOWN, end] == face:
            end += 1
        if face:
            find_levels(textures, faces, floats, integers, face, row, begin, end)
            place_face(textures, faces, floats, integers, face, row, begin, end)
        else:
            place_sky(textures, faces, floats, integers, row, begin, end)
        begin = end


@njit(error_model="numpy")
def gray_row(texels: Texels, floats: Floats, integers: Integers, row: int, out: Any) -> None:
    """Luma of a row whose texels are placed."""
    for column in range(at.COLUMNS):
        integers[TEXEL, column] = texels[integers[PLACE, column]]
    for column in range(at.COLUMNS):
        r, g, b = lit(integers[TEXEL, column], floats[RED, column], floats[GREEN, column], floats[BLUE, column])
        out[row, column] = luma(r, g, b)


@njit(error_model="numpy")
def gray_picture(looks: Looks, desk: Desk, out: Any, stage: int) -> None:
    texels, textures = looks.texels, looks.textures
    faces, roots, floats, integers = desk.faces, desk.roots, desk.floats, desk.integers
    find_roots(faces, roots)
    for row in range(at.ROWS):
        show_faces(faces, roots, floats, integers, row)
        if stage > 1:
            place_row(textures, faces, floats, integers, row)
        if stage > 2:
            gray_row(texels, floats, integers, row, out)
