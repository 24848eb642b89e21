"""A policy in another process: it acts as it does in this one; and one that fails is one line, and nothing hangs."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from itertools import cycle, permutations
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import stable_baselines3 as sb3
from gymnasium import spaces

from tests.processes import state_of
from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.files import file_sha256
from uavaccel.realtime import PolicyServer, RealTime, RemotePolicy, load_policy, measure
from uavaccel.realtime.server import BODY_BYTES, MAGIC, READ_BYTES, Frame, identity_of, read_frame, spec_of, spec_text

pytestmark = pytest.mark.usefixtures("whole_messages")

PACKAGE = Path(__file__).parents[1]

STRANGER = """
import sys
from importlib.abc import MetaPathFinder

class Refusing(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        top = name.partition(".")[0]
        if top not in sys.stdlib_module_names and top not in ("uavaccel", *INSTALLED):
            raise ImportError(name)

sys.meta_path.insert(0, Refusing())
"""
"""Python with the packages INSTALLED alone."""
POLICY = """
from uavaccel.realtime import serve

def policy(seen):
    return [3.0 * seen[1] + 0.5 * seen[3]]

serve(policy)
"""


class Spaces:
    observation_space: Any = spaces.Box(-1.0, 1.0, (3,), np.float32)
    action_space: Any = spaces.Box(-1.0, 1.0, (2,), np.float32)


class Other(Spaces):
    observation_space: Any = spaces.Box(-1.0, 1.0, (4,), np.float32)


SEEN = np.array([0.25, -0.5, 1.0], np.float32)


@contextmanager
def process(program: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A server's process, and its address."""
    command, environment = [sys.executable, "-c", program], {**os.environ, "PYTHONPATH": str(PACKAGE)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            yield server, server.stdout.readline().strip()
        finally:
            server.kill()


@contextmanager
def impostor(converse: Callable[[socket.socket], object]) -> Iterator[str]:
    """Anything that listens: it does as `converse` says with its first client."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def accept() -> None:
            connection, _ = listening.accept()
            with connection:
                try:
                    converse(connection)
                except OSError:
                    return

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        yield f"tcp://127.0.0.1:{listening.getsockname()[1]}"


def received(connection: socket.socket) -> Frame:
    return read_frame(connection, lambda: 30.0)


def hello(**entries: Any) -> bytes:
    about = {"version": 1, "name": "policy", "sha256": None, "observation": None, "action": None}
    return Frame("hello", {**about, **entries}).packed()


def answering(answer: bytes) -> Callable[[socket.socket], object]:
    """Greets, then answers every question so, until the client has gone."""

    def converse(connection: socket.socket) -> None:
        received(connection)
        connection.sendall(hello())
        while True:
            received(connection)
            connection.sendall(answer)

    return converse


def acting(address: str, answer_s: float = 30.0) -> Any:
    return load_policy(address, Spaces(), answer_s=answer_s)(SEEN)


# --- it acts as it does in this process -------------------------------------------------------------------------------


def flown(policy: Any) -> tuple[list[bytes], float]:
    """Observations and return of an episode in real time."""
    env = RealTime(gymnasium.make("InvertedPendulum-v5"), latency_s=0.02)
    loaded = load_policy(policy, env)
    (seen, _), total, over = env.reset(seed=3), 0.0, False
    observations: list[bytes] = []
    loaded.reset(3)
    while not over and len(observations) < 50:
        seen, reward, terminated, truncated, _ = env.step(loaded(seen))
        total, over = total + reward, terminated or truncated
        observations.append(seen.tobytes())
    loaded.close()
    return observations, total


def test_a_stranger_serves_with_numpy_alone_and_acts_to_the_bit() -> None:
    with process(STRANGER.replace("INSTALLED", "['numpy']") + POLICY) as (_, address):
        assert address.startswith("tcp://127.0.0.1:")
        assert flown(address) == flown(lambda seen: [3.0 * seen[1] + 0.5 * seen[3]])


@pytest.mark.parametrize(
    ("seen", "actions", "given"),
    [
        (spaces.Dict({"picture": spaces.Box(0, 255, (2, 3), np.uint8), "at": spaces.Box(-1, 1, (1,))}), 3, 2),
        (spaces.Discrete(5), 3, 0),
        (spaces.Box(-1, 1, (0,)), 2, 1),
    ],
    ids=["dictionary", "discrete", "empty"],
)
def test_observations_arrive_as_they_were(seen: spaces.Space[Any], actions: int, given: int) -> None:
    arrived: list[Any] = []

    def policy(observation: Any) -> int:
        arrived.append(observation)
        return given

    env = Spaces()
    env.observation_space, env.action_space = seen, spaces.Discrete(actions)
    seen.seed(0)
    observation = seen.sample()
    with PolicyServer(policy, env=env) as server:
        assert load_policy(server.address, env)(observation) == given
    there, here = ((each if isinstance(each, dict) else {"": each}) for each in (arrived[0], observation))
    assert there.keys() == here.keys()
    for name, part in here.items():
        np.testing.assert_array_equal(there[name], part)
        assert there[name].dtype == np.asarray(part).dtype


def test_a_frame_arrives_as_it_was() -> None:
    """Of every type, in whatever order its bytes are, longer than a read, and its arrays can be written to."""
    random, shapes = np.random.default_rng(0), cycle([(), (3,), (2, 0), (5, 2, 3)])
    parts = {kind: np.asarray(random.integers(0, 99, next(shapes))).astype(kind) for kind in "?bhiqBHIQefd"}
    parts |= {"turned": np.arange(12.0).reshape(3, 4).T, "big": np.arange(7, dtype=">i4"), "": np.arange(9)[::-2]}
    sent = Frame("act", {"seed": 5, "line": "ü\n"}, {**parts, "long": random.random(READ_BYTES // 8 + 3)})
    here, there = socket.socketpair()
    with here, there, ThreadPoolExecutor(1) as pool:
        pool.submit(here.sendall, 2 * sent.packed())
        for got in (received(there), received(there)):
            assert (got.kind, got.entries, [*got.parts]) == (sent.kind, sent.entries, [*sent.parts])
            for name, part in sent.parts.items():
                np.testing.assert_array_equal(got.parts[name], part)
                assert got.parts[name].dtype == part.dtype.newbyteorder("=")
                assert got.parts[name].flags.writeable


def test_a_space_is_said_as_it_is_sent_and_a_policy_by_its_code() -> None:
    at, of = spaces.Box(0, 9, (3, 4), np.uint8), spaces.Dict({"of": spaces.Discrete(5), "at": spaces.MultiBinary(4)})
    said = {"at uint8 (3, 4), to int64 (2,)": spaces.Dict({"to": spaces.MultiDiscrete([3, 4]), "at": at})}
    for text, space in {**said, "at int8 (4,), of one of 5": of, "float32 (3,)": Spaces.observation_space}.items():
        assert spec_text(json.loads(json.dumps(spec_of(space)))) == text
    for policy in (nothing, partial(nothing, seen=1)):
        assert identity_of(policy) == ("nothing", file_sha256(Path(__file__)))
    assert identity_of(len) == ("len", None)


def test_a_server_says_what_it_serves_and_resets_its_policy() -> None:
    begun: list[int | None] = []

    class Named:
        name, sha256 = "mine", "ab\x1b\n" * 32

        def __call__(self, seen: Any) -> Any:
            return np.float64(seen[:2])

        def reset(self, seed: int | None) -> None:
            begun.append(seed)

    with PolicyServer(Named()) as server:
        policy = load_policy(server.address, Spaces())
        policy.reset(5)
        policy.reset()
        np.testing.assert_array_equal(policy(SEEN), SEEN[:2])
    assert (policy.name, policy.sha256, begun) == (server.address, "ab " * 31 + "ab", [5, None])


@pytest.mark.skipif(not Path("/proc/net/if_inet6").exists(), reason="this machine has no IPv6")
def test_an_address_of_ipv6_is_served_and_asked() -> None:
    with PolicyServer(lambda seen: np.float64(seen[:2]), host="::1") as server:
        assert server.address.startswith("tcp://[::1]:")
        np.testing.assert_array_equal(load_policy(server.address, Spaces())(SEEN), SEEN[:2])


def test_a_file_is_served_by_its_name_and_hash(tmp_path: Path) -> None:
    env: Any = gymnasium.make("CartPole-v1")
    model = sb3.PPO("MlpPolicy", env, policy_kwargs={"net_arch": [4]}, device="cpu")
    model.save(file := tmp_path / "model.zip")
    with PolicyServer(load_policy(file, env), env=env) as server:
        policy = load_policy(server.address, env)
        assert (policy.sha256, server.about["name"]) == (file_sha256(file), str(file))
        for seen in np.random.default_rng(0).normal(size=(5, 4)).astype(np.float32):
            assert policy(seen) == model.predict(seen, deterministic=True)[0]


def test_a_slow_servers_round_trips_are_measured_as_such() -> None:
    clock, slow_ns = MonotonicClock(), 20_000_000

    def slow(seen: Any) -> list[float]:
        clock.sleep_until(clock.now_ns() + slow_ns)
        return [0.0]

    with PolicyServer(slow) as server:
        found = measure("InvertedPendulum-v5", server.address, steps=10, warm_up=1)
    assert min(found.taken_ns) >= slow_ns
    assert found.about["policy"]["name"] == server.address


# --- it fails, in one line ------------------------------------------------------------------------------------------


def test_a_killed_server_is_one_line_and_its_successor_is_found() -> None:
    with process(POLICY) as (server, address):
        policy = RemotePolicy(address, gymnasium.make("InvertedPendulum-v5"))
        server.send_signal(signal.SIGKILL)
        server.wait()
        with pytest.raises(UserError, match=f"^{address}: the policy server has closed the connection"):
            policy(np.zeros(4))
        reset = ConnectionResetError(104, "Connection reset by peer")
        assert policy._failure(reset) == "the policy server has closed the connection: Connection reset by peer"
        with pytest.raises(UserError, match=f"^{address}: no policy server answers there: Connection refused$"):
            policy(np.zeros(4))
        with process(POLICY.replace("serve(policy)", f"serve(policy, {address.rpartition(':')[2]})")) as (_, again):
            assert again == address
            assert policy(np.ones(4)) == 3.5


def test_a_server_that_was_stopped_is_one_line_and_goes_on_later() -> None:
    with process(POLICY) as (server, address):
        policy = RemotePolicy(address, gymnasium.make("InvertedPendulum-v5"), answer_s=2)
        server.send_signal(signal.SIGSTOP)
        while state_of(server.pid) != "T":
            assert server.poll() is None
        with pytest.raises(UserError, match=f"^{address}: has not answered within 2 s$"):
            policy(np.ones(4))
        server.send_signal(signal.SIGCONT)
        policy = RemotePolicy(address, gymnasium.make("InvertedPendulum-v5"))
        assert policy(np.ones(4)) == 3.5


def test_an_answer_that_comes_late_is_not_taken_for_the_next() -> None:
    asked = threading.Event()

    def slow(seen: Any) -> Any:
        if seen[0] > 0:
            asked.set()
            clock = MonotonicClock()
            clock.sleep_until(clock.now_ns() + 500_000_000)
        return seen[:2]

    def interrupt() -> None:
        asked.wait()
        os.kill(os.getpid(), signal.SIGINT)

    with PolicyServer(slow) as server:
        policy = load_policy(server.address, Spaces())
        impatient = load_policy(server.address, Spaces(), answer_s=0.2)
        with pytest.raises(UserError, match="has not answered"):
            impatient(SEEN)
        asked.clear()
        threading.Thread(target=interrupt, daemon=True).start()
        with pytest.raises(KeyboardInterrupt):
            policy(SEEN)
        for each in (policy, load_policy(server.address, Spaces())):
            np.testing.assert_array_equal(each(-SEEN), -SEEN[:2])


def test_a_server_that_only_dribbles_is_not_waited_for() -> None:
    def dribble(connection: socket.socket) -> None:
        received(connection)
        clock = MonotonicClock()
        for byte in hello(filling="x" * 10_000):
            connection.sendall(bytes([byte]))
            clock.sleep_until(clock.now_ns() + 20_000_000)

    with impostor(dribble) as address, pytest.raises(UserError, match=r"has not answered within 0.3 s$"):
        acting(address, answer_s=0.3)


def nothing(seen: Any) -> Any:
    raise ValueError("nothing\nto say")


def too_large(seen: Any) -> Any:
    return np.zeros(BODY_BYTES // 8 + 1)


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        (lambda seen: np.zeros(3), r"returned float64 \(3,\), where an action is \(2,\)"),
        (lambda seen: ["a", "b"], r"the policy's action: it is <U1 \(2,\), no array of numbers"),
        (lambda seen: [1j, 0j], r"the policy's action: it is complex128 \(2,\), no array of numbers"),
        (lambda seen: [True, False], r"returned bool \(2,\), where an action is \(2,\)"),
        (lambda seen: None, r"the policy's action: it is object \(\), no array of numbers"),
        (lambda seen: [np.nan, 0.0], r"returned float64 \(2,\) with NaN or infinity, where an action is \(2,\)"),
        (too_large, r"the policy's action: a frame of \d+ \+ 67,108,872 bytes is too large: at most .*"),
        (nothing, "the policy raised ValueError: nothing to say"),
    ],
    ids=["shape", "text", "complex", "bool", "none", "nan", "large", "raises"],
)
def test_what_a_policy_does_wrong_is_one_line(policy: Any, said: str, capfd: pytest.CaptureFixture[str]) -> None:
    """And its server goes on."""
    failing = True

    def mended(seen: Any) -> Any:
        return policy(seen) if failing else seen[:2]

    with PolicyServer(mended) as server:
        loaded = load_policy(server.address, Spaces())
        with pytest.raises(UserError, match=f"^{server.address}: {said}$") as caught:
            loaded(SEEN)
        assert "\n" not in str(caught.value)
        failing = False
        np.testing.assert_array_equal(loaded(SEEN), SEEN[:2])
    assert ("Traceback" in capfd.readouterr().err) == (policy is nothing)


HEAD = struct.Struct("<4sII")


def framed(shape: str, size: int) -> bytes:
    header = f'{{"kind": "action", "parts": [["", "float64", {shape}]]}}'.encode()
    return HEAD.pack(MAGIC, len(header), size) + header + bytes(size)


@pytest.mark.parametrize(
    ("converse", "said"),
    [
        (lambda to: to.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n"), "does not speak the policy server's protocol"),
        (lambda to: to.sendall(HEAD.pack(MAGIC, 1 << 31, 1 << 31)), "a frame of 2,147,483,648 .* is too large: .*"),
        (lambda to: received(to), "the policy server has closed the connection"),
        (lambda to: (received(to), to.sendall(hello(version=2))), "speaks version 2 of the protocol, not 1"),
        (lambda to: (received(to), to.sendall(Frame("ready").packed())), "answered 'ready', not 'hello'"),
        (answering(HEAD.pack(MAGIC, 2, 0) + b"[]"), "sent a frame whose header cannot be read"),
        (answering(HEAD.pack(MAGIC, 1 << 16, 0) + b"[" * (1 << 16)), "sent a frame whose header cannot be read"),
        (answering(framed("[-1]", 8)), "sent a frame whose header cannot .*"),
        (answering(framed("[1000000000, 1000000000]", 8)), "sent a frame whose header cannot .*"),
        (answering(framed("[0, 60000000, 60000000, 60000000]", 0)), "sent a frame whose header cannot .*"),
        *((answering(framed("[2]", size)), "sent a frame whose arrays have not the length .*") for size in (8, 24)),
        (answering(Frame("action", parts={"": np.zeros(2)}).packed()[:-1]), "has not answered within 0.5 s"),
        (answering(Frame("error", {"line": "a\n\x1b[2Jb"}).packed()), r"a \[2Jb"),
        (answering(Frame("action", parts={"other": SEEN}).packed()), r"returned None, where an action is \(2,\)"),
    ],
)
def test_what_is_no_policy_server_is_one_line(converse: Callable[[socket.socket], object], said: str) -> None:
    with impostor(converse) as address, pytest.raises(UserError, match=f"^{address}: {said}$") as caught:
        acting(address, answer_s=0.5 if "answered within" in said else 30.0)
    assert "\n" not in str(caught.value)


def test_a_server_of_other_spaces_is_one_line() -> None:
    with PolicyServer(lambda seen: seen[:2], env=Other()) as server:
        said = r"its observations are float32 \(4,\), the environment's float32 \(3,\)"
        with pytest.raises(UserError, match=f"^{server.address}: {said}$"):
            load_policy(server.address, Spaces())
    counted = (
        spaces.Discrete(3),
        spaces.Discrete(3, start=1),
        spaces.MultiDiscrete([2, 3]),
        spaces.MultiDiscrete([3, 3]),
    )
    for here, there in permutations(counted, 2):
        env, other = Spaces(), Spaces()
        env.action_space, other.action_space = here, there
        with PolicyServer(nothing, env=env) as server, pytest.raises(UserError, match=r": its actions are .* of "):
            load_policy(server.address, other)
    said = r"its actions are '.x1b\[2J', the environment's float32"

    def escape(connection: socket.socket) -> None:
        received(connection)
        connection.sendall(hello(action="\x1b[2J"))

    with impostor(escape) as address, pytest.raises(UserError, match=f"^{address}: {said}"):
        load_policy(address, Spaces())
    env, at = Spaces(), Spaces.observation_space
    for space in (spaces.Text(5), spaces.Dict({"at": at, "in": spaces.Dict({"at": at})}), spaces.Dict({"": at})):
        env.observation_space = space
        with pytest.raises(UserError, match=r"^policy server: carries arrays, and .* of arrays, not a (Text|Dict)\("):
            PolicyServer(lambda seen: seen, env=env)


def test_an_address_serves_one_policy_for_as_long_as_it_is_used() -> None:
    with PolicyServer(lambda seen: seen[:2]) as server:
        policy = RemotePolicy(server.address, Spaces())
        policy.close()
        server.about["sha256"] = "another"
        with pytest.raises(UserError, match=f"^{server.address}: serves another policy than before: another sha256$"):
            policy(SEEN)


def test_a_client_of_anybodys_neither_ends_a_server_nor_holds_it_up() -> None:
    with PolicyServer(lambda seen: seen[:2]) as server:
        at = ("127.0.0.1", server.server_address[1])
        silent = socket.create_connection(at)
        for sent, said in (
            (b"GET / HTTP/1.1\r\n\r\n", "the client does not speak the policy server's protocol"),
            (HEAD.pack(MAGIC, 10, 1 << 31), "the client a frame of 10 + 2,147,483,648 bytes is too large"),
            (Frame("act").packed(), "the client speaks version none of the protocol, the server 1"),
            (Frame("hello", {"version": 9}).packed(), "the client speaks version 9 of the protocol, the server 1"),
            (hello() + Frame("fly").packed(), "the client asks for 'fly', where reset and act are known"),
        ):
            with socket.create_connection(at) as stranger:
                stranger.sendall(sent)
                answer = received(stranger)
                answer = received(stranger) if answer.kind == "hello" else answer
            assert (answer.kind, answer.entries["line"][: len(said)]) == ("error", said)
        np.testing.assert_array_equal(acting(server.address), SEEN[:2])
        silent.close()


def test_a_policy_is_asked_by_one_client_at_a_time() -> None:
    inside, at_once = list[int](), set[int]()

    def policy(seen: Any) -> Any:
        inside.append(1)
        at_once.add(len(inside))
        threading.Event().wait(0.02)
        inside.pop()
        return seen[:2]

    with PolicyServer(policy) as server, ThreadPoolExecutor(3) as pool:
        clients = [RemotePolicy(server.address, Spaces()) for _ in range(3)]
        for client, action in zip(clients, pool.map(lambda client: client(SEEN), clients), strict=True):
            np.testing.assert_array_equal(action, SEEN[:2])
            client.close()
    assert at_once == {1}


def test_a_port_that_is_taken_is_one_line() -> None:
    with PolicyServer(lambda seen: seen) as server:
        port = server.server_address[1]
        with pytest.raises(UserError, match=f"^policy server: cannot listen on 127.0.0.1:{port}: Address already in"):
            PolicyServer(lambda seen: seen, port)
    for wrong in (99999, "5555"):
        with pytest.raises(UserError, match=f"^port: must be 0 to 65535, not {wrong!r}$"):
            PolicyServer(lambda seen: seen, wrong)  # type: ignore[arg-type]


def test_a_server_ends_quietly_at_ctrl_c() -> None:
    with process(POLICY) as (server, _):
        server.send_signal(signal.SIGINT)
        assert server.wait(30) == 0
