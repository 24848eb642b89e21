"""The page's web server, viser's, which is imported when a page is opened."""

from __future__ import annotations

import errno
import importlib.util
import io
import socket
from contextlib import redirect_stdout
from typing import TYPE_CHECKING

from uavaccel.errors import UserError

if TYPE_CHECKING:
    from viser import ViserServer

MISSING = "watch: needs the package viser: pip install 'uavaccel[watch]'"
UPDATES_PER_S = 30
PICTURES_EVERY = 3  # updates
BRAND = (0, 114, 178)


def check_viser() -> None:
    """Raise UserError where viser is missing."""
    if importlib.util.find_spec("viser") is None:
        raise UserError(MISSING)


def free_port(host: str, port: int) -> int:
    """Return the first free port from `port` on; without one, and for a foreign address, viser would wait for ever.

    Raises UserError where the address is not one of this machine, or all these ports are taken.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for each in range(port, 1 << 16):
        try:
            socket.create_server((host, each), family=family).close()
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                reason = (error.strerror or str(error)).partition(" (while")[0]
                raise UserError(f"the page cannot be opened at {host}:{port}: {reason}") from None
        else:
            return each
    raise UserError(f"the page cannot be opened at {host}: no port is free from {port} on")


def open_server(host: str, port: int) -> ViserServer:
    """Open a page, without a word, at the first free port from `port` on.

    Raises UserError where viser is missing, and as `free_port` does.
    """
    check_viser()
    port = free_port(host, port)
    import viser

    with redirect_stdout(io.StringIO()):  # it greets, even where it is asked to be silent
        server = viser.ViserServer(host=host, port=port, label="uavaccel watch", verbose=False)
    server.gui.configure_theme(
        control_layout="collapsible", show_logo=False, show_share_button=False, brand_color=BRAND
    )
    server.gui.set_panel_label("uavaccel watch")
    return server
