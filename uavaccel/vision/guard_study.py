"""A study of how many perturbed images of a stream the guard rejects."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from uavaccel.files import Plain
from uavaccel.vision.guard import GuardSettings, GuardState, Verdict, acquire
from uavaccel.vision.perturb import PerturbationKind, PerturbationSettings, perturb_share

Image = NDArray[np.uint8]


@dataclass
class _Statistics:
    """Counts of images sent and passed, by kind of perturbation (None: clean), of retries and of exhausted retries."""

    sent: Counter[PerturbationKind | None] = field(default_factory=Counter)
    passed: Counter[PerturbationKind | None] = field(default_factory=Counter)
    retries: int = 0
    exhausted: int = 0

    def share_passed(self, kind: PerturbationKind | None) -> float | None:
        return self.passed[kind] / self.sent[kind] if self.sent[kind] else None

    def of_kind(self, kind: PerturbationKind) -> dict[str, Plain]:
        return {
            "sent": self.sent[kind],
            "passed": self.passed[kind],
            "share_passed": self.share_passed(kind),
        }

    def summary(self, kinds: Sequence[PerturbationKind]) -> dict[str, Plain]:
        images = sum(self.passed.values())
        return {
            "by_kind": {str(kind): self.of_kind(kind) for kind in kinds},
            "perturbed_share_handed_on": 1 - self.passed[None] / images if images else 0.0,
            "retries": self.retries,
            "exhausted": self.exhausted,
            "false_alarms": self.sent[None] - self.passed[None],
        }


def guard_study(
    frames: Sequence[Image],
    share: float,
    seed: int,
    guard: GuardSettings | None = None,
    kinds: tuple[PerturbationKind, ...] = tuple(PerturbationKind),
) -> dict[str, Plain]:
    """Send consecutive images, uint8 (H, W, 3), through the guard, a `share` of them perturbed (MODELLED).

    The scene is static while an image is requested again; each request may be perturbed anew. The result,
    ready for JSON, holds for each of "off" (no guard), "on" and "clean" (guard on, nothing perturbed):
    `by_kind`, the perturbed images sent and handed on; `perturbed_share_handed_on`; `retries`; `exhausted`,
    the images taken because no retry was left; `false_alarms`, the clean images refused.
    """
    guard, perturbed = guard or GuardSettings(), PerturbationSettings(share, kinds, seed)
    return {
        "modelled": True,
        "images": len(frames),
        "share": share,
        "seed": seed,
        "off": _send(frames, perturbed, GuardSettings(max_retries=0)).summary(kinds),
        "on": _send(frames, perturbed, guard).summary(kinds),
        "clean": _send(frames, PerturbationSettings(), guard).summary(kinds),
    }


def _send(frames: Sequence[Image], perturbed: PerturbationSettings, guard: GuardSettings) -> _Statistics:
    statistics, state = _Statistics(), GuardState()
    for frame in frames:
        sent: list[PerturbationKind | None] = []

        def camera(scene: Image = frame, sent: list[PerturbationKind | None] = sent) -> Image:
            image, kind = perturb_share(scene, perturbed, index=statistics.sent.total() + len(sent))
            sent.append(kind)
            return image

        _, state, retries, reason = acquire(state, camera, guard)
        statistics.sent.update(sent)
        statistics.passed[sent[-1]] += 1
        statistics.retries += retries
        statistics.exhausted += reason is Verdict.EXHAUSTED
    return statistics
