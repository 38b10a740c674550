"""Relief as fine as a texel: neighbours correct no normal that is known better than they agree."""

from __future__ import annotations

import numpy as np
import pytest
from bumpy import degrees_between
from plates import plate
from scipy import ndimage

import diffshade as ds
from diffshade.texels.robust.neighbours import corrected, geometric_median

FREE = ("k_d", "k_s", "n_s", "normal")


@pytest.mark.thorough
@pytest.mark.parametrize("k_s", [0.0, 0.3])
def test_grain_keeps_its_normals_and_their_errors_hold(k_s):
    grain = np.random.default_rng(2).standard_normal((44, 44))
    raised = 0.12 * grain + 3.0 * ndimage.gaussian_filter(grain, 5.0)
    of = plate(np.full((44, 44, 3), (0.6, 0.5, 0.4)), k_s, 30.0, 12, raised, 35.0)
    maps, own = (ds.fit_texels(of.scene, of.views, free=FREE, light_error=0.0, neighbours=n) for n in (True, False))
    off, alone = (degrees_between(one.values["normal"], of.normal)[of.mask] for one in (maps, own))
    assert off.mean() < 1.15 * alone.mean() + 0.05
    for errors, least in ((maps.errors, 0.6), (maps.errors_95, 0.9)):
        assert np.mean(off <= errors["normal"][of.mask][:, 0]) > least


def test_a_median_replaces_what_is_known_no_better():
    bumpy = np.array((0.0, 0.0, 1.0)) + np.random.default_rng(0).normal(0.0, 0.1, (9, 9, 3))
    bumpy /= np.linalg.norm(bumpy, axis=-1, keepdims=True)
    mask, median = np.ones((9, 9), bool), geometric_median(bumpy, np.ones((9, 9), bool))
    np.testing.assert_array_equal(corrected(bumpy, np.full((9, 9, 1), 0.01), mask)[1:-1, 1:-1], bumpy[1:-1, 1:-1])
    for angle in (1.0, np.inf):
        np.testing.assert_array_equal(corrected(bumpy, np.full((9, 9, 1), angle), mask), median)
