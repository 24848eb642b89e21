"""The lane from above, for films: walls, obstacles, and where the drone has been."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.draw.canvas import BLUE, GREEN, VERMILION, Bgr
from uavaccel.sim.lane.layout import HULL_RADIUS_M, LENGTH_M, WIDTH_M, LaneLayout

GROUND, OUTSIDE, WALL = (240, 240, 240), (222, 222, 222), (110, 110, 110)
OBSTACLE, TRACK, DRONE, GOAL = (70, 70, 70), BLUE, VERMILION, GREEN
WALL_M = 0.25  # as thick as it is drawn
BEHIND = 0.25  # share of the near map that shows what was passed
IMPACT_PIXELS = 12  # half of the cross
SUBPIXEL = 4  # bits


class View(NamedTuple):
    """A north-east rectangle as a picture: the pixel of the origin, and the axes' steps in pixels per metre."""

    size: tuple[int, int]  # width, height
    origin: NDArray[np.float64]
    north: NDArray[np.float64]
    east: NDArray[np.float64]

    def pixels(self, places_m: ArrayLike) -> NDArray[np.int32]:
        """Pixels (..., 2) of (..., 2) places, north and east, in OpenCV's fixed-point numbers."""
        places = np.asarray(places_m, np.float64)
        exact = self.origin + places[..., :1] * self.north + places[..., 1:] * self.east
        return np.rint(exact * (1 << SUBPIXEL)).astype(np.int32)

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        return float(np.abs(self.north + self.east).max())


def whole_lane(size: tuple[int, int]) -> View:
    """The lane lengthwise, its start on the left; east is down."""
    width, height = size
    scale = min(width / (LENGTH_M + 4.0), height / (WIDTH_M + 2 * WALL_M))
    return View(size, np.array([2.0 * scale, height / 2]), np.array([scale, 0.0]), np.array([0.0, scale]))


def follow(place_m: ArrayLike, size: tuple[int, int]) -> View:
    """The surroundings of a place, north up, as wide as the lane."""
    width, height = size
    scale = width / (WIDTH_M + 2 * WALL_M)
    north = float(np.asarray(place_m)[0])
    origin = np.array([width / 2, height * (1 - BEHIND) + north * scale])
    return View(size, origin, np.array([0.0, -scale]), np.array([scale, 0.0]))


def draw_lane(layout: LaneLayout, view: View) -> Bgr:
    """Ground, walls, goal and obstacles; (height, width, 3) blue, green, red."""
    picture = np.full((view.size[1], view.size[0], 3), OUTSIDE, np.uint8)
    half = WIDTH_M / 2
    _box(picture, view, (-10.0, -half), (LENGTH_M + 10.0, half), GROUND)
    for inner, outer in ((half, half + WALL_M), (-half - WALL_M, -half)):
        _box(picture, view, (-10.0, inner), (LENGTH_M + 10.0, outer), WALL)
    _box(picture, view, (LENGTH_M, -half), (LENGTH_M + 0.4, half), GOAL)
    for x, y, half_width, is_round in zip(
        layout.x_m, layout.y_m, layout.half_width_m, layout.round, strict=True
    ):
        if is_round:
            _disc(picture, view, (x, y), half_width, OBSTACLE)
        else:
            _box(picture, view, (x - half_width, y - half_width), (x + half_width, y + half_width), OBSTACLE)
    return picture


def draw_track(picture: Bgr, view: View, track_m: ArrayLike) -> Bgr:
    """Draw places flown (n, 2), and the drone at the last one, onto a lane's picture; returns it."""
    track = np.asarray(track_m)
    cv2.polylines(picture, [view.pixels(track)], False, TRACK, 2, cv2.LINE_AA, SUBPIXEL)
    _disc(picture, view, track[-1], max(HULL_RADIUS_M, 3.0 / view.scale), DRONE)
    return picture


def draw_impact(picture: Bgr, view: View, place_m: ArrayLike) -> Bgr:
    """Mark the place where something was hit with a cross; returns the picture."""
    x, y = view.pixels(np.asarray(place_m)).tolist()
    reach = IMPACT_PIXELS << SUBPIXEL
    for slope in (1, -1):
        ends = (x - reach, y - slope * reach), (x + reach, y + slope * reach)
        cv2.line(picture, *ends, DRONE, 3, cv2.LINE_AA, SUBPIXEL)
    return picture


def _box(
    picture: Bgr,
    view: View,
    south_west: tuple[float, float],
    north_east: tuple[float, float],
    colour: tuple[int, int, int],
) -> None:
    (south, west), (north, east) = south_west, north_east
    corners = view.pixels([(south, west), (south, east), (north, east), (north, west)])
    cv2.fillPoly(picture, [corners], colour, cv2.LINE_AA, SUBPIXEL)


def _disc(
    picture: Bgr, view: View, place_m: ArrayLike, radius_m: float, colour: tuple[int, int, int]
) -> None:
    centre = view.pixels(place_m)
    radius = round(radius_m * view.scale * (1 << SUBPIXEL))
    cv2.circle(picture, (int(centre[0]), int(centre[1])), radius, colour, -1, cv2.LINE_AA, SUBPIXEL)
