"""The wheel, installed away from a checkout: its commands work where nothing can be written, without a compiler."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("hatchling", reason="without network, a wheel is built by the hatchling that is installed")

ROOT = Path(__file__).parents[1]
AS_ANY_USER = (shutil.which("setpriv"), "--bounding-set=-dac_override,-fowner")  # root may write where nobody else may
OF_EXTRAS = ["av", "cv2", "h5py", "mcap", "scipy", "stable_baselines3", "tensorboard", "torch"]
LEARNING = ("train", "evaluate")  # with PyTorch
SCRIPT = """
import airsim
client = airsim.MultirotorClient()
client.enableApiControl(True)
client.moveByVelocityAsync(1, 0, 0, 2).join()
print(f"north {client.getMultirotorState().kinematics_estimated.position.x_val:.1f}")
"""


def built(target: str, source: Path, folder: Path) -> Path:
    """The sdist or the wheel of a source tree; without build's own environment, which would need a package index."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", str(folder)]
    subprocess.run(command, cwd=source, capture_output=True, check=True)
    (made,) = folder.iterdir()
    return made


def test_an_sdist_builds_the_wheel_of_its_checkout(tmp_path: Path) -> None:
    sdist = built("sdist", ROOT, tmp_path / "sdist")
    subprocess.run(["tar", "--extract", "--file", sdist, "--directory", tmp_path], check=True)
    (unpacked,) = tmp_path.glob("uavaccel-*")
    wheels = [built("wheel", source, tmp_path / f"of-{source.name}") for source in (ROOT, unpacked)]
    assert wheels[0].name == wheels[1].name
    assert wheels[0].read_bytes() == wheels[1].read_bytes()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages with uavaccel's wheel alone, which nobody may write to."""
    folder = tmp_path_factory.mktemp("installed")
    wheel, packages = built("wheel", ROOT, folder / "wheel"), folder / "site"
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(packages)]
    subprocess.run([*install, str(wheel)], capture_output=True, check=True)
    for path in (packages, *packages.rglob("*")):
        path.chmod(path.stat().st_mode & ~0o222)
    return packages


@contextmanager
def uavaccel(site: Path, folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A command of the wheel without extras that it does not need; PATH has nothing, no compiler; its home is new."""
    missing = [name for name in OF_EXTRAS if name != "torch" or arguments[0] not in LEARNING]
    (folder / "sitecustomize.py").write_text(f"import sys\nsys.modules.update(dict.fromkeys({missing}))\n")
    unprivileged = AS_ANY_USER if os.geteuid() == 0 and AS_ANY_USER[0] else ()
    command = [*map(str, unprivileged), sys.executable, "-m", "uavaccel", *arguments]
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
    before = sorted(site.rglob("*"))
    for command, said in (
        (f"{grid} --out path", "report: path/report.html"),
        ("fly script.py", "north 1.2"),
        (f"train --games 2 {small} --set mirror=false --out learned", "report: learned/report.html"),
        ("evaluate learned --games 1 --out evaluated", "without films: MP4: needs av: pip install"),
    ):
        with uavaccel(site, tmp_path, *command.split()) as process:
            output = process.communicate()[0]
        assert process.returncode == 0, output
        assert said in output
    assert (tmp_path / "learned" / "policy.pt").is_file()
    with uavaccel(site, tmp_path, "watch") as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = re.search(r"http://\S+(?=;)", line)
        assert address is not None, line + process.stdout.read()
        with urllib.request.urlopen(address[0], timeout=30) as page:
            assert "<html" in page.read().decode()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    assert sorted(site.rglob("*")) == before
