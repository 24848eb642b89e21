"""AirSim's models of the Earth: geographic coordinates on a sphere and on an ellipsoid, atmosphere, magnetic dipole.

Source: AirSim v1.8.1, EarthUtils.hpp, GeodeticConverter.hpp, Environment.hpp.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Vector
from uavaccel.sim.poses import HERE

RADIUS_M = 6_378_137.0
ECCENTRICITY_SQUARED = 6.69437999014e-3  # of WGS 84
SEA_LEVEL_PA = 101_325.0
GAS_CONSTANT = 287.053  # J/(kg K), of air
GRAVITY_M_S2 = 9.80665
POLE_LATITUDE, POLE_LONGITUDE = math.radians(80.31), math.radians(-72.62)  # of the geomagnetic north
MEAN_FIELD_GAUSS = 0.312


class GeoPoint(NamedTuple):
    """Latitude and longitude in degrees, altitude in metres above the sea."""

    latitude: float
    longitude: float
    altitude: float


class Atmosphere(NamedTuple):
    """State of the air: kelvin, pascals, kg/m³."""

    temperature_k: float
    pressure_pa: float
    density: float


def geographic(position_m: Vector, home: GeoPoint) -> GeoPoint:
    """Convert an NED position relative to `home`, along the great circle that leaves it (nedToGeodetic)."""
    north, east, down = position_m
    arc = math.hypot(north, east) / RADIUS_M
    if arc < 1e-12:
        return GeoPoint(home.latitude, home.longitude, home.altitude - down)
    bearing, latitude = math.atan2(east, north), math.radians(home.latitude)
    there = math.asin(math.cos(arc) * math.sin(latitude) + math.sin(arc) * math.cos(latitude) * math.cos(bearing))
    turned = math.atan2(
        math.sin(bearing) * math.sin(arc),
        math.cos(latitude) * math.cos(arc) - math.sin(latitude) * math.sin(arc) * math.cos(bearing),
    )
    return GeoPoint(math.degrees(there), home.longitude + math.degrees(turned), home.altitude - down)


def geodetic(position_m: Vector, home: GeoPoint, origin_m: Vector = HERE) -> GeoPoint:
    """Convert an NED position relative to `home` to the WGS 84 ellipsoid, as Environment does for a vehicle.

    Its plane touches the ellipsoid at the vehicle's own home: at `origin_m`, NED from `home`.
    """
    own = geographic(origin_m, home)
    north, east, down = (metres - begun for metres, begun in zip(position_m, origin_m, strict=True))
    x, y, z = (_earth_centred(own) + (north, east, -down) @ _axes(own)).tolist()
    across, latitude = math.hypot(x, y), math.radians(own.latitude)
    for _ in range(8):  # each leaves less than a hundredth of the error
        latitude = math.atan2(z + ECCENTRICITY_SQUARED * _curvature_m(latitude) * math.sin(latitude), across)
    altitude = across * math.cos(latitude) + z * math.sin(latitude) - RADIUS_M**2 / _curvature_m(latitude)
    return GeoPoint(math.degrees(latitude), math.degrees(math.atan2(y, x)), altitude)


def local(point: GeoPoint, home: GeoPoint) -> Vector:
    """Convert a point to an NED position relative to `home`: the inverse of `geodetic` (geodetic2Ned)."""
    north, east, up = (_axes(home) @ (_earth_centred(point) - _earth_centred(home))).tolist()
    return north, east, -up


def ned_of(point: GeoPoint, home: GeoPoint) -> Vector:
    """Return the point in metres NED from `home` on the WGS 84 ellipsoid, as moveToGPS takes it (GeodeticToNed).

    In AirSim's single precision, whose Earth-centred coordinates resolve half a metre.
    """
    axes = _axes(home).astype(np.float32)
    asked = GeoPoint(*(float(np.float32(number)) for number in point))
    here = home._replace(altitude=float(np.float32(home.altitude)))
    parts = axes * (_earth_centred(asked).astype(np.float32) - _earth_centred(here).astype(np.float32))
    north, east, up = (parts[:, 0] + parts[:, 1] + parts[:, 2]).tolist()
    return north, east, -up


def _axes(home: GeoPoint) -> NDArray[np.float64]:
    """Return north, east and up at a place, a row each, in the Earth's axes."""
    latitude, longitude = math.radians(home.latitude), math.radians(home.longitude)
    level, rise = math.cos(latitude), math.sin(latitude)
    ahead, aside = math.cos(longitude), math.sin(longitude)
    return np.array([(-rise * ahead, -rise * aside, level), (-aside, ahead, 0.0), (level * ahead, level * aside, rise)])


def _curvature_m(latitude: float) -> float:
    """Return the ellipsoid's radius of curvature across the meridian at a latitude in radians."""
    return RADIUS_M / math.sqrt(1 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)


def _earth_centred(point: GeoPoint) -> NDArray[np.float64]:
    latitude, longitude = math.radians(point.latitude), math.radians(point.longitude)
    curvature_m = _curvature_m(latitude)
    across = (curvature_m + point.altitude) * math.cos(latitude)
    along = (curvature_m * (1 - ECCENTRICITY_SQUARED) + point.altitude) * math.sin(latitude)
    return np.array([across * math.cos(longitude), across * math.sin(longitude), along])


def atmosphere(altitude_m: float) -> Atmosphere:
    """Return the standard atmosphere, up to 20 km (getStandardTemperature, getStandardPressure)."""
    height_km = RADIUS_M * altitude_m / (RADIUS_M + altitude_m) / 1000
    if height_km <= 11:
        temperature = 288.15 - 6.5 * height_km
        pressure = SEA_LEVEL_PA * (288.15 / temperature) ** -5.255877
    else:
        temperature = 216.65
        pressure = 22632.06 * math.exp(-0.1577 * (height_km - 11))
    return Atmosphere(temperature, pressure, pressure / GAS_CONSTANT / temperature)


def pressure_altitude_m(pressure_pa: float) -> float:
    """Return the altitude that a barometric altimeter shows (BarometerSimple.hpp)."""
    return float(1 - (pressure_pa / SEA_LEVEL_PA) ** 0.190284) * 145366.45 * 0.3048


def magnetic_field_gauss(point: GeoPoint) -> Vector:
    """Return the dipole's field, NED (getMagField, whose pole has latitude and colatitude exchanged)."""
    latitude, longitude = math.radians(point.latitude), math.radians(point.longitude)
    turned = longitude - POLE_LONGITUDE
    colatitude = math.acos(
        math.cos(latitude) * math.cos(POLE_LATITUDE) + math.sin(latitude) * math.sin(POLE_LATITUDE) * math.cos(turned)
    )
    strength = MEAN_FIELD_GAUSS * (RADIUS_M / (RADIUS_M + point.altitude)) ** 3
    strength *= math.sqrt(1 + 3 * math.cos(colatitude) ** 2)
    nearer = math.cos(colatitude) > math.sin(POLE_LATITUDE) * math.sin(latitude)
    share = (math.sin(turned) if nearer else math.cos(turned)) * math.cos(POLE_LATITUDE) / math.sin(colatitude)
    declination, inclination = math.asin(share), math.atan(2 / math.tan(colatitude))
    level = strength * math.cos(inclination)
    return level * math.cos(declination), level * math.sin(declination), strength * math.sin(inclination)
