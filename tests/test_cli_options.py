"""What each command of `uavaccel` hands on of what was typed: every option under its own name, and the defaults."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from uavaccel.bench.batch import BatchSize
from uavaccel.cli import evaluate, run, view
from uavaccel.cli.main import app
from uavaccel.cli.run import RunRequest, duration, expected_wall_s, plan, resumption_notes
from uavaccel.errors import UserError
from uavaccel.rl.policy import MANIFEST
from uavaccel.suites.suite import Cost, SimpleCase
from uavaccel.watch.beside import PageAddress


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """The functions behind the commands, by their last name, and what they were called with."""
    calls: list[tuple[Any, ...]] = []

    def stand_in(name: str) -> None:
        def call(*arguments: Any, **options: Any) -> None:
            calls.append((name.rpartition(".")[2], *arguments, *options.items()))

        monkeypatch.setattr(f"uavaccel.{name}", call)

    for name in (
        "cli.run.run_experiment", "cli.evaluate.evaluate_agent", "cli.evaluate.sweep_agent", "cli.fly.fly_script",
        "cli.calibrate.show_agreement", "cli.calibrate.write_calibration", "cli.advise.show_advice",
        "cli.bench.run_benches", "cli.doctor.examine", "cli.view.view_game",
        "cli.watch.watch", "cli.export.export", "cli.serve.serve",
    ):  # fmt: skip
        stand_in(name)
    return calls


def typed(line: str) -> None:
    done = CliRunner().invoke(app, line.split())
    assert done.exit_code == 0, done.output


NOTHING = dict.fromkeys(("clock_speed", "command", "timing", "profile", "games", "seed"))
OF_RUN = NOTHING | dict.fromkeys(("t_move_s", "rounds", "seeds", "with_run"))
ON_ALL = "--timing virtual --profile airsim --games 7 --seed 9 --out folder --resume --dry-run --set a.b=1 --set c=2"
FLOWN: dict[str, Any] = {"timing": "virtual", "profile": "airsim", "games": 7, "seed": 9}
REQUEST = {"overrides": ["a.b=1", "c=2"], "out": Path("folder"), "resume": True, "dry_run": True}
PLAIN = asdict(RunRequest(None, overrides=[]))


@pytest.mark.parametrize(
    ("line", "name", "request_"),
    [
        ("run dp1", "run_experiment", {"experiment": "dp1", "options": OF_RUN}),
        (
            f"run dp1 --clock 5 --clock 10 --command adsc --t-move 0.5 --rounds 3 --seeds 4 --with past --jobs 6 "
            f"--engine ray --watch {ON_ALL}",
            "run_experiment",
            {
                "experiment": "dp1",
                "options": FLOWN | {
                    "clock_speed": [5.0, 10.0], "command": ["adsc"], "t_move_s": [0.5], "rounds": [3], "seeds": 4,
                    "with_run": "past",
                },
                "jobs": 6, "engine": "ray", "page": asdict(PageAddress()), **REQUEST,
            },
        ),
        ("train", "run_experiment", {"experiment": "train", "options": NOTHING, "suite": "train"}),
        ("train --resume", "run_experiment", {"options": NOTHING, "suite": "train", "resume": True}),
        (
            f"train own.yaml --clock 5 --command tcsc --watch-at :9 {ON_ALL}",
            "run_experiment",
            {
                "experiment": "own.yaml", "options": FLOWN | {"clock_speed": 5.0, "command": "tcsc"},
                "suite": "train", "page": asdict(PageAddress(port=9)), **REQUEST,
            },
        ),
        (
            f"evaluate straight --clock 5 --command tcsc --jobs 6 --engine dask --against other --no-films {ON_ALL}",
            "evaluate_agent",
            {
                "experiment": "evaluate",
                "options": FLOWN | {"clock_speed": 5.0, "command": "tcsc", "agent": "straight"},
                "suite": "evaluate", "jobs": 6, "engine": "dask", **REQUEST,
            },
        ),
        (
            "evaluate --resume", "evaluate_agent",
            {"options": NOTHING | {"agent": None}, "suite": "evaluate", "resume": True},
        ),
        (
            "evaluate --sweep wind=0,3 --sweep mass=1", "sweep_agent",
            {"experiment": "evaluate", "options": NOTHING | {"agent": None}, "suite": "evaluate"},
        ),
    ],
)  # fmt: skip
def test_a_run_is_asked_for_with_every_option_and_no_other(
    told: list[tuple[Any, ...]], line: str, name: str, request_: dict[str, Any]
) -> None:
    typed(line)
    [(called, request, *others)] = told
    assert called == name
    assert asdict(request) == PLAIN | request_
    expected = {
        "run_experiment": [],
        "evaluate_agent": [Path("other"), False] if "--against" in line else [None, True],
        "sweep_agent": [["wind=0,3", "mass=1"], None],
    }
    assert others == expected[name]


@pytest.mark.parametrize(
    ("line", "call"),
    [
        ("calibrate", ("write_calibration", Path("latency.yaml"), 1500, "native")),
        (
            "calibrate --out mine.yaml --commands 70 --profile airsim",
            ("write_calibration", Path("mine.yaml"), 70, "airsim"),
        ),
        ("calibrate --check", ("show_agreement", None, "native", 20)),
        (
            "calibrate --check --latency mine.yaml --profile airsim --games 3",
            ("show_agreement", Path("mine.yaml"), "airsim", 3),
        ),
        ("advise", ("show_advice", 1.0, 0.1, 4, None, "native")),
        (
            "advise --t-move 0.5 --error 0.25 --rounds 2 --latency mine.yaml --profile airsim",
            ("show_advice", 0.5, 0.25, 2, Path("mine.yaml"), "airsim"),
        ),
        ("bench", ("run_benches", [], 0.0, None, BatchSize((8,), None, None, "shared"))),
        (
            "bench batch dvs --soak-s 3 --out b.json --lanes 4 --lanes 16 --processes 2 --tiles 5 --renderer own",
            ("run_benches", ["batch", "dvs"], 3.0, Path("b.json"), BatchSize((4, 16), 2, 5, "own")),
        ),
        ("doctor", ("examine",)),
        ("view", ("view_game", "default", None, None)),
        ("view run --case a --out films", ("view_game", "run", "a", Path("films"))),
        ("export run", ("export", "run", *[None] * 6)),
        (
            "export run --onnx o --csv c --parquet p --mcap m --minari n --case a",
            ("export", "run", *map(Path, "ocpmn"), "a"),
        ),
    ],
)  # fmt: skip
def test_a_command_hands_on_what_it_was_given(
    told: list[tuple[Any, ...]], line: str, call: tuple[Any, ...]
) -> None:
    typed(line)
    assert told == [call]


@pytest.mark.parametrize(
    ("line", "asked"),
    [
        ("watch", (None, None, None, 50.0, 0.012, 0, "127.0.0.1", 8080)),
        (
            "watch run --case a --game 2 --clock 5 --think 0.5 --seed 3 --host ::1 --port 9",
            (Path("run"), "a", 2, 5.0, 0.5, 3, "::1", 9),
        ),
        ("serve", (None, None, None, None, "native", "blocks", None)),
        (
            "serve --settings s.json --clock 5 --port 9 --host ::1 --profile airsim --scene lane --recordings r",
            (Path("s.json"), 5.0, 9, "::1", "airsim", "lane", Path("r")),
        ),
    ],
)
def test_a_page_and_a_server_are_those_that_were_asked_for(
    told: list[tuple[Any, ...]], line: str, asked: tuple[Any, ...]
) -> None:
    typed(line)
    [(_, request)] = told
    assert tuple(vars(request).values()) == asked


def test_options_before_a_script_are_the_flights_and_those_after_it_its_own(
    told: list[tuple[Any, ...]],
) -> None:
    typed("fly script.py --clock 3 --film")
    typed(
        "fly --clock 2,5 --timing lockstep --check --until 8 --think 0.25 --seed 3 --settings s.json --no-settings "
        "--profile airsim --scene lane --out o --film --watch-at ::1:9 script.py --seed 4"
    )
    [(_, plain), (_, full)] = told
    assert (plain.clocks, plain.check, plain.find_settings, plain.out, plain.page) == (
        (),
        False,
        True,
        None,
        None,
    )
    assert plain.flight.arguments == ("--clock", "3", "--film")
    assert (plain.flight.timing, plain.flight.film, plain.flight.seed) == ("virtual", False, None)
    assert (full.clocks, full.check, full.find_settings, full.out) == ((2.0, 5.0), True, False, Path("o"))
    assert full.page == PageAddress("::1", 9)
    flight = {name: value for name, value in vars(full.flight).items() if value is not None}
    assert flight == {
        "script": Path("script.py"), "arguments": ("--seed", "4"), "folder": Path(), "timing": "lockstep",
        "profile": "airsim", "scene": "lane", "settings": Path("s.json"), "think_s": 0.25, "seed": 3,
        "until_s": 8.0, "film": True, "settings_found": False,
    }  # fmt: skip


def test_several_runs_of_a_suite_are_compared_and_one_alone_is_not(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    done: list[tuple[str, list[str]]] = []

    class Run:
        def __init__(self, path: Path) -> None:
            self.path = path

        def config(self) -> dict[str, str]:
            return {"suite": self.path.name[:-1]}

    def compare(runs: list[Run]) -> list[Path]:
        done.append(("compared", [run.path.name for run in runs]))
        return [Path("compared.png")]

    monkeypatch.setattr("uavaccel.records.RunDirectory", Run)
    monkeypatch.setattr("uavaccel.cli.run.report_run", lambda run: done.append(("reported", [run.path.name])))
    monkeypatch.setattr("uavaccel.suites.registry.suite_of", lambda run: SimpleNamespace(compare=compare))
    typed("report train1 dp1 train2")
    reported = [("reported", [name]) for name in ("train1", "dp1", "train2")]
    assert done == [*reported, ("compared", ["train1", "train2"])]


# --- a run in words --------------------------------------------------------------------------------------------------


def test_jobs_share_the_games_of_a_simulated_clock_alone() -> None:
    cost = Cost(12.0, 0.0)
    shares = {
        timing: expected_wall_s(SimpleCase("a", timing, 1.0), cost, 4)
        for timing in ("wall", "virtual", "lockstep")
    }
    assert shares == {"wall": 12.0, "virtual": 3.0, "lockstep": 3.0}


def test_a_plan_adds_up_games_simulated_time_wall_time_and_bytes() -> None:
    costs = {"a": Cost(1200.0, 1.5e6), "b": Cost(2400.0, 2.5e6), "c": Cost(1200.0, 0.0)}
    cases = [
        SimpleCase("a", "wall", 1000.0),
        SimpleCase("b", "virtual", 234.0),
        SimpleCase("c", "virtual", 1.0),
    ]

    def planned(games: int, *chosen: SimpleCase) -> str:
        suite = SimpleNamespace(cost=lambda config, case: costs[case.id], games=lambda config, case: games)
        return plan(suite, None, chosen, 4, Path("out"))  # type: ignore[arg-type]

    assert planned(1, *cases) == (
        "3 games (1 wall, 2 virtual: measured and modelled), 1,235 simulated s: estimated 35 min and 4 MB, into out"
    )
    assert planned(2000, *cases[1:]) == (
        "4,000 games in 2 cells (2 virtual: modelled), 235 simulated s: estimated 15 min and 2 MB, into out"
    )
    assert planned(1, cases[2]).endswith("estimated 5 min and 1 MB, into out")
    assert planned(1) == "no game is left to be flown in out"


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (59.9, "under a minute"), (60.0, "1 min"), (600.0, "10 min"), (5399.0, "90 min"), (5400.0, "1.5 h"),
        (36_000.0, "10.0 h"),
    ],
)  # fmt: skip
def test_a_duration_is_in_the_unit_that_suits_it(seconds: float, words: str) -> None:
    assert duration(seconds) == words


OLD, MIDDLE, NEW = ({"uavaccel": "1", "numpy": numpy} for numpy in ("2.0", "2.1", "2.2"))
BEGUN, GONE_ON = {"commit": "a" * 40}, {"commit": "b" * 40}


@pytest.mark.parametrize(
    ("manifest", "now", "warned"),
    [
        ({"versions": OLD}, {"versions": OLD}, []),
        ({"versions": OLD, "resumed": [{"versions": NEW}]}, {"versions": NEW}, ["numpy 2.0 then, 2.2 now"]),
        # the last start is the present one; the one before it counts
        (
            {"versions": OLD, "resumed": [{"versions": MIDDLE}, {"versions": NEW}]}, {"versions": NEW},
            ["numpy 2.1 then, 2.2 now"],
        ),
        ({"versions": OLD, "resumed": [{"versions": NEW}, {"versions": NEW}]}, {"versions": NEW}, []),
        ({"versions": OLD}, {"versions": {**OLD, "ray": "3"}}, []),  # which was not there before
        ({"git": BEGUN}, {"git": BEGUN}, []),
        ({"git": BEGUN}, {"git": GONE_ON}, ["aaaaaaaaaaaa, now bbbbbbbbbbbb"]),
        ({"git": None}, {"git": GONE_ON}, []),
    ],
)  # fmt: skip
def test_a_run_that_goes_on_says_what_has_changed_since_its_last_start(
    manifest: dict[str, Any], now: dict[str, Any], warned: list[str]
) -> None:
    run_ = SimpleNamespace(path=Path("out"), rows=lambda: [{}, {}], manifest=lambda: manifest)
    first, *warnings = resumption_notes(run_, 5, now)  # type: ignore[arg-type]
    assert first == "going on with out: 2 of 5 games are flown"
    assert len(warnings) == len(warned)
    for warning, ending in zip(warnings, warned, strict=True):
        assert warning.startswith("warning: ")
        assert warning.endswith(ending)


@pytest.mark.parametrize(
    ("options", "timing"),
    [
        ({"clock_speed": [5.0]}, "wall"),
        ({"clock_speed": [5.0], "timing": "virtual"}, "virtual"),
        ({"clock_speed": [5.0, 10.0]}, "virtual"),
        ({}, "virtual"),
    ],
)
def test_an_experiment_at_one_clock_speed_is_quick_and_measured_unless_told_otherwise(
    options: dict[str, Any], timing: str
) -> None:
    suite, config = run.configure(RunRequest("dp1", options))
    quick = len(options.get("clock_speed", ())) == 1
    assert config.timing == timing  # type: ignore[attr-defined]
    for key, value in (suite.quick or {}).items():
        assert (config.model_dump(mode="json")[key] == value) == quick


# --- what follows an evaluation --------------------------------------------------------------------------------------


@pytest.mark.parametrize("simulator", [None, "mujoco", "kernels"])
def test_the_best_and_the_worst_game_are_filmed_under_their_names(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], simulator: str | None
) -> None:
    rows = [
        {"case": "far", "is_success": False, "commands": 3, "distance_m": 9.0},
        {"case": "slow", "is_success": True, "commands": 30, "distance_m": 50.0},
        {"case": "near", "is_success": False, "commands": 3, "distance_m": 1.0},
        {"case": "quick", "is_success": True, "commands": 20, "distance_m": 50.0},
    ]
    written: list[tuple[str, ...]] = []
    monkeypatch.setattr(view, "film_of_game", lambda run, case: (case, f"film of {case}"))
    monkeypatch.setattr(view, "write_film", lambda *what: written.append(what))
    config = {} if simulator is None else {"simulator": simulator}
    evaluate.film_extremes(SimpleNamespace(rows=lambda: rows, config=lambda: config, file=str))  # type: ignore[arg-type]
    assert written == [
        (f"film of {case}", f"films/{name}.mp4", f"films/{name}.png")
        for case, name in (("quick", "best"), ("near", "worst"))
    ]
    assert ("exact simulator" in capsys.readouterr().out) == (simulator == "kernels")


EVALUATED = [{"suite": "evaluate", "lane": lane} for lane in (2, 3)]
OF_ANOTHER = [{"suite": "dp2", "lane": lane} for lane in (0, 1, 2)]


@pytest.mark.parametrize(
    ("rows", "games", "comparable"),
    [(EVALUATED, 3, True), (EVALUATED, 2, False), (OF_ANOTHER, 3, False), ([], 3, False)],
)
def test_evaluations_are_compared_where_they_have_a_lane_in_common(
    monkeypatch: pytest.MonkeyPatch, rows: list[dict[str, Any]], games: int, comparable: bool
) -> None:
    """Which is found out before anything is flown."""
    suite = SimpleNamespace(
        name="evaluate", cases=lambda config: [SimpleNamespace(lane=lane) for lane in range(games)]
    )
    other = SimpleNamespace(path=Path("other"), rows=lambda: rows)
    flown: list[tuple[RunRequest, Any]] = []
    monkeypatch.setattr(evaluate, "RunDirectory", lambda _: other)
    monkeypatch.setattr(evaluate, "configure", lambda _: (suite, None))
    monkeypatch.setattr(evaluate, "check_jobs", lambda *_: None)
    monkeypatch.setattr(evaluate, "run_experiment", lambda *told: flown.append(told))
    request = RunRequest("evaluate")
    if comparable:
        evaluate.evaluate_agent(request, Path("other"), films=False)
        assert flown == [(request, None)]
        return
    with pytest.raises(UserError, match="is no evaluation of the same lanes"):
        evaluate.evaluate_agent(request, Path("other"), films=False)
    assert not flown


@pytest.mark.parametrize(("case", "lane"), [(None, 0), ("lane-000007", 7), ("lane-12", 12)])
def test_of_a_policy_the_first_lane_is_shown_unless_one_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, case: str | None, lane: int
) -> None:
    (tmp_path / MANIFEST).write_text("{}")
    done: list[tuple[Any, ...]] = []

    for name, stand_in in (
        ("view.policy_folder", Path),
        ("view.describe_renderer", lambda: None),
        ("view.film_of", lambda flight: f"film of {flight}"),
        ("view.write_film", lambda *what: done.append(what)),
        ("view.resolve", lambda *_: config),
    ):
        monkeypatch.setattr(f"uavaccel.cli.{name}", stand_in)
    monkeypatch.setattr("uavaccel.suites.evaluate.completed", lambda mapping: mapping)
    monkeypatch.setattr("uavaccel.suites.evaluate_again.flight_of_agent", lambda config, lane: lane)
    config = SimpleNamespace(task=SimpleNamespace(wire_lane=lambda lane: None))
    view.view_game(str(tmp_path), case, None)
    named = tmp_path / "view" / (case or "lane-000000")
    assert done == [(f"film of {lane}", named.with_suffix(".mp4"), named.with_suffix(".png"))]
