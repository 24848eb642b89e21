"""The suite of one's own that docs/own-suite.md shows: run, killed, resumed and reported from outside the package."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

import uavaccel
from tests.conftest import forget_own_code, modules_below
from uavaccel import VelocityGoal, open_session, tcsc
from uavaccel.cli.main import app
from uavaccel.errors import UserError
from uavaccel.own_code import as_noted, file_beside, folder_of, imported_code, look_also_in, own_function, trusting
from uavaccel.processes.workers import on_this_machine
from uavaccel.records import RunDirectory
from uavaccel.resources import asset
from uavaccel.rl.policy import MANIFEST, read_manifest
from uavaccel.suites.registry import find_suite, suite_of

pytestmark = pytest.mark.usefixtures("whole_messages")

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "own-suite.md").read_text(encoding="utf-8")
FOUND = re.findall(r"^```(\w+)[^\n]*\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
BLOCKS = dict(reversed(FOUND))
RUN, REPORT = (line.split()[1:] for line in BLOCKS["sh"].splitlines())
MADE = ("rows.jsonl", "summary.json", "config.yaml")


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page's two files and the run of its first command."""
    folder = tmp_path_factory.mktemp("home")
    (folder / "toy.py").write_text(BLOCKS["python"])
    (folder / "toy.yaml").write_text(BLOCKS["yaml"])
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "path", [*sys.path])
        forget_own_code(patch)
        assert [*on_this_machine(2, 1, [(abs, (-1,), {})] * 2)] == [1, 1]  # by workers that do not know this folder
        app(RUN, standalone_mode=False)
    for name in modules_below(folder):
        del sys.modules[name]
    return folder


def test_it_has_thirty_lines_at_most() -> None:
    assert sum(bool(line.strip()) for line in BLOCKS["python"].splitlines()) <= 30


@pytest.mark.slow
def test_rows_say_how_far_each_speed_goes_and_the_page_shows_it(home: Path) -> None:
    rows = [json.loads(line) for line in (home / "runs/toy/rows.jsonl").read_text().splitlines()]
    assert [row["case"] for row in rows] == ["speed-0.5", "speed-1", "speed-1.5", "speed-2"]
    with open_session("lockstep") as session:
        *_, end = tcsc(session.start_game(1.0), VelocityGoal((1.5, 0.0, 0.0)), 1.0, 0.1)
    assert rows[2]["north_m"] == end.position_m[0]
    assert np.all(np.diff([row["north_m"] for row in rows]) > 0)
    page = (home / "runs/toy/report.md").read_text()
    assert "![Rising curves, one a speed.](figures/north.png)" in page
    assert "| case | north\\_m | speed\\_m\\_s |" in page
    assert json.loads((home / "runs/toy/summary.json").read_text())["speed-1.5"] == rows[2]["north_m"]


@pytest.mark.slow
def test_killed_and_resumed_it_ends_with_the_same_bytes(
    home: Path,
    here: Path,
    said: Callable[[str], str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Of the run in two processes, one process flies again what is left after a kill in the middle of a line."""
    yaml, out = home / "toy.yaml", shutil.copytree(home / "runs/toy", home / "runs/killed")
    whole = (out / "rows.jsonl").read_bytes()
    (out / "rows.jsonl").write_bytes(whole[: whole.index(b"\n") + 20])
    for name in ("timing.jsonl", "summary.json"):
        (out / name).unlink()
    assert said(f"run {yaml} --out {out} --resume") == ""
    for name in MADE:
        assert (out / name).read_bytes() == (home / "runs/toy" / name).read_bytes()
    for code, refused in (
        (BLOCKS["python"].replace("speed-", "v"), pytest.raises(UserError, match="which is no case of toy now: ")),
        (f"{BLOCKS['python']}\n", nullcontext()),
    ):
        yaml.with_name("toy.py").write_text(code)
        forget_own_code(monkeypatch)
        for name in modules_below(yaml.parent):
            monkeypatch.delitem(sys.modules, name)
        with refused:
            app(["run", str(yaml), "--out", str(out), "--resume"], standalone_mode=False)
    assert "warning: toy.py: changed since the run was begun" in capsys.readouterr().out


@pytest.mark.slow
def test_a_report_finds_the_suite_from_any_folder(home: Path, here: Path, said: Callable[[str], str]) -> None:
    run = home / "runs/toy"
    before = (run / "summary.json").read_bytes()
    (run / "summary.json").unlink()
    assert said(f"{' '.join(REPORT[:-1])} {run} --trust") == ""
    assert (run / "summary.json").read_bytes() == before


@pytest.mark.parametrize(("place", "function"), [("return GameResult(", "fly"), ("return (Speed(", "cases")])
def test_what_goes_wrong_in_its_flights_is_one_line(
    place: str, function: str, here: Path, said: Callable[[str], str]
) -> None:
    text = BLOCKS["python"].replace(place, f"raise SystemExit(3)\n        {place}")
    (here / "toy.py").write_text(text)
    (here / "toy.yaml").write_text(BLOCKS["yaml"])
    line = text.partition("raise SystemExit")[0].count("\n") + 1
    assert said("run toy.yaml --out run").endswith(f"{here}/toy.py:{line}: Toy.{function}: SystemExit: 3")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("stranger:Stranger", "names no uavaccel.suites.suite.Suite: Stranger is none"),
        ("stranger:called", "names no uavaccel.suites.suite.Suite: called is none"),
        ("stranger:Friend", "names no uavaccel.suites.suite.Suite: stranger has no Friend"),
        *((f"{name}:abort", f"no module '{name}' in ") for name in ("nobody", "os", "numpy", "a/b", "..x", "")),
        *(
            (f"{name}:abort", "'my-own' is no name that Python can import")
            for name in ("my-own", "x.my-own", "/my-own.py")
        ),
        ("json:dumps", "HERE/json.py has the name of another module, "),
    ],
)
def test_a_suite_that_is_none_is_one_line(name: str, hint: str, here: Path) -> None:
    """What is installed, and Python itself, is no project's; whatever a name stands for, it is not called."""
    (here / "stranger.py").write_text("class Stranger:\n    pass\ndef called():\n    raise SystemExit\n")
    (here / "json.py").write_text("raise SystemExit\n")
    with trusting(), pytest.raises(UserError) as caught:
        find_suite(name, "toy.yaml")
    assert str(caught.value).startswith(f"toy.yaml: suite = {name!r}: {hint.replace('HERE', str(here))}")


def test_own_code_finds_the_environments_in_a_worker_process(here: Path) -> None:
    """In which this package was imported before Gymnasium."""
    (here / "user.py").write_text("import gymnasium, uavaccel\ngymnasium.spec('uavaccel/Hover-v0')\n")
    program = "from uavaccel.own_code import own_module, trusting\nwith trusting(): own_module('user', 'user.yaml')"
    subprocess.run([sys.executable, "-c", program], env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True)


def test_a_suite_in_a_package_is_imported_from_above_it(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a later process by a run that notes its folder, from anywhere."""
    package = here / "toys" / "inner"
    package.mkdir(parents=True)
    for name in ("__init__.py", "toy.py"):
        (package / name).write_text(BLOCKS["python"])
    for module in ("toys.inner.toy", "toys.inner"):
        with trusting(beside=here):
            assert folder_of(type(find_suite(f"{module}:Toy", "toy.yaml"))) == here
        forget_own_code(monkeypatch)
        monkeypatch.chdir("/")
        look_also_in(str(here))
        assert folder_of(type(find_suite(f"{module}:Toy", "toy.yaml"))) == here
    assert folder_of(type(find_suite("dp1", "dp1.yaml"))) is None
    forget_own_code(monkeypatch)
    monkeypatch.chdir(here)
    (package / "__init__.py").write_text(FOREIGN)  # runs before what is in the package
    with pytest.raises(UserError, match=r"toy\.py has changed since it was trusted"):
        find_suite("toys.inner.toy:Toy", "toy.yaml")


def test_of_modules_of_one_name_a_run_means_that_of_its_folder(here: Path) -> None:
    """Whichever folders others have noted before; a policy's, too, which is read once."""
    folders = [here / "one", here / "other"]
    for folder in folders:
        shutil.copytree(asset("policies/default"), folder)
        manifest = json.loads((folder / MANIFEST).read_text())
        (folder / MANIFEST).write_text(json.dumps({**manifest, "own_code": str(folder)}))
        (folder / "toy.py").write_text(BLOCKS["python"])
        with trusting(beside=folder):
            assert folder_of(type(find_suite("toy:Toy", "toy.yaml"))) == folder
    for folder in (*folders, folders[0]):
        read_manifest(folder)
        assert folder_of(type(find_suite("toy:Toy", "toy.yaml"))) == folder
    (here / "toy.py").write_text(BLOCKS["python"])
    (folder / "config.yaml").write_text("{suite: toy:Toy, training: {env_id: 'toy.py:Toy', agent: 'offset:1'}}")
    (folder / "manifest.json").write_text(json.dumps({"own_code": str(folder)}))
    assert folder_of(type(suite_of(RunDirectory(folder)))) == folder, "not that of the working directory"
    assert RunDirectory(folder).config()["training"] == {"env_id": f"{folder}/toy.py:Toy", "agent": "offset:1"}
    for strange in ("x" * 5_000, "\0", str(folder)):
        for name in ("toy:Toy", "../\0.py:A", f"{'x' * 300}:A"):
            assert as_noted({"agent": name}, strange)["agent"] in (name, f"{folder}/toy.py:Toy")


FOREIGN = """
from pathlib import Path
Path("ran").touch()
raise ImportError("it ran")
"""


def foreign_run(here: Path, folder: str) -> None:
    """A run's folder from elsewhere, whose suite is said to be in another folder."""
    (here / "run").mkdir()
    (here / "run/config.yaml").write_text("suite: foreign:Evil\n")
    (here / "run/manifest.json").write_text(json.dumps({"own_code": str(here / folder)}))
    (here / "run/rows.jsonl").write_text('{"suite": "evil", "case": "a"}\n')


@pytest.mark.parametrize("command", [
    "report run", "view run", "watch run", "export run --csv tables", "export run --mcap games", "evaluate run",
    *(f"{name} --out run --resume" for name in ("run", "train", "evaluate")),
])  # fmt: skip
def test_a_folder_from_elsewhere_runs_nothing(
    command: str, here: Path, said: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever its code is: in the folder that it names, in the working directory, in both."""
    foreign_run(here, "run")
    monkeypatch.setattr("uavaccel.sim.camera.gl.describe_renderer", lambda: None)
    for place in ("run", "."):
        (here / place / "foreign.py").write_text(FOREIGN)
        assert "Traceback" not in said(command)
        assert not (here / "ran").exists()


@pytest.mark.parametrize("command", [
    "run dp1 --set suite=foreign:Evil",
    "run realtime_smoke --set environments.x.id=foreign:X-v0",
    "run sweep --set evaluation.experiment=theirs.yaml",
    "run mine.yaml",
    "run named.yaml --set suite=foreign:Evil",
])  # fmt: skip
def test_code_that_the_named_yaml_does_not_name_needs_trust(
    command: str, here: Path, said: Callable[[str], str]
) -> None:
    """Named by --set, or by a file that --set or a key of the user's own file names."""
    (here / "foreign.py").write_text(FOREIGN)
    (here / "theirs.yaml").write_text("suite: foreign:Evil\n")
    (here / "named.yaml").write_text("suite: another:Suite\n")
    (here / "mine.yaml").write_text("suite: sweep\nevaluation: {experiment: theirs.yaml}\nsweep: {wind: [3]}\n")
    asks = "foreign.py is code that nobody has trusted here: read it, then add --trust"
    assert asks in said(f"{command} --dry-run")
    assert not (here / "ran").exists()
    assert "it ran" in said(f"{command} --dry-run --trust")


def test_a_file_here_goes_before_one_beside_the_yaml(here: Path) -> None:
    (here / "theirs").mkdir()
    for folder in ("theirs", "."):
        (here / folder / "lane.yaml").write_text("obstacles: []\n")
        with trusting(beside=here / "theirs"):
            assert file_beside("lane.yaml").resolve() == here / folder / "lane.yaml"


def test_own_code_is_trusted_once_until_it_changes(
    here: Path, said: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    foreign_run(here, ".")
    (here / "foreign.py").write_text(FOREIGN)
    for command in ("run --report", "watch", "export --mcap logs"):
        assert "foreign.py is code that nobody has trusted here: read it, then add --trust, once" in said(
            f"{command} run"
        )
    assert "it ran" in said("run --report run --trust")
    monkeypatch.chdir(here / "run")
    assert "it ran" in said("run --report .")
    (here / "foreign.py").write_text(f"{FOREIGN}\n")
    assert "foreign.py has changed since it was trusted" in said("run --report .")
    (here / "elsewhere").mkdir()
    (here / "foreign.py").rename(here / "elsewhere/foreign.py")
    (here / "run/manifest.json").write_text(json.dumps({"own_code": str(here / "elsewhere")}))
    assert "no module 'foreign' in" in said("run --report . --trust")


def test_code_runs_once_it_is_trusted_also_without_a_home(
    here: Path, said: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    foreign_run(here, ".")
    (here / "foreign.py").write_text(FOREIGN)
    (here / "state").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(here / "state"))
    assert "it ran" in said("run --report run --trust")


def test_projects_of_one_process_may_have_modules_of_one_name(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That beside the YAML file goes before that of the working directory, and so do those that it imports."""
    monkeypatch.setattr("sys.path", [*sys.path])
    said = []
    for name in ("", "theirs", ""):
        (here / name / "parts").mkdir(parents=True, exist_ok=True)
        (here / name / "same_name.py").write_text("from parts.helper import NAME\ndef act(): return NAME")
        (here / name / "parts/helper.py").write_text(f"NAME = {name!r}")
        with trusting(beside=here / name):
            said.append(own_function("same_name:act", "agent")[0]())
    assert said == ["", "theirs", ""]


@pytest.mark.parametrize("file", ["pilot.py", "helper.py"])
def test_in_a_notebook_code_that_was_edited_flies_as_it_is_now(file: str, here: Path) -> None:
    """Also in workers, which are not those of the run before."""
    (here / "pilot.py").write_text("from helper import EAST\ndef act(seen): return EAST")
    (here / "helper.py").write_text("EAST = 3")
    known = set()
    for heading in (3, 1):
        keys = {"games": 1, "simulator": "kernels", "task": {"observation": "state", "t_move_s": 0.1, "history": 1}}
        run = uavaccel.evaluate("pilot.py:act", trust=True, out=here / f"run{heading}", **keys)
        assert set(run.rows()[0]["actions"]) == {heading}
        known.add(imported_code())
        (here / file).write_text((here / file).read_text().replace("= 3", "= 1 ").replace("return EAST", "return 1"))
    assert len(known) == 2
    (here / file).write_text("raise SystemExit('it ran')")
    with pytest.raises(UserError, match=r"pilot\.py has changed since it was trusted|it ran"):
        uavaccel.film(run)


WRONG = """
from contextlib import nullcontext
from typing_extensions import TypedDict
from uavaccel.forms import ArrayForm
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.suite import GameResult, SimpleCase, Suite

class Config(Experiment):
    suite: str

class Own(Suite):
    name, config, names = "own", Config, ("a", "b")
    def cases(self, config):
        return (SimpleCase(name, "lockstep", 0.0) for name in self.names)
    def open(self, config, timing, run):
        return nullcontext()
    def fly(self, config, case, opened):
        return self.flown(case)

class Wrong(Own):
"""
FLOWN = "flown = lambda self, case: GameResult({'0': 1, 'x!q': 2, 'timing': 'late', 'seed': [1]})"
TOLD = ("summary", "title", "headline", "overview", "source", "page", "status")
CALLED = ("prepare", "finish", "check", "renders")


@pytest.mark.parametrize(("line", "reason"), [
    ("config = None", "Wrong.config has to be a subclass"),
    ("config = dict", "Wrong.config has to be a subclass"),
    ("name = None", "Wrong.name has to be a text"),
    ("names = ('a', 'a')", "two cases are called 'a'"),
    ("names = ()", "own: there is no game to fly: cases is empty"),
    ("names = ('../a',)", "a case cannot be called '../a'"),
    ("flown = lambda self, case: None", "fly of a returned a NoneType"),
    ("flown = lambda self, case: GameResult({'value': object()})", "its row is no JSON: 'value': Obj"),
    ("flown = lambda self, case: GameResult({'value': ['\\ud800']})", "'value': 'utf-8' codec can't encode"),
    ("flown = lambda self, case: GameResult({'case': 'c'})", "of no other case"),
    ("flown = lambda self, case: GameResult([1])", "its row has to be a mapping"),
    ("flown = lambda self, case: GameResult({1: 2})", "its row has 1 for a name"),
    ("cases = lambda self, config: None", "own: cases returned a NoneType"),
    ("cases = lambda self, config: [{'id': 'a'}]", "own: cases has a dict without id, timing, simulated_s"),
    ("cases = lambda self, config: [SimpleCase('a', 'never', 1.0)]", "own: a has the timing 'never': should be wall"),
    ("cases = lambda self, config: [SimpleCase('a', 'virtual', float('nan'))]", "own: a takes nan simulated s"),
    ("open = lambda self, *_: 3; flown = lambda self, case: GameResult({})", "own: open returned a int"),
    *((f"{FLOWN}; {name} = lambda *_: 1", f"own: {name} returned a int, not") for name in TOLD),
    *((f"{FLOWN}; {name} = lambda *_: 1 / 0", "Wrong.<lambda>: ZeroDivision") for name in (*TOLD, *CALLED)),
    (f"{FLOWN}; summary = lambda self, report: {{'a': {{1}}}}", "own: summary is no JSON: 'a': Object of type set"),
    (f"{FLOWN}; page = lambda self, report: [{{}}]", "own: page yields a dict, no block: a text, Heading"),
    ("flown = lambda self, case: GameResult({'suite': 'a'})", "fly of a: its row: suite = 'a': this is a run of own"),
    (f"{FLOWN}; row = TypedDict('R', {{'x': int}})", "fly of a: its row: key 'x' is missing"),
    ("flown = lambda self, case: GameResult({}, {'a': [1]}); arrays = {'b': ArrayForm('f')}", "has no array 'b'"),
    ("cases = lambda self, config: [SimpleCase('a', 'virtual', '1')]", "own: a takes '1' simulated s"),
    ("flown = lambda self, case: GameResult({}, {'a': [[1], [1, 2]]})", "its arrays have to be a mapping of numbers"),
    ("flown = lambda self, case: GameResult({}, [1])", "its arrays have to be a mapping of numbers"),
])  # fmt: skip
def test_a_mistake_in_one_is_one_line(line: str, reason: str, here: Path, said: Callable[[str], str]) -> None:
    (here / "wrong_suites.py").write_text(f"{WRONG}    {line}\n")
    (here / "own.yaml").write_text("suite: wrong_suites:Wrong\n")
    assert reason in said("run own.yaml --out run")


@pytest.mark.parametrize(
    ("page", "told"),
    [
        ("'Alone.'", "Alone."),
        ("['One.', 'Two.']", "One.\n\nTwo."),
        ("Suite.page(*_)", "| case |\n| --- |\n| a |\n| b |"),
    ],
)
def test_a_page_is_a_text_several_blocks_or_a_table_of_the_rows(page: str, told: str, here: Path) -> None:
    line = f"flown = lambda self, case: GameResult({{}}, {{'a': [1]}}); page = lambda *_: {page}"
    (here / "wrong_suites.py").write_text(f"{WRONG}    {line}\n")
    (here / "own.yaml").write_text("suite: wrong_suites:Wrong\n")
    app(["run", "own.yaml", "--out", "run"], standalone_mode=False)
    report, *kept = ((here / "run" / name).read_text() for name in ("report.md", "config.yaml", "manifest.json"))
    assert f"\n{told}\n\n## Provenance" in report
    assert all(text in report for text in kept)
