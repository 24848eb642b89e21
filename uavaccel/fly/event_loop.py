"""asyncio on a simulated clock: an event loop that waits lets that clock pass, and other threads of the script run."""

from __future__ import annotations

import selectors
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING

from uavaccel.fly.modules import called_by_a_script
from uavaccel.fly.patches import Patches
from uavaccel.fly.turns import Turns
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:
    import asyncio

FREE_TURNS = (
    100  # of a loop while the clock stands; each one more looks at the clock, so that one that polls ends
)


class SimulatedSelector:
    """What an event loop waits in. `look` lets as much time pass as a look at the clock does.

    What sockets and pipes bring is there when the machine brings it: it is waited for where nothing else can go on.
    """

    def __init__(self, selector: selectors.BaseSelector, turns: Turns, look: Callable[[], object]) -> None:
        self._selector, self._turns, self._look = selector, turns, look
        self._stood_ns, self._turns_since = 0, 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready: list[tuple[selectors.SelectorKey, int]] = []

        def happened() -> bool:
            ready[:] = self._selector.select(0)
            return bool(ready)

        if timeout is not None and timeout <= 0:
            self._let_others_run()
            happened()
        else:
            self._turns.until(happened, timeout, lambda: self._selector.select(None))
        return ready

    def _let_others_run(self) -> None:
        now_ns = self._turns.now_ns()
        self._turns_since = self._turns_since + 1 if now_ns == self._stood_ns else 0
        if self._turns_since > FREE_TURNS:
            self._look()
        self._stood_ns = self._turns.now_ns()
        self._turns.wait_until(self._stood_ns)

    def __getattr__(self, name: str) -> object:
        return getattr(self._selector, name)


def loops_taking_turns(
    module: ModuleType, patches: Patches, turns: Turns, look: Callable[[], object]
) -> None:
    """Let event loops of asyncio.selector_events that a script makes live on its clock."""
    original: Callable[..., None] = module.BaseSelectorEventLoop.__init__

    def init(self: asyncio.BaseEventLoop, selector: selectors.BaseSelector | None = None) -> None:
        if not (turns.is_mine() and called_by_a_script()):
            return original(self, selector)
        self.time = lambda: turns.now_ns() / NS_PER_S  # type: ignore[method-assign]
        return original(self, SimulatedSelector(selector or selectors.DefaultSelector(), turns, look))

    patches.set(module.BaseSelectorEventLoop, "__init__", init)
