"""The RL experiment: cells that a kill does not change, Table I's numbers by hand, figures."""

from __future__ import annotations

import os
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from matplotlib.figure import Figure

from tests import made_runs as made
from tests.opengl import needs_opengl
from tests.running import configured, run_into, stopped_at
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites import parts
from uavaccel.suites.grid import Sweep
from uavaccel.suites.parts import Part
from uavaccel.suites.rl import Rl, RlConfig, collapse, draw_variants, over_gaps, parts_of

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
FLIGHTS = ("evaluation-tcsc", "evaluation-adsc", "evaluation-exact")
PARTS = ("training/rows.jsonl", "training/policy.pt", *(f"{flight}/rows.jsonl" for flight in FLIGHTS))
OTHER = {"adsc": "tcsc", "tcsc": "adsc"}


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


@pytest.mark.slow
def test_interrupted_and_moved_it_ends_with_equal_bytes(tmp_path: Path, whole: RunDirectory) -> None:
    """In the second cell's training, of whose games two have a row, and in a flight of its policy."""
    config, second = small(clock_speed=[1.0], profile="airsim"), tmp_path / "run/parts/airsim-virtual-adsc-1x-seed0"
    for place, case in ((second / "training", "game-0000002"), (second / "evaluation-adsc", "lane-000001")):
        with stopped_at(lambda run, row, at=(place, case): (run.path, row["case"]) == at):  # type: ignore[misc]
            run_into(tmp_path / "run", Rl(), config, resume=True)
        assert len(RunDirectory(tmp_path / "run").rows()) == 1
    moved = (tmp_path / "run").rename(tmp_path / "moved")  # the evaluation names its policy by where it was
    run_into(moved, Rl(), config, resume=True)

    rows = RunDirectory(moved).rows()
    assert rows == [row for row in whole.rows() if row["case"].startswith("airsim") and row["clock_speed"] == 1.0]
    assert [row["case"].endswith("-exact") for row in rows] == [False, False, True, True]
    for row in rows:
        folder = f"parts/{row['case'].removesuffix('-exact')}"
        for name in (row["arrays"], *(f"{folder}/{part}" for part in PARTS)):
            assert (moved / name).read_bytes() == (whole.path / name).read_bytes()
    assert not [*moved.glob("parts/*/training/checkpoints"), *moved.glob("parts/**/*.png")]
    starts = [RunDirectory(path.parent).manifest() for path in moved.glob("parts/**/manifest.json")]
    again = [start for first in starts for start in first.get("resumed", [])]
    assert again, "a part that was stopped"
    assert not any("resumed" in start for start in again), "none has the starts of the whole for its own"


@pytest.mark.slow
def test_policies_fly_in_real_time_as_they_were_trained(whole: RunDirectory) -> None:
    """The lanes of seed 0; with the other command, and in the exact simulator."""
    weights: dict[str, str] = {}
    for row in whole.rows():
        exact, policy = row["case"].endswith("-exact"), row["case"].removesuffix("-exact")
        commands = [row["command"]] if exact else [row["command"], OTHER[row["command"]]]
        assert [flown["command"] for flown in row["evaluations"]] == commands
        weights[policy] = weights.get(policy) or row["training"]["weights_sha256"]
        for flown in row["evaluations"]:
            flight = "exact" if exact else flown["command"]
            part, arrays = RunDirectory(whole.path / "parts" / policy / f"evaluation-{flight}"), whole.load_arrays(row)
            assert (flown["clock_speed"], flown["games"], part.config()["seed"]) == (1.0, 2, 0)
            assert flown["simulator"] == ("mujoco" if exact else "kernels")
            assert [part.config()["task"][key] for key in ("timing", "profile")] == [row["timing"], row["profile"]]
            for key in ("distance_m", "lane", "is_success"):
                assert arrays[f"{flight}_{key}"].tolist() == [game[key] for game in part.rows()]
    assert weights["native-virtual-tcsc-100x-seed0"] == weights["native-lockstep-tcsc-1x-seed0"]
    assert weights["airsim-virtual-adsc-1x-seed0"] != weights["airsim-virtual-adsc-5x-seed0"]


@pytest.mark.parametrize(
    ("overrides", "flown"),
    [
        ((), "adsc at 1, tcsc at 1, exact: adsc at 1"),
        (("interchange=false", "as_trained=true"), "adsc at 1, adsc-5x: adsc at 5, exact: adsc at 1"),
        (("as_trained=true", "exact_seeds=0"), "adsc at 1, tcsc at 1, adsc-5x: adsc at 5, tcsc-5x: tcsc at 5"),
    ],
)
def test_a_policy_is_flown_with_the_other_command_too(overrides: Any, flown: str) -> None:
    """A decision takes its time in evaluations too; the lanes are of seed 0, and the policy keeps its own senses."""
    keys = "training: {inference_s: 0.03, learning_s: 0.5}, task: {t_move_s: .8, difficulty.wind_m_s: 3.0}"
    config = small(f"cells=[{{profile: airsim, clock_speed: [5], {keys}}}]", *overrides, command=["adsc"], seed=4)
    found = []
    for case in Rl().cases(config):
        for name, (part, seed) in parts_of(config, case).items():
            trained, made = name == "training", part.resolve(seed)[1].model_dump()
            assert (made["inference_s"], made["task"]["difficulty"]["wind_m_s"]) == (0.03, 3.0)
            assert (made["task"]["t_move_s"], "learning_s" in part.keys) == ((0.8, True) if trained else (1.0, False))
            assert (seed, part.keys.get("agent")) == ((4, None) if trained else (0, "default"))
            flight, clock = name.removeprefix("evaluation-"), f"at {part.keys['task.clock_speed']:g}"
            of = "" if flight == part.keys["task.command"] else f"{flight}: "
            found += [] if trained else [f"{of}{part.keys['task.command']} {clock}"]
    assert ", ".join(found) == flown


def test_seeds_are_outermost_and_options_choose_cells() -> None:
    """A run grows by seeds; what builds on trainings waits for all of them."""

    def names(**options: Any) -> list[str]:
        return [case.id for case in Rl().cases(small(**options))]

    some = [name for name in names(command=["adsc"], seeds=2) if not name.endswith("-exact")]
    assert some == [f"airsim-virtual-adsc-{k}x-seed{seed}" for seed in (0, 1) for k in (1, 5)]
    once = "native-lockstep-tcsc-1x-seed3"
    assert names(timing="lockstep", seed=3) == [once, f"{once}-exact"]
    assert {name.split("-")[0] for name in names(profile="native")} == {"native"}
    few, many = names(), names(seeds=2)
    assert [name[-1] for name in many[:12]] == ["0"] * 6 + ["1"] * 6
    assert (len(few), set(few) <= set(many), set(Rl.grows)) == (12, True, {"seeds", "exact_seeds"})
    more_exact = small("exact_seeds=3")  # of policies that there are
    assert [case.exact for case in Rl().cases(more_exact)] == [False] * 6 + [True] * 6
    stages = [(Rl().stage(case), case.exact) for case in Rl().cases(small(seeds=2))]
    assert [exact for _, exact in stages] == [False] * 12 + [True] * 6
    assert len(set(stages)) == 2  # all exact ones are a stage of their own, after the others


@pytest.mark.parametrize(
    ("experiment", "options", "games"),
    [
        ("rl_session", {"clock_speed": [1.0], "profile": "airsim"}, [1600, 1600]),  # each policy flies twice
        ("rl_collapse", {}, 65),
        ("rl_latency", {}, 15),
    ],
)
def test_shipped_experiments_count_the_games_of_all_parts(experiment: str, options: dict[str, Any], games: Any) -> None:
    config = configured(experiment, "seeds=1", **options)  # which checks it
    found = [Rl().games(config, case) for case in Rl().cases(config)]
    assert games in (found, len(found))
    for keys, seed in (({}, 3), ({"seed": 9}, 9)):
        assert Part(experiment="evaluate", keys=keys).resolve(3)[1].seed == seed


@pytest.mark.slow
@needs_opengl
def test_a_cell_learns_from_pictures(tmp_path: Path) -> None:
    cells = "cells=[{profile: airsim, command: [tcsc], clock_speed: [5], task: {max_commands: 24}}]"
    config = configured("rl_smoke", "games=2", cells, "evaluation.keys={games: 1, task.max_commands: 12}")
    assert Rl().renders(config)
    assert run_into(tmp_path / "run", Rl(), config)["cells"][0]["phase_s"]["rendering"] > 0


@pytest.mark.parametrize(
    ("overrides", "options", "said"),
    [
        ([], {"clock_speed": [7.0]}, r"clock_speed = 7.0 is in no cell; there are 1.0, 5.0, 100.0"),
        ([], {"profile": "native", "command": ["adsc"]}, "together select no cell"),
        ([], {"timing": "wall"}, "should be 'virtual' or 'lockstep'"),
        (["evaluation.keys.gamess=1"], {}, "^part evaluate.yaml: unknown key 'gamess'"),
        (["training.keys.environment=2"], {}, "train.yaml: unknown key 'environment'"),
        (["cells.2={profile: airsim, clock_speed: [5]}"], {}, "airsim virtual tcsc at 5x twice; give one a `variant`"),
        (["exact.keys.games=3"], {}, r"exact\.keys: games, first_lane and task\.split must be those of evaluation"),
        (["exact.keys.first_lane=3"], {}, r"exact\.keys: games, first_lane and task\.split must be those"),
        (["exact.keys.task.split=test"], {}, r"exact\.keys: games, first_lane and task\.split must be those"),
        (["evaluation.keys.simulator=mujoco"], {}, r"evaluation\.keys\.simulator = mujoco: exact_seeds needs kernels"),
        (["exact.keys.simulator=kernels"], {}, r"exact\.keys\.simulator = kernels: exact_seeds needs mujoco"),
    ],
)
def test_cells_that_cannot_be_are_one_clear_line(overrides: list[str], options: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        small(*overrides, **options)
    assert "\n" not in str(caught.value)


# --- numbers ----------------------------------------------------------------------------------------------------

STAYS = "success in real time stays below half of the best cell's"


def thought(command: str, variant: str, gap: float, won: int, **keys: Any) -> dict[str, Any]:
    """A pooled cell of 100 games."""
    conditions = {"variant": variant, "profile": "airsim", "timing": "virtual", "command": command, "clock_speed": 5.0}
    return {**conditions, "gap_s": gap, "success_ratio": won / 100, **keys}


def test_the_gap_of_collapse_is_one_without_recovery() -> None:
    """.2 s, where it fails but .3 s does not, is no collapse; half of the best is none either."""
    won = {0.0: 80, 0.1: 96, 0.2: 30, 0.3: 48, 0.4: 47, 0.9: 2}
    cells = [thought("adsc", f"think_{1000 * gap:.0f}ms", gap, count) for gap, count in reversed(won.items())]
    cells += [thought("tcsc", f"think_{n}ms", 0.0, 90) for n in range(3)]  # one gap: nothing to be said of it
    cells.append(thought("adsc", "plain_dqn", 0.2, 1))  # a cell alone is no line
    cells.append(thought("adsc", "", 0.9, 99, timing="lockstep"))  # which has no clock
    lines = over_gaps(cells)
    found = {label: line.gap_s.tolist() for label, line in lines.items()}
    assert found == {"ADSC, airsim": sorted(won), "TCSC, airsim": [0.0] * 3}
    assert collapse(lines) == f"ADSC, airsim: {STAYS} 96.0% from a gap of 0.40 simulated seconds on."
    hard = [thought("adsc", f"hard_think_{n}ms", n / 10, 60 - n) for n in range(3)]
    said = f"ADSC, airsim, hard: no gap was flown, up to 0.20 s, from which {STAYS} 60.0%."
    assert collapse(over_gaps(hard)) == said
    assert said in collapse(over_gaps([*hard, *cells]))  # another lane's best is none of this one's
    assert over_gaps(hard[:2]) == {}
    failing = thought("adsc", "hard_think_9ms", 0.1, 3)  # at a gap at which another cell does not
    assert "no gap was flown" in collapse(over_gaps([*hard, failing]))


def test_the_headline_tells_slowest_and_fastest_training(tmp_path: Path) -> None:
    """Of trainings without a variant; where there are none, the gap at which policies fail."""
    report = made.rl(tmp_path / "run", rows := made.rl_rows("tcsc", 1.0, [range(30), range(20)]))
    clocks = (("tcsc", 1.0, 0.0, 21), ("adsc", 100.0, 9.0, 0), ("adsc", 5.0, 0.4, 64), ("adsc", 1.0, 0.1, 23))
    plain = [thought(command, "", gap, won, clock_speed=clock_speed) for command, clock_speed, gap, won in clocks]
    told = [thought("adsc", f"think_{n}ms", n / 10, 96 >> n) for n in range(3)]
    at_1x, at_100x = "23.0% after training at 1x", "0.0% after training at 100x"
    for pooled, begin in (
        ([*plain, *told], f"TCSC, airsim wins 21.0% after training at 1x; ADSC, airsim wins {at_1x} and {at_100x}"),
        (told, f"ADSC, airsim: {STAYS} 96.0% from a gap of 0.20 simulated seconds on"),
        (told[:1], "Variants alone win 96.0%"),
    ):
        cells = [{"games": games} for games in (200, 100, 100)]
        report.summary = {"cells": cells, "training_games": 5000, "evaluation_clock_speed": 2.0, "pooled": pooled}
        assert report.headline() == begin
        told_of = "modelled, but for the times of this machine · 3 trainings of 5000 games"
        assert Rl().source(report) == f"{told_of}, each policy flown on 100, 200 lanes at 2x · seed 0, 1"
    assert Rl().status(rows) == f"{rows[1]['case']} won 20 of 40"


def test_variants_are_compared_by_common_seeds_and_drawn_apart(tmp_path: Path) -> None:
    """One seed of three has a plain training; the profiles have a line each that differs from the other."""
    rows: list[Any] = []
    for profile, clock in product(("airsim", "native"), (1.0, 9.0)):
        rows += made.rl_rows("adsc", clock, [range(40), range(4), []], variant="told", profile=profile)
        rows += made.rl_rows("adsc", clock, [range(30)], profile=profile)
    variants = made.rl(tmp_path / "run", rows).summary["variants"]
    for cell in variants:
        assert (cell["seeds"], cell["games"], cell["success_ratio"]) == ([0], 40, 1.0)
        assert cell["difference"]["value"] == cell["success_ratio"] - cell["plain"]["success_ratio"] == 0.25
    draw_variants(axes := Figure().add_subplot(), pd.DataFrame(variants))
    looks = {line.get_label(): line.get_linestyle() for line in axes.lines}
    assert looks.items() >= {"ADSC, airsim": "-", "ADSC, native": "--"}.items()


def taken(device: str, gpus: int, monkeypatch: pytest.MonkeyPatch, **given: str) -> list[str | None]:
    """What a new process takes, `given` an environment: GPU, renderer, and its share of five cores."""
    cores: list[set[int]] = []
    monkeypatch.setattr("torch.cuda.device_count", lambda: gpus)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3, 4}, raising=False)
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, share: cores.append(set(share)), raising=False)
    monkeypatch.setattr(parts, "_place", None)
    for name in (parts.VISIBLE, parts.EGL_DEVICE):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    parts.acquire_gpu(device)
    return [os.environ.get(parts.VISIBLE), os.environ.get(parts.EGL_DEVICE), *map(str, cores)]


def test_each_process_takes_a_gpu_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A place is a lock, which another opening of the file in this process meets as another process would."""
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    first, second = ["0", "0", "{0, 1}"], ["1", "1", "{2, 3}"]
    few = {parts.VISIBLE: "5, GPU-8f"}  # of all there are
    by_number, by_name = ["5", "5", "{0, 1}"], ["GPU-8f", None, "{2, 3}"]
    held: list[Any] = []
    renderer, own = {parts.EGL_DEVICE: "3"}, ["1", "3", "{2, 3}"]
    for expected, given in ((first, {}), (own, renderer), (by_number, few), (by_name, few)):
        assert taken("cuda", 2, monkeypatch, **given) == expected
        held.append(parts._place)
    held[1].close()  # as at its process's end
    assert taken("cuda", 2, monkeypatch) == second
    for file in (*held, parts._place):
        file.close()
    for device, count in (("cpu", 2), ("cuda:1", 2), ("cuda", 1)):
        assert taken(device, count, monkeypatch) == [None, None]


def test_a_sweep_takes_a_gpu_for_flights_on_gpus_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    run: Any = object()
    monkeypatch.setattr(parts, "acquire_gpu", asked.append)
    for device in ("cpu", "cuda"):
        keys = {"simulator": "kernels", "device": device}
        evaluation = {"experiment": "evaluate", "keys": keys}
        config = configured("sweep", "agent=straight", sweep={"wind": [0]}, evaluation=evaluation)
        with Sweep().open(config, "lockstep", run) as opened:
            assert opened is run
    assert asked == ["cpu", "cuda"]
