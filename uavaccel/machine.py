"""What a run is flown on, for its manifest: this machine, the versions of what flies, and their source."""

import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import uavaccel
from uavaccel.files import Plain
from uavaccel.resources import source_tree

_PACKAGES = ("gymnasium", "llvmlite", "mujoco", "numba", "numpy")
_OF_EXTRAS = ("onnxruntime", "opencv-python-headless", "stable-baselines3", "torch")  # where it is installed
_ENVIRONMENT = ("LP_NUM_THREADS", "MUJOCO_GL", "NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def describe_run(
    command_line: Sequence[str], seed: int, start_time: str, gl_renderer: str | None = None
) -> dict[str, Plain]:
    """Return the contents of a run directory's manifest.json.

    `start_time` is ISO 8601 text from a clock, `gl_renderer` the GL_RENDERER of the context in use, if any.
    """
    return {
        "command_line": list(command_line),
        "start_time": start_time,
        "seed": seed,
        "versions": versions(),
        "git": _git(),
        "host": {**host(), "memory_bytes": memory_bytes()},
        "gl_renderer": gl_renderer,
        "environment": {name: os.environ.get(name) for name in _ENVIRONMENT},
    }


def versions() -> dict[str, str | None]:
    """Return the versions of uavaccel, of Python and of the packages that fly, None for one that is not installed."""
    found: dict[str, str | None] = {"uavaccel": uavaccel.__version__, "python": platform.python_version()}
    found |= {package: version_of(package) for package in _PACKAGES}
    return found | {package: at for package in _OF_EXTRAS if (at := version_of(package))}


def host() -> dict[str, Plain]:
    """Return what is known of this machine's system and processor."""
    return {"platform": platform.platform(), "cpu_model": _cpu_model(), "cores": usable_cores()}


def gpu(device: str) -> dict[str, Plain]:
    """Return a CUDA device's name and UUID, and the versions of CUDA and cuDNN; nothing for another device.

    Nothing either before one of several GPUs was taken: who asked here could not take another any more (suites/parts).
    """
    if not device.startswith("cuda"):
        return {}
    import torch as th

    taken = th.cuda.is_initialized()  # type: ignore[no-untyped-call]
    if not th.cuda.is_available() or (th.cuda.device_count() > 1 and not taken):
        return {}
    found = th.cuda.get_device_properties(device)
    versions = {"cuda": th.version.cuda, "cudnn": th.backends.cudnn.version()}  # type: ignore[no-untyped-call]
    return {"gpu": {"name": found.name, "uuid": str(found.uuid), **versions}}


def version_of(package: str) -> str | None:
    """Return the version of an installed package; None for one that is not."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _git() -> dict[str, Plain] | None:
    """Return the commit of the source tree, and whether tracked files differ from it; None outside a source tree."""
    if (root := source_tree()) is None:
        return None
    commands = ("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no")
    how: dict[str, Any] = {"capture_output": True, "text": True, "check": True, "timeout": 30}
    try:
        commit, changes = (subprocess.run(["git", "-C", root, *each], **how).stdout.strip() for each in commands)
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit, "dirty": bool(changes)}


def usable_cores() -> int:
    """Return the number of cores on which this process may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def memory_bytes() -> int | None:
    """Return the main memory of this machine; None where the system does not tell it."""
    if sys.platform == "win32":
        return None
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _cpu_model() -> str:
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as lines:
        for line in lines:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
