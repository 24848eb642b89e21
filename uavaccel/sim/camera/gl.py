"""OpenGL contexts: the backend of MUJOCO_GL if that is set, otherwise EGL or OSMesa, whichever works.

OpenGL is not used before a context is requested, so that everything without images works on machines without it.
"""

from __future__ import annotations

import ctypes
import importlib.util
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco

from uavaccel.errors import UserError

HEADLESS = ("egl", "osmesa")
PROBE_TIMEOUT_S = 60.0  # drivers that hang were reported (google-deepmind/mujoco#3444)
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri, or libosmesa6"
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software")

_driver = threading.RLock()
_in_thread = threading.local()  # .context: the current one
_drawn = False  # whether this process, or one that it was forked from, has made a context
forked = False  # whether it was forked after that: then OpenGL's objects are not its own, and cannot be freed
_found: GlRenderer | None = None  # of the last context of this process, or of the probe

# MuJoCo and PyOpenGL use one backend per process, and a bad driver may crash: so probe in another process.
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
    """The renderer: the backend ("egl", "osmesa", ...), GL_RENDERER, and whether it is software."""

    backend: str
    name: str
    software: bool


def turns(renderer: GlRenderer) -> AbstractContextManager[object]:
    """Return a lock for rendering in software, since Mesa sometimes crashes if several threads render at once."""
    return _driver if renderer.software else nullcontext()


def make_context(width: int, height: int) -> tuple[mujoco.GLContext, GlRenderer]:
    """Make a GL context of MuJoCo's, current in this thread; returns it with its renderer.

    Raises UserError without a working OpenGL, naming the packages to install, and in a process forked from one that has
    rendered: the driver's threads do not exist there, and it would wait for them forever.
    """
    global _drawn, _found
    check_process()
    backend = choose_backend()
    logging.getLogger("OpenGL").setLevel(logging.WARNING)  # a script's log is not for what PyOpenGL could do with
    _load_triton()
    try:
        module = f"mujoco.{backend}" if backend in HEADLESS else "mujoco.rendering.classic.gl_context"
        with _driver:
            context = importlib.import_module(module).GLContext(width, height)
            _drawn = True
            bind(context)
            from OpenGL import GL  # takes the platform of the first context, so imported after it

            name = GL.glGetString(GL.GL_RENDERER)
            if name is None:  # GLFW without a display makes a context that does not work
                raise RuntimeError("the context draws nothing")
            _found = _named(backend, name.decode())
            return context, _found
    except Exception as error:  # several libraries, each with exceptions of its own
        reason = (str(error).strip() or "no reason given").splitlines()[0]
        raise UserError(
            f"OpenGL does not work with MUJOCO_GL={backend} ({type(error).__name__}: {reason}); "
            f"unset MUJOCO_GL, or install {PACKAGES} (Debian)"
        ) from error


@cache
def _load_triton() -> None:
    """Load Triton's library, where PyTorch's CUDA builds have it, before Mesa's: each brings an LLVM.

    Mesa's is found by all that is loaded later, and Triton, which stable-baselines3 imports, crashed with it.
    """
    spec = importlib.util.find_spec("triton") if sys.platform == "linux" else None
    for folder in (spec and spec.submodule_search_locations) or ():
        for library in Path(folder).glob("_C/libtriton*.so"):
            with suppress(OSError):
                ctypes.CDLL(str(library))


def _named(backend: str, name: str) -> GlRenderer:
    return GlRenderer(backend, name, any(software in name.lower() for software in SOFTWARE_RENDERERS))


def sample_textures_fast(context: mujoco.MjrContext) -> None:
    """Sample one texel per pixel instead of MuJoCo's eight, which saves a third of the frame time in software.

    It is the nearest texel of the nearest mipmap; with at most one pixel per texel the picture is only crisper.
    """
    from OpenGL import GL

    for texture, kind in zip(context.texture[: context.ntexture], context.textureType, strict=False):
        target = GL.GL_TEXTURE_2D if kind == mujoco.mjtTexture.mjTEXTURE_2D else GL.GL_TEXTURE_CUBE_MAP
        GL.glBindTexture(target, int(texture))
        GL.glTexParameteri(target, GL.GL_TEXTURE_MIN_FILTER, GL.GL_NEAREST_MIPMAP_NEAREST)
        GL.glTexParameteri(target, GL.GL_TEXTURE_MAG_FILTER, GL.GL_NEAREST)


def drop_stencil(context: mujoco.MjrContext, width: int, height: int) -> None:
    """Attach a depth buffer without MuJoCo's stencil, which saves a fifth of the frame time in software.

    The stencil is only for reflections, which are off; depths keep 32 bits, so that pixels are the same. The buffer is
    freed with the GL context.
    """
    from OpenGL import GL

    depth = GL.glGenRenderbuffers(1)
    GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, depth)
    GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_DEPTH_COMPONENT32F, width, height)
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, int(context.offFBO))
    for attachment, buffer in ((GL.GL_DEPTH_STENCIL_ATTACHMENT, 0), (GL.GL_DEPTH_ATTACHMENT, depth)):
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)


def pixel_reader() -> Callable[..., None]:
    """Return the current library's glReadPixels without PyOpenGL's checks, which take longer than the call."""
    from OpenGL.platform import PLATFORM  # set by the first context, so imported after it

    function = PLATFORM.GL.glReadPixels
    function.restype = None
    read_pixels: Callable[..., None] = function
    return read_pixels


def describe_renderer() -> GlRenderer:
    """Return the renderer of cameras in this process and its children. Raises UserError if there is none."""
    choose_backend()
    if _found is not None:  # by the probe
        return _found
    context, renderer = make_context(8, 8)
    release(context)
    return renderer


def bind(context: mujoco.GLContext) -> None:
    """Make a context current in this thread unless it is, which the driver takes 10 µs to find out.

    Raises UserError while it is current in another one, which has not `let_go`.
    """
    if getattr(_in_thread, "context", None) is not context:
        try:
            context.make_current()
        except Exception as error:  # several libraries, each with exceptions of its own
            raise UserError(
                "OpenGL draws in one thread at a time, and another one has drawn with this camera: make, step and "
                "close an environment in one and the same thread"
            ) from error
        _in_thread.context = context


def let_go() -> None:
    """Leave this thread without a context, so that another one can draw with what it has drawn with."""
    if getattr(_in_thread, "context", None) is None or forked:
        return
    _in_thread.context = None
    backend = os.environ.get("MUJOCO_GL")
    if backend == "egl":
        from OpenGL import EGL

        EGL.eglMakeCurrent(EGL.eglGetCurrentDisplay(), EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)
    elif backend == "osmesa":
        from OpenGL import GL, osmesa

        osmesa.OSMesaMakeCurrent(None, None, GL.GL_FLOAT, 0, 0)
    else:
        importlib.import_module("glfw").make_context_current(None)


def check_process() -> None:
    """Raise UserError in a process that cannot render since its parent had rendered before the fork."""
    if forked:
        raise UserError(
            "this process was forked from one that had drawn, and OpenGL does not survive that: start workers by "
            'spawn, as AsyncVectorEnv(..., context="spawn") or SubprocVecEnv(..., start_method="spawn")'
        )


def _note_fork() -> None:
    global forked
    forked = _drawn


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def release(context: mujoco.GLContext) -> None:
    """Free a context, whose objects must have been freed before."""
    context.free()
    _in_thread.context = None


def choose_backend() -> str:
    """Return the backend's name for MUJOCO_GL, which is set so that child processes need no probe."""
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
    """Return the renderer of the first backend that works, each tried in a process of its own; None without any."""
    for backend in HEADLESS:
        environment = {**os.environ, "MUJOCO_GL": backend}
        with suppress(OSError, subprocess.SubprocessError, IndexError):
            probe = subprocess.check_output(
                [sys.executable, "-c", _PROBE],
                stderr=subprocess.PIPE,
                env=environment,
                timeout=PROBE_TIMEOUT_S,
                text=True,
            )
            return _named(backend, probe.splitlines()[-1])
    return None
