"""Several drones in one world: PettingZoo's interface, what they see and touch of one another, and flights as alone."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test  # type: ignore[import-untyped]

from tests.opengl import needs_opengl
from uavaccel.envs.hover import Hover
from uavaccel.envs.swarm import Swarm, SwarmTask
from uavaccel.errors import UserError

NORTH, SOUTH, DOWN, STAY = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
IN_LINE: dict[str, Any] = {
    "starts_m": [[0.0, 0.0, -5.0], [4.0, 0.0, -5.0], [0.0, 30.0, -5.0]],
    "goals_m": [[50.0, 0.0, -5.0], [-50.0, 0.0, -5.0], [2.0, 30.0, -5.0]],
}


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_it_passes_the_tests_of_pettingzoo(capsys: pytest.CaptureFixture[str]) -> None:
    with closing(Swarm(drones=3, max_commands=8)) as drones:
        parallel_api_test(drones, num_cycles=30)
    parallel_seed_test(lambda: Swarm(drones=2, max_commands=4), num_cycles=10)
    capsys.readouterr()


def test_drones_that_meet_touch_each_other_and_leave() -> None:
    with closing(Swarm(drones=3)) as drones:
        drones.reset(options=IN_LINE)
        last: dict[str, Any] = {}
        for _ in range(40):
            actions = dict(zip(drones.possible_agents, (NORTH, SOUTH, NORTH), strict=True))
            told = drones.step({agent: actions[agent] for agent in drones.agents})
            last |= {agent: [each[agent] for each in told[1:]] for agent in told[0]}
            if not drones.agents:
                break
        (reward, over, cut, info), (_, _, _, other), (won, *_, third) = (
            last[agent] for agent in drones.possible_agents
        )
        assert (info["collision"], other["collision"], third["collision"]) == ("drone_1", "drone_0", None)
        assert (over, cut, reward < -9.0) == (True, False, True)
        assert 1.2 < info["position_m"][0] < other["position_m"][0] < 2.8
        assert other["position_m"][0] - info["position_m"][0] == pytest.approx(0.68, abs=0.01), "where they touched"
        assert (third["is_success"], won > 10.0) == (True, True)
        assert third["distance_m"] <= 0.5
        # a game that follows does not know of it
        assert [each["collision"] for each in drones.reset(options=IN_LINE)[1].values()] == [None] * 3
        assert all(not each["collision"] for each in drones.step(dict.fromkeys(drones.agents, STAY))[4].values())


def test_who_wins_with_the_last_command_is_not_cut_short() -> None:
    with closing(Swarm(drones=3, max_commands=1)) as drones:
        drones.reset(options=IN_LINE | {"goals_m": [[0.3, 0.0, -5.0], *IN_LINE["goals_m"][1:]]})
        _, _, over, cut, _ = drones.step(dict.fromkeys(drones.agents, STAY))
        assert [(over[agent], cut[agent]) for agent in over] == [(True, False), (False, True), (False, True)]


def test_a_seed_repeats_its_game_and_those_that_follow() -> None:
    with closing(Swarm(drones=2)) as drones:
        seeds = (3, None, 3, None)
        first, second, *again = [drones.reset(seed)[1]["drone_0"]["goal_m"] for seed in seeds]
        assert first != second
        assert again == [first, second]


def test_a_drone_far_from_others_flies_as_it_does_alone() -> None:
    actions = np.random.default_rng(2).uniform(-1.0, 1.0, (6, 3)).astype(np.float32)
    alone = Hover(altitude_m=5.0, speed_m_s=2.0)
    alone.reset(seed=0, options={"waypoint_m": [50.0, 0.0, -5.0]})
    starts_m = [[0.0, 0.0, -5.0], [40.0, 9.0, -5.0], [0.0, 30.0, -5.0]]
    with closing(Swarm(drones=3, altitude_m=5.0)) as drones:
        drones.reset(options=IN_LINE)
        _, infos = drones.reset(options=IN_LINE | {"starts_m": starts_m})
        np.testing.assert_allclose([info["position_m"] for info in infos.values()], starts_m)
        for action in actions:
            seen = alone.step(action)[0]
            others = drones.step({"drone_0": action, "drone_1": STAY, "drone_2": STAY})[0]
            np.testing.assert_allclose(others["drone_0"][:13], seen, atol=1e-6)
    alone.close()


def test_each_is_told_where_the_others_are_until_they_are_gone() -> None:
    with closing(Swarm(drones=3)) as drones:
        starts_m, goals_m = [[4.0, 0, -9], [4.0, 0, -5], [0.0, 30, -5]], [[50.0, 0, -5], [4.3, 0, -5], [0.0, 90, -5]]
        observations, _ = drones.reset(options={"starts_m": starts_m, "goals_m": goals_m})
        np.testing.assert_allclose(observations["drone_0"][13:16], [0.0, 0.0, 4.0], atol=1e-5)
        np.testing.assert_allclose(observations["drone_2"][13:16], [4.0, -30.0, -4.0], atol=1e-5)
        first = drones.step({"drone_0": DOWN, "drone_1": STAY, "drone_2": STAY})
        assert first[2]["drone_1"], "which began at its goal"
        velocity = -first[0]["drone_2"][16:19]
        seen = drones.step({"drone_0": DOWN, "drone_2": STAY})[0]
        assert velocity[2] < 0.0 == seen["drone_0"][13:19].max() == seen["drone_0"][13:19].min()
        assert seen["drone_0"][19:22][1] == pytest.approx(30.0, abs=0.1)
        while (info := drones.step({"drone_0": DOWN, "drone_2": STAY})[4]["drone_0"])["position_m"][2] < -4.0:
            assert info["collision"] is None, "with one that has left"


@needs_opengl
def test_a_camera_sees_the_drone_in_front_of_it() -> None:
    """And what is in front of its own when another, which is at its goal from the first, has left."""
    options = IN_LINE | {"starts_m": [[0.0, 0.0, -5.0], [2.0, 0.0, -5.0], [0.0, 30.0, -5.0]]}
    options["goals_m"] = [options["starts_m"][0], *IN_LINE["goals_m"][1:]]
    with closing(Swarm(drones=3, observation="depth", also_state=True)) as drones:
        seen, _ = drones.reset(options=options)
        assert seen["drone_0"]["image"].shape == (1, 36, 64)
        assert seen["drone_0"]["state"].shape == (25,)
        behind, ahead = (seen[agent]["image"][0].astype(int) for agent in ("drone_0", "drone_1"))
        rows, columns = np.nonzero((ahead - behind)[:, 20:44] > 20)  # a level is 20 cm; further aside are buildings
        assert set(rows.tolist()) == {17, 18}
        assert (columns.min(), columns.max()) == (6, 17)
        for _ in range(2):
            later = drones.step(dict.fromkeys(drones.agents, STAY))[0]
        assert list(later) == ["drone_1", "drone_2"]
        for agent, now in later.items():
            assert np.abs(now["image"].astype(int) - seen[agent]["image"]).mean() < 1.0


class Slow(SwarmTask):
    def reward(self, before: Any, now: Any) -> float:
        return float(now.commands)


def test_a_task_of_ones_own_judges_each_drone() -> None:
    class Slowly(Swarm):
        task_class = Slow

    with closing(Slowly(drones=2, max_commands=2)) as drones:
        drones.reset(seed=0)
        rewards = [drones.step(dict.fromkeys(drones.agents, STAY))[1] for _ in range(2)]
        assert rewards == [{"drone_0": 1.0, "drone_1": 1.0}, {"drone_0": 2.0, "drone_1": 2.0}]
        assert drones.agents == []


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"drones": 1}, r"^Swarm: drones = 1: "),
        ({"command": "adsc"}, r"command = 'adsc': several drones fly with 'tcsc' alone"),
        ({"profile": "airsim"}, "profile = 'airsim'"),
        ({"history": 2}, r"history = 2: several drones fly with 1 alone"),
        *(
            ({"observation": "dvs", key: value}, f"{key} = {value}: several drones fly with .* alone")
            for key, value in (
                *(("image_noise", 2.0), ("dvs_shot_noise_hz", 1.0), ("dvs_leak_hz", 1.0), ("dvs_rate_hz", 100.0)),
                *(("blank_images", True), ("list_events", True), ("report_host_times", True)),
            )
        ),
        ({"timing": "virtual"}, r"timing = 'virtual'"),
        ({"t_move_s": 0.4}, "t_sample_s equal to t_move_s"),
        ({"drone": 3}, "unknown key 'drone'"),
        ({"altitude_m": 0.2}, "altitude_m = 0.2: needs 0.3, as some start 0.2 m lower"),
    ],
)
def test_keys_that_several_drones_cannot_fly_are_refused(keys: Mapping[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        Swarm(**keys)


def test_mistakes_in_a_reset_or_a_step_are_one_line() -> None:
    with closing(Swarm(drones=2)) as drones:
        with pytest.raises(UserError, match=r"^reset the drones before their first step$"):
            drones.step({})
        with pytest.raises(UserError, match=r"option starts_m must be 2 places \[north, east, down\] in metres"):
            drones.reset(options={"starts_m": [[0, 0, -5]]})
        with pytest.raises(UserError, match=r"^drone_1 would start less than 0.75 m from drone_0$"):
            drones.reset(options={"starts_m": [[0, 0, -5], [0.1, 0, -5]]})
        with pytest.raises(UserError, match=r"NED z has to be from"):
            drones.reset(options={"starts_m": [[0, 0, 5], [4, 0, -5]]})
        with pytest.raises(UserError, match=r"^reset: options = \[1\]: must be a mapping, of starts_m, goals_m$"):
            drones.reset(options=[1])  # type: ignore[arg-type]
        drones.reset(options={"starts_m": [[500, 0, -10], [500, 10, -10]]})  # as far off as any other place
        drones.reset(seed=0)
        with pytest.raises(UserError, match=r"^step: drone_1 has no action$"):
            drones.step({"drone_0": STAY})
        with pytest.raises(UserError, match="is not in the action space"):
            drones.step({"drone_0": STAY, "drone_1": [2.0, 0.0, 0.0]})
