"""Keys, options and actions that environments and batches refuse: one clear line each."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch as th

import uavaccel.envs  # noqa: F401 - registers
from tests.running import configured
from uavaccel.envs.gates import Gates
from uavaccel.envs.hover import Hover
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import make_batch
from uavaccel.errors import UserError

Keys = dict[str, Any]
Table = list[tuple[Keys, str]]

LANE: Table = [
    ({"observaton": "dvs"}, "unknown key 'observaton'; did you mean 'observation'?"),
    ({"observation": "lidar"}, "observation = 'lidar'"),
    ({"action": "rates"}, "action = rates: the lane's actions are headings"),
    ({"observation": "state", "also_state": True}, "also_state needs pictures"),
    ({"headings_deg": []}, "headings_deg = []: needs at least one heading"),
    ({"headings_deg": [0.0, 30.0, 0.0]}, "must not have one heading twice"),
    ({"max_commands": 0}, "max_commands = 0"),
    ({"lane": {"obstacles": [{"x_m": 12, "y_m": 0.2}]}}, "should have radius_m"),
    ({"lane": "nowhere.yaml"}, "nowhere.yaml"),
    ({"difficulty": {"obstacles_per_row": 4, "min_gap_m": 5.0}}, "the lane is 10 m wide"),
    ({"difficulty": {"first_row_m": 1.1, "half_width_m": 1.0}}, "half_width_m = 1 reaches the start, within 0.3418 m"),
    # times
    ({"t_move_s": 0.003}, "t_move_s: 0.003 s is not a positive multiple of the physics step of 2 ms"),
    ({"t_sample_s": 1e-12}, "t_sample_s: 1e-12 s is not a positive multiple"),
    ({"t_move_s": 1.0, "t_sample_s": 0.333}, "t_sample_s: 0.333 s is not a positive multiple"),
    ({"t_move_s": 1e-9, "profile": "airsim"}, "t_move_s: 1e-09 s is too short for the airsim profile"),
    ({"t_sample_s": 0.0001, "profile": "airsim"}, "t_sample_s: 0.0001 s is too short"),
    # event cameras, and what is told beside them
    ({"dvs_preset": "foggy"}, "dvs_preset = 'foggy'"),
    ({"dvs_rate_hz": 300.0}, "does not divide the 500 steps per second of the physics; 250 does"),
    ({"dvs_rate_hz": 900.0}, "500 does"),
    ({"dvs_rate_hz": 2.5}, "dvs_rate_hz = 2.5: must give a frame in each sample of 0.33 s"),
    ({"dvs_rate_hz": 100.0, "observation": "depth"}, "need observation dvs"),
    ({"dvs_rate_hz": 100.0, "timing": "wall"}, "timing virtual or lockstep"),
    ({"dvs_rate_hz": -1.0}, "dvs_rate_hz"),
    ({"list_events": True, "observation": "depth"}, "need observation dvs"),
    ({"knows": ["frame_age"], "picture_size": [64, 36]}, "context planes need [256, 144]"),
    ({"knows": ["last_action"], "observation": "state"}, "knows needs pictures"),
    ({"knows": ["last_action", "last_action"]}, "must not name one thing twice"),
    ({"knows": ["last_acton"]}, "last_acton"),
    # conditions
    ({"randomise": {"wind_m_s": [6, 0]}}, "least, most"),
    ({"randomise": {"wind_m_s": [0, 99]}}, "wind_m_s"),
    ({"randomise": {"light": [0, 2]}}, "light"),
    ({"randomise": {"min_gap_m": [2, 10]}}, "min_gap_m"),
    ({"randomise": {"mass_ratio": [1, 1.3], "thrust_ratio": [0.8, 1.5]}}, "mass_ratio"),
    ({"randomise": {"mass_ratio": [0.8, 1.5], "thrust_ratio": [1, 1.5]}}, "least 0.55 times thrust_ratio, 1.5, or"),
    ({"randomise": {"wnd_m_s": [0, 1]}}, "did you mean"),
    ({"randomise": {"latency_scale": [0, 1]}, "timing": "lockstep"}, "timing virtual"),
    ({"randomise": {"wind_m_s": [0, 1]}, "lane": {"obstacles": []}}, "leave lane out"),
    ({"randomise": {"speed_m_s": [-1, 1]}}, "speed_m_s"),
    ({"randomise": {"speed_m_s": [1, 2], "share": 0}}, "share"),
    ({"randomise": {"speed_m_s": [1, 2], "shares": {"speed_m_s": 2}}}, "shares.speed_m_s"),
    ({"randomise": {"speed_m_s": [1, 2], "shares": {"light": 0.5}}}, "shares.light: there is no range"),
]
GATES: Table = [
    ({"gates": 10**6}, "gates = 1000000: should be less than or equal to 32"),
    ({"gates": 26}, "gates = 26 with spacing_m = 6 need 156 m; the lane is 150 m long"),
    ({"spacing_m": 0.2}, "spacing_m = 0.2: should be greater than 0.5418"),
    ({"spread_m": 4.0}, "spread_m = 4 with half_width_m = 1 need 10.4 m; the lane is 10 m wide"),
    ({"altitude_m": 1e5}, "altitude_m = 100000.0: should be less than or equal to 4000"),
]
BATCHES: Table = [
    ({"num_envs": 0}, "num_envs = 0: must be a whole number, at least 1"),
    ({"num_envs": "2"}, "num_envs = '2': must be a whole number"),
    ({"num_envs": "2", "simulator": "kernels"}, "num_envs = '2': must be a whole number"),
    ({"processes": "x"}, "processes = 'x': must be a whole number"),
    ({"simulator": "kernels", "threads": 0}, "threads = 0: must be a whole number, at least 1"),
    ({"autoreset_mode": "x"}, "autoreset_mode = 'x' is unknown; there are NextStep, SameStep"),
    ({"autoreset_mode": "x", "simulator": "kernels"}, "autoreset_mode = 'x' is unknown"),
    ({"render_mode": "x"}, "render_mode = 'x' is unknown; there are None, rgb_array"),
    ({"timing": "wall", "processes": 1}, "a batch flies in virtual or lockstep"),
    ({"speed": 3.0}, "speed"),
    ({"simulator": "kernel"}, "simulator = 'kernel' is unknown; there are mujoco, kernels"),
    ({"simulator": "kernels", "device": "gpu"}, "device = 'gpu' is unknown; there are cpu, cuda"),
    ({"device": "cuda"}, "device = cuda: simulator = mujoco flies on the CPU"),
    ({"simulator": "kernels", "device": "cuda"}, "device = cuda: "),
    ({"simulator": "kernels", "processes": 2}, "processes: needs simulator = mujoco"),
    ({"simulator": "kernels", "render_mode": "rgb_array"}, "render_mode: needs simulator = mujoco"),
    ({"simulator": "kernels", "timing": "wall"}, "simulator = kernels: timing wall"),
    ({"simulator": "kernels", "clock_speed": 1.23456789}, "clock_speed = 1.23456789 has more digits"),
    ({"simulator": "kernels", "list_events": True}, "list_events needs single events"),
    ({"simulator": "kernels", "difficulty": {"scenery": "forest"}}, "its looks are textured meshes"),
    ({"simulator": "kernels", "picture_size": [64, 36]}, "the lane is rendered in [256, 144] only"),
]
OPTIONS: list[tuple[type[Any], Any, str]] = [
    (ObstacleLane, {"lanes": 3}, "reset: unknown option 'lanes'; known: lane"),
    (ObstacleLane, {"lane": "seven"}, "option lane = 'seven' must be a whole number"),
    (ObstacleLane, {"lane": 1.5}, "option lane = 1.5 must be a whole number"),
    (ObstacleLane, {"lane": 10**6}, "lane 1000000 does not exist"),
    (Hover, {"lane": 3}, "unknown option 'lane'; known: waypoint_m"),
    (Hover, {"waypoint_m": [1, 2]}, "must be [north, east, down]"),
    (Hover, {"waypoint_m": [1, 2, float("nan")]}, "must be [north, east, down]"),
    (Gates, {"gates_m": [1, 2, 3]}, "must be [[north, east, down], ...]"),
    (Gates, {"gates_m": [[1000, 0, -2]]}, "lane: obstacles.0.x_m = 1000.0: should be less than or equal to 150"),
    (Gates, {"gates_m": [[9, 0, -2]] * 1000}, "lane: obstacles = "),
    (Gates, 3, "reset: options = 3: must be a mapping, of gates_m"),
    (Navigate, {"world": -1}, "option world = -1: must be an index from 0 to 999999"),
]


def reset(kind: type[Any], options: Any) -> None:
    kind(observation="state").reset(options=options)


REFUSED: list[tuple[Callable[..., Any], Keys, str]] = [
    *((ObstacleLane, *line) for line in LANE),
    *((Gates, *line) for line in GATES),
    (Hover, {"action": "thrust"}, "action"),
    (Navigate, {"observation": "state", "also_state": True}, "also_state needs pictures"),
    *(
        (partial(gymnasium.make_vec, "uavaccel/ObstacleLane-v0"), {"num_envs": 2, **keys}, said)
        for keys, said in BATCHES
    ),
    *((reset, {"kind": kind, "options": options}, said) for kind, options, said in OPTIONS),
    (partial(configured, "train", "task.also_state=true"), {}, "mirror must be false: it needs pictures alone, and"),
    (partial(configured, "train", "turns=999"), {}, "turns must be at most environments: 999 of"),
    (
        partial(configured, "train", "task.also_state=true", "mirror=false", "algorithm=sb3_dqn"),
        {},
        "task.also_state needs algorithm double_dqn or ppo, not sb3_dqn",
    ),
    *(
        (partial(configured, "dp2", "dvs_rate_hz=100", *more), {"timing": timing}, "dvs_rate_hz needs timing and ref")
        for timing, more in (("wall", ()), ("virtual", ("reference_timing=wall",)))
    ),
]


@pytest.mark.parametrize(("make", "keys", "said"), REFUSED)
def test_what_does_not_fit_is_one_clear_line(
    make: Callable[..., Any], keys: Keys, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(th.cuda, "is_available", lambda: False)
    with pytest.raises(UserError) as raised:
        make(**keys)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("simulator", ["mujoco", "kernels"])
def test_what_a_batch_is_asked_wrongly_is_one_clear_line(simulator: Any) -> None:
    """None of it flies a part of the environments, or waits for what does not come."""
    batch: Any = make_batch(ObstacleLane, 2, simulator, observation="state")
    wrong: list[tuple[Callable[[], Any], str]] = [
        *((partial(batch.step, each), r"^actions: must be of shape \(2,\), an action for each") for each in SHAPELESS),
        (partial(batch.step, [0, 99]), r"^action .*99.* is not in the action space"),
        *((partial(batch.reset, seed=seed), r"^reset: seed") for seed in (-1, [1, -1], "ab", 1.5, [1], True)),
        (partial(batch.reset, options=3), r"^reset: options = 3: must be a mapping, of lane$"),
    ]
    with pytest.raises(RuntimeError if simulator == "mujoco" else UserError, match=r"no command was|was not asked"):
        batch.step_wait()
    before = batch.reset(seed=0)[0]
    for asked, said in wrong:
        with pytest.raises(UserError, match=said):
            asked()
    np.testing.assert_array_equal(batch.reset(seed=0)[0], before)
    batch.close()


SHAPELESS: list[Any] = [[0], [0, 1, 2], [[0, 1]], 3, None, [[1], [2, 3]]]


def test_an_unknown_keyword_is_also_pythons_error() -> None:
    """TorchRL's GymEnv passes `frameskip` and goes on without it when it meets this TypeError."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip"):
        gymnasium.make("uavaccel/Hover-v0", frameskip=1, spare=2)


@pytest.mark.parametrize("kind", [ObstacleLane, Hover])
def test_wrong_actions_and_steps_before_a_reset_are_refused(kind: type[Any]) -> None:
    headings, velocities = [-1, 5, 1.0, "north", None], [[0.0, 0.0], [0.0, 0.0, 1.1], [0.0, 0.0, np.nan], ["a"] * 3, 0]
    environment = kind(observation="state")
    with pytest.raises(UserError, match="reset the environment"):
        environment.step(2)
    with pytest.raises(UserError, match=r"^reset: seed = -1: must be a whole number, at least 0$"):
        environment.reset(seed=-1)
    environment.reset(seed=0)
    for action in headings if kind is ObstacleLane else velocities:
        with pytest.raises(UserError, match="not in the action space"):
            environment.step(action)
    environment.close()
