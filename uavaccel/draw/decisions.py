"""What a network was given and how it rated its actions, for films."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.canvas import BLUE, FAINT, INK, PAPER, Bgr, paste, write

TAKEN, UNTAKEN = BLUE, (200, 200, 200)
LEAST = 0.1  # of the film's largest difference: the worst action's bar
MARGIN, FOOT = 24, 40  # pixels above the bars, for their values, and below, for their headings


@dataclass(frozen=True)
class Decisions:
    """Of m commands: ratings of the actions (m, actions), which was taken (m,), and what the network was given.

    `given` (m, planes, H, W) uint8, oldest first; None where it is given no pictures. `rated_as` says what the ratings
    are. Sample i of the film's n was taken during command `of_sample[i]`.
    """

    ratings: NDArray[np.float64]
    taken: NDArray[np.int64]
    headings_deg: tuple[float, ...]
    of_sample: NDArray[np.int64]
    rated_as: str
    given: NDArray[np.uint8] | None = None


def draw_given(planes: NDArray[np.uint8], size: tuple[int, int]) -> Bgr:
    """Planes (k, H, W) side by side from the top left on, as large as they fit in `size` (width, height)."""
    picture = np.full((size[1], size[0], 3), PAPER, np.uint8)
    columns = math.ceil(math.sqrt(len(planes)))
    width, height = size[0] // columns, size[1] // columns
    for place, plane in enumerate(planes):
        tile = cv2.resize(plane, (width - 2, height - 2), interpolation=cv2.INTER_NEAREST)
        at = place % columns * width, place // columns * height
        paste(picture, np.asarray(cv2.cvtColor(tile, cv2.COLOR_GRAY2BGR), np.uint8), at)
    return picture


def draw_ratings(decisions: Decisions, command: int, size: tuple[int, int]) -> Bgr:
    """A bar per action, from west to east: how much better it is rated than the worst, on one scale for the film.

    The ratings themselves stand above; the action that was taken is in colour.
    """
    width, height = size
    picture = np.full((height, width, 3), PAPER, np.uint8)
    spread = float(np.ptp(decisions.ratings, axis=1).max()) or 1.0
    better = decisions.ratings[command] - decisions.ratings[command].min() + LEAST * spread
    scale = (height - MARGIN - FOOT) / ((1.0 + LEAST) * spread)
    order = np.argsort(decisions.headings_deg)
    step = width / len(order)
    for place, action in enumerate(order):
        left, right = round(place * step) + 3, round((place + 1) * step) - 3
        top = round(height - FOOT - better[action] * scale)
        colour = TAKEN if action == decisions.taken[command] else UNTAKEN
        cv2.rectangle(picture, (left, top), (right, height - FOOT), colour, -1)
        middle = (left + right) // 2
        write(picture, f"{decisions.ratings[command, action]:.2f}", (middle, top - 6), 0.36, INK, anchor=0.5)
        write(
            picture,
            f"{decisions.headings_deg[action]:.0f}",
            (middle, height - FOOT + 16),
            0.4,
            INK,
            anchor=0.5,
        )
    write(picture, "degrees east of the lane", (width // 2, height - 6), 0.36, FAINT, anchor=0.5)
    return picture
