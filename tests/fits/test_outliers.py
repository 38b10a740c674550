"""Single pixels far from the model, as of dust and text: least squares follows them, and the fit says so."""

import numpy as np
import pytest

import diffshade as ds

CAMERA = ds.Camera((0, 0, 4), fov=35, shape=(64, 64))
LAMPS = (ds.PointLight((2, 3, 4)), ds.PointLight((-3, 1, 4)))
TRUE = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_a=0.05, k_d=(0.6, 0.4, 0.2), k_s=0.3, n_s=30)), LAMPS)


def fitted(share, seed, loss="squares", *, of_light=0.0):
    """A fit to photographs of which a share of the pixels shows anything, with noise that may grow with the light."""
    random, views = np.random.default_rng(seed), []
    for i in (0, 1):
        image = np.asarray(ds.render(TRUE, CAMERA, lit=i), np.float64)
        image = image + (0.004 + of_light * image) * random.standard_normal((64, 64, 3))
        dusty = random.random((64, 64)) < share
        image[dusty] = random.random((dusty.sum(), 3))
        views.append(ds.View(image, CAMERA, lit=i))
    return ds.fit(TRUE, views, free=("k_a", "k_d", "k_s", "n_s"), loss=loss)


@pytest.mark.parametrize(
    ("share", "seed"), [(0.01, 0), *(pytest.param(*of, marks=pytest.mark.thorough) for of in [(0.03, 1), (0.1, 2)])]
)
def test_errors_contain_what_they_move_and_the_note_says_what_to_do(share, seed):
    fit = fitted(share, seed)
    off = np.abs(fit.values - fit.values_in(TRUE))
    assert np.max(off / fit.plain_errors) > 3.0
    np.testing.assert_array_less(off[fit.determined], 2.5 * fit.errors[fit.determined])
    (note,) = [note for note in fit.notes if note.kind == "cause"]
    assert note.names == ("outliers",)
    assert "the rest is noise" in note
    assert "loss='cauchy'" in note
    robust = fitted(share, seed, "cauchy")
    np.testing.assert_array_less(np.abs(robust.values - robust.values_in(TRUE)), 3.5 * robust.errors)
    assert np.max(np.abs(robust.values - robust.values_in(TRUE)) / off) < 1.0


def test_noise_alone_has_none():
    fit = fitted(0.0, 3)
    assert not [note for note in fit.notes if note.kind in ("cause", "misfit")]
    np.testing.assert_array_equal(fit.errors, fit.clusters.wide_errors())


def test_noise_that_grows_with_the_light_as_of_few_paths_a_pixel_has_none():
    fit = fitted(0.0, 4, of_light=0.15)
    assert not [note for note in fit.notes if "outliers" in note.names]
    np.testing.assert_array_less(
        np.abs(fit.values - fit.values_in(TRUE))[fit.determined], 3.0 * fit.errors[fit.determined]
    )
