"""A study of the image guard on the images of a run, of which a share is perturbed (MODELLED)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uavaccel.vision.guard import GuardSettings, GuardState, acquire
from uavaccel.vision.perturb import PerturbationKind, PerturbationSettings, perturb_share

SHARE, STREAMS = 0.05, 20  # of the images that are perturbed; of images


def study_guard(images: NDArray[np.uint8], guard: GuardSettings, seed: int) -> dict[str, Any]:
    """Count what the guard accepts (MODELLED) where a share of a run's images (n, H, W, 3) is perturbed, by kind.

    The images are sent STREAMS times, perturbed with another seed each time, as one stream has too few of each
    kind. An image that the guard requests again may be perturbed again, so with the guard more are sent.
    """
    perturbed = [PerturbationSettings(SHARE, seed=seed + n) for n in range(STREAMS)]
    by_kind: dict[str, Any] = {str(kind): {} for kind in PerturbationKind}
    handed_on = dict[str, float]()
    for name, used in {"off": GuardSettings(max_retries=0), "on": guard}.items():
        sent = pd.concat(pass_guard(images, own, used) for own in perturbed)
        handed_on[name] = float((sent.kind[sent.passed] != "").mean())
        for kind, of_kind in by_kind.items():
            passed = sent.passed[sent.kind == kind]
            share = float(passed.mean()) if len(passed) else None
            of_kind[name] = {"sent": len(passed), "passed": int(passed.sum()), "share_passed": share}
    alarms = int((~pass_guard(images, PerturbationSettings(), guard).passed).sum())
    found: dict[str, Any] = {"modelled": True, "images": len(images), "share": SHARE, "streams": STREAMS}
    found |= {"by_kind": by_kind, "clean_false_alarms": alarms, "clean_retries": alarms}
    return found | {"perturbed_share_handed_on": handed_on}


def pass_guard(images: NDArray[np.uint8], perturbed: PerturbationSettings, guard: GuardSettings) -> pd.DataFrame:
    """Return each image sent: its `kind` of perturbation, "" for none, and whether it `passed` the guard.

    The scene is static while an image is requested again; each request may be perturbed anew.
    """
    state, kinds, passed = GuardState(), list[str](), list[bool]()

    def receive(scene: NDArray[np.uint8]) -> NDArray[np.uint8]:
        image, kind = perturb_share(scene, perturbed, len(kinds))
        kinds.append(kind or "")
        return image

    for scene in images:
        _, state, retries, _ = acquire(state, partial(receive, scene), guard)
        passed += [*[False] * retries, True]
    return pd.DataFrame({"kind": kinds, "passed": passed})
