"""The RL experiment: cells that a kill does not change, Table I's numbers by hand, figures."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import binomtest, fisher_exact

from tests.drawing import labelled, points, record_figures, texts, tick_texts
from tests.learning import kill_at_row
from tests.opengl import needs_opengl
from tests.running import configured, run_into
from uavaccel.draw.labels import number
from uavaccel.errors import UserError
from uavaccel.metrics.equivalence import mean_estimate
from uavaccel.metrics.success import Success
from uavaccel.records import RunDirectory
from uavaccel.suites import gpu
from uavaccel.suites.grid import Sweep
from uavaccel.suites.parts import Part, part_suite
from uavaccel.suites.report import Report
from uavaccel.suites.rl import KEY, Rl, RlConfig, collapse, over_gaps, parts_of

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
    kill_at_row(tmp_path / "killed", config, 10)
    second = tmp_path / "killed/parts/airsim-virtual-adsc-1x-seed0"
    assert [len(RunDirectory(path).rows()) for path in (tmp_path / "killed", second / "training")] == [1, 2]
    append = RunDirectory.append_row

    def interrupted(run: RunDirectory, row: Any, on_disk: bool = True) -> None:
        if row["case"] == "lane-000001":
            raise KeyboardInterrupt
        append(run, row, on_disk)

    with monkeypatch.context() as patch:
        patch.setattr(RunDirectory, "append_row", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_into(tmp_path / "killed", Rl(), config, resume=True)
    assert len(RunDirectory(second / "evaluation-adsc").rows()) == 1
    moved = (tmp_path / "killed").rename(tmp_path / "moved")  # the evaluation names its policy by where it was
    run_into(moved, Rl(), config, resume=True)

    rows = RunDirectory(moved).rows()
    assert rows == [row for row in whole.rows() if row["case"].startswith("airsim") and row["clock_speed"] == 1.0]
    assert [row["case"].endswith("-exact") for row in rows] == [False, False, True, True]
    for row in rows:
        folder = f"parts/{row['case'].removesuffix('-exact')}"
        for name in (row["arrays"], *(f"{folder}/{part}" for part in PARTS)):
            assert (moved / name).read_bytes() == (whole.path / name).read_bytes()
    assert not [*moved.glob("parts/*/training/checkpoints"), *moved.glob("parts/**/*.png")]


@pytest.mark.slow
def test_policies_fly_in_real_time_on_the_clock_and_the_profile_of_their_training(whole: RunDirectory) -> None:
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
def test_a_policy_is_flown_as_it_was_trained_and_with_the_other_command(overrides: Any, flown: str) -> None:
    """A decision takes its time in evaluations too; the lanes are of seed 0, and the policy keeps its own senses."""
    keys = "training: {inference_s: 0.03, learning_s: 0.5}, task: {t_move_s: .8, difficulty.wind_m_s: 3.0}"
    config = small(f"cells=[{{profile: airsim, clock_speed: [5], {keys}}}]", *overrides, command=["adsc"], seed=4)
    found = []
    for case in Rl().cases(config):
        for name, (part, seed) in parts_of(config, case).items():
            trained, made = name == "training", part_suite(part, seed)[1].model_dump()
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
    assert (len(few), set(few) <= set(many), set(Rl().may_grow(Path()))) == (12, True, {"seeds", "exact_seeds"})
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
def test_shipped_experiments_can_be_flown_and_count_the_games_of_all_parts(
    experiment: str, options: dict[str, Any], games: Any
) -> None:
    config = configured(experiment, "seeds=1", **options)  # which checks it
    found = [Rl().games(config, case) for case in Rl().cases(config)]
    assert games in (found, len(found))
    for keys, seed in (({}, 3), ({"seed": 9}, 9)):
        assert part_suite(Part(experiment="evaluate", keys=keys), 3)[1].seed == seed


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
        (["evaluation.keys.gamess=1"], {}, "evaluate.yaml: unknown key 'gamess'"),
        (["training.keys.environment=2"], {}, "train.yaml: unknown key 'environment'"),
        (["cells.2={profile: airsim, clock_speed: [5]}"], {}, "airsim virtual tcsc at 5x twice; give one a `variant`"),
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


# --- numbers ----------------------------------------------------------------------------------------------------

LANES = 40


def made(command: str, clock_speed: float, won: Sequence[Any], wall_s: float = 1.0, **keys: Any) -> list[Any]:
    """A row for each seed, won in flights or in real time alone; of a command `wall_s` less .25 s fly, .25 s draw."""
    rows = []
    spent_s = {"simulation": 0.75 * wall_s, "rendering": 0.25}
    spent_s |= {"image_processing": 0.001, "inference": 0.002, "learning": 0.007}
    for seed, lanes in enumerate(won):
        flights: Mapping[tuple[str, float], Sequence[int]] = (
            lanes if isinstance(lanes, Mapping) else {(command, 1.0): lanes}
        )
        commands = 100 * (seed + 1)
        row: dict[str, Any] = {"suite": "rl", "variant": "", "profile": "airsim", "timing": "virtual", "seed": seed}
        row |= {"command": command, "clock_speed": clock_speed, **keys}
        row["case"] = "-".join(str(row[name]) for name in (*KEY, "seed"))
        row["training"] = {"games": 10, "successes": 3 + seed, "commands": commands, "sim_time_s": float(commands)}
        row["training"] |= {"weights_sha256": "f00", "phase_s": {name: commands * s for name, s in spent_s.items()}}
        row["evaluations"] = [flight(*conditions, len(some)) for conditions, some in flights.items()]
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
            distance_m = np.where(won, 150.0, 10.0 + lane)
            arrays |= {f"{name}_lane": lane, f"{name}_is_success": won, f"{name}_distance_m": distance_m}
        own = {key: value for key, value in row.items() if key != "lanes"}
        run.append_row(own | run.save_arrays(row["case"], arrays))
    for row, training_s in zip(rows, took_s, strict=False):
        run.append_timing({"case": row["case"], "training_s": training_s})
    return Rl().report(run)


def page_of(report: Report) -> str:
    report.write()
    return (report.run.path / "report.md").read_text(encoding="utf-8")


def tables_of(page: str) -> dict[str, list[list[str]]]:
    """The cells of the first table after each heading of a report.md, line by line, without the columns' names."""
    found = {}
    for section in page.split("## ")[1:]:
        lines = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("|")]
        found[section.partition("\n")[0]] = lines[2:]
    return found


def wilson(successes: int, games: int) -> tuple[float, float]:
    interval = binomtest(successes, games).proportion_ci(method="wilson")
    return interval.low, interval.high


def test_every_number_of_table_i_and_figure_9(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = made("tcsc", 1.0, [range(30), range(20)], 3600.0) + made("tcsc", 5.0, [range(25, 35), range(12)], 900.0)
    rows += made("adsc", 1.0, [range(9)], 1800.0) + made("tcsc", 5.0, [range(3)], profile="native")
    rows += made("tcsc", 1.0, [range(3)], timing="lockstep") + made("adsc", 1.0, [range(3)], timing="lockstep")
    for row in rows:
        row["training"]["phase_s"]["learning"] = 400.0 * row["training"]["commands"]
    report = report_of(tmp_path / "run", rows, [60.0 * (number + 1) for number in range(5)])
    page, cells = page_of(report), report.summary["cells"]
    assert [cell["successes"] for cell in cells] == [30, 20, 10, 12, 9, 3, 3, 3]
    lost_m = [10.0 + n for n in range(40) if not 25 <= n < 35]
    assert cells[2]["distance_m_median"] == float(np.median(lost_m + [150.0] * 10))
    real_time, fast, adsc, native, lockstep, _ = report.summary["pooled"]
    # Lanes 0 to 24 of seed 0 and 12 to 19 of seed 1 were won at 1x alone, 30 to 34 of seed 0 at 5x alone.
    mcnemar, over_seeds = binomtest(5, 5 + 25 + 8).pvalue, mean_estimate([10 / LANES, 12 / LANES])
    slow_s, fast_s, beside_s = 0.75 * 1800 + 0.25, 0.75 * 900 + 0.25, 400.003  # ADSC at 1x is what speed-ups are over
    expected = {
        "successes": 22, "games": 80, "trained_games": 20, "commands": 300, "sim_time_s": 300, "paper_successes": 30,
        "wilson_low": wilson(22, 80)[0], "wilson_high": wilson(22, 80)[1],  # narrower than over seeds
        "seeds_low": max(0.0, over_seeds.low), "seeds_high": over_seeds.high,
        "fisher_p": fisher_exact(np.array([[22, 58], [50, 30]])).pvalue, "mcnemar_p": mcnemar,
        "permutation_p": 2 / 6,  # of six ways to share four trainings out, two are as far
        "training_wall_s": 300 * (fast_s + beside_s), "real_time_s": 300 * (slow_s + beside_s),
        "training_speedup": slow_s / fast_s, "whole_training_speedup": (slow_s + beside_s) / (fast_s + beside_s),
        "paper_training_speedup": 4.0, "paper_whole_training_speedup": 3.6,
    }  # fmt: skip
    assert {name: fast[name] for name in expected} == pytest.approx(expected)
    assert (fast["successes_by_seed"], fast["phase_s"]["rendering"], adsc["training_speedup"]) == ([10, 12], 75.0, 1.0)
    assert (adsc["seeds_low"], adsc["seeds_high"]) == (adsc["wilson_low"], adsc["wilson_high"])
    assert (real_time["paper_successes"], native["paper_successes"]) == (21, None)
    assert real_time["fisher_p"] is real_time["permutation_p"] is native["fisher_p"] is lockstep["fisher_p"] is None
    assert native["training_speedup"] is lockstep["training_speedup"] is lockstep["real_time_s"] is None
    success = f"27.5% [{fast['seeds_low']:.1%}, {fast['seeds_high']:.1%}]"
    tables = tables_of(page)
    won = ["22 of 80", success, "10, 12", "30", "0.33", number(mcnemar, 2)]
    assert tables["Table I: success by training"][1][3:] == won
    speedups = [f"{expected['training_speedup']:.3g}x", "4x", f"{expected['whole_training_speedup']:.3g}x", "3.6x"]
    hours = [f"{expected[name] / 3600:.1f} h" for name in ("training_wall_s", "real_time_s")]
    assert tables["Time of the training"][1][1:] == ["5x", "0, 1", *hours, *speedups, "420.0 s"]
    shown = report.overview()
    assert shown is not None
    assert shown.rows[1] == ("TCSC, airsim", "5x", "0, 1", success, "30 %", speedups[0])
    real_s = 700 * (slow_s + beside_s)
    for said in (f"50 games would have taken {real_s / 3600:.1f} h", f"{real_s / 50:.0f} s per game", "took 15 min of"):
        assert said in page
    assert f"{real_s / 900:.0f} times less" in page


def test_each_flight_of_a_policy_is_told_in_its_line_and_column(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Student's t of two trainings is 12.7 at 95 %: of 30 % and 25 % that makes 27.5 % and up to 31.8 % more.

    Both won lanes 0 to 9, which adds to it.
    """

    def flights(*lanes: range) -> Any:
        return dict(zip((("tcsc", 1.0), ("adsc", 1.0), ("tcsc", 5.0), ("adsc", 5.0)), lanes, strict=False))

    def between(policies: list[Any], *ways: tuple[str, float]) -> str:
        """The difference of the same policies in two ways, with its interval over policies and lanes."""
        lanes = [[np.isin(np.arange(LANES), flown[way]) for flown in policies] for way in ways]
        difference = Success.on_lanes(lanes[0]).difference(Success.on_lanes(lanes[1]), same_policies=True)
        return "{:+.1%} [{:+.1%}, {:+.1%}]".format(*difference)

    told = [flights(range(30), range(10, 34), range(12), range(8, 14)), flights(*map(range, (20, 20, 10, 4)))]
    plain = [flights(*map(range, (10, 10, 12, 12))), flights(*map(range, (5, 5, 10, 10))), flights(range(40))]
    rows = made("tcsc", 5.0, told, variant="told") + made("tcsc", 5.0, plain)
    tables = tables_of(page_of(report_of(tmp_path / "run", [*rows, exact_of(rows[0], range(4, 32))])))
    real_time, fast = "62.5% [0.0%, 100.0%]", "27.5% [0.0%, 61.9%]"
    slow_p, fast_p = f"{binomtest(4, 14).pvalue:.2g}", f"{binomtest(2, 16).pvalue:.2g}"
    who = ["TCSC, airsim, told", "5x", "0, 1"]
    assert [line[3:] for line in tables["Commands interchanged"] if line[:3] == who] == [
        ["1x", real_time, "55.0% [0.0%, 100.0%]", between(told, ("tcsc", 1.0), ("adsc", 1.0)), "10, 4", "1", slow_p],
        ["5x", fast, "12.5% [0.0%, 44.3%]", between(told, ("tcsc", 5.0), ("adsc", 5.0)), "14, 2", "0.5", fast_p],
    ]
    variant, beside = tables["Flown at the ClockSpeed of the training"]
    of_two = between(told, ("tcsc", 1.0), ("tcsc", 5.0))
    assert variant == [*who, real_time, "0.33", fast, "1", of_two, "0.5"]  # beside the plain seeds flown so, too
    assert (beside[0], beside[4], beside[6]) == ("TCSC, airsim", "-", "-")
    exact = [*who[:2], "0", "30", "28", "34 of 40", f"{binomtest(2, 6).pvalue:.2g}"]
    assert tables["The same policies in the exact simulator"] == [exact]
    low, high = wilson(30, 40)
    first = [*who[:2], "0", "3 of 10", f"30 of 40: 75.0% [{low:.1%}, {high:.1%}]", "f00"]
    assert (tables["Each training"][0], len(tables["Each training"])) == (first, 5)
    # Flown in real time alone: a variant's flights have nothing beside them.
    slow = made("tcsc", 5.0, [flights(range(20))])
    (alone,) = report_of(tmp_path / "slow", [*slow, rows[0]]).summary["as_trained"]
    assert alone["real_time"]["mcnemar_p"] is alone["as_trained"]["mcnemar_p"] is None


def test_weights_are_the_same_where_every_clock_speed_learned_them(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    rows = made("tcsc", 1.0, [[]] * 4) + made("tcsc", 5.0, [[]] * 3) + made("adsc", 1.0, [[]])
    rows[5]["training"]["weights_sha256"] = "other"  # of seed 1; seed 3 was not trained at 5x
    report = report_of(tmp_path / "run", rows)
    (found,) = report.summary["same_weights"]
    assert (found["command"], found["clock_speed"], found["seeds"], found["equal"]) == (
        "tcsc",
        [1, 5],
        [0, 1, 2],
        [0, 2],
    )
    said = "TCSC, airsim: of 3 seeds 2 learned the same weights at 1x, 5x: 1 learned others."
    assert said in list(Rl().page(report))


def test_the_gap_is_what_passes_beyond_t_move_while_the_clock_runs(tmp_path: Path) -> None:
    # .3 s of flight and .01 s beside it pass at 5x; the pictures' .25 s stand
    rows = made("adsc", 5.0, [[0], [1]], 0.4)
    rows += made("adsc", 10.0, [[0]], 0.05)  # commands that collisions end early
    rows += made("adsc", 100.0, [[0]], 0.04)  # a tick of 3 ms takes 45 us: no more than 66.7x
    rows += made("tcsc", 5.0, [[0]], 0.4)  # its clock is paused
    gaps = [cell["gap_s"] for cell in report_of(tmp_path / "run", rows).summary["pooled"]]
    assert gaps == pytest.approx([0.55, 0.0, 0.04 * 200 / 3 - 1.0, 0.0])


STAYS = "success in real time stays below half of the best cell's"


def thought(command: str, variant: str, gap: float, won: int, **keys: Any) -> dict[str, Any]:
    """A pooled cell of 100 games."""
    conditions = {"variant": variant, "profile": "airsim", "timing": "virtual", "command": command, "clock_speed": 5.0}
    return {**conditions, "gap_s": gap, "success_ratio": won / 100, **keys}


def test_the_gap_from_which_a_policy_fails_is_the_one_that_success_never_recovers_from() -> None:
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


def test_the_headline_tells_success_after_the_slowest_and_the_fastest_training(tmp_path: Path) -> None:
    """Of trainings without a variant; where there are none, the gap at which policies fail."""
    report = report_of(tmp_path / "run", rows := made("tcsc", 1.0, [range(30), range(20)]))
    clocks = (("tcsc", 1.0, 0.0, 21), ("adsc", 100.0, 9.0, 0), ("adsc", 5.0, 0.4, 64), ("adsc", 1.0, 0.1, 23))
    plain = [thought(command, "", gap, won, clock_speed=clock_speed) for command, clock_speed, gap, won in clocks]
    told = [thought("adsc", f"think_{n}ms", n / 10, 96 >> n) for n in range(3)]
    at_1x, at_100x = "23.0% after training at 1x", "0.0% after training at 100x"
    for pooled, begin in (
        ([*plain, *told], f"TCSC, airsim wins 21.0% after training at 1x; ADSC, airsim wins {at_1x} and {at_100x}"),
        (told, f"ADSC, airsim: {STAYS} 96.0% from a gap of 0.20 simulated seconds on"),
        (told[:1], ""),
    ):
        cells = [{"games": games} for games in (200, 100, 100)]
        report.summary = {"cells": cells, "training_games": 5000, "evaluation_clock_speed": 2.0, "pooled": pooled}
        assert report.headline() == begin
        told_of = "modelled, but for the times of this machine · 3 trainings of 5000 games"
        assert Rl().source(report) == f"{told_of}, each policy flown on 100, 200 lanes at 2x · seed 0, 1"
    assert Rl().status(rows) == f"{rows[1]['case']} won 20 of 40"


# --- figures ----------------------------------------------------------------------------------------------------


def bars_of(axes: Any) -> dict[str, Any]:
    """The ends of each line's intervals, by its label."""
    handles = labelled(axes).items()
    return {label: [bar[:, 1] for bar in handle.lines[2][0].get_segments()] for label, handle in handles}


def dots_of(axes: Any) -> list[tuple[float, float]]:
    return sorted(point for line in axes.lines if line.get_marker() == "." for point in points(line))


def test_success_and_distance_have_a_line_per_clock_speed_and_kind_of_training(
    tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """The paper's numbers, with Wilson's intervals, where it has some; exact flights and variants are of no cell's."""
    rows = made("tcsc", 50.0, [range(0), range(10)]) + made("tcsc", 5.0, [range(4)])
    rows += made("tcsc", 5.0, [range(20), range(20)], profile="native") + made("tcsc", 5.0, [range(8)], variant="told")
    report = report_of(tmp_path / "run", [*rows, exact_of(rows[0], range(30))])
    page_of(report)
    axes: Any = drawn["table1_success"].axes[0]
    assert tick_texts(axes.xaxis) == ["5x", "50x"]
    assert {label: points(handle.lines[0]) for label, handle in labelled(axes).items()} == {
        "TCSC, airsim": [(-0.09, 0.1), (0.91, 0.125)],
        "TCSC, the paper's": [(-0.03, 0.3), (0.97, 0.14)],
        "TCSC, airsim, told": [(0.03, 0.2)],
        "TCSC, native": [(0.09, 0.5)],
    }
    assert dots_of(axes) == [(-0.06, 0.1), (0.06, 0.2), (0.12, 0.5), (0.12, 0.5), (0.94, 0.0), (0.94, 0.25)]
    own = {cell["clock_speed"]: cell for cell in report.summary["pooled"][:2]}
    bars = bars_of(axes)
    np.testing.assert_allclose(bars["TCSC, airsim"], [(own[k]["seeds_low"], own[k]["seeds_high"]) for k in (5.0, 50.0)])
    np.testing.assert_allclose(bars["TCSC, the paper's"], [wilson(won, 100) for won in (30, 14)])
    upper, *_ = drawn["figure8_distances"].axes
    curves = {label: dict(points(line)) for label, line in labelled(upper).items()}
    reached = curves["trained at 5x"]  # the share from each distance on
    assert [reached[metres] for metres in (0.0, 14.0, 49.0, 150.0)] == pytest.approx([1.0, 39 / 40, 4 / 40, 0.0])
    assert (list(curves)[1], curves["trained at 50x"][49.0]) == ("trained at 50x", 0.125)
    dotted: Any = [line.get_xdata()[0] for line in upper.lines if line.get_linestyle() == ":"]  # type: ignore[index]
    assert len(dotted) > 2
    assert len({round(step, 6) for step in np.diff(dotted)}) == 1, "rows of obstacles"


def test_success_over_the_gap_and_the_time_of_trainings_by_phase(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Intervals stand over three seeds or one, not over two, nor where cells share a gap; times are means of seeds."""
    rows = made("adsc", 5.0, [range(20), range(10)], 0.4) + made("adsc", 10.0, [range(8)] * 3, 0.3)
    rows += made("adsc", 2.0, [range(30)], 1.2) + made("tcsc", 1.0, [[]], timing="lockstep")
    rows += [row for clock in (1.0, 5.0, 10.0) for row in made("tcsc", clock, [range(30)], 0.25)]
    rows += made("adsc", 1.0, [range(2)], 9.0)
    report = report_of(tmp_path / "run", rows)
    page_of(report)
    pooled = [cell for cell in report.summary["pooled"] if cell["timing"] == "virtual"]
    cells = {(cell["command"], cell["clock_speed"]): cell for cell in pooled}
    axes: Any = drawn["success_over_gap"].axes[0]
    lines = {label: points(handle.lines[0]) for label, handle in labelled(axes).items()}
    at = {clock: round(cells["adsc", clock]["gap_s"], 12) for clock in (1.0, 2.0, 5.0, 10.0)}
    success = {at[2.0]: 0.75, at[10.0]: 0.2, at[5.0]: 0.375, at[1.0]: 0.05}
    assert lines == {"ADSC, airsim": sorted(success.items()), "TCSC, airsim": [(0.0, 0.75)] * 3}
    bars, three = bars_of(axes), cells["adsc", 10.0]
    np.testing.assert_array_equal(bars["TCSC, airsim"], [(0.75, 0.75)] * 3)
    stood = dict(zip(sorted(success), bars["ADSC, airsim"], strict=True))
    np.testing.assert_allclose(stood[at[5.0]], (0.375, 0.375))
    np.testing.assert_allclose(stood[at[10.0]], (three["seeds_low"], three["seeds_high"]))
    assert {(at[5.0], 0.5), (at[5.0], 0.25)} <= set(dots_of(axes))

    adsc, tcsc = drawn["figure9_training_time"].axes
    assert (adsc.get_title("left"), tcsc.get_title("left")) == ("ADSC, airsim", "TCSC, airsim")
    assert (adsc.get_xlabel(), tick_texts(adsc.yaxis)) == ("minutes", ["1x", "2x", "5x", "10x"])
    minutes = {str(bar.get_label()): bar[2].get_width() for bar in adsc.containers}  # of 100 and 200 commands at 5x
    names = ("simulation (with rendering)", "image processing", "inference", "learning")
    assert minutes == pytest.approx(dict(zip(names, np.array([0.55, 0.001, 0.002, 0.007]) * 2.5, strict=True)))
    simulation, whole = (cells["tcsc", 5.0][name] for name in ("training_speedup", "whole_training_speedup"))
    assert texts(tcsc)[1] == f"{number(simulation, 3)}x, whole {number(whole, 3)}x (paper 4x, 3.6x)"


# --- GPUs -------------------------------------------------------------------------------------------------------


def taken(device: str, gpus: int, monkeypatch: pytest.MonkeyPatch) -> list[str | None]:
    """What a new process takes: GPU, renderer, and its share of five cores."""
    cores: list[set[int]] = []
    monkeypatch.setattr("torch.cuda.device_count", lambda: gpus)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3, 4}, raising=False)
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, share: cores.append(set(share)), raising=False)
    monkeypatch.setattr(gpu, "_place", None)
    for name in (gpu.VISIBLE, gpu.EGL_DEVICE):
        monkeypatch.delenv(name, raising=False)
    gpu.acquire_gpu(device)
    return [os.environ.get(gpu.VISIBLE), os.environ.get(gpu.EGL_DEVICE), *map(str, cores)]


def test_each_process_takes_a_gpu_of_its_own_where_there_is_a_choice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A place is a lock, which another opening of the file in this process meets as another process would."""
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    first, second = ["0", "0", "{0, 1}"], ["1", "1", "{2, 3}"]
    held: list[Any] = []
    for expected in (first, second, first, second):
        assert taken("cuda", 2, monkeypatch) == expected
        held.append(gpu._place)
    held[1].close()  # as at its process's end
    assert taken("cuda", 2, monkeypatch) == second
    for file in (*held, gpu._place):
        file.close()
    for device, count in (("cpu", 2), ("cuda:1", 2), ("cuda", 1)):
        assert taken(device, count, monkeypatch) == [None, None]


def test_a_sweep_takes_a_gpu_for_flights_on_gpus_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    run: Any = object()
    monkeypatch.setattr(gpu, "acquire_gpu", asked.append)
    for device in ("cpu", "cuda"):
        keys = {"simulator": "kernels", "device": device}
        evaluation = {"experiment": "evaluate", "keys": keys}
        config = configured("sweep", "agent=straight", sweep={"wind": [0]}, evaluation=evaluation)
        with Sweep().open(config, "lockstep", run) as opened:
            assert opened is run
    assert asked == ["cpu", "cuda"]
