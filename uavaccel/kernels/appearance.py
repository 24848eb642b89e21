"""The appearance of a lane, read from its MuJoCo model as OpenGL receives it, and the visible geometry of layouts.

Textures, materials, camera, sky, walls and ground come from the model, mipmaps are computed as glGenerateMipmap does.
The layout determines obstacles, their textures and the sunlight, as in sim/lane.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.kernels import fields as at
from uavaccel.kernels.bodies import KINDS, SOLIDS, visible, worn
from uavaccel.kernels.fields import NO_APPEARANCE, Appearance, Looks, Operand, Scenes
from uavaccel.kernels.fields import empty_scenes as empty_scenes
from uavaccel.sim.camera.view import HEIGHT, WIDTH, far_m, is_pinhole
from uavaccel.sim.lane import (
    GROUND_TEXTURES,
    OBSTACLE_HALF_HEIGHT_M,
    OBSTACLE_TEXTURES,
    WALL_TEXTURES,
    LaneLayout,
    object_name,
    obstacle_geoms,
    sunlight,
)
from uavaccel.sim.scene import DRONE_GROUP, PLAIN, QUADROTOR

NEAREST_M = 0.5  # up to which OpenGL may clip what rays see
WORN = (("obstacle", OBSTACLE_TEXTURES), ("wall", WALL_TEXTURES), ("ground", GROUND_TEXTURES))


def read_appearance(model: mujoco.MjModel, camera: str = "front_center") -> Appearance:
    """Read the appearance of a model's lanes. Raises UserError if the kernels cannot render it as OpenGL would."""
    obstacles = obstacle_geoms(model)
    if not len(obstacles):
        raise UserError("simulator: kernels draws the obstacle lane alone; other scenes need simulator: mujoco")
    _check(model, obstacles)
    texels, textures, of_texture = _textures(model)
    materials = _materials(model, of_texture)
    fixed = [
        [*model.geom_pos[geom], *model.geom_size[geom], KINDS[int(model.geom_type[geom])], model.geom_matid[geom]]
        for geom in _visible(model)
        if geom not in obstacles
    ]
    wearing = np.zeros((3, 4), np.int32)
    for row, (kind, names) in zip(wearing, WORN, strict=True):
        row[: len(names)] = [model.material(f"{kind}_{name}").id for name in names]
    return Appearance(texels, textures, materials, _camera(model, camera), np.array(fixed, np.float32), wearing)


def read_looks(model: mujoco.MjModel, size: tuple[int, int], depth: bool, camera: str = "front_center") -> Looks:
    """Read how a still scene is seen in pictures of a size, columns and rows; of `depth`, or in colours.

    Raises UserError for colours that would not be OpenGL's.
    """
    seen, light = _camera(model, camera, size), np.zeros(9, np.float32)
    if seen[at.NEAR_M] > NEAREST_M:
        raise UserError(
            f"simulator: kernels draws what is near, but znear x extent is {seen[at.NEAR_M]:.2g} m in this scene: "
            f'let <visual><map znear="..."/></visual> make it at most {NEAREST_M} m'
        )
    if depth:
        return Looks(seen, light, *NO_APPEARANCE[:3])
    sun, data = _sun(model), mujoco.MjData(model)
    texels, textures, of_texture = _textures(model)
    materials = _materials(model, {-1: 0} | of_texture)
    _check_worn(model, materials)
    mujoco.mj_kinematics(model, data)
    shining = data.xmat[model.light_bodyid[sun]].reshape(3, 3) @ model.light_dir[sun]
    light[at.AMBIENT : at.DIFFUSE], light[at.DIFFUSE : at.TOWARDS] = model.light_ambient[sun], model.light_diffuse[sun]
    light[at.TOWARDS :] = -shining / np.linalg.norm(shining)
    return Looks(seen, light, texels, textures, materials)


def fill_scenes(appearance: Appearance, scenes: Scenes, lanes: Sequence[int], layouts: Sequence[LaneLayout]) -> None:
    """Write the geometry and light of several lanes. Raises UserError for a scenery other than the plain one."""
    for lane, layout in zip(lanes, layouts, strict=True):
        if layout.scenery != PLAIN:
            raise UserError(
                f"scenery: simulator: kernels draws {PLAIN!r} alone; {layout.scenery!r} needs simulator: mujoco"
            )
        count, solids = len(layout), scenes.solids[lane]
        posts, fixed = solids[:count], solids[count : count + len(appearance.fixed)]
        posts[:, 0], posts[:, 1], posts[:, 2] = layout.x_m, -layout.y_m, OBSTACLE_HALF_HEIGHT_M
        posts[:, 3] = posts[:, 4] = layout.half_width_m
        posts[:, 5], posts[:, at.KIND] = OBSTACLE_HALF_HEIGHT_M, layout.round  # BOX, CYLINDER
        posts[:, at.MATERIAL] = appearance.wearing[0, layout.texture]
        fixed[:] = appearance.fixed
        plane = appearance.fixed[:, at.KIND] == at.PLANE
        fixed[:, at.MATERIAL] = np.where(
            plane, appearance.wearing[2, layout.ground_texture], appearance.wearing[1, layout.wall_texture]
        )
        scenes.counts[lane] = count + len(appearance.fixed)
        direction, ambient, diffuse = sunlight(layout)
        scenes.lights[lane, :3], scenes.lights[lane, 3:6] = ambient, diffuse
        scenes.lights[lane, 6:] = -direction


def _visible(model: mujoco.MjModel) -> list[int]:
    """Return the geoms that the drone's camera may see."""
    return [geom for geom in range(model.ngeom) if model.geom_group[geom] not in (DRONE_GROUP, 3)]


def _check(model: mujoco.MjModel, obstacles: NDArray[np.int64]) -> None:
    """Raise UserError for the first part of a model that is not rendered here as OpenGL would."""
    for geom in _visible(model):
        name, kind = model.geom(geom).name, int(model.geom_type[geom])
        turned = not np.allclose(model.geom_quat[geom], (1, 0, 0, 0)) or model.geom_bodyid[geom] != 0
        if geom not in obstacles and (KINDS.get(kind) not in SOLIDS or turned):
            raise UserError(f"geom {name!r}: simulator: kernels draws upright boxes, cylinders and planes of the world")
    _sun(model)
    if model.vis.quality.numslices != at.SLICES:
        raise UserError(f"simulator: kernels draws cylinders with {at.SLICES} slices")


def _check_worn(model: mujoco.MjModel, materials: NDArray[np.float32]) -> None:
    """Raise UserError for what is half transparent, and for textures on planes without an end."""
    colours = worn(model)
    for geom in visible(model).tolist():
        material, endless = model.geom_matid[geom], not model.geom_size[geom, :2].all()
        textured = material >= 0 and materials[material, at.TEXTURE_ID] > 0
        if colours[geom, 3] < 1:
            raise UserError(
                f"simulator: kernels draws nothing transparent: {object_name(model, geom)} has an alpha < 1"
            )
        if textured and endless and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            raise UserError(
                f"simulator: kernels draws textures on finite planes: give {object_name(model, geom)} a size"
            )


def _sun(model: mujoco.MjModel) -> int:
    """Return the only light of a model. Raises UserError for others, and for gloss."""
    of_drone = model.body_rootid[model.light_bodyid] == model.body(QUADROTOR).id
    suns = [light for light in range(model.nlight) if model.light_active[light]]
    headlight = model.vis.headlight
    if len(suns) != 1 or model.light_type[suns[0]] != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
        raise UserError("simulator: kernels draws with one directional light, the sun")
    if headlight.active and np.any([headlight.ambient, headlight.diffuse, headlight.specular]):
        raise UserError("simulator: kernels draws without a headlight: let its colours be 0 0 0")
    if model.light_mode[suns[0]] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED or of_drone[suns[0]]:
        raise UserError("simulator: kernels draws with a sun that stands still: let it be of the world, and fixed")
    if np.any(model.light_specular[suns]) or np.any(model.mat_reflectance):
        raise UserError("simulator: kernels draws without gloss: let the sun's specular and each reflectance be 0")
    return suns[0]


def _materials(model: mujoco.MjModel, of_texture: dict[int, int]) -> NDArray[np.float32]:
    """Return the materials (m, 8). Raises UserError for other textures than these."""
    materials = np.zeros((model.nmat, 8), np.float32)
    for index in range(model.nmat):
        texture = int(model.mat_texid[index, mujoco.mjtTextureRole.mjTEXROLE_RGB])
        if texture not in of_texture:
            raise UserError(f"material {model.material(index).name!r}: simulator: kernels draws 2d textures alone")
        how = *model.mat_texrepeat[index], model.mat_texuniform[index], model.mat_emission[index]
        materials[index] = *model.mat_rgba[index, :3], of_texture[texture], *how
    return materials


def _camera(model: mujoco.MjModel, name: str, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.float64]:
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
    own = camera >= 0 and model.cam_bodyid[camera] == model.body(QUADROTOR).id
    if not (own and is_pinhole(model, camera)):
        raise UserError(f"camera {name!r}: simulator: kernels draws what a fixed camera of the drone sees, with a fovy")
    high = float(np.tan(np.radians(model.cam_fovy[camera]) / 2))
    wide = high * WIDTH / HEIGHT  # the same for pictures of all sizes, as in sim/camera/view
    if size[0] * HEIGHT != size[1] * WIDTH:
        high = wide * size[1] / size[0]
    near = float(model.vis.map.znear * model.stat.extent)
    place, axes = model.cam_pos[camera], model.cam_mat0[camera]
    return np.array([*place, *axes, wide, high, near, far_m(model)], np.float64)


def _textures(model: mujoco.MjModel) -> tuple[NDArray[np.uint32], NDArray[np.int32], dict[int, int]]:
    """Return texels, the rows of Appearance.textures, and the row of each 2d texture."""
    texels: list[NDArray[np.uint32]] = []
    rows: list[tuple[int, int]] = []
    of_texture: dict[int, int] = {}
    base = 0
    skies = [texture for texture in range(model.ntex) if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX]
    flat = [texture for texture in range(model.ntex) if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D]
    if not skies:
        raise UserError("simulator: kernels draws scenes with a sky: give the model a skybox texture")
    for texture in [skies[0], *flat]:
        data = _texture_data(model, texture)
        width = data.shape[1]
        if texture != skies[0]:
            of_texture[texture] = len(rows)
            padded = (np.pad(level, ((0, 0), (0, width - level.shape[1]), (0, 0))) for level in mipmaps(data))
            data = np.concatenate(list(padded))
        rows.append((base, width.bit_length() - 1))
        packed = data.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16], np.uint32)
        texels.append(packed.ravel())
        base += packed.size
    return np.concatenate(texels).astype(np.uint32), np.array(rows, np.int32), of_texture


def _texture_data(model: mujoco.MjModel, texture: int) -> NDArray[np.uint8]:
    """Return a texture as uploaded to OpenGL, (height, width, 3). Raises UserError for unsupported formats."""
    height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
    address, name = int(model.tex_adr[texture]), model.texture(texture).name
    sky = model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX
    shape = (width, height // 6 if sky else height)
    if model.tex_nchannel[texture] != 3 or model.tex_colorspace[texture] == mujoco.mjtColorSpace.mjCOLORSPACE_SRGB:
        raise UserError(f"texture {name!r}: simulator: kernels draws linear red, green and blue")
    if width & (width - 1) or shape[0] != shape[1]:
        raise UserError(f"texture {name!r}: simulator: kernels draws squares with sides of a power of two")
    return np.asarray(model.tex_data[address : address + 3 * width * height]).reshape(height, width, 3)


def mipmaps(data: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Return all mipmap levels of a texture (height, width, 3) whose sides are powers of two.

    Neighbours are averaged across, then down, each time rounding halves up, as llvmpipe's glGenerateMipmap does.
    """
    levels = [data]
    while max(levels[-1].shape[:2]) > 1:
        level: Operand = levels[-1].astype(np.uint16)
        if level.shape[1] > 1:
            level = (level[:, 0::2] + level[:, 1::2] + 1) >> 1
        if level.shape[0] > 1:
            level = (level[0::2] + level[1::2] + 1) >> 1
        levels.append(level.astype(np.uint8))
    return levels
