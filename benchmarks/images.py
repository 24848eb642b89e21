"""Benchmarks of vision: frames per second, an image over the wire, DVS events of a frame. They need OpenGL."""

from __future__ import annotations

import os
from collections.abc import Iterator
from statistics import median

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.speed import Measurement, elapsed_s
from uavaccel.clock import MonotonicClock
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.sensors import EventCamera
from uavaccel.kinematics import VelocityGoal
from uavaccel.resources import asset
from uavaccel.sim.camera.camera import Camera
from uavaccel.sim.camera.gl import GlRenderer, describe_renderer
from uavaccel.sim.flight import of_velocity
from uavaccel.sim.lane import apply_layout, sample_layout
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
from uavaccel.suites.lane_path import plan_path
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs import PRESETS, init_state, make_sensor, step
from uavaccel.wire.session import WallSession

PLACES_M = range(0, 150, 10)  # along the lane, with many obstacles in view, and few
FRAMES_AT_EACH = 10


def frame_rates(rounds: int = 5) -> tuple[float, float, float, GlRenderer]:
    """Measure frames per second of `Camera.colour` and of a bare loop, and their ratio; return the renderer too.

    The bare loop is mjr_render and mjr_readPixels in the same GL context with the same settings; ours adds poses,
    scene, field of view and flipping the image. The two take turns, so that both are under the same load; rates are
    those of the best of `rounds` passes along the lane, the ratio is the median. Raises UserError without OpenGL.
    """
    model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    data = mujoco.MjData(model)
    apply_layout(model, data, sample_layout(seed=0))
    with Camera(model) as camera:
        bare_ns, ours_ns = np.array([_pass(camera, data) for _ in range(rounds)]).T
        frames_ns = len(PLACES_M) * FRAMES_AT_EACH * NS_PER_S
        ratio = float(np.median(bare_ns / ours_ns))
        return float(frames_ns / ours_ns.min()), float(frames_ns / bare_ns.min()), ratio, camera.renderer


def _pass(camera: Camera, data: mujoco.MjData) -> tuple[int, int]:
    """Return the wall time in ns of the bare loop and of ours, once along the lane."""
    clock, picture = MonotonicClock(), np.empty((camera.height, camera.width, 3), np.uint8)
    bare_ns = ours_ns = 0
    for north_m in PLACES_M:
        data.qpos[0] = north_m
        camera.colour(data)
        start_ns = clock.now_ns()
        for _ in range(FRAMES_AT_EACH):
            camera.render_again(picture)
        middle_ns = clock.now_ns()
        for _ in range(FRAMES_AT_EACH):
            camera.colour(data)
        bare_ns += middle_ns - start_ns
        ours_ns += clock.now_ns() - middle_ns
    return bare_ns, ours_ns


PICTURES = 300
LANE = 0
T_SAMPLE_S = 0.33
AHEAD = 2
EVENT_CAMERA_HZ = (None, 100.0, 500.0)  # None: as many as there are samples
COMMANDS = 5  # of 1 s each


def bench_camera() -> Iterator[Measurement]:
    """Measure frames of the lane against a bare loop of MuJoCo's two calls, in one process."""
    ours, bare, ratio, renderer = frame_rates()
    note = f"{renderer.name}, LP_NUM_THREADS={os.environ.get('LP_NUM_THREADS')}"
    yield Measurement("frames of 256x144", ours, "frames/s", bare, note)
    yield Measurement("frames over the bare loop", ratio, "", note="aim 0.9")


def bench_image() -> Iterator[Measurement]:
    """Measure a gray image requested over the wire against bare rendering."""
    with WallSession("lane", "native") as session:
        client = session.start_game(1.0, np.random.SeedSequence(0), lane=LANE)
        client.image("gray")
        wire_s = median(elapsed_s(lambda: client.image("gray")) for _ in range(PICTURES))
    world = World("lane", NATIVE)
    world.set_lane(sample_layout(LANE))
    camera, out = world.camera(256, 144), np.empty((144, 256, 3), np.uint8)
    camera.colour(world.data)
    bare_s = median(elapsed_s(lambda: camera.render_again(out)) for _ in range(PICTURES))
    world.close()
    yield Measurement("picture over the wire", wire_s * 1e3, "ms", bare_s * 1e3, "bound: the bare render")
    yield Measurement("what the wire adds", (wire_s - bare_s) * 1e3, "ms", 0.8, "bound: the aim")


def bench_dvs() -> Iterator[Measurement]:
    """Measure the DVS on the frames of a flight through the lane, on one core."""
    frames = lane_frames()
    sensor = make_sensor(PRESETS["clean"], (144, 256), 0)
    state = init_state(sensor, frames[0])
    clock, took = MonotonicClock(), []
    for index, frame in enumerate(frames[1:], start=1):
        start_ns = clock.now_ns()
        state, _, _ = step(sensor, state, frame, index * T_SAMPLE_S)
        took.append((clock.now_ns() - start_ns) / NS_PER_S)
    note = f"median of {len(took)} frames of a planned flight; bound: the aim"
    yield Measurement("DVS, per frame", median(took) * 1e3, "ms", 0.6, note)


def bench_event_camera() -> Iterator[Measurement]:
    """Measure a simulated second with an event camera that receives the samples alone, and with faster ones."""
    renderer = describe_renderer().name
    for rate_hz in EVENT_CAMERA_HZ:
        environment = ObstacleLane(dvs_rate_hz=rate_hz)
        environment.reset(seed=0, options={"lane": LANE})
        environment.step(AHEAD)
        before = count_frames(environment)
        took = [elapsed_s(lambda: environment.step(AHEAD)) for _ in range(COMMANDS)]  # noqa: B023  called at once
        per_s = (count_frames(environment) - before) / COMMANDS
        environment.close()
        wall_ms = median(took) * 1e3
        name = "at the samples" if rate_hz is None else f"at {rate_hz:g} Hz"
        note = f"{per_s:g} pictures, {wall_ms / per_s:.2f} ms each, flight included; {renderer}"
        yield Measurement(f"event camera {name}", wall_ms, "ms/simulated s", note=note)


def count_frames(environment: ObstacleLane) -> int:
    """Return how many frames an environment's event camera has received."""
    assert isinstance(environment.sensor, EventCamera)
    return environment.sensor.counter.frames


def lane_frames() -> list[NDArray[np.uint8]]:
    """Return gray frames of a planned flight through a lane, one every .33 s."""
    world = World("lane", NATIVE)
    layout = sample_layout(LANE)
    world.set_lane(layout)
    world.reset()
    camera = world.camera(256, 144)
    frames = [camera.gray(world.data)]
    for north, east in plan_path(layout):
        world.lead.set_goal(of_velocity(VelocityGoal((north, east, 0.0), height_m=-10.0)))
        for slice_ticks in (165, 165, 170):
            world.advance(slice_ticks)
            frames.append(camera.gray(world.data))
    world.close()
    return frames
