"""The MJCF model of a scene, with one quadrotor or several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco

from uavaccel.errors import UserError
from uavaccel.resources import asset
from uavaccel.sim.lane.layout import PLAIN
from uavaccel.sim.scene.furnished import furnished_model, furnished_spec, put_spares_by

QUADROTOR = "quadrotor"
DRONE_GROUP = 1  # of quadrotor.xml's visible geoms, which a camera that it carries leaves out
OTHERS_GROUP = 2  # those of the others, which it sees


def scene_path(scene: str, scenery: str = PLAIN) -> Path:
    """The file of a scene in a scenery. Raises UserError where there is none."""
    plain = asset(f"mjcf/{scene}.xml")
    path = plain if scenery == PLAIN else plain.parent / scenery / plain.name
    if not path.is_file():
        raise UserError(f"scenery = {scenery}: the scene {scene} has none of that name")
    return path


def load_scene(
    scene: str, others: Sequence[str] = (), furnished: bool = False, scenery: str = PLAIN
) -> mujoco.MjModel:
    """A scene of assets/mjcf with its quadrotor, and one more for each prefix, whose names begin with it.

    `furnished` for AirSim's clients (uavaccel.sim.scene.furnished). Raises UserError for an unknown scene.
    """
    path = scene_path(scene, scenery)
    if not others:
        return furnished_model(path) if furnished else mujoco.MjModel.from_xml_path(str(path))
    spec = furnished_spec(path) if furnished else mujoco.MjSpec.from_file(str(path))
    attach_quadrotors(spec, others)
    model = spec.compile()
    if furnished:
        put_spares_by(model)
    return model


def attach_quadrotors(spec: mujoco.MjSpec, prefixes: Sequence[str]) -> None:
    """One quadrotor more for each prefix, whose names begin with it; what there was keeps its numbers."""
    for prefix in prefixes:
        quadrotor = mujoco.MjSpec.from_file(str(asset(f"mjcf/{QUADROTOR}.xml")))
        for geom in quadrotor.geoms:
            geom.group = OTHERS_GROUP if geom.group == DRONE_GROUP else geom.group
        spec.attach(quadrotor, frame=spec.worldbody.add_frame(), prefix=prefix)
