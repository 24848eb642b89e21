"""A user-defined lane, as YAML or a mapping:

obstacles:
  - {x_m: 12, y_m: 0.5, half_side_m: 0.4}               # a square post
  - {x_m: 20, y_m: -2, radius_m: 0.6, texture: yellow}  # a cylinder
light: 0.8
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from uavaccel.config import Config, load_yaml, validate
from uavaccel.limits import Seed, Share
from uavaccel.sim.lane.layout import (
    GROUND_TEXTURES,
    HULL_RADIUS_M,
    LENGTH_M,
    MAX_OBSTACLES,
    OBSTACLE_TEXTURES,
    WALL_TEXTURES,
    WIDTH_M,
    Difficulty,
    LaneLayout,
    Scenery,
    clearance_m,
)
from uavaccel.sim.scene.bounds import check_wind

HalfWidth = Annotated[float, Field(gt=0.0, le=WIDTH_M / 2)]


class Obstacle(Config):
    """One obstacle: a cylinder, or a square post with two sides parallel to the lane."""

    x_m: Annotated[float, Field(gt=0.0, le=LENGTH_M)]
    """Metres north of the start."""
    y_m: Annotated[float, Field(ge=-WIDTH_M / 2, le=WIDTH_M / 2)]
    """Metres east of the lane's centre line."""
    radius_m: HalfWidth | None = None
    """Radius of a cylinder, metres."""
    half_side_m: HalfWidth | None = None
    """Half the side of a square post, metres."""
    texture: Literal["red", "white", "yellow", "blue"] = "red"
    """Texture of the obstacle."""

    @model_validator(mode="after")
    def _has_one_shape(self) -> Self:
        if (self.radius_m is None) == (self.half_side_m is None):
            raise ValueError("should have radius_m (a cylinder) or half_side_m (a square post), one of them")
        return self


class LaneFile(Config):
    """A user-defined lane, in a file or a mapping."""

    obstacles: Annotated[list[Obstacle], Field(max_length=MAX_OBSTACLES)]
    """All obstacles of the lane."""
    wall_texture: Literal["concrete", "brick"] = "concrete"
    """Texture of both walls."""
    ground_texture: Literal["asphalt", "grass"] = "asphalt"
    """Texture of the ground."""
    light: Share = 1.0
    """Light level, 0 to 1, which is full daylight."""
    sun_azimuth_rad: Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)] = 0.5
    """Direction in which the sun shines, radians; 0 is north, the way the drone faces."""
    wind_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Wind velocity, NED, m/s."""
    scenery: Scenery = "plain"
    """Appearance of the lane: plain, or forest, where each texture is a kind of bark, of trees or of ground."""

    @model_validator(mode="after")
    def _can_be_flown(self) -> Self:
        check_wind(self.wind_m_s)
        if clearance_m(self.layout(), (0.0, 0.0)) <= 0.0:
            raise ValueError(f"an obstacle is within {HULL_RADIUS_M:g} m of the start at x_m = y_m = 0")
        return self

    def layout(self) -> LaneLayout:
        """Convert to the layout that the simulation takes."""
        posts = self.obstacles
        return LaneLayout(
            x_m=np.array([post.x_m for post in posts], float),
            y_m=np.array([post.y_m for post in posts], float),
            half_width_m=np.array([post.radius_m or post.half_side_m for post in posts], float),
            round=np.array([post.radius_m is not None for post in posts], bool),
            texture=np.array([OBSTACLE_TEXTURES.index(post.texture) for post in posts], int),
            wall_texture=WALL_TEXTURES.index(self.wall_texture),
            ground_texture=GROUND_TEXTURES.index(self.ground_texture),
            light=self.light,
            sun_azimuth_rad=self.sun_azimuth_rad,
            wind_m_s=self.wind_m_s,
            scenery=self.scenery,
        )


def parse_lane(lane: object) -> object:
    """Read a lane from a mapping or from the YAML file of that name; return anything else, such as a seed, unchanged.

    For use in validators, inside which pydantic refuses a list for a tuple. Raises UserError naming file and key.
    """
    written = load_yaml(Path(lane)) if isinstance(lane, str) else lane
    if isinstance(written, Mapping) and "seed" not in written:
        return validate(LaneFile, written, lane if isinstance(lane, str) else "lane")
    return written


class DrawnLane(Config):
    """A lane sampled from a seed."""

    seed: Seed
    """The lane's: the same seed and difficulty make the same lane."""
    difficulty: Difficulty = Difficulty()
    """How hard the lane is, and what the weather and the vehicle are like."""


Lane = Annotated[
    Seed | DrawnLane | LaneFile, BeforeValidator(parse_lane, json_schema_input_type=int | DrawnLane | LaneFile | str)
]
"""A lane of a configuration: its seed, alone or with a difficulty, or the obstacles, written out or in a file."""


def layout_from(mapping: Mapping[str, object], source: str) -> LaneLayout:
    """Make the layout that a mapping describes; errors call it `source`.

    Raises UserError for a wrong key or value, or for an obstacle at the drone's start.
    """
    return validate(LaneFile, mapping, source).layout()
