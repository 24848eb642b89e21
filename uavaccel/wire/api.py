"""AirSim's calls, and a few of our own, on a `Simulation`: names, arity, argument checks, wire types.

The same table serves the socket server and the in-process transport, so a call means the same in every timing.
Source of names, parameter orders and error texts: AirSim v1.8.1, RpcLibServerBase.cpp, MultirotorRpcLibServer.cpp.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.simulation import DeferredReply, Simulation
from uavaccel.wire import rpc, types
from uavaccel.wire.game_api import GameApi
from uavaccel.wire.image_api import ImageApi
from uavaccel.wire.recorder import Recorder
from uavaccel.wire.refusals import Refusals
from uavaccel.wire.settings import Settings

SERVER_VERSION = 4  # satisfies AirSim's client (1) and Cosys-AirSim's (4)
MIN_CLIENT_VERSION = 1
FORWARD_ONLY = 1
MIN_HEADING_M_S = 0.5  # adjustYaw: a slower velocity has no direction worth facing
LONGEST_S = 1e9  # what is asked to last longer lasts so long: AirSim's clients write 3e38 for ever

Handler = Callable[..., Any]


class Method:
    """A call of the table: how many arguments it needs, and how many it takes at most."""

    def __init__(self, handler: Handler, required: int, optional: int = 0) -> None:
        self.handler = handler
        self.required = required
        self.most = required + optional


class Api:
    """The calls that one simulation answers. `recordings`: the folder for what startRecording records."""

    def __init__(
        self,
        simulation: Simulation,
        settings: Settings | None = None,
        render: bool = True,
        recordings: Path | None = None,
    ) -> None:
        self.simulation = simulation
        self.settings = settings or Settings()
        self.recorder = Recorder(simulation, self.settings.vehicle, recordings)
        self._images = ImageApi(simulation, render)
        self._game = GameApi(simulation, self.recorder)
        self._wall_ns = 0
        self.refusals = Refusals()
        self.methods = self._airsim_methods() | self._image_methods() | self._own_methods()

    def call(self, method: str, params: Sequence[Any], wall_ns: int) -> Any:
        """The result of a call handled at `wall_ns`, or its `DeferredReply`. Raises rpc.RpcError.

        The simulation has to be advanced to `wall_ns` before.
        """
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
            "listVehicles": Method(lambda: [self.settings.vehicle], 0),
            "reset": Method(self._reset, 0),
            "enableApiControl": Method(self._enable_api_control, 1, 1),
            "isApiControlEnabled": Method(self._is_api_control_enabled, 0, 1),
            "armDisarm": Method(self._arm, 1, 1),
            "simPause": Method(self._pause, 1),
            "simIsPaused": Method(lambda: simulation.paused, 0),
            "simContinueForTime": Method(self._continue_for_time, 1),
            "getMultirotorState": Method(self._multirotor_state, 0, 1),
            "simGetGroundTruthKinematics": Method(self._kinematics, 0, 1),
            "moveByVelocity": Method(self._move_by_velocity, 6, 1),
            "moveByVelocityZ": Method(self._move_by_velocity_z, 6, 1),
            "hover": Method(self._hover, 0, 1),
            "cancelLastTask": Method(self._cancel, 0, 1),
            "startRecording": Method(self.recorder.start, 0),
            "stopRecording": Method(self.recorder.stop, 0),
            "isRecording": Method(lambda: simulation.world.recording, 0),
        }

    def _image_methods(self) -> dict[str, Method]:
        images = self._images
        return {
            "simGetImages": Method(images.get_images, 1, 2),
            "simGetImage": Method(images.get_image, 2, 2),
            "simGetCameraInfo": Method(images.camera_info, 1, 2),
            "simGetCollisionInfo": Method(images.collision_info, 0, 1),
            "simGetVehiclePose": Method(images.vehicle_pose, 0, 1),
            "simSetVehiclePose": Method(images.set_vehicle_pose, 2, 1),
            "uavaccelImage": Method(images.raw_image, 1),
            "uavaccelSetLane": Method(images.set_lane, 1),
            "uavaccelCollision": Method(images.collision, 0),
        }

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

    def _check_vehicle(self, name: Any) -> None:
        if name not in ("", self.settings.vehicle):
            raise ValueError(
                f"Vehicle API for '{name}' is not available. This could either because this is simulation"
                f"-only API or this vehicle does not exist; there is '{self.settings.vehicle}'"
            )

    def _reset(self) -> None:
        """A recording goes on through it, as in AirSim."""
        world = self.simulation.world
        self.recorder.keep()
        self.simulation.reset(self._wall_ns, recording=world.recording)

    def _enable_api_control(self, enabled: Any, vehicle: Any = "") -> None:
        self._check_vehicle(vehicle)
        enabled = types.flag(enabled, "is_enabled")
        if not enabled:  # a command that runs on would have no end
            self.simulation.cancel(self._wall_ns)
        self.simulation.api_control = enabled

    def _is_api_control_enabled(self, vehicle: Any = "") -> bool:
        self._check_vehicle(vehicle)
        return self.simulation.api_control

    def _arm(self, arm: Any, vehicle: Any = "") -> bool:
        self._check_vehicle(vehicle)
        return self.simulation.arm(types.flag(arm, "arm"))

    def _pause(self, paused: Any) -> None:
        if types.flag(paused, "is_paused"):
            self.simulation.pause(self._wall_ns)
        else:
            self.simulation.run(self._wall_ns)

    def _continue_for_time(self, seconds: Any) -> DeferredReply:
        reply = self.simulation.continue_for_wall(self._duration(seconds, "seconds"), self._wall_ns)
        reply.encode = lambda _: None
        return reply

    def _duration(self, value: Any, name: str) -> float:
        seconds = types.number(value, name)
        if seconds < 0:
            raise ValueError(f"{name} must not be negative, not {seconds:g}")
        return min(seconds, LONGEST_S)

    def _multirotor_state(self, vehicle: Any = "") -> dict[str, Any]:
        self._check_vehicle(vehicle)
        kinematics = self.simulation.kinematics()
        return {
            "collision": types.no_collision_map(),  # AirSim never fills it here
            "kinematics_estimated": types.kinematics_map(kinematics),
            "gps_location": types.geo_point_map(kinematics.position_m),
            "timestamp": kinematics.time_ns,
            "landed_state": 0 if self.simulation.world.landed else 1,
            "rc_data": types.rc_data_map(),
        }

    def _kinematics(self, vehicle: Any = "") -> dict[str, Any]:
        self._check_vehicle(vehicle)
        return types.kinematics_map(self.simulation.kinematics())

    def _move_by_velocity(
        self, vx: Any, vy: Any, vz: Any, duration: Any, drivetrain: Any, yaw: Any, vehicle: Any = ""
    ) -> DeferredReply | bool:
        self._check_vehicle(vehicle)
        velocity = (types.number(vx, "vx"), types.number(vy, "vy"), types.number(vz, "vz"))
        seconds = types.number(duration, "duration")
        goal = VelocityGoal(velocity, None, *facing(velocity, drivetrain, yaw))
        if seconds <= 0:
            self.simulation.cancel(self._wall_ns)
            return True
        return self._fly(goal, seconds)

    def _move_by_velocity_z(
        self, vx: Any, vy: Any, z: Any, duration: Any, drivetrain: Any, yaw: Any, vehicle: Any = ""
    ) -> DeferredReply | bool:
        self._check_vehicle(vehicle)
        velocity = (types.number(vx, "vx"), types.number(vy, "vy"), 0.0)
        seconds = types.number(duration, "duration")
        goal = VelocityGoal(velocity, types.number(z, "z"), *facing(velocity, drivetrain, yaw))
        if seconds <= 0:
            self.simulation.cancel(self._wall_ns)
            return False
        return self._fly(goal, seconds)

    def _fly(self, goal: VelocityGoal, seconds: float) -> DeferredReply:
        self.recorder.keep()  # the first command starts the simulation's recorder anew
        return self.simulation.fly_velocity(goal, min(seconds, LONGEST_S), self._wall_ns)

    def _hover(self, vehicle: Any = "") -> bool:
        """AirSim's hover ends the running command and lets the goal timeout bring position hold."""
        self._check_vehicle(vehicle)
        self.simulation.cancel(self._wall_ns)
        return True

    def _cancel(self, vehicle: Any = "") -> None:
        self._check_vehicle(vehicle)
        self.simulation.cancel(self._wall_ns)


def facing(velocity: tuple[float, float, float], drivetrain: Any, yaw_mode: Any) -> tuple[float, bool]:
    """Yaw goal and whether it is a rate, for the direction of travel (MultirotorApiBase::adjustYaw)."""
    is_rate, yaw = types.yaw_mode(yaw_mode)
    if types.number(drivetrain, "drivetrain") != FORWARD_ONLY or is_rate:
        return yaw, is_rate
    if math.hypot(velocity[0], velocity[1]) <= MIN_HEADING_M_S:
        return 0.0, True
    return math.remainder(yaw + math.atan2(velocity[1], velocity[0]), 2 * math.pi), False
