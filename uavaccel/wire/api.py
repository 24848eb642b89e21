"""AirSim's calls, and a few of our own, on a `Simulation`: names, arity, argument checks, wire types.

The same table serves the socket server and the in-process transport, so a call means the same in every timing.
Source of names, parameter orders and error texts: AirSim v1.8.1, RpcLibServerBase.cpp, MultirotorRpcLibServer.cpp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from uavaccel.errors import UserError
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.sim.flight.pilot import Pilot
from uavaccel.sim.sensors.earth import geographic
from uavaccel.sim.simulation import Simulation
from uavaccel.wire import rpc, types
from uavaccel.wire.attitude_api import AttitudeApi, stick_map
from uavaccel.wire.camera_api import CameraApi
from uavaccel.wire.detection_api import DetectionApi
from uavaccel.wire.flight_api import LONGEST_S, FlightApi
from uavaccel.wire.game_api import GameApi
from uavaccel.wire.image_api import ImageApi
from uavaccel.wire.method import Method
from uavaccel.wire.notices import Notices
from uavaccel.wire.object_api import ObjectApi
from uavaccel.wire.recorder import Recorder
from uavaccel.wire.refusals import Refusals
from uavaccel.wire.scenery import Scenery
from uavaccel.wire.sensor_api import SensorApi
from uavaccel.wire.settings import Settings
from uavaccel.wire.steps import Steps
from uavaccel.wire.vehicle_api import VehicleApi
from uavaccel.wire.vehicles import populate
from uavaccel.wire.world_api import WorldApi

SERVER_VERSION = 4  # satisfies AirSim's client (1) and Cosys-AirSim's (4)
MIN_CLIENT_VERSION = 1
FRAMES_PER_S, MOST_FRAMES = 60, 1e9


class Api:
    """The calls that one simulation answers. `recordings`: the folder for what startRecording records."""

    def __init__(
        self,
        simulation: Simulation,
        settings: Settings | None = None,
        render: bool = True,
        recordings: Path | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.simulation = simulation
        self.settings = settings or Settings()
        populate(simulation, self.settings)
        self.scenery = Scenery(simulation, self.settings, render)
        self.notices = Notices(say)
        self.recorder = Recorder(self.scenery, recordings, say)
        self._images = ImageApi(self.scenery, self._check_vehicle, self.notices)
        self._vehicles = VehicleApi(self.scenery, self.pilot_of)
        self._game = GameApi(simulation, self.recorder)
        self._wall_ns = 0
        self.refusals = Refusals()
        self.methods = self._airsim_methods() | self._image_methods() | self._own_methods()
        self.methods |= self._flight() | self._vehicles.methods() | self._senses()

    def call(self, method: str, params: Sequence[Any], wall_ns: int) -> Any:
        """The result of a call handled at `wall_ns`, or its `DeferredReply`. Raises rpc.RpcError.

        The simulation has to be advanced to `wall_ns` before.
        """
        result = self.begin(method, params, wall_ns)
        if not isinstance(result, Steps):
            return result
        while self.go_on(result, method, params):
            pass
        return result.made

    def go_on(self, steps: Steps, method: str, params: Sequence[Any]) -> bool:
        """Make one more piece of what `begin` gave; False when it is whole. Raises rpc.RpcError."""
        try:
            return steps.advance()
        except Exception as error:  # costs the caller its call and nobody else
            raise rpc.threw(method, len(params), str(error)) from error

    def begin(self, method: str, params: Sequence[Any], wall_ns: int) -> Any:
        """As `call`, but what takes long is begun only: `Steps`, with which to `go_on`."""
        entry = self.methods.get(method)
        if entry is None:
            self.refusals.unknown(method)
            raise rpc.unknown_method(method, len(params))
        try:
            return self._call(entry, method, params, wall_ns)
        except rpc.RpcError as error:
            self.refusals.command(method, error.reason)
            raise

    def _call(self, entry: Method, method: str, params: Sequence[Any], wall_ns: int) -> Any:
        if not entry.required <= len(params) <= entry.most:
            raise rpc.wrong_arity(method, entry.most, len(params))
        self._wall_ns = wall_ns
        if self.simulation.trace.enabled:
            self.simulation.note(f"handle {method}", wall_ns)
        try:
            return entry.handler(*params)
        except (ValueError, UserError) as error:
            raise rpc.threw(method, len(params), str(error)) from error
        except Exception as error:  # costs the caller its call and nobody else, as in rpclib
            raise rpc.threw(method, len(params), f"{type(error).__name__}: {error}") from error

    def _airsim_methods(self) -> dict[str, Method]:
        simulation = self.simulation
        return {
            "ping": Method(lambda: True, 0),
            "getServerVersion": Method(lambda: SERVER_VERSION, 0),
            "getMinRequiredClientVersion": Method(lambda: MIN_CLIENT_VERSION, 0),
            "getSettingsString": Method(lambda: self.settings.as_json(float(simulation.clock_speed)), 0),
            "reset": Method(self._reset, 0),
            "enableApiControl": Method(self._enable_api_control, 1, 1),
            "isApiControlEnabled": Method(self._is_api_control_enabled, 0, 1),
            "armDisarm": Method(self._arm, 1, 1),
            "simPause": Method(self._pause, 1),
            "simIsPaused": Method(lambda: simulation.paused, 0),
            "simContinueForTime": Method(self._continue_for_time, 1),
            "simContinueForFrames": Method(self._continue_for_frames, 1),
            "getMultirotorState": Method(self._multirotor_state, 0, 1),
            "simGetGroundTruthKinematics": Method(self._kinematics, 0, 1),
            "startRecording": Method(lambda: self.recorder.start(self._wall_ns), 0),
            "stopRecording": Method(self.recorder.stop, 0),
            "isRecording": Method(lambda: simulation.world.recording, 0),
        }

    def _image_methods(self) -> dict[str, Method]:
        images = self._images
        return {
            "simGetImages": Method(images.get_images, 1, 2),
            "simGetImage": Method(images.get_image, 2, 2),
            "uavaccelImage": Method(images.raw_image, 1),
            "uavaccelSetLane": Method(images.set_lane, 1),
            "uavaccelCollision": Method(images.collision, 0),
        }

    def _flight(self) -> dict[str, Method]:
        """What a vehicle may be told to fly."""
        flight = FlightApi(self._flown, lambda: self._wall_ns, self.settings.home)
        return flight.methods() | AttitudeApi(self._flown, lambda: self._wall_ns).methods()

    def _senses(self) -> dict[str, Method]:
        """Cameras, objects, sensors and the world at large."""
        scenery, check, notices = self.scenery, self._check_vehicle, self.notices
        methods = CameraApi(scenery, check, notices).methods()
        methods |= ObjectApi(scenery, self._vehicles, notices).methods()
        methods |= DetectionApi(scenery, check).methods()
        methods |= SensorApi(scenery, check).methods()
        return methods | WorldApi(scenery, check, notices).methods()

    def _own_methods(self) -> dict[str, Method]:
        game = self._game
        return {
            "uavaccelContinueFor": Method(lambda duration: game.continue_for(duration, self._wall_ns), 1),
            "uavaccelState": Method(game.state, 0),
            "uavaccelStartGame": Method(lambda *params: game.start(self._wall_ns, *params), 1, 1),
            "uavaccelSetClockSpeed": Method(lambda speed: game.set_clock_speed(speed, self._wall_ns), 1),
            "uavaccelSpeed": Method(game.speed, 0),
            "uavaccelRecording": Method(game.recording, 0),
            "uavaccelTrace": Method(game.trace, 1),
        }

    # --- AirSim -----------------------------------------------------------------------------------

    def pilot_of(self, name: Any) -> Pilot:
        """Who flies a vehicle; "" is the first. Raises ValueError, in AirSim's words, for an unknown name."""
        pilots = self.simulation.pilots
        for pilot in pilots:
            if name in ("", pilot.vehicle.name):
                return pilot
        raise self._not_there(name)

    def _not_there(self, name: Any) -> ValueError:
        known = ", ".join(f"'{pilot.vehicle.name}'" for pilot in self.simulation.pilots)
        return ValueError(
            f"Vehicle API for '{name}' is not available. This could either because this is simulation"
            f"-only API or this vehicle does not exist; there is {known}"
        )

    def _flown(self, name: Any) -> Pilot:
        """Who flies a vehicle, where vehicles fly. Raises ValueError, in AirSim's words, as pilot_of does."""
        if self.settings.flightless:
            raise self._not_there(name)
        return self.pilot_of(name)

    def _check_vehicle(self, name: Any) -> None:
        """Raises ValueError as pilot_of does."""
        self.pilot_of(name)

    def _reset(self) -> None:
        """A recording goes on through it, as in AirSim."""
        self.recorder.go_through(lambda recording: self.simulation.reset(self._wall_ns, recording=recording))

    def _enable_api_control(self, enabled: Any, vehicle: Any = "") -> None:
        pilot, enabled = self._flown(vehicle), types.flag(enabled, "is_enabled")
        if not enabled:  # a command that runs on would have no end
            pilot.cancel(self._wall_ns)
        pilot.api_control = enabled

    def _is_api_control_enabled(self, vehicle: Any = "") -> bool:
        return self._flown(vehicle).api_control

    def _arm(self, arm: Any, vehicle: Any = "") -> bool:
        return self._flown(vehicle).arm(types.flag(arm, "arm"))

    def _pause(self, paused: Any) -> None:
        if types.flag(paused, "is_paused"):
            self.simulation.pause(self._wall_ns)
        else:
            self.simulation.run(self._wall_ns)

    def _continue_for_time(self, seconds: Any) -> DeferredReply:
        return self._continue(self._duration(seconds, "seconds"))

    def _continue_for_frames(self, frames: Any) -> DeferredReply:
        """Unreal draws 60 of them per second of wall time, if it keeps up."""
        count = types.number(frames, "frames")
        if count != int(count) or not 0 <= count <= MOST_FRAMES:
            raise ValueError(f"frames must be a whole number from 0 to {MOST_FRAMES:g}, not {frames}")
        return self._continue(count / FRAMES_PER_S)

    def _continue(self, wall_s: float) -> DeferredReply:
        reply = self.simulation.continue_for_wall(wall_s, self._wall_ns)
        reply.encode = lambda _: None
        return reply

    def _duration(self, value: Any, name: str) -> float:
        seconds = types.number(value, name)
        if seconds < 0:
            raise ValueError(f"{name} must not be negative, not {seconds:g}")
        return min(seconds, LONGEST_S)

    def _multirotor_state(self, vehicle: Any = "") -> dict[str, Any]:
        pilot = self._flown(vehicle)
        kinematics = pilot.kinematics()
        return {
            "collision": types.no_collision_map(),  # AirSim never fills it here
            "kinematics_estimated": types.kinematics_map(kinematics),
            "gps_location": types.geo_map(
                geographic(pilot.vehicle.in_world(kinematics.position_m), self.settings.home)
            ),
            "timestamp": types.stamp(kinematics.time_ns),
            "landed_state": 0 if pilot.vehicle.landed else 1,
            "rc_data": types.rc_data_map() | stick_map(pilot.sticks),
        }

    def _kinematics(self, vehicle: Any = "") -> dict[str, Any]:
        return types.kinematics_map(self.pilot_of(vehicle).kinematics())
