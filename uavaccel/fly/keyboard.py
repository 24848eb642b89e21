"""The keys that `--keys` presses, one after the other, on the script's clock; without it no key is ever pressed.

A key is down until the script has noticed it, and for HELD_S more; the next one follows after as long again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from math import inf

from uavaccel.errors import UsageError

POLL_S = 0.001  # what asking for a key costs the script, so that a loop that waits for one comes to an end
KEY_S = 0.1  # after which a call that waits for a key returns where no more keys come
HELD_S = 0.1
NAMED = {"enter": 13, "esc": 27, "space": 32, "tab": 9, "left": 81, "up": 82, "right": 83, "down": 84}
"""Keys that have names, and OpenCV's numbers for them."""
ALIASES = {"return": "enter", "escape": "esc", " ": "space", "\n": "enter", "\r": "enter"}


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
        """Return the key that is down now."""
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
