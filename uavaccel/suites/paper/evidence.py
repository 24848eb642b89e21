"""The numbers that decide claims, out of the runs of the paper's experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.metrics.intervals import median_interval
from uavaccel.records import RunDirectory

Cell = Mapping[str, Any]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Finding:
    """What a run says of a claim: its number with its interval in words, and whether the claim holds in it."""

    value: str
    holds: bool


@dataclass(frozen=True)
class Trajectories:
    """A run of DP1: its cells, and the STLC of each of their games."""

    cells: Sequence[Cell]
    games: Sequence[Cell]
    seed: int

    @classmethod
    def of(cls, run: RunDirectory) -> Trajectories:
        summary = run.read_json("summary.json")
        return cls(summary["cells"], run.read_json("scores.json"), summary["seed"])

    @property
    def clocks(self) -> list[float]:
        """The ClockSpeeds above 1."""
        return sorted({cell["clock_speed"] for cell in self.cells if cell["clock_speed"] > 1})

    def stlc(self, command: str, clock_speed: float, rounds: int | None = None) -> FloatArray:
        """STLC of the games, T_moves pooled, and rounds too unless one is asked for; KeyError if none was flown."""
        values = [
            cell["stlc"]
            for cell in self.games
            if (cell["command"], cell["clock_speed"]) == (command, clock_speed)
            and rounds in (None, cell["rounds"])
        ]
        if not values:
            raise KeyError(f"{command} at {clock_speed:g}x was not flown")
        return np.concatenate([np.asarray(each, float) for each in values])

    def median(self, command: str, clock_speed: float) -> float:
        """Pooled median STLC, as in the paper's Figure 5."""
        return float(np.median(self.stlc(command, clock_speed)))

    def interval(self, command: str, clock_speed: float) -> str:
        """The median with its 95 % bootstrap interval over games."""
        low, high = median_interval(self.stlc(command, clock_speed), self.seed)
        return f"{self.median(command, clock_speed):.3f} [{low:.3f}, {high:.3f}]"

    @property
    def most_rounds(self) -> int:
        """The longest path's rounds."""
        return max(int(cell["rounds"]) for cell in self.cells)

    def cell(self, command: str, clock_speed: float, t_move_s: float, rounds: int) -> Cell:
        """One cell of the summary."""
        key = (command, clock_speed, t_move_s, rounds)
        names = ("command", "clock_speed", "t_move_s", "rounds")
        return next(cell for cell in self.cells if tuple(cell[name] for name in names) == key)

    def column(self, key: str, command: str, clock_speed: float, rounds: int | None = None) -> FloatArray:
        """A key of the cells of a command and ClockSpeed, by T_move."""
        chosen = [
            cell
            for cell in self.cells
            if (cell["command"], cell["clock_speed"]) == (command, clock_speed)
            and rounds in (None, cell["rounds"])
        ]
        return np.array([float(cell[key]) for cell in sorted(chosen, key=lambda cell: cell["t_move_s"])])


@dataclass(frozen=True)
class Images:
    """A run of DP2: its cells of TCSC by ClockSpeed."""

    cells: Mapping[float, Cell]

    @classmethod
    def of(cls, run: RunDirectory) -> Images:
        cells = run.read_json("summary.json")["cells"]
        return cls({cell["clock_speed"]: cell for cell in cells if cell["command"] == "tcsc"})


@dataclass(frozen=True)
class Policies:
    """A run of the suite `rl`: evaluation games won by command and ClockSpeed of the training, seeds pooled."""

    cells: Sequence[Cell]
    interchange: Sequence[Cell] = ()
    """Policies flown with both commands, seeds pooled."""

    @classmethod
    def of(cls, run: RunDirectory, profile: str) -> Policies:
        """Of the profile's trainings on the virtual clock, those without a variant."""
        summary = run.read_json("summary.json")
        wanted = (profile, "virtual", "")
        return cls(
            *([cell for cell in summary[part] if _kind(cell) == wanted] for part in ("cells", "interchange"))
        )

    def counts(self, command: str, clock_speed: float) -> tuple[int, int]:
        """Successes and games; (0, 0) where nothing was trained."""
        chosen = self._cells(command, clock_speed)
        return sum(cell["successes"] for cell in chosen), sum(cell["games"] for cell in chosen)

    def speedup(self, clock_speed: float) -> float | None:
        """Mean simulation-only speed-up of TCSC's trainings, on their modelled clock; None without one."""
        return self._mean("training_speedup", clock_speed)

    def whole_speedup(self, clock_speed: float) -> float | None:
        """The same with image processing, inference and learning."""
        return self._mean("whole_training_speedup", clock_speed)

    def accelerated(self, command: str) -> list[float]:
        """ClockSpeeds above 1 at which the command was trained."""
        return sorted(
            {c["clock_speed"] for c in self.cells if c["command"] == command and c["clock_speed"] > 1}
        )

    def _mean(self, key: str, clock_speed: float) -> float | None:
        values = [cell[key] for cell in self._cells("tcsc", clock_speed)]
        return float(np.mean(values)) if values and None not in values else None

    def _cells(self, command: str, clock_speed: float) -> list[Cell]:
        return [
            cell for cell in self.cells if (cell["command"], cell["clock_speed"]) == (command, clock_speed)
        ]


def _kind(cell: Cell) -> tuple[str, str, str]:
    return cell["profile"], cell["timing"], cell["variant"]
