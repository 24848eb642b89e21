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
from tests import test_kernel_looks as looks
from tests import test_still_scenes as still
from tests.host_kernels import stand_in
from tests.test_kernels_compile import FLOWN
from uavaccel.envs.navigate import Navigate
from uavaccel.kernels.appearance import empty_scenes, fill_scenes, read_appearance
from uavaccel.kernels.fields import Appearance
from uavaccel.kernels.pictures import render_lanes
from uavaccel.metrics.stlc import stlc_matrix
from uavaccel.metrics.trajectory import trajectory
from uavaccel.resources import asset
from uavaccel.sim.camera import pixels
from uavaccel.sim.lane import layout_from
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
from uavaccel.vision import dvs
from uavaccel.vision.dvs_kernels import block_sums

# Of single precision, and of double for a low-pass filter.
CAMERAS: tuple[dict[str, Any], ...] = {"dvs_preset": "clean"}, {"dvs_preset": "noisy"}
STATE = {"observation": "state", "mediation": {"gap_s": 0.1, "start_speed": 0.5}}
CASES = [*FLOWN, (Navigate, {"observation": "depth", "timing": "virtual"}), (Navigate, STATE)]


def main() -> None:
    for task, camera in product(("lane", "navigate"), CAMERAS):
        fly_a_command(uavaccel.make_vec(task, 1, simulator="kernels", observation="dvs", max_commands=1, **camera))
    fly_alone()
    render()
    count_events()
    make_smaller()
    compile_tests()
    with pytest.MonkeyPatch.context() as patch:
        stand_in(patch)
        of_a_gpu = import_module("uavaccel.envs.cuda_batch").CudaBatch
        for kind, keys in CASES:
            fly_a_command(of_a_gpu(kind, 1, max_commands=1, **keys))


def fly_alone() -> None:
    """The exact simulator, between whose checks for contact it flies free, and how close two flights are."""
    with closing(World("blocks", NATIVE)) as world:
        world.reset()
        world.advance(2)
    flights = [trajectory([0.0, 1.0], np.zeros((2, 3)))]
    stlc_matrix(flights, flights)


def render() -> None:
    """A picture of each kind."""
    appearance = lane_appearance()
    scenes, pose = empty_scenes(1), (np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))
    fill_scenes(appearance, scenes, [0], [layout_from({"obstacles": []}, "test")])
    for kind in ("gray", "colour", "depth"):
        render_lanes(kind, appearance, scenes, np.zeros(1, np.int32), *pose)


def lane_appearance() -> Appearance:
    return read_appearance(mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml"))))


def count_events() -> None:
    """By each preset of the exact simulator's event camera."""
    frames = np.zeros((2, 144, 256), np.uint8)
    frames[1] = 255
    for preset in dvs.PRESETS.values():
        sensor = dvs.make_sensor(preset, frames[0].shape, seed=0)
        dvs.step_with_events(sensor, dvs.init_state(sensor, frames[0]), frames[1], 0.01)
    block_sums(*np.zeros((2, 4, 4), np.int32))


def make_smaller() -> None:
    """Pictures as OpenGL draws them."""
    drawn = np.zeros((4, 4, 4), np.uint8)
    luma = pixels.luma(drawn)
    luma.setflags(write=False)
    pixels.means(luma)
    for picture in (pixels.turned_colours(drawn), np.zeros((4, 4), np.float32)):
        pixels.quartered(picture)


def compile_tests() -> None:
    """What tests compile for themselves, of parts that are typed by now."""
    looks.test_columns_and_quads_are_the_picture_of_faces_that_tiles_touch(lane_appearance(), 1)
    looks.test_quads_without_noise_see_what_pixels_see(0.0, 0.2)
    still.test_rays_meet_what_mujocos_rays_meet("sphere")
    still.test_a_picture_sees_only_what_its_tiles_have()
    still.test_no_hill_is_nearer_than_the_bound()
    still.test_a_thin_plate_is_touched_where_mujoco_finds_it_touched()


def fly_a_command(batch: Any) -> None:
    with closing(batch):
        batch.reset(seed=0)
        batch.step(batch.action_space.sample())


if __name__ == "__main__":
    main()
