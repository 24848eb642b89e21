"""Where the spectators look from: the first view, a phone's, and one that goes along with the drone."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

FROM_BEHIND = (-1.15, 0.0, 0.85)  # to the first view, in reaches of the flights; x north, y west, z up
LOWER = 0.3  # of the distance, by which a phone's view looks below the flights
FARTHER = 1.5  # on a phone, times the height of the screen over its width
WORTH_M = 0.02  # a move that the view follows


class Views:
    """The browsers' views of a flight around `centre`, of `reach_m` to each side, in MuJoCo's frame."""

    def __init__(self, server: ViserServer, on_first: Callable[[], None]) -> None:
        """`on_first` is called when a browser opens the page and no other has it open."""
        self._server = server
        self._at = np.zeros(3)
        self.look_at(np.zeros(3), 3.0)

        @server.on_client_connect
        def _(client: ClientHandle) -> None:
            self._aim(client)
            if len(server.get_clients()) == 1:
                on_first()

    def look_at(self, centre: NDArray[np.float64], reach_m: float, wide: bool = True) -> None:
        """The first view: from the south and above; of a `wide` scene on a narrow screen from farther off."""
        self._wide = wide
        self._at, self._back = np.array(centre, float), reach_m * np.array(FROM_BEHIND)
        camera = self._server.initial_camera
        camera.look_at, camera.position = self._at, self._at + self._back

    def aim_all(self) -> None:
        """Show the first view to those who look already."""
        for client in self._server.get_clients().values():
            self._aim(client)

    def follow(self, place: NDArray[np.float64]) -> None:
        """Go along with a drone that is at this place now; everyone may turn and zoom as before."""
        moved = np.asarray(place) - self._at
        if float(np.linalg.norm(moved)) < WORTH_M:
            return
        self._at = self._at + moved
        camera = self._server.initial_camera
        camera.look_at, camera.position = self._at, self._at + self._back
        for client in self._server.get_clients().values():
            client.camera.position = client.camera.position + moved

    def _aim(self, client: ClientHandle) -> None:
        back, below = self._back, np.zeros(3)
        if client.camera.aspect < 1.0:  # a phone: the controls take the lower half
            back = FARTHER * self._back / client.camera.aspect if self._wide else self._back
            below[2] = LOWER * float(np.linalg.norm(back))
        client.camera.position = self._at + back
        client.camera.look_at = self._at - below
