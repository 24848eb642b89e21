"""A vehicle's cameras, AirSim's five and those of the settings; its types of image, drawn at the moment of the call.

Sources: AirSim v1.8.1, AirSimSettings.hpp (keys and defaults of cameras), FlyingPawn.cpp (their names),
BP_FlyingPawn.uasset (their mounts), docs/image_apis.md (what the numbers of each type mean), ImageCaptureBase.hpp
(types), Examples/DataCollection/StereoImageGenerator.hpp (disparity), AirBlueprintLib.cpp and docs/seg_rgbs.txt
(segmentation IDs and their colours).
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Annotated

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from uavaccel.resources import asset
from uavaccel.sim.camera.camera import FRONT_CENTER, Lens, MountedCamera
from uavaccel.sim.camera.view import GeomImage, vehicle_pose
from uavaccel.sim.objects import SceneObjects, cast
from uavaccel.sim.poses import Pose, from_degrees
from uavaccel.sim.sensors import AirSimKeys
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.vehicle import Vehicle
from uavaccel.sim.world import World

SCENE = 0
MOUNTS = {
    "front_center": FRONT_CENTER,
    "front_right": Pose((0.46, 0.125, 0.0)),
    "front_left": Pose((0.46, -0.125, 0.0)),
    "bottom_center": Pose((0.0, 0.0, 0.12), from_degrees(0.0, -90.0, 0.0)),
    "back_center": Pose((-0.46, 0.0, 0.0), from_degrees(0.0, 0.0, 180.0)),
}
ALIASES = {str(number): name for number, name in enumerate(MOUNTS)} | {"": "front_center", "fpv": "front_center"}
DISTORTION = ("K1", "K2", "K3", "P1", "P2")
Size = Annotated[int | None, Field(ge=1, le=8192)]
NARROWEST_DEG, WIDEST_DEG = 0.1, 179.0  # fields of view that a projection can have


class CaptureSettings(AirSimKeys):
    """The lens for one type of image."""

    image_type: Annotated[int, Field(ge=-1, le=9)] = SCENE
    """AirSim's number of the type; -1 is the view of its window."""
    width: Size = None
    height: Size = None
    fov_degrees: Annotated[float | None, Field(alias="FOV_Degrees", ge=NARROWEST_DEG, le=WIDEST_DEG)] = None


class CameraSettings(AirSimKeys):
    """A camera of settings.json, in metres FRD and degrees; keys that are left out change nothing."""

    capture_settings: list[CaptureSettings] = Field(default_factory=list)
    x: float | None = None
    y: float | None = None
    z: float | None = None
    pitch: float | None = None
    roll: float | None = None
    yaw: float | None = None

    def lenses(self, before: Mapping[int, Lens]) -> dict[int, Lens]:
        """Return the lenses by image type, on the basis of the lenses `before`."""
        lenses = dict(before)
        for given in self.capture_settings:
            lens = lenses.get(given.image_type, Lens())
            size = given.width or lens.width, given.height or lens.height
            lenses[given.image_type] = Lens(*size, given.fov_degrees or lens.fov_deg)
        return lenses

    def mount(self, before: Pose) -> Pose:
        """Return the mount on the vehicle, on the basis of the mount `before`."""
        given = zip((self.x, self.y, self.z), before.position_m, strict=True)
        x, y, z = (old if new is None else new for new, old in given)
        angles = (self.roll, self.pitch, self.yaw)
        turned = any(angle is not None for angle in angles)
        return Pose((x, y, z), from_degrees(*(a or 0.0 for a in angles)) if turned else before.orientation_wxyz)


@dataclass
class CameraMount:
    """One camera: its lenses, and its mount on the vehicle number `carrier`, or in the world if it is `external`."""

    name: str
    mount: Pose
    lenses: dict[int, Lens]
    external: bool = False
    carrier: int = 0
    distortion: dict[str, float] = field(default_factory=lambda: dict.fromkeys(DISTORTION, 0.0))

    def eye(self, vehicle: Pose) -> Pose:
        """Return the camera's pose in the world, NED, for a pose of the vehicle."""
        return self.mount if self.external else vehicle.of(self.mount)

    def body(self, vehicles: Sequence[Vehicle]) -> str | None:
        """Return the name of the body that carries it, through which its rays pass; None for an external camera."""
        return None if self.external else vehicles[self.carrier].body

    def lens(self, image_type: int) -> Lens:
        return self.lenses.get(image_type, Lens())

    def set_fov(self, fov_deg: float) -> None:
        types = {SCENE, *range(10), *self.lenses}
        self.lenses = {kind: self.lens(kind)._replace(fov_deg=fov_deg) for kind in types}


class Cameras:
    """Cameras by name: a vehicle's, or those of ExternalCameras. `defaults` apply to each `given` one."""

    def __init__(
        self, defaults: CameraSettings, given: Mapping[str, CameraSettings], external: bool = False, carrier: int = 0
    ) -> None:
        lenses, mounts = defaults.lenses({}), {} if external else MOUNTS
        self._cameras = {each: CameraMount(each, at, dict(lenses), carrier=carrier) for each, at in mounts.items()}
        for alias, settings in given.items():
            name = ALIASES.get(alias, alias)
            before = self._cameras.get(name) or CameraMount(name, Pose(), dict(lenses))
            mount, own = settings.mount(before.mount), settings.lenses(before.lenses)
            self._cameras[name] = CameraMount(name, mount, own, external, carrier)

    def named(self, name: object) -> CameraMount:
        """Return the camera of a client's name for it. Raises ValueError if there is none."""
        found = self._cameras.get(ALIASES.get(str(name), str(name)))
        if found is None:
            numbers = {full: number for number, full in ALIASES.items() if number.isdecimal()}
            known = [f"{full} ({numbers[full]})" if full in numbers else full for full in self._cameras]
            raise ValueError(f"no camera '{name}'; there are {', '.join(known) or 'none'}")
        return found

    def lenses(self) -> list[Lens]:
        """Return all lenses of all cameras."""
        return [Lens(), *(lens for camera in self._cameras.values() for lens in camera.lenses.values())]


Pixels = NDArray[np.uint8] | NDArray[np.float32]


class ImageType(IntEnum):
    """AirSim's numbers of its types of image."""

    SCENE = 0
    DEPTH_PLANAR = 1
    DEPTH_PERSPECTIVE = 2
    DEPTH_VIS = 3
    DISPARITY_NORMALIZED = 4
    SEGMENTATION = 5
    SURFACE_NORMALS = 6
    INFRARED = 7


MOST_PIXELS = 1 << 24  # of one picture, so that its bytes fit into an answer: more than 4320 x 2160
RAYS_AT_ONCE = 1 << 16
DEPTH_VIS_FAR_M = 100.0
BASELINE_M = 0.25  # between AirSim's front_left and front_right
_DEPTHS = (ImageType.DEPTH_PLANAR, ImageType.DEPTH_PERSPECTIVE, ImageType.DEPTH_VIS, ImageType.DISPARITY_NORMALIZED)


class Pictures:
    """Draws the images of one simulation. With `render` False it refuses them all, and costs nothing."""

    def __init__(
        self, simulation: Simulation, largest: tuple[int, int], segmentation: Segmentation, render: bool
    ) -> None:
        self._simulation, self._largest, self._segmentation = simulation, largest, segmentation
        self.render = render

    def floats(self, camera: CameraMount, image_type: int) -> NDArray[np.float32]:
        """Return an image (height, width) of metres, of fractions, or of another type's red channel from 0 to 1."""
        kind, shown = known_type(image_type), self._shown()
        if kind in _DEPTHS:
            return self._depth(camera, kind, shown)
        return (self.rgb(camera, kind)[..., 0] / np.float32(255)).astype(np.float32)

    def rgb(self, camera: CameraMount, image_type: int) -> NDArray[np.uint8]:
        """Return an image (height, width, 3) of red, green and blue."""
        kind, shown = known_type(image_type), self._shown()
        if kind == ImageType.SCENE:
            return self._pointed(camera, kind, shown).colour(shown)
        if kind == ImageType.SEGMENTATION:
            return colours()[self._object_ids(camera, kind, shown)]
        if kind == ImageType.INFRARED:
            return _gray(self._object_ids(camera, kind, shown).astype(np.uint8))
        if kind == ImageType.SURFACE_NORMALS:
            return self._normals(camera, shown)
        share = self._depth(camera, kind, shown)
        if kind in (ImageType.DEPTH_PLANAR, ImageType.DEPTH_PERSPECTIVE):
            share = np.minimum(share / np.float32(DEPTH_VIS_FAR_M), np.float32(1.0))
        return _gray(np.rint(share * 255).astype(np.uint8))

    def warm_up(self) -> None:
        """Draw once, so that the first requested image takes no longer than others. Raises UserError without OpenGL."""
        front = CameraMount("front_center", FRONT_CENTER, {})
        for image_type in (ImageType.SCENE, ImageType.SEGMENTATION, ImageType.DEPTH_PERSPECTIVE):
            self.rgb(front, image_type)

    def _depth(self, camera: CameraMount, kind: ImageType, scene: mujoco.MjData) -> NDArray[np.float32]:
        """Return the depth image of a type: metres, or fractions from 0 to 1 for DEPTH_VIS and DISPARITY_NORMALIZED."""
        pointed = self._pointed(camera, kind, scene)
        if kind == ImageType.DEPTH_PERSPECTIVE:
            return pointed.depth_perspective(scene)
        depth_m = pointed.depth(scene)
        if kind == ImageType.DEPTH_VIS:
            depth_m = np.minimum(depth_m / np.float32(DEPTH_VIS_FAR_M), np.float32(1.0))
        if kind == ImageType.DISPARITY_NORMALIZED:
            half_width = math.tan(math.radians(camera.lens(kind).fov_deg) / 2)
            depth_m = np.minimum(np.float32(BASELINE_M / (2 * half_width)) / depth_m, np.float32(1.0))
        return depth_m

    def _object_ids(self, camera: CameraMount, kind: ImageType, scene: mujoco.MjData) -> NDArray[np.int64]:
        return self._segmentation.ids(self._pointed(camera, kind, scene).segmentation(scene))

    def _normals(self, camera: CameraMount, scene: mujoco.MjData) -> NDArray[np.uint8]:
        """Draw surface normals: north, east and up as red, green and blue, -1 as 0 and 1 as 255; the sky is black."""
        lens = camera.lens(ImageType.SURFACE_NORMALS)
        self._check_renderable(lens)
        eye, world = camera.eye(vehicle_pose(scene, camera.carrier)), self._simulation.world
        carrier = camera.body(world.vehicles)
        picture, rows = np.empty((lens.height, lens.width, 3), np.uint8), max(RAYS_AT_ONCE // lens.width, 1)
        for top in range(0, lens.height, rows):  # casting takes a hundred bytes per ray
            directions = pixel_rays(lens, range(top, min(top + rows, lens.height))) @ eye.matrix().T
            hits = cast(world.model, scene, eye.position_m, directions.reshape(-1, 3), exclude=carrier)
            rgb = np.rint((hits.normals * (1.0, 1.0, -1.0) + 1.0) * 127.5).astype(np.uint8)
            rgb[hits.geoms < 0] = 0
            picture[top : top + rows] = rgb.reshape(-1, lens.width, 3)
        return picture

    def _pointed(self, camera: CameraMount, image_type: int, scene: mujoco.MjData) -> MountedCamera:
        """Point the renderer as the camera is. Raises ValueError if rendering is off, UserError without OpenGL."""
        lens = camera.lens(image_type)
        self._check_renderable(lens)
        width, height = self._largest
        fit = (width, height) if width * height <= MOST_PIXELS else (lens.width, lens.height)
        pointed = self._simulation.world.mounted_camera(*fit)
        own = camera.mount == FRONT_CENTER and not camera.external and camera.carrier == 0
        pointed.point(None if own else camera.eye(vehicle_pose(scene, camera.carrier)), lens)
        return pointed

    def _check_renderable(self, lens: Lens) -> None:
        if not self.render:
            raise ValueError("rendering is switched off")
        if not can_render(lens):
            raise ValueError(
                f"a picture of {lens.width} x {lens.height} is too large: it may have {MOST_PIXELS:,} pixels"
            )

    def _shown(self) -> mujoco.MjData:
        """Return the scene to draw: the present, or the frame that a modelled renderer shows."""
        return self._simulation.frames.scene(self._simulation.world.data)


def can_render(lens: Lens) -> bool:
    return lens.width * lens.height <= MOST_PIXELS


def known_type(image_type: int) -> ImageType:
    """Return the type of image of this number. Raises ValueError for a type that is not available here."""
    try:
        return ImageType(image_type)
    except ValueError:
        known = ", ".join(f"{kind.value} {kind.name.lower()}" for kind in ImageType)
        raise ValueError(f"image type {image_type} is not available; there are {known}") from None


def pixel_rays(lens: Lens, rows: range) -> NDArray[np.float64]:
    """Unit vectors (rows, width, 3), FRD, through the centres of the pixels in some rows."""
    pixel = 2 * math.tan(math.radians(lens.fov_deg) / 2) / lens.width
    right = (np.arange(lens.width) + 0.5 - lens.width / 2) * pixel
    down = (np.array(rows) + 0.5 - lens.height / 2) * pixel
    rays = np.stack(np.broadcast_arrays(1.0, right[None, :], down[:, None]), axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _gray(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(image[..., None], 3, axis=2)


def ppm(rgb: NDArray[np.uint8]) -> bytes:
    """Return a portable pixmap of red, green, blue pixels (H, W, 3)."""
    height, width = rgb.shape[:2]
    return f"P6\n{width} {height}\n255\n".encode() + rgb.tobytes()


def pfm(numbers: NDArray[np.float32]) -> bytes:
    """Return a portable float map: one number per pixel, little endian, the bottom row first."""
    height, width = numbers.shape
    return f"Pf\n{width} {height}\n-1.0\n".encode() + numbers[::-1].astype("<f4").tobytes()


NOT_RENDERED, NO_OBJECT = -1, 0
HIGHEST_ID = 255


class Segmentation:
    """The IDs of one world's objects, and of its vehicles."""

    def __init__(self, world: World, objects: SceneObjects) -> None:
        self._world, self._objects = world, objects
        self._given: dict[int, int] = {}  # by geom
        self._table = np.zeros(0, np.int64)

    def ids(self, geoms: GeomImage) -> NDArray[np.int64]:
        """Return the IDs of an image of geoms; 0 for the sky and for objects that are not drawn."""
        return np.asarray(np.maximum(self._all(), NO_OBJECT)[geoms])

    def _all(self) -> NDArray[np.int64]:
        """Return the IDs of all geoms, and last that of the sky, geom -1."""
        model = self._world.model
        if len(self._table) != model.ngeom + 1:  # at first, or after a vehicle was added
            names = [self._world.name_of(geom) for geom in range(model.ngeom)]
            self._table = np.array([*map(id_of_name, names), NO_OBJECT])
            for geom, number in self._given.items():
                self._table[geom] = number
        return self._table

    def _give(self, geoms: list[int], number: int) -> None:
        self._all()[geoms] = number
        self._given |= dict.fromkeys(geoms, number)

    def set_id(self, names: Iterable[str], number: int) -> bool:
        """Set the ID of the objects and vehicles of these names; returns whether there are any."""
        if not NOT_RENDERED <= number <= HIGHEST_ID:
            raise ValueError(f"object_id must be {NOT_RENDERED} to {HIGHEST_ID}, not {number}")
        geoms = [geom for name in names for geom in self._geoms(name)]
        self._give(geoms, number)
        return bool(geoms)

    def id(self, names: Iterable[str]) -> int:
        """Return the ID of the first of these objects and vehicles; -1 if there is none."""
        geoms = [geom for name in names for geom in self._geoms(name)]
        return int(self._all()[geoms[0]]) if geoms else NOT_RENDERED

    def spawned(self, name: str) -> None:
        """Give a new object the ID of its name."""
        self._give(self._geoms(name), id_of_name(name))

    def _geoms(self, name: str) -> list[int]:
        geom = self._objects.geom(name)
        for vehicle in self._world.vehicles if geom is None else []:
            if name == vehicle.name:
                own = np.flatnonzero(self._world.model.geom_bodyid == vehicle.body_id)
                return [int(part) for part in own]
        return [] if geom is None else [geom]


def id_of_name(name: str) -> int:
    """AirSim's ID of an object at the start: the sum of its name's letters."""
    return (5 + sum(ord(letter) for letter in name.lower() if ord(letter) >= ord("a"))) % (HIGHEST_ID + 1)


@cache
def colours() -> NDArray[np.uint8]:
    """Return the red, green and blue (256, 3) of each ID."""
    with asset("airsim/segmentation_colours.csv").open(encoding="ascii", newline="") as file:
        rows = [list(map(int, row.values())) for row in csv.DictReader(file)]
    return np.array(rows, np.uint8)
