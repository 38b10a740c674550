"""Quantiles of residuals, and the bands that they make around predictions."""

import numpy as np

from diffshade.diagnosis.residual_quantiles import BRIGHTNESS, ResidualQuantiles, residual_quantiles

NEAR = 10.0  # degrees from each light to the others


def photographs(seed, views=24, texels=400):
    """Photographs of two kinds of texels, of which one is ten times as hard to predict, with highlights that are too.

    Every photograph has an error of its own, which all of its samples share.
    """
    random = np.random.default_rng(seed)
    hard = np.where(np.arange(texels) % 2 == 0, 1.0, 10.0)[:, None]
    predicted = np.where(random.random((views, texels, 1)) < 0.1, 4.0, 1.0) * np.ones((views, texels, 3))
    size = 0.01 * hard * np.where(predicted > 3.0, 5.0, 1.0)
    shared = 0.3 * random.normal(size=(views, 1, 1))
    return predicted + size * (random.exponential(size=predicted.shape) - 0.5 + shared), predicted, hard


def quantiles_of(seen, predicted) -> ResidualQuantiles:
    return residual_quantiles(seen, predicted, np.arange(len(seen)), np.full(len(seen), NEAR))


def test_photographs_not_seen_lie_inside_wherever_one_looks():
    seen, predicted, hard = photographs(0)
    quantiles = quantiles_of(seen, predicted)
    new, of_new, _ = photographs(1)
    lower, upper = np.array([quantiles.band(p[None], 0.9, NEAR) for p in of_new]).swapaxes(0, 1)
    inside = (lower <= new) & (new <= upper)
    assert 0.86 < inside.mean() < 0.94
    for part in (of_new > 3.0, of_new < 3.0, np.broadcast_to(hard == 1.0, new.shape)):
        assert 0.8 < inside[part].mean() < 0.97
    assert np.median((upper - of_new)[of_new > 3.0] / (of_new - lower)[of_new > 3.0]) > 2.0  # as the errors are


def test_a_higher_level_has_wider_bands():
    seen, predicted, _ = photographs(0)
    widths = []
    for level in (0.5, 0.8, 0.95):
        lower, upper = quantiles_of(seen, predicted).band(predicted[:1], level, NEAR)
        widths.append(upper - lower)
    assert np.all(widths[0] < widths[1])
    assert np.all(widths[1] < widths[2])


def test_fits_that_disagree_make_wider_bands():
    seen, predicted, _ = photographs(0)
    quantiles = quantiles_of(seen, predicted)
    apart = np.array([0.5, 1.0, 1.0, 1.5])[:, None, None] * predicted[0]
    widths = [np.subtract(*quantiles.band(of, 0.9, NEAR)[::-1]) for of in (predicted[:1], apart)]
    assert np.all(widths[1] > widths[0])


def test_a_fit_that_runs_away_does_not_make_a_band_boundless():
    seen, predicted, _ = photographs(0)
    wild = np.ones((8, 1, 1)) * predicted[0]
    wild[3] *= 1e6
    _, upper = quantiles_of(seen, predicted).band(wild, 0.9, NEAR)
    assert upper.max() < 2.0 * seen.max()


def test_a_fit_that_runs_away_downward_leaves_the_upper_ends():
    seen, predicted, _ = photographs(0)
    quantiles = quantiles_of(seen, predicted)
    wild = np.ones((8, 1, 1)) * predicted[0]
    _, upper = quantiles.band(wild, 0.9, NEAR)
    wild[3] = -1e6
    lower, of_wild = quantiles.band(wild, 0.9, NEAR)
    np.testing.assert_allclose(of_wild, upper, rtol=0.05)
    assert np.all(lower < predicted[0])


def test_a_photograph_brighter_than_all_fitted_has_bands_about_its_prediction():
    seen, predicted, _ = photographs(0)
    brighter = 5.0 * np.ones((8, 1, 1)) * predicted[0]
    brighter[3] *= 1e6
    lower, upper = quantiles_of(seen, predicted).band(brighter, 0.9, NEAR)
    assert np.all((lower < 5.0 * predicted[0]) & (5.0 * predicted[0] < upper))
    assert upper.max() < 8.0 * seen.max()


def test_no_band_goes_below_the_darkest_sample():
    seen, predicted, _ = photographs(0)
    lower, _ = quantiles_of(seen, predicted).band(0.0 * predicted[:1], 0.9, NEAR)
    assert lower.min() == seen.min()


def test_samples_that_do_not_count_say_nothing():
    """A texel without samples has the scale of the median texel; a brightness without samples all quantiles."""
    seen, predicted, _ = photographs(0)
    whole = quantiles_of(seen, predicted)
    seen[:, 7] = np.nan
    part = quantiles_of(seen, predicted)
    assert np.all((part.scale[7] > whole.scale[6]) & (part.scale[7] < 1.5 * whole.scale.max()))
    others = np.arange(400) != 7
    np.testing.assert_allclose(part.scale[others], whole.scale[others], rtol=0.2)
    unseen = np.digitize(0.1, BRIGHTNESS)  # nothing was predicted to be so dark
    assert part.counts[:, unseen].sum() == 0
    dark = np.full_like(predicted[:1], 0.1)
    dark[:, 7] = 0.0
    lower, upper = part._replace(floor=-np.inf).band(dark, 0.9, NEAR)
    assert np.isfinite(lower).all()
    assert np.all(upper[others] > lower[others])


def test_residuals_grow_with_the_distance_to_the_fitted_lights():
    """As they do from the near to the far fit of the same photographs: by the square root, here."""
    seen, predicted, _ = photographs(0)
    far, of_far, _ = photographs(0)
    far = of_far + 2.0 * (far - of_far)
    of = np.tile(np.arange(24), 2)
    distance = np.repeat([NEAR, 4.0 * NEAR], 24)
    both = residual_quantiles(np.concatenate([seen, far]), np.concatenate([predicted, of_far]), of, distance)
    np.testing.assert_allclose(both.growth, 0.5, atol=1e-9)
    widths = [np.subtract(*both.band(predicted[:1], 0.9, d)[::-1]).mean() for d in (NEAR, 4.0 * NEAR)]
    np.testing.assert_allclose(widths[1] / widths[0], 2.0, rtol=0.05)


def test_residuals_of_a_small_object_grow_too():
    """No bin has enough samples of a photograph for a growth of its own: they have that of all samples."""
    seen, predicted, _ = photographs(0, texels=20)
    of = np.tile(np.arange(24), 2)
    distance = np.repeat([NEAR, 4.0 * NEAR], 24)
    twice = np.concatenate([seen, predicted + 2.0 * (seen - predicted)])
    both = residual_quantiles(twice, np.concatenate([predicted, predicted]), of, distance)
    np.testing.assert_allclose(both.growth, 0.5, atol=0.05)


def test_bright_samples_may_grow_otherwise_than_dark_ones():
    seen, predicted, _ = photographs(0)
    far = predicted + np.where(predicted > 3.0, 4.0, 1.0) * (seen - predicted)
    of = np.tile(np.arange(24), 2)
    distance = np.repeat([NEAR, 4.0 * NEAR], 24)
    both = residual_quantiles(np.concatenate([seen, far]), np.concatenate([predicted, predicted]), of, distance)
    dark, bright = np.digitize([1.0, 4.0], BRIGHTNESS)
    np.testing.assert_allclose(both.growth[[dark, bright]], [0.0, 1.0], atol=0.05)


def test_a_brightness_that_one_photograph_shows_has_wider_bands():
    seen, predicted, _ = photographs(0)
    many = quantiles_of(seen, predicted)
    alone = predicted.copy()
    alone[1:] = np.minimum(alone[1:], 1.0)
    few = quantiles_of(alone + (seen - predicted), alone)
    bright = np.full_like(predicted[:1], 4.0)
    widths = [np.subtract(*of.band(bright, 0.9, NEAR)[::-1]).mean() for of in (many, few)]
    assert widths[1] > 1.5 * widths[0]
