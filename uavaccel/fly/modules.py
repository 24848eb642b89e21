"""What a script's imports find: AirSim's client is ours, and its clocks are the simulated one.

AirSim's modules are exchanged for everybody. `time` and `datetime` are exchanged for the script's own files alone:
libraries that it imports go on measuring with the machine's clock.
"""

from __future__ import annotations

import builtins
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import uavaccel.airsim
from uavaccel import airsim
from uavaccel.airsim import client, pfm, types, utils
from uavaccel.wire.rpc import RpcError

CLIENTS = ("airsim", "cosysairsim")
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")})


def client_modules() -> dict[str, ModuleType]:
    """AirSim's client under the names by which scripts import it, and the helpers that it comes with."""
    found: dict[str, ModuleType] = {}
    for name in CLIENTS:
        found[name] = airsim
        parts = {"client": client, "types": types, "utils": utils, "pfm": pfm}
        found |= {f"{name}.{part}": module for part, module in parts.items()}
    return (
        found
        | _msgpackrpc()
        | {"setup_path": named_module("setup_path", SetupPath=type("SetupPath", (), {}))}
    )


def _msgpackrpc() -> dict[str, ModuleType]:
    """The errors that scripts catch."""
    error = named_module(
        "msgpackrpc.error", RPCError=RpcError, TransportError=ConnectionError, TimeoutError=TimeoutError
    )
    return {"msgpackrpc": named_module("msgpackrpc", error=error), "msgpackrpc.error": error}


def named_module(name: str, **attributes: Any) -> ModuleType:
    module = ModuleType(name)
    vars(module).update(attributes)
    return module


@contextmanager
def importing(everywhere: Mapping[str, ModuleType], in_scripts: Mapping[str, ModuleType]) -> Iterator[None]:
    """Let imports find these modules: `everywhere`, or where files that belong to no library import them."""
    before = {name: sys.modules.get(name) for name in everywhere}
    sys.modules.update(everywhere)
    original = builtins.__import__

    def import_for(
        name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
    ) -> ModuleType:
        if level == 0 and name in in_scripts and of_a_script(globals):
            return in_scripts[name]
        found = original(name, globals, locals, fromlist, level)
        if level == 0 and name in everywhere and "." in name:  # nobody has put it into its package
            package, _, part = name.rpartition(".")
            setattr(sys.modules[package], part, everywhere[name])
        return found

    builtins.__import__ = import_for
    try:
        yield
    finally:
        builtins.__import__ = original
        for name, module in before.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module


def of_a_script(namespace: Mapping[str, Any] | None) -> bool:
    """Whether a module's names are those of a file that neither Python, nor a package, nor this one installed."""
    file = (namespace or {}).get("__file__")
    if not file:
        return False
    path = str(Path(file).absolute())
    return not path.startswith(_LIBRARIES) and "site-packages" not in path and not path.startswith(_OWN)


_OWN = str(Path(uavaccel.airsim.__file__).parents[1])
