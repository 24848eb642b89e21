"""The exact simulator, lanes over arrays on the CPU, and those of a GPU fly, see, time and judge the same games.

Tasks, actions, conditions, latencies and seeds are random. The exact simulator's pictures are here the kernels', so
that what an event camera makes of them is compared to the bit; tests/test_kernel_looks.py compares them with OpenGL's.
The GPU's kernels run on the CPU (tests/host_kernels.py) unless UAVACCEL_TEST_GPU=1 asks for the GPU itself.
"""

from __future__ import annotations

import re
from contextlib import ExitStack, closing, nullcontext, suppress
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
import torch as th
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.host_kernels import ON_A_GPU, a_gpu, host_kernels  # noqa: F401 - fixtures
from tests.lanes import SideBySide, assert_close, assert_same, stored
from tests.own_tasks import Few, Post, PostTask, Spin
from uavaccel.envs import kernel_games
from uavaccel.envs.arrays import mapped, select
from uavaccel.envs.flight_env import FlightEnv, environment_of
from uavaccel.envs.gates import Gates
from uavaccel.envs.hover import Hover
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import CUDA, check_flyable
from uavaccel.envs.task import Task
from uavaccel.errors import UserError
from uavaccel.kernels import timeline as wire
from uavaccel.kernels.appearance import empty_scenes, fill_scenes, read_appearance
from uavaccel.kernels.pictures import render_lanes
from uavaccel.kinematics import BodyRatesGoal, VelocityGoal
from uavaccel.resources import asset
from uavaccel.sim.camera import gl
from uavaccel.sim.world import World
from uavaccel.wire.latency import CHANNELS, WAITS_MS, Latency

LANES, FRAME_NS = 2, 20_000_000
PHASES = ("inference", "learning")
Keys = dict[str, Any]


class Case(NamedTuple):
    """What is flown; `noise` is how far from straight ahead actions are, and `work_s` what the agent takes for one."""

    kind: type[FlightEnv]
    keys: Keys
    seed: int
    commands: int
    noise: float
    work_s: float
    events: tuple[str, ...] = ()
    """Before the commands from the third on games are moved to other engines, or begin anew: one of them where that can
    be, or all in turn, by a seed or by options."""
    next_step: bool = False
    """Whether a game that is over begins anew with the next command; a GPU's batch does not have this."""


# --- what is drawn --------------------------------------------------------------------------------------


def constant_latencies() -> st.SearchStrategy[Keys]:
    """Latency models each of whose channels always takes the same, so that clocks do not depend on the generator."""
    channel = st.floats(1.0, 3000.0).map(lambda us: [us, us])
    names = [each for name in CHANNELS for each in (name, *(f"{name}@{ms}ms" for ms in WAITS_MS))]
    tables = st.dictionaries(st.sampled_from(names), channel, max_size=12).map(lambda of: {"call": [40.0, 40.0], **of})
    platform = st.fixed_dictionaries(
        {},
        optional={
            "stall_us": st.sampled_from([900.0, 40_000.0]),
            "tick_us": st.sampled_from([45.0, 1000.0]),
            "integer_clock_speed": st.booleans(),
            "frames": st.fixed_dictionaries({"hz": st.just(60.0), "stale_pose": st.booleans()}),
        },
    )
    return st.fixed_dictionaries(
        {
            "quantiles": st.just([0.0, 1.0]),
            "request_us": tables,
            "reply_us": tables,
            "issue_us": channel,
            "timer_us": channel,
            "scale": st.sampled_from([1.0, 1.3, 8.0]),
            "platform": platform,
        }
    )


def timings() -> st.SearchStrategy[Keys]:
    """How commands are timed."""
    both = {"command": st.sampled_from(["adsc", "tcsc"]), "profile": st.sampled_from(["native", "airsim"])}
    both["clock_speed"] = st.sampled_from([1.0, 3.0, 7.5, 30.0])
    virtual = {"timing": st.just("virtual"), "latency": constant_latencies()}
    virtual["image_processing_s"] = st.sampled_from([0.0, 0.0003, 0.05])
    gaps = mediations().map(lambda gap: {"mediation": gap, "clock_speed": 3.0})
    return st.one_of(st.just({}), gaps, st.fixed_dictionaries(both), st.fixed_dictionaries({**both, **virtual}))


def mediations() -> st.SearchStrategy[Keys]:
    """Gaps between commands, whole or in part; images are older than some commands' first samples."""
    late_s = st.sampled_from([0.0, 0.002, 0.016])
    return st.fixed_dictionaries(
        {"gap_s": st.sampled_from([0.0, 0.04, 0.3, 1.1]), "image_age_s": late_s},
        optional={"start_speed": st.sampled_from([0.0, 0.4, 1.0])},
    )


def durations(*pairs: tuple[float, float]) -> st.SearchStrategy[Keys]:
    return st.sampled_from([{"t_move_s": move, "t_sample_s": sample} for move, sample in pairs])


LOW_LEVEL = durations((0.02, 0.02), (0.1, 0.02), (0.1, 0.06))
COMMANDED = durations((0.2, 0.2), (0.5, 0.2), (1.0, 0.33))
CONTINUOUS = st.one_of(
    st.tuples(st.just({"action": "velocity"}), COMMANDED).map(lambda parts: parts[0] | parts[1]),
    st.tuples(
        st.sampled_from(["attitude", "rates", "motors"]), LOW_LEVEL, st.floats(5.0, 90.0), st.floats(20.0, 720.0)
    ).map(lambda parts: {"action": parts[0], **parts[1], "tilt_deg": parts[2], "rate_deg_s": parts[3]}),
)
HOVERS = st.fixed_dictionaries(
    {"max_commands": st.integers(2, 9), "history": st.integers(1, 3), "altitude_m": st.sampled_from([0.5, 2.0, 10.0])},
    optional={"hold_s": st.just(0.04), "radius_m": st.just(2.5)},
)
GATES = st.fixed_dictionaries(
    {"spacing_m": st.floats(0.7, 3.0), "half_width_m": st.floats(0.3, 1.5), "max_commands": st.integers(2, 9)}
)
DIFFICULTY = st.fixed_dictionaries(
    {"first_row_m": st.floats(1.1, 4.0), "wind_m_s": st.floats(0.0, 6.0), "mass_ratio": st.floats(0.8, 1.2)}
)
RANDOMISED = st.sampled_from(
    [
        {},
        {"randomise": {"wind_m_s": [0, 6], "speed_m_s": [0.5, 4.0], "altitude_m": [1, 4], "share": 0.7}},
        {"randomise": {"mass_ratio": [0.8, 1.2], "speed_m_s": [1.0, 3.0], "widen_over_games": 4}},
    ]
)
FLIGHTS = st.fixed_dictionaries(
    {
        "max_commands": st.integers(2, 9),
        "history": st.integers(1, 3),
        "difficulty": DIFFICULTY,
        "wall_reward": st.just(-0.1),
    }
)
SCALES = st.sampled_from([[0.0, 4.0], [2.5, 2.5]])  # of a game's latencies
PLACED = {"lane": {"obstacles": [{"x_m": 3, "y_m": 0.6, "radius_m": 0.5}, {"x_m": 4, "y_m": -1.0, "half_side_m": 0.4}]}}
NOISE = st.fixed_dictionaries(
    {"dvs_preset": st.sampled_from(["clean", "constructor", "command_line", "noisy"])},
    optional={
        "dvs_shot_noise_hz": st.sampled_from([0.5, 900.0]),
        "dvs_leak_hz": st.sampled_from([0.3, 50.0]),
        "dvs_hot_pixels": st.just(0.02),
        "image_noise": st.sampled_from([1.0, 12.0]),
        "dvs_seed": st.integers(0, 3),
        "dvs_threshold_ratio": st.floats(0.5, 2.0),
        "knows": st.just(["last_action", "frame_age"]),
    },
)


COLOUR, DEPTH = {"observation": "colour"}, {"observation": "depth", "image_noise": 0.0}


KINDS: list[type[FlightEnv]] = [Hover, Gates, ObstacleLane, Post, Spin, Navigate]
WORLDS = {"clutter": {"shapes": 250}, "speed_m_s": 6.0, "split": "evaluation"}
UNSEEN = {"observation": "state", "picture_size": [64, 36]}  # which is of no picture here


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Tasks that observe the state."""
    kind: type[FlightEnv] = draw(st.sampled_from(KINDS))
    parts: dict[Any, list[Any]] = {
        Hover: [HOVERS, CONTINUOUS],
        Gates: [GATES, CONTINUOUS],
        ObstacleLane: [FLIGHTS, COMMANDED, st.one_of(RANDOMISED, st.just(PLACED)), st.just(UNSEEN)],
        Post: [COMMANDED, st.fixed_dictionaries({"ends_at_touch": st.booleans()})],
        Spin: [LOW_LEVEL],
        Navigate: [st.just({**WORLDS, "observation": "state"}), CONTINUOUS],
    }
    keys: Keys = {name: value for part in (timings(), *parts[kind]) for name, value in draw(part).items()}
    if kind is ObstacleLane and keys.get("timing") == "virtual" and "lane" not in keys:
        keys["randomise"] = {**keys.get("randomise", {}), "latency_scale": draw(SCALES)}
    noise = draw(st.sampled_from([0.1, 0.4, 1.0]))
    return Case(kind, keys, draw(st.integers(0, 2**16)), 10, noise, draw(work()), draw(EVENTS), draw(st.booleans()))


@st.composite
def seen_cases(draw: st.DrawFn) -> Case:
    """Lanes that are observed by a camera, most by an event camera."""
    keys: Keys = {name: value for part in (timings(), FLIGHTS, NOISE) for name, value in draw(part).items()}
    keys["difficulty"] |= draw(st.sampled_from([{}, {"light": [0.1, 0.1]}, {"light": [0.03, 1.0]}]))
    both = {"also_state": True}
    keys |= draw(st.sampled_from([{}, both, {"dvs_rate_hz": 1000 / 12}, {"dvs_rate_hz": 500.0} | both, COLOUR, DEPTH]))
    if "dvs_rate_hz" in keys:  # ADSC flies on, and sees a frame every few milliseconds
        keys |= {name: min(keys[name], 3.0) for name in ("clock_speed",) if name in keys}
        if keys.get("profile") == "airsim":
            keys["dvs_rate_hz"] = 1000 / 12  # which divides both profiles' steps
    short = durations((0.104, 0.104), (0.24, 0.12)) if "dvs_rate_hz" in keys else durations((0.3, 0.3), (0.4, 0.2))
    if "mediation" in keys:
        keys["mediation"] = {**keys["mediation"], "image_age_s": draw(st.sampled_from([0.0, 0.05, 0.2, 0.25]))}
        keys.pop("dvs_rate_hz", None)
        short = durations((0.3, 0.3), (0.4, 0.2))
    keys |= draw(short) | {"max_commands": draw(st.integers(2, 4)), "speed_m_s": draw(st.sampled_from([1.0, 6.0]))}
    work_s = draw(st.sampled_from([0.0, 0.003]))  # ADSC flies on meanwhile, and the camera sees it
    return Case(ObstacleLane, keys, draw(st.integers(0, 2**16)), 5, 0.5, work_s, draw(EVENTS), draw(st.booleans()))


@st.composite
def worlds(draw: st.DrawFn) -> Case:
    """Clutter that is observed by a camera."""
    depth = {"observation": "depth", "also_state": True, "also_attitude": draw(st.booleans())}
    looks: Keys = draw(st.sampled_from([depth, {"dvs_shot_noise_hz": 5.0}]))
    seen = {"observation": "dvs", "picture_size": [32, 20], "image_noise": 2.0} if len(looks) == 1 else {}
    keys = {**WORLDS, **seen, **looks, "max_commands": draw(st.integers(2, 4)), "history": draw(st.integers(1, 2))}
    return Case(Navigate, keys, draw(st.integers(0, 2**16)), 6, 0.6, 0.0, draw(EVENTS))


EVENTS = st.lists(st.sampled_from(["", "move", "one", "in turn", "seed", "options"]), max_size=3).map(tuple)


def work() -> st.SearchStrategy[float]:
    return st.sampled_from([0.0, 0.003, 0.7])


# --- how they are compared ------------------------------------------------------------------------------


def actions_of(case: Case, space: Any) -> np.ndarray:
    """Mostly ahead, so that some games are lost and others go far."""
    random, shape = np.random.default_rng(case.seed), (case.commands, LANES)
    if not space.shape:
        ahead = space.n // 2
        return np.where(random.random(shape) < 1.0 - case.noise, ahead, random.integers(space.n, size=shape))
    ahead = np.array([1.0, 0.0, 0.0, 0.0][: space.shape[0]]) * (case.keys.get("action", "velocity") == "velocity")
    off = random.uniform(-case.noise, case.noise, (*shape, *space.shape))
    return np.clip(ahead + off, -1.0, 1.0).astype(np.float32)


OPTIONS: dict[Any, Keys] = {ObstacleLane: {"lane": 7}, Navigate: {"world": 7}, Hover: {"waypoint_m": [1, 2, -8]}}


class Engines:
    """A case's environments: alone in the exact simulator, lanes on the CPU and, if it flies them, those of a GPU."""

    def __init__(self, case: Case, stack: ExitStack) -> None:
        self._case, self._stack = case, stack
        reduced = case.kind is ObstacleLane and case.keys.get("observation") in ("colour", "depth")
        self.lanes = SideBySide(*self._made(), pictures_alike if reduced else assert_same)
        self.device = self._made_device()
        self._returns, self._steps = np.zeros(LANES), list[Any]()

    def _made(self) -> tuple[KernelBatch, list[FlightEnv]]:
        """The exact simulator's pictures are the kernels' in the lane alone; elsewhere it flies what sees none."""
        kind, keys, mode = self._case.kind, self._case.keys, "NextStep" if self._case.next_step else "SameStep"
        batch = KernelBatch(kind, LANES, threads=1, autoreset_mode=mode, **keys)
        blind = kind is Navigate and batch.task.observation != "state"
        alone = [kind(**keys) for _ in range(0 if blind else LANES)]
        each: Any
        for each in (batch, *alone):
            self._stack.enter_context(closing(each))
        return batch, alone

    def _made_device(self) -> Any:
        from uavaccel.envs.cuda_batch import CudaBatch

        with suppress(UserError):
            check_flyable(self.lanes.batch.task, LANES, CUDA)
            if not self._case.next_step:
                return self._stack.enter_context(closing(CudaBatch(self._case.kind, LANES, **self._case.keys)))
        return None

    def reset(self, seed: int | None = None, options: Any = None) -> None:
        seen = self.lanes.reset(seed, options)
        self._returns[:] = 0.0
        if self.device:
            mapped(assert_seen, self.device.reset(seed=seed, options=options)[0], seen)

    def move(self) -> None:
        """To engines that have flown other games."""
        states = self.device.get_states() if self.device else []
        batch, alone = self._made()
        each: Any
        for each in (batch, *alone):
            each.reset(seed=1)
        self.lanes.move(batch, alone)
        if self.device:
            self.device = self._made_device()
            self.device.reset(seed=1)
            seen = self.device.set_states([stored(state) for state in states])
            seen = mapped(lambda each: th.from_numpy(each).to(self.device.device), seen)
            mapped(assert_seen, seen, batch.observations())

    def charge(self, spent_s: float, phase: str) -> None:
        self.lanes.charge(spent_s, phase)
        if self.device:
            lanes = self.device._lanes
            lanes.charge(lanes.going, spent_s, phase)

    def step(self, actions: Any, in_turns: bool) -> None:
        """Fly a command everywhere, in turns with a lane by itself."""
        if in_turns and not self.device:
            for lane in reversed(range(LANES)):
                self.lanes.step(actions, [lane])
            return
        flown = self.lanes.step(actions)
        if self.device:
            self._steps = [*self._steps[-1:], (self.device.step(actions), flown)]
            for each in self._steps:  # that before, too, which stays as it was
                compare_batch(self.device, *each)
            self._compare_what_the_host_reads(flown)

    def _compare_what_the_host_reads(self, flown: Any) -> None:
        """Return and info of the games that have ended, as a learner is told them."""
        from uavaccel.envs.cuda_lanes import AT

        lanes, over = self.device._lanes, flown[2] | flown[3]
        self._returns += flown[1]
        ended = lanes.ended.cpu()
        np.testing.assert_array_equal(ended[:, AT.over] > 0.0, over)
        for lane in np.flatnonzero(over).tolist():
            outcome, expected = ended[lane].tolist(), flown[4][lane]["final_info"]
            found = lanes.info(lane, outcome)
            assert outcome[AT.reward] == pytest.approx(self._returns[lane], abs=1e-9)
            assert found["collision"] == expected["collision"]
            same = {"is_success", "position_m", "commands", "wall_s", "phase_s", "lane", "world", "conditions"}
            for name in same & {*expected}:
                assert_close(found[name], expected[name])
        self._returns[over] = 0.0


def fly_everywhere(case: Case) -> list[Any]:
    """Fly a case in all simulators, compare them after each command, and return the infos of games that ended."""
    with ExitStack() as stack:
        engines = Engines(case, stack)
        engines.reset(case.seed)
        for number, actions in enumerate(actions_of(case, engines.lanes.batch.single_action_space)):
            event = dict(enumerate(case.events, 2)).get(number, "")
            if event == "move":
                engines.move()
            elif event == "one" and not engines.device:
                engines.lanes.reset_one(LANES - 1)
            elif event:
                options = OPTIONS.get(case.kind) if event == "options" and "lane" not in case.keys else None
                engines.reset(case.seed + 1 if event == "seed" else None, options)
            elif number:  # the first games' first commands follow the reset
                engines.charge(case.work_s, PHASES[number % 2])
            engines.step(actions, in_turns=number % 3 == 2)
        engines.reset()  # without a seed the games go on
        return engines.lanes.ends


def compare_batch(device: Any, flown: Any, steps: Any) -> None:
    """A batch of tensors with the CPU's."""
    observations, rewards, terminated, truncated, infos = flown
    mapped(assert_seen, observations, steps[0])
    np.testing.assert_allclose(rewards.cpu().numpy(), steps[1], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(terminated.cpu(), steps[2])
    np.testing.assert_array_equal(truncated.cpu(), steps[3])
    over = steps[2] | steps[3]
    for mask in ("_final_obs", "_final_info"):
        np.testing.assert_array_equal(infos[mask].cpu(), over)
    for lane in range(LANES):
        for name in ("position_m", "commands"):  # of the next game where one has ended
            assert_close(infos[name][lane].tolist(), steps[4][lane][name])
        if not over[lane]:
            continue
        mapped(assert_seen, select(infos["final_obs"], lane), steps[4][lane]["final_obs"])
        found, expected = one_lane(infos["final_info"], lane), dict(steps[4][lane]["final_info"])
        hit = found.pop("collision")
        assert (None if hit < 0 else device.object_names[hit]) == expected.pop("collision")
        assert_close(found, expected)


def pictures_alike(ours: Any, theirs: Any) -> None:
    """To the bit, but for OpenCV's way to round halves where it reduces pictures."""
    assert np.abs(ours.astype(int) - theirs).max() <= 1
    assert np.mean(ours != theirs) < 0.05


def assert_seen(ours: Any, theirs: Any) -> None:
    """Pictures to the bit, but for single pixels of a GPU's own arithmetic, and numbers but for their last."""
    found = ours.cpu().numpy().astype(float)
    if theirs.dtype != np.uint8:
        np.testing.assert_allclose(found, theirs, rtol=1e-6, atol=1e-6)
    elif ours.is_cuda:
        assert np.mean(np.abs(found - theirs) > 1.0) < 5e-3  # counts of events: 12 of 4 608 on an H200
    else:
        np.testing.assert_array_equal(found, theirs)


def one_lane(info: Any, lane: int) -> Any:
    """A lane's info without the masks beside it."""
    if not isinstance(info, dict):
        return info[lane].tolist()
    return {name: one_lane(value, lane) for name, value in info.items() if not name.startswith("_")}


@pytest.fixture
def kernels_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """The exact simulator sees what the kernels render; a frame is waited for as long each time."""
    appearance = read_appearance(mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml"))))
    lay_out = World.set_lane

    def set_lane(world: World, layout: Any) -> None:
        lay_out(world, layout)
        scenes = empty_scenes(1)
        fill_scenes(appearance, scenes, [0], [layout])
        vars(world)["scenes"] = scenes

    class Camera:
        def __init__(self, world: World) -> None:
            self.scenes = vars(world)["scenes"]

        def __getattr__(self, name: str) -> Any:
            kind: Any = name
            half_turn = np.array([1.0, -1.0, -1.0])

            def picture(data: mujoco.MjData) -> Any:
                turned = np.concatenate([data.qpos[3:5], -data.qpos[5:7]])
                lane = np.zeros(1, np.int32)
                pose = (data.qpos[:3] * half_turn)[None], turned[None]
                return render_lanes(kind, appearance, self.scenes, lane, *pose)[0]

            return picture

    monkeypatch.setattr(World, "set_lane", set_lane)
    monkeypatch.setattr(World, "camera", lambda world, width, height: Camera(world))
    monkeypatch.setattr(gl, "check_process", lambda: None)
    tables_of = kernel_games._tables

    def tables(latency: Any) -> Any:
        made = tables_of(latency)
        made.tables_us[wire.FRAME] = FRAME_NS / 1e3
        return made

    monkeypatch.setattr(kernel_games, "_tables", tables)
    monkeypatch.setattr(Latency, "frame_ns", lambda _: FRAME_NS)


HOLD_TO_COME: Keys = {
    "mediation": {"gap_s": 0.3, "image_age_s": 0.25, "start_speed": 0.0},
    "t_move_s": 0.3,
    "t_sample_s": 0.1,
    "max_commands": 5,
}
"""Position hold sets in between the end of a gap, whose motion is undone, and the command that comes late.

It comes within the last of three slices.
"""

QUICK: Keys = {
    "quantiles": [0.0, 1.0],
    **{name: {"call": [40.0, 40.0]} for name in ("request_us", "reply_us")},
    **{name: [0.0, 0.0] for name in ("issue_us", "timer_us")},
}
AT_ONCE: Keys = {name: {"call": [0.0, 0.0]} for name in ("request_us", "reply_us")}
GOES_ON: Keys = {
    "ends_at_touch": False,
    "timing": "virtual",
    "command": "adsc",
    "clock_speed": 3.0,
    "latency": {**QUICK, "scale": 2.0, "platform": {"faults": {"late": 1.0}}},
    "t_move_s": 0.5,
    "t_sample_s": 0.2,
    "max_commands": 8,
}
"""A vehicle that has touched something is given commands, which come late, while time passes."""
STANDS_IN_THE_GAP: Keys = {
    "ends_at_touch": False,
    "mediation": {"gap_s": 0.3, "image_age_s": 0.0, "start_speed": 0.4},
    "t_move_s": 0.5,
    "t_sample_s": 0.2,
    "max_commands": 8,
}
"""Nor does the end of a gap, whose motion is undone, let it go on."""
FLIES_ON: Keys = {
    "observation": "state",
    "mediation": {"gap_s": 1.1, "image_age_s": 0.0, "start_speed": 1.0},
    "lane": {"obstacles": [{"x_m": 4.48, "y_m": 0.0, "half_side_m": 0.3}]},
    "t_move_s": 1.0,
    "t_sample_s": 0.5,
    "speed_m_s": 6.0,
}
"""It has come to rest just before a post when the gap is over, and its motion is undone."""
MANY_GAMES: Keys = {
    "observation": "state",
    "max_commands": 1,
    "randomise": {"wind_m_s": [2, 6], "speed_m_s": [1, 4], "altitude_m": [1, 4], "share": 0.4, "widen_over_games": 9},
}
"""What was sampled for games that a GPU has forgotten is not said of those in their places, nor are they counted."""

FIXTURES = settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], deadline=None)


@pytest.mark.slow
@settings(FIXTURES, max_examples=13)
@example(Case(ObstacleLane, {**HOLD_TO_COME, "observation": "state"}, 0, 8, 0.5, 0.0, events=("", "options", "move")))
@example(Case(Post, GOES_ON, seed=1, commands=9, noise=0.1, work_s=0.7, events=("", "", "", "", "move")))
@example(Case(Post, STANDS_IN_THE_GAP, seed=1, commands=9, noise=0.1, work_s=0.0, events=("", "", "", "", "move")))
@example(Case(ObstacleLane, FLIES_ON, seed=0, commands=3, noise=0.0, work_s=0.0))
@example(Case(Few, {**UNSEEN, "max_commands": 2}, seed=0, commands=6, noise=0.1, work_s=0.0))
@example(Case(ObstacleLane, MANY_GAMES, 0, 16, 0.1, 0.0, events=("options", "", "", "seed", "", "", "move")))
@given(cases())
@pytest.mark.usefixtures("a_gpu")
def test_games_are_the_same_in_all_simulators(case: Case) -> None:
    fly_everywhere(case)


HIT_BETWEEN_FRAMES: Keys = {
    "also_state": True,
    "dvs_rate_hz": 500.0,
    "lane": {"obstacles": [{"x_m": 2.0, "y_m": 0.0, "half_side_m": 0.5}]},
    "t_move_s": 0.24,
    "t_sample_s": 0.12,
    "max_commands": 4,
    "speed_m_s": 6.0,
}
"""Events that were not read are of the game that has ended, whose last state is not shown."""
OTHER_LIGHT: Keys = {
    "observation": "colour",
    "knows": ["frame_age"],
    "timing": "virtual",
    "command": "adsc",
    "clock_speed": 3.0,
    "image_processing_s": 0.05,
    "latency": QUICK,
    "difficulty": {"light": [0.03, 1.0]},
    "t_move_s": 0.3,
    "t_sample_s": 0.3,
    "max_commands": 1,
}
"""A game's first image is not requested again because the last game's was darker; ADSC lets each become older.

In lockstep, where processing takes no time, it does not."""
DARK_COLOURS: Keys = {**OTHER_LIGHT, "difficulty": {"light": [0.08, 0.12], "texture_variation": 1.0}}
"""Each about as bright as the guard's floor, by the weights of red, green and blue."""
COMES_NEAR: Keys = {
    "timing": "virtual",
    "latency": QUICK | {"request_us": {"call": [40.0, 40.0], "image": [9000.0, 9000.0]}},
    "lane": {"obstacles": [{"x_m": 3.5, "y_m": 0.0, "half_side_m": 1.0}]},
    "t_move_s": 0.6,
    "t_sample_s": 0.3,
    "speed_m_s": 4.0,
}
"""The event camera's picture becomes darker from sample to sample, and is requested again."""
RESTS: Keys = {"dvs_preset": "command_line", "dvs_rate_hz": 500.0, "t_move_s": 0.1, "t_sample_s": 0.1, "speed_m_s": 6.0}
"""Frames come every 2 ms, of which a pixel rests half a millisecond after each event."""
OUT_OF_STEP: Keys = {"dvs_rate_hz": 250 / 3, "t_move_s": 0.104, "t_sample_s": 0.104, "speed_m_s": 6.0}
"""The second command has a frame more than the first."""
STANDS_BETWEEN_FRAMES: Keys = {
    "observation": "colour",
    "knows": ["last_action", "frame_age"],
    "timing": "virtual",
    "profile": "airsim",
    "clock_speed": 3.0,
    "image_processing_s": 0.06,
    "latency": QUICK | AT_ONCE | {"platform": {"frames": {"hz": 50.0, "stale_pose": True}}},
    "t_move_s": 0.36,
    "t_sample_s": 0.12,
    "speed_m_s": 6.0,
    "max_commands": 3,
    "history": 2,
}
"""Images show the pose of Unreal's last frame, and are as old to the agent as TCSC's clock says, which stands: from the
moment of a frame on, which does not come any more."""
OTHER_NOISE: Keys = {
    "randomise": {"image_noise": [2, 9], "dvs_leak_hz": [5, 50], "share": 0.4},
    "t_move_s": 0.4,
    "t_sample_s": 0.2,
    "max_commands": 1,
}
"""Cameras are quiet in one game, and noisy in the next and in that beside it; lanes fly on while one renders."""

TWO_SAMPLES_OF_ONE_TICK: Keys = {
    "command": "adsc",
    "profile": "native",
    "clock_speed": 7.5,
    "timing": "virtual",
    "latency": {
        "request_us": {"call": [40.0, 40.0]},
        "reply_us": {"call": [40.0, 40.0]},
        "quantiles": [0.0, 1.0],
        "issue_us": [1.0, 1.0],
        "timer_us": [1.0, 1.0],
        "platform": {"stall_us": 40000.0, "frames": {"hz": 60.0, "stale_pose": True}},
    },
    "image_processing_s": 0.0,
    "dvs_rate_hz": 250.0 / 3.0,
    "t_move_s": 0.24,
    "t_sample_s": 0.12,
    "max_commands": 2,
}
"""A stall puts both samples of a command on a tick of the event camera's; the second sees its frame all the same."""

STALE_FOR_THE_GUARD: Keys = {
    **TWO_SAMPLES_OF_ONE_TICK,
    "clock_speed": 1.0,
    "latency": {**TWO_SAMPLES_OF_ONE_TICK["latency"], "platform": {"frames": {"hz": 60.0, "stale_pose": True}}},
    "difficulty": {"first_row_m": 1.28},
}
"""The event camera has a frame of the sample's own tick; the guard judges the stale one, of another brightness."""


@pytest.mark.slow
@settings(FIXTURES, max_examples=6)
@example(Case(ObstacleLane, STALE_FOR_THE_GUARD, seed=10, commands=5, noise=0.5, work_s=0.0))
@example(Case(ObstacleLane, TWO_SAMPLES_OF_ONE_TICK, seed=0, commands=5, noise=0.5, work_s=0.0))
@example(Case(ObstacleLane, HIT_BETWEEN_FRAMES, seed=0, commands=5, noise=0.0, work_s=0.0))
@example(Case(ObstacleLane, OTHER_LIGHT, seed=0, commands=5, noise=0.5, work_s=0.0))
@example(Case(ObstacleLane, DARK_COLOURS, seed=0, commands=9, noise=0.5, work_s=0.0))
@example(Case(ObstacleLane, {**OTHER_LIGHT, "timing": "lockstep"}, seed=0, commands=2, noise=0.5, work_s=0.0))
@example(Case(ObstacleLane, STANDS_BETWEEN_FRAMES, seed=0, commands=3, noise=0.0, work_s=0.0))
@example(Case(ObstacleLane, OTHER_NOISE, seed=0, commands=5, noise=0.5, work_s=0.0))
@example(Case(ObstacleLane, COMES_NEAR, seed=0, commands=4, noise=0.0, work_s=0.0))
@example(Case(ObstacleLane, RESTS, seed=2, commands=2, noise=0.0, work_s=0.0))
@example(Case(ObstacleLane, OUT_OF_STEP, seed=2, commands=3, noise=0.0, work_s=0.0))
@given(seen_cases())
@pytest.mark.usefixtures("a_gpu", "kernels_pictures")
def test_cameras_see_the_same_in_all_simulators(case: Case) -> None:
    fly_everywhere(case)


@pytest.mark.slow
@settings(FIXTURES, max_examples=4)
@given(worlds())
@pytest.mark.usefixtures("a_gpu")
def test_clutter_is_the_same_for_cores_and_a_gpu(case: Case) -> None:
    fly_everywhere(case)


@pytest.mark.usefixtures("a_gpu", "kernels_pictures")
def test_depth_is_asked_for_once_wherever_it_is_flown() -> None:
    """On the wall clock of all three: of the lane's depths, whose mean is often below ten metres, and changes."""
    taken = {"request_us": {"call": [0.0, 0.0], "image": [1e6, 1e6]}, "reply_us": {"call": [0.0, 0.0]}}
    latency = {"quantiles": [0.0, 1.0], **taken, "issue_us": [0.0, 0.0], "timer_us": [0.0, 0.0]}
    keys: Keys = {
        **DEPTH,
        "timing": "virtual",
        "latency": latency,
        "max_commands": 3,
        "difficulty": {"first_row_m": 1.5},
    }
    case = Case(ObstacleLane, keys, 4, 5, 0.5, 0.0)
    check_flyable(ObstacleLane(**keys).task, LANES, CUDA)
    assert fly_everywhere(case)
    with closing(ObstacleLane(**keys)) as alone:
        alone.reset(seed=4)
        info = alone.step(2)[4]
    frames = 1 + ObstacleLane(**keys).task.frames_per_command
    assert info["phase_s"]["rendering"] == frames, "a second each"


def own_task_of_the_page() -> Any:
    """The task that docs/extending.md builds."""
    page = (Path(__file__).parents[1] / "docs/extending.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python title=\"beacon.py\"\n(.*?)```", page, re.DOTALL)
    assert code.count("\n") <= 60
    named: dict[str, Any] = {"__name__": "beacon"}
    exec(compile(code, "beacon.py", "exec", dont_inherit=True), named)
    return named["Beacon"]


@pytest.mark.usefixtures("a_gpu")
def test_the_task_of_the_page_is_the_same_in_all_simulators() -> None:
    keys: Keys = {"max_commands": 8, "t_move_s": 0.4}
    assert len(fly_everywhere(Case(own_task_of_the_page(), keys, 3, 25, 0.3, 0.0))) >= 4


def two_kinds(task: Any, action: Any) -> Any:
    """A velocity for the two actions of which a batch is made, and body rates for others."""
    return Post.task_class.goal(task, action) if np.shape(action)[1:] == (2,) else BodyRatesGoal(0.0, 0.0, 0.0, 0.5)


@pytest.mark.parametrize(
    ("name", "function", "said"),
    [
        (
            "advance",
            lambda _, before, now: {"low": True},
            "its course must have the items that sample gives it: post_m",
        ),
        (
            "advance",
            lambda _, before, now: {**now.course, "new": 1},
            "its course must have the items that sample gives",
        ),
        ("advance", lambda _, before, now: {**now.course, "turns": 0.5}, "is float64, and was sampled as int64"),
        ("advance", lambda _, before, now: {**now.course, "low": now.commands}, "is int64, and was sampled as bool"),
        ("reward", lambda _, before, now: float(now.position_m[0] > 0), "must compute with plain arithmetic"),
        ("reward", lambda _, before, now: 0.0 * now.commands + np.nan, "returned nan: must be a finite number"),
        ("failure", lambda _, now: now.touched or now.commands > 3, "must compute with plain arithmetic"),
        ("success", lambda _, now: not now.touched, "must compute with plain arithmetic"),
        ("info", lambda _, now: {"far": int(now.commands)}, "must compute with plain arithmetic"),
        ("features", lambda _, state, course: [[state.position_m[0] + np.nan]], "returned a number that is not finite"),
        ("goal", two_kinds, "all actions must ask for the same kind of goal"),
        ("goal", lambda _, action: VelocityGoal(tuple(action[:3] + np.inf)), "returned a number that is not finite"),
    ],
)
@pytest.mark.usefixtures("a_gpu")
def test_what_cannot_be_computed_over_arrays_is_named(name: str, function: Any, said: str) -> None:
    task: Any = type("Mine", (Post.task_class,), {name: function, "__module__": __name__})
    from uavaccel.envs.cuda_batch import CudaBatch

    wrong = rf"{re.escape(__file__)}: Mine\.{name}.*{re.escape(said)}"
    for made in (KernelBatch, CudaBatch)[: 1 if "finite" in said else 2]:  # a GPU waits for no look at its numbers
        with pytest.raises(UserError) as caught:
            fly_a_command(task, made)
        assert re.search(wrong, str(caught.value).replace("torch.", ""))
        assert th.get_default_dtype() == th.float32


def fly_a_command(task: Any, made: Any = KernelBatch) -> Any:
    with closing(made(environment_of(task), 3)) as batch:
        batch.reset(seed=0)
        return batch.step(np.full((3, 4), 0.5, np.float32))[0]


def test_features_may_be_an_array_of_frames_and_fields_nested() -> None:
    class Listed(PostTask):
        def features(self, state: Any, course: Any) -> Any:
            return [list(state.position_m), list(state.linear_velocity_m_s)]

    class Arrayed(Listed):
        def features(self, state: Any, course: Any) -> Any:
            return np.array(super().features(state, course))

    class OfFields(Listed):
        flat_state, fields, features = True, Listed.features, Task.features

    listed, arrayed, fields = (fly_a_command(task) for task in (Listed, Arrayed, OfFields))
    assert listed.shape == (3, 2, 3)
    np.testing.assert_array_equal([arrayed, fields], [listed] * 2)


@pytest.mark.parametrize(("first", "later"), [(0.5, 2), (2, 0.5)])
def test_a_later_game_may_have_whole_numbers_for_fractions_alone(first: Any, later: Any) -> None:
    drawn = [first]
    sample = lambda task, random, options: {**Post.task_class.sample(task, random, options), "kind": drawn[-1]}  # noqa: E731
    task: Any = type("Mine", (Post.task_class,), {"sample": sample, "__module__": __name__})
    refused = pytest.raises(UserError, match="numbers of the same kinds") if later == 0.5 else nullcontext()
    with closing(KernelBatch(environment_of(task), 3, threads=1, max_commands=1)) as batch, refused:
        batch.reset(seed=0)
        drawn.append(later)
        for _ in range(2):
            batch.step(np.zeros((3, 4), np.float32))
