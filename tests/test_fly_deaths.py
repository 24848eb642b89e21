"""What becomes of a flight when one of its processes is killed, stopped or interrupted: a line, and nothing is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.processes import alive, command_line, descendants, left_after
from uavaccel.fly import command
from uavaccel.fly.command import FlightResult, FlyRequest, fly_script
from uavaccel.fly.options import SCRATCH, FlightOptions

pytestmark = [pytest.mark.skipif(sys.platform != "linux", reason="/proc, signals"), pytest.mark.slow]

ROOT = Path(__file__).parents[1]
PATIENCE_S = 60.0
SCRIPT = """
import sys, time
if "connected" in sys.argv:
    import airsim
    client = airsim.MultirotorClient()
    print(client.ping(), flush=True)
    time.sleep(3600)
print("begun", flush=True)
while True:
    pass
"""
MARKS = {"script": "uavaccel.fly.process", "server": "uavaccel.cli.main"}


def process_of(whole: subprocess.Popen[str], target: str) -> int:
    """The number of one of a flight's processes; the server's session is its own."""
    if target == "parent":
        return whole.pid
    return next(pid for pid in descendants(whole.pid) if MARKS[target] in command_line(pid))


DEATHS = [
    ("virtual", "parent", "INT", "", 130),
    ("wall", "parent", "KILL", "the process that started this flight was killed", -9),
    ("wall", "server", "KILL", "the server's process was ended by SIGKILL; the script ends too", 1),
]


def test_a_death_is_noticed_and_nothing_is_left(tmp_path: Path) -> None:
    """All at the same time, as they wait most of it."""
    with ThreadPoolExecutor(len(DEATHS)) as pool:
        for _ in pool.map(lambda death: dies(tmp_path / "-".join(death[:3]), *death), DEATHS):
            pass


def dies(folder: Path, timing: str, target: str, kind: str, line: str, status: int) -> None:
    """Fly a script and send a signal to one of the flight's processes."""
    script, temporary, said = folder / "script.py", folder / "tmp", folder / "said.txt"
    temporary.mkdir(parents=True)
    script.write_text(SCRIPT)
    command = [sys.executable, "-m", "uavaccel", "fly", "--timing", timing, str(script)]
    command += ["connected"] if timing == "wall" else []
    with (
        said.open("w") as errors,
        subprocess.Popen(
            command,
            cwd=ROOT,
            env={**os.environ, "TMPDIR": str(temporary)},
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,
        ) as flight,
    ):
        try:
            assert flight.stdout is not None
            assert flight.stdout.readline().strip() in ("begun", "True")
            everybody = {flight.pid, *descendants(flight.pid)}
            assert len(everybody) == (3 if timing == "wall" else 2)
            os.kill(process_of(flight, target), getattr(signal, f"SIG{kind}"))
            assert flight.wait(PATIENCE_S) == status
            assert not left_after(everybody, PATIENCE_S), [command_line(pid) for pid in everybody if alive(pid)]
            rest = flight.stdout.read()
        except BaseException:
            os.killpg(flight.pid, signal.SIGKILL)  # or leaving the block would wait for it
            raise
    lines = [text for text in said.read_text().splitlines() if "stopped; requested" not in text]
    if line:
        assert len(lines) == 1, lines
        assert line in lines[0]
    else:
        assert rest.startswith("interrupted; "), (rest, lines)
    assert not list(temporary.iterdir())


def test_what_a_killed_flight_left_is_cleared_by_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    left, others = (tmp_path / f"{SCRATCH}{pid}-x" for pid in (gone.pid, os.getpid()))
    for folder in (left, others):
        folder.mkdir()
        (folder / "file").touch()
    script = tmp_path / "script.py"
    script.touch()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(command, "fly", lambda options: FlightResult(0, None))
    assert fly_script(FlyRequest(FlightOptions(script, (), Path()), find_settings=False)) == 0
    assert sorted(tmp_path.iterdir()) == sorted([others, script])
