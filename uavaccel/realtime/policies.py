"""Policies as they are deployed: a function, a module of PyTorch, a file, or a server; each checks its actions.

A policy is anything that returns the action for an observation. If it has a `reset`, that is called before an episode,
with the episode's seed where it takes one: what draws or remembers begins anew there, so that an evaluation repeats.
"""

from __future__ import annotations

import hashlib
import reprlib
import socket
import sys
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Protocol, cast
from urllib.parse import urlsplit

import numpy as np
from gymnasium import spaces

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.files import file_sha256
from uavaccel.own_code import errors_named, own_function, takes, trusting
from uavaccel.realtime.policy_files import BatchPolicy, Space, form_of, module_policy, policy_file
from uavaccel.realtime.server import (
    VERSION,
    WHAT,
    Frame,
    StreamError,
    begin,
    identity_of,
    one_line,
    read_frame,
    spec_of,
    spec_text,
    values_of,
)
from uavaccel.units import NS_PER_S, real

TCP = "tcp"
ANSWER_S = 10.0


class Spaces(Protocol):
    """An environment, or what else has its two spaces."""

    observation_space: Any
    action_space: Any


class Policy:
    """A policy for one environment's spaces, whose actions are checked.

    `name` and `sha256` say what it is: the hash of its file or its weights, that a server tells, or None. Raises
    UserError, one line that begins with the name, for an answer that is no action, and where a server fails.
    """

    def __init__(self, name: str, sha256: str | None, act: Callable[[Any], Any], actions: Space, state: Any = None):
        """`state` has the `reset` and the `close` of the policy, if it has any."""
        self.name, self.sha256 = name, sha256
        self._act, self._actions, self._state = act, actions, state

    def __call__(self, observation: Any) -> Any:
        """Return the action for an observation, in the type of its space: some environments refuse any other."""
        action, wanted = fitting(self._act(observation), self._actions, self.name), cast(Any, self._actions.dtype)
        if isinstance(action, np.ndarray) and action.dtype != wanted and np.can_cast(action.dtype, wanted, "same_kind"):
            with np.errstate(over="ignore"):  # infinite then, and so no action
                return fitting(action.astype(wanted), self._actions, self.name)
        return action

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode."""
        begin(self._state, seed)

    def close(self) -> None:
        """End the connection to a server."""
        if isinstance(self._state, RemotePolicy):
            self._state.close()


def load_policy(policy: Any, env: Spaces, trust: bool = False, answer_s: float = ANSWER_S) -> Policy:
    """Return the policy for an environment.

    `policy` is a function or another callable; a module of PyTorch, which is set to evaluate and given batches of one;
    or a text: a file of stable-baselines3 (.zip), ONNX (.onnx) or TorchScript (.pt, .pth, .ts), a function of one's
    own, as in `file.py:function` and `module:function`, or `tcp://host:port`, a policy server, which has `answer_s` for
    an answer. A function, a TorchScript file, and what has to be unpickled, is code: it runs once it is trusted, as
    `trust` says.

    Raises UserError where there is no such policy, where it is not trusted, and where it does not fit the environment.
    """
    with trusting(trust):
        if isinstance(policy, str | Path):
            return _found(str(policy), env, answer_s)
    if isinstance(policy, Policy):
        return policy
    name, sha256 = identity_of(policy)
    if (torch := sys.modules.get("torch")) is not None and isinstance(policy, torch.nn.Module):
        act = _of_one(module_policy(policy.eval(), env.action_space, name))
        return Policy(name, _hash_of_weights(policy), act, env.action_space, policy)
    if not callable(policy):
        raise UserError(f"policy: must be a function of an observation, a file or tcp://host:port, not {policy!r}")
    return Policy(name, sha256, policy, env.action_space, policy)


def _found(name: str, env: Spaces, answer_s: float) -> Policy:
    seen, actions = env.observation_space, env.action_space
    if name.startswith(f"{TCP}:"):
        remote = RemotePolicy(name, env, answer_s)
        return Policy(name, remote.sha256, remote, actions, remote)
    if (file := policy_file(name)) is not None:
        for what, own, of_env in file.forms(seen, actions):
            if own != of_env:
                raise UserError(f"{name}: its {what} are {own}, the environment's {of_env}")
        act = _of_one(file.load(seen, actions))
        return Policy(name, file_sha256(file.file), act, actions, file.state)
    if ":" not in name:
        wanted = "a file (.zip, .onnx, .pt), file.py:function, module:function or tcp://host:port"
        raise UserError(f"policy {name!r}: is none that is known: name {wanted}")
    function, code = own_function(name, f"policy {name!r}")
    if not takes(function, 1):
        raise UserError(f"policy {name!r}: must take an observation alone")
    called = _OwnFunction(name, code, function)
    return Policy(name, file_sha256(code), called, actions, called)


@dataclass
class _OwnFunction:
    """A function of a file, whose errors are one line that names the file."""

    name: str
    file: Path
    function: Callable[[Any], Any]

    def __call__(self, observation: Any) -> Any:
        with errors_named(self.file, self.name):
            return self.function(observation)

    def reset(self, seed: int | None) -> None:
        with errors_named(self.file, self.name):
            begin(self.function, seed)


def _of_one(policy: BatchPolicy) -> Callable[[Any], Any]:
    """Return a policy of batches as one of single observations."""

    def act(observation: Any) -> Any:
        if isinstance(observation, Mapping):
            return policy({name: np.asarray(part)[None] for name, part in observation.items()})[0]
        return policy(np.asarray(observation)[None])[0]

    return act


def _hash_of_weights(module: Any) -> str:
    """Return the hash of a module of PyTorch: its printed layers, and its weights by name."""
    digest = hashlib.sha256(str(module).encode())
    for name, weight in sorted(module.state_dict().items()):
        digest.update(f"{name} {weight.dtype} {tuple(weight.shape)}".encode())
        digest.update(weight.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def fitting(given: Any, space: Space, name: str) -> Any:
    """Return an action as an array, of discrete ones as an int, or of other spaces as it is given.

    Raises UserError, which begins with `name`, where it is no action: for its shape, for what is no number, and for
    NaN. It may be beyond the bounds of a Box.
    """
    if not isinstance(space, spaces.Discrete | spaces.Box):
        if space.contains(given):
            return given
        raise UserError(f"{name}: returned {reprlib.repr(given)}, where an action is one of {space}")
    try:
        action = np.asarray(given)
    except ValueError:  # of lists of different lengths
        action = np.asarray(None)
    except (RuntimeError, TypeError) as error:  # of a tensor that learns, or is on a GPU
        raise UserError(f"{name}: returned {reprlib.repr(given)}: {one_line(error)}") from error
    if isinstance(space, spaces.Discrete):
        fits = action.shape == () and action.dtype.kind in "iu" and bool(space.contains(int(action)))
    else:
        fits = action.shape == space.shape and action.dtype.kind in "fiu" and bool(np.isfinite(action).all())
    if fits:
        return int(action) if isinstance(space, spaces.Discrete) else action
    what = f"{action.dtype} {action.shape}" if action.ndim else reprlib.repr(given)
    if action.shape == space.shape and action.dtype.kind == "f":
        what = f"{what} with NaN or infinity" if action.ndim else what
    raise UserError(f"{name}: returned {what}, where an action is {form_of(space)}")


class RemotePolicy:
    """The policy of a server at `tcp://host:port`, in another process or on another machine.

    It connects at once, and again where a connection was lost, to the same policy. What the server sends becomes
    numbers, and nothing else. Raises UserError, one line that begins with the address, where none is there, where it
    ends, has not answered within `answer_s` seconds, answers with an error, or speaks another protocol, and where its
    policy was made for other spaces.
    """

    def __init__(self, address: str, env: Spaces, answer_s: float = ANSWER_S) -> None:
        parts = urlsplit(address)
        try:
            self._at = parts.hostname, parts.port
        except ValueError:  # a port that is none
            self._at = None, None
        if parts.scheme != TCP or None in self._at or parts.path:
            raise UserError(f"policy {address!r}: must be tcp://host:port, as in tcp://127.0.0.1:5555")
        if (seconds := real(answer_s)) is None or not 0 < seconds <= 3600:
            raise UserError(f"answer_s: must be above 0 and at most 3600 seconds, not {answer_s!r}")
        self.name, self._answer_s, self._clock = address, seconds, MonotonicClock()
        self._spec = {what: spec_of(getattr(env, f"{what}_space")) for what in WHAT}
        self._values = {what: values_of(getattr(env, f"{what}_space")) for what in WHAT}
        self._socket: socket.socket | None = None
        self._about: Mapping[str, Any] | None = None
        self._connect()

    @property
    def sha256(self) -> str | None:
        """The hash of the policy, as the server says it."""
        said = (self._about or {}).get("sha256")
        return one_line(said) if isinstance(said, str) else None

    def __call__(self, observation: Any) -> Any:
        seen = observation if isinstance(observation, Mapping) else {"": observation}
        parts = {name: np.asarray(seen[name], part["dtype"]) for name, part in self._spec["observation"].items()}
        answer = self._ask("action", Frame("act", parts=parts)).parts.get("")
        return None if answer is None else answer[()]

    def reset(self, seed: int | None = None) -> None:
        self._ask("ready", Frame("reset", {"seed": seed}))

    def close(self) -> None:
        """End the connection; the next question would make another one."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self) -> None:
        try:
            self._socket = socket.create_connection(self._at, self._answer_s)
        except (OSError, OverflowError) as error:
            said = getattr(error, "strerror", None) or error
            raise UserError(f"{self.name}: no policy server answers there: {said}") from error
        weakref.finalize(self, self._socket.close)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        about = self._ask("hello", Frame("hello", {"version": VERSION, **self._spec})).entries
        try:
            self._check(about)
        except UserError:
            self.close()
            raise
        self._about = about

    def _check(self, about: Mapping[str, Any]) -> None:
        if (version := about.get("version")) != VERSION:
            raise UserError(f"{self.name}: speaks version {one_line(version)} of the protocol, not {VERSION}")
        values = about["values"] if isinstance(about.get("values"), Mapping) else {}  # not every server says them
        for (own, said), what in product(((self._spec, about), (self._values, values)), WHAT):
            if (theirs := said.get(what)) not in (None, ours := own[what]):
                form = one_line(spec_text(theirs))
                raise UserError(f"{self.name}: its {what}s are {form}, the environment's {spec_text(ours)}")
        if self._about is not None and about.get("sha256") != self._about.get("sha256"):
            raise UserError(f"{self.name}: serves another policy than before: another sha256")

    def _ask(self, kind: str, question: Frame) -> Frame:
        """Return the answer, of that kind."""
        if self._socket is None:
            self._connect()
        assert self._socket is not None
        deadline_ns = self._clock.now_ns() + round(self._answer_s * NS_PER_S)

        def left_s() -> float:
            if (left_ns := deadline_ns - self._clock.now_ns()) > 0:
                return left_ns / NS_PER_S
            raise TimeoutError

        try:
            self._socket.settimeout(self._answer_s)
            self._socket.sendall(question.packed())
            answer = read_frame(self._socket, left_s)
            if answer.kind not in (kind, "error"):
                raise StreamError(f"answered {one_line(answer.kind)!r}, not {kind!r}")
        except BaseException as error:
            self.close()  # an answer that comes late is not one to the next question
            if (said := self._failure(error)) is None:
                raise
            raise UserError(f"{self.name}: {said}") from error
        if answer.kind == "error":
            raise UserError(f"{self.name}: {one_line(answer.entries.get('line', 'an error'))}")
        return answer

    def _failure(self, error: BaseException) -> str | None:
        """Return what an error of the connection means; None for any other."""
        if isinstance(error, TimeoutError):
            return f"has not answered within {self._answer_s:g} s"
        if isinstance(error, OSError):
            return f"the policy server has closed the connection{f': {error.strerror}' if error.strerror else ''}"
        return str(error) if isinstance(error, StreamError) else None
