"""DP2's study of the image guard: what it accepts where a share of the run's own images is perturbed (MODELLED)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.document import or_dash
from uavaccel.suites.report import Summary, Values
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.guard_study import guard_study
from uavaccel.vision.perturb import PerturbationKind

SHARE = 0.05
STREAMS = 20  # the same images, perturbed with another seed in each: one stream has too few of each kind

HEADER = ("kind of perturbation", "perturbed images sent", "pass without guard", "pass the guard")


def study(images: NDArray[np.uint8], settings: GuardSettings, seed: int) -> Values:
    """Count the perturbed images sent and accepted, by kind, over `STREAMS` streams of `images` (n, H, W, 3).

    An image that the guard requests again may be perturbed again, so with the guard more are sent.
    """
    streams = [guard_study(list(images), SHARE, seed + stream, settings) for stream in range(STREAMS)]
    clean = streams[0]["clean"]
    return {
        "modelled": True,
        "images": len(images),
        "share": SHARE,
        "streams": STREAMS,
        "by_kind": {str(kind): _by_kind(streams, str(kind)) for kind in PerturbationKind},
        "perturbed_share_handed_on": {
            guard: float(np.mean([stream[guard]["perturbed_share_handed_on"] for stream in streams]))
            for guard in ("off", "on")
        },
        "clean_false_alarms": clean["false_alarms"],
        "clean_retries": clean["retries"],
    }


def _by_kind(streams: list[Values], kind: str) -> Values:
    result = {}
    for guard in ("off", "on"):
        counts = [stream[guard]["by_kind"][kind] for stream in streams]
        sent, passed = (sum(count[key] for count in counts) for key in ("sent", "passed"))
        result[guard] = {"sent": sent, "passed": passed, "share_passed": passed / sent if sent else None}
    return result


def table(guard: Summary) -> list[tuple[str, ...]]:
    """Return a row of text for each kind, below `HEADER`, and one for all images."""
    rows = [
        (
            kind.replace("_", " "),
            str(counts["on"]["sent"]),
            or_dash(counts["off"]["share_passed"], "{:.1%}".format),
            or_dash(counts["on"]["share_passed"], "{:.1%}".format),
        )
        for kind, counts in guard["by_kind"].items()
    ]
    sent = sum(counts["on"]["sent"] for counts in guard["by_kind"].values())
    passed = [_ratio([counts[mode] for counts in guard["by_kind"].values()]) for mode in ("off", "on")]
    return [*rows, ("all", str(sent), *(or_dash(share, "{:.1%}".format) for share in passed))]


def sentence(guard: Summary) -> str:
    """Return the false alarms and the perturbed share of all accepted images, in a sentence."""
    handed_on = guard["perturbed_share_handed_on"]
    return (
        f"False alarms: {guard['clean_false_alarms']} of {guard['images']} clean images. "
        f"With {guard['share']:.0%} of the images perturbed, {handed_on['off']:.1%} of those handed on are "
        f"perturbed without the guard and {handed_on['on']:.1%} with it."
    )


def _ratio(counts: list[Summary]) -> float | None:
    sent = sum(count["sent"] for count in counts)
    return sum(count["passed"] for count in counts) / sent if sent else None
