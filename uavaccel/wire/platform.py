"""The model of the simulator's side: what its ticks and frames cost, and the faults of its connection."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator, model_validator

from uavaccel.config import Config, LatencyUs, Share
from uavaccel.sim.profile import AIRSIM, PROFILES, Executor, Frames, Profile, airsim_variant
from uavaccel.units import seconds_to_ns

RESENT_NS = 200_000_000  # Linux's least time-out before TCP sends a lost segment again (TCP_RTO_MIN)
STALLED_NS = 40_000_000  # Linux's delayed acknowledgement, which Nagle's algorithm waits for (TCP_DELACK_MIN)


class FrameConfig(Config):
    """The model of Unreal's frames (uavaccel.sim.simulation)."""

    hz: Annotated[float, Field(ge=0.0, le=1e5)] = 0.0
    """Frames per wall second; with 0 an image is drawn when it is requested."""

    @field_validator("hz")
    @classmethod
    def _comes_to_an_end(cls, hz: float) -> float:
        if 0.0 < hz < 0.01:
            raise ValueError("must be 0, or 0.01 or more")
        return hz

    stale_pose: bool = False
    """Whether images show the pose of the last frame before a pause."""
    after_continue: bool = False
    """Whether the reply of a continue-for also waits for a frame, while the simulation is paused."""


class FaultConfig(Config):
    """The fractions of messages, in either direction, that suffer a fault."""

    dropped: Share = 0.0
    """Lost, and sent again after TCP's minimum time-out of 200 ms."""
    stalled: Share = 0.0
    """Held until a delayed acknowledgement comes, 40 ms."""
    late: Share = 0.0
    """Late by `late_us`."""
    late_us: LatencyUs = 10_000.0
    """Microseconds by which a late message comes later."""

    @model_validator(mode="after")
    def _at_most_all(self) -> FaultConfig:
        if self.dropped + self.stalled + self.late > 1.0:
            raise ValueError("dropped, stalled and late are fractions of all messages: together at most 1")
        return self


class PlatformConfig(Config):
    """The simulator's side of a modelled wall clock; by default it costs nothing and has no faults."""

    tick_us: LatencyUs = 0.0
    """Wall time of a physics tick; the speed saturates at the tick's duration divided by it."""
    integer_clock_speed: bool = False
    """Whether a ClockSpeed above 1 loses its fraction, as in AirSim."""
    stall_us: LatencyUs = 0.0
    """Delay of a request that follows a command without a reply yet: 40 000 for AirSim's client on a connection with
    Nagle's algorithm and delayed acknowledgements."""
    frames: FrameConfig = FrameConfig()
    """The game engine's frames, to which pictures and calls may have to wait."""
    faults: FaultConfig = FaultConfig()
    """Messages that come late or are lost."""
    goal_timeout_s: Annotated[float, Field(gt=0.0, le=1e6)] = 0.06
    """AirSim's api_goal_timeout: simulated time without a new goal after which position hold begins."""
    exact_pauses: bool = False
    """Whether a continue-for ends on the tick, as in the profile `native`, instead of by a wall timer."""
    scalable_clock: bool = False
    """Whether the clock is AirSim's ScalableClock: a loop of 3 ms of wall time, whose step grows with ClockSpeed."""

    def profile(self, name: str, clock_speed: float) -> Profile:
        """Return the profile of that name, modified by the keys above; `native` is not modified."""
        if name != AIRSIM.name:
            return PROFILES[name]
        step = max(clock_speed, 1.0) if self.scalable_clock else 1.0
        return airsim_variant(round(AIRSIM.tick_ns * step), seconds_to_ns(self.goal_timeout_s), self.exact_pauses)

    def executor(self) -> Executor:
        return Executor(round(self.tick_us * 1e3), self.integer_clock_speed)

    def frame_ns(self) -> int:
        """Return the period of the frames; 0 without frames."""
        return round(1e9 / self.frames.hz) if self.frames.hz else 0

    def new_frames(self, wait_ns: Callable[[], int]) -> Frames:
        """Return the frames of one game; `wait_ns` draws how long a frame is waited for."""
        return Frames(self.frame_ns(), self.frames.stale_pose, self.frames.after_continue, wait_ns)


def delays_ns(faults: FaultConfig, generator: np.random.Generator) -> Iterator[int]:
    """Yield the delays of a stream's messages; one number is drawn for each message."""
    at = np.cumsum([faults.dropped, faults.stalled, faults.late])
    delays = (RESENT_NS, STALLED_NS, round(faults.late_us * 1e3), 0)
    while True:
        for uniform in generator.random(1024):
            yield delays[int(np.searchsorted(at, uniform, side="right"))]
