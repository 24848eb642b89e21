"""The trajectory of a flight: samples at a fixed simulated interval, as arrays and as a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavaccel.files import read_arrays, replacing, write_arrays
from uavaccel.kinematics import Kinematics
from uavaccel.units import NS_PER_S

FILE_NAME, TABLE_NAME = "trajectory.npz", "trajectory.csv"
INTERVAL_NS = 50_000_000
COLUMNS = "time_s,north_m,east_m,down_m,q_w,q_x,q_y,q_z,v_north_m_s,v_east_m_s,v_down_m_s"


class Trajectory:
    """The samples of one vehicle in the order of their times."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, ...]] = []
        self._time_ns: list[int] = []

    def add(self, state: Kinematics) -> None:
        self._time_ns.append(state.time_ns)
        self._rows.append((*state.position_m, *state.orientation_wxyz, *state.linear_velocity_m_s))

    def write(self, folder: Path) -> None:
        """Write time_ns (n,), position_m (n, 3) NED, orientation_wxyz (n, 4) and velocity_m_s (n, 3), also as CSV."""
        rows = np.array(self._rows, np.float64).reshape(-1, 10)
        write_trajectory(folder, np.array(self._time_ns, np.int64), rows)


def write_trajectory(folder: Path, time_ns: NDArray[np.int64], rows: NDArray[np.float64]) -> None:
    """Write a trajectory's files; `rows` (n, 10) are position, orientation wxyz and velocity."""
    arrays = {"time_ns": time_ns, "position_m": rows[:, :3], "orientation_wxyz": rows[:, 3:7]}
    write_arrays(folder / FILE_NAME, arrays | {"velocity_m_s": rows[:, 7:]})
    table = np.column_stack([time_ns / NS_PER_S, rows])
    with replacing(folder / TABLE_NAME) as file:
        np.savetxt(file, table, "%.9g", ",", header=COLUMNS, comments="")


def largest_difference_m(folder: Path, reference: Path) -> float:
    """Return the largest distance between two flights' positions at equal simulated times."""
    one, other = _positions(folder), _positions(reference)
    shared = np.intersect1d(one[0], other[0], return_indices=True)
    if not len(shared[0]):
        return 0.0
    return float(np.linalg.norm(one[1][shared[1]] - other[1][shared[2]], axis=1).max())


def equal(folder: Path, reference: Path) -> bool:
    """Return whether two flights' samples are the same bytes."""
    return (folder / FILE_NAME).read_bytes() == (reference / FILE_NAME).read_bytes()


def _positions(folder: Path) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    arrays = read_arrays(folder / FILE_NAME)
    return arrays["time_ns"], arrays["position_m"]
