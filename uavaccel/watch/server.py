"""The page's web server, viser's, which is imported when a page is opened.

Every website that the spectator opens could send requests here too. So the server answers those alone that name this
machine (`Host`: a website's own name may lead here), and that a page of its own has made (`Origin`). A browser that no
longer reads is dropped; one that reads slowly gets the latest state instead of all of them.
"""

from __future__ import annotations

import errno
import importlib.util
import io
import logging
import socket
from collections.abc import Collection, Iterator
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from uavaccel.errors import UserError

if TYPE_CHECKING:
    from viser import GuiDropdownHandle, ViserServer
    from websockets import Headers

UNREAD_MS = 10_000  # for so long a browser may leave what was sent unread
BRAND = (0, 114, 178)


def check_viser() -> None:
    """Raise UserError where viser is missing."""
    if importlib.util.find_spec("viser") is None:
        raise UserError("watch: needs the package viser: pip install 'uavaccel[watch]'")


def free_port(host: str, port: int) -> int:
    """Return the first free port from `port` on; without one, and for a foreign address, viser would wait for ever.

    Raises UserError where the address is not one of this machine, or all these ports are taken.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for free in range(port, 1 << 16):
        try:
            socket.create_server((host, free), family=family).close()
            return free
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                reason = (error.strerror or str(error)).partition(" (while")[0]
                raise UserError(f"the page cannot be opened at {host}:{port}: {reason}") from None
    raise UserError(f"the page cannot be opened at {host}: no port is free from {port} on")


def open_server(host: str, port: int) -> ViserServer:
    """Open a page, without a word, at the first free port from `port` on.

    Raises UserError where viser is missing, and as `free_port` does.
    """
    check_viser()
    port = free_port(host, port)
    import viser

    with redirect_stdout(io.StringIO()), _guarded(host):  # it greets, even where it is asked to be silent
        server = viser.ViserServer(host=host, port=port, label="uavaccel watch", verbose=False)
    server.gui.configure_theme(
        control_layout="collapsible", show_logo=False, show_share_button=False, brand_color=BRAND
    )
    server.gui.set_panel_label("uavaccel watch")
    return server


def is_ours(headers: Headers, host: str) -> bool:
    """Return whether a request may be answered: it names this machine, and no other page has made it.

    This machine has its own names, `host`, and any number, which no website can have.
    """
    named, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(named) != 1 or not {origin.lower() for origin in origins} <= {
        f"{scheme}://{named[0]}".lower() for scheme in ("http", "https")
    }:
        return False
    own = socket.gethostname().lower()
    try:
        name = urlsplit(f"//{named[0]}").hostname or ""
        if name not in {"localhost", host.lower(), own, f"{own}.local"}:
            ip_address(name)
    except ValueError:
        return False
    return True


@contextmanager
def _guarded(host: str) -> Iterator[None]:
    """Guard the server that viser opens in the `with` block, for which viser has no option.

    Raises UserError where viser serves in another way.
    """
    import websockets.asyncio.server as servers

    serve, guards = servers.serve, []
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # what is no request is no traceback here

    def guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if not is_ours(request.headers, host):
                return connection.respond(HTTPStatus.FORBIDDEN, "Open the page at its own address.\n")
            if (unread := getattr(socket, "TCP_USER_TIMEOUT", None)) is not None:
                connection.transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, unread, UNREAD_MS)
            return process_request(connection, request)

        guards.append(answer)
        return serve(*arguments, process_request=answer, **options)

    setattr(servers, "serve", guarded)  # noqa: B010  a function, to a type checker a class
    try:
        yield
    finally:
        setattr(servers, "serve", serve)  # noqa: B010
    if not guards:
        raise UserError("watch: this version of viser cannot be guarded against other websites; take an older one")


def chosen(menu: GuiDropdownHandle[str], known: Collection[str], otherwise: str) -> str:
    """Return what is chosen in a menu, or `otherwise` for what it does not offer, which a page could send."""
    if menu.value not in known:
        setattr(menu, "value", otherwise)  # noqa: B010  to a type checker it cannot be set
    value: str = menu.value
    return value
