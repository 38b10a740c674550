"""Fits of what came after the material: an index of refraction and depth cueing; what cannot be found is said."""

from typing import Any

import numpy as np
import pytest
from scenarios import same_but

import diffshade as ds
from diffshade.inverse.summary import _jumps
from diffshade.inverse.unknowns.parameters import find_unknowns

CAMERA = ds.Camera((0, 0.2, 5), fov=34, shape=(24, 24))


def photograph(scene: ds.Scene, sigma: float) -> np.ndarray:
    image = np.asarray(ds.render(scene, CAMERA), np.float64)
    return image + sigma * np.random.default_rng(0).standard_normal(image.shape)


# --- an index of refraction, which is searched for over all of its range


def ball(eta: float, n_s: float) -> ds.Scene:
    material = ds.Material(k_a=0.05, k_d=0.3, n_s=n_s, fresnel=ds.Dielectric(), eta=eta)
    return ds.Scene(ds.Object(ds.Sphere(), material), ds.PointLight((2, 3, 4), 3.0))


@pytest.mark.thorough
def test_the_index_of_an_opaque_ball_from_its_highlight():
    truth = ball(1.5, 12.0)
    told = same_but(ball(2.2, 60.0), lambda s: [s.objects[0].material.k_d], [(0.9, 0.9, 0.9)])
    fit = ds.fit(told, ds.View(photograph(truth, 0.002), CAMERA, noise=0.002), free=("k_d", "n_s", "eta"))
    assert fit.converged
    assert np.abs((fit.values - fit.values_in(truth)) / fit.plain_errors).max() < 4.5
    assert fit.plain_errors[fit.names.index("eta")] < 0.02
    assert all(note.startswith("1 view") for note in fit.notes)


# --- what has no derivative, and what is not there


def before_a_chequer(*, smooth: bool) -> ds.Scene:
    wall = ds.Material(k_a=ds.Chequer((0.9, 0.8, 0.2), (0.1, 0.2, 0.5), period=1.5, smooth=smooth))
    ball = ds.Object(ds.Sphere(), ds.Material(k_a=0.05, k_t=0.85, eta=1.5), "ball")
    return ds.Scene([ball, ds.Object(ds.Plane((0, 0, -3), (0, 0, 1)), wall, "wall")])


def test_hard_squares_have_no_derivative_where_an_unknown_moves_them_and_that_is_said():
    views = [ds.View(np.zeros((24, 24, 3)), CAMERA)]

    def said(scene: ds.Scene, *free: str) -> list[str]:
        return [*_jumps(scene, find_unknowns(scene, views, free))]

    hard, smooth = (before_a_chequer(smooth=smooth) for smooth in (False, True))
    for free in ("eta", "period", "radius"):
        (note,) = said(hard, free, "k_t")
        assert "Chequer" in note
        assert free in note
        assert "smooth=True" in note
        assert said(smooth, free) == []
    assert said(hard, "k_t", "ambient") == []


def test_what_a_scene_does_not_have_is_said_with_its_remedy():
    opaque = ds.Scene(ds.Object(ds.Sphere()), ds.PointLight((2, 3, 4)))
    view = ds.View(np.full((24, 24, 3), 0.1), CAMERA)
    for name in ("k_t", "eta"):
        with pytest.raises(ValueError, match=rf"^free names '{name}'.*Give it"):
            ds.fit(opaque, view, free=name)


# --- depth cueing on a floor that leads away


def floor(**cueing: Any) -> ds.Scene:
    """Return a plane that the camera sees from 4.2 to 7.4 away."""
    plane = ds.Plane((0, -0.4, 0), (0, 1, 1))
    material = ds.Material(k_a=0.1, k_d=(0.7, 0.5, 0.3), k_s=0.0, n_s=20)
    fog = ds.DepthCueing(**cueing, I_dc=(0.5, 0.6, 0.7))
    return ds.Scene(ds.Object(plane, material), ds.DirectionalLight((-1, -1, -2)), atmosphere=fog)


CUEING = ("z_f", "z_b", "s_f", "s_b")


def fit_of_fog(truth: ds.Scene, told: ds.Scene | None, **options: Any) -> ds.Fit:
    where = lambda s: [getattr(s.atmosphere, name) for name in CUEING]  # noqa: E731
    told = same_but(truth, where, (4.5, 7.0, 0.8, 0.4)) if told is None else told
    return ds.fit(told, ds.View(photograph(truth, 0.002), CAMERA), free=CUEING, **options)


@pytest.mark.thorough
def test_depth_cueing_from_a_floor_that_reaches_beyond_both_ends():
    truth = floor(z_f=4.9, z_b=6.5, s_f=0.95, s_b=0.2)
    fit = fit_of_fog(truth, None)
    assert fit.determined.all()
    assert np.abs((fit.values - fit.values_in(truth)) / fit.plain_errors).max() < 4.5
    assert (fit.plain_errors < 0.05).all()


@pytest.mark.thorough
def test_with_all_of_it_between_the_ends_only_slope_and_intercept_are_determined():
    truth = floor(z_f=3.0, z_b=10.0, s_f=0.95, s_b=0.2)
    fit = fit_of_fog(truth, truth, start="scene")
    assert not fit.determined.any()
    for pair in ("z_f and s_f", "z_b and s_b"):
        assert any("cannot separate" in note and pair in note for note in fit.notes)
