"""Batches: each environment flies as it would alone; and nothing of them is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
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
from tests.processes import descendants, left_after, state_of
from uavaccel.envs import environment_processes
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.environment_processes import BatchError
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import make_batch
from uavaccel.errors import UserError
from uavaccel.sim.camera import gl

NAME = "uavaccel/ObstacleLane-v0"
COMMANDS = 9
FLOWN: list[tuple[tuple[int, int], dict[str, Any]]] = [  # lanes, processes
    ((5, 2), {}),
    ((3, 1), {"observation": "colour", "history": 2, "difficulty": {"scenery": "forest"}, "image_noise": 2.0}),
    ((2, 2), {"observation": "depth", "timing": "virtual", "command": "adsc", "clock_speed": 5.0}),
]


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
def test_a_batch_flies_as_single_environments_do(size: tuple[int, int], keys: dict[str, Any]) -> None:
    task = {"max_commands": 6, **keys}
    batch, lanes = EnvironmentBatch(ObstacleLane, *size, **task), size[0]
    with closing(batch), singles(lanes, **task) as alone:
        ends = assert_flies_as_alone(batch, alone, COMMANDS)
    assert ends >= lanes  # of them all, lost or cut off


@needs_opengl
def test_gymnasium_makes_batches() -> None:
    made: Any = gymnasium.make_vec(NAME, num_envs=2, max_commands=2, render_mode="rgb_array")
    with closing(made) as batch:
        assert batch.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        seen, infos = batch.reset(seed=3)
        assert (seen.shape, seen.dtype) == (batch.observation_space.shape, np.uint8) == ((2, 3, 36, 64), np.uint8)
        assert len(set(infos["lane"].tolist())) == 2
        for _ in range(2):
            _, rewards, terminated, truncated, infos = batch.step(np.array([2, 0]))
        assert truncated.all()
        assert not terminated.any()
        assert (rewards > 0).all()
        np.testing.assert_array_equal(infos["commands"], [2, 2])
        assert [picture.shape for picture in batch.render() or ()] == [(144, 256, 3)] * 2
        seen, rewards, _, truncated, infos = batch.step(np.array([2, 0]))
        np.testing.assert_array_equal(infos["commands"], [0, 0])
        assert not rewards.any()
        assert not truncated.any()


def test_the_same_step_may_end_a_game_and_begin_another_and_close_leaves_nothing() -> None:
    task = {"observation": "state", "max_commands": 1}
    batch = EnvironmentBatch(ObstacleLane, 2, 1, autoreset_mode="SameStep", **task)
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
        pids = batch.process_ids
        batch.step_async([2, 2])  # and whoever still flies is ended
    batch.close()
    assert not left_after(pids, 0.0)
    with pytest.raises(BatchError, match="this batch is closed"):
        batch.step([2, 2])


def test_lanes_answer_by_themselves_until_one_dies() -> None:
    """A mistake is the caller's; some fly while others wait; a game goes on elsewhere; a death is said in one line."""
    batch = EnvironmentBatch(ObstacleLane, 2, 2, observation="state", timing="virtual")
    with closing(batch), singles(2, observation="state", timing="virtual") as alone:
        with pytest.raises(UserError, match="reset the environment"):
            batch.step([2, 2])
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
        os.kill(batch.process_ids[1], signal.SIGKILL)
        with pytest.raises(BatchError, match=r"^the process of environment 1 ended with status -9$"):
            batch.step([2, 2])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0: must be a whole number, at least 1"),
        ({"num_envs": "2"}, "num_envs = '2': must be a whole number"),
        ({"num_envs": "2", "simulator": "kernels"}, "num_envs = '2': must be a whole number"),
        ({"num_envs": 2, "processes": "x"}, "processes = 'x': must be a whole number"),
        ({"num_envs": 2, "simulator": "kernels", "threads": 0}, "threads = 0: must be a whole number, at least 1"),
        ({"num_envs": 2, "autoreset_mode": "x"}, "autoreset_mode = 'x' is unknown; there are NextStep, SameStep"),
        ({"num_envs": 2, "autoreset_mode": "x", "simulator": "kernels"}, "autoreset_mode = 'x' is unknown"),
        ({"num_envs": 1, "render_mode": "x"}, "render_mode = 'x' is unknown; there are None, rgb_array"),
        ({"num_envs": 2, "timing": "wall"}, "a batch flies in virtual or lockstep"),
        ({"num_envs": 2, "speed": 3.0}, "speed"),
    ],
)
def test_what_a_batch_cannot_be_is_one_clear_line(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message) as raised:
        gymnasium.make_vec(NAME, **keys)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("simulator", ["mujoco", "kernels"])
def test_what_a_batch_is_asked_wrongly_is_one_clear_line(simulator: Any) -> None:
    """None of it flies a part of the environments, or waits for what does not come."""
    batch: Any = make_batch(ObstacleLane, 2, simulator, observation="state")
    with closing(batch):
        with pytest.raises((UserError, BatchError), match=r"no command was started|was not asked for anything"):
            batch.step_wait()
        before = batch.reset(seed=0)[0]
        wrong: list[Any] = [[0], [0, 1, 2], [[0, 1]], 3, None, [[1], [2, 3]]]
        for actions in wrong:
            with pytest.raises(UserError, match=r"^actions: must be of shape \(2,\), an action for each"):
                batch.step(actions)
        with pytest.raises(UserError, match=r"^action .*99.* is not in the action space"):
            batch.step([0, 99])
        for seed in (-1, [1, -1], "ab", 1.5, [1], True):
            with pytest.raises(UserError, match=r"^reset: seed"):
                batch.reset(seed=seed)
        with pytest.raises(UserError, match=r"^reset: options = 3: must be a mapping, of lane$"):
            batch.reset(options=3)
        np.testing.assert_array_equal(batch.reset(seed=0)[0], before)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere OpenGL needs no choice")
def test_pictures_without_opengl_are_refused_before_a_process_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "_first_that_works", lambda: None)
    before = descendants(os.getpid())
    with pytest.raises(UserError, match=r"^no OpenGL here to draw images with: install"):
        EnvironmentBatch(ObstacleLane, 2)
    assert descendants(os.getpid()) == before
    with closing(EnvironmentBatch(ObstacleLane, 2, observation="state")) as batch:
        batch.reset(seed=0)


# --- ends -------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_the_first_answer_is_not_waited_for_while_a_lane_stands_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment_processes, "POLL_S", 0.1)
    with closing(EnvironmentBatch(ObstacleLane, 2, 2, observation="state")) as batch:
        batch.reset(seed=0)
        pids = batch.process_ids
        os.kill(pids[0], signal.SIGSTOP)
        while state_of(pids[0]) != "T":
            pass
        batch.call_async(0, "get_state")
        batch.call_async(1, "get_state")
        assert batch.call_wait()[0] == 1
        with pytest.raises(BatchError, match=r"^the process of environment 0 hangs: it was stopped$"):
            batch.call_wait()
    assert not left_after(pids, 0.0)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each process loads for itself")
def test_processes_are_forks_of_one_that_loads_for_all() -> None:
    """Killed while it loads, it is missed like any of them; once they fly, they need it no more, nor heed Ctrl-C."""
    with closing(EnvironmentBatch(ObstacleLane, 2, 2, observation="state")) as batch:
        (loading,) = set(batch.process_ids)
        os.kill(loading, signal.SIGKILL)
        with pytest.raises(BatchError, match=r"^the process of environment 0 ended with status -9$"):
            batch.reset(seed=0)
    with closing(EnvironmentBatch(ObstacleLane, 2, 2, observation="state")) as batch:
        batch.reset(seed=0)
        pids = batch.process_ids
        (loaded,) = {descendant for descendant in descendants(os.getpid()) if descendants(descendant) >= set(pids)}
        for pid in (loaded, *pids):
            os.kill(pid, signal.SIGINT)
        batch.step([2, 2])
        os.kill(loaded, signal.SIGKILL)
        batch.step([2, 2])
    assert not left_after([loaded, *pids], 1.0)


@pytest.mark.wall_clock
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each process loads for itself")
@pytest.mark.parametrize("gone", [False, True])
def test_a_batch_closes_though_its_processes_are_stopped(gone: bool) -> None:
    """The one that has forked them is stopped; or it has gone, and they are."""
    with closing(EnvironmentBatch(ObstacleLane, 2, 2, observation="state")) as batch:
        batch.reset(seed=0)
        pids = batch.process_ids
        (loaded,) = {descendant for descendant in descendants(os.getpid()) if descendants(descendant) >= set(pids)}
        for pid in pids if gone else [loaded, pids[0]]:
            os.kill(pid, signal.SIGSTOP)
        if gone:
            os.kill(loaded, signal.SIGKILL)
    assert not left_after([loaded, *pids], 1.0)


FLYING = """
import numpy as np, sys
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.obstacle_lane import ObstacleLane
batch = EnvironmentBatch(ObstacleLane, 2, 1)
batch.reset(seed=0)
print("flying", flush=True)
while True:
    batch.step(np.array([2, 2]))
"""


def named_memory(pids: list[int]) -> list[str]:
    """What processes share under a name, which would outlive them if they are killed."""
    maps = "".join(Path(f"/proc/{pid}/maps").read_text() for pid in pids)
    return [line for line in maps.splitlines() if "/dev/shm/" in line]


@needs_opengl
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_nothing_is_left_when_the_program_is_killed() -> None:
    program = subprocess.Popen(
        [sys.executable, "-c", FLYING], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert program.stdout is not None
    assert program.stdout.readline() == "flying\n"
    started = descendants(program.pid)
    assert len(started) == 1
    assert not named_memory([program.pid, *started])
    program.kill()
    program.wait()
    program.stdout.close()
    assert not left_after(started, 60.0)
