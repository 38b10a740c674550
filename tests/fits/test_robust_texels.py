"""Robust fits of texels: objects whose photographs have shadows that no model knows, with one highlight for all."""

from __future__ import annotations

import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffshade as ds
from diffshade.texels.robust.calibration import calibrated, parts_of
from diffshade.texels.robust.candidates import hemisphere
from diffshade.texels.robust.disagreement import CELLS, disagreements
from diffshade.texels.robust.highlight_shape import EXPONENTS, HighlightShape, shape_of
from diffshade.texels.robust.neighbours import geometric_median, scatter_of
from tests.support.measured import measured
from tests.support.textured import angle, facing_us, textured_ball

FREE = ("k_d", "k_s", "n_s", "normal")


@pytest.fixture(scope="module")
def shadowed():
    ball = textured_ball(40, noise=0.005, shadows=0.1)
    return ball, ds.fit_texels(facing_us(ball), ball.views, free=FREE)


def test_shadows_do_not_turn_normals(shadowed):
    ball, maps = shadowed
    assert maps.highlights  # shared: an own n_s for each texel predicts shadowed photographs worse
    off = angle(maps.values["normal"], ball.truth["normal"])[ball.mask]
    plain = ds.fit_texels(facing_us(ball), ball.views, free=FREE, loss="squares")
    by_squares = angle(plain.values["normal"], ball.truth["normal"])[ball.mask]
    assert np.median(off) < 1.0
    assert np.mean(off) < 0.5 * np.mean(by_squares)
    assert not plain.highlights
    k_d = maps.values["k_d"][ball.mask] / ball.truth["k_d"].reshape(*ball.mask.shape, -1)[ball.mask]
    assert abs(np.median(k_d) - 1.0) < 0.05


def test_stated_angles_hold_the_truth(shadowed):
    ball, maps = shadowed
    off = angle(maps.values["normal"], ball.truth["normal"])[ball.mask]
    for errors, least in ((maps.errors, 0.55), (maps.errors_95, 0.9)):
        assert np.mean(off <= errors["normal"][..., 0][ball.mask]) > least
    sure = maps.known[ball.mask]
    assert np.mean(off[sure]) <= np.mean(off)


def test_maps_are_shaded_by_the_shared_highlight_and_say_so(shadowed, tmp_path):
    ball, maps = shadowed
    assert abs(sum(one.weight for one in maps.highlights) - 1.0) < 1e-6
    drawn = maps.shade(lit=3)
    shown = np.asarray(ball.views[3].image)
    lit = ball.mask & (shown.mean(-1) > 0.05)
    assert np.median(np.abs(drawn - shown)[lit]) < 0.02
    assert drawn.max() < 2.0 * shown.max()  # no fireflies
    maps.write(tmp_path, suffix=".npy")
    about = tomllib.loads((tmp_path / "maps.toml").read_text())
    assert [one["n_s"] for one in about["highlight"]] == [one.n_s for one in maps.highlights]
    assert about["errors_95"]["normal"] == pytest.approx(maps.times_95["normal"], abs=1e-3)


def test_bands_are_the_whole_map(shadowed, tmp_path):
    ball, maps = shadowed
    bands = ds.fit_texels(facing_us(ball), ball.views, free=FREE, memory=400_000, out=tmp_path / "maps")
    assert len(np.load(tmp_path / "maps" / "done.npy")) > 2
    apart = np.linalg.norm(bands.values["normal"] - maps.values["normal"], axis=-1)[ball.mask]
    assert np.rad2deg(np.max(apart)) < 1e-6
    for name in FREE:
        np.testing.assert_allclose(bands.errors[name], maps.errors[name], rtol=1e-5)
    np.testing.assert_array_equal(bands.status, maps.status)


def test_light_errors_enlarge_the_errors_of_normals(shadowed):
    ball, maps = shadowed
    wide = ds.fit_texels(facing_us(ball), ball.views, free=FREE, light_error=3.0)
    both = np.isfinite(wide.errors["normal"]) & np.isfinite(maps.errors["normal"]) & ball.mask[..., None]
    assert (wide.errors["normal"] >= maps.errors["normal"] - 1e-5)[both].all()
    # independent errors of 3 degrees, averaged over some of 20 lights
    added = np.sqrt(np.maximum(wide.errors["normal"] ** 2 - maps.errors["normal"] ** 2, 0.0))[both]
    assert 0.5 < np.median(added) < 3.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"light_error": -1.0}, "light_error must be one number of degrees, at least 0"),
        ({"light_error": [1.0, 2.0]}, "one for each of the 20 views"),
        ({"light_error": 1.0, "loss": "squares"}, "light_error needs k_d, k_s, n_s and normal free, and a robust loss"),
    ],
)
def test_wrong_light_errors_are_refused(given, message):
    ball = textured_ball(8)
    with pytest.raises(ValueError, match=message):
        ds.fit_texels(facing_us(ball), ball.views, free=FREE, **given)


def test_a_normal_alone_keeps_its_own(shadowed):
    ball, maps = shadowed
    alone = ds.fit_texels(facing_us(ball), ball.views, free=FREE, neighbours=False)
    off = [angle(m.values["normal"], ball.truth["normal"])[ball.mask] for m in (alone, maps)]
    assert np.mean(off[0]) > np.mean(off[1])


def test_the_shape_of_a_highlight_has_its_slope_and_half_width():
    shape = shape_of(np.array([0.0, 0.3, 0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 1e-4]))
    assert [p for _, p in shape.lobes] == [EXPONENTS[1], EXPONENTS[4]]
    c = jnp.linspace(0.5, 1.0, 7)
    single = HighlightShape(jnp.asarray(shape.weight, c.dtype))
    value, slope = single.at(c)
    np.testing.assert_allclose(value, 0.3 * c**8 + 0.7 * c**64, rtol=1e-6)
    np.testing.assert_allclose(slope, jax.vmap(jax.grad(lambda x: single.at(x)[0]))(c), rtol=1e-6)
    one = shape_of(np.eye(len(EXPONENTS))[3])
    assert one.exponent == pytest.approx(32.0, rel=1e-6)


def test_candidates_are_unit_vectors_of_equal_areas():
    flat = hemisphere().reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(flat, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(flat.mean(0), [0.0, 0.0, 0.5], atol=2e-3)  # the mean over a hemisphere
    nearest = np.sort(np.rad2deg(np.arccos(np.clip(flat @ flat.T, -1, 1))), 1)[:, 1]
    assert nearest.max() < 4.0


def test_a_median_of_normals_outvotes_one_and_keeps_an_edge():
    normal = np.zeros((8, 8, 3))
    normal[:, :4], normal[:, 4:] = [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]
    mask = np.ones((8, 8), bool)
    wild = normal.copy()
    wild[4, 1] = [0.0, 1.0, 0.0]
    found = geometric_median(wild, mask)
    assert np.rad2deg(np.arccos(found[4, 1, 2])) < 1.0
    assert np.rad2deg(np.arccos(np.clip(np.sum(found[:, 3] * normal[:, 3], -1), -1, 1)))[1:-1].max() < 8.0
    assert scatter_of(normal, mask)[4, 4] > 5.0 * scatter_of(normal[:, :1].repeat(8, 1), mask)[4, 4]


def test_halves_of_lights_give_the_size_of_errors():
    rng = np.random.default_rng(0)
    spread, true = rng.uniform(0.5, 2.0, 4000), 3.0
    # halves of independent errors lie on either side of the whole, as far as the whole lies from the truth
    one = np.abs(rng.standard_normal(4000)) * true * spread
    found = calibrated(np.stack([one, one]), spread, np.ones((2, 4000)))
    assert found.errors == pytest.approx(true, rel=0.05)
    assert found.errors * found.times_95 == pytest.approx(1.96 * true, rel=0.05)
    lights = np.stack([np.linspace(-1, 1, 30), 0.1 * np.cos(np.arange(30)), np.ones(30)], -1)
    halves = parts_of(lights)
    assert halves.shape == (2, 30)
    assert (halves[0] == ~halves[1]).all()
    assert len(parts_of(lights[:12])) == 3
    assert np.isinf(calibrated(np.zeros((2, 5)), np.ones(5), np.ones((2, 5))).errors)


def test_a_photograph_that_disagrees_is_named():
    ball = textured_ball(40, noise=0.005, shadows=0.1)
    views = list(ball.views)
    views[7] = ds.View(np.roll(views[7].image, 9, 1), views[7].camera, views[7].mask, lit=views[7].lit)
    maps = ds.fit_texels(facing_us(ball), views, free=FREE, loss="cauchy", light_error=0.1)
    assert any("views[7]" in note and "disagree" in note for note in maps.notes)
    doubts = np.zeros((6, CELLS * CELLS, 2))
    doubts[..., 1], doubts[2, 5, 0] = 100.0, 90.0
    (place,) = disagreements(doubts)
    assert (place.view, place.cell) == (2, 5)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "most", "of_twelve"), [("ball", 1.9, 2.8), ("cat", 4.9, 8.0), ("harvest", 16.5, 25.0)]
)
def test_real_objects_have_their_normals(name, most, of_twelve):
    """Plain least squares: 5.2, 8.6 and 31.6 degrees with these 48 photographs."""
    folder = measured(f"diligent_{name}")
    scene, views = ds.read_photographs(folder, normals=False)
    truth, mask = np.load(folder / "normal_gt.npy"), ds.read_mask(folder / "mask.png")
    maps = ds.fit_texels(scene, views, free=FREE)
    off = angle(maps.values["normal"], truth)[mask]
    assert maps.highlights
    assert off.mean() < most
    assert 0.59 < np.mean(off <= maps.errors["normal"][..., 0][mask]) < 0.76
    assert np.mean(off <= maps.errors_95["normal"][..., 0][mask]) > 0.9
    assert off[maps.known[mask]].mean() < off[~maps.known[mask]].mean()
    twelve = [views[i] for i in np.round(np.linspace(0, 47, 12)).astype(int)]
    maps = ds.fit_texels(scene, twelve, free=FREE)
    assert angle(maps.values["normal"], truth)[mask].mean() < of_twelve
