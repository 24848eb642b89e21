"""The claims against the runs: holds, fails, or pending until somebody has trained; and what the paper's n can tell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uavaccel.errors import UserError
from uavaccel.metrics.intervals import fisher_exact_p
from uavaccel.records import RunDirectory
from uavaccel.suites import paper_results
from uavaccel.suites.paper import claims
from uavaccel.suites.paper.config import PROFILES, Claim, PaperConfig, read_claims
from uavaccel.suites.paper.evidence import Finding, Images, NoEvidence, Policies, Trajectories
from uavaccel.suites.parts import part_run
from uavaccel.suites.report import SummaryCell

LEVEL = 0.05


def judge(config: PaperConfig, run: RunDirectory) -> list[dict[str, Any]]:
    """A row for each claim: the paper's number, and for each profile what was found and the verdict."""
    evidence = {profile: _evidence(config, run, profile) for profile in PROFILES}
    return [
        {
            "claim": claim.id,
            "place": claim.place,
            "says": claim.says,
            "paper": claim.paper,
            "paper_p": _paper_p(claim),
            **{profile: _judged(claim, evidence[profile]) for profile in PROFILES},
        }
        for claim in read_claims(config)
    ]


def _evidence(config: PaperConfig, run: RunDirectory, profile: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if f"dp1-{profile}" in config.parts:
        found["dp1"] = Trajectories.of(part_run(run, f"dp1-{profile}"))
    if f"dp2-{profile}" in config.parts:
        found["dp2"] = Images.of(part_run(run, f"dp2-{profile}"))
    if config.with_run is not None:
        found["rl"] = Policies.of(training_run(config.with_run), profile)
    return found


def training_run(path: str) -> RunDirectory:
    """The run of the suite `rl` at a path. Raises UserError if it is none."""
    run = RunDirectory(path)
    if run.config().get("suite") != "rl":
        raise UserError(f"--with {path}: is a run of {run.config().get('suite')}, not of rl")
    return run


def _judged(claim: Claim, evidence: Mapping[str, Any]) -> dict[str, Any]:
    undecided = {"value": "", "verdict": "pending" if claim.decided_by == "rl" else "not flown"}
    if claim.decided_by not in evidence:
        return undecided
    try:
        finding: Finding = getattr(claims, claim.id)(evidence[claim.decided_by])
    except NoEvidence:
        return undecided
    return {"value": finding.value, "verdict": "holds" if finding.holds else "fails"}


def _paper_p(claim: Claim) -> float | None:
    """Fisher's exact test of the paper's own counts; above 5 % its n tells nothing."""
    if claim.paper_counts is None:
        return None
    first, second = claim.paper_counts
    return fisher_exact_p((first, paper_results.GAMES), (second, paper_results.GAMES))


def at_the_papers_n(row: SummaryCell) -> str:
    """What the paper's own games can tell, in words; empty where it compares no counts."""
    if row["paper_p"] is None:
        return ""
    said = "significant" if row["paper_p"] < LEVEL else "undecidable"
    return f"{said} at n = {paper_results.GAMES} (p = {row['paper_p']:.2g})"
