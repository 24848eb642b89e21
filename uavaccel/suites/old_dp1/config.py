"""DP1's configuration: the path, how fast and how often it is flown, and what it is compared with."""

from __future__ import annotations

from collections.abc import Sized
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from uavaccel.commands.paths import PATHS
from uavaccel.commands.slices import check_times
from uavaccel.limits import MOST_GAMES, MOST_HEIGHT_M, MOST_ROUNDS, MOST_SECONDS, Speed, Velocity
from uavaccel.sim.profile import PROFILES
from uavaccel.suites.experiment import FlightExperiment, Timing, within

Path = Literal["square", "two_forward_one_back"]
Rounds = Annotated[tuple[int, ...], AfterValidator(lambda rounds: within(rounds, 1, MOST_ROUNDS))]
Duration = Annotated[float, AfterValidator(lambda time_s: within((time_s,), 0.0, MOST_SECONDS)[0])]
Durations = Annotated[tuple[float, ...], AfterValidator(lambda times_s: within(times_s, 0.0, MOST_SECONDS))]
Count = Annotated[int, AfterValidator(lambda games: within((games,), 1, MOST_GAMES)[0])]


class Dp1Config(FlightExperiment):
    """`suite: dp1`."""

    suite: Literal["dp1"]
    path: Path | tuple[tuple[Velocity, Velocity, Velocity], ...] = "square"
    """A named path, or a list of velocities, one command each, NED in m/s."""
    speed_m_s: Speed = 1.0
    """Speed on a named path."""
    height_m: Annotated[float, Field(lt=0.0, ge=-MOST_HEIGHT_M)] | None = None
    """NED z to hold, as moveByVelocityZ does; without it plain moveByVelocity is called, as in the paper."""
    rounds: Rounds = (1, 2, 4, 8, 16, 24)
    """How often the square path is flown in a game; each value is flown."""
    t_move_s: Durations = (0.1, 0.2, 0.5, 1.0)
    """Simulated seconds of a command; each value is flown."""
    t_sample_s: Duration | None = None
    """How often the client itself gathers the state; without it once per command, beside the server's recorder."""
    games: Count = 20
    """Games of each cell, that is of each command, ClockSpeed, T_move and number of rounds."""
    reference_games: Count = 20
    """Real-time ADSC games of each T_move and number of rounds, unless the run flies that cell anyway."""
    reference_timing: Timing = "virtual"
    """The timing of the reference flights, with ADSC at ClockSpeed 1."""

    @field_validator("path")
    @classmethod
    def _not_empty(cls, path: Sized) -> Sized:
        if not path:
            raise ValueError(f"needs at least one velocity, or one of {', '.join(PATHS)}")
        return path

    @model_validator(mode="after")
    def _times_fit(self) -> Dp1Config:
        profile = PROFILES[self.profile]
        for t_move_s in self.t_move_s:
            check_times(t_move_s, self.t_sample_s or t_move_s, profile.check_duration)
        return self
