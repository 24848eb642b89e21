"""What a page shows of a flight: MuJoCo's geoms as meshes, the ground with its texture, drones, paths, images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from uavaccel.draw.style import BLUE, VERMILION, bgr, dvs_picture
from uavaccel.kinematics import Vector
from uavaccel.sim.camera.camera import Camera
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.lane import APPEARANCE_GROUP
from uavaccel.units import ned_to_mujoco
from uavaccel.vision.dvs import DvsState, init_state, luma, step
from uavaccel.vision.dvs_sensor import DvsParameters, make_sensor

if TYPE_CHECKING:
    import trimesh
    from viser import LineSegmentsHandle, ViserServer

SHOWN_GROUPS = (0, 1, 2, APPEARANCE_GROUP)  # those that MuJoCo draws, and a scenery's appearance; hulls are in 3
DEEPEST_M = 50.0  # below the ground lies what a scene keeps for later
GROUND_PIXELS = 2048
HALF = 0.5  # of a texture, across a face
PLANE_M = 100.0  # half of a plane that MuJoCo draws without an end
ROTOR_SECTIONS = 40
SURROUNDINGS = "/surroundings"
ZENITH, HORIZON = (120, 165, 215), (229, 238, 250)
COMMANDED, THINKING, IDEAL = (
    bgr(BLUE)[::-1],
    bgr(VERMILION)[::-1],
    (245, 245, 245),
)  # colours of paths: red, green, blue
ARROW, PLUMB, SHADOW = (240, 180, 0), (25, 30, 25), (48, 54, 46)
PATH_WIDTH, PLUMB_WIDTH, IDEAL_WIDTH = 5.0, 1.5, 2.0  # pixels
ARROW_M, LABEL_M, SHADOW_M, LIFT_M = 0.7, 0.55, 0.32, 0.02
STANDING_M = 0.15  # nearer to the ground there is no plumb line
BLOCK, MOST_BLOCKS = 500, 100  # segments of a path that are sent together; older blocks are removed
LONGEST_S = 0.25  # simulated; beyond it the spectator has jumped, and the events begin anew
BLANK = np.full((2 * HEIGHT, WIDTH, 3), 246, np.uint8)  # images without events
Floats = NDArray[np.float64]
Geom = mujoco.mjtGeom


@dataclass(frozen=True)
class Scene:
    """A model and its data, as a flight's world has them, and the body of each of its drones, by name.

    The first view is of `centre_m`, in MuJoCo's frame, and `reach_m` around it; with `follows` it goes along with the
    first drone. Drones that were flown at one place are shown `apart_m` from each other, from west to east.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    bodies: Mapping[str, int]
    centre_m: Floats
    reach_m: float = 3.0
    follows: bool = True
    apart_m: float = 0.0


def pose_of(model: mujoco.MjModel, body: int) -> slice:
    """Where MuJoCo's `qpos` has place and attitude of a vehicle."""
    first = int(model.jnt_qposadr[model.body_jntadr[body]])
    return slice(first, first + 7)


def light_up(server: ViserServer) -> None:
    """Sky, sun and the sky's own light; without shadows and light from a picture, which need a GPU."""
    scene = server.scene
    scene.set_up_direction("+z")
    scene.configure_environment_map(hdri=None)
    scene.configure_default_lights(enabled=False)
    scene.add_light_ambient("/light/sky", color=HORIZON, intensity=1.4)
    scene.add_light_directional("/light/sun", intensity=2.4, position=(-30.0, -40.0, 60.0))
    share = np.linspace(0.0, 1.0, 64)[:, None, None]
    sky = (1.0 - share) * np.array(ZENITH) + share * np.array(HORIZON)
    scene.set_background_image(np.tile(sky, (1, 2, 1)).astype(np.uint8), format="png")


def show_surroundings(server: ViserServer, scene: Scene) -> None:
    """All that is not a vehicle, where the data have it, in place of what an earlier call has shown.

    Solids are one mesh for each colour; a plane is a picture.
    """
    model, data = scene.model, scene.data
    server.scene.remove_by_name(SURROUNDINGS)
    server.scene.add_frame(SURROUNDINGS, show_axes=False)
    stands = (model.body_dofnum[model.geom_bodyid] == 0) & (data.geom_xpos[:, 2] >= -DEEPEST_M)
    fixed = np.flatnonzero(stands & np.isin(model.geom_group, SHOWN_GROUPS)).tolist()
    _show_solids(server, f"{SURROUNDINGS}/solids", model, fixed, data.geom_xpos, data.geom_xmat)
    for geom in fixed:
        if model.geom_type[geom] == Geom.mjGEOM_PLANE:
            half_x, half_y = (float(half) or PLANE_M for half in model.geom_size[geom][:2])
            server.scene.add_image(
                f"{SURROUNDINGS}/plane{geom}",
                plane_picture(model, geom),
                2 * half_x,
                2 * half_y,
                position=data.geom_xpos[geom],
                format="jpeg",
                wxyz=(0.0, 1.0, 0.0, 0.0),
                receive_shadow=True,
            )


def _show_solids(
    server: ViserServer, name: str, model: mujoco.MjModel, geoms: Iterable[int], places: Floats, turns: Floats
) -> None:
    """Show the surfaces of geoms, one mesh for each colour; `places` (ngeom, 3) and `turns` (ngeom, 9) are theirs."""
    import trimesh

    by_colour: dict[tuple[int, ...], list[trimesh.Trimesh]] = {}
    for geom in geoms:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turns[geom].reshape(3, 3), places[geom]
        for mesh, colour in _striped(model, geom):
            by_colour.setdefault(tuple(colour.tolist()), []).append(mesh.apply_transform(pose))
    for number, ((red, green, blue), meshes) in enumerate(by_colour.items()):
        joined = trimesh.util.concatenate(meshes)
        assert isinstance(joined, trimesh.Trimesh)
        server.scene.add_mesh_simple(
            f"{name} {number}", joined.vertices, joined.faces, color=(red, green, blue), flat_shading=True
        )


def _striped(model: mujoco.MjModel, geom: int) -> Iterator[tuple[trimesh.Trimesh, NDArray[np.uint8]]]:
    """A geom's surfaces in its own frame with their colours: one, or its bands, if its faces show half a checker."""
    if (mesh := geom_mesh(model, geom)) is None:
        return
    material = int(model.geom_matid[geom])
    texture = _texture(model, material)
    wide, high = (1.0, 1.0) if material < 0 else model.mat_texrepeat[material].tolist()
    upright = Geom(int(model.geom_type[geom])) in (Geom.mjGEOM_BOX, Geom.mjGEOM_CYLINDER)
    if texture is None or wide != HALF or not upright:
        yield mesh, _colour(model, geom)
        return
    bands, (bottom, top) = round(2 * high), mesh.bounds[:, 2]
    colours = np.asarray(np.clip(texture[[-1, 0], 0] * model.mat_rgba[material][:3], 0, 255), np.uint8)  # from below
    band_m = (top - bottom) / bands
    for number in range(bands):
        band: trimesh.Trimesh = mesh.copy()
        band.vertices[:, 2] = bottom + band_m * (number + (band.vertices[:, 2] > 0.0))
        yield band, colours[number % 2]


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """A geom's surface in its own frame; None of kinds that are no solids."""
    import trimesh

    (a, b, c), shapes = model.geom_size[geom].tolist(), trimesh.creation

    def own() -> trimesh.Trimesh:
        mesh = int(model.geom_dataid[geom])
        vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
        vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
        return trimesh.Trimesh(vertices, model.mesh_face[face : face + int(model.mesh_facenum[mesh])], process=False)

    make = {
        Geom.mjGEOM_BOX: lambda: shapes.box((2 * a, 2 * b, 2 * c)),
        Geom.mjGEOM_SPHERE: lambda: shapes.icosphere(2, a),
        Geom.mjGEOM_ELLIPSOID: lambda: shapes.icosphere(2, 1.0).apply_scale((a, b, c)),
        Geom.mjGEOM_CYLINDER: lambda: shapes.cylinder(a, 2 * b, sections=ROTOR_SECTIONS),
        Geom.mjGEOM_CAPSULE: lambda: shapes.capsule(2 * b, a, count=(12, 12)),
        Geom.mjGEOM_MESH: own,
    }.get(Geom(int(model.geom_type[geom])))
    return None if make is None else make()


def plane_picture(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    """The whole of a plane: its texture as often as its material repeats it; its colour where it has none."""
    material = int(model.geom_matid[geom])
    if (texture := _texture(model, material)) is None:
        return np.tile(_colour(model, geom), (8, 8, 1))
    repeats = np.maximum(np.round(model.mat_texrepeat[material]), 1).astype(int)
    columns, rows = np.maximum(GROUND_PIXELS // repeats, 2).tolist()
    tile = np.asarray(Image.fromarray(texture).resize((columns, rows), Image.Resampling.BOX))
    tile = tile * model.mat_rgba[material][:3]
    return np.tile(np.asarray(np.clip(tile, 0, 255), np.uint8), (*repeats[::-1].tolist(), 1))


def _colour(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    """Red, green, blue: the geom's or its material's colour, times its texture's mean."""
    material = int(model.geom_matid[geom])
    rgb = np.array(model.geom_rgba[geom] if material < 0 else model.mat_rgba[material], float)[:3]
    if (texture := _texture(model, material)) is not None:
        rgb *= texture.reshape(-1, 3).mean(axis=0) / 255.0
    return np.asarray(np.clip(255.0 * rgb, 0, 255), np.uint8)


def _texture(model: mujoco.MjModel, material: int) -> NDArray[np.uint8] | None:
    """A material's colours (H, W, 3), the top row first; None without a texture of three channels."""
    texture = -1 if material < 0 else int(model.mat_texid[material][mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture < 0 or model.tex_nchannel[texture] != 3:
        return None
    height, width, first = (int(value[texture]) for value in (model.tex_height, model.tex_width, model.tex_adr))
    return np.asarray(model.tex_data[first : first + height * width * 3], np.uint8).reshape(height, width, 3)


class Drone:
    """A drone on the page: its body, its command's arrow, what is written above it, its shadow below, and its path.

    Poses are place in m and wxyz, in MuJoCo's frame; it is shown `aside_m` (3,) from there.
    """

    def __init__(self, server: ViserServer, name: str, scene: Scene, aside_m: Floats) -> None:
        self.height_m: float | None = None
        """To what is below it; None where nothing is."""
        self._page, self._name, self._scene, self._aside_m = server.scene, name, scene, aside_m
        self._blocks: list[LineSegmentsHandle] = []
        self._blocks_made = 0
        self._block: list[tuple[list[Floats], tuple[int, int, int]]] = []
        self._end_m: Floats | None = None
        add, model, body = self._page, scene.model, scene.bodies[name]
        self._frame = add.add_frame(f"/{name}", show_axes=False)
        turns = np.zeros((model.ngeom, 9))
        for turn, quaternion in zip(turns, model.geom_quat, strict=True):
            mujoco.mju_quat2Mat(turn, quaternion)
        own = np.flatnonzero((model.geom_bodyid == body) & np.isin(model.geom_group, SHOWN_GROUPS)).tolist()
        _show_solids(server, f"/{name}/body", model, own, model.geom_pos, turns)
        add.add_label(f"/{name}/name", name, position=(0.0, 0.0, LABEL_M))
        self._arrow = add.add_arrows(
            f"/{name} command", np.zeros((1, 2, 3)), ARROW, shaft_radius=0.025, head_radius=0.07, head_length=0.16
        )
        self._plumb = self._add_lines("plumb line", np.zeros((1, 2, 3)), PLUMB, PLUMB_WIDTH)
        # Opaque, as what shines through would be the sky, not the ground's picture; without the sun's highlight.
        self._shadow = add.add_cylinder(
            f"/{name} shadow", SHADOW_M, LIFT_M / 2, SHADOW, material="toon3", cast_shadow=False, receive_shadow=False
        )

    def begin(self, ideal_m: Floats | None) -> None:
        """Begin the path anew; along `ideal_m` (n, 3) is drawn a thin line, if it is given."""
        for block in self._blocks:
            block.remove()
        self._blocks, self._block, self._end_m = [], [], None
        if ideal_m is not None:
            line = ideal_m + self._aside_m
            self._add_lines("ideal", np.stack([line[:-1], line[1:]], axis=1), IDEAL, IDEAL_WIDTH)

    def go_to(self, place_m: Floats, commanded: bool) -> None:
        """Lengthen the path to a place, coloured by whether a command was running on the way."""
        place = place_m + self._aside_m
        if self._end_m is not None and not np.array_equal(place, self._end_m):
            if len(self._block) == BLOCK:
                self._send_block()
                self._block = []
            if not self._block:
                if len(self._blocks) == MOST_BLOCKS:
                    self._blocks.pop(0).remove()
                self._blocks_made += 1
                start = np.array([[self._end_m, self._end_m]])
                self._blocks.append(self._add_lines(f"path {self._blocks_made}", start, COMMANDED, PATH_WIDTH))
            self._block.append(([self._end_m, place], COMMANDED if commanded else THINKING))
        self._end_m = place

    def show(self, pose: Floats, towards_ned: Vector | None) -> None:
        """Move it, with an arrow along `towards_ned`, and send the path's last block to the browsers."""
        place = pose[:3] + self._aside_m
        self._frame.position, self._frame.wxyz = place, pose[3:]
        length = 0.0 if towards_ned is None else float(np.linalg.norm(towards_ned))
        self._arrow.visible = length > 0.0
        if towards_ned is not None and length > 0.0:
            self._arrow.points = np.array([[place, place + ARROW_M * ned_to_mujoco(towards_ned) / length]])
        model, data, body = self._scene.model, self._scene.data, self._scene.bodies[self._name]
        metres = mujoco.mj_ray(model, data, place, np.array([0.0, 0.0, -1.0]), None, 1, body, np.zeros(1, np.int32))
        self.height_m = None if metres < 0.0 else float(metres)
        self._shadow.visible = self.height_m is not None
        self._plumb.visible = self.height_m is not None and self.height_m > STANDING_M
        if self.height_m is not None:
            foot = place - np.array([0.0, 0.0, self.height_m - LIFT_M])
            self._shadow.position, self._plumb.points = foot, np.array([[place, foot]], np.float32)
        self._send_block()

    def _send_block(self) -> None:
        if self._block:
            points, colours = zip(*self._block, strict=True)
            self._blocks[-1].points = np.array(points, np.float32)
            self._blocks[-1].colors = np.repeat(as_light(colours)[:, None], 2, axis=1)

    def _add_lines(self, name: str, points: Floats, colour: tuple[int, int, int], width: float) -> LineSegmentsHandle:
        place, light = f"/{self._name} {name}", as_light(colour)
        return self._page.add_line_segments(
            place, points.astype(np.float32), light, thickness=width, thickness_units="screen"
        )


def as_light(colours: ArrayLike) -> NDArray[np.uint8]:
    """Colours (..., 3) of sRGB as amounts of light, which viser takes those of lines for."""
    share = np.asarray(colours, float) / 255.0
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    return np.asarray(np.rint(255.0 * light), np.uint8)


class Eyes:
    """What a drone's front camera and an event camera beside it see in a scene in which nothing flies.

    The drone is the one whose pose is `data.qpos[pose]`.
    """

    def __init__(self, camera: Camera, data: mujoco.MjData, pose: slice) -> None:
        self._camera, self._data, self._pose = camera, data, pose
        self._sensor = make_sensor(DvsParameters(), (HEIGHT, WIDTH), seed=0)
        self._state: DvsState | None = None
        self._began_s, self._seen_s = 0.0, 0.0
        self._events = BLANK[:HEIGHT]

    def render(self, pose: Floats, time_s: float) -> NDArray[np.uint8]:
        """Return the camera's image above the events since the last one, RGB; `pose` (7,) is in MuJoCo's frame."""
        self._data.qpos[self._pose] = pose
        image = self._camera.colour(self._data)
        frame, passed_s = luma(image), time_s - self._seen_s
        if self._state is None or not 0.0 <= passed_s < LONGEST_S:
            self._state, self._began_s = init_state(self._sensor, frame), time_s
        elif passed_s > 0.0:  # while the clock is paused, nothing changes
            self._state, on, off = step(self._sensor, self._state, frame, time_s - self._began_s)
            self._events = np.ascontiguousarray(dvs_picture(on, off)[..., ::-1])
        self._seen_s = time_s
        return np.vstack([image, self._events])
