"""Which OpenGL draws: MUJOCO_GL where the user set it, otherwise EGL, otherwise OSMesa, whichever works.

Nothing here touches OpenGL before a context is asked for, so all that needs no images works on a machine without.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache

import mujoco

from uavaccel.errors import UserError

HEADLESS = ("egl", "osmesa")
PROBE_TIMEOUT_S = 60.0  # drivers that hang were reported (google-deepmind/mujoco#3444)
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri, or libosmesa6"
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software")

_driver = threading.RLock()
_in_thread = threading.local()  # .context: the one that is current
_drawn = False  # whether this process, or one that it was forked from, has made a context
_forked = False  # whether it was forked after that
_found: GlRenderer | None = None  # who drew in the last context of this process, or in the one that was tried

# MuJoCo and PyOpenGL each settle for one backend a process, and a bad driver may crash: so try in another one.
_PROBE = """
import mujoco
context = mujoco.GLContext(8, 8)
context.make_current()
from OpenGL import GL
print(GL.glGetString(GL.GL_RENDERER).decode())
context.free()
"""


@dataclass(frozen=True)
class GlRenderer:
    """Who draws: the backend ("egl", "osmesa", ...), GL_RENDERER, and whether that is a program on the CPU."""

    backend: str
    name: str
    software: bool


def turns(renderer: GlRenderer) -> AbstractContextManager[object]:
    """Lets the threads of this process draw one at a time in software: Mesa crashes now and then where many do."""
    return _driver if renderer.software else nullcontext()


def make_context(width: int, height: int) -> tuple[mujoco.GLContext, GlRenderer]:
    """A GL context of MuJoCo's, made current in this thread, and who draws in it.

    Raises UserError where nothing can draw, one line that names the packages to install, and in a process that was
    forked from one that has drawn: the driver's threads stayed behind, and it would wait for them for ever.
    """
    global _drawn, _found
    check_process()
    backend = choose_backend()
    try:
        module = f"mujoco.{backend}" if backend in HEADLESS else "mujoco.rendering.classic.gl_context"
        with _driver:
            context = importlib.import_module(module).GLContext(width, height)
            _drawn = True
            bind(context)
            _found = _current_renderer(backend)
            return context, _found
    except Exception as error:  # of several libraries, each with its own kind
        raise UserError(
            f"OpenGL does not work with MUJOCO_GL={backend} ({type(error).__name__}: {_first_line(error)}); "
            f"unset MUJOCO_GL, or install {PACKAGES} (Debian)"
        ) from error


def _current_renderer(backend: str) -> GlRenderer:
    from OpenGL import GL  # takes the platform of the first context, so not before there is one

    name = GL.glGetString(GL.GL_RENDERER)
    if name is None:  # GLFW without a display makes a context that is none
        raise RuntimeError("the context draws nothing")
    return _named(backend, name.decode())


def _named(backend: str, name: str) -> GlRenderer:
    return GlRenderer(backend, name, any(software in name.lower() for software in SOFTWARE_RENDERERS))


def sample_textures_fast(context: mujoco.MjrContext) -> None:
    """Read one texel a pixel instead of MuJoCo's eight: a third of the frame, in software.

    The nearest texel of the nearest mipmap; with one pixel a texel or less it looks the same, only crisper.
    """
    from OpenGL import GL

    for texture, kind in zip(context.texture[: context.ntexture], context.textureType, strict=False):
        target = GL.GL_TEXTURE_2D if kind == mujoco.mjtTexture.mjTEXTURE_2D else GL.GL_TEXTURE_CUBE_MAP
        GL.glBindTexture(target, int(texture))
        GL.glTexParameteri(target, GL.GL_TEXTURE_MIN_FILTER, GL.GL_NEAREST_MIPMAP_NEAREST)
        GL.glTexParameteri(target, GL.GL_TEXTURE_MAG_FILTER, GL.GL_NEAREST)


def drop_stencil(context: mujoco.MjrContext, width: int, height: int) -> None:
    """Give the off-screen buffer depths without MuJoCo's stencil beside them: a fifth of the frame, in software.

    The stencil is for reflections, of which there are none; depths have the same 32 bits, so pixels are the same. The
    buffer goes with the GL context.
    """
    from OpenGL import GL

    depth = GL.glGenRenderbuffers(1)
    GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, depth)
    GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_DEPTH_COMPONENT32F, width, height)
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, int(context.offFBO))
    for attachment, buffer in ((GL.GL_DEPTH_STENCIL_ATTACHMENT, 0), (GL.GL_DEPTH_ATTACHMENT, depth)):
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)


def pixel_reader() -> Callable[..., None]:
    """glReadPixels of the present context's library, without PyOpenGL's checks, which take longer than the call."""
    from OpenGL.platform import PLATFORM  # that of the first context, so not before there is one

    function = PLATFORM.GL.glReadPixels
    function.restype = None
    read_pixels: Callable[..., None] = function
    return read_pixels


def describe_renderer() -> GlRenderer:
    """The renderer that cameras of this process get, and of its children. Raises UserError where there is none."""
    choose_backend()
    if _found is not None:  # by whoever tried the backend, in a context of its own
        return _found
    context, renderer = make_context(8, 8)
    release(context)
    return renderer


def known_renderer() -> GlRenderer | None:
    """Who draws here, and in processes started from here, where that has been found out already."""
    return _found


def bind(context: mujoco.GLContext) -> None:
    """Make a context current in this thread, unless it is: the driver takes 10 µs to find out."""
    if getattr(_in_thread, "context", None) is not context:
        context.make_current()
        _in_thread.context = context


def survives() -> bool:
    """Whether this process may touch what OpenGL holds: not where it was forked from one that has drawn."""
    return not _forked


def check_process() -> None:
    """Raise UserError where this process cannot draw because its parent had drawn before it was forked."""
    if _forked:
        raise UserError(
            "this process was forked from one that had drawn, and OpenGL does not survive that: start workers by "
            'spawn, as AsyncVectorEnv(..., context="spawn") or SubprocVecEnv(..., start_method="spawn")'
        )


def _note_fork() -> None:
    global _forked
    _forked = _drawn


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def release(context: mujoco.GLContext) -> None:
    """Free a context; whatever it held must be freed before."""
    context.free()
    _in_thread.context = None


def choose_backend() -> str:
    """The backend's name, as MUJOCO_GL takes it; written there, so that child processes need not try again."""
    global _found
    chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
    if chosen in ("disable", "disabled", "off", "false", "0"):
        raise UserError(f"MUJOCO_GL={chosen} switches images off; unset it, or run without a camera")
    if chosen or sys.platform != "linux":
        return chosen
    found = _first_that_works()
    if found is None:
        raise UserError(f"no OpenGL here to draw images with: install {PACKAGES} (Debian)")
    _found = _found or found
    os.environ["MUJOCO_GL"] = found.backend
    return found.backend


@cache
def _first_that_works() -> GlRenderer | None:
    return next((found for backend in HEADLESS if (found := _tried(backend)) is not None), None)


def _tried(backend: str) -> GlRenderer | None:
    """Who draws with that backend; None where it does not work."""
    environment = {**os.environ, "MUJOCO_GL": backend}
    try:
        command = [sys.executable, "-c", _PROBE]
        probe = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=PROBE_TIMEOUT_S, check=True
        )
        return _named(backend, probe.stdout.splitlines()[-1])
    except (OSError, subprocess.SubprocessError, IndexError):
        return None


def _first_line(error: Exception) -> str:
    return (str(error).strip() or "no reason given").splitlines()[0]
