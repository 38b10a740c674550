"""Fits of photographs with other channels than red, green and blue."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.unknown import coordinates

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(24, 24))
WAVELENGTHS = np.arange(400, 701, 10)
SPECTRA = np.random.default_rng(1).uniform(0.1, 0.6, (3, 31))


def scene(bands: int, **of_material) -> ds.Scene:
    """A ball whose k_d and k_s are spectra, under a lamp that is one too."""
    k_d, k_s, lamp = SPECTRA[:, :bands]
    names = WAVELENGTHS[:bands] if bands > 3 else None
    material = ds.Material(0.1, k_d, k_s, 30, **of_material)
    return ds.Scene(ds.Object(ds.Sphere(), material), ds.PointLight((2, 3, 4), 1 + lamp), bands=names)


def view(of: ds.Scene, sigma: float = 0.002) -> ds.View:
    """Its photograph, with noise."""
    image = np.asarray(ds.render(of, CAMERA), np.float64)
    return ds.View(image + np.random.default_rng(2).normal(0, sigma, image.shape), CAMERA)


@pytest.fixture(scope="module")
def found() -> ds.Fit:
    return ds.fit(scene(31), view(scene(31)), free=("k_a", "k_d", "k_s", "n_s"), bounds={"k_d.550nm": (0, 0.9)})


def test_thirty_one_bands_are_found_with_their_errors(found):
    assert found.determined.all()
    off = (found.values - found.values_in(scene(31))) / found.errors
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.3


def test_parameters_bear_the_names_of_their_bands(found):
    assert found.names[0] == "k_a.400nm"
    assert {f"{k}.{w}nm" for k in ("k_a", "k_d", "k_s") for w in WAVELENGTHS} | {"n_s"} == set(found.names)
    assert "k_s.700nm" in str(found)
    assert [u.name for u in found.unknowns if u.upper == 0.9] == ["k_d.550nm"]
    assert found.counts.samples == 31 * found.counts.pixels


@pytest.mark.thorough
def test_a_fit_by_rendering_finds_bands_too():
    true = scene(5, fresnel=ds.Schlick())
    fit = ds.fit(true, view(true), free=("k_d", "k_s", "n_s"))
    assert np.abs((fit.values - fit.values_in(true)) / fit.errors).max() < 4.5
    assert np.abs(fit.predict(view(true)).difference).max() < 0.02


@pytest.mark.thorough
@pytest.mark.parametrize("steepest", [None, 0.3])
def test_derivatives_by_bands_are_those_by_each_unknown(steepest):
    true = scene(5, fresnel=ds.Schlick())
    data = ViewSet.of(true, [view(true)])
    unknowns = find_unknowns(true, data.views, ("k_d", "k_s", "n_s", "lights.0.position"))
    problem = new_problem(true, data, unknowns, "huber", "hinge")
    limits = None if steepest is None else np.full(len(unknowns), steepest)
    model = jax.tree.map(jnp.asarray, dataclasses.replace(problem.model, steepest=limits))
    dense = eqx.tree_at(lambda m: m.setting.of_bands, model, None)
    theta = coordinates(np.array([u.start for u in unknowns]), unknowns)
    few, all_of_them = (of.summary(jnp.asarray(theta), problem.chunks()[0]) for of in (model, dense))
    assert model.setting.of_bands is not None
    assert model.setting.of_bands[0].shape == (6, 14)  # k_d, k_s, n_s, x, y and z
    for one, other in zip(jax.tree.leaves(few), jax.tree.leaves(all_of_them), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())


@pytest.mark.thorough
def test_in_four_bands_the_fourth_is_no_alpha():
    true = scene(4)
    fit = ds.fit(true, view(true), free=("k_d", "k_s"))
    assert fit.counts.samples == 4 * fit.counts.pixels
    assert np.abs((fit.values - fit.values_in(true)) / fit.errors).max() < 4.5


@pytest.mark.thorough
def test_one_band_has_one_number_for_each_colour():
    true = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.6, 0.3, 30)), ds.PointLight((2, 3, 4)), bands=(850,))
    fit = ds.fit(true, view(true), free=("k_a", "k_d", "k_s", "n_s"))
    assert fit.names == ("k_a.850nm", "k_d.850nm", "k_s.850nm", "n_s")
    assert np.abs((fit.values - fit.values_in(true)) / fit.errors).max() < 4.5


@pytest.mark.thorough
def test_grey_and_ties_hold_over_all_bands():
    true = scene(5)
    fit = ds.fit(true, view(true), free=("k_d", "k_s"), constraints=ds.Grey("k_s"))
    assert fit.names == (*(f"k_d.{w}nm" for w in WAVELENGTHS[:5]), "k_s")


def test_photographs_of_other_channels_are_refused():
    of_three = view(scene(3))
    refuses(lambda: ds.fit(scene(5), of_three, free="k_d"), "views[0].image", "3 channels", "5 bands", "400nm", "440nm")
    refuses(lambda: ds.fit(scene(3), view(scene(5)), free="k_d"), "views[0].image", "5 channels", "bands=5")
    with_gain = ds.View(view(scene(5)).image, CAMERA, sensor=ds.Sensor(red=1.5))
    refuses(lambda: ds.fit(scene(5), with_gain, free="k_d"), "views[0].sensor", "red", "5 bands", "intensities")
    refuses(lambda: ds.fit(scene(5), view(scene(5)), free="k_d", bounds={"k_d.470nm": (0, 1)}), "k_d.470nm")
