"""uavaccel.airsim against a real server: AirSim's names, types and futures, from any number of threads."""

import io
import math
import socket
import threading
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.serving import running_server
from uavaccel import airsim
from uavaccel.airsim.connection import as_received, as_sent, plain
from uavaccel.units import NS_PER_S
from uavaccel.wire.rpc import RpcError

pytestmark = pytest.mark.wall_clock


@pytest.fixture(scope="module")
def client() -> Iterator[airsim.MultirotorClient]:
    with running_server(clock_speed=50) as server:
        yield airsim.MultirotorClient(port=server.address[1])


def test_flies_and_reads_the_state_as_airsims_types(client: airsim.MultirotorClient) -> None:
    client.confirmConnection()
    client.reset()
    client.enableApiControl(True)
    future = client.moveByVelocityAsync(np.float32(2), 0, 0, 2)  # type: ignore[arg-type]
    told: list[Any] = []
    future.attach_callback(told.append)
    future.attach_result_handler(told.append)
    future.join()
    assert future.result is True
    assert future.error is None
    assert (future.get(), told) == (None, [future, True])  # a handler takes what get would return
    state = client.getMultirotorState()
    assert isinstance(state, airsim.MultirotorState)
    assert isinstance(state.kinematics_estimated.position, airsim.Vector3r)
    assert 1.0 < state.kinematics_estimated.position.x_val < 20
    assert state.ready is False  # not on the wire: the class's default
    assert client.simGetVehiclePose().orientation.get_length() == pytest.approx(1.0)


def test_a_callback_is_called_while_the_client_waits_for_something_else(client: airsim.MultirotorClient) -> None:
    """Within it the client can be called."""
    told: list[Any] = []
    future = client.moveByVelocityAsync(0, 0, 0, 0.05)
    future.attach_callback(lambda done: told.append((done, client.ping())))
    client.simContinueForTime(0.3)
    assert told == [(future, True)]
    future.join()
    assert len(told) == 1


def test_an_error_is_raised_by_get_and_told_once_by_join(
    client: airsim.MultirotorClient, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaccel.airsim.connection._printed", set())  # by other tests of this process
    for _ in range(2):
        future = client.client.call_async("moveNowhere", 1)
        future.join()
        assert future.error is not None
        assert "moveNowhere" in future.error
    assert capsys.readouterr().err.count("moveNowhere failed") == 1
    with pytest.raises(RpcError, match="moveNowhere"):
        future.get()
    told: list[str] = []
    future.attach_error_handler(told.append)
    assert (future.get(), told) == (None, [future.error])
    with pytest.raises(RpcError, match="could not find function 'nothing'"):
        client.client.call("nothing")
    for count in ({3}, frozenset({3}), range(3, 4), iter([3])):
        with pytest.raises(RpcError, match="must be a text, not list"):
            client.client.call("simListSceneObjects", count)
    with pytest.raises(TypeError, match="object cannot be sent"):
        client.client.call("ping", object())


def test_threads_share_a_client(client: airsim.MultirotorClient) -> None:
    """Each gets the answers to its own calls, while another thread waits for a long one."""
    client.enableApiControl(True)
    long = client.moveByVelocityAsync(0, 0, 0, 1e6)  # until it is cancelled
    wrong: list[object] = []

    def ask(number: int) -> None:
        for count in range(40):
            try:
                client.client.call(f"method{number}_{count}")
            except RpcError as error:
                if f"'method{number}_{count}'" not in str(error):
                    wrong.append(error)

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(6)]
    waiting = threading.Thread(target=long.join)
    for thread in (waiting, *threads):
        thread.start()
    for thread in threads:
        thread.join()
    assert not long.done
    client.cancelLastTask()
    waiting.join()
    assert long.result is False
    assert not wrong


def test_nobody_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(ConnectionError, match=f"no server at 127.0.0.1:{port} .* start one with `uavaccel serve`"):
        airsim.MultirotorClient(port=port)


def test_an_answer_that_does_not_come_in_time_does_not_count(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        client = airsim.VehicleClient(port=silent.getsockname()[1], timeout_value=0.05)
        patience = threading.Timer(10.0, silent.shutdown, [socket.SHUT_RDWR])  # whoever waits on is hung up on
        patience.start()
        with pytest.raises(TimeoutError, match=r"^ping: no answer within 0\.05 s$"):
            client.ping()
        assert capsys.readouterr().err == ""
        told: list[Any] = []
        future = client.client.call_async("ping")
        future.attach_callback(told.append)
        future.join()  # as AirSim's, it raises nothing
        assert capsys.readouterr().err == "airsim: ping failed: no answer within 0.05 s\n"
        vars(client.client)["_timeout_ns"] = 10 * NS_PER_S
        in_time, (server, _) = client.client.call_async("ping"), silent.accept()
        unpacker, asked = msgpack.Unpacker(), list[Any]()
        with server:
            while len(asked) < 3:
                unpacker.feed(server.recv(4096))
                asked += unpacker
            server.sendall(b"".join(msgpack.packb([1, number, None, True]) for _, number, *_ in asked))
            assert in_time.get() is True
        assert (told, future.error, future.result) == ([future], "no answer within 0.05 s", None)
        patience.cancel()


class Colour(IntEnum):
    RED = 3


numbers = st.integers(-(2**40), 2**40) | st.floats(allow_nan=False)
leaves: st.SearchStrategy[Any] = st.one_of(
    *(numbers, st.booleans(), st.none(), st.text(max_size=5), st.binary(max_size=5), st.just(Colour.RED)),
    *(st.floats(width=32, allow_nan=False).map(np.float32), st.integers(0, 9).map(np.int64)),
    *(st.builds(airsim.Vector3r, numbers, numbers, numbers), st.builds(airsim.YawMode, st.booleans(), numbers)),
)
values = st.recursive(
    leaves, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
)


@given(values)
def test_arguments_of_a_flight_are_those_that_a_wire_carries(value: object) -> None:
    wired = msgpack.unpackb(msgpack.packb(value, default=plain))
    sent = as_sent(value)
    assert sent == wired
    assert repr(sent) == repr(wired)  # of the same types too


def test_answers_of_a_flight_are_those_that_a_wire_carries() -> None:
    """Arrays become lists of single precision, wherever they are."""
    pixels, single = np.array([[0.1, 2.0]]), [float(np.float32(number)) for number in (0.1, 2.0, 0.2)]
    assert as_received({"pixels": pixels, "name": "a"}) == {"pixels": single[:2], "name": "a"}
    assert as_received([pixels, {"x": np.array([0.2])}]) == [single[:2], {"x": single[2:]}]
    assert as_received({"plain": [0.1], "name": "a"}) == {"plain": [0.1], "name": "a"}


@given(*[st.floats(-1.5, 1.5)] * 3)
def test_angles_and_quaternions_are_inverse(pitch: float, roll: float, yaw: float) -> None:
    turned = airsim.to_quaternion(pitch, roll, yaw)
    assert airsim.to_eularian_angles(turned) == pytest.approx((pitch, roll, yaw), abs=1e-9)
    beyond_by_rounding = airsim.Quaternionr(0, 0.70710679, 0, 0.70710679)
    assert airsim.to_eularian_angles(beyond_by_rounding)[0] == math.pi / 2


def test_quarter_turns_have_airsims_directions() -> None:
    """By pitch, roll and yaw: where forward, right and down point then; by yaw first."""
    for angles, turned in (
        ((0, 0, 1), ((0, 1, 0), (-1, 0, 0), (0, 0, 1))),
        ((1, 0, 0), ((0, 0, -1), (0, 1, 0), (1, 0, 0))),
        ((0, 1, 0), ((1, 0, 0), (0, 0, 1), (0, -1, 0))),
        ((0, 1, 1), ((0, 1, 0), (0, 0, 1), (1, 0, 0))),
    ):
        turn = airsim.to_quaternion(*(angle * math.pi / 2 for angle in angles))
        turn = airsim.Quaternionr(*np.array([*turn], np.float32).tolist())  # as rounded as a server's
        for axis, expected in zip(np.eye(3).tolist(), turned, strict=True):
            rotated = airsim.Vector3r(*axis).to_Quaternionr().rotate(turn)
            assert [*rotated] == pytest.approx([*expected, 0], abs=1e-6)


UNIT_X, UNIT_Y = airsim.Quaternionr(1, 0, 0, 0), airsim.Quaternionr(0, 1, 0, 0)
LONG = airsim.Quaternionr(0.0, 3.0, 0.0, 4.0)  # of length 5


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (UNIT_X * UNIT_Y, (0, 0, 1, 0)),
        (UNIT_Y * UNIT_X, (0, 0, -1, 0)),
        (UNIT_X + LONG, (1, 3, 0, 4)),
        (UNIT_X - LONG, (1, -3, 0, -4)),
        (LONG / 2, (0, 1.5, 0, 2)),
        (LONG.conjugate(), (0, -3, 0, 4)),
        (LONG.inverse(), (0, -3 / 25, 0, 4 / 25)),
        (UNIT_X / LONG, (4 / 25, 0, -3 / 25, 0)),
        (LONG.sgn(), (0, 0.6, 0, 0.8)),
        (airsim.Quaternionr(1, 2, 3, 4).cross(airsim.Quaternionr(5, 6, 7, 8)), (-4, 8, -4, 0)),
        (UNIT_X.outer_product(UNIT_Y), (0, 0, -1, 0)),
        (UNIT_X.outer_product(LONG), (-52 / 25, 0, -39 / 25, 0)),
        (LONG.star(), (0, -3, 0, 4)),
        (airsim.Vector3r(1, 2, 3) * 2, (2, 4, 6)),
        (airsim.Quaternionr(1, 2, 3, 4) * airsim.Quaternionr(5, 6, 7, 8), (24, 48, 48, -6)),
        (airsim.Vector3r(1, 2, 3).to_Quaternionr(), (1, 2, 3, 0)),
        (airsim.Vector3r(1, 2, 3) + airsim.Vector3r(4, 4, 4), (5, 6, 7)),
        (airsim.Vector3r(1, 2, 3) - airsim.Vector3r(4, 4, 4), (-3, -2, -1)),
        (airsim.Vector3r(1, 2, 3) / 2, (0.5, 1, 1.5)),
        (airsim.Vector3r(1, 2, 3).cross(airsim.Vector3r(4, 5, 6)), (-3, 6, -3)),
        (airsim.Vector3r(1, 2, 3).to_numpy_array(), (1, 2, 3)),
        (airsim.Quaternionr(1, 2, 3, 4).to_numpy_array(), (1, 2, 3, 4)),
    ],
)
def test_the_algebra_of_vectors_and_quaternions(found: Any, expected: tuple[float, ...]) -> None:
    assert [*found] == pytest.approx(expected, abs=1e-12)


def test_lengths_and_products_are_numbers_and_any_nan_counts() -> None:
    one, other = airsim.Vector3r(1, 2, 2), airsim.Vector3r(3, 4, 1)
    assert (one.get_length(), one.dot(other), other.distance_to(one)) == (3.0, 13.0, 3.0)
    assert (LONG.get_length(), LONG.dot(airsim.Quaternionr(1, 1, 1, 1))) == (5.0, 7.0)
    half_known = (airsim.Pose(airsim.Vector3r.nanVector3r()), airsim.Pose(None, airsim.Quaternionr(w_val=math.nan)))
    assert [pose.containsNan() for pose in (airsim.Pose(), *half_known)] == [False, True, True]
    assert all(math.isnan(each) for part in airsim.Pose.nanPose() for each in part)
    assert [*one * np.float32(2)] == [2, 4, 4]
    with pytest.raises(TypeError, match="Vector3r and str"):
        one * "2"  # type: ignore[operator]


def test_bytes_and_lists_become_arrays_that_can_be_written_to(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = np.array([1.5, 2.5], np.float32)
    for found, expected in (
        (airsim.string_to_uint8_array(b"\x01\xff"), [1, 255]),
        (airsim.string_to_float_array(numbers.tobytes()), [1.5, 2.5]),
    ):
        assert found.tolist() == expected
        found[0] = 7
    response = airsim.ImageResponse(image_data_float=[*range(6)], width=3, height=2)
    assert airsim.get_pfm_array(response).tolist() == [[0, 1, 2], [3, 4, 5]]
    assert airsim.to_dict(airsim.YawMode()) == {"is_rate": True, "yaw_or_rate": 0.0}
    assert airsim.to_dict(type("Mine", (), {"seen": 1, "_own": 2, "ask": len})()) == {"seen": 1}
    monkeypatch.setattr("sys.stdin", io.StringIO("y"))
    assert (airsim.wait_key(), airsim.wait_key()) == ("y", None), "a key without a terminal is the next character"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("shape", [(3, 4), (3, 4, 1), (3, 4, 3)])
def test_pfm_files_are_read_as_written(shape: tuple[int, ...], order: str, tmp_path: str) -> None:
    image = np.arange(math.prod(shape), dtype=f"{order}f4").reshape(shape)
    airsim.write_pfm(f"{tmp_path}/depth.pfm", image, scale=2)
    read, scale = airsim.read_pfm(f"{tmp_path}/depth.pfm")
    np.testing.assert_array_equal(read, image[..., 0] if shape[2:] == (1,) else image)
    assert scale == 2
    written = Path(tmp_path, "depth.pfm").read_bytes()
    kind, sign = "PF" if shape[2:] == (3,) else "Pf", "-" if order == "<" else ""
    assert written == f"{kind}\n4 3\n{sign}2.000000\n".encode() + image.tobytes()
    with pytest.raises(ValueError, match="float32"):
        airsim.write_pfm(f"{tmp_path}/depth.pfm", image.astype(float))
    with pytest.raises(ValueError, match="H x W"):
        airsim.write_pfm(f"{tmp_path}/depth.pfm", image.ravel())
