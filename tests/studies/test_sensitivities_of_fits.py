"""Derivatives of more fits by what was taken as known and by the photographs, beside finite differences of fits."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from synthetic import CAMERA, forget, noisy, photographs, point_lights, seen_by, standard_scene

import diffshade as ds

pytestmark = pytest.mark.slow

FREE = ("k_a", "k_d", "k_s", "n_s")
SCENE = standard_scene(lights=point_lights()[:3])
SIGMA, LEVEL, STEP = 0.02, 0.75, 1e-3
IMAGES = noisy(photographs(SCENE), SIGMA, 0)
INSIDE = np.asarray(seen_by(CAMERA).mask)


def views(images: Sequence[np.ndarray], exposure: float = 1.0) -> list[ds.View]:
    """Return the views, clipped and of known noise; the first with an exposure."""
    return [
        ds.View(image, CAMERA, lit=(i,), noise=SIGMA, saturation=LEVEL, exposure=exposure if i == 0 else 1.0)
        for i, image in enumerate(images)
    ]


class Base:
    """A fit, and fits again of what is a little different."""

    def __init__(self, **options: Any):
        self.options = options
        self.fit = ds.fit(forget(SCENE), views(IMAGES), free=FREE, **options)
        assert self.fit.converged

    def again(self, scene: ds.Scene | None = None, images: Sequence[np.ndarray] = IMAGES, exposure: float = 1.0):
        scene = self.fit.scene if scene is None else scene
        return ds.fit(scene, views(images, exposure), free=FREE, start="scene", **self.options).values

    def moved(self, where: Any, channel: int, by: float) -> np.ndarray:
        """Return the values of a fit whose scene has one number moved."""
        return self.again(
            eqx.tree_at(where, self.fit.scene, np.asarray(where(self.fit.scene)) + by * np.eye(3)[channel])
        )

    def agrees(self, derivative: np.ndarray, fitted: Any) -> None:
        """Compare a derivative with central differences of `fitted`, the values as a function of the step."""
        difference = (fitted(STEP) - fitted(-STEP)) / (2.0 * STEP)
        unit = self.fit.plain_errors
        size = np.abs(difference / unit).max()
        assert size > 1.0  # it moves by more than its error for a change of 1
        np.testing.assert_allclose(derivative / unit, difference / unit, rtol=0, atol=1e-3 * size)


def by_lights_and_exposure(base: Base) -> None:
    by_intensity = ds.sensitivity(base.fit, "lights.0.intensity")
    by_position = ds.sensitivity(base.fit, "lights.1.position")
    by_exposure = ds.sensitivity(base.fit, "views.0.exposure")
    assert [d.shape for d in (by_intensity, by_position, by_exposure)] == [(10, 3), (10, 3), (10, 1)]
    base.agrees(by_intensity[:, 1], lambda h: base.moved(lambda s: s.lights[0].intensity, 1, h))
    base.agrees(by_position[:, 0], lambda h: base.moved(lambda s: s.lights[1].position, 0, h))
    base.agrees(by_exposure[:, 0], lambda h: base.again(exposure=1.0 + h))


def by_a_position(base: Base) -> None:
    base.agrees(
        ds.sensitivity(base.fit, "lights.0.position")[:, 2], lambda h: base.moved(lambda s: s.lights[0].position, 2, h)
    )


def by_the_image(base: Base) -> None:
    image = IMAGES[0]
    by_image = ds.image_sensitivity(base.fit, 0)
    assert by_image.shape == (10, *image.shape)
    assert (by_image[:, ~INSIDE] == 0).all()
    clipped = image >= LEVEL
    assert clipped.any()
    assert (by_image[:, clipped] == 0).all()
    assert (np.abs(by_image).sum(0) > 0)[INSIDE & ~clipped.any(-1)].all()
    far = image < LEVEL - 0.02  # the step clips no other sample
    some = np.random.default_rng(0).random(image.shape) < 0.05
    for change in (np.where(far, image, 0.0), 1.0 * (some & far & INSIDE[..., None])):
        base.agrees(
            (by_image * change).sum((1, 2, 3)),
            lambda h, change=change: base.again(images=[image + h * change, *IMAGES[1:]]),
        )


@pytest.mark.parametrize(
    ("options", "checks"),
    [
        ({}, (by_lights_and_exposure, by_the_image)),
        ({"loss": "cauchy", "priors": {"n_s": (40.0, 0.05)}}, (by_a_position, by_the_image)),
        ({"clipped": "tobit"}, (by_a_position,)),
    ],
    ids=["squares", "cauchy, with a prior", "tobit"],
)
def test_sensitivities_with_clipped_samples_are_the_finite_differences_of_whole_fits(options, checks):
    base = Base(**options)
    assert base.fit.counts.clipped >= 3
    for check in checks:
        check(base)


def test_a_value_at_a_bound_does_not_move_and_the_others_move_as_they_do_beside_it():
    base = Base(bounds={"k_s": (0.6, 0.9)})
    held = base.fit.at_bound
    assert [name for name, at in zip(base.fit.names, held, strict=True) if at] == ["k_s.r", "k_s.g", "k_s.b"]
    moves = ds.sensitivity(base.fit, "lights.0.intensity")
    assert (moves[held] == 0).all()
    assert (moves[~held] != 0).any(-1).all()
    base.agrees(moves[:, 1], lambda h: base.moved(lambda s: s.lights[0].intensity, 1, h))
    by_image = ds.image_sensitivity(base.fit, 0)
    assert (by_image[held] == 0).all()
    assert (by_image[~held] != 0).any((1, 2, 3)).all()


def test_an_exponent_that_was_known_is_differentiated_in_its_own_unit():
    free = ("k_d", "k_s")
    fit = ds.fit(SCENE, views(IMAGES), free=free)
    by_exponent = ds.sensitivity(fit, "n_s")[:, 0]

    def moved(h: float) -> np.ndarray:
        scene = eqx.tree_at(lambda s: s.objects[0].material.n_s, fit.scene, np.asarray(50.0 + h))
        return ds.fit(scene, views(IMAGES), free=free, start="scene").values

    difference = (moved(0.05) - moved(-0.05)) / 0.1
    np.testing.assert_allclose(by_exponent, difference, rtol=0, atol=1e-3 * np.abs(difference).max())


def test_an_exponent_of_0_that_was_known_has_a_derivative():
    scene = eqx.tree_at(lambda s: s.objects[0].material.n_s, SCENE, np.asarray(0.0))
    fit = ds.fit(scene, views(IMAGES), free=("k_a", "k_d"))
    assert np.isfinite(ds.sensitivity(fit, "n_s")).all()


def test_a_known_direction_of_any_length_is_differentiated_as_it_is():
    clean = standard_scene(
        lights=[ds.DirectionalLight((-1.0, -0.8, -2.0)), ds.DirectionalLight((3.0, -2.0, -5.0), 0.4)]
    )
    images = noisy(photographs(clean), SIGMA, 1)

    def fit(scene: ds.Scene, start: str) -> ds.Fit:
        shown = [ds.View(image, CAMERA, lit=i) for i, image in enumerate(images)]
        if start == "scene":
            return ds.fit(scene, shown, free=FREE, start="scene")
        return ds.fit(scene, shown, free=FREE)

    base = fit(forget(clean), "search")
    by_direction = ds.sensitivity(base, "lights.1.direction")
    where = lambda s: s.lights[1].direction  # noqa: E731
    for axis in range(3):
        step = STEP * np.eye(3)[axis]
        ends = [fit(eqx.tree_at(where, base.scene, where(base.scene) + s * step), "scene").values for s in (1, -1)]
        difference = (ends[0] - ends[1]) / (2.0 * STEP)
        assert np.abs(difference / base.plain_errors).max() > 1.0
        np.testing.assert_allclose(by_direction[:, axis], difference, rtol=0, atol=1e-3 * np.abs(difference).max())


def test_a_known_colour_that_another_follows_moves_that_too():
    free, constraints = ("k_s", "n_s"), ds.Proportional("k_s", "k_d")
    base = ds.fit(SCENE, views(IMAGES), free=free, constraints=constraints)
    by_colour = ds.sensitivity(base, "k_d")
    where = lambda s: s.objects[0].material.k_d  # noqa: E731
    for channel in range(3):
        step = STEP * np.eye(3)[channel]
        scenes = [eqx.tree_at(where, base.scene, where(base.scene) + s * step) for s in (1, -1)]
        ends = [ds.fit(s, views(IMAGES), free=free, constraints=constraints, start="scene").values for s in scenes]
        difference = (ends[0] - ends[1]) / (2.0 * STEP)
        np.testing.assert_allclose(by_colour[:, channel], difference, rtol=0, atol=1e-3 * np.abs(difference).max())
