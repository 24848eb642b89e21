"""How many frames per second the camera takes in the lane, beside a bare loop of MuJoCo's own two calls."""

from __future__ import annotations

import os
from typing import TypedDict

import mujoco
import numpy as np

from uavaccel.clock import MonotonicClock
from uavaccel.resources import asset
from uavaccel.sim.camera.camera import Camera
from uavaccel.sim.lane.layout import draw_layout
from uavaccel.sim.lane.scene import apply_layout
from uavaccel.units import NS_PER_S

PLACES_M = range(0, 150, 10)  # along the lane: many obstacles in view, and few
FRAMES_AT_EACH = 10


class FrameRates(TypedDict):
    """Of `Camera.colour` and of a bare loop, and who draws."""

    frames_per_s: float
    bare_frames_per_s: float
    ratio_to_bare: float
    width: int
    height: int
    gl_backend: str
    gl_renderer: str
    gl_software: bool
    lp_num_threads: str | None


def frame_rates(rounds: int = 5) -> FrameRates:
    """Frames per second of `Camera.colour` and of a bare loop, the best of `rounds` passes along the lane.

    The bare loop is mjr_render and mjr_readPixels in the same GL context with the same settings; what ours adds is
    poses, scene, field of view and turning the picture over. The two take turns, so that both meet the same load.
    Raises UserError where there is no OpenGL.
    """
    model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    data = mujoco.MjData(model)
    apply_layout(model, data, draw_layout(seed=0))
    with Camera(model) as camera:
        passes = np.array([_pass(camera, data) for _ in range(rounds)])
        frames = len(PLACES_M) * FRAMES_AT_EACH
        bare, ours = (float(frames * NS_PER_S / passes[:, column].min()) for column in (0, 1))
        return {
            "frames_per_s": ours,
            "bare_frames_per_s": bare,
            "ratio_to_bare": float(np.median(passes[:, 0] / passes[:, 1])),
            "width": camera.width,
            "height": camera.height,
            "gl_backend": camera.renderer.backend,
            "gl_renderer": camera.renderer.name,
            "gl_software": camera.renderer.software,
            "lp_num_threads": os.environ.get("LP_NUM_THREADS"),
        }


def _pass(camera: Camera, data: mujoco.MjData) -> tuple[int, int]:
    """Wall time in ns of the bare loop and of ours, once along the lane."""
    clock, picture = MonotonicClock(), np.empty((camera.height, camera.width, 3), np.uint8)
    bare_ns = ours_ns = 0
    for north_m in PLACES_M:
        data.qpos[0] = north_m
        camera.colour(data, picture)
        start_ns = clock.now_ns()
        for _ in range(FRAMES_AT_EACH):
            camera.render_again(picture)
        middle_ns = clock.now_ns()
        for _ in range(FRAMES_AT_EACH):
            camera.colour(data, picture)
        bare_ns += middle_ns - start_ns
        ours_ns += clock.now_ns() - middle_ns
    return bare_ns, ours_ns
