"""A world that is looked at while it flies: at fixed ticks, in the middle of whatever was asked of it."""

from __future__ import annotations

from collections.abc import Callable

from uavaccel.sim.profile import Profile
from uavaccel.sim.world import World


class WatchedWorld(World):
    """A `World` that calls back at every so many ticks, once `watch` was called. Looking changes no flight."""

    def __init__(self, scene: str, profile: Profile, furnished: bool = False) -> None:
        super().__init__(scene, profile, furnished)
        self._watchers: list[tuple[int, int, Callable[[int], None]]] = []

    def watch(self, every_ticks: int, look: Callable[[int], None], first_tick: int = 0) -> Callable[[], None]:
        """Call `look` with the tick at every so many ticks after `first_tick`; what is returned ends that."""
        watcher = every_ticks, first_tick, look
        self._watchers.append(watcher)
        return lambda: self._watchers.remove(watcher)

    def advance(self, ticks: int) -> int:
        """As World.advance; a vehicle that is frozen where it touched something is not looked at any more."""
        flown = 0
        while self._watchers and flown < ticks and not self._frozen:
            to_next = min(every - (self.tick - first) % every for every, first, _ in self._watchers)
            due = min(ticks - flown, to_next)
            chunk = super().advance(due)
            flown += chunk
            if chunk < due:  # a touch
                break
            for every, first, look in tuple(self._watchers):  # one may end itself
                if (self.tick - first) % every == 0:
                    look(self.tick)
        return flown or super().advance(ticks)

    @property
    def _frozen(self) -> bool:
        return self.freeze_on_collision and self.collision_tick is not None
