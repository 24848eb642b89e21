"""Messages that are nearly requests: calls of every method with something wrong in them, or bytes that were changed."""

from __future__ import annotations

import contextlib
import random
import socket
from collections.abc import Iterator
from typing import Any

import msgpack

from tests.flying import pose
from uavaccel.wire import rpc
from uavaccel.wire.api import CALLS, Api

YAW = {"is_rate": True, "yaw_or_rate": 0.0}
POSE = pose(1.0, 0.0, -10.0)
HERE = POSE["position"]
IMAGE = {"camera_name": "0", "image_type": 0, "pixels_as_float": False, "compress": True}
GOOD: dict[str, list[Any]] = {
    "enableApiControl": [True, ""],
    "simPause": [False],
    "simContinueForTime": [0.01],
    "simContinueForFrames": [3],
    "uavaccelContinueFor": [10_000_000],
    "uavaccelSetClockSpeed": [20.0],
    "uavaccelStartGame": [20.0, -10.0],
    "simGetImages": [[IMAGE], "", False],
    "moveByVelocity": [1.0, 0.0, 0.0, 0.1, 0, YAW, ""],
    "moveToPosition": [1.0, 0.0, -10.0, 1.0, 1.0, 0, YAW, -1.0, 1.0, ""],
    "moveOnPath": [[HERE, HERE], 1.0, 1.0, 0, YAW, -1.0, 1.0, ""],
    "moveByMotorPWMs": [0.6, 0.6, 0.6, 0.6, 0.1, ""],
    "moveByRC": [{"roll": 0.1, "pitch": 0.0, "throttle": 0.6, "yaw": 0.0, "is_valid": True}, ""],
    "simSetVehiclePose": [POSE, True, ""],
    "simSetKinematics": [{**POSE, "linear_velocity": HERE}, True, ""],
    "simAddVehicle": ["Drone2", "car", POSE, ""],  # of a heap of vehicles the server would only fly contacts
    "simSpawnObject": ["Box", "Cube", POSE, HERE, False, False],
    "simSetObjectPose": ["Box", POSE, True],
    "simSetSegmentationObjectID": [".*", 7, True],
    "simSetWind": [HERE],
    "simTestLineOfSightBetweenPoints": [{"latitude": 47.6, "longitude": -122.1, "altitude": 120.0}] * 2,
}
WILD: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    1 << 63,
    -(1 << 63),
    0.1,
    -1.0,
    1e300,
    float("nan"),
    float("inf"),
    "",
    "SimpleFlight",
    "x" * 1000,
    b"\xff\xfe",
    [],
    [[[[[[[[]]]]]]]],
    {},
    {"x_val": "far"},
    POSE,
    YAW,
    IMAGE,
)
STRANGE = (b"\xdd\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff", b"\xc1", b"\x91")


HANGS_S = 120.0  # without a word of an answer, on however busy a machine
PING = 0  # its id, which no mutated call has
CALM = b"".join(  # else it would soon do nothing but fly
    rpc.pack_request(1, name, [value]) for name, value in (("uavaccelSetClockSpeed", 1.0), ("simPause", True))
)


def mutated_calls(api: Api, choose: random.Random) -> Iterator[bytes]:
    """Packed calls without end: framed as they should be, with whatever inside. Every id is above 0."""
    methods = sorted(api.handlers)
    number = 0
    while True:
        number = number % 0xFFFFFFF0 + 1
        name = choose.choice(methods)
        least, most = CALLS[name].required, CALLS[name].most
        given = GOOD.get(name) or [choose.choice(WILD) for _ in range(choose.randint(least, most))]
        params = [changed(each, choose) if choose.random() < 0.3 else each for each in given]
        if choose.random() < 0.1:
            params = choose.choice([params[:-1], [*params, None], params[::-1]])
        if choose.random() < 0.03:
            name = changed_bytes(name.encode(), choose).decode("latin-1")
        yield rpc.pack_request(number, name, params)


def changed(value: Any, choose: random.Random) -> Any:
    """Something else in its place, or in the place of something inside it."""
    if isinstance(value, dict) and value and choose.random() < 0.7:
        key = choose.choice(sorted(value))
        rest = {name: each for name, each in value.items() if name != key}
        return rest if choose.random() < 0.2 else {**rest, key: changed(value[key], choose)}
    if isinstance(value, list) and value and choose.random() < 0.7:
        place = choose.randrange(len(value))
        return [*value[:place], changed(value[place], choose), *value[place + 1 :]]
    return choose.choice(WILD)


def changed_bytes(data: bytes, choose: random.Random) -> bytes:
    """With one to four changes: a byte, a cut, a piece twice, a piece gone, something strange put in."""
    for _ in range(choose.randint(1, 4)):
        start, end = sorted(choose.randrange(len(data) + 1) for _ in range(2))
        put_in = choose.choice(STRANGE)
        data = choose.choice((
            data[:start] + choose.randbytes(1) + data[start + 1 :],
            data[:start],
            data[:end] + data[start:end] + data[end:],
            data[:start] + data[end:],
            data[:start] + put_in + data[start:],
        ))  # fmt: skip
    return data


def send(port: int, calls: list[bytes], strange: list[bytes]) -> None:
    """Raises TimeoutError where the ping is not answered, ConnectionRefusedError where nobody listens."""
    unpacker = msgpack.Unpacker(unicode_errors="surrogateescape", strict_map_key=False, max_buffer_size=1 << 28)
    for data in strange:
        with connected(port) as connection, contextlib.suppress(ConnectionError):
            connection.sendall(data)
    with connected(port) as connection:
        connection.sendall(b"".join(calls) + CALM + rpc.pack_request(PING, "ping", []))
        answered = False
        while not answered:
            data = connection.recv(1 << 16)
            if not data:
                raise ConnectionRefusedError("it hung up before the ping was answered")
            unpacker.feed(data)
            answered = any(message[1] == PING for message in unpacker)


def connected(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=HANGS_S)
