"""Fits of glass of any index, of depth cueing on several objects, and of an area light."""

from typing import Any

import equinox as eqx
import numpy as np
import pytest

import diffshade as ds

CAMERA = ds.Camera((0, 0.2, 5), fov=34, shape=(28, 28))


def photograph(scene: ds.Scene, camera: ds.Camera = CAMERA, sigma: float = 0.0) -> np.ndarray:
    image = np.asarray(ds.render(scene, camera), np.float64)
    return image + sigma * np.random.default_rng(0).standard_normal(image.shape)


# --- a glass ball before a chequer, and what it shows of it


def glass(eta: float, k_t: float) -> ds.Scene:
    ball = ds.Material(k_a=0.05, k_d=0.1, k_s=0.4, n_s=60, k_t=k_t, eta=eta)
    wall = ds.Material(k_a=ds.Chequer((0.9, 0.8, 0.2), (0.1, 0.2, 0.5), period=1.5, smooth=True))
    return ds.Scene(
        [ds.Object(ds.Sphere(), ball, "ball"), ds.Object(ds.Plane((0, 0, -3), (0, 0, 1)), wall, "wall")],
        ds.PointLight((2, 3, 4)),
    )


INDICES = 1.02, 1.05, 1.15, 1.25, 1.33, 1.45, 1.5, 1.62, 1.75, 1.9, 1.95, 2.15, 2.2, 2.35, 2.42, 2.5


@pytest.mark.slow
@pytest.mark.parametrize("eta", INDICES)
def test_transmission_and_index_of_a_glass_ball_from_what_it_shows(eta):
    fit = ds.fit(glass(1.7, 0.3), ds.View(photograph(glass(eta, 0.85), sigma=0.005), CAMERA), free=("k_t", "eta"))
    assert fit.names == ("k_t.r", "k_t.g", "k_t.b", "eta")
    assert fit.converged
    assert np.abs((fit.values - [0.85, 0.85, 0.85, eta]) / fit.plain_errors).max() < 4.5
    assert fit.plain_errors[3] < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("number", range(12))
def test_any_glass_before_a_chequer_at_least_as_wide_as_the_ball(number):
    random = np.random.default_rng(number)
    camera = ds.Camera((0, 0, 6), fov=30, shape=(40, 40))
    period, eta, k_t = random.uniform(1.0, 4.0), random.uniform(1.02, 2.5), random.uniform(0.2, 0.98, 3)

    def scene(eta: Any, k_t: Any) -> ds.Scene:
        wall = ds.Material(k_a=ds.Chequer(0.1, 0.9, period, smooth=True))
        ball = ds.Object(ds.Sphere(), ds.Material(k_s=0.3, n_s=50, k_t=k_t, eta=eta))
        return ds.Scene([ball, ds.Object(ds.Plane((0, 0, -3), (0, 0, 1)), wall)], ds.PointLight((2, 3, 4)))

    view = ds.View(photograph(scene(eta, k_t), camera, sigma=0.005), camera)
    fit = ds.fit(scene(1.0, 0.5), view, free=("k_t", "eta"))
    np.testing.assert_allclose(fit.values, [*k_t, eta], atol=0.01)


def test_a_model_that_cannot_be_right_is_said_where_the_noise_is_known():
    truth = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_a=0.2)), ds.PointLight((2, 3, 4)))
    wrong = eqx.tree_at(lambda s: s.ambient, truth, np.full(3, 0.9))
    view = ds.View(photograph(truth, sigma=0.005), CAMERA, noise=0.005)
    fits = [ds.fit(scene, view, free="k_d") for scene in (truth, wrong)]
    assert [any(note.kind == "beyond noise" for note in fit.notes) for fit in fits] == [False, True]


def test_an_objects_own_name_stands_in_the_names_of_its_parameters():
    ball, wall = (
        ds.Material(k_a=0.05, k_d=0.1, k_s=0.4, n_s=60),
        ds.Material(k_a=ds.Chequer(0.9, 0.1, 1.5, smooth=True)),
    )
    objects = ds.Object(ds.Sphere(), ball, "ball"), ds.Object(ds.Plane((0, 0, -3), (0, 0, 1)), wall, "wall")
    truth = ds.Scene(objects, ds.PointLight((2, 3, 4)))
    fit = ds.fit(truth, ds.View(photograph(truth), CAMERA), free="ball.material.k_d")
    assert fit.names == tuple(f"ball.material.k_d.{channel}" for channel in "rgb")
    np.testing.assert_allclose(fit.values, fit.values_in(truth), rtol=1e-6)


# --- depth cueing on a row of spheres


def row(depths: Any, **cueing: Any) -> ds.Scene:
    """Spheres side by side, the nearest at the left."""
    spheres = [ds.Sphere((x, 0, -z), 0.45) for x, z in zip(np.linspace(-1.5, 1.5, len(depths)), depths, strict=True)]
    material = ds.Material(k_a=0.1, k_d=(0.7, 0.5, 0.3), k_s=0.3, n_s=20)
    lights = ds.DirectionalLight((-1, -1, -2))
    fog = ds.DepthCueing(**cueing, I_dc=(0.5, 0.6, 0.7))
    return ds.Scene([ds.Object(s, material) for s in spheres], lights, atmosphere=fog)


SIDE = ds.Camera((0, 0, 6), fov=14, shape=(24, 96))
CUEING = {"z_f": 6.0, "z_b": 8.5, "s_f": 0.95, "s_b": 0.2}


def told(scene: ds.Scene) -> ds.Scene:
    where = lambda s: [getattr(s.atmosphere, name) for name in CUEING]  # noqa: E731
    return eqx.tree_at(where, scene, [np.asarray(v) for v in (5.5, 9.5, 0.8, 0.4)])


def test_depth_cueing_from_a_row_of_spheres_that_reaches_beyond_both_ends():
    truth = row((-0.5, 0.5, 1.5, 2.5, 3.5), **CUEING)
    fit = ds.fit(told(truth), ds.View(photograph(truth, SIDE, 0.002), SIDE), free=tuple(CUEING))
    assert fit.determined.all()
    assert np.abs((fit.values - fit.values_in(truth)) / fit.plain_errors).max() < 4.5
    assert (fit.plain_errors < 0.05).all()


# --- an area light


def test_the_intensity_of_an_area_light():
    light = ds.AreaLight((-1, 2, 3), (2, 0, 0), (0, -1, -1), (3.0, 2.0, 1.0), samples=(3, 2))
    truth = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, (0.6, 0.4, 0.3), 0.3, 20)), light)
    dim = eqx.tree_at(lambda s: s.lights[0].intensity, truth, np.ones(3))
    fit = ds.fit(dim, ds.View(photograph(truth), CAMERA), free="intensity")
    np.testing.assert_allclose(fit.values, (3.0, 2.0, 1.0), rtol=1e-9)
