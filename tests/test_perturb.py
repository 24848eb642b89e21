"""Modelled image perturbations."""

from collections import Counter
from itertools import permutations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uavaccel.vision.perturb import PerturbationKind, PerturbationSettings, perturb, perturb_share, share_at


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


def test_the_share_grows_with_clock_speed_from_none_at_1x_to_all_of_it() -> None:
    shares = [share_at(clock_speed, 0.08, 25.0) for clock_speed in (0.5, 1.0, 6.0, 26.0, 76.0, 1e9)]
    assert shares == pytest.approx([0.0, 0.0, 0.08 / 6, 0.04, 0.06, 0.08])
    assert share_at(1.0, 0.08, None) == share_at(100.0, 0.08, None) == 0.08


def test_share_and_kinds_are_met_and_follow_the_seed() -> None:
    image, settings = flight(1)[0], PerturbationSettings(share=0.2, seed=3)
    kinds = [perturb_share(image, settings, i)[1] for i in range(2000)]
    assert kinds == [perturb_share(image, settings, i)[1] for i in range(2000)]
    assert 2000 - kinds.count(None) == pytest.approx(400, abs=4 * 320**0.5)
    for kind in PerturbationKind:
        assert kinds.count(kind) == pytest.approx(100, abs=40)


@pytest.mark.parametrize("kind", PerturbationKind)
def test_a_perturbed_image_is_a_changed_copy(kind: PerturbationKind) -> None:
    image = flight(1)[0]
    before = image.copy()
    changed = perturb(image, kind, np.random.default_rng(1))
    np.testing.assert_array_equal(image, before)
    assert (changed.shape, changed.dtype) == (image.shape, image.dtype)
    assert (changed != image).any()


def test_a_changed_image_follows_its_index_and_its_seed() -> None:
    image, salt = flight(1)[0], (PerturbationKind.SALT_AND_PEPPER,)
    settings = PerturbationSettings(share=1.0, kinds=salt, seed=3)
    [once, again, next_, other] = [
        perturb_share(image, changed, index)
        for changed, index in (
            (settings, 0), (settings, 0), (settings, 1), (PerturbationSettings(1.0, salt, seed=4), 0),
        )
    ]  # fmt: skip
    assert {kind for _, kind in (once, again, next_, other)} == set(salt)
    np.testing.assert_array_equal(once[0], again[0])
    assert (once[0] != next_[0]).any()
    assert (once[0] != other[0]).any()


def test_brightness_is_a_gain_that_darkens_as_often_as_it_brightens() -> None:
    """0.4 to 0.8 or 1.25 to 2, evenly, and clipped."""
    rng, image = np.random.default_rng(2), np.zeros((2, 2, 3), np.uint8)
    image[0, 0], image[1, 1] = 100, 250
    changed = np.array([perturb(image, PerturbationKind.BRIGHTNESS, rng) for _ in range(4000)], float)
    gains = changed[:, 0, 0, 0] / 100
    assert not changed[:, 0, 1].any()
    np.testing.assert_allclose(changed[:, 1, 1, 1], np.minimum(250 * gains, 255), atol=2.0)
    darker, brighter = gains[gains < 1], gains[gains > 1]
    assert len(darker) == pytest.approx(2000, abs=130)
    for group, low, high in ((darker, 0.4, 0.8), (brighter, 1.25, 2.0)):
        assert (group.min(), group.max()) == pytest.approx((low, high), abs=0.006)
        assert group.mean() == pytest.approx((low + high) / 2, abs=4 * (high - low) / 12**0.5 / 2000**0.5)


def test_colours_are_every_wrong_order_of_the_channels_equally_often() -> None:
    rng = np.random.default_rng(2)
    image = np.array([[[10, 20, 30]]], np.uint8)
    orders = Counter(tuple(perturb(image, PerturbationKind.COLOURS, rng)[0, 0].tolist()) for _ in range(2000))
    assert set(orders) == set(permutations((10, 20, 30))) - {(10, 20, 30)}
    assert min(orders.values()) > 400 - 4 * 320**0.5


def test_an_empty_image_is_black() -> None:
    assert not perturb(flight(1)[0], PerturbationKind.EMPTY, np.random.default_rng(0)).any()


def test_salt_and_pepper_hit_their_share_of_the_pixels() -> None:
    grey = np.full((400, 400, 3), 90, np.uint8)
    noisy = perturb(grey, PerturbationKind.SALT_AND_PEPPER, np.random.default_rng(1))
    for level in (0, 255):  # all three channels of a pixel, black as often as white
        assert (noisy == level).all(axis=2).mean() == pytest.approx(0.05 / 2, rel=0.1)
    assert (noisy == 90).all(axis=2).mean() == pytest.approx(0.95, rel=0.01)
