"""A quadrotor of a world: its views of MuJoCo's arrays, its flight state, its contacts, and its recorder.

Its poses and goals are in its own frame: NED, in metres from `origin_m`, a point of the world (NedTransform.cpp).
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, Quaternion, Vector
from uavaccel.sim.poses import HERE, LEVEL
from uavaccel.sim.profile import Profile
from uavaccel.sim.scene import QUADROTOR, TOUCH
from uavaccel.sim.vehicle import autopilot, hotloop
from uavaccel.sim.vehicle.autopilot import IDLE, Goal
from uavaccel.sim.vehicle.contacts import ContactLog
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, KINEMATICS, NEVER, PARAMETERS_DTYPE, Record, parameters
from uavaccel.units import mujoco_to_ned, ned_to_mujoco, quaternion_ned_to_mujoco

SAMPLE_CAPACITY = 1 << 16


class Samples:
    """Rows (n, 14) that the hot loop writes: tick, position, wxyz, velocity, body rate."""

    def __init__(self, period_ticks: int, capacity: int | None = None) -> None:
        self.record = np.zeros(1, hotloop.RECORDER_DTYPE)
        self.buffer = np.empty((SAMPLE_CAPACITY if capacity is None else capacity, hotloop.SAMPLE_COLUMNS))
        self.record["period"] = period_ticks
        self.stop()

    @property
    def active(self) -> bool:
        return int(self.record["next_tick"][0]) != NEVER

    @property
    def dropped(self) -> int:
        """Number of samples for which the buffer had no room."""
        return int(self.record["dropped"][0])

    def start(self, tick: int) -> None:
        """Empty the buffer; the next sample is due at `tick`."""
        self.record["count"] = self.record["dropped"] = 0
        self.record["next_tick"] = tick

    def stop(self) -> None:
        """Stop recording; the rows stay."""
        self.record["next_tick"] = NEVER

    def rows(self) -> NDArray[np.float64]:
        """Return a copy of the recorded rows."""
        return self.buffer[: int(self.record["count"][0])].copy()

    def take(self) -> NDArray[np.float64]:
        """Return the rows and empty the buffer; recording continues."""
        rows = self.rows()
        self.record["count"] = 0
        return rows


AT_REST_M_S = 0.05
UNCOUNTED = -1.0  # contacts exist, but the hot loop has not counted them yet
GAINS = (
    *("position_gain", "velocity_gain", "z_integral_gain", "angle_gain", "rate_gain"),
    *("full_pid", "integral_gain", "derivative_gain"),
)
PID_NAMES = ("position", "velocity", "angle", "rate")  # of the cascade's levels


@dataclass(frozen=True)
class Start:
    """A vehicle's start, NED in the world: in a settled hover or, if `idle`, with its rotors idling."""

    position_m: Vector
    orientation_wxyz: Quaternion = LEVEL
    idle: bool = False


class AddedVehicle(NamedTuple):
    """A vehicle to be added; `origin_m` is the origin of its own frame, NED in the world."""

    name: str
    start: Start
    origin_m: Vector = HERE


class Motion(NamedTuple):
    """How a vehicle moves at a tick: its flight state, and MuJoCo's pose, velocity, forces and acceleration."""

    flight: NDArray[np.void]
    body: tuple[NDArray[np.float64], ...]


class Vehicle:
    """A quadrotor flown by SimpleFlight's cascade; `prefix` begins its names in the MJCF model."""

    def __init__(
        self,
        name: str,
        profile: Profile,
        start: Start,
        samples: Samples,
        prefix: str = "",
        origin_m: Vector = HERE,
        contacts_act: bool = True,
    ) -> None:
        self.name, self.profile, self.start, self.prefix = name, profile, start, prefix
        self.body = prefix + QUADROTOR  # its name in the model
        self.origin_m = origin_m
        self._samples, self._contacts_act = samples, contacts_act
        self._flight = np.zeros(1, FLIGHT_DTYPE)
        # the state's fields (1, ...), to be changed in place: numpy finds them again only slowly
        self.field = {name: self._flight[name] for name in FLIGHT_DTYPE.names or ()}
        self._kinematics = self._flight.view(np.float64)[1 : 1 + KINEMATICS]
        self._parameters = np.zeros(1, PARAMETERS_DTYPE)
        self._time_s = np.zeros(1)
        self.contact_log = ContactLog()

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData, name_of: Callable[[int], str]) -> None:
        """Fly in this model instead of any previous one; `name_of` returns the name of what a geom belongs to."""
        body = model.body(self.body)
        if not self.parameters["mass_kg"]:
            inertia, ticks = model.body_inertia[body.id], self.profile.hover_after_ticks
            mass = model.body_mass[body.id]
            self._parameters[:] = parameters(self.profile.tick_s, ticks, mass, inertia, self._contacts_act)
            self._own_parameters = self._parameters.copy()
            self._default_gains = {name: self._parameters[name].copy() for name in GAINS}
        joint = model.joint(int(model.body_jntadr[body.id]))
        place, motion = int(joint.qposadr[0]), int(joint.dofadr[0])
        sensor = int(model.sensor(self.prefix + TOUCH).adr[0])
        self.body_id = int(body.id)
        self.qpos = data.qpos[place : place + 7]
        self.qvel = data.qvel[motion : motion + 6]
        self._force = data.qfrc_applied[motion : motion + 6]
        self._push = data.qfrc_constraint[motion : motion + 6]
        self.gained = data.qacc[motion : motion + 6]
        self._warm_start = data.qacc_warmstart[motion : motion + 6]
        self._contact = data.sensordata[sensor : sensor + 1]
        self.model, self.data = model, data
        self.contact_log.bind(model, data, self.body_id, name_of)
        arrays = (self.qpos, self.qvel, self._force, self._contact, self._push)
        records = (self._parameters, self._flight, self._samples.record, self._samples.buffer)
        own = [array.ctypes.data for array in (*arrays, *records)]
        fixed = [hotloop.mj_step_address(), model._address, data._address]
        free = [self._warm_start.ctypes.data, self._time_s.ctypes.data]
        # what the hot loop works on, in the order of hotloop.views
        self.handles = np.array([*fixed, *own, len(self._samples.buffer), *free], np.int64)
        self._handles_pointer = self.handles.ctypes.data_as(ctypes.POINTER(ctypes.c_int64))

    # --- state ------------------------------------------------------------------------------------

    @property
    def parameters(self) -> Record:
        """The quadrotor's and the autopilot's parameters (quadrotor.PARAMETERS_DTYPE)."""
        return self._parameters[0]

    @property
    def state(self) -> Record:
        """The flight's state (quadrotor.FLIGHT_DTYPE), with positions in the world's frame."""
        return self._flight[0]

    @property
    def tick(self) -> int:
        """Physics steps since the last reset."""
        return int(self.field["tick"][0])

    @property
    def collision_tick(self) -> int | None:
        """Tick of the first contact since the last reset; None without one."""
        tick = int(self.field["collision_tick"][0])
        return None if tick == NEVER else tick

    @property
    def place_m(self) -> Vector:
        """Its position in MuJoCo, NED in the world."""
        x, y, z = mujoco_to_ned(self.qpos[:3]).tolist()
        return x, y, z

    @property
    def landed(self) -> bool:
        """Whether the vehicle is in contact with something and at rest."""
        state = self.state
        return bool(state["contacts"]) and math.hypot(*state["velocity"].tolist()) < AT_REST_M_S

    def kinematics(self, origin_ns: int = 0, in_world: bool = False) -> Kinematics:
        """Return the state at the present tick, NED and FRD; `origin_ns` is the simulated time of tick 0."""
        n = tuple(self._kinematics.tolist())
        time_ns = origin_ns + self.tick * self.profile.tick_ns
        place_m = n[0:3] if in_world else self.local(n[0:3])
        return Kinematics(time_ns, place_m, n[3:7], n[7:10], n[10:13], n[13:16], n[16:19])

    def local(self, place_m: Vector) -> Vector:
        """Convert a position in the world to the vehicle's own frame."""
        if self.origin_m is HERE:
            return place_m
        x, y, z = (a - b for a, b in zip(place_m, self.origin_m, strict=True))
        return x, y, z

    def in_world(self, place_m: Vector) -> Vector:
        """Convert a position in the vehicle's own frame to the world: the inverse of `local`."""
        if self.origin_m is HERE:
            return place_m
        x, y, z = (a + b for a, b in zip(place_m, self.origin_m, strict=True))
        return x, y, z

    # --- goals ------------------------------------------------------------------------------------

    def set_goal(self, goal: Goal) -> None:
        """Set the autopilot's goal from the next tick on."""
        field, values = self.field, goal.values
        if self.origin_m is not HERE:
            held = (goal.xy_mode, goal.xy_mode, goal.z_mode)
            places = [
                value + origin * (mode == autopilot.POSITION)
                for value, origin, mode in zip(values, self.origin_m, held, strict=False)
            ]
            values = (places[0], places[1], places[2], values[3])
        field["goal"][0] = values
        field["xy_mode"][0], field["z_mode"][0] = goal.xy_mode, goal.z_mode
        field["yaw_mode"][0] = goal.yaw_mode

    def hold_from(self, tick: int | None) -> None:
        """Let position hold begin at `tick`; None: never."""
        self.field["hover_tick"][0] = NEVER if tick is None else tick

    def set_gains(self, level: str, kp: Vector, ki: Vector, kd: Vector) -> None:
        """Set the gains of three axes of a level of the cascade: "position", "velocity", "angle" or "rate".

        The controllers are reset (Params::gains_changed).
        """
        parameters = self.parameters
        parameters[f"{level}_gain"] = kp
        slots = slice(first := 3 * PID_NAMES.index(level), first + 3)
        parameters["integral_gain"][slots], parameters["derivative_gain"][slots] = ki, kd
        if level == "velocity":  # its vertical axis has a leaky integrator of its own
            parameters["z_integral_gain"], parameters["integral_gain"][slots.stop - 1] = ki[2], 0.0
        parameters["full_pid"] = parameters["integral_gain"].any() or parameters["derivative_gain"].any()
        self.field["z_integral_mode"][0] = self.field["pid_mode"][0] = autopilot.UNSET

    def restore_gains(self) -> None:
        """Restore the gains of AirSim's Params.hpp."""
        for name, gains in self._default_gains.items():
            self.parameters[name] = gains[0]

    def set_airframe(self, mass_ratio: float, thrust_ratio: float) -> None:
        """Scale its mass and inertia, and thrust and torque of its rotors, relative to its own.

        The autopilot keeps its gains. So does MuJoCo what it derives from the mass for contacts, since in the lane the
        first contact ends a game.
        """
        model, own, body = self.model, self._own_parameters, self.body_id
        for name in ("mass_kg", "inertia_kg_m2"):
            self._parameters[name] = mass_ratio * own[name]
        for name in ("max_thrust_n", "max_torque_n_m"):
            self._parameters[name] = thrust_ratio * own[name]
        mass_kg, inertia = self._parameters["mass_kg"][0], self._parameters["inertia_kg_m2"][0]
        if model.body_mass[body] != mass_kg:
            model.body_subtreemass[[0, body]] += mass_kg - model.body_mass[body]
            model.body_mass[body], model.body_inertia[body] = mass_kg, inertia
            model.dof_M0[:3], model.dof_M0[3:6] = mass_kg, inertia  # MuJoCo takes a free body's mass matrix from here

    # --- places -----------------------------------------------------------------------------------

    def begin(self, start: Start) -> None:
        """Go to tick 0 at a start, at rest: in a settled position hold, or idle."""
        wind = self.state["wind"].copy()
        for name in FLIGHT_DTYPE.names or ():
            self.state[name] = 0
        self.state["wind"] = wind
        self.state["armed"] = 1
        self.state["hover_tick"] = NEVER
        self.state["pid_mode"] = autopilot.UNSET
        self.put(start.position_m, start.orientation_wxyz)
        self.clear_contacts()
        if start.idle:
            self.set_goal(IDLE)
            for name in ("rotor_input", "rotor_lagged", "rotor_output"):
                self.state[name] = autopilot.IDLE_THROTTLE
            self.state["z_integral_mode"] = autopilot.UNSET
        else:
            autopilot.settle(self._parameters, self._flight)
        self.refresh()

    def clear_contacts(self) -> None:
        self.state["collision_tick"] = NEVER
        self.state["contacts"] = self.state["contacts_changed"] = 0
        self.contact_log.clear()

    def stand(self) -> None:
        """Do `refresh` with MuJoCo's latest contact forces in the accelerations; the next tick logs the contact."""
        self.refresh()
        parameters, state = (array.view(np.recarray)[0] for array in (self._parameters, self._flight))
        hotloop.feel_contacts.py_func(parameters, state, self._contact, self._push)
        self.state["contacts"] = UNCOUNTED

    def put(
        self, position_m: Vector, orientation_wxyz: Quaternion, velocity_m_s: Vector = HERE, rate: Vector = HERE
    ) -> None:
        """Set pose and velocity in MuJoCo: NED in the world, and rad/s in the body's frame."""
        self.set_pose(position_m, orientation_wxyz)
        self.qvel[:3], self.qvel[3:] = ned_to_mujoco(velocity_m_s), ned_to_mujoco(rate)
        self._force[:] = self._warm_start[:] = 0.0
        self.refresh()

    def set_pose(self, position_m: Vector, orientation_wxyz: Quaternion) -> None:
        """Set only MuJoCo's pose."""
        self.qpos[:3] = ned_to_mujoco(position_m)
        self.qpos[3:7] = quaternion_ned_to_mujoco(orientation_wxyz)

    def move(self, position_m: Vector, orientation_wxyz: Quaternion) -> None:
        """Move to a pose at the same velocity; contacts there count as new ones."""
        self.set_pose(position_m, orientation_wxyz)
        self._warm_start[:] = 0.0
        self.state["contacts"] = self.state["contacts_changed"] = 0
        self.contact_log.leave()
        self.refresh()

    def set_velocity(self, velocity_m_s: Vector, rate_rad_s: Vector) -> None:
        """Set NED m/s and body rad/s at this tick; MuJoCo's own are half a tick older (hotloop)."""
        goal = np.concatenate([ned_to_mujoco(velocity_m_s), ned_to_mujoco(rate_rad_s)])
        self.qvel[:] = goal
        for _ in range(3):  # a fixed-point iteration, since drag depends on the velocity
            self.refresh()
            state, half = self.state, 0.5 * self.profile.tick_s
            gained = [ned_to_mujoco(state[name]) for name in ("acceleration", "angular_acceleration")]
            self.qvel[:] = goal - half * np.concatenate(gained)
        self.refresh()

    def motion(self) -> Motion:
        """Return how it moves at this tick, for `resume` and for `fly_on`."""
        arrays = self.qpos, self.qvel, self._force, self._push, self._warm_start
        return Motion(self._flight.copy(), tuple(array.copy() for array in arrays))

    def resume(self, motion: Motion, share: float) -> None:
        """Fly on from the present place as in `motion`, with `share` of its velocity and turn rate.

        Position hold sets in when the commands of meanwhile have said, if that is still to come.
        """
        now, (pose, velocity, force, _, acceleration) = self._flight.copy(), motion.body
        self._flight[:] = motion.flight
        for name in ("tick", "hover_tick"):
            self.field[name][0] = now[name][0]
        self.qpos[3:], self.qvel[:] = pose[3:], velocity * share
        self._force[:], self._warm_start[:] = force, acceleration
        self.refresh()

    def fly_on(self, motion: Motion) -> None:
        """Go on with the flight in the model that it was bound to last."""
        self.qpos[:], self.qvel[:], self._force[:], self._push[:], _ = motion.body

    def refresh(self) -> None:
        """Update the flight state after MuJoCo's pose or velocity was changed from outside."""
        hotloop.ENTRY_POINTS.refresh.ctypes(self._handles_pointer, 0)

    def fly(self, ticks: int) -> int:
        """Fly up to `ticks` ticks, for a vehicle alone in its world; returns how many (hotloop's `fly`)."""
        return int(hotloop.ENTRY_POINTS.fly.ctypes(self._handles_pointer, ticks))

    def fly_free(self, ticks: int) -> int:
        """Fly as `fly` does, faster, while no contact is possible for that long."""
        self._time_s[0] = self.data.time
        flown = int(hotloop.ENTRY_POINTS.fly_free.ctypes(self._handles_pointer, ticks))
        self.data.time = self._time_s[0]
        return flown if flown == ticks else flown + self.fly(ticks - flown)

    def rest(self, ticks: int) -> int:
        """Let ticks pass without moving."""
        return int(hotloop.ENTRY_POINTS.rest.ctypes(self._handles_pointer, ticks))
