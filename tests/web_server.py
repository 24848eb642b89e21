"""A stand-in for viser's server: what was added to the scene and the controls, by name, and browsers that look."""

from __future__ import annotations

import re
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np

from uavaccel.watch.scene import COMMANDED, THINKING, as_light

BLUE, VERMILION = (tuple(as_light(colour).tolist()) for colour in (COMMANDED, THINKING))  # as they are sent


class Handle:
    """Something that was added; a browser clicks on it, or chooses a value."""

    def __init__(self, server: Server, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> None:
        self.name, self.arguments, self.options, self._server = name, arguments, options, server
        self.label: Any = name
        self.content: Any = arguments[0]
        self.value, self.visible, self.disabled = options.get("initial_value"), options.get("visible", True), False
        self.points: Any = None
        self._acts: list[Any] = []

    def on_click(self, act: Any) -> None:
        self._acts.append(act)

    on_update = on_click

    def click(self, client: object = "a browser") -> None:
        for act in self._acts:
            act(SimpleNamespace(client=client, target=self))

    def choose(self, value: Any) -> None:
        self.value = value
        self.click()

    def remove(self) -> None:
        del self._server.added[self.name]


class Server:
    """One browser for each of `aspects`, the width of its screen over the height."""

    def __init__(self, *aspects: float) -> None:
        self.added: dict[str, Any] = {}
        self.initial_camera: Any = SimpleNamespace()
        cameras = [SimpleNamespace(aspect=aspect, position=np.full(3, 9.0)) for aspect in aspects]
        self.clients = {number: SimpleNamespace(camera=camera) for number, camera in enumerate(cameras)}
        self.scene = self.gui = self
        self.connected: Any = None

    def __getattr__(self, call: str) -> Any:
        def add(*arguments: Any, **options: Any) -> Handle | None:
            if not call.startswith("add_"):
                return None
            name = re.findall(r"class='(\w+)'", arguments[0])[0] if call == "add_html" else arguments[0]
            handle = Handle(self, options.get("label", name), arguments, options)
            self.added[handle.name] = handle
            return handle

        return add

    def remove_by_name(self, name: str) -> None:
        self.added = {other: handle for other, handle in self.added.items() if not other.startswith(name)}

    def atomic(self) -> Any:
        return nullcontext()

    def get_clients(self) -> dict[int, Any]:
        return self.clients

    def on_client_connect(self, act: Any) -> None:
        self.connected = act

    def clocks(self) -> str:
        """The table of clocks in words."""
        return " ".join(re.sub("<[^>]*>|&nbsp;", " ", self.added["clocks"].content).split())

    def path(self, name: str) -> tuple[list[Any], list[Any]]:
        """The path of a drone: its segments' ends, and their colours."""
        blocks = [handle for other, handle in self.added.items() if other.startswith(f"/{name} path")]
        points = [segment for block in blocks for segment in block.points.round(6).tolist()]
        return points, [tuple(colour[0]) for block in blocks for colour in block.colors.tolist()]
