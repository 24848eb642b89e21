"""Where on a flight's wall clock the spectator is: playing slowly, paused, or stepping. Pure, told what time passes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Playhead:
    """Seconds of the flights' wall clock; `slowness` of the spectator's own seconds show one of them."""

    end_s: float
    slowness: float
    step_s: float
    at_s: float = 0.0
    playing: bool = True

    def pass_time(self, seconds: float) -> None:
        """The spectator's clock went on; at the end the flight stands."""
        if self.playing:
            self.seek(self.at_s + seconds / self.slowness)
            self.playing = self.at_s < self.end_s

    def toggle(self) -> None:
        """Pause, or go on; at the end begin anew."""
        if self.at_s >= self.end_s:
            self.at_s = 0.0
        self.playing = not self.playing

    def step(self) -> None:
        """One step on, and pause there."""
        self.playing = False
        self.seek(self.at_s + self.step_s)

    def seek(self, at_s: float) -> None:
        """Go to a moment of the flight."""
        self.at_s = min(max(at_s, 0.0), self.end_s)

    def replay(self) -> None:
        """Begin anew."""
        self.at_s, self.playing = 0.0, True
