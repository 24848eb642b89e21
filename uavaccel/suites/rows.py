"""Rows of rows.jsonl: the keys that games of several suites share, and how they are filled in."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal, NotRequired, TypeVar, cast

import numpy as np
from pydantic import AfterValidator
from typing_extensions import TypedDict

from uavaccel.files import Plain
from uavaccel.forms import Count, NotNegative, Number

if TYPE_CHECKING:  # environments load Gymnasium
    from uavaccel.envs.values import Info

Row = Mapping[str, Plain]
"""A row as it is read back; suites declare the keys of their own rows as a `GameRow`."""

Disturbance = Literal["lost_wall_s", "stalled_wall_s", "restarts"]
DISTURBANCES: tuple[Disturbance, ...] = ("lost_wall_s", "stalled_wall_s", "restarts")
Entry = TypeVar("Entry")
Key = TypeVar("Key")


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


def subset(row: Mapping[str, object], *keys: str) -> dict[str, Plain]:
    """Return the entries of a row under these keys."""
    return {key: row[key] for key in keys}


def named_seed(run_seed: int, name: str) -> np.random.SeedSequence:
    """Return the seed of a game by its name: the same in any subset of a run, and in any order."""
    return np.random.SeedSequence(run_seed, spawn_key=(zlib.crc32(name.encode()),))


def number_of(row: Mapping[str, Plain]) -> int:
    """Return the number of a game of an evaluation: of its lane or, in other environments, its own."""
    return int(row["lane"] if "lane" in row else row["game"])


def game_row(suite: str, case: str, ended: Info, t_move_s: float) -> OutcomeRow:
    """Return the row of a game from the info of its last step."""
    row: Plain = {"suite": suite, "case": case, "sim_time_s": ended["commands"] * t_move_s}
    row |= subset(ended, "is_success", "collision", "commands", "phase_s")
    row |= {key: found for key in DISTURBANCES if (found := ended.get(key))}
    if "conditions" in ended:
        row["conditions"] = ended["conditions"]
    return cast(OutcomeRow, row)


def disturbances(row: Row, restarts: int = 0) -> Disturbances:
    """Return the keys that mark a `wall` game as disturbed; none where it was not."""
    found: Disturbances = {"restarts": restarts} if restarts else {}
    if found or any(row.get(key) for key in DISTURBANCES):
        found["disturbed"] = True
    return found
