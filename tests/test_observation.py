"""What an agent is shown and told beside its pictures, and what its actions below velocities ask of the drone."""

from __future__ import annotations

from contextlib import closing
from dataclasses import astuple
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import gymnasium
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import uavaccel.envs  # noqa: F401 - registers
from tests.learning import tiny_config, train_into
from tests.opengl import needs_opengl
from tests.running import configured, fly_into
from uavaccel.config import validate
from uavaccel.envs.hover import HoverTask
from uavaccel.envs.judging import autopilot_goal
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.sensors import ContextPlanes
from uavaccel.envs.task import HOVER_THROTTLE
from uavaccel.errors import UserError
from uavaccel.export import write_minari
from uavaccel.kernels.events import level_of
from uavaccel.kinematics import AttitudeGoal, BodyRatesGoal, MotorsGoal, VelocityGoal
from uavaccel.rl.agents import make_agent, origin_of
from uavaccel.rl.double_dqn import HostDQN
from uavaccel.rl.network import Levels, Windows, contrast
from uavaccel.rl.policy import load_policy
from uavaccel.sim.vehicle.autopilot import Goal
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.evaluate_again import environment_of, fly_again
from uavaccel.suites.train import TrainConfig
from uavaccel.vision.dvs_sensor import dvs_observation
from uavaccel.wire.session import VirtualSession

# --- planes, ages and pictures ----------------------------------------------------------------------------------------


KNOWS = ("last_action", "frame_age")
MS = 1_000_000


def action_plane(headings: list[float], action: int) -> np.ndarray:
    plane: np.ndarray = ContextPlanes(["last_action"], headings, 1).observe(np.array([action]), np.array([[0]]))[0, 0]
    return plane


@given(st.lists(st.integers(1, 180), min_size=0, max_size=12, unique=True), st.booleans(), st.randoms())
def test_the_last_action_turns_with_the_mirror(sides: list[int], ahead: bool, random: Any) -> None:
    """Whatever the headings' number and order; each has columns of its own, those of the western ones on the left."""
    headings = [float(sign * side) for side in sides for sign in (-1, 1)] + [0.0] * ahead
    if not headings:
        return
    random.shuffle(headings)
    planes = [action_plane(headings, action) for action in range(len(headings))]
    for action, heading in enumerate(headings):
        np.testing.assert_array_equal(planes[action][:, ::-1], planes[headings.index(-heading)])
    lit = np.array([(plane == 255).all(axis=0) for plane in planes])
    assert (lit.sum(axis=0) == 1).all()
    west_to_east = [lit[action].argmax() for action in np.argsort(headings)]
    assert west_to_east == sorted(west_to_east)


def test_a_learner_mirrors_the_plane_with_the_action() -> None:
    config = tiny_config({"knows": list(KNOWS)})
    headings, last, rows = list(config.task.headings_deg), [0, 1, 3, 4], th.arange(4)
    ring = th.tensor(np.stack([action_plane(headings, action) for action in last]))[:, None, None]
    seen, acted = config.task.observation_space(), config.task.action_space()
    lanes: Any = SimpleNamespace(num_envs=1, single_observation_space=seen, single_action_space=acted)
    learner, mirrored = HostDQN(config, lanes), th.tensor([True, True, False, False])
    learner.sight = SimpleNamespace(look=Levels().look, rate=lambda network, seen: th.zeros(4, 5))
    learner.replay = cast(Any, SimpleNamespace(observations=ring, next_observations=ring))
    learner.policy = cast(Any, SimpleNamespace(q_net=None, q_net_target=None))
    one = th.ones(4)
    batch = learner._prepared(Windows(rows, rows, th.zeros(4).long(), th.tensor(last), one, one, one, mirrored))
    assert batch.actions.tolist() == [4, 3, 3, 4]
    for image, action in zip(batch.seen, batch.actions.tolist(), strict=True):
        expected = contrast(th.tensor(action_plane(headings, action)).float())
        np.testing.assert_array_equal(image[0], expected)


def test_ages_are_bands_a_level_for_20_ms() -> None:
    """2.9 s is more than a byte holds; before the first action nothing is told of any."""
    told = ContextPlanes(["frame_age", "last_action"], [-30.0, 30.0], 3)
    ages, acted = told.observe(np.array([-1]), np.array([[2900 * MS, 2500 * MS, 0]]))[0]
    assert [np.unique(band).tolist() for band in ages.reshape(3, 12, 64)] == [[255], [128 + 125], [128]]
    assert (acted == 128).all()


@needs_opengl
@pytest.mark.parametrize("flown", [{"command": "tcsc"}, {"command": "adsc", "timing": "virtual", "profile": "airsim"}])
def test_pictures_and_flight_stay_as_they_were(flown: dict[str, Any]) -> None:
    plain, told = (ObstacleLane(clock_speed=10.0, knows=knows, **flown) for knows in ((), KNOWS))
    begun = [each.reset(seed=3)[0] for each in (plain, told)][1]
    for action in (2, 0, 4):
        before, after = plain.step(action), told.step(action)
        assert (before[0].shape, after[0].shape) == ((3, 36, 64), (5, 36, 64))
        np.testing.assert_array_equal(after[0][:3], before[0])
        assert before[1:] == after[1:]
        np.testing.assert_array_equal(after[0][3], action_plane([-60, -30, 0, 30, 60], action))
        assert told.observation_space.contains(after[0])
    bands = [int(level) - 128 for level in after[0][4].reshape(3, 12, 64)[:, 0, 0]]
    if flown["command"] == "tcsc":  # samples at 0.33, 0.66 and 1 s
        assert bands == [33, 17, 0]
    else:  # the last one came after a callback of some 28 ms, ten times as long in simulated time
        assert bands[0] - bands[1] == pytest.approx(16, abs=4)
        assert bands[1] > 17 + 5
    np.testing.assert_array_equal(told.reset(seed=3)[0], begun)
    plain.close()
    told.close()


def test_a_policy_that_was_told_flies_no_task_that_tells_less() -> None:
    assert origin_of("default").keys()["knows"] == ["last_action"]
    with pytest.raises(UserError, match=r"task.knows = \(\): default was trained with \('last_action',\)"):
        make_agent("default", LaneTask(history=2))


# --- the state beside pictures ----------------------------------------------------------------------------------------


SMALL: dict[str, Any] = {"picture_size": [32, 18], "max_commands": 3}
AHEAD = np.array([1.0, 0.1, 0.0], np.float32)


@needs_opengl
def test_pictures_and_state_are_those_of_either_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds: tuple[dict[str, Any], ...] = ({"also_state": True}, {}, {"observation": "state"})
    both, pictures, state = (Navigate(**SMALL, **keys) for keys in kinds)
    space = both.observation_space
    assert isinstance(space, spaces.Dict)
    seen = [each.reset(seed=4)[0] for each in (both, pictures, state)]
    for _ in range(3):
        assert space.contains(seen[0])
        np.testing.assert_array_equal(seen[0]["image"], seen[1])
        np.testing.assert_array_equal(seen[0]["state"], seen[2])
        seen = [each.step(AHEAD)[0] for each in (both, pictures, state)]
    with closing(Navigate(**SMALL, also_state=True)) as other:
        again = other.set_state(both.get_state())
        for name, part in seen[0].items():
            np.testing.assert_array_equal(again[name], part, err_msg=name)
    for told, said in ((seen[0]["state"] * np.nan, "is not finite"), (np.zeros(2), r"returned the shape \(2,\)")):
        both.reset()
        monkeypatch.setattr(type(both.task), "features", lambda *_, told=told: told)
        with pytest.raises(UserError, match=rf"NavigateTask\.features: .*{said}"):
            both.step(AHEAD)
        monkeypatch.undo()
    for each in (both, pictures, state):
        each.close()


@needs_opengl
def test_after_a_touch_there_is_no_state_beside_pictures() -> None:
    lane = {"obstacles": [{"x_m": 1.5, "y_m": 0.0, "half_side_m": 0.5}]}
    with closing(ObstacleLane(lane=lane, observation="depth", also_state=True)) as wall:
        wall.reset(seed=0)
        seen, over = dict[str, Any](), False
        while not over:
            seen, _, over, _, info = wall.step(2)
        assert info["collision"]
        assert not seen["state"].any()
        assert seen["state"].shape == (13,)


@needs_opengl
@pytest.mark.slow
@pytest.mark.usefixtures("trainings_here")
def test_ppo_learns_from_both_and_its_games_are_exported(tmp_path: Path) -> None:
    keys = {
        "env_id": "uavaccel/Navigate-v0", "algorithm": "ppo", "games": 3, "environments": 2, "hidden": [8],
        "channels": [2], "options": {"rollout": 4, "minibatches": 2}, "task": {**SMALL, "also_state": True},
    }  # fmt: skip
    config = validate(TrainConfig, keys, "test")
    first, again = (train_into(tmp_path / name, config)["weights_sha256"] for name in ("one", "again"))
    assert first == again
    policy = load_policy(tmp_path / "one")
    assert policy.manifest["observation_shape"] == {"image": [1, 18, 32], "state": [7]}
    evaluation = configured("evaluate", "task.timing=lockstep", agent=str(tmp_path / "one"), games=1)
    run = fly_into(tmp_path / "flown", Evaluation(), evaluation)
    (row,) = run.rows()
    steps = fly_again(run, evaluation, environment_of(evaluation), row)
    assert row["actions"] == [step.action for step in steps]
    list(write_minari(run, tmp_path / "navigate-v0"))
    import h5py

    with h5py.File(tmp_path / "navigate-v0/data/main_data.hdf5") as file:
        stored = file["episode_0/observations"]
        assert stored["image"].shape == (len(steps) + 1, 1, 18, 32)
        np.testing.assert_array_equal(stored["state"][0], steps[0].given["state"])
        assert file["episode_0/actions"].dtype == np.float32


@needs_opengl
@pytest.mark.usefixtures("trainings_here")
def test_double_dqn_learns_from_both_and_its_decisions_are_shown(tmp_path: Path) -> None:
    train_into(tmp_path / "run", tiny_config({"observation": "depth", "also_state": True}, games=2, mirror=False))
    policy = load_policy(tmp_path / "run")
    assert policy.manifest["observation_shape"] == {"image": [3, 36, 64], "state": [13]}
    seen = {"image": np.zeros((2, 3, 36, 64), np.uint8), "state": np.eye(2, 13, dtype=np.float32)}
    one, other = policy.rate(seen)[1]
    assert (one != other).all(), "it reads the state"
    config = configured("evaluate", "task.timing=lockstep", agent=str(tmp_path / "run"), games=1)
    run = fly_into(tmp_path / "flown", Evaluation(), config)
    (row,) = run.rows()
    steps = fly_again(run, config, environment_of(config), row)
    assert row["actions"] == [step.action for step in steps]
    decisions = Evaluation().flight(Evaluation().report(run), row).decisions
    assert decisions is not None
    assert decisions.ratings.argmax(axis=1).tolist() == row["actions"]


# --- event images -----------------------------------------------------------------------------------------------------


@given(st.integers(0, 999), st.sampled_from([np.int32, np.uint8]))
def test_blocks_are_summed_and_clipped(seed: int, dtype: type) -> None:
    on, off = np.random.default_rng(seed).integers(0, 30, (2, 12, 20)).astype(dtype)
    sums = (on.astype(int) - off).reshape(3, 4, 5, 4).sum(axis=(1, 3))
    image = dvs_observation(on, off)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, np.clip(128 + sums, 0, 255))
    assert image.ravel().tolist() == [level_of(events) for events in sums.ravel().tolist()], "the kernels'"


# --- actions ----------------------------------------------------------------------------------------------------------


KINDS = ("attitude", "rates", "motors")


def states_of(actions: list[Any], name: str = "Hover", **keys: Any) -> NDArray[np.float64]:
    """Position, velocity and body rate (commands, 9) after each command of 0.02 s, NED and FRD."""
    env: Any = gymnasium.make(f"uavaccel/{name}-v0", t_move_s=0.02, t_sample_s=0.02, **keys)
    env.reset(seed=0)
    states = []
    for action in actions:
        env.step(np.asarray(action, np.float32))
        state = env.unwrapped._now.state
        states.append([*state.position_m, *state.linear_velocity_m_s, *state.angular_velocity_rad_s])
    env.close()
    return np.array(states)


def test_shares_become_goals() -> None:
    shares = [0.5, -1.0, 0.25, 0.0]
    attitude = HoverTask(action="attitude", tilt_deg=20.0, rate_deg_s=90.0).goal(shares)
    assert isinstance(attitude, AttitudeGoal)
    assert np.degrees(astuple(attitude)[:3]) == pytest.approx([10, -20, 22.5])
    assert attitude.throttle == HOVER_THROTTLE
    rates = HoverTask(action="rates", rate_deg_s=90.0).goal([0.5, -1.0, 0.25, 1.0])
    assert isinstance(rates, BodyRatesGoal)
    assert np.degrees(astuple(rates)[:3]) == pytest.approx([45, -90, 22.5])
    assert rates.throttle == 1.0
    motors = HoverTask(action="motors").goal([-1.0, 0.0, 1.0, -0.5])
    assert motors == MotorsGoal(0.0, HOVER_THROTTLE, 1.0, HOVER_THROTTLE / 2)


def test_games_over_arrays_ask_the_autopilot_for_what_the_server_does() -> None:
    rng = np.random.default_rng(0)
    with VirtualSession("blocks", "native") as session:
        client = session.start_game(1.0)
        for _ in range(9):
            velocity, (height_m, turn) = tuple(rng.uniform(-2, 2, 3).tolist()), rng.uniform(-9, 3, 2).tolist()
            one, two, three, share = rng.uniform(0, 1, 4).tolist()
            held, attitude = VelocityGoal(velocity, height_m, turn, False), AttitudeGoal(one, two, three, share)
            others = BodyRatesGoal(one, two, three, share), MotorsGoal(one, two, three, share)
            for goal in (VelocityGoal(velocity, None, turn), held, attitude, *others):
                client.move_async(goal, 0.5)
                client.continue_for(20_000_000)
                flown = {name: rows[0] for name, rows in session._present().world.lead.field.items()}
                modes = (int(flown[name]) for name in ("xy_mode", "z_mode", "yaw_mode"))
                assert Goal(tuple(flown["goal"].tolist()), *modes) == autopilot_goal(goal), goal


@pytest.mark.parametrize("kind", KINDS)
def test_zero_hovers(kind: str) -> None:
    states = states_of([np.zeros(4)] * 100, action=kind)
    np.testing.assert_allclose(states[:, :3], [[0.0, 0.0, -10.0]] * 100, atol=0.05)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("timing", ["virtual", "lockstep"])
def test_tcsc_flies_them_the_same_at_any_clock_speed(kind: str, timing: str) -> None:
    actions = np.random.default_rng(1).uniform(-0.2, 0.2, (20, 4))
    flights = [
        states_of(list(actions), "Gates", action=kind, timing=timing, clock_speed=speed) for speed in (1.0, 50.0)
    ]
    np.testing.assert_array_equal(flights[0], flights[1])
    adsc = states_of(list(actions), "Gates", action=kind, timing="virtual", command="adsc", clock_speed=50.0)
    assert np.abs(adsc - flights[0]).max() > 0.01
