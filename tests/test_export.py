"""Exports: a policy's network with its pre-processing, and a run's rows and samples as tables."""

from __future__ import annotations

import csv
import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch as th

from tests.learning import tiny_config
from tests.running import configured
from uavaccel.cli.flights import export
from uavaccel.config import Config
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.sensors import PICTURE_SIZE
from uavaccel.envs.values import AT_REST
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.rl.onnx_file import OnnxPolicy, described, example, input_names, reduced, write_onnx
from uavaccel.rl.policy import Policy, make_policy
from uavaccel.suites.report import records, row_table, sample_tables, table_of, write_tables


def policy(algorithm: str = "double_dqn", mirrored_decisions: bool = False, **task: Any) -> Policy:
    options = {} if algorithm != "double_dqn" else {"options": {"learning_starts": 8}}
    keys = {"algorithm": algorithm, "mirrored_decisions": mirrored_decisions, **options}
    config = tiny_config(task, mirror=False, **keys)
    th.manual_seed(0)
    return Policy(make_policy(config).eval(), config, {"weights_file_sha256": "ab", "trained": {"games": 7}})


@pytest.mark.parametrize("size", [PICTURE_SIZE, (64, 36), (33, 17)])
def test_pictures_are_reduced_as_the_environment_reduces_them(size: tuple[int, int]) -> None:
    def levels(observation: Any, picture: Any, planes: Any) -> tuple[Any, Any]:
        task = LaneTask(observation=observation, picture_size=size)
        sensor: Any = task.sensor()
        if observation == "dvs":
            sensor.counter = SimpleNamespace(has_frame_of=lambda time_ns: True, take=lambda: picture)
        seen = reduced(th.from_numpy(planes.astype(np.float32))[None], task)[0].numpy()
        return sensor.frame(AT_REST, picture, {}), seen

    random, (columns, rows) = np.random.default_rng(0), size
    most = 30 if size == PICTURE_SIZE else 300
    on, off = random.integers(0, most, (2, rows, columns), dtype=np.int32)
    expected, seen = levels("dvs", (on, off), (on - off)[None])
    np.testing.assert_array_equal(seen, expected)
    assert (expected.min(), expected.max()) == (0, 255)
    depth = random.uniform(0, 80, (rows, columns)).astype(np.float32)
    expected, seen = levels("depth", depth, depth[None])
    assert abs(seen - expected).max() <= 1  # where rounding falls either way
    colour = random.integers(0, 256, (rows, columns, 3), dtype=np.uint8)
    expected, seen = levels("colour", colour, colour.transpose(2, 0, 1))
    np.testing.assert_array_equal(seen, expected)


def test_a_policy_that_decides_both_ways_is_symmetric() -> None:
    """And rates by the mean of both; without, the mirror changes more than the sides."""
    seen = np.random.default_rng(0).integers(0, 256, (50, 3, 36, 64), dtype=np.uint8)
    in_mirror = np.ascontiguousarray(seen[..., ::-1])
    plain, both = policy(), policy(mirrored_decisions=True)
    turned = [4, 3, 2, 1, 0]
    ratings = [plain.rate(each)[1] for each in (seen, in_mirror)]
    np.testing.assert_allclose(both.rate(seen)[1], (ratings[0] + ratings[1][:, turned]) / 2, atol=1e-6)
    assert both.act(in_mirror).tolist() == [turned[action] for action in both.act(seen)]
    assert plain.act(in_mirror).tolist() != [turned[action] for action in plain.act(seen)]


@pytest.mark.parametrize(
    ("algorithm", "task"),
    [
        ("double_dqn", {}),
        ("double_dqn", {"knows": ["last_action", "frame_age"], "history": 2}),
        ("double_dqn", {"knows": ["last_action"], "mirrored_decisions": True}),
        ("sb3_ppo", {"observation": "depth"}),
        ("double_dqn", {"observation": "colour", "picture_size": [40, 32]}),
        ("double_dqn", {"observation": "state"}),
    ],
)
def test_the_whole_network_acts_as_the_policy(algorithm: str, task: dict[str, Any]) -> None:
    """From pictures without pre-processing, and from what is told beside them, of sizes told too, the same action."""
    trained = policy(algorithm, **task)
    inputs = [th.rand(each.shape) * 255 for each in example(trained)]
    observation = trained.config.task.observation
    planes = [reduced(inputs[0], trained.config.task), *inputs[1:]]
    seen = th.cat(planes, dim=1).numpy()
    if observation != "state":
        seen = seen.round().astype(np.uint8)
        inputs[1:] = [each.round() for each in inputs[1:]]
        for name, given in zip(input_names(trained.config.task), inputs, strict=True):
            assert ", ".join(map(str, given.shape[2:])) in described(trained)[name]
    if observation == "dvs":
        inputs[0] = th.round(inputs[0] / 64 - 2)
        seen[:, : planes[0].shape[1]] = reduced(inputs[0], trained.config.task).numpy()
    with th.inference_mode():
        _, action = OnnxPolicy(trained).eval()(*inputs)
    assert action.tolist() == trained.act(seen).tolist()


@pytest.mark.parametrize("knows", [[], ["last_action"], ["last_action", "frame_age"]])
def test_the_metadata_describes_each_input(knows: list[str]) -> None:
    trained = policy(knows=knows)
    about, inputs = described(trained), ["seen", "told"][: len(example(trained))]
    assert {"seen", "told"} & about.keys() == set(inputs)
    task = {key: json.loads(about[key]) for key in ("knows", "headings_deg", "speed_m_s", "t_move_s", "dvs_preset")}
    assert task == {key: trained.config.task.model_dump(mode="json")[key] for key in task}
    assert (about["weights_file_sha256"], about["trained"]) == ("ab", '{"games": 7}')


@pytest.mark.skipif(importlib.util.find_spec("onnxscript") is not None, reason="it is installed")
def test_a_missing_package_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"needs onnxscript: pip install .*\[onnx\]'"):
        write_onnx(policy(), tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())


def run(path: Path) -> RunDirectory:
    made = RunDirectory.create(path, Config(), {})
    arrays: dict[str, np.ndarray[Any, Any]] = {
        "position_m": np.arange(6.0).reshape(2, 3) / 7,
        "image": np.zeros((2, 9, 9), np.uint8),
        "speed": np.array([0.1, 0.2], np.float32),
        "event": np.array([1, 2, 3]),
    }
    row = {"case": "a", "phase_s": {"learning": 0.1}, "actions": [1, 2], **made.save_arrays("a", arrays)}
    made.append_row(row)
    made.append_row({"case": "b", "collision": "wall, west", "phase_s": {"learning": 1 / 3}})
    return made


def test_a_run_as_csv_reads_back_to_the_same_numbers(tmp_path: Path) -> None:
    paths = list(write_tables(run(tmp_path / "run"), tmp_path / "out", "csv"))
    assert [str(path.relative_to(tmp_path / "out")) for path in paths] == [
        "rows.csv",
        "samples/a-2.csv",
        "samples/a-3.csv",
    ]
    with paths[0].open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["case"] for row in rows] == ["a", "b"]
    assert float(rows[1]["phase_s.learning"]) == 1 / 3
    assert rows[1]["collision"] == "wall, west"
    assert (rows[0]["actions"], rows[1]["actions"]) == ("[1, 2]", "")
    with paths[1].open(newline="") as file:
        samples = list(csv.DictReader(file))
    assert list(samples[0]) == ["position_m.0", "position_m.1", "position_m.2", "speed"]
    assert float(samples[1]["position_m.2"]) == 5 / 7


def test_a_table_has_all_rows_columns_and_unknown_integers_stay_none() -> None:
    rows: list[dict[str, Any]] = [
        {"n": 1, "m": 1.5, "i": 1},
        {"m": None, "i": 2, "text": "x"},
        {"n": 2, "i": 3, "is": True},
    ]
    table = table_of(rows)
    assert {name: str(kind) for name, kind in table.dtypes.items()} == {
        "n": "object", "m": "float64", "i": "int64", "text": "object", "is": "object",
    }  # fmt: skip
    assert table.n.tolist() == [1, None, 2]
    assert [row["is"] for row in records(table)] == [None, None, True]


def test_columns_have_one_kind_each() -> None:
    rows = {"value": 3, "n": 1, "mixed": True, "some": 7}, {"value": "noisy", "n": 0.5, "mixed": 2}, {"value": None}
    table = row_table(rows)
    assert table.to_csv(index=False).splitlines() == ["value,n,mixed,some", "3,1.0,true,7", "noisy,0.5,2,", ",,,"]
    assert table.some.tolist() == [7, None, None]
    ((_, columns),) = sample_tables({"line": np.zeros((3, 8, 8)), "image": np.zeros((3, 5, 13))})
    assert list(columns) == [f"line.{n}" for n in range(64)]
    assert list(sample_tables({"empty": np.zeros((0, 3)), "number": np.array(3.0)})) == []


def test_parquet_keeps_the_numbers_or_says_what_is_missing(tmp_path: Path) -> None:
    made = run(tmp_path / "run")
    if importlib.util.find_spec("pyarrow") is None:
        with pytest.raises(UserError, match=r"needs pyarrow: .*\[parquet\]"):
            list(write_tables(made, tmp_path / "out", "parquet"))
        return
    from pyarrow import parquet

    paths = list(write_tables(made, tmp_path / "out", "parquet"))
    assert parquet.read_table(paths[0])["phase_s.learning"].to_pylist() == [0.1, 1 / 3]
    assert str(parquet.read_table(paths[1]).schema.field("speed").type) == "float"


def test_export_says_what_it_writes_and_refuses_no_source(tmp_path: Path) -> None:
    refused: tuple[tuple[str, dict[str, Any], str], ...] = (
        ("default", {}, "say what to write"),
        (str(tmp_path), {"csv": tmp_path / "out"}, "not a run directory"),
        (str(tmp_path), {"onnx": tmp_path / "file"}, "holds no policy"),
    )
    for source, to, said in refused:
        with pytest.raises(UserError, match=said):
            export(source, **to)


def test_each_format_is_written_where_it_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A data set of 25 games tells ten times how far it is, and where it is when it is done."""
    RunDirectory.create(tmp_path / "run", configured("evaluate", agent="straight"), {})

    def tables(run: RunDirectory, folder: Path, kind: str) -> list[str]:
        return [f"{run.path.name}: {folder.name} as {kind}"]

    def dataset(run: RunDirectory, folder: Path) -> Iterator[tuple[int, int]]:
        return ((done, 25) for done in range(1, 26))

    monkeypatch.setattr("uavaccel.suites.report.write_tables", tables)
    monkeypatch.setattr("uavaccel.export.write_minari", dataset)
    export(str(tmp_path / "run"), csv=tmp_path / "a", parquet=tmp_path / "b")
    assert capsys.readouterr().out.splitlines() == ["run: b as parquet", "run: a as csv"]
    monkeypatch.chdir(tmp_path)
    export("run", minari=Path("lane-v0"))
    told = [f"{done}/25 games" for done in (3, 5, 8, 10, 13, 15, 18, 20, 23, 25)]
    assert capsys.readouterr().out.splitlines() == [*told, "lane-v0"]
