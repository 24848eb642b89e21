"""AirSim's sensors against formulas written here and rays whose ends are known; and the world at large."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from tests.airsim_wire import AirSimWire, xyz
from tests.scenes import Pose
from uavaccel.kinematics import Kinematics
from uavaccel.sim.earth import GeoPoint, atmosphere, geodetic, local, magnetic_field_gauss
from uavaccel.sim.poses import Pose as ScenePose
from uavaccel.sim.profile import AIRSIM, NATIVE
from uavaccel.sim.sensors import (
    Drift,
    Gps,
    GpsSettings,
    Imu,
    ImuSettings,
    LidarSettings,
    Magnetometer,
    MagnetometerSettings,
    Truth,
    directions,
)
from uavaccel.sim.world import World
from uavaccel.wire import rpc
from uavaccel.wire.api import CALLS
from uavaccel.wire.types import EPOCH_NS

HOME = GeoPoint(47.641468, -122.140165, 122.0)
QUIET = {"UncorrelatedNoiseSigma": 0.0}
LIDAR = {"SensorType": 6, "NumberOfChannels": 8, "PointsPerSecond": 8000, "Range": 60.0}
SENSORS = {
    "Imu": {"SensorType": 2},
    "Down": {"SensorType": 5, "Pitch": -90, **QUIET},
    "Ahead": {"SensorType": 5, **QUIET},
    "Off": {"SensorType": 5, "Enabled": False},
    "Lidar": LIDAR,
    "Local": LIDAR | {"DataFrame": "SensorLocalFrame", "X": 0.5, "Yaw": 90, "DrawDebugPoints": True},
    "Half": LIDAR | {"HorizontalFOVStart": -30, "HorizontalFOVEnd": 30, "VerticalFOVUpper": 0, "VerticalFOVLower": 0},
}
TILTED = Pose((2.0, -3.0, -9.0), (10.0, -15.0, 40.0))


def with_sensors(**sensors: Any) -> AirSimWire:
    return AirSimWire({"Vehicles": {"Drone": {"Sensors": sensors or SENSORS}}})


def hover_at(time_s: float, tick_s: float = 0.002, since_reset_s: float = 0.0) -> Truth:
    hover = Kinematics(round(time_s * 1e9), (0, 0, 0), (1, 0, 0, 0), *[(0.0, 0.0, 0.0)] * 4)
    return Truth(hover, tick_s, since_reset_s, HOME)


def test_a_tilted_imu_feels_the_force_along_its_own_axes() -> None:
    silent = dict.fromkeys(("AngularRandomWalk", "GyroBiasStability", "VelocityRandomWalk", "AccelBiasStability"), 0.0)
    wire = with_sensors(Imu={"SensorType": 2} | silent)
    wire.move(TILTED)
    wire.fly(0.1)
    true, told = wire.call("simGetGroundTruthKinematics", ""), wire.call("getImuData", "", "")
    w, x, y, z = true["orientation"].values()
    down = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])  # in the body's frame
    acceleration, force = (np.array(xyz(each["linear_acceleration"])) for each in (true, told))
    turned = wire.simulation.kinematics().orientation_wxyz
    assert force == pytest.approx((acceleration - [0.0, 0.0, 9.80665]) @ ScenePose((0, 0, 0), turned).matrix())
    assert down @ force == pytest.approx(acceleration[2] - 9.80665)
    assert xyz(told["angular_velocity"]) == pytest.approx(xyz(true["angular_velocity"]))


def test_a_vehicles_sensors_stand_beside_the_defaults_of_other_kinds() -> None:
    """As in AirSim; without a name the first by name is read, and one that is not enabled takes its default's place."""
    far = {"Sensors": {"Z": LIDAR | {"Range": 1.0}, "B": LIDAR, "Gone": {"SensorType": 1, "Enabled": False}}}
    wire = AirSimWire({"Vehicles": {"Drone": far}})
    assert wire.call("getImuData", "imu", "")["orientation"]["w_val"] == pytest.approx(1.0)
    assert wire.call("getGpsData", "", "")["is_valid"] is not None
    assert wire.call("getLidarData", "", "")["point_cloud"] == wire.call("getLidarData", "B", "")["point_cloud"]
    assert wire.call("getLidarData", "", "")["point_cloud"] != wire.call("getLidarData", "Z", "")["point_cloud"]
    with pytest.raises(rpc.RpcError, match="No barometer with name  exist on vehicle"):
        wire.call("getBarometerData", "", "")
    wire = AirSimWire({"DefaultSensors": {"Tilt": {"SensorType": 2}}, "Vehicles": {"Drone": far}})
    assert wire.call("getImuData", "", "") == wire.call("getImuData", "Tilt", "")
    with pytest.raises(rpc.RpcError, match="No gps with name"):
        wire.call("getGpsData", "", "")


@pytest.mark.parametrize(("kind", "number", "silent"), [
    ("Imu", 2, ("GyroBiasStability", "AccelBiasStability")),
    ("Imu", 2, ("AngularRandomWalk", "VelocityRandomWalk")),
    ("Barometer", 1, ("PressureFactorSigma",)),
    ("Barometer", 1, ("UncorrelatedNoiseSigma",)),
    ("Magnetometer", 4, ()),
    ("DistanceSensor", 5, ()),
])  # fmt: skip
def test_noise_depends_on_tick_seed_vehicle_and_sensor_alone(kind: str, number: int, silent: tuple[str, ...]) -> None:
    method, sensor = f"get{kind}Data", {"SensorType": number, **dict.fromkeys(silent, 0.0)}
    two = {"DefaultSensors": {"a": sensor, "b": sensor}, "Vehicles": {"A": {}, "B": {"Y": 20}}}

    def after_a_second(seed: int = 0, asking_before: bool = False) -> AirSimWire:
        wire = AirSimWire({"SensorSeed": seed, **two}, World("blocks", NATIVE))
        for _ in range(10):
            wire.fly(0.1)
            if asking_before:
                wire.call(method, "", "")
        return wire

    later = after_a_second()
    told, *others = (later.call(method, name, vehicle) for vehicle in "AB" for name in "ab")
    assert len({str(each) for each in (told, *others)}) == 4
    assert after_a_second(asking_before=True).call(method, "", "") == told
    assert after_a_second(seed=1).call(method, "", "") != told
    later.fly(0.002)
    assert later.call(method, "", "") != told


def test_the_air_and_the_field_are_those_of_the_place() -> None:
    """Barometer and magnetometer within their noise; AirSim's own numbers of its dipole (EarthUtils.hpp)."""
    assert magnetic_field_gauss(GeoPoint(47.637, -122.147, 622.0)) == pytest.approx(
        (0.250394, 0.0340771, 0.36567), rel=1e-5
    )
    wire = with_sensors(
        Quiet={"SensorType": 1, "PressureFactorSigma": 0.0, **QUIET},
        Field={"SensorType": 4, "NoiseSigma": 0.0, "ScaleFactor": 2.0},
    )
    wire.move(TILTED)
    altitude = 122.0 + 9.0
    told = wire.call("getBarometerData", "Quiet", "")
    geopotential = 6_378_137 * altitude / (6_378_137 + altitude)
    pressure = 101_325 * (1 - 0.0065 * geopotential / 288.15) ** 5.255877
    assert told["pressure"] == pytest.approx(pressure, rel=1e-6)
    assert told["altitude"] == pytest.approx(altitude, abs=0.5)
    assert told["qnh"] == 1013.25
    assert atmosphere(15_000.0)[:2] == pytest.approx((216.65, 12_111.0), rel=1e-3)  # US Standard Atmosphere 1976
    air = wire.call("simGetGroundTruthEnvironment", "")
    assert (air["air_pressure"], air["temperature"]) == pytest.approx((pressure, 288.15 - 0.0065 * geopotential))
    assert air["air_density"] == pytest.approx(pressure / 287.053 / air["temperature"])
    assert xyz(air["gravity"]) == [0.0, 0.0, 9.80665]
    assert xyz(air["position"]) == pytest.approx(TILTED.position_m)
    field = np.array(xyz(wire.call("getMagnetometerData", "", "Drone")["magnetic_field_body"]))
    north, east, down = TILTED.matrix() @ field
    there = np.array(magnetic_field_gauss(GeoPoint(**air["geo_point"])))
    assert (north, east, down) == pytest.approx(2.0 * there, abs=1e-6)


def test_rotors_carry_the_vehicle_and_turn_with_the_root_of_their_thrust() -> None:
    rotors = AirSimWire().call("getRotorStates", "")["rotors"]
    assert sum(rotor["thrust"] for rotor in rotors) == pytest.approx(9.80665, rel=0.02), "of 1 kg in air at sea level"
    assert [rotor["speed"] for rotor in rotors] == pytest.approx(
        [669.857 * math.sqrt(rotor["thrust"] / 4.179446268) for rotor in rotors]
    )


def test_a_gps_converges_and_is_as_late_in_velocity_as_in_place() -> None:
    home = {"Latitude": 10, "Longitude": 20, "Altitude": 300}
    sensors = {"Gps": {"SensorType": 3, "EPV_TimeConstant": 1.8, "EpvInitial": 50.0}}
    wire = AirSimWire({"OriginGeopoint": home, "Vehicles": {"Drone": {"Sensors": sensors}}})
    assert wire.call("getHomeGeoPoint", "") == {"latitude": 10.0, "longitude": 20.0, "altitude": 300.0}
    wire.call("moveByVelocity", 5.0, 0.0, 0.0, 20.0, 0, {"is_rate": True, "yaw_or_rate": 0.0}, "")
    wire.fly(0.5)
    told, true = wire.call("getGpsData", "", "")["gnss"], wire.call("simGetGroundTruthKinematics", "")
    assert told["eph"] == pytest.approx(0.1 + 99.9 * math.exp(-0.5 / 0.9))
    assert told["epv"] == pytest.approx(0.1 + 49.9 * math.exp(-0.5 / 1.8))
    velocity, acceleration = (np.array(xyz(true[f"linear_{each}"])) for each in ("velocity", "acceleration"))
    assert acceleration[0] > 1.0
    assert xyz(told["velocity"]) == pytest.approx(velocity - 0.2 * acceleration)
    place = np.array(xyz(true["position"])) - 0.2 * velocity + 0.02 * acceleration
    then = geodetic(tuple(place.tolist()), GeoPoint(10.0, 20.0, 300.0))
    assert [*told["geo_point"].values()] == pytest.approx([*then], abs=1e-9)
    assert told["time_utc"] * 1000 == wire.call("getGpsData", "", "")["time_stamp"] == EPOCH_NS + 500_000_000


def test_a_receiver_is_no_later_than_the_last_reset() -> None:
    """5 m/s north, and 1 m/s² faster each second."""
    still = (0.0, 0.0, 0.0)
    now = Kinematics(10**9, still, (1, 0, 0, 0), (5.0, 0.0, 0.0), still, (1.0, 0.0, 0.0), still)
    for since_reset_s, ago_s in ((0.0, 0.0), (0.05, 0.05), (0.3, 0.2)):
        read = Gps(GpsSettings(), 0, "gps").read(Truth(now, 0.002, since_reset_s, HOME))
        assert local(read.place, HOME)[0] == pytest.approx(-5.0 * ago_s + ago_s**2 / 2, abs=1e-6)
        assert read.velocity_m_s[0] == pytest.approx(5.0 - ago_s)


def test_a_lidar_scans_its_channels_in_its_frame() -> None:
    wire = with_sensors()
    wire.move(TILTED)
    told = wire.call("getLidarData", "Lidar", "")
    points = np.array(told["point_cloud"]).reshape(-1, 3)
    assert 300 < len(points) == len(told["segmentation"]) <= 800
    ground = np.array(told["segmentation"]) == wire.call("simGetSegmentationObjectID", "ground")
    assert ground.any()
    np.testing.assert_allclose(points[ground, 2], 0.0, atol=1e-4)
    assert (np.linalg.norm(points - TILTED.position_m, axis=1) <= 60.0).all()
    local_points = np.array(wire.call("getLidarData", "Local", "")["point_cloud"]).reshape(-1, 3)
    sensor = wire.call("getLidarData", "Local", "")["pose"]
    mount = TILTED.matrix() @ Pose((0, 0, 0), (0, 0, 90)).matrix()
    np.testing.assert_allclose(xyz(sensor["position"]), np.array(TILTED.position_m) + 0.5 * TILTED.matrix()[:, 0])
    world = local_points @ mount.T + xyz(sensor["position"])
    assert (np.abs(world[:, 2]) < 1e-4).sum() > 100
    assert wire.api.settings.without_effect() == ["Vehicles.Drone.Sensors.Local.DrawDebugPoints"]


def lidar(channels: int, points_per_s: int, **keys: float) -> LidarSettings:
    given = {"SensorType": 6, "NumberOfChannels": channels, "PointsPerSecond": points_per_s, **keys}
    return LidarSettings.model_validate(given)


CIRCLES = [(-180, 180), (0, 360), (-360, 0), (90, 90), (-90, 270)]
PARTS = [(0, 359), (-30, 30), (-180, 179), (300, 20), (-350, -10), (90, -90)]


@pytest.mark.parametrize(("first", "last"), CIRCLES + PARTS)
def test_a_lidars_rays_are_those_of_airsims_formula(first: float, last: float) -> None:
    """Every channel has the same azimuths, one after the other, channel by channel; in fractions, from 0 and later."""
    low, high = Fraction(first) % 360, Fraction(last) % 360
    for channels, points_per_s, begun in ((4, 8_000, 0), (64, 8_000, 36), (16, 10_000, 340), (32, 100_000, 36)):
        settings = lidar(channels, points_per_s, HorizontalFOVStart=first, HorizontalFOVEnd=last)
        of_one = math.floor(Fraction(points_per_s, 10 * channels) + Fraction(1, 2))
        turns = [(begun + Fraction(360, of_one) * ray) % 360 for ray in range(of_one)]
        seen = [turn for turn in turns if (low <= turn <= high if low < high else turn >= low or turn <= high)]
        assert len(seen) == of_one or (first, last) in PARTS
        rays, expected = directions(settings, begun), np.tile([float(turn) for turn in seen], channels)
        assert rays.shape == (len(expected), 3)
        yaw, down = np.degrees([np.arctan2(rays[:, 1], rays[:, 0]), np.arcsin(rays[:, 2])])
        np.testing.assert_allclose((yaw - expected + 180) % 360 - 180, 0.0, atol=1e-9)
        np.testing.assert_allclose(down, np.repeat(np.linspace(15, 45, channels), len(seen)), atol=1e-9)
        assert len(np.unique(rays.round(9), axis=0)) == len(rays), "no ray twice"


def test_a_lidar_has_a_hundred_thousand_points_at_most_and_none_without_half_a_one_for_each_channel() -> None:
    whole_circle = {"HorizontalFOVStart": 0.0, "HorizontalFOVEnd": 360.0}
    assert len(directions(lidar(10, 10**7, **whole_circle), 0.0)) == 100_000
    assert directions(lidar(64, 310), 0.0).shape == (0, 3)
    assert directions(lidar(64, 320), 0.0).shape == (64, 3)


def drift_of(wire: AirSimWire) -> float:
    true = wire.call("simGetGroundTruthEnvironment", "")["air_pressure"]
    return wire.call("getBarometerData", "", "")["pressure"] / true - 1.0


def test_a_barometer_drifts_as_airsims_gauss_markov_process() -> None:
    """Each fiftieth of a second keeps exp(-dt/tau) and gains the rest of a normal number; anew with a reset."""
    keep, sigma = math.exp(-0.02 / 2.0), 0.05
    drifting = {"PressureFactorTau": 2.0, "PressureFactorSigma": sigma, **QUIET}
    wire = with_sensors(Baro={"SensorType": 1, **drifting})
    values = [drift_of(wire)]
    for _ in range(400):
        wire.fly(0.02)
        values.append(drift_of(wire))
    gained = (np.array(values)[1:] - keep * np.array(values)[:-1]) / ((1 - keep) * sigma)
    assert values[0] == pytest.approx(0.0, abs=1e-12)
    assert gained.mean() == pytest.approx(0.0, abs=0.2)
    assert gained.std() == pytest.approx(1.0, abs=0.15)
    assert np.abs(gained).max() < 4.5, "at a whole second no more than at another"
    wire.call("reset")
    assert drift_of(wire) == pytest.approx(0.0, abs=1e-12)
    wire.fly(3.0)
    assert drift_of(wire) == pytest.approx(values[150], rel=1e-9), "whoever asked before"


def test_an_imus_biases_walk_as_far_as_their_settings_say() -> None:
    """After a second a deviation of the settings, a degree per second and 1 g, over the roots of their own times."""
    silent = {"AngularRandomWalk": 0.0, "VelocityRandomWalk": 0.0}
    taus = {"GyroBiasStabilityTau": 4.0, "AccelBiasStabilityTau": 16.0}
    settings = ImuSettings(**silent, **taus, GyroBiasStability=3600.0, AccelBiasStability=1e6)
    read = [Imu(settings, seed, "imu").read(hover_at(1.0, since_reset_s=1.0)) for seed in range(400)]
    rate, force = (np.array(each) for each in zip(*read, strict=True))
    np.testing.assert_allclose(rate.std(axis=0), math.radians(0.5), rtol=0.12)
    np.testing.assert_allclose((force + np.array([0.0, 0.0, 9.80665])).std(axis=0), 9.80665 / 4, rtol=0.12)


def test_an_imus_biases_walk_in_small_steps() -> None:
    """In fiftieths of a second, as far in the root of the time as AirSim's."""
    walk = Drift(3, "imu rate", 3, 1.0, 0.02**0.5)
    steps = np.diff([walk.at(step / 50) for step in range(5001)], axis=0)
    assert (steps != 0.0).all()
    np.testing.assert_allclose(steps.std(axis=0), 0.02**0.5, rtol=0.05)
    assert walk.at(70.011).tolist() == Drift(3, "imu rate", 3, 1.0, 0.02**0.5).at(70.0).tolist()


def test_wind_acts_at_the_next_tick_as_in_airsims_physics() -> None:
    """FastPhysicsEngine beside it, 10 m/s from rest at 3 ms: half a kick at the first tick, the way from the next."""
    world = World("blocks", AIRSIM)
    world.advance(4)
    world.set_wind((10.0, 0.0, 0.0))
    for speed, gained, way in ((9.76691e-4, 0.651114, 0.0), (2.929692e-3, 0.650859, 5.860272e-6)):
        world.advance(1)
        now = world.lead.kinematics()
        assert now.linear_velocity_m_s[0] == pytest.approx(speed, rel=1e-4)
        assert now.linear_acceleration_m_s2[0] == pytest.approx(gained, rel=1e-4)
        assert now.position_m[0] == pytest.approx(way, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize("server", ["one", "another"])
def test_what_has_no_effect_and_what_is_refused_is_said_once(server: str) -> None:
    wire = AirSimWire()
    accepted = [name for name, call in CALLS.items() if call.status == "accepted"]
    assert len(accepted) == 16
    answers = {"simSwapTextures": [], "simSetLightIntensity": True, "simRunConsoleCommand": True}
    for name in accepted:
        for _ in range(2):
            assert wire.call(name, 1, 2, 3) == answers.get(name)
    assert wire.said == [f"{name}: accepted, without effect" for name in accepted]
    refused = {name: call.status for name, call in CALLS.items() if call.status.startswith("refused: ")}
    assert len(refused) == 20
    for name, status in refused.items():
        with pytest.raises(rpc.RpcError, match=f"{name} is not available: {status.removeprefix('refused: ')}"):
            wire.call(name, "")
    assert len(wire.said) == len(accepted) + len(refused)
    assert wire.call("simLoadLevel", "Blocks")


def test_magnetometers_of_one_vehicle_have_biases_of_their_own() -> None:
    biased = {"SensorType": 4, "NoiseSigma": 0.0, "NoiseBias": 0.3}
    wire = with_sensors(Bow=biased, Tail=biased, Mast=biased)
    read = {name: xyz(wire.call("getMagnetometerData", name, "")["magnetic_field_body"]) for name in ("Tail", "Mast")}
    assert all(0.0 < abs(tail - mast) <= 0.6 for tail, mast in zip(read["Tail"], read["Mast"], strict=True))


def test_a_magnetometers_bias_is_uniform_within_its_bound() -> None:
    keys = {"NoiseSigma": 0.0, "ScaleFactor": 3.0, "NoiseBias": 0.3}
    read = [Magnetometer(MagnetometerSettings(**keys), seed, "field").read(hover_at(0.0)) for seed in range(400)]
    bias = np.array(read) - 3.0 * np.array(magnetic_field_gauss(HOME))
    assert (np.abs(bias) <= 0.3).all()
    np.testing.assert_allclose(bias.mean(axis=0), 0.0, atol=0.03)
    np.testing.assert_allclose(bias.std(axis=0), 0.3 / math.sqrt(3), rtol=0.1)


def test_noise_has_the_size_of_its_setting() -> None:
    """Each by itself: pascals, gauss and metres; the others are switched off."""
    wire = with_sensors(
        Air={"SensorType": 1, "PressureFactorSigma": 0.0, "UncorrelatedNoiseSigma": 50.0},
        Field={"SensorType": 4, "NoiseSigma": 0.02},
        Down={"SensorType": 5, "Pitch": -90, "UncorrelatedNoiseSigma": 0.5},
    )
    pressure = wire.call("simGetGroundTruthEnvironment", "")["air_pressure"]
    field = np.array(magnetic_field_gauss(GeoPoint(**wire.call("simGetGroundTruthEnvironment", "")["geo_point"])))
    errors: list[list[float]] = []
    for _ in range(150):
        wire.fly(0.002)
        air, magnet = wire.call("getBarometerData", "", ""), wire.call("getMagnetometerData", "", "")
        distance = wire.call("getDistanceSensorData", "", "")["distance"]
        turned = np.array(xyz(magnet["magnetic_field_body"])) - field
        errors.append([air["pressure"] - pressure, *turned, distance - 10.0])
    sizes = np.array([50.0, 0.02, 0.02, 0.02, 0.5])
    np.testing.assert_allclose(np.std(errors, axis=0), sizes, rtol=0.2)
    np.testing.assert_allclose(np.mean(errors, axis=0) / sizes, 0.0, atol=0.3)


@pytest.mark.parametrize("tick_s", [0.001, 0.002, 0.003])
def test_an_imus_white_noise_is_greater_at_a_shorter_step(tick_s: float) -> None:
    """Settings of 6 degrees per root hour, 0.1 per root second, and of 1 g per root hertz, over the step's root."""
    settings = ImuSettings(
        AngularRandomWalk=6.0, VelocityRandomWalk=1000.0, GyroBiasStability=0.0, AccelBiasStability=0.0
    )
    imu = Imu(settings, 0, "imu")
    read = [imu.read(hover_at(number * tick_s, tick_s)) for number in range(1000)]
    rate, force = (np.array(each) for each in zip(*read, strict=True))
    np.testing.assert_allclose(rate.std(axis=0), math.radians(0.1) / tick_s**0.5, rtol=0.1)
    np.testing.assert_allclose(force.std(axis=0), 9.80665 / tick_s**0.5, rtol=0.1)
    correlations = np.corrcoef(np.hstack([rate, force]).T)
    np.testing.assert_allclose(correlations, np.eye(6), atol=0.15, err_msg="each axis has noise of its own")


def test_a_fix_follows_from_the_horizontal_dilution_alone() -> None:
    """Halved each second, after ten: 3 m for a fix in space, 4 m for one in the plane, whatever the vertical one is."""
    halving = {"EPH_TimeConstant": 1 / math.log(2), "EPV_TimeConstant": 1 / math.log(2), "EphFinal": 0, "EpvFinal": 0}
    for eph_m, epv_m, fix in ((64, 0, 0), (4.1, 0.6, 0), (3.9, 0.6, 2), (3.9, 64, 2), (3.1, 0.6, 2), (2.9, 64, 3)):
        settings = GpsSettings(**halving, EphInitial=eph_m * 2**10, EpvInitial=epv_m * 2**10)
        read = Gps(settings, 0, "gps").read(hover_at(30.0, since_reset_s=10.0))
        assert (read.eph_m, read.epv_m) == pytest.approx((eph_m, epv_m))
        assert read.fix == fix


@pytest.mark.parametrize(("seconds", "first_deg"), [(0.0, 0), (0.1, 72), (0.19, 72), (0.3, 216), (0.5, 0), (0.7, 144)])
def test_a_slow_lidar_goes_on_where_its_last_scan_ended(seconds: float, first_deg: float) -> None:
    """Two turns and ten scans a second, each of a fifth of a circle: 200 rays of 0.36 degrees in a channel."""
    keys = {"RotationsPerSecond": 2, "PointsPerSecond": 4000, "NumberOfChannels": 2, "HorizontalFOVEnd": 360}
    wire = with_sensors(Slow=LIDAR | keys | {"DataFrame": "SensorLocalFrame"})
    wire.fly(seconds)
    wire.call("reset")  # which does not turn it back
    points = np.array(wire.call("getLidarData", "Slow", "")["point_cloud"]).reshape(-1, 3)
    bearing = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    expected = np.tile(first_deg + 0.36 * np.arange(200), 2)
    np.testing.assert_allclose((bearing - expected + 180) % 360 - 180, 0.0, atol=1e-3)
