"""Scenes of other channels than red, green and blue."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refuses

import diffshade as ds

CAMERA = ds.Camera(eye=(0, 0, 4), fov=40, shape=(12, 16))
WAVELENGTHS = np.arange(400, 701, 10)
SPECTRUM = np.random.default_rng(3).uniform(0.1, 0.9, (6, 31))


def ball(bands: int) -> ds.Scene:
    """A ball whose k_d, lamp and n_s differ from band to band, and whose other colours are grey."""
    k_d, lamp = SPECTRUM[0, :bands], SPECTRUM[1, :bands]
    material = ds.Material(k_a=0.1, k_d=k_d if bands > 1 else k_d[0], k_s=0.4, n_s=20)
    light = ds.PointLight((2, 3, 4), lamp if bands > 1 else lamp[0])
    return ds.Scene(ds.Object(ds.Sphere(), material), light, background=0.2, bands=bands)


def of_every_colour(band: slice | np.ndarray, bands: int) -> ds.Scene:
    """A scene of almost everything that has a colour, in some of 31 bands."""
    a, b, c, d, e, f = (of[band] for of in SPECTRUM)
    over_pixels = np.random.default_rng(5).uniform(0.1, 0.9, (*CAMERA.shape, 31))[..., band]
    more = ds.Highlight(e, 5 + 20 * f)
    objects = [
        ds.Object(ds.Plane((0, -1, 0)), ds.Material(a, ds.Chequer(b, c), d, 10 + 20 * d, highlights=more, k_e=e)),
        ds.Object(ds.Sphere((0, 1, 0), 0.5), ds.Material(a, over_pixels, d, n_s=20 * d)),
    ]
    lights = [ds.PointLight((2, 3, 4), a, ambient=b, specular=c), ds.DirectionalLight((0, -1, -1), d)]
    return ds.Scene(objects, lights, ambient=e, background=f, atmosphere=ds.Fog(0.1, I_dc=d), bands=bands)


def of_glass_and_textures(band: slice | np.ndarray, bands: int) -> ds.Scene:
    """A ball of coloured glass before a picture, under a lamp that is an area."""
    a, b, c, d, *_ = (of[band] for of in SPECTRUM)
    image = np.random.default_rng(4).uniform(0.1, 0.9, (3, 5, 31))[..., band]
    objects = [
        ds.Object(ds.Sphere((0, 0, 1), 0.7), ds.Material(a, k_s=b, k_t=c, fresnel=ds.Schlick())),
        ds.Object(ds.Plane((0, 0, 0), (0, 0, 1)), ds.Material(a, ds.Texture(image))),
    ]
    return ds.Scene(objects, ds.AreaLight((0, 2, 2), (1, 0, 0), (0, 0, 1), d, samples=2), bands=bands)


@pytest.mark.thorough
@pytest.mark.parametrize("scene", [of_every_colour, of_glass_and_textures])
def test_each_band_is_what_red_green_and_blue_show_of_it(scene):
    whole = np.asarray(ds.render(scene(slice(None), 31), CAMERA))
    assert whole.shape == (*CAMERA.shape, 31)
    for band in (np.array([0, 1, 2]), np.array([7, 30, 15])):
        np.testing.assert_allclose(whole[..., band], ds.render(scene(band, 3), CAMERA), rtol=0, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("bands", [2, 31])
def test_derivatives_in_each_direction_are_finite_differences(bands):
    scene = jax.tree.map(jnp.asarray, ball(bands))
    rng = np.random.default_rng(6)

    def moved(scene: Any) -> list[Any]:
        m, light = scene.objects[0].material, scene.lights[0]
        return [m.k_a, m.k_d, m.k_s, m.n_s, light.intensity, light.position, scene.ambient, scene.background]

    directions = [jnp.asarray(rng.normal(size=leaf.shape)) for leaf in moved(scene)]
    along = eqx.tree_at(moved, jax.tree.map(jnp.zeros_like, scene), directions)
    weights = rng.normal(size=(*CAMERA.shape, bands))

    def seen(scene: ds.Scene) -> jax.Array:
        return jnp.sum(ds.render(scene, CAMERA) * weights)

    h = 1e-6
    there, back = (seen(jax.tree.map(lambda x, d, h=h: x + h * d, scene, along)) for h in (h, -h))
    forward = float(jax.jvp(seen, (scene,), (along,))[1])
    reverse = jax.tree.map(jnp.vdot, jax.grad(seen)(scene), along)
    assert forward == pytest.approx(float((there - back) / (2 * h)), rel=1e-6)
    assert float(sum(jax.tree.leaves(reverse))) == pytest.approx(forward, rel=1e-10)


def test_bands_are_a_number_wavelengths_or_names():
    assert ball(4).bands == ("band1", "band2", "band3", "band4")
    assert ball(31).channels[0] == "band1"
    scene = ds.Scene(ds.Object(ds.Sphere()), bands=(450, 550.25, 680.0, 850))
    assert scene.channels == ("450nm", "550.25nm", "680nm", "850nm")
    assert ds.Scene(ds.Object(ds.Sphere()), bands=("green", "red", "nir")).channels == ("green", "red", "nir")
    assert ds.Scene(ds.Object(ds.Sphere())).channels == ("r", "g", "b")


def test_one_number_is_grey_in_all_bands():
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=0.5)), ds.PointLight((2, 3, 4)), bands=31)
    assert {np.shape(of) for of in (scene.objects[0].material.k_d, scene.ambient, scene.background)} == {(31,)}
    one = ds.render(ds.Scene(scene.objects, ds.PointLight((2, 3, 4)), bands=31), CAMERA)
    grey = ds.render(ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=0.5)), ds.PointLight((2, 3, 4))), CAMERA)
    np.testing.assert_allclose(one, np.asarray(grey)[..., :1].repeat(31, -1), atol=1e-15)


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (lambda: ds.Scene(ball(31).objects), ("objects.0.material.k_a", "31", "bands=31")),
        (lambda: ds.Scene(ball(5).objects, bands=WAVELENGTHS), ("k_a", "5", "31 bands", "400nm to 700nm", "grey")),
        (lambda: ds.Scene(ball(31).objects, bands=41), ("Scene.bands", "40", "41")),
        (lambda: ds.Scene(ball(2).objects), ("objects.0.material.k_a", "2 numbers", "bands=2")),
        (lambda: ds.Scene(ds.Object(ds.Sphere()), bands=(0, 450, 500)), ("Scene.bands", "above 0 nm", "0")),
        (lambda: ds.Scene(ds.Object(ds.Sphere()), bands=("a", "b", "a")), ("Scene.bands", "different", "'a'")),
        (lambda: ds.Material(k_d=np.ones(41)), ("Material.k_d", "40 bands", "41")),
    ],
)
def test_wrong_bands_are_refused(made, says):
    refuses(made, *says)


def test_bands_that_are_no_bands_are_refused():
    refuses(lambda: ds.Scene(ds.Object(ds.Sphere()), bands="rgb"), "Scene.bands", "'rgb'", error=TypeError)


@pytest.mark.parametrize("bands", [1, 2, 4])
def test_foleys_form_takes_a_spectrum_beside_greys(bands):
    O_d = np.linspace(0.2, 0.8, bands)
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material.foley(O_d=O_d, k_a=0.5, k_d=0.5, k_s=0.3)), bands=bands)
    np.testing.assert_allclose(scene.objects[0].material.k_d, 0.5 * O_d)
    np.testing.assert_allclose(scene.objects[0].material.k_s, [0.3] * bands)
