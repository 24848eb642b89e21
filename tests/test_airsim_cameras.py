"""AirSim's cameras and types of image, against rays cast into boxes of known measures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.airsim_wire import AirSimWire, floats, pixels, xyz
from tests.flying import pose
from tests.scenes import BLOCKS, Pose, Seen, cast_from
from uavaccel.wire import rpc
from uavaccel.wire.pictures import Cameras, CameraSettings, id_of_name

pytestmark = pytest.mark.opengl

SCENE, PLANAR, PERSPECTIVE, VIS, DISPARITY, SEGMENTATION, NORMALS, INFRARED, FLOW = range(9)
SKY_M = 65504.0
WIDE = BLOCKS | {"ground": ((0.0, 0.0, 1.0), (1e4, 1e4, 1.0))}
VEHICLE = Pose((3.0, -4.0, -8.0), (8.0, -6.0, 25.0))
SETTINGS = {
    "CameraDefaults": {"CaptureSettings": [{"ImageType": kind, "Width": 96, "Height": 54} for kind in (6, 1)]},
    "ExternalCameras": {"mast": {"X": -5, "Y": 10, "Z": -20, "Pitch": -30, "Yaw": -45}},
    "Vehicles": {
        "Eye": {
            "Cameras": {
                "tail": {"X": -1.0, "Z": -0.5, "Pitch": -20, "Yaw": 170},
                "2": {
                    "Y": -0.5,
                    "CaptureSettings": [{"ImageType": 1, "Width": 288, "Height": 60, "FOV_Degrees": 60}],
                    "Gimbal": {"Stabilization": 1},
                },
            }
        }
    },
}
MOUNTS = {  # by name: metres FRD; roll, pitch, yaw in degrees; columns, rows, degrees across
    "front_center": ((0.46, 0.0, 0.0), (0, 0, 0), 96, 54, 90),
    "1": ((0.46, 0.125, 0.0), (0, 0, 0), 96, 54, 90),
    "front_left": ((0.46, -0.5, 0.0), (0, 0, 0), 288, 60, 60),
    "3": ((0.0, 0.0, 0.12), (0, -90, 0), 96, 54, 90),
    "back_center": ((-0.46, 0.0, 0.0), (0, 0, 180), 96, 54, 90),
    "tail": ((-1.0, 0.0, -0.5), (0, -20, 170), 96, 54, 90),
}


def turned(degrees: tuple[float, float, float]) -> NDArray[np.float64]:
    return Pose((0.0, 0.0, 0.0), degrees).matrix()


def seen_from(mount: Any, vehicle: Pose = VEHICLE) -> Seen:
    place, degrees, columns, rows, fov_deg = mount
    eye = np.array(vehicle.position_m) + vehicle.matrix() @ place
    return cast_from(eye, vehicle.matrix() @ turned(degrees), WIDE, columns, rows, fov_deg)


def test_optical_flow_is_empty_and_documented() -> None:
    wire = AirSimWire()
    for _ in range(2):
        for image_type, picture in zip((8, 9), wire.images(*(("0", t, False) for t in (8, 9))), strict=True):
            assert (picture["width"], picture["height"], picture["image_data_uint8"]) == (0, 0, b"")
            assert picture["message"].startswith(f"image type {image_type} is not available")
    assert wire.said == ["simGetImages: images of types 8 and 9 (optical flow) are empty"]
    page = (Path(__file__).parents[1] / "docs" / "from-airsim.md").read_text(encoding="utf-8")
    assert [line for line in page.splitlines() if "ypes 8 and 9 (optical flow)" in line]
    assert not any("there are none" in line for line in page.splitlines() if "empty images" in line)


@pytest.mark.parametrize("name", MOUNTS)
def test_each_camera_sees_from_its_mount_through_its_lens(name: str) -> None:
    wire, mount = AirSimWire(SETTINGS), MOUNTS[name]
    wire.move(VEHICLE)
    [response] = wire.images((name, PLANAR, True))
    assert (response["width"], response["height"]) == mount[2:4]
    seen, depth_m = seen_from(mount), floats(response)
    clear = seen.inside() & (seen.planar_m < 500)
    assert clear.mean() > 0.2
    np.testing.assert_allclose(depth_m[clear], seen.planar_m[clear], rtol=4e-3)
    assert (depth_m[seen.inside() & (seen.box < 0)] == SKY_M).all()
    eye = np.array(VEHICLE.position_m) + VEHICLE.matrix() @ mount[0]
    info = wire.call("simGetCameraInfo", name, "Eye", False)
    for told in (response["camera_position"], info["pose"]["position"]):
        np.testing.assert_allclose(xyz(told), eye, atol=1e-9)
    assert response["camera_orientation"] == info["pose"]["orientation"]
    w, *axis = info["pose"]["orientation"].values()
    forward = VEHICLE.matrix() @ turned(mount[1])[:, 0]
    x, y, z = axis
    np.testing.assert_allclose([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], forward, atol=1e-9)
    assert wire.api.settings.without_effect() == ["Vehicles.Eye.Cameras.2.Gimbal"]


def test_an_external_camera_stands_in_the_world_and_sees_the_vehicle() -> None:
    wire = AirSimWire(SETTINGS)
    wire.move(VEHICLE)
    request = {"camera_name": "mast", "image_type": PLANAR, "pixels_as_float": True}
    [response] = wire.call("simGetImages", [request], "", True)
    axes, eye = turned((0.0, -30.0, -45.0)), np.array([-5.0, 10.0, -20.0])
    seen = cast_from(eye, axes, WIDE, 96, 54, 90.0)
    near = np.abs(floats(response) / seen.planar_m - 1) < 4e-3
    assert near[seen.inside() & (seen.planar_m < 500)].mean() > 0.98
    forward, right, down = (np.array(VEHICLE.position_m) - eye) @ axes
    row, column = int(27 + 48 * down / forward), int(48 + 48 * right / forward)
    assert floats(response)[row, column] == pytest.approx(forward, abs=0.5), "the vehicle is in the way"
    [scene] = wire.call("simGetImages", [{"camera_name": "mast", "image_type": SCENE}], "", True)
    assert wire.call("simGetImage", "mast", SCENE, "", True) == scene["image_data_uint8"]
    detecting = ("simAddDetectionFilterMeshName", SCENE, "a"), ("simSetDetectionFilterRadius", SCENE, 9.0)
    for method, *more in (
        *(("simGetCameraInfo",), ("simSetCameraFov", 80.0), ("simSetCameraPose", pose(0.0, 0.0, 0.0))),
        *(("simGetDistortionParams",), ("simSetDistortionParam", "K1", 0.0), ("simGetImage", SCENE)),
        *(*detecting, ("simGetDetections", SCENE), ("simClearDetectionMeshNames", SCENE)),
    ):
        wire.call(method, "mast", *more, "", True)
        with pytest.raises(rpc.RpcError, match="no camera 'mast'"):
            wire.call(method, "mast", *more, "")
    with pytest.raises(rpc.RpcError, match="no camera 'mast'"):
        wire.images(("mast", PLANAR, True))
    with pytest.raises(rpc.RpcError, match="no camera '0'; there are mast"):
        wire.call("simGetCameraInfo", "0", "", True)


def test_what_a_camera_leaves_out_of_its_lens_is_of_the_defaults() -> None:
    common = CameraSettings.model_validate({"CaptureSettings": [{"Width": 64, "Height": 48, "FOV_Degrees": 60}]})
    for own, lens in (
        ({}, (64, 48, 60.0)),
        ({"Width": 300}, (300, 48, 60.0)),
        ({"Height": 20}, (64, 20, 60.0)),
        ({"FOV_Degrees": 30}, (64, 48, 30.0)),
    ):
        given = CameraSettings.model_validate({"CaptureSettings": [own]})
        assert Cameras(common, {"0": given}).named("front_center").lens(0) == lens


def test_a_camera_is_moved_and_zoomed_and_nan_changes_nothing() -> None:
    wire = AirSimWire()
    wire.move(VEHICLE)
    mount = Pose((0.2, 1.0, -0.3), (5.0, -30.0, 60.0))
    wire.call("simSetCameraPose", "0", mount.message(), "", False)
    wire.call("simSetCameraFov", "front_center", 50, "", False)
    wire.call("simSetCameraPose", "fpv", pose(float("nan"), 0.0, 0.0, w_val=float("nan")), "", False)
    seen = seen_from((mount.position_m, mount.degrees, 256, 144, 50))
    planar, along, shares, colours = wire.images(
        ("0", PLANAR, True), ("", PERSPECTIVE, True), ("0", VIS, True), ("0", INFRARED, False)
    )
    clear = seen.inside() & (seen.planar_m < 500)
    np.testing.assert_allclose(floats(planar)[clear], seen.planar_m[clear], rtol=4e-3)
    np.testing.assert_allclose(floats(along)[clear], seen.perspective_m[clear], rtol=4e-3)
    np.testing.assert_allclose(floats(shares)[clear], np.minimum(seen.planar_m / 100, 1)[clear], rtol=4e-3)
    ids = np.array([id_of_name(name) for name in WIDE])
    assert (pixels(colours)[clear] == ids[seen.box][clear][:, None]).all()
    assert wire.call("simGetCameraInfo", "0", "", False)["fov"] == 50


def test_disparity_normals_and_infrared() -> None:
    """Level, 10 m up, before block_north's south face: its normal is south, the ground's up."""
    wire = AirSimWire()
    seen = seen_from(((0.46, 0.0, 0.0), (0, 0, 0), 256, 144, 90), Pose((0.0, 0.0, -10.0), (0, 0, 0)))
    clear = seen.inside() & (seen.planar_m < 500)
    disparity, normals, infrared = wire.images(("0", DISPARITY, True), ("0", NORMALS, False), ("0", INFRARED, False))
    np.testing.assert_allclose(floats(disparity)[clear], 0.25 / 2 / seen.planar_m[clear], rtol=4e-3)
    names = [*WIDE]
    faces = {"block_north": (0, 128, 128), "ground": (128, 128, 255)}
    for name, rgb in faces.items():
        of_it = seen.inside() & (seen.box == names.index(name))
        assert of_it.sum() > 1000
        assert np.abs(pixels(normals)[of_it][:, ::-1].astype(int) - rgb).max() <= 1
        assert (pixels(infrared)[of_it] == id_of_name(name)).all()
    sky = seen.inside() & (seen.box < 0)
    assert not pixels(normals)[sky].any()
    assert not pixels(infrared)[sky].any()
    wire.call("simSetVehiclePose", pose(36.0, 0.0, -6.0), True, "")
    wire.call("simSetCameraFov", "0", 1.0, "")
    [near] = wire.images(("0", DISPARITY, True))
    assert (floats(near) == 1.0).all(), "through a long lens 5.5 m are too near"


def test_what_cannot_be_drawn_is_refused_alone() -> None:
    wire = AirSimWire()
    wire.call("moveByVelocity", 4.0, 1.0, 0.0, 5.0, 0, {"is_rate": True, "yaw_or_rate": 20.0}, "")
    wire.fly(1.0)
    first, flow, last = wire.images(("0", SCENE, False), ("0", FLOW, False), ("2", PLANAR, True))
    assert flow["message"].startswith("image type 8 is not available")
    assert (flow["width"], flow["height"], flow["image_data_uint8"], flow["image_data_float"]) == (0, 0, b"", [])
    assert wire.call("simGetImages", [{"image_type": FLOW, "compress": True}], "", False)[0]["image_data_uint8"] == b""
    assert (first["message"], last["message"]) == ("", "")
    assert len(first["image_data_uint8"]) == 256 * 144 * 3
    stamps = {response["time_stamp"] for response in (first, flow, last)}
    assert stamps == {wire.call("getMultirotorState", "")["timestamp"]}
    assert first["camera_orientation"] == last["camera_orientation"]


def test_images_that_are_too_much_for_an_answer_are_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each has 108 KiB of bytes, or 180 KiB of numbers."""
    monkeypatch.setattr("uavaccel.wire.image_api.MAX_ANSWER_BYTES", 1 << 20)
    for as_float, most in ((False, 9), (True, 5)):
        assert len(AirSimWire().images(*[("0", SCENE, as_float)] * most)) == most
        with pytest.raises(rpc.RpcError, match="the answer would have more than 1 MiB: ask for less at once"):
            AirSimWire().images(*[("0", SCENE, as_float)] * (most + 1))


def test_the_ground_goes_on_beyond_a_hundred_metres() -> None:
    wire = AirSimWire()
    wire.call("simSetVehiclePose", pose(150.0, 20.0, -5.0), True, "")
    [response] = wire.images(("0", PLANAR, True))
    rows = (np.arange(144) + 0.5 - 72) / 128
    below = rows > 5.0 / 900  # of the horizon, as far as the ground is drawn in whole pixels
    expected = np.broadcast_to((5.0 / rows[below])[:, None], (below.sum(), 256))
    np.testing.assert_allclose(floats(response)[below], expected, rtol=1e-2)
    assert (floats(response)[rows < 0] == SKY_M).all()
