"""What experiments share: keys of their YAML, keys of their rows (rows.jsonl), times of this machine (timing.jsonl)."""

from __future__ import annotations

import os
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal, NotRequired, TypeAlias, TypeVar, cast

import numpy as np
from pydantic import AfterValidator
from typing_extensions import TypedDict

from uavaccel.clock import MonotonicClock
from uavaccel.config import ClockSpeed, CommandName, Config, Cost, Seed
from uavaccel.draw.page import in_words
from uavaccel.files import Plain
from uavaccel.forms import Count, NotNegative, Number
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import LatencyModel

if TYPE_CHECKING:  # environments load Gymnasium
    from uavaccel.envs.values import Info

Timing = Literal["wall", "virtual", "lockstep"]
ProfileName = Literal["native", "airsim"]
Distinct = TypeVar("Distinct", bound=tuple[float | str, ...])
Result = TypeVar("Result")
Row = Mapping[str, Plain]
"""A row as it is read back; suites declare the keys of their own rows as a `GameRow`."""
Timings: TypeAlias = Sequence[Mapping[str, Any]]
"""The entries of timing.jsonl; `wall_s` is the wall time since the first command of a start of the run."""


def distinct(values: Distinct) -> Distinct:
    """Return the values. Raises ValueError for none, and for two with the same six digits, which name a game."""
    if not values:
        raise ValueError("needs at least one value")
    counts = Counter(value if isinstance(value, str) else f"{value + 0:g}" for value in values)
    if twice := [name for name, count in counts.items() if count > 1]:
        raise ValueError(f"has {twice[0]} twice")
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


def named_seed(run_seed: int, name: str) -> np.random.SeedSequence:
    """Return the seed of a game by its name: the same in any subset of a run, and in any order."""
    return np.random.SeedSequence(run_seed, spawn_key=(zlib.crc32(name.encode()),))


# --- rows -----------------------------------------------------------------------------------------------------------


class Disturbances(TypedDict, total=False):
    """What disturbed a game on the machine's own clock; the keys are absent from the rows of undisturbed games."""

    lost_wall_s: NotNegative
    """Wall time that the simulation could not make good."""
    stalled_wall_s: NotNegative
    """Wall time during which the server did not answer."""
    restarts: Count
    """How often the server was started again."""
    disturbed: bool


class GameRow(Disturbances):
    """The keys that the row of a game has in every suite."""

    suite: str
    case: str
    arrays: NotRequired[str]
    arrays_sha256: NotRequired[str]


def _all_phases(spent_s: dict[str, float]) -> dict[str, float]:
    from uavaccel.envs.stopwatch import PHASES

    if missing := [phase for phase in PHASES if phase not in spent_s]:
        raise ValueError(f"should have the phase {missing[0]!r}")
    return spent_s


Phases = Annotated[dict[str, NotNegative], AfterValidator(_all_phases)]
"""Seconds of a game or a training by phase."""


class OutcomeRow(GameRow):
    """The row of a game of any environment: how it ended."""

    is_success: bool
    collision: str | None
    commands: Count
    phase_s: Phases
    sim_time_s: NotNegative
    conditions: NotRequired[Mapping[str, Number]]
    simulator: NotRequired[str]
    """The simulator of an evaluation, unless that is the exact one."""


class LaneRow(OutcomeRow):
    """The row of a game in the obstacle lane."""

    distance_m: Number
    lane: Count


ReturnRow = TypedDict("ReturnRow", {"return": Number})  # a keyword of Python's


def subset(row: Mapping[str, object], *keys: str) -> dict[str, Plain]:
    """Return the entries of a row under these keys."""
    return {key: row[key] for key in keys}


def number_of(row: Mapping[str, Plain]) -> int:
    """Return the number of a game of an evaluation: of its lane or, in other environments, its own."""
    return int(row["lane"] if "lane" in row else row["game"])


def game_row(suite: str, case: str, ended: Info, t_move_s: float) -> OutcomeRow:
    """Return the row of a game from the info of its last step."""
    row: Plain = {"suite": suite, "case": case, "sim_time_s": ended["commands"] * t_move_s}
    row |= subset(ended, "is_success", "collision", "commands", "phase_s")
    row |= {key: found for key in Disturbances.__annotations__ if (found := ended.get(key))}
    if "conditions" in ended:
        row["conditions"] = ended["conditions"]
    return cast(OutcomeRow, row)


def disturbances(row: Row, restarts: int = 0) -> dict[str, Plain]:
    """Return the keys that mark a `wall` game as disturbed; none where it was not."""
    found = {"restarts": restarts} if restarts else {}
    return {**found, "disturbed": True} if found or any(map(row.get, Disturbances.__annotations__)) else {}


# --- times of this machine, which no summary has, since they are never reproduced -----------------------------------


def timed(work: Callable[[], Result]) -> tuple[Result, dict[str, float]]:
    """Return the result of some work, and the entries of timing.jsonl for its duration and the machine's load."""
    clock = MonotonicClock()
    start_ns = clock.now_ns()
    result = work()
    return result, {"host_wall_s": (clock.now_ns() - start_ns) / NS_PER_S, "load": os.getloadavg()[0]}


def cumulative_wall_s(timings: Timings) -> list[float]:
    """Return the wall time in seconds from the first command up to each entry that has it, over all starts."""
    readings = [entry["wall_s"] for entry in timings if "wall_s" in entry]
    steps = [after - before if after >= before else after for before, after in pairwise([0.0, *readings])]
    return list(accumulate(steps))


def whole_wall_s(timings: Timings) -> float:
    """Return the wall time in seconds of all commands, over all starts; 0 where it was not measured."""
    return (cumulative_wall_s(timings) or [0.0])[-1]


def over_all_starts(readings: Sequence[Mapping[str, float]]) -> Counter[str]:
    """Return the sums of stopwatches that restart whenever a run is resumed."""
    total = Counter[str](readings[-1] if readings else {})
    for before, after in pairwise(readings):
        if sum(after.values()) < sum(before.values()):
            total.update(before)
    return total


def pace_of(timings: Timings, simulated_s: float) -> str:
    """Return in words how long games of so many simulated seconds took; empty where it was not measured."""
    took_s = whole_wall_s(timings)
    if not took_s:
        return ""
    what = "flying and learning" if "learner_s" in timings[-1] else "flying"
    return f"{what} took {in_words(took_s)} of wall clock, {simulated_s / took_s:.0f} simulated s per wall s"
