"""A chase view: a flight through a scene, rendered afterwards from behind and above its poses.

It is drawn for the eye, and nothing flies in it: in full daylight whatever a lane's light, antialiased, with the
shadows that the sun throws on the ground, and with a drone that stands out from walls and ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.camera import Lens, MountedCamera
from uavaccel.sim.clutter import ClutterLayout, apply_clutter
from uavaccel.sim.lane import OBSTACLE_HALF_HEIGHT_M, LaneLayout, apply_layout, sunlight
from uavaccel.sim.poses import Pose, from_degrees
from uavaccel.sim.scene import DRONE_GROUP, PLAIN, QUADROTOR, scene_path
from uavaccel.units import euler_from_quaternion, ned_to_mujoco, quaternion_ned_to_mujoco

EYE = Pose((-2.4, 0.0, -1.15), from_degrees(0.0, -20.0, 0.0))  # relative to the vehicle's position and heading
FOV_DEG = 85.0
FINER = 1.25  # supersampling factor: in software MuJoCo's antialiasing takes twice as long

ROTORS_M, ROTOR_RADIUS_M = tuple(product((0.16087, -0.16087), repeat=2)), 0.1143  # quadrotor.xml's
SHELL, ARMS, DARK = (0.93, 0.94, 0.96, 1.0), (0.75, 0.77, 0.8, 1.0), (0.1, 0.1, 0.11, 1.0)
FRONT_ROTOR, REAR_ROTOR = (1.0, 0.38, 0.05, 0.85), (0.85, 0.88, 0.92, 0.7)
SHADOW, TARGET = (0.0, 0.0, 0.0, 0.4), (0.0, 0.62, 0.45, 0.6)
TARGET_M = 0.25  # radius
POST_SHADOW_M, DRONE_SHADOW_M = 0.01, 0.03  # heights above the ground, so that neither hides the other


class ChaseView:
    """Renders n poses, `position_m` (n, 3) NED and `orientation_wxyz` (n, 4), in a scene, with a layout if it has one.

    A sphere is at `target_m` (3,), NED. Raises UserError without OpenGL.
    """

    def __init__(
        self,
        scene: str,
        layout: LaneLayout | ClutterLayout | None,
        position_m: NDArray[np.float64],
        orientation_wxyz: NDArray[np.float64],
        size: tuple[int, int],
        target_m: Sequence[float] | None = None,
    ) -> None:
        self._position_m, self._orientation_wxyz = position_m, orientation_wxyz
        lane = replace(layout, light=1.0) if isinstance(layout, LaneLayout) else None
        spec = mujoco.MjSpec.from_file(str(scene_path(scene, lane.scenery if lane else PLAIN)))
        sun = sunlight(lane)[0] if lane else np.array(spec.lights[0].dir)
        self._slope = sun[:2] / -sun[2]  # how far a shadow falls beside what throws it, per metre of height
        self._model = _model(spec, lane, self._slope, target_m)
        self._data = mujoco.MjData(self._model)
        if lane:
            apply_layout(self._model, self._data, lane)
        elif isinstance(layout, ClutterLayout):
            apply_clutter(self._model, self._data, layout)
        self._size = size
        width, height = (round(FINER * pixels) for pixels in size)
        self._lens = Lens(width, height, FOV_DEG)
        self._camera = MountedCamera(self._model, width, height)

    def __call__(self, number: int) -> NDArray[np.uint8]:
        """Render pose `number`: (height, width, 3) red, green, blue."""
        north, east, down = self._position_m[number].tolist()
        yaw = euler_from_quaternion(self._orientation_wxyz[number])[2]
        place = ned_to_mujoco((north, east, down))
        self._data.qpos[:3] = place
        self._data.qpos[3:7] = quaternion_ned_to_mujoco(self._orientation_wxyz[number])
        self._data.mocap_pos[0] = (*(place[:2] + place[2] * self._slope), DRONE_SHADOW_M)
        self._data.mocap_quat[0] = (math.cos(yaw / 2), 0.0, 0.0, -math.sin(yaw / 2))
        level = Pose((north, east, down), from_degrees(0.0, 0.0, math.degrees(yaw)))
        self._camera.point(level.of(EYE), self._lens)
        drawn = self._camera.colour(self._data)
        return np.asarray(cv2.resize(drawn, self._size, interpolation=cv2.INTER_LINEAR), np.uint8)

    def close(self) -> None:
        """Free what OpenGL holds."""
        self._camera.close()


def _model(
    spec: mujoco.MjSpec, lane: LaneLayout | None, slope: NDArray[np.float64], target_m: Sequence[float] | None
) -> mujoco.MjModel:
    """Compile a scene with the shadows, a target, and with the drone as this view shows it."""
    spec.visual.quality.numslices = 16  # round rotors
    _dress(spec.body(QUADROTOR))
    shadow = spec.worldbody.add_body(name="drone_shadow", mocap=True)
    for ahead, left in ROTORS_M:
        _add(shadow, mujoco.mjtGeom.mjGEOM_CYLINDER, (ROTOR_RADIUS_M, 0.001, 0.0), (ahead, left, 0.0), SHADOW)
    _add(shadow, mujoco.mjtGeom.mjGEOM_BOX, (0.12, 0.07, 0.001), (0.0, 0.0, 0.0), SHADOW)
    if lane:
        _add_post_shadows(spec.worldbody, lane, slope)
    if target_m is not None:
        place = tuple(ned_to_mujoco(target_m))
        _add(spec.worldbody, mujoco.mjtGeom.mjGEOM_SPHERE, (TARGET_M, 0.0, 0.0), place, TARGET)
    return spec.compile()


def _dress(drone: mujoco.MjsBody) -> None:
    """Give the drone a pale shell, orange rotors in front, motors and skids."""
    for geom in drone.geoms:
        if geom.group != DRONE_GROUP:
            continue
        if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
            geom.rgba = FRONT_ROTOR if geom.pos[0] > 0 else REAR_ROTOR
        else:
            geom.rgba = ARMS if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE else SHELL
    for ahead, left in ROTORS_M:
        _add(drone, mujoco.mjtGeom.mjGEOM_CYLINDER, (0.022, 0.02, 0.0), (ahead, left, 0.008), DARK)
    _add(drone, mujoco.mjtGeom.mjGEOM_ELLIPSOID, (0.1, 0.06, 0.035), (0.0, 0.0, 0.02), SHELL)
    _add(drone, mujoco.mjtGeom.mjGEOM_BOX, (0.03, 0.03, 0.02), (0.09, 0.0, -0.02), DARK)
    for left in (0.075, -0.075):
        _add(drone, mujoco.mjtGeom.mjGEOM_BOX, (0.11, 0.007, 0.007), (0.0, left, -0.1), DARK)
        for ahead in (0.05, -0.05):
            _add(drone, mujoco.mjtGeom.mjGEOM_BOX, (0.006, 0.006, 0.045), (ahead, left, -0.055), DARK)


def _add_post_shadows(world: mujoco.MjsBody, layout: LaneLayout, slope: NDArray[np.float64]) -> None:
    """Lay a strip from the foot of each obstacle to where the shadow of its top falls."""
    reach = 2 * OBSTACLE_HALF_HEIGHT_M * slope
    half_length, turn = float(np.hypot(*reach)) / 2, math.atan2(reach[1], reach[0]) / 2
    feet = ned_to_mujoco(np.stack([layout.x_m, layout.y_m, np.zeros(len(layout))], axis=1))
    for foot, half_width in zip(feet, layout.half_width_m, strict=True):
        middle = (*(foot[:2] + reach / 2), POST_SHADOW_M)
        size = half_length, float(half_width), 0.001
        strip = _add(world, mujoco.mjtGeom.mjGEOM_BOX, size, middle, SHADOW)
        strip.quat = (math.cos(turn), 0.0, 0.0, math.sin(turn))


def _add(
    body: mujoco.MjsBody,
    kind: mujoco.mjtGeom,
    size: tuple[float, float, float],
    place_m: tuple[float, ...],
    rgba: tuple[float, float, float, float],
) -> mujoco.MjsGeom:
    """Add a geom that is only seen; sizes are halves, and a cylinder's are its radius and half its height."""
    return body.add_geom(
        type=kind, size=size, pos=place_m, rgba=rgba, group=DRONE_GROUP, contype=0, conaffinity=0, mass=0.0
    )
