"""The environment: Gymnasium's contract, lanes, ends of a game, observations, and one flight in every timing."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from numpy.typing import NDArray
from stable_baselines3.common.env_checker import check_env as check_env_for_learning

import uavaccel.envs  # noqa: F401 - registers
from tests.lanes import free_distance_m
from tests.opengl import needs_opengl
from uavaccel.envs.hover import Hover
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.sim.lane import lane_seed, sample_layout
from uavaccel.vision.dvs_sensor import NEUTRAL_LEVEL
from uavaccel.wire.session import Client
from uavaccel.wire.transport import Transport

NAME = "uavaccel/ObstacleLane-v0"
IMAGE = (3, 36, 64)
AHEAD, HARD_WEST = 2, 0
NO_LANE = {"obstacles_per_row": 0}


def lane(**task: Any) -> closing[ObstacleLane]:
    return closing(ObstacleLane(**task))


def fly(environment: ObstacleLane, actions: list[int], seed: int = 5) -> list[NDArray[Any]]:
    """The observations of a game's start and of its commands."""
    return [environment.reset(seed=seed)[0], *(environment.step(action)[0] for action in actions)]


def crash(environment: ObstacleLane, index: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
    """Straight ahead until the game is over; its last step."""
    environment.reset(seed=0, options={"lane": index})
    while True:
        last = environment.step(AHEAD)
        if last[2] or last[3]:
            return last


# --- Gymnasium --------------------------------------------------------------------------------------------------


def test_it_is_registered_as_the_documentation_says() -> None:
    """By the module, which Gymnasium imports before it looks for the name."""
    program = f"import gymnasium; print(gymnasium.make('uavaccel:{NAME}', observation='state').spec.id)"
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert said.stdout.strip() == NAME


@needs_opengl
@pytest.mark.filterwarnings("ignore:.*Box observation space m:UserWarning")  # a position has no bounds
@pytest.mark.filterwarnings("ignore:.*unconventional shape:UserWarning")
@pytest.mark.parametrize(
    ("name", "keys"),
    [
        *((NAME, {"observation": kind}) for kind in ("dvs", "colour", "depth")),
        (NAME, {"observation": "state", "randomise": {"wind_m_s": [0, 3]}}),
        *((f"uavaccel/{name}-v0", {}) for name in ("Hover", "Gates")),
    ],
)
def test_checkers_of_gymnasium_and_baselines_find_nothing(name: str, keys: dict[str, Any]) -> None:
    environment = gymnasium.make(name, **keys, max_commands=5)
    check_env(environment.unwrapped, skip_render_check=keys.get("observation", "state") == "state")
    check_env_for_learning(environment)
    environment.close()


def test_what_an_info_says_is_its_readers() -> None:
    """Who changes it does not move the waypoint."""
    with closing(Hover()) as environment:
        _, begun = environment.reset(seed=0)
        waypoint_m = [*begun["waypoint_m"]]
        begun["waypoint_m"].clear()
        assert environment.step(np.zeros(3, np.float32))[4]["waypoint_m"] == waypoint_m


def test_a_truth_value_is_the_number_of_an_action() -> None:
    with lane(observation="state") as environment:
        flown = fly(environment, [False, True])
        assert np.array_equal(flown, fly(environment, [0, 1]))


class Recorder:
    """Stands for the encoder of a film, which the package does not need: it keeps the pictures."""

    films: list[list[NDArray[np.uint8]]] = []  # noqa: RUF012 - one for all

    def __init__(self, pictures: list[NDArray[np.uint8]], fps: int) -> None:
        self.films.append(list(pictures))

    def write_videofile(self, path: str, logger: Any = None) -> None:
        Path(path).touch()


@needs_opengl
def test_gymnasium_records_its_films(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setattr(sys.modules["moviepy.video.io.ImageSequenceClip"], "ImageSequenceClip", Recorder, False)
    monkeypatch.setattr(Recorder, "films", [])
    folder = tmp_path / "films"
    environment = RecordVideo(gymnasium.make(NAME, render_mode="rgb_array", max_commands=3), str(folder))
    environment.reset(seed=0)
    while not environment.step(AHEAD)[3]:
        pass
    environment.close()
    (film,) = Recorder.films
    assert [picture.shape for picture in film] == [(144, 256, 3)] * 4
    assert (film[0] != film[-1]).any()
    assert len(list(folder.glob("*.mp4"))) == 1


def test_its_spec_is_json() -> None:
    environment = gymnasium.make(NAME, observation="state", difficulty=NO_LANE, headings_deg=[-30.0, 0.0, 30.0])
    assert environment.spec is not None
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(environment.spec.to_json()))
    assert again.unwrapped.task == environment.unwrapped.task  # type: ignore[attr-defined]
    environment.close()
    again.close()


FORKED = """
import multiprocessing, warnings
import gymnasium
from gymnasium.vector import AsyncVectorEnv

warnings.filterwarnings("ignore")  # Gymnasium warns of each worker's error
make = lambda: gymnasium.make("uavaccel.envs:uavaccel/ObstacleLane-v0", max_commands=2)
parent = make()
parent.reset(seed=0)
for context in ("fork", "spawn"):
    vector = AsyncVectorEnv([make], context=context)
    try:
        print(context, vector.reset(seed=0)[0].shape)
    except Exception as error:
        print(context, error)
    vector.close(terminate=True)
parent.step(2)
print(multiprocessing.active_children())
"""


@needs_opengl
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere nothing is forked")
def test_workers_forked_after_drawing_say_what_to_do() -> None:
    """And spawned ones find the environment of a program without a file, as a notebook's, by its name alone."""
    done = subprocess.run([sys.executable, "-c", FORKED], check=True, capture_output=True, text=True, timeout=300)
    forked, spawned, left = done.stdout.splitlines()
    assert "start workers by spawn" in forked
    assert spawned == "spawn (1, 3, 36, 64)"
    assert left == "[]"


# --- lanes ------------------------------------------------------------------------------------------------------


OWN_LANE = {
    "obstacles": [{"x_m": 12, "y_m": 0.2, "half_side_m": 0.5}, {"x_m": 20, "y_m": -2, "radius_m": 0.6}],
    "wind_m_s": [0.5, 0.0, 0.0],
}


@pytest.mark.parametrize("written", ["out", "file"])
def test_a_lane_of_ones_own_is_flown_in_every_game(tmp_path: Path, written: str) -> None:
    (tmp_path / "own.yaml").write_text(json.dumps(OWN_LANE))  # JSON is YAML
    own = OWN_LANE if written == "out" else str(tmp_path / "own.yaml")
    with lane(observation="state", lane=own) as environment:
        again = ObstacleLane(**environment.task.model_dump(mode="json"))  # as other processes get it
        assert again.task == environment.task
        for index in (0, 7):
            info = crash(environment, index)[4]
            assert info["distance_m"] == pytest.approx(12 - 0.5 - 0.3418, abs=0.01)
            assert info["collision"] == "obstacle_00"


# --- a game's ends ----------------------------------------------------------------------------------------------


@needs_opengl
def test_a_collision_ends_the_game_and_blanks_missing_frames() -> None:
    with lane(split="evaluation") as environment:
        observation, reward, terminated, truncated, info = crash(environment, 2)
    free_m = free_distance_m(sample_layout(lane_seed("evaluation", 2)), 0.0)
    assert (terminated, truncated, info["is_success"]) == (True, False, False)
    assert info["collision"].startswith("obstacle_")
    assert info["distance_m"] == info["position_m"][0] == pytest.approx(free_m, abs=0.01)
    assert -1.0 < reward < -0.9
    assert np.ptp(observation[0]) > 0  # it was still on its way at the first sample
    assert (observation[1:] == NEUTRAL_LEVEL).all()


@needs_opengl
def test_infos_are_json_and_the_same_twice() -> None:
    with lane(split="evaluation") as environment:
        texts = [json.dumps(crash(environment, 2)[4]) for _ in range(2)]
    assert texts[0] == texts[1]
    info = json.loads(texts[0])
    assert info["lane"] == 2
    assert info["phase_s"]["simulation"] == pytest.approx(info["commands"], abs=1.0)
    assert info["wall_s"] == sum(info["phase_s"].values())  # nothing takes any time but flight


# --- observations -----------------------------------------------------------------------------------------------


@needs_opengl
def test_events_are_neutral_before_anything_moved_and_kept_as_long_as_asked() -> None:
    with lane(history=2) as environment:
        start, first, second = fly(environment, [AHEAD, HARD_WEST])
    assert start.shape == (6, 36, 64)
    assert start.dtype == np.uint8
    assert (start == NEUTRAL_LEVEL).all()
    assert np.ptp(first) > 20
    np.testing.assert_array_equal(first[3:], second[:3])


@needs_opengl
def test_blank_images_show_nothing() -> None:
    with lane(blank_images=True) as environment:
        assert all((seen == NEUTRAL_LEVEL).all() for seen in fly(environment, [AHEAD, HARD_WEST]))


# --- timings ----------------------------------------------------------------------------------------------------


@needs_opengl
def test_tcsc_sees_the_same_at_any_clock_speed() -> None:
    flights = []
    for timing, clock_speed in (("lockstep", 1.0), ("virtual", 1.0), ("virtual", 100.0)):
        with lane(timing=timing, clock_speed=clock_speed) as environment:
            seen = fly(environment, [2, 3, 1, 4, 2, 2])
        flights.append([observation.tobytes() for observation in seen])
    assert flights[0] == flights[1] == flights[2]


@pytest.mark.parametrize("ends", [{"max_commands": 2}, {"hold_s": 0.4, "radius_m": 9.0, "t_move_s": 0.2}])
@pytest.mark.parametrize("timing", ["lockstep", "wall"])
def test_a_game_tells_at_its_end_what_held_up_its_wall_clock(
    timing: str, ends: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However it ends; the clock is a simulated one in truth."""
    monkeypatch.setattr(Client, "speed", lambda self: {"lost_wall_ns": 250_000_000})
    monkeypatch.setattr(Transport, "stalled_ns", 1_500_000_000)
    with closing(Hover(**ends)) as environment:
        environment.reset(seed=0)
        environment.task = environment.task.model_copy(update={"timing": timing})
        infos = [environment.step(np.zeros(3, np.float32))[4] for _ in range(2)]
    told = [{name: info[name] for name in ("lost_wall_s", "stalled_wall_s") if name in info} for info in infos]
    assert told == [{}, {"lost_wall_s": 0.25, "stalled_wall_s": 1.5} if timing == "wall" else {}]
