"""A game as a film: camera, DVS and map side by side, H.264 in an MP4 that browsers play; or as a contact sheet, a PNG.

Everything is drawn from plain arrays, so whoever keeps images of a lane can show them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.lane_map import draw_lane, draw_track, follow, whole_lane
from uavaccel.draw.movie import Bgr, movie
from uavaccel.errors import UserError
from uavaccel.sim.lane.layout import LaneLayout

FRAMES_PER_S = 12
WIDTH, HEIGHT = 1280, 480
PANEL = (512, 288)  # width and height of camera and DVS: twice the camera's own
CAMERA_AT, DVS_AT, NEAR_AT, LANE_AT = (12, 64), (536, 64), (1060, 64), (12, 380)
NEAR_SIZE, LANE_SIZE = (208, 288), (1256, 86)

PAPER, INK, FAINT = (255, 255, 255), (40, 40, 40), (120, 120, 120)
NO_EVENT, ON, OFF = (246, 246, 246), (178, 114, 0), (0, 94, 213)  # style.BLUE and style.VERMILION
FULL_COLOUR_FROM = 3  # events of a pixel

SHEET_COLUMNS, SHEET_ROWS, SHEET_GAP, SHEET_CAPTION = 5, 4, 10, 24
THUMB = (256, 144)


@dataclass(frozen=True)
class Film:
    """A game's n samples: times (n,), images (n, H, W) gray or (n, H, W, 3) RGB, DVS event
    counts (n, H, W), places NED (n, 3).

    `title` says who flew, how fast and by which clock.
    """

    title: str
    time_s: NDArray[np.float64]
    images: NDArray[np.uint8]
    on_events: NDArray[np.integer]
    off_events: NDArray[np.integer]
    position_m: NDArray[np.float64]
    layout: LaneLayout

    def __len__(self) -> int:
        return len(self.time_s)


def write_video(film: Film, path: Path, frames_per_s: int = FRAMES_PER_S) -> Path:
    """Write an MP4, a frame per sample, whole or not at all; returns `path`. Raises UserError where it cannot be."""
    with movie(path, (WIDTH, HEIGHT), frames_per_s) as add:
        for picture in frames(film, frames_per_s):
            add(picture)
    return path


def frames(film: Film, frames_per_s: int = FRAMES_PER_S) -> Iterator[Bgr]:
    """The film's frames (480, 1280, 3), one per sample."""
    page = np.full((HEIGHT, WIDTH, 3), PAPER, np.uint8)
    lane_view = whole_lane(LANE_SIZE)
    lane = draw_lane(film.layout, lane_view)
    _write(page, film.title, (12, 26), 0.62)
    for name, (x, y) in (("camera", CAMERA_AT), ("DVS: ON blue, OFF red", DVS_AT), ("map", NEAR_AT)):
        _write(page, name, (x, y - 8), 0.42, FAINT)
    _write(page, "the whole lane, start on the left", (LANE_AT[0], LANE_AT[1] - 8), 0.42, FAINT)
    playback = _playback(film, frames_per_s)
    for i in range(len(film)):
        picture, track = page.copy(), film.position_m[: i + 1, :2]
        _write(picture, f"{_moment(film, i)}, shown at {playback:.1f}x", (WIDTH - 12, 26), 0.62, right=True)
        _paste(picture, _camera(film.images[i], PANEL), CAMERA_AT)
        _paste(picture, dvs_picture(film.on_events[i], film.off_events[i], PANEL), DVS_AT)
        near_view = follow(track[-1], NEAR_SIZE)
        _paste(picture, draw_track(draw_lane(film.layout, near_view), near_view, track), NEAR_AT)
        _paste(picture, draw_track(lane.copy(), lane_view, track), LANE_AT)
        yield picture


def write_contact_sheet(film: Film, path: Path) -> Path:
    """Write a PNG of at most 20 moments, evenly spread: camera above DVS; returns `path`."""
    count = min(SHEET_COLUMNS * SHEET_ROWS, len(film))
    chosen = np.unique(np.linspace(min(1, len(film) - 1), len(film) - 1, count).round().astype(int))
    cell_width, cell_height = THUMB[0] + SHEET_GAP, 2 * THUMB[1] + SHEET_CAPTION + SHEET_GAP
    rows = -(-len(chosen) // SHEET_COLUMNS)
    shape = (44 + rows * cell_height, SHEET_GAP + SHEET_COLUMNS * cell_width, 3)
    sheet = np.full(shape, PAPER, np.uint8)
    _write(sheet, film.title, (SHEET_GAP, 28), 0.62)
    for place, i in enumerate(chosen):
        x = SHEET_GAP + place % SHEET_COLUMNS * cell_width
        y = 44 + place // SHEET_COLUMNS * cell_height
        _write(sheet, _moment(film, i), (x, y + 16), 0.42, FAINT)
        _paste(sheet, _camera(film.images[i], THUMB), (x, y + SHEET_CAPTION))
        _paste(
            sheet,
            dvs_picture(film.on_events[i], film.off_events[i], THUMB),
            (x, y + SHEET_CAPTION + THUMB[1]),
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), sheet):
        raise UserError(f"{path}: cannot be written")
    return path


def dvs_picture(on: NDArray[np.integer], off: NDArray[np.integer], size: tuple[int, int]) -> Bgr:
    """Event counts (H, W) as a picture of `size` (width, height): the more events, the deeper the colour."""
    picture = np.full((*on.shape, 3), NO_EVENT, np.float32)
    for counts, colour in ((on, ON), (off, OFF)):
        depth = np.minimum(counts / FULL_COLOUR_FROM, 1.0)[..., None]
        picture += depth * (np.array(colour, np.float32) - NO_EVENT)
    return _resized(np.clip(picture, 0, 255).astype(np.uint8), size)


def _camera(image: Bgr, size: tuple[int, int]) -> Bgr:
    code = cv2.COLOR_GRAY2BGR if image.ndim == 2 else cv2.COLOR_RGB2BGR
    return _resized(np.asarray(cv2.cvtColor(image, code), np.uint8), size)


def _resized(picture: Bgr, size: tuple[int, int]) -> Bgr:
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST), np.uint8)


def _paste(page: Bgr, picture: Bgr, at: tuple[int, int]) -> None:
    x, y = at
    page[y : y + picture.shape[0], x : x + picture.shape[1]] = picture


def _moment(film: Film, i: int) -> str:
    return f"{film.time_s[i]:6.2f} s, {film.position_m[i, 0]:5.1f} m"


def _playback(film: Film, frames_per_s: int) -> float:
    """Simulated seconds per second of film."""
    flown_s = float(film.time_s[-1] - film.time_s[0])
    return flown_s * frames_per_s / max(len(film) - 1, 1)


def _write(
    page: Bgr, text: str, at: tuple[int, int], size: float, colour: Any = INK, right: bool = False
) -> None:
    """Text whose baseline starts, or with `right` ends, at `at`."""
    font = cv2.FONT_HERSHEY_SIMPLEX
    x, y = at
    if right:
        x -= cv2.getTextSize(text, font, size, 1)[0][0]
    cv2.putText(page, text, (x, y), font, size, colour, 1, cv2.LINE_AA)
