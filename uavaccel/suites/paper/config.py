"""Configuration of the suite `paper`: its parts, and the claims that they decide."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from uavaccel.config import Config, validate
from uavaccel.resources import experiment
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.parts import Part
from uavaccel.yaml_io import load_yaml

PROFILES: tuple[Literal["airsim", "native"], ...] = ("airsim", "native")
Kind = Literal["dp1", "dp2", "rl"]


class Claim(Config):
    """A claim of the paper that a run can decide."""

    id: str
    place: str
    """Section of the paper."""
    says: str
    """The claim in brief."""
    paper: str
    """The paper's number."""
    decided_by: Annotated[tuple[Kind, ...], Field(min_length=1)]
    """Kinds of runs that decide it, in the order of the deciding function's arguments."""
    basis: Literal["fitted", "chosen", "predicted"]
    """Origin of the deciding number under `airsim`: fitted to the paper, due to a choice of this project on which the
    paper is silent, or predicted by a model that was fitted to something else."""
    paper_counts: tuple[int, int] | None = None
    """Successes of 100 games each, where the paper compares two."""


class Claims(Config):
    """The contents of a file of claims."""

    claims: tuple[Claim, ...]


class PaperConfig(Experiment):
    """`suite: paper`."""

    suite: Literal["paper"]
    parts: Annotated[dict[str, Part], Field(min_length=1)]
    """Runs by name, KIND-PROFILE: dp1-airsim, dp2-native, and so on."""
    claims: str = "claims.yaml"
    """File of claims among those that ship with the experiments."""
    with_run: str | None = None
    """Run directory of the suite `rl`, which decides the claims on training."""

    @field_validator("parts")
    @classmethod
    def _say_kind_and_profile(cls, parts: dict[str, Part]) -> dict[str, Part]:
        for name in parts:
            kind, _, profile = name.partition("-")
            if kind not in ("dp1", "dp2") or profile not in PROFILES:
                raise ValueError(f"has {name!r}; names are dp1 or dp2, a hyphen, and airsim or native")
        return parts


def read_claims(config: PaperConfig) -> tuple[Claim, ...]:
    """Read the claims, in the paper's order. Raises UserError for an invalid file."""
    path = experiment(config.claims)
    return validate(Claims, load_yaml(path), str(path)).claims
