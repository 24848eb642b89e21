"""Stand-ins for modules that read keys, if they are not installed: `keyboard`, `pynput`, `pygame`, `msvcrt`.

They read the keys of uavaccel.fly.keyboard. A call that waits for a key returns Enter where none is to come.
"""

from __future__ import annotations

import string
import sys
import threading
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType, SimpleNamespace
from typing import NamedTuple

from uavaccel.fly.keyboard import KEY_S, NAMED, POLL_S, Keyboard, key_of
from uavaccel.fly.modules import called_by_a_script

LIBRARIES = ("keyboard", "pynput", "pygame")
ROOTS = (*LIBRARIES, "msvcrt")
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

    def __init__(self, keyboard: Keyboard) -> None:
        self._sleep, self._now_s, self._ticked_s = keyboard.pass_time, keyboard.now_s, keyboard.now_s()

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
def key_modules(keyboard: Keyboard) -> Iterator[None]:
    """Let a script's imports find the stand-ins, if it presses keys or if there is no other such module."""
    finder = _Finder(keyboard)
    sys.meta_path.insert(0 if keyboard.keys else len(sys.meta_path), finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in [name for name, module in sys.modules.items() if isinstance(module, StubModule)]:
            del sys.modules[name]


class _Finder(Loader, MetaPathFinder):
    """Finds stand-ins for scripts only: a library may try an import and manage without it."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard = keyboard

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
            keys = "only those of --keys are pressed" if self._keyboard.keys else "no key is ever pressed (--keys)"
            why = "" if self._keyboard.keys else " is not installed"
            print(f"uavaccel: {root}{why}: a stand-in takes its place, and {keys}", file=sys.stderr, flush=True)
        vars(module).update(_names(module.__name__, self._keyboard))
        for name in PARTS.get(module.__name__, ()):
            part_of_it = sys.modules[f"{module.__name__}.{name}"] = StubModule(f"{module.__name__}.{name}")
            vars(part_of_it).update(_names(part_of_it.__name__, self._keyboard))
            setattr(module, name, part_of_it)


def _names(module: str, keyboard: Keyboard) -> dict[str, object]:
    """Return the names of a module that do something."""
    match module:
        case "keyboard":
            return _public(_Hooks(keyboard))
        case "pynput.keyboard":
            listener = type("Listener", (Listener,), {"keyboard": keyboard})
            return {"Key": NAMED_KEYS, "KeyCode": KeyCode, "Listener": listener}
        case "msvcrt":
            return _public(_Console(keyboard))
        case "pygame":
            return {"init": lambda: (0, 0), "error": type("error", (RuntimeError,), {})}
        case "pygame.event" | "pygame.key":
            return _public(_Events(keyboard))
        case "pygame.joystick":
            return {"get_count": lambda: 0, "get_init": lambda: False}
        case "pygame.locals":
            return {name: _number_of(name) for name in CONSTANTS}
        case "pygame.time":
            return _public(_Time(keyboard)) | {"Clock": lambda: Clock(keyboard)}
    return {}


def _public(stand_in: object) -> dict[str, object]:
    """Return the methods of an object, as the functions of a module."""
    return {name: getattr(stand_in, name) for name in dir(stand_in) if not name.startswith("_")}


class _Hooks:
    """The module `keyboard`."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard = keyboard
        self._hooks: list[tuple[str, str, Callable[[object], object]]] = []
        self._thread: threading.Thread | None = None

    def is_pressed(self, key: object) -> bool:
        self._keyboard.pass_time(POLL_S)
        return self._keyboard.is_down(key)

    def wait(self, key: object = None, *_: object, **options: object) -> None:
        if self._thread is not None:
            self._thread.join()
            return
        while (pressed := self._keyboard.next()) is not None:
            if pressed == key_of(key):
                return
        self._keyboard.pass_time(KEY_S)

    def record(self, until: object = "esc", *_: object, **options: object) -> list[object]:
        self.wait(until)
        return []

    def read_key(self, *_: object, **options: object) -> str:
        return self._keyboard.read()

    def read_event(self, *_: object, **options: object) -> object:
        return self._event("down", self._keyboard.read())

    def hook(self, act: Callable[[object], object], *_: object, **options: object) -> None:
        self._add("", "", act)

    def on_press(self, act: Callable[[object], object], *_: object, **options: object) -> None:
        self._add("down", "", act)

    def on_release(self, act: Callable[[object], object], *_: object, **options: object) -> None:
        self._add("up", "", act)

    def on_press_key(self, key: object, act: Callable[[object], object], *_: object, **options: object) -> None:
        self._add("down", key, act)

    def on_release_key(self, key: object, act: Callable[[object], object], *_: object, **options: object) -> None:
        self._add("up", key, act)

    def add_hotkey(
        self, key: object, act: Callable[..., object], args: Sequence[object] = (), *_: object, **options: object
    ) -> None:
        self._add("down", key, lambda event: act(*args))

    def _add(self, kind: str, key: object, act: Callable[[object], object]) -> None:
        self._hooks.append((kind, key_of(key), act))
        if self._thread is None:
            self._thread = self._keyboard.listen(partial(self._tell, "down"), partial(self._tell, "up"))

    def _tell(self, kind: str, key: str) -> None:
        for wanted, of_key, act in self._hooks:
            if wanted in (kind, "") and of_key in (key, ""):
                act(self._event(kind, key))

    def _event(self, kind: str, key: str) -> SimpleNamespace:
        time_s = self._keyboard.now_s()
        return SimpleNamespace(event_type=kind, name=key, scan_code=_number_of(key), time=time_s)


class _Console:
    """The module `msvcrt`."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard = keyboard
        self._rest = ""  # the second character of an arrow

    def kbhit(self) -> bool:
        self._keyboard.pass_time(POLL_S)
        return bool(self._rest) or self._keyboard.has_next()

    def getwch(self) -> str:
        if char := self._rest:
            self._rest = ""
            return char
        key = self._keyboard.read()
        self._rest = ARROWS.get(key, "")
        return "\xe0" if self._rest else chr(NAMED[key]) if key in NAMED else key

    def getch(self) -> bytes:
        return self.getwch().encode("latin1", "replace")

    getwche, getche = getwch, getch


class _Events:
    """The modules `pygame.event` and `pygame.key`."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard = keyboard
        self._held = ""

    def get(self, *kinds: object, **options: object) -> list[object]:
        self._keyboard.pass_time(POLL_S)
        events: list[object] = []
        if self._held and self._keyboard.down() != self._held:
            events.append(self._event("KEYUP", self._held))
            self._held = ""
        if self._keyboard.has_next() and (key := self._keyboard.next(0.0)) is not None:
            self._held = key
            events.append(self._event("KEYDOWN", key))
        return events

    def poll(self) -> object:
        return next(iter(self.get()), StubObject())

    def wait(self, *arguments: object) -> object:
        if (key := self._keyboard.next()) is not None:
            return self._event("KEYDOWN", key)
        self._keyboard.pass_time(KEY_S)
        return StubObject()

    def get_pressed(self) -> object:
        self._keyboard.pass_time(POLL_S)
        return _Pressed(self._keyboard)

    def get_mods(self) -> int:
        return 0

    def _event(self, kind: str, key: str) -> SimpleNamespace:
        text = key if len(key) == 1 else ""
        return SimpleNamespace(type=_number_of(kind), key=PYGAME_KEYS[key], unicode=text, mod=0)


class _Pressed(StubObject):
    """What pygame.key.get_pressed returns: whether a key is down, by its constant."""

    def __init__(self, keyboard: Keyboard) -> None:
        vars(self)["is_down"] = keyboard.is_down

    def __getitem__(self, key: object) -> bool:
        return any(vars(self)["is_down"](name) for name, number in PYGAME_KEYS.items() if number == key)


class _Time:
    """The module `pygame.time`."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard, self._begun_s = keyboard, keyboard.now_s()

    def get_ticks(self) -> int:
        return round(1000 * (self._keyboard.now_s() - self._begun_s))

    def wait(self, milliseconds: float) -> None:
        self._keyboard.pass_time(milliseconds / 1000)

    delay = wait


class KeyCode(NamedTuple):
    """pynput's key with a character."""

    char: str

    def __str__(self) -> str:
        return repr(self.char)

    @classmethod
    def from_char(cls, char: str) -> KeyCode:
        return cls(char)


class NamedKey:
    """pynput's key without a character."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __repr__(self) -> str:
        return f"Key.{self.name}"


class Listener:
    """pynput.keyboard.Listener, which tells of keys in a thread of the script's."""

    keyboard: Keyboard
    running = False
    _thread: threading.Thread | None = None

    def __init__(
        self,
        on_press: Callable[[object], object] | None = None,
        on_release: Callable[[object], object] | None = None,
        **options: object,
    ) -> None:
        self._press, self._release = on_press or StubObject, on_release or StubObject

    def start(self) -> None:
        self.running = True
        self._thread = self.keyboard.listen(partial(self._tell, self._press), partial(self._tell, self._release))

    def _tell(self, act: Callable[[object], object], name: str) -> object:
        return self.running and act(getattr(NAMED_KEYS, name) if name in NAMED else KeyCode(name))

    def join(self, timeout: float | None = None) -> None:
        if self._thread is not None:
            self._thread.join(timeout)

    def stop(self) -> None:
        self.running = False

    def is_alive(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def __enter__(self) -> Listener:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()


def _number_of(name: str) -> int:
    """Return a constant's number: the same in every process, and very likely distinct."""
    return 256 + zlib.crc32(name.encode()) % (1 << 30)


ARROWS = {"up": "H", "down": "P", "left": "K", "right": "M"}  # msvcrt's second characters
NAMED_KEYS = StubModule("Key")
vars(NAMED_KEYS).update({name: NamedKey(name) for name in NAMED})
PYGAME_KEYS = {key: _number_of(f"K_{key}") for key in string.ascii_letters + string.digits + string.punctuation}
PYGAME_KEYS |= {name: _number_of(f"K_{name.upper()}") for name in NAMED}
PYGAME_KEYS |= {"enter": _number_of("K_RETURN"), "esc": _number_of("K_ESCAPE")}
"""pygame's number of a key, by our name."""
