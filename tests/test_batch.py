"""Batches: each environment flies as it would alone; and nothing of them is left behind."""

from __future__ import annotations

import os
import re
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
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

import uavaccel.envs
from tests.lanes import SideBySide, mostly_ahead
from tests.opengl import needs_opengl
from tests.own_tasks import Pair, PairTask
from tests.processes import descendants, left_after, state_of
from uavaccel.envs import environment_process
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.environment_process import BatchError
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.task import Task
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.camera import gl

NAME = "uavaccel/ObstacleLane-v0"
COMMANDS = 7
ADSC = {"timing": "virtual", "command": "adsc", "clock_speed": 5.0}
FLOWN: list[tuple[str, tuple[int, int], dict[str, Any]]] = [  # mode; lanes, processes
    ("SameStep", (3, 2), {"observation": "depth", "also_state": True, "max_commands": 3, **ADSC}),
    ("NextStep", (2, 1), {"history": 2, "difficulty": {"scenery": "forest"}, "image_noise": 2.0}),
]


@contextmanager
def singles(count: int, **task: Any) -> Iterator[list[ObstacleLane]]:
    environments = [ObstacleLane(**task) for _ in range(count)]
    yield environments
    for environment in environments:
        environment.close()


@needs_opengl
@pytest.mark.slow
@pytest.mark.parametrize(("mode", "size", "keys"), FLOWN)
def test_a_batch_flies_as_single_environments_do(mode: str, size: tuple[int, int], keys: dict[str, Any]) -> None:
    """Observations, rewards, ends and infos, command by command, byte for byte."""
    task, lanes = {"max_commands": 4, **keys}, size[0]
    with (
        closing(EnvironmentBatch(ObstacleLane, *size, autoreset_mode=mode, **task)) as batch,
        singles(lanes, **task) as alone,
    ):
        flown = SideBySide(batch, alone)
        flown.reset(7)
        for number, actions in enumerate(mostly_ahead(lanes, COMMANDS)):
            flown.step(actions)
            flown.charge(0.01 * number)
    assert len(flown.ends) >= lanes  # of them all, lost or cut off


@pytest.mark.parametrize("simulator", ["mujoco", "kernels"])
def test_a_mask_says_which_games_begin_anew(simulator: str) -> None:
    batch: Any = uavaccel.make_vec("hover", 2, simulator=simulator, autoreset_mode="Disabled", render_mode=None)
    with closing(batch), closing(uavaccel.make("hover")) as alone:
        with pytest.raises(UserError, match=r"^reset: option reset_mask: reset all environments first$"):
            batch.reset(options={"reset_mask": np.array([False, True])})
        first, _ = batch.reset(seed=1)
        for seed, aim in ((1, {"waypoint_m": [1.0, 0.0, -9.0]}), (5, {})):
            seen, infos = batch.reset(seed=seed, options={"reset_mask": np.array([False, True]), **aim})
            begun, _ = alone.reset(seed=seed + 1, options=aim)
            assert seen.tolist() == [first[0].tolist(), begun.tolist()] != first.tolist()
            assert infos["_commands"].tolist() == [False, True]
        action = np.array([0.5, 0.0, -0.5], np.float32)
        assert (batch.step(np.tile(action, (2, 1)))[0][1] == alone.step(action)[0]).all()
        for wrong in ([True], [False, False], [1, 0], "yes"):
            with pytest.raises(UserError, match=r"^reset: option reset_mask: must be 2 truth values"):
                batch.reset(options={"reset_mask": wrong})


@pytest.mark.parametrize("simulator", ["mujoco", "kernels"])
def test_an_ended_game_is_not_flown_on(simulator: str) -> None:
    """Without automatic resets it has to be reset; saved before one, it begins anew elsewhere too."""
    keys: Any = {"simulator": simulator, "max_commands": 1}
    action = np.full((2, 3), 0.5, np.float32)
    with closing(uavaccel.make_vec("hover", 2, autoreset_mode="Disabled", **keys)) as batch:
        batch.reset(seed=0)
        batch.step(action)
        batch.reset(options={"reset_mask": np.array([True, False])})
        with pytest.raises(UserError, match=r"^step: the game of environment 1 has ended: .* reset_mask$"):
            batch.step(action)
    batches: Any = (uavaccel.make_vec("hover", 2, **keys) for _ in range(2))
    saved, other = batches
    with closing(saved), closing(other):
        saved.reset(seed=0)
        saved.step(action)
        other.call_each("set_state", [(state,) for state in saved.call_each("get_state", [()] * 2)])
        begun = [batch.step(action) for batch in (saved, other)]
        assert begun[0][0].tolist() == begun[1][0].tolist()
        assert [step[4]["commands"].tolist() for step in begun] == [[0, 0]] * 2


@pytest.mark.parametrize("simulator", ["mujoco", "kernels"])
def test_what_flies_is_not_asked_for_more(simulator: str) -> None:
    """A second command, a reset or a saving would mix with the first."""
    action = np.full((3, 3), 0.5, np.float32)
    flying: Any = uavaccel.make_vec("hover", 3, simulator=simulator)
    with closing(flying) as batch:
        batch.reset(seed=0)
        batch.step_async(action[1:], [1, 2])
        asked = [
            lambda: batch.step_async(action),
            lambda: batch.reset(seed=0, options={"reset_mask": np.array([False, True, False])}),
            lambda: batch.call_each("get_state", [()], [1]),
        ]
        for ask in asked:
            with pytest.raises(BatchError, match="environment 1 is still flying"):
                ask()


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_lanes_have_actions_of_several_numbers_and_nested_courses(mode: str) -> None:
    with closing(KernelBatch(Pair, 2, autoreset_mode=mode)) as batch, closing(Pair()) as one, closing(Pair()) as other:
        flown, random = SideBySide(batch, [one, other]), np.random.default_rng(0)
        flown.reset(7)
        for _ in range(COMMANDS):
            flown.step(random.integers(3, size=(2, 2)))
    assert len(flown.ends) == 2


@pytest.mark.parametrize(("first", "later"), [
    ({"x": 1}, {"x": 1.5}), ({"x": [1.0]}, {"x": [1.0, 2.0]}), ({"x": 1}, {"y": 1}), ({"x": {"y": 1}}, {"x": 1}),
    ({"x": "left"}, {}), ({"x": None}, {}),
])  # fmt: skip
def test_a_course_that_is_not_as_the_others_is_refused(first: Any, later: Any) -> None:
    """Also in the game of an automatic reset: nothing is cut to the kind of the first."""
    coming = dict(first)

    class Other(PairTask):
        max_commands: int = 1
        sample, advance, reward, info = lambda *_: dict(coming), Task.advance, Task.reward, Task.info

    def fly() -> None:
        with closing(uavaccel.make_vec(Other, 1, simulator="kernels", autoreset_mode="SameStep")) as batch:
            batch.reset(seed=0)
            coming.clear()
            coming.update(later)
            batch.step([[1, 1]])

    refused = r"Other\.sample: over arrays, the courses of all games must have the same items, .* simulator = mujoco$"
    with pytest.raises(UserError, match=refused):
        fly()


@pytest.mark.parametrize(("parts", "line"), [
    ({"with_conditions": lambda of, _: of.model_copy(update={"max_commands": 2})}, "with_conditions: changes max_com"),
    ({"with_conditions": lambda of, _: of.model_copy(update={"t_move_s": 0.4})}, "with_conditions: changes t_move_s"),
    ({"success": lambda _, now: now.collision is not None}, "success: says False of a game, and True of the same"),
    ({"fields": lambda _, state, course: [(state.time_ns > 0) + (state.time_ns > 2)]}, "fields: says [2] of a game"),
    ({"action_space": lambda _: spaces.Discrete(3), "goal": lambda _, a: VelocityGoal((1 * ((a > 0) + (a > 1)), 0, 0))},
     "goal: says [(2, 0, 0), None, 0.0, True] of a game, and [[1, 0, 0]"),
    ({"info": lambda _, now: {"velocity": np.array(now.state.linear_velocity_m_s)}}, "info: says {'velocity': array("),
])  # fmt: skip
def test_a_task_of_which_arrays_tell_otherwise_is_refused(parts: dict[str, Any], line: str) -> None:
    other = type("Other", (PairTask,), {"__module__": __name__, **parts})
    refused = rf"Other\.{re.escape(line)}.* or use simulator = mujoco$"
    with pytest.raises(UserError, match=refused), closing(uavaccel.make_vec(other, 2, simulator="kernels")) as batch:
        batch.reset(seed=0)


@needs_opengl
def test_gymnasium_makes_batches() -> None:
    made: Any = gymnasium.make_vec(NAME, num_envs=2, max_commands=2, render_mode="rgb_array")
    with closing(made) as batch:
        assert batch.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        seen, infos = batch.reset(seed=3)
        assert (seen.shape, seen.dtype) == (batch.observation_space.shape, np.uint8) == ((2, 3, 36, 64), np.uint8)
        assert len(set(infos["lane"].tolist())) == 2
        batch.set_attr("mark", ["first", "second"])
        batch.set_attr("same", 5)
        assert (batch.get_attr("mark"), batch.get_attr("same")) == (("first", "second"), (5, 5))
        with pytest.raises(AttributeError, match=r"has no attribute .nothing.$"):
            batch.call("nothing")
        with pytest.raises(UserError, match="set_attr: 1 values for 2 environments"):
            batch.set_attr("mark", ["first"])
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


def test_lanes_answer_by_themselves_until_one_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mistake is the caller's; some fly while others wait; a game goes on elsewhere; a death is said in one line.

    Without pictures they need no OpenGL.
    """
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "_first_that_works", lambda: None)
    task: dict[str, Any] = {"observation": "state", "timing": "virtual", "max_commands": 2}
    batch = EnvironmentBatch(ObstacleLane, 3, 2, **task)
    with closing(batch), singles(2, **task) as alone:
        with pytest.raises(UserError, match="reset the environment"):
            batch.step([2, 2, 2])
        batch.reset(seed=1)
        batch.step_async([3], slots=[1])
        with pytest.raises(BatchError, match="environment 1 is still flying"):
            batch.step_async([2, 2, 2])
        batch.step_wait(slots=[0])
        batch.step_wait(slots=[1])
        batch.call_each("charge", [(0.5, "learning")], slots=[1])
        states = batch.call_each("get_state", [()] * 3)
        np.testing.assert_array_equal(alone[1].set_state(states[1]), batch.observations()[1])
        last = alone[1].step(2)[0].tobytes()
        for _ in range(2):
            seen, _, _, cut, _ = batch.step([2, 2, 2])
            assert (seen[1].tobytes(), cut[1]) == (last, True)
            batch.call_each("set_state", [(states[1],)], slots=[1])  # of a game that has ended
        os.kill(batch.process_ids[0], signal.SIGKILL)
        with pytest.raises(BatchError, match=r"^the process of environment 2 ended with status -9$"):
            batch.call_each("get_state", [()], slots=[2])


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere OpenGL needs no choice")
def test_pictures_without_opengl_are_refused_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "_first_that_works", lambda: None)
    before = descendants(os.getpid())
    with pytest.raises(UserError, match=r"^no OpenGL here to draw images with: install"):
        EnvironmentBatch(ObstacleLane, 2)
    assert descendants(os.getpid()) == before


# --- ends -------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_an_answer_comes_while_another_lane_stands_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment_process, "POLL_S", 0.1)
    with closing(EnvironmentBatch(ObstacleLane, 2, 5, observation="state")) as batch:
        batch.reset(seed=0)
        pids = batch.process_ids
        assert len(pids) == batch.processes == 2  # one for each lane at most
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
        with pytest.raises(BatchError, match=r"^the process of environment [01] ended with status -9$"):
            batch.reset(seed=0)
    with closing(EnvironmentBatch(ObstacleLane, 2, 2, observation="state")) as batch:
        batch.reset(seed=[4, 9])
        pids = batch.process_ids
        (loaded,) = {descendant for descendant in descendants(os.getpid()) if descendants(descendant) >= set(pids)}
        for pid in (loaded, *pids):
            os.kill(pid, signal.SIGINT)
        batch.step([2, 2])
        os.kill(loaded, signal.SIGKILL)
        batch.step([2, 2])
        batch.step_async([2, 2])  # and whoever still flies is ended
    assert not left_after([loaded, *pids], 60.0)
    with pytest.raises(BatchError, match="this batch is closed"):
        batch.step([2, 2])


def test_a_closed_batch_of_kernels_says_so() -> None:
    batch = uavaccel.make_vec("hover", 2, simulator="kernels")
    batch.reset(seed=0)
    batch.close()
    with pytest.raises(BatchError, match="this batch is closed"):
        batch.step(batch.action_space.sample())
    with pytest.raises(BatchError, match="this batch is closed"):
        batch.reset(seed=0)


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
    assert not left_after([loaded, *pids], 60.0)


FLYING = """
import numpy as np, sys
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.kernel_batch import KernelBatch
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
