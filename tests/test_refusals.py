"""What a simulation refuses on the wire, and in which words: one table of calls, and of the reason that each is given.

Nothing flies while a call is refused. rpclib's phrase around a reason is the same for all (`PHRASE`).
"""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest

from tests.airsim_wire import AirSimWire
from tests.flying import point, pose
from uavaccel.sim.simulation import DeferredReply
from uavaccel.sim.world import START_M
from uavaccel.wire import rpc
from uavaccel.wire.api import CALLS

NAN, INF, HUGE = float("nan"), float("inf"), 1 << 70
YAW = {"is_rate": True, "yaw_or_rate": 0.0}
HERE = pose(0.0, 0.0, -10.0)
PATH = (2.0, 60.0, 0, YAW)
MOVING = {"linear_velocity": point(0.0, 0.0, 0.0), "angular_velocity": point(0.0, 0.0, 0.0)}
NOBODY = (
    "Vehicle API for 'Nobody' is not available. This could either because this is simulation-only API or this vehicle "
    "does not exist; there is 'SimpleFlight'"
)
CAMERAS = "front_center (0), front_right (1), front_left (2), bottom_center (3), back_center (4)"
TYPES = (
    "0 scene, 1 depth_planar, 2 depth_perspective, 3 depth_vis, 4 disparity_normalized, 5 segmentation, "
    "6 surface_normals, 7 infrared"
)
PHRASE = (
    "rpclib: function '{method}' (called with {count} arg(s)) threw an exception. The exception contained this "
    "information: {reason}."
)
PARAMETERS: dict[str, Any] = {  # of calls that name a vehicle, by their names
    "yaw_mode": YAW, "path": [point(0, 0, -9)], "pose": HERE, "state": {**HERE, **MOVING}, "rcdata": {},
    "requests": [{}], "kp": [0.2] * 3, "ki": [0.0] * 3, "kd": [0.0] * 3, "param_name": "K1",
    "point": point(1, 0, -9), "latitude": 47.64, "longitude": -122.14, "altitude": 130.0, "lookahead": -1.0,
}  # fmt: skip


def refusals() -> list[tuple[str, str]]:
    """The calls and their reasons in tests/data/refusals.txt, on two lines each."""
    lines = (Path(__file__).parent / "data" / "refusals.txt").read_text(encoding="utf-8").splitlines()
    return list(zip(lines[::2], map(str.strip, lines[1::2]), strict=True))


def test_each_call_is_refused_in_its_words_and_changes_nothing() -> None:
    wire, said, expected = AirSimWire(), [], []
    before = wire.simulation.kinematics()
    for call, reason in refusals():
        method, _, params = call.partition("(")
        values = eval(f"[{params[:-1]}]", globals())
        with pytest.raises(rpc.RpcError) as refused:
            wire.call(method, *values)
        for name in ("NOBODY", "CAMERAS", "TYPES"):
            reason = reason.replace(f"{{{name}}}", globals()[name])
        said.append((call, str(refused.value)))
        expected.append((call, PHRASE.format(method=method, count=len(values), reason=reason)))
        assert wire.simulation.kinematics() == before, call
        assert wire.call("listVehicles") == ["SimpleFlight"], call
    assert said == expected
    assert len(said) > 80
    counted, methods = wire.api.refusals.lines(), {call.partition("(")[0] for call, _ in said}
    assert {line.split()[2] for line in counted} == {method for method in methods if CALLS[method].joined}


def test_unknown_calls_and_numbers_of_arguments_are_refused_in_rpclibs_words() -> None:
    wire = AirSimWire()
    unknown = "rpclib: server could not find function '{}' with argument count {}."
    arity = "rpclib: Function '{}' was called with an invalid number of arguments. Expected: {}, got: {}"
    wrong: list[tuple[str, list[Any], str]] = [
        ("fly", [], unknown.format("fly", 0)),
        ("", [1, 2], unknown.format("", 2)),
    ]
    wrong += [("simPause", [], arity.format("simPause", 1, 0)), ("ping", [1], arity.format("ping", 0, 1))]
    wrong += [(name, [object()] * 99, arity.format(name, call.most, 99)) for name, call in CALLS.items()]
    for method, params, text in wrong:
        with pytest.raises(rpc.RpcError) as refused:
            wire.call(method, *params)
        assert str(refused.value) == text


def test_every_call_that_names_a_vehicle_refuses_an_unknown_one() -> None:
    """Whatever else it is told: the arguments of a call are those that it is declared with."""
    wire, named = AirSimWire(), 0
    good: dict[str, Any] = {
        "float": 0.5, "int": 0, "bool": True, "Truthy": False, "object": "0", "str": "x", "ObjectName": "x",
    }  # fmt: skip
    for method, call in CALLS.items():
        parameters = list(inspect.signature(call.method).parameters.values())[1:]
        if "vehicle" not in [each.name for each in parameters]:
            continue
        until = parameters[: [each.name for each in parameters].index("vehicle")]
        params = [PARAMETERS.get(each.name, good.get(str(each.annotation), 1.0)) for each in until]
        with pytest.raises(rpc.RpcError, match=r"Vehicle API for 'Nobody' is not available.*there is 'SimpleFlight'"):
            wire.call(method, *params, "Nobody")
        named += 1
    assert named > 50


def test_what_is_extreme_is_flown_within_the_drones_limits() -> None:
    wire = AirSimWire()
    reply = wire.call("moveByVelocity", 3e38, -3e38, -3e38, 0.5, 0, YAW, "")
    wire.fly(0.6)
    assert isinstance(reply, DeferredReply)
    assert (reply.value, wire.simulation.failure) == (True, None)
    assert wire.simulation.kinematics().position_m != START_M
