"""Domain randomisation: conditions sampled uniformly at each reset (Tobin et al., IROS 2017).

The ranges may widen with the games flown: a curriculum from the configured task to the full ranges.
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
    """A condition of the flights: its short name in a sweep, its key in the task, and its unit."""

    short: str
    key: str
    unit: str = ""


class Ranges(Config):
    """Ranges [least, most] of the conditions that are sampled for each game; others stay as in the task.

    Names and units are those of the keys of the task, of its difficulty and of its latency model. Sweeps, robustness
    maps and the documentation take names, keys and units of all conditions from these fields.
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
    dvs_threshold_ratio: Annotated[Range | None, Condition("threshold", "dvs_threshold_ratio", "× the preset's")] = None
    """Thresholds of the event camera, times the preset's."""
    dvs_spread_ratio: Annotated[Range | None, Condition("spread", "dvs_spread_ratio", "× the preset's")] = None
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
    """Only for timing virtual."""
    share: Share = 1.0
    """Probability, 0 to 1, with which each condition is sampled in a game; otherwise it stays as in the task."""
    shares: dict[str, Share] = Field(default_factory=dict)
    """Probabilities of single conditions where they differ from `share`, as {wind_m_s: 0.6}."""
    widen_over_games: Annotated[int, Field(ge=0)] = 0
    """Training games of each environment over which the ranges widen to their full width; 0: full from the start."""

    @model_validator(mode="after")
    def _shares_have_ranges(self) -> Self:
        ranges = self.given()
        for name in self.shares:
            if name not in ranges:
                raise ValueError(f"shares.{name}: there is no range of it; there are {', '.join(ranges) or 'none'}")
        if self.model_fields_set and not ranges:
            raise ValueError("needs a range of what is to be drawn, as wind_m_s: [0, 3]")
        return self

    @property
    def all_sampled(self) -> bool:
        """Whether every condition with a range is sampled in every game."""
        return all(self._share_of(name) == 1.0 for name in self.given())

    def _share_of(self, name: str) -> float:
        return self.shares.get(name, self.share)

    def given(self) -> dict[str, tuple[float, float]]:
        """Return the configured ranges, in the order of sampling."""
        ranges = {name: getattr(self, name) for name in SAMPLED}
        return {name: ends for name, ends in ranges.items() if ends is not None}

    def widened(self, games: int, usual: Mapping[str, tuple[float, float]]) -> Self:
        """Return the ranges after that many games, on the way from `usual`, the task's own."""
        share = min(games / self.widen_over_games, 1.0) if self.widen_over_games else 1.0
        if share == 1.0:
            return self
        between = {
            name: tuple(start + share * (end - start) for start, end in zip(usual[name], ends, strict=True))
            for name, ends in self.given().items()
        }
        return self.model_copy(update=between)

    def sample(self, random: np.random.Generator) -> dict[str, float]:
        """Sample each condition with its probability, uniformly from its range."""
        sampled = {name: float(random.uniform(*ends)) for name, ends in self.given().items()}
        if self.all_sampled:
            return sampled
        return {name: value for name, value in sampled.items() if random.random() < self._share_of(name)}


SAMPLED = {
    name: each for name, field in Ranges.model_fields.items() for each in field.metadata if isinstance(each, Condition)
}
"""Conditions that can be sampled, by their field of `Ranges`."""
for _name, _condition in SAMPLED.items():
    _unit = f", {_condition.unit}" if _condition.unit else ""
    Ranges.model_fields[_name].description = f"Range of task.{_condition.key}{_unit}; None: not sampled."
Ranges.model_rebuild(force=True)
NOT_SAMPLED = (
    Condition("scenery", "difficulty.scenery"),
    Condition("sensor", "dvs_preset"),
    Condition("clock", "clock_speed", "x"),
    Condition("command", "command"),
    Condition("profile", "profile"),
)
SHORT_NAMES = {each.short: each for each in (*SAMPLED.values(), *NOT_SAMPLED)}
"""All conditions by their short names."""
OF_DIFFICULTY = tuple(name for name, each in SAMPLED.items() if each.key == f"difficulty.{name}")
OF_TASK = tuple(name for name, each in SAMPLED.items() if each.key == name)
OF_SENSOR = tuple(name for name in OF_TASK if name not in ("speed_m_s", "altitude_m"))
LATENCY = "latency_scale"


def corners(ranges: Mapping[str, tuple[float, float]], alone: bool = False) -> list[dict[str, float]]:
    """Return the extreme conditions to check: all least, all most, and each of them with the other's thrust.

    With `alone`, also each end of each range by itself, for conditions that are not always sampled together.
    """
    least, most = ({name: ends[end] for name, ends in ranges.items()} for end in (0, 1))
    weakest, strongest = ({name: end[name] for name in end if name == "thrust_ratio"} for end in (least, most))
    single = [{name: end} for name, ends in ranges.items() for end in ends] if alone else []
    return [least, most, {**most, **weakest}, {**least, **strongest}, *single]


def keys_of(conditions: Mapping[str, float]) -> dict[str, Any]:
    """Return conditions as keys of a task: those of its difficulty and its latency are nested."""
    difficulty: dict[str, Any] = {name: conditions[name] for name in OF_DIFFICULTY if name in conditions}
    if "light" in difficulty:
        difficulty["light"] = (difficulty["light"], difficulty["light"])
    latency = {"scale": conditions[LATENCY]} if LATENCY in conditions else {}
    keys: dict[str, Any] = {name: conditions[name] for name in OF_TASK if name in conditions}
    return keys | {"difficulty": difficulty, "latency": latency}
