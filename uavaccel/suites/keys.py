"""The keys of configurations that have options of their own on the command line; it loads nothing, for --help."""

from __future__ import annotations

from typing import NamedTuple


class Key(NamedTuple):
    """A key's option, the kind of its values, and the words that it takes, if these are few."""

    option: str
    kind: type
    help: str
    words: tuple[str, ...] = ()


KEYS = {
    "clock_speed": Key("--clock", float, "ClockSpeed"),
    "command": Key("--command", str, "adsc or tcsc", ("adsc", "tcsc")),
    "t_move_s": Key("--t-move", float, "Duration of a command in seconds"),
    "rounds": Key("--rounds", int, "Rounds of the path"),
    "games": Key("--games", int, "Number of games: per cell, to learn from, or of evaluation lanes"),
    "timing": Key(
        *("--timing", str, "wall (measured), virtual (modelled) or lockstep (no latency)"),
        words=("wall", "virtual", "lockstep"),
    ),
    "profile": Key("--profile", str, "native or airsim", ("native", "airsim")),
    "seed": Key("--seed", int, "Seed of every random number"),
    "seeds": Key("--seeds", int, "Trainings, of each cell for rl: seed, seed + 1 and so on"),
    "with_run": Key("--with", str, "For paper: a run of rl, which decides what needs training"),
}
