"""Ablations, sweeps and robustness maps: which points a grid has, what is flown there, and what the reports say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from tests.dp1_games import line_arrays, line_row
from tests.drawing import labelled, legend_texts, points, record_figures, texts, tick_texts
from tests.running import configured, fly_into, run_into
from uavaccel.cli.experiments import sweep_agent
from uavaccel.config import validate
from uavaccel.draw import style
from uavaccel.envs.conditions import CONDITIONS
from uavaccel.errors import UsageError, UserError
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment
from uavaccel.suites.dp1 import Dp1, Dp1Config
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.grid import Ablation, Point, Robustness, Sweep, parse_sweep
from uavaccel.suites.report import Report
from uavaccel.suites.session import RunRequest

BASE = "base={profile: airsim, command: [adsc], clock_speed: [1, 10], t_move_s: [0.2], rounds: [2], games: 2, reference_games: 2}"  # noqa: E501
# It sees nothing, so there are no pictures; the latency changes where it is when a game is cut short.
BLIND = ("agent=straight", "games=2", "evaluation.keys={task.max_commands: 5}")


def ablation(*variants: dict[str, Any], **keys: Any) -> Any:
    return configured("ablation", BASE, seed=4, variants=list(variants), **{"times_clock_speed": False, **keys})


def report_of(path: Path, suite: Any, config: Any, rows: Sequence[Any]) -> Report:
    """A run's report from rows, whose `arrays` are kept beside them."""
    run = RunDirectory.create(path, config, {})
    for row in rows:
        arrays = row.pop("arrays")
        run.append_row({**row, "suite": suite.name, **run.save_arrays(row["case"], arrays)})
    return suite.report(run)


def outcomes_of(won: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of an evaluation of which these lanes were won."""
    return {"lane": np.arange(len(won)), "is_success": won, "distance_m": np.full(len(won), 75.0)}


# --- ablations ----------------------------------------------------------------------------------------------------


def test_a_variant_changes_its_keys_and_nothing_else() -> None:
    config = ablation({"name": "as it is"}, {"name": "slow", "changes": {"latency.reply_us.move": 2}})
    plain, slow = (Ablation().dp1_of(config, name) for name in ("as it is", "slow"))
    assert plain == validate(Dp1Config, {**config.base, "suite": "dp1", "seed": 4}, "dp1")
    assert slow.latency.reply_us["move"] == tuple(2 * each for each in plain.latency.reply_us["move"])
    assert slow.model_dump(exclude={"latency"}) == plain.model_dump(exclude={"latency"})
    assert slow.latency.platform == plain.latency.platform


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


def variant_rows() -> list[Any]:
    """Under each of three variants two paths of ADSC, a TCSC game, and one in lockstep, which is left out."""
    rows = []
    for v, (variant, aside_m) in enumerate({"0.5": 0.1, "3": 0.4}.items()):
        for t_move_s, rounds in ((0.5, 2), (1.0, 24), (0.5, 24)):
            keys: dict[str, Any] = {"t_move_s": t_move_s, "rounds": rounds, "variant": variant}
            made = [line_row("reference", "adsc", 1.0, 0, 0.0, **keys, wall_s=40.0 * t_move_s)]
            for game in range(3):
                offset_m, gaps_s = aside_m * (game + 1), [0.063, 0.064, 0.01 * (v + 1)]
                error = "crashed" if (game, rounds) == (2, 2) else None
                made.append(line_row("game", "adsc", 10.0, game, offset_m, gaps_s=gaps_s, error=error, **keys))
            made.append(line_row("game", "adsc", 10.0, 9, 9.0, timing="lockstep", wall_s=0.01, **keys))
            made.append(line_row("game", "tcsc", 10.0, 0, 0.0, **keys))
            rows += [row | {"case": f"v{v:02d}-{row['case']}", "arrays": line_arrays(row)} for row in made]
    return rows


def test_a_variants_games_are_pooled_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its speed-up is that of the longest paths; gaps up to the 63 ms of the goal timeout are within it."""
    variants = [{"name": name} for name in ("3", "0.5", "not flown")]
    config = ablation(*variants, axis="latency × ClockSpeed", title="Late", times_clock_speed=True)
    report = report_of(tmp_path / "run", Ablation(), config, variant_rows())
    entries = {(entry["variant"], entry["command"], entry["clock_speed"]): entry for entry in report.summary["entries"]}
    assert list(entries)[:4] == [("3", "adsc", 1.0), ("3", "adsc", 10.0), ("3", "tcsc", 10.0), ("0.5", "adsc", 1.0)]
    aside_m = [0.4, 0.4, 0.4, 0.8, 0.8, 0.8, 1.2, 1.2]
    stlc = 1 + np.exp(-np.array(aside_m))
    assert entries["3", "adsc", 10.0] == {
        "variant": "3", "command": "adsc", "clock_speed": 10.0, "games": 8, "failed_games": 1,
        "stlc_quartiles": pytest.approx(np.quantile(stlc, (0.25, 0.5, 0.75)).tolist()),
        "position_rmse_m_median": pytest.approx(0.8), "effective_speedup": (40 / 4 + 20 / 4) / 2,
        "share_beyond_goal_timeout": pytest.approx(1 / 3),
    }  # fmt: skip
    assert entries["3", "adsc", 1.0]["stlc_quartiles"] is None, "a lone reference is compared with nothing"
    low, high = (f"{1 + np.exp(-each):.3f}" for each in (0.8, 0.2))
    assert report.headline() == (
        f"ADSC at 10x: STLC from {low} with 3 to {high} with 0.5; TCSC at 10x: STLC from 2.000 with 3 to 2.000 with 0.5"
    )
    assert Ablation().overview(report).rows[1] == (
        "3", "ADSC", "10x", "8 (1 failed)", "1.449 [{:.3f}, {:.3f}]".format(*np.quantile(stlc, (0.25, 0.75))), "0.800",
        "7.50", "33%",
    )  # fmt: skip
    figures = record_figures(monkeypatch)
    report.write()
    stlc_axes, rmse, speedup = figures["ablation"].axes
    lines = [labelled(axes)["ADSC 10x"] for axes in (stlc_axes, rmse, speedup)]
    assert [points(line)[0] for line in lines] == [(30.0, pytest.approx(1 + np.exp(-0.8))), (30.0, 0.8), (30.0, 7.5)]
    assert points(lines[1])[1] == (5.0, 0.2)
    assert points(labelled(stlc_axes)["ADSC 1x"]) == []
    assert legend_texts(figures["ablation"].legends[0]) == ["ADSC 1x", "ADSC 10x", "TCSC 10x", "alike above 1.8"]
    assert (rmse.get_xlabel(), speedup.get_yscale()) == ("latency × ClockSpeed", "log")
    assert stlc_axes.get_xscale() == "symlog", "from 0.5 to 30"
    page = (report.run.path / "report.md").read_text()
    assert page.startswith("# Late\n")
    assert page.index("| variant |") < page.index("figures/") < page.index("STLC and position error against ADSC at 1x")


def test_named_variants_stand_side_by_side_and_what_cannot_be_compared_is_not_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [row | {"variant": {"3": "none", "0.5": "late"}[row["variant"]]} for row in variant_rows()]
    figures, config = record_figures(monkeypatch), ablation({"name": "none"}, {"name": "late"})
    alone = [dict(row) for row in rows if row["timing"] == "lockstep"]
    report_of(tmp_path / "run", Ablation(), config, rows).write()
    axes = figures.pop("ablation").axes[0]
    assert tick_texts(axes.xaxis) == ["none", "late"]
    assert [x for x, _ in points(labelled(axes)["ADSC 10x"])] == [0.0, 1.0]
    report = report_of(tmp_path / "lockstep", Ablation(), config, alone)
    report.write()
    assert (report.headline(), figures) == ("No variant has games to compare", {})


# --- sweeps -------------------------------------------------------------------------------------------------------


def test_a_condition_is_an_evaluation_with_one_key_changed_and_none_is_flown_twice(tmp_path: Path) -> None:
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


def test_every_shipped_condition_is_an_evaluation_that_can_be_flown() -> None:
    config = configured("sweep", "agent=straight")
    assert set(CONDITIONS) - set(config.sweep) == {"profile"}
    trained, *flown = Sweep().cases(config)
    same: Any = trained.labels["same"]
    assert (trained.id, len(same)) == ("as-trained", 19)
    assert {"wind-0", "scenery-plain", "light-1", "gap-2", "sensor-clean", "clock-1", "command-tcsc"} - {*same} == {
        "light-1"
    }
    assert len({case.id for case in flown} | {*same}) == sum(map(len, config.sweep.values()))
    assert {case.labels["same"] == [] for case in flown} == {True}


def swept(path: Path) -> Report:
    config = configured("sweep", games=8, sweep={"wind": [0, 3, 6], "light": [1]})
    outcomes = {"as-trained": [1, 1, 1, 1, 1, 1, 1, 0], "wind-3": [1, 1, 0, 0, 0, 0, 0, 1]}
    rows: list[Any] = [
        {
            "case": case, "same": ["wind-0"] if case == "as-trained" else [], "successes": sum(won), "games": 8,
            "timing": "virtual", "sim_time_s": 9.0, "distance_m_median": 150.0,
            "condition": "" if case == "as-trained" else "wind", "value": None if case == "as-trained" else 3,
            "arrays": outcomes_of(np.array(won, bool)),
        }
        for case, won in outcomes.items()
    ]  # fmt: skip
    return report_of(path, Sweep(), config, rows)


def test_a_sweeps_tests_intervals_table_and_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures, report = record_figures(monkeypatch), swept(tmp_path / "run")
    report.write()
    summary: Any = report.summary
    assert [cell["value"] for cell in summary["cells"]] == [None, 0, 3]  # 6 and the light are not flown yet
    interval = binomtest(3, 8).proportion_ci(method="wilson")
    cell = summary["cells"][2]
    assert (cell["wilson_low"], cell["wilson_high"]) == pytest.approx((interval.low, interval.high))
    assert cell["mcnemar_p"] == pytest.approx(binomtest(1, 6).pvalue)  # lost five that were won, won one
    assert summary["cells"][1]["mcnemar_p"] is None
    assert {key: summary[key] for key in ("lanes", "provenance")} == {"lanes": 8, "provenance": ["modelled"]}
    assert Sweep().overview(report).rows == [
        ("as trained", "", "87.5%", "52.9% to 97.8%", "7 of 8", "150.0", ""),
        ("wind, m/s", "0", "87.5%", "52.9% to 97.8%", "7 of 8", "150.0", ""),
        ("wind, m/s", "3", "37.5%", "13.7% to 69.4%", "3 of 8", "150.0", "0.22"),
    ]
    assert report.headline() == (
        "The policy that ships wins 87.5% of 8 lanes as trained and 37.5% at wind = 3, the least of 2 conditions"
    )
    [axes] = figures["sweep"].axes
    assert (tick_texts(axes.xaxis), axes.get_title("left")) == (["0", "3"], "wind, m/s")
    assert points(axes.lines[0]) == [(0.0, 0.875), (1.0, 0.375)]
    assert {y for _, y in points(axes.lines[-1])} == {0.875}
    assert "\n\nModelled · 8 lanes each · seed 0\n\n" in (report.run.path / "report.md").read_text()


def test_the_page_has_the_table_of_conditions() -> None:
    page = (Path(__file__).parents[1] / "docs" / "training.md").read_text(encoding="utf-8")
    assert not [name for name in CONDITIONS if f"`{name}`" not in page]


def test_options_and_overrides_of_evaluate_are_the_conditions_around_which_is_swept(tmp_path: Path) -> None:
    options = {"agent": "straight", "games": 2, "clock_speed": 5.0, "seed": None}
    request = RunRequest(
        "evaluate", options, ["task.max_commands=3", "task.difficulty.wind_m_s=2"], out=tmp_path / "run"
    )
    sweep_agent(request, ["wind=2,4", "light=.5"], None)
    assert [row["case"] for row in RunDirectory(tmp_path / "run").rows()] == ["as-trained", "wind-4", "light-0.5"]
    part = RunDirectory(tmp_path / "run" / "parts" / "light-0.5").config()["task"]
    assert (part["clock_speed"], part["max_commands"], part["difficulty"]["wind_m_s"]) == (5.0, 3, 2)
    assert part["difficulty"]["light"] == [0.5, 0.5]
    with pytest.raises(UsageError, match="twice"):
        sweep_agent(request, ["wind=2", "wind=4"], None)
    with pytest.raises(UsageError, match="--against"):
        sweep_agent(request, ["wind=2"], tmp_path)


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


SCALES = (0.0, 1.0, 2.0, 4.0)


def mapped(path: Path, **ratios: list[float]) -> Report:
    """Success of 40 lanes at latencies ×0, ×1, ×2 and ×4, by command and ClockSpeed, as in adsc5; -1 is not flown."""
    rows: list[Any] = [
        {
            "case": f"latency{scale:g}-{name[:4]}-{name[4:]}x", "latency_scale": scale,
            "command": name[:4], "clock_speed": float(name[4:]),
            "games": 40, "successes": round(40 * ratio), "distance_m_median": 75.0, "sim_time_s": 9.0,
            "arrays": outcomes_of(np.arange(40) < round(40 * ratio)),
        }
        for name, line in ratios.items()
        for scale, ratio in zip(SCALES, line, strict=True)
        if ratio >= 0
    ]  # fmt: skip
    return report_of(path, Robustness(), configured("robustness"), rows[::-1])


@pytest.mark.parametrize(
    ("line", "above", "below", "words"),
    [
        ([0.9, 0.9, 0.5, 0.3], 2.0, 4.0, "between ×2 and ×4"),  # half of 0.8 is 0.4
        ([0.9, 0.9, 0.8, 0.4], 4.0, None, "nowhere up to ×4"),
        ([0.9, 0.1, 0.8, 0.8], 0.0, 1.0, "between ×0 and ×1"),
        ([0.3, 0.3, 0.3, 0.3], None, 0.0, "at ×0 or less"),
    ],
)
def test_success_collapses_below_half_of_that_in_real_time(
    line: list[float], above: Any, below: Any, words: str, tmp_path: Path
) -> None:
    report = mapped(tmp_path / "run", adsc5=line, adsc1=[0.9, 0.8, 0.8, 0.8], tcsc5=line)
    collapses: Any = report.summary["collapses"]
    assert [(found["command"], found["clock_speed"]) for found in collapses] == [("adsc", 1), ("adsc", 5), ("tcsc", 5)]
    assert (collapses[1]["above"], collapses[1]["below"]) == (above, below)
    assert (collapses[1]["real_time"], collapses[1]["fitted"]) == (0.8, line[1])
    assert [collapses[2][name] for name in ("above", "below", "real_time")] == [None] * 3
    blocks: Any = list(Robustness().page(report))
    assert blocks[3].rows[1] == ("ADSC", "5x", f"{line[1]:.1%}", words)
    assert blocks[3].rows[2][3] == "- (1x at the fitted latency was not flown)"


def test_the_map_shows_ratio_and_interval_of_every_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with style.project_style():
        figures = record_figures(monkeypatch)
        report = mapped(
            tmp_path / "run", tcsc1=[0.975, 0.9, 0.8, -1.0], adsc5=[0.5, 0.25, 0.2, 0.0], adsc1=[0.9, 0.8, 0.8, 0.75]
        )
        report.write()
    assert report.headline() == (
        "The policy that ships wins from 0.0% with ADSC at 5x and latency ×4 to 97.5% with TCSC at 1x and latency ×0"
    )
    axes: Any = figures["robustness_map"].axes[0]
    assert [axis.get_title("left") for axis in figures["robustness_map"].axes] == ["ADSC", "TCSC"]
    assert (tick_texts(axes.xaxis), tick_texts(axes.yaxis)) == (["1x", "5x"], ["×0", "×1", "×2", "×4"])
    shown = {text.xy: text.get_text() for text in axes.texts if "%" in text.get_text()}
    assert {place: shown[place] for place in ((0, 0), (1, 1), (1, 3))} == {(0, 0): "90%", (1, 1): "25%", (1, 3): "0%"}
    assert axes.images[0].get_array()[1, 1] == 0.25
    interval = binomtest(10, 40).proportion_ci(method="wilson")
    assert f"{100 * interval.low:.0f}–{100 * interval.high:.0f}" in texts(axes)
    (frame,) = axes.patches
    assert (frame.get_y(), frame.get_height()) == (0.5, 1.0)  # the second line: the latency as fitted
    source = "Modelled, profile airsim · 11 points, 40 lanes each · seed 0"
    assert f"\n\n{source}\n\n" in (report.run.path / "report.md").read_text()
    table = Robustness().overview(report)
    assert table.header == ("command", "latency", "1x", "5x")
    assert [row[:2] for row in table.rows[3:5]] == [("ADSC", "×4"), ("TCSC", "×0")]
    assert table.rows[1][3] == f"25% [{100 * interval.low:.0f}, {100 * interval.high:.0f}]"
    assert table.rows[4][3] == "-"


# --- mistakes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "override", "said"),
    [
        ("ablation", "variants=[{name: a, changes: {latency.platform.tik_us: 1.0}}]", "variant 'a'.*tik_us.*tick_us"),
        ("ablation", "variants=[{name: a}, {name: a}]", "has a twice"),
        ("ablation", "variants=[]", "variants"),
        ("ablation", "base.rounds=[0]", "base: rounds"),
        ("sweep", "sweep={wind: [99]}", "task.difficulty.wind_m_s = 99"),
        ("sweep", "sweep={wind: [1, 1.0]}", "each once"),
        ("sweep", "sweep={wind: []}", "needs values"),
        ("sweep", "sweep={nothing: [1]}", "is unknown"),
        (
            "sweep",
            "sweep={task.nothing: [1]}",
            "--sweep task.nothing: uavaccel/ObstacleLane-v0 has no task.nothing; known: wind, ",
        ),
        ("sweep", "sweep={command: [fly]}", "task.command"),
        ("robustness", "latency_scale=[-1]", "latency_scale.0 = -1: should be greater than or equal to 0"),
        ("robustness", "latency_scale=[1, 1]", "has 1 twice"),
        ("robustness", "evaluation.keys={task.histry: 1}", "unknown key 'task.histry'"),
        ("robustness", "evaluation.experiment=dp1", "evaluation.experiment = dp1|unknown key"),
        ("robustness", "agent=nowhere", "nowhere: holds no policy"),
    ],
)
def test_a_grid_that_cannot_be_flown_is_refused_in_one_line(name: str, override: str, said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        configured(name, override)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("wnd=1", "did you mean 'wind'"),
        ("wind", "NAME=VALUE"),
        ("wind=", "NAME=VALUE"),
        ("=1", "NAME=VALUE"),
        ("agent=straight", "is unknown"),
        ("wind=[", "--sweep wind"),
    ],
)
def test_a_sweep_that_cannot_be_read_is_one_line(text: str, said: str) -> None:
    with pytest.raises(UserError, match=said):
        parse_sweep(text)


def test_a_sweep_on_the_wall_clock_is_flown_in_one_process() -> None:
    wall = configured("sweep", *BLIND, "evaluation.keys={task.timing: wall}", sweep={"wind": [1]})
    assert "wall clock" in Sweep().why_serial(wall)
    assert Sweep().why_serial(configured("sweep", *BLIND, sweep={"wind": [1]})) == ""
    assert Sweep().status([{"case": "wind-1", "successes": 1, "games": 2}]) == "wind-1 won 1 of 2"
    assert Sweep().games(wall, Point("", "virtual", 0.0, {}, {})) == 2
