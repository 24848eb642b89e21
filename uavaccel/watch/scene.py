"""MuJoCo's geoms as meshes of the page: what stands in the scene, its ground with its texture, and the drone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import trimesh
    from viser import ViserServer

SHOWN_GROUPS = 3  # MuJoCo draws groups 0 to 2; hulls are in 3
GROUND_PIXELS = 2048
PLANE_M = 100.0  # half of a plane that MuJoCo draws without an end
ROTOR_SECTIONS = 40
ZENITH, HORIZON = (120, 165, 215), (229, 238, 250)
Geom = mujoco.mjtGeom


def light_up(server: ViserServer) -> None:
    """Sky, sun and the sky's own light; without shadows and light from a picture, which need a GPU."""
    server.scene.configure_environment_map(hdri=None)
    server.scene.configure_default_lights(enabled=False)
    server.scene.add_light_hemisphere(
        "/light/sky", sky_color=HORIZON, ground_color=(110, 115, 105), intensity=2.2
    )
    server.scene.add_light_directional("/light/sun", intensity=2.4, position=(-30.0, -40.0, 60.0))
    share = np.linspace(0.0, 1.0, 64)[:, None, None]
    sky = (1.0 - share) * np.array(ZENITH) + share * np.array(HORIZON)
    server.scene.set_background_image(np.tile(sky, (1, 2, 1)).astype(np.uint8), format="png")


def show_surroundings(server: ViserServer, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """All that is not the vehicle, where `data` has it: one mesh, and a picture for each textured plane."""
    shown = [
        g for g in range(model.ngeom) if model.geom_group[g] < SHOWN_GROUPS and not _of_vehicle(model, g)
    ]
    solids = []
    for geom in shown:
        turn, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        if model.geom_type[geom] == Geom.mjGEOM_PLANE:
            _show_plane(server, model, geom, place)
        elif (mesh := geom_mesh(model, geom)) is not None:
            solids.append(_placed(mesh, turn, place))
    if solids:
        server.scene.add_mesh_trimesh("/scene", _joined(solids))


def show_drone(server: ViserServer, name: str, model: mujoco.MjModel) -> None:
    """The vehicle's own geoms, below the frame `name`."""
    parts = []
    for geom in range(model.ngeom):
        mesh = geom_mesh(model, geom) if _of_vehicle(model, geom) else None
        if mesh is not None and model.geom_group[geom] < SHOWN_GROUPS:
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
            parts.append(_placed(mesh, turn.reshape(3, 3), model.geom_pos[geom]))
    server.scene.add_mesh_trimesh(f"{name}/body", _joined(parts))


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
    """A geom's surface in its own frame, in its colour; None of kinds that are not drawn."""
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
    if kind in (Geom.mjGEOM_BOX, Geom.mjGEOM_CYLINDER):
        mesh.unmerge_vertices()  # else their edges would be shaded round
    mesh.visual = trimesh.visual.ColorVisuals(
        mesh, vertex_colors=np.tile([*colour_of(model, geom), 255], (len(mesh.vertices), 1))
    )
    return mesh


def _own_mesh(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    import trimesh

    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return trimesh.Trimesh(
        model.mesh_vert[first : first + count], model.mesh_face[face : face + faces], process=False
    )


def _of_vehicle(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.body_dofnum[model.geom_bodyid[geom]])


def _placed(mesh: trimesh.Trimesh, turn: NDArray[np.float64], place: NDArray[np.float64]) -> trimesh.Trimesh:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return mesh.apply_transform(pose)


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    import trimesh

    joined = trimesh.util.concatenate(meshes)
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def _show_plane(server: ViserServer, model: mujoco.MjModel, geom: int, place: NDArray[np.float64]) -> None:
    half_x, half_y = (float(half) or PLANE_M for half in model.geom_size[geom][:2])
    server.scene.add_image(
        f"/plane{geom}",
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
