"""A policy server: it answers observations over TCP, from another process or another machine. It needs NumPy alone.

    from uavaccel.realtime import serve

    def policy(observation):
        return weights @ observation

    serve(policy, port=5555)

A message is a frame: a head of twelve bytes (MAGIC, and the lengths of what follows as little-endian integers), a
header in JSON, and the bytes of its arrays, little-endian and in C order. Nothing is unpickled, and what is longer than
a frame may be is refused before it is read. The client asks, the server answers each question with one frame:

    hello   version, and the environment's observation and action  hello   version, the policy's name, sha256 and spaces
    reset   the episode's seed, or null                            ready
    act     arrays: an observation                                 action  arrays: the action

or with `error` and a line. A space is a mapping of the names of its arrays, which is "" where it is a single one, to
`dtype`, `shape` and, of a discrete one, `n`. The server's hello may have `values`, too: of each of both spaces, of its
arrays that count, `start`, the least values, and `n`, how many there are.
"""

from __future__ import annotations

import inspect
import json
import math
import socket
import socketserver
import struct
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, repeat
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.files import file_sha256, parse_json
from uavaccel.units import plain, whole

LOOPBACK = "127.0.0.1"
VERSION = 1
MAGIC = b"UAPS"
HEAD = struct.Struct("<4sII")
HEADER_BYTES, BODY_BYTES, READ_BYTES = 1 << 16, 1 << 26, 1 << 18
DTYPES = ("bool", *(f"{kind}{bits}" for kind in ("int", "uint") for bits in (8, 16, 32, 64)))
DTYPES += ("float16", "float32", "float64")
MOST_AXES = 16
PATIENCE_S = 10.0  # for the rest of a frame that has begun
WHAT = ("observation", "action")
END_S = 0.02  # within which a server that serves beside its program ends

Parts = Mapping[str, NDArray[Any]]
Spec = dict[str, dict[str, Any]]


class StreamError(Exception):
    """A stream that is not of this protocol; the connection cannot go on."""


@dataclass
class Frame:
    """A message: its kind, its other entries, and its arrays."""

    kind: str
    entries: Mapping[str, Any] = field(default_factory=dict)
    parts: Parts = field(default_factory=dict)

    def packed(self) -> bytes:
        """Return the frame's bytes. Raises StreamError for arrays that no frame holds, and for too many bytes."""
        arrays = {name: np.asarray(part, order="C") for name, part in self.parts.items()}
        for name, array in arrays.items():
            if array.dtype.name not in DTYPES or array.ndim > MOST_AXES:
                raise StreamError(f"{name or 'it'} is {array.dtype} {array.shape}, no array of numbers")
        forms = [[name, array.dtype.name, array.shape] for name, array in arrays.items()]
        header = json.dumps({**self.entries, "kind": self.kind, "parts": forms}).encode()
        body = b"".join(array.astype(array.dtype.newbyteorder("<")).tobytes() for array in arrays.values())
        _check_lengths(len(header), len(body))
        return HEAD.pack(MAGIC, len(header), len(body)) + header + body


def read_frame(connection: socket.socket, patience_s: Callable[[], float | None]) -> Frame:
    """Return the frame that arrives; `patience_s` says before each read how long it may take, None: for ever.

    Raises StreamError for what is no frame, and OSError where the connection has ended or the patience has.
    """

    def read(count: int) -> bytes:
        content = bytearray()
        while len(content) < count:
            connection.settimeout(patience_s())
            if not (found := connection.recv(min(count - len(content), READ_BYTES))):
                raise ConnectionResetError
            content += found
        return bytes(content)

    magic, header_bytes, body_bytes = HEAD.unpack(read(HEAD.size))
    if magic != MAGIC:
        raise StreamError("does not speak the policy server's protocol")
    _check_lengths(header_bytes, body_bytes)
    try:
        header = parse_json(read(header_bytes))
        kind, forms = header.pop("kind"), [_form(*form) for form in header.pop("parts")]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise StreamError("sent a frame whose header cannot be read") from error
    if sum(dtype.itemsize * math.prod(shape) for _, dtype, shape in forms) != body_bytes:
        raise StreamError("sent a frame whose arrays have not the length that its header says")
    parts, body, at = {}, read(body_bytes), 0
    for name, dtype, shape in forms:
        count = math.prod(shape)
        parts[name] = np.frombuffer(body, dtype.newbyteorder("<"), count, at).astype(dtype).reshape(shape)
        at += count * dtype.itemsize
    return Frame(str(kind), header, parts)


def _form(name: str, dtype: str, shape: list[int]) -> tuple[str, np.dtype[Any], list[int]]:
    axes = [each for each in shape if type(each) is int and 0 <= each <= BODY_BYTES]
    if not isinstance(name, str) or dtype not in DTYPES or len(axes) < len(shape) or len(axes) > MOST_AXES:
        raise ValueError
    if math.prod(filter(None, axes)) > BODY_BYTES:  # NumPy counts the others beside an axis of no length, too
        raise ValueError
    return name, np.dtype(dtype), axes


def _check_lengths(header_bytes: int, body_bytes: int) -> None:
    if header_bytes > HEADER_BYTES or body_bytes > BODY_BYTES:
        raise StreamError(
            f"a frame of {header_bytes:,} + {body_bytes:,} bytes is too large: at most {HEADER_BYTES:,} + "
            f"{BODY_BYTES:,} are read"
        )


def spec_of(space: Any) -> Spec:
    """Return what the protocol says of a Gymnasium space. Raises UserError for one that it does not carry."""
    from gymnasium import spaces  # whoever has a space has Gymnasium

    if isinstance(space, spaces.Dict):
        found = {name: spec_of(part).get("") for name, part in space.spaces.items()}
        if all(found.values()) and "" not in found:
            return {name: part for name, part in found.items() if part is not None}
    if isinstance(space, spaces.Discrete):
        return {"": {"dtype": "int64", "shape": [], "n": int(space.n)}}
    if isinstance(space, spaces.Box | spaces.MultiBinary | spaces.MultiDiscrete) and space.dtype.name in DTYPES:
        return {"": {"dtype": space.dtype.name, "shape": [int(size) for size in space.shape]}}
    raise UserError(f"policy server: carries arrays, and dictionaries of arrays, not a {space}")


def values_of(space: Any) -> dict[str, dict[str, Any]]:
    """Return what the protocol says of the values of a space's arrays that count."""
    from gymnasium import spaces

    parts: Mapping[str, Any] = space.spaces if isinstance(space, spaces.Dict) else {"": space}
    counts = {name: part.n for name, part in parts.items() if isinstance(part, spaces.Discrete)}
    counts |= {name: part.nvec for name, part in parts.items() if isinstance(part, spaces.MultiDiscrete)}
    return {name: {"start": plain(parts[name].start), "n": plain(count)} for name, count in counts.items()}


def spec_text(spec: object) -> str:
    """Return a space or its values in words, as in "float32 (17,)" and "one of 3 from 0"; what is none, as it is."""
    try:
        parts = [(name, _part_text(part)) for name, part in spec.items()]  # type: ignore[attr-defined]
    except (AttributeError, KeyError, TypeError):
        return repr(spec)[:200]
    return ", ".join(f"{name} {text}".strip() for name, text in parts)


def _part_text(part: Mapping[str, Any]) -> str:
    if "n" not in part:
        return f"{part['dtype']} {tuple(part['shape'])}"
    return f"one of {part['n']} from {part['start']}" if "start" in part else f"one of {part['n']}"


def one_line(said: object) -> str:
    """Return what an error or a stranger says as one line of at most 200 printable characters."""
    return "".join(each for each in " ".join(str(said).split())[:200] if each.isprintable())


def identity_of(policy: Any) -> tuple[str, str | None]:
    """Return a policy's name and hash: its own `name` and `sha256`, or those of the function and of its file.

    The hash is None where no file has the code. What a function holds beside its code, as weights, is in no file.
    """
    if isinstance(name := getattr(policy, "name", None), str) and hasattr(policy, "sha256"):
        return name, policy.sha256
    policy = getattr(policy, "func", policy)  # of a functools.partial
    owner = policy if inspect.isroutine(policy) else type(policy)
    try:
        file = Path(inspect.getsourcefile(owner) or "")
        code = file_sha256(file) if file.is_file() else None
    except (TypeError, UserError):  # without a file, or not readable
        code = None
    return getattr(owner, "__qualname__", type(policy).__qualname__), code


def begin(policy: Any, seed: int | None) -> None:
    """Begin an episode: call the policy's `reset`, if it has one, with the seed, if it takes one."""
    if callable(reset := getattr(policy, "reset", None)):
        try:
            inspect.signature(reset).bind(seed)
        except (TypeError, ValueError):  # it takes none, or does not say
            reset()
        else:
            reset(seed)


class PolicyServer(socketserver.ThreadingTCPServer):
    """Serves a policy: anything that returns the action for an observation; a `reset` is called before an episode.

    It listens on `host`, loopback by default, and on `port`, by default one that is free; `address` says which. There
    is neither a password nor encryption: to another machine, tunnel it. Each client has a thread, the policy is asked
    by one at a time; one that has a state, and so a `reset`, serves one client. `env`, or anything with its two spaces,
    says what the policy was made for, and refuses other clients. As a context it serves in a thread of this process.
    Raises UserError where it cannot listen.
    """

    daemon_threads = allow_reuse_address = True

    def __init__(self, policy: Any, port: int = 0, host: str = LOOPBACK, env: Any = None) -> None:
        if (number := whole(port)) is None or not 0 <= number <= 65535:
            raise UserError(f"port: must be 0 to 65535, not {port!r}")
        self.policy, self.lock = policy, threading.Lock()
        name, sha256 = identity_of(policy)
        self.about: dict[str, Any] = {"version": VERSION, "name": name, "sha256": sha256}
        for what in WHAT:
            self.about[what] = None if env is None else spec_of(getattr(env, f"{what}_space"))
        if env is not None:
            self.about["values"] = {what: values_of(getattr(env, f"{what}_space")) for what in WHAT}
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, number), _Conversation)
        except OSError as error:
            raise UserError(f"policy server: cannot listen on {host}:{port}: {error.strerror or error}") from error
        at = f"[{host}]" if ":" in host else host
        self.address = f"tcp://{at}:{self.server_address[1]}"

    def __enter__(self) -> Self:
        threading.Thread(target=self.serve_forever, args=(END_S,), daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        self.shutdown()
        self.server_close()


def serve(policy: Any, port: int = 0, host: str = LOOPBACK, env: Any = None) -> None:
    """Serve a policy, as a `PolicyServer`, until Ctrl-C; the first line on standard output is its address."""
    server = PolicyServer(policy, port, host, env)
    with suppress(KeyboardInterrupt):
        print(server.address, flush=True)
        server.serve_forever()
    server.server_close()


class _Conversation(socketserver.BaseRequestHandler):
    """One client's connection."""

    server: PolicyServer
    request: socket.socket

    def handle(self) -> None:
        self.request.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with suppress(OSError):  # the client has gone, or stays silent in the middle of a frame
            try:
                self._check_version(self._read())
                self._send(Frame("hello", self.server.about).packed())
                while True:
                    self._send(self._answer_to(self._read()))
            except StreamError as error:
                self._send(_refusal(f"the client {error}"))

    def _check_version(self, hello: Frame) -> None:
        if hello.kind != "hello" or (theirs := hello.entries.get("version")) != VERSION:
            theirs = theirs if hello.kind == "hello" else "none"
            raise StreamError(f"speaks version {one_line(theirs)} of the protocol, the server {VERSION}")

    def _answer_to(self, question: Frame) -> bytes:
        policy, parts = self.server.policy, question.parts
        if question.kind not in ("reset", "act"):
            raise StreamError(f"asks for {one_line(question.kind)!r}, where reset and act are known")
        try:
            with self.server.lock:
                if question.kind == "reset":
                    begin(policy, question.entries.get("seed"))
                    return Frame("ready").packed()
                action = policy(parts[""][()] if "" in parts else dict(parts))
            return Frame("action", parts={"": np.asarray(action)}).packed()
        except StreamError as error:
            return _refusal(f"the policy's action: {error}")
        except Exception as error:  # whatever a policy of anybody's raises
            traceback.print_exc(file=sys.stderr)
            return _refusal(f"the policy raised {type(error).__name__}: {error}")

    def _read(self) -> Frame:
        """Return the next question, for which is waited as long as the client likes, but not within it."""
        return read_frame(self.request, chain([None], repeat(PATIENCE_S)).__next__)

    def _send(self, answer: bytes) -> None:
        self.request.settimeout(PATIENCE_S)
        self.request.sendall(answer)


def _refusal(said: str) -> bytes:
    return Frame("error", {"line": one_line(said)}).packed()
