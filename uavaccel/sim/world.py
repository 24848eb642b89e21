"""One drone in one MuJoCo scene, stepped in whole ticks. No wall time, no commands, no threads."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.kinematics import Kinematics, Quaternion, Vector, VelocityGoal
from uavaccel.resources import asset
from uavaccel.sim import autopilot, hotloop
from uavaccel.sim.airframe import set_airframe
from uavaccel.sim.clearance import Clearance
from uavaccel.sim.furnished import furnished_model
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.sim.lane.scene import apply_layout
from uavaccel.sim.profile import Profile
from uavaccel.sim.quadrotor import FLIGHT_DTYPE, KINEMATICS, NEVER, Record, parameters
from uavaccel.sim.samples import Samples
from uavaccel.sim.saved import State, into_record, layout_of, of_record, part, under
from uavaccel.sim.touch import Touches, deepest_contact
from uavaccel.units import ned_to_mujoco, quaternion_ned_to_mujoco

if TYPE_CHECKING:
    from uavaccel.sim.camera import FrontCamera
    from uavaccel.sim.mounted_camera import MountedCamera

PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION)
HIGHEST_M = 20_000.0  # over the sea, as high as air_density follows the standard atmosphere
AT_REST_M_S = 0.05
DEEPEST_M = 0.05  # into what it is placed on; from deeper contacts would throw the vehicle
START_M = (0.0, 0.0, -10.0)  # a game starts from a settled hover 10 m up
LEVEL = (1.0, 0.0, 0.0, 0.0)


class FlightError(RuntimeError):
    """MuJoCo warned of a state it could not integrate; the game is void."""


class World:
    """A scene of assets/mjcf with its quadrotor, flown by SimpleFlight's cascade.

    `furnished` for AirSim's clients (uavaccel.sim.furnished).
    In the lane the vehicle is frozen where it first touches anything, which ends a game; in other scenes MuJoCo's
    contacts act.
    """

    def __init__(self, scene: str, profile: Profile, furnished: bool = False) -> None:
        path = asset(f"mjcf/{scene}.xml")
        self.model = furnished_model(path) if furnished else mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.timestep = profile.tick_s
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self.profile = profile
        self.freeze_on_collision = scene == "lane"
        self.scene = scene
        self._lane: LaneLayout | None = None
        self._cameras: dict[tuple[int, int], FrontCamera] = {}
        self._mounted_camera: MountedCamera | None = None
        body = self.model.body("quadrotor").id
        mass, inertia = self.model.body_mass[body], self.model.body_inertia[body]
        self._parameters = parameters(
            profile.tick_s, profile.hover_after_ticks, mass, inertia, not self.freeze_on_collision
        )
        self._own_parameters = self._parameters.copy()
        self._flight = np.zeros(1, FLIGHT_DTYPE)
        self._samples = Samples(profile.recorder_ticks)
        # views of the records' fields, which numpy finds again only slowly
        self._field = {name: self._flight[name] for name in FLIGHT_DTYPE.names or ()}
        self._kinematics = self._flight.view(np.float64)[1 : 1 + KINEMATICS]
        self._warnings = self.data.warning.number
        self._clearance = Clearance(self.model, self.data)
        self.touches = Touches(self.model, self.data)
        self._handles = self._addresses()
        self._handles_pointer = self._handles.ctypes.data_as(ctypes.POINTER(ctypes.c_int64))
        self.reset()

    def _addresses(self) -> NDArray[np.int64]:
        """What the hot loop works on, in the order of hotloop.views."""
        data = self.data
        arrays = (data.qpos, data.qvel, data.qfrc_applied, data.sensordata, data.qfrc_constraint)
        samples = self._samples
        records = (self._parameters, self._flight, samples.record, samples.buffer)
        own = [array.ctypes.data for array in (*arrays, *records)]
        fixed = [hotloop.mj_step_address(), self.model._address, data._address]
        return np.array([*fixed, *own, len(samples.buffer)], np.int64)

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

    @property
    def collision_object(self) -> str:
        """What was touched first since the last reset; "" for nothing."""
        return self.touches.first.object if self.touches.first else ""

    @property
    def landed(self) -> bool:
        """Whether the vehicle rests on, or against, something."""
        state = self.state
        return bool(state["contacts"]) and math.hypot(*state["velocity"].tolist()) < AT_REST_M_S

    def camera(self, width: int, height: int) -> FrontCamera:
        """The front camera at a size; made when first asked for, kept. Raises UserError without OpenGL."""
        from uavaccel.sim.camera import make_camera  # what needs no images needs no OpenGL

        if (width, height) not in self._cameras:
            self._cameras[width, height] = make_camera(self.model, width, height)
        return self._cameras[width, height]

    def mounted_camera(self, width: int, height: int) -> MountedCamera:
        """A camera to be pointed anywhere, for pictures up to a size; kept. Raises UserError without OpenGL."""
        from uavaccel.sim.mounted_camera import MountedCamera

        camera = self._mounted_camera
        if camera is None or camera.width_most < width or camera.height_most < height:
            if camera is not None:
                camera.close()
            self._mounted_camera = camera = MountedCamera(self.model, width, height)
        return camera

    def set_lane(self, layout: LaneLayout) -> None:
        """Lay out the lane's obstacles, light and wind anew. Raises UserError in another scene."""
        apply_layout(self.model, self.data, layout)
        self._lane = layout
        self.surroundings_changed()
        self._field["wind"][0] = layout.wind_m_s
        ratios = layout.mass_ratio, layout.thrust_ratio
        set_airframe(self.model, self._parameters, self._own_parameters, *ratios)

    def surroundings_changed(self) -> None:
        """Objects of the model were moved, have come or gone, or look different."""
        for camera in self._cameras.values():
            camera.scene_changed()
        mujoco.mj_kinematics(self.model, self.data)
        self._clearance.surroundings_changed()

    def close(self) -> None:
        """Give back what OpenGL holds."""
        while self._cameras:
            self._cameras.popitem()[1].close()
        if self._mounted_camera is not None:
            self._mounted_camera.close()
            self._mounted_camera = None

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
        autopilot.settle(self._parameters, self._flight)
        hotloop.ENTRY_POINTS.look.ctypes(self._handles_pointer, 0)

    def place(
        self, position_m: Vector, orientation_wxyz: Quaternion = LEVEL, velocity_m_s: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        """Put the vehicle somewhere (NED, wxyz), not turning; its autopilot and rotors go on as they are.

        Raises UserError, and leaves it where it is, below the ground, in an object or above HIGHEST_M.
        """
        self.check_place(position_m, orientation_wxyz)
        mujoco.mj_resetData(self.model, self.data)
        self._set_pose(position_m, orientation_wxyz)
        self.data.qvel[:3] = ned_to_mujoco(velocity_m_s)
        self.state["collision_tick"] = NEVER
        self.state["contacts"] = self.state["contacts_changed"] = 0
        self.touches.clear()
        self._clearance.look_anew()
        self._failed = False
        hotloop.ENTRY_POINTS.look.ctypes(self._handles_pointer, 0)

    def _set_pose(self, position_m: Vector, orientation_wxyz: Quaternion) -> None:
        self.data.qpos[:3] = ned_to_mujoco(position_m)
        self.data.qpos[3:7] = quaternion_ned_to_mujoco(orientation_wxyz)
        mujoco.mj_kinematics(self.model, self.data)

    def check_place(self, position_m: Vector, orientation_wxyz: Quaternion = LEVEL) -> None:
        """Raise UserError, as `place` does, where the vehicle cannot be put."""
        z_m, top_m = position_m[2], self.parameters["ground_altitude_m"] - HIGHEST_M
        if not top_m <= z_m <= 0.0:
            raise UserError(
                f"position: NED z has to be from {top_m:g} (thin air) to 0 m (the ground), not {z_m:g}"
            )
        if self.freeze_on_collision:  # nothing is thrown: the game is over before it began
            return
        before = self._physics()
        self._clearance.look_anew()
        self._set_pose(position_m, orientation_wxyz)
        mujoco.mj_collision(self.model, self.data)
        depth_m, name = deepest_contact(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, before, PHYSICS)
        mujoco.mj_kinematics(self.model, self.data)
        if depth_m > DEEPEST_M:
            raise UserError(f"position: {position_m} m is {depth_m:.2g} m inside {name}")

    def advance(self, ticks: int) -> int:
        """Fly up to `ticks` ticks; returns how many: fewer where a touch freezes the vehicle.

        Raises FlightError when MuJoCo warns; the vehicle then stands still until it is placed anew.
        """
        if self._failed or (self.freeze_on_collision and self.collision_tick is not None):
            return int(hotloop.ENTRY_POINTS.stand_still.ctypes(self._handles_pointer, ticks))
        flown = self._fly(ticks)
        if self._warnings.any():
            self._failed = True
            kind = mujoco.mjtWarning(int(np.flatnonzero(self._warnings)[0])).name
            raise FlightError(f"MuJoCo warned of {kind} at tick {self.tick}")
        return flown

    def _fly(self, ticks: int) -> int:
        flown, field = 0, self._field
        while flown < ticks:
            tick = int(field["tick"][0])
            due = self._clearance.ticks_to_fly(tick, ticks - flown, self.parameters, self.state)
            flown += int(hotloop.ENTRY_POINTS.fly.ctypes(self._handles_pointer, due))
            if field["contacts_changed"][0]:
                field["contacts_changed"][0] = 0
                self.touches.look(int(field["contact_tick"][0]), field["contact_position"][0])
                if self.freeze_on_collision:
                    break
        return flown

    def fly_velocity(self, goal: VelocityGoal) -> None:
        """Set the autopilot's goal."""
        field, (vx, vy, vz) = self._field, goal.velocity_m_s
        held = goal.height_m is not None
        field["goal"][0] = (vx, vy, goal.height_m if held else vz, goal.yaw)
        field["xy_mode"][0] = autopilot.VELOCITY
        field["z_mode"][0] = autopilot.POSITION if held else autopilot.VELOCITY
        field["yaw_mode"][0] = autopilot.RATE if goal.yaw_is_rate else autopilot.ANGLE

    def hold_from(self, tick: int | None) -> None:
        """Position hold sets in at `tick`; None: not at all."""
        self._field["hover_tick"][0] = NEVER if tick is None else tick

    def kinematics(self, origin_ns: int = 0) -> Kinematics:
        """The state at the present tick, NED and FRD; `origin_ns` is the simulated time of tick 0."""
        n = tuple(self._kinematics.tolist())
        time_ns = origin_ns + self.tick * self.profile.tick_ns
        return Kinematics(time_ns, n[0:3], n[3:7], n[7:10], n[10:13], n[13:16], n[16:19])

    def get_state(self) -> State:
        """All that the flight depends on, for np.savez or, with units.plain, JSON.

        `World(scene, profile).set_state(world.get_state())` flies on to the same bytes, in another process too; the
        lane's layout and the samples recorded so far are in it.
        """
        state: State = {"scene": self.scene, "profile": self.profile.name, "failed": self._failed}
        state |= {"physics": self._physics(), "warnings": self._warnings.copy()}
        state |= under("flight", of_record(self._flight)) | under("samples", self._samples.get_state())
        state |= under("touches", self.touches.get_state()) | under("contacts", self._clearance.get_state())
        return state | (under("lane", vars(self._lane)) if self._lane else {})

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Back to what `get_state` gave. Raises UserError for the state of another scene or profile."""
        for name, own in (("scene", self.scene), ("profile", self.profile.name)):
            if str(state[name]) != own:
                raise UserError(f"the saved state's {name} is {state[name]}, not {own}")
        self._failed = bool(state["failed"])
        if lane := part("lane", state):
            self.set_lane(layout_of(lane))
        mujoco.mj_setState(self.model, self.data, np.asarray(state["physics"], float), PHYSICS)
        mujoco.mj_kinematics(self.model, self.data)
        self._warnings[:] = state["warnings"]
        into_record(self._flight, part("flight", state))
        self._samples.set_state(part("samples", state))
        self.touches.set_state(part("touches", state))
        self._clearance.set_state(part("contacts", state))

    def _physics(self) -> NDArray[np.float64]:
        values = np.empty(mujoco.mj_stateSize(self.model, PHYSICS))
        mujoco.mj_getState(self.model, self.data, values, PHYSICS)
        return values

    @property
    def recording(self) -> bool:
        return self._samples.running

    def start_recording(self) -> None:
        """Sample the state at this tick and then on the profile's grid, into an emptied buffer."""
        self._samples.start(self.tick)
        hotloop.ENTRY_POINTS.stand_still.ctypes(self._handles_pointer, 0)

    def stop_recording(self) -> None:
        self._samples.stop()

    def samples(self) -> NDArray[np.float64]:
        """Copy of the recorded rows (n, 14): tick, position, wxyz, velocity, body rate."""
        return self._samples.rows()

    def take_samples(self) -> NDArray[np.float64]:
        """The recorded rows, as `samples`, and room for as many anew; the recorder's grid goes on."""
        return self._samples.take()

    @property
    def samples_dropped(self) -> int:
        """Samples that found the buffer full."""
        return self._samples.dropped
