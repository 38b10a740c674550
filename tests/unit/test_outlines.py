"""Outlines: a silhouette beside photographs of a ball before a dark wall."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

import diffshade as ds
from diffshade.inverse.verdicts.outlines import WrongOutline, compare, noise_of, said

ROW, COLUMN = np.mgrid[:80, :80] - 39.5


def ball(radius: float, lights=((0.5, 0.3, 0.8), (-0.5, -0.3, 0.8), (0.0, 0.0, 1.0)), k_a=0.0, noise=0.003):
    """The brightest of photographs of a matte ball under these lights."""
    random = np.random.default_rng(0)
    z2 = 1.0 - (ROW**2 + COLUMN**2) / radius**2
    normal = np.stack([COLUMN / radius, -ROW / radius, np.sqrt(np.maximum(z2, 0.0))], -1)
    images = [
        np.where(z2 > 0, k_a + 0.6 * np.maximum(normal @ np.array(light) / np.linalg.norm(light), 0.0), 0.0)
        + noise * random.standard_normal(ROW.shape)
        for light in lights
    ]
    return np.max(images, 0)


def disc(radius: float, right: float = 0.0):
    return ROW**2 + (COLUMN - right) ** 2 < radius**2


@pytest.mark.parametrize("k_a", [0.0, 0.05])
@pytest.mark.parametrize("noise", [0.0, 0.003, 0.02])
def test_a_radius_too_large_or_too_small_is_seen_with_its_width(k_a, noise):
    found = compare(disc(27.5), ball(25, k_a=k_a, noise=noise))
    assert found is not None
    assert found.large
    assert found.width == pytest.approx(2.5, abs=0.7)
    assert found.pixels == pytest.approx(disc(27.5).sum() - disc(25).sum(), rel=0.15)
    assert found.share > 0.9
    found = compare(disc(23), ball(25, k_a=k_a, noise=noise))
    assert found is not None
    assert not found.large
    assert found.width == pytest.approx(2, abs=0.7)


@pytest.mark.parametrize("k_a", [0.0, 0.05])
def test_the_right_outline_is_right(k_a):
    for brightness in (
        ball(25, k_a=k_a),
        ball(25, k_a=k_a, noise=0.03),
        ball(25, k_a=k_a, lights=((1.0, 0.0, 0.2),)),  # half of it is dark
        ball(25, k_a=k_a, lights=((1.0, 0.0, -0.4),)),  # a crescent
        ball(25, k_a=k_a, lights=((0.3, 0.0, 1.0),)),
        ball(25, k_a=k_a, lights=((0.0, 0.0, 1.0),)),
        ndimage.gaussian_filter(ball(25, k_a=k_a), 1.5),
        0.0 * ball(25),
    ):
        assert compare(disc(25), brightness) is None


@pytest.mark.parametrize("radius", [4.5, 20.0])
def test_the_noise_of_a_small_object_is_found_in_its_own_rows(radius):
    """Rows spread over the whole of a tall photograph would miss it."""
    row, column = np.mgrid[:3000, :60]
    inside = np.hypot(row - 1234.5, column - 30.0) < radius
    image = inside + 0.01 * np.random.default_rng(0).standard_normal(inside.shape)
    view = ds.View(np.repeat(image[..., None], 3, -1), ds.Camera((0, 0, 4), shape=(3000, 60)))
    assert noise_of([view], inside) == pytest.approx(0.01, rel=0.5 if radius < 5 else 0.1)
    assert noise_of([view], np.zeros_like(inside)) == np.inf


def test_before_another_background_nothing_is_said():
    table = np.where(disc(25), ball(25), 0.3 + 0.1 * np.sin(ROW / 7))
    assert compare(disc(27.5), table) is None
    assert compare(disc(23), table) is None
    assert compare(disc(27.5), np.where(disc(25), ball(25), 0.4)) is None
    assert compare(disc(200), ball(25)) is None
    assert compare(disc(0), ball(25)) is None


def test_a_centre_that_is_off_shows_on_one_side():
    assert compare(disc(25, right=0.4), ball(25)) is None
    found = compare(disc(25, right=6), ball(25))
    assert found is None or found.share < 0.8


def test_it_is_said_where_and_what_to_do():
    scene = ds.Scene(ds.Object(ds.Sphere()))
    sentence = said(scene, WrongOutline(True, 1234, 2.6, 0.9))
    for word in ("1,234 pixels inside", "radius is too large", "3 px", "Nothing is determined", "View a mask"):
        assert word in sentence
    sentence = said(ds.Scene(ds.Object(ds.Box())), WrongOutline(False, 12, 1.0, 0.9))
    assert "outside the outline" in sentence
    assert "Nothing is determined" not in sentence
    assert "an object is too small" in sentence


@pytest.mark.parametrize(("fov", "words"), [(36.0, None), (40.0, "inside the outline"), (33.0, "outside the outline")])
def test_an_alpha_channel_tells_a_wrong_fov(fov, words):
    """As of a lens that is given for another sensor: "blurred by 5.5 pixels", "longer in one direction"."""
    right, lamp = ds.Camera((0, 0, 4), fov=36.0, shape=(96, 96)), ds.DirectionalLight((-0.5, -0.3, -1.0))
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.05, (0.6, 0.4, 0.2), 0.3, 20)), lamp)
    image = np.asarray(ds.render(scene, right)) + 0.003 * np.random.default_rng(0).standard_normal((96, 96, 3))
    alpha = np.asarray(ds.intersect(scene, right).mask)[..., None]
    view = ds.View(np.concatenate([image * alpha, alpha], -1), ds.Camera((0, 0, 4), fov=2 * 36.0 - fov, shape=(96, 96)))
    notes = [note for note in ds.fit(scene, view, free=("k_a", "k_d", "k_s", "n_s")).notes if note.kind == "outline"]
    assert [words in note for note in notes] == ([True] if words else [])
