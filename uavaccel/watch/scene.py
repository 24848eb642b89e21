"""MuJoCo's geoms as meshes of the page: what stands in the scene, its ground with its texture, and the drone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.lane.scene import APPEARANCE_GROUP

if TYPE_CHECKING:
    import trimesh
    from viser import ViserServer

SHOWN_GROUPS = (0, 1, 2, APPEARANCE_GROUP)  # those that MuJoCo draws, and a scenery's looks; hulls are in 3
DEEPEST_M = 50.0  # below the ground lies what a scene keeps for later
GROUND_PIXELS = 2048
PLANE_M = 100.0  # half of a plane that MuJoCo draws without an end
ROTOR_SECTIONS = 40
SURROUNDINGS = "/surroundings"
ZENITH, HORIZON = (120, 165, 215), (229, 238, 250)
Geom = mujoco.mjtGeom


def light_up(server: ViserServer) -> None:
    """Sky, sun and the sky's own light; without shadows and light from a picture, which need a GPU."""
    server.scene.configure_environment_map(hdri=None)
    server.scene.configure_default_lights(enabled=False)
    server.scene.add_light_ambient("/light/sky", color=HORIZON, intensity=1.4)
    server.scene.add_light_directional("/light/sun", intensity=2.4, position=(-30.0, -40.0, 60.0))
    share = np.linspace(0.0, 1.0, 64)[:, None, None]
    sky = (1.0 - share) * np.array(ZENITH) + share * np.array(HORIZON)
    server.scene.set_background_image(np.tile(sky, (1, 2, 1)).astype(np.uint8), format="png")


def show_surroundings(server: ViserServer, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """All that is not a vehicle, where `data` has it: one mesh, and a picture for each textured plane.

    What an earlier call has shown is removed.
    """
    server.scene.remove_by_name(SURROUNDINGS)
    server.scene.add_frame(SURROUNDINGS, show_axes=False)
    solids = []
    for geom in range(model.ngeom):
        turn, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        if not _is_drawn(model, geom) or _of_vehicle(model, geom) or place[2] < -DEEPEST_M:
            continue
        if model.geom_type[geom] == Geom.mjGEOM_PLANE:
            _show_plane(server, model, geom, place)
        elif (mesh := geom_mesh(model, geom)) is not None:
            solids.append((colour_of(model, geom), _placed(mesh, turn, place)))
    _show_solids(server, f"{SURROUNDINGS}/solids", solids)


def show_drone(server: ViserServer, name: str, model: mujoco.MjModel, body: int) -> None:
    """A vehicle's own geoms, below the frame `name`."""
    parts = []
    for geom in range(model.ngeom):
        mesh = geom_mesh(model, geom) if model.geom_bodyid[geom] == body else None
        if mesh is not None and _is_drawn(model, geom):
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
            placed = _placed(mesh, turn.reshape(3, 3), model.geom_pos[geom])
            parts.append((colour_of(model, geom), placed))
    _show_solids(server, f"{name}/body", parts)


def colour_of(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    """Red, green, blue: the geom's or its material's colour, times its texture's mean."""
    material = int(model.geom_matid[geom])
    rgb = np.array(model.geom_rgba[geom][:3], float)
    if material >= 0:
        rgb = np.array(model.mat_rgba[material][:3], float)
        texture = texture_of(model, material)
        if texture is not None:
            rgb = rgb * texture.reshape(-1, 3).mean(axis=0) / 255.0
    return np.asarray(np.clip(255.0 * rgb, 0, 255), np.uint8)


def texture_of(model: mujoco.MjModel, material: int) -> NDArray[np.uint8] | None:
    """A material's colours (H, W, 3), the top row first; None without a texture of three channels."""
    texture = int(model.mat_texid[material][mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture < 0 or model.tex_nchannel[texture] != 3:
        return None
    height, width, first = (int(each[texture]) for each in (model.tex_height, model.tex_width, model.tex_adr))
    pixels = model.tex_data[first : first + height * width * 3]
    return np.asarray(pixels, np.uint8).reshape(height, width, 3)


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """A geom's surface in its own frame; None of kinds that are not drawn."""
    import trimesh

    kind, (a, b, c) = model.geom_type[geom], model.geom_size[geom].tolist()
    if kind == Geom.mjGEOM_BOX:
        mesh = trimesh.creation.box((2 * a, 2 * b, 2 * c))
    elif kind == Geom.mjGEOM_SPHERE:
        mesh = trimesh.creation.icosphere(2, a)
    elif kind == Geom.mjGEOM_ELLIPSOID:
        mesh = trimesh.creation.icosphere(2, 1.0).apply_scale((a, b, c))
    elif kind == Geom.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(a, 2 * b, sections=ROTOR_SECTIONS)
    elif kind == Geom.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(2 * b, a, count=(12, 12))
    elif kind == Geom.mjGEOM_MESH:
        mesh = _own_mesh(model, int(model.geom_dataid[geom]))
    else:
        return None
    return mesh


def _own_mesh(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    import trimesh

    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return trimesh.Trimesh(model.mesh_vert[first : first + count], model.mesh_face[face : face + faces], process=False)


def pose_of(model: mujoco.MjModel, body: int) -> slice:
    """Where MuJoCo's `qpos` has place and attitude of a vehicle."""
    first = int(model.jnt_qposadr[model.body_jntadr[body]])
    return slice(first, first + 7)


def ground_below(model: mujoco.MjModel, data: mujoco.MjData, place: NDArray[np.float64], body: int) -> float | None:
    """The height of what is straight below a place, the vehicle's own body left out; None where nothing is."""
    hit = np.zeros(1, np.int32)
    down = np.array([0.0, 0.0, -1.0])
    metres = mujoco.mj_ray(model, data, place, down, None, 1, body, hit)
    return None if metres < 0.0 else float(place[2] - metres)


def _is_drawn(model: mujoco.MjModel, geom: int) -> bool:
    return model.geom_group[geom] in SHOWN_GROUPS


def _of_vehicle(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.body_dofnum[model.geom_bodyid[geom]])


def _placed(mesh: trimesh.Trimesh, turn: NDArray[np.float64], place: NDArray[np.float64]) -> trimesh.Trimesh:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return mesh.apply_transform(pose)


def _show_solids(server: ViserServer, name: str, solids: Sequence[tuple[NDArray[np.uint8], trimesh.Trimesh]]) -> None:
    """Show coloured surfaces, one mesh for each colour."""
    import trimesh

    by_colour: dict[tuple[int, ...], list[trimesh.Trimesh]] = {}
    for colour, mesh in solids:
        by_colour.setdefault(tuple(colour.tolist()), []).append(mesh)
    for number, ((red, green, blue), meshes) in enumerate(by_colour.items()):
        joined = trimesh.util.concatenate(meshes)
        assert isinstance(joined, trimesh.Trimesh)
        server.scene.add_mesh_simple(
            f"{name} {number}", joined.vertices, joined.faces, color=(red, green, blue), flat_shading=True
        )


def _show_plane(server: ViserServer, model: mujoco.MjModel, geom: int, place: NDArray[np.float64]) -> None:
    half_x, half_y = (float(half) or PLANE_M for half in model.geom_size[geom][:2])
    server.scene.add_image(
        f"{SURROUNDINGS}/plane{geom}",
        plane_picture(model, geom),
        2 * half_x,
        2 * half_y,
        position=place,
        format="jpeg",
        wxyz=(0.0, 1.0, 0.0, 0.0),
        receive_shadow=True,
    )


def plane_picture(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    """The whole of a plane: its texture as often as its material repeats it; its colour where it has none."""
    material = int(model.geom_matid[geom])
    texture = texture_of(model, material) if material >= 0 else None
    if texture is None:
        return np.tile(colour_of(model, geom), (8, 8, 1))
    repeats = np.maximum(np.round(model.mat_texrepeat[material]), 1).astype(int)
    tile = np.maximum(GROUND_PIXELS // repeats, 2)
    small = cv2.resize(texture, (int(tile[0]), int(tile[1])), interpolation=cv2.INTER_AREA)
    tinted = small * model.mat_rgba[material][:3]
    return np.tile(np.asarray(np.clip(tinted, 0, 255), np.uint8), (int(repeats[1]), int(repeats[0]), 1))
