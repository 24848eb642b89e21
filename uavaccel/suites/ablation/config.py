"""An ablation's configuration: a DP1 experiment, and its variants."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from uavaccel.config import Config, validate
from uavaccel.files import Plain
from uavaccel.suites.dp1.config import Dp1Config
from uavaccel.suites.experiment import Experiment, merged


class Variant(Config):
    """A variant of the experiment, by what it changes."""

    name: str
    """In the table and on the figure's axis; where all names are numbers, they are values on it."""
    changes: dict[str, Plain] = Field(default_factory=dict)
    """Values by dotted key of the DP1 configuration, as for --set."""


class AblationConfig(Experiment):
    """`suite: ablation`."""

    suite: Literal["ablation"]
    title: str = "Ablation"
    """What the report is called."""
    axis: str = "variant"
    """What the variants' names are values of; the figure's axis."""
    times_clock_speed: bool = False
    """The figure's axis is the variants' value times ClockSpeed."""
    base: dict[str, Plain]
    """A DP1 configuration; `suite` and `seed` may be left out. Its latency is a block or what ships for the profile."""
    variants: Annotated[tuple[Variant, ...], Field(min_length=1)]
    """What is changed, one variant after the other."""

    @field_validator("variants")
    @classmethod
    def _distinct(cls, variants: tuple[Variant, ...]) -> tuple[Variant, ...]:
        names = [variant.name for variant in variants]
        if len(set(names)) < len(names):
            raise ValueError("must have names of their own")
        return variants

    @model_validator(mode="after")
    def _can_be_flown(self) -> AblationConfig:
        for variant in self.variants:
            self.experiment(variant)
        return self

    @property
    def timing(self) -> str:
        """The clock of the games."""
        return str(self.base.get("timing", "virtual"))

    def experiment(self, variant: Variant) -> Dp1Config:
        """The DP1 experiment of a variant. Raises UserError that names the variant and the key."""
        known = {**self.base, "suite": "dp1", "seed": self.seed}
        validate(Dp1Config, known, "base")
        return validate(Dp1Config, merged(known, variant.changes), f"variant {variant.name!r}")
