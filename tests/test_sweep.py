"""Sweeps: what a condition is, which flights it takes, what its report says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from tests.drawing import texts, tick_texts
from tests.running import configured, fly_into, run_into
from uavaccel.cli.evaluate import sweep_agent
from uavaccel.cli.run import RunRequest
from uavaccel.envs.conditions import CONDITIONS
from uavaccel.errors import UsageError, UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.suite import Evaluation
from uavaccel.suites.sweep.config import SweepConfig, keys_of, parse_sweep
from uavaccel.suites.sweep.suite import Sweep, plot_sweeps, summarise, swept, table

# It sees nothing, so there are no pictures.
SMALL = ("agent=straight", "games=3", "evaluation.keys={task.max_commands: 4}")


def small(**sweep: Any) -> SweepConfig:
    config = configured("sweep", *SMALL, sweep=sweep)
    assert isinstance(config, SweepConfig)
    return config


def test_a_condition_is_an_evaluation_with_one_key_changed_and_none_is_flown_twice(tmp_path: Path) -> None:
    summary = run_into(tmp_path / "run", Sweep(), small(wind=[0, 8], speed=[2]))
    run = RunDirectory(tmp_path / "run")
    assert [row["case"] for row in run.rows()] == ["as-trained", "wind-8", "speed-2"]
    assert [(cell["condition"], cell["value"]) for cell in summary["cells"]] == [
        ("", None),
        ("wind", 0),
        ("wind", 8),
        ("speed", 2),
    ]
    distances = {row["case"]: run.load_arrays(row)["distance_m"] for row in run.rows()}
    alone = configured(
        "evaluate", "agent=straight", "games=3", "task.max_commands=4", "task.difficulty.wind_m_s=8"
    )
    flown = fly_into(tmp_path / "alone", Evaluation(), alone).rows()
    assert [row["distance_m"] for row in flown] == list(distances["wind-8"])
    assert (distances["speed-2"] > distances["as-trained"] + 2.0).all()
    assert summary["cells"][1]["distance_m_median"] == summary["cells"][0]["distance_m_median"]
    report: Any = Sweep().report(run)
    ratios = (0.9, 0.95, 0.25, 0.5)
    cells = [cell | {"success_ratio": ratio} for cell, ratio in zip(summary["cells"], ratios, strict=True)]
    report.summary = {**summary, "cells": cells}
    assert "wins 90.0% as trained, 25.0% at wind = 8, the least of 3 conditions;" in report.headline()


def test_every_shipped_condition_is_an_evaluation_that_can_be_flown() -> None:
    config = configured("sweep", "agent=straight")
    assert isinstance(config, SweepConfig)
    assert set(CONDITIONS) - set(config.sweep) == {"profile"}
    flown = [case.id for case in Sweep().cases(config)]
    assert flown[0] == "as-trained"
    usual = {
        "wind-0",
        "scenery-plain",
        "spread-1",
        "shot_noise-0",
        "leak-0",
        "hot_pixels-0",
        "image_noise-0",
        "spacing-10",
        "gap-2",
        "speed-1",
        "height-2",
        "sensor-clean",
        "clock-1",
        "command-tcsc",
    }
    assert not usual & set(flown)
    assert len(flown) == len(set(flown)) == 1 + sum(map(len, config.sweep.values())) - 19


def test_the_tests_intervals_and_table_are_those_of_the_rows() -> None:
    rows: list[Any] = [
        {"case": "as-trained", "same": ["wind-0"], "successes": 7, "games": 8, "timing": "virtual"},
        {"case": "wind-3", "same": [], "successes": 3, "games": 8, "timing": "virtual"},
    ]
    won = {
        "as-trained": np.array([1, 1, 1, 1, 1, 1, 1, 0], bool),
        "wind-3": np.array([1, 1, 0, 0, 0, 0, 0, 1], bool),
    }
    config = {"agent": "default", "seed": 0, "games": 8, "sweep": {"wind": [0, 3, 6], "light": [1]}}
    summary = summarise(config, [row | {"distance_m_median": 150.0} for row in rows], won)
    assert [cell["value"] for cell in summary["cells"]] == [None, 0, 3]  # 6 and the light are not flown yet
    cell = summary["cells"][2]
    interval = binomtest(3, 8).proportion_ci(method="wilson")
    assert (cell["wilson_low"], cell["wilson_high"]) == pytest.approx((interval.low, interval.high))
    assert cell["mcnemar_p"] == pytest.approx(binomtest(1, 6).pvalue)  # lost five that were won, won one
    assert table(summary).rows[2][:5] == ("wind, m/s", "3", "37.5%", "13.7% to 69.4%", "3 of 8")
    figure = plot_sweeps(swept(summary), 7 / 8, "Success", "modelled")
    axes = figure.axes[0]
    assert tick_texts(axes.xaxis) == ["0", "3"]
    assert axes.get_xlabel() == "wind, m/s"
    assert "modelled" in texts(figure)


def test_the_page_has_the_table_of_conditions() -> None:
    page = (Path(__file__).parents[1] / "docs" / "training.md").read_text(encoding="utf-8")
    lines = [f"| `{each.short}` | `task.{each.key}` | {each.unit} |" for each in CONDITIONS.values()]
    assert "\n".join(lines) in page


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


@pytest.mark.parametrize(
    ("sweep", "said"),
    [
        ({"wind": [99]}, "task.difficulty.wind_m_s = 99"),
        ({"wind": [1, 1.0]}, "each once"),
        ({"wind": []}, "needs values"),
        ({"nothing": [1]}, "is unknown"),
        ({"task.nothing": [1]}, "unknown key 'task.nothing'"),
        ({"command": ["fly"]}, "task.command"),
    ],
)
def test_values_that_cannot_be_flown_are_refused_before_anything_is(sweep: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        small(**sweep)


def test_options_and_overrides_of_evaluate_are_the_conditions_around_which_is_swept(tmp_path: Path) -> None:
    options = {"agent": "straight", "games": 2, "clock_speed": 5.0, "seed": None}
    overrides = ["task.max_commands=3", "task.difficulty.wind_m_s=2"]
    request = RunRequest("evaluate", options, overrides, out=tmp_path / "run")
    sweep_agent(request, ["wind=2,4", "light=.5"], None)
    run = RunDirectory(tmp_path / "run")
    assert [row["case"] for row in run.rows()] == ["as-trained", "wind-4", "light-0.5"]
    part = RunDirectory(tmp_path / "run" / "parts" / "light-0.5").config()["task"]
    assert (part["clock_speed"], part["max_commands"], part["difficulty"]["wind_m_s"]) == (5.0, 3, 2)
    assert part["difficulty"]["light"] == [0.5, 0.5] == keys_of("light", 0.5)["task.difficulty.light"]
    with pytest.raises(UsageError, match="twice"):
        sweep_agent(request, ["wind=2", "wind=4"], None)
    with pytest.raises(UsageError, match="--against"):
        sweep_agent(request, ["wind=2"], tmp_path)
