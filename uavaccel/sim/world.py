"""A MuJoCo scene with its quadrotors, stepped in whole ticks, without wall time, commands or threads."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from uavaccel.errors import UserError
from uavaccel.kinematics import Quaternion, Vector
from uavaccel.sim.clutter import ClutterLayout, apply_clutter
from uavaccel.sim.lane import LaneLayout, apply_layout, object_name
from uavaccel.sim.poses import DEEPEST_M, HERE, LEVEL, check_apart, check_bounds, check_name, check_wind
from uavaccel.sim.profile import Profile
from uavaccel.sim.scene import PLAIN, copy_objects, load_scene, physics_state, restore_physics, scene_path
from uavaccel.sim.vehicle import hotloop
from uavaccel.sim.vehicle.clearance import Clearance
from uavaccel.sim.vehicle.resting import beside_objects, depth, on_the_ground, stand
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Motion, Samples, Start, Vehicle
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:
    from uavaccel.sim.camera.camera import Camera, MountedCamera

START_M = (0.0, 0.0, -10.0)  # a game starts from a settled hover 10 m up
VEHICLE = "SimpleFlight"
GAME_SCENES = ("lane", "clutter")  # a contact ends a game there
MOST_VEHICLES = 100
SETTLING_S, SETTLING_CHECKS_PER_S = 300, 10  # a vehicle has settled that rests for a second


class FlightError(RuntimeError):
    """MuJoCo warned of a state that it cannot integrate; the game is void."""


class World:
    """A scene of assets/mjcf with its quadrotors, flown by SimpleFlight's cascade.

    `airsim` prepares the scene for AirSim's clients (uavaccel.sim.scene). In the lane a vehicle freezes at its
    first contact, which ends a game; in other scenes MuJoCo's contact forces act. Methods without a vehicle refer to
    the first one, `lead`.
    """

    def __init__(self, scene: str, profile: Profile, airsim: bool = False) -> None:
        self.profile = profile
        self.freeze_on_collision = scene in GAME_SCENES
        # AirSim's ComputerVision mode: vehicles do not fly, but stay where they are put
        self.still = False
        self._airsim = airsim
        self._mounted_camera: MountedCamera | None = None
        self.scene, self.scenery = scene, PLAIN
        self.lane: LaneLayout | None = None
        self.clutter: ClutterLayout | None = None
        self._cameras: dict[tuple[int, int], Camera] = {}
        self._observers: list[tuple[int, int, Callable[[int], None]]] = []
        self.called: Callable[[str], str] = str
        """Returns clients' name of the object with a geom's name."""
        self.revision = 0
        """Grows whenever objects or vehicles were added, removed or moved, or look different."""
        self.recorder = Samples(profile.recorder_ticks)
        acts = not self.freeze_on_collision
        self.lead = Vehicle(VEHICLE, profile, Start(START_M), self.recorder, contacts_act=acts)
        self.vehicles = [self.lead]
        self._adopt(*self._build(self.vehicles))
        self.reset()

    def _build(self, vehicles: Sequence[Vehicle]) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Build a model for these vehicles, without changing the world, which an error leaves as it was."""
        model = load_scene(self.scene, [vehicle.prefix for vehicle in vehicles[1:]], self._airsim, self.scenery)
        model.opt.timestep = self.profile.tick_s
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        for vehicle in vehicles:
            model.body(vehicle.body)  # raises KeyError where MuJoCo has made another name of it
        return model, mujoco.MjData(model)

    def _adopt(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Simulate this model from now on."""
        self.model, self.data = model, data
        self.revision += 1
        self.warnings = self.data.warning.number
        self.clearance = Clearance(self.model, self.data)
        for vehicle in self.vehicles:
            vehicle.bind(self.model, self.data, self.name_of)
        self._bodies = {vehicle.body_id: vehicle.name for vehicle in self.vehicles}
        rows = [vehicle.handles for vehicle in self.vehicles]
        self._handles = np.concatenate([[len(rows)], *rows]).astype(np.int64)
        self._handles_pointer = self._handles.ctypes.data_as(ctypes.POINTER(ctypes.c_int64))

    def name_of(self, geom: int) -> str:
        """Return the name of the object or vehicle that a geom belongs to."""
        return self._bodies.get(int(self.model.geom_bodyid[geom])) or object_name(self.model, geom)

    # --- scene ------------------------------------------------------------------------------------

    def camera(self, width: int, height: int) -> Camera:
        """Return the front camera of a size, made at the first request. Raises UserError without OpenGL."""
        from uavaccel.sim.camera.camera import make_camera  # without images no OpenGL is needed

        if (width, height) not in self._cameras:
            self._cameras[width, height] = make_camera(self.model, width, height)
        return self._cameras[width, height]

    def mounted_camera(self, width: int, height: int) -> MountedCamera:
        """Return a camera that can be placed anywhere, for pictures up to a size. Raises UserError without OpenGL."""
        from uavaccel.sim.camera.camera import MountedCamera

        camera = self._mounted_camera
        if camera is None or camera.width_most < width or camera.height_most < height:
            if camera is not None:
                camera.close()
            self._mounted_camera = camera = MountedCamera(self.model, width, height)
        return camera

    def set_lane(self, layout: LaneLayout) -> None:
        """Set the lane's obstacles, light and wind, and the vehicle's mass and thrust. Raises UserError elsewhere.

        Another scenery needs another MuJoCo model: cameras are made anew, and the vehicle continues its flight there.
        """
        if layout.scenery != self.scenery:
            scene_path(self.scene, layout.scenery)  # raises UserError before anything changes
            physics = physics_state(self.model, self.data)
            self.close()
            self.scenery = layout.scenery
            self._adopt(*self._build(self.vehicles))
            restore_physics(self.model, self.data, physics)
        apply_layout(self.model, self.data, layout)
        self.lane = layout
        self.surroundings_changed()
        self.lead.state["wind"] = layout.wind_m_s
        self.lead.set_airframe(layout.mass_ratio, layout.thrust_ratio)

    def set_clutter(self, layout: ClutterLayout) -> None:
        """Place the shapes of a world of clutter. Raises UserError in other scenes."""
        apply_clutter(self.model, self.data, layout)
        self.clutter = layout
        self.surroundings_changed()

    def surroundings_changed(self) -> None:
        """Note that objects of the model were moved, added or removed, or look different."""
        self.revision += 1
        mujoco.mj_kinematics(self.model, self.data)
        self.clearance.surroundings_changed()

    def set_wind(self, wind_m_s: Vector) -> None:
        """Set the wind, NED, for all vehicles. Raises ValueError beyond STRONGEST_WIND_M_S."""
        check_wind(wind_m_s)
        for vehicle in self.vehicles:
            vehicle.state["wind"] = wind_m_s
        self.clearance.check_now()

    def add_vehicles(self, newcomers: Sequence[AddedVehicle]) -> None:
        """Add vehicles at their starts, while the others continue their flights. Cameras are made anew.

        Raises UserError, and adds none, for an invalid name, for a start that is not possible, and in the lane.
        """
        if self.freeze_on_collision or len(self.vehicles) + len(newcomers) > MOST_VEHICLES:
            raise UserError(f"no vehicle can be added: at most {MOST_VEHICLES}, and one in the lane")
        places = {vehicle.name: vehicle.place_m for vehicle in self.vehicles}
        for name, start, _ in newcomers:
            check_name(name, places)
            self.check_place(start.position_m, start.orientation_wxyz)
            check_apart(name, start.position_m, places)
            places[name] = start.position_m
        motions, wind = [old.motion() for old in self.vehicles], self.lead.state["wind"].copy()
        ticks = self.tick
        new = [
            Vehicle(name, self.profile, start, Samples(self.profile.recorder_ticks, 0), f"{name}/", origin_m)
            for name, start, origin_m in newcomers
        ]
        made, before = self._build([*self.vehicles, *new]), self.model
        self.vehicles += new
        self.close()
        self._adopt(*made)
        copy_objects(before, self.model)
        for old, motion in zip(self.vehicles, motions, strict=False):
            old.fly_on(motion)
        for vehicle in new:
            vehicle.state["wind"] = wind
            vehicle.parameters["ground_altitude_m"] = self.lead.parameters["ground_altitude_m"]
        self._begin({vehicle: vehicle.start for vehicle in new}, ticks)

    def close(self) -> None:
        """Free what OpenGL holds."""
        while self._cameras:
            self._cameras.popitem()[1].close()
        if self._mounted_camera is not None:
            self._mounted_camera.close()
            self._mounted_camera = None

    # --- places -----------------------------------------------------------------------------------

    def reset(self, position_m: Vector | None = None, orientation_wxyz: Quaternion = LEVEL) -> None:
        """Go back to tick 0 with every vehicle at its start; the first hovers at `position_m`, NED, if that is given.

        The recorder stops. Raises UserError where no vehicle can hover.
        """
        start = self.lead.start if position_m is None else Start(position_m, orientation_wxyz)
        self.check_place(start.position_m, start.orientation_wxyz)
        self.recorder.stop()
        mujoco.mj_resetData(self.model, self.data)
        self._begin({vehicle: vehicle.start for vehicle in self.vehicles} | {self.lead: start}, 0)
        self.failed = False

    def _begin(self, starts: Mapping[Vehicle, Start], tick: int) -> None:
        """Start vehicles at a tick; idle ones that touch something stand on it."""
        for vehicle, start in starts.items():
            vehicle.begin(start)
            vehicle.state["tick"] = tick
        self._moved()
        for vehicle, start in starts.items():
            if start.idle and not (self.freeze_on_collision or self.still):
                stand(vehicle)

    def _moved(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
        self.clearance.check_now()

    def teleport(
        self,
        vehicle: Vehicle,
        position_m: Vector,
        orientation_wxyz: Quaternion,
        velocity_m_s: Vector | None = None,
        rate_rad_s: Vector = HERE,
        anywhere: bool = False,
    ) -> None:
        """Put a vehicle at a pose (NED of the world, wxyz), with its present velocity or the given one.

        A position below the ground is moved up to it, with `anywhere` one inside an object to the nearest outside.
        Earlier contacts stay in the log (MultirotorPawnSimApi::setPose). Raises UserError, without moving it, as
        `check_place` does.
        """
        if not self.still:
            self.clearance.check_now()
            position_m = on_the_ground(vehicle, position_m, orientation_wxyz)
            if anywhere and not self.freeze_on_collision:
                position_m = beside_objects(vehicle, position_m, orientation_wxyz)
        self.check_place(position_m, orientation_wxyz, vehicle)
        if self.failed:  # its velocity is not finite
            self.warnings[:] = 0
            vehicle.put(position_m, orientation_wxyz)
            self.failed = False
        vehicle.move(position_m, orientation_wxyz)
        if velocity_m_s is not None:
            vehicle.set_velocity(velocity_m_s, rate_rad_s)
        if self.freeze_on_collision:
            vehicle.clear_contacts()
        self._moved()

    def resume(self, motion: Motion, share: float) -> None:
        """Let the first vehicle fly on from where it is as it did in `motion`, its velocity scaled by `share`.

        A vehicle that a contact has frozen stays as it is.
        """
        if not self._frozen:
            self.lead.resume(motion, share)
            self.clearance.check_now()

    def check_place(
        self, position_m: Vector, orientation_wxyz: Quaternion = LEVEL, vehicle: Vehicle | None = None
    ) -> None:
        """Raise UserError for a pose where a vehicle cannot be: below the ground, in an object, or above HIGHEST_M."""
        vehicle = vehicle or self.lead
        check_bounds(position_m, float(vehicle.parameters["ground_altitude_m"]), self.still)
        if self.freeze_on_collision or self.still:  # contact forces cannot throw the vehicle
            return
        self.clearance.check_now()
        depth_m, geom = depth(vehicle, position_m, orientation_wxyz)
        if depth_m > DEEPEST_M:
            raise UserError(f"position: {position_m} m is {depth_m:.2g} m inside {self.called(self.name_of(geom))}")

    def penetration(self, vehicle: Vehicle) -> tuple[float, str]:
        """Return how deep, in m, a vehicle is in what it now touches, and the name of that; (0, "") without any."""
        if not vehicle.field["contacts"][0]:
            return 0.0, ""
        depth_m, geom = depth(vehicle, vehicle.place_m, vehicle.kinematics().orientation_wxyz)
        return (max(depth_m, 0.0), self.name_of(geom)) if geom >= 0 else (0.0, "")

    def settle(self) -> None:
        """Let idle vehicles that start in the air fall until they rest, for SETTLING_S at most; tick 0 is then."""
        idle = [vehicle for vehicle in self.vehicles if vehicle.start.idle]
        if self.still or self.freeze_on_collision or all(vehicle.landed for vehicle in idle):
            return
        a_second, rested = NS_PER_S // self.profile.tick_ns, 0
        while rested < SETTLING_CHECKS_PER_S and self.tick < SETTLING_S * a_second:
            self._advance(a_second // SETTLING_CHECKS_PER_S)
            rested = rested + 1 if all(vehicle.landed for vehicle in idle) else 0
        for vehicle in self.vehicles:
            touches = vehicle.state["contacts"]
            vehicle.state["tick"] = 0
            vehicle.clear_contacts()
            if touches:
                vehicle.stand()
        self._moved()

    @property
    def tick(self) -> int:
        """Physics steps since the last reset."""
        return self.lead.tick

    # --- time -------------------------------------------------------------------------------------

    def watch(self, every_ticks: int, observe: Callable[[int], None], first_tick: int = 0) -> Callable[[], None]:
        """Call `observe(tick)` every `every_ticks` ticks, counted from `first_tick`; the returned function stops that.

        Calls come in the middle of `advance` and do not change the flight.
        """
        observer = every_ticks, first_tick, observe
        self._observers.append(observer)
        return lambda: self._observers.remove(observer)

    def advance(self, ticks: int) -> int:
        """Advance up to `ticks` ticks and return how many: fewer if a contact freezes the vehicle.

        Watchers are not called for a frozen vehicle. Raises FlightError if MuJoCo warns; after that the vehicles stand
        still until one is placed again.
        """
        flown = 0
        while self._observers and flown < ticks and not self._frozen:
            to_next = min(every - (self.tick - first) % every for every, first, _ in self._observers)
            due = min(ticks - flown, to_next)
            chunk = self._advance(due)
            flown += chunk
            if chunk < due:  # a contact
                break
            for every, first, observe in tuple(self._observers):  # one may end itself
                if (self.tick - first) % every == 0:
                    observe(self.tick)
        return flown or self._advance(ticks)

    @property
    def _frozen(self) -> bool:
        return self.freeze_on_collision and self.lead.collision_tick is not None

    def _advance(self, ticks: int) -> int:
        if self.still or self.failed or self._frozen:
            return max(vehicle.rest(ticks) for vehicle in self.vehicles)
        flown = self._fly(ticks) if len(self.vehicles) == 1 else self._fly_all(ticks)
        if self.warnings.any():
            self.failed = True
            kind = mujoco.mjtWarning(int(np.flatnonzero(self.warnings)[0])).name
            raise FlightError(f"MuJoCo warned of {kind} at tick {self.tick}")
        return flown

    def _fly(self, ticks: int) -> int:
        lead, flown, field = self.lead, 0, self.lead.field
        while flown < ticks:
            tick = int(field["tick"][0])
            due = self.clearance.ticks_to_fly(tick, ticks - flown, lead.parameters, lead.state)
            if self.clearance.left_out and not field["contacts"][0]:
                flown += lead.fly_free(due)
                continue
            flown += lead.fly(due)
            if field["contacts_changed"][0]:
                self._log_contacts(lead)
                if self.freeze_on_collision:
                    break
        return flown

    def _fly_all(self, ticks: int) -> int:
        """Advance several vehicles, always with contact detection, since they may collide."""
        flown = 0
        while flown < ticks:
            flown += int(hotloop.ENTRY_POINTS.fly_all.ctypes(self._handles_pointer, ticks - flown))
            for vehicle in self.vehicles:
                if vehicle.field["contacts_changed"][0]:
                    self._log_contacts(vehicle)
        return flown

    def _log_contacts(self, vehicle: Vehicle) -> None:
        field = vehicle.field
        field["contacts_changed"][0] = 0
        vehicle.contact_log.log(int(field["contact_tick"][0]), field["contact_position"][0])

    # --- recording --------------------------------------------------------------------------------

    def start_recording(self) -> None:
        """Record samples into an emptied buffer, at this tick and then at the profile's interval."""
        self.recorder.start(self.tick)
        self.lead.rest(0)
