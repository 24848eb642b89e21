"""A saved game is its seed, options, actions and charges: flown again anywhere, it is the same game, byte for byte."""

from __future__ import annotations

import json
import pickle
from contextlib import closing
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.lanes import stored
from tests.opengl import needs_opengl
from uavaccel.envs import observer
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.hover import Hover, HoverTask
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.observer import Game, Observer
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.swarm import Swarm
from uavaccel.errors import UserError

LANE: dict[str, Any] = {"observation": "state", "timing": "virtual", "clock_speed": 10.0}
POST = {"obstacles": [{"x_m": 1.5, "y_m": 0.0, "half_side_m": 0.5}], "wind_m_s": [1.0, 0.0, 0.0]}
SEEING: dict[str, Any] = {
    "dvs_preset": "noisy",
    "history": 2,
    "dvs_rate_hz": 20.0,
    "dvs_hot_pixels": 0.01,
    "image_noise": 3.0,
    "knows": ["last_action", "frame_age"],
    "command": "adsc",
    "timing": "virtual",
    "clock_speed": 10.0,
    "randomise": {"dvs_threshold_ratio": [1, 2], "latency_scale": [0.5, 2], "widen_over_games": 3},
}


def what_follows(environment: FlightEnv[Any], actions: Any) -> list[Any]:
    """What an environment does next: each step, its recording, and its next game."""
    seen: list[Any] = []
    for action in actions:
        observation, *rest = environment.step(action)
        seen += [observation.tobytes(), rest]
    seen.append({name: each.tobytes() for name, each in environment.recording().arrays().items()})
    observation, info = environment.reset()
    return [*seen, observation.tobytes(), info]


DOINGS = st.lists(st.one_of(st.integers(0, 4), st.floats(0.001, 0.1), st.just("recording")), max_size=6)


@settings(max_examples=20)
@example(seed=1, doings=["recording", 2], games=0, keys={"timing": "virtual", "command": "adsc"}, kind="json")
@given(
    seed=st.integers(0, 2**32),
    doings=DOINGS,
    games=st.integers(0, 2),
    keys=st.fixed_dictionaries(
        {
            "timing": st.sampled_from(["virtual", "lockstep"]),
            "profile": st.sampled_from(["native", "airsim"]),
            "command": st.sampled_from(["adsc", "tcsc"]),
            "difficulty": st.sampled_from([{}, {"wind_m_s": 3.0, "mass_ratio": 1.2}]),
        }
    ),
    kind=st.sampled_from(["npz", "json"]),
)
def test_a_saved_game_goes_on_to_the_same_bytes(
    seed: int, doings: list[Any], games: int, keys: dict[str, Any], kind: str
) -> None:
    with closing(ObstacleLane(**{**LANE, **keys})) as here, closing(ObstacleLane(**{**LANE, **keys})) as there:
        here.reset(seed=seed, options={"lane": 7} if games == 0 else None)
        for _ in range(games):
            here.step(0)
            here.reset()
        there.reset(seed=1)
        there.step(4)  # another game before
        for doing in doings:
            if isinstance(doing, str):
                here.recording()
            elif isinstance(doing, float):
                here.charge(doing, "learning")
            else:
                here.step(doing)
        state = here.get_state()
        there.set_state(stored(state) if kind == "npz" else json.loads(json.dumps(state)))
        assert what_follows(here, [3, 1]) == what_follows(there, [3, 1])


def test_a_game_goes_on_into_its_collision_and_by_numbers() -> None:
    with closing(ObstacleLane(**LANE, lane=POST)) as here, closing(ObstacleLane(**LANE, lane=POST)) as there:
        here.reset(seed=1)
        here.step(2)
        there.set_state(here.get_state())
        ends = [each.step(2) for each in (here, there)]
        assert [end[4]["collision"] is not None for end in ends] == [True, True]
        assert ends[0][4] == ends[1][4]
    with closing(Navigate(observation="state")) as free, closing(Navigate(observation="state")) as other:
        free.reset(seed=5)
        free.step(np.array([0.3, 0.1, -0.2], np.float32))
        assert other.set_state(free.get_state()).tobytes() == free._observation().tobytes()


@needs_opengl
def test_what_is_seen_is_seen_again() -> None:
    """Events of a noisy camera between samples, noise of pictures, conditions of the game, what an agent is told."""
    made = [ObstacleLane(render_mode="rgb_array", **SEEING) for _ in range(2)]
    with closing(made[0]) as here, closing(made[1]) as there:
        here.reset(seed=3)
        here.reset()
        here.step(1)
        here.render()  # a message, which takes time in `virtual`
        here.charge(0.01)
        seen = here.step(2)[0]
        np.testing.assert_array_equal(there.set_state(here.get_state()), seen)
        assert there.episode_task == here.episode_task != here.task
        assert what_follows(here, [3, 0]) == what_follows(there, [3, 0])


def test_before_a_game_it_is_what_the_next_one_is_sampled_from() -> None:
    with closing(ObstacleLane(**LANE)) as here, closing(ObstacleLane(**LANE)) as there:
        here.np_random.random(3)
        state = here.get_state()
        assert here.reset()[0].tobytes() == there.set_state(state).tobytes()
        assert what_follows(here, [2]) == what_follows(there, [2])


def test_a_copy_is_made_of_what_does_not_fly_yet() -> None:
    for kind, then in ((Hover, "set_state"), (Swarm, "reset")):
        here: Any = kind()
        there = [deepcopy(here), pickle.loads(pickle.dumps(here))]
        begun = [repr(each.reset(seed=1)) for each in (here, *there)]
        assert begun == begun[:1] * 3
        for copied in (deepcopy, pickle.dumps):
            with pytest.raises(UserError, match=rf"^{kind.__name__}: what flies cannot be copied .* and {then}"):
                copied(here)
        for each in (here, *there):
            each.close()
    with closing(KernelBatch(Hover)) as lanes, pytest.raises(UserError, match=r"^KernelBatch: .* and reset\(seed="):
        deepcopy(lanes)


class Onlooker(Observer):
    def __init__(self) -> None:
        self.seen: list[Any] = []

    def game_begun(self, game: Game) -> None:
        self.seen.append(game.start)

    def sample_taken(self, sample: Any, command: int) -> None:
        self.seen.append((sample.state, command))


def test_whoever_looks_on_sees_the_game_from_its_beginning() -> None:
    looking = Onlooker(), Onlooker()
    with closing(ObstacleLane(**LANE)) as here, closing(ObstacleLane(**LANE)) as there:
        here.add_observer(looking[0])
        there.add_observer(looking[1])
        here.reset(seed=1)
        for action in (2, 3):
            here.step(action)
        there.set_state(here.get_state())
    assert looking[0].seen == looking[1].seen != []


@needs_opengl
def test_whoever_looks_on_begins_anew_with_each_game() -> None:
    with closing(ObstacleLane(observation="state", t_sample_s=1.0, lane=POST)) as lane:
        onlooker, camera = observer.Onlooker(pictures=False), observer.SecondEventCamera(lane.task, every_ticks=250)
        for each in (onlooker, camera):
            lane.add_observer(each)
        lane.reset(seed=1)
        while not lane.step(2)[2]:
            pass
        hit, frames = onlooker.hit, camera.events.frames
        assert hit is not None
        path, hit_s = lane.recording().arrays(), (hit[0] - onlooker.samples[0].time_ns) / 1e9
        stands = (path["position_m"] == path["position_m"][-1]).all(axis=1)
        assert 0.0 <= path["time_s"][stands][0] - hit_s < 0.1, "not that of the sample which tells of it"
        lane.reset()
        lane.step(2)
        assert (onlooker.hit, len(onlooker.samples), camera.events.frames - frames) == (None, 2, 2)


@pytest.mark.parametrize("change", ["action", "charge", "seed", "task", "draws"])
def test_a_game_that_comes_out_differently_is_one_clear_line(change: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """So is one after which another game would come, as a task draws more numbers than it did."""
    with closing(Hover(timing="virtual", clock_speed=1.0)) as here:
        here.action_space.seed(0)
        here.reset(seed=1)
        here.step(here.action_space.sample())
        here.charge(0.01)
        state = here.get_state()
    flown = json.loads(state["flown"])
    if change == "action":
        flown[0][1] = [-value for value in flown[0][1]]
    elif change == "charge":
        flown[1][1] += 1e-9
    elif change == "seed":
        state["generator"] = json.dumps(np.random.default_rng(5).bit_generator.state)
    elif change == "draws":
        monkeypatch.setattr(HoverTask, "sample_conditions", lambda task, random, games: dict(random.random(1)[1:]))
    there = Hover(timing="virtual", clock_speed=2.0 if change == "task" else 1.0)
    with closing(there), pytest.raises(UserError, match="flown again, did not end as it was saved") as caught:
        there.set_state({**state, "flown": json.dumps(flown)})
    assert "\n" not in str(caught.value)


def test_a_saved_game_calls_nothing_but_what_games_are_flown_by() -> None:
    with closing(Hover()) as here:
        here.reset(seed=1)
        state = {**here.get_state(), "flown": json.dumps([["close"]])}
        with pytest.raises(UserError, match="a saved game: 'close' is no part of one"):
            here.set_state(state)


def test_lanes_are_saved_in_a_game_at_its_end_and_with_their_options() -> None:
    keys: dict[str, Any] = {"observation": "state", "max_commands": 2, "difficulty": {"first_row_m": 1.5}}
    keys["randomise"] = {"wind_m_s": [8, 8], "widen_over_games": 4}
    with closing(KernelBatch(ObstacleLane, 2, **keys)) as here, closing(KernelBatch(ObstacleLane, 2, **keys)) as there:
        here.reset(seed=3, options={"lane": 7})
        for _ in range(5):  # lane 7 has a post straight ahead
            there.reset(seed=1)
            for lane, state in enumerate(here.call_each("get_state", [()] * 2)):
                there.call_each("set_state", [(stored(state),)], [lane])
            assert repr(here.step([2, 2])) == repr(there.step([2, 2]))
