"""The MJCF model of a scene, with one quadrotor or several."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from uavaccel.resources import asset

QUADROTOR = "quadrotor"
DRONE_GROUP = 1  # of quadrotor.xml's visible geoms, which a camera that it carries leaves out
OTHERS_GROUP = 2  # those of the others, which it sees


def load_scene(scene: str, others: Sequence[str] = ()) -> mujoco.MjModel:
    """A scene of assets/mjcf with its quadrotor, and one more for each prefix, whose names begin with it.

    Raises UserError for an unknown scene.
    """
    path = str(asset(f"mjcf/{scene}.xml"))
    if not others:
        return mujoco.MjModel.from_xml_path(path)
    spec = mujoco.MjSpec.from_file(path)
    attach_quadrotors(spec, others)
    return spec.compile()


def attach_quadrotors(spec: mujoco.MjSpec, prefixes: Sequence[str]) -> None:
    """One quadrotor more for each prefix, whose names begin with it; what there was keeps its numbers."""
    for prefix in prefixes:
        quadrotor = mujoco.MjSpec.from_file(str(asset(f"mjcf/{QUADROTOR}.xml")))
        for geom in quadrotor.geoms:
            geom.group = OTHERS_GROUP if geom.group == DRONE_GROUP else geom.group
        spec.attach(quadrotor, frame=spec.worldbody.add_frame(), prefix=prefix)
