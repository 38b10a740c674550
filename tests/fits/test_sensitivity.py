"""Derivatives of whole fits by what was taken as known and by the photographs, beside finite differences of fits."""

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from scenarios import noisy_fit
from synthetic import CAMERA, noisy, photographs, seen_by, standard_scene

import diffshade as ds

LEVEL, STEP = 0.6, 2e-3
SCENE = standard_scene(lights=[ds.DirectionalLight((-1.0, -0.8, -2.0)), ds.DirectionalLight((3.0, -2.0, -5.0), 0.8)])
# k_s follows k_d, which is known; k_a ends at its bound; what is above the level is clipped
OPTIONS: Any = {
    "free": ("k_a", "k_s", "n_s"),
    "constraints": ds.Proportional("k_s", "k_d"),
    "bounds": {"k_a": (0.0, 0.05)},
    "start": "scene",
}


@cache
def images() -> tuple[np.ndarray, ...]:
    return tuple(noisy(photographs(SCENE), 0.01, 0))


@cache
def fitted() -> ds.Fit:
    return fit_of(SCENE, images())


def fit_of(scene: ds.Scene, images: Sequence[np.ndarray]) -> ds.Fit:
    views = [ds.View(image, CAMERA, lit=i, saturation=LEVEL) for i, image in enumerate(images)]
    return ds.fit(scene, views, **OPTIONS)


def agrees(derivative: np.ndarray, values: Any) -> None:
    """Compare a derivative with central differences of `values`, a function of the step."""
    difference = (values(STEP) - values(-STEP)) / (2.0 * STEP)
    unit = fitted().plain_errors
    size = np.abs(difference / unit).max()
    assert size > 1.0  # it moves by more than its error for a change of 1
    np.testing.assert_allclose(derivative / unit, difference / unit, rtol=0, atol=1e-3 * size)


@pytest.mark.slow
def test_a_colour_that_was_known_moves_the_values_as_fits_do():
    """And takes the one along that follows it."""
    fit = fitted()
    assert fit.counts.clipped >= 3
    assert fit.at_bound.any()
    derivative = ds.sensitivity(fit, "k_d")
    assert derivative.shape == (len(fit.names), 3)
    assert (derivative[fit.at_bound] == 0).all()
    assert (derivative[~fit.at_bound] != 0).any(-1).all()
    where = lambda s: s.objects[0].material.k_d  # noqa: E731
    for channel, step in enumerate(np.eye(3)):
        moved = lambda h, step=step: eqx.tree_at(where, fit.scene, where(fit.scene) + h * step)  # noqa: E731
        agrees(derivative[:, channel], lambda h, moved=moved: fit_of(moved(h), images()).values)


@pytest.mark.thorough
def test_the_samples_of_a_photograph_move_the_values_as_fits_do():
    fit, image, inside = fitted(), images()[0], np.asarray(seen_by(CAMERA).mask)
    by_image = ds.image_sensitivity(fit, 0)
    assert by_image.shape == (len(fit.names), *image.shape)
    assert (by_image[:, ~inside] == 0).all()
    clipped = image >= LEVEL
    assert clipped[inside].any()
    assert (by_image[:, clipped] == 0).all()
    assert (by_image[fit.at_bound] == 0).all()
    far = image < LEVEL - 0.01  # the step clips no other sample
    some = np.random.default_rng(0).random(image.shape) < 0.05
    for change in (np.where(far, image, 0.0), 1.0 * (some & far & inside[..., None])):
        moved = lambda h, change=change: fit_of(fit.scene, [image + h * change, images()[1]]).values  # noqa: E731
        agrees((by_image * change).sum((1, 2, 3)), moved)


@pytest.mark.slow
def test_a_light_that_is_on_in_no_view_moves_nothing_and_has_its_columns():
    lights = (*SCENE.lights, ds.DirectionalLight((0.0, 0.0, -1.0)))
    fit = fit_of(dataclasses.replace(SCENE, lights=lights), images())
    derivative = ds.sensitivity(fit, "intensity")
    assert derivative.shape == (len(fit.names), 9)
    assert (derivative[:, 6:] == 0).all()
    assert (derivative[:, :6] != 0).any()


# --- what is refused


@pytest.mark.parametrize("name", ["k_d", "n_s", "objects.0.material"])
def test_the_derivative_by_a_free_number_is_refused(name):
    with pytest.raises(ValueError, match="is free in this fit") as refusal:
        ds.sensitivity(noisy_fit(), name)
    message = str(refusal.value)
    assert all(part in message for part in (f"'{name}'", "objects.0.material.", "Name a parameter that was known."))


@pytest.mark.parametrize("view", [-1, 8])
def test_the_derivative_by_a_view_that_is_not_there_is_refused(view):
    with pytest.raises(ValueError, match=f"from 0 to 7; got {view}"):
        ds.image_sensitivity(noisy_fit(), view)


def test_a_fit_that_is_not_determined_has_no_derivative():
    fit = noisy_fit()
    lost = dataclasses.replace(fit.evidence, regular=np.arange(12) != 1)
    fit = dataclasses.replace(fit, clusters=dataclasses.replace(fit.clusters, evidence=lost))
    for derivative in (lambda: ds.sensitivity(fit, "lights.0.intensity"), lambda: ds.image_sensitivity(fit, 0)):
        with pytest.raises(ValueError, match=r"k_a\.g is not determined") as refusal:
            derivative()
        assert "Fix k_a.g and fit again." in str(refusal.value)
    for derivative in (lambda: ds.sensitivity("x", "k_d"), lambda: ds.image_sensitivity("x", 0)):  # pyright: ignore
        with pytest.raises(TypeError, match="fit"):
            derivative()
