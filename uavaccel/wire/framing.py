"""Cuts what a client sends into whole messages, without unpacking any: half a message costs its bytes and no more.

Unpacked as they come, nested arrays take a hundred times the memory of their bytes, and one that announces items takes
it before they have come.
"""

from __future__ import annotations

import msgpack

from uavaccel.wire.rpc import MAX_MESSAGE_BYTES, REQUEST, ProtocolError

_LONGEST_HEAD = 16  # bytes of a message's outermost array, its kind and its number
_BEGINNINGS = (  # arrays of three or four: a notification, a request
    *(b"\x93", b"\x94", b"\xdc\x00\x03", b"\xdc\x00\x04"),
    *(b"\xdd\x00\x00\x00\x03", b"\xdd\x00\x00\x00\x04"),
)


class Framer:
    """The messages of one stream of bytes: those that have come whole are handed out one by one."""

    def __init__(self, max_message_bytes: int = MAX_MESSAGE_BYTES) -> None:
        self._most = max_message_bytes
        # it may be fed while whole messages wait
        self._scanner = msgpack.Unpacker(max_buffer_size=2 * max_message_bytes, strict_map_key=False)
        self._kept = bytearray()
        self._passed = 0  # bytes of the messages that have been handed out

    @property
    def held_bytes(self) -> int:
        """What has come and was not handed out, which the scanner may keep too."""
        return 2 * len(self._kept)

    def feed(self, data: bytes) -> None:
        """More of the stream. Raises ProtocolError where that is too much."""
        self._kept += data
        try:
            self._scanner.feed(data)
        except msgpack.BufferFull:
            raise self._too_long() from None

    def next(self) -> bytes | None:
        """The next whole message; None while it is not there. Raises ProtocolError for what is none, or too long."""
        if not self._kept:
            return None
        self._check_beginning()
        try:
            self._scanner.skip()
        except msgpack.OutOfData:
            if len(self._kept) > self._most:
                raise self._too_long() from None
            return None
        except (ValueError, TypeError, msgpack.UnpackException) as error:
            raise ProtocolError(f"not msgpack: {error}") from error
        size = self._scanner.tell() - self._passed
        if size > self._most:
            raise self._too_long()
        self._passed += size
        message = bytes(self._kept[:size])
        del self._kept[:size]
        return message

    def _check_beginning(self) -> None:
        head = bytes(self._kept[:5])
        if not any(head.startswith(known[: len(head)]) for known in _BEGINNINGS):
            raise ProtocolError("not a msgpack-rpc message")

    def _too_long(self) -> ProtocolError:
        return ProtocolError(f"a message may have {self._most >> 20} MiB, not more", self.unfinished_id())

    def unfinished_id(self) -> int | None:
        """The number of the request of which a part has come; None where it has none, or that is not known yet."""
        head = msgpack.Unpacker()
        head.feed(bytes(self._kept[:_LONGEST_HEAD]))
        try:
            head.read_array_header()
            kind, number = head.unpack(), head.unpack()
        except (ValueError, msgpack.UnpackException):
            return None
        return number if kind == REQUEST and isinstance(number, int) else None
