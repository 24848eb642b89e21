"""The RL experiment: cells that a kill does not change, Table I's numbers by hand, runs put together, claims."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TextIO, cast, get_type_hints

import numpy as np
import pytest
from scipy.stats import binomtest, fisher_exact

from tests.opengl import needs_opengl
from tests.running import configured, run_into
from uavaccel.config import to_yaml
from uavaccel.errors import UserError
from uavaccel.metrics.equivalence import mean_estimate
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT
from uavaccel.suites import gpu, runner
from uavaccel.suites.paper import policy_claims
from uavaccel.suites.paper.evidence import NoEvidence, Policies, Undecided
from uavaccel.suites.parts import Part, part_suite
from uavaccel.suites.rl import suite as rl_suite
from uavaccel.suites.rl.cases import (
    EXACT,
    EvaluationResult,
    TrainingResult,
    cases,
    evaluation_part,
    flights,
    training_part,
)
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.rl.figures import plot_training_time
from uavaccel.suites.rl.gaps import GapLine, collapse, over_gaps
from uavaccel.suites.rl.report import RlReport
from uavaccel.suites.rl.suite import Rl, merge_runs
from uavaccel.suites.rl.summary import KEY, gap_s, summarise

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
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.rl.suite import Rl
from uavaccel.suites.runner import begin_run, run_suite
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
run_suite(Rl(), config, begin_run(Rl(), config, Path(sys.argv[2]), {}))
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
    assert [each.name for each in (second / "training/checkpoints").iterdir()] == ["0000001"]

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


def trainings(run: RunDirectory) -> list[dict[str, Any]]:
    return [row for row in run.rows() if "training" in row]


@pytest.mark.slow
def test_native_tcsc_learns_at_100x_what_it_does_in_lockstep(whole: RunDirectory) -> None:
    weights = {row["case"]: row["training"]["weights_sha256"] for row in trainings(whole)}
    assert weights["native-virtual-tcsc-100x-seed0"] == weights["native-lockstep-tcsc-1x-seed0"]
    assert weights["airsim-virtual-adsc-1x-seed0"] != weights["airsim-virtual-adsc-5x-seed0"]


@pytest.mark.slow
def test_policies_fly_in_real_time_on_the_clock_and_the_profile_of_their_training(
    whole: RunDirectory,
) -> None:
    """The lanes of seed 0, whatever the seed of the training; with the other command too."""
    for row in trainings(whole):
        commands = sorted(("tcsc", "adsc"), key=lambda command: command != row["command"])
        assert [flown["command"] for flown in row["evaluations"]] == commands
        parts = {"training": (row["command"], row["clock_speed"], row["seed"], 3)}
        parts |= {f"evaluation-{command}": (command, 1.0, 0, 2) for command in commands}
        for part, expected in parts.items():
            config = RunDirectory(whole.path / "parts" / row["case"] / part).config()
            task = config["task"]
            assert (task["command"], task["clock_speed"], config["seed"], config["games"]) == expected
            assert (task["timing"], task["profile"]) == (row["timing"], row["profile"])
        for flown in row["evaluations"]:
            rows = RunDirectory(whole.path / f"parts/{row['case']}/evaluation-{flown['command']}").rows()
            assert (flown["games"], flown["clock_speed"]) == (2, 1.0)
            assert flown["successes"] == sum(each["is_success"] for each in rows)
            found = whole.load_arrays(row)
            for name in ("distance_m", "lane"):
                assert found[f"{flown['command']}_{name}"].tolist() == [each[name] for each in rows]


def test_a_policy_is_flown_as_it_was_trained_and_with_the_other_command_where_that_is_asked_for() -> None:
    def flown(*overrides: str) -> list[Any]:
        config = small(*overrides, clock_speed=[5.0], command=["adsc"])
        return [tuple(flights(config, cell)) for cell in Rl().cases(config)]

    own, other = ("adsc", 1.0, "adsc"), ("tcsc", 1.0, "tcsc")
    fast, other_fast = ("adsc", 5.0, "adsc-5x"), ("tcsc", 5.0, "tcsc-5x")
    exact = (("adsc", 1.0, "exact"),)
    assert flown() == [(own, other), exact]
    assert flown("interchange=false", "as_trained=true") == [(own, fast), exact]
    assert flown("as_trained=true", "exact_seeds=0") == [(own, other, fast, other_fast)]


@pytest.mark.slow
def test_exact_flights_are_of_the_trained_policy_on_the_same_lanes(whole: RunDirectory) -> None:
    rows = {row["case"]: row for row in whole.rows()}
    compared = {tuple(each[name] for name in KEY): each for each in whole.read_json("summary.json")["exact"]}
    for row in trainings(whole):
        exact = rows[row["case"] + "-exact"]
        (flown,) = exact["evaluations"]
        assert (flown["simulator"], flown["command"], flown["clock_speed"]) == ("mujoco", row["command"], 1.0)
        assert row["evaluations"][0]["simulator"] == "kernels"
        ours, theirs = whole.load_arrays(row), whole.load_arrays(exact)
        assert theirs["exact_lane"].tolist() == ours[f"{row['command']}_lane"].tolist() == [0, 1]
        if row["profile"] == "native":  # nothing is seen, and no latency is drawn: equal to the last bit
            np.testing.assert_array_equal(theirs["exact_distance_m"], ours["tcsc_distance_m"])
        told = compared[tuple(row[name] for name in KEY)]
        assert (told["lanes"], told["same_end"], told["mcnemar_p"]) == (2, 2, 1.0)


def test_exact_flights_are_of_the_kernels_lanes() -> None:
    for other in ("games", "first_lane"):
        with pytest.raises(
            UserError, match=r"exact\.keys: games and first_lane must be those of evaluation\.keys"
        ):
            small(f"exact.keys.{other}=3")
    with pytest.raises(
        UserError, match=r"exact_seeds: needs .* beside an evaluation by the kernels, not by mujoco"
    ):
        small("evaluation.keys.simulator=mujoco")


def test_each_seed_trains_a_policy_of_its_own_which_flies_the_lanes_of_seed_0(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown: list[tuple[str, int, str]] = []

    def fly_at_once(run: RunDirectory, name: str, part: Part, seed: int, pages: bool) -> dict[str, Any]:
        policy = str(part.keys.get("agent", ""))
        flown.append((name.removeprefix("native-virtual-tcsc-100x-"), seed, policy[-14:]))
        folder = run.path / "parts" / name
        folder.mkdir(parents=True)
        (folder / "config.yaml").write_text("suite: any\n")
        names = (*get_type_hints(TrainingResult), *get_type_hints(EvaluationResult))
        return dict.fromkeys(names)

    monkeypatch.setattr(rl_suite, "fly_part", fly_at_once)
    monkeypatch.setattr(rl_suite, "outcomes", lambda _: {})
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
    assert [(row["seed"], "training" in row) for row in rows] == [
        (4, True),
        (5, True),
        (4, False),
        (5, False),
    ]


def test_a_run_grows_by_seeds_and_what_builds_on_trainings_waits_for_all_of_them() -> None:
    few, many = ([case.id for case in Rl().cases(small(seeds=seeds))] for seeds in (1, 2))
    assert set(few) <= set(many)
    assert set(Rl().may_grow(Path())) == {"seeds", "exact_seeds"}
    groups: list[Any] = [group for _, group in runner._groups(Rl(), Rl().cases(small(seeds=2)))]
    assert [(len(group), {Rl().stage(case) for case in group}) for group in groups] == [(12, {0}), (6, {1})]


@pytest.mark.slow
@needs_opengl
def test_a_cell_learns_from_pictures(tmp_path: Path) -> None:
    cells = "cells=[{profile: airsim, command: [tcsc], clock_speed: [5], task: {max_commands: 24}}]"
    config = configured("rl_smoke", "games=2", cells, "evaluation.keys={games: 1, task.max_commands: 12}")
    cell = run_into(tmp_path / "run", Rl(), config)["cells"][0]
    assert cell["phase_s"]["rendering"] > 0
    assert cell["training_speedup"] is None  # without the same at 1x


def test_seeds_are_outermost_and_options_choose_cells() -> None:
    def names(**options: Any) -> list[str]:
        return [case.id for case in Rl().cases(small(**options))]

    def names_of_trainings(**options: Any) -> list[str]:
        return [name for name in names(**options) if not name.endswith("-exact")]

    some = names_of_trainings(command=["adsc"], seeds=2)
    assert some == [f"airsim-virtual-adsc-{k}x-seed{seed}" for seed in (0, 1) for k in (1, 5)]
    once = "native-lockstep-tcsc-1x-seed3"
    assert names(timing="lockstep", seed=3) == [once, f"{once}-exact"]
    assert len(names()) == 12


def test_a_part_has_the_seed_of_the_run_unless_its_keys_name_another() -> None:
    for keys, seed in (({}, 3), ({"seed": 9}, 9)):
        assert part_suite(Part(experiment="evaluate", keys=keys), 3)[1].seed == seed


def test_a_dry_run_counts_games_and_one_checkpoint() -> None:
    def disk_bytes(config: Any) -> float:
        return sum(Rl().cost(config, case).disk_bytes for case in Rl().cases(config))

    config = configured("rl_session", seeds=1, clock_speed=[1.0], profile="airsim")
    assert [Rl().games(config, case) for case in Rl().cases(config)] == [
        1600,
        1600,
    ]  # each policy flies twice
    often = configured(
        "rl_session", "training.keys.checkpoint_games=500", seeds=1, clock_speed=[1.0], profile="airsim"
    )
    assert (
        disk_bytes(often) - disk_bytes(config) == 2 * 150_000 * 3 * 36 * 64
    )  # both observations of a transition


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"clock_speed": [7.0]}, r"clock_speed = 7.0 is in no cell; there are 1.0, 5.0, 100.0"),
        ({"profile": "native", "command": ["adsc"]}, "together select no cell"),
        ({"timing": "wall"}, "should be 'virtual' or 'lockstep'"),
    ],
)
def test_a_choice_that_cannot_be_is_one_clear_line(options: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        small(**options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("evaluation.keys.gamess=1", "evaluate.yaml: unknown key 'gamess'"),
        ("training.keys.environment=2", "train.yaml: unknown key 'environment'"),
        (
            "cells.2={profile: airsim, clock_speed: [5]}",
            "airsim virtual tcsc at 5x twice; give one a `variant`",
        ),
    ],
)
def test_a_part_that_cannot_be_is_refused_before_anything_is_flown(override: str, said: str) -> None:
    with pytest.raises(UserError, match=said):
        small(override)


# --- numbers ----------------------------------------------------------------------------------------------------

LANES = 40


def made(command: str, clock_speed: float, won: list[list[int]], wall_s: float) -> list[Any]:
    """A row for each seed that won those lanes; of a command three quarters of `wall_s` fly, and 0.25 s draw."""
    return [
        {
            "variant": "",
            "profile": "airsim",
            "timing": "virtual",
            "command": command,
            "clock_speed": clock_speed,
            "seed": seed,
            "case": f"{command}-{clock_speed:g}-{seed}",
            "training": {
                "games": 10,
                "successes": 4,
                "commands": 100 * (seed + 1),
                "sim_time_s": 100.0 * (seed + 1),
                "weights_sha256": "f00",
                "phase_s": {
                    phase: 100 * (seed + 1) * spent_s
                    for phase, spent_s in {
                        "simulation": 0.75 * wall_s,
                        "rendering": 0.25,
                        "image_processing": 0.001,
                        "inference": 0.002,
                        "learning": 0.007,
                    }.items()
                },
            },
            "evaluations": [flight(command, 1.0, len(lanes))],
            "lanes": lanes,
        }
        for seed, lanes in enumerate(won)
    ]


def flight(command: str, clock_speed: float, successes: int) -> dict[str, Any]:
    name = f"{command}-{clock_speed:g}x"
    return {
        "name": name,
        "command": command,
        "clock_speed": clock_speed,
        "successes": successes,
        "games": LANES,
    }


def load(row: Any) -> dict[str, np.ndarray]:
    lane = np.arange(LANES)
    won = np.isin(lane, row["lanes"])
    outcomes = {"lane": lane, "is_success": won, "distance_m": np.where(won, 150.0, 10.0 + lane)}
    return {f"{row['command']}_{name}": each for name, each in outcomes.items()}


def test_every_number_of_table_i_and_figure_9() -> None:
    rows = made("tcsc", 1.0, [list(range(30)), list(range(20))], 1.0)
    rows += made("tcsc", 5.0, [list(range(25, 35)), list(range(12))], 0.25)
    rows += made("adsc", 1.0, [list(range(9))], 0.5)
    summary = summarise({"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}, rows, load)
    assert [cell["successes"] for cell in summary["cells"]] == [30, 20, 10, 12, 9]
    assert summary["cells"][2]["distance_m_median"] == float(
        np.median([10.0 + n for n in range(40) if not 25 <= n < 35] + [150.0] * 10)
    )
    real_time, fast, adsc = summary["pooled"]
    assert (fast["successes"], fast["games"], fast["successes_by_seed"]) == (22, 80, [10, 12])
    wilson = binomtest(22, 80).proportion_ci(method="wilson")
    assert (fast["wilson_low"], fast["wilson_high"]) == (wilson.low, wilson.high)
    assert fast["fisher_p"] == pytest.approx(fisher_exact(np.array([[22, 58], [50, 30]])).pvalue)
    # Lanes 0 to 24 of seed 0 and 12 to 19 of seed 1 were won at 1x alone, 30 to 34 of seed 0 at 5x alone.
    assert fast["mcnemar_p"] == pytest.approx(binomtest(5, 5 + 25 + 8).pvalue)
    assert (fast["paper_successes"], real_time["paper_successes"]) == (30, 21)
    assert fast["permutation_p"] == pytest.approx(
        2 / 6
    )  # of six ways to share four trainings out, two are as far
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
    assert real_time["training_speedup"] == pytest.approx(0.625)
    assert adsc["training_speedup"] == 1.0
    assert real_time["fisher_p"] is real_time["permutation_p"] is None


def test_both_simulators_ends_are_paired_by_seed_and_lane() -> None:
    """The exact one flew seed 1's policy alone; the same end is a game won in both, or lost in both."""
    rows = made("tcsc", 1.0, [list(range(40)), list(range(12))], 1.0)
    (exact,) = made("tcsc", 1.0, [[*range(2, 12), 39]], 1.0)
    exact |= {"seed": 1, "case": "exact"}
    del exact["training"]

    def of_both(row: Any) -> dict[str, np.ndarray]:
        arrays = load(row)
        return (
            arrays
            if "training" in row
            else {name.replace("tcsc", EXACT): each for name, each in arrays.items()}
        )

    (found,) = summarise({"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}, [*rows, exact], of_both)[
        "exact"
    ]
    assert found["seeds"] == [1]
    assert (found["kernels"]["successes"], found["exact"]["successes"]) == (12, 11)
    assert (found["lanes"], found["same_end"]) == (40, 37)
    assert found["mcnemar_p"] == pytest.approx(binomtest(1, 3).pvalue)


def test_weights_are_the_same_where_every_clock_speed_learned_them() -> None:
    rows = (
        made("tcsc", 1.0, [[], [], []], 1.0) + made("tcsc", 5.0, [[], []], 1.0) + made("adsc", 1.0, [[]], 1.0)
    )
    rows[4]["training"]["weights_sha256"] = "other"  # of seed 1; seed 2 was not trained at 5x
    (found,) = summarise({"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}, rows, load)["same_weights"]
    assert (found["command"], found["clock_speed"]) == ("tcsc", [1.0, 5.0])
    assert (found["seeds"], found["equal"]) == ([0, 1], [0])


def test_the_interchange_test_pairs_the_same_policies_lanes() -> None:
    (row,) = made("tcsc", 1.0, [list(range(30))], 1.0)
    row["evaluations"].append(flight("adsc", 1.0, 24))

    def both(row: Any) -> dict[str, np.ndarray]:
        adsc = load({"command": "adsc", "lanes": range(10, 34)})
        return load(row) | adsc

    summary = summarise({"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}, [row], both)
    (test,) = summary["interchange"]
    assert [flown["successes"] for flown in test["flown_with"]] == [30, 24]
    assert (test["only_first"], test["only_second"]) == (10, 4)
    assert test["mcnemar_p"] == pytest.approx(binomtest(4, 14).pvalue)


def test_a_variant_is_held_against_the_plain_training_on_the_same_lanes() -> None:
    plain, told = (made("adsc", 5.0, [list(range(count))], 0.25)[0] for count in (20, 32))
    told |= {"variant": "told", "case": "told"}
    for row, count in ((plain, 4), (told, 15)):
        row["evaluations"].append(flight("adsc", 5.0, count))

    def both(row: Any) -> dict[str, np.ndarray]:
        fast = load({"command": "adsc", "lanes": range(row["evaluations"][-1]["successes"])})
        return load(row) | {name.replace("adsc", "adsc-5x"): each for name, each in fast.items()}

    config = {"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}
    without, within = summarise(config, [plain, told], both)["as_trained"]
    assert without["as_trained"]["mcnemar_p"] is None
    assert (within["real_time"]["successes"], within["as_trained"]["successes"]) == (32, 15)
    assert within["real_time"]["mcnemar_p"] == pytest.approx(binomtest(0, 12).pvalue)
    assert within["as_trained"]["mcnemar_p"] == pytest.approx(binomtest(0, 11).pvalue)
    assert within["as_trained"]["fisher_p"] == pytest.approx(
        fisher_exact(np.array([[15, 25], [4, 36]])).pvalue
    )
    plain["evaluations"].pop()  # flown in real time alone: a variant's two flights have nothing beside them
    (alone,) = summarise(config, [plain, told], both)["as_trained"]
    assert alone["real_time"]["mcnemar_p"] is alone["as_trained"]["mcnemar_p"] is None


def test_times_of_a_figure_are_means_of_the_seeds_and_rendering_is_of_simulation() -> None:
    rows = made("tcsc", 1.0, [[0], [1]], 1.0)
    (cell,) = summarise({"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}, rows, load)["pooled"]
    bars = plot_training_time({"TCSC": {1.0: cell}}, "modelled").axes[0].containers
    minutes = {str(bar.get_label()): bar[0].get_height() for bar in cast(Any, bars)}
    assert minutes == pytest.approx({
        "simulation (with rendering)": 2.5, "image processing": 0.0025, "inference": 0.005, "learning": 0.0175,
    })  # fmt: skip


def test_success_that_no_seed_varies_has_the_width_of_the_games() -> None:
    rows = made("adsc", 5.0, [[], [], []], 0.25) + made("tcsc", 5.0, [list(range(LANES))] * 3, 0.25)
    cells = summarise({"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}, rows, load)["pooled"]
    for cell, successes in zip(cells, (0, 3 * LANES), strict=True):
        wilson = binomtest(successes, 3 * LANES).proportion_ci(method="wilson")
        assert (cell["seeds_low"], cell["seeds_high"]) == (wilson.low, wilson.high)
        assert cell["seeds_low"] < cell["seeds_high"]


@pytest.mark.parametrize(
    ("clock_speed", "wall_s", "gap"),
    [
        (5.0, 0.4, 0.55),  # .3 s of flight and .01 s beside it pass at 5x: 1.55 s; the pictures' .25 s stand
        (5.0, 0.1, 0.0),  # commands that collisions end early
        (100.0, 0.04, 0.04 * 200 / 3 - 1.0),  # a tick of 3 ms takes 45 us: no more than 66.7x
    ],
)
def test_the_gap_is_what_passes_beyond_t_move_while_the_clock_runs(
    clock_speed: float, wall_s: float, gap: float
) -> None:
    rows = made("adsc", clock_speed, [[0], [1]], wall_s)
    assert gap_s(rows) == pytest.approx(gap)
    (cell,) = summarise({"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}, rows, load)["pooled"]
    assert cell["gap_s"] == gap_s(rows)
    assert gap_s(made("tcsc", clock_speed, [[0]], wall_s)) == 0.0  # its clock is paused


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
    assert [(line.label, [cell["gap_s"] for cell in line.cells]) for line in lines] == [
        ("ADSC, airsim", sorted(won)),
        ("TCSC, airsim", [0.0] * 3),
    ]
    assert collapse(lines) == (
        "ADSC, airsim: success in real time stays below half of the best cell's 96.0% from a gap of 0.40 simulated "
        "seconds on."
    )


def test_where_no_gap_breaks_a_policy_the_report_says_so() -> None:
    cells = [thought("adsc", f"hard_think_{n}ms", n / 10, 60 - n) for n in range(3)]
    (line,) = over_gaps(cells)
    said = (
        "ADSC, airsim, hard: no gap was flown, up to 0.20 s, from which success in real time stays below half of the "
        "best cell's 60.0%."
    )
    assert collapse([line]) == said
    easier = over_gaps(
        [thought("adsc", f"think_{n}ms", n / 10, 100) for n in range(3)]
    )  # another lane's best
    assert collapse([line, *easier]).startswith(said)
    assert over_gaps(cells[:2]) == []
    ended = GapLine("adsc", "airsim, hard", [*cells[:2], thought("adsc", "hard_think_9ms", 0.1, 3), cells[2]])
    assert "no gap was flown" in collapse([ended])


@pytest.mark.parametrize(("experiment", "cells"), [("rl_collapse", 65), ("rl_latency", 15)])
def test_the_shipped_maps_of_gaps_can_be_trained_and_flown(experiment: str, cells: int) -> None:
    config = configured(experiment, "seeds=1")
    Rl().check(config)
    assert len(list(cases(config))) == cells


def test_the_headline_tells_success_after_the_slowest_and_the_fastest_training() -> None:
    """Of trainings without a variant; where there are none, the gap at which policies fail."""
    plain = [
        thought(command, "", gap, won) | {"clock_speed": clock_speed}
        for command, clock_speed, gap, won in (
            *(
                ("tcsc", 1.0, 0.0, 21),
                ("adsc", 100.0, 9.0, 0),
                ("adsc", 5.0, 0.4, 64),
                ("adsc", 1.0, 0.1, 23),
            ),
        )
    ]
    told_of = [thought("adsc", f"think_{n}ms", n / 10, 96 >> n) for n in range(3)]
    summary = {
        "cells": [{"games": 200}, {"games": 100}, {"games": 100}],
        "training_games": 5000,
        "evaluation_clock_speed": 2.0,
    }
    rest = (
        "3 trainings of 5000 games, each policy flown on 100, 200 lanes at 2x; "
        "all times are modelled but those of this machine"
    )
    told: Any = SimpleNamespace(summary={**summary, "pooled": [*plain, *told_of]})
    assert RlReport.headline(told) == (
        "TCSC, airsim: 21.0% after training at 1x; "
        f"ADSC, airsim: 23.0% after training at 1x, 0.0% after training at 100x; {rest}"
    )
    told.summary["pooled"] = told_of
    assert RlReport.headline(told) == (
        "ADSC, airsim: success in real time stays below half of the best cell's 96.0% from a gap of 0.20 simulated "
        f"seconds on; {rest}"
    )
    told.summary["pooled"] = told_of[:1]
    assert RlReport.headline(told) == rest


def test_the_display_tells_the_last_trainings_games_in_real_time() -> None:
    first, last = (
        {"case": case, "evaluations": [flight("tcsc", 1.0, won), flight("adsc", 1.0, won + 1)]}
        for case, won in (("one", 30), ("two", 20))
    )
    assert Rl().status([first, last]) == "two won 20 of 40"


def table_below(page: str, heading: str) -> list[dict[str, str]]:
    """The first table after a heading of a report.md: a line each, its cells by their columns' names, in order."""
    lines = [line for line in page.split(f"## {heading}\n")[1].split("## ")[0].splitlines() if "|" in line]
    columns, _, *cells = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines)
    numbered = [f"{column} ({columns[:n].count(column) + 1})" for n, column in enumerate(columns)]
    return [dict(zip(numbered, line, strict=True)) for line in cells]


@pytest.mark.usefixtures("without_figures")
def test_the_report_tells_each_number_in_its_column(tmp_path: Path) -> None:
    """Hours of hours, minutes of minutes, the test over seeds and McNemar's each in its own."""
    run = RunDirectory.create(tmp_path / "run", small(), {})
    rows = made("tcsc", 1.0, [list(range(30)), list(range(20))], 3600.0)
    rows += made("tcsc", 5.0, [list(range(25, 35)), list(range(12))], 900.0)
    rows += made("adsc", 1.0, [list(range(9))], 1800.0)
    for number, row in enumerate(rows):
        row["training"]["phase_s"]["learning"] = 400.0 * row["training"]["commands"]
        run.append_row({"suite": "rl"} | row | run.save_arrays(row["case"], load(row)))
        run.append_timing({"case": row["case"], "training_s": 60.0 * (number + 1)})
    report = Rl().report(run)
    report.write()
    page = (run.path / "report.md").read_text(encoding="utf-8")
    _, fast, _ = table_below(page, "Table I: success by training")
    mcnemar = binomtest(5, 5 + 25 + 8).pvalue
    low, high = (100 * report.summary["pooled"][1][end] for end in ("seeds_low", "seeds_high"))
    assert list(fast.values())[3:] == [
        "22 of 80", f"27.5% [{low:.1f}, {high:.1f}]", "10, 12", "30", "0.33", f"{mcnemar:.2g}",
    ]  # fmt: skip
    assert [name.split(" (")[0] for name in fast][-2:] == [
        "p against 1x, over seeds",
        "of these policies: McNemar",
    ]
    _, fast, _ = table_below(page, "Time of the training")
    slow_s, fast_s, beside_s = 0.75 * 1800 + 0.25, 0.75 * 900 + 0.25, 400.003
    assert list(fast.values())[1:] == [
        "5x", "2", f"{300 * (fast_s + beside_s) / 3600:.3g}", f"{300 * (slow_s + beside_s) / 3600:.3g}",
        f"{slow_s / fast_s:.3g}x", "4x", f"{(slow_s + beside_s) / (fast_s + beside_s):.3g}x", "3.6x", "7",
    ]  # fmt: skip
    shown = report.overview()
    assert shown is not None
    assert shown.rows[1][-1] == f"{slow_s / fast_s:.3g}x"
    hours = 700 * (slow_s + beside_s) / 3600
    assert f"These trainings' 50 games would have taken {hours:.3g} hours in real time" in page
    assert f"{3600 * hours / 50:.0f} s per game" in page
    assert f"took 0.25 hours of training, measured, one after another: {hours * 4:.0f} times less" in page


def variant_and_plain() -> tuple[list[Any], dict[str, dict[str, np.ndarray]]]:
    """Two seeds of TCSC at 5x with a variant and without, and the exact flights of the variant's first seed.

    Rows, and the arrays of each: the lanes that are won with either command, in real time and at 5x.
    """
    flights_of_each = (("tcsc", 1.0), ("adsc", 1.0), ("tcsc", 5.0), ("adsc", 5.0))
    won: dict[tuple[str, int], tuple[range, ...]] = {
        ("told", 0): (range(30), range(10, 34), range(12), range(8, 14)),
        ("told", 1): (range(20), range(20), range(10), range(4)),
        ("", 0): (range(10), range(10), range(12), range(12)),
        ("", 1): (range(5), range(5), range(10), range(10)),
    }
    rows, arrays = [], {}
    for (variant, seed), lanes in won.items():
        row = made("tcsc", 5.0, [[], []], 0.25)[seed] | {"variant": variant, "case": f"{variant}{seed}"}
        row["evaluations"] = [
            flight(*each, len(some)) for each, some in zip(flights_of_each, lanes, strict=True)
        ]
        row["training"] |= {"successes": 3 + seed, "weights_sha256": f"{variant}{seed}"}
        rows.append(row)
        arrays[row["case"]] = outcomes_of(
            dict(zip(("tcsc", "adsc", "tcsc-5x", "adsc-5x"), lanes, strict=True))
        )
    exact = {key: value for key, value in rows[0].items() if key != "training"}
    rows.append(exact | {"case": "told0-exact", "evaluations": [flight("tcsc", 1.0, 28)]})
    arrays["told0-exact"] = outcomes_of({"exact": range(4, 32)})
    return rows, arrays


def outcomes_of(won: dict[str, Any]) -> dict[str, np.ndarray]:
    loaded = (load({"command": name, "lanes": lanes}) for name, lanes in won.items())
    return {name: each for flown in loaded for name, each in flown.items()}


def page_of(path: Path, rows: list[Any], arrays: dict[str, dict[str, np.ndarray]]) -> str:
    run = RunDirectory.create(path, small(), {})
    for row in rows:
        run.append_row({"suite": "rl"} | row | run.save_arrays(row["case"], arrays[row["case"]]))
    Rl().report(run).write()
    return (path / "report.md").read_text(encoding="utf-8")


def of_wilson(successes: int, games: int) -> str:
    interval = binomtest(successes, games).proportion_ci(method="wilson")
    ends = f"[{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
    return f"{successes} of {games}: {successes / games:.1%} {ends}"


@pytest.mark.usefixtures("without_figures")
def test_each_flight_of_a_policy_is_told_in_its_line_and_column(tmp_path: Path) -> None:
    """Student's t of two trainings is 12.7 at 95 %: of 30 % and 25 % that makes 27.5 % and up to 31.8 % more."""
    page = page_of(tmp_path / "run", *variant_and_plain())
    real_time, fast = "62.5% [0.0, 100.0]", "27.5% [0.0, 59.3]"
    slow_p, fast_p = f"{binomtest(4, 14).pvalue:.2g}", f"{binomtest(2, 16).pvalue:.2g}"
    told = ("TCSC, airsim, told 5x", "0, 1")
    shown = [tuple(line.values()) for line in table_below(page, "Commands interchanged")]
    assert [line for line in shown if line[0] == told[0]] == [
        (*told, "TCSC 1x", real_time, "10", "1", slow_p),
        (*told, "ADSC 1x", "55.0% [0.0, 100.0]", "4", "1", slow_p),
        (*told, "TCSC 5x", fast, "14", "0.5", fast_p),
        (*told, "ADSC 5x", "12.5% [0.0, 44.3]", "2", "0.5", fast_p),
    ]
    told = ("TCSC, airsim, told", "5x")
    variant, plain = (
        tuple(line.values()) for line in table_below(page, "Flown at the ClockSpeed of the training")
    )
    assert variant == (*told, "0, 1", real_time, "0.33", fast, "1", "0.5")
    assert (plain[0], plain[4], plain[6]) == ("TCSC, airsim", "-", "-")
    exact = table_below(page, "The same policies in the exact simulator")
    assert [tuple(line.values()) for line in exact] == [
        (*told, "0", of_wilson(30, 40), of_wilson(28, 40), "34 of 40", f"{binomtest(2, 6).pvalue:.2g}"),
    ]
    assert "Of 40 flights of a policy over a lane in real time 34 end alike in both" in page
    assert [tuple(line.values()) for line in table_below(page, "Each training")] == [
        (*told, "0", "3 of 10", of_wilson(30, 40), "told0"),
        (*told, "1", "4 of 10", of_wilson(20, 40), "told1"),
        ("TCSC, airsim", "5x", "0", "3 of 10", of_wilson(10, 40), "0"),
        ("TCSC, airsim", "5x", "1", "4 of 10", of_wilson(5, 40), "1"),
    ]


@pytest.mark.usefixtures("without_figures")
def test_the_report_counts_the_seeds_that_learned_the_same_weights(tmp_path: Path) -> None:
    rows = made("tcsc", 1.0, [[]] * 3, 1.0) + made("tcsc", 5.0, [[]] * 3, 1.0)
    for row in rows[4:]:
        row["training"]["weights_sha256"] = "other"
    page = page_of(tmp_path / "run", rows, {row["case"]: load(row) for row in rows})
    assert "TCSC, airsim: of 3 seeds 1 learned the same weights at 1x, 5x: 2 learned others." in page


def test_merged_runs_have_the_seeds_from_the_first_to_the_last_of_all(tmp_path: Path) -> None:
    options: dict[str, Any] = {
        "early": {"seed": 2, "seeds": 2, "command": ["tcsc"]},
        "late": {"seed": 7, "seeds": 3, "command": ["adsc"]},
    }
    runs = [RunDirectory.create(tmp_path / name, small(**each), {}) for name, each in options.items()]
    rows = made("tcsc", 1.0, [[3]], 1.0) + made("adsc", 1.0, [[5, 6]], 1.0)
    for run, row, took_s in zip(runs, rows, (4.0, 9.0), strict=True):
        run.append_row(row | run.save_arrays(row["case"], load(row)))
        run.append_timing({"case": row["case"], "training_s": took_s})
    for first, second in (runs, runs[::-1]):
        merged = merge_runs([first, second])
        config = merged.config()
        assert (config["seed"], config["seeds"], config["command"]) == (2, 8, [])
        won = {row["case"]: merged.load_arrays(row)[f"{row['command']}_is_success"] for row in merged.rows()}
        assert {case: int(each.sum()) for case, each in won.items()} == {"tcsc-1-0": 1, "adsc-1-0": 2}
        took = {entry["case"]: entry["training_s"] for entry in merged.timings()}
        assert took == {"tcsc-1-0": 4.0, "adsc-1-0": 9.0}


def test_claims_take_the_plain_trainings_of_their_profile_on_the_virtual_clock(tmp_path: Path) -> None:
    """Games that were lost ended on the way: at 10 m in the first lane, and a metre further in each."""
    rows = made("tcsc", 1.0, [[*range(39)], [*range(38)]], 1.0)
    rows += made("tcsc", 5.0, [[]], 1.0) + made("adsc", 1.0, [[]], 1.0)
    others: list[dict[str, Any]] = [{"variant": "told"}, {"profile": "native"}, {"timing": "lockstep"}]
    rows += [made("tcsc", 1.0, [[]], 1.0)[0] | other for other in others]
    run = RunDirectory.create(tmp_path / "run", small(), {})
    for number, row in enumerate(rows):
        other = "adsc" if row["command"] == "tcsc" else "tcsc"
        row["evaluations"].append(flight(other, 1.0, len(row["lanes"]) // 2))
        row["case"] = f"case{number}"
        run.append_row(
            row | run.save_arrays(row["case"], outcomes_of(dict.fromkeys(("tcsc", "adsc"), row["lanes"])))
        )
    config = {"seed": 0, "games": 10, "evaluation_clock_speed": 1.0}
    run.write_json("summary.json", summarise(config, cast(Any, run.rows()), run.load_arrays))
    found = Policies.of(run, "airsim")
    kinds = [(cell["command"], cell["clock_speed"], cell["seed"], cell["successes"]) for cell in found.cells]
    assert kinds == [("tcsc", 1.0, 0, 39), ("tcsc", 1.0, 1, 38), ("tcsc", 5.0, 0, 0), ("adsc", 1.0, 0, 0)]
    (flown,) = found.interchange
    assert [(each["command"], each["successes"]) for each in flown["flown_with"]] == [
        ("tcsc", 77),
        ("adsc", 38),
    ]
    lost_m = {key: each.tolist() for key, each in found.ended_m.items()}
    assert lost_m["tcsc", 1.0] == [49.0, 48.0, 49.0]
    assert lost_m["tcsc", 5.0] == lost_m["adsc", 1.0] == [10.0 + lane for lane in range(LANES)]


def test_what_a_decision_takes_it_takes_in_evaluations_too() -> None:
    cells = "cells=[{profile: airsim, clock_speed: [5], training: {inference_s: 0.03, learning_s: 0.5}}]"
    config = small(cells)
    for cell in cases(config):
        learned = part_suite(training_part(config, cell), 0)[1]
        assert (learned.inference_s, learned.learning_s) == (0.03, 0.5)  # type: ignore[attr-defined]
        flown = part_suite(evaluation_part(config, cell, flights(config, cell)[0], DEFAULT), 0)[1]
        assert flown.inference_s == 0.03  # type: ignore[attr-defined]


# --- reports ----------------------------------------------------------------------------------------------------


def half(whole: RunDirectory, path: Path, **options: Any) -> RunDirectory:
    """What a run of some of the cells alone would have left."""
    run, names = (
        RunDirectory.create(path, small(**options), {}),
        [case.id for case in Rl().cases(small(**options))],
    )
    for row in whole.rows():
        if row["case"] in names:
            run.save_arrays(row["case"], whole.load_arrays(row))
            run.append_row(row)
    return run


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """The run `whole` draws them."""
    monkeypatch.setattr(RlReport, "figures", lambda _: [])


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_two_runs_merge_runs_are_the_one_that_flew_all(tmp_path: Path, whole: RunDirectory) -> None:
    runs = [half(whole, tmp_path / name, command=[name]) for name in ("adsc", "tcsc")]
    assert Rl().compare(runs) == [tmp_path / "adsc/merged/report.html"]
    merged, one = (run.read_json("summary.json") for run in (RunDirectory(tmp_path / "adsc/merged"), whole))
    for name in ("cells", "pooled", "interchange", "exact", "same_weights"):
        assert sorted(merged[name], key=str) == sorted(one[name], key=str)
    with pytest.raises(UserError, match=r"has airsim-virtual-adsc-1x-seed0, which .* has too"):
        Rl().compare([runs[0], runs[0]])
    other = RunDirectory.create(tmp_path / "other", small("games=4"), {})
    with pytest.raises(UserError, match="other: games differs"):
        Rl().compare([runs[0], other])


@pytest.mark.slow
def test_the_claims_of_section_iv_d_read_a_run(whole: RunDirectory) -> None:
    airsim, native = (Policies.of(whole, profile) for profile in ("airsim", "native"))
    with pytest.raises(Undecided, match="2 games of ADSC at 5x, at least 100 are needed"):
        policy_claims.adsc_collapses_at_5x(airsim)
    with pytest.raises(Undecided, match="3 training games of TCSC at 5x"):
        policy_claims.training_speedup_5x(airsim)
    with pytest.raises(NoEvidence, match="tcsc at 10x was not flown"):
        policy_claims.tcsc_preserved_at_10x(airsim)
    assert native.clocks("tcsc") == [100.0]  # the lockstep training is none of them
    (flown,) = airsim.interchange
    assert [(each["command"], each["games"]) for each in flown["flown_with"]] == [("tcsc", 2), ("adsc", 2)]
    for row in trainings(whole):
        if (row["profile"], row["command"], row["clock_speed"]) == ("airsim", "tcsc", 5.0):
            arrays = whole.load_arrays(row)
            ended_m = arrays["tcsc_distance_m"][~arrays["tcsc_is_success"]]
            assert airsim.ended_m["tcsc", 5.0].tolist() == ended_m.tolist() != []


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
        gpu.take_gpu("cuda")
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
def test_without_a_choice_of_gpus_nothing_is_touched(
    device: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.device_count", lambda: count)
    monkeypatch.setattr(gpu, "_place", None)
    monkeypatch.delenv(gpu.VISIBLE, raising=False)
    gpu.take_gpu(device)
    assert gpu.VISIBLE not in os.environ
