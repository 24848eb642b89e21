"""Environments of gym 0.21's interface, as AirSim's samples have them, between a script and libraries of today."""

import sys
import sysconfig
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from gymnasium import spaces

from uavaccel.fly import environment, old_gym
from uavaccel.fly.keys import Keyboard, key_modules, parse_keys
from uavaccel.fly.modules import Patches, importing

pytestmark = pytest.mark.skipif("gym" not in environment.old_modules(), reason="a gym is installed")


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


def test_parts_of_gym_are_imported_by_their_names() -> None:
    text = """
from gym import error, logger, spaces, utils
from gym.envs.registration import register
from gym.spaces import Box
from gym.utils import seeding
import gym.envs.registration as again
found = again.register is register and gym.envs.registration is again and utils.seeding is seeding
"""
    names: dict[str, Any] = {}
    with importing(environment.old_modules(), {}):
        exec("import gym\n" + text, names)
    assert names["found"]
    assert names["Box"] is spaces.Box


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

    class Placed(Walk):
        def reset(self, place: int = 0) -> Any:
            return np.array([place], np.float32)

    assert Doubled(gym.ActionWrapper(Placed())).reset(place=2).tolist() == [4], "options of a reset pass through"
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


def test_libraries_see_terminated_truncated_and_seeds(gym: ModuleType) -> None:
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
    with pytest.raises(ValueError, match=r"'run-v0' is registered; there are walk-v0"):
        gym.make("run-v0")


def test_a_wrapper_passes_on_attributes_and_calls(gym: ModuleType) -> None:
    class Drawn(Walk):
        told: ClassVar[list[Any]] = []

        def render(self, mode: str = "human", **options: Any) -> Any:
            self.told.append((mode, options))
            return mode

        def close(self) -> None:
            self.told.append("closed")

    inner = Drawn()
    wrapped = gym.Wrapper(gym.Wrapper(old_gym.Adapted(inner)))
    assert wrapped.metadata["render.modes"] == ["rgb_array"]
    assert (wrapped.action_space, wrapped.observation_space) == (Walk.action_space, Walk.observation_space)
    assert (wrapped.render("rgb_array", width=3), wrapped.render()) == ("rgb_array", "human")
    with wrapped:
        wrapped.reset()
        wrapped.step(0)
    wrapped.close()
    assert Drawn.told[:2] == [("rgb_array", {"width": 3}), ("human", {})]
    assert Drawn.told[-1] == "closed"
    assert (wrapped.place, wrapped.unwrapped, wrapped.seed(5)) == (-1, inner, [5])


# --- keys and frames of a script without a keyboard -----------------------------------------------------------------

WITHOUT_KEYS = pytest.mark.skipif(
    any(find_spec(name) for name in ("pygame", "keyboard", "msvcrt")), reason="what reads keys is installed"
)


def run_as_a_script(text: str, keys: str = "") -> dict[str, Any]:
    """The names of a script that has run, at 7 s by its clock; `work` passes its time."""
    passed = [7.0]
    names: dict[str, Any] = {"__file__": "/somewhere/script.py", "__name__": "__main__", "work": passed.append}
    with key_modules(Keyboard(passed.append, lambda: sum(passed), parse_keys(keys))):
        exec(compile(text, "/somewhere/script.py", "exec"), names)
    return names


@WITHOUT_KEYS
def test_what_else_such_a_module_has_does_nothing() -> None:
    """But its clock goes by the script's time; a library finds no such module."""
    text = """
import pygame, sysconfig
library = {"__name__": "library", "__file__": sysconfig.__file__}
exec("try: import keyboard\\nexcept ImportError: missing = True", library)
ticks = [pygame.time.get_ticks(), work(0.25), pygame.time.get_ticks()]
class Sprite(pygame.sprite.Sprite):
    pass
with pygame.display.set_mode((640, 480)) as screen:
    screen.fill((0, 0, 0))
    pygame.display.flip()
told = [*screen, len(screen), int(screen), float(screen), screen[3], "ab"[screen], type(Sprite()).__name__]
"""
    names = run_as_a_script(text)
    assert names["ticks"] == [0, None, 250]
    assert names["library"]["missing"]
    assert names["told"] == [0, 0, 0.0, False, "a", "Sprite"]


@WITHOUT_KEYS
def test_an_installed_module_reads_its_own_keys_unless_some_are_pressed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "keyboard.py").write_text("read_key = lambda: 'its own'")
    monkeypatch.syspath_prepend(tmp_path)
    for keys, read in (("", "its own"), ("w", "w")):
        assert run_as_a_script("import keyboard\nread = keyboard.read_key()", keys=keys)["read"] == read
        monkeypatch.delitem(sys.modules, "keyboard", raising=False)


@WITHOUT_KEYS
def test_each_key_has_one_number_of_its_own() -> None:
    text = """
import pygame
from pygame.locals import *
same = [K_w == pygame.K_w, QUIT == pygame.QUIT, K_UP == pygame.locals.K_UP]
numbers = [value for value in vars(pygame.locals).values() if type(value) is int] + [pygame.K_F1]
events = [pygame.event.wait() for _ in range(4)]
called = [pygame.key.name(event.key) for event in events] + [pygame.key.name(pygame.K_F1)]
are = [event.key for event in events] == [K_w, K_PLUS, K_LEFTBRACKET, K_RETURN]
"""
    names = run_as_a_script(text, keys="W,+,[,enter")
    assert names["same"] == [True] * 3
    assert (names["called"], names["are"]) == (["w", "+", "[", "return", ""], True)
    assert len(set(names["numbers"])) == len(names["numbers"]) > 50
    assert "pygame" not in sys.modules


# --- images and names of old libraries ---------------------------------------------------------------------


def test_images_of_old_scipy_are_red_first_and_rescaled(tmp_path: Path) -> None:
    misc = environment.old_modules()["scipy.misc"]()
    red = np.zeros((2, 3, 3), np.uint8)
    red[..., 0] = 200
    misc.imsave(tmp_path / "red.png", red)
    np.testing.assert_array_equal(misc.imread(tmp_path / "red.png"), red)
    pixels: Any = cv2.imread(str(tmp_path / "red.png"))
    assert pixels[0, 0].tolist() == [0, 0, 200]
    for name, values, kept in (
        ("bytes", np.array([[3, 9]], np.uint8), [3, 9]),
        ("numbers", np.array([[-1.0, 0.0, 1.0, 3.0]]), [0, 63, 127, 255]),
        ("flat", np.full((1, 2), 0.5), [0, 0]),
    ):
        misc.imsave(tmp_path / f"{name}.png", values)
        assert misc.imread(tmp_path / f"{name}.png")[0, :, 0].tolist() == kept
    with pytest.raises(FileNotFoundError, match=r"none\.png"):
        misc.imread(tmp_path / "none.png")


def test_old_names_of_numpy_mean_what_they_meant() -> None:
    """A NumPy without them; `fromstring` of bytes gives an array of its own that can be written."""
    numpy = ModuleType("numpy")
    there = ("frombuffer", "fromstring", "inf", "nan", "bool_", "float64", "complex128", "str_", "bytes_")
    vars(numpy).update({name: getattr(np, name) for name in (*there, "prod", "cumprod", "any", "all", "isin")})
    with Patches() as patches:
        environment.supply_numpy(patches, numpy)
        assert all(getattr(numpy, kind.__name__) is kind for kind in (bool, complex, float, int, object, str))
        types = {"bool8": np.bool_, "float_": np.float64, "complex_": np.complex128, "string_": np.bytes_}
        reduced = {"product": np.prod, "cumproduct": np.cumprod, "sometrue": np.any, "alltrue": np.all, "in1d": np.isin}
        assert [getattr(numpy, name) for name in types | reduced] == [*types.values(), *reduced.values()]
        assert [numpy.Inf, numpy.infty, numpy.PINF, -numpy.NINF] == [np.inf] * 4
        assert (numpy.NaN, numpy.unicode_) == (np.nan, np.str_)
        bytes_of = numpy.fromstring(b"\x01\x02\x03", np.uint8)
        bytes_of[0] = 9
        assert bytes_of.tolist() == [9, 2, 3]
        assert numpy.fromstring(b"\x01\x00\x02\x00", "<u2", 1).tolist() == [1]
        assert numpy.fromstring("\xff\x01", np.uint8).tolist() == [255, 1]
        assert numpy.fromstring("1 2.5", sep=" ").tolist() == [1.0, 2.5]
    assert not hasattr(numpy, "float")
