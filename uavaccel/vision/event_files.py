"""Event files for other programs: HDF5 in DSEC's layout, and a plain .npz.

DSEC (Gehrig et al., RA-L 2021): `events/x`, `events/y` uint16, `events/p` uint8 (1 ON, 0 OFF), `events/t` uint32, and
`ms_to_idx` uint64, `t_offset` int64; an event's time is t + t_offset in microseconds, and ms_to_idx[m] the index of the
first event at m milliseconds or later, counted without the offset. `width` and `height` are attributes of ours.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.files import replacing, write_arrays

US_PER_S, US_PER_MS = 1_000_000, 1_000
FORMATS = (".h5", ".npz")


class EventColumns(NamedTuple):
    """Columns of events, sorted by time: microseconds, pixels from the left and from the top, 1 for ON, 0 for OFF."""

    t: NDArray[np.uint32]
    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    p: NDArray[np.uint8]


def columns_of(events: NDArray[np.floating]) -> EventColumns:
    """Convert rows (n, 4), t in s, x, y, p = 1 or -1; events of one microsecond keep their order."""
    t_us = np.rint(events[:, 0].astype(np.float64) * US_PER_S).astype(np.uint32)
    rows = events[np.argsort(t_us, kind="stable")]
    pixels = rows[:, 1:3].astype(np.uint16)
    return EventColumns(np.sort(t_us), pixels[:, 0], pixels[:, 1], (rows[:, 3] > 0).astype(np.uint8))


def check_format(path: Path) -> None:
    """Raise UserError unless the file's suffix is one of FORMATS."""
    if path.suffix not in FORMATS:
        raise UserError(f"{path}: events are written as {' or '.join(FORMATS)}")


def write_events(path: Path, events: NDArray[np.floating], height: int, width: int) -> Path:
    """Write rows (n, 4) in the format of the file's suffix, .h5 or .npz. Raises UserError for others."""
    check_format(path)
    columns = columns_of(events)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npz":
        size = {"height": np.array(height), "width": np.array(width)}
        write_arrays(path, {**columns._asdict(), **size})
    else:
        _write_dsec(path, columns, height, width)
    return path


def _write_dsec(path: Path, columns: EventColumns, height: int, width: int) -> None:
    import h5py  # slow to load

    packed: dict[str, str | bool] = {"compression": "gzip", "shuffle": True} if len(columns.t) else {}
    with replacing(path) as file, h5py.File(file, "w") as events:
        for name, values in columns._asdict().items():
            events.create_dataset(f"events/{name}", data=values, **packed)
        events["ms_to_idx"] = first_of_each_ms(columns.t)
        events["t_offset"] = np.int64(0)
        events.attrs.update(height=height, width=width)


def first_of_each_ms(t_us: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """Return, for each whole millisecond up to the last event, the index of the first event at that time or later."""
    last_ms = int(t_us[-1]) // US_PER_MS if len(t_us) else 0
    return np.searchsorted(t_us, np.arange(last_ms + 1) * US_PER_MS).astype(np.uint64)
