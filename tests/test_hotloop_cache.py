"""The hot loop's machine code follows the sources that it was compiled from."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLY = """
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
world = World("blocks", NATIVE)
world.fly_velocity((1.0, 0.0, 0.0), False, 0.0, True)
world.advance(100)
print(world.state["position"][0])
"""


def flown_m(checkout: Path) -> float:
    done = subprocess.run(
        [sys.executable, "-c", FLY], cwd=checkout, capture_output=True, text=True, check=True
    )
    return float(done.stdout)


@pytest.mark.slow
def test_a_change_of_the_autopilot_reaches_the_cached_hot_loop(tmp_path: Path) -> None:
    for name in ("uavaccel", "assets"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    before = flown_m(tmp_path)
    autopilot = tmp_path / "uavaccel" / "sim" / "autopilot.py"
    autopilot.write_text(autopilot.read_text().replace("pitch_goal = -clip(", "pitch_goal = clip("))
    assert before > 0
    assert flown_m(tmp_path) < 0
