"""What the image guard keeps out of a stream of images of which a share is perturbed."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.vision.guard import GuardSettings, GuardState, Verdict, acquire
from uavaccel.vision.perturb import Kind, PerturbationSettings, perturb_share

Image = NDArray[np.uint8]


@dataclass
class _Tally:
    """What was sent, what was handed on, by kind of perturbation (None: clean), and what it took."""

    sent: Counter[Kind | None] = field(default_factory=Counter)
    passed: Counter[Kind | None] = field(default_factory=Counter)
    retries: int = 0
    exhausted: int = 0

    def share_passed(self, kind: Kind | None) -> float | None:
        return self.passed[kind] / self.sent[kind] if self.sent[kind] else None

    def of_kind(self, kind: Kind) -> dict[str, Any]:
        return {
            "sent": self.sent[kind],
            "passed": self.passed[kind],
            "share_passed": self.share_passed(kind),
        }

    def summary(self, kinds: Sequence[Kind]) -> dict[str, Any]:
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
    kinds: tuple[Kind, ...] = tuple(Kind),
) -> dict[str, Any]:
    """Send consecutive images, uint8 (H, W, 3), through the guard, a `share` of them perturbed (MODELLED).

    The scene stands still between the requests for one image; each request may be perturbed anew. The result,
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
        "off": _fly(frames, perturbed, GuardSettings(max_retries=0)).summary(kinds),
        "on": _fly(frames, perturbed, guard).summary(kinds),
        "clean": _fly(frames, PerturbationSettings(), guard).summary(kinds),
    }


def _fly(frames: Sequence[Image], perturbed: PerturbationSettings, guard: GuardSettings) -> _Tally:
    tally, state = _Tally(), GuardState()
    for frame in frames:
        sent: list[Kind | None] = []

        def camera(scene: Image = frame, sent: list[Kind | None] = sent) -> Image:
            image, kind = perturb_share(scene, perturbed, index=tally.sent.total() + len(sent))
            sent.append(kind)
            return image

        _, state, retries, reason = acquire(state, camera, guard)
        tally.sent.update(sent)
        tally.passed[sent[-1]] += 1
        tally.retries += retries
        tally.exhausted += reason is Verdict.EXHAUSTED
    return tally
