"""The claims against the runs, and what the paper's n can tell.

A claim holds or fails; it is undecided where its games or its interval cannot tell, pending until somebody has trained,
and not flown where the run leaves its part out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from uavaccel.errors import UserError
from uavaccel.metrics.intervals import fisher_exact_p
from uavaccel.records import RunDirectory
from uavaccel.suites import paper_results
from uavaccel.suites.paper import flight_claims, policy_claims
from uavaccel.suites.paper.config import PROFILES, Claim, PaperConfig, read_claims
from uavaccel.suites.paper.evidence import Finding, Images, NoEvidence, Policies, Trajectories, Undecided
from uavaccel.suites.parts import part_run
from uavaccel.suites.report import SummaryCell

LEVEL = 0.05
VERDICTS = {True: "holds", False: "fails", None: "undecided"}


def judge(config: PaperConfig, evidence: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A row for each claim: the paper's number, and for each profile what was found and the verdict.

    `evidence`: by profile, as of `evidence_of`.
    """
    return [
        {
            "claim": claim.id,
            "place": claim.place,
            "says": claim.says,
            "paper": claim.paper,
            "basis": claim.basis,
            "paper_p": _paper_p(claim),
            **{profile: judged(claim, evidence[profile]) for profile in PROFILES},
        }
        for claim in read_claims(config)
    ]


def evidence_of(config: PaperConfig, run: RunDirectory, profile: str) -> dict[str, Any]:
    """What a run has of a profile, by kind of run."""
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


def judged(claim: Claim, evidence: Mapping[str, Any]) -> dict[str, Any]:
    """The claim's verdict, and what was found or why nothing can be said."""
    lacking = {"value": "", "verdict": "pending" if "rl" in claim.decided_by else "not flown"}
    if any(kind not in evidence for kind in claim.decided_by):
        return lacking
    try:
        finding = decision(claim.id)(*(evidence[kind] for kind in claim.decided_by))
    except NoEvidence:
        return lacking
    except Undecided as reason:
        return {"value": str(reason), "verdict": "undecided"}
    return {"value": finding.value, "verdict": VERDICTS[finding.holds]}


def decision(name: str) -> Callable[..., Finding]:
    """The function of that name. Raises AttributeError where there is none."""
    module = flight_claims if hasattr(flight_claims, name) else policy_claims
    decide: Callable[..., Finding] = getattr(module, name)
    return decide


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
