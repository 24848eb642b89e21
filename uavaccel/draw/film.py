"""A game as a film, H.264 in an MP4 that browsers play, or as a contact sheet, a PNG.

Camera, DVS and map are side by side; below them, where they are known, are the view from behind, the network's input
and its ratings of the actions. The moment of impact is marked, and its frame is held.

Everything is rendered from plain arrays, so that any images of a lane can be shown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.panels import (
    FAINT,
    INK,
    around,
    blank,
    draw_given,
    draw_impact,
    draw_lane,
    draw_ratings,
    draw_target,
    draw_track,
    enlarged,
    follow,
    paste,
    to_bgr,
    whole_lane,
    write,
)
from uavaccel.draw.style import VERMILION, Bgr, Decisions, bgr, dvs_picture
from uavaccel.errors import UserError, naming
from uavaccel.files import replacing
from uavaccel.sim.clutter import ClutterLayout
from uavaccel.sim.lane import LaneLayout

FRAMES_PER_S = 12
WIDTH, HEIGHT = 1280, 480
PANEL = (512, 288)  # width and height of camera and DVS: twice the camera's own
CAMERA_AT, DVS_AT, NEAR_AT, LANE_AT = (12, 64), (536, 64), (1060, 64), (12, 380)
NEAR_SIZE, LANE_SIZE = (208, 288), (1256, 86)
SECOND_ROW = 328  # pixels lower than the first; the lane is as much lower where there is one
MARGIN = 14  # pixels below the first row where there is no lane, above another
HELD_S = 2.0  # seconds of film for which the frame of an impact is held

IMPACT = bgr(VERMILION)

SHEET_COLUMNS, SHEET_ROWS, SHEET_GAP, SHEET_CAPTION = 5, 4, 10, 24
THUMB = (256, 144)
POSTER_WIDTH = 960

# x264's options for images half of text and edges: bits go where the error is, so that counting numbers stay legible.
# The event of a single pixel is still visible. The preset medium halves the file and takes five times as long.
X264 = {"crf": "38", "preset": "ultrafast", "aq-mode": "0", "psy": "0", "x264-params": "cabac=1"}
LARGEST = 3_000_000  # bytes of a game's film: where it would be larger, it is less sharp
BT709, BT601, LIMITED_RANGE = 1, 6, 1  # as FFmpeg and H.264 number them: players need not guess


@dataclass(frozen=True)
class Film:
    """A game's n samples: times (n,), images (n, H, W) gray or (n, H, W, 3) RGB, DVS event counts (n, H, W), and
    positions NED (n, 3).

    The whole of a lane is below all else; elsewhere the map is of the whole flight, with what is to be reached at
    `target_m` (3,). `chase` renders the view of a sample from behind, RGB, as large as PANEL. `hit` names the object of
    a collision at the last sample; empty if there was none.
    """

    title: str
    time_s: NDArray[np.float64]
    images: NDArray[np.uint8]
    on_events: NDArray[np.integer]
    off_events: NDArray[np.integer]
    position_m: NDArray[np.float64]
    layout: LaneLayout | ClutterLayout | None
    chase: Callable[[int], NDArray[np.uint8]] | None = None
    decisions: Decisions | None = None
    hit: str = ""
    target_m: Sequence[float] | None = None

    @property
    def in_lane(self) -> bool:
        return isinstance(self.layout, LaneLayout)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its frames."""
        return WIDTH, (HEIGHT if self.in_lane else NEAR_AT[1] + NEAR_SIZE[1] + MARGIN) + self.lower

    @property
    def lower(self) -> int:
        """Pixels by which a second row lowers the lane."""
        return SECOND_ROW if self.chase is not None or self.decisions is not None else 0

    def __len__(self) -> int:
        return len(self.time_s)


def write_video(film: Film, path: Path, written: Callable[[], object] = lambda: None) -> Path:
    """Write an MP4 of the film's frames, whole or not at all, and return `path`; `written` is called after each frame.

    Raises UserError if it cannot be written.
    """
    seconds = len(film) / FRAMES_PER_S + (HELD_S if film.hit else 0.0)
    with movie(path, film.size, FRAMES_PER_S, seconds) as add:
        for picture in frames(film):
            add(picture)
            written()
    return path


def frames(film: Film) -> Iterator[Bgr]:
    """Yield the film's frames, in a lane (480, 1280, 3), (808, 1280, 3) with a second row, as images of `film.size`.

    There is one for each sample, and more of an impact.
    """
    page, cameras = _page(film), [CAMERA_AT] if film.chase is None else [CAMERA_AT, _below(CAMERA_AT)]
    target = [] if film.target_m is None else [film.target_m[:2]]
    near_view = around(np.array([*film.position_m[:, :2], *target]), NEAR_SIZE)  # of the whole flight
    lane_view, lane, ground = whole_lane(LANE_SIZE), None, None
    if film.in_lane:
        lane = draw_lane(film.layout, lane_view)
    else:
        ground = draw_lane(film.layout, near_view)
        if film.target_m is not None:
            draw_target(ground, near_view, film.target_m)
    simulated_s = float(film.time_s[-1] - film.time_s[0])
    playback = simulated_s * FRAMES_PER_S / max(len(film) - 1, 1)  # simulated seconds per second of film
    decided = lru_cache(maxsize=1)(partial(_decision, film.decisions))  # a command has several samples
    for i in range(len(film)):
        picture, track = page.copy(), film.position_m[: i + 1, :2]
        hit = film.hit if i == len(film) - 1 else ""
        caption = f"hit {hit}: {_moment(film, i)}" if hit else f"{_moment(film, i)}, shown at {playback:.1f}x"
        write(picture, caption, (WIDTH - 12, 26), 0.62, IMPACT if hit else INK, anchor=1.0)
        paste(picture, to_bgr(film.images[i], PANEL), CAMERA_AT)
        paste(picture, enlarged(dvs_picture(film.on_events[i], film.off_events[i]), PANEL), DVS_AT)
        if ground is None:
            near_view = follow(track[-1], NEAR_SIZE)
        near = draw_track(draw_lane(film.layout, near_view) if ground is None else ground.copy(), near_view, track)
        if film.chase is not None:
            paste(picture, to_bgr(film.chase(i), PANEL), _below(CAMERA_AT))
        for panel, at in decided(0 if film.decisions is None else int(film.decisions.of_sample[i])):
            paste(picture, panel, at)
        if hit:
            draw_impact(near, near_view, track[-1])
            for x, y in cameras:
                cv2.rectangle(picture, (x + 2, y + 2), (x + PANEL[0] - 3, y + PANEL[1] - 3), IMPACT, 5)
        paste(picture, near, NEAR_AT)
        if lane is not None:
            whole = draw_track(lane.copy(), lane_view, track)
            whole = draw_impact(whole, lane_view, track[-1]) if hit else whole
            paste(picture, whole, (LANE_AT[0], LANE_AT[1] + film.lower))
        yield from [picture] * (round(HELD_S * FRAMES_PER_S) if hit else 1)


def _page(film: Film) -> Bgr:
    """Return what all frames share: the title, and the panels' captions."""
    page = blank(film.size)
    write(page, film.title, (12, 26), 0.62)
    names = [("camera", CAMERA_AT), ("DVS: ON blue, OFF red", DVS_AT), ("map", NEAR_AT)]
    if film.in_lane:
        names.append(("the whole lane, start on the left", (LANE_AT[0], LANE_AT[1] + film.lower)))
    if film.chase is not None:
        names.append(("from behind", _below(CAMERA_AT)))
    if film.decisions is not None:
        names.append((film.decisions.rated_as, _below(NEAR_AT)))
        if film.decisions.given is not None:
            count, rows, columns = film.decisions.given.shape[1:]
            text = f"what the network is given: {count} of {columns} x {rows}, the oldest first"
            names.append((text, _below(DVS_AT)))
    for name, (x, y) in names:
        write(page, name, (x, y - 8), 0.42, FAINT)
    return page


def _decision(decisions: Decisions | None, command: int) -> list[tuple[Bgr, tuple[int, int]]]:
    """Return the panels of a command's decision with their places."""
    if decisions is None:
        return []
    panels = [(draw_ratings(decisions, command, NEAR_SIZE), _below(NEAR_AT))]
    if decisions.given is not None:
        panels.append((draw_given(decisions.given[command], PANEL), _below(DVS_AT)))
    return panels


def _below(at: tuple[int, int]) -> tuple[int, int]:
    return at[0], at[1] + SECOND_ROW


def write_contact_sheet(film: Film, path: Path) -> Path:
    """Write a PNG of at most 20 moments, evenly spaced, camera above DVS, and return `path`."""
    count = min(SHEET_COLUMNS * SHEET_ROWS, len(film))
    chosen = np.unique(np.linspace(min(1, len(film) - 1), len(film) - 1, count).round().astype(int))
    cell_width, cell_height = THUMB[0] + SHEET_GAP, 2 * THUMB[1] + SHEET_CAPTION + SHEET_GAP
    rows = -(-len(chosen) // SHEET_COLUMNS)
    sheet = blank((SHEET_GAP + SHEET_COLUMNS * cell_width, 44 + rows * cell_height))
    write(sheet, film.title, (SHEET_GAP, 28), 0.62)
    right = sheet.shape[1] - SHEET_GAP
    write(sheet, "camera, and below it DVS: ON blue, OFF red", (right, 28), 0.42, FAINT, anchor=1.0)
    for place, i in enumerate(chosen):
        x = SHEET_GAP + place % SHEET_COLUMNS * cell_width
        y = 44 + place // SHEET_COLUMNS * cell_height
        hit = film.hit if i == len(film) - 1 else ""
        write(sheet, f"{_moment(film, i)}{', hit' if hit else ''}", (x, y + 17), 0.5, IMPACT if hit else INK)
        paste(sheet, to_bgr(film.images[i], THUMB), (x, y + SHEET_CAPTION))
        events = enlarged(dvs_picture(film.on_events[i], film.off_events[i]), THUMB)
        paste(sheet, events, (x, y + SHEET_CAPTION + THUMB[1]))
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), sheet):
        raise UserError(f"{path}: cannot be written")
    return path


def _moment(film: Film, i: int) -> str:
    if film.target_m is None:
        return f"{film.time_s[i]:6.2f} s, {film.position_m[i, 0]:5.1f} m"
    return f"{film.time_s[i]:6.2f} s, {np.linalg.norm(film.position_m[i] - film.target_m):5.1f} m to go"


def poster(path: Path) -> bytes:
    """Return the frame in the middle of a film as a JPEG, POSTER_WIDTH wide; nothing of what is no film."""
    import av

    try:
        with av.open(str(path)) as file:
            middle_s = (file.duration or 0) / av.time_base / 2
            picture = next(frame for frame in file.decode(video=0) if frame.time >= middle_s).to_ndarray(format="bgr24")
    except (OSError, av.FFmpegError, StopIteration):
        return b""
    height = round(POSTER_WIDTH * picture.shape[0] / picture.shape[1])
    small = cv2.resize(picture, (POSTER_WIDTH, height), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", small, (cv2.IMWRITE_JPEG_QUALITY, 80))[1].tobytes()


@contextmanager
def movie(
    path: Path, size: tuple[int, int], frames_per_s: int, seconds: float | None = None
) -> Iterator[Callable[[Bgr], None]]:
    """Yield a function that adds an image of `size` (width, height) to an MP4, which is written whole or not at all.

    If it is known how long it will be, `seconds`, it has LARGEST bytes at most. It is H.264 in 4:2:0 with the index
    in front, so that it plays from the first byte on, encoded in one thread and without dates, so that equal films
    are equal files. Raises UserError where it cannot be written, at the end too if the first error was caught.
    """
    import av  # FFmpeg is needed for films alone

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file, _encoding(file.name, size, frames_per_s, seconds) as add:
            yield add
    except (OSError, av.FFmpegError, av.codec.codec.UnknownCodecError) as error:
        raise UserError(f"{path}: cannot be written: {error}") from error


@contextmanager
def _encoding(
    name: str, size: tuple[int, int], frames_per_s: int, seconds: float | None
) -> Iterator[Callable[[Bgr], None]]:
    import av

    limit: dict[str, str] = {}
    if seconds is not None:  # the decoder's buffer holds a second, and is full at first
        rate = str(int(8 * 0.97 * LARGEST / (seconds + 1.0)))  # without the file's index
        limit = {"maxrate": rate, "bufsize": rate}

    with av.open(name, "w", format="mp4", options={"movflags": "+faststart", "fflags": "+bitexact"}) as file:
        stream = file.add_stream("libx264", rate=frames_per_s, options=X264 | limit)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        context = stream.codec_context
        context.thread_count = 1
        context.color_primaries = context.color_trc = BT709
        context.colorspace = BT601  # the luma of OpenCV, which converts five times as fast as FFmpeg
        context.color_range = LIMITED_RANGE

        refused: list[str] = []

        def encode(frame: av.VideoFrame | None) -> None:
            if refused:  # PyAV crashes if it goes on with a file whose beginning could not be written
                raise UserError(refused[0])
            try:
                with naming(Path(name)):
                    file.mux(stream.encode(frame))
            except UserError as error:
                refused.append(str(error))
                raise

        def add(picture: Bgr) -> None:
            planes = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420), np.uint8)
            encode(av.VideoFrame.from_ndarray(planes, format="yuv420p"))

        yield add
        encode(None)
