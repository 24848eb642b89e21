"""The paper: its experiments under AirSim's and under native timing, and each of its claims decided (claims.py).

The cases of a run are whole runs of other suites, its parts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Field

from uavaccel import __version__
from uavaccel.config import Config, load_yaml, validate
from uavaccel.draw.page import Block, Column, Heading, Picture, Table, fill
from uavaccel.errors import UserError
from uavaccel.files import Plain, file_sha256
from uavaccel.forms import Count
from uavaccel.metrics.intervals import fisher_exact_p
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment
from uavaccel.suites import claims, paper_results
from uavaccel.suites.experiment import Experiment, GameRow, Row
from uavaccel.suites.parts import Part, Run, SuiteOfRuns, fly_part, part_run
from uavaccel.suites.registry import open_run, suite_of
from uavaccel.suites.report import Report, Summary, method_note, records, table_of
from uavaccel.suites.rl import flights_of
from uavaccel.suites.suite import GameResult, SimpleCase

PROFILES = ("airsim", "native")
LEVEL = 0.05
VERDICTS = {True: "holds", False: "fails", None: "undecided"}


class Claim(Config):
    """A claim of the paper that a run can decide."""

    id: str
    place: str
    """Section of the paper."""
    says: str
    """The claim in brief."""
    paper: str
    """The paper's number."""
    decided_by: Annotated[tuple[Literal["dp1", "dp2", "rl"], ...], Field(min_length=1)]
    """Kinds of runs that decide it, in the order of the deciding function's arguments."""
    basis: Literal["fitted", "chosen", "predicted"]
    """Origin of the deciding number under `airsim`: fitted to the paper, due to a choice of this project on which the
    paper is silent, or predicted by a model that was fitted to something else."""
    paper_counts: tuple[int, int] | None = None
    """Successes of 100 games each, where the paper compares two."""
    decide: str = ""
    """The function of claims.py that decides it, by default that of its id."""
    keys: dict[str, Plain] = Field(default_factory=dict)
    """What that function is called with beside the runs."""


class Claims(Config):
    """The contents of a file of claims, with what the page says of the verdicts and of the hours by phase."""

    claims: tuple[Claim, ...]
    reading: str
    phases: str


class PaperConfig(Experiment):
    """`suite: paper`."""

    suite: Literal["paper"]
    parts: Annotated[dict[Literal["dp1-airsim", "dp1-native", "dp2-airsim", "dp2-native"], Part], Field(min_length=1)]
    """Runs by name: suite and profile."""
    claims: str = "claims.yaml"
    """File of claims among those that ship with the experiments."""
    with_run: str | None = None
    """Run directory of the suite `rl`, which decides the claims on training."""


class PaperRow(GameRow):
    """The row of a part: a run of another suite."""

    cells: Count
    """Number of entries in its summary."""


class Paper(SuiteOfRuns[PaperConfig, SimpleCase]):
    """`uavaccel run paper`. Its report is made of the reports of its parts."""

    name = "paper"
    unit = "part"
    config = PaperConfig
    row = PaperRow

    def check(self, config: PaperConfig) -> None:
        read_claims(config)
        for name, part in config.parts.items():
            suite, run = part.resolve(config.seed)
            if (flies := f"{suite.name}-{getattr(run, 'profile', '')}".rstrip("-")) != name:
                raise UserError(f"parts.{name}: {part.experiment} and its keys fly {flies}")
        if config.with_run is not None:
            training_run(config.with_run)

    def cases(self, config: PaperConfig) -> Iterator[SimpleCase]:
        for name in config.parts:
            case = SimpleCase(name, "virtual", 0.0)
            yield replace(case, typical_s=self.size(config, case)[1])

    def runs(self, config: PaperConfig, case: SimpleCase) -> list[Run]:
        return [part.resolve(config.seed) for name, part in config.parts.items() if name == case.id]

    def status(self, rows: Sequence[Row]) -> str:
        return ""

    def fly(self, config: PaperConfig, case: SimpleCase, opened: RunDirectory) -> GameResult:
        part = fly_part(opened, case.id, self.runs(config, case)[0])
        flown(opened, case.id, part)
        return GameResult({"cells": len(part.summary["cells"])})

    def summary(self, report: Report) -> Summary:
        """Return the verdict on each claim under either profile, and the hours of trainings by phase under airsim."""
        evidence: dict[str, dict[str, Any]] = {profile: {} for profile in PROFILES}
        for name in report.config.parts:
            kind, _, profile = name.partition("-")
            evidence[profile][kind] = flown(report.run, name)
        phases: list[dict[str, float]] = []
        if report.config.with_run is not None:
            run = training_run(report.config.with_run)
            flights = flights_of(run.rows(), run.load_arrays)
            for profile, found in evidence.items():
                found["rl"] = claims.trainings(flights, profile)
            phases = claims.training_phases(evidence["airsim"]["rl"])
        judged = [
            {
                "claim": claim.id,
                **claim.model_dump(include={"place", "says", "paper", "basis"}),
                "paper_p": claim.paper_counts
                and fisher_exact_p(*((n, paper_results.GAMES) for n in claim.paper_counts)),
                **{profile: verdict(claim, evidence[profile]) for profile in PROFILES},
            }
            for claim in read_claims(report.config).claims
        ]
        return {"suite": "paper", "seed": report.config.seed, "claims": judged, "phases": phases}

    def title(self, report: Report) -> str:
        return "The paper, claim by claim"

    def headline(self, report: Report) -> str:
        """Return how many claims hold, by profile."""
        judged, parts = report.summary["claims"], []
        for profile in PROFILES:
            counts = Counter(claim[profile]["verdict"] for claim in judged)
            parts.append(f"under {profile} {', '.join(f'{count} {word}' for word, count in counts.items())}")
        return f"of {len(judged)} claims of the paper {'; '.join(parts)}"

    def source(self, report: Report) -> str:
        return f"all times modelled unless a part says measured · seed {report.config.seed}"

    def overview(self, report: Report) -> Table:
        columns = {"claim": "{claim}", "place": "{place}", "is": "{basis}"}
        columns |= {f"under {profile}": f"{{{profile}[verdict]}}  {{{profile}[value]}}" for profile in PROFILES}
        table = Table.of(report.summary["claims"], columns)
        return Table(table.header, [[cell.rstrip() for cell in row] for row in table.rows])

    def page(self, report: Report) -> Iterator[Block | str]:
        told = read_claims(report.config)
        yield Heading("Claims")
        judged = [f"{{{profile}[{key}]}}" for profile in PROFILES for key in ("verdict", "value")]
        columns: list[Column] = ["{says}", "{place}", "{paper}", "{basis}", *judged, at_the_papers_n]
        header = ("claim", "place", "the paper's", "is", "under airsim", "", "under native", "", "the paper's n")
        yield Table(header, [[fill(column, claim) for column in columns] for claim in report.summary["claims"]])
        if phases := report.summary["phases"]:
            yield Heading("Figure 9: hours by phase, under airsim")
            yield Table.of(map(whole_hours, phases), HOURS)
        for name in report.config.parts:
            yield Heading(name)
            yield f"Its own report: parts/{name}/report.html."
            for path in sorted((part_run(report.run, name).path / "figures").glob("*.png")):
                copied = report.run.write_bytes(f"figures/{name}-{path.name}", path.read_bytes())
                number, _, subject = path.stem.partition("_")
                figure = f"{number.capitalize().replace('Figure', 'Figure ')}, {subject.replace('_', ' ')}"
                yield Picture(copied, f"{name}: {figure}.", f"{figure} of {name}, as its own report describes it.")
        yield method_note(" ".join([told.reading, *([told.phases] if phases else [])]))


def read_claims(config: PaperConfig) -> Claims:
    """Read the claims, in the paper's order. Raises UserError for an invalid file."""
    path = experiment(config.claims)
    return validate(Claims, load_yaml(path), str(path))


def training_run(path: str) -> RunDirectory:
    """Return the run of the suite `rl` at a path. Raises UserError if it is none."""
    try:
        run = open_run(path)
    except UserError as error:
        raise UserError(f"--with {error}") from None
    if run.config().get("suite") != "rl":
        raise UserError(f"--with {path}: is a run of {run.config().get('suite')}, not of rl")
    return run


def flown(run: RunDirectory, name: str, report: Report | None = None) -> claims.Flown:
    """Return what a part tells, from evidence/NAME.json if that is of its games and this version; else it is scored."""
    part, file, kind = part_run(run, name), f"evidence/{name}.json", name.partition("-")[0]
    of = [__version__, *(file_sha256(part.path / kept) for kept in ("config.yaml", "rows.jsonl"))]
    kept = run.read_json(file) if report is None and (run.path / file).is_file() else {}
    if kept.get("of") != of:
        report = report or suite_of(part).report(part)
        games = records(report.scores.reindex(columns=claims.SCORES[kind]))
        run.write_json(file, kept := {"of": of, "games": games, "summary": report.summary})
    return claims.Flown(table_of(kept["games"]), kept["summary"])


def verdict(claim: Claim, evidence: Mapping[str, Any]) -> dict[str, str]:
    """Return the verdict on a claim, and the number that decides it or the reason why nothing does."""
    lacking = {"value": "", "verdict": "pending" if "rl" in claim.decided_by else "not flown"}
    if any(kind not in evidence for kind in claim.decided_by):
        return lacking
    try:
        value, holds = getattr(claims, claim.decide or claim.id)(
            *(evidence[kind] for kind in claim.decided_by), **claim.keys
        )
    except claims.NoEvidence:
        return lacking
    except claims.Undecided as reason:
        return {"value": str(reason), "verdict": "undecided"}
    return {"value": value, "verdict": VERDICTS[holds]}


def at_the_papers_n(claim: Mapping[str, Any]) -> str:
    """Return in words whether the paper's own counts differ significantly; empty where it compares none."""
    if (p_value := claim["paper_p"]) is None:
        return ""
    significant = "significant" if p_value < LEVEL else "undecidable"
    return f"{significant} at n = {paper_results.GAMES} (p = {p_value:.2g})"


def whole_hours(phases: Mapping[str, float]) -> dict[str, Any]:
    """Return a row of `training_phases` with its sum, and the paper's whole training where it gives its speed-up."""
    speedup = {1.0: 1.0, **paper_results.TRAINING_SPEEDUP}.get(phases["clock_speed"])
    whole_h = sum(phases[f"{phase}_h"] for phase in ("simulation", *claims.BESIDE_SIMULATION))
    return {**phases, "whole_h": whole_h, "paper_whole_h": speedup and paper_results.REAL_TIME_S / 3600 / speedup}


HOURS = {
    "ClockSpeed": "{clock_speed:g}x",
    "simulation, h": "{simulation_h:.1f}",
    "simulation, the paper's": "{paper_simulation_h:.1f}",
    "image processing, h": "{image_processing_h:.1f}",
    "inference, h": "{inference_h:.1f}",
    "learning, h": "{learning_h:.1f}",
    "all three, the paper's": "{paper_beside_h:.1f}",
    "whole, h": "{whole_h:.1f}",
    "whole, the paper's": "{paper_whole_h:.1f}",
}
