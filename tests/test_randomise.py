"""Domain randomisation: what is drawn at reset, that it acts, that games are saved with it, and that off is off."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import model_validator

from tests.learning import fly_here, tiny_config, train_into
from tests.opengl import needs_opengl
from uavaccel.envs.conditions import Ranges
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.records import RunDirectory
from uavaccel.sim.flight import of_velocity
from uavaccel.sim.lane import HEAVIEST, LIGHTEST, Difficulty, sample_layout
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.world import World

RANGES: dict[str, Any] = {
    "wind_m_s": [0, 6],
    "light": [0.1, 1.0],
    "row_spacing_m": [7, 15],
    "speed_m_s": [0.8, 2.2],
    "altitude_m": [1.5, 4],
    "mass_ratio": [0.8, 1.3],
    "dvs_threshold_ratio": [0.7, 1.5],
    "latency_scale": [0, 16],
}


def lane(**keys: Any) -> ObstacleLane:
    return ObstacleLane(**{"observation": "state", "timing": "virtual", "command": "adsc", **keys})


def test_a_seed_draws_the_same_lane_under_any_conditions() -> None:
    with_ranges, without = lane(randomise=RANGES), lane()
    _, drawn = with_ranges.reset(seed=5)
    _, usual = without.reset(seed=5)
    assert drawn["lane"] == usual["lane"]
    assert "conditions" not in usual
    assert set(drawn["conditions"]) == set(RANGES)
    assert all(RANGES[name][0] <= value <= RANGES[name][1] for name, value in drawn["conditions"].items())
    assert with_ranges.reset(seed=5)[1] == drawn  # whatever was flown before
    assert with_ranges.reset(seed=5, options={"lane": drawn["lane"]})[1] == drawn  # and whether it is asked for
    assert with_ranges.reset()[1]["conditions"] != drawn["conditions"]


@pytest.mark.parametrize(
    ("name", "value", "keys"),
    [
        ("speed_m_s", 2.0, {"speed_m_s": 2.0}),
        ("altitude_m", 3.5, {"altitude_m": 3.5}),
        ("wind_m_s", 8.0, {"difficulty": {"wind_m_s": 8.0}}),
        ("row_spacing_m", 2.0, {"difficulty": {"row_spacing_m": 2.0}}),
        ("mass_ratio", 1.4, {"difficulty": {"mass_ratio": 1.4}}),
        ("thrust_ratio", 1.2, {"difficulty": {"thrust_ratio": 1.2}}),
        ("latency_scale", 20.0, {"latency": "20x"}),
    ],
)
def test_a_drawn_condition_flies_as_the_key_of_its_name(name: str, value: float, keys: Any) -> None:
    """A range of one value is that value, to the last bit; and it differs from the task without it."""
    if name == "latency_scale":
        keys = {"latency": {**LaneTask().latency.model_dump(mode="json"), "scale": value}}

    def flown(**keys: Any) -> np.ndarray[Any, Any]:
        environment, seen = lane(clock_speed=20.0, t_move_s=0.5, t_sample_s=0.5, **keys), []
        for _ in range(2):  # the second time in a session of its own
            environment.reset(seed=1)
            seen.append(np.stack([environment.step(action)[0] for action in (2, 3, 3, 1)]))
            environment.close()
        np.testing.assert_array_equal(seen[0], seen[1])
        return seen[0]

    drawn = flown(randomise={name: [value, value]})
    np.testing.assert_array_equal(drawn, flown(**keys))
    if name != "row_spacing_m":  # which a vehicle does not feel
        assert not np.array_equal(drawn, flown())


def test_a_vehicle_accelerates_as_its_thrust_over_its_mass() -> None:
    """At full throttle from a hover, in numpy: a = g - 4 T / m, with the rotors' own lag long over."""
    world = World("lane", PROFILES["native"])
    for mass, thrust in ((1.0, 1.0), (1.3, 1.0), (1.3, 1.2), (1.0, 1.0)):
        world.set_lane(sample_layout(0, Difficulty(obstacles_per_row=0, mass_ratio=mass, thrust_ratio=thrust)))
        world.reset((0.0, 0.0, -2.0))
        hover = float(world.lead.state["rotor_output"][0])
        world.advance(100)
        assert abs(world.lead.kinematics().position_m[2] + 2.0) < 1e-3
        world.lead.set_goal(of_velocity(VelocityGoal((0.0, 0.0, -5.0))))
        world.advance(60)
        before_m_s = world.lead.kinematics().linear_velocity_m_s[2]
        output = world.lead.state["rotor_output"].mean()
        world.advance(1)
        gained = (world.lead.kinematics().linear_velocity_m_s[2] - before_m_s) / PROFILES["native"].tick_s
        assert gained == pytest.approx(9.80665 * (1 - output / hover), abs=0.2)
        assert hover == pytest.approx(0.5935 * mass / thrust, rel=1e-3)
        craft = world.lead.parameters
        assert craft["max_torque_n_m"] / craft["max_thrust_n"] == pytest.approx(0.0555624 / 4.179446, rel=1e-4)
        body = world.model.body("quadrotor")  # which MuJoCo steps near obstacles
        assert [*body.mass, *body.subtreemass, *world.model.dof_M0[:3]] == pytest.approx([craft["mass_kg"]] * 5)


@pytest.mark.parametrize(("mass", "thrust"), [(LIGHTEST, 1.0), (HEAVIEST, 1.0), (0.83, 1.5), (1.04, 0.7)])
def test_the_lightest_and_the_heaviest_climb_and_descend(mass: float, thrust: float) -> None:
    world = World("lane", PROFILES["native"])
    world.set_lane(sample_layout(0, Difficulty(obstacles_per_row=0, mass_ratio=mass, thrust_ratio=thrust)))
    world.reset((0.0, 0.0, -9.0))
    for speed_m_s in (-1.0, 1.0):
        world.lead.set_goal(of_velocity(VelocityGoal((0.0, 0.0, speed_m_s))))
        world.advance(2000)
        assert world.lead.kinematics().linear_velocity_m_s[2] == pytest.approx(speed_m_s, abs=0.1)


@settings(max_examples=40)
@given(games=st.integers(0, 40), over=st.integers(0, 30), seed=st.integers(0, 99))
def test_ranges_widen_with_the_games_from_the_usual_to_the_whole(games: int, over: int, seed: int) -> None:
    ranges = Ranges(wind_m_s=(0.0, 6.0), light=(0.1, 1.0), widen_over_games=over)
    usual = {"wind_m_s": (0.0, 0.0), "light": (0.7, 1.0)}
    share = 1.0 if over == 0 else min(games / over, 1.0)
    widened = ranges.widened(games, usual).given()
    assert widened["wind_m_s"] == pytest.approx((0.0, 6.0 * share))
    assert widened["light"] == pytest.approx((0.7 - 0.6 * share, 1.0))
    drawn = ranges.widened(games, usual).sample(np.random.default_rng(seed))
    assert 0.0 <= drawn["wind_m_s"] <= 6.0 * share + 1e-12


def test_a_share_of_the_conditions_is_drawn_and_the_others_stay() -> None:
    environment = lane(randomise={"wind_m_s": [3, 6], "light": [0.1, 0.2], "share": 0.5})
    games = [(environment.reset(seed=seed)[1].get("conditions", {}), environment.episode_task) for seed in range(8)]
    assert {len(conditions) for conditions, _ in games} == {0, 1, 2}
    for conditions, task in games:
        assert task.difficulty.wind_m_s == conditions.get("wind_m_s", 0.0)
        light = conditions.get("light")
        assert task.difficulty.light == ((0.7, 1.0) if light is None else (light, light))
    environment.close()


@needs_opengl
def test_conditions_end_with_their_game_and_frames_between_samples_take_no_time() -> None:
    ranges = {"latency_scale": [9, 9], "dvs_threshold_ratio": [3, 3], "share": 0.5}
    told: dict[int, Any] = {}
    for keys in ({}, {"dvs_rate_hz": 20.0}):
        with closing(lane(observation="dvs", t_move_s=0.33, randomise=ranges, **keys)) as environment:
            for seed in (0, 1, 0):
                environment.reset(seed=seed)
                camera: Any = environment.sensor
                assert camera.counter.sensor.parameters == environment.episode_task.dvs_parameters
                info = environment.step(2)[4]
                assert told.setdefault(seed, info) == info
    assert [len(told[seed].get("conditions", ())) for seed in (0, 1)] == [0, 2]


def test_ranges_that_fit_together_alone_are_sampled_together() -> None:
    ranges: dict[str, Any] = {"mass_ratio": [1.4, 1.4], "thrust_ratio": [1.2, 1.2]}
    lane(randomise=ranges, difficulty={"thrust_ratio": 0.8}).close()
    with pytest.raises(UserError, match=r"mass_ratio = 1\.4 must be at most 1.5 times thrust_ratio"):
        lane(randomise={**ranges, "share": 0.5}, difficulty={"thrust_ratio": 0.8})


def test_a_condition_may_have_a_share_of_its_own() -> None:
    for keys in ({"share": 0.1, "shares": {"wind_m_s": 0.6}}, {"shares": {"light": 0.1, "wind_m_s": 0.6}}):
        ranges, random = Ranges(wind_m_s=(3.0, 6.0), light=(0.1, 0.5), **keys), np.random.default_rng(0)
        drawn = [ranges.sample(random) for _ in range(1000)]
        for name, share in (("wind_m_s", 0.6), ("light", 0.1)):
            three_deviations = 3 * (1000 * share * (1 - share)) ** 0.5
            assert sum(name in each for each in drawn) == pytest.approx(1000 * share, abs=three_deviations)
    always = Ranges(wind_m_s=(3.0, 6.0), light=(0.1, 0.5), share=0.5, shares={"wind_m_s": 1, "light": 1})
    usual = Ranges(wind_m_s=(3.0, 6.0), light=(0.1, 0.5))
    same = [each.sample(np.random.default_rng(7)) for each in (always, usual)]
    assert same[0] == same[1]


def test_evaluation_lanes_have_the_whole_ranges_at_once() -> None:
    environment = lane(split="evaluation", randomise={"wind_m_s": [5, 6], "widen_over_games": 100})
    told = environment.reset(seed=0)[1]["conditions"]
    assert told.pop("wind_m_s") >= 5
    assert "wind_m_s" in environment.step(2)[4]["conditions"], "what is told is the caller's own"


def test_a_task_with_keys_of_its_own_is_randomised_within_them() -> None:
    class Slow(LaneTask):
        fastest_m_s: float = 3.0

        @model_validator(mode="after")
        def _is_slow(self) -> Self:
            if self.speed_m_s > self.fastest_m_s:
                raise ValueError("too fast")
            return self

    assert Slow(randomise=Ranges(speed_m_s=(1.0, 3.0))).sample_conditions(np.random.default_rng(0), 0)
    with pytest.raises(UserError, match=r"randomise: .*too fast"):
        Slow(randomise=Ranges(speed_m_s=(1.0, 4.0)))


def test_a_seed_begins_the_widening_anew() -> None:
    """Of an environment's games: the first has the usual wind, and each is drawn from wider ranges than the last."""
    keys: dict[str, Any] = {
        "observation": "state", "max_commands": 1, "randomise": {"wind_m_s": [8, 8], "widen_over_games": 4},
    }  # fmt: skip
    alone, widening = lane(**keys), [0.0, 2.0, 4.0, 6.0, 8.0, 8.0]
    for _ in range(2):
        seeds = (3, *[None] * 5)
        assert [alone.reset(seed=seed)[1]["conditions"]["wind_m_s"] for seed in seeds] == widening
    with closing(KernelBatch(ObstacleLane, 2, autoreset_mode="SameStep", **keys)) as batch:
        for _ in range(2):
            infos = [batch.reset(seed=3)[1], *(batch.step([2, 2])[4] for _ in range(5))]
            assert [info["conditions"]["wind_m_s"].tolist() for info in infos] == [[wind] * 2 for wind in widening]


@pytest.mark.slow
def test_rows_tell_the_conditions_also_after_an_interruption(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fly_here(monkeypatch.setattr)
    task = {"observation": "state", "randomise": {"wind_m_s": [0, 6], "widen_over_games": 3}}
    config = tiny_config(task, mirror=False)
    train_into(tmp_path / "whole", config)
    with monkeypatch.context() as patch:
        append = RunDirectory.append_row

        def interrupted(run: RunDirectory, row: Any, on_disk: bool = True) -> None:
            if row["game"] == 3:
                raise KeyboardInterrupt
            append(run, row, on_disk)

        patch.setattr(RunDirectory, "append_row", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train_into(tmp_path / "resumed", config)
    train_into(tmp_path / "resumed", config, resume=True)
    rows = RunDirectory(tmp_path / "whole").rows()
    winds = [row["conditions"]["wind_m_s"] for row in rows]
    assert winds[0] == 0.0
    assert len(set(winds)) == 4
    assert RunDirectory(tmp_path / "resumed").rows() == rows
