"""What uavaccel.airsim sends for each method, against AirSim's own client; and what it makes of the answers."""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import msgpack
import pytest

from uavaccel import airsim
from uavaccel.airsim import old_client, types, vehicle_client
from uavaccel.airsim.connection import plain
from uavaccel.wire.rpc import Future

TABLE = Path(__file__).parent / "data" / "airsim_client_calls.txt"
DEFAULTS = {"RED": [1.0, 0.0, 0.0, 1.0], "FREE": 0, "STILL": {"is_rate": True, "yaw_or_rate": 0.0}}
OF_CLIENT_ALONE = {
    *("getClientVersion", "getMinRequiredServerVersion", "confirmConnection"),
    *("simSetDistortionParams", "simGetLidarSegmentation", "simSetCameraOrientation"),
}
GAINS = {
    "angle_rate_gains": (types.AngleRateControllerGains, [[0.25] * 3, [0] * 3, [0] * 3]),
    "angle_level_gains": (types.AngleLevelControllerGains, [[2.5] * 3, [0] * 3, [0] * 3]),
    "velocity_gains": (types.VelocityControllerGains, [[0.2, 0.2, 2.0], [0, 0, 2.0], [0] * 3]),
    "position_gains": (types.PositionControllerGains, [[0.25] * 3, [0] * 3, [0] * 3]),
}


class Call(NamedTuple):
    """A line of the table: parameters with their defaults as text, and expressions of what is sent."""

    method: str
    parameters: list[tuple[str, str | None]]
    on_wire: str
    sent: str


def read_table() -> list[Call]:
    calls = []
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if found := re.fullmatch(r"(\w+)\((.*)\) -> (\w+)(?:: (.*))?", line):
            method, given, on_wire, sent = found.groups()
            signature = ast.parse(f"def f({given}): ...").body[0]
            assert isinstance(signature, ast.FunctionDef)
            names = [arg.arg for arg in signature.args.args]
            defaults = [ast.unparse(default) for default in signature.args.defaults]
            pairs = list(zip(names, [None] * (len(names) - len(defaults)) + [*defaults], strict=True))
            calls.append(Call(method, pairs, on_wire, sent or ", ".join(names)))
    return calls


CALLS = {call.method: call for call in read_table()}


class Recorder:
    """A connection that keeps what is sent, and answers what it is told to."""

    def __init__(self) -> None:
        self.sent: list[tuple[Any, ...]] = []
        self.answer: Any = None
        self.future = Future("", lambda future: future.answer(None, self.answer))

    def call(self, method: str, *params: Any) -> Any:
        self._keep(method, params)
        return self.answer

    def call_async(self, method: str, *params: Any) -> Future:
        self._keep(method, params)
        return self.future

    def close(self) -> None: ...

    def _keep(self, method: str, params: Any) -> None:
        self.sent.append((method, *msgpack.unpackb(msgpack.packb(params, default=plain))))


@pytest.fixture
def recorder() -> Iterator[Recorder]:
    made = Recorder()
    with patch("uavaccel.airsim.connection._connect", lambda host, port, timeout_s: made):
        yield made


@pytest.fixture
def client(recorder: Recorder) -> airsim.MultirotorClient:
    return airsim.MultirotorClient()


def ask(client: Any, method: str, *arguments: Any, **named: Any) -> Any:
    """What a call returns; None where the recorder's answer is none of its kind."""
    try:
        return getattr(client, method)(*arguments, **named)
    except (TypeError, AttributeError):
        assert client.client.sent, method
        return None


def value_of(name: str, number: int) -> Any:
    """An argument that is no other's."""
    if name in GAINS:
        return GAINS[name][0](*(types.PIDGains(number + i, 10 * number + i, 0.1 * number + i) for i in range(3)))
    return [number + 0.25] if name in ("requests", "path") else number + 0.5


def lists(given: Any) -> list[list[float]]:
    axes = [vars(axis) for axis in vars(given).values()]
    return [[axis[gain] for axis in axes] for gain in ("kp", "ki", "kd")]


def test_methods_have_airsims_parameters_and_send_what_it_sends(client: Any, recorder: Recorder) -> None:
    public = {name for name, _ in inspect.getmembers(airsim.MultirotorClient, inspect.isfunction)}
    assert {name for name in public if not name.startswith("_")} == {*CALLS, *OF_CLIENT_ALONE}
    assert len(CALLS) == 124
    recorder.answer = 7
    for call in CALLS.values():
        signature = inspect.signature(getattr(airsim.MultirotorClient, call.method))
        ours = [each for each in signature.parameters.values() if each.name != "self"]
        assert [our.name for our in ours] == [name for name, _ in call.parameters], call.method
        for parameter, (_, default) in zip(ours, call.parameters, strict=True):
            if default is None:
                assert parameter.default is inspect.Parameter.empty, (call.method, parameter.name)
            else:
                told = plain(parameter.default) if hasattr(parameter.default, "to_msgpack") else parameter.default
                told = list(told) if isinstance(told, tuple) else told
                assert told == eval(default, DEFAULTS.copy()), (call.method, parameter.name)
        given = {name: value_of(name, number) for number, (name, _) in enumerate(call.parameters)}
        recorder.sent.clear()
        found = ask(client, call.method, *given.values())
        expected = eval(f"[{call.sent}]", {"lists": lists, **given})
        ask(client, call.method, **given)
        assert recorder.sent == [(call.on_wire, *expected)] * 2, "by place and by name"
        assert (found is recorder.future) == call.method.endswith("Async"), call.method
        assert found is None or signature.return_annotation != "None", call.method


def test_gains_are_those_of_simpleflight_unless_others_are_given(client: Any, recorder: Recorder) -> None:
    for name, (_, gains) in GAINS.items():
        (method,) = (each for each, call in CALLS.items() if (name, "None") in call.parameters)
        getattr(client, method)()
        assert recorder.sent.pop() == (method, *gains, "")


def test_moving_by_rc_alone_lets_go_of_the_sticks(client: Any, recorder: Recorder) -> None:
    client.moveByRC(vehicle_name="B")
    (_, sticks, vehicle), *_ = recorder.sent
    assert vehicle == "B"
    assert sticks == vars(airsim.RCData())
    assert {key for key, value in sticks.items() if value} <= {"is_valid"}


def test_enumerations_have_airsims_numbers() -> None:
    images = (
        *("Scene", "DepthPlanar", "DepthPerspective", "DepthVis", "DisparityNormalized", "Segmentation"),
        *("SurfaceNormals", "Infrared", "OpticalFlow", "OpticalFlowVis"),
    )
    weather = ("Rain", "Roadwetness", "Snow", "RoadSnow", "MapleLeaf", "RoadLeaf", "Dust", "Fog", "Enabled")
    for kind, names in (
        (types.ImageType, images),
        (types.WeatherParameter, weather),
        (types.LandedState, ("Landed", "Flying")),
        (types.DrivetrainType, ("MaxDegreeOfFreedom", "ForwardOnly")),
    ):
        assert [getattr(kind, name) for name in names] == list(range(len(names)))


def test_fields_are_nothing_until_they_are_set_but_for_these() -> None:
    """As in AirSim's types.py; nested objects are looked at by themselves."""
    set_already = {
        "Quaternionr": {"w_val": 1.0},
        "CollisionInfo": {"object_id": -1},
        "YawMode": {"is_rate": True},
        "ImageRequest": {"camera_name": "0", "compress": True},
        "ImageResponse": {"compress": True},
        "CameraInfo": {"fov": -1},
        "CarControls": {"gear_immediate": True},
    }
    for name, kind in vars(types).items():
        if isinstance(kind, type) and issubclass(kind, types.MsgpackMixin) and kind is not types.MsgpackMixin:
            parts = zip(vars(kind()).values(), vars(kind()).values(), strict=True)
            assert not any(one is another for one, another in parts if hasattr(one, "to_msgpack")), name
            plain_fields = {key: var for key, var in vars(kind()).items() if not hasattr(var, "to_msgpack")}
            assert {key: plain_field for key, plain_field in plain_fields.items() if plain_field} == set_already.get(
                name, {}
            ), name


# --- answers ----------------------------------------------------------------------------------------------------

POINT = {"x_val": 1.0, "y_val": 2.0, "z_val": 3.0}
TURN = {"w_val": 0.5, "x_val": 0.1, "y_val": 0.2, "z_val": 0.3}
PLACE = {"latitude": 47.0, "longitude": -122.0, "altitude": 99.0}


def test_plain_answers(client: Any, recorder: Recorder) -> None:
    for method, arguments, answer, returns in (
        *(("ping", (), True, True), ("simIsPause", (), 1, True), ("isApiControlEnabled", (), 0, False)),
        *(("getServerVersion", (), 4, 4), ("isRecording", (), False, False), ("getSettingsString", (), "{}", "{}")),
        *(("listVehicles", (), ("A", "B"), ["A", "B"]), ("simListSceneObjects", (), ("Ground",), ["Ground"])),
        *(("simGetSegmentationObjectID", ("x",), -1, -1), ("simGetDistortionParams", (0,), (1, 2), [1, 2])),
        *(("simGetImage", ("0", 0), b"png", b"png"), ("simGetImage", ("0", 0), "", None)),
        *(("simGetImage", ("0", 0), b"\0", None), ("simSpawnObject", ("a", "b", None, None), "a_1", "a_1")),
    ):
        recorder.answer = answer
        found = getattr(client, method)(*arguments)
        assert (method, found, type(found)) == (method, returns, type(returns))


def test_answers_are_airsims_types(client: Any, recorder: Recorder) -> None:
    for method, answer, kind in (
        ("simGetVehiclePose", {"position": POINT, "orientation": TURN}, airsim.Pose),
        ("simGetObjectPose", {"position": POINT, "orientation": TURN}, airsim.Pose),
        ("simGetObjectScale", POINT, airsim.Vector3r),
        ("getHomeGeoPoint", PLACE, airsim.GeoPoint),
        ("simGetCollisionInfo", {"normal": POINT, "has_collided": True}, airsim.CollisionInfo),
        ("simGetGroundTruthKinematics", {"linear_velocity": POINT}, airsim.KinematicsState),
        ("simGetGroundTruthEnvironment", {"geo_point": PLACE}, airsim.EnvironmentState),
        ("getMultirotorState", {"gps_location": PLACE, "landed_state": 1}, airsim.MultirotorState),
        ("getRotorStates", {"rotors": [], "timestamp": 7}, airsim.RotorStates),
        ("simGetCameraInfo", {"fov": 90.0}, airsim.CameraInfo),
        ("getImuData", {"linear_acceleration": POINT}, airsim.ImuData),
        ("getBarometerData", {"pressure": 3.0}, airsim.BarometerData),
        ("getMagnetometerData", {"magnetic_field_body": POINT}, airsim.MagnetometerData),
        ("getGpsData", {"is_valid": True}, airsim.GpsData),
        ("getDistanceSensorData", {"distance": 4.0}, airsim.DistanceSensorData),
        ("getLidarData", {"point_cloud": [1.0]}, airsim.LidarData),
    ):
        recorder.answer = answer
        found = getattr(client, method)(*([0] if CALLS[method].parameters[0][1] is None else []))
        assert type(found) is kind
        for key, value in answer.items():
            assert (plain(getattr(found, key)) if isinstance(value, dict) else getattr(found, key)) == value


def test_answers_keep_unknown_fields_and_default_missing_ones() -> None:
    """Fields that AirSim's own types do not have stay; vectors are in the order of x, y, z all the same."""
    backwards = dict(reversed(TURN.items()))
    told = {"extra": 7, "has_collided": True, "normal": {"z_val": 3.0, "y_val": 2.0, "x_val": 1.0}}
    collision = airsim.CollisionInfo.from_msgpack(told)
    assert (collision.extra, collision.has_collided, collision.object_id) == (7, True, -1)  # type: ignore[attr-defined]
    assert [*collision.normal] == [1.0, 2.0, 3.0]
    pose = airsim.Pose.from_msgpack({"orientation": backwards, "position": {"y_val": 4.0}})
    assert [[*part] for part in pose] == [[0.0, 4.0, 0.0], [0.1, 0.2, 0.3, 0.5]]
    state = airsim.MultirotorState.from_msgpack({"kinematics_estimated": {"position": POINT}})
    assert [*state.kinematics_estimated.position] == [1.0, 2.0, 3.0]
    assert [*state.kinematics_estimated.orientation] == [0.0, 0.0, 0.0, 1.0]
    assert airsim.CollisionInfo().normal is not airsim.CollisionInfo().normal


def test_lists_of_answers_are_airsims_types(client: Any, recorder: Recorder) -> None:
    recorder.answer = [{"width": 3}, {"width": 4}]
    images = client.simGetImages([airsim.ImageRequest(0, 5)])
    asked = {"camera_name": "0", "image_type": 5, "pixels_as_float": False, "compress": True}
    assert recorder.sent == [("simGetImages", [asked], "", False)]
    assert [(type(image), image.width) for image in images] == [(airsim.ImageResponse, 3), (airsim.ImageResponse, 4)]
    recorder.answer = [{"name": "A"}]
    assert [(type(detection), detection.name) for detection in client.simGetDetections("0", 0)] == [
        (airsim.DetectionInfo, "A")
    ]
    recorder.answer = [PLACE, PLACE]
    assert [type(corner) for corner in client.simGetWorldExtents()] == [airsim.GeoPoint] * 2


def test_what_the_client_does_with_several_calls_or_none(
    client: Any, recorder: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    client.simSetDistortionParams(2, {"K1": 0.5, "P2": 0.25}, "B", True)
    expected = [("simSetDistortionParam", "2", *each, "B", True) for each in (("K1", 0.5), ("P2", 0.25))]
    assert recorder.sent == expected
    recorder.sent.clear()
    recorder.answer = {"segmentation": [5]}
    assert client.simGetLidarSegmentation("eye", "B") == [5]
    assert recorder.sent == [("getLidarData", "eye", "B")]
    recorder.sent.clear()
    client.simSetCameraOrientation(1, airsim.Quaternionr(*TURN.values()), "B")
    ((method, camera, pose, *rest),) = recorder.sent
    assert (method, camera, rest) == ("simSetCameraPose", "1", ["B", False])
    assert all(math.isnan(each) for each in pose["position"].values())
    assert list(pose["orientation"].values()) == list(airsim.Quaternionr(*TURN.values()).to_msgpack().values())
    assert (client.getClientVersion(), client.getMinRequiredServerVersion()) == (1, 1)
    recorder.answer = 1
    client.confirmConnection()
    assert capsys.readouterr().out.startswith("Connected!\nClient Ver:1 (Min Req: 1), Server Ver:1 (Min Req: 1)\n")
    recorder.answer = 0
    client.confirmConnection()
    said = capsys.readouterr()
    assert said.out.startswith("Ping returned false!\n")
    assert "AirSim server is too old" in said.out
    assert said.err == "Client Ver:1 (Min Req: 0), Server Ver:0 (Min Req: 1)\n"
    monkeypatch.setattr(client, "getServerVersion", lambda: 9)
    recorder.answer = 9  # which a client must have
    client.confirmConnection()
    assert "This client is too old" in capsys.readouterr().out


def test_a_client_connects_to_where_airsim_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[Any, ...]] = []
    monkeypatch.setattr(vehicle_client, "connect", lambda *given: told.append(given))
    airsim.MultirotorClient()
    airsim.VehicleClient("10.0.0.1", 5, timeout_value=2)
    assert told == [("127.0.0.1", 41451, 3600), ("10.0.0.1", 5, 2)]
    with pytest.raises(NotImplementedError, match="there is no car"):
        airsim.CarClient()


# --- before 1.2 -------------------------------------------------------------------------------------------------

FREE, STILL = DEFAULTS["FREE"], DEFAULTS["STILL"]
HOW = (FREE, STILL, -1, 1, "")


OLD_CALLS = [
    ("takeoff", (), ("takeoff", 15, "")),
    ("takeoff", (0,), ("takeoff", 3e38, "")),
    ("land", (), ("land", 60, "")),
    ("goHome", (), ("goHome", 3e38, "")),
    ("hover", (), ("hover", "")),
    ("moveByAngle", (0.1, 0.2, -3, 0.4, 5), ("moveByRollPitchYawZ", 0.2, 0.1, 0.4, -3, 5, "")),
    ("moveByAngleZ", (0.1, 0.2, -3, 0.4, 5), ("moveByRollPitchYawZ", 0.2, 0.1, 0.4, -3, 5, "")),
    ("moveByVelocity", (1, 2, 3, 4), ("moveByVelocity", 1, 2, 3, 4, FREE, STILL, "")),
    ("moveByVelocityZ", (1, 2, 3, 4), ("moveByVelocityZ", 1, 2, 3, 4, FREE, STILL, "")),
    ("moveByManual", (1, 2, 3, 4), ("moveByManual", 1, 2, 3, 4, FREE, STILL, "")),
    ("moveOnPath", ([1], 2), ("moveOnPath", [1], 2, 60, *HOW)),
    ("moveToPosition", (1, 2, 3, 4), ("moveToPosition", 1, 2, 3, 4, 60, *HOW)),
    ("moveToZ", (1, 2), ("moveToZ", 1, 2, 60, *HOW[1:])),
    ("rotateToYaw", (9,), ("rotateToYaw", 9, 60, 5, "")),
    ("rotateByYawRate", (9, 2), ("rotateByYawRate", 9, 2, "")),
    ("getCollisionInfo", (), ("simGetCollisionInfo", "")),
    ("getCameraInfo", (3,), ("simGetCameraInfo", "3", "", False)),
    ("simSetPose", (7, True), ("simSetVehiclePose", 7, True, "")),
    ("simGetPose", (), ("simGetVehiclePose", "")),
    ("setRCData", (7,), ("moveByRC", 7, "")),
    ("takeoff", (7,), ("takeoff", 7, "")),
    ("land", (7,), ("land", 7, "")),
    ("moveByVelocity", (1, 2, 3, 4, 1, 6, "B"), ("moveByVelocity", 1, 2, 3, 4, 1, 6, "B")),
    ("moveByVelocityZ", (1, 2, 3, 4, 1, 6, "B"), ("moveByVelocityZ", 1, 2, 3, 4, 1, 6, "B")),
    ("moveByManual", (1, 2, 3, 4, 1, 6, "B"), ("moveByManual", 1, 2, 3, 4, 1, 6, "B")),
    ("rotateByYawRate", (9, 2, "B"), ("rotateByYawRate", 9, 2, "B")),
    ("moveOnPath", ([1], 2, 3, 4, 5, 6, 7), ("moveOnPath", [1], 2, 3, 4, 5, 6, 7, "")),
    ("moveToPosition", (*range(1, 10),), ("moveToPosition", *range(1, 10), "")),
    ("moveToZ", (*range(1, 7),), ("moveToZ", *range(1, 7), "")),
    ("rotateToYaw", (1, 2, 3), ("rotateToYaw", 1, 2, 3, "")),
    ("moveOnPath", ([1], 2, 0), ("moveOnPath", [1], 2, 3e38, *HOW)),
    ("moveToPosition", (1, 2, 3, 4, 0), ("moveToPosition", 1, 2, 3, 4, 3e38, *HOW)),
    ("moveToZ", (1, 2, 0), ("moveToZ", 1, 2, 3e38, *HOW[1:])),
    ("rotateToYaw", (9, 0), ("rotateToYaw", 9, 3e38, 5, "")),
]


def test_the_client_before_1_2_sends_the_same_calls(recorder: Recorder) -> None:
    client = old_client.MultirotorClient()
    for method, arguments, sent in OLD_CALLS:
        ask(client, str(method), *arguments)
        assert recorder.sent.pop() == sent
        assert not recorder.sent


HELPERS = {  # AirSim's names before 1.2, and since
    "stringToUint8Array": "string_to_uint8_array",
    "stringToFloatArray": "string_to_float_array",
    "listTo2DFloatArray": "list_to_2d_float_array",
    "getPfmArray": "get_pfm_array",
    "toEulerianAngle": "to_eularian_angles",
    "toQuaternion": "to_quaternion",
    **{name: name for name in ("to_dict", "to_str", "get_public_fields")},
    **{name: name for name in ("write_file", "write_png", "write_pfm", "read_pfm")},
}


def test_the_client_before_1_2_has_the_helpers_of_the_module() -> None:
    for before, since in HELPERS.items():
        assert getattr(old_client.AirSimClientBase, before) is getattr(airsim, since)


def test_arguments_keep_their_places_whatever_is_named(client: airsim.MultirotorClient, recorder: Recorder) -> None:
    """What is left out before or between has its default."""
    still = {"is_rate": True, "yaw_or_rate": 0.0}
    client.moveByVelocityAsync(1, 2, 3, 4, vehicle_name="B")
    client.moveByVelocityAsync(1, duration=4, vz=3, vy=2, drivetrain=1)
    client.simSetCameraFov(camera_name=1, fov_degrees=80, external=True)
    assert recorder.sent == [
        ("moveByVelocity", 1, 2, 3, 4, 0, still, "B"),
        ("moveByVelocity", 1, 2, 3, 4, 1, still, ""),
        ("simSetCameraFov", "1", 80, "", True),
    ]
    old_client.MultirotorClient().moveToZ(-3, max_wait_seconds=5, velocity=1)
    assert recorder.sent[-1] == ("moveToZ", -3, 1, 5, still, -1, 1, "")
    for call in (lambda: client.moveByVelocityAsync(1, 2, 3), lambda: client.ping(1), lambda: client.ping(a=1)):  # type: ignore[call-arg]
        with pytest.raises(TypeError):
            call()


def test_the_old_client_waits_for_commands_with_a_limit(recorder: Recorder) -> None:
    client = old_client.MultirotorClient()
    recorder.answer = False
    for command in (lambda: client.takeoff(0), lambda: client.moveByVelocity(1, 0, 0, 1)):
        assert command() is True
        assert not recorder.future.done
    for waits in (
        *(lambda: client.moveToZ(-3, 1), lambda: client.moveToPosition(1, 2, -3, 4), client.hover),
        *(lambda: client.moveOnPath([], 1), lambda: client.rotateToYaw(9), lambda: client.moveToZ(-3, 1)),
        *(client.takeoff, client.land, client.goHome),
    ):
        recorder.future.done = False
        assert waits() is False
        assert recorder.future.done


def test_the_client_before_1_2_reads_parts_of_the_state(recorder: Recorder) -> None:
    client = old_client.MultirotorClient()
    flown = {"position": POINT, "linear_velocity": {**POINT, "x_val": 9.0}, "orientation": TURN}
    recorder.answer = {
        "kinematics_estimated": flown, "gps_location": PLACE, "landed_state": 1, "timestamp": 5,
        "rc_data": {"yaw": 0.25},
    }  # fmt: skip
    assert (client.getRCData().yaw, client.getRCData().roll) == (0.25, 0.0)
    assert plain(client.getPosition()) == POINT
    assert client.getVelocity().x_val == 9.0
    assert client.getGpsLocation().altitude == 99.0
    assert (client.getLandedState(), client.timestampNow(), client.isSimulationMode()) == (1, 5, True)
    angles = airsim.to_eularian_angles(client.getOrientation())
    assert client.getPitchRollYaw() == client.getRollPitchYaw() == angles  # both in the order of the former
    client.setCameraOrientation(3, client.getOrientation())
    method, camera, pose, *_ = recorder.sent[-1]
    assert (method, camera, pose["orientation"]) == ("simSetCameraPose", "3", TURN)
