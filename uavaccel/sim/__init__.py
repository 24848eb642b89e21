"""The simulation on MuJoCo. MuJoCo reads MUJOCO_GL when it is imported; a wrong value raises UserError here."""

import os

from uavaccel.errors import UserError

try:
    import mujoco  # noqa: F401
except (AttributeError, ImportError, RuntimeError) as error:
    if not os.environ.get("MUJOCO_GL"):
        raise
    raise UserError(
        f"MUJOCO_GL={os.environ['MUJOCO_GL']} does not work here ({error}); unset it, set it to egl or osmesa, "
        "or install libegl1 libegl-mesa0 libgl1-mesa-dri, or libosmesa6 (Debian)"
    ) from error
