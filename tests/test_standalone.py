"""The wheel of the real-time room alone: what it imports, where Gymnasium and NumPy are all there is."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest

from tests.test_wheel import ROOT, built

ALONE = ("gymnasium", "numpy", "cloudpickle", "farama-notifications", "typing_extensions")  # with what Gymnasium needs
LOADED = "import sys; print(*(name for name in sys.modules if name.startswith('uavaccel')))"
NOTEBOOK = ROOT / "docs" / "real_time.ipynb"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built("wheel", ROOT / "standalone", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages with the wheel, Gymnasium and NumPy."""
    folder = tmp_path_factory.mktemp("alone")
    for name in ALONE:
        found = distribution(name)
        for top in {path.parts[0] for path in found.files or () if path.parts[0] not in ("..", "__pycache__")}:
            (folder / top).symlink_to(Path(str(found.locate_file(top))))
    with zipfile.ZipFile(wheel) as file:
        file.extractall(folder)
    return folder


def run(site: Path, program: str, folder: Path) -> str:
    """What a program prints that finds these packages alone."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    command = [sys.executable, "-S", "-W", "error", "-c", program]
    environment |= {"PYTHONPATH": str(site), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def modules(wheel: Path) -> set[str]:
    names = [Path(name) for name in zipfile.ZipFile(wheel).namelist() if name.endswith(".py")]
    return {".".join(name.parent.parts if name.stem == "__init__" else name.with_suffix("").parts) for name in names}


@pytest.mark.parametrize("first", ["", "import gymnasium\n"])
def test_each_of_its_modules_is_needed_and_finds_what_it_needs(
    first: str, wheel: Path, site: Path, tmp_path: Path
) -> None:
    """Whether Gymnasium is imported before, where uavaccel registers its environments, which are not here."""
    there = modules(wheel)
    program = first + "".join(f"import {name}\n" for name in sorted(there) if name.startswith("uavaccel.realtime"))
    assert set(run(site, program + LOADED, tmp_path).split()) == there


def test_it_needs_gymnasium_and_numpy(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as file:
        (name,) = [name for name in file.namelist() if name.endswith("METADATA")]
        told = file.read(name).decode().splitlines()
    needed = [line.removeprefix("Requires-Dist: ") for line in told if line.startswith("Requires-Dist")]
    assert [line.partition(">")[0].partition("<")[0] for line in needed] == ["gymnasium", "numpy"]


def test_the_notebooks_example_runs_there(site: Path, tmp_path: Path) -> None:
    """It prints what it was saved with; its figures need Matplotlib."""
    cells = [cell for cell in json.loads(NOTEBOOK.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]
    cells = [cell for cell in cells if "matplotlib" not in "".join(cell["source"])]
    saved = ["".join(output["text"]) for cell in cells for output in cell["outputs"] if output.get("name") == "stdout"]
    assert run(site, "\n".join("".join(cell["source"]) for cell in cells), tmp_path) == "".join(saved)


def test_what_is_measured_is_replayed_there(site: Path, tmp_path: Path) -> None:
    """And certified. A calibration file in YAML needs PyYAML, and says so; the one that is written is JSON too."""
    program = """
import gymnasium
from uavaccel.errors import UserError
from uavaccel.realtime import RealTime, certify
env = RealTime(gymnasium.make("CartPole-v1"), "measured", default_action=0)
env.reset(seed=0)
env.step(1)
env.thinking.save("thinking.yaml")
how = {"calibration": "thinking.yaml", "episodes": 1, "default_action": 0}
print(certify("CartPole-v1", lambda seen: 1, **how).line.partition(",")[0])
open("own.yaml", "w").write("latency: {request_us: {call: [1]}}")
try:
    RealTime(gymnasium.make("CartPole-v1"), "own.yaml", default_action=0)
except UserError as error:
    print(error)
"""
    certified, complaint = run(site, program, tmp_path).splitlines()
    assert certified == "<lambda> in CartPole-v1: holds 90% of its return without latency"
    assert complaint == "own.yaml: no JSON, and to read YAML PyYAML is needed: pip install pyyaml"
