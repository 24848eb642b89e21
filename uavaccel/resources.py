"""What ships with the package, `assets/` (scenes) and `experiments/` (YAML), and the extras that do not.

A wheel has both folders inside the package; in a source tree, installed editable or not, they are beside it.
"""

import json
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from uavaccel.errors import UserError, suggestion

_PACKAGE = Path(str(files("uavaccel")))


def source_tree() -> Path | None:
    """Return the checkout from which the package runs; None where it was installed from a wheel."""
    root = _PACKAGE.parent
    return root if (root / "pyproject.toml").is_file() and (root / "assets").is_dir() else None


def require(module: str, what: str, extra: str, package: str = "") -> None:
    """Raise UserError where a module of an extra is missing; the line says what needs it, and how to install it.

    `package` is named where it is called otherwise than the module.
    """
    if find_spec(module) is None:
        raise UserError(f"{what}: needs {package or module}: pip install {_requirement(extra)}")


def _requirement(extra: str) -> str:
    """Return what pip must be given for an extra: the checkout, or what uavaccel was installed from (PEP 610).

    No package index has uavaccel, unless it was installed by that name.
    """
    if (checkout := source_tree()) is not None:
        return f"-e '{checkout}[{extra}]'"
    try:
        origin = json.loads(distribution("uavaccel").read_text("direct_url.json") or "{}")
    except PackageNotFoundError:  # a folder that was copied
        origin = {}
    if "url" not in origin:
        return f"'uavaccel[{extra}]'"
    source = origin.get("vcs_info", {})
    scheme = f"{source['vcs']}+" if source else ""
    return f"'uavaccel[{extra}] @ {scheme}{origin['url']}'"


def asset(name: str) -> Path:
    """Return the path of an asset, e.g. "mjcf/blocks.xml". Raises UserError if there is none of that name."""
    return _find("assets", name)


def scene_file(name: str, said: str = "scene = ") -> Path:
    """Return the MJCF file of a scene. Raises UserError for an unknown one, whose name it puts after `said`."""
    known = {path.stem: path for path in sorted(_folder("assets").glob("mjcf/*.xml")) if path.stem != "quadrotor"}
    if name not in known:
        raise UserError(f"{said}{name}: is unknown; {suggestion(name, known)}")
    return known[name]


def experiment(name: str) -> Path:
    """Return the path of an experiment that ships, e.g. "dp1.yaml". Raises UserError if there is none of that name."""
    return _find("experiments", name)


@cache
def experiments() -> dict[str, str]:
    """Return the experiments that ship by name, as `uavaccel run` takes them, and what each is: its first comment."""
    texts = {path.stem: path.read_text("utf-8") for path in sorted(_folder("experiments").glob("*.yaml"))}
    return {name: text.partition("\n")[0][2:] for name, text in texts.items() if "\nsuite: " in text}


def _find(folder: str, name: str) -> Path:
    root = _folder(folder)
    path = root / name
    if not path.exists():
        present = sorted(entry.stem for entry in path.parent.glob(f"*{path.suffix}")) or ["none"]
        raise UserError(f"no {name!r} among the {folder}; {suggestion(path.stem, present)}")
    return path


def _folder(name: str) -> Path:
    packaged = _PACKAGE / name
    return packaged if packaged.is_dir() else _PACKAGE.parent / name
