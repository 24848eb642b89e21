"""Limits of configurations: far beyond any use, and within what numbers, clocks and machines can represent."""

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from uavaccel.units import CLOCK_SPEEDS

MOST_GAMES = 1_000_000
MOST_ROUNDS = 100_000
MOST_SPEED_M_S = 1_000.0
MOST_HEIGHT_M = 4_000.0  # in the thinner air above, the quadrotor soon cannot hover
MOST_SECONDS = 86_400.0
MOST_LATENCY_US = 60e6
MOST_SCALE = 1_000.0
MOST_PROCESSES = 1_024
MOST_LANES = 65_536  # over arrays
MOST_SEEDS = 1 << 32

CommandName = Annotated[
    Literal["adsc", "tcsc"], BeforeValidator(lambda name: name.lower() if isinstance(name, str) else name)
]
"""In any case, as the paper and the pages have capitals; kept in lower case."""
Seed = Annotated[int, Field(ge=0, lt=MOST_SEEDS)]
"""A seed that NumPy's and torch's generators accept."""
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Games = Annotated[int, Field(ge=1, le=MOST_GAMES)]
Processes = Annotated[int, Field(ge=1, le=MOST_PROCESSES)]
Lanes = Annotated[int, Field(ge=1, le=MOST_LANES)]
ClockSpeed = Annotated[float, Field(gt=0.0, ge=CLOCK_SPEEDS[0], le=CLOCK_SPEEDS[1])]
Speed = Annotated[float, Field(gt=0.0, le=MOST_SPEED_M_S)]
Velocity = Annotated[float, Field(ge=-MOST_SPEED_M_S, le=MOST_SPEED_M_S)]
Height = Annotated[float, Field(gt=0.0, le=MOST_HEIGHT_M)]
Seconds = Annotated[float, Field(gt=0.0, le=MOST_SECONDS)]
Cost = Annotated[float, Field(ge=0.0, le=3_600.0)]
"""A cost in seconds on a modelled wall clock."""
LatencyUs = Annotated[float, Field(ge=0.0, le=MOST_LATENCY_US)]
