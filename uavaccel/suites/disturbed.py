"""Games on the machine's own clock that something kept from running as they should: which, and how that is said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from uavaccel.suites.report import Row
from uavaccel.units import NS_PER_S

KEYS = ("lost_wall_s", "stalled_wall_s", "restarts")
"""Wall time that the simulation could not make good; for which the server did not answer; servers started again."""


def disturbances(row: Row, restarts: int = 0) -> dict[str, Any]:
    """What the row of a `wall` game has to say about it: nothing where all went well."""
    found = {"restarts": restarts} if restarts else {}
    if found or any(row.get(key) for key in KEYS):
        found["disturbed"] = True
    return found


def measured_disturbances(info: Mapping[str, Any]) -> dict[str, Any]:
    """Those of an environment's last info that it has."""
    return {key: info[key] for key in KEYS if info.get(key)}


def stalls(stalled_ns: int) -> dict[str, float]:
    """A row's entry for a server that did not answer for so long; none where it always did."""
    return {"stalled_wall_s": stalled_ns / NS_PER_S} if stalled_ns else {}


def disturbed_games(rows: Sequence[Row]) -> int:
    """How many of the rows are flagged."""
    return sum(bool(row.get("disturbed")) for row in rows)


def disturbed_words(rows: Sequence[Row]) -> list[str]:
    """A note for the source line of a figure; none where no game was disturbed."""
    count = disturbed_games(rows)
    return [f"{count} of {len(rows)} games disturbed"] if count else []
