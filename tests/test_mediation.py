"""What of ADSC's gap is moved alone: in a command of the exact simulator, and in the suite that compares policies."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike

from tests.made_runs import run_of, thinking_row
from tests.running import configured, fly_into, run_into
from tools.fit_gap_law import conditions, fit, halves, judged, largest_gap
from uavaccel.config import parse_yaml
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.mediation import Contrast, Mediation, MediationConfig, Share, effect, share_of_loss
from uavaccel.suites.realtime import Realtime

pytestmark = pytest.mark.usefixtures("trainings_here", "whole_messages")

LEFT, AHEAD = 0, 2
EMPTY: dict[str, Any] = {"observation": "state", "lane": {"obstacles": []}, "t_sample_s": 0.1}
NORTH_SPEED, EAST_SPEED = 7, 8  # columns of a frame of the state


def flown(actions: Sequence[int], **mediation: float) -> np.ndarray:
    """Position, attitude and velocity of each sample of some commands (commands, samples, numbers)."""
    environment = ObstacleLane(**EMPTY, mediation=mediation)
    environment.reset(seed=0)
    frames = np.stack([environment.step(action)[0] for action in actions])
    environment.close()
    return frames


def test_position_hold_brakes_in_a_gap_once_the_goal_has_held() -> None:
    plain, brief, long = (flown([AHEAD] * 3, **keys) for keys in ({}, {"gap_s": 0.06}, {"gap_s": 0.776}))
    speeds = [frames[2, 0, NORTH_SPEED] for frames in (plain, brief, long)]
    assert speeds[1] > speeds[0] - 0.01
    assert speeds[2] < 0.3 * speeds[0]


def test_a_command_begins_with_a_share_of_the_speed_where_the_last_one_ended() -> None:
    plain, rests = flown([AHEAD] * 3), flown([AHEAD] * 3, start_speed=0.0)
    np.testing.assert_allclose(rests[0], plain[0], atol=1e-6)  # which begins at rest in any case
    assert rests[1, 0, NORTH_SPEED] < 0.2 < 0.6 < plain[1, 0, NORTH_SPEED]
    assert 0.0 < rests[1, 0, 0] - rests[0, -1, 0] < 0.02


def test_the_way_of_a_gap_is_gone_and_the_motion_before_it_kept() -> None:
    plain, way = flown([AHEAD] * 2), flown([AHEAD] * 2, gap_s=0.776, start_speed=1.0)
    np.testing.assert_allclose(way[1, :, NORTH_SPEED], plain[1, :, NORTH_SPEED], atol=1e-3)
    gone = way[1, :, 0] - plain[1, :, 0]  # a centimetre of height is gone too, which the command makes good
    assert gone.min() > 0.2
    np.testing.assert_allclose(gone, gone[0], atol=1e-3)


def test_images_of_an_age_shift_the_flight_and_not_its_samples() -> None:
    actions = [AHEAD, LEFT, AHEAD]
    plain, late = (flown(actions, image_age_s=age).reshape(-1, 13) for age in (0.0, 0.2))
    np.testing.assert_allclose(late[2:], plain[:-2], atol=1e-9)
    assert abs(late[11, EAST_SPEED]) < 1e-9 < -late[12, EAST_SPEED]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"mediation": {"gap_s": 0.1}, "command": "adsc"}, "mediation needs command tcsc, timing lockstep"),
        ({"mediation": {"gap_s": 0.1}, "timing": "virtual"}, "mediation needs command tcsc, timing lockstep"),
        ({"mediation": {"image_age_s": 1.0}}, r"mediation.image_age_s = 1: must be less than t_move_s"),
        ({"mediation": {"gap_s": 0.0011}}, r"mediation.gap_s"),
        ({"mediation": {"start_speed": 1.5}}, r"mediation.start_speed"),
    ],
)
def test_what_cannot_be_mediated_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        ObstacleLane(**keys)


# --- the suite --------------------------------------------------------------------------------------------------

SMALL = """{
    policies: {blind: {agent: straight}, small: {task.mediation.gap_s: 0.074}, brief: {games: 2}},
    training: {experiment: train, keys: {games: 3, environments: 1, turns: 1, checkpoint_games: 1, channels: [4, 4],
        hidden: [16], mirror: false, task.observation: state, task.max_commands: 12,
        options: {learning_starts: 8, batch_size: 8, buffer_size: 300}}},
    evaluation: {experiment: evaluate,
        keys: {games: 2, simulator: kernels, task.timing: lockstep, task.max_commands: 12, task.t_move_s: 1.0}},
    flights: {gap: {label: s, keys: [task.mediation.gap_s], values: [[0.776], [2.0]]},
        slow: {label: s, keys: [task.t_move_s, task.t_sample_s, task.speed_m_s], values: [[1.98, 0.66, 0.5]]}},
    contrasts: [{label: games, without: [small/usual], moved: [brief/usual]}],
    shares: [{usual: small/usual, whole: small/gap-2, parts: [brief/gap-2, small/slow-1.98]}]}"""


def small(*overrides: str, **options: Any) -> MediationConfig:
    keys = parse_yaml(SMALL, "SMALL")
    given = [f"{key}={json.dumps(value)}" for key, value in keys.items()]
    config = configured("mediation_flight", *given, *overrides, **options)
    assert isinstance(config, MediationConfig)
    return config


@pytest.mark.slow
def test_each_policy_is_flown_under_every_value_of_every_factor(tmp_path: Path) -> None:
    summary = run_into(tmp_path / "run", Mediation(), small("only_flights=[gap-2, usual, slow-1.98]", seeds=2))
    rows = RunDirectory(tmp_path / "run").rows()
    flights = ["usual", "gap-2", "slow-1.98"]  # gap-0.776 is not asked for
    trained = [f"{policy}-seed{seed}" for seed in (0, 1) for policy in ("small", "brief")]
    assert [row["case"] for row in rows] == ["blind-seed0", *trained]
    assert all(set(row["successes"]) == set(flights) and row["games"] == 2 for row in rows)
    assert [row.get("trained_games") for row in rows] == [None, 3, 2, 3, 2]
    assert len({row["weights_sha256"] for row in rows[1:]}) == 4
    cells = {(cell["policy"], cell["flight"]): cell for cell in summary["cells"]}
    assert len(cells) == 3 * len(flights)
    assert (cells["small", "gap-2"]["seeds"], cells["blind", "usual"]["seeds"]) == ([0, 1], [0])
    assert [share["part"] for share in summary["shares"]] == ["brief/gap-2", "small/slow-1.98"]
    for row in rows:
        part = RunDirectory(tmp_path / f"run/parts/{row['case']}/gap-2")
        assert part.config()["task"]["mediation"]["gap_s"] == 2.0
        assert (part.config()["agent"] == "straight") == (row["policy"] == "blind")
    assert "Shares of the loss" in (tmp_path / "run/report.md").read_text()
    assert summary["contrasts"][0]["trainings"] == 4
    assert "Effects" in (tmp_path / "run/report.md").read_text()


def test_policies_of_another_task_and_ones_with_their_own_flights_are_flown(tmp_path: Path) -> None:
    hover = "{experiment: hover_ppo, games: 4, environments: 2, options.rollout: 8, task.max_commands: 4}"
    policies = f"policies={{hover: {hover}, slow: {{agent: straight, task.speed_m_s: 0.5}}}}"
    flights = "flights={gap: {label: s, keys: [task.mediation.gap_s], values: [[0.4]]}}"
    keys = "evaluation.keys={games: 2, simulator: kernels, task.timing: lockstep, task.max_commands: 4}"
    run_into(tmp_path / "run", Mediation(), small(policies, flights, keys, "shares=[]", "contrasts=[]"))
    flown = [RunDirectory(tmp_path / f"run/parts/{name}-seed0/gap-0.4").config() for name in ("hover", "slow")]
    assert [config["env_id"] for config in flown] == ["uavaccel/Hover-v0", "uavaccel/ObstacleLane-v0"]
    assert flown[1]["task"]["speed_m_s"] == 0.5
    assert [config["task"]["mediation"]["gap_s"] for config in flown] == [0.4, 0.4]


@pytest.mark.slow
def test_a_run_that_was_moved_goes_on_where_it_was(tmp_path: Path) -> None:
    """In the midst of a flight of a policy that it has trained, whose folder is another one now."""
    config = small("only_flights=[usual, gap-2]", "policies={brief: {games: 2}}", "shares=[]", "contrasts=[]")
    run = fly_into(tmp_path / "run", Mediation(), config)
    rows = (run.path / "rows.jsonl").read_bytes()
    run.truncate_to(0)
    RunDirectory(run.path / "parts/brief-seed0/gap-2").truncate_to(1)
    del run  # and its lock
    (tmp_path / "run").rename(tmp_path / "moved")
    assert (fly_into(tmp_path / "moved", Mediation(), config, resume=True).path / "rows.jsonl").read_bytes() == rows


def test_a_policy_that_exists_has_one_flight_whatever_the_seed() -> None:
    cases = [case.id for case in Mediation().policies_of(small(seed=3, seeds=2))]
    assert cases == ["blind-seed3", "small-seed3", "brief-seed3", "small-seed4", "brief-seed4"]


def test_flights_of_a_policy_are_known_unless_it_learns_elsewhere() -> None:
    """And whether a run renders follows from those of its first policy."""
    policies = "policies={blind: {agent: straight}, small: {}, hover: {experiment: hover_ppo}}"
    config = small(policies, "shares=[]", "contrasts=[]")
    runs = [[suite.name for suite, _ in Mediation().runs(config, case)] for case in Mediation().policies_of(config)]
    assert runs == [["evaluate"] * 4, ["train", *["evaluate"] * 4], ["train"]]
    for simulator in ("kernels", "mujoco"):
        drawn = small(f"evaluation.keys={{simulator: {simulator}, task.timing: lockstep, task.observation: dvs}}")
        assert Mediation().renders(drawn) is (simulator == "mujoco")


@pytest.mark.parametrize("experiment", ["mediation", "mediation_flight", "mediation_law"])
def test_shipped_mediations_can_be_flown(experiment: str) -> None:
    config = configured(experiment)
    cases = [*Mediation().policies_of(config)]
    assert len({case.id for case in cases}) == len(cases) == config.seeds * len(config.policies)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("shares.0.whole=small/gap-3", r"shares: small/gap-3 is no cell; cells are POLICY/FLIGHT, as in blind/gap-0"),
        ("contrasts=[{label: a, without: [small/gap-3], moved: [small/usual]}]", "contrasts: small/gap-3 is no cell"),
        ("contrasts=[{label: a, without: [small/usual, brief/usual], moved: [small/gap-2]}]", "a needs as many cells"),
        ("flights.gap.values=[[0.1, 0.2]]", r"values has \[0.1, 0.2\]: needs a value for each of task"),
        ("flights.gap.values=[[0.2], [0.2000001]]", "each value of task.mediation.gap_s once"),
        ("flights.gap.values=[[fast]]", "those of task.mediation.gap_s must be numbers"),
        ("flights.gap.keys=[task.mediation.gab_s]", r"gab_s"),
        (
            "only_flights=[usual, gap-3]",
            "only_flights: gap-3 is no flight; there are usual, gap-0.776, gap-2, slow-1.98",
        ),
        ("only_flights=[gap-2]", "only_flights: must have usual"),
    ],
)
def test_a_mistake_in_a_mediation_is_named(override: str, said: str) -> None:
    with pytest.raises(UserError, match=said):
        small(override)


def cell(*won: ArrayLike) -> pd.DataFrame:
    return pd.DataFrame({"won": [np.array(lanes, bool) for lanes in won]})


def test_a_part_of_a_loss_is_a_share_with_an_interval_over_trainings_and_lanes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaccel.suites.mediation.RESAMPLES", 400)
    lanes = np.arange(200)
    cells = {
        "a/usual": cell(lanes >= 0),
        "a/none": cell(lanes >= 0),
        "a/whole": cell(lanes % 2),
        "a/part": cell(lanes % 4),
    }
    share = Share(usual="a/usual", whole="a/whole", parts=("a/part",))
    found: dict[str, Any] = share_of_loss(cells, share, "a/part")
    assert (found["loss"], found["alone"], found["share"]) == (0.5, 0.25, 0.5)
    assert 0.35 < found["low"] < 0.5 < found["high"] < 0.65
    same: dict[str, Any] = share_of_loss(cells, share, "a/whole")
    assert (same["share"], same["low"], same["high"]) == (1.0, 1.0, 1.0)
    assert share_of_loss(cells, share, "a/none")["share"] == 0.0
    nothing = share_of_loss(cells, Share(usual="a/usual", whole="a/none", parts=()), "a/part")
    assert (nothing["share"], nothing["low"], nothing["high"]) == (None, None, None)
    few = {"a/usual": cell(lanes[:10] >= 0), "a/whole": cell(lanes[:10] > 3)}  # some resamples lose nothing
    some: dict[str, Any] = share_of_loss(few, share, "a/whole")
    assert (some["share"], some["low"], some["high"]) == (1.0, 1.0, 1.0)
    alone = {"a/usual": cell([True]), "a/whole": cell([False])}
    one = share_of_loss(alone, share, "a/whole")
    assert (one["share"], one["low"], one["high"]) == (1.0, None, None)
    seeds = {"a/usual": cell(lanes >= 0), "b/whole": cell(lanes < 0, lanes >= 0), "c/part": cell(lanes % 2)}
    apart: dict[str, Any] = share_of_loss(seeds, Share(usual="a/usual", whole="b/whole", parts=()), "c/part")
    assert (apart["share"], apart["low"]) == (1.0, None)  # the other training loses nothing


def test_an_effect_is_that_of_one_factor_over_all_cells_of_the_others() -> None:
    lanes = np.arange(200)

    def trained(*won: int) -> pd.DataFrame:
        return cell(*(lanes < count for count in won))

    cells = {"a/x": trained(200, 180), "b/x": trained(180, 160), "c/x": trained(100, 80), "d/x": trained(40, 20)}
    found = effect(cells, Contrast(label="y", without=("a/x", "b/x"), moved=("c/x", "d/x")))
    assert (found["without"], found["moved"], found["trainings"]) == (pytest.approx(0.9), pytest.approx(0.3), 8)
    # each training is .05 off its policy's mean: four variances of .0025 of halved means, and four degrees in all
    width = 2.7764 * np.sqrt(4 * 0.0025 / 4)
    assert (found["low"], found["high"]) == pytest.approx((-0.6 - width, -0.6 + width), abs=1e-4)
    alone = {name: own.iloc[:1] for name, own in cells.items()}
    single = effect(alone, Contrast(label="y", without=("a/x",), moved=("c/x",)))
    assert (single["effect"], single["low"]) == (pytest.approx(-0.5), None)


def test_an_effect_in_flight_compares_each_training_with_itself() -> None:
    lanes = np.arange(200)
    cells = {
        "a/x": cell(*(lanes < count for count in (200, 100, 50))),
        "a/y": cell(*(lanes < c for c in (180, 78, 31))),
    }
    found = effect(cells, Contrast(label="y", without=("a/x",), moved=("a/y",)))
    losses = np.array([0.1, 0.11, 0.095])
    width = 4.3027 * losses.std(ddof=1) / np.sqrt(3)
    assert (found["low"], found["high"]) == pytest.approx((-losses.mean() - width, -losses.mean() + width), abs=1e-4)
    assert found["trainings"] == 3


# --- the law ----------------------------------------------------------------------------------------------------

GAPS_S = np.array([0.0, 0.1, 0.2, 0.4, 0.8, 1.6])


def drops_at(gap_s: float, games: int = 200) -> np.ndarray:
    """Outcomes (gaps, games) of which five of a hundred more are lost with each `gap_s`, half a period apart."""
    lost = np.round(0.05 * games * GAPS_S / gap_s)
    return np.arange(games) % games >= lost[:, None]


def made_sweep(path: Path, largest_s: dict[str, float], t_move_s: dict[str, float]) -> RunDirectory:
    """A run of commands of several lengths, whose success drops at known gaps."""
    policies = {
        name: {"agent": "straight", "task.t_move_s": each, "task.t_sample_s": each} for name, each in t_move_s.items()
    }
    values = [[float(gap_s)] for gap_s in GAPS_S[1:]]
    flights = {"gap": {"label": "s", "keys": ["task.mediation.gap_s"], "values": values}}
    config = small(f"policies={json.dumps(policies)}", f"flights={json.dumps(flights)}", "shares=[]", "contrasts=[]")
    rows = []
    for policy, gap_s in largest_s.items():
        won = dict(zip(["usual", *(f"gap-{value:g}" for [value] in values)], drops_at(gap_s), strict=True))
        arrays = {f"{flight}_is_success": each for flight, each in won.items()}
        successes = {flight: int(each.sum()) for flight, each in won.items()}
        row = {"case": f"{policy}-seed0", "policy": policy, "seed": 0, "games": 200, "successes": successes}
        rows.append({**row, "arrays": arrays})
    return run_of(path, Mediation(), config, rows).run


def made_delays(path: Path, largest_s: float) -> RunDirectory:
    """A run of an agent at Gymnasium's pendulum, whose return drops by 5 % with each `largest_s`."""
    config = configured(
        "realtime_law", "environments={pole: {id: InvertedPendulum-v5}}", f"latency_s={GAPS_S.tolist()}"
    )
    rows = []
    for seed, gap_s in product(range(2), GAPS_S.tolist()):
        returns = [1000.0 * (1.0 - 0.05 * gap_s / largest_s)] * 3
        rows.append(thinking_row("naive", "adsc", gap_s, 1.0, 0.0, environment="pole", seed=seed, returns=returns))
    return run_of(path, Realtime(), config, rows).run


def test_the_largest_gap_is_where_success_has_dropped_by_five_points() -> None:
    gaps_s = np.array([0.0, 0.2, 0.4, 1.2])
    assert largest_gap(gaps_s, np.array([1.0, 1.0, 0.9, 0.2])) == pytest.approx((0.3, 0.3))
    assert largest_gap(gaps_s, np.array([0.9, 0.8, 0.95, 0.0])) == (0.0, 0.2)  # at once: it is below the first
    assert largest_gap(gaps_s, np.array([0.9, 0.9, 0.86, 0.85])) == (1.2, np.inf)


def test_runs_of_policies_and_of_delays_give_a_largest_gap_for_each_condition(tmp_path: Path) -> None:
    t_move_s = {"brief": 0.5, "long": 1.0, "never": 2.0}
    sweep = made_sweep(tmp_path / "a", {"brief": 0.2, "long": 0.4, "never": 1e6}, t_move_s)
    found = conditions([sweep.path, made_delays(tmp_path / "b", 0.3).path]).set_index("condition")
    assert found.index.tolist() == ["brief", "long", "never", "pole"]
    assert found.task.tolist() == ["ObstacleLane"] * 3 + ["InvertedPendulum"]
    assert found.control_s.tolist() == pytest.approx([0.5, 1.0, 2.0, 0.04])
    assert found.at_least_s.tolist() == pytest.approx([0.2, 0.4, 1.6, 0.3], rel=0.02)
    assert found.below_s.tolist() == pytest.approx([0.2, 0.4, np.inf, 0.3], rel=0.02)
    dropped = found.loc[["brief", "long"]]
    assert (dropped.low < dropped.at_least_s).all()
    assert (dropped.below_s < dropped.high).all()
    assert (found.low["pole"], found.high["pole"]) == pytest.approx((0.3, 0.3))  # whose returns do not vary
    assert found.games.tolist() == [200, 200, 200, 3]
    assert (found.without_gap == 1.0).all()


def law_table(**columns: Any) -> pd.DataFrame:
    """Conditions of four tasks, three of the first one, whose largest gap is three times a command."""
    table = pd.DataFrame({"task": [*"aaabcd"], "control_s": [0.1, 0.2, 0.4, 0.05, 1.0, 2.0]})
    table = table.assign(own_s=[0.5] * 5 + [0.2], room_s=[1.0, 0.3, 0.2, 0.3, 0.4, 0.3], without_gap=1.0)
    return table.assign(at_least_s=3 * table.control_s, below_s=3 * table.control_s).assign(**columns)


def test_a_law_that_holds_is_found_on_half_of_the_tasks_and_predicts_the_rest() -> None:
    found = fit(law_table(), ("b", "d"))
    assert found.law == ("control_s",)
    assert found.factor == pytest.approx(3.0, rel=0.01)
    assert found.error == pytest.approx(1.0, abs=0.01)
    assert found.constant > 1.5
    assert len(halves(law_table())) == 6


def test_a_bound_is_missed_only_by_a_prediction_beyond_it() -> None:
    """Task b drops at once, below 0.5 s, and c never up to 1 s; the law says 0.15 and 3 s."""
    at_least_s, below_s = [0.3, 0.6, 1.2, 0.0, 1.0, 6.0], [0.3, 0.6, 1.2, 0.5, np.inf, 6.0]
    assert fit(law_table(at_least_s=at_least_s, below_s=below_s), ("b", "c")).error == pytest.approx(1.0, abs=0.01)
    below_s[3] = 0.075
    assert fit(law_table(at_least_s=at_least_s, below_s=below_s), ("b",)).error == pytest.approx(2.0, rel=0.01)


def test_every_task_counts_alike_however_many_conditions_it_has() -> None:
    gaps_s = [1.0, 1.0, 1.0, 4.0, 1.0, 1.0]
    table = law_table(control_s=1.0, own_s=1.0, room_s=1.0, at_least_s=gaps_s, below_s=gaps_s)
    assert fit(table, ("c", "d")).factor == pytest.approx(2.0, rel=0.01)


def test_a_policy_that_fails_without_a_gap_is_not_judged() -> None:
    assert judged(law_table(without_gap=[0.4, 0.5, 1.0, 1.0, 1.0, 1.0])).control_s.tolist() == [
        0.2,
        0.4,
        0.05,
        1.0,
        2.0,
    ]
