"""Other scenes: what a longer ball, other lamps and the colours of JPEG files change, beside pictures that have it."""

from __future__ import annotations

import io
from functools import cache
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
from PIL import Image
from refusals import untyped
from slightly_wrong import EYE, FOV, SIDE, ball

import diffshade as ds
from diffshade.inverse.misfit.linearised import _duller
from diffshade.inverse.misfit.other_scenes import _stretched, falling, farther, of_ellipsoid, stretch, with_lamps

OF: dict[str, Any] = {"k_a": np.array([0.05, 0.04, 0.03]), "k_d": np.array([0.5, 0.3, 0.2]), "k_s": 0.3, "n_s": 20.0}
TO_LIGHT = np.array([0.4, 0.3, 0.8])
VIEW = ds.View(np.zeros((SIDE, SIDE, 3)), ds.Camera(eye=tuple(EYE), fov=FOV, shape=(SIDE, SIDE)))


def scene(*lights: Any) -> ds.Scene:
    return ds.Scene(ds.Object(ds.Sphere(), ds.Material(**OF)), lights or ds.DirectionalLight(-TO_LIGHT))


@cache
def pictures() -> list[np.ndarray]:
    with jax.enable_x64(True):
        return [np.asarray(ds.render(s, VIEW.camera)) for s in _stretched(scene(), VIEW)]


def test_a_ball_that_is_not_stretched_is_drawn_as_it_is():
    np.testing.assert_allclose(pictures()[0], ball(OF, TO_LIGHT), atol=1e-9)


@pytest.mark.parametrize(("which", "axes"), [(3, (1.01, 0.99, 1.0)), (4, (1 - 0.00577, 1 - 0.00577, 1.01155))])
def test_a_longer_ball_is_that_of_an_ellipsoid(which, axes):
    """But for the outermost pixels, which the ellipsoid covers or leaves."""
    longer = pictures()[1 + which] - pictures()[0]
    true = ball(OF, TO_LIGHT, axes=axes) - ball(OF, TO_LIGHT)
    row, column = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    inner = np.hypot(row, column) < 0.35 * SIDE
    np.testing.assert_allclose(longer[inner], true[inner], atol=0.06 * np.abs(true[inner]).max())


def test_stretches_keep_the_volume_and_are_of_one_size():
    for amount in np.eye(5):
        S = stretch(amount)
        assert np.trace(S) == pytest.approx(0.0, abs=1e-15)
        np.testing.assert_array_equal(S, S.T)
        assert np.sum(S**2) == pytest.approx(2.0)


def lights_of(fit: Any, change: Any) -> Any:
    return with_lamps(fit, change).lights


@untyped
def test_other_lamps_are_as_strong_at_the_object():
    lamp = ds.PointLight((0.0, 3.0, 4.0), 14.0, ds.RadialAttenuation(1.0, 0.1, 0.02))
    sun, arriving = ds.DirectionalLight((0, 0, -1)), 14.0 * float(lamp.attenuation(5.0))
    fit: Any = SimpleNamespace(scene=scene(lamp, sun), views=[VIEW])
    for change, d in (
        (lambda *of: falling(0, *of), 5.0),
        (lambda *of: falling(2, *of), 5.0),
        (lambda *of: farther(1.1, *of), 5.5),
    ):
        changed, kept = lights_of(fit, change)
        assert kept is sun
        assert float(np.linalg.norm(changed.position)) == pytest.approx(d)
        assert np.asarray(changed.intensity)[0] * float(changed.attenuation(d)) == pytest.approx(arriving, rel=1e-6)
    even, square = (lights_of(fit, lambda *of, power=power: falling(power, *of))[0] for power in (0, 2))
    assert float(even.attenuation(2.5)) == pytest.approx(float(even.attenuation(5.0)))
    assert float(square.attenuation(2.5)) == pytest.approx(4.0 * float(square.attenuation(5.0)))


def test_duller_colours_are_those_of_a_jpeg_file_with_colours_of_half_the_size():
    picture = np.clip(ball(OF, TO_LIGHT), 0.0, 1.0)
    stored = Image.fromarray(np.round(255 * ds.srgb_encode(picture)).astype(np.uint8))
    stored.save(file := io.BytesIO(), "jpeg", quality=100, subsampling="4:2:0")
    true = np.asarray(ds.srgb_decode(np.asarray(Image.open(file)) / 255.0)) - picture
    red, blue, *_ = _duller(picture)
    both = red + blue
    assert np.sum(both * true) / np.sum(both**2) == pytest.approx(1.0, abs=0.1)
    assert np.sum(both * true) / np.sqrt(np.sum(both**2) * np.sum(true**2)) > 0.9


@pytest.mark.parametrize("bands", [1, 5])
def test_a_picture_of_other_bands_has_no_such_colours(bands):
    assert not any(of.any() for of in _duller(np.full((8, 8, bands), 0.3)))


@untyped
@pytest.mark.parametrize(
    "of",
    [
        ds.Scene(ds.Object(ds.Sphere(), ds.Material(**OF)), ds.DirectionalLight(-TO_LIGHT), shadows=True),
        ds.Scene(ds.Object(ds.Sphere(), ds.Material(**OF, k_t=0.5, eta=1.5)), ds.DirectionalLight(-TO_LIGHT)),
        ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_d=ds.Chequer(0.2, 0.4, 0.1))), ds.DirectionalLight(-TO_LIGHT)),
        ds.Scene([ds.Object(ds.Sphere(), ds.Material(**OF))] * 2, ds.DirectionalLight(-TO_LIGHT)),
    ],
    ids=["shadows", "glass", "pattern", "two"],
)
def test_what_no_gbuffer_can_draw_is_not_stretched(of):
    at: Any = SimpleNamespace(fit=SimpleNamespace(scene=of, views=[VIEW]), drawable=True)
    assert list(of_ellipsoid(at)) == []


@untyped
def test_a_lamp_where_the_object_is_and_one_whose_light_does_not_arrive_stay():
    here = ds.PointLight((0.0, 0.0, 0.0))
    for power in (0, 2):
        assert falling(power, here, np.zeros(3)) is here


@pytest.mark.thorough
def test_lamps_that_are_no_points_are_named_with_their_width():
    """Of 0.6 by 0.6 at a distance of 3: as ds.AreaLight they are right, and as points too sharp."""
    places = np.array([[1.5, 1.0, 2.5], [-1.5, 1.0, 2.5], [0.0, 2.0, 2.5]])
    ball, law = scene().objects, ds.RadialAttenuation(0, 0, 1)
    wide, points = [], []
    for at in places:
        u, v = 0.6 * np.linalg.svd(at[None])[2][1:]
        u, v = (u, v) if np.dot(np.cross(u, v), at) < 0 else (v, u)
        wide.append(ds.AreaLight(at - 0.5 * (u + v), u, v, intensity=6.0, exponent=0, attenuation=law))
        points.append(ds.PointLight(at, 6.0, law))
    random = np.random.default_rng(1)
    views = []
    for i in range(len(places)):
        image = np.asarray(ds.render(ds.Scene(ball, wide[i]), VIEW.camera))
        views.append(ds.View(image + 0.003 * random.standard_normal(image.shape), VIEW.camera, lit=(i,)))
    fit = ds.fit(ds.Scene(ball, points), views, free=("k_a", "k_d", "k_s", "n_s"))
    (note,) = (note for note in fit.notes if note.kind == "cause")
    assert note.names == ("size",)
    assert "about 0.2 times as wide" in note or "about 0.19 times as wide" in note
    true = np.concatenate([OF["k_a"], OF["k_d"], [OF["k_s"]] * 3, [OF["n_s"]]])
    np.testing.assert_array_less(np.abs(fit.values - true), 3.0 * fit.errors)
