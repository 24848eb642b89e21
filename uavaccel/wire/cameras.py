"""The cameras of a vehicle: AirSim's five and those of the settings, with their mounts and lenses.

Sources: AirSim v1.8.1, AirSimSettings.hpp (keys and defaults), FlyingPawn.cpp (names), BP_FlyingPawn.uasset (mounts).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from uavaccel.sim.camera.camera import FRONT_CENTER, Lens
from uavaccel.sim.poses import Pose, from_degrees
from uavaccel.sim.sensors import AirSimKeys
from uavaccel.sim.vehicle.vehicle import Vehicle

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
Pixels = Annotated[int, Field(ge=1, le=8192)]
NARROWEST_DEG, WIDEST_DEG = 0.1, 179.0  # fields of view that a projection can have


class CaptureSettings(AirSimKeys):
    """The lens for one type of image."""

    image_type: Annotated[int, Field(ge=-1, le=9)] = SCENE
    """AirSim's number of the type; -1 is the view of its window."""
    width: Pixels = Lens().width
    height: Pixels = Lens().height
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
            fov_deg = lens.fov_deg if given.fov_degrees is None else given.fov_degrees
            sizes = given.model_fields_set
            width = given.width if "width" in sizes else lens.width
            height = given.height if "height" in sizes else lens.height
            lenses[given.image_type] = Lens(width, height, fov_deg)
        return lenses

    def mount(self, before: Pose) -> Pose:
        """Return the mount on the vehicle, on the basis of the mount `before`."""
        place = [
            old if new is None else new for new, old in zip((self.x, self.y, self.z), before.position_m, strict=True)
        ]
        angles = (self.roll, self.pitch, self.yaw)
        turned = any(angle is not None for angle in angles)
        attitude = from_degrees(*(angle or 0.0 for angle in angles)) if turned else before.orientation_wxyz
        return Pose((place[0], place[1], place[2]), attitude)


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
        """Set the field of view of all types of image, as AirSim does."""
        types = {SCENE, *range(10), *self.lenses}
        self.lenses = {kind: self.lens(kind)._replace(fov_deg=fov_deg) for kind in types}


class Cameras:
    """Cameras by name: a vehicle's, or those of ExternalCameras. `defaults` apply to each `given` one."""

    def __init__(
        self, defaults: CameraSettings, given: Mapping[str, CameraSettings], external: bool = False, carrier: int = 0
    ) -> None:
        lenses = defaults.lenses({})
        mounts = {} if external else MOUNTS
        self._cameras = {
            name: CameraMount(name, mount, dict(lenses), carrier=carrier) for name, mount in mounts.items()
        }
        for alias, settings in given.items():
            name = full_name(alias)
            before = self._cameras.get(name) or CameraMount(name, Pose(), dict(lenses))
            mount, own = settings.mount(before.mount), settings.lenses(before.lenses)
            self._cameras[name] = CameraMount(name, mount, own, external, carrier)

    def named(self, name: object) -> CameraMount:
        """Return the camera of a client's name for it. Raises ValueError if there is none."""
        found = self._cameras.get(full_name(str(name)))
        if found is None:
            numbers = {full: number for number, full in ALIASES.items() if number.isdecimal()}
            known = [f"{full} ({numbers[full]})" if full in numbers else full for full in self._cameras]
            raise ValueError(f"no camera '{name}'; there are {', '.join(known) or 'none'}")
        return found

    def lenses(self) -> list[Lens]:
        """Return all lenses of all cameras."""
        return [Lens(), *(lens for camera in self._cameras.values() for lens in camera.lenses.values())]


def full_name(name: str) -> str:
    """Return the camera's name for one of AirSim's numbers or short names."""
    return ALIASES.get(name, name)
