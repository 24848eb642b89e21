"""The drones of one MuJoCo scene, stepped together in whole ticks. No wall time, no commands, no threads."""

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
from uavaccel.sim import hotloop
from uavaccel.sim.clearance import Clearance
from uavaccel.sim.flight.goal import of_velocity
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.sim.lane.scene import apply_layout, object_name
from uavaccel.sim.profile import Profile
from uavaccel.sim.quadrotor import Record
from uavaccel.sim.samples import Samples
from uavaccel.sim.saved import State, layout_of, part, under
from uavaccel.sim.scene import load_scene
from uavaccel.sim.touch import Touches, deepest_contact
from uavaccel.sim.vehicle import HERE, LEVEL, Start, Vehicle
from uavaccel.units import mujoco_to_ned

if TYPE_CHECKING:
    from uavaccel.sim.camera import FrontCamera

PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION)
HIGHEST_M = 20_000.0  # over the sea, as high as air_density follows the standard atmosphere
FARTHEST_M = 10_000.0  # north or east: farther away the physics loses its millimetres
STRONGEST_WIND_M_S = 100.0  # beyond it a tick's drag exceeds the speed that it brakes
DEEPEST_M = 0.05  # into what it is placed on; from deeper contacts would throw the vehicle
START_M = (0.0, 0.0, -10.0)  # a game starts from a settled hover 10 m up
VEHICLE = "SimpleFlight"
MOST_VEHICLES = 100
APART_M = 0.75  # between the middles of two vehicles, so that they do not touch


class FlightError(RuntimeError):
    """MuJoCo warned of a state it could not integrate; the game is void."""


class World:
    """A scene of assets/mjcf with its quadrotors, flown by SimpleFlight's cascade; the first one leads.

    In the lane the vehicle is frozen where it first touches anything, which ends a game; in other scenes MuJoCo's
    contacts act. Where no vehicle is named, the leading one is meant.
    """

    def __init__(self, scene: str, profile: Profile) -> None:
        self.profile = profile
        self.freeze_on_collision = scene == "lane"
        self._scene = scene
        self._lane: LaneLayout | None = None
        self._cameras: dict[tuple[int, int], FrontCamera] = {}
        self._samples = Samples(profile.recorder_ticks)
        acts = not self.freeze_on_collision
        self.lead = Vehicle(VEHICLE, profile, Start(START_M), self._samples, contacts_act=acts)
        self.vehicles = [self.lead]
        self._load()
        self.reset()

    def _load(self) -> None:
        """Make the model for the vehicles that there are."""
        self.model = load_scene(self._scene, [vehicle.prefix for vehicle in self.vehicles[1:]])
        self.model.opt.timestep = self.profile.tick_s
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self._warnings = self.data.warning.number
        self._clearance = Clearance(self.model, self.data)
        for vehicle in self.vehicles:
            vehicle.bind(self.model, self.data, self._name_of)
        self._bodies = {vehicle.body_id: vehicle.name for vehicle in self.vehicles}
        rows = [vehicle.handles for vehicle in self.vehicles]
        self._handles = np.concatenate([[len(rows)], *rows]).astype(np.int64)
        self._handles_pointer = self._handles.ctypes.data_as(ctypes.POINTER(ctypes.c_int64))

    def _name_of(self, geom: int) -> str:
        """The object, or the other vehicle, that a geom belongs to."""
        return self._bodies.get(int(self.model.geom_bodyid[geom])) or object_name(self.model, geom)

    # --- the leading vehicle ----------------------------------------------------------------------

    @property
    def parameters(self) -> Record:
        """Of the leading quadrotor and its autopilot (quadrotor.PARAMETERS_DTYPE)."""
        return self.lead.parameters

    @property
    def state(self) -> Record:
        """Of the leading vehicle's flight (quadrotor.FLIGHT_DTYPE)."""
        return self.lead.state

    @property
    def tick(self) -> int:
        return self.lead.tick

    @property
    def collision_tick(self) -> int | None:
        """Tick of the first touch since the last reset."""
        return self.lead.collision_tick

    @property
    def collision_object(self) -> str:
        """What was touched first since the last reset; "" for nothing."""
        first = self.lead.touches.first
        return first.object if first else ""

    @property
    def touches(self) -> Touches:
        return self.lead.touches

    @property
    def landed(self) -> bool:
        return self.lead.landed

    def kinematics(self, origin_ns: int = 0) -> Kinematics:
        """The state at the present tick, NED and FRD; `origin_ns` is the simulated time of tick 0."""
        return self.lead.kinematics(origin_ns)

    def fly_velocity(self, goal: VelocityGoal) -> None:
        """Set the autopilot's goal to a velocity."""
        self.lead.set_goal(of_velocity(goal))

    def hold_from(self, tick: int | None) -> None:
        """Position hold sets in at `tick`; None: not at all."""
        self.lead.hold_from(tick)

    # --- scene ------------------------------------------------------------------------------------

    def camera(self, width: int, height: int) -> FrontCamera:
        """The front camera at a size; made when first asked for, kept. Raises UserError without OpenGL."""
        from uavaccel.sim.camera import make_camera  # what needs no images needs no OpenGL

        if (width, height) not in self._cameras:
            self._cameras[width, height] = make_camera(self.model, width, height)
        return self._cameras[width, height]

    def set_lane(self, layout: LaneLayout) -> None:
        """Lay out the lane's obstacles, light and wind anew. Raises UserError in another scene."""
        apply_layout(self.model, self.data, layout)
        self._lane = layout
        for camera in self._cameras.values():
            camera.scene_changed()
        self._clearance.look_anew()
        self.lead.state["wind"] = layout.wind_m_s

    def set_wind(self, wind_m_s: Vector) -> None:
        """NED, for all vehicles. Raises UserError beyond STRONGEST_WIND_M_S."""
        if not np.linalg.norm(wind_m_s) <= STRONGEST_WIND_M_S:
            raise UserError(f"wind: {wind_m_s} m/s is not a wind of at most {STRONGEST_WIND_M_S:g} m/s")
        for vehicle in self.vehicles:
            vehicle.state["wind"] = wind_m_s
        self._clearance.look_anew()

    def add_vehicle(self, name: str, start: Start, origin_m: Vector = HERE) -> Vehicle:
        """One vehicle more, at its start; the others fly on. Cameras are made anew.

        Raises UserError for a name that is taken or cannot be, for a place where nothing can begin, and in the lane.
        """
        if self.freeze_on_collision or len(self.vehicles) == MOST_VEHICLES:
            raise UserError(f"no vehicle can be added: at most {MOST_VEHICLES}, and one in the lane")
        if not name or "/" in name or name in (vehicle.name for vehicle in self.vehicles):
            raise UserError(f"a vehicle cannot be called {name!r}: names differ, and hold no /")
        self.check_place(start.position_m, start.orientation_wxyz)
        for other in self.vehicles:
            if math.dist(start.position_m, mujoco_to_ned(other.qpos[:3])) < APART_M:
                raise UserError(f"{name} would start less than {APART_M:g} m from {other.name}")
        kept = [vehicle.carry() for vehicle in self.vehicles]
        vehicle = Vehicle(name, self.profile, start, Samples(self.profile.recorder_ticks, 0), f"{name}/")
        vehicle.origin_m = origin_m
        self.vehicles.append(vehicle)
        self.close()
        self._load()
        for old, carried in zip(self.vehicles, kept, strict=False):
            old.take_over(carried)
        vehicle.state["wind"] = self.lead.state["wind"]
        self._begin(vehicle, start)
        vehicle.state["tick"] = self.tick
        return vehicle

    def close(self) -> None:
        """Give back what OpenGL holds."""
        while self._cameras:
            self._cameras.popitem()[1].close()

    # --- places -----------------------------------------------------------------------------------

    def reset(self, position_m: Vector | None = None, orientation_wxyz: Quaternion = LEVEL) -> None:
        """Tick 0: every vehicle at its start, the leading one at rest in a settled position hold where one is given.

        The recorder stops.
        """
        start = self.lead.start if position_m is None else Start(position_m, orientation_wxyz)
        self.check_place(start.position_m, start.orientation_wxyz)
        self.stop_recording()
        mujoco.mj_resetData(self.model, self.data)
        self._begin(self.lead, start)
        for vehicle in self.vehicles[1:]:
            self._begin(vehicle, vehicle.start)
        self._failed = False

    def _begin(self, vehicle: Vehicle, start: Start) -> None:
        vehicle.begin(start)
        self._moved()

    def _moved(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
        self._clearance.look_anew()

    def place(
        self, position_m: Vector, orientation_wxyz: Quaternion = LEVEL, velocity_m_s: Vector = HERE
    ) -> None:
        """Put the leading vehicle somewhere (NED, wxyz), not turning; its autopilot and rotors go on as they are.

        Raises UserError, and leaves it where it is, below the ground, in an object or above HIGHEST_M.
        """
        self.check_place(position_m, orientation_wxyz)
        if len(self.vehicles) == 1:
            mujoco.mj_resetData(self.model, self.data)
        self._warnings[:] = 0
        self.lead.put(position_m, orientation_wxyz, velocity_m_s)
        self.lead.forget_touches()
        self._moved()
        self._failed = False

    def teleport(
        self,
        vehicle: Vehicle,
        position_m: Vector,
        orientation_wxyz: Quaternion,
        velocity_m_s: Vector | None = None,
        rate_rad_s: Vector = HERE,
    ) -> None:
        """Put a vehicle somewhere (NED of the world, wxyz), as fast as it is or as is said; all else goes on.

        What it has touched stays told (MultirotorPawnSimApi::setPose). Raises UserError as `place` does.
        """
        self.check_place(position_m, orientation_wxyz, vehicle)
        if self._failed:  # nothing of its velocity is worth keeping
            self._warnings[:] = 0
            vehicle.put(position_m, orientation_wxyz)
            self._failed = False
        vehicle.move(position_m, orientation_wxyz)
        if velocity_m_s is not None:
            vehicle.set_velocity(velocity_m_s, rate_rad_s)
        if self.freeze_on_collision:
            vehicle.forget_touches()
        self._moved()

    def check_place(
        self, position_m: Vector, orientation_wxyz: Quaternion = LEVEL, vehicle: Vehicle | None = None
    ) -> None:
        """Raise UserError, as `place` does, where a vehicle cannot be put."""
        vehicle, z_m = vehicle or self.lead, position_m[2]
        top_m = self.parameters["ground_altitude_m"] - HIGHEST_M
        if not top_m <= z_m <= 0.0:
            raise UserError(
                f"position: NED z has to be from {top_m:g} (thin air) to 0 m (the ground), not {z_m:g}"
            )
        if not max(abs(position_m[0]), abs(position_m[1])) <= FARTHEST_M:
            raise UserError(f"position: north and east have to be within {FARTHEST_M:g} m, not {position_m}")
        if self.freeze_on_collision:  # nothing is thrown: the game is over before it began
            return
        before = self._physics()
        self._clearance.look_anew()
        vehicle.set_pose(position_m, orientation_wxyz)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        depth_m, geom = deepest_contact(self.model, self.data, vehicle.body_id)
        mujoco.mj_setState(self.model, self.data, before, PHYSICS)
        mujoco.mj_kinematics(self.model, self.data)
        if depth_m > DEEPEST_M:
            raise UserError(f"position: {position_m} m is {depth_m:.2g} m inside {self._name_of(geom)}")

    # --- time -------------------------------------------------------------------------------------

    def advance(self, ticks: int) -> int:
        """Fly up to `ticks` ticks; returns how many: fewer where a touch freezes the vehicle.

        Raises FlightError when MuJoCo warns; the vehicles then stand still until one is placed anew.
        """
        if self._failed or (self.freeze_on_collision and self.collision_tick is not None):
            return max(vehicle.stand_still(ticks) for vehicle in self.vehicles)
        flown = self._fly(ticks) if len(self.vehicles) == 1 else self._fly_all(ticks)
        if self._warnings.any():
            self._failed = True
            kind = mujoco.mjtWarning(int(np.flatnonzero(self._warnings)[0])).name
            raise FlightError(f"MuJoCo warned of {kind} at tick {self.tick}")
        return flown

    def _fly(self, ticks: int) -> int:
        lead, flown, field = self.lead, 0, self.lead.field
        while flown < ticks:
            tick = int(field["tick"][0])
            due = self._clearance.ticks_to_fly(tick, ticks - flown, lead.parameters, lead.state)
            flown += lead.fly(due)
            if field["contacts_changed"][0]:
                self._look_at_contacts(lead)
                if self.freeze_on_collision:
                    break
        return flown

    def _fly_all(self, ticks: int) -> int:
        """Contacts are always looked for: vehicles move, and may meet."""
        flown = 0
        while flown < ticks:
            flown += int(hotloop.ENTRY_POINTS.fly_all.ctypes(self._handles_pointer, ticks - flown))
            for vehicle in self.vehicles:
                if vehicle.field["contacts_changed"][0]:
                    self._look_at_contacts(vehicle)
        return flown

    def _look_at_contacts(self, vehicle: Vehicle) -> None:
        field = vehicle.field
        field["contacts_changed"][0] = 0
        vehicle.touches.look(int(field["contact_tick"][0]), field["contact_position"][0])

    # --- saving -----------------------------------------------------------------------------------

    def get_state(self) -> State:
        """All that the flight depends on, for np.savez or, with units.plain, JSON.

        `World(scene, profile).set_state(world.get_state())` flies on to the same bytes, in another process too; the
        lane's layout and the samples recorded so far are in it.
        """
        state: State = {"scene": self._scene, "profile": self.profile.name, "failed": self._failed}
        state |= {"physics": self._physics(), "warnings": self._warnings.copy()}
        state |= self.lead.get_state() | under("samples", self._samples.get_state())
        state |= under("contacts", self._clearance.get_state())
        for vehicle in self.vehicles[1:]:
            state |= under(f"vehicles.{vehicle.name}", vehicle.get_state())
        return state | (under("lane", vars(self._lane)) if self._lane else {})

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Back to what `get_state` gave. Raises UserError for the state of another scene, profile or vehicles."""
        own_vehicles = {vehicle.name for vehicle in self.vehicles[1:]}
        saved = {key.split(".")[1] for key in state if key.startswith("vehicles.")}
        for name, found, own in (
            ("scene", str(state["scene"]), self._scene),
            ("profile", str(state["profile"]), self.profile.name),
            ("vehicles", sorted(saved), sorted(own_vehicles)),
        ):
            if found != own:
                raise UserError(f"the saved state's {name} is {found}, not {own}")
        self._failed = bool(state["failed"])
        if lane := part("lane", state):
            self.set_lane(layout_of(lane))
        mujoco.mj_setState(self.model, self.data, np.asarray(state["physics"], float), PHYSICS)
        mujoco.mj_kinematics(self.model, self.data)
        self._warnings[:] = state["warnings"]
        self.lead.set_state(state)
        for vehicle in self.vehicles[1:]:
            vehicle.set_state(part(f"vehicles.{vehicle.name}", state))
        self._samples.set_state(part("samples", state))
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
        self.lead.stand_still(0)

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
