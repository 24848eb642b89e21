"""Converts latitude and longitude to NED around a home, on the WGS 84 ellipsoid.

Source: AirSim v1.8.1, EarthUtils.hpp (GeodeticToNed, GeodeticToEcef), which moveToGPS uses; in doubles here, where its
single precision resolves half a metre.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Vector
from uavaccel.sim.sensors.earth import GeoPoint

SEMI_MAJOR_M = 6378137.0
ECCENTRICITY_SQUARED = 6.69437999014e-3


def ned_of(point: GeoPoint, home: GeoPoint) -> Vector:
    """The point in metres NED from `home`."""
    x, y, z = _earth_centred(point) - _earth_centred(home)
    latitude, longitude = math.radians(home.latitude), math.radians(home.longitude)
    outwards = x * math.cos(longitude) + y * math.sin(longitude)
    north = z * math.cos(latitude) - outwards * math.sin(latitude)
    east = y * math.cos(longitude) - x * math.sin(longitude)
    up = outwards * math.cos(latitude) + z * math.sin(latitude)
    return float(north), float(east), float(-up)


def _earth_centred(point: GeoPoint) -> NDArray[np.float64]:
    latitude, longitude = math.radians(point.latitude), math.radians(point.longitude)
    curvature_m = SEMI_MAJOR_M / math.sqrt(1 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2)
    across = (curvature_m + point.altitude) * math.cos(latitude)
    along = (curvature_m * (1 - ECCENTRICITY_SQUARED) + point.altitude) * math.sin(latitude)
    return np.array([across * math.cos(longitude), across * math.sin(longitude), along])
