"""Environments of gym 0.21's interface, as AirSim's samples have them, between a script and libraries of today."""

import sys
import sysconfig
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
import pytest
from gymnasium import spaces

from uavaccel.fly import old_gym, shims
from uavaccel.fly.keys import key_modules

pytestmark = pytest.mark.skipif("gym" not in shims.old_modules(), reason="a gym is installed")


class Walk(old_gym.Env):
    """One step to the right or the left, until 3."""

    action_space = spaces.Discrete(2)
    observation_space = spaces.Box(-9, 9, (1,), np.float32)
    metadata = {"render.modes": ["rgb_array"]}  # noqa: RUF012

    def __init__(self, start: int = 0) -> None:
        self.start, self.place = start, 0

    def reset(self) -> Any:
        self.place = self.start
        return np.array([self.place], np.float32)

    def step(self, action: int) -> Any:
        self.place += 1 if action else -1
        return np.array([self.place], np.float32), self.place, abs(self.place) == 3, {"place": self.place}


@pytest.fixture
def gym() -> Iterator[ModuleType]:
    gym = old_gym.modules()["gym"]
    gym.envs.registration.register(id="walk-v0", entry_point=Walk, kwargs={"start": 1})
    yield gym
    old_gym._registered.clear()


def test_a_script_steps_through_the_old_interface(gym: ModuleType) -> None:
    env = gym.make("walk-v0", start=2)
    assert env.reset().tolist() == [2]
    observation, reward, done, info = env.step(1)
    assert (observation.tolist(), reward, done, info) == ([3], 3, True, {"place": 3})
    assert env.place == 3


def test_wrappers_of_a_script_are_old_too(gym: ModuleType) -> None:
    class Doubled(gym.ObservationWrapper):  # type: ignore[name-defined]
        def observation(self, observation: Any) -> Any:
            return 2 * observation

    class Turned(gym.ActionWrapper):  # type: ignore[name-defined]
        def action(self, action: int) -> int:
            return 1 - action

    class Paid(gym.RewardWrapper):  # type: ignore[name-defined]
        def reward(self, reward: float) -> float:
            return 10 * reward

    env = Doubled(gym.make("walk-v0"))
    assert env.reset().tolist() == [2]
    assert env.step(1)[0].tolist() == [4]
    env = Paid(Turned(gym.make("walk-v0")))
    assert env.reset().tolist() == [1]
    assert env.step(0)[:3] == ([2], 20, False)
    assert env.unwrapped.place == 2


def test_stable_baselines_sees_gymnasiums_interface(gym: ModuleType) -> None:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    env: Any = DummyVecEnv([lambda: Monitor(gym.make("walk-v0"))])
    assert env.reset().tolist() == [[1]]
    env.step([1])
    observation, reward, done, info = env.step([1])
    assert (done.tolist(), reward.tolist(), info[0]["terminal_observation"].tolist()) == ([True], [3.0], [3])
    assert info[0]["episode"]["r"] == 5
    assert observation.tolist() == [[1]]  # reset


def test_a_library_is_told_apart_what_is_over_and_what_is_cut_short_and_seeds_what_it_resets(
    gym: ModuleType,
) -> None:
    class Cut(Walk):
        seeds: ClassVar[list[int]] = []

        def seed(self, seed: int | None = None) -> Any:
            self.seeds.append(seed or 0)

        def step(self, action: int) -> Any:
            observation, reward, _, info = super().step(action)
            return observation, reward, True, info | {"TimeLimit.truncated": self.place == 1}

    env = old_gym.Adapted(Cut())
    library: dict[str, Any] = {"env": env, "__file__": sysconfig.__file__}
    called = [eval(call, library) for call in ("env.reset(seed=4)", "env.step(1)", "env.step(1)")]
    assert (called[0][0].tolist(), called[0][1], Cut.seeds) == ([0], {}, [4])
    assert [each[2:4] for each in called[1:]] == [(False, True), (True, False)]


def test_a_module_named_before_the_id_is_imported_and_registers_it(
    gym: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = "from uavaccel.fly import old_gym", "from tests.test_old_gym import Walk"
    text = "\n".join([*lines, "old_gym.register(id='far-v0', entry_point=Walk, kwargs={'start': -2})"])
    (tmp_path / "walks_of_a_script.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    assert gym.make("walks_of_a_script:far-v0").reset().tolist() == [-2]
    del sys.modules["walks_of_a_script"]


def test_options_of_a_reset_reach_the_environment_through_its_wrappers(gym: ModuleType) -> None:
    class Placed(Walk):
        def reset(self, place: int = 0) -> Any:  # type: ignore[override]
            self.place = place
            return np.array([place], np.float32)

    wrapped = gym.ObservationWrapper(gym.ActionWrapper(Placed()))
    wrapped.observation = lambda observation: observation + 0.5
    assert wrapped.reset(place=2).tolist() == [2.5]


# --- keys and frames of a script without a keyboard -----------------------------------------------------------------


@pytest.mark.skipif(
    any(find_spec(name) for name in ("pygame", "keyboard", "msvcrt")), reason="what reads keys is installed"
)
def test_frames_and_keys_take_the_scripts_time(capsys: pytest.CaptureFixture[str]) -> None:
    """A frame of 50 ms lasts so long whatever is done in it, a longer one as long as that; a key takes 100 ms."""
    text = """
import pygame, keyboard, msvcrt
clock = pygame.time.Clock()
work(0.02)
told = [clock.tick(20)]
work(0.07)
told += [clock.tick(20), pygame.time.wait(250), pygame.time.get_ticks()]
told += [msvcrt.getch(), keyboard.read_key(), pygame.time.get_ticks()]
"""
    passed = [0.0]

    def sleep(seconds: float) -> None:
        passed[0] += seconds

    names: dict[str, Any] = {"work": sleep, "__file__": "/somewhere/script.py", "__name__": "__main__"}
    with key_modules(sleep, lambda: passed[0]):
        exec(compile(text, "/somewhere/script.py", "exec"), names)
    assert names["told"] == [50, 70, None, 370, b"\r", "enter", 570]
    assert "no key is ever pressed" in capsys.readouterr().err


def test_an_environment_that_nobody_registered(gym: ModuleType) -> None:
    with pytest.raises(ValueError, match=r"'run-v0' is registered; there are walk-v0"):
        gym.make("run-v0")
