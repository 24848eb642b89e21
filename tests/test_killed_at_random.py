"""Runs killed at random instants, the process alone or with all it started: resumed, they end with the same bytes.

`KILLS=100 pytest -n 0 -s tests/test_killed_at_random.py` kills as often as one likes, over every suite; without it
one of them is killed once.
"""

from __future__ import annotations

import contextlib
import os
import random
import shlex
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.processes import command_line, descendants, left_after, servers
from uavaccel.cli.main import app
from uavaccel.clock import MonotonicClock
from uavaccel.files import UNFINISHED, read_lines
from uavaccel.processes.lifetime import OF_JOBLIB
from uavaccel.records import RunDirectory
from uavaccel.units import NS_PER_S

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")]

GONE_S = 120.0  # by when nothing that it started is left, on however busy a machine; what it took is printed
STARTS_S = 3.0  # before a process of its own does what the whole run does in this one
ENDS_S = 600.0  # by when a run that is left alone has ended
PARENT, GROUP, WORKER, SERVER = "parent", "group", "worker", "server"
BLIND = "--set task.observation=state --set task.max_commands=12"
TINY = "channels: [4, 4], hidden: [16], options: {learning_starts: 8, batch_size: 8, buffer_size: 200}"
CELLS = "[{profile: airsim, command: [tcsc, adsc], clock_speed: [5]}]"


@dataclass(frozen=True)
class Killed:
    """A run, and what of it may be killed."""

    arguments: str
    kinds: tuple[str, ...] = (PARENT, GROUP, WORKER)


ALL = {
    "dp1": Killed(
        "run dp1 --jobs 2 --timing virtual --clock 50 --t-move 0.2 --rounds 4 --games 10 --set reference_games=4"
    ),
    "train": Killed(f"train --timing virtual --games 20 --set checkpoint_games=4 --set mirror=false {BLIND} "
                    + " ".join(f"--set '{key}'" for key in ("hidden=[16]", "options.learning_starts=8"))),
    "evaluate": Killed("evaluate straight --games 40 --no-films"),
    "dp2": Killed("run dp2 --jobs 2 --timing virtual --clock 50 --command tcsc"),
    "batch": Killed("evaluate default --games 4 --no-films --set environments=2 --set task.max_commands=12"),
    "lanes": Killed(f"train --timing virtual --games 12 --set environments=2 --set checkpoint_games=4 {BLIND} "
                    "--set mirror=false --set 'hidden=[16]' --set options.learning_starts=8"),
    "rl": Killed(f"run rl_smoke --games 3 --set 'cells={CELLS}' "
                 "--set 'evaluation.keys={games: 2, task.max_commands: 12}' --set 'training.keys={checkpoint_games: 1, "
                 f"mirror: false, task.observation: state, task.max_commands: 12, {TINY}}}'"),
    "sweep": Killed("evaluate straight --games 3 --jobs 2 --sweep wind=0,8 "
                    "--set task.max_commands=6"),
    "robustness": Killed("run robustness --games 2 --set agent=straight --set 'latency_scale=[1, 0]' --set "
                         "'clock_speed=[1, 50]' --set 'evaluation.keys={task.max_commands: 6}'"),
    "wall": Killed("run dp1 --timing wall --clock 50 --t-move 1 --rounds 8 --games 6 --set reference_games=2",
                   (PARENT, GROUP, SERVER)),
}  # fmt: skip
EVERY_DAY = ("dp1",)  # with processes of joblib; tests of the others kill them at instants of their own
RUNS = {name: ALL[name] for name in (ALL if "KILLS" in os.environ else EVERY_DAY)}
KILLS = max(int(os.environ.get("KILLS", "1")) // len(RUNS), 1)
CLOCK = MonotonicClock()


def begin(arguments: str, out: Path, said: Path) -> subprocess.Popen[bytes]:
    """In a session of its own, so that all of it can be found and ended; temporary files have a folder of their own."""
    command = [sys.executable, "-m", "uavaccel", *shlex.split(arguments), "--out", str(out)]
    temporary = said.with_suffix(".tmp")
    temporary.mkdir(exist_ok=True)
    with said.open("wb") as file:
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=file,
            env={**os.environ, "TMPDIR": str(temporary)},
            start_new_session=True,
        )


def contents(run: Path) -> dict[str, bytes]:
    names = ["rows.jsonl", "summary.json", "config.yaml"]
    arrays = [path.relative_to(run).as_posix() for path in sorted(run.glob("arrays/*"))]
    return {name: (run / name).read_bytes() for name in [*names, *arrays]}


def repeatable(run: Path) -> list[str]:
    """What rows of a `wall` run say that is the same each time: which games, and those on a simulated clock whole."""
    rows = read_lines(run / "rows.jsonl")
    return [row["case"] if row["timing"] == "wall" else str(row) for row in rows]


def kill(process: subprocess.Popen[bytes], kind: str, choose: random.Random) -> tuple[str, set[int]]:
    """Kill the parent, or one of those below it, or the group; what was killed, and what has to be gone soon."""
    below = descendants(process.pid)
    found = sorted(servers(process.pid) if kind == SERVER else below)
    if kind == GROUP:
        os.killpg(process.pid, signal.SIGKILL)
        return "group", below
    if kind in (WORKER, SERVER) and found:
        victim = choose.choice(found)
        what = command_line(victim)
        with contextlib.suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
        return f"{kind}: {what}", {victim} if kind == SERVER else below
    process.kill()
    return "parent", below


@dataclass
class Seen:
    """What a test has killed, the processes that it saw, and for how long one of them lived on."""

    kills: Counter[str] = field(default_factory=Counter)
    pids: set[int] = field(default_factory=set)
    longest_s: float = 0.0

    def wait_until_gone(self, below: set[int]) -> None:
        start_ns = CLOCK.now_ns()
        assert not left_after(below, GONE_S), [command_line(pid) for pid in below]
        self.longest_s = max(self.longest_s, (CLOCK.now_ns() - start_ns) / NS_PER_S)

    def left_in_shared_memory(self) -> list[str]:
        """Semaphores and folders that one of them has made; neighbours have theirs."""
        named = ((name, OF_JOBLIB.match(name)) for name in os.listdir("/dev/shm"))
        return [name for name, match in named if match is not None and int(match[1]) in self.pids]


@pytest.mark.parametrize("name", RUNS)
def test_runs_killed_at_random_end_with_the_same_bytes(name: str, tmp_path: Path) -> None:
    choose, said = random.Random(name), tmp_path / "said"
    start_ns = CLOCK.now_ns()
    alone = shlex.split(RUNS[name].arguments.replace(" --jobs 2", ""))
    done = CliRunner().invoke(app, [*alone, "--out", str(tmp_path / "whole")], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    whole_s = STARTS_S + (CLOCK.now_ns() - start_ns) / NS_PER_S
    same = repeatable if name == "wall" else contents
    seen = Seen()
    for number in range(KILLS):
        out = tmp_path / f"run{number}"
        while fly_and_kill(RUNS[name], out, said, choose, whole_s, seen):
            pass
        assert same(out) == same(tmp_path / "whole")
        assert not list(out.rglob(f"*{UNFINISHED}"))
        assert not seen.left_in_shared_memory()
        if seen.kills.total() >= KILLS:
            break
    print(f"\n{name}: {seen.kills.total()} kills; all gone after {seen.longest_s:.1f} s at most")
    for what, count in sorted(seen.kills.items()):
        print(f"{count:5} {what[:150]}")


def fly_and_kill(run: Killed, out: Path, said: Path, choose: random.Random, whole_s: float, seen: Seen) -> bool:
    """Begin the run or go on with it, until it is killed or ends; whether it has to be gone on with."""
    begun = (out / "config.yaml").is_file()
    arguments = "run --resume" if begun else f"{run.arguments} --resume" if out.exists() else run.arguments
    process = begin(arguments, out, said)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(ENDS_S if seen.kills.total() >= KILLS else choose.uniform(0.3, whole_s))
    if process.poll() is not None:
        assert process.returncode == 0, said.read_text()
        return False
    what, below = kill(process, choose.choice(run.kinds), choose)
    seen.kills[what] += 1
    seen.pids |= {process.pid, *below}
    status = process.wait(ENDS_S)
    seen.wait_until_gone(below)
    assert "Traceback" not in said.read_text(), f"{what}: {said.read_text()}"
    if (out / "config.yaml").is_file():
        RunDirectory(out)  # can be read as it is
    return status != 0
