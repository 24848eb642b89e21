"""The robustness map: cells that are evaluations, where success collapses, and what the figure shows."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from scipy.stats import binomtest

from tests.drawing import texts, tick_texts
from tests.running import configured, fly_into, run_into
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.suite import Evaluation
from uavaccel.suites.robustness.suite import (
    Robustness,
    RobustnessConfig,
    RobustnessReport,
    collapse,
    maps,
    plot_success_maps,
    summarise,
)

# It sees nothing, so there are no pictures; the latency changes where it is when a game is cut short.
SMALL = ("agent=straight", "games=2", "latency_scale=[1, 0]", "evaluation.keys={task.max_commands: 6}")


def small(**options: Any) -> RobustnessConfig:
    config = configured("robustness", *SMALL, **{"clock_speed": [1.0, 50.0], **options})
    assert isinstance(config, RobustnessConfig)
    return config


@pytest.mark.slow
def test_a_cell_is_an_evaluation_under_its_latency(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = small(command=["adsc"])
    with monkeypatch.context() as patch:
        append = RunDirectory.append_row
        rows: list[str] = []

        def interrupted(run: RunDirectory, row: Any, on_disk: bool = True) -> None:
            if len(rows) == 5:  # two cells of two games are over
                raise KeyboardInterrupt
            append(run, row, on_disk)
            rows.append(row["case"])

        patch.setattr(RunDirectory, "append_row", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_into(tmp_path / "run", Robustness(), config)
    summary = run_into(tmp_path / "run", Robustness(), config, resume=True)
    run = RunDirectory(tmp_path / "run")
    assert [row["case"] for row in run.rows()] == [
        f"latency{scale}-adsc-{k}x" for scale in (1, 0) for k in (1, 50)
    ]
    keys = ("task.max_commands=6", "task.profile=airsim", "task.command=adsc", "task.latency.scale=0")
    alone = configured("evaluate", *keys, clock_speed=50.0, games=2, agent="straight")
    flown = fly_into(tmp_path / "alone", Evaluation(), alone).rows()
    row_of = {row["case"]: row for row in run.rows()}
    arrays = run.load_arrays(row_of["latency0-adsc-50x"])
    assert arrays["distance_m"].tolist() == [row["distance_m"] for row in flown]
    assert arrays["lane"].tolist() == [0, 1]
    assert (
        arrays["distance_m"].tolist() != run.load_arrays(row_of["latency1-adsc-50x"])["distance_m"].tolist()
    )
    assert [cell["successes"] for cell in summary["cells"]] == [0] * 4


def cells(**ratios: list[float]) -> list[dict[str, Any]]:
    """Success of ADSC at latencies ×0, ×1, ×2 and ×4 of 40 lanes, by ClockSpeed."""
    rows: list[Any] = [
        {
            "command": "adsc",
            "clock_speed": float(name.removeprefix("k")),
            "latency_scale": scale,
            "games": 40,
            "successes": round(40 * ratio),
            "distance_m_median": 75.0,
        }
        for name, line in ratios.items()
        for scale, ratio in zip((0.0, 1.0, 2.0, 4.0), line, strict=True)
    ]
    config = {"agent": "default", "profile": "airsim", "seed": 0}
    found: list[dict[str, Any]] = summarise(config, rows[::-1])["cells"]
    return found


@pytest.mark.parametrize(
    ("line", "above", "below"),
    [
        ([0.9, 0.9, 0.5, 0.3], 2.0, 4.0),  # half of 0.8 is 0.4
        ([0.9, 0.9, 0.8, 0.4], 4.0, None),
        ([0.9, 0.1, 0.8, 0.8], 0.0, 1.0),
        ([0.3, 0.3, 0.3, 0.3], None, 0.0),
    ],
)
def test_success_collapses_below_half_of_that_in_real_time(
    line: list[float], above: float | None, below: float | None
) -> None:
    found = collapse(cells(k1=[0.9, 0.8, 0.8, 0.8], k5=line), "adsc", 5.0)
    assert (found["above"], found["below"]) == (above, below)
    assert (found["real_time"], found["fitted"]) == (0.8, line[1])
    assert (
        collapse(cells(k5=line), "adsc", 5.0)["above"] is None
    )  # without real time there is nothing to fall below


def test_the_headline_goes_from_the_worst_cell_to_the_best() -> None:
    cells = [
        {"command": command, "clock_speed": k, "latency_scale": scale, "success_ratio": ratio, "games": games}
        for command, k, scale, ratio, games in (
            *(("tcsc", 5.0, 1.0, 0.5, 40), ("adsc", 20.0, 2.5, 0.125, 30)),
            *(("tcsc", 1.0, 0.0, 0.975, 20), ("adsc", 1.0, 1.0, 0.75, 10)),
        )
    ]
    told: Any = SimpleNamespace(summary={"cells": cells, "agent": "straight", "profile": "airsim"})
    assert RobustnessReport.headline(told) == (
        "straight wins from 12.5% with ADSC at 20x and latency ×2.5 to 97.5% with TCSC at 1x and latency ×0: "
        "100 games over 4 points of latency and ClockSpeed, all of it modelled under airsim"
    )


def test_the_map_shows_ratio_and_interval_of_every_cell() -> None:
    figure = plot_success_maps(
        maps(cells(k1=[0.9, 0.8, 0.8, 0.75], k5=[0.5, 0.25, 0.2, 0.0])), 1.0, "Map", "modelled"
    )
    axes: Any = figure.axes[0]
    assert (tick_texts(axes.xaxis), tick_texts(axes.yaxis)) == (["1x", "5x"], ["×0", "×1", "×2", "×4"])
    shown = {
        annotation.xy: annotation.get_text() for annotation in axes.texts if "%" in annotation.get_text()
    }
    assert shown[(0, 0)] == "90%"
    assert shown[(1, 1)] == "25%"
    assert shown[(1, 3)] == "0%"
    interval = binomtest(10, 40).proportion_ci(method="wilson")
    assert f"{100 * interval.low:.0f}–{100 * interval.high:.0f}" in texts(axes)
    (frame,) = axes.patches
    assert (frame.get_y(), frame.get_height()) == (0.5, 1.0)  # the second line: the latency as fitted


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("latency_scale=[-1]", "latency_scale = .*must be 0 to 1000"),
        ("latency_scale=[1, 1]", "has 1 twice"),
        ("evaluation.keys={task.histry: 1}", "unknown key 'task.histry'"),
        ("agent=nowhere", "nowhere: holds no policy"),
    ],
)
def test_a_map_that_cannot_be_is_one_clear_line(override: str, said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        configured("robustness", override)
    assert "\n" not in str(caught.value)
