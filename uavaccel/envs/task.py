"""A learning task: what is drawn at reset, what an action means, what is seen, and reward, success and ends.

The cut is that of dm_control: physics, environment and task are three things. A task is a configuration, whose keys are
the environment's keywords, and a few pure functions of what happened, each of which a subclass may replace.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field, model_validator

from uavaccel.commands.slices import check_times, samples_due
from uavaccel.config import Config
from uavaccel.envs.sensors import Sensor, blank_frame, make_sensor, state_fields
from uavaccel.envs.told import ContextPlanes
from uavaccel.envs.values import Action, Course, Info, Number
from uavaccel.errors import UserError
from uavaccel.kinematics import Kinematics, Vector, VelocityGoal
from uavaccel.limits import ClockSpeed, Cost, Height, Seconds, Seed, Speed
from uavaccel.sim.lane.layout import PLAIN, LaneLayout
from uavaccel.sim.profile import PROFILES
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs_sensor import PRESETS, DvsParameters, with_noise, with_thresholds
from uavaccel.wire.latency import LatencyModel, of_the_profile

NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]

RATE_ROUNDING = 1e-4  # of a rate that is written with few digits, as 333.33
AT_REST = Kinematics(0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Moment(NamedTuple):
    """What is known at a game's start and at the end of each command.

    A task's functions take one game's, or a `Moments` of many: what they compute is arithmetic on its numbers, the same
    for one float and for an array of them.
    """

    state: Kinematics
    """Of the last sample."""
    position_m: Vector
    """Where the vehicle is, or where it hit something: NED."""
    collision: str | None
    """What it hit."""
    commands: int
    """Flown so far."""
    course: Course
    """The task's own: what it drew, and what became of it. Plain numbers, lists and mappings."""

    @property
    def touched(self) -> bool:
        return self.collision is not None

    @property
    def free(self) -> bool:
        return self.collision is None


class Moments(NamedTuple):
    """The same of many games: where `Moment` has a number, an array (n,) of NumPy or a tensor of PyTorch."""

    state: Kinematics | None
    """Of arrays."""
    position_m: Sequence[Number]
    """Three arrays: north, east, down."""
    touched: Number
    commands: Number
    course: Course
    """What is a list of numbers in a game's course is a list of arrays."""

    @property
    def free(self) -> Number:
        return ~self.touched


AnyMoment: TypeAlias = Any  # a Moment or Moments; a task of one's own may be written for either alone


class Task(Config):
    """Keys that all tasks share, and the functions that make one; those below `actions` are to be replaced."""

    scene: ClassVar[str] = "blocks"
    reset_options: ClassVar[tuple[str, ...]] = ()
    """Keys that `reset(options=...)` may have."""
    sees_start: ClassVar[bool] = True
    """Whether the first observation is of the start; else its frames are blank."""

    observation: Literal["dvs", "state", "colour", "depth"] = "state"
    history: Annotated[int, Field(ge=1, le=8)] = 1
    """Commands whose frames are in one observation, the newest last."""
    blank_images: bool = False
    """Frames without content, for the baseline that shows what can be learned without seeing."""
    dvs_preset: Literal["clean", "constructor", "command_line", "noisy"] = "clean"
    """Which of v2e's parameter sets the event camera has."""
    dvs_seed: Seed = 0
    """Draws the thresholds of the sensor's pixels, which stay as they are from game to game."""
    dvs_threshold_ratio: Positive = 1.0
    """Times the preset's contrast thresholds."""
    dvs_spread_ratio: NotNegative = 1.0
    """Times their spread from pixel to pixel."""
    dvs_shot_noise_hz: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """Noise events per second of a black pixel, a quarter of them of a white one, beside the preset's: at most one ON
    and one OFF per frame that the event camera sees."""
    dvs_leak_hz: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """ON events per second of a pixel that sees no change, beside the preset's."""
    dvs_hot_pixels: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Share of the pixels that make 10 ON events per second, whatever they see; the sensor's, drawn by dvs_seed."""
    image_noise: Annotated[float, Field(ge=0.0, le=255.0)] = 0.0
    """Standard deviation of each picture's Gaussian noise, of 255 grey levels, before the event camera sees it."""

    dvs_rate_hz: Positive | None = None
    """Frames per simulated second that the event camera sees, up to every step of the physics; else one per sample."""
    list_events: bool = False
    """Whether the event camera keeps its events one by one, for `take_events`."""

    command: Literal["adsc", "tcsc"] = "tcsc"
    """tcsc pauses the simulation while the agent decides and learns, adsc does not."""
    t_move_s: Seconds = 0.2
    t_sample_s: Seconds = 0.2
    speed_m_s: Speed = 1.0
    """Metres per second of a command."""
    altitude_m: Height = 10.0
    """Of the start."""
    max_commands: Count = 100

    timing: Literal["wall", "virtual", "lockstep"] = "lockstep"
    """Which wall clock: wall is measured, virtual is simulated with latencies, lockstep has none."""
    clock_speed: ClockSpeed = 1.0
    """Simulated seconds per wall second that are asked for."""
    profile: Literal["native", "airsim"] = "native"
    """How the simulator handles time: native is exact to the step, airsim behaves like AirSim."""
    t_th_wall_s: Cost = 0.001
    """TCSC's T_th, the client's latency; used by `airsim` alone, whose continue-for may end early."""
    latency: LatencyModel = Field(default_factory=of_the_profile)
    """The latency model that `virtual` draws from, or the YAML file of one; the shipped one where none is given."""
    image_processing_s: Cost = 0.0003
    """What the DVS of one frame costs the simulated wall clock of `virtual`."""
    report_host_times: bool = False
    """Whether infos have `host_phase_s`, measured on this machine's clock: never the same twice."""

    @model_validator(mode="after")
    def _times_fit(self) -> Self:
        profile = PROFILES[self.profile]
        check_times(self.t_move_s, self.t_sample_s, profile.check_duration)
        return self

    @model_validator(mode="after")
    def _events_come_from_a_dvs(self) -> Self:
        if self.dvs_rate_hz is None and not self.list_events:
            return self
        if self.observation != "dvs" or self.timing == "wall":
            raise ValueError(
                "dvs_rate_hz and list_events need observation dvs, and timing virtual or lockstep"
            )
        period_s = (self.dvs_ticks or 0) * PROFILES[self.profile].tick_s
        if period_s > self.t_sample_s * (1 + RATE_ROUNDING):
            raise ValueError(
                f"dvs_rate_hz = {self.dvs_rate_hz:g}: must give a frame in each sample of {self.t_sample_s:g} s"
            )
        return self

    @model_validator(mode="after")
    def _noise_is_of_pictures(self) -> Self:
        if self.image_noise and self.observation == "depth":
            raise ValueError("image_noise is of grey levels: it needs observation dvs or colour")
        return self

    @property
    def dvs_ticks(self) -> int | None:
        """Ticks from one of the event camera's frames to the next; None: it sees the samples alone."""
        return None if self.dvs_rate_hz is None else rate_ticks(self.dvs_rate_hz, self.profile)

    @property
    def scenery(self) -> str:
        """What its scene looks like."""
        return PLAIN

    @property
    def t_th_ns(self) -> int:
        """TCSC's T_th in simulated nanoseconds (Profile.t_th_ns)."""
        return PROFILES[self.profile].t_th_ns(self.t_th_wall_s, self.clock_speed, self.t_sample_s)

    # --- senses -----------------------------------------------------------------------------------

    @property
    def frames_per_command(self) -> int:
        return len(samples_due(self.t_move_s, self.t_sample_s))

    def sensor(self) -> Sensor:
        """What turns samples into frames."""
        return make_sensor(
            self.observation,
            self.features,
            self._blank_features(),
            self.dvs_parameters,
            self.dvs_seed,
            self.list_events,
        )

    def _blank_features(self) -> NDArray[np.float32]:
        return np.zeros_like(self.features(AT_REST, self.draw(np.random.default_rng(0), {})))

    @property
    def dvs_parameters(self) -> DvsParameters:
        """The event camera's."""
        noise = self.dvs_shot_noise_hz, self.dvs_leak_hz, self.dvs_spread_ratio, self.dvs_hot_pixels
        return _parameters(self.dvs_preset, self.dvs_threshold_ratio, *noise)

    def events_seed(self, seed: int) -> int:
        """Of the event camera's noise in a game of that seed; v2e's presets by themselves have one for all games."""
        return seed if self.dvs_shot_noise_hz > 0.0 or self.dvs_leak_hz > 0.0 else 0

    def observation_space(self) -> spaces.Box:
        """Of the frames of `history` commands, stacked along the first axis, and what else the agent is told."""
        blank = self._blank_features() if self.observation == "state" else blank_frame(self.observation)
        told = self.told()
        planes = 0 if told is None else told.planes
        shape = (self.frames_per_command * self.history * blank.shape[0] + planes, *blank.shape[1:])
        if blank.dtype == np.uint8:
            return spaces.Box(0, 255, shape, np.uint8)
        return spaces.Box(-np.inf, np.inf, shape, np.float32)

    def told(self) -> ContextPlanes | None:
        """What the agent is told beside its frames."""
        return None

    def fields(self, state: Kinematics, course: Course) -> Sequence[Number]:
        """The numbers of a frame of observation "state", of one state or of a `Kinematics` of arrays."""
        return state_fields(state)

    def features(self, state: Kinematics, course: Course) -> NDArray[np.float32]:
        """A frame of observation "state"."""
        return np.array(self.fields(state, course), np.float32)[None]

    # --- actions: by default a velocity ---------------------------------------------------------------

    def action_space(self) -> spaces.Space[Action]:
        """North, east and down: shares of `speed_m_s`."""
        return spaces.Box(-1.0, 1.0, (3,), np.float32)

    @property
    def directions(self) -> Sequence[Vector] | None:
        """Of discrete actions: north, east and down, shares of `speed_m_s`. None: an action is its own direction."""
        return None

    @property
    def held_z_m(self) -> float | None:
        """The NED height that every command holds; None: commands fly up and down too."""
        return None

    def goal(self, action: Action) -> VelocityGoal:
        """The velocity that an action of the space asks for."""
        direction = action if self.directions is None else self.directions[int(action)]
        north, east, down = (float(share) * self.speed_m_s for share in direction)
        return VelocityGoal((north, east, down), self.held_z_m)

    # --- a game ---------------------------------------------------------------------------------------

    def draw(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        """What a game is about. Raises UserError for an option that cannot be."""
        return {}

    def draw_conditions(self, random: np.random.Generator, games: int) -> Mapping[str, float]:
        """Under which a game is flown, after so many of its environment; nothing: as the task has them."""
        return {}

    def under(self, conditions: Mapping[str, float]) -> Self:
        """The task as it is under conditions of `draw_conditions`."""
        return self

    def layout(self, course: Course) -> object:
        """The scene of a game as Client.set_lane takes it; None: as it is."""
        return None

    def drawn(self, course: Course) -> LaneLayout | None:
        """The same as obstacles. Raises UserError."""
        from uavaccel.wire.image_api import lane_layout  # as heavy as the simulation

        layout = self.layout(course)
        return None if layout is None else lane_layout(layout)

    def advance(self, before: AnyMoment, now: AnyMoment) -> Course:
        """The course after a command."""
        course: Course = now.course
        return course

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        """Of one command."""
        return 0.0 * now.commands

    def success(self, now: AnyMoment) -> Number:
        """Whether the game is won; it is over then."""
        return now.touched & now.free

    def failure(self, now: AnyMoment) -> Number:
        """Whether it is lost."""
        return now.touched

    def info(self, now: Moment) -> Info:
        """What infos have beside the keys of `FlightEnv`."""
        return dict(now.course)


@lru_cache(maxsize=256)
def _parameters(preset: str, threshold_ratio: float, *noise: float) -> DvsParameters:
    return with_noise(with_thresholds(PRESETS[preset], threshold_ratio), *noise)


def rate_ticks(rate_hz: float, profile: str, key: str = "dvs_rate_hz") -> int:
    """Ticks between two frames. Raises ValueError where the rate does not divide that of the physics."""
    physics_hz = NS_PER_S / PROFILES[profile].tick_ns
    ticks = round(physics_hz / rate_hz)
    if not ticks > 0 or abs(ticks * rate_hz / physics_hz - 1) > RATE_ROUNDING:
        raise ValueError(
            f"{key} = {rate_hz:g} does not divide the {physics_hz:g} steps per second of the physics; "
            f"{physics_hz / max(ticks, 1):g} does"
        )
    return ticks


def position_option(options: Mapping[str, object], name: str, drawn: NDArray[np.float64]) -> list[Number]:
    """A reset option of positions (..., 3), NED, in the shape of `drawn`'s; `drawn` where it is not given.

    Raises UserError where it is no list of finite numbers of that form.
    """
    try:
        given = np.array(options.get(name, drawn), float)
    except (TypeError, ValueError):
        given = np.array(np.nan)
    if given.ndim != drawn.ndim or given.shape[-1:] != (3,) or not np.isfinite(given).all() or not given.size:
        form = "[north, east, down]" if drawn.ndim == 1 else "[[north, east, down], ...]"
        raise UserError(f"reset: option {name} = {options[name]!r} must be {form} in metres")
    positions: list[Number] = given.tolist()
    return positions


def distance(a: Sequence[Number], b: Sequence[Number]) -> Number:
    """Metres between two places, of one game or of many."""
    squared = sum((here - there) * (here - there) for here, there in zip(a, b, strict=True))
    return math.sqrt(squared) if isinstance(squared, float) else squared**0.5
