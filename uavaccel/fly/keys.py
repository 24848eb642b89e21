"""Stand-ins for modules that read keys, if they are not installed: `keyboard`, `pynput`, `pygame`, `msvcrt`.

They read the keys of uavaccel.fly.keys. A call that waits for a key returns Enter where none is to come.
"""

from __future__ import annotations

import string
import subprocess  # noqa: F401  # which, imported after a stand-in for msvcrt, would take this for Windows
import sys
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from math import inf
from types import ModuleType, SimpleNamespace
from typing import NamedTuple

from uavaccel.errors import UsageError
from uavaccel.fly.modules import ModuleFinder, called_by_a_script

POLL_S = 0.001  # what asking for a key costs the script, so that a loop that waits for one comes to an end
KEY_S = 0.1  # after which a call that waits for a key returns where no more keys come
HELD_S = 0.1
NAMED = {"enter": 13, "esc": 27, "space": 32, "tab": 9, "left": 81, "up": 82, "right": 83, "down": 84}
"""Keys that have names, and OpenCV's numbers for them."""
ALIASES = {"return": "enter", "escape": "esc", " ": "space", "\n": "enter", "\r": "enter"}
LIBRARIES = ("keyboard", "pynput", "pygame")
ROOTS = (*LIBRARIES, "msvcrt")
PUNCTUATION = (
    *("EXCLAIM", "QUOTEDBL", "HASH", "DOLLAR", "PERCENT", "AMPERSAND", "QUOTE", "LEFTPAREN", "RIGHTPAREN", "ASTERISK"),
    *("PLUS", "COMMA", "MINUS", "PERIOD", "SLASH", "COLON", "SEMICOLON", "LESS", "EQUALS", "GREATER", "QUESTION", "AT"),
    *("LEFTBRACKET", "BACKSLASH", "RIGHTBRACKET", "CARET", "UNDERSCORE", "BACKQUOTE"),
    *("LEFTBRACE", "BAR", "RIGHTBRACE", "TILDE"),
)
"""What pygame calls string.punctuation."""
CONSTANTS = (
    *(f"K_{key}" for key in (*string.ascii_lowercase, *string.digits, *PUNCTUATION)),
    *(f"K_{key}" for key in ("UP", "DOWN", "LEFT", "RIGHT", "SPACE", "TAB")),
    *("K_RETURN", "K_ESCAPE", "K_LSHIFT", "K_LCTRL", "QUIT", "KEYDOWN", "KEYUP", "MOUSEBUTTONDOWN", "MOUSEBUTTONUP"),
    *("MOUSEMOTION", "JOYAXISMOTION", "JOYBUTTONDOWN", "JOYBUTTONUP"),
    *("RESIZABLE", "FULLSCREEN", "DOUBLEBUF", "HWSURFACE"),
)
"""The names that `from pygame.locals import *` imports."""


def key_of(name: object) -> str:
    """Return our name of a key that a script names in another way."""
    text = str(name) if len(str(name)) == 1 else str(name).lower().removesuffix(" arrow")
    return ALIASES.get(text, text)


def parse_keys(text: str | None) -> tuple[str, ...]:
    """Return the keys in a text such as "w,w,space,q". Raises UsageError."""
    keys = tuple(map(key_of, text.split(","))) if text else ()
    for key in keys:
        if len(key) != 1 and key not in NAMED:
            raise UsageError(f"--keys {text}: {key!r} is no key; there are single characters, {', '.join(NAMED)}")
    return keys


class Keyboard:
    """Presses `keys`; a script waits by `pass_time`, and `now_s` is its time. `thread` makes the script's threads."""

    def __init__(
        self,
        pass_time: Callable[[float], object],
        now_s: Callable[[], float],
        keys: Sequence[str] = (),
        thread: type[threading.Thread] = threading.Thread,
    ) -> None:
        self.pass_time, self.now_s, self.keys = pass_time, now_s, keys
        self._thread = thread
        self._place, self._noticed_s, self._told = 0, inf, False

    def down(self) -> str | None:
        if self._place < len(self.keys):
            since_s = self.now_s() - self._noticed_s
            if since_s < HELD_S:
                return self.keys[self._place]
            if since_s >= 2 * HELD_S:
                self._place, self._noticed_s, self._told = self._place + 1, inf, False
                return self.down()
        return None

    def is_down(self, name: object) -> bool:
        """Return whether a key is down, which has been noticed then."""
        if self.down() != key_of(name):
            return False
        self._noticed_s = min(self._noticed_s, self.now_s())
        return True

    def has_next(self) -> bool:
        """Return whether a key is down that `next` has not returned."""
        return self.down() is not None and not self._told

    def next(self, timeout_s: float = inf) -> str | None:
        """Wait for a key that has not been returned; None after the time, or at once where that is endless in vain."""
        while not self.has_next():
            if self._place == len(self.keys):
                if timeout_s < inf:
                    self.pass_time(timeout_s)
                return None
            if timeout_s <= 0:
                return None
            pause_s = min(timeout_s, max(POLL_S, self._noticed_s + 2 * HELD_S - self.now_s()))
            self.pass_time(pause_s)
            timeout_s -= pause_s
        key = self.down()
        self._told = self.is_down(key)
        return key

    def read(self) -> str:
        """Wait for a key; Enter where no more keys come."""
        if (key := self.next()) is None:
            self.pass_time(KEY_S)
        return key or "enter"

    def listener(self, press: Callable[[str], object], release: Callable[[str], object]) -> threading.Thread:
        """Return a thread of the script's that tells what is pressed and released until a call returns False."""

        def tell() -> None:
            while (key := self.next()) is not None and press(key) is not False:
                self.pass_time(HELD_S)
                if release(key) is False:
                    return

        return self._thread(target=tell, daemon=True)


class Stub:
    """Any other object of such a module: it can be called, indexed, drawn on and derived from, and does nothing."""

    def __init__(self, *arguments: object, **options: object) -> None:
        pass

    def __call__(self, *arguments: object, **options: object) -> object:
        return Stub()

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        return Stub()

    def __mro_entries__(self, bases: object) -> tuple[type]:
        return (Stub,)

    def __enter__(self) -> object:
        return self

    def __iter__(self) -> Iterator[object]:
        return iter(())

    def _nothing(self, *arguments: object) -> int:
        return 0

    __len__ = __int__ = __index__ = _nothing

    def __float__(self) -> float:
        return 0.0

    def __getitem__(self, key: object) -> bool:
        return False

    def __exit__(self, *exception: object) -> None:
        pass


class StubModule(ModuleType):
    """A module whose unknown names are modules, Stubs or, in capitals, distinct numbers."""

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        if (whole := f"{self.__name__}.{name}") in NAMES:
            return import_module(whole)
        value = _number_of(name) if name.isupper() or name.startswith("K_") else Stub()
        setattr(self, name, value)
        return value


@contextmanager
def key_modules(keyboard: Keyboard) -> Iterator[None]:
    """Let a script's imports find the stand-ins, if it presses keys or if there is no other such module.

    Those of libraries do not: one may try an import and manage without it.
    """

    def made(name: str) -> ModuleType:
        if "." not in name:
            keys = "only those of --keys are pressed" if keyboard.keys else "no key is ever pressed (--keys)"
            why = "" if keyboard.keys else " is not installed"
            print(f"uavaccel: {name}{why}: a stand-in takes its place, and {keys}", file=sys.stderr, flush=True)
        module = StubModule(name)
        vars(module).update(NAMES[name](keyboard) if name in NAMES else {})
        return module

    def find(name: str) -> Callable[[], ModuleType] | None:
        wanted = name.partition(".")[0] in ROOTS and called_by_a_script({"importlib", "_frozen_importlib"})
        return partial(made, name) if wanted else None

    with ModuleFinder(find).finding(0 if keyboard.keys else len(sys.meta_path)):
        yield


class Hooks:
    """The module `keyboard`."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard = keyboard
        self._hooks: list[tuple[str, str, Callable[[object], object]]] = []
        self._thread: threading.Thread | None = None
        self.read_key = lambda *arguments, **options: keyboard.read()
        self.hook, self.on_press, self.on_release = (partial(self._add, kind, "") for kind in ("", "down", "up"))
        self.on_press_key, self.on_release_key = (partial(self._add, kind) for kind in ("down", "up"))

    def is_pressed(self, hotkey: object) -> bool:
        self._keyboard.pass_time(POLL_S)
        return self._keyboard.is_down(hotkey)

    def wait(self, hotkey: object = None, *_: object, **options: object) -> None:
        if self._thread is not None:
            self._thread.join()
            return
        while (pressed := self._keyboard.next()) is not None:
            if pressed == key_of(hotkey):
                return
        self._keyboard.pass_time(KEY_S)

    def record(self, until: object = "esc", *_: object, **options: object) -> list[object]:
        self.wait(until)
        return []

    def read_event(self, *_: object, **options: object) -> object:
        return self._event("down", self._keyboard.read())

    def add_hotkey(
        self, hotkey: object, callback: Callable[..., object], args: Sequence[object] = (), *_: object, **__: object
    ) -> None:
        self._add("down", hotkey, lambda event: callback(*args))

    def _add(self, kind: str, key: object, callback: Callable[[object], object], *_: object, **__: object) -> None:
        self._hooks.append((kind, key_of(key), callback))
        if self._thread is None:
            self._thread = self._keyboard.listener(partial(self._tell, "down"), partial(self._tell, "up"))
            self._thread.start()

    def _tell(self, kind: str, key: str) -> None:
        for wanted, of_key, callback in self._hooks:
            if wanted in (kind, "") and of_key in (key, ""):
                callback(self._event(kind, key))

    def _event(self, kind: str, key: str) -> SimpleNamespace:
        time_s = self._keyboard.now_s()
        return SimpleNamespace(event_type=kind, name=key, scan_code=_number_of(key), time=time_s)


class Console:
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


class Events:
    """The modules `pygame.event` and `pygame.key`."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard, self._held = keyboard, ""

    def get(self, *kinds: object, **options: object) -> list[object]:
        self._keyboard.pass_time(POLL_S)
        events: list[object] = []
        if self._held and self._keyboard.down() != self._held:
            events.append(_event("KEYUP", self._held))
            self._held = ""
        if self._keyboard.has_next() and (key := self._keyboard.next(0.0)) is not None:
            self._held = key
            events.append(_event("KEYDOWN", key))
        return events

    def poll(self) -> object:
        return next(iter(self.get()), Stub())

    def wait(self, timeout: float = 0) -> object:
        """Wait for a key, for `timeout` milliseconds or, with 0, until no more keys come."""
        if (key := self._keyboard.next(timeout / 1000 if timeout > 0 else inf)) is not None:
            return _event("KEYDOWN", key)
        if timeout <= 0:
            self._keyboard.pass_time(KEY_S)
        return Stub()

    def get_pressed(self) -> object:
        self._keyboard.pass_time(POLL_S)
        return Pressed(self._keyboard)

    def name(self, key: int) -> str:
        return PYGAME_NAMES.get(key, "")

    get_mods = staticmethod(int)


def _event(kind: str, key: str) -> SimpleNamespace:
    text = key if len(key) == 1 else ""
    return SimpleNamespace(type=_number_of(kind), key=PYGAME_KEYS[key], unicode=text, mod=0)


class Pressed(Stub):
    """What pygame.key.get_pressed returns: whether a key is down, by its constant."""

    def __init__(self, keyboard: Keyboard) -> None:
        self.is_down = keyboard.is_down

    def __getitem__(self, key: object) -> bool:
        return any(self.is_down(name) for name, number in PYGAME_KEYS.items() if number == key)


class Time:
    """The module `pygame.time`."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard, self._begun_s = keyboard, keyboard.now_s()
        self.Clock = partial(Clock, keyboard)

    def wait(self, milliseconds: float) -> int:
        self._keyboard.pass_time(milliseconds / 1000)
        return int(milliseconds)

    delay = wait

    def get_ticks(self) -> int:
        return round(1000 * (self._keyboard.now_s() - self._begun_s))


class Clock:
    """pygame.time.Clock: `tick` waits for the end of a frame."""

    get_fps = staticmethod(float)

    def __init__(self, keyboard: Keyboard) -> None:
        self._sleep, self._now_s, self._ticked_s = keyboard.pass_time, keyboard.now_s, keyboard.now_s()

    def tick(self, framerate: float = 0) -> int:
        """Wait until 1 / `framerate` seconds after the last tick; returns the milliseconds since then."""
        self._sleep(max(0.0, self._ticked_s + (1 / framerate if framerate else 0.0) - self._now_s()))
        before_s, self._ticked_s = self._ticked_s, self._now_s()
        return round(1000 * (self._ticked_s - before_s))

    tick_busy_loop = tick


class KeyCode(NamedTuple):
    """pynput's key with a character."""

    char: str

    def __str__(self) -> str:
        return repr(self.char)

    @classmethod
    def from_char(cls, char: str) -> KeyCode:
        return cls(char)


class NamedKey(NamedTuple):
    """pynput's key without a character."""

    name: str

    def __repr__(self) -> str:
        return f"Key.{self.name}"


class Listener:
    """pynput.keyboard.Listener, which tells of keys in a thread of the script's."""

    running = False

    def __init__(
        self,
        keyboard: Keyboard,
        on_press: Callable[[object], object] | None = None,
        on_release: Callable[[object], object] | None = None,
        **options: object,
    ) -> None:
        self._thread = keyboard.listener(*(partial(self._tell, act or Stub) for act in (on_press, on_release)))
        self.join, self.is_alive = self._thread.join, self._thread.is_alive

    def start(self) -> None:
        self.running = True
        self._thread.start()

    def _tell(self, act: Callable[[object], object], name: str) -> object:
        return self.running and act(getattr(NAMED_KEYS, name) if name in NAMED else KeyCode(name))

    def stop(self) -> None:
        self.running = False

    def __enter__(self) -> Listener:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()


def _number_of(name: str) -> int:
    """Return a constant's number: the same in every process, and very likely distinct."""
    return 256 + zlib.crc32(name.encode()) % (1 << 30)


def _public(kind: Callable[[Keyboard], object], keyboard: Keyboard) -> Mapping[str, object]:
    """Return the public names of a new object, as those of a module."""
    made = kind(keyboard)
    return {name: getattr(made, name) for name in dir(made) if not name.startswith("_")}


ARROWS = {"up": "H", "down": "P", "left": "K", "right": "M"}  # msvcrt's second characters
NAMED_KEYS = StubModule("Key")
vars(NAMED_KEYS).update({name: NamedKey(name) for name in NAMED})
PYGAME_KEYS = {key: _number_of(f"K_{key.lower()}") for key in string.ascii_letters + string.digits}
PYGAME_KEYS |= {key: _number_of(f"K_{name}") for key, name in zip(string.punctuation, PUNCTUATION, strict=True)}
PYGAME_KEYS |= {name: _number_of(f"K_{name.upper()}") for name in NAMED}
PYGAME_KEYS |= {"enter": _number_of("K_RETURN"), "esc": _number_of("K_ESCAPE")}
"""pygame's number of a key, by our name."""
PYGAME_NAMES = {number: key.lower() for key, number in PYGAME_KEYS.items()}
PYGAME_NAMES |= {_number_of("K_RETURN"): "return", _number_of("K_ESCAPE"): "escape"}
NAMES: dict[str, Callable[[Keyboard], Mapping[str, object]]] = {
    "keyboard": partial(_public, Hooks),
    "msvcrt": partial(_public, Console),
    "pynput.keyboard": lambda keys: {"Key": NAMED_KEYS, "KeyCode": KeyCode, "Listener": partial(Listener, keys)},
    "pygame": lambda keyboard: {"init": lambda: (0, 0), "error": type("error", (RuntimeError,), {})},
    "pygame.joystick": lambda keyboard: {"get_count": lambda: 0, "get_init": lambda: False},
    "pygame.locals": lambda keyboard: {name: _number_of(name) for name in CONSTANTS},
    **dict.fromkeys(("pygame.event", "pygame.key"), partial(_public, Events)),
    "pygame.time": partial(_public, Time),
}
"""What does something in each module, by name."""
