"""Images of lanes, rendered on the CPU column by column: those that `sim.camera.Camera` renders with OpenGL.

A depth buffer has one column; obstacles are tall, so runs of one face are longer in columns than in rows. The
arithmetic is that of `kernels.rays`. Inner loops have no branches and no table lookups, and run over multiples of eight
pixels, so that the compiler vectorises them; texels are fetched in a separate loop.

The functions hold no GIL and share no memory, so threads may call them concurrently. Poses are those of
`sim.vehicle.quadrotor.FLIGHT_DTYPE`: positions NED in metres (D, 3), and quaternions wxyz, FRD to NED, (D, 4), both
float64. `lanes` (D,) int32 has the row of `Scenes` that each drone is in. Row 0 of an image is its top.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from uavaccel.kernels import fields as at
from uavaccel.kernels.faces import project
from uavaccel.kernels.fields import Appearance, Float, Integer, Launchable, Operand, Scenes
from uavaccel.kernels.rays import (
    I0,
    I1,
    ONE,
    SHORTEST_W,
    ZERO,
    Faces,
    Texels,
    Textures,
    level_of,
    lit,
    sky_index,
    texel_index,
)
from uavaccel.sim.camera.pixels import luma_of
from uavaccel.sim.parts import chosen_by_types, part
from uavaccel.sim.vehicle.hotloop import sources

HUGE = np.float32(1e30)
Floats = NDArray[np.float32]
Integers = NDArray[np.int32]

# Rows of Scratch.floats: 0, 1, 2, ...; 1, 1, 3, 3, ...; the largest w so far; the light's colour. Then of integers.
ROW, CORNER, BEST, RED, GREEN, BLUE = range(6)
PLACE, TEXEL = range(2)
Line = tuple[Float, Float, Float, Float]


class Scratch(NamedTuple):
    """The working memory of one thread."""

    faces: Faces
    begins: Integers  # (COLUMNS,): first row of a face in each column
    ends: Integers  # (COLUMNS,): row after its last
    spans: Integers  # (COLUMNS, FACES): face << 16 | begin << 8 | end of the faces in each column
    counts: Integers  # (COLUMNS,): their number
    floats: Floats  # (6, ROWS)
    integers: Integers  # (2, ROWS)
    channels: NDArray[np.uint8]  # (3, COLUMNS, ROWS): the image, by columns
    bright: NDArray[np.float64]  # (1,): the mean of an image that was not made of spans


@part(error_model="numpy")
def make_scratch() -> Scratch:
    """Allocate the working memory of one thread."""
    floats = np.zeros((6, at.ROWS), np.float32)
    for row in range(at.ROWS):
        floats[ROW, row], floats[CORNER, row] = row, row | 1
    begins, ends = np.zeros(at.COLUMNS, np.int32), np.zeros(at.COLUMNS, np.int32)
    counts = np.zeros(at.COLUMNS, np.int32)
    faces, spans = np.zeros((at.FACES, at.FIELDS), np.float32), np.zeros((at.COLUMNS, at.FACES), np.int32)
    integers, channels = np.zeros((2, at.ROWS), np.int32), np.zeros((3, at.COLUMNS, at.ROWS), np.uint8)
    return Scratch(faces, begins, ends, spans, counts, floats, integers, channels, np.zeros(1))


@part(error_model="numpy")
def line_of(per_column: Float, per_row: Float, rest: Float) -> Line:
    """Return the rows in which a linear function is >= 0: the first and the last, each in column 0 and per column.

    One of the two is infinite, for the function either rises or falls from row to row.
    """
    root = ONE / per_row if abs(per_row) > ONE / HUGE else HUGE
    row, slope = -rest * root, -per_column * root
    rises = root > ZERO
    return row if rises else -HUGE, slope if rises else ZERO, HUGE if rises else row, ZERO if rises else slope


@part(error_model="numpy")
def edge_line(faces: Faces, face: int, field: int) -> Line:
    """Return the `line_of` a face's linear function."""
    return line_of(faces[face, field], faces[face, field + 1], faces[face, field + 2])


@part(error_model="numpy")
def whole_rows(low: Float, high: Float) -> tuple[Integer, Integer]:
    """Return the image's whole rows within [low, high] as [begin, end)."""
    low, high = min(max(low, ZERO), np.float32(at.ROWS)), min(max(high, -ONE), np.float32(at.ROWS - 1))
    begin = np.int32(low)
    return begin + (I1 if low > np.float32(begin) else I0), np.int32(high + ONE)


@part(error_model="numpy")
def find_spans(faces: Faces, begins: Integers, ends: Integers, spans: Integers, counts: Integers) -> None:
    """Find the faces in each column, with their rows."""
    counts[:] = 0
    for face in range(1, int(faces[0, at.COUNT])):
        if faces[face, at.NEAREST_W] > ZERO:
            first, last = int(faces[face, at.FIRST_COLUMN]), int(faces[face, at.LAST_COLUMN])
            find_rows(faces, face, first, last, begins, ends)
            for column in range(first, last + 1):
                if begins[column] < ends[column]:
                    spans[column, counts[column]] = (face << 16) | (begins[column] << 8) | ends[column]
                    counts[column] += 1


@part(error_model="numpy", inline=False)
def find_rows(faces: Faces, face: int, first: int, last: int, begins: Integers, ends: Integers) -> None:
    """Find the rows of a face in the columns from `first` to `last`."""
    l0, l0_slope, h0, h0_slope = edge_line(faces, face, at.EDGES)
    l1, l1_slope, h1, h1_slope = edge_line(faces, face, at.EDGES + 3)
    l2, l2_slope, h2, h2_slope = edge_line(faces, face, at.EDGES + 6)
    l3, l3_slope, h3, h3_slope = edge_line(faces, face, at.EDGES + 9)
    for column in range(np.uintp(first & ~7), np.uintp((last + 8) & ~7)):
        x = np.float32(np.int32(column))
        low = max(max(l0 + l0_slope * x, l1 + l1_slope * x), max(l2 + l2_slope * x, l3 + l3_slope * x))
        high = min(min(h0 + h0_slope * x, h1 + h1_slope * x), min(h2 + h2_slope * x, h3 + h3_slope * x))
        begins[column], ends[column] = whole_rows(low, high)
    extra = int(faces[face, at.EXTRA])
    for edge in range(at.SLICES if extra > 0 else 0):
        narrow(edge_line(faces, extra, 3 * edge), first, last, begins, ends)
    if faces[face, at.NEAREST_W] >= faces[0, at.NEAR_W]:
        rest = faces[0, at.NEAR_W] - faces[face, at.W + 2]
        narrow(line_of(-faces[face, at.W], -faces[face, at.W + 1], rest), first, last, begins, ends)


@part(error_model="numpy", inline=False)
def narrow(line: Line, first: int, last: int, begins: Integers, ends: Integers) -> None:
    """Clip a face's rows by a line, as `line_of` describes it."""
    low, low_slope, high, high_slope = line
    for column in range(np.uintp(first), np.uintp(last + 1)):
        x = np.float32(np.int32(column))
        begin, end = whole_rows(low + low_slope * x, high + high_slope * x)
        begins[column], ends[column] = max(begins[column], begin), min(ends[column], end)


@part(error_model="numpy", inline=False)
def show_face(
    textures: Textures, faces: Faces, floats: Floats, integers: Integers, face: int, column: int, begin: int, end: int
) -> None:
    """Write texel index and light in each row of a column in which a face is nearer than what the buffer holds."""
    texture = int(faces[face, at.TEXTURE])
    base, size = textures[texture, at.BASE], textures[texture, at.LOG2_SIZE]
    x, corner_x = np.float32(column), np.float32(column & ~1)
    tu, cu, tv, cv = faces[face, at.TU], faces[face, at.TU + 1], faces[face, at.TV], faces[face, at.TV + 1]
    a, b, c = faces[face, at.W], faces[face, at.W + 1], faces[face, at.W + 2]
    ea, eb, ec = faces[face, at.ACROSS], faces[face, at.ACROSS + 1], faces[face, at.ACROSS + 2]
    da, db, dc = faces[face, at.DOWN], faces[face, at.DOWN + 1], faces[face, at.DOWN + 2]
    r0, g0, b0 = faces[face, at.COLOUR], faces[face, at.COLOUR + 1], faces[face, at.COLOUR + 2]
    r1, g1, b1 = faces[face, at.SLOPE], faces[face, at.SLOPE + 1], faces[face, at.SLOPE + 2]
    first, last = np.float32(begin), np.float32(end)
    ax, aex, adx, acx, aecx, adcx = a * x, ea * x, da * x, a * corner_x, ea * corner_x, da * corner_x
    for pixel in range(np.uintp(begin & ~7), np.uintp((end + 7) & ~7)):
        best, other, red = floats[BEST, pixel], integers[PLACE, pixel], floats[RED, pixel]
        green, blue = floats[GREEN, pixel], floats[BLUE, pixel]
        y = floats[CORNER, pixel]
        w, e, d = acx + (b * y + c), aecx + (eb * y + ec), adcx + (db * y + dc)
        at_0, at_x, at_y = (ONE / max(w, SHORTEST_W), ONE / max(w + a, SHORTEST_W), ONE / max(w - b, SHORTEST_W))
        u_0, v_0 = e * at_0, d * at_0
        level = level_of(
            ((e + ea) * at_x - u_0) * tu,
            ((d + da) * at_x - v_0) * tv,
            ((e - eb) * at_y - u_0) * tu,
            ((d - db) * at_y - v_0) * tv,
            size,
        )
        y = floats[ROW, pixel]
        w = ax + (b * y + c)
        depth = ONE / max(w, SHORTEST_W)
        along = (aex + (eb * y + ec)) * depth
        place = texel_index(along * tu + cu, (adx + (db * y + dc)) * depth * tv + cv, level, base, size)
        nearer = (w > best) & (y >= first) & (y < last)
        floats[BEST, pixel] = w if nearer else best
        integers[PLACE, pixel] = place if nearer else other
        floats[RED, pixel] = r0 + r1 * along if nearer else red
        floats[GREEN, pixel] = g0 + g1 * along if nearer else green
        floats[BLUE, pixel] = b0 + b1 * along if nearer else blue


@part(error_model="numpy", inline=False)
def show_sky(
    textures: Textures, faces: Faces, floats: Floats, integers: Integers, column: int, spans: Integers, count: int
) -> None:
    """Write the sky, except where faces cover a column from its top or bottom; faces are drawn over it."""
    begin, end = 0, at.ROWS
    for number in range(count):
        first, behind = (spans[column, number] >> 8) & 255, spans[column, number] & 255
        begin = max(begin, behind) if first == 0 else begin
        end = min(end, first) if behind == at.ROWS else end
    x = np.float32(column)
    xa, xb, xc = faces[0, at.RAYS] * x, faces[0, at.RAYS + 1], faces[0, at.RAYS + 2]
    ya, yb, yc = faces[0, at.RAYS + 3] * x, faces[0, at.RAYS + 4], faces[0, at.RAYS + 5]
    za, zb, zc = faces[0, at.RAYS + 6] * x, faces[0, at.RAYS + 7], faces[0, at.RAYS + 8]
    base, size = textures[0, at.BASE], textures[0, at.LOG2_SIZE]
    for pixel in range(np.uintp(begin & ~7), np.uintp((max(end, begin) + 7) & ~7)):
        y = floats[ROW, pixel]
        integers[PLACE, pixel] = sky_index(xa + (xb * y + xc), ya + (yb * y + yc), za + (zb * y + zc), base, size)
        floats[RED, pixel] = floats[GREEN, pixel] = floats[BLUE, pixel] = ONE


@part(error_model="numpy")
def gray_column(texels: Texels, floats: Floats, integers: Integers, column: int, channels: Operand) -> None:
    """Write the luma of a column whose texel indices are known."""
    for row in range(at.ROWS):
        integers[TEXEL, row] = texels[np.uint32(integers[PLACE, row])]
    for row in range(at.ROWS):
        red, green, blue = lit(integers[TEXEL, row], floats[RED, row], floats[GREEN, row], floats[BLUE, row])
        channels[0, column, row] = luma_of(red, green, blue)


@part(error_model="numpy")
def colour_column(texels: Texels, floats: Floats, integers: Integers, column: int, channels: Operand) -> None:
    """Write red, green and blue of a column whose texel indices are known."""
    for row in range(at.ROWS):
        red, green, blue = lit(
            np.int32(texels[np.uint32(integers[PLACE, row])]), floats[RED, row], floats[GREEN, row], floats[BLUE, row]
        )
        channels[0, column, row], channels[1, column, row], channels[2, column, row] = red, green, blue


@part(error_model="numpy", inline=False)
def render_channels(appearance: Appearance, scratch: Scratch, colour: bool) -> None:
    """Render the projected faces to `scratch.channels`: red, green and blue if `colour`, else luma."""
    texels, textures = appearance.texels, appearance.textures
    faces, spans, counts = scratch.faces, scratch.spans, scratch.counts
    floats, integers, channels = scratch.floats, scratch.integers, scratch.channels
    find_spans(faces, scratch.begins, scratch.ends, spans, counts)
    for column in range(at.COLUMNS):
        for row in range(at.ROWS):
            floats[BEST, row] = faces[0, at.FAR_W]
        show_sky(textures, faces, floats, integers, column, spans, counts[column])
        for number in range(counts[column]):
            span = spans[column, number]
            show_face(textures, faces, floats, integers, span >> 16, column, (span >> 8) & 255, span & 255)
        if colour:
            colour_column(texels, floats, integers, column, channels)
        else:
            gray_column(texels, floats, integers, column, channels)


@part(error_model="numpy")
def paint_gray(
    appearance: Appearance, scenes: Scenes, lane: int, place: Floats, quaternion: Floats, scratch: Scratch, out: Operand
) -> None:
    """Render luma (ROWS, COLUMNS) for a pose, NED in metres and wxyz."""
    project(appearance, scenes, lane, place, quaternion, True, scratch.faces)
    render_channels(appearance, scratch, False)
    for row in range(at.ROWS):
        for column in range(at.COLUMNS):
            out[row, column] = scratch.channels[0, column, row]


@part(error_model="numpy")
def paint_colour(
    appearance: Appearance, scenes: Scenes, lane: int, place: Floats, quaternion: Floats, scratch: Scratch, out: Operand
) -> None:
    """Render red, green and blue (ROWS, COLUMNS, 3)."""
    project(appearance, scenes, lane, place, quaternion, True, scratch.faces)
    render_channels(appearance, scratch, True)
    for row in range(at.ROWS):
        for column in range(at.COLUMNS):
            out[row, column, 0] = scratch.channels[0, column, row]
            out[row, column, 1] = scratch.channels[1, column, row]
            out[row, column, 2] = scratch.channels[2, column, row]


@part(error_model="numpy")
def paint_depths(
    appearance: Appearance, scenes: Scenes, lane: int, place: Floats, quaternion: Floats, scratch: Scratch, out: Operand
) -> None:
    """Render depth (ROWS, COLUMNS), metres."""
    project(appearance, scenes, lane, place, quaternion, False, scratch.faces)
    faces, floats, counts = scratch.faces, scratch.floats, scratch.counts
    find_spans(faces, scratch.begins, scratch.ends, scratch.spans, counts)
    for column in range(at.COLUMNS):
        for row in range(at.ROWS):
            floats[BEST, row] = faces[0, at.FAR_W]
        for number in range(counts[column]):
            span = scratch.spans[column, number]
            face = span >> 16
            a, b, c = faces[face, at.W] * np.float32(column), faces[face, at.W + 1], faces[face, at.W + 2]
            for row in range(np.uintp((span >> 8) & 255), np.uintp(span & 255)):
                w = a + (b * floats[ROW, row] + c)
                floats[BEST, row] = max(w, floats[BEST, row])
        for row in range(at.ROWS):
            out[row, column] = ONE / floats[BEST, row]


def of_picture(out: Any, gray: Any, colour: Any, depths: Any) -> Any:
    """Return that of three functions which renders to arrays of a numba type: uint8 (H, W) or (H, W, 3), or float32."""
    return depths if out.dtype == types.float32 else (colour if out.ndim == 3 else gray)


@chosen_by_types
def paint(appearance, scenes, lane, place, quaternion, scratch, out):  # type: ignore[no-untyped-def]
    """Render the kind of image that `out` has room for."""
    return of_picture(out, paint_gray, paint_colour, paint_depths)


def _compile(stamp: int) -> Launchable:
    """Compile the loop over drones, or load it from numba's cache.

    numba checks this file alone for changes. The loop closes over `stamp`, a digest of the other sources, so that a
    change there makes it compile anew.
    """

    @njit(cache=True, nogil=True, error_model="numpy")
    def render(appearance, scenes, lanes, positions, quaternions, out):  # type: ignore[no-untyped-def]
        scratch = make_scratch()
        for drone in range(len(lanes) * (stamp != 0)):
            place, quaternion = positions[drone], quaternions[drone]
            paint(appearance, scenes, lanes[drone], place, quaternion, scratch, out[drone])

    return render


_render = _compile(sources(__name__))

Poses = NDArray[np.float64]
Lanes = NDArray[np.int32]


def render_lanes(
    kind: Literal["gray", "colour", "depth"],
    appearance: Appearance,
    scenes: Scenes,
    lanes: Lanes,
    positions: Poses,
    quaternions: Poses,
) -> NDArray[Any]:
    """Render what drones see (D, ROWS, COLUMNS, ...).

    It is luma uint8, which OpenCV would compute from the colours; red, green and blue (..., 3) uint8; or depth float32,
    metres along the optical axis, where the sky is at the far plane.
    """
    channels = (3,) if kind == "colour" else ()
    out = np.empty((len(lanes), at.ROWS, at.COLUMNS, *channels), np.float32 if kind == "depth" else np.uint8)
    _render(appearance, scenes, lanes, positions, quaternions, out)
    return out
