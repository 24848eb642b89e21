"""A flight of a run, whichever suite flew it: what the page in the browser, films and exports show."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.errors import UsageError, UserError
from uavaccel.files import inside
from uavaccel.forms import ArrayForm
from uavaccel.own_code import errors_named, files_of
from uavaccel.sim.lane import LaneLayout
from uavaccel.units import NS_PER_S, to_ns

if TYPE_CHECKING:  # they load what draws
    from uavaccel.draw.film import Film
    from uavaccel.draw.style import Decisions
    from uavaccel.sim.clutter import ClutterLayout
    from uavaccel.vision.dvs import DvsParameters

ARRAYS = ("time_s", "position_m", "orientation_wxyz", "command_start_s", "command_end_s")
"""What `Flight.of` needs of a game's arrays; a recording of the simulation has them."""
FLIGHT = {
    "time_s": ArrayForm("fiu", ("samples",), ascends=True),
    "position_m": ArrayForm("fiu", ("samples", 3)),
    "orientation_wxyz": ArrayForm("fiu", ("samples", 4)),
    "linear_velocity_m_s": ArrayForm("fiu", ("samples", 3), optional=True),
    **dict.fromkeys(("command_start_s", "command_end_s"), ArrayForm("fiu", ascends=True)),
}
"""Their forms in a suite of one's own, whose numbers may be of any type."""
Times = NDArray[np.int64]
Floats = NDArray[np.float64]
Counts = NDArray[np.integer]
NOT_SHOWN = nullcontext[Callable[[], object]](lambda: None)


class Commands(NamedTuple):
    """The c commands of a flight: when each began and ended, and its velocity (c, 3) NED in m/s.

    That is (0, 3) if it is unknown, and NaN for what asks for no velocity."""

    start_ns: Times
    end_ns: Times
    velocity_m_s: Floats


class Window(NamedTuple):
    """Events up to `time_ns`, since the window before: rows (n, 4), t in s, x, y, p = 1 or -1.

    `counts`, ON and OFF per pixel (H, W), stands in where a run kept counts alone.
    """

    time_ns: int
    rows: NDArray[np.floating] | None
    counts: tuple[Counts, Counts] | None = None

    def per_pixel(self, shape: tuple[int, int]) -> tuple[Counts, Counts]:
        """Return ON and OFF events of each pixel of a camera of this shape."""
        if self.counts is not None:
            return self.counts
        on, off = np.zeros((2, *shape), np.int32)
        if self.rows is not None:
            x, y, positive = self.rows[:, 1].astype(int), self.rows[:, 2].astype(int), self.rows[:, 3] > 0
            np.add.at(on, (y[positive], x[positive]), 1)
            np.add.at(off, (y[~positive], x[~positive]), 1)
        return on, off


@dataclass(frozen=True)
class Flight:
    """One flight: n samples, NED metres, attitudes body FRD to NED; times in integer ns of simulated time."""

    title: str
    """Who flew, how fast, and how it ended."""
    clock_speed: float
    time_ns: Times
    position_m: Floats
    """(n, 3)"""
    orientation_wxyz: Floats
    """(n, 4)"""
    commands: Commands
    velocity_m_s: Floats | None = None
    """(n, 3), where it was recorded."""
    scene: str = "blocks"
    lane: LaneLayout | ClutterLayout | None = None
    """Where obstacles stand that are not of the scene itself."""
    target_m: Sequence[float] | None = None
    """(3,), what is to be reached, where the environment says so."""
    image_ns: Times = field(default_factory=lambda: np.zeros(0, np.int64))
    images: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 0), np.uint8))
    """(m, H, W) gray, or (m, H, W, 3) RGB."""
    windows: Sequence[Window] = ()
    """What an event camera saw."""
    collision: tuple[int, str] | None = None
    """When it hit something, and what."""
    decisions: Decisions | None = None
    """What a policy saw and how it rated the actions."""

    def __post_init__(self) -> None:
        """Raise UserError for arrays that do not fit together, as a suite of one's own may give."""
        samples, images = len(self.time_ns), self.images
        wanted = {
            "position_m": (self.position_m, (samples, 3)),
            "orientation_wxyz": (self.orientation_wxyz, (samples, 4)),
            "velocity_m_s": (self.velocity_m_s, (samples, 3)),
            "commands.end_ns": (self.commands.end_ns, (len(self.commands.start_ns),)),
            "images": (images, (len(self.image_ns), *images.shape[1:3], *[3] * (images.ndim > 3))),
        }
        for name, (array, shape) in wanted.items():
            if array is not None and np.shape(array) != shape:
                raise UserError(f"{self.title}: {name} has the shape {np.shape(array)}, not {shape}")
            if array is not None and not np.isfinite(array).all():
                raise UserError(f"{self.title}: {name} has numbers that are not finite")
        if images.dtype != np.uint8 or images.ndim < 3:
            raise UserError(f"{self.title}: images are {images.dtype} {images.shape}, not uint8 (n, H, W) or RGB")
        if not np.any(self.orientation_wxyz, axis=1).all():
            raise UserError(f"{self.title}: orientation_wxyz has an attitude of length 0")
        height, width = images.shape[1:3] if images.size else (np.inf, np.inf)
        for window in self.windows:
            if window.counts is not None and images.size and np.shape(window.counts) != (2, height, width):
                raise UserError(
                    f"{self.title}: windows count {np.shape(window.counts)} events, not {(2, height, width)}"
                )
            pixels = np.reshape([] if window.rows is None else window.rows, (-1, 4))[:, 1:3]
            if not ((pixels >= 0) & (pixels < (width, height))).all():
                raise UserError(f"{self.title}: windows have events outside the images of {width} x {height}")

    @classmethod
    def of(
        cls, title: str, clock_speed: float, arrays: Mapping[str, Any], velocity_m_s: ArrayLike = (), **more: Any
    ) -> Flight:
        """Return the flight that a recording has, as arrays with the names in ARRAYS; `more` are further fields."""
        velocities = np.array(velocity_m_s, float).reshape(-1, 3)
        commands = Commands(to_ns(arrays["command_start_s"]), to_ns(arrays["command_end_s"]), velocities)
        poses = to_ns(arrays["time_s"]), arrays["position_m"], arrays["orientation_wxyz"]
        return cls(title, clock_speed, *poses, commands, arrays.get("linear_velocity_m_s"), **more)


def windows_of(
    images: NDArray[np.uint8], time_ns: Times, parameters: DvsParameters, sensor_seed: int
) -> Iterator[Window]:
    """Yield the events between gray images (n, H, W) taken at times (n,); n - 1 windows."""
    from uavaccel.vision.dvs import EventCounter, make_sensor

    counter = EventCounter(make_sensor(parameters, images.shape[1:], sensor_seed), listed=True)
    counter.start(images[0], int(time_ns[0]), sensor_seed)
    for image, at in zip(images[1:], time_ns[1:].tolist(), strict=True):
        counter.process_frame(image, at)
        yield Window(at, counter.pop_events())


def flight_of(
    source: str | Path, case: str | None = None, game: int | None = None, pictures: bool = True
) -> tuple[str, Flight]:
    """Return the name and the flight of a run's game, by its case or its line in rows.jsonl, or of a policy's.

    `source` is a run directory, or a policy: "default", its folder, a training's run directory, which flies the
    evaluation lane, or the game, `case`, by default the first. By default a run's game is the most interesting. With
    `pictures` the flight has images, where the run keeps them or can fly its games again. Raises UserError if there is
    no such game.
    """
    from uavaccel.config import validate
    from uavaccel.rl.agents import policy_folder  # they load what learns
    from uavaccel.rl.config import LANE
    from uavaccel.rl.policy import MANIFEST
    from uavaccel.suites.evaluate import EvaluateConfig, case_of, completed
    from uavaccel.suites.evaluate_again import flight_of_agent
    from uavaccel.suites.registry import open_run, suite_of
    from uavaccel.suites.suite import choose_row

    if not (policy_folder(str(source)) / MANIFEST).is_file():
        run = open_run(source)
        suite = suite_of(run)
        report = suite.report(run)
        row = choose_row(suite, report, case, game)
        with errors_named(files_of(type(suite))):
            return str(row["case"]), suite.flight(report, row, pictures=pictures)
    if game is not None:
        raise UsageError(f"--game {game}: {source} is a policy, which flies a lane: --case lane-000007")
    keys = completed({"agent": str(source), "task": {"timing": "lockstep"}})
    config = validate(EvaluateConfig, keys, str(source))
    in_lane = config.env_id == LANE
    case = case or case_of(0, in_lane)
    number = re.fullmatch(r"lane-(\d+)" if in_lane else r"game-(\d+)", case)
    if not number:
        what = "an evaluation lane" if in_lane else "a game"
        raise UserError(f"--case {case}: must be {what}, as {case_of(7, in_lane)}")
    if in_lane:
        config.task.wire_lane(int(number[1]))  # refuses one that there is not
    return case, flight_of_agent(config, int(number[1]), pictures)


def film_game(
    source: str | Path,
    case: str | None = None,
    game: int | None = None,
    movie: Path | None = None,
    working: Callable[[str, int], AbstractContextManager[Callable[[], object]]] = lambda name, steps: NOT_SHOWN,
) -> tuple[Path, Path]:
    """Write the film of a game, as `flight_of` finds it, and its contact sheet beside it, and return their paths.

    By default they are below films/ in the run. `working` opens what shows the progress of so many steps, 0 if their
    number is unknown, and gives what is called after each. Raises UserError where nothing can draw, there is no such
    game, or it has no images.
    """
    from uavaccel.draw.style import check_films

    check_films()
    from uavaccel.draw.film import write_contact_sheet, write_video

    with working("the game", 0):
        name, flight = flight_of(source, case, game)
        movie, film = movie or inside(Path(source), f"films/{name}.mp4"), film_of(flight)
    with working(movie.name, len(film)) as written:
        write_video(film, movie, written=written)
    return movie, write_contact_sheet(film, movie.with_suffix(".png"))


def film_of(flight: Flight) -> Film:
    """Return the film of a flight, a frame for each of its images. Raises UserError for one without images."""
    from uavaccel.draw.chase import ChaseView
    from uavaccel.draw.film import PANEL, Film

    if not len(flight.images):
        raise UserError(f"{flight.title}: has no images to film")
    shape, last_ns = flight.images.shape[1:3], int(flight.image_ns[-1])
    on, off = np.zeros((2, len(flight.images), *shape), np.uint16)
    for window in flight.windows:
        seen = min(int(np.searchsorted(flight.image_ns, window.time_ns)), len(on) - 1)
        for counts, more in zip((on, off), window.per_pixel(shape), strict=True):
            counts[seen] += more.astype(np.uint16)
    at = np.searchsorted(flight.time_ns[:-1], flight.image_ns)  # the last sample's, where an image comes after it
    position_m, lane = flight.position_m[at], flight.lane
    return Film(
        flight.title,
        (flight.image_ns - flight.image_ns[0]) / NS_PER_S,
        flight.images,
        on,
        off,
        position_m,
        lane,
        chase=ChaseView(flight.scene, lane, position_m, flight.orientation_wxyz[at], PANEL, flight.target_m),
        target_m=flight.target_m,
        decisions=flight.decisions,
        hit=flight.collision[1] if flight.collision and flight.collision[0] <= last_ns else "",
    )
