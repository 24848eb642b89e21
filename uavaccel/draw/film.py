"""A game as a film, H.264 in an MP4 that browsers play, or as a contact sheet, a PNG.

Camera, DVS and map are side by side; below them, where they are known, are the view from behind, the network's input
and its ratings of the actions. The moment of impact is marked, and its frame is held.

Everything is rendered from plain arrays, so that any images of a lane can be shown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.draw.style import BLUE, GREEN, VERMILION, Bgr, Decisions, bgr, dvs_picture
from uavaccel.errors import UserError, naming
from uavaccel.files import replacing
from uavaccel.sim.clutter import BOX, COS, HALF_X, HALF_Y, KIND, SIN, ClutterLayout, X, Y
from uavaccel.sim.lane import HULL_RADIUS_M, LENGTH_M, WIDTH_M, LaneLayout

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


# --- panels ---------------------------------------------------------------------------------------------------------

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


GROUND, WALL = (240, 240, 240), (110, 110, 110)
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
    picture = blank(view.size, GROUND)
    if not isinstance(layout, LaneLayout):
        for row in layout.rows[layout.standing] if layout else ():  # a shape's outline from above
            along, across = (CORNERS if int(row[KIND]) == BOX else ROUND).T * row[HALF_X : HALF_Y + 1, None]
            north, west = row[X] + row[COS] * along - row[SIN] * across, row[Y] + row[SIN] * along + row[COS] * across
            cv2.fillPoly(picture, [view.pixels(np.stack([north, -west], axis=1))], OBSTACLE, cv2.LINE_AA, SUBPIXEL)
        return picture
    half = WIDTH_M / 2
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
HEADROOM, FOOT = 24, 40  # pixels above the bars for their values, and below for their headings


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
    scale = (height - HEADROOM - FOOT) / ((1.0 + LEAST) * spread)
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
