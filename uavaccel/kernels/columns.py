"""Visibility within one column of an image: scalar functions, for loops on the CPU and for CUDA threads.

In a column a face is an interval of rows in which w, the inverse depth, is linear in the row. The column is resolved
piece by piece: find the nearest interval at a row, then the row at which another one begins or crosses it. The cost
grows with the number of intervals, not of pixels. The arithmetic is that of `kernels.spans`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from uavaccel.kernels import fields as at
from uavaccel.kernels.operands import Operand
from uavaccel.kernels.rays import I0, I1, ZERO, Faces, Float, Integer
from uavaccel.kernels.spans import HUGE, edge_line, line_of, whole_rows

MOST_INTERVALS = 32  # per column; 3 on average, rarely more than 20; of more, the nearest are kept
MOST_PIECES = 48
ROWS, BYTE_BITS, FACE_BITS, BYTE = (np.int32(number) for number in (at.ROWS, 8, 16, 255))


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
