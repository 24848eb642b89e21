"""Calls of the table: each answers with something that can be sent; values, units and goals; what ends what."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.flying import STRAIGHT, go_on, hovering
from tests.flying import call as ask
from tests.simulating import simulate
from uavaccel.errors import UserError
from uavaccel.kinematics import Kinematics
from uavaccel.sim.earth import geodetic, geographic
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.simulation import DeferredReply, Simulation
from uavaccel.sim.world import World
from uavaccel.wire import rpc, types
from uavaccel.wire.api import CALLS, Api, page, sections
from uavaccel.wire.calls import Calls, Refusals, call
from uavaccel.wire.flight_api import facing
from uavaccel.wire.game_api import decode_state, encode_state
from uavaccel.wire.recorder import COLUMNS, FILE_NAME
from uavaccel.wire.settings import Settings
from uavaccel.wire.types import EPOCH_NS

MS = 1_000_000
WORLD = World("blocks", PROFILES["native"])

values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(1 << 63), (1 << 64) - 1)
    | st.floats()
    | st.sampled_from(["", "SimpleFlight", "x_val", "seed", 0, 1, 0.1, 1.0, -1.0, 1e300])
    | st.text(max_size=3)
    | st.binary(max_size=3),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["position", "orientation", "x_val", "w_val", "is_rate", "seed", "obstacles"]), inner
        )
    ),
    max_leaves=5,
)


@st.composite
def calls(draw: st.DrawFn) -> tuple[str, list[Any]]:
    """A method and as many arguments as it takes, of any kind."""
    name = draw(st.sampled_from(sorted(CALLS)))
    method = CALLS[name]
    return name, draw(st.lists(values, min_size=method.required, max_size=method.most))


@pytest.mark.slow
@settings(max_examples=150)
@given(calls())
def test_any_arguments(asked: tuple[str, list[Any]]) -> None:
    WORLD.reset()
    api = Api(Simulation(WORLD), render=False)
    for wall_ns in (0, MS):
        api.simulation.advance_to(wall_ns)
        try:
            result = api.call(*asked, wall_ns)
        except rpc.RpcError:
            continue
        if isinstance(result, DeferredReply):
            api.simulation.pause(wall_ns)
            api.simulation.lead.end(False, wall_ns)
            result = result.encode(result.value)
        msgpack.packb(result)


def test_a_bug_in_a_call_leaves_its_traceback_in_the_log_once(caplog: pytest.LogCaptureFixture) -> None:
    api = hovering()

    def broken() -> int:
        return dict[str, int]()["pong"]

    for name in ("ping", "reset"):
        api.handlers[name] = broken
        for _ in range(2):
            with pytest.raises(rpc.RpcError, match=r"threw an exception.* KeyError: 'pong'\."):
                api.call(name, [], 0)
    for name, params in (("moveByRC", [7]), ("simPause", []), ("moveByVelocity", [1.0] * 6), ("takeoff", ["x"])):
        with pytest.raises(rpc.RpcError):
            api.call(name, params, 0)  # a client's mistake is no bug
    assert [record.getMessage() for record in caplog.records] == ["ping failed", "reset failed"]
    assert caplog.text.count("in broken") == 2
    assert caplog.text.count("KeyError: 'pong'") == 2


def test_refusals_are_told_once_each_and_no_more_than_200_kinds() -> None:
    """Names and texts come from clients, on one line each."""
    refusals, said = Refusals(), list[str]()
    refusals.say = said.append
    for number in (*range(250), 0, 0):
        refusals.add(f"call{number}", "is\nunknown")
    assert len(said) == 201
    assert (said[0], said[-1]) == ("call0 is?unknown", "other calls were refused")
    assert refusals.lines()[:3] == [
        "50 x other calls were refused", "3 x call0 is?unknown", "1 x call1 is?unknown",
    ]  # fmt: skip


def test_a_method_says_all_about_its_call() -> None:
    class OwnApi(Calls, title="Own"):
        @call("uavaccelTriple", lambda params: "state" if params else "call", leaves_state=True)
        def triple(self, number: float, times: int = 3) -> float:
            return number * times

    triple = OwnApi.calls["uavaccelTriple"]
    assert (triple.required, triple.most, triple.leaves_state, triple.joined) == (1, 2, True, False)
    assert [triple.channel_of([]), triple.channel_of([2])] == ["call", "state"]
    assert triple.arguments([2]) == [2.0]
    with pytest.raises(ValueError, match=r"times must be a whole number of 32 bits, not 1\.5"):
        triple.arguments([2.0, 1.5])
    with pytest.raises(TypeError, match="no client's value becomes <class 'dict'>"):

        class BadApi(Calls, title="Bad"):
            @call("uavaccelBad")
            def bad(self, value: dict) -> None: ...


def test_settings_name_the_vehicle() -> None:
    api = hovering(settings=Settings.model_validate({"Vehicles": {"Drone1": {}}, "ClockSpeed": 5}))
    assert ask(api, "listVehicles") == ["Drone1"]
    assert ask(api, "simGetGroundTruthKinematics", "Drone1")
    with pytest.raises(rpc.RpcError, match="there is 'Drone1'"):
        ask(api, "simGetGroundTruthKinematics", "SimpleFlight")
    told = json.loads(ask(api, "getSettingsString"))
    assert told["SimMode"] == "Multirotor"
    assert told["ClockSpeed"] == 1.0  # what holds, not what the file says
    assert told["Vehicles"] == {"Drone1": {}}


def test_a_vehicles_own_sensors_go_before_the_defaults_and_those_before_airsims() -> None:
    imu = {"SensorType": 2}
    for own, name in (({"Sensors": {"own": imu}}, "own"), ({}, "default")):
        given = {"Vehicles": {"A": own}, "DefaultSensors": {"default": imu}}
        api = hovering(settings=Settings.model_validate(given))
        assert ask(api, "getImuData", name) == ask(api, "getImuData")
        with pytest.raises(rpc.RpcError, match=f"No imu with name imu exist on vehicle; there is {name}"):
            ask(api, "getImuData", "imu")
    assert ask(hovering(), "getImuData", "imu")


def rows_of(folder: Path) -> list[list[list[str]]]:
    """Lines and columns of every recording below `folder`, in the order in which they were made."""
    files = sorted(folder.glob(f"*/{FILE_NAME}"), key=lambda file: (len(file.parent.name), file))
    return [[line.split("\t") for line in file.read_text().splitlines()] for file in files]


def test_a_recording_is_airsims_file(tmp_path: Path) -> None:
    api = hovering(recordings=tmp_path)
    ask(api, "startRecording")
    go_on(api, 0.2)
    ask(api, "stopRecording")
    [[header, *rows]] = rows_of(tmp_path)
    assert tuple(header) == COLUMNS
    begun_ms = (EPOCH_NS + api.simulation.time_ns) // MS - 200
    assert [int(row[1]) - begun_ms for row in rows] == [0, 50, 100, 150, 200]
    assert {(row[0], row[2], row[4], row[5], row[9]) for row in rows} == {("SimpleFlight", "0", "-10", "1", "")}


def test_a_recording_goes_on_through_commands_and_resets(tmp_path: Path) -> None:
    api = hovering(recordings=tmp_path)
    ask(api, "startRecording")
    go_on(api, 0.12)
    ask(api, "moveByVelocity", 1.0, 0.0, 0.0, 1.0, 0, STRAIGHT)
    go_on(api, 0.28)
    ask(api, "reset")
    assert ask(api, "isRecording")
    go_on(api, 0.1)
    ask(api, "stopRecording")
    assert not ask(api, "isRecording")
    [[_, *rows]] = rows_of(tmp_path)
    times = [int(row[1]) - int(rows[0][1]) for row in rows]
    assert times == sorted([*range(0, 450, 50), *range(400, 550, 50)])  # of the reset, the state before and after
    ask(api, "uavaccelStartGame", 1.0)
    ask(api, "simPause", False)
    go_on(api, 0.12)
    ask(api, "moveByVelocity", 1.0, 0.0, 0.0, 1.0, 0, STRAIGHT)
    assert api.simulation.recording().samples[0, 0] == 0, "a game counts from its first command again"


@pytest.mark.parametrize("name", ["Drone\t1", "two\nlines", "a\u2028b", "a\x85b", "\0", "a/b", "a" * 257])
def test_a_name_that_a_file_cannot_hold_is_refused(name: str) -> None:
    vehicle: dict[str, Any] = {"Vehicles": {name: {}}}
    camera: dict[str, Any] = {"Vehicles": {"Drone": {"Cameras": {name: {}}}}}
    for chosen, key in ((vehicle, "Vehicles: a vehicle"), (camera, "Cameras: a camera")):
        with pytest.raises(UserError, match=f"{key} cannot be called"):
            hovering(settings=Settings.model_validate(chosen))


def test_each_recording_has_a_file_of_its_own_or_is_the_callers_error(tmp_path: Path) -> None:
    api = hovering(recordings=tmp_path / "made" / "when needed")
    for method in ("startRecording", "startRecording", "stopRecording"):
        ask(api, method)
    assert len(rows_of(tmp_path / "made" / "when needed")) == 2
    (tmp_path / "file").write_text("in the way")
    api = hovering(recordings=tmp_path / "file")
    with pytest.raises(rpc.RpcError, match=r"startRecording.*/file/.*: Not a directory"):
        ask(api, "startRecording")
    assert ask(api, "ping")


# --- flight and state -------------------------------------------------------------------------------------------------


MAX_DOF, FORWARD_ONLY = 0, 1
STATE = Kinematics(
    time_ns=123,
    position_m=(1.0, 2.0, 3.0),
    orientation_wxyz=(4.0, 5.0, 6.0, 7.0),
    linear_velocity_m_s=(8.0, 9.0, 10.0),
    angular_velocity_rad_s=(11.0, 12.0, 13.0),
    linear_acceleration_m_s2=(14.0, 15.0, 16.0),
    angular_acceleration_rad_s2=(17.0, 18.0, 19.0),
)


def test_a_state_survives_the_wire() -> None:
    assert encode_state(STATE) == [123, *(float(n) for n in range(1, 20))]
    assert decode_state(encode_state(STATE)) == STATE


def test_homes_are_on_a_sphere_around_airsims_origin() -> None:
    """A degree of latitude is a 360th of the circumference; of longitude, the cosine of the latitude times that."""
    degree_m = 2 * math.pi * 6_378_137.0 / 360
    north = geographic((degree_m / 100, 0.0, -7.0), Settings().home)
    assert north == pytest.approx((47.641468 + 0.01, -122.140165, 122.0 + 7.0), abs=1e-9)
    east = geographic((0.0, degree_m / 1000, 0.0), Settings().home)
    assert east.longitude == pytest.approx(-122.140165 + 0.001 / math.cos(math.radians(47.641468)), abs=1e-9)


@pytest.mark.parametrize(("place_m", "expected"), [
    ((3000.0, -2000.0, -500.0), (47.6684446689, -122.166792765, 623.019409)),
    ((9000.0, 9000.0, -3000.0), (47.7223124619, -122.020263627, 3134.6897)),
    ((-5000.0, 100.0, -9000.0), (47.5965613644, -122.138837203, 9123.95996)),
])  # fmt: skip
def test_vehicles_are_where_airsims_environment_has_them(
    place_m: tuple[float, float, float], expected: tuple[float, float, float]
) -> None:
    """On the plane that touches WGS 84 at a vehicle's home: places of AirSim's own code, altitudes to its float32."""
    home = Settings().home
    assert geodetic(place_m, home)[:2] == pytest.approx(expected[:2], abs=1e-9)
    assert geodetic(place_m, home).altitude == pytest.approx(expected[2], abs=1e-3)
    origin_m = (40.0, -30.0, 2.0)
    aside = geodetic(tuple(a + b for a, b in zip(place_m, origin_m, strict=True)), home, origin_m)  # type: ignore[arg-type]
    assert aside == pytest.approx(geodetic(place_m, geographic(origin_m, home)), abs=1e-9)


@pytest.mark.parametrize(("velocity", "drivetrain", "mode", "yaw", "is_rate"), [
    ((1.0, 1.0, 0.0), MAX_DOF, {"is_rate": True, "yaw_or_rate": 90.0}, math.pi / 2, True),
    ((1.0, 1.0, 0.0), MAX_DOF, {"is_rate": False, "yaw_or_rate": 90.0}, math.pi / 2, False),
    ((1.0, 1.0, 0.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 0.0}, math.pi / 4, False),
    ((1.0, -1.0, 0.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 10.0}, math.radians(-35.0), False),
    ((-1.0, 0.0, 0.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 90.0}, -math.pi / 2, False),
    ((1.0, 1.0, 0.0), FORWARD_ONLY, {"is_rate": True, "yaw_or_rate": 90.0}, math.pi / 2, True),
    ((0.3, 0.4, 9.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 90.0}, 0.0, True),  # .5 m/s: no direction
    ((0.3, 0.41, 0.0), FORWARD_ONLY, {"is_rate": False, "yaw_or_rate": 0.0}, math.atan2(0.41, 0.3), False),
    ((1.0, 0.0, 0.0), MAX_DOF, {}, 0.0, True),
])  # fmt: skip
def test_yaw_follows_the_direction_of_travel_if_asked_to(
    velocity: tuple[float, float, float], drivetrain: int, mode: Any, yaw: float, is_rate: bool
) -> None:
    found = facing(*velocity[:2], drivetrain, types.yaw_mode(mode, "yaw_mode"))
    assert found[0] == pytest.approx(yaw)
    assert found[1] is is_rate


# --- the table of calls -----------------------------------------------------------------------------------------------


PAGE = Path(__file__).parents[1] / "docs" / "airsim-calls.md"


def test_the_page_is_that_of_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python -m uavaccel.wire.api > docs/airsim-calls.md"


def test_every_call_of_airsims_client_is_in_it_once() -> None:
    names = [call.name for calls in sections().values() for call in calls]
    assert len(names) == len(set(names)) == 122
    assert {*names} == {name for name in Api(simulate()).handlers if not name.startswith("uavaccel")}
