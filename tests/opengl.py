"""The mark of tests that draw."""

from __future__ import annotations

import pytest

from uavaccel.errors import UserError
from uavaccel.sim import gl


def opengl_works() -> bool:
    try:
        return bool(gl.choose_backend())
    except UserError:
        return False


needs_opengl = pytest.mark.skipif(not opengl_works(), reason="no OpenGL on this machine")
