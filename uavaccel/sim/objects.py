"""The objects of a scene for AirSim's clients, which find them by name, move, scale, spawn and destroy them.

An object is a geom of the world body, changed in place, so that neither the model nor a GL context is made anew.
Positions are NED, of the object's centre. Spawned objects use spare geoms (uavaccel.sim.scene); they are static.

A client's regular expression is matched against whole names in bounded time, by the package `regex`, which takes a time
limit: std::regex_match with icase, in the syntax of ECMA-262, 15.10, with the POSIX classes of std::regex; what `regex`
has beyond it is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np
import regex
from numpy.typing import ArrayLike, NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.sim.lane import APPEARANCE_GROUP
from uavaccel.sim.poses import Pose, from_mujoco
from uavaccel.sim.scene import PARKED_M, SPARE, refit_bounding_boxes
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S, mujoco_to_ned, ned_to_mujoco, quaternion_ned_to_mujoco

Scale = tuple[float, float, float]

BOX, SPHERE, CYLINDER = (
    int(kind) for kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER)
)
ELLIPSOID, PLANE = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID), int(mujoco.mjtGeom.mjGEOM_PLANE)
MESH, CAPSULE = int(mujoco.mjtGeom.mjGEOM_MESH), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
SCALED = (BOX, SPHERE, CYLINDER, ELLIPSOID, CAPSULE)
# Unreal's basic shapes: one metre across; kind, half sizes along x, y, z.
ASSETS: dict[str, tuple[int, Scale]] = {
    "Cube": (BOX, (0.5, 0.5, 0.5)),
    "1M_Cube_Chamfer": (BOX, (0.5, 0.5, 0.5)),
    "1M_Cube": (BOX, (0.5, 0.5, 0.5)),
    "Sphere": (ELLIPSOID, (0.5, 0.5, 0.5)),
    "Cylinder": (CYLINDER, (0.5, 0.5, 0.5)),
    "Plane": (BOX, (0.5, 0.5, 0.005)),
}
LARGEST_HALF_M = 1e4


class SceneObjects:
    """The objects of a world. Methods raise ValueError for what is not possible."""

    def __init__(self, world: World) -> None:
        self._world = world
        still = (self._model.geom_bodyid == 0) & (self._model.geom_group != APPEARANCE_GROUP)
        named = {self._model.geom(int(geom)).name: int(geom) for geom in np.flatnonzero(still)}
        self._spares = sorted(geom for name, geom in named.items() if name.startswith(SPARE))
        self._geoms = {name: geom for name, geom in named.items() if name and not name.startswith(SPARE)}
        self._kinds = {geom: int(self._model.geom_type[geom]) for geom in self._geoms.values()}
        self._full_size = {geom: _half_sizes(self._model, geom) for geom in self._geoms.values()}
        self._scales: dict[int, Scale] = {}
        world.called = self.name_of

    @property
    def _model(self) -> mujoco.MjModel:
        return self._world.model

    def names(self) -> list[str]:
        """Return the names of all objects, sorted."""
        return sorted(name for name, geom in self._geoms.items() if self._is_there(geom))

    def geom(self, name: str) -> int | None:
        """Return the geom of the object of that name; None without one."""
        geom = self._geoms.get(name)
        return geom if geom is not None and self._is_there(geom) else None

    def name_of(self, geom_name: str) -> str:
        """Return clients' name of the object with that geom name; they differ for spawned objects."""
        if not geom_name.startswith(SPARE):
            return geom_name
        return next((name for name, geom in self._geoms.items() if self._model.geom(geom).name == geom_name), "")

    def _is_there(self, geom: int) -> bool:
        return bool(self._model.geom_rgba[geom, 3] > 0.0)

    def pose(self, name: str) -> Pose | None:
        """Return an object's pose, NED; None without one of that name."""
        if (geom := self.geom(name)) is None:
            return None
        here = from_mujoco(self._model.geom_pos[geom], self._model.geom_quat[geom])
        within = self._within(geom)
        return here if within is None else here.of(within.inwards_pose(Pose()))

    def set_pose(self, name: str, pose: Pose) -> bool:
        """Move an object; returns False without one of that name, and for the ground."""
        geom = self.geom(name)
        if geom is None or self._kinds[geom] == PLANE:
            return False
        self._place(geom, pose)
        self._moved(geom)
        return True

    def scale(self, name: str) -> Scale | None:
        """Return an object's size relative to its initial one; None without one of that name."""
        return None if (geom := self.geom(name)) is None else self._scales.get(geom, (1.0, 1.0, 1.0))

    def set_scale(self, name: str, scale: Scale) -> bool:
        """Scale an object; returns False without one of that name, and for the ground, meshes and height fields."""
        geom = self.geom(name)
        if geom is None or self._kinds[geom] not in SCALED:
            return False
        self._resize(geom, scale)
        self._moved(geom)
        return True

    def spawn(self, name: str, asset: str, pose: Pose, scale: Scale) -> str:
        """Spawn an object; returns its name, with a number if it is taken (WorldSimApi::spawnObject)."""
        if asset not in ASSETS:
            raise ValueError(
                f"There were no objects with name {asset} found in the Registry; there are {', '.join(ASSETS)}"
            )
        if not self._spares:
            raise ValueError("there is no room for another object; destroy one with simDestroyObject first")
        names = [*self.names(), *(vehicle.name for vehicle in self._world.vehicles)]
        if taken := [other for other in names if name in other]:
            numbers = [int(found[0]) for other in taken if (found := re.findall(r"\d+$", other))]
            name += str(max(numbers, default=0) + 1)
        geom = self._spares[0]
        self._kinds[geom], self._full_size[geom] = ASSETS[asset]
        self._resize(geom, scale)
        self._place(geom, pose)
        del self._spares[0]
        self._geoms[name] = geom
        self._set_there(geom, True)
        self._moved(geom)
        return name

    def destroy(self, name: str) -> bool:
        """Destroy an object; returns False without one of that name, and for the ground."""
        geom = self.geom(name)
        if geom is None or self._kinds[geom] == PLANE:
            return False
        del self._geoms[name]
        self._set_there(geom, False)
        self._place(geom, Pose(tuple(mujoco_to_ned(PARKED_M).tolist())))
        if self._model.geom(geom).name.startswith(SPARE):
            self._spares.append(geom)
        self._moved(geom)
        return True

    def corners(self, name: str) -> NDArray[np.float64]:
        """Return the corners (8, 3), NED, of an object's oriented box. Raises KeyError."""
        geom = self._geoms[name]
        half, middle = _half_sizes(self._model, geom), mujoco_to_ned(self._model.geom_aabb[geom, :3])
        if self._kinds[geom] == PLANE:  # whose box is infinitely deep
            half, middle = (*self._model.geom_size[geom, :2], 0.0), np.zeros(3)
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        pose = from_mujoco(self._model.geom_pos[geom], self._model.geom_quat[geom])
        return np.asarray((signs * np.array(half) + middle) @ pose.matrix().T + np.array(pose.position_m))

    def _within(self, geom: int) -> Pose | None:
        """Return the pose in a mesh's own frame of the axes of inertia, about which MuJoCo turns it; None of others."""
        if self._kinds[geom] != MESH:
            return None
        mesh = int(self._model.geom_dataid[geom])
        return from_mujoco(self._model.mesh_pos[mesh], self._model.mesh_quat[mesh])

    def _place(self, geom: int, pose: Pose) -> None:
        if (within := self._within(geom)) is not None:
            pose = pose.of(within)
        self._model.geom_pos[geom] = ned_to_mujoco(pose.position_m)
        self._model.geom_quat[geom] = quaternion_ned_to_mujoco(pose.orientation_wxyz)
        # otherwise MuJoCo ignores its rotation
        self._model.geom_sameframe[geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE

    def _resize(self, geom: int, scale: Scale) -> None:
        half = np.array(self._full_size[geom]) * scale
        kind = self._kinds[geom]
        if not (np.isfinite(half).all() and half.min() > 0.0 and half.max() <= LARGEST_HALF_M):
            raise ValueError(f"scale must be positive and at most {2 * LARGEST_HALF_M:g} m, not {scale}")
        if kind == CYLINDER and half[0] != half[1]:
            raise ValueError(f"the scale of a cylinder must be the same along x and y, not {scale}")
        if kind == CAPSULE and len(set(scale)) > 1:
            raise ValueError(f"the scale of a capsule must be the same along x, y and z, not {scale}")
        model = self._model
        model.geom_type[geom] = ELLIPSOID if kind == SPHERE else kind
        along = {CYLINDER: half[2], CAPSULE: half[2] - half[0]}  # half lengths
        model.geom_size[geom] = (half[0], along[kind], 0.0) if kind in along else half
        model.geom_aabb[geom] = (0.0, 0.0, 0.0, *half)
        model.geom_rbound[geom] = float(np.linalg.norm(half))
        self._scales[geom] = scale

    def _set_there(self, geom: int, there: bool) -> None:
        """Make a geom visible with contacts, or neither."""
        self._model.geom_rgba[geom, 3] = float(there)
        self._model.geom_matid[geom] = self._model.geom_matid[geom] if there else -1
        self._model.geom_contype[geom] = self._model.geom_conaffinity[geom] = int(there)

    def _moved(self, geom: int) -> None:
        refit_bounding_boxes(self._model, {geom})
        self._world.surroundings_changed()


def _half_sizes(model: mujoco.MjModel, geom: int) -> Scale:
    x, y, z = (float(half) for half in model.geom_aabb[geom, 3:])
    return x, y, z


NEAR_END_M = 1e-3
# Those of depth pictures: neither the vehicles' hulls nor looks.
_GROUPS = np.array([1, 1, 1, 0, 0, 1], np.uint8)


class Hits(NamedTuple):
    """Hits of n rays: metres (n,), inf for none; geoms (n,), -1 for none; outward normals (n, 3), NED."""

    distance_m: NDArray[np.float64]
    geoms: NDArray[np.int32]
    normals: NDArray[np.float64]


def cast(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    start_m: ArrayLike,
    directions: NDArray[np.float64],
    longest_m: float = np.inf,
    *,
    exclude: str | None,
) -> Hits:
    """Cast rays from a position along unit vectors (n, 3), through the body `exclude`, if any."""
    mujoco.mj_kinematics(model, data)  # mj_step leaves the positions of the step's beginning
    count = len(directions)
    geoms, distance_m, normals = np.full(count, -1, np.int32), np.full(count, -1.0), np.zeros((count, 3))
    without, cutoff = -1 if exclude is None else model.body(exclude).id, min(longest_m, mujoco.mjMAXVAL)
    rays, found = (ned_to_mujoco(start_m), ned_to_mujoco(directions).ravel()), (geoms, distance_m, normals.reshape(-1))
    mujoco.mj_multiRay(model, data, *rays, _GROUPS, True, without, *found, count, cutoff)
    missed = (geoms < 0) | (distance_m < 0) | (distance_m > longest_m)
    distance_m[missed], geoms[missed] = np.inf, -1
    return Hits(distance_m, geoms, mujoco_to_ned(normals))


def sees(model: mujoco.MjModel, data: mujoco.MjData, start_m: ArrayLike, end_m: ArrayLike, *, exclude: str) -> bool:
    """Return whether only the body `exclude` is between two positions, except for what touches the second."""
    way = np.asarray(end_m, float) - np.asarray(start_m, float)
    length_m = float(np.linalg.norm(way))
    if length_m <= NEAR_END_M:
        return True
    hits = cast(model, data, start_m, (way / length_m)[None], length_m - NEAR_END_M, exclude=exclude)
    return bool(np.isinf(hits.distance_m[0]))


LONGEST_NS = NS_PER_S // 10  # for all names
MOST_STEPS = 100_000  # of a compiled expression, each of which takes about 300 bytes
FLAGS = regex.VERSION0 | regex.ASCII | regex.IGNORECASE  # \w, \d and \b are ASCII's
TOKEN = re.compile(
    r"(?P<own>\\0|\[\^?\]|[$.]|\{(?!\d+(?:,\d*)?\}))"
    r"|(?P<unknown>\(\?(?![:=!]).?|\(\*|[*+?}]\+)"
    r"|(?P<same>\\[bBdDfnrsStuvwWx1-9]|\[(?:\[:\w*:\]|\\.|[^]\\])+\])"
    r"|\\(?P<letter>.)",
    re.DOTALL,
)
OWN = {"$": r"\Z", ".": r"[^\n\r\u2028\u2029]", "{": r"\{", "[]": "(?!)", "[^]": r"[\s\S]", r"\0": r"\x00"}
POSIX = {"d": r"\d", "s": r"\s", "w": r"\w", "upper": "[:alpha:]", "lower": "[:alpha:]"}


def matching(text: str, names: Iterable[str]) -> list[str]:
    """Return the names that match as a whole, ignoring case. Raises ValueError for a wrong or slow expression."""
    clock = MonotonicClock()
    end_ns = clock.now_ns() + LONGEST_NS
    try:
        groups = [int(least or 1) + 1 for least in re.findall(r"\)(?:\+|\{(\d+))", text)]
        letters = [int(least) for least in re.findall(r"[^)]\{(\d+)", text)]
        if len(text) * math.prod(groups) * max([1, *letters]) > MOST_STEPS:  # `regex` writes repetitions out
            raise ValueError(f"longer than {MOST_STEPS} steps, its repetitions written out")
        pattern = regex.compile(TOKEN.sub(_translated, _folded(text)), FLAGS, cache_pattern=False)
        return [
            name
            for name in names
            if pattern.fullmatch(_folded(name), timeout=max(end_ns - clock.now_ns(), 0) / NS_PER_S)
        ]
    except TimeoutError:
        raise ValueError(f"{text!r} takes too long to match; make it simpler") from None
    except RecursionError:
        raise ValueError(f"{text!r} is no regular expression: nested too deeply") from None
    except (regex.error, ValueError) as error:
        raise ValueError(f"{text!r} is no regular expression: {getattr(error, 'msg', error)}") from None
    finally:
        regex.purge()  # it remembers something of every expression, without a bound


def _folded(text: str) -> str:
    return "".join(letter if letter.isascii() else letter.lower() for letter in text)


def _translated(token: re.Match[str]) -> str:
    """Return what `regex` understands as a token of ECMA-262. Raises ValueError where there is no such token."""
    if token["unknown"]:
        raise ValueError(f"{token['unknown']} is not known")
    if token["own"]:
        return OWN[token["own"]]
    if token["letter"]:
        return re.escape(token["letter"])
    return re.sub(r"\[:(\w+):\]", lambda known: POSIX.get(known[1], known[0]), token["same"])
