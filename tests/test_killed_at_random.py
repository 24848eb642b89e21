"""Runs killed at random instants, the process alone or with all it started: resumed, they end with the same bytes.

`KILLS=100 pytest -n 0 tests/test_killed_at_random.py` kills as often as one likes.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from uavaccel.clock import MonotonicClock
from uavaccel.files import UNFINISHED
from uavaccel.leftovers import OF_JOBLIB
from uavaccel.records import RunDirectory
from uavaccel.units import NS_PER_S

pytestmark = pytest.mark.slow

KILLS = int(os.environ.get("KILLS", "6"))
LATEST_S = 8.0  # after which a run is killed
GONE_S = 5.0  # by when nothing that it started is left
TINY = "task.observation=state mirror=false hidden=[16] options.learning_starts=8 options.buffer_size=200"
RUNS = {
    "dp1": "run dp1 --jobs 2 --timing virtual --clock 10 --clock 50 --t-move 0.2 --rounds 4 --games 20 "
    "--set reference_games=4",
    "train": "train --timing virtual --games 40 --set checkpoint_games=5 --set task.max_commands=20 "
    + " ".join(f"--set {each}" for each in TINY.split()),
    "evaluate": "evaluate straight --games 40 --no-films",
}


def begin(arguments: str, out: Path) -> subprocess.Popen[bytes]:
    """In a session of its own, so that all of it can be found and ended."""
    command = [sys.executable, "-m", "uavaccel", *arguments.split(), "--out", str(out)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)


def contents(run: Path) -> dict[str, bytes]:
    names = ["rows.jsonl", "summary.json", "config.yaml"]
    arrays = [path.relative_to(run).as_posix() for path in sorted(run.glob("arrays/*"))]
    return {name: (run / name).read_bytes() for name in [*names, *arrays]}


def children(pid: int) -> set[int]:
    """Processes below one, all the way down."""
    found: set[int] = set()
    pending = [pid]
    while pending:
        tasks = Path(f"/proc/{pending.pop()}/task")
        with contextlib.suppress(OSError):
            below = {
                int(each) for task in tasks.iterdir() for each in (task / "children").read_text().split()
            }
            found |= below
            pending += below
    return found


def kill(process: subprocess.Popen[bytes], kind: str, choose: random.Random) -> set[int]:
    """Kill the parent, or one of those below it, or the group; those that have to be gone soon."""
    below = children(process.pid)
    if kind == "group":
        os.killpg(process.pid, signal.SIGKILL)
    elif kind == "worker" and below:
        with contextlib.suppress(ProcessLookupError):
            os.kill(choose.choice(sorted(below)), signal.SIGKILL)
    else:
        process.kill()
    return below


def gone(pids: set[int]) -> bool:
    """Whether none of them is left but as an entry that its parent has not read yet."""
    clock = MonotonicClock()
    end_ns = clock.now_ns() + round(GONE_S * NS_PER_S)
    while any(alive(pid) for pid in pids):
        if clock.now_ns() > end_ns:
            return False
        clock.sleep_until(clock.now_ns() + 50_000_000)
    return True


def of_the_dead(name: str) -> bool:
    """Whether a semaphore or a folder is that of a run which is no more."""
    named = OF_JOBLIB.match(name)
    return named is not None and not alive(int(named[1]))


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize("name", RUNS)
def test_runs_killed_at_random_end_with_the_same_bytes(name: str, tmp_path: Path) -> None:
    choose = random.Random(name)
    assert begin(RUNS[name], tmp_path / "whole").wait(timeout=300) == 0
    killed, arguments = tmp_path / "killed", RUNS[name]
    for _ in range(max(KILLS // len(RUNS), 1)):
        process = begin(arguments, killed)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=choose.uniform(1.0, LATEST_S))
        below = kill(process, choose.choice(["parent", "group", "worker"]), choose)
        process.wait(timeout=60)
        assert gone(below)
        if (killed / "config.yaml").is_file():
            RunDirectory(killed)  # can be read as it is
            arguments = "run --resume"
    assert begin(arguments, killed).wait(timeout=300) == 0
    assert contents(killed) == contents(tmp_path / "whole")
    assert not list(killed.rglob(f"*{UNFINISHED}"))
    assert not [name for name in os.listdir("/dev/shm") if of_the_dead(name)]
