"""The suite `ablation`: what a variant changes, that all else stays as it is, and the numbers that are drawn."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from uavaccel.suites.old_dp1.suite import Dp1

from tests.running import fly_into, run_into
from uavaccel.config import validate
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment
from uavaccel.suites.ablation.report import AblationReport, VariantCurve, curves, plot_variants, summarise, table
from uavaccel.suites.ablation.suite import Ablation, AblationConfig, Variant
from uavaccel.suites.old_dp1.config import Dp1Config
from uavaccel.suites.old_dp1.scores import Cell, CellKey, CellScores
from uavaccel.yaml_io import load_yaml

BASE: dict[str, Any] = {
    "profile": "airsim",
    "command": ["adsc"],
    "clock_speed": [1, 10],
    "t_move_s": [0.2],
    "rounds": [2],
    "games": 2,
    "reference_games": 2,
}


def config_of(*variants: dict[str, Any], **keys: Any) -> AblationConfig:
    mapping = {"suite": "ablation", "seed": 4, "base": BASE, "variants": list(variants), **keys}
    return validate(AblationConfig, mapping, "test")


def test_a_variant_changes_its_keys_and_nothing_else() -> None:
    config = config_of({"name": "as it is"}, {"name": "dear", "changes": {"latency.platform.tick_us": 70.0}})
    plain, dear = (config.experiment(variant) for variant in config.variants)
    assert plain == validate(Dp1Config, {**BASE, "suite": "dp1", "seed": 4}, "dp1")
    assert dear.latency.platform.tick_us == 70.0
    assert dear.model_dump(exclude={"latency"}) == plain.model_dump(exclude={"latency"})
    assert dear.latency.reply_us == plain.latency.reply_us
    slow = config.experiment(Variant(name="slow", changes={"latency.reply_us.move": 2}))
    assert slow.latency.reply_us["move"] == tuple(2 * each for each in plain.latency.reply_us["move"])


@pytest.mark.parametrize(
    ("variants", "text"),
    [
        ([{"name": "a", "changes": {"latency.platform.tik_us": 1.0}}], "variant 'a'.*tik_us.*tick_us"),
        ([{"name": "a"}, {"name": "a"}], "names of their own"),
        ([], "variants"),
    ],
)
def test_a_variant_that_cannot_be_is_refused(variants: list[dict[str, Any]], text: str) -> None:
    with pytest.raises(UserError, match=text):
        config_of(*variants)


def test_variants_fly_the_games_of_dp1_with_its_seeds(tmp_path: Path) -> None:
    """The variant that changes nothing flies DP1's own rows; one without latency is ADSC without its error."""
    config = config_of({"name": "as it is"}, {"name": "0", "changes": {"latency.scale": 0.0}})
    summary = run_into(tmp_path / "ablation", Ablation(), config)
    alone = fly_into(tmp_path / "dp1", Dp1(), config.experiment(config.variants[0]))
    walls: dict[str, list[float]] = {"as it is": [], "0": []}
    for row in RunDirectory(tmp_path / "ablation").rows():
        walls[row["variant"]].append(row["wall_s"])
    own = [row["wall_s"] for row in alone.rows() if row["role"] != "figure2"]
    assert walls["as it is"] == own
    at_10x = {entry["variant"]: entry for entry in summary["entries"] if entry["clock_speed"] == 10}
    assert at_10x["0"]["stlc_quartiles"] == [2.0, 2.0, 2.0]
    assert at_10x["0"]["share_beyond_goal_timeout"] == 0
    assert at_10x["as it is"]["stlc_quartiles"][1] < 1.95
    assert at_10x["as it is"]["share_beyond_goal_timeout"] > 0.5, "28 ms at 10x are 280 ms"
    assert at_10x["as it is"]["effective_speedup"] < at_10x["0"]["effective_speedup"]


ENTRY = {
    "variant": "3",
    "command": "adsc",
    "clock_speed": 10.0,
    "games": 4,
    "failed_games": 1,
    "stlc_quartiles": [1.25, 1.5, 1.75],
    "position_rmse_m_median": 0.125,
    "effective_speedup": 7.5,
    "share_beyond_goal_timeout": 0.25,
}


def test_what_is_tabulated_and_drawn() -> None:
    unknown = {**ENTRY, "variant": "0.5", "stlc_quartiles": None, "position_rmse_m_median": None}
    assert table({"entries": [ENTRY]}).rows == [
        ("3", "ADSC", "10x", "4 (1 failed)", "1.500 [1.250, 1.750]", "0.125", "7.50", "25%")
    ]
    [curve] = curves([unknown, ENTRY], times_clock_speed=True)
    assert curve.places == [5.0, 30.0]
    assert np.isnan(curve.stlc[0])
    assert np.isnan(curve.position_rmse_m[0])
    assert (curve.stlc[1], curve.position_rmse_m[1], curve.speedup[1]) == (1.5, 0.125, 7.5)
    figure = plot_variants([curve], "latency", "Title", "source")
    lines = [panel.get_lines()[0] for panel in figure.axes]
    assert [np.asarray(line.get_xdata())[1] for line in lines] == [30.0] * 3
    assert [np.asarray(line.get_ydata())[1] for line in lines] == [1.5, 0.125, 7.5]


def scored(t_move_s: float, rounds: int, timing: str, *values: list[float]) -> CellScores:
    """Of ADSC at 10x: STLC, position errors, gaps."""
    stlc, rmse_m, gap_s = map(np.array, values)
    cell = Cell(CellKey("adsc", 10.0, t_move_s, rounds, timing), (), 1, (), None, False)
    return CellScores(cell, stlc, rmse_m, rmse_m, gap_s, 1)


def test_a_variants_games_are_pooled_and_its_speed_up_is_that_of_the_longest_paths() -> None:
    """Games without latency are not the variant's, and gaps up to the 63 ms of the goal timeout are within it."""
    scores = [
        scored(0.5, 2, "virtual", [1.0, 2.0], [0.5, 0.25], [0.063, 0.064]),
        scored(1.0, 24, "virtual", [1.5, 1.75, 1.25], [0.0, 1.0, 2.0], [0.1, 0.01, 0.02, 0.03]),
        scored(1.0, 24, "lockstep", [9.0], [9.0], [9.0]),
    ]
    cells: list[Any] = [
        {
            "command": command,
            "clock_speed": k,
            "rounds": rounds,
            "timing": timing,
            "effective_speedup": speedup,
        }
        for command, k, rounds, timing, speedup in (
            *(("adsc", 10.0, 2, "virtual", 100.0), ("adsc", 10.0, 24, "virtual", 4.0)),
            *(("adsc", 10.0, 24, "virtual", 7.0), ("adsc", 10.0, 24, "lockstep", 200.0)),
            *(("adsc", 5.0, 24, "virtual", 300.0), ("tcsc", 10.0, 24, "virtual", 400.0)),
        )
    ]
    assert summarise("late", scores, cells) == [
        {
            "variant": "late", "command": "adsc", "clock_speed": 10.0, "games": 5, "failed_games": 2,
            "stlc_quartiles": [1.25, 1.5, 1.75], "position_rmse_m_median": 0.5, "effective_speedup": 5.5,
            "share_beyond_goal_timeout": 2 / 6,
        }
    ]  # fmt: skip


def test_the_headline_names_the_least_and_the_most_accurate_variant_at_the_fastest_clock() -> None:
    def entry(command: str, clock_speed: float, variant: str, median: float | None) -> dict[str, Any]:
        quartiles = None if median is None else [0.0, median, 2.0]
        return {
            "command": command,
            "clock_speed": clock_speed,
            "variant": variant,
            "stlc_quartiles": quartiles,
        }

    entries = [
        *(
            entry("tcsc", 50.0, "plain", 1.9),
            entry("adsc", 50.0, "plain", 1.25),
            entry("adsc", 5.0, "plain", 0.5),
        ),
        *(
            entry("adsc", 50.0, "calm", 1.75),
            entry("adsc", 50.0, "late", 1.0),
            entry("adsc", 100.0, "late", None),
        ),
    ]
    told: Any = SimpleNamespace(summary={"entries": entries})
    assert AblationReport.headline(told) == (
        "ADSC at 50x: STLC from 1.000 with late to 1.750 with calm; TCSC at 50x: STLC 1.900 with plain"
    )


def test_named_variants_stand_side_by_side() -> None:
    values = np.array([1.0, 2.0])
    figure = plot_variants(
        [VariantCurve("tcsc", 5.0, ["none", "late"], values, values, values)], "variant", "Title", "source"
    )
    assert [text.get_text() for text in figure.axes[0].get_xticklabels()] == ["none", "late"]
    assert np.asarray(figure.axes[0].get_lines()[0].get_xdata()).tolist() == [0.0, 1.0]


SHIPPED = [experiment("ablation.yaml"), *sorted(experiment("ablations").glob("*.yaml"))]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_ablations_that_ship_can_be_flown(path: Path) -> None:
    config = validate(AblationConfig, load_yaml(path), path.name)
    assert len({config.experiment(variant).model_dump_json() for variant in config.variants}) == len(
        config.variants
    ), "every variant is another"
