"""Exposures of texels: what photographs say of their own brightness and colour, and what is done with it."""

import numpy as np
import pytest
from bumpy import bumpy
from plates import COLOURS, coloured_plate

import diffshade as ds
from diffshade.core.backend import in_float64
from diffshade.texels.lighting import Exposures, LightErrors
from diffshade.texels.lights.exposures import _errors_with, _named, _of_directions, undone
from diffshade.texels.lights.placing import LightEstimates, PlacedLights

FACTOR = np.array([[1.0, 1.0, 1.0], [2.0, 1.0, 0.5], [0.5, 0.5, 0.5], [1.0, 1.0, 1.0]])


def lamps(count):
    along = np.linspace(-0.6, 0.6, count)
    lights = [ds.DirectionalLight((x, 0.2, -1.0), intensity=0.5) for x in along]
    of = bumpy("matte", count, 40.0)
    return ds.Scene(of.scene.objects[0], lights), of.views


def test_a_photograph_that_shows_more_has_a_brighter_light():
    scene, _ = lamps(4)
    with in_float64():
        said = PlacedLights.of(scene, np.arange(4))
        matched = undone(Exposures(FACTOR, np.zeros(4), said.directions), said)
    intensity = np.array(
        [np.asarray(light.intensity) for light in matched.lights if isinstance(light, ds.DirectionalLight)]
    )
    np.testing.assert_allclose(intensity, 0.5 * FACTOR, rtol=1e-6)
    np.testing.assert_allclose(PlacedLights.of(matched, np.arange(4)).directions, said.directions, atol=1e-6)


def test_a_lamp_keeps_its_distance():
    scene, _ = lamps(1)
    near = ds.Scene(scene.objects[0], [ds.PointLight((0.0, 0.0, 3.0))])
    placed = PlacedLights.of(near, np.arange(1))._replace(middle=np.zeros(3))
    moved = placed.moved(LightEstimates(np.array([[0.6, 0.0, 0.8]]), np.ones(1)))
    (light,) = moved.lights
    assert isinstance(light, ds.PointLight)
    np.testing.assert_allclose(light.position, (1.8, 0.0, 2.4), atol=1e-6)


def test_what_differs_most_is_named_first():
    assert _named(FACTOR).startswith("views[1] red 2.00 green 1.00 blue 0.50 times, views[2] 0.50 times")
    assert _named(FACTOR).endswith("and 1 more")
    assert _named(FACTOR[:, :1]).startswith("views[1] 2.00 times")


def test_a_covariance_of_directions_has_two_axes():
    l = np.array([[0.0, 0.6, 0.8]])
    found = Exposures(np.ones((1, 3)), np.zeros(1), l)
    across = np.eye(3) - l[0][:, None] * l[0]
    for root in (0.02 * across, 0.02 * np.eye(3)):
        error = _of_directions(found, LightErrors(root[None], np.zeros(1)))
        np.testing.assert_allclose(error, 0.02, rtol=1e-9)


def test_exposures_err_alike_under_lights_that_are_near_each_other():
    """In any way that is linear in the light's direction, and that k_d does not take back: all ways as likely."""
    l = np.random.default_rng(0).standard_normal((9, 3))
    l /= np.linalg.norm(l, axis=-1, keepdims=True)
    error = np.full(9, 0.03)
    alike = _errors_with(Exposures(np.ones((9, 3)), error, l), LightErrors.within(np.zeros(9))).alike
    assert alike is not None
    np.testing.assert_allclose(alike.mean(1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.mean(np.square(alike).sum(0)), 0.03**2, rtol=1e-9)
    np.testing.assert_allclose(alike @ alike.T, 3.0 * 0.03**2 * np.eye(3), atol=1e-12)
    linear = (l - l.mean(0)) @ (0.2, -0.5, 1.0)
    np.testing.assert_allclose(np.linalg.lstsq(alike.T, linear, rcond=None)[1], 0.0, atol=1e-12)
    turn = np.linspace(0.0, 6.0, 9)
    ring = np.stack([0.6 * np.cos(turn), 0.6 * np.sin(turn), np.full(9, 0.8) + 1e-9 * l[:, 0]], -1)
    alike = _errors_with(Exposures(np.ones((9, 3)), error, ring), LightErrors.within(np.zeros(9))).alike
    assert alike is not None
    assert (np.abs(alike).max(1) > 0.0).sum() == 2  # what rounding tells apart is no way


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("material", "grey", "factor"),
    [
        ("two", False, 4.0),
        ("clay", False, 1.6),
        *(pytest.param("two", *of, marks=pytest.mark.slow) for of in ((True, 0.25), (False, 0.25), (True, 4.0))),
    ],
)
def test_one_photograph_that_is_far_off_leaves_the_others_as_they_are(material, factor, grey):
    of = bumpy(material, 12, 60.0)
    images = [np.asarray(view.image) * (factor if i == 5 else 1.0) for i, view in enumerate(of.views)]
    images = [image.mean(-1, keepdims=True) if grey else image for image in images]
    views = [ds.View(image, v.camera, v.mask, lit=v.lit) for image, v in zip(images, of.views, strict=True)]
    found = ds.fit_texels(of.scene, views, free=("k_d", "k_s", "n_s", "normal")).exposures
    assert found is not None
    assert found.factor[5] == pytest.approx(factor, rel=0.05)
    np.testing.assert_allclose(np.delete(found.factor, 5, 0), 1.0, atol=0.05)


@pytest.mark.thorough
def test_few_photographs_say_that_their_exposures_differ_and_a_dark_one_says_nothing():
    of = bumpy("glossy", 8, 60.0)
    free = ("k_d", "k_s", "n_s", "normal")

    def fitted(factor):
        images = [np.asarray(view.image) * (factor if i == 5 else 1.0) for i, view in enumerate(of.views)]
        views = [ds.View(image, v.camera, v.mask, lit=v.lit) for image, v in zip(images, of.views, strict=True)]
        maps = ds.fit_texels(of.scene, views, free=free)
        return maps.exposures, [note for note in maps.notes if "exposures say" in note]

    exposures, notes = fitted(1.6)
    assert exposures is None
    assert "views[5] 1." in notes[0]
    assert fitted(0.0) == (None, [])


@pytest.mark.thorough
def test_white_highlights_that_cover_a_coloured_plate_are_no_colour_of_a_photograph():
    of = coloured_plate(12)
    maps = ds.fit_texels(of.scene, of.views, free=("k_d", "k_s", "n_s", "normal"))
    assert maps.exposures is None
    row, column = np.mgrid[: of.mask.shape[0], : of.mask.shape[1]]
    k_d = COLOURS[(row // 15 + column // 15) % 2]
    assert np.median(np.abs(maps.values["k_d"] / k_d - 1.0)[maps.determined]) < 0.02
    # what the shape of the highlight takes from k_d is in its errors: without it half of the texels were within them
    assert (np.abs(maps.values["k_d"] - k_d) <= maps.errors_95["k_d"])[maps.determined].mean() > 0.9
