"""The hot loop's machine code follows the sources that it was compiled from, in whatever file they are."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLY = """
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.vehicle.goal import of_velocity
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
world = World("blocks", NATIVE)
world.lead.set_goal(of_velocity(VelocityGoal((1.0, 0.0, 0.0))))
world.advance(100)
print(world.lead.state["position"][0])
"""


def flown_m(checkout: Path) -> float:
    done = subprocess.run(
        [sys.executable, "-c", FLY], cwd=checkout, capture_output=True, text=True, check=True
    )
    return float(done.stdout)


@pytest.mark.slow
def test_a_change_of_any_file_that_the_hot_loop_reaches_is_flown(tmp_path: Path) -> None:
    """A function of a new file, and behind it a number of another new one: no list of files knows them."""
    for name in ("uavaccel", "assets"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    sim = tmp_path / "uavaccel" / "sim"
    (sim / "sign.py").write_text("SIGN = 1.0\n")
    imports = "from uavaccel.parts import part\nfrom uavaccel.sim import sign\n"
    function = imports + "\n\n@part\ndef signed(x):\n    return {} * x\n"
    (sim / "signed.py").write_text(function.format("sign.SIGN"))
    pilot = (sim / "vehicle" / "autopilot.py").read_text()
    pilot = pilot.replace(
        "from uavaccel.parts import part\n",
        "from uavaccel.parts import part\nfrom uavaccel.sim.signed import signed\n",
    )
    (sim / "vehicle" / "autopilot.py").write_text(
        pilot.replace("pitch_goal = -tilt_goal(", "pitch_goal = -signed(1.0) * tilt_goal(")
    )
    before = flown_m(tmp_path)
    (sim / "sign.py").write_text("SIGN = -1.0\n")
    turned = flown_m(tmp_path)
    (sim / "signed.py").write_text(function.format("0.5 * sign.SIGN"))
    assert before > 0
    assert turned < flown_m(tmp_path) < 0, "half as steep"
