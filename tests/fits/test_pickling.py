"""Views, scenes and fits as other processes get them: pickled, copied, and read again from another folder."""

import copy
import pickle

import jax
import numpy as np
import pytest
from small_blocks import small_blocks  # noqa: F401

import diffshade as ds

CAMERA = ds.OrthographicCamera((0, 0, 4), height=2.6, shape=(24, 24), local_viewer=False)
TOWARD = np.array([(0.6, 0, 0.8), (0, 0.6, 0.8), (-0.6, 0, 0.8), (0, -0.6, 0.8), (0, 0, 1), (0.36, 0.48, 0.8)])
BALL = ds.Scene(
    ds.Object(ds.Sphere(), ds.Material(0.05, (0.6, 0.3, 0.2), 0.3, 30)), [ds.DirectionalLight(-l) for l in TOWARD]
)


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """Photographs of a ball in .npy, which are opened and not read."""
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(0)
    for i in range(len(TOWARD)):
        image = np.asarray(ds.render(BALL, CAMERA, lit=i), np.float64)
        np.save(folder / f"{i}.npy", image + rng.normal(0, 0.002, image.shape))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder.parent)  # their paths are relative
        images = [ds.open_image(f"{folder.name}/{i}.npy") for i in range(len(TOWARD))]
    return [ds.View(image, CAMERA, lit=i) for i, image in enumerate(images)]


@pytest.fixture(scope="module")
def fit(views):
    return ds.fit(BALL, views, free=("k_a", "k_d", "k_s", "n_s"))


def again(thing):
    return pickle.loads(pickle.dumps(thing))


@pytest.mark.parametrize("copied", [again, copy.deepcopy])
def test_views_of_files_are_their_paths(views, copied, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a worker may be at work in another folder
    assert len(pickle.dumps(views[0].image)) < 1000
    for view, other in zip(views, copied(views), strict=True):
        assert type(other.image) is type(view.image)
        np.testing.assert_array_equal(other.image[:], view.image[:])
    image = np.concatenate([views[0].image[:], np.ones((24, 24, 1))], -1)
    np.save("with alpha.npy", image)
    np.testing.assert_array_equal(copied(ds.open_image("with alpha.npy").colours())[:], image[..., :3])


@pytest.mark.parametrize("copied", [again, copy.deepcopy])
def test_a_fit_prints_and_predicts_the_same(fit, copied):
    other = copied(fit)
    assert str(other) == str(fit)
    np.testing.assert_array_equal(other.predict(other.views[1]).image, fit.predict(fit.views[1]).image)
    assert str(copied(fit.scene)) == str(fit.scene)


def test_maps_are_the_same(views, tmp_path):
    ds.fit_texels(BALL, views, free=("k_d",), out=tmp_path / "maps")
    maps = ds.read_maps(tmp_path / "maps")
    other = again(maps)
    assert str(other) == str(maps)
    np.testing.assert_array_equal(other.values["k_d"], maps.values["k_d"])


# Where a user has told JAX to raise on every NaN


@pytest.fixture
def nans_raise():
    jax.config.update("jax_debug_nans", True)
    yield
    jax.config.update("jax_debug_nans", False)


@pytest.mark.thorough
def test_no_program_makes_a_nan(nans_raise, views):
    fit = ds.fit(BALL, views, free=("k_a", "k_d", "k_s", "n_s"))
    np.testing.assert_allclose(fit.material.k_d, (0.6, 0.3, 0.2), atol=0.002)
    assert "n_s" in str(ds.examine(fit))
    maps = ds.fit_texels(BALL, views, free=("k_d", "k_s", "n_s", "normal"))
    np.testing.assert_allclose(np.median(maps.values["k_d"][maps.known], 0), (0.6, 0.3, 0.2), atol=0.005)
    assert ds.fit_texels(BALL, views, free=("k_d", "k_s")).known.any()
