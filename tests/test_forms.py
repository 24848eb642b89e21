"""Rows, arrays, host times and manifests of a run: what is wrong in one is a line, wherever it is read."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock, call

import numpy as np
import pytest

from tests.made_runs import line_arrays, line_row
from uavaccel import records
from uavaccel.cli.experiments import report_runs
from uavaccel.cli.flights import export
from uavaccel.config import to_yaml, validate
from uavaccel.errors import UserError
from uavaccel.files import read_lines
from uavaccel.forms import ArrayForm, RowForm
from uavaccel.records import RunDirectory
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.registry import SUITES, find_suite, open_run
from uavaccel.suites.suite import AnySuite
from uavaccel.suites.train import EVALUATIONS, evaluations
from uavaccel.watch.replay import recorded

pytestmark = pytest.mark.usefixtures("whole_messages")

NAN = float("nan")


def whole_game() -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A game of DP1 with all keys and arrays that the suite writes."""
    row = line_row("game", "adsc", 5.0, 0, 0.5)
    return row, line_arrays(row)


def begin(path: Path, suite: AnySuite) -> RunDirectory:
    keys = {"suite": suite.name, "clock_speed": [5.0], "latency": {}} if suite.name == "dp1" else {}
    return RunDirectory.create(path, validate(suite.config, {"suite": suite.name, **keys}, "test"), {})


def write(path: Path, row: dict[str, Any], arrays: dict[str, np.ndarray]) -> RunDirectory:
    run = begin(path, Dp1())
    kept = run.save_arrays(row["case"], arrays)
    row = {**row, **kept}
    (path / "rows.jsonl").write_text(json.dumps(row) + "\n")  # NaN too
    return open_run(path)


def lane_game() -> dict[str, Any]:
    phases = dict.fromkeys(("simulation", "rendering", "image_processing", "inference", "learning"), 0.5)
    shown = {"lane": 7, "is_success": True, "distance_m": 80.0, "collision": None, "commands": 2}
    return {
        "suite": "evaluate",
        "case": "lane-000007",
        "wall_s": 1.0,
        "sim_time_s": 2.0,
        "actions": [0, 1],
        **shown,
        "phase_s": phases,
    }


def test_a_whole_game_is_read_as_it_is(tmp_path: Path) -> None:
    row, arrays = whole_game()
    run = write(tmp_path / "run", row, arrays)
    [read] = run.rows()
    assert {key: read[key] for key in row if key != "arrays"} == {k: v for k, v in row.items() if k != "arrays"}
    found = run.load_arrays(read)
    assert all(np.array_equal(found[name], arrays[name]) for name in arrays)


@pytest.mark.parametrize("suite", SUITES)
def test_every_suite_declares_its_rows(suite: str) -> None:
    with pytest.raises(UserError, match=r"rows.jsonl: line 1: x: (key '\w+' is missing|kind)"):
        find_suite(suite, "test").form.check_rows([{"suite": suite, "case": "x", "kind": 3}], "rows.jsonl")


ROWS: list[tuple[dict[str, Any], str]] = [
    ({"wall_s": "4"}, r"wall_s = '4': should be a valid number"),
    ({"wall_s": NAN}, r"wall_s = nan: should be a finite number"),
    ({"wall_s": None}, r"wall_s = None: should be a valid number"),
    ({"wall_s": 0}, r"wall_s = 0: should be greater than 0"),
    ({"wall_s": 1e308}, r"wall_s = 1e\+308: should be less"),
    ({"rounds": 1.5}, r"rounds = 1.5: should be a valid integer"),
    ({"rounds": True}, r"rounds = True: should be a valid integer"),
    ({"rounds": 10**400}, r"rounds = 1000.*: should be less"),
    ({"seed": -1}, r"seed = -1: should be greater"),
    ({"command": "adsx"}, r"command = 'adsx': should be 'adsc' or 'tcsc'"),
    ({"timing": []}, r"timing = \[\]: should be 'wall', 'virtual' or 'lockstep'"),
    ({"suite": "dp2"}, r"suite = 'dp2': this is a run of dp1"),
    ({"suite": 3}, r"suite = 3: this is a run of dp1"),
    ({"clock_speed": 7.0}, r"by its other keys it is the row of adsc-k7-"),
    ({"game": 9}, r"by its other keys it is the row of adsc-.*-g09"),
]


@pytest.mark.parametrize(("change", "said"), ROWS, ids=[str(change)[:40] for change, _ in ROWS])
def test_a_wrong_row_is_a_line_that_names_game_key_and_value(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    row, arrays = whole_game()
    run = write(tmp_path / "run", {**row, **change}, arrays)
    with pytest.raises(UserError, match=rf"rows\.jsonl: line 1: {row['case']}: {said}") as error:
        run.rows()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("key", ["role", "t_move_s", "duration_s", "real_time_factor", "error", "profile"])
def test_a_missing_key_is_named(tmp_path: Path, key: str) -> None:
    row, arrays = whole_game()
    del row[key]
    with pytest.raises(UserError, match=rf"line 1: {row['case']}: key '{key}' is missing; delete the line"):
        write(tmp_path / "run", row, arrays).rows()


ARRAYS: dict[str, tuple[Callable[[np.ndarray], np.ndarray | None], str]] = {
    "gone": (lambda _: None, "has no array 'position_m'"),
    "nan": (lambda a: np.full(a.shape, np.nan), "numbers that are not finite"),
    "huge": (lambda a: np.full(a.shape, 1e300), r"numbers beyond 1e\+12"),
    "integers": (lambda a: a.astype(int), "is of int64, not of floats"),
    "complex": (lambda a: a.astype(complex), "is of complex128, not of floats"),
    "texts": (lambda a: a.astype(str), "is of <U"),
    "short": (lambda a: a[:-1], r"has the shape \(\d+, 3\), not \(\d+, 3\)"),
    "flat": (lambda a: a[:, 0], "has the shape"),
    "wide": (lambda a: np.hstack([a, a]), "has the shape"),
    "empty": (lambda a: a[:0], "has the shape"),
    "scalar": (lambda _: np.array(1.0), r"has the shape \(\)"),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_a_wrong_array_is_a_line_that_names_file_and_array(tmp_path: Path, name: str) -> None:
    change, said = ARRAYS[name]
    row, arrays = whole_game()
    changed = change(arrays.pop("position_m"))
    run = write(tmp_path / "run", row, arrays if changed is None else {**arrays, "position_m": changed})
    with pytest.raises(UserError, match=rf"{row['case']}\.npz: {row['case']}: .*{said}"):
        run.load_arrays(run.rows()[0])


def test_a_length_is_that_of_all_arrays_of_one_name(tmp_path: Path) -> None:
    """Two evaluations of a policy may have another number of lanes, each of them one."""
    form = RowForm(dict, arrays={"*_lane": ArrayForm("i", ("n",)), "*_won": ArrayForm("b", ("n",))})
    arrays = {f"{name}_lane": np.arange(n) for name, n in (("tcsc", 2), ("exact", 3))}
    arrays |= {"tcsc_won": np.ones(2, bool), "exact_won": np.ones(3, bool)}
    form.check_arrays(arrays, {"case": "a"}, "a.npz: a")
    with pytest.raises(UserError, match=r"exact_won: has the shape \(2,\), not \(3,\)"):
        form.check_arrays(arrays | {"exact_won": np.ones(2, bool)}, {"case": "a"}, "a.npz: a")


def test_times_that_fall_and_uncounted_commands_are_refused(tmp_path: Path) -> None:
    row, arrays = whole_game()
    for name, time_s, said in (
        ("falls", arrays["time_s"][::-1], "has to ascend"),
        ("early", np.array([-1.0, *arrays["time_s"][1:]]), "has to begin at 0 or later"),
        ("late", np.array([*arrays["time_s"][:-1], 2e9]), r".* and to end below 1e\+09"),
    ):
        run = write(tmp_path / name, row, {**arrays, "time_s": time_s})
        with pytest.raises(UserError, match=f"time_s: {said}"):
            run.load_arrays(run.rows()[0])
    run = write(tmp_path / "counts", {**row, "commands": 99}, arrays)
    with pytest.raises(UserError, match=r"command_start_s: has the shape \(\d+,\), not \(99,\)"):
        run.load_arrays(run.rows()[0])


READERS: dict[str, Callable[[Path], object]] = {
    "report": lambda path: report_runs([path]),
    "watch": lambda path: recorded(path),
    "csv": lambda path: export(str(path), csv=path.with_name("csv")),
    "mcap": lambda path: export(str(path), mcap=path.with_name("mcap")),
}


@pytest.mark.parametrize("reader", READERS)
def test_every_reader_of_a_run_checks_its_rows(tmp_path: Path, reader: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They may be hundreds of thousands, and are read once."""
    row, arrays = whole_game()
    write(tmp_path / "run", {**row, "duration_s": NAN}, arrays)
    look = Mock(side_effect=read_lines)
    monkeypatch.setattr(records, "read_lines", look)
    with pytest.raises(UserError, match=r"line 1: .*duration_s = nan: should be a finite number"):
        READERS[reader](tmp_path / "run")
    assert ([path.name for path in tmp_path.iterdir()], look.call_args_list) == (
        ["run"],
        [call(tmp_path / "run/rows.jsonl")],
    )


@pytest.mark.parametrize("reader", READERS)
def test_every_reader_of_a_run_wants_its_manifest(tmp_path: Path, reader: str) -> None:
    write(tmp_path / "run", *whole_game())
    (tmp_path / "run/manifest.json").unlink()
    with pytest.raises(UserError, match=r"manifest\.json: No such file"):
        READERS[reader](tmp_path / "run")


LANES: list[tuple[dict[str, Any], str]] = [
    ({"distance_m": "far"}, r"distance_m = 'far'"),
    ({"actions": [0, 1.5]}, r"actions\.1 = 1\.5: should be a valid integer"),
    ({"path_m": [[1.0, 2.0], [3.0]]}, r"path_m\.1 = \[3\.0\]: .*at least 2"),
    ({"phase_s": {"simulation": 1.0}}, r"phase_s = .*should have the phase 'rendering'"),
    ({"phase_s": {"simulation": "long"}}, r"phase_s\.simulation = 'long'"),
    ({"lane": 8}, "by its other keys it is the row of lane-000008"),
]


@pytest.mark.parametrize(("change", "said"), LANES, ids=[str(change)[:40] for change, _ in LANES])
def test_rows_of_evaluations_are_checked_likewise(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    begin(tmp_path / "run", Evaluation())
    (tmp_path / "run/rows.jsonl").write_text(json.dumps(lane_game() | change) + "\n")
    for reader in (READERS["report"], READERS["watch"]):
        with pytest.raises(UserError, match=rf"line 1: lane-000007: {said}"):
            reader(tmp_path / "run")
    with pytest.raises(UserError, match=said):
        export(str(tmp_path / "run"), minari=tmp_path / "lane-v0")


@pytest.mark.parametrize(
    ("manifest", "said"),
    [
        ({"resumed": 3}, "resumed = 3: should be a"),
        ({"resumed": [3]}, "resumed.0 = 3: should be a mapping"),
        ({"versions": {"numpy": 2}}, "versions.numpy = 2: should be a valid string"),
        ({"git": "main"}, "git = 'main'"),
        ({"git": {"commit": 3}}, "git.commit = 3: should be a valid string"),
        ({"own_code": 3}, "own_code = 3"),
        (None, "should be a mapping"),
    ],
)
def test_a_manifest_of_another_form_is_named(tmp_path: Path, manifest: object, said: str) -> None:
    run = begin(tmp_path / "run", Evaluation())
    run.write_json("manifest.json", manifest)
    with pytest.raises(UserError, match=rf"manifest\.json: {said}"):
        open_run(run.path)
    again = validate(Evaluation.config, {"suite": "evaluate"}, "test")
    run._lock = None
    with pytest.raises(UserError, match=r"manifest\.json"):
        RunDirectory.create(run.path, again, {}, resume=True)


def test_host_times_that_are_no_numbers_are_named(tmp_path: Path) -> None:
    run = begin(tmp_path / "run", Evaluation())
    for entry, said in (({"wall_s": "x"}, "wall_s = 'x'"), ({"learner_s": {"learning": -1}}, "learner_s.learning")):
        (run.path / "timing.jsonl").write_text(json.dumps(entry) + "\n")
        with pytest.raises(UserError, match=rf"timing\.jsonl: line 1: {said}"):
            run.timings()


@pytest.mark.parametrize(("line", "said"), [
    ({"successes": 2}, "successes should be the number of lanes won"),
    ({"is_success": [True]}, "should have one entry for each lane"),
    ({"distance_m": [1.0]}, "should have one entry for each lane"),
    ({"lanes": [], "is_success": [], "successes": 0}, "should have one entry for each lane"),
])  # fmt: skip
def test_an_evaluation_that_contradicts_itself_is_named(line: dict[str, Any], said: str, tmp_path: Path) -> None:
    whole = {"games": 4, "weights_sha256": "f0", "successes": 1, "lanes": [3, 4], "is_success": [True, False]}
    for each in (whole, whole | line):
        (tmp_path / EVALUATIONS).write_text(f"{json.dumps(whole)}\n{json.dumps(each)}\n")
        if each is whole:
            assert evaluations(SimpleNamespace(path=tmp_path)) == [whole] * 2  # type: ignore[arg-type]
    with pytest.raises(UserError, match=rf"evaluations\.jsonl: line 2: .*{said}"):
        evaluations(SimpleNamespace(path=tmp_path))  # type: ignore[arg-type]


def test_a_configuration_that_no_longer_holds_is_named(tmp_path: Path) -> None:
    run = write(tmp_path / "run", *whole_game())
    text = to_yaml(validate(Dp1.config, run.config(), "test"))
    (run.path / "config.yaml").write_text(text + "gamess: 3\n")
    with pytest.raises(UserError, match=r"config\.yaml: unknown key 'gamess'"):
        report_runs([run.path])
