"""The wheel, installed away from a checkout: its commands work where nothing can be written, without a compiler."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("hatchling", reason="without network, a wheel is built by the hatchling that is installed")

ROOT = Path(__file__).parents[1]
AS_ANY_USER = (shutil.which("setpriv"), "--bounding-set=-dac_override,-fowner")  # root may write where nobody else may
OF_EXTRAS = ["av", "cv2", "h5py", "mcap", "scipy", "stable_baselines3", "tensorboard"]
SCRIPT = """
import airsim
client = airsim.MultirotorClient()
client.enableApiControl(True)
client.moveByVelocityAsync(1, 0, 0, 2).join()
print(f"north {client.getMultirotorState().kinematics_estimated.position.x_val:.1f}")
"""
ONE_AFTER_ANOTHER = """
import sys
from uavaccel.cli.main import app
for line in sys.argv[1:]:
    if line.startswith("train "):
        del sys.modules["torch"]  # which was missing
    assert not app(line.split(), standalone_mode=False)
"""


def built(target: str, source: Path, folder: Path) -> Path:
    """The sdist or the wheel of a source tree; without build's own environment, which would need a package index."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", str(folder)]
    subprocess.run(command, cwd=source, capture_output=True, check=True)
    (made,) = folder.iterdir()
    return made


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built("wheel", ROOT, tmp_path_factory.mktemp("wheel"))


def test_an_sdist_builds_the_wheel_of_its_checkout(wheel: Path, tmp_path: Path) -> None:
    sdist = built("sdist", ROOT, tmp_path / "sdist")
    subprocess.run(["tar", "--extract", "--file", sdist, "--directory", tmp_path], check=True)
    (unpacked,) = tmp_path.glob("uavaccel-*")
    again = built("wheel", unpacked, tmp_path / "again")
    assert again.name == wheel.name
    assert again.read_bytes() == wheel.read_bytes()


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages with uavaccel's wheel alone, which nobody may write to."""
    packages = tmp_path_factory.mktemp("installed") / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(packages)]
    subprocess.run([*install, str(wheel)], capture_output=True, check=True)
    for path in (packages, *packages.rglob("*")):
        path.chmod(path.stat().st_mode & ~0o222)
    return packages


@contextmanager
def program(site: Path, folder: Path, missing: Sequence[str], *words: str) -> Iterator[subprocess.Popen[str]]:
    """A program of the wheel without some extras; PATH has nothing, no compiler; its home is new."""
    (folder / "sitecustomize.py").write_text(f"import sys\nsys.modules.update(dict.fromkeys({missing}))\n")
    unprivileged = AS_ANY_USER if os.geteuid() == 0 and AS_ANY_USER[0] else ()
    command = [*map(str, unprivileged), sys.executable, *words]
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA_", "XDG_"))}
    environment |= {"PYTHONPATH": f"{site}:{folder}", "PATH": str(folder), "HOME": str(folder), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.wall_clock
def test_an_installed_wheel_runs_trains_flies_and_watches(site: Path, tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    grid = "run dp1 --clock 50 --games 1 --timing virtual --set reference_games=1 --set rounds=[1] --set t_move_s=[1.0]"
    small = "--set environments=2 --set turns=1 --set task.max_commands=3 --set task.observation=state"
    commands = {
        f"{grid} --out path": "report: path/report.html",
        "fly script.py": "north 1.2",
        f"train --games 2 {small} --set mirror=false --out learned": "report: learned/report.html",
        "evaluate learned --games 1 --no-films --out evaluated": "report: evaluated/report.html",
    }
    before = sorted(site.rglob("*"))
    with program(site, tmp_path, [*OF_EXTRAS, "torch"], "-c", ONE_AFTER_ANOTHER, *commands) as process:
        output = process.communicate()[0]
    assert process.returncode == 0, output
    assert [said for said in commands.values() if said not in output] == [], output
    assert (tmp_path / "learned" / "policy.pt").is_file()
    with program(site, tmp_path, OF_EXTRAS, "-m", "uavaccel", "watch") as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = re.search(r"http://\S+(?=;)", line)
        assert address is not None, line + process.stdout.read()
        with urllib.request.urlopen(address[0], timeout=30) as page:
            assert "<html" in page.read().decode()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    assert sorted(site.rglob("*")) == before
