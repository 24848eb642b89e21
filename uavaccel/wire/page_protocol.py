"""What a page that looks on and the flights that it shows have agreed on; light, for commands that open a page."""

from __future__ import annotations

from typing import TypedDict

PAGE = "UAVACCEL_WATCH_PAGE"
"""The environment variable with the path of the page's Unix socket, which every process of a command inherits."""
MESSAGE_BYTES = 1 << 16


class Orders(TypedDict):
    """The page's orders to a flight: `held` until it is told to go on, but for `refreshes` that are let pass."""

    seen: bool
    """Whether somebody looks at it: otherwise the page needs to hear now and then only that it flies."""
    held: bool
    pace: float | None
    """Simulated seconds per second of the machine's; None for as fast as it flies."""
    refreshes: int


FREE: Orders = {"seen": False, "held": False, "pace": None, "refreshes": 0}
"""Those of a flight that is not shown, or that nobody looks at."""
