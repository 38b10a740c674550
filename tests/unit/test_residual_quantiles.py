"""Quantiles of residuals, and the bands that they make around predictions."""

import numpy as np

from diffshade.diagnosis.residual_quantiles import BRIGHTNESS, residual_quantiles


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


def test_photographs_not_seen_lie_inside_wherever_one_looks():
    seen, predicted, hard = photographs(0)
    quantiles = residual_quantiles(seen, predicted)
    new, of_new, _ = photographs(1)
    lower, upper = np.array([quantiles.band(p[None], 0.9) for p in of_new]).swapaxes(0, 1)
    inside = (lower <= new) & (new <= upper)
    assert 0.86 < inside.mean() < 0.94
    for part in (of_new > 3.0, of_new < 3.0, np.broadcast_to(hard == 1.0, new.shape)):
        assert 0.8 < inside[part].mean() < 0.97
    assert np.median((upper - of_new)[of_new > 3.0] / (of_new - lower)[of_new > 3.0]) > 2.0  # as the errors are


def test_a_higher_level_has_wider_bands():
    seen, predicted, _ = photographs(0)
    widths = []
    for level in (0.5, 0.8, 0.95):
        lower, upper = residual_quantiles(seen, predicted).band(predicted[:1], level)
        widths.append(upper - lower)
    assert np.all(widths[0] < widths[1])
    assert np.all(widths[1] < widths[2])


def test_fits_that_disagree_make_wider_bands():
    seen, predicted, _ = photographs(0)
    quantiles = residual_quantiles(seen, predicted)
    apart = np.array([0.5, 1.0, 1.0, 1.5])[:, None, None] * predicted[0]
    widths = [np.subtract(*quantiles.band(of, 0.9)[::-1]) for of in (predicted[:1], apart)]
    assert np.all(widths[1] > widths[0])


def test_no_band_goes_below_the_darkest_sample():
    seen, predicted, _ = photographs(0)
    lower, _ = residual_quantiles(seen, predicted).band(0.0 * predicted[:1], 0.9)
    assert lower.min() == seen.min()


def test_samples_that_do_not_count_say_nothing():
    """A texel without samples has the scale of the median texel; a brightness without samples all quantiles."""
    seen, predicted, _ = photographs(0)
    whole = residual_quantiles(seen, predicted)
    seen[:, 7] = np.nan
    part = residual_quantiles(seen, predicted)
    assert np.all((part.scale[7] > whole.scale[6]) & (part.scale[7] < 1.5 * whole.scale.max()))
    others = np.arange(400) != 7
    np.testing.assert_allclose(part.scale[others], whole.scale[others], rtol=0.2)
    unseen = np.digitize(0.1, BRIGHTNESS)  # nothing was predicted to be so dark
    scaled = ((seen - predicted) / part.scale)[np.isfinite(seen)]
    np.testing.assert_allclose(part.table[unseen][[0, -1]], np.quantile(scaled, (0.5 / 64, 63.5 / 64)))
