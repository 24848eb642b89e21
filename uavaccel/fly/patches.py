"""Temporary changes to modules, each made when its module is first imported.

A script so pays only for the modules that it uses.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Self

Act = Callable[[ModuleType], None]


class Patches:
    """Changes that last for the `with` block of this object."""

    def __init__(self) -> None:
        self._undo = ExitStack()
        self._finder = _Finder()

    def __enter__(self) -> Self:
        sys.meta_path.insert(0, self._finder)
        self._undo.callback(sys.meta_path.remove, self._finder)
        return self

    def __exit__(self, *exception: object) -> None:
        self._undo.close()

    def set(self, owner: object, name: str, value: object) -> None:
        """Replace an attribute of a module, a class or an object."""
        missing = object()
        before = getattr(owner, "__dict__", {}).get(name, missing)  # a method of a class as it stands there
        if before is missing and not isinstance(owner, ModuleType):  # which may warn of a missing name
            before = getattr(owner, name, missing)
        setattr(owner, name, value)
        if before is missing:
            self._undo.callback(delattr, owner, name)
        else:
            self._undo.callback(setattr, owner, name, before)

    def undo(self, act: Callable[[], object]) -> None:
        """Call a function at the end of the block."""
        self._undo.callback(act)

    def when_imported(self, name: str, act: Act) -> None:
        """Call `act(module)` now if the module has been imported, and otherwise when it is."""
        if name in sys.modules:
            act(sys.modules[name])
        else:
            self._finder.acts.setdefault(name, []).append(act)


class _Finder(MetaPathFinder):
    """Finds what the other finders find, and acts on the module once it has been executed."""

    def __init__(self) -> None:
        self.acts: dict[str, list[Act]] = {}

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name not in self.acts:
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        found = next((spec for finder in others if (spec := finder.find_spec(name, path, target))), None)
        loader: Any = None if found is None else found.loader  # whose method is exchanged
        if hasattr(loader, "exec_module") and hasattr(loader, "__dict__"):
            execute, acts = loader.exec_module, self.acts.pop(name)

            def exec_module(module: ModuleType) -> None:
                execute(module)
                for act in acts:
                    act(module)

            loader.exec_module = exec_module
        return found
