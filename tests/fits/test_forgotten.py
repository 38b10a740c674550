"""What a user forgets to tell a fit of two photographs is named, whether or not a number stays determined."""

import dataclasses
from functools import cache

import numpy as np
import pytest

import diffshade as ds

CAMERA = ds.Camera((0, 0, 4), fov=35, shape=(48, 48))
LAMPS = tuple(
    ds.PointLight(place, 20.0, ds.RadialAttenuation(constant=0.0, quadratic=1.0)) for place in ((2, 3, 4), (-3, 1, 3))
)


def ball(**material):
    return ds.Scene(ds.Object(ds.Sphere(), ds.Material(**material)), LAMPS)


@cache
def photographs():
    true, random = ball(k_d=(0.6, 0.3, 0.2), k_s=0.4, n_s=40), np.random.default_rng(0)
    pictures = [np.asarray(ds.render(true, CAMERA, lit=i), np.float64) for i in (0, 1)]
    return [one + 0.005 * random.standard_normal(one.shape) for one in pictures]


def said(scene, views, free=("k_d", "k_s", "n_s")):
    """What the fit names as its cause."""
    fit = ds.fit(scene, views, free=free)
    (note,) = [note for note in fit.notes if note.kind == "cause"]
    return fit, note


def seen():
    return [ds.View(image, CAMERA, lit=i) for i, image in enumerate(photographs())]


def test_which_light_is_on():
    fit, note = said(ball(), [ds.View(image, CAMERA) for image in photographs()])
    assert "views[0] and views[1] have one camera and the same 2 lights, and show different pictures" in note
    assert "lit=" in note
    assert not fit.determined.any()


def test_one_set_up_of_several_photographs_is_no_mistake():
    random = np.random.default_rng(1)
    twice = [photographs()[0] * f + 0.005 * random.standard_normal((48, 48, 3)) for f in (1.0, 1.2)]
    scene = dataclasses.replace(ball(), lights=(LAMPS[0], dataclasses.replace(LAMPS[1], intensity=0.01)))
    _, note = said(scene, [ds.View(image, CAMERA, lit=(0, 1)) for image in twice])
    assert note.names[0] == "exposure"


@pytest.mark.thorough
def test_that_there_is_a_highlight():
    fit, note = said(ball(k_s=0.0), seen(), free=("k_d",))
    assert "there is a highlight, with n_s near 64, that the scene does not have" in note
    assert "Free 'k_s' and 'n_s'" in note
    np.testing.assert_array_less(np.abs(fit.values - (0.6, 0.3, 0.2)), 3.0 * fit.errors)


@pytest.mark.thorough
def test_that_the_exponent_is_free():
    _, note = said(ball(n_s=10.0), seen(), free=("k_d", "k_s"))
    assert "a second, sharper part, with n_s near 40" in note
    assert "Free 'n_s', which is known in this fit." in note


@pytest.mark.thorough
def test_how_bright_a_lamp_is_though_nothing_stays_determined():
    scene = ball()
    brighter = dataclasses.replace(scene, lights=(LAMPS[0], dataclasses.replace(LAMPS[1], intensity=26.0)))
    fit, note = said(brighter, seen())
    assert not fit.determined.any()
    assert "views[0] is 1.28 times as bright as views[1] predicts" in note
    assert fit.notes[0] is note


def test_that_the_lamp_was_off():
    """Photographs that show nothing but their black level: what a fault may change of them is what is predicted."""
    view = ds.View(np.full((48, 48, 3), 0.5), CAMERA, lit=0, black=0.5, noise=0.01)
    fit, _ = said(ball(k_a=0.1), [view], free=("k_d",))
    np.testing.assert_allclose(fit.values, 0.0, atol=1e-6)
    assert np.isfinite(fit.errors).all()


def test_that_highlights_differ_by_colour():
    scene, random = ball(k_a=0.05, k_d=(0.5, 0.4, 0.3), k_s=0.3, n_s=(20.0, 25.0, 32.0)), np.random.default_rng(3)
    pictures = [np.asarray(ds.render(scene, CAMERA, lit=i), np.float64) for i in (0, 1)]
    views = [ds.View(one + 0.004 * random.standard_normal(one.shape), CAMERA, lit=i) for i, one in enumerate(pictures)]
    fit, note = said(ball(), views, free=("k_a", "k_d", "k_s", "n_s"))
    assert note.names == ("highlight by colour",)
    assert "Give the material n_s=(" in note
    off = np.abs(fit.values - fit.values_in(ball(k_a=0.05, k_d=(0.5, 0.4, 0.3), k_s=0.3, n_s=25.0)))
    np.testing.assert_array_less(off[fit.determined], 2.5 * fit.errors[fit.determined])
