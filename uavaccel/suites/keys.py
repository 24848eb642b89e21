"""The keys of configurations that have options of their own on the command line; it loads nothing, for --help."""

from __future__ import annotations

from typing import NamedTuple


class Key(NamedTuple):
    """A key's option, the kind of its values, how help shows them, and what it says."""

    option: str
    kind: type
    shown: str
    help: str


KEYS = {
    "clock_speed": Key("--clock", float, "X", "ClockSpeed"),
    "command": Key("--command", str, "adsc|tcsc", "tcsc pauses the simulation while the program works, adsc does not"),
    "t_move_s": Key("--t-move", float, "S", "Simulated seconds of a command"),
    "rounds": Key("--rounds", int, "N", "Rounds of the path"),
    "games": Key("--games", int, "N", "Games of each cell; of a training episodes, of an evaluation lanes"),
    "timing": Key(
        "--timing", str, "wall|virtual|lockstep", "Measured on the machine's clock, modelled, or without latency"
    ),
    "profile": Key("--profile", str, "native|airsim", "Exact to the physics step, or as AirSim handles time"),
    "seed": Key("--seed", int, "N", "Random seed"),
    "seeds": Key("--seeds", int, "N", "Trainings, with seeds counted up from --seed; for rl of each cell"),
    "with_run": Key("--with", str, "RUN_DIR", "For paper: a run of rl, which decides what needs training"),
}
