"""Games on the machine's own clock that something kept from running as they should: which, and how that is said."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from uavaccel.suites.report import Disturbances, GameRow, Row
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:  # environments load Gymnasium
    from uavaccel.envs.values import Info

KEYS: tuple[Literal["lost_wall_s", "stalled_wall_s", "restarts"], ...] = (
    "lost_wall_s",
    "stalled_wall_s",
    "restarts",
)


def disturbances(row: Row, restarts: int = 0) -> Disturbances:
    """The entries of a `wall` game's row that say that it was disturbed; none where it was not."""
    found: Disturbances = {"restarts": restarts} if restarts else {}
    if found or any(row.get(key) for key in KEYS):
        found["disturbed"] = True
    return found


def note_disturbances(row: GameRow, info: Info) -> None:
    """Enter into a game's row the disturbances that its last info reports."""
    for key in KEYS:
        if found := info.get(key):
            row[key] = found


def note_stalls(row: GameRow, stalled_ns: int) -> None:
    """Enter into a game's row for how long the server did not answer, unless it always did."""
    if stalled_ns:
        row["stalled_wall_s"] = stalled_ns / NS_PER_S


def disturbed_games(rows: Sequence[Row]) -> int:
    """How many of the rows are flagged."""
    return sum(bool(row.get("disturbed")) for row in rows)


def disturbed_words(rows: Sequence[Row]) -> list[str]:
    """A note for the source line of a figure; none where no game was disturbed."""
    count = disturbed_games(rows)
    return [f"{count} of {len(rows)} games disturbed"] if count else []
