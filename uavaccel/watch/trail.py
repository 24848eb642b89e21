"""The path of a drone that is still flying: line segments in blocks, so that an update sends only the last one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavaccel.watch.figure import COMMANDED, PATH_WIDTH, THINKING

if TYPE_CHECKING:
    from viser import LineSegmentsHandle, ViserServer

BLOCK, MOST_BLOCKS = 100, 100  # segments; older blocks are removed


class Trail:
    """The way of one drone, in MuJoCo's frame, coloured by whether a command was running."""

    def __init__(self, server: ViserServer, name: str) -> None:
        self._scene, self._name = server.scene, name
        self._blocks: list[LineSegmentsHandle] = []
        self._made = 0
        self._points: list[list[NDArray[np.float64]]] = []
        self._colours: list[tuple[int, int, int]] = []
        self._end: NDArray[np.float64] | None = None

    def clear(self) -> None:
        """Begin anew."""
        for block in self._blocks:
            block.remove()
        self._blocks, self._points, self._colours, self._end = [], [], [], None

    def add(self, place: NDArray[np.float64], commanded: bool) -> None:
        """Go on to a place."""
        if self._end is not None and not np.array_equal(place, self._end):
            if len(self._points) == BLOCK:
                self.draw()
                self._points, self._colours = [], []
            if not self._points:
                self._begin_block()
            self._points.append([self._end, place])
            self._colours.append(COMMANDED if commanded else THINKING)
        self._end = place

    def draw(self) -> None:
        """Send the last block to the browsers."""
        if self._points:
            self._blocks[-1].points = np.array(self._points, np.float32)
            self._blocks[-1].colors = np.repeat(np.array(self._colours, np.uint8)[:, None], 2, axis=1)
            self._blocks[-1].visible = True

    def _begin_block(self) -> None:
        if len(self._blocks) == MOST_BLOCKS:
            self._blocks.pop(0).remove()
        self._made += 1
        self._blocks.append(
            self._scene.add_line_segments(
                f"/{self._name} path {self._made}",
                np.zeros((1, 2, 3), np.float32),
                COMMANDED,
                thickness=PATH_WIDTH,
                thickness_units="screen",
                visible=False,
            )
        )
