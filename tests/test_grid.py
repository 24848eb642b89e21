"""Ablations, sweeps and robustness maps: which points a grid has, what is flown there, and what the reports say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.running import configured, fly_into, run_into
from uavaccel.cli.experiments import sweep_agent
from uavaccel.config import validate
from uavaccel.envs.conditions import SHORT_NAMES
from uavaccel.errors import UsageError, UserError
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment
from uavaccel.suites.dp1 import Dp1, Dp1Config
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.grid import Ablation, Point, PolicyGrid, Robustness, Sweep, band_figure
from uavaccel.suites.runner import cases_of
from uavaccel.suites.session import RunRequest, planned, reading

pytestmark = pytest.mark.usefixtures("whole_messages")
BASE = "base={profile: airsim, command: [adsc], clock_speed: [1, 10], t_move_s: [0.2], rounds: [2], games: 2, reference_games: 2}"  # noqa: E501
# It sees nothing, so there are no pictures; the latency changes where it is when a game is cut short.
BLIND = ("agent=straight", "games=2", "evaluation.keys={task.max_commands: 5}")


def ablation(*variants: dict[str, Any], **keys: Any) -> Any:
    return configured("ablation", BASE, seed=4, variants=list(variants), **{"times_clock_speed": False, **keys})


def test_a_variant_changes_its_keys_and_nothing_else() -> None:
    config = ablation({"name": "as it is"}, {"name": "slow", "changes": {"latency.reply_us.move": 2}})
    plain, slow = (Ablation().dp1_of(config, name) for name in ("as it is", "slow"))
    assert plain == validate(Dp1Config, {**config.base, "suite": "dp1", "seed": 4}, "dp1")
    assert slow.latency.reply_us["move"] == tuple(2 * each for each in plain.latency.reply_us["move"])
    assert slow.model_dump(exclude={"latency"}) == plain.model_dump(exclude={"latency"})
    assert slow.latency.platform == plain.latency.platform
    named = configured("ablation", BASE, "base.seed=9", seed=4, variants=[{"name": "a"}, {"name": "b"}])
    assert Ablation().dp1_of(named, "a") == plain, "the seed is the run's"


def test_lanes_latencies_and_parts_are_found_beside_their_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the working directory has goes before."""
    (tmp_path / "own").mkdir()
    for folder, x_m, scale in ((tmp_path, 7, 7), (tmp_path / "own", 9, 9)):
        (folder / "lane.yaml").write_text(f"obstacles: [{{x_m: {x_m}, y_m: 0, radius_m: 0.3}}]\n")
        (folder / "slow.yaml").write_text(f"latency: {{scale: {scale}}}\n")
    task = "task: {lane: lane.yaml, latency: slow.yaml}\n"
    (tmp_path / "own/evaluation.yaml").write_text(f"suite: evaluate\nagent: straight\n{task}")
    for sweep, part in (("sweep.yaml", "own/evaluation.yaml"), ("own/beside.yaml", "evaluation.yaml")):
        (tmp_path / sweep).write_text(f"suite: sweep\nsweep: {{wind: [1]}}\nevaluation: {{experiment: {part}}}\n")
    monkeypatch.chdir(tmp_path)
    for there in (7, 9):
        with reading(RunRequest("own/evaluation.yaml")) as (_, config):
            assert (config.task.lane.obstacles[0].x_m, config.task.latency.scale) == (there, there)
        for sweep in ("sweep.yaml", "own/beside.yaml"):
            with reading(RunRequest(sweep)) as (_, config):
                pass
            assert config.evaluation.resolve(0)[1].task.latency.scale == there
        for name in ("lane.yaml", "slow.yaml"):
            (tmp_path / name).unlink(missing_ok=True)


@pytest.mark.slow
def test_processes_find_what_is_beside_the_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own/slow.yaml").write_text("latency: {scale: 7}\n")
    evaluation = "evaluation: {experiment: evaluate, keys: {task.latency: slow.yaml, task.max_commands: 1}}"
    sweep = f"suite: sweep\nagent: straight\ngames: 1\nsweep: {{wind: [1]}}\n{evaluation}\n"
    (tmp_path / "own/sweep.yaml").write_text(sweep)
    monkeypatch.chdir(tmp_path)
    with planned(RunRequest("own/sweep.yaml", jobs=2, out=Path("run"))) as plan:
        plan.fly(run := plan.begin(print), lambda *_: None)
    assert [row["case"] for row in run.rows()] == ["as-trained", "wind-1"]


SHIPPED = [experiment("ablation.yaml"), *sorted(experiment("ablations").glob("*.yaml"))]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_variant_of_a_shipped_ablation_is_another(path: Path) -> None:
    config = configured(str(path))
    flown = {Ablation().dp1_of(config, variant.name).model_dump_json() for variant in config.variants}
    assert len(flown) == len(config.variants)


def test_variants_fly_the_games_of_dp1_with_its_seeds(tmp_path: Path) -> None:
    """The variant that changes nothing flies DP1's own rows; one without latency is ADSC without its error."""
    config = ablation({"name": "as it is"}, {"name": "0", "changes": {"latency.scale": 0.0}})
    summary = run_into(tmp_path / "ablation", Ablation(), config)
    alone = fly_into(tmp_path / "dp1", Dp1(), Ablation().dp1_of(config, "as it is"))
    rows, own = RunDirectory(tmp_path / "ablation").rows(), [row for row in alone.rows() if row["role"] != "figure2"]
    assert [row["case"] for row in rows] == [f"v{variant:02d}-{row['case']}" for variant in (0, 1) for row in own]
    assert [row["wall_s"] for row in rows if row["variant"] == "as it is"] == [row["wall_s"] for row in own]
    at_10x = {entry["variant"]: entry for entry in summary["entries"] if entry["clock_speed"] == 10}
    assert at_10x["0"]["stlc_quartiles"] == [2.0, 2.0, 2.0]
    assert at_10x["0"]["share_beyond_goal_timeout"] == 0
    assert at_10x["as it is"]["stlc_quartiles"][1] < 1.95
    assert at_10x["as it is"]["share_beyond_goal_timeout"] > 0.5, "28 ms at 10x are 280 ms"
    assert at_10x["as it is"]["effective_speedup"] < at_10x["0"]["effective_speedup"]
    report = Ablation().report(RunDirectory(tmp_path / "ablation"))
    flight = Ablation().flight(report, report.games.iloc[-1])
    assert flight.title == "ADSC at 10x"


def test_a_band_is_the_range_of_all_variants_about_the_first(tmp_path: Path) -> None:
    clocks, medians = [1.0, 10.0], {"as fitted": (1.9, 1.5), "slow": (1.8, 1.1), "fast": (1.95, 1.4)}
    variants = [{"name": name} for name in medians]
    entries = pd.DataFrame(
        [
            ("adsc", clock, name, stlc[place], 0.1, 5.0)
            for name, stlc in medians.items()
            for place, clock in enumerate(clocks)
        ],
        columns=["command", "clock_speed", "variant", "stlc", "position_rmse_m_median", "effective_speedup"],
    )
    axes = band_figure(ablation(*variants, band=True), entries).axes[0]
    (line,), (band,) = axes.lines, axes.collections
    corners: Any = band.get_paths()[0].vertices
    assert [*np.asarray(line.get_ydata())] == [1.9, 1.5]
    ends = {(x, round(y, 6)) for x, y in corners}
    assert {(0, 1.8), (0, 1.95), (1, 1.1), (1, 1.5)} == ends


def test_a_condition_is_an_evaluation_with_one_key_changed(tmp_path: Path) -> None:
    summary = run_into(tmp_path / "run", Sweep(), configured("sweep", *BLIND, sweep={"wind": [0, 8], "speed": [2]}))
    run = RunDirectory(tmp_path / "run")
    assert [row["case"] for row in run.rows()] == ["as-trained", "wind-8", "speed-2"]
    cells = [(cell["condition"], cell["value"]) for cell in summary["cells"]]
    assert cells == [("", None), ("wind", 0), ("wind", 8), ("speed", 2)]
    distances = {row["case"]: run.load_arrays(row)["distance_m"] for row in run.rows()}
    keys = ("agent=straight", "games=2", "task.max_commands=5", "task.difficulty.wind_m_s=8")
    flown = fly_into(tmp_path / "alone", Evaluation(), configured("evaluate", *keys)).rows()
    assert [row["distance_m"] for row in flown] == list(distances["wind-8"])
    assert (distances["speed-2"] > distances["as-trained"] + 2.0).all()
    assert summary["cells"][1]["distance_m_median"] == summary["cells"][0]["distance_m_median"]


def test_every_shipped_condition_can_be_flown() -> None:
    config = configured("sweep", "agent=straight")
    assert set(SHORT_NAMES) - set(config.sweep) == {"profile"}
    trained, *flown = Sweep().cases(config)
    same: Any = trained.labels["same"]
    assert (trained.id, len(same)) == ("as-trained", 19)
    assert {"wind-0", "scenery-plain", "light-1", "gap-2", "sensor-clean", "clock-1", "command-tcsc"} - {*same} == {
        "light-1"
    }
    assert len({case.id for case in flown} | {*same}) == sum(map(len, config.sweep.values()))
    assert {case.labels["same"] == [] for case in flown} == {True}
    timed = configured("sweep", "agent=straight", sweep={"task.timing": ["lockstep"]})
    assert [case.timing for case in Sweep().cases(timed)] == ["virtual", "lockstep"]
    lit = configured("sweep", "agent=straight", sweep={"light": [0.5, [0.2, 0.6]]})
    _, *levels = (point.keys for point in Sweep().points(lit))
    assert [[*keys.values()] for keys in levels] == [[[0.5, 0.5]], [[0.2, 0.6]]], "a range is taken as it is"


def test_the_page_has_the_table_of_conditions() -> None:
    page = (Path(__file__).parents[1] / "docs" / "training.md").read_text(encoding="utf-8")
    assert not [name for name in SHORT_NAMES if f"`{name}`" not in page]


def test_a_sweep_is_around_the_options_of_evaluate(tmp_path: Path) -> None:
    options = {"agent": "straight", "games": 2, "clock_speed": 10.0, "seed": 3}
    keys = ["task.max_commands=3", "task.difficulty.wind_m_s=2", "task.clock_speed=5"]  # which goes before its option
    request = RunRequest("evaluate", options, keys, out=tmp_path / "run")
    sweep_agent(request, ["wind=2,4", "light=.5"], None)
    assert [row["case"] for row in RunDirectory(tmp_path / "run").rows()] == ["as-trained", "wind-4", "light-0.5"]
    assert RunDirectory(tmp_path / "run").config()["seed"] == 3
    part = RunDirectory(tmp_path / "run" / "parts" / "light-0.5").config()["task"]
    assert (part["clock_speed"], part["max_commands"], part["difficulty"]["wind_m_s"]) == (5.0, 3, 2)
    assert part["difficulty"]["light"] == [0.5, 0.5]
    with pytest.raises(UsageError, match=r"^--sweep windy: is unknown; did you mean 'wind'"):
        configured("sweep", sweep={"windy": [1]})
    for name in ("latency", "inference", "task.latency.scale"):
        with pytest.raises(UserError, match=f"--sweep {name}: changes nothing in timing lockstep"):
            sweep_agent(replace(request, options={**options, "timing": "lockstep"}), [f"{name}=1,2"], None)


# --- robustness maps ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_cell_is_an_evaluation_under_its_latency(tmp_path: Path) -> None:
    config = configured("robustness", *BLIND, "latency_scale=[1, 0]", clock_speed=[1.0, 50.0], command=["adsc"])
    summary = run_into(tmp_path / "run", Robustness(), config)
    run = RunDirectory(tmp_path / "run")
    rows = {row["case"]: run.load_arrays(row) for row in run.rows()}
    assert list(rows) == [f"latency{scale}-adsc-{k}x" for scale in (1, 0) for k in (1, 50)]
    keys = ("task.max_commands=5", "task.profile=airsim", "task.command=adsc", "task.latency.scale=0")
    alone = configured("evaluate", *keys, clock_speed=50.0, games=2, agent="straight")
    flown = fly_into(tmp_path / "alone", Evaluation(), alone).rows()
    assert rows["latency0-adsc-50x"]["distance_m"].tolist() == [row["distance_m"] for row in flown]
    assert rows["latency0-adsc-50x"]["lane"].tolist() == [0, 1]
    assert rows["latency0-adsc-50x"]["distance_m"].tolist() != rows["latency1-adsc-50x"]["distance_m"].tolist()
    assert [cell["successes"] for cell in summary["cells"]] == [0] * 4


def test_a_sweep_on_the_wall_clock_is_flown_in_one_process() -> None:
    wall = configured("sweep", *BLIND, "evaluation.keys={task.timing: wall}", sweep={"wind": [1]})
    assert "wall clock" in Sweep().why_serial(wall)
    assert Sweep().why_serial(configured("sweep", *BLIND, sweep={"wind": [1]})) == ""
    assert Sweep().provenance(wall) == {"policy_sha256": None}, "a baseline's"
    assert Sweep().status([{"case": "wind-1", "successes": 1, "games": 2}]) == "wind-1 won 1 of 2"
    assert Sweep().games(wall, Point("", "virtual", 0.0, {}, {})) == 2


def test_a_grid_without_points_is_refused_in_a_line() -> None:
    class Empty(PolicyGrid):
        name, points = "empty", lambda self, config: iter(())

    with pytest.raises(UserError, match=r"^empty: there is no game to fly: cases is empty$"):
        cases_of(Empty(), configured("sweep", "sweep={wind: [1]}"))
