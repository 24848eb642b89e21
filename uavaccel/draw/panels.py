"""The panels of a film's frame as pixels: text, images, the lane from above, and an agent's decisions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.draw.style import BLUE, GREEN, VERMILION, Bgr, Decisions, bgr
from uavaccel.sim.clutter import BOX, COS, HALF_X, HALF_Y, KIND, SIN, ClutterLayout, X, Y
from uavaccel.sim.lane import HULL_RADIUS_M, LENGTH_M, WIDTH_M, LaneLayout

PAPER, INK, FAINT = (255, 255, 255), (40, 40, 40), (120, 120, 120)


def blank(size: tuple[int, int], colour: Sequence[int] = PAPER) -> Bgr:
    """Return an image of one colour, `size` (width, height)."""
    width, height = size
    picture = np.empty((height, width, 3), np.uint8)
    picture[:] = np.full((width, 3), colour, np.uint8)  # by rows: several times as fast as by pixels
    return picture


def paste(page: Bgr, picture: Bgr, at: tuple[int, int]) -> None:
    """Copy an image onto a page, its upper left corner at (x, y)."""
    x, y = at
    page[y : y + picture.shape[0], x : x + picture.shape[1]] = picture


def to_bgr(image: NDArray[np.uint8], size: tuple[int, int]) -> Bgr:
    """Return an image, gray (H, W) or RGB (H, W, 3), as BGR at `size` (width, height), without interpolation."""
    code = cv2.COLOR_GRAY2BGR if image.ndim == 2 else cv2.COLOR_RGB2BGR
    return enlarged(np.asarray(cv2.cvtColor(image, code), np.uint8), size)


def enlarged(picture: Bgr, size: tuple[int, int]) -> Bgr:
    """Return an image at `size` (width, height), without interpolation."""
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST), np.uint8)


def write(
    page: Bgr, text: str, at: tuple[int, int], size: float, colour: Sequence[float] = INK, anchor: float = 0.0
) -> None:
    """Write text with its baseline at `at`, its left end, or its middle with `anchor` 0.5, or its right end with 1."""
    font = cv2.FONT_HERSHEY_SIMPLEX
    x, y = at
    x -= round(anchor * cv2.getTextSize(text, font, size, 1)[0][0])
    cv2.putText(page, text, (x, y), font, size, colour, 1, cv2.LINE_AA)


GROUND, OUTSIDE, WALL = (240, 240, 240), (222, 222, 222), (110, 110, 110)
OBSTACLE, TRACK, DRONE, GOAL = (70, 70, 70), bgr(BLUE), bgr(VERMILION), bgr(GREEN)
WALL_M = 0.25  # thickness on the map
BEHIND = 0.25  # share of the near map that lies behind the drone
IMPACT_PIXELS = 12  # half of the cross
ROOM_M = 3.0  # around a flight on the map
CORNERS = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
ROUND = np.stack([np.cos(turn := np.linspace(0.0, 2 * np.pi, 24, endpoint=False)), np.sin(turn)], axis=1)
SUBPIXEL = 4  # bits


class View(NamedTuple):
    """A map projection: the pixel of the origin, and the axes' steps in pixels per metre."""

    size: tuple[int, int]  # width, height
    origin: NDArray[np.float64]
    north: NDArray[np.float64]
    east: NDArray[np.float64]

    def pixels(self, places_m: ArrayLike) -> NDArray[np.int32]:
        """Return the pixels (..., 2) of places (..., 2), north and east, in OpenCV's fixed-point numbers."""
        places = np.asarray(places_m, np.float64)
        exact = self.origin + places[..., :1] * self.north + places[..., 1:] * self.east
        return np.rint(exact * (1 << SUBPIXEL)).astype(np.int32)

    @property
    def scale(self) -> float:
        """The pixels per metre."""
        return float(np.abs(self.north + self.east).max())


def whole_lane(size: tuple[int, int]) -> View:
    """Return the projection of the whole lane lengthwise, its start on the left; east is down."""
    width, height = size
    scale = min(width / (LENGTH_M + 4.0), height / (WIDTH_M + 2 * WALL_M))
    return View(size, np.array([2.0 * scale, height / 2]), np.array([scale, 0.0]), np.array([0.0, scale]))


def follow(place_m: ArrayLike, size: tuple[int, int]) -> View:
    """Return the projection of the surroundings of a place, north up, as wide as the lane."""
    width, height = size
    scale = width / (WIDTH_M + 2 * WALL_M)
    origin = np.array([width / 2, height * (1 - BEHIND) + float(np.asarray(place_m)[0]) * scale])
    return View(size, origin, np.array([0.0, -scale]), np.array([scale, 0.0]))


def around(places_m: NDArray[np.float64], size: tuple[int, int]) -> View:
    """Return the projection of all of these places (n, 2), north up, with ROOM_M around them."""
    least, most = places_m.min(axis=0) - ROOM_M, places_m.max(axis=0) + ROOM_M
    (width, height), (north_m, east_m) = size, most - least
    scale = min(width / east_m, height / north_m)
    north, east = (least + most) / 2
    origin = np.array([width / 2 - east * scale, height / 2 + north * scale])
    return View(size, origin, np.array([0.0, -scale]), np.array([scale, 0.0]))


def draw_lane(layout: LaneLayout | ClutterLayout | None, view: View) -> Bgr:
    """Draw ground, walls, goal and obstacles, or what stands in the clutter; without a layout the ground alone.

    The image is (height, width, 3), BGR.
    """
    if not isinstance(layout, LaneLayout):
        picture = blank(view.size, GROUND)
        for row in layout.rows[layout.standing] if layout else ():  # a shape's outline from above
            along, across = (CORNERS if int(row[KIND]) == BOX else ROUND).T * row[HALF_X : HALF_Y + 1, None]
            north, west = row[X] + row[COS] * along - row[SIN] * across, row[Y] + row[SIN] * along + row[COS] * across
            cv2.fillPoly(picture, [view.pixels(np.stack([north, -west], axis=1))], OBSTACLE, cv2.LINE_AA, SUBPIXEL)
        return picture
    picture = blank(view.size, OUTSIDE)
    half = WIDTH_M / 2
    _box(picture, view, (-10.0, LENGTH_M + 10.0), (-half, half), GROUND)
    for walls in ((half, half + WALL_M), (-half - WALL_M, -half)):
        _box(picture, view, (-10.0, LENGTH_M + 10.0), walls, WALL)
    _box(picture, view, (LENGTH_M, LENGTH_M + 0.4), (-half, half), GOAL)
    obstacles = zip(layout.x_m, layout.y_m, layout.half_width_m, layout.round, strict=True)
    for x, y, half_width, is_round in obstacles:
        if is_round:
            _disc(picture, view, (x, y), half_width, OBSTACLE)
        else:
            _box(picture, view, (x - half_width, x + half_width), (y - half_width, y + half_width), OBSTACLE)
    return picture


def draw_target(picture: Bgr, view: View, place_m: ArrayLike) -> Bgr:
    """Mark what is to be reached, and return the image."""
    _disc(picture, view, np.asarray(place_m)[:2], 5.0 / view.scale, GOAL)
    return picture


def draw_track(picture: Bgr, view: View, track_m: ArrayLike) -> Bgr:
    """Draw the track (n, 2), and the drone at its end, onto the image of a lane, and return that."""
    track = np.asarray(track_m)
    cv2.polylines(picture, [view.pixels(track)], False, TRACK, 2, cv2.LINE_AA, SUBPIXEL)
    _disc(picture, view, track[-1], max(HULL_RADIUS_M, 3.0 / view.scale), DRONE)
    return picture


def draw_impact(picture: Bgr, view: View, place_m: ArrayLike) -> Bgr:
    """Mark the place of a collision with a cross, and return the image."""
    x, y = view.pixels(np.asarray(place_m)).tolist()
    reach = IMPACT_PIXELS << SUBPIXEL
    for slope in (1, -1):
        ends = (x - reach, y - slope * reach), (x + reach, y + slope * reach)
        cv2.line(picture, *ends, DRONE, 3, cv2.LINE_AA, SUBPIXEL)
    return picture


def _box(picture: Bgr, view: View, north: Sequence[float], east: Sequence[float], colour: Sequence[int]) -> None:
    """Fill the ground between two places to the north and two to the east, in metres."""
    corners = view.pixels([(north[0], east[0]), (north[0], east[1]), (north[1], east[1]), (north[1], east[0])])
    cv2.fillPoly(picture, [corners], colour, cv2.LINE_AA, SUBPIXEL)


def _disc(picture: Bgr, view: View, place_m: ArrayLike, radius_m: float, colour: tuple[int, int, int]) -> None:
    centre = view.pixels(place_m)
    radius = round(radius_m * view.scale * (1 << SUBPIXEL))
    cv2.circle(picture, (int(centre[0]), int(centre[1])), radius, colour, -1, cv2.LINE_AA, SUBPIXEL)


TAKEN, UNTAKEN = TRACK, (200, 200, 200)
LEAST = 0.1  # height of the worst action's bar, relative to the film's largest difference
MARGIN, FOOT = 24, 40  # pixels above the bars for their values, and below for their headings


def draw_given(planes: NDArray[np.uint8], size: tuple[int, int]) -> Bgr:
    """Tile planes (k, H, W) from the top left on, as large as they fit into `size` (width, height)."""
    picture = blank(size)
    columns = math.ceil(math.sqrt(len(planes)))
    width, height = size[0] // columns, size[1] // columns
    for place, plane in enumerate(planes):
        tile = cv2.resize(plane, (width - 2, height - 2), interpolation=cv2.INTER_NEAREST)
        at = place % columns * width, place // columns * height
        paste(picture, np.asarray(cv2.cvtColor(tile, cv2.COLOR_GRAY2BGR), np.uint8), at)
    return picture


def draw_ratings(decisions: Decisions, command: int, size: tuple[int, int]) -> Bgr:
    """Draw a bar per action, from west to east: its rating above the worst's, on one scale for the film.

    Above the bars are the ratings; the action that was taken is in colour.
    """
    width, height = size
    picture = blank(size)
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
        write(picture, f"{decisions.headings_deg[action]:.0f}", (middle, height - FOOT + 16), 0.4, INK, anchor=0.5)
    write(picture, "degrees east of the lane", (width // 2, height - 6), 0.36, FAINT, anchor=0.5)
    return picture
