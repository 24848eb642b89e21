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
found = again.register is register and gym.envs.registration is again
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


class AtOnce:
    """A thread that has run when it has begun."""

    def __init__(self, target: Any, daemon: bool) -> None:
        self.start = target

    def join(self, timeout: float | None = None) -> None:
        pass

    is_alive = join


def run_as_a_script(text: str, begun_s: float = 0.0, keys: str = "") -> dict[str, Any]:
    """The names of a script that has run; `work` passes its time, which `now` tells."""
    passed = [begun_s]

    def sleep(seconds: float) -> None:
        passed[0] += seconds

    names: dict[str, Any] = {"__file__": "/somewhere/script.py", "__name__": "__main__"}
    names |= {"work": sleep, "now": lambda: round(passed[0], 6)}
    thread: Any = AtOnce
    with key_modules(Keyboard(sleep, lambda: passed[0], parse_keys(keys), thread)):
        exec(compile(text, "/somewhere/script.py", "exec"), names)
    return names


@WITHOUT_KEYS
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
work(0.02)
told += [clock.tick(), clock.tick_busy_loop(50), clock.get_fps()]
"""
    names = run_as_a_script(text, begun_s=7.0)
    assert names["told"] == [50, 70, 250, 370, b"\r", "enter", 570, 470, 20, 0.0]
    assert "no key is ever pressed" in capsys.readouterr().err


@WITHOUT_KEYS
def test_nobody_presses_a_key_and_who_waits_for_one_waits_a_moment() -> None:
    calls: dict[str, tuple[Any, float]] = {
        "keyboard.is_pressed('w')": (False, 0.001), "keyboard.wait('esc')": (None, 0.1),
        "keyboard.read_key(suppress=True)": ("enter", 0.1), "keyboard.record(until='esc')": ([], 0.1),
        "msvcrt.kbhit()": (False, 0.001), "msvcrt.getch()": (b"\r", 0.1), "msvcrt.getche()": (b"\r", 0.1),
        "msvcrt.getwch()": ("\r", 0.1), "pygame.init()": ((0, 0), 0.0), "pygame.event.get()": ([], 0.001),
        "pygame.event.wait().key[3]": (False, 0.1), "pygame.key.get_pressed()[3]": (False, 0.001),
        "pygame.key.get_mods()": (0, 0.0), "pygame.joystick.get_count()": (0, 0.0),
        "pygame.joystick.get_init()": (False, 0.0), "pygame.time.wait(40)": (40, 0.04),
        "pygame.time.delay(40)": (40, 0.04), "pygame.time.get_ticks()": (0, 0.0),
        "pygame.mouse.get_pos() and 1": (0, 0.0),
    }  # fmt: skip
    for call, (answer, takes_s) in calls.items():
        module = call.partition(".")[0]
        names = run_as_a_script(f"import {module}\nanswer = {call}\nthen = now()", begun_s=7.0)
        got = names["answer"]
        assert (type(got), got) == (type(answer), answer) or (answer == 0 and len(got) == 0), call
        assert names["then"] == round(7.0 + takes_s, 6), call


READ_KEYS = """
import keyboard, msvcrt, pygame
from pynput import keyboard as keys
told = []
while not keyboard.is_pressed("x"):
    told += ["c"] if keyboard.is_pressed("c") and (not told or told[-1] != now()) else []
polled = now()
work(1)
read = [msvcrt.getch(), msvcrt.getwch(), keyboard.read_key(), msvcrt.getch(), msvcrt.getch()]
work(1)
events = [(event.type == pygame.KEYDOWN, event.key) for event in pygame.event.get()]
held = pygame.key.get_pressed()
held = [held[pygame.K_UP], held[pygame.K_DOWN]]
work(0.15)
events += [(event.type == pygame.KEYUP, event.key) for event in pygame.event.get()]
heard = []
with keys.Listener(on_press=lambda key: heard.append(key), on_release=lambda key: key != keys.Key.esc) as listener:
    listener.join()
begun, down_s = now(), []
while not pygame.key.get_pressed()[pygame.K_q] and now() < begun + 1:
    down_s += [now() - begun] if pygame.key.get_pressed()[pygame.K_w] else []
hooked = []
keyboard.on_press_key("z", lambda event: hooked.append(event.name))
"""


@WITHOUT_KEYS
def test_keys_are_pressed_in_turn_each_until_it_is_noticed() -> None:
    """Each is down for 100 ms from then on, and the next one comes after 100 ms more."""
    names = run_as_a_script(READ_KEYS, keys="c,x,a,enter,space,left,up,b,esc,w,q,y,z,Z")
    assert 0.2 <= names["polled"] < 0.21
    assert names["read"] == [b"a", "\r", "space", b"\xe0", b"K"]
    up = names["pygame"].K_UP
    assert (names["events"], names["held"]) == ([(True, up), (True, up)], [True, False])
    assert [str(key) for key in names["heard"]] == ["'b'", "Key.esc"]
    assert names["heard"][0] == names["keys"].KeyCode.from_char("b")
    assert names["down_s"][-1] - names["down_s"][0] == pytest.approx(0.1, abs=0.005)
    assert names["hooked"] == ["z"]


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


# --- windows, images and names of old libraries ---------------------------------------------------------------------


def test_a_window_is_shown_nowhere_and_waits_as_long_as_it_is_told() -> None:
    slept: list[float] = []
    window = cv2.imshow
    with Patches() as patches:
        environment.supply_windows(patches, cv2, Keyboard(slept.append, lambda: sum(slept)))
        assert cv2.imshow("camera", np.zeros((2, 2))) is None
        assert [cv2.waitKey(250), cv2.waitKeyEx(1500), cv2.waitKey(0), cv2.waitKey(-1)] == [-1] * 4
        assert slept == [0.25, 1.5, 0.1, 0.1]
        environment.supply_windows(patches, cv2, Keyboard(slept.append, lambda: sum(slept), ("q", "esc", "left")))
        assert [cv2.waitKey(1), cv2.waitKey(0), cv2.waitKey(1), cv2.waitKey(0)] == [ord("q"), 27, -1, 81]
        assert cv2.waitKey(0) == -1
        cv2.createTrackbar("hue", "camera", 3, 10, lambda value: None)
        cv2.createTrackbar("value", "camera", 300, 255, onChange=lambda value: None)
        cv2.setTrackbarPos("hue", "camera", 4)
        assert [cv2.getTrackbarPos(name, "camera") for name in ("hue", "value", "none")] == [4, 255, -1]
        assert cv2.getWindowProperty("camera", cv2.WND_PROP_VISIBLE) == 1.0
        cv2.setMouseCallback("camera", lambda *event: None)
        assert cv2.selectROI("camera", np.zeros((2, 2))) == (0, 0, 0, 0)
    assert cv2.imshow is window


def test_a_backend_that_draws_on_a_screen_is_not_chosen() -> None:
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    before = mpl.get_backend()
    with Patches() as patches:
        environment._supply_old_interfaces(patches, Keyboard(lambda seconds: None, lambda: 0.0))
        mpl.use("TkAgg")
        plt.switch_backend("Qt5Agg")
        plt.plot([1, 2])
        plt.show()
        assert mpl.get_backend().lower() == "agg"
    plt.close("all")
    mpl.use(before)


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
        assert (numpy.float, numpy.int, numpy.bool, numpy.object) == (float, int, bool, object)
        assert (numpy.bool8, numpy.float_, numpy.product, numpy.in1d) == (np.bool_, np.float64, np.prod, np.isin)
        assert (numpy.sometrue, numpy.alltrue, numpy.Inf, numpy.NINF) == (np.any, np.all, np.inf, -np.inf)
        bytes_of = numpy.fromstring(b"\x01\x02\x03", np.uint8)
        bytes_of[0] = 9
        assert bytes_of.tolist() == [9, 2, 3]
        assert numpy.fromstring(b"\x01\x00\x02\x00", "<u2", 1).tolist() == [1]
        assert numpy.fromstring("\xff\x01", np.uint8).tolist() == [255, 1]
        assert numpy.fromstring("1 2.5", sep=" ").tolist() == [1.0, 2.5]
    assert not hasattr(numpy, "float")
