"""Messages that Foxglove knows by their schema's name, as JSON, and three of this project's own.

Foxglove's schemas are published at docs.foxglove.dev, "Message schemas". Frames: `ned` is the simulator's world, x
north, y east, z down; `drone` its body, x forward, y right, z down; `front_center` the camera's optical frame, x right,
y down, z along the view. `enu`, x east, y north, z up, is the same world the right way up for a 3D panel.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.mounted import FRONT_CENTER
from uavaccel.units import NS_PER_S

WORLD, UPRIGHT, BODY, CAMERA = "ned", "enu", "drone", "front_center"
FRAMES = (
    "enu: x east, y north, z up; ned: x north, y east, z down; drone: x forward, y right, z down; "
    "front_center: x right, y down, z forward; orientations turn the body into the world"
)
HALF = math.sqrt(0.5)
NED_IN_ENU = (0.0, HALF, HALF, 0.0)  # w, x, y, z: half a turn about the diagonal of east and north
OPTICAL_IN_BODY = (0.5, 0.5, 0.5, 0.5)  # its x is the body's y, its y the body's z, its z the body's x
INFO, WARNING = 2, 3  # foxglove.LogLevel

Json = dict[str, object]


def _record(title: str, **properties: object) -> Json:
    return {"title": title, "type": "object", "properties": properties}


_TEXT, _NUMBER, _INTEGER = {"type": "string"}, {"type": "number"}, {"type": "integer"}
_BYTES = {"type": "string", "contentEncoding": "base64"}
_TIME = _record("time", sec=_INTEGER, nsec=_INTEGER)
_VECTOR = _record("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _record("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_TRANSFORM = _record(
    "foxglove.FrameTransform",
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)
_POSE = _record("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
SCHEMAS: dict[str, Json] = {
    each["title"]: each  # type: ignore[misc]
    for each in (
        _record("foxglove.FrameTransforms", transforms={"type": "array", "items": _TRANSFORM}),
        _record("foxglove.PoseInFrame", timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
        _record("foxglove.CompressedImage", timestamp=_TIME, frame_id=_TEXT, data=_BYTES, format=_TEXT),
        _record("foxglove.Log", timestamp=_TIME, level=_INTEGER, message=_TEXT, name=_TEXT, file=_TEXT, line=_INTEGER),
        _record("uavaccel.VelocityCommand", timestamp=_TIME, frame_id=_TEXT, velocity_m_s=_VECTOR),
        _record("uavaccel.Velocity", timestamp=_TIME, frame_id=_TEXT, velocity_m_s=_VECTOR),
        {
            **_record(
                "uavaccel.Events",
                timestamp=_TIME,
                frame_id=_TEXT,
                width=_INTEGER,
                height=_INTEGER,
                count=_INTEGER,
                x=_BYTES,
                y=_BYTES,
                t=_BYTES,
                p=_BYTES,
            ),
            "description": "Events by column, sorted by time, little-endian: x, y uint16 pixels from the left and the "
            "top; t uint32 microseconds since the game's start; p uint8, 1 ON, 0 OFF.",
        },
    )
}


def stamp(time_ns: int) -> Json:
    """Return a time as Foxglove's messages have it."""
    seconds, nanoseconds = divmod(time_ns, NS_PER_S)
    return {"sec": seconds, "nsec": nanoseconds}


def _vector(values: Sequence[float]) -> Json:
    return dict(zip("xyz", map(float, values), strict=True))


def _quaternion(wxyz: Sequence[float]) -> Json:
    return dict(zip("wxyz", map(float, wxyz), strict=True))


def _transform(time_ns: int, parent: str, child: str, position_m: Sequence[float], wxyz: Sequence[float]) -> Json:
    return {
        "timestamp": stamp(time_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": _vector(position_m),
        "rotation": _quaternion(wxyz),
    }


def transforms(time_ns: int, position_m: Sequence[float], wxyz: Sequence[float]) -> Json:
    """Return all frames, the fixed ones too: whoever jumps to a moment is given the last message of a topic alone."""
    fixed = (
        _transform(time_ns, UPRIGHT, WORLD, (0.0, 0.0, 0.0), NED_IN_ENU),
        _transform(time_ns, BODY, CAMERA, FRONT_CENTER.position_m, OPTICAL_IN_BODY),
    )
    return {"transforms": [*fixed, _transform(time_ns, WORLD, BODY, position_m, wxyz)]}


def pose(time_ns: int, position_m: Sequence[float], wxyz: Sequence[float]) -> Json:
    """Return the drone's, in `ned`."""
    inner = {"position": _vector(position_m), "orientation": _quaternion(wxyz)}
    return {"timestamp": stamp(time_ns), "frame_id": WORLD, "pose": inner}


def velocity(time_ns: int, velocity_m_s: Sequence[float]) -> Json:
    """Return a velocity, flown or asked for, in `ned`."""
    return {"timestamp": stamp(time_ns), "frame_id": WORLD, "velocity_m_s": _vector(velocity_m_s)}


def image(time_ns: int, picture: NDArray[np.uint8]) -> Json:
    """Return a picture, gray or BGR, as PNG."""
    _, png = cv2.imencode(".png", picture)
    data = base64.b64encode(png.tobytes()).decode()
    return {"timestamp": stamp(time_ns), "frame_id": CAMERA, "data": data, "format": "png"}


def events(time_ns: int, rows: NDArray[np.floating], height: int, width: int) -> Json:
    """Return events, rows (n, 4) of t in s, x, y, p = 1 or -1, by column; those of one microsecond keep their order."""
    t_us = np.rint(rows[:, 0].astype(np.float64) * 1e6).astype("<u4")
    order = np.argsort(t_us, kind="stable")
    x, y = rows[order, 1:3].astype("<u2").T
    packed = {"t": t_us[order], "x": x, "y": y, "p": (rows[order, 3] > 0).astype(np.uint8)}
    columns = {name: base64.b64encode(values.tobytes()).decode() for name, values in packed.items()}
    size = {"height": height, "width": width, "count": len(rows)}
    return {"timestamp": stamp(time_ns), "frame_id": CAMERA, **size, **columns}


def log(time_ns: int, level: int, message: str) -> Json:
    """Return a line of the log panel."""
    said = {"level": level, "message": message, "name": "uavaccel", "file": "", "line": 0}
    return {"timestamp": stamp(time_ns), **said}
