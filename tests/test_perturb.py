"""Modelled image perturbations, and how many of them the guard lets pass."""

import json

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.guard_study import guard_study
from uavaccel.vision.perturb import NOISY_PIXELS, Kind, PerturbationSettings, perturb, perturb_share


def flight(images: int, seed: int = 0) -> list[NDArray[np.uint8]]:
    """Views of a coloured texture sliding by."""
    texture = np.random.default_rng(seed).integers(0, 256, (72, 128 + 2 * images, 3), np.uint8)
    texture = cv2.GaussianBlur(texture, (0, 0), 3) * np.array([1.0, 0.8, 0.5])
    return [texture[:, 2 * i : 2 * i + 128].astype(np.uint8) for i in range(images)]


def test_off_by_default() -> None:
    image = flight(1)[0]
    same, kind = perturb_share(image, PerturbationSettings(), 0)
    assert same is image
    assert kind is None


def test_share_and_kinds_are_met_and_follow_the_seed() -> None:
    image, settings = flight(1)[0], PerturbationSettings(share=0.2, seed=3)
    kinds = [perturb_share(image, settings, i)[1] for i in range(2000)]
    assert kinds == [perturb_share(image, settings, i)[1] for i in range(2000)]
    assert 2000 - kinds.count(None) == pytest.approx(400, abs=4 * 320**0.5)
    for kind in Kind:
        assert kinds.count(kind) == pytest.approx(100, abs=40)


@pytest.mark.parametrize("kind", Kind)
def test_a_perturbed_image_is_a_changed_copy(kind: Kind) -> None:
    image = flight(1)[0]
    before = image.copy()
    changed = perturb(image, kind, np.random.default_rng(1))
    np.testing.assert_array_equal(image, before)
    assert (changed.shape, changed.dtype) == (image.shape, image.dtype)
    assert (changed != image).any()


def test_salt_and_pepper_hit_their_share_of_the_pixels() -> None:
    grey = np.full((200, 200, 3), 90, np.uint8)
    noisy = perturb(grey, Kind.SALT_AND_PEPPER, np.random.default_rng(1))
    assert (noisy != 90).any(axis=2).mean() == pytest.approx(NOISY_PIXELS, rel=0.1)
    assert set(np.unique(noisy)) == {0, 90, 255}


def test_study_counts_by_kind_what_passes_with_the_guard_off_and_on() -> None:
    result = guard_study(flight(600), share=0.2, seed=1)
    assert result == json.loads(json.dumps(result))
    off, on, clean = result["off"], result["on"], result["clean"]
    for kind in Kind:
        assert off["by_kind"][kind]["share_passed"] == 1.0
    assert on["by_kind"]["empty"]["share_passed"] < 0.1
    assert on["by_kind"]["brightness"]["share_passed"] < 0.1
    assert (
        on["by_kind"]["salt_and_pepper"]["share_passed"] == 1.0
    )  # hardly changes the mean of a mid-grey image
    assert on["perturbed_share_handed_on"] < off["perturbed_share_handed_on"]
    assert (clean["false_alarms"], clean["retries"], off["retries"]) == (0, 0, 0)
    assert on["retries"] >= sum(row["sent"] - row["passed"] for row in on["by_kind"].values())


def test_study_without_perturbations_has_no_shares() -> None:
    result = guard_study(flight(5), share=0.0, seed=0, guard=GuardSettings())
    assert result["on"]["by_kind"]["empty"] == {"sent": 0, "passed": 0, "share_passed": None}
    assert result["on"]["perturbed_share_handed_on"] == 0.0


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_a_share_outside_0_to_1_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match="share"):
        PerturbationSettings(share=share)


def test_grey_images_are_refused() -> None:
    with pytest.raises(ValueError, match="H, W, 3"):
        perturb(np.zeros((4, 4), np.uint8), Kind.EMPTY, np.random.default_rng(0))
