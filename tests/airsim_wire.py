"""AirSim's calls on a scene for its clients in this process, for the tests of what a vehicle senses."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from tests.scenes import BLOCKS, Pose
from uavaccel.sim.objects import SceneObjects
from uavaccel.sim.poses import Pose as ScenePose
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.simulation import DeferredReply, Simulation
from uavaccel.sim.world import World
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.settings import Settings

MS = 1_000_000


@cache
def airsim_world() -> World:
    """One for all tests: each begins with a reset, and what it spawned it destroys.

    Its blocks are where tests.scenes.BLOCKS has them; what is no block is out of the way.
    """
    world = World("blocks", NATIVE, airsim=True)
    objects = SceneObjects(world)
    for name in objects.names():
        middle, _ = BLOCKS.get(name, ((-5000.0, 0.0, -3.0), None))
        objects.set_pose(name, ScenePose(middle))
    return world


def xyz(field: Mapping[str, float]) -> list[float]:
    return [field[key] for key in ("x_val", "y_val", "z_val")]


def floats(response: Mapping[str, Any]) -> NDArray[np.float64]:
    """The picture of metres or fractions in a response."""
    assert response["image_data_uint8"] == b""
    return np.array(response["image_data_float"]).reshape(response["height"], response["width"])


def pixels(response: Mapping[str, Any]) -> NDArray[np.uint8]:
    """The picture of blue, green and red in a response."""
    assert response["image_data_float"] == []
    flat = np.frombuffer(response["image_data_uint8"], np.uint8)
    return flat.reshape(response["height"], response["width"], 3)


class AirSimWire:
    """A settled hover 10 m up, running at 1x, API control on; replies are what a client unpacks."""

    def __init__(self, settings: Mapping[str, Any] | None = None, world: World | None = None, **api: Any) -> None:
        self.world = world or airsim_world()
        self.world.lead.state["wind"] = 0.0
        self.world.reset()
        self.said: list[str] = []
        self.simulation = Simulation(self.world)
        self.simulation.reset(0)
        self.simulation.lead.api_control = True
        self.api = Api(self.simulation, Settings.model_validate(settings or {}), say=self.said.append, **api)
        self.wall_ns = 0

    def call(self, method: str, *params: Any) -> Any:
        result = self.api.call(method, params, self.wall_ns)
        if isinstance(result, DeferredReply):
            return result
        return msgpack.unpackb(rpc.pack_response(1, None, result))[3]

    def fly(self, seconds: float) -> None:
        self.wall_ns += round(seconds * 1000) * MS
        self.simulation.advance_to(self.wall_ns)

    def move(self, pose: Pose) -> None:
        self.call("simSetVehiclePose", pose.message(), True, "")

    def images(self, *requests: tuple[str, int, bool]) -> list[dict[str, Any]]:
        """Camera, type, and whether as numbers."""
        keys = ("camera_name", "image_type", "pixels_as_float")
        asked = [dict(zip(keys, request, strict=True)) | {"compress": False} for request in requests]
        answers: list[dict[str, Any]] = self.call("simGetImages", asked, "", False)
        return answers
