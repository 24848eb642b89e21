"""A `wall` run whose server is killed or stopped again and again, and what its rows say of it.

    python -m tests.soak.disturbed_wall --minutes 30 --every 60 --out disturbed

Disturbances come in turn: SIGKILL, SIGSTOP for good, SIGSTOP for 3 s, SIGSTOP for 0.3 s. Ends with status 1 where a
game is missing or stands twice, or where a disturbance is in no flagged row.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import statistics
import subprocess
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.processes import left_after, servers
from uavaccel.clock import MonotonicClock
from uavaccel.files import read_lines
from uavaccel.units import NS_PER_S

KINDS = {"killed": 0.0, "stopped for good": None, "stopped for 3 s": 3.0, "stopped for 0.3 s": 0.3}
GAME_S = 2.0  # of wall time, about: 96 simulated seconds at 50x
SLOWER_S = 0.25  # than the median of its like: a row that should say why
CLOCK = MonotonicClock()


@dataclass(frozen=True)
class Disturbance:
    """What was done to the server, between how many rows, and how long it took until another served."""

    kind: str
    rows_before: int
    rows_after: int
    replaced_s: float | None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--every", type=float, default=60.0, help="seconds from one disturbance to the next")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    games = max(round(asked.minutes * 60 / GAME_S / 2), 1)
    run = begin(games, asked.out)
    try:
        done = disturb(run, asked.out, asked.minutes * 60, asked.every)
        status = run.wait()
    finally:
        run.kill()
    sys.exit(judge(asked.out, games, done, status))


def begin(games: int, out: Path) -> subprocess.Popen[bytes]:
    shape = "--timing wall --clock 50 --t-move 1 --rounds 24 --set reference_games=2 --games"
    command = [sys.executable, "-m", "uavaccel", "run", "dp1", *shape.split(), str(games), "--out", str(out)]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


def disturb(run: subprocess.Popen[bytes], out: Path, last_s: float, every_s: float) -> list[Disturbance]:
    """One disturbance after the other, at a random instant of each period."""
    choose, done = random.Random(0), list[Disturbance]()
    start_ns = CLOCK.now_ns()
    while (len(done) + 1) * every_s <= last_s and run.poll() is None:
        sleep_to(start_ns, len(done) * every_s + choose.uniform(0.2, 0.8) * every_s)
        server = serving(run)
        if server is None:
            break
        done.append(disturb_once(run, out, server, list(KINDS)[len(done) % len(KINDS)]))
        print(done[-1], flush=True)
    return done


def disturb_once(run: subprocess.Popen[bytes], out: Path, server: int, kind: str) -> Disturbance:
    before, begun_ns = rows_of(out), CLOCK.now_ns()
    os.kill(server, signal.SIGKILL if kind == "killed" else signal.SIGSTOP)
    after, lasts_s = rows_of(out), KINDS[kind]
    if lasts_s:
        sleep_to(begun_ns, lasts_s)
        if server in servers(run.pid):
            os.kill(server, signal.SIGCONT)
        return Disturbance(kind, before, after, None)
    left_after([server], 60.0)
    serving(run, other_than=server)
    return Disturbance(kind, before, after, (CLOCK.now_ns() - begun_ns) / NS_PER_S)


def serving(run: subprocess.Popen[bytes], other_than: int = 0) -> int | None:
    """The server of the run, waited for; None if the run ended."""
    while run.poll() is None:
        found = servers(run.pid) - {other_than}
        if found:
            return found.pop()
        sleep_to(CLOCK.now_ns(), 0.02)
    return None


def sleep_to(start_ns: int, after_s: float) -> None:
    CLOCK.sleep_until(start_ns + round(after_s * NS_PER_S))


def rows_of(out: Path) -> int:
    return len(read_lines(out / "rows.jsonl"))


def judge(out: Path, games: int, done: Sequence[Disturbance], status: int) -> int:
    """Print what became of it; 1 if anything is missing or hidden."""
    rows = read_lines(out / "rows.jsonl")
    cases = [row["case"] for row in rows]
    flagged = {number for number, row in enumerate(rows) if row.get("disturbed")}
    unseen = [one for one in done if not flagged & set(range(one.rows_before, one.rows_after + 2))]
    slow = unflagged_and_slow(rows)
    played = sum(row["role"] == "game" for row in rows)
    replaced = [one.replaced_s for one in done if one.replaced_s is not None]
    print(f"exit status {status}; {len(rows)} rows, {played} of {2 * games} games, {len(set(cases))} cases")
    print(f"{len(done)} disturbances, {len(unseen)} of them in no flagged row; {len(flagged)} rows flagged")
    print(f"{sum(row.get('restarts', 0) for row in rows)} restarts in the rows, {len(replaced)} servers lost")
    if replaced:
        print(f"another server after {statistics.median(replaced):.1f} s, {max(replaced):.1f} s at most")
    print(f"{len(slow)} rows without a flag took {SLOWER_S} s more than their like: the machine's other work")
    for one in unseen:
        print(f"in no flagged row: {one}")
    whole = status == 0 and played == 2 * games and len(set(cases)) == len(rows)
    return int(not whole or bool(unseen))


def unflagged_and_slow(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Rows on the wall clock that say nothing, though they took longer than others of their cell."""
    cells = defaultdict[tuple[Any, ...], list[Mapping[str, Any]]](list)
    for row in rows:
        if row["timing"] == "wall" and not row.get("disturbed"):
            cells[row["role"], row["command"], row["t_move_s"], row["rounds"]].append(row)
    medians = {cell: statistics.median(row["wall_s"] for row in like) for cell, like in cells.items()}
    return [row for cell, like in cells.items() for row in like if row["wall_s"] > medians[cell] + SLOWER_S]


if __name__ == "__main__":
    main()
