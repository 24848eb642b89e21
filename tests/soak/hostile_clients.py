"""A server of its own, attacked by many clients at once, each way for some seconds, while one good client pings.

    python -m tests.soak.hostile_clients [clients] [seconds]

prints for each attack the server's largest memory and the longest ping, and whether it lives. Bounds: 1.5 GB; a ping
waits for one request of each attacker at most, for seconds where they ask for the largest pictures.
"""

from __future__ import annotations

import contextlib
import json
import selectors
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests.processes import resident_mib
from uavaccel.clock import MonotonicClock
from uavaccel.units import NS_PER_S
from uavaccel.wire import rpc

clock = MonotonicClock()
REQUEST = rpc.pack_request
POSE = {
    "position": {"x_val": 0.0, "y_val": 0.0, "z_val": -60.0},
    "orientation": {"w_val": 1.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0},
}
UNIT = {"x_val": 1.0, "y_val": 1.0, "z_val": 1.0}
RAW = {"camera_name": "0", "image_type": 0, "compress": False}
FLOATS = {"camera_name": "0", "image_type": 2, "pixels_as_float": True, "compress": False}


def nested(number: int) -> bytes:
    """An endless message: its first half MiB, then more of it."""
    return REQUEST(9, "ping", [])[:-1] + b"\xdd\x7f\xff\xff\xff" + b"\x90" * (1 << 19)


ATTACKS: dict[str, Callable[[int], bytes]] = {
    "nested arrays without an end": nested,
    "replies that nobody reads": lambda _: REQUEST(1, "getMultirotorState", []) * 200,
    "recordings that nobody reads": lambda _: REQUEST(1, "uavaccelRecording", []) * 20,
    "pictures that nobody reads": lambda _: REQUEST(1, "simGetImages", [[RAW] * 64]) * 4,
    "pictures of numbers": lambda _: REQUEST(1, "simGetImages", [[FLOATS] * 64]) * 4,
    "surface normals": lambda _: REQUEST(1, "simGetImage", ["0", 6]),
    "the largest pictures": lambda _: REQUEST(1, "simGetImages", [[dict(RAW, camera_name="large")]]),
    "pictures that are too large": lambda _: REQUEST(1, "simGetImages", [[dict(RAW, camera_name="huge")]]),
    "regular expressions": lambda _: (
        REQUEST(1, "simListSceneObjects", ["(x+x+)+y"])
        + REQUEST(2, "simSetSegmentationObjectID", ["(.*.*.*.*.*)*!", 3, True])
    ),
    "ClockSpeed 10 000": lambda n: REQUEST(1, "uavaccelSetClockSpeed", [1e4]) + REQUEST(2, "simPause", [False]) * 20,
    "recordings begun": lambda _: REQUEST(1, "startRecording", []) * 20,
    "vehicles": lambda n: (
        REQUEST(1, "simAddVehicle", [f"v{n}", "simpleflight", place(n), ""])
        + REQUEST(2, "simAddVehicle", ["\0", "simpleflight", place(n), ""])
        + REQUEST(3, "reset", [])
    ),
    "spawned objects": lambda n: REQUEST(1, "simSpawnObject", ["x" * 200 + str(n), "Cube", POSE, UNIT]) * 5,
    "fields of view": lambda n: (
        REQUEST(1, "simSetCameraFov", ["0", 1.0 + n / 10]) + REQUEST(2, "simGetImages", [[FLOATS]])
    ),
}
SETTINGS = {
    "Vehicles": {
        "Drone": {
            "VehicleType": "SimpleFlight",
            "Cameras": {
                "large": {"CaptureSettings": [{"ImageType": 0, "Width": 3840, "Height": 2160}]},
                "huge": {"CaptureSettings": [{"ImageType": 0, "Width": 8192, "Height": 8192}]},
            },
        }
    }
}


def place(number: int) -> dict[str, dict[str, float]]:
    return POSE | {"position": {"x_val": 3.0 * (number % 30), "y_val": 3.0 * (number // 30), "z_val": -30.0}}


class Attack:
    """Many connections that send as fast as they can, and read only if they are `reading`."""

    def __init__(self, port: int, clients: int, make: Callable[[int], bytes], reading: bool) -> None:
        self._make, self._reading = make, reading
        self._selector = selectors.DefaultSelector()
        self.closed = 0
        for number in range(clients):
            connection = socket.create_connection(("127.0.0.1", port))
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 16)
            self._selector.register(connection, selectors.EVENT_READ | selectors.EVENT_WRITE, bytearray(make(number)))

    def go_on(self) -> None:
        for key, events in self._selector.select(0.01):
            connection = key.fileobj
            assert isinstance(connection, socket.socket)
            try:
                if events & selectors.EVENT_WRITE:
                    del key.data[: connection.send(key.data[: 1 << 16])]
                    if len(key.data) < 1 << 10:
                        key.data.extend(self._make(key.fd))
                if events & selectors.EVENT_READ and self._reading and not connection.recv(1 << 16):
                    raise ConnectionResetError
            except BlockingIOError:
                pass
            except OSError:
                self.closed += 1
                self._selector.unregister(connection)
                connection.close()

    def close(self) -> None:
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        self._selector.close()


def attack_of(words: list[str]) -> None:
    """The process of the attackers: their own, so that they do not hold up who measures."""
    port, clients, name, reading, seconds = words
    attack = Attack(int(port), int(clients), ATTACKS[name], reading == "True")
    end_ns = clock.now_ns() + int(float(seconds) * NS_PER_S)
    while clock.now_ns() < end_ns:
        attack.go_on()
    attack.close()
    print(attack.closed)


def ping_s(good: socket.socket) -> float:
    begun_ns = clock.now_ns()
    good.sendall(REQUEST(5, "ping", []))
    wanted, got = rpc.pack_response(5, None, True), b""
    while len(got) < len(wanted):
        if not (more := good.recv(100)):
            raise ConnectionResetError("the good client was hung up on")
        got += more
    return (clock.now_ns() - begun_ns) / NS_PER_S


def under_attack(server: subprocess.Popen[str], port: int, words: list[str], seconds: float) -> tuple[float, float]:
    """The server's largest memory in MiB and the longest ping in seconds."""
    memory_mib = longest_s = 0.0
    with socket.create_connection(("127.0.0.1", port), timeout=120) as good:
        ping_s(good)
        attackers = subprocess.Popen(
            [sys.executable, "-m", "tests.soak.hostile_clients", "--attack", str(port), *words, str(seconds)],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        end_ns = clock.now_ns() + int((seconds + 3.0) * NS_PER_S)
        while clock.now_ns() < end_ns:
            longest_s = max(longest_s, ping_s(good))
            memory_mib = max(memory_mib, resident_mib(server.pid))
            clock.sleep_until(clock.now_ns() + 20_000_000)
        print(f"{attackers.communicate()[0].strip()} hung up on", end="; ")
    return memory_mib, longest_s


def main(clients: int = 15, seconds: float = 10.0) -> None:
    worst_mib = worst_s = 0.0
    for name in ATTACKS:
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "settings.json").write_text(json.dumps(SETTINGS))
            server = subprocess.Popen(
                [sys.executable, "-m", "uavaccel", "serve", "--port", "0", "--recordings", f"{folder}/recordings",
                 "--settings", f"{folder}/settings.json"],
                stdout=subprocess.PIPE, text=True,
            )  # fmt: skip
            assert server.stdout is not None
            line = server.stdout.readline()
            port = int(line.partition(": ")[0].rpartition(":")[2])
            print(f"{name}: ", end="", flush=True)
            words = [str(clients), name, str(not name.endswith("nobody reads"))]
            with contextlib.suppress(ConnectionError):
                mib, longest_s = under_attack(server, port, words, seconds)
                worst_mib, worst_s = max(worst_mib, mib), max(worst_s, longest_s)
                print(f"{mib:.0f} MiB, longest ping {longest_s:.3f} s", end=", ")
            alive = server.poll() is None
            folders = len([*Path(folder).glob("recordings/*")])
            print(f"{'alive' if alive else 'DEAD'}, {folders} folders", flush=True)
            server.terminate()
            print("   ", server.communicate()[0].strip().replace("\n", "\n    ")[-600:], flush=True)
    print(f"worst: {worst_mib:.0f} MiB, {worst_s:.3f} s")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--attack"]:
        attack_of(sys.argv[2:])
    else:
        main(*[int(word) for word in sys.argv[1:]])
