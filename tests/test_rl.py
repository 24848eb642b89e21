"""The RL experiment: cells that a kill does not change, Table I's numbers by hand, figures, several runs together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import binomtest, fisher_exact

from tests.drawing import headline, labelled, points, record_figures, tick_texts
from tests.opengl import needs_opengl
from tests.running import configured, run_into
from uavaccel.config import to_yaml
from uavaccel.errors import UserError
from uavaccel.metrics.equivalence import mean_estimate
from uavaccel.records import RunDirectory
from uavaccel.suites import gpu, rl, runner
from uavaccel.suites.parts import Part, part_suite
from uavaccel.suites.report import Report
from uavaccel.suites.rl import EvaluationResult, Rl, RlConfig, TrainingResult, other_command, parts_of
from uavaccel.suites.rl_figures import KEY, collapse, over_gaps

pytestmark = pytest.mark.usefixtures("trainings_here")

# No pictures, hence no OpenGL; games of a dozen commands; policies flown by the kernels, and with both commands.
SMALL = (
    "games=3",
    "cells=[{profile: airsim, command: [tcsc, adsc], clock_speed: [1, 5]}, {profile: native, command: [tcsc], "
    "clock_speed: [100]}, {profile: native, timing: lockstep, command: [tcsc], clock_speed: [1]}]",
    "evaluation.keys={games: 2, task.max_commands: 12, simulator: kernels}",
    "exact_seeds=1",
    "exact={experiment: evaluate, keys: {games: 2, task.max_commands: 12}}",
    "training.keys={environments: 1, turns: 1, checkpoint_games: 1, channels: [4, 4], hidden: [16], mirror: false, "
    "task.observation: state, task.max_commands: 12, options: {learning_starts: 8, batch_size: 8, buffer_size: 300}}",
)
# Runs as the command line does, but dies without a word at the so-manieth row that any part writes.
KILLED = """
import os, signal, sys
from pathlib import Path
from uavaccel.config import validate
from uavaccel.records import RunDirectory
from uavaccel.suites.rl import Rl, RlConfig
from uavaccel.suites.runner import start_run, run_suite
from uavaccel.yaml_io import load_yaml
from tests.learning import fly_here

fly_here()
append, left = RunDirectory.append_row, [int(sys.argv[3])]

def append_and_die(run, row, on_disk=True):
    append(run, row, on_disk)
    left[0] -= 1
    if not left[0]:
        os.kill(os.getpid(), signal.SIGKILL)

RunDirectory.append_row = append_and_die
config = validate(RlConfig, load_yaml(sys.argv[1]), sys.argv[1])
run_suite(Rl(), config, start_run(Rl(), config, Path(sys.argv[2]), {}))
"""


def small(*overrides: str, **options: Any) -> RlConfig:
    config = configured("rl_smoke", *SMALL, *overrides, **options)
    assert isinstance(config, RlConfig)
    return config


@pytest.fixture(scope="module")
def whole(trainings_here: None, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """A run of six cells."""
    out = tmp_path_factory.mktemp("rl") / "whole"
    run_into(out, Rl(), small())
    return RunDirectory(out)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    return record_figures(monkeypatch)


# --- cells ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_killed_moved_and_interrupted_it_ends_with_the_same_bytes(
    tmp_path: Path, whole: RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows of a cell: three of its training, two of each of its evaluations, its own; each policy is flown twice."""
    config = small(clock_speed=[1.0], profile="airsim")
    (tmp_path / "config.yaml").write_text(to_yaml(config))
    command = [sys.executable, "-c", KILLED, str(tmp_path / "config.yaml"), str(tmp_path / "killed"), "10"]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    second = tmp_path / "killed/parts/airsim-virtual-adsc-1x-seed0"
    assert len(RunDirectory(tmp_path / "killed").rows()) == 1
    assert len(RunDirectory(second / "training").rows()) == 2
    assert [path.name for path in (second / "training/checkpoints").iterdir()] == ["0000001"]

    with monkeypatch.context() as patch:
        interrupt_at_row(patch, "lane-000001")
        with pytest.raises(KeyboardInterrupt):
            run_into(tmp_path / "killed", Rl(), config, resume=True)
    assert len(RunDirectory(second / "evaluation-adsc").rows()) == 1
    # The evaluation names its policy by where it was.
    moved = (tmp_path / "killed").rename(tmp_path / "moved")
    run_into(moved, Rl(), config, resume=True)

    rows = RunDirectory(moved).rows()
    expected = [row for row in whole.rows() if row["case"].startswith("airsim") and row["clock_speed"] == 1.0]
    assert rows == expected
    assert [row["case"].endswith("-exact") for row in rows] == [False, False, True, True]
    for row in rows:
        cell = row["case"].removesuffix("-exact")
        for name in (row["arrays"], *(f"parts/{cell}/{part}" for part in PARTS)):
            assert (moved / name).read_bytes() == (whole.path / name).read_bytes()
    assert not list(moved.glob("parts/*/training/checkpoints"))
    assert not list(moved.glob("parts/**/*.png"))


PARTS = (
    "training/rows.jsonl",
    "training/policy.pt",
    "evaluation-tcsc/rows.jsonl",
    "evaluation-adsc/rows.jsonl",
    "evaluation-exact/rows.jsonl",
)


def interrupt_at_row(patch: pytest.MonkeyPatch, case: str) -> None:
    append = RunDirectory.append_row

    def interrupted(run: RunDirectory, row: Any, on_disk: bool = True) -> None:
        if row["case"] == case:
            raise KeyboardInterrupt
        append(run, row, on_disk)

    patch.setattr(RunDirectory, "append_row", interrupted)


@pytest.mark.slow
def test_policies_fly_in_real_time_on_the_clock_and_the_profile_of_their_training(whole: RunDirectory) -> None:
    """The lanes of seed 0, whatever the seed of the training; with the other command, and in the exact simulator."""
    rows = {row["case"]: row for row in whole.rows()}
    compared = {tuple(each[name] for name in KEY): each for each in whole.read_json("summary.json")["exact"]}
    for name, row in rows.items():
        if "training" not in row:
            continue
        commands = [row["command"], other_command(row["command"])]
        parts = {"training": (row["command"], row["clock_speed"], row["seed"], 3)}
        parts |= {f"evaluation-{command}": (command, 1.0, 0, 2) for command in commands}
        for part, expected in parts.items():
            config = RunDirectory(whole.path / "parts" / name / part).config()
            task = config["task"]
            assert (task["command"], task["clock_speed"], config["seed"], config["games"]) == expected
            assert (task["timing"], task["profile"]) == (row["timing"], row["profile"])
        ours = whole.load_arrays(row)
        for command, flown in zip(commands, row["evaluations"], strict=True):
            games = RunDirectory(whole.path / f"parts/{name}/evaluation-{command}").rows()
            assert (flown["command"], flown["clock_speed"], flown["simulator"]) == (command, 1.0, "kernels")
            assert (flown["games"], flown["successes"]) == (2, sum(game["is_success"] for game in games))
            for key in ("distance_m", "lane", "is_success"):
                assert ours[f"{command}_{key}"].tolist() == [game[key] for game in games]
        exact = rows[f"{name}-exact"]
        (flown,), theirs = exact["evaluations"], whole.load_arrays(exact)
        assert (flown["simulator"], flown["command"], flown["clock_speed"]) == ("mujoco", row["command"], 1.0)
        assert theirs["exact_lane"].tolist() == ours[f"{row['command']}_lane"].tolist() == [0, 1]
        if row["profile"] == "native":  # nothing is seen, and no latency is drawn: equal to the last bit
            np.testing.assert_array_equal(theirs["exact_distance_m"], ours["tcsc_distance_m"])
        told = compared[tuple(row[key] for key in KEY)]
        assert (told["lanes"], told["same_end"], told["mcnemar_p"]) == (2, 2, 1.0)
    weights = {name: row["training"]["weights_sha256"] for name, row in rows.items() if "training" in row}
    assert weights["native-virtual-tcsc-100x-seed0"] == weights["native-lockstep-tcsc-1x-seed0"]
    assert weights["airsim-virtual-adsc-1x-seed0"] != weights["airsim-virtual-adsc-5x-seed0"]


def test_a_policy_is_flown_as_it_was_trained_and_with_the_other_command_where_that_is_asked_for() -> None:
    def flown(*overrides: str) -> list[Any]:
        config = small(*overrides, clock_speed=[5.0], command=["adsc"])
        return [
            [
                (name.removeprefix("evaluation-"), *(part.keys[f"task.{key}"] for key in ("command", "clock_speed")))
                for name, (part, _) in parts_of(config, cell).items()
                if name != "training"
            ]
            for cell in Rl().cases(config)
        ]

    own, other = ("adsc", "adsc", 1.0), ("tcsc", "tcsc", 1.0)
    fast, other_fast = ("adsc-5x", "adsc", 5.0), ("tcsc-5x", "tcsc", 5.0)
    exact = [("exact", "adsc", 1.0)]
    assert flown() == [[own, other], exact]
    assert flown("interchange=false", "as_trained=true") == [[own, fast], exact]
    assert flown("as_trained=true", "exact_seeds=0") == [[own, other, fast, other_fast]]


def test_what_a_decision_takes_it_takes_in_evaluations_too() -> None:
    keys = "training: {inference_s: 0.03, learning_s: 0.5}, task: {t_move_s: .8}"
    config = small(f"cells=[{{profile: airsim, clock_speed: [5], {keys}}}]")
    for cell in Rl().cases(config):
        for name, (part, seed) in parts_of(config, cell).items():
            found: Any = part_suite(part, seed)[1]
            assert found.inference_s == 0.03
            assert (found.task.t_move_s, "learning_s" in part.keys) == (
                (0.8, True) if name == "training" else (1.0, False)
            )


def test_each_seed_trains_a_policy_of_its_own_which_flies_the_lanes_of_seed_0(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown: list[tuple[str, int, str]] = []

    def fly_at_once(run: RunDirectory, name: str, part: Part, seed: int, pages: bool) -> dict[str, Any]:
        policy = str(part.keys.get("agent", ""))
        flown.append((name.removeprefix("native-virtual-tcsc-100x-"), seed, policy[-14:]))
        folder = run.path / "parts" / name
        folder.mkdir(parents=True)
        (folder / "config.yaml").write_text(f"suite: {part.experiment}\n")
        (folder / "manifest.json").write_text("{}\n")
        return dict.fromkeys((*TrainingResult.__annotations__, *EvaluationResult.__annotations__))

    monkeypatch.setattr(rl, "fly_part", fly_at_once)
    monkeypatch.setattr(rl, "outcomes", lambda _: {})
    config = small("interchange=false", "exact_seeds=2", clock_speed=[100.0], seed=4, seeds=2)
    run = RunDirectory.create(tmp_path / "run", config, {})
    rows = [Rl().fly(config, case, run).row for case in Rl().cases(config)]
    assert flown == [
        ("seed4/training", 4, ""),
        ("seed4/evaluation-tcsc", 0, "seed4/training"),
        ("seed5/training", 5, ""),
        ("seed5/evaluation-tcsc", 0, "seed5/training"),
        ("seed4/evaluation-exact", 0, "seed4/training"),
        ("seed5/evaluation-exact", 0, "seed5/training"),
    ]
    assert [(row["seed"], "training" in row) for row in rows] == [(4, True), (5, True), (4, False), (5, False)]


def test_seeds_are_outermost_and_options_choose_cells() -> None:
    """A run grows by seeds; what builds on trainings waits for all of them."""

    def names(**options: Any) -> list[str]:
        return [case.id for case in Rl().cases(small(**options))]

    some = [name for name in names(command=["adsc"], seeds=2) if not name.endswith("-exact")]
    assert some == [f"airsim-virtual-adsc-{k}x-seed{seed}" for seed in (0, 1) for k in (1, 5)]
    once = "native-lockstep-tcsc-1x-seed3"
    assert names(timing="lockstep", seed=3) == [once, f"{once}-exact"]
    few, many = names(), names(seeds=2)
    assert [name[-1] for name in many[:12]] == ["0"] * 6 + ["1"] * 6
    assert (len(few), set(few) <= set(many)) == (12, True)
    assert set(Rl().may_grow(Path())) == {"seeds", "exact_seeds"}
    groups: list[Any] = [group for _, group in runner._groups(Rl(), Rl().cases(small(seeds=2)))]
    assert [(len(group), {Rl().stage(case) for case in group}) for group in groups] == [(12, {0}), (6, {1})]


def test_a_dry_run_counts_the_games_of_all_parts_and_seeds_are_the_runs_unless_keys_name_others() -> None:
    config = configured("rl_session", seeds=1, clock_speed=[1.0], profile="airsim")
    assert [Rl().games(config, case) for case in Rl().cases(config)] == [1600, 1600]  # each policy flies twice
    for keys, seed in (({}, 3), ({"seed": 9}, 9)):
        assert part_suite(Part(experiment="evaluate", keys=keys), 3)[1].seed == seed


@pytest.mark.slow
@needs_opengl
def test_a_cell_learns_from_pictures(tmp_path: Path) -> None:
    cells = "cells=[{profile: airsim, command: [tcsc], clock_speed: [5], task: {max_commands: 24}}]"
    config = configured("rl_smoke", "games=2", cells, "evaluation.keys={games: 1, task.max_commands: 12}")
    cell = run_into(tmp_path / "run", Rl(), config)["cells"][0]
    assert cell["phase_s"]["rendering"] > 0
    assert cell["training_speedup"] is None  # without the same at 1x


@pytest.mark.parametrize(
    ("overrides", "options", "said"),
    [
        ([], {"clock_speed": [7.0]}, r"clock_speed = 7.0 is in no cell; there are 1.0, 5.0, 100.0"),
        ([], {"profile": "native", "command": ["adsc"]}, "together select no cell"),
        ([], {"timing": "wall"}, "should be 'virtual' or 'lockstep'"),
        (["evaluation.keys.gamess=1"], {}, "evaluate.yaml: unknown key 'gamess'"),
        (["training.keys.environment=2"], {}, "train.yaml: unknown key 'environment'"),
        (["cells.2={profile: airsim, clock_speed: [5]}"], {}, "airsim virtual adsc at 5x twice; give one a `variant`"),
        (["exact.keys.games=3"], {}, r"exact\.keys: games and first_lane must be those of evaluation\.keys"),
        (["exact.keys.first_lane=3"], {}, r"exact\.keys: games and first_lane must be those of evaluation\.keys"),
        (["evaluation.keys.simulator=mujoco"], {}, r"exact_seeds: needs .* beside an evaluation .* not by mujoco"),
    ],
)
def test_what_cannot_be_is_one_clear_line_before_anything_is_flown(
    overrides: list[str], options: dict[str, Any], said: str
) -> None:
    with pytest.raises(UserError, match=said) as caught:
        small(*overrides, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("experiment", "cells"), [("rl_collapse", 65), ("rl_latency", 15)])
def test_the_shipped_maps_of_gaps_can_be_trained_and_flown(experiment: str, cells: int) -> None:
    config = configured(experiment, "seeds=1")  # which checks it
    assert len(list(Rl().cases(config))) == cells


# --- numbers ----------------------------------------------------------------------------------------------------

LANES = 40
Won = Sequence[int] | Mapping[tuple[str, float], Sequence[int]]
"""The lanes that a policy won, in real time with its own command, or in flights with others."""


def made(command: str, clock_speed: float, won: Sequence[Won], wall_s: float = 1.0, **keys: Any) -> list[Any]:
    """A row for each seed; of a command three quarters of `wall_s` fly, and 0.25 s draw."""
    rows = []
    spent_s = {"simulation": 0.75 * wall_s, "rendering": 0.25}
    spent_s |= {"image_processing": 0.001, "inference": 0.002, "learning": 0.007}
    for seed, lanes in enumerate(won):
        flights = lanes if isinstance(lanes, Mapping) else {(command, 1.0): lanes}
        commands = 100 * (seed + 1)
        row: dict[str, Any] = {"suite": "rl", "variant": "", "profile": "airsim", "timing": "virtual", "seed": seed}
        row |= {"command": command, "clock_speed": clock_speed, **keys}
        row["case"] = "-".join(str(row[name]) for name in (*KEY, "seed"))
        row["training"] = {
            "games": 10,
            "successes": 3 + seed,
            "commands": commands,
            "sim_time_s": float(commands),
            "weights_sha256": "f00",
            "phase_s": {phase: commands * each for phase, each in spent_s.items()},
        }
        row["evaluations"] = [flight(*each, len(some)) for each, some in flights.items()]
        row["lanes"] = {f"{name}" if at == 1.0 else f"{name}-{at:g}x": some for (name, at), some in flights.items()}
        rows.append(row)
    return rows


def flight(command: str, clock_speed: float, successes: int) -> dict[str, Any]:
    conditions = {"command": command, "clock_speed": clock_speed, "timing": "virtual", "simulator": "kernels"}
    return {**conditions, "successes": successes, "games": LANES}


def exact_of(row: dict[str, Any], lanes: Sequence[int]) -> dict[str, Any]:
    """The row of a policy's flight in the exact simulator."""
    exact = {key: value for key, value in row.items() if key != "training"}
    flown = [flight(row["command"], 1.0, len(lanes)) | {"simulator": "mujoco"}]
    return exact | {"case": f"{row['case']}-exact", "evaluations": flown, "lanes": {"exact": lanes}}


def report_of(path: Path, rows: Sequence[Any], took_s: Sequence[float] = (), **options: Any) -> Report:
    """The report of a run of these rows; games that were not won ended at 10 m on lane 0, 11 m on lane 1 and so on."""
    run, lane = RunDirectory.create(path, small(**options), {}), np.arange(LANES)
    for row in rows:
        arrays: dict[str, np.ndarray] = {}
        for name, lanes in row["lanes"].items():
            won = np.isin(lane, lanes)
            arrays |= {f"{name}_lane": lane, f"{name}_is_success": won}
            arrays[f"{name}_distance_m"] = np.where(won, 150.0, 10.0 + lane)
        own = {key: value for key, value in row.items() if key != "lanes"}
        run.append_row(own | run.save_arrays(row["case"], arrays))
    for row, each in zip(rows, took_s, strict=False):
        run.append_timing({"case": row["case"], "training_s": each})
    return Rl().report(run)


def test_every_number_of_table_i_and_figure_9(tmp_path: Path) -> None:
    rows = made("tcsc", 1.0, [range(30), range(20)])
    rows += made("tcsc", 5.0, [range(25, 35), range(12)], 0.25)
    rows += made("adsc", 1.0, [range(9)], 0.5)
    rows += made("tcsc", 5.0, [range(3)], profile="native") + made("tcsc", 1.0, [range(3)], timing="lockstep")
    summary = report_of(tmp_path / "run", rows).summary
    assert [cell["successes"] for cell in summary["cells"]] == [30, 20, 10, 12, 9, 3, 3]
    lost_m = [10.0 + n for n in range(40) if not 25 <= n < 35]
    assert summary["cells"][2]["distance_m_median"] == float(np.median(lost_m + [150.0] * 10))
    real_time, fast, adsc, native, lockstep = summary["pooled"]
    assert (fast["successes"], fast["games"], fast["successes_by_seed"]) == (22, 80, [10, 12])
    wilson = binomtest(22, 80).proportion_ci(method="wilson")
    assert (fast["wilson_low"], fast["wilson_high"]) == (wilson.low, wilson.high)
    assert fast["fisher_p"] == pytest.approx(fisher_exact(np.array([[22, 58], [50, 30]])).pvalue)
    # Lanes 0 to 24 of seed 0 and 12 to 19 of seed 1 were won at 1x alone, 30 to 34 of seed 0 at 5x alone.
    assert fast["mcnemar_p"] == pytest.approx(binomtest(5, 5 + 25 + 8).pvalue)
    assert (fast["paper_successes"], real_time["paper_successes"], native["paper_successes"]) == (30, 21, None)
    # of six ways to share four trainings out, two are as far
    assert fast["permutation_p"] == pytest.approx(2 / 6)
    over_seeds = mean_estimate([10 / LANES, 12 / LANES])  # wider than Wilson's of the games
    assert (fast["seeds_low"], fast["seeds_high"]) == (max(0.0, over_seeds.low), over_seeds.high)
    assert (adsc["seeds_low"], adsc["seeds_high"]) == (adsc["wilson_low"], adsc["wilson_high"])
    # ADSC at 1x is what all speed-ups are over.
    assert fast["training_speedup"] == pytest.approx(0.625 / 0.4375)
    assert fast["whole_training_speedup"] == pytest.approx(0.635 / 0.4475)
    assert fast["training_wall_s"] == pytest.approx(300 * 0.4475)
    assert fast["phase_s"]["rendering"] == pytest.approx(300 * 0.25)
    assert (fast["trained_games"], fast["commands"], fast["sim_time_s"]) == (20, 300, 300.0)
    assert fast["real_time_s"] == pytest.approx(300 * 0.635)
    assert (fast["paper_training_speedup"], fast["paper_whole_training_speedup"]) == (4.0, 3.6)
    assert (real_time["training_speedup"], adsc["training_speedup"]) == (pytest.approx(0.625), 1.0)
    assert real_time["fisher_p"] is real_time["permutation_p"] is native["fisher_p"] is None
    assert native["training_speedup"] is lockstep["training_speedup"] is lockstep["fisher_p"] is None


def test_both_simulators_ends_are_paired_by_seed_and_lane(tmp_path: Path) -> None:
    """The exact one flew seed 1's policy alone; the same end is a game won in both, or lost in both."""
    rows = made("tcsc", 1.0, [range(40), range(12)])
    (found,) = report_of(tmp_path / "run", [*rows, exact_of(rows[1], [*range(2, 12), 39])]).summary["exact"]
    assert found["seeds"] == [1]
    assert (found["kernels"]["successes"], found["exact"]["successes"]) == (12, 11)
    assert (found["lanes"], found["same_end"]) == (40, 37)
    assert found["mcnemar_p"] == pytest.approx(binomtest(1, 3).pvalue)


def test_weights_are_the_same_where_every_clock_speed_learned_them(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = made("tcsc", 1.0, [[]] * 4) + made("tcsc", 5.0, [[]] * 3) + made("adsc", 1.0, [[]])
    rows[5]["training"]["weights_sha256"] = "other"  # of seed 1; seed 3 was not trained at 5x
    report = report_of(tmp_path / "run", rows)
    (found,) = report.summary["same_weights"]
    assert (found["command"], found["clock_speed"]) == ("tcsc", [1.0, 5.0])
    assert (found["seeds"], found["equal"]) == ([0, 1, 2], [0, 2])
    said = "TCSC, airsim: of 3 seeds 2 learned the same weights at 1x, 5x: 1 learned others."
    assert said in list(Rl().page(report))


def test_a_variant_is_held_against_the_plain_training_on_the_same_lanes(tmp_path: Path) -> None:
    def flights(*counts: int) -> Any:
        return {("adsc", at): range(count) for at, count in zip((1.0, 5.0), counts, strict=False)}

    plain, told = (
        made("adsc", 5.0, [flights(*counts)], variant=name) for *counts, name in ((20, 4, ""), (32, 15, "told"))
    )
    without, within = report_of(tmp_path / "both", plain + told).summary["as_trained"]
    assert without["as_trained"]["mcnemar_p"] is None
    assert (within["real_time"]["successes"], within["as_trained"]["successes"]) == (32, 15)
    assert within["real_time"]["mcnemar_p"] == pytest.approx(binomtest(0, 12).pvalue)
    assert within["as_trained"]["mcnemar_p"] == pytest.approx(binomtest(0, 11).pvalue)
    assert within["as_trained"]["fisher_p"] == pytest.approx(fisher_exact(np.array([[15, 25], [4, 36]])).pvalue)
    slow = made("adsc", 5.0, [flights(20)])  # flown in real time alone: a variant's flights have nothing beside them
    (alone,) = report_of(tmp_path / "slow", slow + told).summary["as_trained"]
    assert alone["real_time"]["mcnemar_p"] is alone["as_trained"]["mcnemar_p"] is None


def test_the_gap_is_what_passes_beyond_t_move_while_the_clock_runs(tmp_path: Path) -> None:
    rows = made(
        "adsc", 5.0, [[0], [1]], 0.4
    )  # .3 s of flight and .01 s beside it pass at 5x; the pictures' .25 s stand
    rows += made("adsc", 10.0, [[0]], 0.05)  # commands that collisions end early
    rows += made("adsc", 100.0, [[0]], 0.04)  # a tick of 3 ms takes 45 us: no more than 66.7x
    rows += made("tcsc", 5.0, [[0]], 0.4)  # its clock is paused
    gaps = [cell["gap_s"] for cell in report_of(tmp_path / "run", rows).summary["pooled"]]
    assert gaps == [pytest.approx(0.55), 0.0, pytest.approx(0.04 * 200 / 3 - 1.0), 0.0]


def thought(command: str, variant: str, gap: float, won: int) -> dict[str, Any]:
    """A pooled cell of 100 games."""
    return {
        "variant": variant, "profile": "airsim", "timing": "virtual", "command": command, "clock_speed": 5.0,
        "seeds": [0], "gap_s": gap, "success_ratio": won / 100, "successes": won, "games": 100,
    }  # fmt: skip


def test_the_gap_from_which_a_policy_fails_is_the_one_that_success_never_recovers_from() -> None:
    """.2 s, where it fails but .3 s does not, is no collapse; half of the best is none either."""
    won = {0.0: 80, 0.1: 96, 0.2: 30, 0.3: 48, 0.4: 47, 0.9: 2}
    cells = [thought("adsc", f"think_{1000 * gap:.0f}ms", gap, count) for gap, count in reversed(won.items())]
    cells += [thought("tcsc", f"think_{n}ms", 0.0, 90) for n in range(3)]  # one gap: nothing to be said of it
    cells.append(thought("adsc", "plain_dqn", 0.2, 1))  # a cell alone is no line
    lines = over_gaps(cells)
    found = {label: [cell["gap_s"] for cell in own] for label, own in lines.items()}
    assert found == {"ADSC, airsim": sorted(won), "TCSC, airsim": [0.0] * 3}
    stays = "success in real time stays below half of the best cell's"
    assert collapse(lines) == f"ADSC, airsim: {stays} 96.0% from a gap of 0.40 simulated seconds on."
    hard = [thought("adsc", f"hard_think_{n}ms", n / 10, 60 - n) for n in range(3)]
    said = f"ADSC, airsim, hard: no gap was flown, up to 0.20 s, from which {stays} 60.0%."
    assert collapse(over_gaps(hard)) == said
    assert said in collapse(over_gaps([*hard, *cells]))  # another lane's best is none of this one's
    assert over_gaps(hard[:2]) == {}
    failing = thought("adsc", "hard_think_9ms", 0.1, 3)  # at a gap at which another cell does not
    assert "no gap was flown" in collapse(over_gaps([*hard, failing]))


def test_the_headline_tells_success_after_the_slowest_and_the_fastest_training(tmp_path: Path) -> None:
    """Of trainings without a variant; where there are none, the gap at which policies fail."""
    plain = [
        thought(command, "", gap, won) | {"clock_speed": clock_speed}
        for command, clock_speed, gap, won in (
            ("tcsc", 1.0, 0.0, 21), ("adsc", 100.0, 9.0, 0), ("adsc", 5.0, 0.4, 64), ("adsc", 1.0, 0.1, 23),
        )
    ]  # fmt: skip
    told_of = [thought("adsc", f"think_{n}ms", n / 10, 96 >> n) for n in range(3)]
    report = report_of(tmp_path / "run", made("tcsc", 1.0, [[]]))
    cells = [{"games": 200}, {"games": 100}, {"games": 100}]
    for pooled, begin in (
        ([*plain, *told_of], "TCSC, airsim: 21.0% after training at 1x; ADSC, airsim: 23.0% after training at 1x, 0.0% "
         "after training at 100x; "),
        (told_of, "ADSC, airsim: success in real time stays below half of the best cell's 96.0% from a gap of 0.20 "
         "simulated seconds on; "),
        (told_of[:1], ""),
    ):  # fmt: skip
        report.summary = {"cells": cells, "training_games": 5000, "evaluation_clock_speed": 2.0, "pooled": pooled}
        assert report.headline() == (
            f"{begin}3 trainings of 5000 games, each policy flown on 100, 200 lanes at 2x; "
            "all times are modelled but those of this machine"
        )
    rows = [
        row | {"case": name}
        for name, row in zip(("one", "two"), made("tcsc", 1.0, [range(30), range(20)]), strict=True)
    ]
    assert Rl().status(rows) == "two won 20 of 40"


# --- the report -------------------------------------------------------------------------------------------------


def table_below(page: str, heading: str) -> list[dict[str, str]]:
    """The first table after a heading of a report.md: a line each, its cells by their columns' names, in order."""
    lines = [line for line in page.split(f"## {heading}\n")[1].split("## ")[0].splitlines() if "|" in line]
    columns, _, *cells = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines)
    return [dict(zip(columns, line, strict=True)) for line in cells]


def page_of(report: Report) -> str:
    report.write()
    return (report.run.path / "report.md").read_text(encoding="utf-8")


def test_the_report_tells_each_number_in_its_column(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Hours of hours, minutes of minutes, the test over seeds and McNemar's each in its own."""
    rows = made("tcsc", 1.0, [range(30), range(20)], 3600.0)
    rows += made("tcsc", 5.0, [range(25, 35), range(12)], 900.0)
    rows += made("adsc", 1.0, [range(9)], 1800.0)
    for row in rows:
        row["training"]["phase_s"]["learning"] = 400.0 * row["training"]["commands"]
    report = report_of(tmp_path / "run", rows, [60.0 * (number + 1) for number in range(5)])
    page = page_of(report)
    _, fast, _ = table_below(page, "Table I: success by training")
    mcnemar = binomtest(5, 5 + 25 + 8).pvalue
    low, high = (100 * report.summary["pooled"][1][end] for end in ("seeds_low", "seeds_high"))
    success = f"27.5% [{low:.1f}, {high:.1f}]"
    assert list(fast.values())[3:] == ["22 of 80", success, "10, 12", "30", "0.33", f"{mcnemar:.2g}"]
    assert list(fast)[-2:] == ["p against 1x, over seeds", "of these policies: McNemar"]
    _, fast, _ = table_below(page, "Time of the training")
    slow_s, fast_s, beside_s = 0.75 * 1800 + 0.25, 0.75 * 900 + 0.25, 400.003
    assert list(fast.values())[1:] == [
        "5x", "2", f"{300 * (fast_s + beside_s) / 3600:.3g}", f"{300 * (slow_s + beside_s) / 3600:.3g}",
        f"{slow_s / fast_s:.3g}x", "4x", f"{(slow_s + beside_s) / (fast_s + beside_s):.3g}x", "3.6x", "7",
    ]  # fmt: skip
    shown = report.overview()
    assert shown is not None
    assert shown.rows[1] == ("TCSC, airsim", "5x", "0, 1", success, "30 %", f"{slow_s / fast_s:.3g}x")
    hours = 700 * (slow_s + beside_s) / 3600
    assert f"These trainings' 50 games would have taken {hours:.3g} hours in real time" in page
    assert f"{3600 * hours / 50:.0f} s per game" in page
    assert f"took 0.25 hours of training, measured, one after another: {hours * 4:.0f} times less" in page


def of_wilson(successes: int, games: int) -> str:
    interval = binomtest(successes, games).proportion_ci(method="wilson")
    ends = f"[{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
    return f"{successes} of {games}: {successes / games:.1%} {ends}"


def test_each_flight_of_a_policy_is_told_in_its_line_and_column(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Student's t of two trainings is 12.7 at 95 %: of 30 % and 25 % that makes 27.5 % and up to 31.8 % more."""

    def flights(*lanes: range) -> Any:
        return dict(zip((("tcsc", 1.0), ("adsc", 1.0), ("tcsc", 5.0), ("adsc", 5.0)), lanes, strict=True))

    told = [
        flights(range(30), range(10, 34), range(12), range(8, 14)),
        flights(range(20), range(20), range(10), range(4)),
    ]
    plain = [flights(range(10), range(10), range(12), range(12)), flights(range(5), range(5), range(10), range(10))]
    rows = made("tcsc", 5.0, told, variant="told") + made("tcsc", 5.0, plain)
    page = page_of(report_of(tmp_path / "run", [*rows, exact_of(rows[0], range(4, 32))]))
    real_time, fast = "62.5% [0.0, 100.0]", "27.5% [0.0, 59.3]"
    slow_p, fast_p = f"{binomtest(4, 14).pvalue:.2g}", f"{binomtest(2, 16).pvalue:.2g}"
    who = ("TCSC, airsim, told 5x", "0, 1")
    shown = [tuple(line.values()) for line in table_below(page, "Commands interchanged")]
    assert [line for line in shown if line[0] == who[0]] == [
        (*who, "TCSC 1x", real_time, "10", "1", slow_p),
        (*who, "ADSC 1x", "55.0% [0.0, 100.0]", "4", "1", slow_p),
        (*who, "TCSC 5x", fast, "14", "0.5", fast_p),
        (*who, "ADSC 5x", "12.5% [0.0, 44.3]", "2", "0.5", fast_p),
    ]
    who = ("TCSC, airsim, told", "5x")
    variant, beside = (tuple(line.values()) for line in table_below(page, "Flown at the ClockSpeed of the training"))
    assert variant == (*who, "0, 1", real_time, "0.33", fast, "1", "0.5")
    assert (beside[0], beside[4], beside[6]) == ("TCSC, airsim", "-", "-")
    exact = table_below(page, "The same policies in the exact simulator")
    assert [tuple(line.values()) for line in exact] == [
        (*who, "0", of_wilson(30, 40), of_wilson(28, 40), "34 of 40", f"{binomtest(2, 6).pvalue:.2g}")
    ]
    assert "Of 40 flights of a policy over a lane in real time 34 end alike in both" in page
    assert [tuple(line.values()) for line in table_below(page, "Each training")] == [
        (*who, "0", "3 of 10", of_wilson(30, 40), "f00"),
        (*who, "1", "4 of 10", of_wilson(20, 40), "f00"),
        ("TCSC, airsim", "5x", "0", "3 of 10", of_wilson(10, 40), "f00"),
        ("TCSC, airsim", "5x", "1", "4 of 10", of_wilson(5, 40), "f00"),
    ]


def bars_of(axes: Any) -> dict[str, list[tuple[float, float]]]:
    """The ends of each line's intervals, by its label."""
    handles = labelled(axes).items()
    return {
        label: [tuple(bar[:, 1].round(9)) for bar in handle.lines[2][0].get_segments()] for label, handle in handles
    }


def dots_of(axes: Any) -> list[tuple[float, float]]:
    return [point for line in axes.lines if line.get_marker() == "." for point in points(line)]


def test_success_and_distance_have_a_line_per_clock_speed_and_kind_of_training(
    tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """The paper's numbers, with Wilson's intervals, where it has some; exact flights and variants are of no cell's."""
    rows = made("tcsc", 50.0, [range(0), range(10)]) + made("tcsc", 5.0, [range(4)])
    rows += made("tcsc", 5.0, [range(20), range(20)], profile="native")
    rows += made("tcsc", 5.0, [range(8)], variant="told")
    report = report_of(tmp_path / "run", [*rows, exact_of(rows[0], range(30))])
    page_of(report)
    pooled = {tuple(cell[key] for key in KEY): cell for cell in report.summary["pooled"]}
    axes: Any = drawn["table1_success"].axes[0]
    assert headline(drawn["table1_success"]) == ("Success by training", "modelled · 3 training games each · seed 0, 1")
    assert tick_texts(axes.xaxis) == ["5x", "50x"]
    lines = {label: points(handle.lines[0]) for label, handle in labelled(axes).items()}
    assert lines == {
        "TCSC, airsim": [(-0.09, 0.1), (0.91, 0.125)],
        "TCSC, the paper's": [(-0.03, 0.3), (0.97, 0.14)],
        "TCSC, airsim, told": [(0.03, 0.2)],
        "TCSC, native": [(0.09, 0.5)],
    }
    assert sorted(dots_of(axes)) == [
        (-0.06, 0.1), (0.06, 0.2), (0.12, 0.5), (0.12, 0.5), (0.94, 0.0), (0.94, 0.25),
    ]  # fmt: skip
    own = [pooled["", "airsim", "virtual", "tcsc", clock] for clock in (5.0, 50.0)]
    bars = bars_of(axes)
    assert bars["TCSC, airsim"] == [(round(cell["seeds_low"], 9), round(cell["seeds_high"], 9)) for cell in own]
    wilson = [binomtest(won, 100).proportion_ci(method="wilson") for won in (30, 14)]
    assert bars["TCSC, the paper's"] == [(round(each.low, 9), round(each.high, 9)) for each in wilson]
    upper, *_, lower, _, _ = drawn["figure8_distances"].axes
    curves = {label: points(line) for label, line in labelled(upper).items()}
    assert list(curves) == ["5x, 40 games", "50x, 80 games"]
    reached = dict(curves["5x, 40 games"])  # the share from each distance on
    assert [reached[metres] for metres in (0.0, 14.0, 49.0, 150.0)] == pytest.approx([1.0, 39 / 40, 4 / 40, 0.0])
    assert curves["50x, 80 games"][-11] == (49.0, 0.125)
    values, edges = lower.patches[0].get_data()[:2]  # type: ignore[attr-defined]
    found = {float(edge): float(share) for edge, share in zip(edges, values, strict=False) if share}
    assert found == {metres: pytest.approx(2 / 40) for metres in np.arange(14.0, 50.0, 2.0)}
    dotted: Any = [line.get_xdata()[0] for line in upper.lines if line.get_linestyle() == ":"]  # type: ignore[index]
    assert len(dotted) > 2
    assert len({round(step, 6) for step in np.diff(dotted)}) == 1, "rows of obstacles"


def test_success_over_the_gap_has_its_points_where_the_gaps_are(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Intervals stand over three seeds or one, not over two, nor where cells share a gap."""
    rows = made("adsc", 5.0, [range(20), range(10)], 0.4) + made("adsc", 10.0, [range(8)] * 3, 0.3)
    rows += made("adsc", 2.0, [range(30)], 1.2)
    rows += [row for clock in (1.0, 5.0, 10.0) for row in made("tcsc", clock, [range(30)])]
    report = report_of(tmp_path / "run", rows)
    page_of(report)
    slow, fast, two = (report.summary["pooled"][n] for n in (2, 1, 0))
    axes: Any = drawn["success_over_gap"].axes[0]
    lines = {label: points(handle.lines[0]) for label, handle in labelled(axes).items()}
    at = {name: round(cell["gap_s"], 12) for name, cell in (("slow", slow), ("fast", fast), ("two", two))}
    expected = sorted([(at["slow"], 0.75), (at["fast"], 0.2), (at["two"], 0.375)])
    assert lines == {"ADSC, airsim": expected, "TCSC, airsim": [(0.0, 0.75)] * 3}
    bars = bars_of(axes)
    assert bars["TCSC, airsim"] == [(0.75, 0.75)] * 3
    drawn_bars = dict(zip([x for x, _ in expected], bars["ADSC, airsim"], strict=True))
    assert drawn_bars[at["two"]] == (0.375, 0.375)
    assert drawn_bars[at["fast"]] == (round(fast["seeds_low"], 9), round(fast["seeds_high"], 9))
    assert {(at["two"], 0.5), (at["two"], 0.25)} <= set(dots_of(axes))


def test_training_time_is_bars_by_phase_and_speed_ups_beside_the_papers(
    tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """Means of the seeds, on a clock; rendering is of simulation."""
    rows = made("tcsc", 5.0, [[0], [1]], 0.25) + made("adsc", 1.0, [[]]) + made("tcsc", 1.0, [[]], timing="lockstep")
    report = report_of(tmp_path / "run", rows)
    page_of(report)
    _, bars, _, speeds = drawn["figure9_training_time"].axes
    assert [axes.get_title() for axes in drawn["figure9_training_time"].axes[:2]] == ["ADSC, airsim", "TCSC, airsim"]
    minutes = {str(bar.get_label()): bar[0].get_height() for bar in bars.containers}
    assert minutes == pytest.approx({
        "simulation (with rendering)": 0.4375 * 2.5, "image processing": 0.0025, "inference": 0.005, "learning": 0.0175,
    })  # fmt: skip
    cell = report.summary["pooled"][0]
    assert {name: points(line) for name, line in labelled(speeds).items()} == {
        "speed-up, simulation alone (right)": [(0.0, round(cell["training_speedup"], 12))],
        "speed-up, whole training (right)": [(0.0, round(cell["whole_training_speedup"], 12))],
        "the paper's, simulation alone": [(0.0, 4.0)],
        "the paper's, whole training": [(0.0, 3.6)],
    }


def test_several_runs_make_the_report_of_the_one_that_flew_all(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = made("tcsc", 1.0, [range(30), range(20)]) + made("adsc", 1.0, [range(9)] * 2)
    rows = [*rows, exact_of(rows[0], range(4))]
    all_of = report_of(tmp_path / "all", rows, [60.0] * 5)
    parts = {"tcsc": [rows[0], rows[1], rows[4]], "adsc": rows[2:4]}
    runs = [
        report_of(tmp_path / name, own, [60.0] * len(own), command=[name], seed=seed, seeds=3).run
        for (name, own), seed in zip(parts.items(), (2, 7), strict=True)
    ]
    for some in (runs, runs[::-1]):
        assert Rl().compare(some) == [some[0].path / "together/report.html"]
        made_one = RunDirectory(some[0].path / "together")
        summary = made_one.read_json("summary.json")
        for name in ("cells", "pooled", "exact", "same_weights"):
            assert sorted(summary[name], key=str) == sorted(all_of.summary[name], key=str)
        config = made_one.config()
        assert (config["seed"], config["seeds"], config["command"]) == (2, 8, [])
        assert set(made_one.manifest()["runs"]) == {str(run.path) for run in runs}
        assert "took 0.083 hours of training" in (made_one.path / "report.md").read_text(encoding="utf-8")
    with pytest.raises(UserError, match=r"has -airsim-virtual-tcsc-1.0-0, which .* has too"):
        Rl().compare([runs[0], runs[0]])
    other = report_of(tmp_path / "other", made("adsc", 5.0, [[]])).run
    (other.path / "config.yaml").write_text((other.path / "config.yaml").read_text().replace("games: 3", "games: 4"))
    with pytest.raises(UserError, match="other: games differs"):
        Rl().compare([runs[0], other])


# --- GPUs -------------------------------------------------------------------------------------------------------


def test_each_process_takes_a_gpu_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A place is a lock, which another opening of the file in this process meets as another process would."""
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    held: list[TextIO] = []
    cores: list[set[int]] = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3, 4}, raising=False)
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, share: cores.append(set(share)), raising=False)

    def taken() -> tuple[str, str]:
        for name in (gpu.VISIBLE, gpu.EGL_DEVICE):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(gpu, "_place", None)
        gpu.acquire_gpu("cuda")
        assert gpu._place is not None
        held.append(gpu._place)
        return os.environ[gpu.VISIBLE], os.environ[gpu.EGL_DEVICE]

    assert [taken() for _ in range(4)] == [("0", "0"), ("1", "1"), ("0", "0"), ("1", "1")]
    assert cores == [{0, 1}, {2, 3}, {0, 1}, {2, 3}]
    held[1].close()  # as at its process's end
    assert taken() == ("1", "1")
    for file in held:
        file.close()


@pytest.mark.parametrize(("device", "count"), [("cpu", 2), ("cuda:1", 2), ("cuda", 1)])
def test_without_a_choice_of_gpus_nothing_is_touched(device: str, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.device_count", lambda: count)
    monkeypatch.setattr(gpu, "_place", None)
    monkeypatch.delenv(gpu.VISIBLE, raising=False)
    gpu.acquire_gpu(device)
    assert gpu.VISIBLE not in os.environ
