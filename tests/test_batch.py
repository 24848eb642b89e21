"""Batches: each environment flies as it would alone, whoever draws; and nothing of them is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import uavaccel.envs  # noqa: F401 - registers
from tests.opengl import needs_opengl
from uavaccel.envs import environment_processes
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.environment_processes import BatchError
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError
from uavaccel.sim.rendering.service import RenderService

NAME = "uavaccel/ObstacleLane-v0"
COMMANDS = 14
SIZES = [(1, 1, 1), (3, 2, 2), (8, 3, 5)]  # lanes, processes, tiles
OTHERS: list[dict[str, Any]] = [
    {"timing": "virtual", "clock_speed": 10.0, "command": "adsc"},
    {"observation": "colour", "history": 2, "difficulty": {"scenery": "forest"}, "image_noise": 2.0},
    {"observation": "depth", "timing": "virtual", "clock_speed": 5.0},
]
FLOWN = [*((size, {}) for size in SIZES), *((SIZES[1], task) for task in OTHERS)]


@contextmanager
def singles(count: int, **task: Any) -> Iterator[list[ObstacleLane]]:
    environments = [ObstacleLane(**task) for _ in range(count)]
    yield environments
    for environment in environments:
        environment.close()


def actions_of(count: int, commands: int) -> np.ndarray:
    """Mostly ahead, so that some games are lost and others go far."""
    random = np.random.default_rng(count)
    return np.where(random.random((commands, count)) < 0.6, 2, random.integers(5, size=(commands, count)))


def assert_flies_as_alone(batch: EnvironmentBatch, alone: list[ObstacleLane], commands: int) -> int:
    """Observations, rewards, ends and infos, command by command, byte for byte; returns how many games ended."""
    seen = batch.reset(seed=7)[0]
    for lane, environment in enumerate(alone):
        assert seen[lane].tobytes() == environment.reset(seed=7 + lane)[0].tobytes()
    over, ends = [False] * len(alone), 0
    for actions in actions_of(len(alone), commands):
        batch.step_async(actions)
        steps = batch.step_wait()
        for lane, environment in enumerate(alone):
            if over[lane]:  # autoreset in the next step
                observation, info = environment.reset()
                expected: Any = (observation, 0.0, False, False, info)
            else:
                expected = environment.step(int(actions[lane]))
            assert steps[0][lane].tobytes() == expected[0].tobytes()
            assert tuple(part[lane] for part in steps[1:4]) == expected[1:4]
            assert steps[4][lane] == expected[4]
            over[lane] = expected[2] or expected[3]
            ends += over[lane]
    return ends


@needs_opengl
@pytest.mark.slow
@pytest.mark.parametrize(("size", "keys"), FLOWN)
def test_a_batch_flies_as_single_environments_do(size: tuple[int, int, int], keys: dict[str, Any]) -> None:
    (lanes, processes, tiles), task = size, {"max_commands": 8, **keys}
    batch = EnvironmentBatch(ObstacleLane, lanes, processes, "shared", tiles, **task)
    with closing(batch), singles(lanes, **task) as alone:
        ends = assert_flies_as_alone(batch, alone, COMMANDS)
    assert ends >= lanes  # of them all, lost or cut off


@needs_opengl
@pytest.mark.parametrize("renderer", ["own", "auto"])
def test_so_does_one_whose_processes_draw_themselves(renderer: str) -> None:
    batch = EnvironmentBatch(ObstacleLane, 2, 1, renderer)  # type: ignore[arg-type]
    with closing(batch), singles(2) as alone:
        assert_flies_as_alone(batch, alone, 4)


@needs_opengl
def test_gymnasium_makes_batches() -> None:
    made: Any = gymnasium.make_vec(NAME, num_envs=3, max_commands=2, render_mode="rgb_array")
    with closing(made) as batch:
        assert batch.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        seen, infos = batch.reset(seed=3)
        assert (
            (seen.shape, seen.dtype)
            == (batch.observation_space.shape, np.uint8)
            == ((3, 3, 36, 64), np.uint8)
        )
        assert len(set(infos["lane"].tolist())) == 3
        for _ in range(2):
            _, rewards, terminated, truncated, infos = batch.step(np.array([2, 2, 0]))
        assert truncated.all()
        assert not terminated.any()
        assert (rewards > 0).all()
        np.testing.assert_array_equal(infos["commands"], [2, 2, 2])
        assert [picture.shape for picture in batch.render() or ()] == [(144, 256, 3)] * 3
        seen, rewards, _, truncated, infos = batch.step(np.array([2, 2, 0]))
        np.testing.assert_array_equal(infos["commands"], [0, 0, 0])
        assert not rewards.any()
        assert not truncated.any()


def test_the_same_step_may_end_a_game_and_begin_another() -> None:
    task = {"observation": "state", "max_commands": 1}
    batch = EnvironmentBatch(ObstacleLane, 2, autoreset_mode="SameStep", **task)  # type: ignore[arg-type]
    with closing(batch), singles(2, **task) as alone:
        batch.reset(seed=[4, 9])
        batch.step_async([2, 0])
        seen, _, _, truncated, infos = batch.step_wait()
        for lane, (seed, action) in enumerate([(4, 2), (9, 0)]):
            alone[lane].reset(seed=seed)
            last, _, _, _, ended = alone[lane].step(action)
            first, begun = alone[lane].reset()
            assert truncated[lane]
            np.testing.assert_array_equal(infos[lane].pop("final_obs"), last)
            assert infos[lane].pop("final_info") == ended
            assert infos[lane] == begun
            np.testing.assert_array_equal(seen[lane], first)


def test_some_lanes_fly_while_others_wait_and_games_go_on_elsewhere() -> None:
    batch = EnvironmentBatch(ObstacleLane, 2, 2, observation="state", timing="virtual")
    with closing(batch), singles(2, observation="state", timing="virtual") as alone:
        batch.reset(seed=1)
        batch.step_async([3], slots=[1])
        with pytest.raises(BatchError, match="environment 1 is still flying"):
            batch.step_async([2, 2])
        batch.step_wait(slots=[0])
        batch.step_wait(slots=[1])
        batch.call_each("charge", [(0.5, "learning")], slots=[1])
        states = batch.call_each("get_state", [(), ()])
        np.testing.assert_array_equal(alone[1].set_state(states[1]), batch.observations()[1])
        assert alone[1].step(2)[0].tobytes() == batch.step([2, 2])[0][1].tobytes()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0: must be at least 1"),
        ({"num_envs": 2, "renderer": "mine"}, "renderer = 'mine' is unknown; there are auto, shared, own"),
        ({"num_envs": 2, "timing": "wall"}, "a batch flies in virtual or lockstep"),
        ({"num_envs": 2, "speed": 3.0}, "speed"),
    ],
)
def test_what_a_batch_cannot_be_is_one_clear_line(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message) as raised:
        gymnasium.make_vec(NAME, **keys)
    assert "\n" not in str(raised.value)


def test_a_user_error_in_a_lane_is_one_here() -> None:
    with closing(EnvironmentBatch(ObstacleLane, 2, observation="state")) as batch:
        with pytest.raises(UserError, match="reset the environment"):
            batch.step([2, 2])
        batch.reset(seed=0)
        batch.step([2, 2])


# --- ends -------------------------------------------------------------------------------------------------------


def running(pids: list[int]) -> list[int]:
    """Those of the processes that still run."""
    return [pid for pid in pids if Path(f"/proc/{pid}").exists() and _state(pid) != "Z"]


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return "Z"


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    listed = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in listed]


@needs_opengl
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_dead_renderer_is_said_in_one_line() -> None:
    with closing(EnvironmentBatch(ObstacleLane, 2, 2, "shared")) as batch:
        batch.reset(seed=0)
        assert batch.service is not None
        batch.service.process.kill()
        with pytest.raises(BatchError, match=r"^the renderer of all environments ended with status -9$"):
            batch.step([2, 2])


def test_a_dead_lane_is_said_in_one_line() -> None:
    with closing(EnvironmentBatch(ObstacleLane, 2, 2, observation="state")) as batch:
        batch.reset(seed=0)
        os.kill(batch.process_ids[1], signal.SIGKILL)
        with pytest.raises(BatchError, match=r"^the process of environment 1 ended with status -9$"):
            batch.step([2, 2])


@needs_opengl
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize(("stopped", "line"), [
    ("renderer", "the renderer of all environments stands still: it was stopped"),
    ("lane", "the process of environment 1 stands still: it was stopped"),
])  # fmt: skip
def test_who_stands_still_is_noticed_and_ended(
    stopped: str, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(environment_processes, "LOOK_S", 0.1)
    with closing(EnvironmentBatch(ObstacleLane, 4, 2, "shared")) as batch:
        batch.reset(seed=0)
        assert batch.service is not None
        pid = batch.service.process.pid if stopped == "renderer" else batch.process_ids[1]
        os.kill(pid, signal.SIGSTOP)
        with pytest.raises(BatchError, match=f"^{line}$"):
            batch.step([2] * 4)
        pids = [*batch.process_ids, batch.service.process.pid]
    assert not running(pids)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_the_first_answer_is_not_waited_for_while_a_lane_stands_still(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(environment_processes, "LOOK_S", 0.1)
    with closing(EnvironmentBatch(ObstacleLane, 2, 2, observation="state")) as batch:
        batch.reset(seed=0)
        os.kill(batch.process_ids[0], signal.SIGSTOP)
        batch.call_async(0, "get_state")
        batch.call_async(1, "get_state")
        assert batch.call_wait()[0] == 1
        with pytest.raises(BatchError, match="the process of environment 0 stands still"):
            batch.call_wait()


@needs_opengl
def test_a_renderer_that_is_killed_before_it_draws_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    start = RenderService.__init__

    def killed(self: RenderService, *arguments: Any) -> None:
        start(self, *arguments)
        self.process.kill()

    monkeypatch.setattr(RenderService, "__init__", killed)
    with pytest.raises(BatchError, match=r"^the renderer ended with status -9 before it could draw$"):
        EnvironmentBatch(ObstacleLane, 2, 2, "shared")


FLYING = """
import numpy as np, sys
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.obstacle_lane import ObstacleLane
batch = EnvironmentBatch(ObstacleLane, 3, 2, "shared")
batch.reset(seed=0)
print("flying", flush=True)
while True:
    batch.step(np.array([2, 2, 2]))
"""


def named_memory(pids: list[int]) -> list[str]:
    """What processes share under a name, which would outlive them if they are killed."""
    maps = "".join(Path(f"/proc/{pid}/maps").read_text() for pid in pids)
    return [line for line in maps.splitlines() if "/dev/shm/" in line]


@needs_opengl
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_nothing_is_left_when_the_program_is_killed(end: signal.Signals) -> None:
    program = subprocess.Popen(
        [sys.executable, "-c", FLYING], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert program.stdout is not None
    assert program.stdout.readline() == "flying\n"
    started = children(program.pid)
    assert len(started) == 3  # two for the lanes, one that draws
    assert not named_memory([program.pid, *started])
    program.send_signal(end)
    program.wait()
    program.stdout.close()
    deadline = time.monotonic() + 60.0
    while running(started) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not running(started)


def test_nothing_is_left_after_close() -> None:
    batch = EnvironmentBatch(ObstacleLane, 3, 2, observation="state")
    batch.reset(seed=0)
    pids = batch.process_ids
    batch.step_async([2, 2, 2])  # and whoever still flies is ended
    batch.close()
    batch.close()
    assert not running(pids)
    with pytest.raises(BatchError, match="this batch is closed"):
        batch.step([2, 2, 2])
