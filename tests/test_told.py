"""What an agent is told beside its pictures: planes that a mirror turns, ages, and pictures as they were."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch as th
from hypothesis import given
from hypothesis import strategies as st

from tests.learning import tiny_config
from tests.opengl import needs_opengl
from uavaccel.envs.context_planes import ContextPlanes
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.errors import UserError
from uavaccel.rl.agents import make_agent, origin_of
from uavaccel.rl.double_dqn import HostDQN
from uavaccel.rl.network import contrast, turned_actions
from uavaccel.rl.replay import Levels, Windows

KNOWS = ("last_action", "frame_age")
MS = 1_000_000


def action_plane(headings: list[float], action: int) -> np.ndarray:
    told = ContextPlanes(["last_action"], headings, 1)
    told.update(action, [0], 0, 0)
    return told.observe()[0]


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
    learner, mirrored = HostDQN.__new__(HostDQN), th.tensor([True, True, False, False])
    learner._turned = th.tensor(turned_actions(config.task.headings_deg))
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
    told = ContextPlanes(["frame_age"], [0.0], 3)
    assert (told.observe() == 128).all()
    told.update(0, [100 * MS, 500 * MS], 1, 3000 * MS)
    bands = told.observe()[0].reshape(3, 12, 64)
    # 2.9 s is more than a byte holds; 2.5 s; the missing frame is of now.
    assert [np.unique(band).tolist() for band in bands] == [[255], [128 + 125], [128]]


@needs_opengl
@pytest.mark.parametrize("flown", [{"command": "tcsc"}, {"command": "adsc", "timing": "virtual", "profile": "airsim"}])
def test_pictures_and_flight_stay_as_they_were(flown: dict[str, Any]) -> None:
    plain, told = (ObstacleLane(clock_speed=10.0, knows=knows, **flown) for knows in ((), KNOWS))
    for each in (plain, told):
        each.reset(seed=3)
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
    plain.close()
    told.close()


def test_a_policy_that_was_told_flies_no_task_that_tells_less() -> None:
    assert origin_of("default").keys()["knows"] == ["last_action"]
    with pytest.raises(UserError, match=r"task.knows = \(\): default was trained with \('last_action',\)"):
        make_agent("default", LaneTask(history=2))
