"""A stand-in for viser's server: what was added to the scene and the controls, by name, and browsers that look."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.golden import numbers
from uavaccel.watch.scene import COMMANDED, IDEAL, THINKING, as_light

MEANT = {"flies": COMMANDED, "thinks": THINKING, "ideal": IDEAL}
LIGHTS = {tuple(as_light(colour).tolist()): name for name, colour in MEANT.items()}  # as they are sent


class Handle:
    """Something that was added; a browser clicks on it, or chooses a value."""

    def __init__(self, server: Server, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> None:
        self.name, self.arguments, self.options, self._server = name, arguments, options, server
        self.label: Any = name
        self.content: Any = arguments[0]
        self.value, self.visible, self.disabled = options.get("initial_value"), options.get("visible", True), False
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

    def told(self) -> str:
        """What a browser would be shown of it: where it is, how large, in which colour."""
        said = []
        for name, value in {**self.options, **vars(self)}.items():
            if isinstance(value, np.ndarray) or name in ("position", "wxyz", "color", "points", "colors"):
                said.append(f"{name} {_colour(value) if name.startswith('color') else numbers(value)}")
        for value in self.arguments[1:]:
            if isinstance(value, np.ndarray) and value.ndim == 2:  # of a mesh, whose order is its library's
                said.append(f"{value.shape} from {numbers(value.min(0))} to {numbers(value.max(0))}")
            elif isinstance(value, np.ndarray):
                said.append(f"{value.shape} {numbers(value)}")
            else:
                said.append(str(value))
        return "; ".join([self.name, *said, *["hidden"] * (not self.visible)])


def _colour(value: Any) -> str:
    rows = [tuple(each) for each in np.reshape(value, (-1, 3)).tolist()]
    return " ".join(LIGHTS.get(row, str(row)) for row in rows[::2] or rows)


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

    def shown(self, below: str = "/") -> Iterator[str]:
        """What a browser is shown of the scene, by line."""
        for name, handle in self.added.items():
            if str(name).startswith(below) and not str(name).startswith("/light"):
                yield handle.told()

    def views(self) -> str:
        """Where the browsers look from and at: the next one, and those that are there."""
        cameras = [self.initial_camera, *(client.camera for client in self.clients.values())]
        return ", ".join(f"{numbers(each.position)} at {numbers(getattr(each, 'look_at', []))}" for each in cameras)
