"""Flight commands through the API in simulated time, to their end."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.simulating import simulate
from uavaccel.sim.profile import NATIVE, Profile
from uavaccel.sim.simulation import DeferredReply
from uavaccel.units import NS_PER_S
from uavaccel.wire.api import Api

FOR_EVER = 3e38
STRAIGHT = {"is_rate": True, "yaw_or_rate": 0.0}


def hovering(profile: Profile = NATIVE, **options: Any) -> Api:
    """10 m up, with API control, running."""
    return Api(simulate(profile=profile), render=False, **options)


def call(api: Api, method: str, *params: Any) -> Any:
    return api.call(method, list(params), api.simulation.wall_ns)


def wait(api: Api, reply: DeferredReply) -> Any:
    """Let time pass until the reply is due; its value."""
    while reply.due_wall_ns is None:
        due = api.simulation.next_event_wall_ns()
        assert due is not None, "nothing will ever end"
        api.simulation.advance_to(due)
    return reply.value


def fly(api: Api, method: str, *params: Any) -> tuple[Any, float]:
    """A command's result, and how long it took in simulated seconds."""
    begun_ns = api.simulation.time_ns
    reply = call(api, method, *params)
    value = wait(api, reply) if isinstance(reply, DeferredReply) else reply
    return value, (api.simulation.time_ns - begun_ns) / NS_PER_S


def go_on(api: Api, seconds: float) -> None:
    """At ClockSpeed 1."""
    api.simulation.advance_to(api.simulation.wall_ns + round(seconds * NS_PER_S))


def place(api: Api, vehicle: str = "") -> NDArray[np.float64]:
    return np.array(api.scenery.pilot(vehicle).kinematics().position_m)


def point(x: float, y: float, z: float) -> dict[str, float]:
    return {"x_val": x, "y_val": y, "z_val": z}


def pose(x: float, y: float, z: float, **turned: float) -> dict[str, Any]:
    """Level and to the north, but for the parts of a quaternion that are given."""
    return {"position": point(x, y, z), "orientation": {"w_val": 1.0, **point(0.0, 0.0, 0.0), **turned}}
