"""A client with the names, arguments, futures and bytes of AirSim's MultirotorClient, so that tests need no airsim.

Like the original it never sets TCP_NODELAY.
"""

# ruff: noqa: N802  the names are AirSim's

import socket
from types import SimpleNamespace
from typing import Any, Self

import msgpack

MOVE = (0, {"is_rate": True, "yaw_or_rate": 0.0}, "")  # the last arguments of moveByVelocity and moveByVelocityZ


class RPCError(Exception):
    """The server's error text."""


class Future:
    def __init__(self, client: "MultirotorClient", message_id: int) -> None:
        self._client, self._message_id = client, message_id
        self.done = False
        self.error: str | None = None
        self.result: Any = None

    def join(self) -> None:
        while not self.done:
            self._client.receive()

    def get(self) -> Any:
        self.join()
        if self.error is not None:
            raise RPCError(self.error)
        return self.result


class MultirotorClient:
    def __init__(self, ip: str = "", port: int = 41451, timeout_value: float = 60) -> None:
        self._socket = socket.create_connection((ip or "127.0.0.1", port), timeout=timeout_value)
        self.address = self._socket.getsockname()
        self._unpacker = msgpack.Unpacker(raw=False)
        self._futures: dict[int, Future] = {}
        self._next_id = 0

    def call_async(self, method: str, *params: Any) -> Future:
        self._next_id += 1
        future = self._futures[self._next_id] = Future(self, self._next_id)
        # msgpack 0.5's format, as airsim 1.8.1 sends it: text and bytes alike are raw
        self._socket.sendall(msgpack.packb([0, self._next_id, method, params], use_bin_type=False))
        return future

    def call(self, method: str, *params: Any) -> Any:
        return self.call_async(method, *params).get()

    def receive(self) -> None:
        data = self._socket.recv(1 << 16)
        if not data:
            raise ConnectionError("the server closed the connection")
        self._unpacker.feed(data)
        for _, message_id, error, result in self._unpacker:
            future = self._futures.pop(message_id)
            future.done, future.error, future.result = True, error, result

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # --- AirSim's names ---------------------------------------------------------------------------

    def __getattr__(self, name: str) -> Any:
        """AirSim's methods whose calls have their names: `moveByVelocityAsync` and the like return a future."""
        if name.startswith("_"):
            raise AttributeError(name)
        if name.endswith("Async"):
            return lambda *given: self.call_async(name.removesuffix("Async"), *given, *MOVE[len(given) - 4 :])
        return lambda *given: _with_attributes(self.call(name, *given))

    def confirmConnection(self) -> None:
        assert self.ping()
        assert self.call("getServerVersion") >= 1
        assert self.call("getMinRequiredClientVersion") <= 1

    def simIsPause(self) -> bool:
        return bool(self.call("simIsPaused"))


def _with_attributes(value: Any) -> Any:
    """Maps as objects, as airsim's types are."""
    if isinstance(value, dict):
        return SimpleNamespace(**{key: _with_attributes(inner) for key, inner in value.items()})
    return value
