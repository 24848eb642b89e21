"""Domain randomisation: conditions of a game drawn at reset, each uniformly from a range (Tobin et al., IROS 2017).

The ranges may widen with the games flown, a curriculum from the task as it is configured to the whole ranges.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from uavaccel.config import Config


def _rising(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"must be [least, most], not {list(ends)}")
    return ends


Share = Annotated[float, Field(gt=0.0, le=1.0)]
Range = Annotated[tuple[float, float], AfterValidator(_rising)]


class Condition(NamedTuple):
    """What a lane is flown under: its short name in a sweep, its key in the task, and its unit."""

    short: str
    key: str
    unit: str = ""


class Ranges(Config):
    """Ranges [least, most] of what is drawn for each game; what has none stays as the task has it.

    Names and units are those of the task's keys, of its difficulty and of its latency model. The fields are the table
    of conditions: a sweep, a robustness map and the documentation take names, keys and units from here.
    """

    wind_m_s: Annotated[Range | None, Condition("wind", "difficulty.wind_m_s", "m/s")] = None
    """Wind, in m/s."""
    light: Annotated[Range | None, Condition("light", "difficulty.light", "of daylight")] = None
    """Share of daylight."""
    texture_variation: Annotated[Range | None, Condition("textures", "difficulty.texture_variation")] = None
    """How much textures vary between lanes."""
    row_spacing_m: Annotated[Range | None, Condition("spacing", "difficulty.row_spacing_m", "m")] = None
    """Metres between two rows."""
    min_gap_m: Annotated[Range | None, Condition("gap", "difficulty.min_gap_m", "m")] = None
    """Metres that neighbours keep between each other."""
    mass_ratio: Annotated[Range | None, Condition("mass", "difficulty.mass_ratio", "× AirSim's")] = None
    """Mass and inertia, times the vehicle's own."""
    thrust_ratio: Annotated[Range | None, Condition("thrust", "difficulty.thrust_ratio", "× AirSim's")] = None
    """Thrust of the rotors, times the vehicle's own."""
    speed_m_s: Annotated[Range | None, Condition("speed", "speed_m_s", "m/s")] = None
    """Speed of a command, in m/s."""
    altitude_m: Annotated[Range | None, Condition("height", "altitude_m", "m")] = None
    """Height of the flight, in metres."""
    dvs_threshold_ratio: Annotated[
        Range | None, Condition("threshold", "dvs_threshold_ratio", "× the preset's")
    ] = None
    """Thresholds of the event camera, times the preset's."""
    dvs_spread_ratio: Annotated[Range | None, Condition("spread", "dvs_spread_ratio", "× the preset's")] = (
        None
    )
    """Spread of its thresholds, times the preset's."""
    dvs_shot_noise_hz: Annotated[Range | None, Condition("shot_noise", "dvs_shot_noise_hz", "Hz")] = None
    """Shot-noise events per pixel and second, beside the preset's."""
    dvs_leak_hz: Annotated[Range | None, Condition("leak", "dvs_leak_hz", "Hz")] = None
    """Leak events per pixel and second, beside the preset's."""
    dvs_hot_pixels: Annotated[Range | None, Condition("hot_pixels", "dvs_hot_pixels", "of all")] = None
    """Share of hot pixels."""
    image_noise: Annotated[Range | None, Condition("image_noise", "image_noise", "of 255")] = None
    """Standard deviation of the image noise, in grey levels of 255."""
    latency_scale: Annotated[Range | None, Condition("latency", "latency.scale", "× the model's")] = None
    """Of timing virtual alone."""
    share: Share = 1.0
    """Probability of each condition to be drawn for a game; else it stays as the task has it."""
    shares: dict[str, Share] = Field(default_factory=dict)
    """The same of single conditions, where it is not `share`: {wind_m_s: 0.6}."""
    widen_over_games: Annotated[int, Field(ge=0)] = 0
    """Games of each environment, in the training split, over which the ranges widen to the whole; 0: whole at once."""

    @model_validator(mode="after")
    def _shares_have_ranges(self) -> Self:
        ranges = self.given()
        for name in self.shares:
            if name not in ranges:
                raise ValueError(
                    f"shares.{name}: there is no range of it; there are {', '.join(ranges) or 'none'}"
                )
        return self

    @model_validator(mode="after")
    def _something_is_drawn(self) -> Self:
        if self.model_fields_set and not self.given():
            raise ValueError("needs a range of what is to be drawn, as wind_m_s: [0, 3]")
        return self

    @property
    def all_drawn(self) -> bool:
        """Whether each game has all of the conditions."""
        return all(self._share_of(name) == 1.0 for name in self.given())

    def _share_of(self, name: str) -> float:
        return self.shares.get(name, self.share)

    def given(self) -> dict[str, tuple[float, float]]:
        """The ranges that there are, in the order in which they are drawn."""
        ranges = {name: getattr(self, name) for name in DRAWN}
        return {name: ends for name, ends in ranges.items() if ends is not None}

    def widened(self, games: int, usual: Mapping[str, tuple[float, float]]) -> Self:
        """The ranges after so many games, on the way from the `usual` ones."""
        share = min(games / self.widen_over_games, 1.0) if self.widen_over_games else 1.0
        if share == 1.0:
            return self
        between = {
            name: tuple(start + share * (end - start) for start, end in zip(usual[name], ends, strict=True))
            for name, ends in self.given().items()
        }
        return self.model_copy(update=between)

    def draw(self, random: np.random.Generator) -> dict[str, float]:
        """A number from each range, or from a share of them."""
        drawn = {name: float(random.uniform(*ends)) for name, ends in self.given().items()}
        if self.all_drawn:
            return drawn
        return {name: value for name, value in drawn.items() if random.random() < self._share_of(name)}


DRAWN = {
    name: each
    for name, field in Ranges.model_fields.items()
    for each in field.metadata
    if isinstance(each, Condition)
}
"""The conditions that can be drawn, by their field of `Ranges`."""
NOT_DRAWN = (
    Condition("scenery", "difficulty.scenery"),
    Condition("sensor", "dvs_preset"),
    Condition("clock", "clock_speed", "x"),
    Condition("command", "command"),
    Condition("profile", "profile"),
)
CONDITIONS = {each.short: each for each in (*DRAWN.values(), *NOT_DRAWN)}
"""All conditions by their short name."""
OF_DIFFICULTY = tuple(name for name, each in DRAWN.items() if each.key == f"difficulty.{name}")
OF_TASK = tuple(name for name, each in DRAWN.items() if each.key == name)
OF_SENSOR = tuple(name for name in OF_TASK if name not in ("speed_m_s", "altitude_m"))
LATENCY = "latency_scale"


def corners(ranges: Mapping[str, tuple[float, float]], alone: bool = False) -> list[dict[str, float]]:
    """All least, all most, and the most with the weakest motors: where one of all that is drawn cannot be flown.

    With `alone`, for conditions that are drawn without the others, each of their ends too.
    """
    least, most = ({name: ends[end] for name, ends in ranges.items()} for end in (0, 1))
    weakest = {name: value for name, value in least.items() if name == "thrust_ratio"}
    single = [{name: end} for name, ends in ranges.items() for end in ends] if alone else []
    return [least, most, {**most, **weakest}, *single]


def keys_of(conditions: Mapping[str, float]) -> dict[str, Any]:
    """The conditions as a task's keys: those of its difficulty and its latency one level down."""
    difficulty: dict[str, Any] = {name: conditions[name] for name in OF_DIFFICULTY if name in conditions}
    if "light" in difficulty:
        difficulty["light"] = (difficulty["light"], difficulty["light"])
    latency = {"scale": conditions[LATENCY]} if LATENCY in conditions else {}
    keys: dict[str, Any] = {name: conditions[name] for name in OF_TASK if name in conditions}
    return keys | {"difficulty": difficulty, "latency": latency}
