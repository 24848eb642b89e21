"""The command line: quick, complete, one line for a mistake; what is asked for is what is typed; a run in words."""

import io
import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import nullcontext, suppress
from dataclasses import is_dataclass, replace
from errno import ENOSPC
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal, cast, get_args, get_origin

import pytest
import typer.main
from pydantic import BaseModel
from rich.console import Console
from typer.testing import CliRunner

from tests.golden import assert_as_recorded, plain
from tests.running import typed
from tools.write_cli_reference import reference
from uavaccel import __version__
from uavaccel.cli import experiments, terminal
from uavaccel.cli.main import app
from uavaccel.cli.options import one_of, shipped
from uavaccel.cli.terminal import columns_within
from uavaccel.draw.page import Table
from uavaccel.errors import Interrupted, UsageError, UserError
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment
from uavaccel.suites.keys import KEYS
from uavaccel.suites.registry import SUITES, find_suite
from uavaccel.suites.session import Plan, RunRequest, configure, manifest_of, planned, resumable, resumption_notes
from uavaccel.suites.suite import SimpleCase
from uavaccel.units import NS_PER_S
from uavaccel.wire import latency

ROOT = Path(__file__).parents[1]


def uavaccel(*arguments: str, **options: Any) -> "subprocess.CompletedProcess[str]":
    environment = {**os.environ, **options.pop("env", {})}
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, env=environment, text=True, check=False, **options)


# --- the shell --------------------------------------------------------------------------------------------------------


def test_the_reference_is_that_of_the_commands() -> None:
    assert (ROOT / "cli.md").read_text(encoding="utf-8") == reference(), "python tools/write_cli_reference.py > cli.md"


COMMANDS = ["init", "train", "evaluate", "watch", "export", "fly", "serve", "run", "doctor", "timing"]


TIMING = [f"timing {name}" for name in ("advise", "calibrate", "measure", "certify")]


@pytest.mark.parametrize("name", ["", *COMMANDS, *TIMING])
def test_help_is_short_and_fits_a_terminal(name: str) -> None:
    lines = typed(f"{name} -h").splitlines()
    assert lines == typed(f"{name} --help").splitlines()
    assert max(map(len, lines)) <= 80
    if not name:
        assert len(lines) <= 24  # a screen
        assert [line.split()[0] for line in lines if re.match("  [a-z]", line)] == COMMANDS


def test_experiments_are_listed_with_a_line_for_each() -> None:
    lines = typed("run --list").splitlines()
    assert max(map(len, lines)) <= 80
    assert [line.split()[0] for line in lines] == shipped("")
    assert all(line.split()[1:] for line in lines)


def test_the_version_is_the_packages() -> None:
    assert typed("--version") == f"uavaccel {__version__}\n"


def test_the_schema_is_of_the_suite_or_of_a_training() -> None:
    assert json.loads(typed("init --schema dp1"))["properties"]["rounds"]
    assert typed("init --schema") == typed("init --schema train")


@pytest.mark.skipif(not shutil.which("make"), reason="needs make")
def test_bare_make_lists_the_targets_and_makes_nothing() -> None:
    env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}  # of the make that tests
    done = subprocess.run(["make"], cwd=ROOT, env=env, capture_output=True, text=True, check=True)
    targets = ["help", "run", "test", "docs", "setup", "clean"]
    assert [line.split()[:2] for line in done.stdout.splitlines()] == [["make", target] for target in targets]


@pytest.mark.parametrize(("words", "completion"), [("uavaccel do", "doctor"), ("uavaccel serve --sce", "--scene")])
def test_the_shell_can_complete(words: str, completion: str) -> None:
    keys = {"_UAVACCEL_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    done = uavaccel("-m", "uavaccel", env=keys)
    assert completion in done.stdout.split()
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(("arguments", "unbuffered"), [(["--version"], ""), (["init", "--schema", "dp1"], "1")])
def test_who_reads_no_further_than_the_head_is_told_nothing(arguments: list[str], unbuffered: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = uavaccel("-m", "uavaccel", *arguments, stdout=writing, env={"PYTHONUNBUFFERED": unbuffered})
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


def test_what_is_complained_of_to_nobody_is_not_printed_elsewhere() -> None:
    command = f"{sys.executable} -m uavaccel nonsense 2>&-"
    done = subprocess.run(command, shell=True, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")


def test_words_of_options_and_experiments_are_completed() -> None:
    words = one_of("wall", "virtual", "lockstep")  # each of which has an l
    assert [words(typed) for typed in ("l", "lockstep", "k")] == [["lockstep"], ["lockstep"], []]
    assert words("") == ["wall", "virtual", "lockstep"]
    assert shipped("dp") == ["dp1", "dp2", "dp2_airsim"]
    assert not {"claims", "latency", "latency_airsim"} & set(shipped(""))
    for name, command in cast(Any, typer.main.get_command(app)).commands.items():
        if name != "timing":
            context = command.make_context(name, [], resilient_parsing=True)
            for option in [each for each in command.params if "|" in (each.metavar or "")]:
                assert [each.value for each in option.shell_complete(context, "")] == option.metavar.split("|")


# --- what is typed is what is asked for -------------------------------------------------------------------------------


def fields_of(model: type[BaseModel]) -> dict[str, Any]:
    """The annotations of a configuration's keys, those of its task below its own."""
    fields = {name: field.annotation for name, field in model.model_fields.items()}
    task = fields.get("task")
    inner = fields_of(task) if isinstance(task, type) and issubclass(task, BaseModel) else {}
    return inner | fields


@pytest.mark.parametrize("suite", SUITES)
def test_the_options_for_keys_take_what_the_configurations_take(suite: str) -> None:
    fields = fields_of(find_suite(suite, "").config)
    for name, key in KEYS.items():
        if name in fields:
            several = get_origin(fields[name]) is tuple
            assert several <= (name in experiments.GRIDS)
            kind = get_args(fields[name])[0] if several or type(None) in get_args(fields[name]) else fields[name]
            if get_origin(kind) is Annotated:
                kind = get_args(kind)[0]
            if get_origin(kind) is Literal:
                assert set(get_args(kind)) <= set(key.shown.split("|"))
            else:
                assert kind is key.kind, name


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """The functions behind the commands, by their last name, and what they were called with."""
    calls: list[tuple[Any, ...]] = []

    def stand_in(place: str) -> None:
        def call(*how: Any, **keys: Any) -> Any:
            calls.append((place.rpartition(".")[2], *how, *([keys] if keys else [])))
            if place.startswith(("realtime.", "calibration.")):  # whose answer would be told
                raise UserError("asked")
            return () if place.endswith(("film_game", "write_tables", "write_mcap", "write_minari")) else 0

        monkeypatch.setattr(f"uavaccel.{place}", call)

    for place in (
        "cli.experiments.run_experiment", "cli.experiments.evaluate_agent", "suites.flight.film_game",
        "watch.beside.show", "wire.service.serve", "fly.command.fly_script",
        "realtime.measure", "realtime.certify", "calibration.calibrate.advise", "calibration.calibrate.measure",
        "calibration.calibrate.check_agreement", "cli.experiments.report_runs", "suites.report.write_tables",
        "export.write_mcap", "export.write_minari",
    ):  # fmt: skip
        stand_in(place)
    monkeypatch.setattr("uavaccel.calibration.doctor.check_machine", lambda: {"verdict": "quiet"})
    monkeypatch.setattr("uavaccel.sim.camera.gl.describe_renderer", lambda: None)
    monkeypatch.setattr("uavaccel.suites.registry.open_run", str)
    read = latency.read_latency  # what ships is read, and kept
    monkeypatch.setattr(latency, "read_latency", lambda path: read(path) if path.is_relative_to(ROOT) else str(path))
    return calls


ON_ALL = "--timing virtual --profile airsim --games 7 --seed 9 --out folder --resume --dry-run --set a.b=1 --set c=2"
RUN_ALL = "--clock 5 --clock 10 --command adsc --t-move 0.5 --rounds 3 --seeds 4 --with past --jobs 6 --engine ray"
NOTHING: tuple[Any, ...] = (None, False, (), [], {})
TYPED = f"""
run dp1
run dp1 --watch --trust {RUN_ALL} {ON_ALL}
train
train --resume
train own.yaml --seeds 5 --jobs 2 --clock 5 --command tcsc --watch {ON_ALL}
evaluate straight --clock 5 --command tcsc --jobs 6 --engine dask --against other --no-films {ON_ALL}
evaluate --resume
evaluate run --resume
evaluate own.yaml
evaluate own.yml --against other
evaluate straight --sweep wind=0,3 --sweep light=1 --games 2 --timing virtual --set task.speed_m_s=2
watch default --film f.mp4
watch run --case a --film f.mp4
watch
watch --clock 5 --think 0.5 --seed 3
watch run --game 2 --host ::1 --port 9
serve
serve --settings s.json --clock 5 --port 9 --host ::1 --profile airsim --scene lane --recordings r
fly script.py --altitude 3 -- --film
fly --clock 2,5 --timing lockstep --check --until 8 --think 0.25 --seed 3 --settings s.json --no-settings \
--profile airsim --scene lane --out o --film --watch script.py -- --seed 4
timing measure p.onnx CartPole-v1
timing measure p.onnx CartPole-v1 --steps 5 --warm-up 3 --seed 4 --out o --answer 7 --trust --set chunk=2
timing certify p.onnx CartPole-v1
timing certify p.onnx CartPole-v1 --latency 0.1 --latency 0.2 --episodes 5 --seed 4 --success won --out o --resume \
--jobs 2 --answer 7 --trust --set chunk=2
timing certify p.onnx CartPole-v1 --latency t.json --factor 2 --factor 3
timing certify p.onnx CartPole-v1 --delay 1 --delay 2
timing advise
timing advise --t-move 0.5 --error 0.2 --rounds 3 --thinking 0.5 --profile airsim
timing advise --latency t.yaml
timing calibrate
timing calibrate --out l.yaml --commands 70 --profile airsim
timing calibrate --check
timing calibrate --check --games 3 --profile airsim --latency t.yaml
run --report a b --trust
export run --csv c --parquet p --mcap m
export run --mcap m --case a
export run --minari m-v0
"""


def test_a_command_asks_for_what_is_typed_and_no_more(asked: list[tuple[Any, ...]]) -> None:
    """What is not given is left out of the recording."""
    said = []
    for line in TYPED.strip().splitlines():
        with suppress(UserError):
            typed(line)
        said.append(f"uavaccel {line}")
        said += [f"    {name}: {'; '.join(map(given_text, given))}" for name, *given in asked]
        asked.clear()
    assert_as_recorded("asked", "\n".join([*said, ""]).replace(str(ROOT), "ROOT"))


def given_text(value: Any) -> str:
    """The fields of a record that say something, with those of records in it."""
    if is_dataclass(value):
        return f"{type(value).__name__} {given_text(vars(value))}"
    if isinstance(value, BaseModel):
        return f"{type(value).__name__} {vars(value)['name']!r}"
    if isinstance(value, dict):
        return f"({', '.join(f'{name} {given_text(each)}' for name, each in value.items() if each not in NOTHING)})"
    return getattr(value, "__name__", type(value).__name__) if callable(value) else str(value)


@pytest.mark.parametrize(
    ("after", "said"),
    [
        ("--check", "--check: comes before the script; what the script itself takes follows --"),
        ("7 --clock=3", "--clock: comes before the script; what the script itself takes follows --"),
        ("--clok 7", "--clok (did you mean --clock?): comes before the script; what the script itself takes"),
    ],
)
def test_an_option_of_fly_after_the_script_is_refused(asked: list[Any], after: str, said: str) -> None:
    with pytest.raises(UsageError, match=re.escape(said)):
        typed(f"fly script.py {after}")
    typed(f"fly script.py -- {after}")
    assert asked[0][1].flight.arguments == tuple(after.split())


def test_an_option_that_the_script_names_itself_is_its_own(asked: list[Any], tmp_path: Path) -> None:
    script = tmp_path / "own.py"
    script.write_text("parser.add_argument('--speed')")  # one letter from --seed
    typed(f"fly {script} --speed 3 --altitude 2 -h")
    assert asked[0][1].flight.arguments == ("--speed", "3", "--altitude", "2", "-h")


# --- a run in words ---------------------------------------------------------------------------------------------------

UNKNOWN = "wall time known after the first"


@pytest.mark.parametrize(
    ("left", "games", "jobs", "lines"),
    [
        ("abc", 1, 4, [f"3 games (1 wall, 2 virtual: measured and modelled), 1,235 simulated s, {UNKNOWN}, into out",
                       "1 game on the wall clock flies alone, in this process, one by one"]),
        ("bc", 2000, 1, [f"4,000 games in 2 cells (2 virtual: modelled), 235 simulated s, {UNKNOWN}, into out"]),
        ("", 1, 1, ["no game is left to be flown in out"]),
    ],
)  # fmt: skip
def test_a_plan_adds_up_the_games_that_are_left(left: str, games: int, jobs: int, lines: list[str]) -> None:
    times = {"a": ("wall", 1000.0), "b": ("virtual", 234.0), "c": ("virtual", 1.0)}
    cases = {name: SimpleCase(name, *time) for name, time in times.items()}
    suite: Any = SimpleNamespace(games=lambda config, case: games, unit="game" if games == 1 else "cell")
    request = RunRequest("own", jobs=jobs)
    plan = Plan(suite, None, list(cases.values()), [cases[name] for name in left], Path("out"), request)
    assert list(plan.lines()) == lines


OLD, MIDDLE, NEW = ({"uavaccel": "1", "numpy": numpy} for numpy in ("2.0", "2.1", "2.2"))
BEGUN, GONE_ON = {"commit": "a" * 40}, {"commit": "b" * 40}


@pytest.mark.parametrize(
    ("manifest", "now", "warned"),
    [
        ({"versions": OLD, "git": BEGUN}, {"versions": {**OLD, "ray": "3"}, "git": BEGUN}, []),
        ({"versions": OLD, "resumed": [{"versions": NEW}]}, {"versions": NEW}, ["numpy 2.0 then, 2.2 now"]),
        # the last start is the present one; the one before it counts
        ({"versions": OLD, "resumed": [{"versions": MIDDLE}, {}]}, {"versions": NEW}, ["numpy 2.1 then, 2.2 now"]),
        ({"versions": OLD, "resumed": [{"versions": NEW}, {"versions": NEW}]}, {"versions": NEW}, []),
        ({"git": BEGUN}, {"git": GONE_ON}, ["aaaaaaaaaaaa, now bbbbbbbbbbbb"]),
        ({"git": None}, {"git": GONE_ON}, []),
    ],
)  # fmt: skip
def test_a_run_that_goes_on_says_what_has_changed_since(
    manifest: dict[str, Any], now: dict[str, Any], warned: list[str]
) -> None:
    run: Any = SimpleNamespace(path=Path("out"), rows=lambda: [{}, {}], manifest=lambda: manifest)
    first, *warnings = resumption_notes(run, "5 cells", now)
    assert first == "going on with out: 2 of 5 cells are flown"
    assert [warning.startswith("warning: ") for warning in warnings] == [True] * len(warned)
    assert all(warning.endswith(ending) for warning, ending in zip(warnings, warned, strict=True))


@pytest.mark.parametrize("clocks", [[], [5.0], [5.0, 10.0]])
@pytest.mark.parametrize("given", [None, "virtual"])
def test_one_clock_speed_makes_a_quick_measured_experiment(clocks: list[float], given: str | None) -> None:
    suite, config = configure(RunRequest("dp1", {"clock_speed": clocks or None, "timing": given}))
    quick = len(clocks) == 1
    assert config.timing == (given or ("wall" if quick else "virtual"))
    assert all((config.model_dump(mode="json")[key] == value) is quick for key, value in (suite.quick or {}).items())


def test_commands_are_taken_in_any_case_and_kept_in_lower_case(tmp_path: Path) -> None:
    """As options, by --set and in files."""
    (tmp_path / "train.yaml").write_text("{suite: train, task: {command: ADSC}}")
    for request in (RunRequest("dp1", {"command": ["TCSC", "Adsc"]}), RunRequest("dp1", {}, ["command=[TCSC, Adsc]"])):
        assert configure(request)[1].command == ("tcsc", "adsc")
    for request in (RunRequest("train", {"command": "ADSC"}), RunRequest(str(tmp_path / "train.yaml"))):
        assert configure(request)[1].task.command == "adsc"


def test_an_unknown_experiment_is_told_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"^dp7: no such experiment; did you mean 'dp2'\?$"):
        configure(RunRequest("dp7"))
    with pytest.raises(UserError, match=r"^zebra: no such experiment; known: ablation, benchmark_smoke, ") as refused:
        configure(RunRequest("zebra"))
    assert "latency" not in str(refused.value).replace("rl_latency", "")
    assert "claims" not in str(refused.value)
    (tmp_path / "config.yaml").touch()
    with pytest.raises(UserError, match="a run, which --report computes again"):
        configure(RunRequest(str(tmp_path)))


def test_a_quick_run_says_so_and_with_which_keys(tmp_path: Path) -> None:
    """A file of one's own is flown as it says."""
    (tmp_path / "own.yaml").write_text("{suite: dp1, games: 7}")
    assert configure(RunRequest(str(tmp_path / "own.yaml"), {"clock_speed": [50.0]}))[1].games == 7
    quick = RunRequest("dp1", {"clock_speed": [50.0], "games": 20})
    with planned(quick) as plan:
        assert list(plan.lines())[1] == (
            "a quick run, since --clock names one ClockSpeed: timing=wall, games=20, reference_games=3; "
            "all games: --set clock_speed=[50]"
        )
    with planned(RunRequest("dp1", {}, ["clock_speed=[50]"])) as plan:
        assert len(list(plan.lines())) == 1


@pytest.mark.parametrize(("suite", "command"), [("train", "train"), ("evaluate", "evaluate"), (None, "run")])
def test_a_run_that_is_stopped_says_which_command_goes_on(suite: str | None, command: str, tmp_path: Path) -> None:
    out = tmp_path / "a run"  # as the shell takes it
    out.mkdir()
    (out / "config.yaml").touch()
    plan: Any = SimpleNamespace(out=out, request=RunRequest("train", suite=suite))
    full, named, wrong = OSError(ENOSPC, "is full", "rows"), UserError("rows: is full"), UserError("games = x")
    named.__cause__ = full
    memory = MemoryError(), UserError, "not enough memory: .*"
    stopped = KeyboardInterrupt(), Interrupted, "interrupted"
    for error, kind, said in (stopped, memory, *((each, UserError, "rows: is full") for each in (full, named))):
        expected = f"^{said}; " + re.escape(f"go on with: uavaccel {command} --resume --out '{out}'") + "$"
        with pytest.raises(kind, match=expected), resumable(plan):
            raise error
    with pytest.raises(UserError, match=r"^games = x$"), resumable(plan):
        raise wrong


def test_an_interrupted_command_says_so() -> None:
    """One that resumes nothing; Typer by itself makes a status of it, and no word."""
    program = (
        "from signal import SIGINT, raise_signal; from uavaccel.cli import experiments, main; "
        "experiments.report_runs = lambda *_: raise_signal(SIGINT); main.main(['run', '--report', 'runs'])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"uavaccel: interrupted\n")


def test_set_has_the_last_word_over_an_option() -> None:
    request = RunRequest("dp1", {"clock_speed": [5.0, 10.0], "games": 3}, ["games=4", "clock_speed.1=20"])
    config = configure(request)[1]
    assert (config.games, config.clock_speed) == (4, (5.0, 20.0))
    assert request.options["clock_speed"] == [5.0, 10.0], "what was asked for stays"


def test_a_resumed_plan_has_the_games_without_a_row(tmp_path: Path) -> None:
    options = {"clock_speed": [5.0], "timing": "virtual", "games": 1, "rounds": [1], "t_move_s": [1.0]}
    request = RunRequest("dp1", options, out=tmp_path / "run")
    with planned(request) as whole:
        run = RunDirectory.create(tmp_path / "run", whole.config, {})
    run.append_row({"case": whole.cases[2].id})
    fewer = RunRequest("dp1", {**options, "rounds": [2]}, out=tmp_path / "run", resume=True)
    with pytest.raises(UserError, match=r"has another configuration: rounds"), planned(fewer):
        raise AssertionError("there is no plan for it")
    with planned(RunRequest(None, out=tmp_path / "run", resume=True)) as again:
        assert [case.id for case in again.cases] == [case.id for case in whole.cases]
        assert [case.id for case in again.left] == [case.id for case in whole.cases if case is not whole.cases[2]]


def test_a_run_whose_part_has_changed_does_not_go_on(tmp_path: Path) -> None:
    whole, part = (tmp_path / f"{name}.yaml" for name in ("whole", "part"))
    whole.write_text(f"suite: paper\nparts: {{dp1-native: {{experiment: {part}}}}}\n")
    request = RunRequest(str(whole), out=tmp_path / "run")
    shutil.copy(experiment("dp1.yaml"), part)
    with planned(request) as plan:
        RunDirectory.create(tmp_path / "run", plan.config, manifest_of(plan.suite, plan.config, print))
    changed = pytest.raises(UserError, match=r"part\.yaml has changed")
    for old, new, expected in (("suite: ", "# the same\nsuite: ", nullcontext()), ("games: 20", "games: 21", changed)):
        part.write_text(part.read_text().replace(old, new))
        with expected, planned(replace(request, resume=True)):
            pass


TABLE = Table(("command", "effective speed-up", "source"), [("ADSC", "11.23", "modelled"), ("TCSC", "-", "x")])


@pytest.mark.parametrize(("width", "columns"), [(80, 3), (28, 3), (27, 2), (18, 2), (17, 1), (3, 1)])
def test_a_table_shows_the_columns_that_fit_uncut(
    width: int, columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of "command", "effective" and "modelled", two characters apart."""
    assert columns_within(TABLE, width) == columns
    monkeypatch.setattr(terminal, "console", Console(width=width, force_terminal=True))
    terminal.show_table(TABLE)
    shown = capsys.readouterr().out
    assert [cell in shown for cell in ("A", "11.23", "modelled")] == [number < columns for number in range(3)]


def test_the_time_left_is_at_the_pace_of_this_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten cells, two at a time, on a clock that moves by hand: two were flown before, and eight are to come."""
    now = SimpleNamespace(s=1000.0)
    clock = SimpleNamespace(now_ns=lambda: int(now.s * NS_PER_S))
    monkeypatch.setattr("uavaccel.clock.MonotonicClock", lambda: clock)
    cases = [SimpleCase(f"g{number}", "virtual", 20.004 if number < 6 else 100.004) for number in range(10)]
    said = io.StringIO()
    earlier = [{"case": "g0"}, {"case": "g1"}]
    suite: Any = SimpleNamespace(unit="cell", status=lambda rows: "")
    shown = terminal.Progress(suite, cases, 2, earlier, Console(file=said, width=120))
    # Of two that fly at once the first says nothing yet; then 40 s of 480 took 60 s, 60 took 120 and 80 took 120.
    for case, passed_s in (("g2", 60.1), ("g3", 0.0), ("g4", 60.1), ("g5", 0.0)):
        now.s += passed_s
        shown.flown(cases[int(case[1:])], {"case": case, "sim_time_s": 7.0})
    assert said.getvalue().startswith("3/10 cells, ")  # as the plan calls them
    left = [line.rpartition(", ")[2] for line in said.getvalue().splitlines()]
    assert left == ["time left unknown", "11 min left", "14 min left", "10 min left"]
    for last in cases[6:]:
        shown.flown(last, {"case": last.id})
    assert said.getvalue().endswith(", 0.0 s left\n")  # whatever fractions have left of it


# What a machine's own pace tells, and when it was.
OF_THE_MACHINE = re.compile(
    r"[\d.]+ simulated s per wall s(, .*)?|[\d.]+ (s|min) in all|(?<=took )[\d.]+ s of wall clock.*|\d+-\d\d-\d\dT\d+"
    r"|[\d.]+ ms\b.*|(?<=policy )\w{12}|(?<=rows )\w{12}"
)
SMALL = "--games 2 --no-films --set task.observation=state --set task.max_commands"
LEFT = "act.py:left CartPole-v1 --set default_action=0"
SESSION = f"""
run dp1 --clock 10 --timing virtual --t-move 0.5 --rounds 1 --games 1 --seed 3 --set reference_games=2 --out dp1
evaluate straight {SMALL}=4 --out one
evaluate offset:1 {SMALL}=4 --set first_lane=1 --against one --out two
evaluate offset:1 {SMALL}=4 --set first_lane=9 --against one --out one --dry-run
evaluate offset:1 {SMALL}=4 --set first_lane=9 --against one --out three
run --report one two --trust
evaluate straight {SMALL}=3 --sweep wind=0,4 --out sweep
run --resume --out sweep
evaluate act.py:hold --games 2 --set env_id=uavaccel/Hover-v0 --trust --no-films --out hover
train --games 3 --set task.observation=state --set task.max_commands=3 --set mirror=false --set hidden=[8] --out train
export one --csv csv --minari one-v0
export dp1 --csv logs --mcap logs/a.mcap --case adsc-k10-t0.5-r1-g00
timing certify {LEFT} --delay 0 --delay 3 --episodes 2 --trust --out certificate
timing measure {LEFT} --steps 3 --warm-up 1
"""
SHIPPED = "dp1 dp2_airsim evaluate hover_ppo mediation_flight realtime_wall rl_smoke train_robust"


@pytest.mark.slow
def test_a_session_prints_and_leaves_what_was_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each command its lines, the files that it has made, and of a run the summary and the last row."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "act.py").write_text("def hold(seen): return [0.0] * 3\n\n\ndef left(seen): return 0\n")
    told, there = list[str](), {Path("act.py")}
    for line in [*SESSION.strip().splitlines(), *(f"run {name} --dry-run" for name in SHIPPED.split())]:
        done = CliRunner().invoke(app, line.split())
        lines = [*done.output.splitlines(), *[repr(done.exception)] * (done.exit_code != 0)]
        told.append(f"$ {line}: {' / '.join(OF_THE_MACHINE.sub('OURS', ' '.join(each.split())) for each in lines)}")
        found = {path.relative_to(tmp_path) for path in tmp_path.glob("**/*") if path.is_file()}
        files = {path for path in found if "__pycache__" not in path.parts} - there
        there |= files
        names = sorted(str(path) for path in files if "parts" not in path.parts)
        told += [re.sub(r"events\.out\S*", "EVENTS", " ".join(names))] * bool(names)
        told += [Path(name).read_text().partition("\n")[0] for name in names if name.endswith("rows.csv")]
        for name in [name for name in names if Path(name).name == "summary.json"]:
            kept: Any = json.loads(Path(name).read_text()), RunDirectory(Path(name).parent).rows()[-1]
            machines = ("wall_s", "simulated_s_per_wall_s") * (line.startswith("train"))
            told += [
                plain({key: each for key, each in some.items() if key not in machines and "sha256" not in key})
                for some in kept
            ]
    assert_as_recorded("session", "\n".join([*told, ""]).replace(str(tmp_path), "HERE"))


# --- around an evaluation ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("simulator", [None, "mujoco", "kernels"])
def test_best_and_worst_game_are_filmed_under_their_names(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], simulator: str | None
) -> None:
    games = {"far": (False, 3, 9.0), "slow": (True, 30, 50.0), "near": (False, 3, 1.0), "quick": (True, 20, 50.0)}
    names = ("is_success", "commands", "distance_m")
    rows = [{"case": case, "lane": 0, **dict(zip(names, game, strict=True))} for case, game in games.items()]
    monkeypatch.setattr("uavaccel.suites.flight.film_game", lambda *filmed: [" ".join(map(str, filmed[:-1]))])
    monkeypatch.setattr("uavaccel.sim.camera.gl.describe_renderer", lambda: None)
    config = {} if simulator is None else {"simulator": simulator}
    run: Any = SimpleNamespace(path="run", rows=lambda: rows, config=lambda: config, file=str)
    experiments.film_extremes(run)
    said = capsys.readouterr().out.splitlines()
    assert said[-3::2] == ["run quick None films/best.mp4", "run near None films/worst.mp4"]
    assert ("exact simulator" in said[0]) == (simulator == "kernels")


def test_a_run_is_reported_even_where_its_films_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(run: RunDirectory) -> None:
        assert not run.file("report.html").exists()
        raise OSError("no room")

    monkeypatch.setattr(experiments, "film_extremes", breaks)
    keys = ["task.observation=state", "task.max_commands=1"]
    request = RunRequest("evaluate", {"agent": "straight", "games": 1}, keys, out=tmp_path / "run", suite="evaluate")
    with pytest.raises(OSError, match="no room"):
        experiments.evaluate_agent(request, None, films=True)
    assert (tmp_path / "run" / "report.html").is_file()
    asked: list[Any] = []
    monkeypatch.setattr(experiments, "run_experiment", lambda *how: asked.append(how[2]))
    for films in (True, False, None):
        experiments.evaluate_agent(request, None, films)
    for begun in ([], ["--no-films"]):  # a run that is resumed keeps to what it was begun with
        (tmp_path / "run/manifest.json").write_text(json.dumps({"command_line": ["uavaccel", "evaluate", *begun]}))
        for films in (None, True):
            experiments.evaluate_agent(replace(request, resume=True), None, films)
    assert asked == [breaks, None, breaks, breaks, breaks, None, breaks]
