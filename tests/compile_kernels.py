"""Compile the kernels that tests load: `python -m tests.compile_kernels`.

First the CPU's, for every kind of scene and camera, which otherwise whoever first flies in them does, and then what
stands in for a GPU's. In one process, which keeps their parts: a process for each would compile most of these twice.
"""

from __future__ import annotations

from contextlib import closing
from importlib import import_module
from itertools import product
from typing import Any

import mujoco
import numpy as np
import pytest

import uavaccel
from tests.host_kernels import stand_in
from tests.test_kernels_compile import FLOWN
from uavaccel.envs.navigate import Navigate
from uavaccel.kernels.appearance import empty_scenes, fill_scenes, read_appearance
from uavaccel.kernels.pictures import render_lanes
from uavaccel.resources import asset
from uavaccel.sim.lane import layout_from
from uavaccel.vision import dvs

# Of single precision, and of double for a low-pass filter.
CAMERAS: tuple[dict[str, Any], ...] = {"dvs_preset": "clean"}, {"dvs_preset": "noisy"}
STATE = {"observation": "state", "mediation": {"gap_s": 0.1, "start_speed": 0.5}}
CASES = [*FLOWN, (Navigate, {"observation": "depth", "timing": "virtual"}), (Navigate, STATE)]


def main() -> None:
    for task, camera in product(("lane", "navigate"), CAMERAS):
        fly_a_command(uavaccel.make_vec(task, 1, simulator="kernels", observation="dvs", max_commands=1, **camera))
    render()
    count_events()
    with pytest.MonkeyPatch.context() as patch:
        stand_in(patch)
        of_a_gpu = import_module("uavaccel.envs.cuda_batch").CudaBatch
        for kind, keys in CASES:
            fly_a_command(of_a_gpu(kind, 1, max_commands=1, **keys))


def render() -> None:
    """A picture of each kind."""
    appearance = read_appearance(mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml"))))
    scenes, pose = empty_scenes(1), (np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))
    fill_scenes(appearance, scenes, [0], [layout_from({"obstacles": []}, "test")])
    for kind in ("gray", "colour", "depth"):
        render_lanes(kind, appearance, scenes, np.zeros(1, np.int32), *pose)


def count_events() -> None:
    """By each preset of the exact simulator's event camera."""
    frames = np.zeros((2, 144, 256), np.uint8)
    for preset in dvs.PRESETS.values():
        sensor = dvs.make_sensor(preset, frames[0].shape, seed=0)
        dvs.step_with_events(sensor, dvs.init_state(sensor, frames[0]), frames[1], 0.01)


def fly_a_command(batch: Any) -> None:
    with closing(batch):
        batch.reset(seed=0)
        batch.step(batch.action_space.sample())


if __name__ == "__main__":
    main()
