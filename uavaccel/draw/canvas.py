"""Pages of pixels, for films: colours, pictures put in place, and text."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Bgr = NDArray[np.uint8]  # (H, W, 3): blue, green, red, as OpenCV has them

PAPER, INK, FAINT = (255, 255, 255), (40, 40, 40), (120, 120, 120)
BLUE, VERMILION, GREEN = (178, 114, 0), (0, 94, 213), (115, 158, 0)  # those of draw/style.py


def paste(page: Bgr, picture: Bgr, at: tuple[int, int]) -> None:
    """Put a picture onto a page, its left upper corner at (x, y)."""
    x, y = at
    page[y : y + picture.shape[0], x : x + picture.shape[1]] = picture


def to_bgr(image: NDArray[np.uint8], size: tuple[int, int]) -> Bgr:
    """An image, gray (H, W) or red, green, blue (H, W, 3), at `size` (width, height), pixel by pixel."""
    code = cv2.COLOR_GRAY2BGR if image.ndim == 2 else cv2.COLOR_RGB2BGR
    picture = cv2.resize(
        np.asarray(cv2.cvtColor(image, code), np.uint8), size, interpolation=cv2.INTER_NEAREST
    )
    return np.asarray(picture, np.uint8)


def write(
    page: Bgr, text: str, at: tuple[int, int], size: float, colour: Sequence[float] = INK, anchor: float = 0.0
) -> None:
    """Text with its baseline at `at`, which is its left end, or with `anchor` 0.5 its middle, 1 its right end."""
    font = cv2.FONT_HERSHEY_SIMPLEX
    x, y = at
    x -= round(anchor * cv2.getTextSize(text, font, size, 1)[0][0])
    cv2.putText(page, text, (x, y), font, size, colour, 1, cv2.LINE_AA)
