"""Summaries of trainings, and their figures: whose numbers a line or bar shows, and where they are from."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.drawing import headline, labelled, legend_texts, points, record_figures, texts, tick_texts
from tests.learning import tiny_config, train_into
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.files import append_line
from uavaccel.records import RunDirectory
from uavaccel.rl.learner import Game
from uavaccel.suites import trainer
from uavaccel.suites.report import Report
from uavaccel.suites.train import Training, curves_figure, game_case
from uavaccel.suites.trainer import model_real_time
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import shipped_latency

Row = Any
STATE = {"observation": "state"}


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    return record_figures(monkeypatch)


def phases(*seconds: float) -> dict[str, float]:
    return dict(zip(PHASES, seconds, strict=True))


def game(number: int, row: Row) -> Row:
    """What the row of a lane's game has in every suite, by default of seven commands without a collision."""
    usual: Row = {"is_success": False, "collision": None, "lane": number, "commands": 7, "sim_time_s": 7.0}
    usual |= {"phase_s": phases(1, 0, 0, 0, 0), "distance_m": 150.0 if row.get("is_success") else 7.0}
    return usual | row


# --- trainings ----------------------------------------------------------------------------------------------


def trained(
    path: Path, rows: Sequence[Row], timings: Sequence[Row] = (), evaluations: Sequence[Row] = (), **keys: Any
) -> Report:
    """The report of a training of these rows; `keys` are of the task if they are not of the training."""
    task = {key: keys.pop(key) for key in list(keys) if key in LaneTask.model_fields}
    config = tiny_config(STATE | task, mirror=False, **keys)
    run = RunDirectory.create(path, config, {})
    unknown = dict.fromkeys(("exploration", "loss", "mean_q"))
    for number, row in enumerate(rows):
        usual = {"suite": "train", "case": game_case(number), "game": number, "environment": 0, "return": 0.0}
        run.append_row(usual | unknown | game(number, row))
    usual = {"host_phase_s": phases(1, 0, 0, 0, 0), "learner_s": phases(0, 0, 0, 0, 1)}
    for entry in timings:
        run.append_timing(usual | entry)
    for line in evaluations:
        won_lanes = [number < line["successes"] for number in range(len(line["lanes"]))]
        usual = {"weights_sha256": "f00", "is_success": won_lanes, "distance_m": [1.0] * len(won_lanes)}
        append_line(run.path / "evaluations.jsonl", usual | line)
    return Training().report(run)


def won(*games: bool) -> list[Row]:
    return [{"is_success": each} for each in games]


def walls(*walls_s: float) -> list[Row]:
    return [{"wall_s": wall_s} for wall_s in walls_s]


def page(report: Report) -> list[Any]:
    return list(Training().page(report))


def test_every_number_of_a_training(tmp_path: Path) -> None:
    task = {**STATE, "timing": "virtual", "command": "adsc", "clock_speed": 20.0, "max_commands": 5}
    summary = train_into(tmp_path / "run", tiny_config(task, mirror=False, seed=9, games=3))
    run = RunDirectory(tmp_path / "run")
    assert summary == run.read_json("summary.json")
    assert len(summary.pop("weights_sha256")) == 64
    commands = sum(row["commands"] for row in run.rows())
    assert 1.0 < summary.pop("modelled_real_time_s") / commands < 1.1  # of 1 s each
    assert summary.pop("modelled_real_time_how").startswith("ADSC under the profile airsim at ClockSpeed 1 ")
    phase_s = {phase: pytest.approx(sum(row["phase_s"][phase] for row in run.rows())) for phase in PHASES}
    assert summary == {
        "suite": "train", "profile": "native", "command": "adsc", "clock_speed": 20.0, "timing": "virtual", "seed": 9,
        "games": 3, "successes": 0,  # nobody gets 150 m far in five commands
        "commands": commands, "sim_time_s": float(commands), "phase_s": phase_s,
    }  # fmt: skip
    assert summary["phase_s"]["simulation"] > summary["phase_s"]["learning"] > 0


def test_real_time_has_flight_pictures_decisions_and_learning() -> None:
    """While a TCSC's client decides and learns nothing flies, so that these add up exactly."""
    state = {**STATE, "clock_speed": 50.0}  # as it was trained is not how it is modelled
    keys = {"mirror": False, "inference_s": 0.0, "learning_s": 0.0}
    blind, seen = (model_real_time(tiny_config(task, **keys))["command_s"] for task in (state, {"observation": "dvs"}))
    assert 1.0 < blind < 1.05
    # Three pictures and DVS per command; a picture waits for up to two frames, one on average.
    frame_s = shipped_latency("airsim").platform.frame_ns() / 1e9
    assert 3 * 0.5 * frame_s < seen - blind < 3 * 2 * frame_s
    working = {**keys, "inference_s": 0.25, "learning_s": 2.0, "commands_per_gradient_step": 4}
    assert model_real_time(tiny_config(state, **working))["command_s"] == pytest.approx(blind + 0.25 + 0.5)
    on_policy = {**working, "algorithm": "sb3_ppo", "options": {}}
    assert model_real_time(tiny_config(state, **on_policy))["command_s"] == pytest.approx(blind + 0.25)


def test_real_time_is_modelled_with_the_trainings_flight_and_senses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty commands straight ahead in an empty lane; all else is AirSim's: its profile, ClockSpeed and latencies."""
    made: list[Any] = []

    class Lane:
        def __init__(self, **keys: Any) -> None:
            self.task, self.commands = LaneTask(**keys), 0
            self.charge = lambda seconds, phase: made.append((phase, seconds))
            self.close = lambda: made.append("closed")
            made.append(keys)

        def reset(self, seed: int) -> Any:
            return None, {"commands": 0}

        def step(self, action: int) -> Any:
            made.append(action)
            self.commands += 1
            return None, 0.0, False, False, {"commands": self.commands, "wall_s": 1.0 + 3.0 * self.commands}

    monkeypatch.setattr(trainer, "ObstacleLane", Lane)
    own: dict[str, Any] = {
        "command": "adsc", "observation": "depth", "history": 2, "image_processing_s": 0.01, "t_move_s": 0.8,
        "t_sample_s": 0.2, "speed_m_s": 1.5, "headings_deg": [-40.0, -20.0, 5.0, 30.0], "altitude_m": 3.0,
    }  # fmt: skip
    elsewhere = {"clock_speed": 50.0, "timing": "lockstep", "profile": "native", "difficulty": {"wind_m_s": 3.0}}
    config = tiny_config(own | elsewhere, mirror=False, inference_s=0.25, learning_s=2.0)
    assert model_real_time(config)["command_s"] == 61.0 / 20
    assert made[0] == own | {"timing": "virtual", "profile": "airsim", "clock_speed": 1.0, "lane": {"obstacles": []}}
    assert made[1:] == [*[("inference", 0.25), ("learning", 2.0 / 4), 2] * 20, "closed"]


@pytest.mark.parametrize("learned", [2, 3])
def test_weights_and_real_time_are_those_of_a_training_that_is_over(
    learned: int, tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """The policy of a checkpoint is not that of its last game."""
    report = trained(tmp_path / "run", won(False, True, False), walls(1, 2, 1200))
    report.run.write_json("policy.json", {"trained": {"games": learned, "weights_sha256": "0123456789abcdef"}})
    report.run.write_json("real_time.json", {"command_s": 60.0, "how": "by hand"})
    games, wall, real = page(report)[0].rows
    said = "he policy won 1 of 3 training games"
    if learned == 3:
        assert report.headline() == f"T{said}; in real time they take 21 min (modelled)"
        assert (report.summary["weights_sha256"], real[1]) == ("0123456789abcdef", "21 min")
    else:
        assert report.headline() == f"Not over yet: t{said}"
        assert (report.summary["weights_sha256"], real[1]) == (None, "-")
    assert (games[1:3], wall[1:3], real[2]) == (("3", "5000"), ("20 min", "-"), "182.0 h")


def test_a_training_tells_its_latest_success_and_its_disturbed_games(tmp_path: Path) -> None:
    rows = won(*[True] * 150, *[False] * 75, *[True] * 25)
    assert Training().status(rows) == "success of the last 100: 25%"
    assert Training().status(rows[148:152]) == "success of the last 4: 50%"
    report = trained(tmp_path / "run", [{"disturbed": True}, {}], timing="wall")
    assert report.summary["disturbed_games"] == 1
    assert report.pace() == ""


def test_evaluations_of_a_training_are_summarised_line_by_line(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    lines = [
        {"games": 40, "successes": 1, "lanes": [7, 8, 9], "distance_m": [150.0, 10.0, 20.0]},
        {"games": 90, "successes": 2, "lanes": [7, 8], "distance_m": [150.0, 151.0]},
    ]
    report = trained(tmp_path / "run", won(False), evaluations=lines, timing="virtual")
    keys = ("games", "lanes", "successes", "success_ratio", "distance_m_median")
    found = [[each[key] for key in keys] for each in report.summary["evaluations"]]
    assert found == [[40, 3, 1, 1 / 3, 20.0], [90, 2, 2, 1.0, 150.5]]
    table = page(report)[3]
    assert table.rows == [("40", "33.3% [6, 79]", "3", "20.0"), ("90", "100.0% [34, 100]", "2", "150.5")]


def test_progress_shows_each_game_and_the_mean_of_the_last_100(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows: list[Any] = [
        {"return": float(n), "commands": 2 * n, "exploration": 1 - n / 200, "mean_q": 3.0 * n, "loss": n and 1.0 / n}
        for n in range(150)
    ]
    rows[:10] = [row | {"loss": None} for row in rows[:10]]
    page(trained(tmp_path / "dqn", rows, timing="virtual"))
    returns, lengths, losses, mean_q, explored = drawn["progress"].axes
    mean = points(labelled(returns)["mean of the last 100"])
    assert (mean[0], mean[9], mean[-1]) == ((1.0, 0.0), (10.0, 4.5), (150.0, 99.5))
    assert points(labelled(returns)["a game"])[-1] == (150.0, 149.0)
    assert points(labelled(lengths)["mean of the last 100"])[-1] == (150.0, 199.0)
    assert points(labelled(losses)["mean of the last 100"])[0] == (11.0, 0.1)  # after the first step
    assert points(labelled(mean_q)["a game"])[-1] == (150.0, 447.0)
    assert points(explored.lines[0])[-1] == (150.0, 1 - 149 / 200)
    ppo = [{key: value for key, value in row.items() if key not in ("exploration", "mean_q")} for row in rows]
    page(trained(tmp_path / "ppo", ppo, timing="virtual"))
    assert [axes.get_title("left") for axes in drawn["progress"].axes] == ["return", "length, commands", "loss"]


def test_learning_curves_are_over_the_wall_clock_of_all_starts(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    every_third, long_s = [game % 3 == 0 for game in range(250)], [2.0 * game for game in range(250)]
    short = trained(tmp_path / "short", won(False, True, True, True), walls(10, 20, 5, 6))  # begun twice
    hundred = trained(tmp_path / "hundred", won(*[True] * 100), walls(*range(40, 140)))
    long = trained(tmp_path / "long", won(*every_third), walls(*long_s))
    axes, *_ = curves_figure("wall clock", [short, long, hundred, short], ["mine", "long", "hundred", "mine"]).axes
    lines = labelled(axes)
    assert list(lines) == ["mine", "long", "hundred"]  # of one name, one entry
    assert points(lines["mine"]) == [(10.0, 0.0), (20.0, 0.5), (25.0, round(2 / 3, 12)), (26.0, 0.75)]
    recent = [(2.0 * game, sum(every_third[game - 99 : game + 1]) / 100) for game in range(99, 250)]
    assert points(lines["long"]) == recent  # from the 100th game on
    assert points(lines["hundred"])[0] == (40.0, 1.0)
    assert (axes.get_xscale(), axes.get_xlim()) == ("log", (5.0, 2 * 498.0))
    assert [line for line in axes.lines if line.get_linestyle() == "--"] == []  # 182 h would squeeze the curves
    page(trained(tmp_path / "days", won(*every_third), walls(*(100 * each for each in long_s))))
    marks = [line for line in drawn["learning_curve"].axes[0].lines if line.get_linestyle() == "--"]
    assert [np.asarray(mark.get_xdata())[0] for mark in marks] == [182 * 3600.0]
    drawn.clear()
    page(trained(tmp_path / "none", won(True), timing="virtual"))
    assert "learning_curve" not in drawn
    for times in ([], [*walls(1), {}]):
        with pytest.raises(UserError, match=r"timing\.jsonl: lacks the wall time of a game"):
            page(trained(tmp_path / f"lacks{len(times)}", won(True, True), times))


def corners(band: Any) -> set[tuple[float, float]]:
    return {(x, round(y, 12)) for x, y in np.asarray(band.get_paths()[0].vertices).tolist()}


def test_evaluations_stand_on_both_learning_curves_with_their_intervals(
    tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    def seed(number: int, *successes: int) -> RunDirectory:
        lines = [
            {"games": games, "successes": each, "lanes": [0, 1, 2, 3]}
            for games, each in zip((4, 8, 9), (*successes, 4), strict=True)  # no game is the ninth
        ]
        times = walls(*(10.0 * (game + 1) for game in range(8)))
        return trained(tmp_path / f"{number}", won(*[True] * 8), times, lines, seed=number).run

    runs = [seed(0, 0, 2), seed(1, 2, 4)]
    page(Training().report(runs[0]))
    for name, at in (("learning_games", (4.0, 8.0)), ("learning_curve", (40.0, 80.0))):
        (bars,) = (
            container for container in drawn[name].axes[0].containers if isinstance(container, ErrorbarContainer)
        )
        assert points(bars.lines[0]) == [(at[0], 0.0), (at[1], 0.5)]
        low, high = np.array(bars.lines[2][0].get_segments())[:, :, 1].T
        np.testing.assert_allclose(low, [0.0, 0.150036], atol=1e-5)  # Wilson's, of 0 and 2 in 4
        np.testing.assert_allclose(high, [0.489896, 0.849964], atol=1e-5)
    Training().compare(runs)
    axes, *_ = drawn["learning_games_compared"].axes
    mean = labelled(axes)["evaluated on 4 lanes: mean, least and most of 2 seeds"]
    assert points(mean) == [(4.0, 0.25), (8.0, 0.75)]
    assert corners(axes.collections[-1]) == {(4.0, 0.0), (4.0, 0.5), (8.0, 0.5), (8.0, 1.0)}


def test_seeds_of_one_training_are_a_line_in_a_band(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """As far as all got; a training of 100 games has a share from its first one on, a longer one from its 100th."""
    games = {"one": [True, True, False, False], "two": [False, True, True], "other": [True]}
    games |= {"hundred": [True] * 100, "longer": [False] * 75 + [True] * 25 + [False] * 4}
    keys: dict[str, Any] = {"two": {"seed": 1}, "other": {"clock_speed": 5.0}, "longer": {"seed": 7}}
    for name in ("hundred", "longer"):
        keys[name] = {"environments": 2, **keys.get(name, {})}
    reports = {
        name: trained(tmp_path / name, won(*each), walls(*range(1, len(each) + 1)), **keys.get(name, {}))
        for name, each in games.items()
    }
    Training().compare([report.run for report in reports.values()])
    axes, of_return, of_length = drawn["learning_games_compared"].axes
    first, other, ends = labelled(axes).items()
    assert [first[0], other[0], ends[0]] == [
        "TCSC 1x, one and 1 more seeds: mean, least and most", "TCSC 5x, other",
        "TCSC 1x, hundred and 1 more seeds: mean, least and most",
    ]  # fmt: skip
    shares = [(1.0, 0.0), (1.0, 0.5), (2 / 3, 2 / 3)]  # of either seed
    assert points(first[1]) == [(game, round((a + b) / 2, 12)) for game, (a, b) in enumerate(shares, start=1)]
    assert points(ends[1]) == [(100.0, 0.625)]
    band = {(float(game), round(end, 12)) for game, pair in enumerate(shares, start=1) for end in pair}
    assert corners(axes.collections[0]) == band
    assert headline(drawn["learning_games_compared"])[1] == "modelled · seed 0, 1, 7"
    assert (of_return.get_ylabel(), of_length.get_ylabel()) == ("return, mean of 100", "length, mean of 100")
    assert [points(line) for line in of_length.lines] == [[(n, 7.0) for n in (1, 2, 3)], [(1.0, 7.0)], [(100.0, 7.0)]]


def test_curves_of_seeds_that_share_no_moment_are_drawn_to_the_last_ones_end(tmp_path: Path) -> None:
    """A training that compiles begins, by its own clock, when another has ended."""
    quick = trained(tmp_path / "quick", won(False, True), walls(1, 2))
    late = trained(tmp_path / "late", won(True, True), walls(10, 12))
    axes, *_ = curves_figure("wall clock", [quick, late], ["both", "both"]).axes
    assert points(axes.lines[0]) == [(1.0, 0.5), (2.0, 0.75), (10.0, 0.75), (12.0, 0.75)]


TIMINGS = [
    {"wall_s": 10.0, "host_phase_s": phases(1, 2, 3, 0, 0), "learner_s": phases(0, 0, 0, 0.5, 2.0)},
    {"wall_s": 20.0, "host_phase_s": phases(1, 2, 3, 0, 0), "learner_s": phases(0, 0, 0, 1.0, 4.0)},  # runs on
    {"wall_s": 7.0, "host_phase_s": phases(0.5, 0, 0, 0, 0), "learner_s": phases(0, 0, 0, 0.25, 1.0)},  # resumed
]


def timed(path: Path, timing: str, longest_s: float = 0.0, **keys: Any) -> Report:
    rows = [
        {"sim_time_s": 60.0, "phase_s": phases(1.0 + longest_s, 2.0, 3.0, 4.0, 5.0)},
        {"sim_time_s": 30.0, "phase_s": phases(0.1, 0.2, 0.3, 0.4, 0.5)},
        {"sim_time_s": 10.0, "phase_s": phases(0, 0, 0, 0, 0)},
    ]
    return trained(path, rows, TIMINGS, command="adsc", clock_speed=100.0, timing=timing, seed=6, **keys)


def test_figure_9_tells_trainings_apart_and_says_what_was_measured(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """A modelled training has the times of its own clock, two lanes side by side, any other those of the machine."""
    timings = ("virtual", "wall", "virtual", "lockstep")
    reports = [timed(tmp_path / f"{n}", timing, environments=1 if n else 2) for n, timing in enumerate(timings)]
    Training().compare([report.run for report in reports])
    figure: Any = drawn["figure9_phases_compared"]
    (axes,) = figure.axes
    labels = [f"ADSC 100x\n{timing}, seed 6" for timing in timings]
    labels[0], labels[2] = (f"{labels[n]}\n{tmp_path / str(n)}" for n in (0, 2))
    assert tick_texts(axes.yaxis) == labels
    stacks = labelled(axes)
    assert list(stacks) == [phase.replace("_", " ") for phase in PHASES]
    own, machine = [1.1, 2.2, 3.3, 4.4, 5.5], [2.5, 4.0, 6.0, 1.25, 5.0]
    heights, tops = (
        np.transpose([[below * bar.get_x() + bar.get_width() for bar in bars] for bars in stacks.values()])
        for below in (0, 1)
    )
    np.testing.assert_allclose(heights, [own, machine, own, machine])
    np.testing.assert_allclose(tops, np.cumsum([own, machine, own, machine], axis=1))
    assert legend_texts(figure.legends[0]) == list(stacks)
    speeds = [f"{speed:.3g} simulated s\na wall s" for speed in (100 / 8.25, 100 / 27, 100 / 16.5, 100 / 27)]
    assert texts(axes) == speeds
    source = "measured, learning beside the flight and modelled · 3 games · seed 6"
    assert headline(figure) == ("Time of training by phase", source)
    figure.draw_without_rendering()
    extents = [label.get_window_extent() for label in axes.get_yticklabels()]
    assert all(upper.y0 > lower.y1 for upper, lower in pairwise(extents)), "labels touch"
    for report, provenance in ((reports[0], "modelled."), (reports[1], "measured, learning beside the flight.")):
        (caption,) = [block.caption for block in page(report) if getattr(block, "alt", "").startswith("A bar")]
        assert caption == f"Figure 9. Time of the training by phase, {provenance}"


@pytest.mark.parametrize(
    ("longest_s", "unit", "height"), [(7_198.9, "hours", 2.0), (3_582.0, "minutes", 59.71833), (28.9, "seconds", 30.0)]
)
def test_figure_9_has_the_largest_unit_that_is_no_fraction(
    longest_s: float, unit: str, height: float, tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    page(timed(tmp_path / "run", "virtual", longest_s))
    axes = drawn["figure9_phases"].axes[0]
    assert axes.get_xlabel() == unit
    assert labelled(axes)["simulation"][0].get_width() == pytest.approx(height, abs=1e-5)


def test_curves_of_games_count_from_this_start_and_leave_out_evaluations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Success of the last 100, an earlier start's among them; simulated over wall time of this start's.

    They are what TensorBoard reads.
    """
    # It is made; a game ends; an evaluation is flown from 110 to 115 s; another game ends.
    now_s = iter([100.0, 104.0, 110.0, 115.0, 120.0])
    monkeypatch.setattr(trainer, "MonotonicClock", lambda: SimpleNamespace(now_ns=lambda: int(next(now_s) * NS_PER_S)))
    earlier = won(*[False] * 50, *[True] * 3, *[False] * 90, *[True] * 7)  # of the last 100 ten
    rows = trainer.GameRows(tiny_config({"t_move_s": 0.5}), tmp_path, earlier)
    stopwatch: Any = SimpleNamespace(spent_s=dict)
    info: dict[str, Any] = {
        "is_success": False, "distance_m": 7.0, "collision": None, "lane": 3, "commands": 16,
        "phase_s": {}, "host_phase_s": {},
    }  # fmt: skip
    (first,) = rows.finished([Game(40, 1, info, -2.5, 0.25)], stopwatch)
    with rows.clock_stopped():
        pass
    rows.finished([Game(41, 0, info, 1.0, None, 0.5, 2.0)], stopwatch)
    rows.close()
    assert (first.row["sim_time_s"], first.host["wall_s"]) == (8.0, 4.0)
    read = EventAccumulator(str(tmp_path / "tensorboard"))
    read.Reload()
    drawn = {name: [(scalar.step, scalar.value) for scalar in read.Scalars(name)] for name in read.Tags()["scalars"]}
    expected = {
        "success_recent": [(41, 0.09), (42, 0.08)],
        "distance_m": [(41, 7.0), (42, 7.0)],
        "return": [(41, -2.5), (42, 1.0)],
        "commands": [(41, 16.0), (42, 16.0)],
        "exploration": [(41, 0.25)],
        "loss": [(42, 0.5)],
        "mean_q": [(42, 2.0)],
        "real_time_factor": [(41, 8.0 / 4.0), (42, 16.0 / 15.0)],
    }
    assert {name.removeprefix("games/"): each for name, each in drawn.items()} == {
        name: [(step, pytest.approx(value)) for step, value in each] for name, each in expected.items()
    }
