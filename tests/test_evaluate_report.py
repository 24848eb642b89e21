"""The report of an evaluation, from rows to summary, page and figures; several side by side; paired tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import binomtest

from tests.drawing import headline, labelled, legend_texts, points, record_figures
from uavaccel.config import validate
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluate import EvaluateConfig, Evaluation, against, game_seed
from uavaccel.suites.suite import choose_row

OBSTACLES = [{"x_m": 12.0, "y_m": -2.0, "radius_m": 0.5}, {"x_m": 20.0, "y_m": 3.0, "half_side_m": 0.25}]


def run_of(path: Path, *rows: dict[str, Any], task: dict[str, Any] | None = None, **keys: Any) -> RunDirectory:
    """A run with a row for each game, of lanes 0, 1, ... and lost by default."""
    keys = {"agent": "straight", "task": {"split": "evaluation", "timing": "virtual", **(task or {})}} | keys
    run = RunDirectory.create(path, validate(EvaluateConfig, keys, "test"), {})
    for lane, row in enumerate(rows):
        lane = row.get("lane", lane)
        plain = {"suite": "evaluate", "case": f"lane-{lane:06d}", "lane": lane, "collision": None, "commands": 3}
        plain |= {"is_success": False, "sim_time_s": 10.0 + lane, "wall_s": 0.5, "distance_m": 9.0}
        plain |= {"actions": [1] * row.get("commands", 3), "phase_s": dict.fromkeys(PHASES, 0.1)}
        run.append_row(plain | row)
    return run


def flown(*distances_m: float) -> list[dict[str, Any]]:
    return [{"distance_m": distance_m, "is_success": distance_m == 150.0} for distance_m in distances_m]


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    return record_figures(monkeypatch)


def page_of(run: RunDirectory) -> str:
    Evaluation().report(run).write()
    return (run.path / "report.md").read_text().split("## Provenance")[0].replace("\\", "")


@pytest.mark.parametrize("simulator", ["mujoco", "kernels"])
def test_every_number_of_an_evaluation(tmp_path: Path, drawn: dict[str, Figure], simulator: str) -> None:
    rows = flown(150.0, 20.0, 30.0, 150.0, 90.0, 100.0, 7.0)
    rows = [row | {"wall_s": wall_s} for row, wall_s in zip(rows, (0.5, 0.1, 0.2, 0.4, 0.6, 0.7, 0.8), strict=True)]
    rows[3]["disturbed"] = True
    task = {"timing": "lockstep", "command": "adsc", "clock_speed": 10.0}
    run = run_of(tmp_path / "run", *rows, task=task, seed=4, agent="offset:1", simulator=simulator)
    page = page_of(run)
    # Wilson's score interval: the ratios that lie z standard errors of their own from 2 in 7.
    z, n, ratio = 1.959963984540054, 7, 2 / 7
    low, high = sorted(np.roots([1 + z**2 / n, -(2 * ratio + z**2 / n), ratio**2]).tolist())
    assert run.read_json("summary.json") == {
        "disturbed_games": 1,
        "suite": "evaluate",
        "agent": "offset:1",
        "simulator": simulator,
        **({"device": "cpu"} if simulator == "kernels" else {}),
        "profile": "native",
        "command": "adsc",
        "clock_speed": 10.0,
        "timing": "lockstep",
        "seed": 4,
        "games": 7,
        "successes": 2,
        "success_ratio": 2 / 7,
        "wilson_low": pytest.approx(low),
        "wilson_high": pytest.approx(high),
        "sim_time_s": 91.0,
        "wall_s": pytest.approx(3.3),
        "simulated_s_per_wall_s": pytest.approx(91.0 / 3.3),
        "distance_m_median": 90.0,
    }
    how = "modelled, simulator kernels on the CPU" if simulator == "kernels" else "modelled"
    assert page.startswith("# Evaluation of offset:1\n")
    assert (
        "The agent offset:1 wins 2 of 7 lanes with ADSC at 10x "
        f"(28.6%, 95 % Wilson interval {low:.1%} to {high:.1%}).\n\n"
        f"M{how[1:]} · 7 games each · seed 4 · 1 of 7 games disturbed\n\n"
    ) in page
    assert f"| the agent offset:1 | 28.6% [{100 * low:.0f}, {100 * high:.0f}] | 7 | {how} |" in page
    assert page.count("measured, in AirSim and another lane") == 2
    assert headline(drawn["figure8_survival"]) == ("Distance travelled", "")


def test_survival_is_the_share_of_games_that_got_at_least_so_far(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    page_of(run_of(tmp_path / "run", *flown(30.0, 151.0, 10.0, 150.0), agent="offset:1"))
    figure: Any = drawn["figure8_survival"]
    (axes,) = figure.axes
    line, end = (labelled(axes)[name] for name in ("the agent offset:1", "end of the lane"))
    assert points(line) == [(0.0, 1.0), (10.0, 0.75), (30.0, 0.5), (150.0, 0.25), (150.0, 0.0)]
    assert line.get_drawstyle() == "steps-post"  # games last until their distance
    assert end.get_xdata()[0] == 150.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("distance north, m", "share of games that got there")
    assert axes.get_ylim() == (0.0, 1.05)
    assert legend_texts(figure.legends[0]) == ["the agent offset:1", "end of the lane"]
    at_10_m = {round(y, 9) for x, y in axes.collections[0].get_paths()[0].vertices if x == 10.0}
    interval = binomtest(3, 4).proportion_ci(method="wilson")
    assert {round(interval.low, 9), round(interval.high, 9)} <= at_10_m


def test_evaluations_are_compared_in_one_figure(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    keys: dict[str, Any] = {"agent": "default", "task": {"timing": "lockstep", "history": 2, "observation": "state"}}
    runs = [
        run_of(tmp_path / "a/run", *flown(10.0, 40.0), **keys, seed=3),
        run_of(tmp_path / "b/run", *flown(20.0), **{**keys, "task": {"timing": "wall"}}, seed=1),
        run_of(tmp_path / "c", *flown(5.0, 6.0), task={"timing": "lockstep"}, seed=3, simulator="kernels"),
    ]
    assert Evaluation().compare(runs) == [tmp_path / "a/run/figures/figure8_survival_compared.png"]
    lines = labelled(drawn["figure8_survival_compared"].axes[0])
    assert {name: points(line) for name, line in lines.items() if name != "end of the lane"} == {
        f"the policy that ships ({tmp_path / 'a/run'})": [(0.0, 1.0), (10.0, 0.5), (40.0, 0.0)],
        f"the policy that ships ({tmp_path / 'b/run'})": [(0.0, 1.0), (20.0, 0.0)],
        "the agent straight, simulator kernels on the CPU": [(0.0, 1.0), (5.0, 0.5), (6.0, 0.0)],
    }
    said = headline(drawn["figure8_survival_compared"])[1]
    assert said == "measured and modelled and modelled, simulator kernels on the CPU · 1, 2 games each · seed 1, 3"


def test_a_game_has_a_seed_of_its_lane_and_the_run() -> None:
    configs = [validate(EvaluateConfig, {"agent": "straight", "seed": seed}, "test") for seed in (0, 1)]
    assert len({game_seed(config, lane) for config in configs for lane in range(50)}) == 100
    assert game_seed(configs[0], 3) == np.random.SeedSequence([0, 3]).generate_state(1)[0]


def test_the_paired_comparison_is_mcnemars_on_the_lanes_that_both_flew(tmp_path: Path) -> None:
    run = run_of(tmp_path / "run", *flown(150.0, 150.0, 150.0, 20.0, 150.0))
    other = run_of(tmp_path / "other", *({"lane": lane, "is_success": lane == 3} for lane in (4, 3, 1, 2, 9)))
    # Of lanes 1 to 4 three were won by the first alone, one by the other alone: 2 * (1 + 4) / 2**4.
    assert against(run, other) == (
        f"against {other.path} on the same 4 lanes: 3 v 1 successes, +50.0 [-39.9, +90.9] points, "
        "exact McNemar p = 0.625"
    )
    with pytest.raises(UserError, match="elsewhere: is no evaluation of the same lanes"):
        against(run, run_of(tmp_path / "elsewhere", {"lane": 77}))


@pytest.mark.parametrize(("farthest_m", "shown_m"), [(30.0, 40.0), (146.0, 152.0), (-1.0, 10.0)])
def test_lost_lanes_are_named_and_drawn_with_the_west_on_top(
    farthest_m: float, shown_m: float, tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """As a pilot who looks north sees them, turned to the right: obstacles, walls, the end, the path and its end."""
    ends: list[tuple[float, str | None]] = [(farthest_m, None), (-3.0, "wall_west")]
    rows = [{"distance_m": end_m, "collision": hit, "path_m": [[1.0, 0.5], [end_m, -2.0]]} for end_m, hit in ends]
    page = page_of(run_of(tmp_path / "run", *rows, *flown(150.0), task={"lane": {"obstacles": OBSTACLES}}))
    titles = ["-3.0 m, hitting wall_west", f"{farthest_m:.1f} m, running out of commands"]
    assert f"the shortest flight first: lanes 1 ({titles[0]}), 0 ({titles[1]}). Each" in page
    assert "| 1 | -3.0 | hitting wall_west | 3 | --case lane-000001 |\n| 0 |" in page
    panels: Any = drawn["lost_lanes"].axes
    assert [axes.get_title(loc="left") for axes in panels] == [f"lane 1: {titles[0]}", f"lane 0: {titles[1]}"]
    for axes, end_m in zip(panels, (-3.0, farthest_m), strict=True):
        assert (axes.get_xlim(), axes.get_ylim()) == ((-2.0, shown_m), (5.0, -5.0))
        west, east, goal, path, end = axes.lines
        assert [line.get_ydata()[0] for line in (west, east)] == [-5.0, 5.0]
        assert goal.get_xdata()[0] == 150.0
        assert points(path) == [(0.0, 0.0), (1.0, 0.5), (end_m, -2.0)]
        assert points(end) == [(end_m, -2.0)]
        post, box = axes.patches
        assert (post.center, post.radius) == ((12.0, -2.0), 0.5)
        assert box.get_bbox().bounds == (19.75, 2.75, 0.5, 0.5)


def test_of_many_lost_lanes_nine_are_drawn_and_none_without_a_path(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = [{"distance_m": 40.0 - lane, "path_m": [[40.0 - lane, 0.0]]} for lane in range(11)]
    page = page_of(run_of(tmp_path / "many", *rows))
    assert "by the positions at the ends of the commands. 2 more are in the table below." in page
    assert "lanes 10 (30.0 m, running out of commands), 9 (31.0 m" in page
    assert "2 (38.0 m, running out of commands), and 2 more. Each" in page
    assert [axes.get_title(loc="left")[:7] for axes in drawn["lost_lanes"].axes][::8] == ["lane 10", "lane 2:"]
    drawn.clear()
    randomised = {"randomise": {"wind_m_s": [0.0, 3.0]}}
    for name, lost, task in (("none", flown(9.0), {}), ("drawn_anew", rows, randomised), ("won", flown(150.0), {})):
        page = page_of(run_of(tmp_path / name, *lost, task=task))
        assert ("## Lost lanes" in page) == (name != "won")
        assert list(drawn) == ["figure8_survival"], name


@pytest.mark.parametrize("made", [(), ("best",), ("best", "worst")])
@pytest.mark.usefixtures("drawn")
def test_films_that_were_made_are_in_the_report(tmp_path: Path, made: tuple[str, ...]) -> None:
    run = run_of(tmp_path / "run", *flown(150.0))
    for name in made:
        for kind in ("mp4", "png"):
            run.file(f"films/{name}.{kind}").write_bytes(b"a film")
    run.file("films/worst.mp4").write_bytes(b"a film without its sheet")
    page = page_of(run)
    assert [name for name in ("best", "worst") if f"(films/{name}.mp4)" in page] == list(made)
    assert page.count("## Films") == bool(made)


def test_the_best_game_is_shown_unless_one_is_named(tmp_path: Path) -> None:
    """From the success in the fewest commands to the failure with the least distance."""
    order = [(True, 20, 150.0), (True, 30, 150.0), (False, 9, 90.0), (False, 3, 1.0)]
    rows = [{"is_success": won, "commands": n, "distance_m": m} for won, n, m in order[::-1]]
    suite, run = Evaluation(), run_of(tmp_path / "run", *rows)
    report = suite.report(run)
    assert choose_row(suite, report)["commands"] == 20
    assert [row["lane"] for row in sorted(report.rows, key=suite.interest)] == [3, 2, 1, 0]
    assert choose_row(suite, report, "lane-000001")["lane"] == choose_row(suite, report, number=1)["lane"] == 1
    with pytest.raises(UserError, match=r"--case lane-99: not in"):
        choose_row(suite, report, "lane-99")
    for number in (-1, 4):
        with pytest.raises(UserError, match=rf"--game {number}: .* has 4 games, from 0 to 3"):
            choose_row(suite, report, number=number)
