"""The paper's image guard (section III-B), which requests an image again if its mean brightness is implausible.

Consecutive images of a scene are about equally bright. An image is suspect if its mean brightness differs by more
than 10 % from that of the previous image, or lies below a floor; it is then requested again while the simulation
stands still. The floor and the limit on retries are this project's own choice.

After the last retry an image is accepted as it is and becomes the reference: a guard that kept the last good one
could lock up for ever once a scene really did become brighter. If the renderer is deterministic, a second image
equal to the suspect one proves that the scene did change, and is accepted at once.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from uavaccel.config import Config
from uavaccel.sim.camera.pixels import means

Image = NDArray[np.uint8]
NotNegative = Annotated[float, Field(ge=0.0)]

LUMA_WEIGHTS = (0.299, 0.587, 0.114)  # of red, green, blue (ITU-R BT.601), as in the DVS's grey image


class GuardSettings(Config):
    """Limits of the image guard (uavaccel.vision.guard); `max_retries: 0` switches it off."""

    max_change: NotNegative = 0.10
    """Accepted change of mean brightness, as a share of the last image's."""
    min_brightness: Annotated[float, Field(ge=0.0, le=255.0)] = 10.0
    """Mean brightness, from 0 to 255, below which an image is too dark."""
    max_retries: Annotated[int, Field(ge=0, le=1000)] = 3
    """How often a rejected image is asked for again."""
    accept_identical: bool = True
    """Whether an image that comes out identical when it is requested again is accepted."""


class Verdict(StrEnum):
    """The decision on an image, and its reason."""

    STEADY = "steady"  # brightness within the limits: accepted
    IDENTICAL = "identical"  # suspect, but equal to the suspect image before it: accepted
    EXHAUSTED = "exhausted"  # suspect, but no retry is left: accepted
    RETRY = "retry"  # suspect: to be requested again


class GuardState(NamedTuple):
    """State of the guard: the brightness of the last accepted image, and the last suspect image and retries since."""

    reference_brightness: float | None = None
    suspect: Image | None = None
    retries: int = 0


class Acquisition(NamedTuple):
    """An accepted image, the guard's new state, the number of retries, and why the image was accepted."""

    image: Image
    state: GuardState
    retries: int
    reason: Verdict


def mean_brightness(image: Image) -> float:
    """Return the mean luma, 0..255, of a grey (H, W) or RGB image (H, W, 3)."""
    found = means(image)
    return found[0] if image.ndim == 2 else float(np.dot(found[:3], LUMA_WEIGHTS))


def judge(state: GuardState, image: Image, settings: GuardSettings) -> tuple[GuardState, Verdict]:
    """Return the new state and the verdict for a received image, without side effects; stored images are copies."""
    brightness, reference = mean_brightness(image), state.reference_brightness
    steady = reference is None or abs(brightness - reference) <= settings.max_change * reference
    if steady and brightness >= settings.min_brightness:
        return GuardState(brightness), Verdict.STEADY
    if settings.accept_identical and state.suspect is not None and np.array_equal(image, state.suspect):
        return GuardState(brightness), Verdict.IDENTICAL
    if state.retries >= settings.max_retries:
        return GuardState(brightness), Verdict.EXHAUSTED
    return GuardState(state.reference_brightness, image.copy(), state.retries + 1), Verdict.RETRY


def acquire(
    state: GuardState, request_image: Callable[[], Image], settings: GuardSettings | None = None
) -> Acquisition:
    """Request images of a static scene until the guard accepts one: at most 1 + `max_retries`."""
    settings = settings or GuardSettings()
    while True:
        image, retries = request_image(), state.retries
        state, verdict = judge(state, image, settings)
        if verdict is not Verdict.RETRY:
            return Acquisition(image, state, retries, verdict)
