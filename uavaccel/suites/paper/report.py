"""The report of the paper's claims: the verdict on each, the training time by phase, and the figures of the parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict

from uavaccel.config import validate
from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table
from uavaccel.draw.style import clock_label
from uavaccel.errors import UserError
from uavaccel.metrics.intervals import fisher_exact_p
from uavaccel.records import RunDirectory
from uavaccel.suites import paper_results
from uavaccel.suites.old_report import Report, Summary, SummaryCell, number
from uavaccel.suites.paper import flight_claims, policy_claims
from uavaccel.suites.paper.config import PROFILES, Claim, PaperConfig, read_claims
from uavaccel.suites.paper.evidence import (
    BESIDE_SIMULATION,
    SIMULATION,
    Finding,
    Images,
    NoEvidence,
    Policies,
    Trajectories,
    Undecided,
)
from uavaccel.suites.parts import part_run
from uavaccel.suites.registry import open_run


def training_phases(rl: Policies) -> list[dict[str, float]]:
    """Return the hours of TCSC's trainings by ClockSpeed and phase, beside those that the paper's speed-ups imply.

    Hours are scaled to trainings that take ADSC the paper's 182 hours at 1x. Empty where ADSC was not trained at 1x.
    """
    try:
        hour_s = (
            rl.command_s("adsc", 1.0, (*SIMULATION, *BESIDE_SIMULATION)).value
            * 3600
            / paper_results.REAL_TIME_S
        )
        return [_phase_hours(rl, k, hour_s) for k in rl.clocks("tcsc") if k in paper_results.CLOCKS]
    except (NoEvidence, Undecided):
        return []


def _phase_hours(rl: Policies, clock_speed: float, hour_s: float) -> dict[str, float]:
    """Return the entry of a ClockSpeed; `hour_s` is the wall time of a command in a training of an hour."""
    simulation, beside = paper_results.phase_hours(clock_speed)
    return {
        "clock_speed": clock_speed,
        "simulation_h": rl.command_s("tcsc", clock_speed, SIMULATION).value / hour_s,
        **{
            f"{each}_h": rl.command_s("tcsc", clock_speed, (each,)).value / hour_s
            for each in BESIDE_SIMULATION
        },
        "paper_simulation_h": simulation,
        "paper_beside_h": beside,
    }


def phase_table(rows: Sequence[SummaryCell]) -> Table:
    """Return the table of `training_phases`, with the paper's whole training where it gives its speed-up."""
    speedups = {1.0: 1.0, **paper_results.TRAINING_SPEEDUP}

    def whole(row: SummaryCell) -> SummaryCell:
        speedup, ours = speedups.get(row["clock_speed"]), ("simulation", *BESIDE_SIMULATION)
        paper_h = speedup and paper_results.REAL_TIME_S / 3600 / speedup
        return {**row, "whole_h": sum(row[f"{each}_h"] for each in ours), "paper_whole_h": paper_h}

    return Table.of(
        [whole(row) for row in rows],
        ("ClockSpeed", lambda row: clock_label(row["clock_speed"])),
        number("simulation, h", "simulation_h", "{:.1f}"),
        number("simulation, the paper's", "paper_simulation_h", "{:.1f}"),
        number("image processing, h", "image_processing_h", "{:.1f}"),
        number("inference, h", "inference_h", "{:.1f}"),
        number("learning, h", "learning_h", "{:.1f}"),
        number("all three, the paper's", "paper_beside_h", "{:.1f}"),
        number("whole, h", "whole_h", "{:.1f}"),
        number("whole, the paper's", "paper_whole_h", "{:.1f}"),
    )


PHASE_NOTE = (
    "Hours of TCSC's training, were it as long as one that takes ADSC the paper's 182 hours at 1x. The paper draws its "
    "phases and gives none in numbers: its columns follow from its speed-ups, of which what it takes beside the "
    "simulation was fitted to the difference between 4x and 3.6x, and 6.4x and 5.2x. Ours takes these costs where the "
    "configuration of the training has them as fitted; what the simulation takes is a prediction, under the choice of "
    "60 frames a second, which no source gives: at 100x it makes 9.1x with 30 frames a second, 12.1x with 45, 14.6x "
    "with 60, 18.7x with 90 and 21.8x with 120, where the paper has 15.4x."
)


LEVEL = 0.05
VERDICTS = {True: "holds", False: "fails", None: "undecided"}


class Judgement(TypedDict):
    """The verdict on a claim under one profile, and the number that decides it or the reason why nothing does."""

    value: str
    verdict: str


class ClaimRow(TypedDict):
    """The entry of a claim in the summary."""

    claim: str
    place: str
    says: str
    paper: str
    basis: str
    paper_p: float | None
    """p-value of Fisher's exact test of the paper's own counts, where it compares counts."""
    airsim: Judgement
    native: Judgement


def judge(config: PaperConfig, evidence: Mapping[str, Mapping[str, Any]]) -> list[ClaimRow]:
    """Judge each claim under either profile; `evidence` is that of `evidence_of`, by profile."""
    return [
        {
            "claim": claim.id,
            "place": claim.place,
            "says": claim.says,
            "paper": claim.paper,
            "basis": claim.basis,
            "paper_p": paper_p(claim),
            "airsim": judged(claim, evidence["airsim"]),
            "native": judged(claim, evidence["native"]),
        }
        for claim in read_claims(config)
    ]


def evidence_of(config: PaperConfig, run: RunDirectory, profile: str) -> dict[str, Any]:
    """Return what a run tells of a profile, by kind of run."""
    found: dict[str, Any] = {}
    if f"dp1-{profile}" in config.parts:
        found["dp1"] = Trajectories.of(part_run(run, f"dp1-{profile}"))
    if f"dp2-{profile}" in config.parts:
        found["dp2"] = Images.of(part_run(run, f"dp2-{profile}"))
    if config.with_run is not None:
        found["rl"] = Policies.of(training_run(config.with_run), profile)
    return found


def training_run(path: str) -> RunDirectory:
    """Return the run of the suite `rl` at a path. Raises UserError if it is none."""
    run = open_run(path)
    if run.config().get("suite") != "rl":
        raise UserError(f"--with {path}: is a run of {run.config().get('suite')}, not of rl")
    return run


def judged(claim: Claim, evidence: Mapping[str, Any]) -> Judgement:
    """Judge a claim: it is pending until somebody has trained, and not flown where the run lacks its part."""
    lacking: Judgement = {"value": "", "verdict": "pending" if "rl" in claim.decided_by else "not flown"}
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
    """Return the function that decides a claim. Raises AttributeError where there is none."""
    module = flight_claims if hasattr(flight_claims, name) else policy_claims
    decide: Callable[..., Finding] = getattr(module, name)
    return decide


def paper_p(claim: Claim) -> float | None:
    """Return the p-value of Fisher's exact test of the paper's own counts, where it compares counts."""
    if claim.paper_counts is None:
        return None
    first, second = claim.paper_counts
    return fisher_exact_p((first, paper_results.GAMES), (second, paper_results.GAMES))


def at_the_papers_n(p_value: float | None) -> str:
    """Return in words whether the paper's own counts differ significantly; empty where it compares none."""
    if p_value is None:
        return ""
    verdict = "significant" if p_value < LEVEL else "undecidable"
    return f"{verdict} at n = {paper_results.GAMES} (p = {p_value:.2g})"


class PaperReport(Report):
    """The report of `uavaccel run paper`, made of the reports of its parts."""

    def summarise(self) -> Summary:
        config = validate(PaperConfig, self.config, str(self.run.path / "config.yaml"))
        evidence = {str(profile): evidence_of(config, self.run, profile) for profile in PROFILES}
        trained = evidence["airsim"].get("rl")
        return {
            "suite": "paper",
            "seed": config.seed,
            "claims": judge(config, evidence),
            "phases": training_phases(trained) if trained else [],
        }

    def title(self) -> str:
        return "The paper, claim by claim"

    def headline(self) -> str:
        """Return how many claims hold, by profile."""
        claims, parts = self.summary["claims"], []
        for profile in PROFILES:
            counts = Counter(claim[profile]["verdict"] for claim in claims)
            verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
            parts.append(f"under {profile} {verdicts}")
        return f"{len(claims)} claims: {'; '.join(parts)}; all times modelled unless a part says measured"

    def overview(self) -> Table:
        return Table.of(
            self.summary["claims"],
            ("claim", lambda row: row["claim"]),
            ("place", lambda row: row["place"]),
            ("is", lambda row: row["basis"]),
            ("under airsim", lambda row: "{verdict}  {value}".format_map(row["airsim"]).rstrip()),
            ("under native", lambda row: "{verdict}  {value}".format_map(row["native"]).rstrip()),
        )

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [
            Heading("Claims"),
            _claim_table(self.summary["claims"]),
            Paragraph(_READING),
            *_phase_blocks(self.summary["phases"]),
            *[block for name in self.config["parts"] for block in _part_blocks(self.run, name)],
        ]


def _phase_blocks(rows: Sequence[SummaryCell]) -> Sequence[Block]:
    if not rows:
        return []
    return [Heading("Figure 9: hours by phase, under airsim"), phase_table(rows), Paragraph(PHASE_NOTE)]


def _claim_table(claims: Sequence[ClaimRow]) -> Table:
    return Table.of(
        claims,
        ("claim", lambda row: row["says"]),
        ("place", lambda row: row["place"]),
        ("the paper's", lambda row: row["paper"]),
        ("is", lambda row: row["basis"]),
        ("under airsim", lambda row: row["airsim"]["verdict"]),
        ("", lambda row: row["airsim"]["value"]),
        ("under native", lambda row: row["native"]["verdict"]),
        ("", lambda row: row["native"]["value"]),
        ("the paper's n", lambda row: at_the_papers_n(row["paper_p"])),
    )


def _figure_name(stem: str) -> str:
    """Return the stem of a figure's file in words: "Figure 5, stlc" of figure5_stlc."""
    number, _, subject = stem.partition("_")
    return f"{number.capitalize().replace('Figure', 'Figure ')}, {subject.replace('_', ' ')}"


def _part_blocks(run: RunDirectory, name: str) -> Sequence[Block]:
    part = part_run(run, name)
    pictures = [
        Picture(
            run.write_bytes(f"figures/{name}-{path.name}", path.read_bytes()),
            f"{name}: {_figure_name(path.stem)}.",
        )
        for path in sorted((part.path / "figures").glob("*.png"))
    ]
    return [Heading(name), Paragraph(f"Its own report: parts/{name}/report.html."), *pictures]


_READING = (
    "A claim holds where the 95 % interval of its number lies within the margins, fails where it lies outside, and is "
    "undecided where it straddles an end or where too little was flown. Under airsim a number is fitted to the paper, "
    "decided by a choice of this project's, or predicted by what was fitted to something else. Success is compared as "
    "a ratio to that at 1x, of a policy that wins more than a tenth there: alike is .8 to 1.25, a loss a third to .8, "
    "a collapse less, a gain more than 1.25; of several trainings the interval is over "
    "trainings, of one it is over its games and holds for that policy alone. "
    "The paper gives TCSC's speed-up at 100x with rendering off as 62x (I), 65x (V) and 50x (IV-D): each is taken as "
    "50x to 65x within its own error. Error is 1 minus the pooled median STLC over its maximum of 2. ADSC above 1.8 "
    "only below 5x can hold pooled over rounds and T_moves alone, as in Figure 5. Speed-ups of training are over ADSC "
    "at 1x, and may miss the paper's by 15 % in either direction. Table I's differences are significant at n = 100 for "
    "ADSC's collapse alone. What the paper says of DVS-ED at 5x and 10x is decided by every image; median and share "
    "beyond stand beside it. STLC's lambda, the network, the reward and the lane's geometry are not in the paper: they "
    "are this project's own choice. ADSC and TCSC are flown here with one recorder sample every 50 ms, and 20 games in "
    "each cell of DP1, as in the paper."
)
