"""One drone in one MuJoCo scene, stepped in whole ticks. No wall time, no commands, no threads."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, Quaternion, Vector
from uavaccel.resources import asset
from uavaccel.sim import autopilot, hotloop
from uavaccel.sim.clearance import Clearance
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.sim.lane.scene import apply_layout, collision_object
from uavaccel.sim.profile import Profile
from uavaccel.sim.quadrotor import FLIGHT_DTYPE, KINEMATICS, NEVER, Record, density_ratio, parameters
from uavaccel.units import ned_to_mujoco, quaternion_ned_to_mujoco

if TYPE_CHECKING:
    from uavaccel.sim.camera import Camera

SAMPLE_CAPACITY = 1 << 16
NEAR_TICKS = 16  # flown with contacts where something is so near that leaving them out is not worth while
START_M = (0.0, 0.0, -10.0)  # a game starts from a settled hover 10 m up
LEVEL = (1.0, 0.0, 0.0, 0.0)


class FlightError(RuntimeError):
    """MuJoCo warned of a state it could not integrate; the game is void."""


class World:
    """A scene of assets/mjcf with its quadrotor, flown by SimpleFlight's cascade.

    In the lane the vehicle is frozen where it first touches anything, which ends a game; in other scenes MuJoCo's
    contacts act.
    """

    def __init__(self, scene: str, profile: Profile) -> None:
        path = asset(f"mjcf/{scene}.xml")
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.timestep = profile.tick_s
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self.profile = profile
        self.freeze_on_collision = scene == "lane"
        self.collision_object = ""
        self._cameras: dict[tuple[int, int], Camera] = {}
        body = self.model.body("quadrotor").id
        mass, inertia = self.model.body_mass[body], self.model.body_inertia[body]
        self._parameters = parameters(profile.tick_s, profile.hover_after_ticks, mass, inertia)
        self._flight = np.zeros(1, FLIGHT_DTYPE)
        self._recorder = np.zeros(1, hotloop.RECORDER_DTYPE)
        self._samples = np.empty((SAMPLE_CAPACITY, hotloop.SAMPLE_COLUMNS))
        # views of the records' fields, which numpy finds again only slowly
        self._field = {name: self._flight[name] for name in FLIGHT_DTYPE.names or ()}
        self._kinematics = self._flight.view(np.float64)[1 : 1 + KINEMATICS]
        self._warnings = self.data.warning.number
        self._clearance = Clearance(self.model, self.data)
        self._with_contacts = int(self.model.opt.disableflags)
        self._handles = self._addresses()
        self._handles_pointer = self._handles.ctypes.data_as(ctypes.POINTER(ctypes.c_int64))
        self.stop_recording()
        self.reset()

    def _addresses(self) -> NDArray[np.int64]:
        """What the hot loop works on, in the order of hotloop.views."""
        data = self.data
        arrays = (data.qpos, data.qvel, data.qfrc_applied, data.sensordata)
        records = (self._parameters, self._flight, self._recorder, self._samples)
        own = [array.ctypes.data for array in (*arrays, *records)]
        fixed = [hotloop.mj_step_address(), self.model._address, data._address]
        return np.array([*fixed, *own, SAMPLE_CAPACITY], np.int64)

    @property
    def parameters(self) -> Record:
        """The quadrotor's and the autopilot's parameters (quadrotor.PARAMETERS_DTYPE)."""
        return self._parameters[0]

    @property
    def state(self) -> Record:
        """The flight's state (quadrotor.FLIGHT_DTYPE)."""
        return self._flight[0]

    @property
    def tick(self) -> int:
        return int(self._field["tick"][0])

    @property
    def collision_tick(self) -> int | None:
        """Tick of the first touch since the last reset."""
        tick = int(self._field["collision_tick"][0])
        return None if tick == NEVER else tick

    def camera(self, width: int, height: int) -> Camera:
        """The front camera at a size; made when first asked for, kept. Raises UserError without OpenGL."""
        from uavaccel.sim.camera import Camera  # what needs no images needs no OpenGL

        if (width, height) not in self._cameras:
            self._cameras[width, height] = Camera(self.model, width, height)
        return self._cameras[width, height]

    def set_lane(self, layout: LaneLayout) -> None:
        """Lay out the lane's obstacles, light and wind anew. Raises UserError in another scene."""
        apply_layout(self.model, self.data, layout)
        self._look_for_contacts()
        self._field["wind"][0] = layout.wind_m_s

    def close(self) -> None:
        """Give back what OpenGL holds."""
        while self._cameras:
            self._cameras.popitem()[1].close()

    def reset(self, position_m: Vector = START_M, orientation_wxyz: Quaternion = LEVEL) -> None:
        """Tick 0, at rest in a settled position hold at `position_m`; the recorder stops."""
        self.stop_recording()
        wind = self.state["wind"].copy()
        self.state["tick"] = 0
        for name in FLIGHT_DTYPE.names or ():
            self.state[name] = 0
        self.state["wind"] = wind
        self.state["armed"] = 1
        self.state["hover_tick"] = self.state["collision_tick"] = NEVER
        self.place(position_m, orientation_wxyz)
        self._settle()

    def place(
        self, position_m: Vector, orientation_wxyz: Quaternion = LEVEL, velocity_m_s: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        """Put the vehicle somewhere (NED, wxyz), not turning; its autopilot and rotors go on as they are."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:3] = ned_to_mujoco(position_m)
        self.data.qpos[3:7] = quaternion_ned_to_mujoco(orientation_wxyz)
        self.data.qvel[:3] = ned_to_mujoco(velocity_m_s)
        self.state["collision_tick"] = NEVER
        self.collision_object = ""
        self._look_for_contacts()
        self._failed = False
        hotloop.ENTRY_POINTS.look.ctypes(self._handles_pointer, 0)

    def _settle(self) -> None:
        """Give rotors, integrator and height goal the values that a long position hold arrives at."""
        state, gains = self.state, self.parameters
        weight = gains["mass_kg"] * gains["gravity_m_s2"]
        thrust = gains["max_thrust_n"] * density_ratio(gains, state["position"][2])
        hover = weight / (4 * thrust)
        for name in ("rotor_input", "rotor_lagged", "rotor_output"):
            state[name] = hover
        autopilot.hold_position.py_func(self._flight.view(np.recarray)[0])
        gathered = gains["tick_s"] * gains["z_integral_gain"] / (1.0 - gains["z_integral_keep"])
        error_m_s = (1.0 - 2.0 * hover) / (gains["velocity_gain"][2] + gathered)
        state["z_integral"] = gathered * error_m_s
        state["z_integral_mode"] = autopilot.POSITION
        state["goal"][2] += error_m_s / (gains["position_gain"][2] * gains["velocity_limit_m_s"])
        hotloop.ENTRY_POINTS.look.ctypes(self._handles_pointer, 0)

    def advance(self, ticks: int) -> int:
        """Fly up to `ticks` ticks; returns how many: fewer where something is touched for the first time.

        Raises FlightError when MuJoCo warns; the vehicle then stands still until it is placed anew.
        """
        if self._failed or (self.freeze_on_collision and self.collision_tick is not None):
            return int(hotloop.ENTRY_POINTS.stand_still.ctypes(self._handles_pointer, ticks))
        flown = self._fly(ticks)
        if not self.collision_object and self.collision_tick is not None:
            self.collision_object = collision_object(self.model, self.data)
        if self._warnings.any():
            self._failed = True
            kind = mujoco.mjtWarning(int(np.flatnonzero(self._warnings)[0])).name
            raise FlightError(f"MuJoCo warned of {kind} at tick {self.tick}")
        return flown

    def _fly(self, ticks: int) -> int:
        flown, touched = 0, self.collision_tick
        while flown < ticks and self.collision_tick == touched:
            if self.tick >= self._look_again_tick:
                self._look_around()
            due = min(ticks - flown, self._look_again_tick - self.tick)
            flown += int(hotloop.ENTRY_POINTS.fly.ctypes(self._handles_pointer, due))
        return flown

    def _look_around(self) -> None:
        """Look for contacts, or, while there can be none, leave them out: the flight is the same."""
        free_ticks = int(self._clearance.free_s(self.parameters, self.state) / self.profile.tick_s)
        if free_ticks < NEAR_TICKS:
            self._look_for_contacts(NEAR_TICKS)
        else:
            self.model.opt.disableflags = self._with_contacts | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
            self._look_again_tick = self.tick + free_ticks

    def _look_for_contacts(self, ticks: int = 0) -> None:
        self.model.opt.disableflags = self._with_contacts
        self._look_again_tick = self.tick + ticks

    def fly_velocity(self, goal: Vector, height_held: bool, yaw: float, yaw_is_rate: bool) -> None:
        """Set the autopilot's goal: NED m/s, the third a height in m if held; yaw in rad or rad/s."""
        field = self._field
        field["goal"][0] = (*goal, yaw)
        field["xy_mode"][0] = autopilot.VELOCITY
        field["z_mode"][0] = autopilot.POSITION if height_held else autopilot.VELOCITY
        field["yaw_mode"][0] = autopilot.RATE if yaw_is_rate else autopilot.ANGLE

    def hold_from(self, tick: int | None) -> None:
        """Position hold sets in at `tick`; None: not at all."""
        self._field["hover_tick"][0] = NEVER if tick is None else tick

    def kinematics(self, origin_ns: int = 0) -> Kinematics:
        """The state at the present tick, NED and FRD; `origin_ns` is the simulated time of tick 0."""
        n = tuple(self._kinematics.tolist())
        time_ns = origin_ns + self.tick * self.profile.tick_ns
        return Kinematics(time_ns, n[0:3], n[3:7], n[7:10], n[10:13], n[13:16], n[16:19])

    @property
    def recording(self) -> bool:
        return int(self._recorder["next_tick"][0]) != NEVER

    def start_recording(self) -> None:
        """Sample the state at this tick and then on the profile's grid, into an emptied buffer."""
        recorder = self._recorder
        recorder["count"] = recorder["dropped"] = 0
        recorder["period"] = self.profile.recorder_ticks
        recorder["next_tick"] = self.tick
        hotloop.ENTRY_POINTS.stand_still.ctypes(self._handles_pointer, 0)

    def stop_recording(self) -> None:
        self._recorder["next_tick"] = NEVER

    def samples(self) -> NDArray[np.float64]:
        """Copy of the recorded rows (n, 14): tick, position, wxyz, velocity, body rate."""
        return self._samples[: int(self._recorder["count"][0])].copy()

    def take_samples(self) -> NDArray[np.float64]:
        """The recorded rows, as `samples`, and room for as many anew; the recorder's grid goes on."""
        rows = self.samples()
        self._recorder["count"] = 0
        return rows

    @property
    def samples_dropped(self) -> int:
        """Samples that found the buffer full."""
        return int(self._recorder["dropped"][0])
