"""Checks of options before anything is flown: numbers, names, and whether what a command writes can be written."""

from __future__ import annotations

import os
from pathlib import Path

from uavaccel.errors import UsageError, UserError


def check_out(folder: Path, resume: bool = False) -> None:
    """Raise UserError for a run's folder that exists, unless the run is resumed, or that cannot be made."""
    _check_name(folder)
    if folder.exists():
        if not resume:
            raise UserError(f"{folder}: exists; take another --out, or --resume to go on with it")
        if not folder.is_dir():
            raise UserError(f"--out {folder}: is no folder, so no run to go on with")
        return
    above = next(each for each in folder.absolute().parents if each.exists())
    if not above.is_dir():
        raise UserError(f"--out {folder}: {above} is no folder")
    if not os.access(above, os.W_OK):
        raise UserError(f"--out {folder}: {above} may not be written")


def check_file(file: Path, option: str = "--out") -> None:
    """Raise UserError for a file that exists, or that cannot be made in its folder."""
    _check_name(file)
    if file.exists():
        raise UserError(f"{file}: exists; take another {option}")
    if not file.absolute().parent.is_dir():
        raise UserError(f"{option} {file}: there is no folder {file.parent}")
    if not os.access(file.absolute().parent, os.W_OK):
        raise UserError(f"{option} {file}: {file.parent} may not be written")


def _check_name(path: Path) -> None:
    try:
        path.exists()
    except OSError as error:
        raise UserError(f"--out {str(path)[:40]}...: {error.strerror}") from error


def check_number(option: str, value: float, least: float, most: float) -> None:
    """Raise UserError for a number outside of these bounds."""
    if not least <= value <= most:
        form = "g" if isinstance(value, float) else "d"
        raise UserError(f"{option} {value:{form}}: must be {least:{form}} to {most:{form}}")


def check_host(host: str) -> None:
    """Raise UsageError for an empty address, which sockets take for all addresses of this machine."""
    if not host.strip():
        raise UsageError("--host: is empty; name an address, as in --host 127.0.0.1")


def check_profile(profile: str) -> None:
    from uavaccel.sim.profile import PROFILES  # heavy

    if profile not in PROFILES:
        raise UserError(f"--profile {profile}: must be {' or '.join(PROFILES)}")


def check_watchable(simulator: str | None, engine: str) -> None:
    """Raise UsageError for --watch where nothing flies in a scene of this machine; None is of a run without lanes."""
    from uavaccel.envs.simulators import KERNELS  # loads Gymnasium
    from uavaccel.suites.engines import LOKY

    if simulator == KERNELS:
        raise UsageError(
            "--watch: the kernels fly numbers, without a scene to look at: --set simulator=mujoco"
        )
    if engine != LOKY:
        raise UsageError(f"--watch: sees flights of this machine only, none of a cluster: --engine {LOKY}")
