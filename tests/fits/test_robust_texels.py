"""Robust fits of texels: objects whose photographs have shadows that no model knows, with one highlight for all."""

from __future__ import annotations

import dataclasses
import tomllib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bumpy import oren_nayar
from scipy.stats import spearmanr
from small_blocks import small_blocks  # noqa: F401

import diffshade as ds
from diffshade.model.diffuse_laws import LAMBERT, DiffuseLaw
from diffshade.model.vectors import Vec3, dot, tangents_of
from diffshade.texels.robust.block_fits import by_bounce, lowest_state
from diffshade.texels.robust.calibration import calibrated, division_of
from diffshade.texels.robust.candidates import hemisphere
from diffshade.texels.robust.choice import _error_of_own
from diffshade.texels.robust.disagreement import CELLS, disagreements
from diffshade.texels.robust.learning import every_assumption, first_model
from diffshade.texels.robust.neighbours import geometric_median, scatter_of
from diffshade.texels.robust.observations import BlockObservations, Lights
from diffshade.texels.robust.reflection_shape import (
    EXPONENTS,
    EitherLobe,
    beside_blinn,
    lobe_taken,
    shape_of,
)
from diffshade.texels.robust.robust_descent import around, begin, system
from diffshade.texels.robust.stated_errors import COLUMNS, SpreadColumns
from diffshade.texels.unexplained import interpolation_of, smoothing_of
from tests.support.measured import measured
from tests.support.textured import angle, facing_us, lights_about, textured_ball

FREE = ("k_d", "k_s", "n_s", "normal")


@pytest.fixture(scope="module")
def shadowed():
    ball = textured_ball(40, noise=0.005, shadows=0.1)
    return ball, ds.fit_texels(facing_us(ball), ball.views, free=FREE)


@pytest.mark.thorough
def test_shadows_do_not_turn_normals(shadowed):
    ball, maps = shadowed
    assert maps.highlights  # shared: an own n_s for each texel predicts shadowed photographs worse
    off = angle(maps.values["normal"], ball.truth["normal"])[ball.mask]
    seen = np.stack([np.asarray(view.image).mean(-1)[ball.mask] for view in ball.views])
    b = np.linalg.lstsq(lights_about(len(seen)), seen, rcond=None)[0].T  # Woodham 1980
    by_squares = angle(b / np.linalg.norm(b, axis=-1, keepdims=True), ball.truth["normal"][ball.mask])
    assert np.median(off) < 1.0
    assert np.mean(off) < 0.5 * np.mean(by_squares)
    k_d = maps.values["k_d"][ball.mask] / ball.truth["k_d"].reshape(*ball.mask.shape, -1)[ball.mask]
    assert abs(np.median(k_d) - 1.0) < 0.05


@pytest.mark.thorough
def test_stated_angles_hold_the_truth(shadowed):
    ball, maps = shadowed
    off = angle(maps.values["normal"], ball.truth["normal"])[ball.mask]
    for errors, least in ((maps.errors, 0.55), (maps.errors_95, 0.9)):
        assert np.mean(off <= errors["normal"][..., 0][ball.mask]) > least
    sure = maps.known[ball.mask]
    assert np.mean(off[sure]) <= np.mean(off)


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_bands_are_the_whole_map(shadowed, tmp_path):
    ball, maps = shadowed
    bands = ds.fit_texels(facing_us(ball), ball.views, free=FREE, memory=400_000, out=tmp_path / "maps")
    assert len(np.load(tmp_path / "maps" / "done.npy")) > 2
    apart = np.linalg.norm(bands.values["normal"] - maps.values["normal"], axis=-1)[ball.mask]
    assert np.rad2deg(np.max(apart)) < 1e-6
    for name in FREE:
        np.testing.assert_allclose(bands.errors[name], maps.errors[name], rtol=1e-5)
    np.testing.assert_array_equal(bands.status, maps.status)


@pytest.mark.slow
def test_bands_are_the_whole_map_under_near_lamps_too():
    at = 3.0 * lights_about(20)
    ball = textured_ball(40, noise=0.005, shadows=0.1, at=at)
    scene = ball.scene

    def fit(memory):
        return ds.fit_texels(scene, ball.views, free=FREE, loss="cauchy", light_error=0.1, memory=memory)

    whole, bands = fit(10**9), fit(500_000)
    apart = np.linalg.norm(bands.values["normal"] - whole.values["normal"], axis=-1)[ball.mask]
    assert np.rad2deg(np.max(apart)) < 1e-6
    np.testing.assert_array_equal(bands.status, whole.status)


@pytest.mark.thorough
def test_what_shows_nothing_is_not_known(shadowed):
    ball, _ = shadowed
    scene = facing_us(ball)
    surface = ds.GBuffer(np.broadcast_to([0.0, 0.0, 1.0], (40, 40, 3)), None, np.ones((40, 40), bool))
    scene = eqx.tree_at(lambda s: s.objects[0].surface, scene, surface)
    views = [ds.View(np.where(ball.mask[..., None], v.image, 0.0), v.camera, lit=v.lit) for v in ball.views]
    maps = ds.fit_texels(scene, views, free=FREE, light_error=0.1)
    assert not maps.known[~ball.mask].any()
    assert np.isinf(maps.errors["normal"][~ball.mask]).all()


@pytest.mark.slow
@pytest.mark.parametrize("n_s", [20.0, 300.0])
def test_the_exponent_of_one_material_lies_within_its_errors(n_s):
    ball, lights, rng = textured_ball(40), lights_about(30), np.random.default_rng(0)
    n = ball.truth["normal"]
    views = []
    for i, l in enumerate(lights):
        h = l + np.array([0.0, 0.0, 1.0])
        h /= np.linalg.norm(h)
        n_l = np.maximum(n @ l, 0.0)
        image = 0.4 * n_l + 0.3 * np.where(n_l > 0.0, np.maximum(n @ h, 0.0) ** n_s, 0.0)
        image = image[..., None] + 0.005 * rng.standard_normal((40, 40, 3))
        dark = rng.random((40, 40, 1)) < 0.1
        views.append(ds.View(np.where(dark, 0.0, image), ball.views[0].camera, ball.mask, lit=i))
    flat = ds.GBuffer(np.broadcast_to([0.0, 0.0, 1.0], (40, 40, 3)), None, ball.mask)
    scene = ds.Scene(ds.Object(flat, ds.Material(lobe=ds.Blinn())), [ds.DirectionalLight(-l) for l in lights])
    maps = ds.fit_texels(scene, views, free=FREE, loss="cauchy", light_error=0.01)
    found, error = (of["n_s"][ball.mask][0, 0] for of in (maps.values, maps.errors))
    assert abs(found - n_s) < 1.96 * error
    assert error < 0.5 * n_s


@pytest.mark.thorough
def test_a_matte_object_has_no_highlight():
    ball = textured_ball(40, noise=0.005, shadows=0.1, gloss=0.0)
    maps = ds.fit_texels(facing_us(ball), ball.views, free=FREE, loss="cauchy", light_error=0.01)
    assert np.mean(maps.determined[ball.mask]) < 0.16
    assert np.mean(maps.known[ball.mask]) > 0.8


@pytest.mark.thorough
def test_lamps_without_a_channel_are_fitted_texel_by_texel():
    colours = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])[np.arange(21) % 3]
    ball = textured_ball(24, 21, noise=0.005, intensity=colours)
    maps = ds.fit_texels(facing_us(ball), ball.views, free=FREE)
    assert not maps.highlights
    assert np.median(angle(maps.values["normal"], ball.truth["normal"])[ball.mask]) < 2.0
    with_error = ds.fit_texels(facing_us(ball), ball.views, free=FREE, light_error=1.0)
    assert any("the errors of the lights are not in those" in note for note in with_error.notes)
    np.testing.assert_array_equal(with_error.values["normal"], maps.values["normal"])


@pytest.mark.slow
def test_faint_lamps_change_nothing(shadowed):
    ball, views = with_bounced_light(24)
    scene = facing_us(ball)

    def dimmed(factor):
        lights = [ds.DirectionalLight(-l, factor) for l in lights_about(24)]
        given = eqx.tree_at(lambda s: s.lights, scene, tuple(lights))
        seen = [ds.View(factor * v.image, v.camera, v.mask, lit=v.lit) for v in views]
        maps = ds.fit_texels(given, seen, free=FREE, loss="cauchy", light_error=0.1)
        return maps.relative_errors(seen)

    np.testing.assert_allclose(dimmed(1e-6), dimmed(1.0), rtol=0.02)


@pytest.mark.thorough
def test_light_errors_enlarge_the_errors_of_normals(shadowed):
    ball, maps = shadowed
    wide = ds.fit_texels(facing_us(ball), ball.views, free=FREE, light_error=3.0)
    both = np.isfinite(wide.errors["normal"]) & np.isfinite(maps.errors["normal"]) & ball.mask[..., None]
    assert (wide.errors["normal"] >= maps.errors["normal"] - 1e-5)[both].all()
    # independent errors of 3 degrees, averaged over some of 20 lights
    added = np.sqrt(np.maximum(wide.errors["normal"] ** 2 - maps.errors["normal"] ** 2, 0.0))[both]
    assert 0.5 < np.median(added) < 3.0
    stated, exact = (ds.fit_texels(facing_us(ball), ball.views, free=FREE, light_error=error) for error in (1.0, 0.0))
    np.testing.assert_array_equal(stated.errors["normal"], maps.errors["normal"])  # a degree, if nothing is said
    assert any("known to a degree" in note for note in maps.notes)
    assert not any("known to a degree" in note for note in stated.notes)
    assert np.median(exact.errors["normal"][both]) < np.median(maps.errors["normal"][both])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"light_error": -1.0}, "light_error must be one number of at least 0"),
        ({"light_error": [1.0, 2.0]}, "one for each of the 20 lights"),
        (
            {"light_error": 1.0, "loss": "squares"},
            "light_error needs k_d, k_s, n_s and normal free alone, and a robust loss",
        ),
    ],
)
def test_wrong_light_errors_are_refused(given, message):
    ball = textured_ball(8)
    with pytest.raises(ValueError, match=message):
        ds.fit_texels(facing_us(ball), ball.views, free=FREE, **given)


@pytest.mark.thorough
def test_a_normal_alone_keeps_its_own(shadowed):
    ball, maps = shadowed
    alone = ds.fit_texels(facing_us(ball), ball.views, free=FREE, neighbours=False)
    off = [angle(m.values["normal"], ball.truth["normal"])[ball.mask] for m in (alone, maps)]
    assert np.mean(off[0]) > np.mean(off[1])


def test_the_shape_of_a_highlight_has_its_slope_and_half_width():
    shape = shape_of(np.array([0.0, 0.3, 0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 1e-4]), LAMBERT)
    assert [p for _, p in shape.lobes] == [EXPONENTS[1], EXPONENTS[4]]
    c = jnp.linspace(0.5, 1.0, 7)
    single = eqx.tree_at(lambda of: of.weight, shape, jnp.asarray(shape.weight, c.dtype))
    value, slope = single.at(c)
    np.testing.assert_allclose(value, 0.3 * c**8 + 0.7 * c**64, rtol=1e-6)
    np.testing.assert_allclose(slope, jax.vmap(jax.grad(lambda x: single.at(x)[0]))(c), rtol=1e-6)
    one = shape_of(np.eye(len(EXPONENTS))[3], LAMBERT)
    assert one.exponent == pytest.approx(32.0, rel=1e-6)


@pytest.mark.parametrize("power", [1, 4])
def test_the_albedo_of_a_highlight_is_that_of_its_lobe(power):
    """Light from all around, seen head on: h is half as far from the normal as l."""
    angle_of_l = (np.arange(20_000) + 0.5) / 20_000 * np.pi
    lobe = np.cos(angle_of_l / 2.0) ** EXPONENTS[power]
    by_lobe = 2.0 * np.pi * np.sum(lobe * np.sin(angle_of_l)) * np.pi / 20_000
    shape = shape_of(np.eye(len(EXPONENTS))[power], LAMBERT)
    assert float(shape.albedo) == pytest.approx(by_lobe / np.pi, rel=1e-5)


def test_spreads_add_what_misfits_show_and_do_not_show():
    one = SpreadColumns(*(np.array([x]) for x in (0.3, 0.2, 0.4, 0.0, 0.0, 0.0, 0.0)))
    assert one.of_normal(0.2) == pytest.approx(0.5)  # hypot(.3, .4) where the scatter is typical
    assert one.of_normal(0.4) == pytest.approx(np.hypot(0.15, 0.4))
    assert one.stacked().shape == (1, COLUMNS)


class Halved(ds.extension.AbstractPowerLobe):
    """Blinn's lobe with a number of its own."""

    share: float | np.floating

    def cosine(self, n, l, v):
        return self.share * ds.Blinn().cosine(n, l, v)


def test_one_of_two_lobes_is_chosen_by_a_number():
    n, l, v = (Vec3.of(np.array(of)) for of in ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 0.6, 0.8)))
    for which, lobe in enumerate(both := (ds.Blinn(), Halved(0.5))):
        either = EitherLobe(both, np.array(bool(which)))
        assert lobe_taken(either) is lobe
        assert float(either.cosine(n, l, v)) == pytest.approx(float(lobe.cosine(n, l, v)), rel=1e-6)
        assert beside_blinn(either) is either
    assert lobe_taken(both[1]) is both[1]
    assert lobe_taken(beside_blinn(both[1])) is both[1]
    assert beside_blinn(both[0]) is both[0]


def observed_with(lobe):
    l = lights_about(6)
    each = Vec3(*(jnp.asarray(l[:, i, None, None], jnp.float32) for i in range(3)))
    toward_us = Vec3(*(jnp.full((1, 1, 1), c, jnp.float32) for c in (0.0, 0.0, 1.0)))
    lights = Lights(each, jnp.ones((6, 1, 1), jnp.float32), toward_us, lobe)
    seen = jnp.ones((6, 1), bool)
    return BlockObservations(jnp.full((6, 1), 0.4, jnp.float32), seen, seen, jnp.ones(1, jnp.float32), lights)


@pytest.mark.parametrize("tilt", [0.0, 0.3, 0.7, 1.2])
def test_k_d_of_a_rough_and_translucent_surface_is_that_of_its_angles_with_its_derivatives(tilt):
    lights, shape = observed_with(ds.Blinn()).lights, shape_of(np.eye(len(EXPONENTS))[3], DiffuseLaw(0.4, 0.1))
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    n = Vec3(*(jnp.full(1, c, jnp.float32) for c in normal))
    D, *_ = lights.shading(shape, n)
    by_angles = oren_nayar(np.broadcast_to(normal, (6, 3)), lights_about(6), np.array([0.0, 0.0, 1.0]), 0.4)
    beyond = np.minimum(lights_about(6) @ normal, 0.0)
    np.testing.assert_allclose(D[:, 0], np.maximum(by_angles + beyond + 0.1, 0.0) / 1.1, atol=2e-6)
    tangents = tangents_of(n)
    found = lights.slopes(shape, n, tangents)
    for k, tangent in enumerate(tangents):
        ahead, behind = (lights.shading(shape, n + tangent * step)[0] for step in (1e-3, -1e-3))
        np.testing.assert_allclose(found[2 + 2 * k], (ahead - behind) / 2e-3, atol=1e-3)
    np.testing.assert_allclose(found[0], D, atol=1e-7)


def test_numbers_of_a_lobe_do_not_change_the_precision():
    own = np.array([[0.1], [0.2], [0.97], [0.4], [0.1], [20.0]], np.float32)
    assert _error_of_own(observed_with(ds.Blinn()), Halved(np.float64(0.9)), own).dtype == np.float32


def test_views_are_added_up_one_by_one_with_a_lobe_that_has_numbers():
    observed = observed_with(Halved(np.float32(0.9)))
    model = first_model("squares", every_assumption()[0])
    weighing = model.weighing(observed.level)
    state = begin(observed, model.shape, weighing, Vec3.of(np.array([[0.1], [0.2], [0.97]], np.float32).T))
    here = around(observed, model.shape, weighing, state)
    found = system(observed, model.shape, weighing, state)
    for i in range(3):  # of k_s, its ridge is added
        for j in range(3):
            assert float(found.A[i][j][0]) == pytest.approx(
                float(jnp.sum(here.weight * here.J[i] * here.J[j])), rel=1e-4
            )


@pytest.mark.thorough
def test_bounced_light_turns_normals_as_far_as_is_said():
    """A matte texel, fitted again with a little light added from around the camera."""
    l = lights_about(30)
    n = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, np.sqrt(0.75)], [0.3, -0.6, np.sqrt(0.55)]]).T
    shade, size = np.maximum(l @ n, 0.0), 0.01
    each = Vec3(*(jnp.asarray(l[:, i, None, None], jnp.float32) for i in range(3)))
    toward_us = Vec3(*(jnp.full((1, 1, 1), c, jnp.float32) for c in (0.0, 0.0, 1.0)))
    lights = Lights(each, jnp.ones((30, 1, 1), jnp.float32), toward_us, ds.Blinn())
    seen = jnp.ones(shade.shape, bool)
    model = first_model("squares", every_assumption()[0])
    model = eqx.tree_at(lambda m: m.bounced, model, np.asarray(size, np.float32))

    def at_minimum(y):
        observed = BlockObservations(jnp.asarray(y, jnp.float32), seen, seen, jnp.ones(3, jnp.float32), lights)
        return observed, lowest_state(observed, model)

    observed, state = at_minimum(shade)
    weighing = model.weighing(observed.level)
    here, A = around(observed, model.shape, weighing, state), system(observed, model.shape, weighing, state).A
    said = by_bounce(observed, model, state, A, here)
    moved = at_minimum(shade + size * np.maximum(l[:, 2:], 0.0))[1].n
    turn = moved - state.n
    apart = np.sqrt(np.asarray(dot(turn, turn)))
    np.testing.assert_allclose(said, apart, rtol=0.15, atol=2e-4)
    assert apart[1] > 1e-3


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
    lights = np.stack([np.linspace(-1, 1, 30), 0.1 * np.cos(np.arange(30)), np.ones(30)], -1)
    division = division_of(lights)
    found = calibrated(np.stack([one, one, one, one]), spread, np.ones((4, 4000)), division)
    assert found.errors == pytest.approx(true, rel=0.05)
    assert found.errors * found.times_95 == pytest.approx(1.96 * true, rel=0.05)
    left, right, *by_height = division.parts
    assert (left == ~right).all()
    assert set(np.flatnonzero(left)) in (set(range(15)), set(range(15, 30)))
    assert (by_height[0] == ~by_height[1]).all()
    for views, groups in ((6, 6), (9, 6), (10, 5), (12, 3), (23, 3)):
        few = division_of(np.resize(lights, (views, 3)))
        assert len(few.parts) == few.first == groups
        assert (few.parts.sum(1) >= min(views, 12) - 4).all()
    assert np.isinf(calibrated(np.zeros((4, 5)), np.ones(5), np.ones((4, 5)), division).errors)


@pytest.mark.thorough
def test_a_photograph_that_disagrees_is_named():
    ball = textured_ball(40, noise=0.005, shadows=0.1)
    views = list(ball.views)
    views[7] = ds.View(np.roll(views[7].image, 9, 1), views[7].camera, views[7].mask, lit=views[7].lit)
    maps = ds.fit_texels(facing_us(ball), views, free=FREE, light_error=0.1, match_exposures=False, align=False)
    assert any("views[7]" in note and "disagree" in note for note in maps.notes)
    doubts = np.zeros((6, CELLS * CELLS, 2))
    doubts[..., 1], doubts[2, 5, 0] = 100.0, 90.0
    (place,) = disagreements(doubts)
    assert (place.view, place.cell) == (2, 5)


def with_bounced_light(lights):
    """The textured ball, on whose far side each light bounces from what stands around it."""
    ball = textured_ball(40, lights, noise=0.005)
    x = 2.2 * ((np.arange(40) + 0.5) / 40 - 0.5)
    views = []
    for view, l in zip(ball.views, lights_about(lights), strict=True):
        bounced = 0.3 * np.maximum(0.2 - l[0] * x[None, :] + l[1] * x[:, None], 0.0) * ball.mask
        image = view.image + bounced[..., None] * ball.truth["k_d"].reshape(40, 40, 3)
        views.append(ds.View(image, view.camera, view.mask, lit=view.lit))
    return ball, views


@pytest.mark.thorough
def test_what_repeats_from_light_to_light_is_predicted():
    """Of which a part, a fifth of what the ball shows, is taken for a level unless all is taken as it is exposed."""
    ball, views = with_bounced_light(40)
    how = {"free": FREE, "loss": "cauchy", "light_error": 0.1, "match_exposures": False}
    maps = ds.fit_texels(facing_us(ball), views[::2], **how)
    assert maps.unexplained is not None
    by_model = dataclasses.replace(maps, unexplained=None)
    left_out = views[1::2]
    found, plain = maps.relative_errors(left_out), by_model.relative_errors(left_out)
    assert np.median(found) < 0.8 * np.median(plain)
    assert found.max() < plain.max()
    with pytest.raises(ValueError, match=r"views\[0\] must have the shape of the maps"):
        maps.relative_errors([ds.View(np.zeros((4, 4, 3)), ds.OrthographicCamera((0, 0, 4), shape=(4, 4)))])


@pytest.mark.slow
def test_unexplained_light_is_that_of_lamps_too(tmp_path):
    ball, views = with_bounced_light(20)
    maps = ds.fit_texels(facing_us(ball), views, free=FREE, loss="cauchy", light_error=0.1)
    light = ball.scene.lights[5]
    assert isinstance(light, ds.DirectionalLight)
    toward = -np.asarray(light.direction)
    surface = ds.GBuffer(ball.truth["normal"], ball.truth["normal"], ball.mask)  # a unit sphere
    maps = dataclasses.replace(maps, scene=eqx.tree_at(lambda s: s.objects[0].surface, maps.scene, surface))
    far, near = (
        maps.shade(light),
        maps.shade(ds.PointLight(1e4 * toward, intensity=1.0, attenuation=ds.RadialAttenuation())),
    )
    np.testing.assert_allclose(near, far, atol=2e-3)
    both = maps.shade([light, light])
    assert np.median((both / np.maximum(2.0 * far, 1e-9))[far > 0.05]) == pytest.approx(1.0, abs=1e-6)
    maps.write(tmp_path, suffix=".npy")
    assert maps.unexplained is not None
    found, given = ds.read_maps(tmp_path).unexplained, maps.unexplained.interpolation
    assert found is not None
    np.testing.assert_array_equal(found.parts, maps.unexplained.parts)
    for name in ("toward", "taken", "given", "width"):
        np.testing.assert_array_equal(getattr(found.interpolation, name), getattr(given, name))


def test_residuals_are_interpolated_only_where_they_repeat():
    lights, rng = lights_about(40), np.random.default_rng(0)
    smooth = np.stack([lights @ rng.standard_normal(3) for _ in range(200)], 1)
    noise = 0.1 * rng.standard_normal(smooth.shape)
    assert smoothing_of(lights, noise) is None
    smoothing = smoothing_of(lights[::2], (smooth + noise)[::2])
    assert smoothing is not None
    found = interpolation_of(lights[::2], (smooth + noise)[::2], smoothing, 9)
    shown = np.stack([found.weights(l) for l in lights[1::2]]) @ found.taken @ (smooth + noise)[::2]
    inner = lights[1::2, 2] > 0.6
    assert np.sqrt(np.mean((shown - smooth[1::2])[inner] ** 2)) < 0.1


@pytest.mark.thorough
def test_no_highlight_is_brighter_than_all_that_was_seen(shadowed):
    ball, maps = shadowed
    brightest = max(np.max(np.asarray(view.image)) for view in ball.views)
    assert maps.values["k_s"].max() <= np.float32(brightest)


def real(name):
    """A scene, 48 photographs, the normals and the mask of an object."""
    folder = measured(f"diligent_{name}")
    truth, mask = np.load(folder / "normal_gt.npy"), ds.read_mask(folder / "mask.png")
    return *ds.read_photographs(folder, normals=False), truth, mask


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("ball", 1.9), ("cat", 4.9), ("harvest", 16.5)])
def test_real_objects_have_their_normals(name, most):
    """Plain least squares: 5.2, 8.6 and 31.6 degrees."""
    scene, views, truth, mask = real(name)
    maps = ds.fit_texels(scene, views, free=FREE)
    off = angle(maps.values["normal"], truth)[mask]
    assert maps.highlights
    assert off.mean() < most
    check_stated_angles(maps, off, mask, rank=0.3 if name == "ball" else 0.5)
    check_no_seams(maps, truth, mask)
    check_relighting(scene, views, mask)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("ball", 2.8), ("cat", 8.0), ("harvest", 25.0)])
def test_twelve_photographs_of_a_real_object_are_enough(name, most):
    scene, views, truth, mask = real(name)
    twelve = [views[i] for i in np.round(np.linspace(0, 47, 12)).astype(int)]
    maps = ds.fit_texels(scene, twelve, free=FREE)
    off = angle(maps.values["normal"], truth)[mask]
    assert off.mean() < most
    assert 0.6 < np.mean(off <= maps.errors["normal"][..., 0][mask]) < 0.95


@pytest.fixture(scope="module")
def relief():
    """Photographs rendered of several materials, some of them metals, under cast shadows and bounced light."""
    folder = measured("rti_dome")
    lines = [line.split() for line in (folder / "dirs.lp").read_text().splitlines()[1:] if line.strip()]
    mask = ds.read_mask(folder / "mask.png")
    camera = ds.OrthographicCamera((0, 0, 4), shape=mask.shape, local_viewer=False)
    facing = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (*mask.shape, 3))
    lights = [ds.DirectionalLight(tuple(-float(x) for x in line[1:4])) for line in lines]
    scene = ds.Scene(ds.Object(ds.GBuffer(facing, None, mask), ds.Material(k_d=0.5)), lights)
    views = [ds.View(ds.read_image(folder / line[0], srgb=False), camera, mask, lit=k) for k, line in enumerate(lines)]
    truth = np.asarray(ds.read_image(folder / "normals.png", srgb=False)) * 2.0 - 1.0
    return scene, views, mask, truth / np.linalg.norm(truth, axis=-1, keepdims=True)


@pytest.mark.slow
def test_a_rendered_relief_is_relit(relief):
    check_relighting(*relief[:3])


@pytest.mark.slow
def test_a_rendered_relief_has_its_errors(relief):
    scene, views, mask, truth = relief
    maps = ds.fit_texels(scene, views, free=FREE)
    check_stated_angles(maps, angle(maps.values["normal"], truth)[mask], mask, rank=0.5)
    check_no_seams(maps, truth, mask)


def check_stated_angles(maps, off, mask, rank):
    """The stated angles hold the truth as often as they say, and are larger where normals are worse."""
    stated = maps.errors["normal"][..., 0][mask]
    assert 0.6 < np.mean(off <= stated) < 0.76
    assert 0.9 < np.mean(off <= maps.errors_95["normal"][..., 0][mask]) < 0.98
    assert spearmanr(np.where(np.isfinite(stated), stated, 180.0), off)[0] > rank
    assert off[maps.known[mask]].mean() < off[~maps.known[mask]].mean()


def check_no_seams(maps, truth, mask):
    """Where the status changes, neighbouring normals differ no more from the truth's difference than elsewhere."""
    n, changes, wrong = maps.values["normal"], [], []
    for axis in (0, 1):
        here, there = (np.s_[:-1], np.s_[1:]) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        both = mask[here] & mask[there]
        changes.append((maps.status[here] != maps.status[there])[both])
        wrong.append(np.linalg.norm((n[here] - n[there]) - (truth[here] - truth[there]), axis=-1)[both])
    changes, wrong = np.concatenate(changes), np.concatenate(wrong)
    assert np.median(wrong[changes]) < 1.5 * np.median(wrong[~changes])


def check_relighting(scene, views, mask):
    """Every second photograph predicts the others better than plain least squares does."""
    seen, left_out = views[::2], views[1::2]
    ours = ds.fit_texels(scene, seen, free=FREE).relative_errors(left_out)
    plain = relative_errors_of_least_squares(scene, seen, left_out, mask)
    for of in (np.median, np.mean, np.max):
        assert of(ours) < of(plain)


def relative_errors_of_least_squares(scene, seen, left_out, mask):
    """By three numbers for each texel and channel: k_d times the normal (Woodham 1980)."""

    def lights(views):
        each = [scene.lights[view.lit[0]] for view in views]
        toward = [-np.asarray(one.direction) / np.linalg.norm(one.direction) for one in each]
        strength = [np.broadcast_to(np.asarray(one.intensity), (3,)) for one in each]
        return np.array(toward)[:, None] * np.array(strength)[..., None]  # (views, channels, 3)

    shown = [np.stack([np.asarray(view.image)[mask][:, :3] for view in views]) for views in (seen, left_out)]
    known, new = lights(seen), lights(left_out)
    albedo = [np.linalg.lstsq(known[:, c], shown[0][..., c], rcond=None)[0] for c in range(3)]
    predicted = np.stack([np.maximum(new[:, c] @ albedo[c], 0.0) for c in range(3)], -1)
    return np.sqrt(np.mean((predicted - shown[1]) ** 2, (1, 2)) / np.mean(shown[1] ** 2, (1, 2)))
