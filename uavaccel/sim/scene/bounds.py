"""What a world bears: places, winds and names beyond these are refused in one line."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping

from uavaccel.errors import UserError
from uavaccel.kinematics import Vector

HIGHEST_M = 20_000.0  # over the sea, as high as air_density follows the standard atmosphere
FARTHEST_M = 10_000.0  # north or east: farther away the physics loses its millimetres
STRONGEST_WIND_M_S = 100.0  # in a storm of 1 000 m/s a tick's drag exceeds the speed that it brakes
DEEPEST_M = 0.05  # into what a vehicle is placed on; from deeper contacts would throw it
LONGEST_NAME = 256
APART_M = 0.75  # between the middles of two vehicles, so that they do not touch


def check_bounds(position_m: Vector, ground_altitude_m: float, anywhere: bool = False) -> None:
    """Raise UserError for an NED place in no air, too far away, or, unless it may be `anywhere`, below the ground."""
    x_m, y_m, z_m = position_m
    top_m = ground_altitude_m - HIGHEST_M
    if not top_m <= z_m <= (FARTHEST_M if anywhere else 0.0):
        raise UserError(
            f"position: NED z has to be from {top_m:g} (thin air) to 0 m (the ground), not {z_m:g}"
        )
    if not max(abs(x_m), abs(y_m)) <= FARTHEST_M:
        raise UserError(
            f"position: north and east have to be within {FARTHEST_M:g} m, not {x_m:g} and {y_m:g} m"
        )


def check_wind(wind_m_s: Vector) -> None:
    """Raise UserError for a wind that is none."""
    if not math.hypot(*wind_m_s) <= STRONGEST_WIND_M_S:
        raise UserError(f"wind: {wind_m_s} m/s is not a wind of at most {STRONGEST_WIND_M_S:g} m/s")


def check_name(name: str, taken: Container[str] = (), kind: str = "a vehicle") -> None:
    """Raise UserError for a name that is taken, or that a model, a file's name or a line of text cannot hold."""
    if name in taken or "/" in name or not name.isprintable() or not 0 < len(name) <= LONGEST_NAME:
        raise UserError(
            f"{kind} cannot be called {name[:LONGEST_NAME]!r}: names differ, hold no / and nothing unprintable, "
            f"and have at most {LONGEST_NAME} characters"
        )


def check_apart(name: str, position_m: Vector, places: Mapping[str, Vector]) -> None:
    """Raise UserError for a place where another vehicle is; `places` by their names."""
    for other, place_m in places.items():
        if math.dist(position_m, place_m) < APART_M:
            raise UserError(f"{name} would start less than {APART_M:g} m from {other}")
