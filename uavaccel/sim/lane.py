"""The obstacle lane: layouts, sampled from a seed or written by a user, and its scene in MuJoCo, assets/mjcf/lane.xml.

The paper gives only the lane's length (150 m, section III-C1); the rest of its geometry is this project's own choice.
Rows of obstacles stand at fixed distances; their lateral positions are random. The lane runs north (NED frame).

Obstacles are geoms of the world body, moved in place: a new lane needs neither a new model nor a new GL context. As
bodies of their own they would raise the cost of a physics step from 2 µs to 12 µs or more. MuJoCo finds contacts
through a bounding-volume tree that it builds only once, so that tree is refitted.

A scenery has looks in place of the lane's bodies: trunks for its obstacles, a forest edge for its walls. The bodies are
those of the plain lane, and contacts, depth and segmentation use them; looks are seen only in colour and by the event
camera.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal, Self

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field, field_validator, model_validator

from uavaccel.config import Config, Seed, Share, load_yaml, validate
from uavaccel.errors import UserError
from uavaccel.own_code import file_beside
from uavaccel.sim.poses import check_wind
from uavaccel.sim.scene import PLAIN, refit_bounding_boxes
from uavaccel.units import ned_to_mujoco

FloatArray = NDArray[np.float64]
Split = Literal["training", "evaluation", "test"]
Scenery = Literal["plain", "forest"]

LENGTH_M = 150.0  # the game is won at this distance north of the start (paper, section III-C1)
WIDTH_M = 10.0  # between the inner faces of the walls
HULL_RADIUS_M = 0.3418  # of quadrotor.xml's hull
# Of mass_ratio / thrust_ratio: full throttle lifts 1.7 times the weight, the autopilot's least of .3 half of it. They
# are quadrotor.HOVERS for AirSim's 1 kg, without numba.
LIGHTEST, HEAVIEST = 0.55, 1.5
MAX_OBSTACLES = 64  # as many as lane.xml provides

OBSTACLE_TEXTURES = ("red", "white", "yellow", "blue")
WALL_TEXTURES = ("concrete", "brick")
GROUND_TEXTURES = ("asphalt", "grass")

SPLIT_SIZE = 1_000_000  # lanes of each split
# Policies learn on training lanes, variants are chosen on evaluation lanes, and published numbers are of test lanes.
FIRST_SEEDS: dict[Split, int] = {"evaluation": 0, "training": SPLIT_SIZE, "test": 2 * SPLIT_SIZE}


class Difficulty(Config):
    """The distribution that lanes are sampled from. All published figures use the defaults."""

    first_row_m: Annotated[float, Field(gt=1.0, le=1000.0)] = 10.0
    """Distance from the start to the first row, metres."""
    row_spacing_m: Annotated[float, Field(gt=1.0, le=1000.0)] = 10.0
    """Distance between rows, metres."""
    obstacles_per_row: Annotated[int, Field(ge=0, le=4)] = 2
    """Number of obstacles in a row."""
    half_width_m: Annotated[float, Field(gt=0.0, le=2.0)] = 0.4
    """Half the side of an obstacle's square cross-section, metres."""
    min_gap_m: Annotated[float, Field(ge=2.2 * HULL_RADIUS_M, le=WIDTH_M)] = 2.0
    """Minimum clear width between neighbours in a row, metres."""
    light: tuple[Share, Share] = (0.7, 1.0)
    """Range of the light level, 0 to 1, which is full daylight."""
    texture_variation: Share = 1.0
    """Share of surfaces and obstacles with a random texture; the others have the first one."""
    wind_m_s: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    """Speed of a steady horizontal wind from a random direction, m/s."""
    scenery: Scenery = "plain"
    """Appearance of the lane, with the same bodies: plain, banded posts between walls, or forest, trees in a wood."""
    mass_ratio: Annotated[float, Field(ge=0.5, le=1.5)] = 1.0
    """Factor on the vehicle's mass and moments of inertia."""
    thrust_ratio: Annotated[float, Field(ge=0.7, le=1.5)] = 1.0
    """Factor on its rotors' thrust and torque."""

    @property
    def pitch_m(self) -> float:
        """Minimum distance between the centres of neighbours in a row."""
        return 2 * self.half_width_m + self.min_gap_m

    @field_validator("light")
    @classmethod
    def _rises(cls, light: tuple[float, float]) -> tuple[float, float]:
        if light[0] > light[1]:
            raise ValueError("must be a range, from the darker to the brighter")
        return light

    @model_validator(mode="after")
    def _row_fits(self) -> Self:
        needed = (self.obstacles_per_row - 1) * self.pitch_m
        if needed >= WIDTH_M:
            raise ValueError(
                f"obstacles_per_row = {self.obstacles_per_row} with half_width_m = {self.half_width_m:g} and "
                f"min_gap_m = {self.min_gap_m:g} need {needed:g} m; the lane is {WIDTH_M:g} m wide"
            )
        if self.obstacles_per_row and self.first_row_m - self.half_width_m <= HULL_RADIUS_M:
            raise ValueError(
                f"first_row_m = {self.first_row_m:g} with half_width_m = {self.half_width_m:g} reaches the start, "
                f"within {HULL_RADIUS_M:g} m"
            )
        return self

    @model_validator(mode="after")
    def _can_hover(self) -> Self:
        ratio = self.mass_ratio / self.thrust_ratio
        if not LIGHTEST <= ratio <= HEAVIEST:
            bound = f"least {LIGHTEST:g}" if ratio < LIGHTEST else f"most {HEAVIEST:g}"
            way = "descend" if ratio < LIGHTEST else "climb"
            raise ValueError(
                f"mass_ratio = {self.mass_ratio:g} must be at {bound} times thrust_ratio, "
                f"{self.thrust_ratio:g}, or it cannot {way}"
            )
        return self


@dataclass(frozen=True)
class LaneLayout:
    """Obstacles and appearance of a lane: metres, NED, with the start at the origin; arrays (n,) for n obstacles.

    An obstacle is a square post of half side `half_width_m` or, if `round`, a cylinder of that radius.
    """

    x_m: FloatArray
    y_m: FloatArray
    half_width_m: FloatArray
    round: NDArray[np.bool_]
    texture: NDArray[np.int64]  # index into OBSTACLE_TEXTURES
    wall_texture: int = 0
    ground_texture: int = 0
    light: float = 1.0
    sun_azimuth_rad: float = 0.5  # heading of the sunlight: 0 shines north, the way the drone looks
    wind_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scenery: str = PLAIN
    mass_ratio: float = 1.0
    thrust_ratio: float = 1.0

    def __len__(self) -> int:
        return len(self.x_m)


def lane_seed(split: Split, index: int) -> int:
    """Return the seed of lane `index` of a split. Raises ValueError unless 0 <= index < 1 000 000."""
    if not 0 <= index < SPLIT_SIZE:
        raise ValueError(f"lane index {index} must be at least 0 and below {SPLIT_SIZE}")
    return FIRST_SEEDS[split] + index


def sample_layout(seed: int, difficulty: Difficulty | None = None) -> LaneLayout:
    """Sample the lane of a seed; the same seed and difficulty give the same arrays on every machine."""
    difficulty = difficulty or Difficulty()
    rng, each, pitch_m = np.random.default_rng(seed), difficulty.obstacles_per_row, difficulty.pitch_m
    rows_m = _row_distances(difficulty.first_row_m, difficulty.row_spacing_m, each)
    # lateral positions row by row, uniform over all with gaps of at least `min_gap_m`; obstacles may reach into the
    # walls, so that the way along a wall is blocked as often as that down the middle
    aside_m = rng.uniform(0.0, WIDTH_M - max(each - 1, 0) * pitch_m, (len(rows_m), each))
    aside_m.sort(axis=1)
    count, varied = len(rows_m) * each, difficulty.texture_variation
    direction = rng.uniform(-np.pi, np.pi)
    return LaneLayout(
        x_m=rows_m.repeat(each),
        y_m=(aside_m + pitch_m * np.arange(each) - WIDTH_M / 2).reshape(-1),
        half_width_m=np.full(count, difficulty.half_width_m),
        round=np.zeros(count, dtype=bool),
        texture=_sample_textures(rng, count, len(OBSTACLE_TEXTURES), varied),
        wall_texture=_sample_texture(rng, len(WALL_TEXTURES), varied),
        ground_texture=_sample_texture(rng, len(GROUND_TEXTURES), varied),
        light=float(rng.uniform(*difficulty.light)),
        sun_azimuth_rad=float(rng.uniform(-1.0, 1.0)),
        wind_m_s=(difficulty.wind_m_s * np.cos(direction), difficulty.wind_m_s * np.sin(direction), 0.0),
        scenery=difficulty.scenery,
        mass_ratio=difficulty.mass_ratio,
        thrust_ratio=difficulty.thrust_ratio,
    )


@lru_cache(maxsize=64)
def _row_distances(first_m: float, spacing_m: float, each: int) -> FloatArray:
    """Return the distances of the rows, up to half a spacing before the lane's end, and at most MAX_OBSTACLES."""
    rows = np.arange(first_m, LENGTH_M - spacing_m / 2, spacing_m)[: MAX_OBSTACLES // max(each, 1)]
    rows.flags.writeable = False
    return rows


def _sample_textures(rng: np.random.Generator, count: int, kinds: int, varied: float) -> NDArray[np.int64]:
    """Sample texture indices: random for a share `varied` of them, 0 for the rest."""
    return (rng.random(count) < varied) * rng.integers(kinds, size=count)


def _sample_texture(rng: np.random.Generator, kinds: int, varied: float) -> int:
    """Sample one texture index."""
    random, kind = rng.random() < varied, int(rng.integers(kinds))
    return kind if random else 0


def clearance_m(layout: LaneLayout, position_m: ArrayLike) -> FloatArray:
    """Return the metres from the hull to the nearest obstacle or wall at positions (..., 2); negative inside."""
    position = np.asarray(position_m, dtype=np.float64)
    wall = WIDTH_M / 2 - np.abs(position[..., 1])
    if not len(layout):
        return wall - HULL_RADIUS_M
    flat = np.where(layout.round, 0.0, layout.half_width_m)
    north = np.maximum(np.abs(position[..., :1] - layout.x_m) - flat, 0.0)
    east = np.maximum(np.abs(position[..., 1:] - layout.y_m) - flat, 0.0)
    distance = np.hypot(north, east) - (layout.half_width_m - flat)
    nearest: NDArray[np.float64] = np.minimum(distance.min(axis=-1), wall) - HULL_RADIUS_M
    return nearest


def is_walled_off(layout: LaneLayout) -> bool:
    """Return whether obstacles with gaps that are too narrow for the hull reach from one wall to the other."""
    flat = np.where(layout.round, 0.0, layout.half_width_m)
    radius, of_both = layout.half_width_m - flat, flat[:, None] + flat
    north, east = (np.maximum(np.abs(at[:, None] - at) - of_both, 0.0) for at in (layout.x_m, layout.y_m))
    closed = np.hypot(north, east) - (radius[:, None] + radius) < 2 * HULL_RADIUS_M
    to_wall = WIDTH_M / 2 - layout.half_width_m - 2 * HULL_RADIUS_M
    reached = layout.y_m < -to_wall  # joined to the western wall, directly or through others
    for _ in range(len(layout)):
        reached = reached | closed[reached].any(axis=0)
    return bool((reached & (layout.y_m > to_wall)).any())


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
    """A user-defined lane, as YAML or a mapping:

    obstacles:
      - {x_m: 12, y_m: 0.5, half_side_m: 0.4}               # a square post
      - {x_m: 20, y_m: -2, radius_m: 0.6, texture: yellow}  # a cylinder
    light: 0.8
    """

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
    try:
        written = load_yaml(file_beside(lane)) if isinstance(lane, str) else lane
    except UserError as error:
        raise UserError(f"lane: {error}") from None
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


OBSTACLE_HALF_HEIGHT_M = 10.0
PARKED_Z_M = 100.0  # NED: below the ground, out of reach and out of sight
SUN_ELEVATION_RAD = 0.9
DAYLIGHT = 0.65  # the sun's share of full daylight; AMBIENT is that of the sky
AMBIENT = 0.45
APPEARANCE_GROUP, BODIES_GROUP = 4, 5  # visible only in colour, and in all but colour; other groups always are
TRUNK_RATIO = 1.25  # a trunk's radius over a square post's half side: between its sides and its corners


def apply_layout(model: mujoco.MjModel, data: mujoco.MjData, layout: LaneLayout) -> None:
    """Move the scene's obstacles and set its textures and light, in place.

    Raises UserError if the scene has fewer obstacles than the layout, and in all scenes but the lane.
    """
    geoms = obstacle_geoms(model)
    if not len(geoms):
        raise UserError("the scene is no lane, whose obstacles, light and wind a layout sets")
    if len(layout) > len(geoms):
        raise UserError(f"the layout has {len(layout)} obstacles, the scene {len(geoms)}: leave some out")
    used, parked = geoms[: len(layout)], geoms[len(layout) :]
    half, tall = layout.half_width_m, np.full(len(layout), OBSTACLE_HALF_HEIGHT_M)
    model.geom_type[used] = np.where(layout.round, int(mujoco.mjtGeom.mjGEOM_CYLINDER), int(mujoco.mjtGeom.mjGEOM_BOX))
    model.geom_size[used] = np.stack([half, np.where(layout.round, tall, half), tall], axis=1)
    model.geom_aabb[used, 3:] = np.stack([half, half, tall], axis=1)
    model.geom_rbound[used] = np.sqrt(half**2 * np.where(layout.round, 1, 2) + tall**2)
    model.geom_pos[used] = ned_to_mujoco(np.stack([layout.x_m, layout.y_m, -tall], axis=1))
    model.geom_pos[parked, 1:] = (0.0, -PARKED_Z_M)
    model.geom_rgba[used] = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's default, which lets the material's colour through
    model.geom_rgba[parked, 3] = 0.0  # not drawn
    materials = np.array([model.material(f"obstacle_{name}").id for name in OBSTACLE_TEXTURES])
    model.geom_matid[used] = materials[layout.texture]
    for wall in ("wall_west", "wall_east"):
        model.geom(wall).matid = model.material(f"wall_{WALL_TEXTURES[layout.wall_texture]}").id
    model.geom("ground").matid = model.material(f"ground_{GROUND_TEXTURES[layout.ground_texture]}").id
    sun = model.light("sun")
    sun.dir, sun.ambient, sun.diffuse = sunlight(layout)
    _set_appearance(model, used, layout)
    refit_bounding_boxes(model, set(geoms.tolist()))
    mujoco.mj_kinematics(model, data)


def obstacle_geoms(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the ids of the geoms that a layout moves, in order of their names; empty in other scenes."""
    return named(model, "obstacle_")


def sunlight(layout: LaneLayout) -> tuple[NDArray[np.float64], float, float]:
    """Return a lane's light: the sun's direction in MuJoCo's axes, the ambient and the diffuse level."""
    level, azimuth = np.cos(SUN_ELEVATION_RAD), layout.sun_azimuth_rad
    direction = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(SUN_ELEVATION_RAD)]
    return ned_to_mujoco(direction), layout.light * AMBIENT, layout.light * DAYLIGHT


def object_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom or, if it has none, of its body; "" for -1, the sky."""
    if geom < 0:
        return ""
    return str(model.geom(geom).name or model.body(int(model.geom_bodyid[geom])).name)


def _set_appearance(model: mujoco.MjModel, obstacles: NDArray[np.int64], layout: LaneLayout) -> None:
    """Let the looks of a scenery follow the geoms of the layout's obstacles; the plain lane has none."""
    trunks = named(model, "trunk_")
    if not len(trunks):
        return
    kinds = np.array([mesh for mesh in range(model.nmesh) if model.mesh(mesh).name.startswith("trunk_")])
    wanted = layout.half_width_m * np.where(layout.round, 1.0, TRUNK_RATIO)
    nearest = np.abs(np.log(wanted[:, None] / model.numeric("trunk_radii_m").data)).argmin(axis=1)
    used, meshes = trunks[: len(obstacles)], kinds[nearest]
    model.geom_rgba[trunks] = (0.5, 0.5, 0.5, 0.0)  # MuJoCo's default lets the material's colour through
    model.geom_rgba[used, 3] = 1.0
    model.geom_dataid[used], model.geom_matid[used] = meshes, model.geom_matid[obstacles]
    model.geom_sameframe[used] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # else their turn goes unnoticed
    away_from_sun = np.array([np.cos(layout.sun_azimuth_rad / 2), 0.0, 0.0, -np.sin(layout.sun_azimuth_rad / 2)])
    for geom, mesh, obstacle in zip(used, meshes, obstacles, strict=True):  # MuJoCo's meshes have their inertia's frame
        mujoco.mju_rotVecQuat(model.geom_pos[geom], model.mesh_pos[mesh], away_from_sun)
        model.geom_pos[geom, :2] += model.geom_pos[obstacle, :2]
        mujoco.mju_mulQuat(model.geom_quat[geom], away_from_sun, model.mesh_quat[mesh])
    for side in ("west", "east"):
        model.geom(f"edge_{side}").matid = model.geom(f"wall_{side}").matid


def named(model: mujoco.MjModel, beginning: str) -> NDArray[np.int64]:
    """Return the ids of the geoms whose names have that beginning, in order of their names."""
    names = [model.geom(geom).name for geom in range(model.ngeom)]
    return np.array([geom for geom, name in enumerate(names) if name.startswith(beginning)], int)
