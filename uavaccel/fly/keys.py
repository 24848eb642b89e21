"""Stand-ins for modules that read keys, if they are not installed: `keyboard`, `pynput`, `pygame`, `msvcrt`.

No key is ever pressed. A call that waits for one returns Enter after a moment, like `airsim.wait_key` and `input` here.
"""

from __future__ import annotations

import string
import sys
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

from uavaccel.fly.modules import called_by_a_script

ROOTS = ("keyboard", "pynput", "pygame", "msvcrt")
KEY_S = 0.1  # seconds of the script's clock after which a call that waits for a key returns
Sleep = Callable[[float], object]
Now = Callable[[], float]
PARTS = {
    "pygame": ("display", "event", "joystick", "key", "locals", "mouse", "time"),
    "pynput": ("keyboard", "mouse"),
}
"""Their submodules that are available without being imported."""
CONSTANTS = (
    *(f"K_{key}" for key in string.ascii_lowercase + string.digits),
    *(
        f"K_{key}"
        for key in ("UP", "DOWN", "LEFT", "RIGHT", "SPACE", "RETURN", "ESCAPE", "TAB", "LSHIFT", "LCTRL")
    ),
    *("QUIT", "KEYDOWN", "KEYUP", "MOUSEBUTTONDOWN", "MOUSEBUTTONUP", "MOUSEMOTION", "JOYAXISMOTION"),
    *("JOYBUTTONDOWN", "JOYBUTTONUP", "RESIZABLE", "FULLSCREEN", "DOUBLEBUF", "HWSURFACE"),
)
"""The names that `from pygame.locals import *` imports."""


class _StubType(type):
    def __getattr__(cls, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        return StubObject()


class StubObject(metaclass=_StubType):
    """Any other object of such a module: it can be called, indexed and drawn on, and does nothing."""

    def __init__(self, *arguments: object, **options: object) -> None:
        pass

    def __call__(self, *arguments: object, **options: object) -> object:
        return StubObject()

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        return StubObject()

    def __setattr__(self, name: str, value: object) -> None:
        pass

    def __getitem__(self, key: object) -> object:
        return False

    def __iter__(self) -> Iterator[object]:
        return iter(())

    def __len__(self) -> int:
        return 0

    def __int__(self) -> int:
        return 0

    __index__ = __int__

    def __float__(self) -> float:
        return 0.0

    def __enter__(self) -> object:
        return self

    def __exit__(self, *exception: object) -> None:
        pass


class StubModule(ModuleType):
    """A module whose unknown names are `StubObject`, except constants in capitals, which are distinct numbers."""

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        if name.isupper() or name.startswith("K_"):
            value: object = _number_of(name)
        else:
            value = StubObject if name[:1].isupper() else StubObject()
        setattr(self, name, value)
        return value


class Clock:
    """pygame.time.Clock: `tick` waits for the end of a frame."""

    def __init__(self, sleep: Sleep, now_s: Now) -> None:
        self._sleep, self._now_s, self._ticked_s = sleep, now_s, now_s()

    def tick(self, framerate: float = 0) -> int:
        """Wait until 1 / `framerate` seconds after the last tick; returns the milliseconds since then."""
        over_s = self._ticked_s + (1 / framerate if framerate else 0.0)
        self._sleep(max(0.0, over_s - self._now_s()))
        before_s, self._ticked_s = self._ticked_s, self._now_s()
        return round(1000 * (self._ticked_s - before_s))

    tick_busy_loop = tick

    def get_fps(self) -> float:
        return 0.0


@contextmanager
def key_modules(sleep: Sleep, now_s: Now) -> Iterator[None]:
    """Let a script's imports find the stand-ins, on the script's clock, if there is no other such module."""
    finder = _Finder(sleep, now_s)
    sys.meta_path.append(finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in [name for name, module in sys.modules.items() if isinstance(module, StubModule)]:
            del sys.modules[name]


class _Finder(Loader, MetaPathFinder):
    """Finds stand-ins for scripts only: a library may try an import and manage without it."""

    def __init__(self, sleep: Sleep, now_s: Now) -> None:
        self._clock = sleep, now_s

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name.partition(".")[0] not in ROOTS or not called_by_a_script({"importlib", "_frozen_importlib"}):
            return None
        return ModuleSpec(name, self, is_package=True)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return StubModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        root, _, part = module.__name__.partition(".")
        if not part:
            line = f"{root} is not installed: a stand-in takes its place, and no key is ever pressed"
            print(f"uavaccel: {line}", file=sys.stderr, flush=True)
        vars(module).update(_names(module.__name__, *self._clock))
        for name in PARTS.get(module.__name__, ()):
            part_of_it = sys.modules[f"{module.__name__}.{name}"] = StubModule(f"{module.__name__}.{name}")
            vars(part_of_it).update(_names(part_of_it.__name__, *self._clock))
            setattr(module, name, part_of_it)


def _names(module: str, sleep: Sleep, now_s: Now) -> dict[str, object]:
    """Return the names of a module that do something."""

    def read(value: object) -> Callable[..., object]:
        return lambda *arguments, **options: (sleep(KEY_S), value)[1]

    def wait_ms(milliseconds: float) -> None:
        sleep(milliseconds / 1000)

    no: Callable[..., bool] = lambda *arguments, **options: False  # noqa: E731
    begun_s = now_s()
    names: dict[str, dict[str, object]] = {
        "keyboard": {"is_pressed": no, "wait": read(None), "read_key": read("enter"), "record": read([])},
        "msvcrt": {"kbhit": no, "getch": read(b"\r"), "getche": read(b"\r"), "getwch": read("\r")},
        "pygame": {"init": lambda: (0, 0), "error": type("error", (RuntimeError,), {})},
        "pygame.event": {"get": lambda *kinds, **options: [], "wait": read(StubObject())},
        "pygame.key": {"get_pressed": StubObject, "get_mods": lambda: 0},
        "pygame.joystick": {"get_count": lambda: 0, "get_init": no},
        "pygame.locals": {name: _number_of(name) for name in CONSTANTS},
        "pygame.time": {
            "Clock": lambda: Clock(sleep, now_s),
            "get_ticks": lambda: round(1000 * (now_s() - begun_s)),
            "wait": wait_ms,
            "delay": wait_ms,
        },
    }
    return names.get(module, {})


def _number_of(name: str) -> int:
    """Return a constant's number: the same in every process, and very likely distinct."""
    return 256 + zlib.crc32(name.encode()) % (1 << 30)
