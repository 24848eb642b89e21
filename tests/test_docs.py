"""Every block of the pages: programs run, command lines are taken with options and keys, YAML files fit their suites.

What a block needs is in the page: a block with a title is a file, `uavaccel init` and `cd` are done. A comment above a
block says where the test is content with less, `<!-- in the test: 20_000 becomes 256 -->`.
"""

from __future__ import annotations

import contextlib
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import gymnasium
import pytest

from tests.test_document import parse
from uavaccel.cli import experiments as cli_experiments
from uavaccel.cli.machine import init
from uavaccel.cli.main import app
from uavaccel.config import load_yaml, validate
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.resources import asset
from uavaccel.rl import agents
from uavaccel.rl.policy import load_policy
from uavaccel.sim.lane import Difficulty, LaneFile
from uavaccel.suites.session import RunRequest, configure
from uavaccel.suites.train import TrainConfig

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("experiments/*.md")])
FENCE = re.compile(
    r'^(?:<!-- in the test: ([^>\n]+) -->\n+)?```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE
)
FLOWN = {"run", "train", "evaluate"}
MADE = "docs/data.md"  # whose programs load what its commands have written
OPTIONAL = {"pyarrow": "--parquet"}  # packages that the tests can do without, and what needs them


# In place of the runtime that flies a policy's file.
STRAIGHT_AHEAD = """
from types import SimpleNamespace

KEYS = {"headings_deg": "[-60, -30, 0, 30, 60]", "speed_m_s": "2.0", "altitude_m": "2.0"}


class InferenceSession:
    def __init__(self, path):
        self.get_modelmeta = lambda: SimpleNamespace(custom_metadata_map=KEYS)

    def run(self, names, inputs):
        assert names == ["action"] and inputs["seen"].shape == (1, 3, 144, 256)
        return [[2]]
"""


class Block(NamedTuple):
    """A fenced block; `folder` is where the page's `cd` have led, `code` is the test's."""

    page: str
    line: int
    language: str
    title: str
    code: str
    folder: str


def blocks_of(page: Path) -> Iterator[Block]:
    text, folder = page.read_text(encoding="utf-8"), "."
    for found in FENCE.finditer(text):
        smaller, language, title, code = found.groups()
        for shown, tested in re.findall(r"(\S+) becomes (\S+?)(?:,|$)", smaller or ""):
            assert shown in code, f"{page}: nothing to replace: {shown}"
            code = code.replace(shown, tested)
        line = text.count("\n", 0, found.start()) + 1
        yield Block(page.relative_to(ROOT).as_posix(), line, language, title or "", code, folder)
        for went in re.findall(r"^cd (\S+)$", code, re.MULTILINE) if language == "sh" else ():
            folder = f"{folder}/{went}"


def lines_of(block: Block) -> list[str]:
    """Those of a shell; what make has set up is what is on a reader's path."""
    joined = block.code.replace("\\\n", " ")
    return [line.removeprefix(".venv/bin/") for line in joined.splitlines() if line]


BLOCKS = [block for page in PAGES for block in blocks_of(page)]
COMMANDS = [
    (block, line.partition(" #")[0])
    for block in BLOCKS
    if block.language == "sh"
    for line in lines_of(block)
    if line.startswith("uavaccel ")
]


def in_language(language: str) -> list[Any]:
    return [pytest.param(block, id=f"{block.page}:{block.line}") for block in BLOCKS if block.language == language]


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of a page's reader: the files that the page shows, and the runs that it makes."""

    @cache
    def made(page: str) -> Path:
        folder = tmp_path_factory.mktemp("reader")
        (folder / "experiments").symlink_to(ROOT / "experiments")
        (folder / "lane.yaml").write_text("obstacles: [{x_m: 12, y_m: 0.5, half_side_m: 0.4}]")
        for block in [block for block in BLOCKS if block.page == page]:
            here = folder / block.folder
            for line in lines_of(block) if block.language == "sh" else ():
                if name := re.match(r"uavaccel init (\S+)", line):
                    init(str(here / name[1]))
                for model in re.findall(r"^uavaccel evaluate (\S+\.(?:zip|onnx))", line):
                    make_model(here / model)
                for suite, out in re.findall(r"^uavaccel (?:run )?(\w+).* --out (\S+)", line):
                    make_run(here / out, suite)
            if block.title:
                (here / block.title).write_text(block.code)
        return folder

    return made


def make_run(folder: Path, suite: str) -> None:
    """What looks like a run before it is opened, with the policy that ships."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(f"suite: {suite.partition('_')[0]}")
    (folder / "manifest.json").write_text("{}")
    for file in asset("policies/default").iterdir():
        with contextlib.suppress(FileExistsError):
            (folder / file.name).symlink_to(file)


NEEDED = {".zip": ("stable_baselines3",), ".onnx": ("onnxscript", "onnxruntime")}
"""The packages without which there is no model in a file of this kind."""


def make_model(file: Path) -> None:
    """Make a model as other programs save it, where their packages are there."""
    if not all(map(find_spec, NEEDED[file.suffix])):
        return
    if file.suffix == ".zip":
        from stable_baselines3 import PPO

        PPO("MlpPolicy", gymnasium.make("uavaccel/Hover-v0"), device="cpu").save(file)
    else:
        from uavaccel.rl.onnx_file import write_onnx

        write_onnx(load_policy(asset("policies/default")), file)


@pytest.fixture
def reading(home: Callable[[str], Path], block: Block, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """In the block's folder, with nothing left of the modules that it makes, before and afterwards."""
    monkeypatch.chdir(home(block.page) / block.folder)
    monkeypatch.setattr(sys, "path", [str(Path.cwd()), *sys.path])
    for title in {Path(block.title).stem for block in BLOCKS if block.title}:
        monkeypatch.delitem(sys.modules, title, raising=False)
    yield
    for name, module in [*sys.modules.items()]:
        if str(getattr(module, "__file__", None) or "").startswith(str(Path.cwd())):
            del sys.modules[name]


def test_every_fence_is_a_block_of_a_known_kind() -> None:
    kinds = {"sh", "python", "yaml", "json", "text", "mermaid", "console"}
    assert {block.language for block in BLOCKS} == kinds
    for page in PAGES:
        fences = re.findall("^```", page.read_text(encoding="utf-8"), re.MULTILINE)
        assert len(fences) == 2 * len(list(blocks_of(page))), page


@pytest.mark.slow
@pytest.mark.wall_clock
@pytest.mark.opengl
@pytest.mark.usefixtures("reading")
@pytest.mark.parametrize("block", in_language("python"))
def test_programs_run(
    block: Block,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """As they stand, each a module of its own; scripts of AirSim's client fly as their page flies them."""
    if "import airsim" in block.code:
        Path("onnxruntime.py").write_text(STRAIGHT_AHEAD)
        assert not app([*flown_by(block), block.title], standalone_mode=False)
        return
    if block.page == MADE:
        if any(f"from {package} " in block.code and not find_spec(package) for package in OPTIONAL):
            pytest.skip("the package that it loads with is not installed")
        make_everything(tmp_path_factory.getbasetemp() / "made", monkeypatch)
        capsys.readouterr()
    module = ModuleType(Path(block.title).stem or "block")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(block.code, f"{block.page}:{block.line}", "exec"), module.__dict__)
    assert "print(" not in block.code or capsys.readouterr().out


def make_everything(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once, what the commands of the page MADE write; the folder is the working directory."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", "datasets")  # which the page's program sets
    first = not folder.exists()
    folder.mkdir(exist_ok=True)
    monkeypatch.chdir(folder)
    for block, line in COMMANDS if first else ():
        missing = [option for package, option in OPTIONAL.items() if not find_spec(package)]
        if block.page == MADE and not any(option in line for option in missing):
            shorter = ["--set", "task.max_commands=2", "--no-films"] if line.startswith("uavaccel evaluate") else []
            assert not app([*shlex.split(line)[1:], *shorter], standalone_mode=False)


def flown_by(block: Block) -> list[str]:
    """The page's own command line, less a second flight and the script."""
    [line] = [line for each, line in COMMANDS if each.page == block.page and line.endswith(f" {block.title}")]
    return [word for word in shlex.split(line)[1:-1] if word != "--check"]


@pytest.mark.parametrize("block", in_language("yaml"))
@pytest.mark.usefixtures("reading")
def test_yaml_files_fit_their_suites(block: Block) -> None:
    """Or are a lane, whose keys are LaneFile's."""
    mapping = load_yaml(Path(block.title))
    if "obstacles" in mapping:
        validate(LaneFile, mapping, block.title)
        return
    assert mapping["suite"]
    configure(RunRequest(block.title))


@pytest.mark.usefixtures("reading")
@pytest.mark.parametrize(
    ("block", "line"), COMMANDS, ids=[f"{block.page}:{block.line}:{line}" for block, line in COMMANDS]
)
def test_commands_are_taken(block: Block, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands and options are there, and of an experiment its name and every key; nothing is trained or flown."""
    _, name, *options = shlex.split(line)
    for package in NEEDED.get(Path(options[0]).suffix if name == "evaluate" and options else "", ()):
        pytest.importorskip(package)
    asked: list[RunRequest] = []
    monkeypatch.setattr(agents, "load_policy", policy_once)
    monkeypatch.setattr(cli_experiments, "run_experiment", lambda request, *_: asked.append(request))
    if name not in FLOWN or "--report" in options:
        parse([name, *options])
        return
    goes_on = "--resume" in options
    app([name, *options, "--dry-run"], standalone_mode=False)
    [request] = asked
    if not goes_on:
        configure(request)


def test_other_programs_come_with_the_package() -> None:
    shell = [line for block in BLOCKS if block.language == "sh" for line in lines_of(block)]
    known = {"uavaccel", "python", "make", "cd", "docker", "git", "pip", "source"}
    others = {line.split()[0] for line in shell} - known
    assert others <= {script.name for script in entry_points(group="console_scripts")}


policy_once = cache(load_policy)  # a sweep reads it for each of its cells


def environment_keys() -> list[str]:
    """The names in the last cells of the environment's tables of keys."""
    text = (ROOT / "docs" / "environment.md").read_text(encoding="utf-8")
    tables = re.findall(r"^\|.*\| key \|\n((?:\|.*\n)+)", text, re.MULTILINE)
    cells = [row.rsplit("|", 2)[1] for table in tables for row in table.splitlines()]
    return [name.split(".")[-1] for cell in cells for name in re.findall(r"`([^`]+)`", cell)]


def test_keys_are_those_of_the_configuration() -> None:
    known = {*LaneTask.model_fields, *Difficulty.model_fields, *TrainConfig.model_fields}
    assert len(environment_keys()) > 20
    assert set(environment_keys()) <= known
