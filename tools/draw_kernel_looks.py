"""Draw pictures of drawn lanes by OpenGL and by `uavaccel.kernels`, their difference, and count how far they are apart.

    python tools/draw_kernel_looks.py docs/figures/kernels_looks.png

Prints the table of docs/kernels.md.
"""

import argparse
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from uavaccel.draw import style
from uavaccel.kernels.appearance import empty_scenes, fill_scenes, read_appearance
from uavaccel.kernels.pictures import render_lanes
from uavaccel.resources import asset
from uavaccel.sim.camera.camera import Camera
from uavaccel.sim.lane import Difficulty, apply_layout, lane_seed, sample_layout
from uavaccel.sim.poses import Pose
from uavaccel.suites import plots
from uavaccel.units import ned_to_mujoco, quaternion_ned_to_mujoco

SHOWN, GAIN = 2, 16
KINDS: tuple[Any, ...] = ("gray", "colour", "depth")
CONDITIONS = {  # altitude in metres, tilt and yaw in degrees, cylinders
    "2 m, tilted up to 15 degrees": ((1.5, 2.5), 15.0, 8.0, False),
    "the same, cylinders": ((1.5, 2.5), 15.0, 8.0, True),
    "0.8 to 25 m, tilted up to 40 degrees, all round": ((0.8, 25.0), 40.0, 180.0, False),
}


def attitude(rng: np.random.Generator, tilt: float, yaw: float) -> np.ndarray:
    """A quaternion wxyz of angles up to these, degrees."""
    halves = np.radians(rng.uniform(-1, 1, 3) * (tilt, tilt, yaw)) / 2
    roll, pitch, heading = [
        (float(np.cos(a)), *(float(np.sin(a)) * axis)) for a, axis in zip(halves, np.eye(3), strict=True)
    ]
    turned = Pose(orientation_wxyz=heading).of(Pose(orientation_wxyz=pitch)).of(Pose(orientation_wxyz=roll))
    return np.array(turned.orientation_wxyz)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="PNG to write")
    parser.add_argument("--views", type=int, default=200, help="of each condition")
    options = parser.parse_args()
    model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    data, appearance, shown = mujoco.MjData(model), read_appearance(model), list[np.ndarray]()
    lanes = np.arange(options.views, dtype=np.int32)
    with Camera(model) as camera:
        for name, ((low, high), tilt, yaw, round_ones) in CONDITIONS.items():
            rng = np.random.default_rng(18)
            layouts = [sample_layout(lane_seed("evaluation", lane), Difficulty(light=(0.1, 1.0))) for lane in lanes]
            for layout in layouts:
                layout.round[:] = round_ones
            places = rng.uniform((-2, -4.5, -high), (155, 4.5, -low), (options.views, 3))
            quaternions = np.array([attitude(rng, tilt, yaw) for _ in lanes])
            scenes = empty_scenes(options.views)
            fill_scenes(appearance, scenes, lanes.tolist(), layouts)
            drawn = [render_lanes(kind, appearance, scenes, lanes, places, quaternions) for kind in KINDS]
            theirs: list[list[np.ndarray]] = [[], [], []]
            for layout, place, quaternion in zip(layouts, places, quaternions, strict=True):
                apply_layout(model, data, layout)
                data.qpos[:3], data.qpos[3:7] = ned_to_mujoco(place), quaternion_ned_to_mujoco(quaternion)
                for kept, kind in zip(theirs, KINDS, strict=True):
                    kept.append(getattr(camera, kind)(data))
            gray, colour = (np.abs(np.array(theirs[number]).astype(int) - drawn[number]) for number in (0, 1))
            depth = np.abs(drawn[2] / np.array(theirs[2]) - 1)
            print(
                f"| {name} | {gray.mean():.4f} | {100 * (gray > 0).mean():.4f} % | {100 * (gray > 10).mean():.4f} % "
                f"| {colour.mean():.4f} | {100 * (depth > 1e-3).mean():.4f} % |"
            )
            for view in range(SHOWN):
                shown += [theirs[1][view], drawn[1][view], np.minimum(GAIN * colour[view], 255)]
    with style.project_style():
        order = f"from the left: OpenGL, the kernels, {GAIN} times their difference"
        figure, grid = plots.panels(len(shown), "Drawn lanes by OpenGL and by the kernels", 1.25, source=order)
        for axes, image in zip(grid, shown, strict=True):
            axes.imshow(image)
            axes.set(xticks=[], yticks=[])
        for name, axes in zip(CONDITIONS, grid[:: 3 * SHOWN], strict=True):
            axes.set_title(name)
        style.save(figure, options.picture)


if __name__ == "__main__":
    main()
