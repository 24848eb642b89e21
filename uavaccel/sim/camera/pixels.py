"""Pictures as arrays: luma, smaller pictures, PNG. Numbers are those of OpenCV, to the bit; v2e computes with it."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.view import AnyImage, Image
from uavaccel.sim.parts import njit, part

Integer = Any  # np.int32: with a Python int numba would compute in 64 bits
OF_RED, OF_GREEN, OF_BLUE, LUMA_HALF, LUMA_BITS = (np.int32(number) for number in (9798, 19235, 3735, 16384, 15))


@part(error_model="numpy")
def luma_of(red: Integer, green: Integer, blue: Integer) -> Integer:
    """Return a pixel's ITU-R BT.601 luma in the fixed-point arithmetic of OpenCV's COLOR_RGBA2GRAY."""
    weighted = np.int32(np.int32(red * OF_RED) + np.int32(green * OF_GREEN)) + np.int32(blue * OF_BLUE)
    return np.int32(np.int32(weighted + LUMA_HALF) >> LUMA_BITS)


@njit(nogil=True, cache=True, error_model="numpy")
def _write_luma(pixels: Image, out: Image, turned: bool) -> None:
    rows, columns, _ = pixels.shape
    for row in range(rows):
        at = rows - 1 - row if turned else row
        for column in range(columns):
            red, green, blue = pixels[row, column, 0], pixels[row, column, 1], pixels[row, column, 2]
            out[at, column] = luma_of(np.int32(red), np.int32(green), np.int32(blue))


@njit(nogil=True, cache=True, error_model="numpy")
def _write_colours(pixels: Image, out: Image) -> None:
    rows, columns, _ = pixels.shape
    for row in range(rows):
        for column in range(columns):
            out[rows - 1 - row, column, 0] = pixels[row, column, 0]
            out[rows - 1 - row, column, 1] = pixels[row, column, 1]
            out[rows - 1 - row, column, 2] = pixels[row, column, 2]


def luma(pixels: Image, turned: bool = False) -> Image:
    """Return the luma (H, W) of red, green, blue and whatever follows (H, W, n); with `turned`, the last row first."""
    out = np.empty(pixels.shape[:2], np.uint8)
    _write_luma(np.ascontiguousarray(pixels), out, turned)
    return out


def turned_colours(pixels: Image) -> Image:
    """Return red, green, blue (H, W, 3) of pixels (H, W, 4), the last row first."""
    out = np.empty((*pixels.shape[:2], 3), np.uint8)
    _write_colours(pixels, out)
    return out


def means(picture: Image) -> list[float]:
    """Return the mean of each channel of a grey (H, W) or colour picture (H, W, channels)."""
    pixels = np.ascontiguousarray(picture).reshape(picture.shape[0] * picture.shape[1], -1)
    return [_total(pixels, channel) * (1.0 / len(pixels)) for channel in range(pixels.shape[1])]


@njit(nogil=True, cache=True, error_model="numpy")
def _total(pixels: Image, channel: int) -> int:
    total = 0
    for pixel in range(len(pixels)):
        total += pixels[pixel, channel]
    return total


def quartered(picture: AnyImage) -> AnyImage:
    """Return a picture (4 H, 4 W) or (4 H, 4 W, channels) of bytes or float32 as (H, W, ...): means of 4 x 4 pixels."""
    planes = np.ascontiguousarray(picture).reshape(*picture.shape[:2], -1)
    is_real = picture.dtype == np.float32
    sums = np.zeros((planes.shape[0] // 4, planes.shape[1] // 4, planes.shape[2]), np.float32 if is_real else np.int32)
    _add_blocks(planes, sums)
    mean = sums.reshape(*sums.shape[:2], *picture.shape[2:]).astype(np.float32) / np.float32(16)
    return np.asarray(mean if is_real else np.rint(mean).astype(np.uint8))


@njit(nogil=True, cache=True, error_model="numpy")
def _add_blocks(planes: AnyImage, sums: NDArray[np.generic]) -> None:
    for row in range(sums.shape[0]):
        for column in range(sums.shape[1]):
            for down in range(4 * row, 4 * row + 4):
                for channel in range(sums.shape[2]):
                    four = sums.dtype.type(planes[down, 4 * column, channel])
                    for right in range(4 * column + 1, 4 * column + 4):
                        four += planes[down, right, channel]
                    sums[row, column, channel] += four


def png(picture: NDArray[Any]) -> bytes:
    """Return the PNG file of a grey (H, W) or RGB picture (H, W, 3), uint8."""
    from PIL import Image as Pillow

    file = BytesIO()
    Pillow.fromarray(np.ascontiguousarray(picture)).save(file, "PNG", compress_level=1)
    return file.getvalue()
