"""The keys that experiments share."""

from __future__ import annotations

from typing import Annotated, Literal, TypeVar

from pydantic import AfterValidator

from uavaccel.config import ClockSpeed, CommandName, Config, Cost, Seed
from uavaccel.wire.latency import LatencyModel

Timing = Literal["wall", "virtual", "lockstep"]
ProfileName = Literal["native", "airsim"]


Distinct = TypeVar("Distinct", bound=tuple[float | str, ...])


def distinct(values: Distinct) -> Distinct:
    """Return the values. Raises ValueError for none, and for two with the same six digits, which name a game."""
    if not values:
        raise ValueError("needs at least one value")
    names = [value if isinstance(value, str) else f"{value:g}" for value in values]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"has {name} twice")
    return values


ClockSpeeds = Annotated[tuple[ClockSpeed, ...], AfterValidator(distinct)]
CommandNames = Annotated[tuple[CommandName, ...], AfterValidator(distinct)]


class Experiment(Config):
    """Keys of every suite. A subclass adds its own, `suite` among them, and `timing` if `task` has none."""

    seed: Seed = 0
    """Of everything that is drawn at random: the same seed and configuration give the same results."""


class FlightExperiment(Experiment):
    """Keys of suites that fly paths with commands at several ClockSpeeds."""

    clock_speed: ClockSpeeds
    """ClockSpeeds: simulated seconds per wall second, above 0, not necessarily whole."""
    command: CommandNames = ("adsc", "tcsc")
    """tcsc pauses the simulation while the program works, adsc does not; each value is flown."""
    timing: Timing = "virtual"
    """wall: measured on the machine's clock; virtual: modelled on a simulated one; lockstep: without latency."""
    profile: ProfileName = "native"
    """How the simulator handles time: native is exact to the step, airsim behaves like AirSim."""
    t_th_wall_s: Cost = 0.001
    """TCSC's T_th, the client's latency; used with `airsim` alone, whose continue-for may end early."""
    latency: LatencyModel
    """The latencies that `virtual` samples, or the name of their file; `uavaccel timing calibrate` writes one."""


def timing_of(config: Experiment) -> str:
    """Return the timing of a run's games; references may have another."""
    return str(getattr(getattr(config, "task", config), "timing", "lockstep"))
