"""Limits of positions, winds and names in a world, beyond which they raise UserError."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping

from uavaccel.errors import UserError
from uavaccel.kinematics import Vector

HIGHEST_M = 20_000.0  # above the sea, up to which air_density follows the standard atmosphere
FARTHEST_M = 10_000.0  # north or east: farther away the physics loses its millimetres
STRONGEST_WIND_M_S = 100.0  # in a storm of 1 000 m/s a tick's drag exceeds the speed that it brakes
DEEPEST_M = 0.05  # of penetration; contacts would throw a vehicle that is placed deeper
LONGEST_NAME = 256
APART_M = 0.75  # between the middles of two vehicles, so that they do not touch


def check_bounds(position_m: Vector, ground_altitude_m: float, anywhere: bool = False) -> None:
    """Raise UserError for an NED position that is too high, too far away or, unless `anywhere`, below the ground."""
    x_m, y_m, z_m = position_m
    top_m = ground_altitude_m - HIGHEST_M
    if not top_m <= z_m <= (FARTHEST_M if anywhere else 0.0):
        raise UserError(f"position: NED z has to be from {top_m:g} (thin air) to 0 m (the ground), not {z_m:g}")
    if not max(abs(x_m), abs(y_m)) <= FARTHEST_M:
        raise UserError(f"position: north and east have to be within {FARTHEST_M:g} m, not {x_m:g} and {y_m:g} m")


def check_wind(wind_m_s: Vector) -> None:
    """Raise UserError for a wind above STRONGEST_WIND_M_S, or one that is not finite."""
    if not math.hypot(*wind_m_s) <= STRONGEST_WIND_M_S:
        raise UserError(f"wind: {wind_m_s} m/s is not a wind of at most {STRONGEST_WIND_M_S:g} m/s")


def check_name(name: str, taken: Container[str] = (), kind: str = "a vehicle") -> None:
    """Raise UserError for a name that is taken, or that is not possible in a model, a file name or a line of text."""
    if name in taken or "/" in name or not name.isprintable() or not 0 < len(name) <= LONGEST_NAME:
        raise UserError(
            f"{kind} cannot be called {name[:LONGEST_NAME]!r}: names differ, hold no / and nothing unprintable, "
            f"and have at most {LONGEST_NAME} characters"
        )


def check_apart(name: str, position_m: Vector, places: Mapping[str, Vector]) -> None:
    """Raise UserError for a position too close to another vehicle's; `places` are positions by name."""
    for other, place_m in places.items():
        if math.dist(position_m, place_m) < APART_M:
            raise UserError(f"{name} would start less than {APART_M:g} m from {other}")
