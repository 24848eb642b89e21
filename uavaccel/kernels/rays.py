"""Visibility and shading of a pixel: scalar functions, for loops on the CPU and for CUDA kernels.

A face is a planar piece of a surface, projected by `kernels.faces`. Every quantity on it is a quotient of functions
that are linear in column and row: w, the inverse depth, and the distances from its edges times w. A pixel shows the
face with the largest w among those that have it inside all their edges. All arithmetic is float32.

Textures are sampled as OpenGL does with NEAREST_MIPMAP_NEAREST. The 2 x 2 pixels of a quad share a mipmap level, chosen
by the distance between their texels; OpenGL counts rows from below, so a quad's reference pixel is its lower left one.
Lighting is per vertex, colours are rounded to 8 bits, luma is OpenCV's.

The functions take and return scalars or tuples, allocate nothing and raise nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Float, Integer, Vector
from uavaccel.sim.parts import part

Faces = NDArray[np.float32]  # (FACES, FIELDS): of one image; row 0 has its rays
Textures = NDArray[np.int32]  # (n, 2)
Texels = NDArray[np.uint32]  # (T,)
Colour = tuple[Integer, Integer, Integer]

ZERO, ONE, HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
SHORTEST_W = np.float32(1e-9)  # keeps depth finite where a quad's pixels beyond an edge are above the horizon
MOST_TEXELS = np.float32(8e6)  # float32 has all integers up to here
# Squared distances between texels from which on a mipmap level is nearer than the one before.
LEVEL_1, LEVEL_2, LEVEL_3, LEVEL_4, LEVEL_5, LEVEL_6, LEVEL_7 = (np.float32(2.0 ** (2 * n + 1)) for n in range(7))
I0, I1, I2, I3, I4, I5, I8, I15, I16, BYTE = (np.int32(n) for n in (0, 1, 2, 3, 4, 5, 8, 15, 16, 255))


@part(error_model="numpy")
def dot(a: Vector, b: Vector) -> Float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part(error_model="numpy")
def plus(a: Vector, b: Vector, times: Float) -> Vector:
    """Return a + b * times."""
    return a[0] + b[0] * times, a[1] + b[1] * times, a[2] + b[2] * times


@part(error_model="numpy")
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@part(error_model="numpy")
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@part(error_model="numpy")
def linear(faces: Faces, face: Integer, field: int, column: Float, row: Float) -> Float:
    """Evaluate the linear function whose coefficients start at `field`: per column, per row, constant."""
    return faces[face, field] * column + (faces[face, field + 1] * row + faces[face, field + 2])


@part(error_model="numpy")
def touches(faces: Faces, face: Integer, row0: Float, row1: Float, column0: Float, column1: Float) -> bool:
    """Return whether a face may be visible in a rectangle of pixels, ends included; never wrongly False."""
    if faces[face, at.NEAREST_W] <= ZERO:
        return False
    seen = True
    for field in range(at.W, at.W + 15, 3):
        a, b, c = faces[face, field], faces[face, field + 1], faces[face, field + 2]
        most = max(a * column0, a * column1) + max(b * row0, b * row1) + c
        seen = seen and most >= -np.float32(1e-6)
    return seen


@part(error_model="numpy")
def texels_at(faces: Faces, face: Integer, column: Float, row: Float) -> tuple[Float, Float]:
    """Return a pixel's texture coordinates in texels of level 0, rightwards and upwards from the texture's corner."""
    w = max(linear(faces, face, at.W, column, row), SHORTEST_W)
    u = linear(faces, face, at.EDGES, column, row) / w * faces[face, at.TU] + faces[face, at.TU + 1]
    v = linear(faces, face, at.EDGES + 9, column, row) / w * faces[face, at.TV] + faces[face, at.TV + 1]
    return u, v


@part(error_model="numpy")
def level_of(du_x: Float, dv_x: Float, du_y: Float, dv_y: Float, last: Integer) -> Integer:
    """Return the mipmap level nearest to log2 of the longer step, in texels, from a quad's reference pixel."""
    step = max(du_x * du_x + dv_x * dv_x, du_y * du_y + dv_y * dv_y)
    level = np.int32(step >= LEVEL_1)
    for limit in (LEVEL_2, LEVEL_3, LEVEL_4, LEVEL_5, LEVEL_6, LEVEL_7):
        level = np.int32(level + np.int32(step >= limit))
    return np.int32(level if level < last else last)


@part(error_model="numpy")
def texel_index(u: Float, v: Float, level: Integer, base: Integer, log2_size: Integer) -> Integer:
    """Return the index of a texel; mipmap levels are stacked vertically, each padded to the width of the first."""
    size, down = log2_size & I15, level & I15  # masked, so that the compiler keeps shifts in 32 bits
    last = np.int32(np.int32(I1 << size) - I1)
    column = np.int32(np.int32(np.int32(min(max(u, ZERO), MOST_TEXELS)) & last) >> down)
    row = np.int32(np.int32(np.int32(min(max(v, ZERO), MOST_TEXELS)) & last) >> down)
    two = np.int32(I2 << size)
    row = np.int32(np.int32(two - np.int32(two >> down)) + row)
    return np.int32(np.int32(base + np.int32(row << size)) + column)


@part(error_model="numpy")
def lit(texel: Integer, red: Float, green: Float, blue: Float) -> Colour:
    """Return a texel times a light's colour (0 to 1), as 8-bit channels."""
    return (
        np.int32(np.float32(np.int32(texel & BYTE)) * red + HALF),
        np.int32(np.float32(np.int32(np.int32(texel >> I8) & BYTE)) * green + HALF),
        np.int32(np.float32(np.int32(np.int32(texel >> I16) & BYTE)) * blue + HALF),
    )


@part(error_model="numpy")
def sky_index(x: Float, y: Float, z: Float, base: Integer, log2_size: Integer) -> Integer:
    """Return the index of a cube map's texel in a direction, in MuJoCo's axes and with its orientation of the cube."""
    s, t, r = x, z, -y
    a_s, a_t, a_r = abs(s), abs(t), abs(r)
    by_s = a_s >= a_t and a_s >= a_r
    by_t = not by_s and a_t >= a_r
    across = (-r if s > ZERO else r) if by_s else (s if by_t or r > ZERO else -s)
    down = (r if t > ZERO else -r) if by_t else -t
    face = (I0 if s > ZERO else I1) if by_s else ((I2 if t > ZERO else I3) if by_t else (I4 if r > ZERO else I5))
    size = log2_size & I15
    last = np.int32(np.int32(I1 << size) - I1)
    middle = HALF * np.float32(np.int32(I1 << size))
    scale = middle / max(max(a_s, max(a_t, a_r)), SHORTEST_W)
    column = min(np.int32(max(across * scale + middle, ZERO)), last)
    row = min(np.int32(max(down * scale + middle, ZERO)), last)
    row = np.int32(np.int32(face << size) + row)
    return np.int32(np.int32(base + np.int32(row << size)) + column)


@part(error_model="numpy")
def colour_of(faces: Faces, face: Integer, texels: Texels, textures: Textures, row: int, column: int) -> Colour:
    """Return red, green and blue (0 to 255) of a pixel that shows `face`, or the sky if that is 0."""
    x, y = np.float32(column), np.float32(row)
    if face == 0:
        ray_x, ray_y = linear(faces, 0, at.RAYS, x, y), linear(faces, 0, at.RAYS + 3, x, y)
        ray_z = linear(faces, 0, at.RAYS + 6, x, y)
        index = sky_index(ray_x, ray_y, ray_z, textures[0, at.BASE], textures[0, at.LOG2_SIZE])
        return lit(np.int32(texels[np.uint32(index)]), ONE, ONE, ONE)
    texture = int(faces[face, at.TEXTURE])
    base, size = textures[texture, at.BASE], textures[texture, at.LOG2_SIZE]
    left, lower = np.float32(column & ~1), np.float32(row | 1)  # the quad's reference pixel
    u0, v0 = texels_at(faces, face, left, lower)
    u_x, v_x = texels_at(faces, face, left + ONE, lower)
    u_y, v_y = texels_at(faces, face, left, lower - ONE)
    level = level_of(u_x - u0, v_x - v0, u_y - u0, v_y - v0, size)
    u, v = texels_at(faces, face, x, y)
    index = texel_index(u, v, level, base, size)
    along = linear(faces, face, at.ACROSS, x, y) / max(linear(faces, face, at.W, x, y), SHORTEST_W)
    return lit(
        np.int32(texels[np.uint32(index)]),
        faces[face, at.COLOUR] + faces[face, at.SLOPE] * along,
        faces[face, at.COLOUR + 1] + faces[face, at.SLOPE + 1] * along,
        faces[face, at.COLOUR + 2] + faces[face, at.SLOPE + 2] * along,
    )
