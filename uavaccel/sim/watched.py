"""A world that is looked at while it flies: at fixed ticks, in the middle of whatever was asked of it."""

from __future__ import annotations

from collections.abc import Callable

from uavaccel.sim.profile import Profile
from uavaccel.sim.world import World


class WatchedWorld(World):
    """A `World` that calls back at every so many ticks, once `watch` was called. Looking changes no flight."""

    def __init__(self, scene: str, profile: Profile) -> None:
        super().__init__(scene, profile)
        self._every_ticks = 0
        self._look: Callable[[int], None]

    def watch(self, every_ticks: int, look: Callable[[int], None]) -> None:
        """Call `look` with the tick whenever it has reached a multiple of `every_ticks`, from now on."""
        self._every_ticks, self._look = every_ticks, look

    def advance(self, ticks: int) -> int:
        """As World.advance; a vehicle that is frozen where it touched something is not looked at any more."""
        every, flown = self._every_ticks, 0
        while every and flown < ticks and not (self.freeze_on_collision and self.collision_tick is not None):
            due = min(ticks - flown, every - self.tick % every)
            flown += super().advance(due)
            if self.tick % every:
                break  # as far as was asked, or up to a touch
            self._look(self.tick)
        return flown or super().advance(ticks)
