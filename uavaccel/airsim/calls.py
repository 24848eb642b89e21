"""What the parts of a client share."""

from __future__ import annotations

from uavaccel.airsim.connection import Connection


class Calls:
    """Calls over a connection."""

    client: Connection
