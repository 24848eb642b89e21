"""Every program in docs/learning.md runs, and every command line is one that the command line takes."""

import re
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest
import typer

from tests.opengl import needs_opengl
from uavaccel.cli.main import app
from uavaccel.cli.run import RunRequest, configure
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.resources import asset
from uavaccel.sim.lane.layout import Difficulty
from uavaccel.suites.training.config import TrainConfig

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "learning.md"
TEXT = PAGE.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
PYTHON = [code for language, code in BLOCKS if language == "python"]
SHELL = [line for language, code in BLOCKS if language == "sh" for line in code.splitlines()]


def test_there_are_blocks_of_two_kinds() -> None:
    assert {language for language, _ in BLOCKS} == {"python", "sh"}
    assert TEXT.count("```") == 2 * len(BLOCKS)


def test_programs_have_thirty_lines_at_most() -> None:
    assert max(len(code.splitlines()) for code in PYTHON) <= 30


@pytest.mark.slow
@needs_opengl
@pytest.mark.parametrize("code", PYTHON)
def test_programs_run(code: str) -> None:
    subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=ROOT, check=True)


@pytest.mark.parametrize("line", [line for line in SHELL if line.startswith("uavaccel ")])
def test_commands_parse(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Options exist, and the keys that they set are valid; nothing is trained or flown."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "seed0").symlink_to(asset("policies/default"))
    (tmp_path / "lane.yaml").write_text("obstacles: [{x_m: 12, y_m: 0.5, half_side_m: 0.4}]")
    _, name, *options = line.split()
    group = typer.main.get_command(app)
    command = group.commands[name]  # type: ignore[attr-defined]
    given = command.make_context(name, options).params
    if name in ("view", "export"):  # set no keys
        return
    keys = {key: given[key] for key in ("command", "timing", "profile", "games", "seed")}
    keys |= {"clock_speed": given["clock"], "agent": given.get("agent")}
    keys = {key: value or None for key, value in keys.items()}  # typer has no empty lists
    configure(RunRequest(given.get("experiment") or name, keys, given["overrides"] or []))


def test_other_programs_come_with_the_package() -> None:
    others = {line.split()[0] for line in SHELL} - {"uavaccel"}
    assert others <= {script.name for script in entry_points(group="console_scripts")}


def keys() -> list[str]:
    """The names in the last cells of the tables of keys."""
    tables = re.findall(r"^\|.*\| key \|\n((?:\|.*\n)+)", TEXT, re.MULTILINE)
    cells = [row.rsplit("|", 2)[1] for table in tables for row in table.splitlines()]
    return [name.split(".")[-1] for cell in cells for name in re.findall(r"`([^`]+)`", cell)]


def test_keys_are_those_of_the_configuration() -> None:
    known = {*LaneTask.model_fields, *Difficulty.model_fields, *TrainConfig.model_fields}
    assert len(keys()) > 20
    assert set(keys()) <= known
