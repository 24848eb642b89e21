"""Images as the bytes of a file: PNG, PPM, or PFM for numbers."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from uavaccel.wire.scenery import Scenery
from uavaccel.wire.settings import RecordedImage

Pixels = NDArray[np.uint8] | NDArray[np.float32]


def png(image: Pixels) -> bytes:
    """Of blue, green, red pixels. Raises ValueError."""
    return _encoded(".png", image)


def pfm(numbers: NDArray[np.float32]) -> bytes:
    """Portable float map: one number per pixel, little endian, the bottom row first."""
    height, width = numbers.shape
    return f"Pf\n{width} {height}\n-1.0\n".encode() + numbers[::-1].astype("<f4").tobytes()


def image_file(scenery: Scenery, wanted: RecordedImage) -> tuple[str, bytes]:
    """Suffix and content of a picture of this moment. Raises ValueError for a camera or type that is not there."""
    camera = scenery.cameras().named(wanted.camera_name)
    if wanted.pixels_as_float:
        return ".pfm", pfm(scenery.pictures.floats(camera, wanted.image_type))
    suffix = ".png" if wanted.compress else ".ppm"
    return suffix, _encoded(suffix, scenery.pictures.bgr(camera, wanted.image_type))


def _encoded(suffix: str, image: Pixels) -> bytes:
    done, data = cv2.imencode(suffix, image)
    if not done:
        raise ValueError("the image could not be compressed")
    return data.tobytes()
