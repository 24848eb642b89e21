"""Configuration of a run of the paper: its parts, and which claims they decide."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from uavaccel.config import Config, validate
from uavaccel.resources import experiment
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.parts import Part
from uavaccel.yaml_io import load_yaml

PROFILES = ("airsim", "native")
Kind = Literal["dp1", "dp2", "rl"]


class Claim(Config):
    """A sentence of the paper's that a run can decide."""

    id: str
    place: str
    """Section of the paper."""
    says: str
    """The claim in short."""
    paper: str
    """The paper's number."""
    decided_by: Annotated[tuple[Kind, ...], Field(min_length=1)]
    """Kinds of runs, in the order in which the deciding function takes them."""
    basis: Literal["fitted", "chosen", "predicted"]
    """Where the deciding number under `airsim` comes from: fitted to the paper, decided by a choice of this project's
    that the paper says nothing of, or predicted by what was fitted to something else."""
    paper_counts: tuple[int, int] | None = None
    """Successes of 100 games each, where the paper compares two."""


class Claims(Config):
    """The file of claims."""

    claims: tuple[Claim, ...]


class PaperConfig(Experiment):
    """`suite: paper`."""

    suite: Literal["paper"]
    parts: Annotated[dict[str, Part], Field(min_length=1)]
    """Runs by name, KIND-PROFILE: dp1-airsim, dp2-native, and so on."""
    claims: str = "claims.yaml"
    """Of the files that ship with the experiments."""
    with_run: str | None = None
    """Run directory of the suite `rl`, which decides the claims that need training."""

    @field_validator("parts")
    @classmethod
    def _say_kind_and_profile(cls, parts: dict[str, Part]) -> dict[str, Part]:
        for name in parts:
            kind, _, profile = name.partition("-")
            if kind not in ("dp1", "dp2") or profile not in PROFILES:
                raise ValueError(f"has {name!r}; names are dp1 or dp2, a hyphen, and airsim or native")
        return parts


def read_claims(config: PaperConfig) -> tuple[Claim, ...]:
    """The claims, in the paper's order. Raises UserError."""
    path = experiment(config.claims)
    return validate(Claims, load_yaml(path), str(path)).claims
