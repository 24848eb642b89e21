"""Summaries of evaluations and trainings, and their figures: whose numbers a line or bar shows, and where from."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure

from tests.dp1_games import quantile
from tests.drawing import headline, labelled, points, record_figures, tick_texts
from tests.learning import tiny_config, train_into
from tests.opengl import needs_opengl
from uavaccel.config import Config
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.files import append_line
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.rl.learner import Game
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.report import plot_evaluations, summarise
from uavaccel.suites.training import real_time
from uavaccel.suites.training import rows as training_rows
from uavaccel.suites.training.learning_curves import (
    Evaluated,
    evaluated,
    plot_evaluated,
    plot_over_games,
    plot_over_time,
    plot_progress,
    recent_mean,
)
from uavaccel.suites.training.phases import phase_times, plot_stacked, plot_trainings, unit_of
from uavaccel.suites.training.real_time import model_real_time
from uavaccel.suites.training.report import TrainingReport, summarise_evaluations
from uavaccel.suites.training.suite import Training
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import shipped_latency

Row = Any


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    return record_figures(monkeypatch)


class Flown(Config):
    """What the figures read of a configuration."""

    seed: int
    task: dict[str, Any]
    agent: str = ""
    environments: int = 1


def run_of(path: Path, config: Flown, rows: list[Row], timings: list[Row] | None = None) -> RunDirectory:
    run = RunDirectory.create(path, config, {})
    for number, row in enumerate(rows):
        run.append_row({"case": str(number), **row})
    for entry in timings or []:
        run.append_timing(entry)
    return run


# --- evaluations --------------------------------------------------------------------------------------------


def test_every_number_of_an_evaluation() -> None:
    task = LaneTask(split="evaluation", timing="virtual", command="adsc", clock_speed=10.0)
    config = EvaluateConfig(agent="offset:1", seed=4, task=task)
    distances_m, walls_s = [150.0, 20.0, 30.0, 150.0, 90.0, 100.0, 7.0], [0.5, 0.1, 0.2, 0.4, 0.6, 0.7, 0.8]
    rows: list[Any] = [
        {"is_success": d == 150.0, "distance_m": d, "sim_time_s": 10.0 + i, "wall_s": wall_s}
        for i, (d, wall_s) in enumerate(zip(distances_m, walls_s, strict=True))
    ]
    # Wilson's score interval: the ratios that lie z standard errors of their own from 2 in 7.
    z, n, ratio = 1.959963984540054, 7, 2 / 7
    low, high = sorted(np.roots([1 + z**2 / n, -(2 * ratio + z**2 / n), ratio**2]).tolist())
    assert summarise(config, rows) == {
        "suite": "evaluate",
        "agent": "offset:1",
        "simulator": "mujoco",
        "profile": "native",
        "command": "adsc",
        "clock_speed": 10.0,
        "timing": "virtual",
        "seed": 4,
        "games": 7,
        "successes": 2,
        "success_ratio": 2 / 7,
        "wilson_low": pytest.approx(low),
        "wilson_high": pytest.approx(high),
        "sim_time_s": 91.0,
        "wall_s": pytest.approx(3.3),
        "simulated_s_per_wall_s": pytest.approx(91.0 / 3.3),
        "distance_m_median": quantile(distances_m, 0.5),
    }


def evaluation(path: Path, agent: str, timing: str, seed: int, *distances_m: float) -> RunDirectory:
    config = Flown(seed=seed, agent=agent, task={"timing": timing})
    return run_of(path, config, [{"distance_m": distance_m} for distance_m in distances_m])


def test_figure_8_has_a_line_for_each_evaluation(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    runs = [
        evaluation(tmp_path / "a/run", "default", "virtual", 3, 10.0, 40.0),
        evaluation(tmp_path / "b/run", "default", "wall", 1, 20.0),
        evaluation(tmp_path / "c", "straight", "virtual", 3, 5.0, 6.0),
    ]
    path = tmp_path / "figure8_survival.png"
    assert plot_evaluations(runs, path).path == path
    lines = labelled(drawn["figure8_survival"].axes[0])
    assert {name: points(line) for name, line in lines.items() if name != "end of the lane"} == {
        f"default ({tmp_path / 'a/run'})": [(0.0, 1.0), (10.0, 0.5), (40.0, 0.0)],
        f"default ({tmp_path / 'b/run'})": [(0.0, 1.0), (20.0, 0.0)],
        "straight": [(0.0, 1.0), (5.0, 0.5), (6.0, 0.0)],
    }
    assert headline(drawn["figure8_survival"])[1] == "measured and modelled · 1, 2 games each · seed 1, 3"
    for run, provenance in ((runs[1], "measured · 1 games"), (runs[2], "modelled · 2 games")):
        plot_evaluations([run], tmp_path / "figure8_survival.png")
        assert headline(drawn["figure8_survival"])[1].startswith(provenance)


# --- trainings ----------------------------------------------------------------------------------------------


def test_every_number_of_a_training(tmp_path: Path) -> None:
    task = {
        "observation": "state",
        "timing": "virtual",
        "command": "adsc",
        "clock_speed": 20.0,
        "max_commands": 5,
    }
    config = tiny_config(task, mirror=False, seed=9, games=3)
    summary = dict(train_into(tmp_path / "run", config))
    run = RunDirectory(tmp_path / "run")
    assert summary == run.read_json("summary.json")
    page = (run.path / "report.md").read_text()
    beside = [line.split(" | ") for line in page.splitlines() if line.startswith(("| games |", "| in real"))]
    assert beside[0] == ["| games", "3", "5000", "counted |"]
    assert beside[1][2] == "182.0 h", "a week and fourteen hours"
    assert beside[1][1] == f"{summary['modelled_real_time_s']:.1f} s"
    assert len(summary.pop("weights_sha256")) == 64
    commands = [row["commands"] for row in run.rows()]
    assert 1.0 < summary.pop("modelled_real_time_s") / sum(commands) < 1.1  # of 1 s each
    assert summary.pop("modelled_real_time_how").startswith("ADSC under the profile airsim at ClockSpeed 1 ")
    assert summary == {
        "suite": "train",
        "profile": "native",
        "command": "adsc",
        "clock_speed": 20.0,
        "timing": "virtual",
        "seed": 9,
        "games": 3,
        "successes": 0,  # nobody gets 150 m far in five commands
        "commands": sum(commands),
        "sim_time_s": float(sum(commands)),  # of 1 s each
        "phase_s": {
            phase: pytest.approx(np.sum([row["phase_s"][phase] for row in run.rows()])) for phase in PHASES
        },
    }
    assert summary["phase_s"]["simulation"] > summary["phase_s"]["learning"] > 0


def test_real_time_has_flight_pictures_decisions_and_learning() -> None:
    """While a TCSC's client decides and learns nothing flies, so that these add up exactly."""
    state = {"observation": "state", "clock_speed": 50.0}  # as it was trained is not how it is modelled
    keys = {"mirror": False, "inference_s": 0.0, "learning_s": 0.0}
    blind = model_real_time(tiny_config(state, **keys))["command_s"]
    assert 1.0 < blind < 1.05
    working = {**keys, "inference_s": 0.25, "learning_s": 2.0, "commands_per_gradient_step": 4}
    assert model_real_time(tiny_config(state, **working))["command_s"] == pytest.approx(blind + 0.25 + 0.5)
    on_policy = {**working, "algorithm": "ppo", "options": {}}
    assert model_real_time(tiny_config(state, **on_policy))["command_s"] == pytest.approx(blind + 0.25)


def test_real_time_is_modelled_with_the_trainings_flight_and_senses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty commands straight ahead in an empty lane; all else is AirSim's: its profile, ClockSpeed and latencies."""
    made: list[Any] = []

    class Lane:
        def __init__(self, **keys: Any) -> None:
            self.task, self.commands = LaneTask(**keys), 0
            made.append(keys)

        def reset(self, seed: int) -> Any:
            return None, self._info()

        def charge(self, seconds: float, phase: str) -> None:
            made.append((phase, seconds))

        def step(self, action: int) -> Any:
            made.append(action)
            self.commands += 1
            return None, 0.0, False, False, self._info()

        def _info(self) -> dict[str, Any]:
            return {"commands": self.commands, "wall_s": 1.0 + 3.0 * self.commands}

        def close(self) -> None:
            made.append("closed")

    monkeypatch.setattr(real_time, "ObstacleLane", Lane)
    trained: dict[str, Any] = {
        "command": "adsc", "observation": "depth", "history": 2, "image_processing_s": 0.01, "t_move_s": 0.8,
        "t_sample_s": 0.2, "speed_m_s": 1.5, "headings_deg": [-40.0, -20.0, 5.0, 30.0], "altitude_m": 3.0,
    }  # fmt: skip
    elsewhere = {
        "clock_speed": 50.0,
        "timing": "lockstep",
        "profile": "native",
        "difficulty": {"wind_m_s": 3.0},
    }
    config = tiny_config(trained | elsewhere, mirror=False, inference_s=0.25, learning_s=2.0)
    assert model_real_time(config)["command_s"] == 61.0 / 20
    modelled = {"timing": "virtual", "profile": "airsim", "clock_speed": 1.0, "lane": {"obstacles": []}}
    assert made[0] == trained | modelled
    assert made[1:] == [*[("inference", 0.25), ("learning", 2.0 / 4), 2] * 20, "closed"]


@pytest.mark.parametrize("learned", [2, 3])
def test_weights_and_real_time_are_those_of_a_training_that_is_over(learned: int, tmp_path: Path) -> None:
    """The policy of a checkpoint is not that of its last game."""
    run = RunDirectory.create(tmp_path / "run", tiny_config({"observation": "state"}, mirror=False), {})
    for number in range(3):
        row = {"is_success": number == 1, "commands": 7, "sim_time_s": 7.0, "phase_s": phases(1, 0, 0, 0, 0)}
        run.append_row({"case": f"game-{number}", "suite": "train", **row})
    trained = {"games": learned, "weights_sha256": "0123456789abcdef"}
    run.write_json("policy.json", {"trained": trained})
    run.write_json("real_time.json", {"command_s": 60.0, "how": "by hand"})
    report = TrainingReport(run, "train")
    won = "1 of 3 training games succeeded, "
    if learned == 3:
        assert report.headline() == f"{won}weights 0123456789ab; in real time 21 min (modelled)"
        assert report.summary["weights_sha256"] == "0123456789abcdef"
    else:
        assert report.headline() == f"{won}the training is not over"
        assert report.summary["weights_sha256"] is None


def test_evaluations_of_a_training_are_summarised_line_by_line() -> None:
    lines: Any = [
        {"games": 40, "successes": 1, "lanes": [7, 8, 9], "distance_m": [150.0, 10.0, 20.0]},
        {"games": 90, "successes": 2, "lanes": [7, 8], "distance_m": [150.0, 151.0]},
    ]
    keys = ("games", "lanes", "successes", "success_ratio", "distance_m_median")
    found = [[each[key] for key in keys] for each in summarise_evaluations(lines)]
    assert found == [[40, 3, 1, 1 / 3, 20.0], [90, 2, 2, 1.0, 150.5]]


def test_a_training_tells_its_latest_success_and_what_its_evaluations_will_take() -> None:
    suite, won = Training(), [*[True] * 150, *[False] * 75, *[True] * 25]
    rows: list[Any] = [{"is_success": each} for each in won]
    assert suite.status(rows) == "success of the last 100: 25%"
    assert suite.status(rows[148:152]) == "success of the last 4: 50%"

    def seconds(every: int, lanes: int) -> float:
        config = tiny_config(
            {"observation": "state"}, mirror=False, evaluate_every_games=every, evaluation_games=lanes
        )
        return suite.cost(config, next(iter(suite.cases(config)))).wall_s

    alone = seconds(0, 10)
    of_a_game = seconds(10, 10) - alone  # ten lanes after ten games: one more for each
    assert 0 < of_a_game < alone
    for every, lanes, more in ((5, 10, 2.0), (20, 10, 0.5), (10, 30, 3.0)):
        assert seconds(every, lanes) - alone == pytest.approx(more * of_a_game)


@needs_opengl
def test_real_time_has_the_pictures_latencies() -> None:
    keys = {"mirror": False, "inference_s": 0.0, "learning_s": 0.0}
    seen, blind = (
        model_real_time(tiny_config({"observation": kind}, **keys))["command_s"] for kind in ("dvs", "state")
    )
    frame_s = shipped_latency("airsim").platform.frame_ns() / 1e9
    # Three pictures and DVS per command; a picture waits for up to two frames, one on average.
    assert 3 * 0.5 * frame_s < seen - blind < 3 * 2 * frame_s


def phases(*seconds: float) -> dict[str, float]:
    return dict(zip(PHASES, seconds, strict=True))


def training(
    path: Path, timing: str, timings: list[Row] | None = None, environments: int = 2
) -> RunDirectory:
    task = {"command": "adsc", "clock_speed": 100.0, "timing": timing}
    rows = [
        {"sim_time_s": 60.0, "phase_s": phases(1.0, 2.0, 3.0, 4.0, 5.0)},
        {"sim_time_s": 40.0, "phase_s": phases(0.1, 0.2, 0.3, 0.4, 0.5)},
    ]
    return run_of(path, Flown(seed=6, task=task, environments=environments), rows, timings)


def timing_entry(wall_s: float, host: dict[str, float], learner: dict[str, float]) -> Row:
    return {"wall_s": wall_s, "host_phase_s": host, "learner_s": learner}


TIMINGS = [
    timing_entry(10.0, phases(1, 2, 3, 0, 0), phases(0, 0, 0, 0.5, 2.0)),
    timing_entry(20.0, phases(1, 2, 3, 0, 0), phases(0, 0, 0, 1.0, 4.0)),  # the learner's watch runs on
    timing_entry(7.0, phases(0.5, 0, 0, 0, 0), phases(0, 0, 0, 0.25, 1.0)),  # resumed: it began anew
]


def test_a_modelled_training_has_the_times_of_its_own_clock(tmp_path: Path) -> None:
    times = phase_times(training(tmp_path / "run", "virtual", TIMINGS))
    assert times.phase_s == pytest.approx(phases(1.1, 2.2, 3.3, 4.4, 5.5))
    assert times.simulated_s_per_wall_s == pytest.approx(100.0 / (16.5 / 2))  # two lanes side by side
    assert times.label == "ADSC 100x\nvirtual, seed 6"


def test_any_other_training_has_the_times_of_the_machine(tmp_path: Path) -> None:
    for timing in ("lockstep", "wall"):
        times = phase_times(training(tmp_path / timing, timing, TIMINGS))
        assert times.phase_s == pytest.approx(phases(2.5, 4.0, 6.0, 1.25, 5.0))
        assert times.simulated_s_per_wall_s == pytest.approx(100.0 / 27.0)
        assert times.label == f"ADSC 100x\n{timing}, seed 6"


def curve_of(path: Path, won: list[bool], walls_s: list[float]) -> RunDirectory:
    config = Flown(seed=6, task={})
    timings: list[Row] = [{"wall_s": wall_s} for wall_s in walls_s]
    return run_of(path, config, [{"is_success": each} for each in won], timings)


def test_progress_shows_each_game_and_the_mean_of_the_last_100(
    tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    rows: list[Any] = [
        {
            "return": float(n),
            "commands": 2 * n,
            "exploration": 1 - n / 200,
            "mean_q": 3.0 * n,
            "loss": None if n < 10 else 1.0 / n,
        }
        for n in range(150)
    ]
    plot_progress(rows, tmp_path / "progress.png", "modelled")
    returns, lengths, losses, mean_q, explored = drawn["progress"].axes
    assert points(labelled(returns)["a game"])[-1] == (150.0, 149.0)
    mean = points(labelled(returns)["mean of the last 100"])
    assert (mean[0], mean[9], mean[-1]) == ((1.0, 0.0), (10.0, 4.5), (150.0, 99.5))
    assert points(labelled(lengths)["mean of the last 100"])[-1] == (150.0, 199.0)
    assert points(labelled(losses)["mean of the last 100"])[0] == (11.0, 0.1)  # after the first step
    assert points(labelled(mean_q)["a game"])[-1] == (150.0, 447.0)
    assert np.asarray(explored.lines[0].get_ydata())[-1] == 1 - 149 / 200
    ppo: list[Any] = [{**row, "exploration": None, "mean_q": None} for row in rows]
    for row in ppo[:5]:
        del row["loss"]  # as in the rows of earlier versions
    plot_progress(ppo, tmp_path / "progress.png", "modelled")
    shown = [axes.get_ylabel() for axes in drawn["progress"].axes]
    assert shown == ["return", "length, commands", "loss"]


def test_a_moving_mean_has_a_value_for_every_game() -> None:
    assert recent_mean([1.0, 3.0, 5.0]).tolist() == [1.0, 2.0, 3.0]


def test_learning_curves_are_over_the_wall_clock_of_all_starts(
    tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    short = curve_of(tmp_path / "short", [False, True, True, True], [10.0, 20.0, 5.0, 6.0])  # begun twice
    won = [game % 3 == 0 for game in range(250)]
    long = curve_of(tmp_path / "long", won, [2.0 * game for game in range(250)])
    plot_over_time([short, long, short], ["mine", "long", "mine"], tmp_path / "curves.png")
    axes = drawn["curves"].axes[0]
    lines = labelled(axes)
    assert list(lines) == ["mine", "long"]  # of one name, one entry
    assert points(lines["mine"]) == [(10.0, 0.0), (20.0, 0.5), (25.0, round(2 / 3, 12)), (26.0, 0.75)]
    recent = [(2.0 * game, sum(won[game - 99 : game + 1]) / 100) for game in range(99, 250)]
    assert points(lines["long"]) == recent  # from the 100th game on
    assert axes.get_xscale() == "log"
    marks = [np.asarray(line.get_xdata()) for line in axes.lines]
    assert [mark[0] for mark in marks if len(mark) == 2] == []  # the paper's 182 h would squeeze the curves
    assert axes.get_xlim() == (5.0, 2 * 498.0)
    days = curve_of(tmp_path / "days", won, [200.0 * game for game in range(250)])
    plot_over_time([days], ["days"], tmp_path / "curves.png")
    marks = [np.asarray(line.get_xdata()) for line in drawn["curves"].axes[0].lines]
    assert [mark[0] for mark in marks if len(mark) == 2] == [182 * 3600.0]
    with pytest.raises(UserError, match="is no training with a wall time"):
        plot_over_time([curve_of(tmp_path / "none", [True], [])], ["none"], tmp_path / "curves.png")


def test_evaluations_stand_on_both_learning_curves_with_their_intervals(
    tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    def evaluated_seed(number: int, successes: list[int]) -> RunDirectory:
        task = {"command": "tcsc", "clock_speed": 1.0, "timing": "lockstep"}
        rows: list[Row] = [{"is_success": True}] * 8
        timings: list[Row] = [{"wall_s": 10.0 * (game + 1)} for game in range(8)]
        run = run_of(tmp_path / f"seed{number}", Flown(seed=number, task=task), rows, timings)
        for games, won in zip((4, 8), successes, strict=True):
            line = {"games": games, "successes": won, "lanes": [0, 1, 2, 3]}
            append_line(run.path / "evaluations.jsonl", line)
        return run

    first, second = evaluated_seed(0, [0, 2]), evaluated_seed(1, [2, 4])
    plot_over_games([first], tmp_path / "games.png")
    plot_over_time([first], ["first"], tmp_path / "time.png")
    plot_over_games([first, second], tmp_path / "both.png")
    for name, at in (("games", (4.0, 8.0)), ("time", (40.0, 80.0))):
        axes = drawn[name].axes[0]
        (bars,) = (each for each in axes.containers if isinstance(each, ErrorbarContainer))
        assert points(bars.lines[0]) == [(at[0], 0.0), (at[1], 0.5)]
        low, high = np.array(bars.lines[2][0].get_segments())[:, :, 1].T
        np.testing.assert_allclose(low, [0.0, 0.150036], atol=1e-5)  # Wilson's, of 0 and 2 in 4
        np.testing.assert_allclose(high, [0.489896, 0.849964], atol=1e-5)
    axes = drawn["both"].axes[0]
    mean = labelled(axes)["evaluated on 4 lanes: mean, least and most of 2 seeds"]
    assert points(mean) == [(4.0, 0.25), (8.0, 0.75)]
    corners = {tuple(each) for each in np.asarray(axes.collections[-1].get_paths()[0].vertices).tolist()}
    assert corners == {(4.0, 0.0), (4.0, 0.5), (8.0, 0.5), (8.0, 1.0)}


def test_seeds_of_one_training_are_a_line_in_a_band(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    def seed(name: str, number: int, won: list[bool], clock: float = 1.0) -> RunDirectory:
        task = {"command": "tcsc", "clock_speed": clock, "timing": "lockstep"}
        return run_of(tmp_path / name, Flown(seed=number, task=task), [{"is_success": each} for each in won])

    runs = [
        seed("one", 0, [True, True, False, False]),
        seed("two", 1, [False, True, True]),
        seed("other", 0, [True], clock=5.0),
    ]
    plot_over_games(runs, tmp_path / "learning_games.png")
    (axes,) = drawn["learning_games"].axes
    lines = labelled(axes)
    assert list(lines) == ["TCSC 1x, one and 1 more seeds", "TCSC 5x, other"]
    shares = [(1.0, 0.0), (1.0, 0.5), (2 / 3, 2 / 3)]  # of either seed, as far as both got
    assert points(lines["TCSC 1x, one and 1 more seeds"]) == [
        (game, round((a + b) / 2, 12)) for game, (a, b) in enumerate(shares, start=1)
    ]
    (band,) = axes.collections
    corners = {(x, round(y, 12)) for x, y in np.asarray(band.get_paths()[0].vertices).tolist()}
    ends = {(game, round(end, 12)) for game, pair in enumerate(shares, start=1) for end in pair}
    assert corners == ends
    assert headline(drawn["learning_games"])[1] == "modelled · seed 0, 1"


def test_seeds_are_averaged_where_all_of_them_have_a_value(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """A training of 100 games has a share from its first one on, a longer one from its 100th."""
    task = {"command": "tcsc", "clock_speed": 1.0, "timing": "lockstep"}
    runs = [
        run_of(tmp_path / name, Flown(seed=number, task=task), [{"is_success": each} for each in won])
        for number, (name, won) in enumerate(
            {"short": [True] * 100, "long": [False] * 75 + [True] * 25 + [False] * 4}.items()
        )
    ]
    plot_over_games(runs, tmp_path / "learning_games.png")
    (line,) = labelled(drawn["learning_games"].axes[0]).values()
    assert points(line) == [(100.0, 0.625)]
    axes = Figure().subplots()
    seeds = [
        Evaluated([4.0, 8.0], [Proportion(0, 4), Proportion(4, 4)]),
        Evaluated([6.0, 10.0], [Proportion(2, 4), Proportion(4, 4)]),
    ]
    plot_evaluated(axes, seeds, "black")
    assert points(axes.lines[0]) == [(6.0, 0.5), (8.0, 0.875)]
    band = {tuple(each) for each in np.asarray(axes.collections[0].get_paths()[0].vertices).tolist()}
    assert band == {(6.0, 0.5), (8.0, 0.75), (8.0, 1.0)}
    for line_of in (3, 4, 5):
        append_line(runs[0].path / "evaluations.jsonl", {"games": line_of, "successes": 1, "lanes": [0, 1]})
    found = evaluated(runs[0], np.array([10.0, 20.0, 30.0, 40.0]))
    assert found is not None
    assert (found.at, found.ratio.tolist()) == ([30.0, 40.0], [0.5, 0.5]), "no later than the games"


def test_figure_9_tells_trainings_apart_and_says_what_was_measured(
    tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    runs = [
        training(tmp_path / "one", "virtual"),
        training(tmp_path / "two", "wall", TIMINGS),
        training(tmp_path / "three", "virtual", environments=1),
    ]
    path = tmp_path / "figure9_phases.png"
    assert plot_trainings(runs, path).path == path
    axes, speed = drawn["figure9_phases"].axes
    modelled = "ADSC 100x\nvirtual, seed 6"
    assert tick_texts(axes.xaxis) == [
        f"{modelled}\n{tmp_path / 'one'}",
        "ADSC 100x\nwall, seed 6",
        f"{modelled}\n{tmp_path / 'three'}",
    ]
    bars = {name: [bar.get_height() for bar in bars] for name, bars in labelled(axes).items()}
    assert list(bars) == [phase.replace("_", " ") for phase in PHASES]
    assert bars["simulation"] == pytest.approx([1.1, 2.5, 1.1])
    assert bars["learning"] == pytest.approx([5.5, 5.0, 5.5])
    places, speeds = zip(*points(labelled(speed)["speed (right)"]), strict=True)
    assert places == (0, 1, 2)
    assert speeds == pytest.approx((100 / 8.25, 100 / 27, 100 / 16.5))
    mixed = "measured, learning beside the flight and modelled · 2 games · seed 6"
    assert headline(drawn["figure9_phases"])[1] == mixed
    for run, provenance in ((runs[0], "modelled ·"), (runs[1], "measured, learning beside the flight ·")):
        plot_trainings([run], tmp_path / "figure9_phases.png")
        assert headline(drawn["figure9_phases"])[1].startswith(provenance)
        assert "one" not in tick_texts(drawn["figure9_phases"].axes[0].xaxis)[0]


def test_curves_of_games_count_from_this_start_and_leave_out_evaluations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Success of the last 100, an earlier start's among them; simulated over wall time of this start's."""
    # It is made; a game ends; an evaluation is flown from 110 to 115 s; another game ends.
    now_s = iter([100.0, 104.0, 110.0, 115.0, 120.0])
    clock = SimpleNamespace(now_ns=lambda: int(next(now_s) * NS_PER_S))
    monkeypatch.setattr(training_rows, "MonotonicClock", lambda: clock)
    drawn: list[tuple[int, dict[str, float]]] = []
    monkeypatch.setattr(training_rows.CurvesFile, "add", lambda _, *point: drawn.append(point))
    won = [*[False] * 50, *[True] * 3, *[False] * 90, *[True] * 7]  # of the last 100 ten
    earlier: Any = [{"is_success": each} for each in won]
    rows = training_rows.GameRows(tiny_config({"t_move_s": 0.5}), tmp_path, earlier)
    stopwatch: Any = SimpleNamespace(spent_s=dict)
    info: dict[str, Any] = {
        "is_success": False, "distance_m": 7.0, "collision": None, "lane": 3, "commands": 16,
        "phase_s": {}, "host_phase_s": {},
    }  # fmt: skip
    first = rows.finished(Game(40, 1, info, -2.5, 0.25), stopwatch)
    with rows.clock_stopped():
        pass
    rows.finished(Game(41, 0, info, 1.0, None, 0.5, 2.0), stopwatch)
    rows.close()
    point = {
        "games/distance_m": 7.0, "games/return": -2.5, "games/commands": 16, "games/real_time_factor": 8.0 / 4.0,
    }  # fmt: skip
    assert drawn == [
        (41, {"games/success_recent": 0.09, "games/exploration": 0.25, **point}),
        (
            42,
            {
                **point,
                "games/success_recent": 0.08,
                "games/return": 1.0,
                "games/loss": 0.5,
                "games/mean_q": 2.0,
                "games/real_time_factor": 16.0 / 15.0,
            },
        ),
    ]
    assert first.row["sim_time_s"] == 8.0
    assert first.host["wall_s"] == 4.0


@pytest.mark.parametrize(
    ("longest_s", "unit", "height"),
    [(7_200.0, "hours", 2.0), (3_599.0, "minutes", 3_599 / 60), (30.0, "seconds", 30.0)],
)
def test_figure_9_has_the_largest_unit_that_is_no_fraction(
    longest_s: float, unit: str, height: float
) -> None:
    spent = [{"simulation": longest_s / 2, "learning": longest_s / 2}, {"simulation": 1.0, "learning": 0.0}]
    assert unit_of(spent) == unit
    axes = Figure().subplots()
    plot_stacked(axes, spent, unit)
    tops = [bar.get_y() + bar.get_height() for bars in axes.containers for bar in bars]
    assert max(tops) == pytest.approx(height)
