"""Where the time of a training goes, and how fast it was (the paper's Figure 9, section IV-D)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uavaccel.draw import style
from uavaccel.draw.style import clock_label, command_name
from uavaccel.envs.stopwatch import PHASES
from uavaccel.records import RunDirectory
from uavaccel.suites.disturbed import disturbed_words
from uavaccel.suites.host_time import over_all_starts, wall_s
from uavaccel.suites.report import listed

UNITS_S = {"hours": 3600.0, "minutes": 60.0, "seconds": 1.0}
LETTER_IN = 0.085  # width of a label's letter


@dataclass(frozen=True)
class PhaseTimes:
    """Seconds of a training by phase, those of the lanes summed over all, and how fast it was all in all."""

    label: str
    phase_s: Mapping[str, float]
    simulated_s_per_wall_s: float


def draw_trainings(runs: Sequence[RunDirectory], path: Path) -> Path:
    """Figure 9 with a bar for each training; returns `path`."""
    return style.save(plot_phases(told_apart(runs), trainings_source(runs)), path)


def trainings_source(runs: Sequence[RunDirectory]) -> str:
    """The line below it."""
    games = listed(sorted({len(run.rows()) for run in runs}))
    seeds = listed(sorted({run.config()["seed"] for run in runs}))
    clocks = " and ".join(sorted({_clock(run) for run in runs}))
    disturbed = disturbed_words([row for run in runs for row in run.rows()])
    return " · ".join([clocks, f"{games} games", f"seed {seeds}", *disturbed])


def told_apart(runs: Sequence[RunDirectory]) -> list[PhaseTimes]:
    """Times of the trainings; where labels are alike, each has its folder below."""
    trainings = [phase_times(run) for run in runs]
    named = Counter(training.label for training in trainings)
    return [
        replace(training, label=f"{training.label}\n{run.path}") if named[training.label] > 1 else training
        for training, run in zip(trainings, runs, strict=True)
    ]


def phase_times(run: RunDirectory) -> PhaseTimes:
    """Of a training: by its own clock where that is simulated, else by the machine's."""
    config, rows = run.config(), run.rows()
    task = config["task"]
    flown_by = f"{command_name(task['command'])} {clock_label(task['clock_speed'])}"
    label = f"{flown_by}\n{task['timing']}, seed {config['seed']}"
    sim_time_s = sum(row["sim_time_s"] for row in rows)
    if task["timing"] == "virtual":
        phase_s = {phase: sum(row["phase_s"][phase] for row in rows) for phase in PHASES}
        return PhaseTimes(label, phase_s, sim_time_s / (sum(phase_s.values()) / config["environments"]))
    timings = run.timings()
    flown, learned = Counter[str](), over_all_starts([entry["learner_s"] for entry in timings])
    for entry in timings:
        flown.update(entry["host_phase_s"])
    return PhaseTimes(
        label, {phase: flown[phase] + learned[phase] for phase in PHASES}, sim_time_s / wall_s(run)
    )


def _clock(run: RunDirectory) -> str:
    if run.config()["task"]["timing"] == "virtual":
        return "modelled"
    return "measured, learning beside the flight"


def plot_phases(trainings: Sequence[PhaseTimes], source: str) -> Figure:
    """A bar per training, its phases on top of each other, and the speeds as points on an axis of their own."""
    with style.project_style():
        longest = max(len(line) for training in trainings for line in training.label.splitlines())
        bar_in = max(1.5, LETTER_IN * longest)  # labels are not to run into each other
        figure = style.new_figure(3.2 + bar_in * len(trainings), 4.2, "Time of training by phase", source)
        axes = figure.subplots()
        phase_s = [training.phase_s for training in trainings]
        unit = unit_of(phase_s)
        places = plot_stacked(axes, phase_s, unit)
        axes.set_xticks(places, [training.label for training in trainings])
        axes.set(ylabel=unit, xlim=(-0.6, len(trainings) - 0.4))
        speed = axes.twinx()
        speeds = [training.simulated_s_per_wall_s for training in trainings]
        speed.plot(places, speeds, "o", color=style.BLACK, label="speed (right)")
        speed.set(ylabel="simulated seconds per wall second", ylim=(0, 1.2 * max(speeds)))
        speed.grid(visible=False)
        figure.legend(loc="outside right upper")
        return figure


def unit_of(phase_s: Sequence[Mapping[str, float]]) -> str:
    """The largest unit in which the longest of several trainings is 1 or more."""
    longest_s = max(sum(spent.values()) for spent in phase_s)
    return next((unit for unit, unit_s in UNITS_S.items() if longest_s >= unit_s), "seconds")


def plot_stacked(axes: Axes, phase_s: Sequence[Mapping[str, float]], unit: str) -> NDArray[np.int64]:
    """A bar for each training, its phases on top of each other; the bars' places (n,)."""
    places, below = np.arange(len(phase_s)), np.zeros(len(phase_s))
    for phase, colour in zip(phase_s[0], style.CYCLE, strict=False):
        spent = np.array([each[phase] for each in phase_s]) / UNITS_S[unit]
        axes.bar(places, spent, 0.55, below, color=colour, label=phase.replace("_", " "))
        below += spent
    return places
