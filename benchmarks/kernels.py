"""Benchmarks of the kernels, part by part: ticks, images and whole commands, each beside its bound.

On the CPU the parts are measured in one thread, then commands in all threads; the bound of a command is the sum of its
parts. On a GPU lanes fly through `CudaLanes`, recorded as in a training, and CUDA events time them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from statistics import median
from typing import NamedTuple

import numpy as np

from benchmarks.speed import Measurement, elapsed_s
from uavaccel.envs.flyable import CUDA
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.kernel_games import GameMaker
from uavaccel.envs.kernel_plan import plan_of
from uavaccel.envs.navigate import NavigateTask
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.simulators import KERNELS, check_simulator
from uavaccel.envs.task import Task
from uavaccel.kernels import cpu, events, timeline
from uavaccel.kernels import lanes as rows
from uavaccel.kernels.fields import COLUMNS, DVS, ROWS, STATE
from uavaccel.kernels.spans import make_scratch
from uavaccel.machine import usable_cores
from uavaccel.sim.clutter.layout import Clutter
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
from uavaccel.vision.dvs_sensor import sample_pixels

REPEATS = 5
TICKS = 50_000
PICTURES = 100
CLUTTER_LANES, CLUTTER_SHAPES = 1024, 400
CPU_LANES, GPU_LANES = (64,), (512, 4096)
COMMANDS, GPU_COMMANDS = 4, 20
AHEAD = 2
NONE_SEEN = {"observation": "state", "t_sample_s": 1.0}
MANY_PICTURES = {"t_move_s": 0.1, "t_sample_s": 0.002}  # 50 images per command: next to no flight


def bench_kernels() -> Iterator[Measurement]:
    """Measure the CPU, then a GPU. Raises UserError where there is none."""
    yield from bench_on_cores()
    check_simulator(KERNELS, CUDA)
    yield from bench_on_gpu()


# --- CPU ----------------------------------------------------------------------------------------------------------


class Bare(NamedTuple):
    """The arrays of one lane, without an environment around them."""

    games: rows.Games
    now: rows.Flights
    view: cpu.View
    plan: timeline.Command
    clocks: timeline.Clocks


def one_lane(task: LaneTask) -> Bare:
    """Return a lane at the start of its first game."""
    maker = GameMaker(task)
    games, now = maker.rows(1), rows.flights(1)
    maker.write(maker.sample(np.random.default_rng(0), 0), games, 0)
    kind = DVS if task.observation == "dvs" else STATE
    sensor = events.sensor_of(sample_pixels(task.dvs_parameters, (ROWS, COLUMNS), task.dvs_seed))
    pixels = events.pixels_of(int(kind == DVS), task.dvs_parameters)
    view, plan = (
        cpu.View(kind, (ROWS, COLUMNS), maker.looks, sensor, pixels),
        plan_of(task, maker.surroundings.hull, np.zeros(3, np.int64), kind != STATE),
    )
    first = np.arange(1)
    cpu.CPU.observe_starts(games, first)
    clocks = timeline.clocks(1, task.frames_per_command)
    cpu.CPU.begin(first, first, view, games, now, plan, clocks)
    return Bare(games, now, view, plan, clocks)


def bench_on_cores() -> Iterator[Measurement]:
    """Measure ticks and images in one thread, and commands in all threads."""
    ticks_per_s = 1.0 / median(_tick_s() for _ in range(REPEATS))
    exact = World("lane", NATIVE)
    exact_per_s = TICKS / elapsed_s(lambda: exact.advance(TICKS))
    exact.close()
    note = "hovering, clearance looked after; beside it the exact simulator's, with mj_step"
    yield Measurement("kernels: flight, one thread", ticks_per_s, "ticks/s", exact_per_s, note)
    gray_s, dvs_s = _picture_s()
    yield Measurement("kernels: picture, one thread", 1 / gray_s, "frames/s", note="gray, 256 x 144")
    yield Measurement("kernels: DVS, one thread", 1 / dvs_s, "frames/s", note="clean, the picture given")
    both_s = median(_seen_s() for _ in range(REPEATS))
    note = "bound: picture and DVS one after the other"
    yield Measurement("kernels: picture and DVS", 1 / both_s, "frames/s", 1 / (gray_s + dvs_s), note)
    task, threads = LaneTask(), usable_cores()
    ticks = int(plan_of(task, np.zeros(3), np.zeros(3, np.int64), True).slices.sum())
    parts_s = ticks / ticks_per_s + task.frames_per_command * both_s
    for lanes in CPU_LANES:
        per_s = lanes * COMMANDS / _commands_s(lanes)
        note = f"{threads} threads; bound: {ticks} ticks and {task.frames_per_command} frames each"
        yield Measurement(f"kernels: commands, {lanes} lanes", per_s, "commands/s", threads / parts_s, note)


def _tick_s() -> float:
    bare = one_lane(LaneTask(**NONE_SEEN))

    def fly(ticks: int) -> None:
        rows.fly(0, ticks, bare.games, bare.now, bare.plan.hull)

    fly(1)  # compiled
    return elapsed_s(lambda: fly(TICKS)) / TICKS


def _seen_s() -> float:
    """Return the seconds of rendering a frame and of its events."""
    bare, scratch, picture = one_lane(LaneTask()), make_scratch(), np.empty((ROWS, COLUMNS), np.uint8)

    def look(number: int) -> None:
        cpu.observe_events(0, bare.view, bare.games, bare.now, bare.plan, scratch, picture)

    look(0)  # compiled
    return _each_s(look)


def _picture_s() -> tuple[float, float]:
    """Return the seconds of rendering a gray image, and of the events of a given one."""
    bare, scratch, picture = one_lane(LaneTask()), make_scratch(), np.empty((ROWS, COLUMNS), np.uint8)
    camera = bare.games.cameras[0]

    def sample(number: int) -> None:
        cpu.render_gray(0, bare.view.looks, bare.games, bare.now, bare.plan.tick_ns, scratch, picture)

    def see(number: int) -> None:
        cpu.see(0, picture, 0.002 * number, bare.view.pixels, bare.view.sensor, camera, 0)

    sample(0)  # compiled
    see(0)
    return _each_s(sample), _each_s(see)


def _each_s(work: Callable[[int], None]) -> float:
    return median(elapsed_s(partial(work, number)) for number in range(1, PICTURES + 1))


def _commands_s(lanes: int) -> float:
    """Return the seconds of COMMANDS commands of each lane, with ends and starts of games."""
    with closing(KernelBatch(ObstacleLane, lanes, autoreset_mode="SameStep")) as batch:
        batch.reset(seed=0)
        actions = np.full(lanes, AHEAD)

        def fly() -> None:
            for _ in range(COMMANDS):
                batch.step_async(actions)
                batch.step_wait()

        fly()
        return elapsed_s(fly)


# --- GPU ----------------------------------------------------------------------------------------------------------


def bench_on_gpu() -> Iterator[Measurement]:
    """Measure ticks, images and commands of many lanes at once."""
    import torch as th

    device, task = th.cuda.get_device_name(), LaneTask()
    chain_s = _round_s(1, LaneTask(**NONE_SEEN))
    for lanes in GPU_LANES:
        ticks = int(plan_of(task, np.zeros(3), np.zeros(3, np.int64), True).slices.sum())
        flight_s = _round_s(lanes, LaneTask(**NONE_SEEN))
        per_s, bound = lanes * ticks / flight_s, lanes * ticks / chain_s
        note = f"{device}; bound: the chain of one lane's {ticks} ticks, {chain_s * 1e3:.2f} ms, judged too"
        yield Measurement(f"GPU: flight, {lanes} lanes", per_s, "ticks/s", bound, note)
        colour_s, dvs_s = (
            _round_s(lanes, LaneTask(**MANY_PICTURES, observation=what)) / 50 for what in ("colour", "dvs")
        )
        note, name = ("bound: pictures in colour, which no event camera sees", f"GPU: picture and DVS, {lanes} lanes")
        yield Measurement(name, lanes / dvs_s, "frames/s", lanes / colour_s, note)
        command_s = _round_s(lanes, task)
        yield Measurement(f"GPU: a command of {lanes} lanes", command_s * 1e3, "ms")
        parts_s = flight_s + task.frames_per_command * dvs_s
        note, name = ("without learning, first metres of games; bound: its parts", f"GPU: commands, {lanes} lanes")
        yield Measurement(name, lanes / command_s, "commands/s", lanes / parts_s, note)

    yield from _bench_rays()


def _bench_rays() -> Iterator[Measurement]:
    """Measure pictures of 256 x 144 in clutter, another world for each lane."""
    clutter = Clutter.model_construct(**{**dict(Clutter()), "shapes": CLUTTER_SHAPES})
    for what in ("depth", "dvs"):
        task = NavigateTask(**MANY_PICTURES, observation=what, picture_size=(COLUMNS, ROWS))
        frame_s = _round_s(CLUTTER_LANES, task.model_copy(update={"clutter": clutter})) / 50
        name = f"GPU: rays, {what}, {CLUTTER_LANES} worlds of {CLUTTER_SHAPES} shapes"
        yield Measurement(name, CLUTTER_LANES / frame_s, "frames/s", note="with the flight in between")


def _round_s(lanes: int, task: Task) -> float:
    """Return the seconds of a command of all lanes by CUDA events; no game ends within the measurement."""
    import torch as th

    from uavaccel.envs.cuda_lanes import CudaLanes
    from uavaccel.kernels.recording import EAGER

    flying = CudaLanes(task, lanes, th.device(CUDA), renews=False)
    flying.seed(range(lanes))
    flying.begin()
    shape = task.action_space().shape or ()
    actions = th.full((lanes, *shape), 0.1 if shape else AHEAD, device=CUDA)
    fly = flying.recorded_flight()
    for _ in range(EAGER + 1):  # compiles and records
        fly(actions)
    begun, ended = (th.cuda.Event(enable_timing=True) for _ in range(2))
    rounds = GPU_COMMANDS if task.t_move_s < 1.0 else COMMANDS  # before a lane can touch something
    begun.record()
    for _ in range(rounds):
        fly(actions)
    ended.record()
    th.cuda.synchronize()
    return float(begun.elapsed_time(ended)) / 1e3 / rounds
