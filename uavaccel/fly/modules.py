"""Redirects a script's imports: AirSim's client to ours, its clock modules to a simulated clock, and changes others.

AirSim's modules are replaced for every importer. `time` and `datetime` are replaced for the script's own files only:
the libraries that it imports keep measuring with the machine's clock. A module is changed when it is first imported, so
that a script pays only for those that it uses.
"""

from __future__ import annotations

import builtins
import sys
import sysconfig
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, Self

from uavaccel.clock import MonotonicClock
from uavaccel.units import NS_PER_S

CLIENTS = ("airsim", "cosysairsim")
OLD_CLIENT = "AirSimClient"  # the client's one module before AirSim 1.2
PARTS = {"client": "client", "types": "types", "utils": "utils", "pfm": "utils"}  # AirSim's submodules, and ours
_HOME = "uavaccel.airsim"
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")})
_OWN = str(Path(__file__).parents[1])

Modules = dict[str, Callable[[], ModuleType]]
"""Functions that make modules, by the names under which the modules are imported."""


def client_modules() -> Modules:
    """AirSim's client and its helper modules, under the names by which scripts import them."""
    homes = {OLD_CLIENT: f"{_HOME}.old_client"}
    for name in CLIENTS:
        homes |= {name: _HOME} | {f"{name}.{part}": f"{_HOME}.{home}" for part, home in PARTS.items()}
    found: dict[str, Callable[[], ModuleType]] = {
        name: lambda home=home: import_module(home)  # type: ignore[misc]
        for name, home in homes.items()
    }
    found["setup_path"] = lambda: named_module("setup_path", SetupPath=type("SetupPath", (), {}))
    return found | {"msgpackrpc": _msgpackrpc, "msgpackrpc.error": lambda: _msgpackrpc().error}


def _msgpackrpc() -> ModuleType:
    """Return a module msgpackrpc with the errors that scripts catch, and the client of copies of AirSim's."""
    from uavaccel.airsim import connection
    from uavaccel.wire.rpc import RpcError

    def client(address: tuple[str, int], timeout: float = 10, **options: object) -> object:
        return connection.connect(address[0], address[1], timeout)

    error = named_module(
        "msgpackrpc.error", RPCError=RpcError, TransportError=ConnectionError, TimeoutError=TimeoutError
    )
    return named_module("msgpackrpc", error=error, Client=client, Address=lambda host, port: (host, port))


def named_module(name: str, **attributes: object) -> ModuleType:
    module = ModuleType(name)
    vars(module).update(attributes)
    return module


class ModuleFinder(Loader, MetaPathFinder):
    """Imports modules that `find` has a function to make; `spent_s` counts the wall time that making them takes."""

    def __init__(self, find: Callable[[str], Callable[[], ModuleType] | None]) -> None:
        self._find, self._clock = find, MonotonicClock()
        self._before: dict[str, ModuleType | None] = {}
        self.spent_s = 0.0

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        return None if self._find(name) is None else ModuleSpec(name, self)

    def exec_module(self, module: ModuleType) -> None:
        begun_ns, name = self._clock.now_ns(), module.__name__
        if (make := self._find(name)) is None:
            raise ImportError(name)
        self._before.setdefault(name, None)
        sys.modules[name] = made = make()
        vars(made).setdefault("__path__", [])  # a package, whose modules can be imported
        self.spent_s += (self._clock.now_ns() - begun_ns) / NS_PER_S

    @contextmanager
    def finding(self, place: int = 0, instead_of: Collection[str] = ()) -> Iterator[Self]:
        """Find modules in the `with` block, at this place among the finders, and those of these names anew."""
        self._before |= {name: sys.modules.pop(name, None) for name in instead_of}
        sys.meta_path.insert(place, self)
        try:
            yield self
        finally:
            sys.meta_path.remove(self)
            for name, module in self._before.items():
                sys.modules.pop(name, None)
                if module is not None:
                    sys.modules[name] = module


@contextmanager
def importing(everywhere: Modules, in_scripts: Mapping[str, ModuleType]) -> Iterator[ModuleFinder]:
    """Let imports find the modules `everywhere`, and those `in_scripts` in files that belong to no library."""
    original = builtins.__import__

    def import_for(
        name: str,
        globals: Mapping[str, object] | None = None,
        locals: Mapping[str, object] | None = None,
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        if level == 0 and name in in_scripts and of_a_script(globals):
            return in_scripts[name]
        return original(name, globals, locals, fromlist, level)

    if in_scripts:
        builtins.__import__ = import_for
    try:
        with ModuleFinder(everywhere.get).finding(instead_of=everywhere) as finder:
            yield finder
    finally:
        builtins.__import__ = original


def of_a_script(namespace: Mapping[str, object] | None) -> bool:
    """Return whether a module's file belongs to neither Python, nor an installed package, nor this one."""
    file = (namespace or {}).get("__file__")
    return bool(file) and not _is_library(str(file)) and not _is_library(str(Path(str(file)).absolute()))


def _is_library(path: str) -> bool:
    return path.startswith(_LIBRARIES) or "site-packages" in path or path.startswith(_OWN)


def called_by_a_script(through: Collection[str] = sys.stdlib_module_names) -> bool:
    """Return whether a script's file makes the present call, directly or `through` Python's own modules.

    In a thread that a script has started, Python's own may be all there is, as in a server's.
    """
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        name = str(frame.f_globals.get("__name__"))
        if name.partition(".")[0] not in through and not name.startswith("uavaccel.fly"):
            return of_a_script(frame.f_globals)
        frame = frame.f_back
    return True


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
        self._undo.callback(act)

    def when_imported(self, name: str, act: Act) -> None:
        """Call `act(module)` now if the module has been imported, and otherwise when it is."""
        if (module := sys.modules.get(name)) is not None:
            act(module)
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
