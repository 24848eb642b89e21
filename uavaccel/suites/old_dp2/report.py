"""DP2's report: the images of each ClockSpeed against those of the run at 1x, Figure 7, and the image guard."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from uavaccel.draw import style
from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_at_clock, command_name
from uavaccel.suites.old_dp2.flights import Dp2Row
from uavaccel.suites.old_dp2.image_errors import LEAST_M, LEAST_PERCENT, ImageCloud, plot_images
from uavaccel.suites.old_dp2.scores import GameScore, score_games, study_guard, summary_of
from uavaccel.suites.old_report import Report, Summary, SummaryCell
from uavaccel.suites.provenance import source_line
from uavaccel.suites.rows import Row
from uavaccel.vision.guard import GuardSettings


def table(summary: Summary) -> Table:
    """Return a table of each command and ClockSpeed, with "-" for numbers that cannot be known."""
    return Table.of(
        summary["cells"],
        ("command", lambda cell: command_name(cell["command"])),
        ("ClockSpeed", lambda cell: clock_label(cell["clock_speed"]) + _role(cell)),
        ("images", lambda cell: str(cell["paired_images"])),
        ("position error, m: median, max", lambda cell: _pair(cell, "position_error_m", 3)),
        ("attitude error, deg: max", lambda cell: _exact_number(cell["attitude_error_deg_max"], 2)),
        ("DVS-ED, %: median, max", lambda cell: _pair(cell, "dvs_ed_percent", 2)),
        ("guard retries", lambda cell: str(cell["guard_retries"])),
        ("poses, counts v. lockstep", _against_lockstep),
        ("distance, m", lambda cell: f"{cell['distance_m']:.1f}" + _hit(cell)),
        ("simulated s a wall s", lambda cell: _exact_number(cell["simulated_s_per_wall_s"], 2)),
        ("source", lambda cell: str(cell["provenance"])),
    )


def _role(cell: SummaryCell) -> str:
    reference = " (reference)" if cell["reference"] and cell["reference"]["is_this_cell"] else ""
    return reference + (" (disturbed)" if cell.get("disturbed") else "")


def _hit(cell: SummaryCell) -> str:
    return f" (hit {cell['collision']['object']})" if cell["collision"] else ""


def _against_lockstep(cell: SummaryCell) -> str:
    compared = (cell[key] for key in ("poses_equal_lockstep", "dvs_counts_equal_lockstep"))
    return ", ".join(or_dash(equal, {True: "equal", False: "differ"}.__getitem__) for equal in compared)


def _verdict(cell: SummaryCell) -> str:
    error_m = _exact_number(cell["position_error_m_max"], 3)
    events = _exact_number(cell["dvs_ed_percent_max"], 2)
    flown = command_at_clock(cell)
    if not cell["position_error_m_max"] and not cell["dvs_ed_percent_max"]:
        return f"{flown} takes the images of 1x, each at the same place with as many events"
    return f"{flown} takes its images up to {error_m} m from those of 1x, with a DVS-ED of up to {events} %"


def _pair(cell: SummaryCell, name: str, digits: int) -> str:
    return ", ".join(_exact_number(cell[f"{name}_{which}"], digits) for which in ("median", "max"))


def _exact_number(value: float | None, digits: int) -> str:
    """Format a number so that only an exact 0 is "0", and one too small for the digits is written with an exponent."""
    if not value:
        return "-" if value is None else "0"
    return f"{value:.{digits}f}" if value >= 10.0**-digits else f"{value:.0e}"


class Dp2Report(Report):
    """DP2's report. Beside the summary it writes scores.json, the errors of each image."""

    @cached_property
    def scores(self) -> list[GameScore]:
        preset, seed = self.config["dvs_preset"], self.config["sensor_seed"]
        return list(score_games(self.rows, self.run.load_arrays, preset, seed))

    def summarise(self) -> Summary:
        compared = [score for score in self.scores if score.reference is not None]
        self.run.write_json("scores.json", [score.by_image() for score in compared])
        return summary_of(self.config, self.scores, self._guard_study())

    def _guard_study(self) -> Summary | None:
        """Study the guard on the images of the one game that are stored in colour."""
        row = next((row for row in self.rows if row["role"] == "lockstep" and row["error"] is None), None)
        if row is None:
            return None
        images = self.run.load_arrays(row)["colour"]
        return study_guard(images, GuardSettings(**self.config["guard"]), self.config["seed"])

    def title(self) -> str:
        return f"DP2, {self.summary['profile']} profile, seed {self.summary['seed']}"

    def figures(self) -> list[Picture]:
        clouds = [
            ImageCloud(
                score.row["command"], score.row["clock_speed"], score.dvs_ed_percent, score.position_error_m
            )
            for score in self.scores
            if score.reference is not None and score.row is not score.reference
        ]
        source = source_line([score.row for score in self.scores])
        caption = (
            "Figure 7. Position error over DVS-ED, a point an image, against the image of the same place in the path "
            "of the same command's run at 1x. Rings: images at the same place with as many DVS pixels as at 1x. Both "
            f"axes are logarithmic, but linear up to {LEAST_PERCENT:g} % and {LEAST_M * 1e3:g} mm."
        )
        path = self.run.file("figures/figure7_images.png")
        return [style.picture(plot_images(clouds, source), path, caption, source)]

    def headline(self) -> str:
        cells = [cell for cell in self.summary["cells"] if cell["position_error_m_max"] is not None]
        flown = [cell for cell in cells if cell["clock_speed"] > 1 and cell["timing"] != "lockstep"]
        by_clock = sorted(flown, key=lambda cell: float(cell["clock_speed"]))
        fastest = {cell["command"]: cell for cell in by_clock}
        said = [_verdict(cell) for _, cell in sorted(fastest.items())]
        return "; ".join(said) or f"{len(self.rows)} games, none of them accelerated and comparable with 1x"

    def overview(self) -> Table:
        return table(self.summary)

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [
            Paragraph(f"Games: {source_line(self.rows)}."),
            *map(Paragraph, _warnings(self.rows, self.summary, self.config)),
            Heading("Each ClockSpeed against the run at 1x"),
            self.overview(),
            Paragraph(_READING),
            *figures,
            *_guard_blocks(self.summary["guard_study"]),
        ]


def guard_table(guard: Summary) -> Table:
    """Return a table with a row for each kind of perturbation, and one for all."""
    kinds = [(kind.replace("_", " "), [counts]) for kind, counts in guard["by_kind"].items()]
    return Table.of(
        [*kinds, ("all", list(guard["by_kind"].values()))],
        ("kind of perturbation", lambda kind: kind[0]),
        ("perturbed images sent", lambda kind: str(sum(counts["on"]["sent"] for counts in kind[1]))),
        ("pass without guard", lambda kind: _share_passed(kind[1], "off")),
        ("pass the guard", lambda kind: _share_passed(kind[1], "on")),
    )


def _share_passed(counts: Sequence[Summary], guard: str) -> str:
    sent, passed = (sum(each[guard][key] for each in counts) for key in ("sent", "passed"))
    return f"{passed / sent:.1%}" if sent else "-"


def guard_sentence(guard: Summary) -> str:
    """Return the false alarms and the perturbed share of all accepted images, in a sentence."""
    handed_on = guard["perturbed_share_handed_on"]
    return (
        f"False alarms: {guard['clean_false_alarms']} of {guard['images']} clean images. "
        f"With {guard['share']:.0%} of the images perturbed, {handed_on['off']:.1%} of those handed on are "
        f"perturbed without the guard and {handed_on['on']:.1%} with it."
    )


def _guard_blocks(guard: Summary | None) -> list[Block]:
    if guard is None:
        return []
    return [
        Heading("Image guard (modelled)"),
        guard_table(guard),
        Paragraph(guard_sentence(guard)),
        Paragraph(
            f"The images are those of the game without latency, sent {guard['streams']} times with another seed. "
            "MuJoCo renders every image correctly: the perturbations are a model of a renderer short of time, whose "
            "sizes are this project's own choice. The guard checks mean brightness alone and cannot detect what leaves "
            "that as it is."
        ),
    ]


def _warnings(rows: Sequence[Dp2Row], summary: Summary, config: Row) -> list[str]:
    warnings = [
        f"{row['case']} hit {collision['object']} after {row['distance_m']:.1f} m and stood still from there: "
        f"its images count up to that moment."
        for row in rows
        if (collision := row["collision"])
    ]
    if failed := [row["case"] for row in rows if row["error"] is not None]:
        warnings.append(f"Warning: {', '.join(failed)} failed and are left out; rows.jsonl says why.")
    if lost_s := sum(row.get("lost_wall_s", 0.0) for row in rows):
        warnings.append(f"Warning: the machine could not keep up and lost {lost_s:.3f} s of wall time.")
    if disturbed := [row["case"] for row in rows if row.get("disturbed")]:
        warnings.append(
            f"Warning: {', '.join(disturbed)} lost wall time, or the server stalled or was started again."
        )
    if summary["perturbed_share"]:
        warnings.append(
            f"Modelled: {summary['perturbed_share']:.1%} of the images of the games were perturbed on their way"
            f"{', fewer where the ClockSpeed is low' if config['perturbation'].get('half_excess') else ''}; "
            "those of the runs at 1x that they are compared with were not."
        )
    if "image" not in config["latency"]["reply_us"] and any(row["timing"] == "virtual" for row in rows):
        warnings.append(
            "The modelled wall times leave out drawing the images: the latency model has no channel for them."
        )
    return warnings


_READING = (
    "Images are paired by their place in the path: the same sample of the same command. DVS-ED is the difference in "
    "the number of pixels with ON events plus that with OFF events, over all pixels; it cannot see events that moved "
    "elsewhere. One DVS, with one map of thresholds, is applied to all games' images. An error of 0 is exactly 0. "
    "Equal to lockstep means that every pose, or every pixel's event count, has the same bits as in the game flown "
    "without latency. Measured: the machine's clock. Modelled: a simulated clock."
)
