"""AirSim's settings.json: honoured, passed over by name, or refused in one line."""

import json
from pathlib import Path
from typing import Any

import pytest

from uavaccel.errors import UserError
from uavaccel.sim.profile import AIRSIM, NATIVE
from uavaccel.wire.settings import Settings, read_settings

USUAL = {
    "SeeDocsAt": "https://github.com/Microsoft/AirSim/blob/main/docs/settings.md",
    "SettingsVersion": 1.2,
    "SimMode": "Multirotor",
    "ClockSpeed": 10,
    "ApiServerPort": 41452,
    "LocalHostIp": "127.0.0.1",
    "ViewMode": "NoDisplay",
    "Wind": {"X": 1, "Y": -2.5},
    "Vehicles": {"Drone1": {"VehicleType": "SimpleFlight", "X": 4, "Cameras": {"0": {}}}},
    "Recording": {"RecordInterval": 0.1, "Folder": "records", "Enabled": True, "Cameras": []},
}


def read(folder: Path, content: Any) -> Settings:
    path = folder / "settings.json"
    text = content if isinstance(content, bytes | str) else json.dumps(content)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_settings(path)


def test_what_is_honoured(tmp_path: Path) -> None:
    settings = read(tmp_path, USUAL)
    assert (settings.clock_speed, settings.api_server_port, settings.address) == (10.0, 41452, "127.0.0.1")
    assert settings.vehicle == "Drone1"
    assert (settings.wind.x, settings.wind.y, settings.wind.z) == (1.0, -2.5, 0.0)
    assert (settings.recording.folder, settings.recording.enabled) == ("records", True)
    assert settings.recorder_of(NATIVE).recorder_ticks == 50
    assert sorted(settings.without_effect()) == ["ViewMode"]
    assert json.loads(settings.as_json(2.5)) == USUAL | {"ClockSpeed": 2.5}, "what clients are told"
    swarm = {name: {"Sensors": {"l": {"SensorType": 6, "Rage": 9}}} for name in "ABC"}
    told = read(tmp_path, {"Vehicles": swarm, "Recording": {"Cameras": [{}, {"Zoom": 2}]}}).warning(None)
    assert told.endswith(": without effect here: Recording.Cameras.1.Zoom, Vehicles.A.Sensors.l.Rage and 2 more")


def test_defaults_are_airsims(tmp_path: Path) -> None:
    settings = read(tmp_path, "\ufeff{}")  # Windows editors begin a file with a mark
    assert settings == Settings()
    assert (settings.clock_speed, settings.api_server_port, settings.address) == (1.0, 41451, "127.0.0.1")
    assert settings.vehicle == "SimpleFlight"
    for profile in (NATIVE, AIRSIM):
        assert settings.recorder_of(profile).recorder_ticks == profile.recorder_ticks


@pytest.mark.parametrize(("content", "text"), [
    ({"SimMode": "Car"}, "SimMode = 'Car': should be 'Multirotor', 'ComputerVision' or ''"),
    ({"ClockType": "ScalableClock"}, "ClockType = 'ScalableClock'"),
    ({"ClockSpeed": 0}, "ClockSpeed = 0"),
    ({"ClockSpeed": "10"}, "ClockSpeed = '10'"),
    ({"ApiServerPort": 65536}, "ApiServerPort = 65536"),
    ({"EnableRpc": False}, "EnableRpc = False"),
    ({"PhysicsEngineName": "ExternalPhysicsEngine"}, "PhysicsEngineName"),
    ({"Vehicles": {"A": {"VehicleType": "PX4Multirotor"}}}, "Vehicles.A.VehicleType = 'PX4Multirotor'"),
    ({"Vehicles": {"A": {"VehicleType": "ComputerVision"}}},
     "Vehicles.A.VehicleType = 'ComputerVision' needs SimMode = 'ComputerVision'"),
    ({"Vehicles": {"A": {"X": "near"}}}, "Vehicles.A.X = 'near'"),
    ({"Recording": {"RecordInterval": 1e300}}, "Recording.RecordInterval = 1e+300: must be 0, or between 1e-12"),
    ({"DefaultSensors": {"eye": {"SensorType": 6, "UpdateFrequency": 1e308}}}, "DefaultSensors.eye.UpdateFrequency"),
    ({"ClockSpeed": 1e-300}, "ClockSpeed = 1e-300: should be greater than or equal to 0.001"),
    ({"SensorSeed": 10**400}, "SensorSeed = "),
    ({"Recording": {"RecordInterval": -1}}, "Recording.RecordInterval = -1"),
    ({"Wind": {"X": "strong"}}, "Wind.X = 'strong'"),
    ({"Wind": {"X": 1000}}, "Wind = {'X': 1000}: wind must be at most 100 m/s, not 1000"),
    ({"ClockSpeed": 1e6}, "ClockSpeed = 1000000.0: should be less than or equal to 100000"),
    ([1], "settings should be a mapping in braces, not list"),
    ('{"ClockSpeed": 5,}', "not JSON: "),
    ('{"ClockSpeed": NaN}', "ClockSpeed"),
    (b"[" * 100_000, "not JSON: nested too deeply"),
    (b'{"A":' * 100_000, "not JSON: nested too deeply"),
    (b"\xff\xfe{", "not JSON: "),
    (b" " * (1 << 21), "has 2,097,152 bytes, where at most 1,048,576 are read"),
    ({"Vehicles": {"A": {"Cameras": {"0": {"X": "far"}}}}}, "Vehicles.A.Cameras.0.X = 'far'"),
    ({"CameraDefaults": {"CaptureSettings": [{"FOV_Degrees": 180}]}}, "CameraDefaults.CaptureSettings.0.FOV_Degrees"),
    ({"DefaultSensors": {"L": {"SensorType": 6, "NumberOfChannels": 0}}}, "DefaultSensors.L"),
    ({"CameraDefaults": {"CaptureSettings": [{"FOV_Degrees": 1e-9}]}}, "CameraDefaults.CaptureSettings.0.FOV_Degrees"),
    ({"CameraDefaults": {"CaptureSettings": [{"ImageType": 99}]}}, "CameraDefaults.CaptureSettings.0.ImageType = 99"),
    ({"DefaultSensors": {"D": {"SensorType": 5, "MinDistance": 9, "MaxDistance": 8}}}, "MinDistance must be at most"),
    ({"DefaultSensors": {"I": {"SensorType": 2, "AngularRandomWalk": -0.3}}}, "I.AngularRandomWalk = -0.3: should be"),
    ({"DefaultSensors": {"I": {"SensorType": 2, "GyroBiasStabilityTau": 0}}}, "I.GyroBiasStabilityTau = 0: should be"),
    ({"DefaultSensors": {"L": {"SensorType": 7}}}, "DefaultSensors.L.SensorType = 7: should be one of 1, 2, 3"),
    ({"DefaultSensors": {"L": {"SensorType": "6"}}}, "DefaultSensors.L.SensorType = '6': should be one of 1, 2, 3"),
    ({"DefaultSensors": {"L": {"Range": 7}}}, "key 'DefaultSensors.L.SensorType' is missing"),
    ({"OriginGeopoint": {"Latitude": 91}}, "OriginGeopoint.Latitude = 91"),
])  # fmt: skip
def test_what_contradicts_is_refused(tmp_path: Path, content: Any, text: str) -> None:
    with pytest.raises(UserError) as caught:
        read(tmp_path, content)
    line = str(caught.value)
    assert line.startswith(f"{tmp_path / 'settings.json'}: ")
    assert text in line
    assert "\n" not in line


def test_an_interval_that_the_step_does_not_divide() -> None:
    settings = Settings.model_validate({"Recording": {"RecordInterval": 0.033}})
    with pytest.raises(UserError, match=r"Recording\.RecordInterval: 0\.033 s .* 0\.032 and 0\.034 s are"):
        settings.recorder_of(NATIVE)
    assert settings.recorder_of(AIRSIM).recorder_ticks == 12  # AirSim waits for more than the interval
