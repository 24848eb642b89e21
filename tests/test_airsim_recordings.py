"""Recordings with images: each sample's files are of its tick, and two runs write the same bytes."""

from __future__ import annotations

from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.airsim_wire import AirSimWire
from tests.flying import point, pose
from uavaccel.errors import UserError
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
from uavaccel.wire import rpc
from uavaccel.wire.types import EPOCH_NS

pytestmark = pytest.mark.opengl

CAMERAS = [
    {"CameraName": "0", "ImageType": 0},
    {"CameraName": "bottom_center", "ImageType": 1, "PixelsAsFloat": True},
    {"CameraName": "0", "ImageType": 5, "Compress": False},
]


def recorder(folder: Path, **recording: object) -> AirSimWire:
    return AirSimWire(
        {"Vehicles": {"Up:down 1": {}}, "Recording": {"Cameras": CAMERAS, **recording}}, recordings=folder
    )


def flown(folder: Path) -> tuple[AirSimWire, Path]:
    wire = recorder(folder)
    wire.fly(0.01)
    wire.call("startRecording")
    wire.fly(0.02)
    wire.call("moveByVelocity", 3.0, 0.0, 0.0, 5.0, 0, {"is_rate": True, "yaw_or_rate": 0.0}, "")
    wire.fly(0.28)
    wire.call("stopRecording")
    [made] = folder.iterdir()
    return wire, made


def test_each_sample_has_its_images(tmp_path: Path) -> None:
    wire, made = flown(tmp_path)
    header, *rows = [line.split("\t") for line in (made / "airsim_rec.txt").read_text().splitlines()]
    assert [int(row[1]) - EPOCH_NS // 1_000_000 for row in rows] == [*range(10, 320, 50)]
    assert wire.said == [f"recording to {made / 'airsim_rec.txt'}"]
    names = [row[header.index("ImageFile")].split(";") for row in rows]
    assert names[1][0] == f"img_Up_down_1_front_center_0_{EPOCH_NS + 60_000_000}.png"
    assert sorted(path.name for path in (made / "images").iterdir()) == sorted(chain(*names))
    assert [Path(name).suffix for name in names[1]] == [".png", ".pfm", ".ppm"]
    scene, depth, segments = (made / "images" / name for name in names[-1])  # at the last tick: it still stands there
    wire.call("simPause", True)
    assert segments.read_bytes().startswith(b"P6")
    shown, below, ids = wire.images(("0", 0, False), ("3", 1, True), ("0", 5, False))
    for path, response in ((scene, shown), (segments, ids)):
        pixels = np.frombuffer(response["image_data_uint8"], np.uint8).reshape(144, 256, 3)
        np.testing.assert_array_equal(cv2.imread(str(path)), pixels)
    depth_m = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED)  # a portable float map
    assert depth_m is not None
    np.testing.assert_allclose(depth_m.ravel(), below["image_data_float"])


@pytest.mark.parametrize(("on_move", "times_ms"), [(False, [0, 50, 100, 120, 170, 220]), (True, [0, 170, 220])])
@pytest.mark.parametrize("again", [["reset"], ["uavaccelStartGame", 1.0]])
def test_after_a_reset_each_sample_has_its_images_again(
    tmp_path: Path, on_move: bool, times_ms: list[int], again: list[Any]
) -> None:
    """On the new sampling grid, which begins with the reset or the game; those of lines left out are of none."""
    wire = recorder(tmp_path, RecordOnMove=on_move)
    wire.call("startRecording")
    wire.fly(0.12)
    wire.call(*again)
    wire.call("simPause", False)
    wire.call("enableApiControl", True, "")
    wire.fly(0.02)
    wire.call("moveByVelocity", 3.0, 0.0, -3.0, 5.0, 0, {"is_rate": True, "yaw_or_rate": 0.0}, "")
    wire.fly(0.11)
    wire.call("stopRecording")
    [made] = tmp_path.iterdir()
    rows = [line.split("\t") for line in (made / "airsim_rec.txt").read_text().splitlines()[1:]]
    assert [int(row[1]) - EPOCH_NS // 1_000_000 for row in rows] == times_ms
    assert [row[-1].count(";") for row in rows] == [2] * len(times_ms)


def test_each_vehicle_is_recorded_in_its_own_frame_with_its_own_cameras(tmp_path: Path) -> None:
    """Those that were there when the recording began; also if samples are written before their images are due."""
    below, front = {"CameraName": "3", "VehicleName": "B"}, {"CameraName": "0", "VehicleName": "C"}
    vehicles = {"A": {"X": 3}, "B": {"Y": 5, "Z": -2, "Yaw": 90}, "C": {"AutoCreate": False}}
    settings = {"Vehicles": vehicles, "Recording": {"Cameras": [below, front]}}
    wire = AirSimWire(settings, World("blocks", NATIVE, airsim=True), recordings=tmp_path)
    wire.world.watch(50, lambda _: wire.api.scenery.recorder.keep())
    wire.call("enableApiControl", True, "B")
    wire.call("startRecording")
    wire.call("moveByVelocityZ", 2.0, 0.0, -3.0, 5.0, 0, {"is_rate": True, "yaw_or_rate": 0.0}, "B")
    wire.fly(0.2)
    wire.call("simAddVehicle", "D", "simpleflight", pose(9.0, 9.0, -2.0), "")
    wire.fly(0.2)
    wire.call("stopRecording")
    wire.call("simPause", True)
    here = [wire.call("simGetVehiclePose", name)["position"].values() for name in "AB"]
    [file] = tmp_path.glob("*/airsim_rec.txt")
    rows = [line.split("\t") for line in file.read_text().splitlines()[1:]]
    assert [row[0] for row in rows] == ["A", "B"] * 9
    assert [row[-1][:22] for row in rows] == ["", "img_B_bottom_center_0_"] * 9
    for row, place in zip(rows[-2:], here, strict=True):
        np.testing.assert_allclose([float(value) for value in row[2:5]], list(place), rtol=1e-6, atol=1e-9)
    assert float(rows[-1][2]) > 0.01, "B flew"


def test_two_runs_write_the_same_bytes(tmp_path: Path) -> None:
    made = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        made.append(flown(tmp_path / name)[1])
    files = [{path.relative_to(run): path.read_bytes() for path in run.rglob("*.*")} for run in made]
    assert len(files[0]) == 1 + 3 * 7
    assert files[0] == files[1]


def test_on_move_what_stands_still_is_left_out(tmp_path: Path) -> None:
    """But for the first sample of each recording."""
    wire = recorder(tmp_path, Cameras=[], RecordOnMove=True)
    wire.call("simPause", True)
    for number in (1, 2):
        wire.call("startRecording")
        wire.call("stopRecording")
        files = [*tmp_path.glob("*/airsim_rec.txt")]
        assert [len(file.read_text().splitlines()) for file in files] == [2] * number
    assert not [*tmp_path.glob("*/images")]


def test_on_move_what_turns_has_moved(tmp_path: Path) -> None:
    wire = AirSimWire({"SimMode": "ComputerVision", "Recording": {"RecordOnMove": True}}, recordings=tmp_path)
    wire.call("startRecording")
    for turn in (0.0, 0.6, 0.6, 0.6):
        wire.call("simSetVehiclePose", pose(*[float("nan")] * 3, z_val=turn), True, "")
        wire.fly(0.05)
    wire.call("stopRecording")
    [file] = tmp_path.glob("*/airsim_rec.txt")
    rows = [line.split("\t")[2:9] for line in file.read_text().splitlines()[1:]]
    assert len(rows) == 2
    assert rows[0][:3] == rows[1][:3]
    wire.call("simSetVehiclePose", pose(20.0, 0.0, 3.0), False, "")
    assert wire.call("simGetVehiclePose", "")["position"] == point(20.0, 0.0, 3.0), "below the ground it looks too"


@pytest.mark.parametrize(("image", "reason"), [
    ({"CameraName": "nose"}, "no camera 'nose'"),
    ({"ImageType": 12}, "image type 12 is not available"),
    ({"VehicleName": "Nobody"}, "Vehicle API for 'Nobody' is not available"),
])  # fmt: skip
def test_an_image_that_cannot_be_taken_is_refused_at_the_start(
    tmp_path: Path, image: dict[str, object], reason: str
) -> None:
    with pytest.raises(UserError, match=rf"^Recording\.Cameras\.1: {reason}"):
        recorder(tmp_path, Cameras=[{}, image])


def test_a_full_disk_ends_images_but_not_the_flight(tmp_path: Path) -> None:
    wire = recorder(tmp_path)
    wire.call("startRecording")
    [images] = tmp_path.glob("*/images")
    for image in images.iterdir():
        image.unlink()
    images.rmdir()
    images.write_text("no folder any more")
    wire.fly(0.2)
    assert wire.said[1].startswith("warning: the recording of images ends here: ")
    assert len(wire.said) == 2
    wire.call("stopRecording")
    [file] = tmp_path.glob("*/airsim_rec.txt")
    assert len(file.read_text().splitlines()) == 1 + 5


def test_a_recording_that_cannot_be_written_ends_and_the_flight_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever writes it: the buffer's emptying, a reset, or its end."""
    wire = recorder(tmp_path, Cameras=[])
    monkeypatch.setattr("uavaccel.wire.recorder.FILE_NAME", "/dev/full")
    for write in (wire.api.scenery.recorder.keep, lambda: wire.call("reset"), lambda: wire.call("stopRecording")):
        wire.call("startRecording")
        wire.fly(0.2)
        write()
        assert wire.said.pop() == "warning: the recording ends here: No space left on device"
    (tmp_path / "file").touch()
    with pytest.raises(rpc.RpcError, match=r"information: \S*/file/\S*: Not a directory\.$"):
        recorder(tmp_path / "file").call("startRecording")


def test_folders_are_not_made_faster_than_one_a_second(tmp_path: Path) -> None:
    wire = recorder(tmp_path, Cameras=[])
    for _ in range(3):
        wire.fly(1.5)
        for _ in range(100):
            with suppress(rpc.RpcError):
                wire.call("startRecording")
    assert len([*tmp_path.iterdir()]) == 20 + 2 + 1
    with pytest.raises(rpc.RpcError, match="begun too often"):
        wire.call("startRecording")
    assert wire.call("isRecording"), "what is refused ends nothing"
    wire.call("stopRecording")
