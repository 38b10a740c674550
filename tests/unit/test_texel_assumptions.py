"""What is assumed of an object's texels: when one way predicts clearly better, and what a matte object's k_s costs."""

import equinox as eqx
import numpy as np
import pytest

from diffshade.texels.robust.calibration import GROUPS
from diffshade.texels.robust.choice import clearly_better, views_seen
from diffshade.texels.robust.learning import every_assumption, first_model
from diffshade.texels.tiles import TexelTile


@pytest.mark.parametrize(("gain", "better"), [(0.2, True), (0.01, False), (-0.2, False), (np.nan, False)])
def test_a_gain_of_a_few_percent_is_not_clear(gain, better):
    assert clearly_better(np.ones(6), np.ones(6) - gain) == better


def test_a_gain_of_one_view_alone_is_chance():
    assert not clearly_better(np.ones(6), np.array([-1.0, 1.2, 1.0, 1.1, 0.9, 1.0]))


def test_each_view_is_left_out_of_the_fits_of_as_many_texels():
    texels = np.arange(600)
    nothing = np.zeros((600, 3))
    tile = TexelTile(texels, nothing, None, np.zeros((8, 1, 600)), np.ones((8, 600), bool))
    assert (np.sum(~views_seen(tile), 1) == 600 // GROUPS).all()


def test_k_s_of_a_matte_object_is_unlikely_whatever_the_units():
    general, matte, *_ = every_assumption()
    assert general.glossy
    assert not matte.glossy
    model = first_model("cauchy", matte)
    bright, dark = (np.asarray(model.weighing(np.asarray([level], np.float32)).ridge) for level in (1.0, 1e-3))
    np.testing.assert_allclose(bright, dark)


def test_without_outliers_the_loss_is_nearly_squares():
    model = first_model("cauchy", every_assumption()[0])
    soft = eqx.tree_at(lambda one: one.assumed.outliers, model, np.asarray(False))
    level = np.ones(1, np.float32)
    assert float(soft.weighing(level).scale[0]) > 20.0 * float(model.weighing(level).scale[0])
    np.testing.assert_allclose(float(soft.softness) * float(model.weighing(level).scale[0]), soft.weighing(level).scale)
