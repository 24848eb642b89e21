"""The process of a page that looks on at the flights of another process.

    python -m uavaccel.watch.live '{"host": "127.0.0.1", "port": 8080, "socket": PATH, "title": "...", "parent": 1}'

prints one line of JSON, {"port": ...}, when the page can be opened, and {"opened": true} once a browser has opened it.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import sys
from pathlib import Path

from uavaccel.processes.lifetime import end_with_parent

NICENESS = 5  # the flight goes first


def main() -> None:
    options = json.loads(sys.argv[1])
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it ends at Ctrl-C, which releases a flight that it holds
    folder = Path(options["socket"]).parent  # the parent's, and for this alone
    end_with_parent(options["parent"], lambda: shutil.rmtree(folder, ignore_errors=True))
    os.nice(NICENESS)
    from uavaccel.watch.feed import Feed
    from uavaccel.watch.live_page import LivePage
    from uavaccel.watch.server import open_server

    feed = Feed(Path(options["socket"]))
    server = open_server(options["host"], options["port"])
    page = LivePage(server, feed, options["title"], lambda: tell({"opened": True}))
    tell({"port": server.get_port()})
    page.run()


def tell(message: dict[str, object]) -> None:
    """Print a line for the process that has started this one, if it still reads."""
    with contextlib.suppress(OSError):
        print(json.dumps(message), flush=True)


if __name__ == "__main__":
    main()
