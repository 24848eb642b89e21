"""Scenes of shapes of every kind, most turned anyhow, as MJCF."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from uavaccel.resources import asset

KINDS = ("sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "hfield", "plane")
FIELD_M = (6.0, 5.0, 1.5, 0.5)  # half sizes, height and depth of the height field
SPREAD_M = 9.0


def clutter(seed: int, kinds: Sequence[str] = KINDS, count: int = 60, size_m: float = 1.0) -> str:
    """MJCF of `count` shapes around the start, none nearer than 2.5 m, and at most one plane and one height field."""
    random = np.random.default_rng(seed)
    spec = mujoco.MjSpec.from_file(str(asset("mjcf/quadrotor.xml")))
    spec.add_mesh(name="rock", uservert=random.normal(size=72).tolist(), scale=[0.35 * size_m] * 3)
    heights = random.random(11 * 14)
    spec.add_hfield(name="hills", size=FIELD_M, nrow=11, ncol=14, userdata=heights.tolist())
    left = list(kinds)
    for number in range(count):
        kind = left[number % len(left)]
        place = np.array([*random.uniform(-SPREAD_M, SPREAD_M, 2), random.uniform(0.5, 4.0)])
        if np.linalg.norm(place[:2]) < 2.5 + size_m:
            place[:2] *= (2.5 + size_m) / np.linalg.norm(place[:2])
        turn = random.normal(size=4)
        if number % 3 == 0:  # upright, and every other one along the axes
            turn[1:] *= (0.0, 0.0, number % 2)
        sizes = random.uniform(0.2, 1.0, 3) * size_m
        if kind in ("plane", "hfield"):
            left.remove(kind)
            place, turn, sizes = np.array([0.3, -0.2, -2.6]), np.array([1.0, 0.02, -0.03, 0.3]), np.array([0, 0, 1.0])
            place[2] += 0.6 * (kind == "hfield")
        spec.worldbody.add_geom(
            name=f"{kind}_{number}",
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
            pos=place,
            quat=turn / np.linalg.norm(turn),
            size=sizes,
            meshname="rock" if kind == "mesh" else "",
            hfieldname="hills" if kind == "hfield" else "",
            rgba=[*random.uniform(0.2, 1.0, 3), 1.0],
        )
    spec.compile()
    return spec.to_xml()
