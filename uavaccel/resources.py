"""The files that ship with the package: `assets/` (scenes) and `experiments/` (YAML).

A wheel has both folders inside the package; in a source tree, installed editable or not, they are beside it.
"""

from importlib.resources import files
from pathlib import Path

from uavaccel.errors import UserError, suggestion

_PACKAGE = Path(str(files("uavaccel")))


def source_tree() -> Path | None:
    """Return the checkout from which the package runs; None where it was installed from a wheel."""
    root = _PACKAGE.parent
    return root if (root / "pyproject.toml").is_file() and (root / "assets").is_dir() else None


def asset(name: str) -> Path:
    """Return the path of an asset, e.g. "mjcf/blocks.xml". Raises UserError if there is none of that name."""
    return _find("assets", name)


def experiment(name: str) -> Path:
    """Return the path of an experiment that ships, e.g. "dp1.yaml". Raises UserError if there is none of that name."""
    return _find("experiments", name)


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
