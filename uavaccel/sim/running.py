"""What of a simulation will end by itself: a command, a continue-for; and the replies that wait for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from uavaccel.sim.saved import State, number_or_none, optional


class DeferredReply:
    """A reply that is not yet due: `join` of a command, or a continue-for."""

    def __init__(self) -> None:
        self.value: Any = None
        self.encode: Callable[[Any], Any] = lambda value: value  # as the wire wants it
        self.due_wall_ns: int | None = None
        self.on_due: Callable[[DeferredReply], None] | None = None

    def resolve(self, value: Any, wall_ns: int) -> None:
        """Fix the reply and the wall time before which it may not leave."""
        self.value, self.due_wall_ns = value, wall_ns
        if self.on_due is not None:
            self.on_due(self)


@dataclass
class Command:
    end_tick: int
    reply: DeferredReply


@dataclass
class Continue:
    """A running continue-for: up to a tick, or in `airsim` up to a wall time."""

    reply: DeferredReply
    end_tick: int | None = None
    end_wall_ns: int | None = None


@dataclass
class Running:
    """At most one of each."""

    command: Command | None = None
    period: Continue | None = None

    def next_end_tick(self) -> int | None:
        """The tick at which something ends, unless a message comes first."""
        command, period = self.command, self.period
        if period is None or period.end_tick is None:
            return command.end_tick if command else None
        return min(command.end_tick, period.end_tick) if command else period.end_tick

    def get_state(self) -> State:
        """When they end; the replies are not in it."""
        command, period = self.command, self.period
        return {
            "command_end_tick": optional(command.end_tick if command else None),
            "period_end_tick": optional(period.end_tick if period else None),
            "period_end_wall_ns": optional(period.end_wall_ns if period else None),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Back to what `get_state` gave, for replies that nobody waits for."""
        end_tick = number_or_none(state["command_end_tick"])
        self.command = None if end_tick is None else Command(end_tick, DeferredReply())
        ends = [number_or_none(state[f"period_end_{unit}"]) for unit in ("tick", "wall_ns")]
        self.period = None if ends == [None, None] else Continue(DeferredReply(), *ends)
