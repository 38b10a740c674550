"""Noise tests: noise passes, whatever its size; what a wrong description leaves is seen in one view as in many."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import ndimage
from synthetic import CAMERA, MATERIAL, noisy, one_light_each, photograph, point_lights, standard_scene

import diffshade as ds
from diffshade.core.backend import in_float64
from diffshade.inverse.misfit.noise_tests import FALSE_ALARM, Footprint, Leftover, leftovers, whiteness

SIDE = 40
Y, X = (2.0 * np.mgrid[:SIDE, :SIDE] + 1 - SIDE) / SIDE
ROW, COLUMN = np.nonzero(X**2 + Y**2 < 0.9)
SHADE = np.sqrt(np.maximum(1.0 - X**2 - Y**2, 0.0)) + np.exp(-((X - 0.3) ** 2 + (Y - 0.2) ** 2) / 0.02)


def white(random: np.random.Generator) -> np.ndarray:
    return random.standard_normal((SIDE, SIDE))


SHOWN = Footprint([ROW * SIDE + COLUMN], (SIDE, SIDE))


def p_value(views: list[Leftover]) -> float:
    return whiteness(views).p_value


def left(residual: np.ndarray) -> Leftover:
    """A view of a shaded disc with a highlight, and these residuals in units of its noise."""
    return Leftover(0, SHOWN, residual[ROW, COLUMN], SHADE[ROW, COLUMN])


def test_noise_passes():
    random = np.random.default_rng(0)
    scale = np.where(random.random((SIDE, SIDE)) < 0.5, 1.0, 5.0)  # noise may differ, but not with brightness
    found = [p_value([left(white(random))]) for _ in range(1500)]
    found += [p_value([left(white(random)) for _ in range(4)]) for _ in range(125)]
    found += [p_value([left(scale * white(random))]) for _ in range(375)]
    assert np.sum(np.array(found) < FALSE_ALARM) <= 1
    assert np.sum(np.array(found) < 0.01) <= 30


def test_noise_is_noise_whatever_its_size():
    noise = white(np.random.default_rng(2))[ROW, COLUMN].astype(np.float32)
    light = SHADE[ROW, COLUMN].astype(np.float32)
    found = [p_value([Leftover(0, SHOWN, np.float32(size) * noise, light)]) for size in (1.0, 1e-12, 1e-16)]
    np.testing.assert_allclose(found, found[0], rtol=1e-3)  # fourth powers are smaller than single precision holds
    assert found[0] > FALSE_ALARM


CHANGES: dict[str, np.ndarray] = {
    "smooth": 1.0 * X * Y,
    "by brightness": 0.5 * np.cos(3.0 * SHADE),
    "shift": 4.0 * np.gradient(SHADE, axis=1),
    "blur": 30.0 * (ndimage.gaussian_filter(SHADE, 1.0) - SHADE),
    "patch": 2.5 * ((np.abs(X + 0.3) < 0.15) & (np.abs(Y) < 0.15)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
@pytest.mark.parametrize("count", [1, 6])
def test_a_change_of_all_views_or_of_one_of_them_is_seen(change, count):
    random = np.random.default_rng(1)
    assert p_value([left(change / np.sqrt(count) + white(random)) for _ in range(count)]) < FALSE_ALARM
    assert p_value([left(1.5 * change * (i == 2 % count) + white(random)) for i in range(count)]) < FALSE_ALARM


NOISES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "grows with brightness": lambda z: z * (0.4 + SHADE),
    "is correlated": lambda z: ndimage.gaussian_filter(z, 0.6),
}


@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
def test_noise_that_is_not_alike_or_not_independent_is_seen(noise):
    random = np.random.default_rng(2)
    assert p_value([left(noise(white(random))) for _ in range(2)]) < FALSE_ALARM


def test_noise_that_grows_a_little_is_seen_in_one_view():
    """As that of photons does; fifteen bins by brightness are less sure than their one sum along it."""
    random = np.random.default_rng(5)
    found = [p_value([left(white(random) * (1.0 + 0.7 * (SHADE - 0.7)))]) for _ in range(40)]
    assert np.sum(np.array(found) < FALSE_ALARM) >= 34


def test_sums_of_correlated_residuals_have_so_many_times_the_variance():
    random = np.random.default_rng(3)
    alike = [np.repeat(np.repeat(white(random)[: SIDE // 2, : SIDE // 2], 2, 0), 2, 1) for _ in range(4)]
    assert whiteness([left(of) for of in alike]).correlation == pytest.approx(4.0, rel=0.25)
    assert whiteness([left(white(random)) for _ in range(4)]).correlation == pytest.approx(1.0, abs=0.25)


def test_what_leaves_nothing_is_noise():
    assert p_value([]) == 1.0
    assert p_value([left(np.zeros((SIDE, SIDE)))]) == 1.0


@pytest.mark.thorough
def test_what_is_left_of_a_fit_is_its_whitened_residuals_and_clipped_samples_that_are_met_count_0():
    """Blocks are padded: the pixels are those of the object alone."""
    scene = standard_scene(MATERIAL, point_lights()[:2])
    images = [np.minimum(im, 0.5) for im in noisy([photograph(scene, CAMERA, (i,)) for i in range(2)], 0.01, 0)]
    fit = ds.fit(scene, one_light_each(images, saturation=0.5, noise=0.02), free=("k_a", "k_d"))
    with in_float64(fit) as own:
        laid = own.solved.laid_out()
        found = leftovers(laid, laid.theta)
    unit, brightest = np.sqrt(laid.squares / fit.counts.samples), max(np.max(image) for image in images)
    clipped = 0
    for view, of in zip(fit.views, found, strict=True):
        seen = fit.predict(view)
        assert len(of.residual) == np.sum(seen.image.sum(-1) > 0)
        inside = seen.image.sum(-1) > 0
        image, shown = np.asarray(view.image)[inside], seen.image[inside]
        met = (image >= 0.5) & (shown >= 0.5)
        clipped += int(met.sum())
        sure = ~np.any((image >= 0.5) & (np.abs(shown - 0.5) < 0.02), -1)  # near its level, the limit is smooth
        expected = np.where(met, 0.0, (shown - image) / 0.02).sum(-1)
        np.testing.assert_allclose(unit * of.residual[sure], expected[sure], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(brightest * of.light, shown.sum(-1), rtol=1e-6)
    assert clipped > 20


@pytest.mark.parametrize("count", [1, 6])
@pytest.mark.parametrize(("sigma", "expected"), [(0.01, 1.0), (0.5, 2.4)])
def test_noise_that_neighbours_share_is_told_from_a_wrong_description(count, sigma, expected):
    random, found = np.random.default_rng(6), []

    def noise():
        return ndimage.gaussian_filter(white(random), sigma)

    for _ in range(50):
        found.append(whiteness([left(noise()) for _ in range(count)]).shared)
        for change in (CHANGES["smooth"], CHANGES["shift"], CHANGES["patch"]):
            assert whiteness([left(10.0 * change + noise()) for _ in range(count)]).shared is None
    assert np.median([of for of in found if of is not None]) == pytest.approx(expected, rel=0.35)
    assert sum(of is None for of in found) < 15
