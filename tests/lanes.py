"""What lanes over arrays must agree with: the obstacle lane in plain geometry, and environments that fly alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import mujoco
import numpy as np

from uavaccel.sim.lane.layout import HULL_RADIUS_M, LENGTH_M, WIDTH_M, LaneLayout
from uavaccel.sim.lane.scene import object_name


def free_distance_m(layout: LaneLayout, y_m: float) -> float:
    """Metres that a drone flying straight north, `y_m` east of the centre line, covers before its hull touches."""
    if abs(y_m) + HULL_RADIUS_M >= WIDTH_M / 2:
        return 0.0
    flat = np.where(layout.round, 0.0, layout.half_width_m)
    reach = HULL_RADIUS_M + layout.half_width_m - flat
    beside = np.maximum(np.abs(layout.y_m - y_m) - flat, 0.0)
    hit = beside < reach
    touch = layout.x_m - flat - np.sqrt(np.maximum(reach**2 - beside**2, 0.0))
    return float(min(touch[hit].min(initial=LENGTH_M), LENGTH_M))


def collision_object(model: mujoco.MjModel, data: mujoco.MjData) -> str:
    """Name of what the drone touches most deeply, e.g. "obstacle_07", "wall_west" or "ground"; "" for nothing."""
    drone = model.body("quadrotor").id
    deepest, name = np.inf, ""
    for contact in data.contact[: data.ncon]:
        bodies = [int(model.geom_bodyid[geom]) for geom in contact.geom]
        if drone in bodies and contact.dist < deepest:
            deepest, name = contact.dist, object_name(model, int(contact.geom[1 - bodies.index(drone)]))
    return name


def collisions_side_by_side(batch: Any, alone: Sequence[Any], seed: int, actions: Iterable[Any]) -> list[str | None]:
    """Fly a batch and single environments to the end of their games, to the same bytes; what each collided with."""
    hit: list[str | None] = []
    seen, over = batch.reset(seed=seed)[0], [False] * len(alone)
    for lane, environment in enumerate(alone):
        assert environment.reset(seed=seed + lane)[0].tobytes() == seen[lane].tobytes()
    for given in actions:
        batch.step_async(given)
        seen, rewards, terminated, truncated, infos = batch.step_wait()
        for lane, environment in enumerate(alone):
            if over[lane]:
                continue
            expected = environment.step(given[lane])
            assert infos[lane] == expected[4]
            assert seen[lane].tobytes() == expected[0].tobytes()
            assert (rewards[lane], terminated[lane], truncated[lane]) == expected[1:4]
            over[lane] = bool(expected[2] or expected[3])
            hit += [expected[4]["collision"]] * over[lane]
        if all(over):
            break
    assert all(over)
    for environment in alone:
        environment.close()
    return hit
