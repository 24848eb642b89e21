"""When contact detection can be skipped, since the vehicle cannot reach anything.

The bound is strict: no flight under the strongest thrust, drag and gravity leaves the ball that is assumed.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.parts import njit, part
from uavaccel.sim.vehicle.quadrotor import Record

PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
GUST_M_S = 10.0  # gain of velocity after which the bound is computed again
MARGIN_M = 0.01
DENSEST_AIR = 1.5  # kg/m³, kilometres below the sea
STRONGEST_THRUST = 1.3  # relative to that at sea level, in the densest air
NEAR_TICKS = 16  # flown with contact detection if less than that is free

Floats = NDArray[np.float64]


class Clearance:
    """Distance of a scene's quadrotor from the static geoms; switches the model's contacts off and on.

    `data` has to hold the geoms' positions.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        body = model.body("quadrotor").id
        touching = self._find_surroundings(model)
        own = touching & (model.geom_bodyid == body)
        self._radius_m = float((np.linalg.norm(model.geom_pos, axis=1) + model.geom_rbound)[own].max())
        self._model = model
        # views, which MuJoCo makes anew at each access
        self._qpos = data.qpos
        self._places = model.geom_type, data.geom_xpos, data.geom_xmat, model.geom_aabb
        # the world and the vehicle, so that nothing else moves, and nothing acts before it is touched
        self.alone = model.nbody == 2 and not _acts_from_afar(model, touching)
        self._with_contacts = int(model.opt.disableflags)
        self._without_contacts = self._with_contacts | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._next_check_tick = 0

    def _find_surroundings(self, model: mujoco.MjModel) -> NDArray[np.bool_]:
        touching: NDArray[np.bool_] = (model.geom_contype | model.geom_conaffinity) > 0
        self._still = np.flatnonzero(touching & (model.geom_bodyid == 0))
        return touching

    def surroundings_changed(self) -> None:
        """Note that static geoms were moved, added or removed."""
        self._find_surroundings(self._model)
        self.check_now()

    def check_now(self) -> None:
        """Compute the bound again at the next tick: vehicle or surroundings were moved."""
        self._next_check_tick = 0
        self._model.opt.disableflags = self._with_contacts

    def ticks_to_fly(self, tick: int, ticks: int, parameters: Record, state: Record) -> int:
        """Return how many of the next `ticks` to fly before the next call; switches contact detection."""
        if tick >= self._next_check_tick:
            free_ticks = int(self.free_s(parameters, state) / parameters["tick_s"])
            near = free_ticks < NEAR_TICKS
            self._model.opt.disableflags = self._with_contacts if near else self._without_contacts
            self._next_check_tick = tick + (NEAR_TICKS if near else free_ticks)
        return min(ticks, self._next_check_tick - tick)

    @property
    def left_out(self) -> bool:
        """Whether contact detection is off."""
        return bool(self._model.opt.disableflags != self._with_contacts)

    def free_s(self, parameters: Record, state: Record) -> float:
        """Return the seconds of flight, 0 or more, in which no contact is possible, whatever the autopilot does."""
        if not self.alone:
            return 0.0
        distance_m = _distance(self._qpos, self._still, *self._places)
        gap_m = distance_m - self._radius_m - MARGIN_M
        craft = tuple(parameters[name] for name in ("max_thrust_n", "drag_factor_m2", "mass_kg", "gravity_m_s2"))
        return float(_free_s(gap_m, state["velocity"], state["wind"], *craft))


def _acts_from_afar(model: mujoco.MjModel, touching: NDArray[np.bool_]) -> bool:
    """Return whether a model has contacts of margins, gaps, pairs of its own or overrides, not of its geoms alone."""
    overridden = model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE
    return bool(model.npair or overridden or (model.geom_margin + model.geom_gap)[touching].any())


@part
def free_s(parameters: Record, state: Record, gap_m: float) -> float:
    """Return the seconds, 0 or more, in which no flight crosses `gap_m`, whatever the autopilot does."""
    thrust_n, drag_m2, mass_kg = parameters.max_thrust_n, parameters.drag_factor_m2, parameters.mass_kg
    return time_through(gap_m, state.velocity, state.wind, thrust_n, drag_m2, mass_kg, parameters.gravity_m_s2)


@part
def time_through(
    gap_m: float, velocity: Floats, wind: Floats, thrust_n: float, drag_m2: Floats, mass_kg: float, gravity_m_s2: float
) -> float:
    """Compute `free_s` from single fields: passing records from Python to numba takes longer than the computation."""
    speed, wind_speed = length(velocity), length(wind)
    strongest = strongest_acceleration(thrust_n, drag_m2, mass_kg, gravity_m_s2, speed + wind_speed)
    return time_to(gap_m, speed, strongest)


@part
def length(vector: Floats) -> float:
    """Return the Euclidean norm of a vector (3,)."""
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


@part
def strongest_acceleration(
    thrust_n: float, drag_m2: Floats, mass_kg: float, gravity_m_s2: float, airspeed_m_s: float
) -> float:
    """Return an upper bound of the acceleration, m/s², until the velocity has changed by GUST_M_S."""
    fastest = airspeed_m_s + GUST_M_S
    drag_n = length(drag_m2) * DENSEST_AIR * fastest * fastest
    return (4 * thrust_n * STRONGEST_THRUST + drag_n) / mass_kg + gravity_m_s2


@part
def time_to(distance_m: float, speed_m_s: float, acceleration_m_s2: float) -> float:
    """Return the seconds in which not even that acceleration covers the distance."""
    if not (distance_m > 0.0 and speed_m_s < np.inf and acceleration_m_s2 < np.inf):
        return 0.0
    arrival_m_s = math.sqrt(speed_m_s * speed_m_s + 2.0 * acceleration_m_s2 * distance_m)
    return min((arrival_m_s - speed_m_s) / acceleration_m_s2, GUST_M_S / acceleration_m_s2)


_free_s = njit(cache=True)(time_through.py_func)


@njit(cache=True)
def _distance(
    point: NDArray[np.float64],
    geoms: NDArray[np.int64],
    kind: NDArray[np.int32],
    position: NDArray[np.float64],
    orientation: NDArray[np.float64],
    box: NDArray[np.float64],
) -> float:
    """Return a lower bound, m, of the distance from a point to the geoms: to planes, and to the others' boxes."""
    nearest: float = np.inf
    for geom in geoms:
        squared, height = 0.0, 0.0
        for axis in range(3):
            local = 0.0
            for world in range(3):
                local += orientation[geom, 3 * world + axis] * (point[world] - position[geom, world])
            squared += max(abs(local - box[geom, axis]) - box[geom, 3 + axis], 0.0) ** 2
            height = local  # the third axis is a plane's normal
        nearest = min(nearest, height if kind[geom] == PLANE else math.sqrt(squared))
    return nearest
