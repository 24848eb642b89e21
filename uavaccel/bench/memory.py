"""Main memory of several processes that share some of theirs."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path


def proportional_mib(process_ids: Iterable[int]) -> float | None:
    """Proportional set size of all of them together, MiB: what they share counts once. None where no kernel tells."""
    try:
        rollups = [Path(f"/proc/{each}/smaps_rollup").read_text(encoding="ascii") for each in process_ids]
    except OSError:
        return None
    return sum(int(kib) for text in rollups for kib in re.findall(r"^Pss: +(\d+) kB", text, re.M)) / 1024
