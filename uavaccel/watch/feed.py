"""What running flights tell the page: the page's end of the sockets of uavaccel.wire.broadcast."""

from __future__ import annotations

import json
import selectors
import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.files import Plain
from uavaccel.kinematics import Vector
from uavaccel.units import NS_PER_S
from uavaccel.watch.scene import pose_of
from uavaccel.wire.page_protocol import FREE, MESSAGE_BYTES, Orders

BACKLOG = 256


@dataclass(frozen=True)
class Scene:
    """A model and its data, as a flight's world had them, and the body of each of its vehicles."""

    model: mujoco.MjModel
    data: mujoco.MjData
    bodies: Mapping[str, int]


class Moment(NamedTuple):
    """One state of a flight. `poses` (vehicles, 7) are place in m and wxyz in MuJoCo's frame."""

    flight: int
    """Counts the flights of a world, from 1."""
    may_pause: bool
    clock_speed: float
    time_s: float
    """Simulated, since the last reset."""
    wall_s: float
    poses: NDArray[np.float64]
    commanded: tuple[bool, ...]
    """Of each vehicle, whether a command is running."""
    towards: tuple[Vector | None, ...]
    """NED, where each vehicle's command leads; None where that is no direction."""


class Source:
    """One world that tells of its flights."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.scene: Scene | None = None
        self.moments: list[Moment] = []
        """Those that were heard last."""
        self._told: Orders | None = None

    def order(self, orders: Orders) -> None:
        """Send these orders if they are others than before."""
        if orders != self._told:
            self._told = orders
            self._send(orders)

    def let_pass(self, refreshes: int) -> None:
        """Let a held flight go on for so many refreshes."""
        self._send({**(self._told or FREE), "refreshes": refreshes})

    def _send(self, orders: Orders) -> None:
        with suppress(OSError):  # it has ended, which `Feed.listen` will notice
            self.connection.send(json.dumps(orders).encode())

    def receive(self) -> bool:
        """Take what was sent; False once the flight's end of the socket is closed."""
        while True:
            try:
                message = self.connection.recv(MESSAGE_BYTES)
            except BlockingIOError:
                return True
            except OSError:
                return False
            if not message:
                return False
            for kind, content in json.loads(message).items():
                if kind == "scene":
                    self.scene = _loaded(content)
                elif self.scene is not None:
                    self.moments.append(_moment(content, self.scene))


class Feed:
    """Listens for flights on a Unix socket at `path`, and chooses the one to be shown.

    That is the first to tell of itself, until it has ended or has been silent for `patience_s` while another speaks.
    """

    def __init__(self, path: Path, patience_s: float = 1.0) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.bind(str(path))
        self._socket.listen(BACKLOG)
        self._socket.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._patience_s, self._silent_s = patience_s, 0.0
        self.sources: list[Source] = []
        self.shown: Source | None = None

    def listen(self, passed_s: float) -> None:
        """Take what has come in the last `passed_s` seconds, without waiting."""
        for source in self.sources:
            source.moments.clear()
        for key, _ in self._selector.select(0):
            if key.data is None:
                self._accept()
            elif not key.data.receive():
                self._drop(key.data)
        self.choose(passed_s)

    def choose(self, passed_s: float) -> None:
        """Choose the flight to be shown, by who has spoken in the last `passed_s` seconds."""
        self._silent_s = 0.0 if self.shown is not None and self.shown.moments else self._silent_s + passed_s
        if self.shown is None or self._silent_s > self._patience_s:
            speaking = next((source for source in self.sources if source.moments), None)
            if speaking is not None:
                self.shown, self._silent_s = speaking, 0.0

    def forgive(self) -> None:
        """Count the shown flight's silence anew: it is held."""
        self._silent_s = 0.0

    def _accept(self) -> None:
        connection, _ = self._socket.accept()
        connection.setblocking(False)
        source = Source(connection)
        self.sources.append(source)
        self._selector.register(connection, selectors.EVENT_READ, source)
        if self.shown is None:
            self.shown = source

    def _drop(self, source: Source) -> None:
        self._selector.unregister(source.connection)
        source.connection.close()
        self.sources.remove(source)
        if self.shown is source:
            self.shown = None

    def close(self) -> None:
        """Hang up on every flight, which then goes on without a page."""
        for source in list(self.sources):
            self._drop(source)
        self._selector.close()
        self._socket.close()


def _loaded(content: Plain) -> Scene:
    """Load the scene that a flight has left in a file, and remove that."""
    file = Path(content["model"])
    model = mujoco.MjModel.from_binary_path(str(file))
    file.unlink()
    data = mujoco.MjData(model)
    data.qpos[:] = content["qpos"]
    mujoco.mj_kinematics(model, data)
    return Scene(model, data, {each["name"]: each["body"] for each in content["vehicles"]})


def _moment(state: Plain, scene: Scene) -> Moment:
    qpos = np.array(state["qpos"], np.float64)
    return Moment(
        state["flight"],
        state["may_pause"],
        state["clock_speed"],
        state["time_ns"] / NS_PER_S,
        state["wall_ns"] / NS_PER_S,
        np.array([qpos[pose_of(scene.model, body)] for body in scene.bodies.values()]),
        tuple(state["commanded"]),
        tuple(None if each is None else tuple(each) for each in state["towards"]),
    )
