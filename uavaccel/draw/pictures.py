"""What pages, exports and films show of a flight alike: colours, pictures of events, an agent's decisions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaccel.resources import require
from uavaccel.sim.camera.gl import describe_renderer

Bgr = NDArray[np.uint8]  # (H, W, 3): blue, green, red, as OpenCV has them
BLUE, VERMILION, GREEN = (178, 114, 0), (0, 94, 213), (115, 158, 0)  # those of draw/style.py
NO_EVENT, ON, OFF = (246, 246, 246), BLUE, VERMILION
FULL_COLOUR_FROM = 3  # events per pixel


def check_films() -> None:
    """Raise UserError where no film can be made: without OpenGL, or without the extra `film`."""
    require("av", "MP4", "film")
    require("cv2", "MP4", "film", "opencv-python-headless")
    describe_renderer()


def dvs_picture(on: NDArray[np.integer], off: NDArray[np.integer]) -> Bgr:
    """Return event counts (H, W) as an image (H, W, 3): the more events, the deeper the colour."""
    shade = np.minimum(on, FULL_COLOUR_FROM) * (FULL_COLOUR_FROM + 1) + np.minimum(off, FULL_COLOUR_FROM)
    return np.asarray(np.take(_SHADES, shade, axis=0))


def _shades() -> Bgr:
    """Return the colour of each pair of counts up to FULL_COLOUR_FROM, OFF varying fastest; (16, 3)."""
    depth = np.linspace(0.0, 1.0, FULL_COLOUR_FROM + 1)[:, None]
    on, off = (depth * (np.array(colour) - NO_EVENT) for colour in (ON, OFF))
    shades = (NO_EVENT + on[:, None] + off[None]).reshape(-1, 3)
    return np.clip(shades, 0, 255).astype(np.uint8)


_SHADES = _shades()


@dataclass(frozen=True)
class Decisions:
    """The decisions of m commands: ratings of the actions (m, actions), the action taken (m,), and the observation.

    `given` (m, planes, H, W) uint8 is the network's input, oldest plane first; None where it is no image. `rated_as`
    says what the ratings are. Sample i of the film's n was taken during command `of_sample[i]`.
    """

    ratings: NDArray[np.float64]
    taken: NDArray[np.int64]
    headings_deg: tuple[float, ...]
    of_sample: NDArray[np.int64]
    rated_as: str
    given: NDArray[np.uint8] | None = None
