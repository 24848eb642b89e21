"""The MuJoCo model of a scene, with one quadrotor or several.

For AirSim's clients the ground extends to the horizon, and spare geoms stand by for objects that they spawn;
NAME_airsim.xml replaces NAME.xml if it exists. The experiments fly the scene without these changes.

A quadrotor of MJCF must be one free body with inertia about its own axes: the hot loop flies it without MuJoCo where
nothing can be touched, and what that cannot fly exactly is refused here.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.errors import UserError
from uavaccel.resources import asset, scene_file

PLAIN = "plain"  # the scenery of assets/mjcf/NAME.xml; others have a folder there
QUADROTOR = "quadrotor"
TOUCH = "collision"  # its sensor of contacts
DRONE_GROUP = 1  # of quadrotor.xml's visible geoms, which its own camera does not render
OTHERS_GROUP = 2  # of other quadrotors' visible geoms
SPARE = "spare_"  # prefix of the names of geoms for spawned objects
SPARES = 64
PARKED_M = (0.0, 0.0, -500.0)  # below the ground, out of reach
GROUND_HALF_M = 10_000.0
NEAR_M, FAR_M = 0.05, 20_000.0  # clipping planes


def scene_path(scene: str, scenery: str = PLAIN) -> Path:
    """Return the file of a scene in a scenery. Raises UserError if there is none."""
    plain = scene_file(scene)
    path = plain if scenery == PLAIN else plain.parent / scenery / plain.name
    if not path.is_file():
        raise UserError(f"scenery = {scenery}: the scene {scene} has none of that name")
    return path


def load_scene(scene: str, others: Sequence[str] = (), airsim: bool = False, scenery: str = PLAIN) -> mujoco.MjModel:
    """Load a scene of assets/mjcf with its quadrotor, and one more for each prefix in `others`.

    `airsim` prepares it for AirSim's clients. Raises UserError for an unknown scene, for one that MuJoCo refuses, and
    for one without a quadrotor or with one that cannot be flown exactly.
    """
    path = scene_path(scene, scenery)
    try:
        model = _compiled(path, others, airsim)
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, QUADROTOR) < 0:
            raise ValueError(f'has no quadrotor: needs <include file="{QUADROTOR}.xml"/>')
        names = [QUADROTOR, *(prefix + QUADROTOR for prefix in others)]
        check_airframes(model, mujoco.MjSpec.from_file(str(path)), names)
    except ValueError as error:
        raise UserError(f"{path}: {' '.join(str(error).split())}") from error
    return model


def _compiled(path: Path, others: Sequence[str], airsim: bool) -> mujoco.MjModel:
    """Return the model of a scene's file. Raises ValueError where it is no MJCF that MuJoCo compiles."""
    if not (others or airsim):
        return mujoco.MjModel.from_xml_path(str(path))
    spec = airsim_spec(path) if airsim else mujoco.MjSpec.from_file(str(path))
    for prefix in others:  # with which the names of another quadrotor begin; existing elements keep their ids
        quadrotor = mujoco.MjSpec.from_file(str(asset(f"mjcf/{QUADROTOR}.xml")))
        for geom in quadrotor.geoms:
            geom.group = OTHERS_GROUP if geom.group == DRONE_GROUP else geom.group
        spec.attach(quadrotor, frame=spec.worldbody.add_frame(), prefix=prefix)
    return compiled_for_clients(spec) if airsim else spec.compile()


def airsim_spec(scene: Path) -> mujoco.MjSpec:
    """Make the scene in a file for AirSim's clients, for `compiled_for_clients`."""
    own = scene.with_name(f"{scene.stem}_airsim.xml")
    path = own if own.exists() else scene
    plain, spec = mujoco.MjModel.from_xml_path(str(path)), mujoco.MjSpec.from_file(str(path))
    wide: set[str] = set()
    for body in spec.bodies:
        body.mocap = False  # what only a program would move is an object as others are
    for geom in spec.geoms:
        if geom.name.startswith(SPARE):
            raise ValueError(f'geom "{geom.name}": names with "{SPARE}" are those of spare geoms; give it another')
    for geom in spec.worldbody.geoms:  # planes extend to the horizon; their textures keep their scale
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE and geom.size[0] > 0 and geom.size[1] > 0:  # others have no end
            times = GROUND_HALF_M / geom.size[0]
            geom.size = [GROUND_HALF_M, GROUND_HALF_M * geom.size[1] / geom.size[0], GROUND_HALF_M]
            material = spec.material(geom.material)
            if material is not None and not material.texuniform and material.name not in wide:
                wide.add(material.name)
                material.texrepeat = [repeat * times for repeat in material.texrepeat]
    box, half_m, grey = mujoco.mjtGeom.mjGEOM_BOX, [0.5, 0.5, 0.5], [0.6, 0.6, 0.6, 0.0]
    for number in range(SPARES):
        name = f"{SPARE}{number:02}"
        spec.worldbody.add_geom(name=name, type=box, size=half_m, pos=PARKED_M, rgba=grey, contype=0, conaffinity=0)
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 24, 12  # spawned spheres are round
    spec.stat.extent, spec.stat.center = plain.stat.extent, plain.stat.center
    spec.visual.map.znear, spec.visual.map.zfar = NEAR_M / plain.stat.extent, FAR_M / plain.stat.extent
    return spec


def compiled_for_clients(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model whose still geoms are the world's, as objects are, and all of which can be met by rays.

    MuJoCo omits geoms without contacts from its trees of boxes, outside of which it looks for nothing, unless they have
    contacts while it compiles. A drone's looks are within its hull.
    """
    drone = spec.body(QUADROTOR)
    if drone is None or not drone.bodies:  # MuJoCo would add their masses to the drone's
        for body in spec.worldbody.bodies:
            _name_geoms(spec, body)
        spec.compiler.fusestatic = True
    bare = [geom for geom in spec.geoms if not (geom.contype or geom.conaffinity)]
    bare = [geom for geom in bare if not geom.parent.name.endswith(QUADROTOR)]
    for geom in bare:
        geom.contype = 1
    model = spec.compile()
    model.geom_contype[[geom.id for geom in bare]] = 0
    return model


def _name_geoms(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Name a body's geoms without a name, and its children's, after it, as far as these names are free."""
    if body.name.endswith(QUADROTOR):
        return
    nameless = [geom for geom in body.geoms if not geom.name]
    for number, geom in enumerate(nameless if body.name and not body.name.startswith(SPARE) else ()):
        name = f"{body.name}_{number}" if number else body.name
        geom.name = "" if spec.geom(name) else name
    for child in body.bodies:
        _name_geoms(spec, child)


def refit_bounding_boxes(model: mujoco.MjModel, moved: Collection[int]) -> None:
    """Refit the world body's bounding-volume tree, which MuJoCo builds only once, to the geoms `moved`.

    Nodes precede their children, hence the reverse order.
    """
    first, count = int(model.body_bvhadr[0]), int(model.body_bvhnum[0])
    boxes, children = model.bvh_aabb[first:], model.bvh_child[first:]
    for node in reversed(range(count)):
        geom = int(model.bvh_nodeid[first + node])
        if geom < 0:
            low = (boxes[children[node], :3] - boxes[children[node], 3:]).min(axis=0)
            high = (boxes[children[node], :3] + boxes[children[node], 3:]).max(axis=0)
            boxes[node] = np.concatenate([(low + high) / 2, (high - low) / 2])
        elif geom in moved:
            boxes[node] = _box(model, geom)


def _box(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    """Return centre and half sizes (6,) of a geom's box along the axes of its body."""
    turn, own = _matrix(model.geom_quat[geom]), model.geom_aabb[geom]
    return np.concatenate([model.geom_pos[geom] + turn @ own[:3], np.abs(turn) @ own[3:]])


def _matrix(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


def copy_objects(old: mujoco.MjModel, new: mujoco.MjModel) -> None:
    """Copy the world's geoms as they are into a model with more vehicles, where they have the same ids."""
    geoms = np.flatnonzero(old.geom_bodyid == 0)
    copied = ("pos", "quat", "size", "type", "aabb", "rbound", "rgba", "matid", "contype", "conaffinity", "sameframe")
    for name in copied:
        getattr(new, f"geom_{name}")[geoms] = getattr(old, f"geom_{name}")[geoms]
    refit_bounding_boxes(new, set(geoms.tolist()))


PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION)


def physics_state(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """Return MuJoCo's integration state."""
    values = np.empty(mujoco.mj_stateSize(model, PHYSICS))
    mujoco.mj_getState(model, data, values, PHYSICS)
    return values


def restore_physics(model: mujoco.MjModel, data: mujoco.MjData, values: ArrayLike) -> None:
    """Restore what `physics_state` returned, and update the positions of all bodies."""
    mujoco.mj_setState(model, data, np.asarray(values, float), PHYSICS)
    mujoco.mj_kinematics(model, data)


GRAVITY_M_S2 = (0.0, 0.0, -9.80665)
ALIGNED = 1e-9  # of the largest inertia: a smaller product of inertia comes from rounding
SAME = 1e-9  # of an acceleration
RIGHT = 'needs <inertial pos="0 0 0" mass="..." diaginertia="..."/>'


def check_airframes(model: mujoco.MjModel, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
    """Raise ValueError, which names body and attribute, for a quadrotor of `names` that cannot be flown exactly.

    So it does for any other body that can move: flights between contacts do not step it.
    `spec` is that of the first one's scene. A full inertia without products is written about the body's axes in the
    model, where MuJoCo has it about axes of its own order.
    """
    bodies = [int(model.body(name).id) for name in names]
    _check_masses(model, spec, names[0], bodies)
    _check_meetings(model, bodies)
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        raise ValueError('option: integrator must be "Euler", with which drones are flown')
    turned = [_align(model, body, name) for body, name in zip(bodies, names, strict=True)]
    if any(turned):
        mujoco.mj_setConst(model, mujoco.MjData(model))
    for body, name in zip(bodies, names, strict=True):
        if not _is_free(model, body):
            raise ValueError(
                f'body "{name}": joints, gravity, gravcomp, damping, a fluid or constraints act on it; it is '
                f'flown as one body with a freejoint, without these, under gravity="{_text(GRAVITY_M_S2)}"'
            )
        if not np.any((model.geom_contype | model.geom_conaffinity)[model.geom_bodyid == body]):
            raise ValueError(
                f'body "{name}": none of its geoms has contacts: one needs contype="1" conaffinity="1", which a '
                "<default> of the scene may have changed"
            )
        sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name.removesuffix(QUADROTOR) + TOUCH)
        if sensor < 0 or model.sensor_type[sensor] != mujoco.mjtSensor.mjSENS_CONTACT or model.sensor_dim[sensor] != 1:
            raise ValueError(
                f'sensor "{TOUCH}": is missing or another: '
                f'needs <contact name="{TOUCH}" body1="{QUADROTOR}" num="1" data="found"/>'
            )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in np.flatnonzero(~(np.abs(data.geom_xpos) < mujoco.mjMAXVAL).all(axis=1)).tolist():
        name = model.geom(geom).name or model.body(int(model.geom_bodyid[geom])).name
        raise ValueError(
            f'geom "{name}": is at "{_text(data.geom_xpos[geom])}", where nothing can be: mend pos or quat'
        )
    if len(moving := np.setdiff1d(model.dof_bodyid, bodies)):
        raise ValueError(f'body "{model.body(int(moving[0])).name}": has joints, but only drones move here')


def _check_meetings(model: mujoco.MjModel, bodies: Sequence[int]) -> None:
    """Raise ValueError for what drones would fly through, or on without: contacts with geoms alone are looked for."""
    for flag in ("contact", "constraint", "sensor"):
        if model.opt.disableflags & getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}"):
            raise ValueError(f'option: flag {flag}="disable": drones would fly through everything; leave it out')
    if model.nflex:
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, 0)
        raise ValueError(f'flex "{name}": drones would fly through it; make it a mesh')
    sites = model.wrap_objid[model.wrap_type == int(mujoco.mjtWrap.mjWRAP_SITE)]
    tied = np.flatnonzero(np.isin(model.body_rootid[model.site_bodyid[sites]], bodies))
    if len(tied):
        raise ValueError(f'tendon: pulls at site "{model.site(int(sites[tied[0]])).name}" of a drone, which flies free')


def _check_masses(model: mujoco.MjModel, spec: mujoco.MjSpec, name: str, bodies: Sequence[int]) -> None:
    """Raise ValueError unless mass and moments of drones are those that their bodies give."""
    own = spec.compiler
    from_geoms = own.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if from_geoms or not spec.body(name).explicitinertial:
        raise ValueError(f'body "{name}": inertial is missing, and its geoms make no drone: {RIGHT}')
    bounds = own.boundmass >= model.body_mass[bodies].min() or own.boundinertia >= model.body_inertia[bodies].min()
    if own.settotalmass > 0 or bounds:
        raise ValueError("compiler: settotalmass, boundmass or boundinertia changes the drone's own: leave them out")
    from uavaccel.sim.vehicle.quadrotor import HOVERS, ROTORS, parameters  # with numba, which looking needs not

    mass = float(model.body_mass[bodies[0]])
    (craft,) = parameters(model.opt.timestep, 0, mass, model.body_inertia[bodies[0]])
    lifted = ROTORS * craft["max_thrust_n"] / craft["gravity_m_s2"]
    least, most = (share * lifted for share in HOVERS)
    if not least <= mass <= most:
        never = "descends" if mass < least else "climbs"
        needs = f"with its rotors: needs {least:.2g} to {most:.2g} kg"
        raise ValueError(f'body "{name}": inertial mass="{mass:g}": never {never} {needs}')


def _align(model: mujoco.MjModel, body: int, name: str) -> bool:
    """Check one inertial; return whether its inertia had to be written about the body's axes."""
    for child in range(body + 1, model.nbody):
        if model.body_rootid[child] == body and model.body_mass[child]:
            inner = model.body(child).name or "a child"
            raise ValueError(
                f'body "{name}": its child body "{inner}" has a mass of {model.body_mass[child]:.3g} kg: add '
                f'that to the inertial of "{name}", and give the child\'s geoms mass="0"'
            )
    if model.body_ipos[body].any():
        raise ValueError(
            f'body "{name}": inertial pos="{_text(model.body_ipos[body])}": the centre of mass must be the '
            'body\'s origin, pos="0 0 0", about which the rotors push; move the geoms instead'
        )
    turn = _matrix(model.body_iquat[body])
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
    own = np.diagonal(inertia)
    if np.abs(inertia - np.diag(own)).max() > ALIGNED * own.max():
        raise ValueError(
            f'body "{name}": inertial quat or fullinertia: the principal axes must be the body\'s, without '
            f"products of inertia: {RIGHT}"
        )
    if np.array_equal(model.body_iquat[body], (1.0, 0.0, 0.0, 0.0)):
        return False
    model.body_inertia[body], model.body_iquat[body] = own, (1.0, 0.0, 0.0, 0.0)
    model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_BODY
    return True


def _is_free(model: mujoco.MjModel, body: int) -> bool:
    """Whether MuJoCo accelerates a body, away from all others, as one free body under gravity alone."""
    if model.body_dofnum[body] != 6 or model.body_jntnum[body] != 1:
        return False
    data, flags = mujoco.MjData(model), model.opt.disableflags
    dofs = slice(int(model.body_dofadr[body]), int(model.body_dofadr[body]) + 6)
    speed, spin, push = np.array([3.0, -5.0, 7.0]), np.array([1.0, 2.0, -1.5]), np.array([0.3, 0.2, -0.1])
    data.qvel[dofs], data.qfrc_applied[dofs] = (*speed, *spin), (*push, *push)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    mujoco.mj_step(model, data)
    model.opt.disableflags = flags
    mass, inertia = model.body_mass[body], model.body_inertia[body]
    free = (*(push / mass + GRAVITY_M_S2), *((push - np.cross(spin, inertia * spin)) / inertia))
    return np.allclose(data.qacc[dofs], free, rtol=SAME, atol=SAME) and np.allclose(
        data.qvel[dofs], (*speed, *spin) + model.opt.timestep * np.array(free), rtol=SAME, atol=SAME
    )


def _text(numbers: Sequence[float] | NDArray[np.float64]) -> str:
    return " ".join(f"{number:g}" for number in numbers)
