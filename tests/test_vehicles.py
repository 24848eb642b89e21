"""Several vehicles in one world: each its own frame, command and state; the first flies as if it were alone."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.flying import STRAIGHT, call, go_on, place, point, pose
from uavaccel.errors import UserError
from uavaccel.sim.profile import NATIVE, Profile
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Start
from uavaccel.sim.world import START_M, World
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.image_api import decode_image
from uavaccel.wire.settings import Settings

ASIDE = {"X": 5, "Y": 5}


def made(profile: Profile = NATIVE, render: bool = False, airsim: bool = False, **settings: Any) -> Api:
    """A world of blocks with these settings."""
    world, given = World("blocks", profile, airsim=airsim), Settings.model_validate(settings)
    given.prepare(world)
    return Api(Simulation(world), given, render=render)


def fleet(profile: Profile = NATIVE, **vehicles: Any) -> Api:
    """The vehicles of a settings file, all with API control."""
    api = made(profile, Vehicles=vehicles)
    for name in vehicles:
        call(api, "enableApiControl", True, name)
    return api


def test_one_of_which_no_model_can_be_made_changes_nothing() -> None:
    ends = []
    for refused in (True, False):
        api = hovering_alone()
        call(api, "moveByVelocity", 1.0, 1.0, 0.0, 60.0, 0, STRAIGHT)
        full = patch("uavaccel.sim.world.load_scene", side_effect=MemoryError("no room for a model"))
        if refused:
            with full, pytest.raises(rpc.RpcError, match="no room for a model"):
                call(api, "simAddVehicle", "New", "simpleflight", pose(3.0, -6.0, 0.0), "")
        go_on(api, 1.0)
        ends.append(place(api).tolist())
        assert call(api, "listVehicles") == ["SimpleFlight"]
    assert ends[0] == ends[1]
    call(api, "reset")
    assert place(api)[2] == START_M[2]


def hovering_alone() -> Api:
    """In a world of its own, which may be populated."""
    api = made()
    call(api, "enableApiControl", True)
    return api


@pytest.mark.parametrize(("vehicles", "text"), [
    ({"A": {"X": 45, "Z": -3}}, "Vehicles.A: position: .* inside block_north"),
    ({"A": {"Z": 3}}, "Vehicles.A: position: NED z has to be"),
    ({"A": {"X": 2e4}}, "Vehicles.A: position: north and east have to be within 10000 m"),
    ({"A": {}, "B/1": ASIDE}, "Vehicles: a vehicle cannot be called 'B/1'"),
    ({"A": {}, "ground": {"AutoCreate": False}}, "Vehicles: a vehicle cannot be called 'ground': an object of"),
])  # fmt: skip
def test_places_that_cannot_be_are_named(vehicles: Any, text: str) -> None:
    with pytest.raises(UserError, match=text):
        fleet(**vehicles)


def test_who_leads() -> None:
    """The first by the alphabet as in AirSim, or who is watched; who is not created is not there."""
    settings = Settings.model_validate({"Vehicles": {"Z": {}, "B": ASIDE}})
    assert settings.vehicle == "B"
    absent = {"AutoCreate": False, "IsFpvVehicle": True}
    watched = {"Vehicles": {"A": absent, "Z": {"IsFpvVehicle": True}, "B": ASIDE}}
    assert Settings.model_validate(watched).vehicle == "Z"
    assert [name for name, _ in Settings.model_validate(watched).created()] == ["B", "Z"]


def test_a_placed_one_has_heading_home_sight_and_ground_of_its_own() -> None:
    api, without = fleet(A={}, B={"X": -20, "Y": 10, "Z": -1, "Yaw": 90}, C={}), fleet(A={}, C={})
    starts, alone = ({each.name: each.start for each in one.simulation.world.vehicles} for one in (api, without))
    assert {name: starts[name] for name in alone} == alone, "the others start where they would without it"
    assert call(api, "simGetVehiclePose", "B")["orientation"]["z_val"] == pytest.approx(0.5**0.5)
    gps = call(api, "getMultirotorState", "B")["gps_location"]
    assert list(call(api, "getHomeGeoPoint", "B").values()) == pytest.approx(list(gps.values()), abs=1e-8)
    assert call(api, "simTestLineOfSightToPoint", point(-20.0, 10.0, -20.0), "B")
    api.simulation.settle(api.simulation.wall_ns)
    assert call(api, "simGetCollisionInfo", "B")["collision_count"] == 0, "it stands from the beginning"


@pytest.mark.parametrize("frame", ["VehicleInertialFrame", "SensorLocalFrame"])
def test_a_lidar_scans_around_its_own_vehicle(frame: str) -> None:
    """All of a scan: as many azimuths for each channel, the upmost channel first; the ground where it is."""
    lidar = {
        "SensorType": 6, "NumberOfChannels": 4, "PointsPerSecond": 4_000, "HorizontalFOVEnd": 360, "DataFrame": frame,
        "VerticalFOVUpper": -20, "VerticalFOVLower": -50, "X": 0.5, "Yaw": 90,
    }  # fmt: skip
    api = fleet(A={}, B={"X": -20, "Y": 10, "Z": -1, "Sensors": {"eye": lidar}})
    call(api, "simSetVehiclePose", pose(2.0, 1.0, -4.0), True, "B")
    told = call(api, "getLidarData", "eye", "B")
    points = np.reshape(told["point_cloud"], (-1, 3)).astype(float)
    assert list(told["pose"]["position"].values()) == pytest.approx([2.5, 1.0, -4.0])
    eye = [2.5, 1.0, -4.0] if frame == "VehicleInertialFrame" else [0.0, 0.0, 0.0]
    assert points.shape == (400, 3)
    rays = points - eye
    down = np.degrees(np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])))
    np.testing.assert_allclose(down, np.repeat([20.0, 30.0, 40.0, 50.0], 100), atol=1e-3)
    bearing = np.degrees(np.arctan2(rays[:, 1], rays[:, 0])) - (90.0 if frame == "VehicleInertialFrame" else 0.0)
    turned = (bearing - np.tile(np.arange(100) * 3.6, 4) + 180) % 360 - 180
    np.testing.assert_allclose(turned, 0.0, atol=1e-3)
    np.testing.assert_allclose(rays[:, 2], 1.045 + 4.0, atol=1e-4)  # its frame begins 1.045 m above the ground


def test_a_camera_sees_through_its_own_vehicle_alone() -> None:
    """By rays: what is detected, and the normals of surfaces, of which the sky has none."""
    mast = {"X": 5, "Y": 5, "Z": -30, "Pitch": -90}
    small = [{"ImageType": 6, "Width": 33, "Height": 33, "FOV_Degrees": 20}]
    settings: dict[str, Any] = {"CameraDefaults": {"CaptureSettings": small}}
    settings["ExternalCameras"] = {"mast": mast, "block_north": mast}  # vehicles alone have names of their own
    api = made(render=True, **settings, Vehicles={"A": {"X": -30, "Y": -30}, "B": ASIDE})

    def normals(camera: str, vehicle: str, external: bool) -> NDArray[np.uint8]:
        request = {"camera_name": camera, "image_type": 6, "compress": False}
        picture, packed = call(api, "simGetImages", [request, request | {"compress": True}], vehicle, external)
        assert call(api, "simGetImage", camera, 6, vehicle, external) == packed["image_data_uint8"]
        told = call(api, "simGetCameraInfo", camera, vehicle, external)["pose"]["position"]
        assert told == picture["camera_position"]
        assert not external or list(told.values()) == [5.0, 5.0, -30.0], "in no vehicle's frame"
        return np.frombuffer(picture["image_data_uint8"], np.uint8).reshape(33, 33, 3)

    for vehicle in ("A", "B"):
        call(api, "simSetVehiclePose", pose(0.0, 0.0, -6.0), True, vehicle)
        call(api, "simSetCameraPose", "0", pose(0.0, 0.0, 0.0), vehicle)
        assert call(api, "simAddDetectionFilterMeshName", "0", 0, "block_north", vehicle) is None
        assert [each["name"] for each in call(api, "simGetDetections", "0", 0, vehicle)] == ["block_north"]
        call(api, "simSetDetectionFilterRadius", "0", 0, 1000.0, vehicle)
        call(api, "simClearDetectionMeshNames", "0", 0, vehicle)
        call(api, "simAddDetectionFilterMeshName", "0", 0, "block_north", vehicle)
        assert call(api, "simGetDetections", "0", 0, vehicle) == [], "the radius, 10 m, is kept"
        call(api, "simSetCameraPose", "0", pose(0.0, 0.0, 0.0, w_val=0.5**0.5, y_val=-(0.5**0.5)), vehicle)
        ground = normals("0", vehicle, False)
        assert (ground == np.array([255, 128, 128], np.uint8)).all(), "blue, which is up, and nothing of itself"
        for other in ("A", "B"):  # below the mast, one after the other
            call(api, "simSetVehiclePose", pose(0.0, 90.0, -6.0), True, other)
        local = {"A": (35.0, 35.0), "B": (0.0, 0.0)}[vehicle]
        call(api, "simSetVehiclePose", pose(*local, -28.0, w_val=0.9, x_val=0.436), True, vehicle)
        seen = normals("mast", "", True)
        assert not (seen[16, 16] == [255, 128, 128]).all(), "a side of the tilted vehicle"
        assert (seen[0, 0] == [255, 128, 128]).all()


@pytest.mark.opengl
def test_each_sees_through_its_own_cameras() -> None:
    """Downwards, from different heights, or past a lowered nose; and ahead, where one looks at the other's back."""
    api = made(render=True, Vehicles={"A": {"X": 0, "Y": 0}, "B": {"X": -30, "Y": -30, "Yaw": 180}})
    heights, lowered = {"A": 10.0, "B": 25.0}, {"w_val": 0.5**0.5, "y_val": -(0.5**0.5)}
    for name, height_m in heights.items():
        for camera, attitude, below_m in (("3", {}, 0.12), ("0", lowered, 0.46)):
            call(api, "simSetVehiclePose", pose(0.0, 0.0, 0.045 - height_m, **attitude), True, name)
            request = {"camera_name": camera, "image_type": 1, "pixels_as_float": True, "compress": False}
            (picture,) = call(api, "simGetImages", [request], name)
            depth_m = np.reshape(picture["image_data_float"], (144, 256))
            np.testing.assert_allclose(depth_m[70:74, 120:136], height_m - below_m, rtol=2e-3)
            told = list(picture["camera_position"].values())
            assert told == pytest.approx([0.0, 0.0, 0.045 - height_m + below_m], abs=1e-6)
    call(api, "simSetVehiclePose", pose(0.0, 0.0, 0.045 - heights["B"]), True, "B")
    call(api, "simSetVehiclePose", pose(-32.0, -30.0, 0.045 - 25.0), True, "A")  # 2 m to the south of B
    behind = decode_image(call(api, "uavaccelImage", "gray"))
    call(api, "simSetVehiclePose", pose(0.0, 0.0, -90.0), True, "B")
    assert np.mean(behind != decode_image(call(api, "uavaccelImage", "gray"))) > 0.002


def test_a_camera_is_where_its_settings_say_and_stands_on_nothing() -> None:
    eye = {"VehicleType": "ComputerVision", "X": 5, "Y": 0, "Z": 0}
    api = made(SimMode="ComputerVision", Vehicles={"Eye": eye})
    call(api, "simAddVehicle", "New", "simpleflight", pose(3.0, -6.0, -2.0), "")
    assert [each.place_m for each in api.simulation.world.vehicles] == [(5.0, 0.0, 0.0), (3.0, -6.0, -2.0)]


def test_of_several_at_once_one_that_is_too_near_is_refused_with_all() -> None:
    api = hovering_alone()
    with pytest.raises(rpc.RpcError, match="cannot be called 'ground': an object"):
        call(api, "simAddVehicle", "ground", "SimpleFlight", pose(5.0, 0.2, 2.0))
    call(api, "simAddVehicle", "Second", "SimpleFlight", pose(5.0, 0.2, 2.0))
    for near in ((5.0, 0.3, -0.2), (20.5, 0.0, -5.0)):
        far = AddedVehicle("Far", Start((20.0, 0.0, -5.0)))
        with pytest.raises(UserError, match=r"Near would start less than 0\.75 m from (Second|Far)"):
            api.simulation.add_vehicles([far, AddedVehicle("Near", Start(near))])
    assert len(api.simulation.pilots) == len(api.simulation.world.vehicles) == 2
