"""Reports from rows and arrays: page, summary.json and figures of made-up runs are those that were read and recorded.

The numbers in a recording were held against the same formulas written out by hand before it was kept, and what differs
in a change of it is to be read again.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests import made_runs as made
from tests.drawing import record_figures
from tests.golden import assert_as_recorded, figures_text, plain, report_text
from tests.learning import tiny_config
from tests.made_runs import (
    SIZE,
    Row,
    active,
    dp2_game,
    ended_at,
    line_row,
    phases,
    run_of,
    thinking_row,
    walls,
    won,
    yaw,
)
from tests.running import configured
from uavaccel.cli.experiments import report_run
from uavaccel.config import validate
from uavaccel.draw import style
from uavaccel.records import RunDirectory
from uavaccel.suites import dp1 as of_dp1
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.grid import Ablation, Robustness, Sweep
from uavaccel.suites.mediation import Mediation
from uavaccel.suites.realtime import Realtime
from uavaccel.suites.report import Report
from uavaccel.suites.seeds import Seeds, SeedsConfig
from uavaccel.suites.train import Training, curves_figure
from uavaccel.wire.latency import LatencyConfig


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Figure]]:
    with style.project_style():
        yield record_figures(monkeypatch)


# --- DP1 ----------------------------------------------------------------------------------------------------------

# Of a failed game no number counts.
CRASHED: Row = {"error": "crashed", "lost_wall_s": 9.0, "wall_s": 99.0}
ALIKE = [line_row("game", "tcsc", 50.0, game, 0.1) for game in range(3)]
SLICE = [
    *("client call continue", "server handle continue", "server run"),
    *("server end", "server pause", "client return continue"),
]
MOVE = ["client call move", "server handle move", *SLICE, *SLICE, "client return move"]
ASKED = ["client call ask", "server handle ask", "client return ask"]


def traced(report: Report, **traces: list[str]) -> Report:
    """With the messages of Figure 4, 0.1 ms apart; a slice is 1 s of simulated time."""
    for command, events in traces.items():
        trace = []
        for place, event in enumerate(events):
            source, _, name = event.partition(" ")
            simulated_s = 7.0 + ("server end" in events[: place + 1])
            trace.append({"source": source, "event": name, "wall_s": 5 + place * 1e-4, "sim_s": simulated_s})
        report.run.write_json(f"traces/{command}.json", trace)
    return report


def dp1_cells(path: Path) -> Report:
    """Two cells, their references, what is to be left out, and other paths whose references are far off."""
    rows = [
        line_row("reference", "adsc", 1.0, i, offset_m, wall_s=wall_s, gaps_s=[0.0, 0.01 * i, 0.0])
        for i, (offset_m, wall_s) in enumerate([(0.0, 4.1), (0.2, 4.3), (0.5, 4.9)])
    ]
    rows += [
        line_row("lockstep", "tcsc", 1.0, 0, 0.6, timing="lockstep"),
        line_row("game", "tcsc", 50.0, 4, 5.0, error="the drone crashed", disturbed=True, timing="wall"),
        line_row("figure2", "tcsc", 50.0, 0, 7.0, timing="wall"),
        line_row("reference", "adsc", 1.0, 0, 30.0, t_move_s=0.5),
        line_row("reference", "adsc", 1.0, 0, 40.0, rounds=2),
        line_row("game", "adsc", 1.0, 0, 50.0, timing="wall"),  # a cell beside the references'
    ]
    gaps_s = [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06], [0.07, 0.08, 0.3], [0.2, 0.21, 0.22]]
    for i in (2, 0, 3, 1):
        keys: Row = {"wall_s": [0.12, 0.09, 0.1, 0.2][i], "lost_wall_s": [0.1, 0.0, 0.25, 0.0][i], "gaps_s": gaps_s[i]}
        keys["real_time_factor"] = [40.0, 48.0, 50.0, 45.0][i]
        rows.append(line_row("game", "tcsc", 50.0, i, [0.1, 0.9, 0.3, 0.35][i], timing="wall", **keys))
    return made.dp1(path, rows)


def accelerated_rows() -> list[Row]:
    """Two T_moves and two numbers of rounds; each path's games lie elsewhere beside its two references."""
    rows = []
    for path, (t_move_s, rounds) in enumerate([(0.5, 1), (0.5, 24), (1.0, 1), (1.0, 24)]):
        keys: dict[str, Any] = {"t_move_s": t_move_s, "rounds": rounds}
        rows += [line_row("reference", "adsc", 1.0, i, 0.0, **keys, wall_s=100.0 + path) for i in (0, 1)]
        for command, clock_speed in (("adsc", 10.0), ("tcsc", 10.0), ("adsc", 100.0)):
            for game in range(3):
                offset_m = 0.01 * (1 + path) * (game + 1) ** 2 * (1 if command == "adsc" else 3)
                wall_s = (100.0 + path) / clock_speed * (1.5 + game / 10)
                timing = "wall" if command == "tcsc" else "virtual"
                row = line_row("game", command, clock_speed, game, offset_m, **keys, wall_s=wall_s, timing=timing)
                rows.append(row)
    return rows


def dp1_accelerated(path: Path) -> Report:
    """With the games of Figure 2, and messages of which a long trace is cut."""
    fast = {"timing": "wall", "velocity_m_s": [9.0, 0.03, 0.0], "gaps_s": [0.01, 0.02, 0.06]}
    rows = [
        line_row("figure2", "adsc", 100.0, 1, 0.0, **fast),
        line_row("figure2", "adsc", 1.0, 0, 0.0, velocity_m_s=[0.5, 0.04, -0.2]),
        line_row("figure2", "adsc", 9.0, 2, 0.0, **CRASHED),
    ]
    return traced(made.dp1(path, rows + accelerated_rows()), tcsc=MOVE, adsc=["server run"] * 53)


def dp1_equal(path: Path) -> Report:
    """One of equal replicas shows them."""
    report = made.dp1(path, [line_row("reference", "adsc", 1.0, 0, 0.0), *ALIKE])
    return traced(report, tcsc=ASKED * 2, adsc=[*SLICE, *SLICE, *ASKED])


def dp1_disturbed(path: Path) -> Report:
    """Games on the machine's clock, one that failed and one that was disturbed."""
    lost_s = (0.25, 0.125, 0.0)
    rows = [line_row("game", "tcsc", 50.0, i, 0.0, timing="wall", lost_wall_s=s) for i, s in enumerate(lost_s)]
    rows[1]["disturbed"], rows[2]["error"] = True, "the drone crashed"
    return traced(made.dp1(path, rows), tcsc=SLICE[3:], adsc=MOVE[:6])


def dp1_failed(path: Path) -> Report:
    """A run whose only game failed has notes in place of figures."""
    return made.dp1(path, [ALIKE[0] | CRASHED])


@pytest.mark.parametrize(
    ("cells", "shown"),
    [
        ([("adsc", 50.0, 1.0, 24), ("adsc", 50.0, 0.5, 4), ("adsc", 90.0, 0.1, 24)], ["24 rounds", "ADSC at 50x"]),
        ([("adsc", 50.0, 1.0, 2), ("adsc", 50.0, 1.0, 1), ("adsc", 50.0, 1.0, 24)], ["2 rounds", "ADSC at 50x"]),
        ([("adsc", 10.0, 1.0, 4), ("adsc", 50.0, 1.0, 4), ("tcsc", 5.0, 1.0, 4), ("tcsc", 2.0, 1.0, 4)],
         ["4 rounds", "ADSC at 50x", "TCSC at 5x"]),
    ],
)  # fmt: skip
def test_figure_3_is_of_the_longest_t_move_and_about_four_rounds(
    cells: list[Any], shown: list[str], tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    rows = [line_row("game", "adsc", 90.0, 0, 0.0, error="crashed")]
    rows += [line_row("game", name, clock, 0, 0.0, t_move_s=t, rounds=rounds) for name, clock, t, rounds in cells]
    of_dp1.trajectory_figure(made.dp1(tmp_path / "run", rows))
    figure: Any = drawn["figure3_trajectories"]
    labels = {str(line.get_label()).partition(",")[0] for line in figure.axes[0].lines}
    assert [figure.get_suptitle(), *sorted(labels)] == [f"Trajectories, {shown[0]}, T_move 1 s", *shown[1:]]


# --- DP2 ----------------------------------------------------------------------------------------------------------

# Shared are the samples 0, 1, 2 and 5, of which the first is the start.
REFERENCE = dp2_game(
    "reference", SAMPLE_INDEX=np.array([0, 1, 2, 4, 5]), ORIENTATION_WXYZ=yaw(0, 0, 0, 0, 10),
    POSITION_M=np.array([[9.0, 9, 9], [1, 0, 0], [2, 0, 0], [4, 0, 0], [5, 0, 0]]),
    IMAGE=np.full((5, *SIZE), 100, np.uint8), DVS_ON=active(0, 3, 3, 8, 4), DVS_OFF=active(0, 1, 4, 8, 2),
)  # fmt: skip
GAME = dp2_game(
    "game", "tcsc", 50.0, timing="wall", guard_retries=4, lost_wall_s=0.25, **made.hit("wall_east"), restarts=1,
    SAMPLE_INDEX=np.array([0, 1, 2, 3, 5]), ORIENTATION_WXYZ=yaw(0, 5, 0, 0, 40),
    POSITION_M=np.array([[0.0, 0, 0], [1, 0.3, 0.4], [2, 0, 0], [3, 0, 0], [5, 1.2, -0.9]]),
    IMAGE=np.full((5, *SIZE), 100, np.uint8), DVS_ON=active(8, 4, 3, 0, 8), DVS_OFF=active(8, 1, 2, 0, 0),
)  # fmt: skip


def dp2_errors(path: Path) -> Report:
    """Images beside those at 1x by metres, degrees and eighths of the pixels; without latency other counts alone."""
    same: Any = {key.upper(): each for key, each in GAME["arrays"].items()}
    calm = dp2_game("lockstep", **same | {"DVS_OFF": REFERENCE["arrays"]["dvs_off"]})
    games = [GAME, calm, REFERENCE, dp2_game("game", "adsc", 9.0, (1, 0.0), (0, 0.0008), lost_wall_s=0.125)]
    games += [dp2_game("game", "adsc", 90.0, (4, 3.0), timing="lockstep"), dp2_game("game", "adsc", 5.0, **CRASHED)]
    games.append(dp2_game("reference", "adsc", 1.0, (0, 0.0), (0, 0.0)))
    return made.dp2(path, games, "perturbation.share=0.1", dvs_preset="noisy", sensor_seed=8)


def dp2_disturbed(path: Path) -> Report:
    """All that a reader can be warned of; nothing to compare with."""
    changes: list[Row] = [CRASHED, {"lost_wall_s": 0.5, "disturbed": True}, {"lost_wall_s": 0.25}]
    games = [dp2_game("game", "tcsc", 5.0 + n, timing="wall", **change) for n, change in enumerate(changes)]
    without = {"latency": LatencyConfig()}
    return made.dp2(path, [*games, dp2_game("game", "adsc")], "perturbation.share=0.1", changes=without)


def dp2_order(path: Path) -> Report:
    """By command and ClockSpeed, each against its own run at 1x, with events that the report counts."""
    rows = [("lockstep", "tcsc", 1.0), ("game", "tcsc", 100.0), ("game", "tcsc", 9.0), ("game", "adsc", 5.0)]
    rows += [("game", "tcsc", 1.0), ("reference", "tcsc", 1.0), ("reference", "adsc", 1.0)]
    return made.dp2(path, [made.uncounted(dp2_game(*row)) for row in rows])


def dp2_clouds(path: Path) -> Report:
    """Figure 7: few and near points lie on those of faster games, one ring stands for the images at 0.

    Measured wall times leave nothing out, whatever the latency model has no channel for.
    """
    clouds: list[Any] = [("adsc", 5.0, (0, 0.0), (1, 0.0), (0, 0.02)), ("adsc", 100.0, (2, 3.0), (3, 4.0))]
    clouds += [("tcsc", 5.0, (0, 0.0)), ("tcsc", 100.0, (0, 0.0), (4, 0.5))]
    games: list[Any] = [("reference", command, 1.0, *[(0, 0.0)] * 3) for command in ("adsc", "tcsc")]
    games += [("game", *cloud) for cloud in clouds]
    return made.dp2(path, [dp2_game(*game, timing="wall") for game in games], changes={"latency": LatencyConfig()})


# --- trainings ----------------------------------------------------------------------------------------------------

HOVER: Row = {"env_id": "uavaccel/Hover-v0", "algorithm": "ppo", "options": {}}


def train_over(path: Path) -> Report:
    """One that is over, with the real time of its commands, and evaluations on the way."""
    lines = [
        {"games": 1, "successes": 1, "lanes": [7, 8, 9], "distance_m": [150.0, 10.0, 20.0]},
        {"games": 3, "successes": 2, "lanes": [7, 8], "distance_m": [150.0, 151.0]},
    ]
    report = made.trained(path, won(False, True, False), walls(1, 2, 1200), lines, timing="virtual")
    report.run.write_json("policy.json", {"trained": {"games": 3, "weights_sha256": "0123456789abcdef"}})
    report.run.write_json("real_time.json", {"command_s": 60.0, "how": "by hand"})
    return report


def train_begun(path: Path) -> Report:
    """The policy of a checkpoint is not that of its last game; wall times of days show the paper's."""
    report = made.trained(path, won(*[n % 3 == 0 for n in range(250)]), walls(*(200.0 * n for n in range(250))))
    report.run.write_json("policy.json", {"trained": {"games": 2, "weights_sha256": "0123456789abcdef"}})
    report.run.write_json("real_time.json", {"command_s": 60.0, "how": "by hand"})
    return report


def train_progress(path: Path) -> Report:
    """Each game, and the mean of the last 100; a loss from the first step on."""
    rows: list[Row] = [
        {"return": float(n), "commands": 2 * n, "exploration": 1 - n / 200, "mean_q": 3.0 * n, "loss": n and 1.0 / n}
        for n in range(150)
    ]
    rows[:10] = [row | {"loss": None, "disturbed": True} for row in rows[:10]]
    return made.trained(path, rows, timing="virtual", environments=2)


def train_ppo(path: Path) -> Report:
    """One in a task that the paper has not, and in whose rows some curves are missing; measured, as its Figure 9 is."""
    spent = {"host_phase_s": phases(1, 2, 3, 0, 0), "learner_s": phases(0, 0, 0, 0.5, 2.0)}
    rows = [{"loss": 0.5, "phase_s": phases(7_199.9, 2, 3, 4, 5)}, {"loss": 0.25}]
    timings, clock = [spent | each for each in walls(10, 20)], {"timing": "wall", "command": "adsc"}
    return made.trained(path, rows, timings, **HOVER, **clock, seed=6)


def test_trainings_are_compared_by_seeds_commands_and_clocks(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """As far as all got; a training of 100 games has a share from its first one on, a longer one from its 100th."""
    games = {"one": [True, True, False, False], "two": [False, True, True], "other": [True]}
    games |= {"hundred": [True] * 100, "longer": [False] * 75 + [True] * 25 + [False] * 4}
    keys: Row = {"two": {"seed": 1}, "other": {"clock_speed": 5.0, "timing": "wall", "command": "adsc"}}
    keys |= {"hundred": {"environments": 2}, "longer": {"environments": 2, "seed": 7}}
    lines = {"one": [(2, 0), (4, 2)], "two": [(2, 2), (4, 4)]}
    runs = []
    for name, each in games.items():
        told = [{"games": n, "successes": won_, "lanes": [0, 1, 2, 3]} for n, won_ in lines.get(name, ())]
        runs.append(
            made.trained(tmp_path / name, won(*each), walls(*range(1, len(each) + 1)), told, **keys.get(name, {})).run
        )
    Training().compare(runs)
    text = "\n".join(figures_text(drawn)).replace(str(tmp_path), "RUNS")
    assert_as_recorded("train_compared", text + "\n")


def test_curves_of_seeds_over_wall_clocks_that_do_not_meet(tmp_path: Path) -> None:
    """Begun twice; a training that compiles begins, by its own clock, when another has ended."""
    begun_twice = made.trained(tmp_path / "short", won(False, True, True, True), walls(10, 20, 5, 6))
    quick = made.trained(tmp_path / "quick", won(False, True), walls(1, 2))
    late = made.trained(tmp_path / "late", won(True, True), walls(10, 12))
    figure = curves_figure("wall clock", [begun_twice, quick, late], ["mine", "both", "both"])
    assert_as_recorded("train_wall_clocks", "\n".join(figures_text({"curves": figure})) + "\n")


# --- evaluations --------------------------------------------------------------------------------------------------

OBSTACLES = [{"x_m": 12.0, "y_m": -2.0, "radius_m": 0.5}, {"x_m": 20.0, "y_m": 3.0, "half_side_m": 0.25}]


def evaluate_exact(path: Path) -> Report:
    """Lost lanes are drawn with the west on top, as a pilot who looks north sees them, turned to the right."""
    rows: list[Row] = [
        {"distance_m": end_m, "collision": thing, "path_m": [[1.0, 0.5], [end_m, -2.0]]}
        for end_m, thing in ((30.0, None), (146.0, "obstacle_3"), (-3.0, "wall_west"))
    ]
    rows = [row | {"wall_s": 0.1 * n} for n, row in enumerate([*rows, *ended_at(150.0)], start=1)]
    rows[3]["disturbed"] = True
    task = {"lane": {"obstacles": OBSTACLES}, "timing": "lockstep", "command": "adsc", "clock_speed": 10.0}
    report = made.evaluated(path, *rows, task=task, seed=4, agent="offset:1")
    for name in ("best.mp4", "best.png", "worst.mp4"):  # the worst lacks its sheet
        report.run.file(f"films/{name}").write_bytes(b"a film")
    return report


def evaluate_kernels(path: Path) -> Report:
    """Survival is the share of games that got at least so far; kernels keep no paths."""
    return made.evaluated(path, *ended_at(30.0, 151.0, 10.0, 150.0), simulator="kernels")


def evaluate_many(path: Path) -> Report:
    """Of many lost lanes whose path is known nine are drawn."""
    rows = [{"distance_m": 40.0 - n, "path_m": [[40.0 - n, 0.0]]} for n in range(11)]
    return made.evaluated(path, *rows, {"distance_m": 50.0}, task={"lane": {"obstacles": OBSTACLES}})


def test_evaluations_are_compared_in_one_figure(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    keys: dict[str, Any] = {"agent": "default", "task": {"timing": "lockstep", "history": 2, "observation": "state"}}
    reports = [
        made.evaluated(tmp_path / "a/run", *ended_at(10.0, 40.0), **keys, seed=3),
        made.evaluated(tmp_path / "b/run", *ended_at(20.0), **keys | {"task": {"timing": "wall"}}, seed=1),
        made.evaluated(tmp_path / "c", *ended_at(5.0, 6.0), task={"timing": "lockstep"}, seed=3, simulator="kernels"),
    ]
    paths = Evaluation().compare([report.run for report in reports])
    assert paths == [tmp_path / "a/run/figures/figure8_survival_compared.png"]
    assert_as_recorded("evaluate_compared", "\n".join(figures_text(drawn)).replace(str(tmp_path), "RUNS") + "\n")


def test_evaluations_outside_of_the_lane_are_compared_by_return(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Distances are from the goal there, or there are none; what flew another environment is left out."""
    elsewhere: dict[str, Any] = {"env_id": "uavaccel/Navigate-v0", "agent": "pilot.py:act"}
    rows: list[Any] = [{"return": 2.0}, {"return": -1.0}]
    runs = [made.evaluated(tmp_path / name, *rows, **elsewhere).run for name in "ab"]
    other = made.evaluated(tmp_path / "c", *ended_at(5.0)).run
    assert Evaluation().compare([other, *runs]) == [tmp_path / "a/figures/figure8_survival_compared.png"]
    [axes] = drawn["figure8_survival_compared"].axes
    assert axes.get_xlabel() == "return"
    assert [np.asarray(line.get_xdata()).tolist() for line in axes.lines] == [[-1.0, -1.0, 2.0]] * 2


# --- the suite rl -------------------------------------------------------------------------------------------------


def rl_table(path: Path) -> Report:
    """Table I and Figure 9: seeds, profiles and clocks; who took how long on this machine."""
    rows = made.rl_rows("tcsc", 1.0, [range(30), range(20)], 3600.0)
    rows += made.rl_rows("tcsc", 5.0, [range(25, 35), range(12)], 900.0) + made.rl_rows("adsc", 1.0, [range(9)], 1800.0)
    rows += made.rl_rows("tcsc", 5.0, [range(3)], profile="native")
    rows += made.rl_rows("tcsc", 1.0, [range(3)], timing="lockstep")
    rows += made.rl_rows("adsc", 1.0, [range(3)], timing="lockstep")
    for row in rows:
        row["training"]["phase_s"]["learning"] = 400.0 * row["training"]["commands"]
    return made.rl(path, rows, [60.0 * (number + 1) for number in range(5)])


def rl_flights(path: Path) -> Report:
    """Commands interchanged, flown as trained, in the exact simulator; a variant beside the plain trainings."""

    def flights(*lanes: range) -> Any:
        return dict(zip((("tcsc", 1.0), ("adsc", 1.0), ("tcsc", 5.0), ("adsc", 5.0)), lanes, strict=False))

    told = [flights(range(30), range(10, 34), range(12), range(8, 14)), flights(*map(range, (20, 20, 10, 4)))]
    plain = [flights(*map(range, (10, 10, 12, 12))), flights(*map(range, (5, 5, 10, 10))), flights(range(40))]
    rows = made.rl_rows("tcsc", 5.0, told, variant="told") + made.rl_rows("tcsc", 5.0, plain)
    rows += made.rl_rows("tcsc", 1.0, [range(3)] * 2, variant="told") + made.rl_rows("tcsc", 1.0, [[]] * 4)
    rows[-3]["training"]["weights_sha256"] = "other"  # of seed 1
    return made.rl(path, [*rows, made.exact_of(rows[0], range(4, 32))])


def rl_gaps(path: Path) -> Report:
    """Success over the gap, with intervals over three seeds or one; a tick of 3 ms takes 45 us, no less."""
    rows = made.rl_rows("adsc", 5.0, [range(20), range(10)], 0.4) + made.rl_rows("adsc", 10.0, [range(8)] * 3, 0.3)
    rows += made.rl_rows("adsc", 2.0, [range(30)], 1.2) + made.rl_rows("adsc", 100.0, [range(1)], 0.04)
    rows += [row for clock in (1.0, 5.0, 10.0) for row in made.rl_rows("tcsc", clock, [range(30)], 0.25)]
    return made.rl(path, rows + made.rl_rows("adsc", 1.0, [range(2)], 9.0))


# --- grids --------------------------------------------------------------------------------------------------------


def variant_rows(*names: str) -> list[Row]:
    """Under each of two variants three paths of ADSC, a TCSC game, and one in lockstep, which is left out."""
    rows = []
    for v, (variant, aside_m) in enumerate(zip(names, (0.1, 0.4), strict=True)):
        for t_move_s, rounds in ((0.5, 2), (1.0, 24), (0.5, 24)):
            keys: dict[str, Any] = {"t_move_s": t_move_s, "rounds": rounds, "variant": variant}
            own = [line_row("reference", "adsc", 1.0, 0, 0.0, **keys, wall_s=40.0 * t_move_s)]
            for game in range(3):
                offset_m, gaps_s = aside_m * (game + 1), [0.063, 0.064, 0.01 * (v + 1)]
                error = "crashed" if (game, rounds) == (2, 2) else None
                own.append(line_row("game", "adsc", 10.0, game, offset_m, gaps_s=gaps_s, error=error, **keys))
            own.append(line_row("game", "adsc", 10.0, 9, 9.0, timing="lockstep", wall_s=0.01, **keys))
            own.append(line_row("game", "tcsc", 10.0, 0, 0.0, **keys))
            arrays = [made.line_arrays(row) for row in own]
            named = [row | {"case": f"v{v:02d}-{row['case']}", "suite": "ablation"} for row in own]
            rows += [row | {"arrays": each} for row, each in zip(named, arrays, strict=True)]
    return rows


def ablated(path: Path, rows: list[Row], *names: str, **keys: Any) -> Report:
    base = "base={profile: airsim, command: [adsc], clock_speed: [1, 10], t_move_s: [0.2], rounds: [2], games: 2}"
    config = configured("ablation", base, seed=4, variants=[{"name": name} for name in names], **keys)
    return run_of(path, Ablation(), config, rows)


def ablation_of_numbers(path: Path) -> Report:
    """A variant's games are pooled; its speed-up is that of the longest paths; 63 ms are within the goal timeout.

    At the highest ClockSpeed no game was finished.
    """
    keys = {"axis": "latency × ClockSpeed", "title": "Late", "times_clock_speed": True}
    failed = line_row("game", "adsc", 20.0, 0, 0.0, suite="ablation", variant="3", error="crashed")
    rows = [*variant_rows("0.5", "3"), failed | {"arrays": made.line_arrays(failed)}]
    return ablated(path, rows, "3", "0.5", "not flown", **keys)


def ablation_of_names(path: Path) -> Report:
    """Named variants stand side by side."""
    return ablated(path, variant_rows("late", "none"), "none", "late", times_clock_speed=False)


def ablation_in_lockstep(path: Path) -> Report:
    """Nothing can be compared."""
    alone = [row for row in variant_rows("late", "none") if row["timing"] == "lockstep"]
    return ablated(path, alone, "none", "late", times_clock_speed=False)


def test_a_speed_up_lacks_where_one_of_its_cells_has_no_reference(tmp_path: Path) -> None:
    rows = variant_rows("late", "none")[6:18]  # of "late" the paths of 24 rounds
    assert [row["role"] for row in (rows[0], rows.pop(6))] == ["reference"] * 2
    entries = ablated(tmp_path / "run", rows, "late", "none").summary["entries"]
    assert [np.isnan(entry["effective_speedup"]) for entry in entries] == [False, True, True]


def sweep(path: Path) -> Report:
    """The wind of 0 is as trained; 6 m/s and the light are not flown yet."""
    outcomes = {"as-trained": [1, 1, 1, 1, 1, 1, 1, 0], "wind-3": [1, 1, 0, 0, 0, 0, 0, 1]}
    rows: list[Row] = [
        {
            "case": case, "same": ["wind-0"] if case == "as-trained" else [], "successes": sum(lanes), "games": 8,
            "timing": "virtual", "sim_time_s": 9.0, "distance_m_median": 150.0,
            "condition": "" if case == "as-trained" else "wind", "value": None if case == "as-trained" else 3,
            "arrays": made.outcomes_of(np.array(lanes, bool)),
        }
        for case, lanes in outcomes.items()
    ]  # fmt: skip
    return run_of(path, Sweep(), configured("sweep", games=8, sweep={"wind": [0, 3, 6], "light": [1]}), rows)


def mapped(path: Path, **ratios: list[float]) -> Report:
    """Success of 40 lanes at latencies ×0, ×1, ×2 and ×4, by command and ClockSpeed, as in adsc5; -1 is not flown."""
    rows: list[Row] = [
        {
            "case": f"latency{scale:g}-{name[:4]}-{name[4:]}x", "latency_scale": scale, "command": name[:4],
            "clock_speed": float(name[4:]), "games": 40, "successes": round(40 * ratio), "distance_m_median": 75.0,
            "sim_time_s": 9.0, "arrays": made.outcomes_of(np.arange(40) < round(40 * ratio)),
        }
        for name, line in ratios.items()
        for scale, ratio in zip((0.0, 1.0, 2.0, 4.0), line, strict=True)
        if ratio >= 0
    ]  # fmt: skip
    return run_of(path, Robustness(), configured("robustness"), rows[::-1])


def robustness(path: Path) -> Report:
    """Success collapses below half of that in real time."""
    at_1x, collapses = [0.9, 0.8, 0.8, 0.75], [0.9, 0.9, 0.5, 0.3]
    return mapped(path, adsc1=at_1x, adsc5=collapses, tcsc1=[0.975, 0.9, 0.8, -1.0], tcsc5=[0.3] * 4)


def test_what_recovers_at_a_higher_latency_has_collapsed(tmp_path: Path) -> None:
    *_, found = mapped(tmp_path / "run", adsc1=[0.9, 0.8, 0.8, 0.7], adsc5=[0.9, 0.8, 0.3, 0.5]).summary["collapses"]
    assert (found["clock_speed"], found["above"], found["below"]) == (5.0, 1.0, 2.0)


def mediated(path: Path, policies: int) -> Report:
    """Each policy wins half of what the one before wins, and less the slower it starts; the last has two trainings."""
    names = [f"told_{n}" for n in range(policies)]
    flights = {"start": {"label": "share", "keys": ["task.mediation.start_speed"], "values": [[-0.5], [0.25]]}}
    shown = [f"policies={json.dumps({name: {} for name in names})}", f"flights={json.dumps(flights)}"]
    rows = []
    for number, name in enumerate([*names, names[-1]]):
        won = {"usual": 16 >> number, "start--0.5": 4 >> number, "start-0.25": 8 >> number}
        arrays: dict[str, Any] = {f"{flight}_is_success": np.arange(16) < count for flight, count in won.items()}
        arrays |= {f"{flight}_distance_m": np.arange(16.0) for flight in won}
        seed = int(number == policies)
        row = {"case": f"{name}-seed{seed}", "policy": name, "seed": seed, "games": 16, "successes": won}
        rows.append({**row, "arrays": arrays})
    return run_of(path, Mediation(), configured("mediation_flight", *shown, "shares=[]", "contrasts=[]"), rows)


def mediation_of_few(path: Path) -> Report:
    """Lines over the values of a factor."""
    return mediated(path, 2)


def mediation_of_many(path: Path) -> Report:
    """A map of policies and flights."""
    return mediated(path, 8)


# --- realtime, seeds ----------------------------------------------------------------------------------------------


def realtime(path: Path) -> Report:
    """Of two agents the naive one is ahead in real time, and behind at 4x where latency is 50 ms."""
    rows = []
    for latency_s in (0.3, 0.0, 0.1, 0.05):
        for speed in (1.0, 4.0):
            mean = 3 if (latency_s, speed) == (0.05, 4.0) else 20
            rows.append(thinking_row("naive", "adsc", latency_s, speed, mean))
            rows.append(thinking_row("chunk", "adsc", latency_s, speed, 10, late_s=0.004))
    rows += [thinking_row("naive", "tcsc", 0.3, speed, 19 + speed, delays_s=[0.0, 0.0]) for speed in (1.0, 4.0)]
    rows.append(thinking_row("naive", "adsc", 0.3, 1.0, 24, seed=1, delays_s=[0.5, 0.1]))
    return made.realtime(path, *rows)


def test_the_machines_clock_is_held_against_the_simulated_one(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    keys = {"late_s": 0.03, "delays_s": [0.1, 0.1], "timing": "wall"}
    chunk, later = thinking_row("chunk", "adsc", 0.05, 1.0, 4.0), thinking_row("naive", "adsc", 0.05, 4.0, 99.0)
    still = thinking_row("naive", "tcsc", 0.05, 1.0, 10.0, delays_s=[0.0, 0.0])
    modelled = made.realtime(tmp_path / "virtual", thinking_row("naive", "adsc", 0.05, 1.0, 10.0), chunk, still, later)
    on_it = [row | {"timing": "wall"} for row in (chunk, still)]
    real = made.realtime(
        tmp_path / "wall", thinking_row("naive", "adsc", 0.05, 1.0, 8.0, **keys), *on_it, timing="wall"
    )
    told = set()
    for given in ((modelled.run, real.run), (real.run, modelled.run)):
        assert Realtime().compare(given) == [tmp_path / "wall/figures/agreement.png"]
        told.add((real.run.path / "agreement.json").read_text() + "\n".join(figures_text(drawn)) + "\n")
    assert_as_recorded("realtime_agreement", told.pop())
    assert not told, "in either order"


def seeds(path: Path, of: Sequence[tuple[int, int, float]] = ((7, 1, 2.0), (8, 2, 4.0), (9, 0, 6.0))) -> Report:
    """Student's interval with 2 degrees of freedom: 4.302653 standard errors."""
    plain = {"seed": 7, "seeds": len(of), "training": tiny_config(made.STATE, mirror=False).model_dump(mode="json")}
    rows = []
    for seed, wins, returned in of:
        row: Row = {"case": f"seed{seed}", "seed": seed, "games": 400, "successes": wins, "sim_time_s": 48.0}
        row |= {"success_recent": 0.5, "return_recent": returned, "commands_recent": 12.0}
        rows.append(row | {"evaluation": {"lanes": 2, "successes": wins}, "weights_sha256": f"{seed}" * 64})
        training = tiny_config(made.STATE, mirror=False, seed=seed)
        part = RunDirectory.create(path / f"parts/seed{seed}", training, {})
        for report_row in made.trained(path.parent / f"of-{seed}", won(*[True] * wins, False), seed=seed).rows:
            part.append_row(report_row)
    report = run_of(path.parent / "whole", Seeds(), validate(SeedsConfig, plain, "test"), rows)
    (path / "parts").rename(report.run.path / "parts")
    return report


MADE: tuple[Callable[[Path], Report], ...] = (
    *(dp1_cells, dp1_accelerated, dp1_equal, dp1_disturbed, dp1_failed, dp2_errors, dp2_disturbed, dp2_order),
    *(dp2_clouds, train_over, train_begun, train_progress, train_ppo, evaluate_exact, evaluate_kernels, evaluate_many),
    *(rl_table, rl_flights, rl_gaps, ablation_of_numbers, ablation_of_names, ablation_in_lockstep, sweep, robustness),
    *(mediation_of_few, mediation_of_many, realtime, seeds),
)


@pytest.mark.parametrize("make", MADE, ids=lambda make: make.__name__)
def test_a_report_is_the_one_that_was_read(
    make: Callable[[Path], Report],
    tmp_path: Path,
    drawn: dict[str, Figure],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    report = make(tmp_path / "run")
    suite = SimpleNamespace(report=lambda run: report)
    monkeypatch.setattr("uavaccel.suites.registry.suite_of", lambda run: suite)
    report_run(report.run)
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines() if not line.endswith((".png", ".html"))]
    text = "\n".join([report_text(report, drawn), "## printed", *printed, ""])
    assert_as_recorded(make.__name__, text.replace(str(tmp_path), "RUNS"))


def ablation_in_bands(path: Path) -> Report:
    """ADSC alone was flown at 1x, and the first variant not at all."""
    flown = [row for row in variant_rows("late", "none") if row["variant"] == "late"]
    return ablated(path, flown, "none", "late", band=True)


def ablation_failed(path: Path) -> Report:
    return ablated(path, [row | {"error": "crashed"} for row in variant_rows("late", "none")[:3]], "late", "none")


def lane_in_wind(path: Path, won: int) -> Report:
    row: Row = {"same": [], "successes": won, "games": 1, "timing": "virtual", "sim_time_s": 9.0, "condition": "wind"}
    row |= {"case": "wind-3", "value": 3, "distance_m_median": 9.0}
    row["arrays"] = made.outcomes_of(np.array([won], bool))
    return run_of(path, Sweep(), configured("sweep", games=1, sweep={"wind": [3]}), [row])


ENDS: tuple[tuple[Callable[[Path], Report], str], ...] = (
    (ablation_in_bands, "ADSC at 10x: STLC 1.819 with late; TCSC at 10x: STLC 2.000 with late"),
    (ablation_failed, "No variant has games to compare"),
    (partial(lane_in_wind, won=1), "The policy that ships wins 100.0% at wind = 3"),
    (partial(mapped, adsc1=[-1, 0.0, -1, -1]), "The policy that ships wins 0.0% with ADSC at 1x and latency ×1"),
    (lambda path: made.rl(path, made.rl_rows("tcsc", 5.0, [[0]], variant="x")), "Variants alone win 2.5%"),
    (lambda path: made.dp1(path, [line_row("game", "tcsc", 50.0, 0, 0.0)]), "1 game, none of them"),
    (partial(seeds, of=[(7, 1, 2.0)]), "Evaluation lanes won after the last game: 50.0% [9.5%, 90.5%], one seed"),
    (
        lambda path: made.realtime(path, *(thinking_row(who, "adsc", 0.0, 1.0, 5.0) for who in ("naive", "chunk"))),
        "With 0 ms to think, in pendulum naive = chunk",
    ),
    (
        lambda path: made.realtime(path, thinking_row("naive", "adsc", 0.0, 1.0, 5.0) | {"returns": [5.0]}),
        "Pendulum, naive: return 5 (one episode) with 0 ms to think, ADSC at 1x",
    ),
    (
        lambda path: made.realtime(path, *(thinking_row("naive", "adsc", s, 1.0, 5.0) for s in (0.0, 0.05))),
        "Pendulum, naive: return 5 (95 % interval 4 to 6.5) with 0 ms to think, ADSC at 1x; pendulum, naive: return 5 "
        "(95 % interval 4 to 6.5) with 50 ms to think, ADSC at 1x",
    ),
)


@pytest.mark.parametrize(("make", "said"), ENDS)
def test_what_little_a_run_has_is_reported(make: Callable[[Path], Report], said: str, tmp_path: Path) -> None:
    report = make(tmp_path / "run")
    report.write()
    assert report.headline().startswith(said)
    page = (report.run.path / "report.md").read_text().partition("config.yaml")[0]
    assert not re.search(r"\bnan\b|(?<![\d.,])1 (games|lanes|trainings|points|conditions|seeds)\b", page)


def test_a_single_seed_tells_nothing_of_the_return_of_others(tmp_path: Path) -> None:
    found = seeds(tmp_path / "run", of=[(7, 1, 2.0)]).summary["over_seeds"]["return_recent"]
    assert found["mean"] == 2.0
    assert np.isnan([found["low"], found["high"]]).all()


def rl_exact(path: Path) -> Report:
    """Policies of several seeds in the exact simulator, too."""
    rows = made.rl_rows("tcsc", 5.0, [range(30), range(20), range(6)])
    return made.rl(path, [*rows, *(made.exact_of(row, range(4, 9 + 7 * row["seed"])) for row in rows)])


def unordered(value: Any) -> Any:
    """Plain data as text, its lists of mappings, and what it says seed by seed, in any order."""
    if isinstance(value, Mapping):
        by_seed = [value[name] for name in ("seeds", "successes_by_seed") if name in value]
        value = {**value, "seeds": sorted(zip(*by_seed, strict=True)), "successes_by_seed": None}
        return {name: unordered(each) for name, each in value.items()}
    if isinstance(value, Sequence) and any(isinstance(each, Mapping) for each in value):
        return sorted(str(unordered(each)) for each in value)
    return plain(value)


@pytest.mark.parametrize("make", [dp1_cells, rl_flights, rl_exact, sweep, mediation_of_few])
def test_a_summary_is_the_same_in_whatever_order_games_are_finished(
    make: Callable[[Path], Report], tmp_path: Path
) -> None:
    report = make(tmp_path / "run")
    file, before = report.run.path / "rows.jsonl", unordered(report.summary)
    lines = file.read_text().splitlines(keepends=True)
    half = len(lines) // 2
    file.write_text("".join([*lines[half:], *reversed(lines[:half])]))
    assert unordered(report.suite.report(RunDirectory(report.run.path)).summary) == before
