"""Benchmarks of the kernels, part by part: ticks, images and whole commands, each beside its bound.

A command's parts are its flight, as lanes without sight fly it, and its frames, each adding what one of many adds
in a short command. The CPU does one after the other, a GPU both at once: their sum or their maximum is the bound. On a
GPU lanes fly through `CudaLanes`, recorded as in a training, and CUDA events time them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from benchmarks.speed import Measurement, elapsed_s
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.kernel_games import GameMaker, plan_of, slices_of
from uavaccel.envs.navigate import NavigateTask
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.simulators import CUDA, KERNELS, check_simulator
from uavaccel.envs.task import Task
from uavaccel.kernels import cpu, events, timeline
from uavaccel.kernels import lanes as rows
from uavaccel.kernels.fields import COLUMNS, DVS, ROWS, STATE
from uavaccel.kernels.pictures import make_scratch
from uavaccel.machine import usable_cores
from uavaccel.sim.clutter import Clutter
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.vehicle.quadrotor import KINEMATICS
from uavaccel.sim.world import World
from uavaccel.vision.dvs_sensor import sample_pixels

REPEATS = 5
TICKS = 50_000
PICTURES = 100
CLUTTER_LANES, CLUTTER_SHAPES = 1024, 400
CPU_LANES, GPU_LANES = (64,), (512, 4096)
COMMANDS, GPU_COMMANDS = 4, 20
AHEAD = 2
NONE_SEEN: dict[str, Any] = {"observation": "state"}
MANY = 50  # frames of a command with next to no flight
MANY_PICTURES: dict[str, Any] = {"t_move_s": 0.1, "t_sample_s": 0.1 / MANY}


def bench_kernels() -> Iterator[Measurement]:
    """Measure the CPU, then a GPU. Raises UserError where there is none."""
    yield from bench_on_cores()
    check_simulator(KERNELS, CUDA)
    yield from bench_on_gpu()


# --- CPU ----------------------------------------------------------------------------------------------------------


def one_lane(task: LaneTask) -> cpu.Work:
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
    work = cpu.Work(
        view,
        games,
        now,
        plan,
        timeline.clocks(1, task.frames_per_command),
        make_scratch(),
        np.empty((ROWS, COLUMNS), np.uint8),
    )
    cpu.run_lanes(
        cpu.BEGIN, first, np.zeros((1, 4)), *work[:5], np.empty((1, 1, 1, 0, 0), np.uint8), np.zeros((1, 1, KINEMATICS))
    )
    return work


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
    yield Measurement(
        "kernels: picture and DVS", 1 / both_s, "frames/s", 1 / gray_s, "bound: the picture without events"
    )
    threads = usable_cores()
    for lanes in CPU_LANES:
        command_s, flight_s, frames_s = _parts_s(_commands_s, lanes)
        note = f"{threads} threads; bound: flight, then frames, as in other commands of as many lanes"
        bound = lanes / (flight_s + frames_s)
        yield Measurement(f"kernels: commands, {lanes} lanes", lanes / command_s, "commands/s", bound, note)


def _parts_s(round_s: Callable[..., float], lanes: int) -> tuple[float, float, float]:
    """Return the seconds of a command of all lanes, of its flight, and of its frames.

    `round_s` returns the seconds of a command for a number of lanes and the task's keys.
    """
    many_s = round_s(lanes, **MANY_PICTURES) - round_s(lanes, **MANY_PICTURES, **NONE_SEEN)
    return round_s(lanes), round_s(lanes, **NONE_SEEN), LaneTask().frames_per_command * many_s / MANY


def _tick_s() -> float:
    bare = one_lane(LaneTask(**NONE_SEEN))

    def fly(ticks: int) -> None:
        rows.fly(0, ticks, bare.games, bare.now, bare.plan.hull)

    fly(1)  # compiled
    return elapsed_s(lambda: fly(TICKS)) / TICKS


def _seen_s() -> float:
    """Return the seconds of rendering a frame and of its events."""
    bare = one_lane(LaneTask())

    def look(number: int) -> None:
        cpu.observe_events(0, bare)

    look(0)  # compiled
    return _each_s(look)


def _picture_s() -> tuple[float, float]:
    """Return the seconds of rendering a gray image, and of the events of a given one."""
    bare = one_lane(LaneTask())
    scratch, picture = bare.scratch, bare.picture
    camera = bare.games.cameras[0]

    def sample(number: int) -> None:
        cpu.render_gray(0, bare.cameras.looks, bare.games, bare.now, bare.plan.tick_ns, scratch, picture)

    def see(number: int) -> None:
        cpu.see(0, picture, 0.002 * number, bare.cameras.pixels, bare.cameras.sensor, camera, 0)

    sample(0)  # compiled
    see(0)
    return _each_s(sample), _each_s(see)


def _each_s(work: Callable[[int], None]) -> float:
    return median(elapsed_s(partial(work, number)) for number in range(1, PICTURES + 1))


def _commands_s(lanes: int, **keys: Any) -> float:
    """Return the seconds of a command of all lanes, the median of COMMANDS, the first of their games."""
    with closing(KernelBatch(ObstacleLane, lanes, **keys)) as batch:
        batch.reset(seed=0)
        actions = np.full(lanes, AHEAD)

        def fly() -> None:
            batch.step_async(actions)
            batch.step_wait()

        fly()
        return median(elapsed_s(fly) for _ in range(COMMANDS))


# --- GPU ----------------------------------------------------------------------------------------------------------


def bench_on_gpu() -> Iterator[Measurement]:
    """Measure ticks, images and commands of many lanes at once."""
    import torch as th

    device = th.cuda.get_device_name()
    ticks = int(slices_of(LaneTask())[0].sum())
    chain_s = _round_s(1, **NONE_SEEN)
    for lanes in GPU_LANES:
        command_s, flight_s, frames_s = _parts_s(_round_s, lanes)
        note = f"{device}; bound: the chain of one lane's {ticks} ticks, {chain_s * 1e3:.2f} ms, judged too"
        yield Measurement(
            f"GPU: flight, {lanes} lanes", lanes * ticks / flight_s, "ticks/s", lanes * ticks / chain_s, note
        )
        colour_s, dvs_s = (_round_s(lanes, **MANY_PICTURES, observation=what) / MANY for what in ("colour", "dvs"))
        note, name = "bound: pictures in colour, which no event camera sees", f"GPU: picture and DVS, {lanes} lanes"
        yield Measurement(name, lanes / dvs_s, "frames/s", lanes / colour_s, note)
        yield Measurement(f"GPU: a command of {lanes} lanes", command_s * 1e3, "ms")
        note = "without learning, first metres of games; bound: the longer of flight and frames, which pass at once"
        name, bound = f"GPU: commands, {lanes} lanes", lanes / max(flight_s, frames_s)
        yield Measurement(name, lanes / command_s, "commands/s", bound, note)

    yield from _bench_rays()


def _bench_rays() -> Iterator[Measurement]:
    """Measure pictures of 256 x 144 in clutter, another world for each lane."""
    clutter = Clutter.model_construct(**{**dict(Clutter()), "shapes": CLUTTER_SHAPES})
    for what in ("depth", "dvs"):
        task = NavigateTask(**MANY_PICTURES, observation=what, picture_size=(COLUMNS, ROWS))
        frame_s = _round_s(CLUTTER_LANES, task.model_copy(update={"clutter": clutter})) / MANY
        name = f"GPU: rays, {what}, {CLUTTER_LANES} worlds of {CLUTTER_SHAPES} shapes"
        yield Measurement(name, CLUTTER_LANES / frame_s, "frames/s", note="with the flight in between")


def _round_s(lanes: int, task: Task | None = None, **keys: Any) -> float:
    """Return the seconds of a command of all lanes by CUDA events; no game ends within the measurement.

    They fly the task, by default the obstacle lane with these keys.
    """
    import torch as th

    from uavaccel.envs.cuda_lanes import CudaLanes
    from uavaccel.kernels.recording import EAGER

    task = task or LaneTask(**keys)
    flying = CudaLanes(task, lanes, th.device(CUDA), renews=False)
    flying.games.seed(range(lanes))
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
