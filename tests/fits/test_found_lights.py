"""Lights found from all texels of an object: refined, of unknown intensity, nearby, and without any direction."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from bumpy import bumpy
from directions import unit
from small_blocks import small_blocks  # noqa: F401

import diffshade as ds
from diffshade.texels.lights.found import notes_on
from diffshade.texels.lights.joint import Responses, light_equations
from diffshade.texels.lights.matte import cells_of
from diffshade.texels.lights.uncalibrated import factorize, of_lengths
from diffshade.texels.tiles import ViewReader
from tests.support.textured import angle, facing_us, lights_about, textured_ball

COUNT, DEGREES, RELATIVE = 20, 2.0, 0.05


def turned(directions: np.ndarray, degrees: float, seed: int) -> np.ndarray:
    """Directions that are off by this much about each axis."""
    random = np.random.default_rng(seed)
    return unit(directions + np.deg2rad(degrees) * random.standard_normal(directions.shape))


def told(scene: ds.Scene, directions: np.ndarray, intensities: np.ndarray) -> ds.Scene:
    lights = [ds.DirectionalLight(-l, float(i)) for l, i in zip(directions, intensities, strict=True)]
    return eqx.tree_at(lambda s: s.lights, scene, tuple(lights))


@pytest.fixture(scope="module")
def matte():
    return textured_ball(64, COUNT, noise=0.005, gloss=0.0, lobe="blinn")


@pytest.fixture(scope="module")
def unequal():
    """Factors by which intensities are told wrong, 1 in the mean of their logarithms."""
    log = RELATIVE * np.random.default_rng(4).standard_normal(COUNT)
    return np.exp(log - log.mean())


@pytest.fixture(scope="module")
def refined(matte, unequal):
    true = lights_about(COUNT)
    stated = turned(true, DEGREES, 3)
    scene = told(facing_us(matte), stated, unequal)
    return stated, ds.lights.find_lights(scene, matte.views, light_error=DEGREES, intensity_error=RELATIVE)


@pytest.mark.thorough
def test_directions_and_intensities_are_refined_and_their_errors_hold(refined, unequal):
    (stated, found), true = refined, lights_about(COUNT)
    assert found.settled
    off = angle(found.directions, true)
    assert off.mean() < 0.5 * angle(stated, true).mean()
    # of two axes, each with this error, 95 % are within 2.45 errors
    assert np.mean(off <= 2.45 * found.errors) >= 0.9
    vectors = found.directions * (found.intensities * unequal)[:, None]
    linear = unit(vectors @ np.linalg.lstsq(vectors, true, rcond=None)[0])
    assert np.mean(angle(linear, true) <= 2.45 * found.own_errors) >= 0.9
    assert angle(linear, true).mean() < 0.5
    left = np.log(found.intensities * unequal)
    assert np.std(left) < 0.5 * np.std(np.log(unequal))
    assert np.mean(np.abs(left - left.mean()) <= 1.96 * found.intensity_errors) >= 0.9


@pytest.mark.thorough
def test_it_says_what_photographs_cannot_tell(refined):
    text = str(refined[1])
    assert "linear map (9 numbers)" in text
    assert "taken from the stated directions" in text
    assert "the mean intensity and k_d scale each other" in text
    assert f"and {COUNT - 8} lights that moved less" in text


@pytest.mark.thorough
def test_the_found_scene_has_the_found_lights(refined, unequal):
    found = refined[1]
    lights = found.scene.lights
    np.testing.assert_allclose([-np.asarray(l.direction) for l in lights], found.directions, atol=1e-12)
    np.testing.assert_allclose([np.mean(l.intensity) for l in lights], found.intensities * unequal, rtol=1e-12)
    assert found.light_error.shape == (COUNT,)


@pytest.mark.thorough
def test_intensities_are_found_where_directions_are_exact(matte, unequal):
    true = lights_about(COUNT)
    found = ds.lights.find_lights(
        told(facing_us(matte), true, unequal), matte.views, light_error=0.0, intensity_error=None
    )
    np.testing.assert_allclose(found.directions, true, atol=1e-9)
    left = np.log(found.intensities * unequal)
    assert np.std(left) < 0.002
    assert (np.abs(left - left.mean()) <= 2.0 * found.intensity_errors).all()
    assert not any("map" in note for note in found.notes)


@pytest.mark.slow
def test_lights_of_which_nothing_is_known_are_found_but_for_what_is_said(matte):
    true = lights_about(COUNT)
    nothing = told(facing_us(matte), np.tile([0.0, 0.0, 1.0], (COUNT, 1)), np.ones(COUNT))
    found = ds.lights.find_lights(nothing, matte.views)
    assert angle(found.directions, true).mean() < 4.0
    assert np.isinf(found.errors).all()
    assert np.isfinite(found.own_errors).all()
    assert "orthogonal map (3 numbers)" in str(found)
    assert "bulges" in str(found)
    maps = ds.fit_texels(found.scene, matte.views, loss="cauchy", free=("k_d", "k_s", "n_s", "normal"))
    off = angle(maps.values["normal"], matte.truth["normal"])[matte.mask]
    assert np.median(off) < 4.0


@pytest.mark.thorough
def test_with_unknown_intensities_too_the_lights_are_found_but_for_a_linear_map(matte, unequal):
    """Of which the normals of a surface leave the generalised bas-relief."""
    true = lights_about(COUNT)
    nothing = told(facing_us(matte), np.tile([0.0, 0.0, 1.0], (COUNT, 1)), unequal)
    found = ds.lights.find_lights(nothing, matte.views, intensity_error=None)
    vectors = found.directions * (found.intensities * unequal)[:, None]
    linear = unit(vectors @ np.linalg.lstsq(vectors, true, rcond=None)[0])
    assert angle(linear, true).mean() < 1.5
    assert angle(found.directions, true).mean() > angle(linear, true).mean()
    assert np.isinf(found.errors).all()
    assert "generalised bas-relief (3 numbers: depth and two tilts)" in str(found)


@pytest.mark.parametrize(
    ("stated", "exact", "said", "not_said"),
    [
        (True, True, ["an orthogonal map (3 numbers)", "taken from the stated directions"], "bas-relief"),
        (True, False, ["a linear map (9 numbers)", "taken from the stated directions", "k_d scale"], "bas-relief"),
        (False, True, ["an orthogonal map (3 numbers)", "bulges or is hollow"], "bas-relief"),
        (False, False, ["a linear map (9 numbers)", "generalised bas-relief (3 numbers", "k_d scale"], "bulges"),
    ],
)
def test_what_remains_is_named_by_what_is_known(stated, exact, said, not_said):
    """Hayakawa 1994; Woodham, Iwahori and Barman 1991; Belhumeur, Kriegman and Yuille 1999."""
    text = " ".join(
        notes_on(stated=stated, exact_directions=False, exact_intensities=exact, shared=0.5, settled=True, spread=0.05)
    )
    for words in said:
        assert words in text
    assert not_said not in text


@pytest.mark.slow
def test_lamps_nearby_are_turned_about_the_object():
    places = 5.0 * lights_about(COUNT)
    ball = textured_ball(64, noise=0.005, gloss=0.0, at=places, intensity=np.array(25.0))
    middle = ball.truth["normal"][ball.mask].mean(0)
    stated = turned(lights_about(COUNT), DEGREES, 3)
    moved: list[Any] = [
        eqx.tree_at(lambda l: l.position, light, 5.0 * d)  # pyright: ignore
        for light, d in zip(facing_us(ball).lights, stated, strict=True)
    ]
    scene = eqx.tree_at(lambda s: s.lights, facing_us(ball), tuple(moved))
    found = ds.lights.find_lights(scene, ball.views, light_error=DEGREES)
    true, before = unit(places - middle), unit(5.0 * stated - middle)
    assert angle(found.directions, true).mean() < 0.5 * angle(before, true).mean()
    for one, light in zip(found.scene.lights, moved, strict=True):
        distances = [np.linalg.norm(np.asarray(l.position) - middle) for l in (one, light)]  # pyright: ignore
        assert distances[0] == pytest.approx(distances[1], rel=1e-9)


def test_eliminating_texels_gives_the_lights_of_the_whole_equations():
    random, views, texels, lights = np.random.default_rng(0), 9, 40, 7
    light_of = np.array([0, 1, 2, 3, 4, 5, 6, 0, 3])
    of = Responses(
        random.standard_normal((views, texels)),
        random.uniform(0.1, 1.0, (views, texels)),
        random.standard_normal((4, views, texels)),
        random.standard_normal((3, views, texels)),
        random.uniform(0.01, 0.1, (4, texels)),
        random.standard_normal((4, texels)),
    )
    cell = random.integers(0, 3, texels)
    found = light_equations(of, light_of, lights, cell, 3)
    J = np.zeros((views, texels, 3 * lights + 4 * texels))
    for v in range(views):
        for t in range(texels):
            J[v, t, 3 * light_of[v] : 3 * light_of[v] + 3] = of.by_light[:, v, t]
            J[v, t, 3 * lights + 4 * t : 3 * lights + 4 * t + 4] = of.by_texel[:, v, t]
    flat, w = J.reshape(-1, J.shape[-1]), np.asarray(of.weight).ravel()
    H = flat.T @ (w[:, None] * flat)
    g = flat.T @ (w * np.asarray(of.residual).ravel())
    own = np.arange(3 * lights, len(H))
    H[own, own] += np.asarray(of.curvature).T.ravel()
    g[own] += np.asarray(of.pull).T.ravel()
    whole = np.linalg.solve(H + 1e-3 * np.diag(np.arange(len(H)) < 3 * lights), g)[: 3 * lights]
    eliminated = np.linalg.solve(found.S + 1e-3 * np.eye(3 * lights), found.gradient.sum(0))
    np.testing.assert_allclose(eliminated, whole, rtol=1e-9, atol=1e-9)


def test_lengths_say_a_map_but_for_a_rotation():
    true = lights_about(12)
    A = np.array([[1.0, 0.3, 0.2], [0.0, 0.7, -0.1], [0.1, 0.0, 1.4]])
    found = (true @ A.T) @ of_lengths(true @ A.T).T
    np.testing.assert_allclose(found @ found.T, true @ true.T, atol=1e-6)


def test_black_texels_do_not_spoil_what_the_lights_are_found_from():
    random, lights = np.random.default_rng(0), lights_about(24)
    n = random.standard_normal((1500, 3))
    n[:, 2] = np.abs(n[:, 2]) + 1.0
    y = np.maximum(lights @ unit(n).T, 0.0) + 0.003 * random.standard_normal((24, 1500))
    y[:, :15] = 0.003 * random.standard_normal((24, 15))
    found = factorize(y, np.ones(y.shape, bool))
    mapped = unit(found @ np.linalg.lstsq(found, lights, rcond=None)[0])
    assert angle(mapped, lights).max() < 1.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"light_error": -1.0}, "light_error must be one number"),
        ({"light_error": [1.0, 2.0]}, f"one for each of the {COUNT} lights"),
        ({"light_error": [0.0] * 10 + [1.0] * 10}, "must be 0 for all lights or above 0 for all"),
        ({"intensity_error": np.nan}, "intensity_error must be one number"),
    ],
)
def test_wrong_errors_are_refused(matte, change, said):
    with pytest.raises(ValueError, match=said):
        ds.lights.find_lights(facing_us(matte), matte.views, **change)


def test_views_without_their_own_light_and_too_few_lights_are_refused(matte):
    scene = facing_us(matte)
    with pytest.raises(ValueError, match=r"views\[0\] has 2"):
        ds.lights.find_lights(
            scene, (ds.View(matte.views[0].image, matte.views[0].camera, lit=(0, 1)), *matte.views[1:])
        )
    with pytest.raises(ValueError, match="at least 6 lights; the views have 5"):
        ds.lights.find_lights(scene, matte.views[:5])


def test_cells_show_each_light_without_its_colour():
    of, colour = bumpy("texture", 6, 40.0), np.array([[1.4, 1.0, 0.6], [0.6, 1.0, 1.4]] * 3)
    seen = []
    for by in (np.ones_like(colour), colour):
        views = [dataclasses.replace(v, image=np.asarray(v.image) * c) for v, c in zip(of.views, by, strict=True)]
        reader = ViewReader(of.scene, views)
        seen.append(cells_of(views, reader, reader.sample(2000), 30, by))
    np.testing.assert_allclose(seen[1].seen, seen[0].seen, atol=1e-6)
    assert seen[0].inside.sum() > 100
