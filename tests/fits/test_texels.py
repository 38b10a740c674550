"""Fits of texels: the maps of a textured ball, what they say of themselves, and how they hold against SciPy."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from measured import measured
from textured import angle, facing_us, lights_about, textured_ball

import diffshade as ds
from diffshade.texels.coefficients import inverse_diagonal, nonnegative, solve

MAPS = ("k_d", "k_s", "n_s")


def test_colours_and_exponents_of_a_textured_ball_are_found():
    ball = textured_ball(noise=0.005)
    maps = ds.fit_texels(ball.scene, ball.views)
    seen = maps.determined
    assert (
        seen.sum() > 450
    )  # of 591 whose k_s, by its curvature alone, would pass for known; 1.7 % of these did not hold
    assert np.median(np.abs(maps.values["k_d"] / ball.truth["k_d"] - 1)[maps.known]) < 0.01  # required: 2 %
    off = np.abs(maps.values["n_s"][..., 0] / ball.truth["n_s"] - 1)[seen]
    assert np.median(off) < 0.04  # required: 10 %
    assert np.mean(off < 0.1) > 0.85
    assert np.median(np.abs(maps.values["k_s"] / ball.truth["k_s"] - 1)[seen]) < 0.05
    assert (maps.status[~ball.mask] == maps.STATUS.index("outside")).all()


def test_errors_are_honest():
    """68 and 95 % of the values lie within one and two standard errors, with some 50 degrees of freedom."""
    ball = textured_ball()
    maps = ds.fit_texels(ball.scene, ball.views)
    for name, where in (("k_d", maps.known), ("k_s", maps.determined), ("n_s", maps.determined)):
        truth = ball.truth[name].reshape(*ball.mask.shape, -1)
        off = np.abs(maps.values[name] - truth)[where] / maps.errors[name][where]
        assert 0.62 < np.mean(off < 1) < 0.76, name
        assert np.mean(off < 2) > 0.90, name


def test_normals_are_found_with_the_rest():
    ball = textured_ball(noise=0.005)
    maps = ds.fit_texels(facing_us(ball), ball.views, free=(*MAPS, "normal"))
    off = angle(maps.values["normal"], ball.truth["normal"])[maps.known]
    assert np.mean(off) < 0.5  # required
    assert np.median(off) < 0.35
    assert np.median(np.abs(maps.values["k_d"] / ball.truth["k_d"] - 1)[maps.known]) < 0.01
    # the root of two squares of a Gaussian each: its median is 1.18 of either
    predicted = maps.errors["normal"][..., 0][maps.known] / np.sqrt(2.0)
    assert 0.85 < np.median(off / predicted) / 1.18 < 1.15


@pytest.mark.parametrize("loss", ["cauchy", "geman-mcclure"])
def test_shadows_are_outliers(loss):
    ball = textured_ball(shadows=0.1)
    squares = ds.fit_texels(ball.scene, ball.views)
    robust = ds.fit_texels(ball.scene, ball.views, loss=loss)
    off = [np.median(np.abs(m.values["k_d"] / ball.truth["k_d"] - 1)[m.known]) for m in (squares, robust)]
    assert off[0] > 0.04
    assert off[1] < 0.02


def test_clipped_observations_are_left_out():
    ball = textured_ball(noise=0.002)
    level = 0.35
    clipped = [eqx.tree_at(lambda v: v.image, view, np.minimum(view.image, level)) for view in ball.views]
    believed = ds.fit_texels(ball.scene, clipped)
    told = [ds.View(view.image, view.camera, lit=view.lit, saturation=level) for view in clipped]
    left_out = ds.fit_texels(ball.scene, told)
    off = [np.mean(np.abs(m.values["k_d"] / ball.truth["k_d"] - 1)[m.known]) for m in (believed, left_out)]
    assert off[1] < 0.01 < 0.02 < off[0]


def test_a_mask_of_one_view_leaves_its_observations_out():
    ball = textured_ball(noise=0.0)
    half = np.zeros(ball.mask.shape, bool)
    half[:, :24] = True
    spoilt = ds.View(np.where(half[..., None], ball.views[0].image, 9.0), ball.views[0].camera, half, lit=(0,))
    maps = ds.fit_texels(ball.scene, (spoilt, *ball.views[1:]))
    seen = maps.determined
    np.testing.assert_allclose(maps.values["k_d"][seen], ball.truth["k_d"][seen], atol=1e-4)


def test_ambient_light_is_told_from_the_lamps():
    ball = textured_ball(noise=0.002, k_a=0.1)
    maps = ds.fit_texels(ball.scene, ball.views, free=("k_a", *MAPS))
    inner = maps.determined & (maps.errors["k_a"].max(-1) < 0.02)
    assert inner.sum() > 300
    assert np.median(np.abs(maps.values["k_a"] - 0.1)[inner]) < 0.01
    known = ds.fit_texels(ball.scene, ball.views)  # k_a from the scene
    assert np.median(np.abs(known.values["k_d"] / ball.truth["k_d"] - 1)[known.known]) < 0.005


@pytest.mark.parametrize("turning", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_regions_share_one_exponent(turning):
    ball = textured_ball()
    left = (np.arange(48)[None] < 26) & np.ones((48, 48), bool)
    scene, free = (facing_us(ball), (*MAPS, "normal")) if turning else (ball.scene, MAPS)
    maps = ds.fit_texels(scene, ball.views, free=free, regions=left.astype(int))
    for side, truth in ((left, 12.0), (~left, 40.0)):
        where = side & maps.determined
        n_s, error = (np.unique(of["n_s"][..., 0][where]) for of in (maps.values, maps.errors))
        assert len(n_s) == 1
        assert abs(n_s[0] - truth) < 3 * error[0] < 0.05 * truth


def test_every_texel_is_where_scipy_ends_from_the_truth():
    """No texel's cost is above that of SciPy's bounded least squares begun at the truth."""
    ball = textured_ball(size=24, noise=0.01, intensity=np.random.default_rng(1).uniform(0.5, 2.0, (20, 3)))
    maps = ds.fit_texels(ball.scene, ball.views)
    l = lights_about(20)
    I = np.random.default_rng(1).uniform(0.5, 2.0, (20, 3))
    y = np.stack([view.image for view in ball.views])
    checked = 0
    for row, column in np.argwhere(maps.determined)[::9]:
        n = ball.truth["normal"][row, column]
        u, cosine = np.maximum(l @ n, 0.0), 2.0 * (l @ n) * n[2] - l[:, 2]
        log = np.log(np.where((u > 0) & (cosine > 0), np.maximum(cosine, 1e-300), 1e-300))

        def residuals(q, u=u, log=log, of=y[:, row, column]):
            return (I * (q[:3] * u[:, None] + q[3:6] * np.exp(np.exp(q[6]) * log)[:, None]) - of).ravel()

        def here(of, row=row, column=column):
            n_s = np.atleast_1d(of["n_s"][row, column])
            return np.concatenate([of["k_d"][row, column], of["k_s"][row, column], np.log(n_s)])

        low, high = [0.0] * 6 + [np.log(0.1)], [np.inf] * 6 + [np.log(1e4)]
        best = scipy.optimize.least_squares(residuals, here(ball.truth), bounds=(low, high), xtol=1e-12, ftol=1e-12)
        mine = residuals(here({k: v.astype(np.float64) for k, v in maps.values.items()}))
        spread = 2.0 * best.cost / (60 - 7)
        assert 0.5 * mine @ mine < best.cost + 0.02 * spread, (row, column)
        checked += 1
    assert checked > 10


def test_lamps_nearby_of_every_kind_and_a_near_viewer():
    """`render` draws the views, so that positions, falloff, cones and emitters count; the maps draw them again."""
    camera = ds.Camera(eye=(0, 0, 4), fov=30, shape=(24, 24))
    fade = ds.RadialAttenuation(0.4, 0.1, 0.05)
    lights = [
        *(ds.PointLight(2.5 * l, intensity=(2.0, 1.5, 1.0), attenuation=fade) for l in lights_about(6)),
        *(ds.SpotLight(3.0 * l, -l, 3.0, cutoff=40, exponent=2, attenuation=fade) for l in lights_about(4)),
        *(ds.AreaLight(2.0 * l, (0.3, 0, 0), (0, 0.3, 0), 2.0, samples=2) for l in -lights_about(2)),
        ds.DirectionalLight((0.2, -0.3, -1.0), 0.5),
    ]
    material = ds.Material(k_a=0.05, k_d=(0.6, 0.4, 0.2), k_s=0.4, n_s=8, lobe=ds.Blinn(), k_e=0.02)
    scene = ds.Scene(ds.Object(ds.Sphere(), material), lights, ambient=0.5)
    lit = [(i,) for i in range(10)] + [(10, 12), (11, 0), (3, 7)]
    with jax.enable_x64(True):
        images = [2.0 * np.asarray(ds.render(scene, camera, lit=on)) + 0.01 for on in lit]
    views = [ds.View(im, camera, lit=on, exposure=2.0, black=0.01) for im, on in zip(images, lit, strict=True)]
    maps = ds.fit_texels(scene, views, free=("k_d", "k_s", "n_s"))
    good = maps.determined & (maps.errors["n_s"][..., 0] < 0.5)
    assert good.sum() > 100
    np.testing.assert_allclose(maps.values["n_s"][good], 8.0, rtol=1e-3)
    np.testing.assert_allclose(maps.values["k_d"][good], np.broadcast_to((0.6, 0.4, 0.2), (good.sum(), 3)), atol=1e-3)
    again = maps.shade(lit=(0, 11))
    with jax.enable_x64(True):
        drawn = np.asarray(ds.render(scene, camera, lit=(0, 11)))
    np.testing.assert_allclose(again[good], drawn[good], atol=1e-3)


def test_grey_photographs_and_known_noise():
    ball = textured_ball(noise=0.01)
    views = [ds.View(v.image.mean(-1) + 0.0, v.camera, lit=v.lit, noise=0.01 / np.sqrt(3.0)) for v in ball.views]
    maps = ds.fit_texels(ball.scene, views)
    truth = ball.truth["k_d"].mean(-1, keepdims=True)
    assert maps.values["k_d"].shape == (48, 48, 1)
    off = np.abs(maps.values["k_d"] - truth)[maps.known] / maps.errors["k_d"][maps.known]
    assert 0.62 < np.mean(off < 1) < 0.76
    assert 0.9 < np.median(maps.residual[maps.known]) < 1.05  # in units of the noise
    assert maps.shade(lit=0).shape == (48, 48, 3)


def test_the_noise_of_counted_photons_weighs_each_observation():
    ball = textured_ball(noise=0.0)
    rng = np.random.default_rng(3)
    noise = ds.Noise(read=0.002, shot=4e-4)
    views = []
    for v in ball.views:
        spread = np.sqrt(0.002**2 + 4e-4 * np.maximum(v.image, 0.0))
        views.append(ds.View(v.image + spread * rng.standard_normal(v.image.shape), v.camera, lit=v.lit, noise=noise))
    maps = ds.fit_texels(ball.scene, views)
    off = np.abs(maps.values["k_d"] - ball.truth["k_d"])[maps.known] / maps.errors["k_d"][maps.known]
    assert 0.62 < np.mean(off < 1) < 0.76


def test_every_texel_says_what_became_of_it():
    ball = textured_ball(noise=0.005)
    dark = np.ones(ball.mask.shape, bool)
    dark[:, :8] = False  # here one view alone counts
    views = [ball.views[0], *(ds.View(v.image, v.camera, dark, lit=v.lit) for v in ball.views[1:])]
    maps = ds.fit_texels(ball.scene, views)
    name = np.array(maps.STATUS)[maps.status]
    alone = ball.mask.copy()
    alone[:, 8:] = False
    assert alone.any()
    assert (name[alone] == "shadowed").all()
    assert np.isinf(maps.errors["k_d"][alone]).all()
    rim = name == "no highlight seen"
    assert rim.sum() > 100
    assert (maps.values["k_s"][rim] == 0).all()
    assert np.isinf(maps.errors["n_s"][rim]).all()
    assert all(np.isfinite(value).all() for value in maps.values.values())
    assert not any(np.isnan(error).any() for error in maps.errors.values())
    text = str(maps)
    assert "no highlight seen" in text
    assert "shadowed" in text


def test_a_matte_ball_has_no_highlight():
    """Noise is no highlight: of a ball without one, hardly a texel claims it."""
    ball = textured_ball()
    rng = np.random.default_rng(5)
    views = []
    for v, l in zip(ball.views, lights_about(20), strict=True):
        n_l = np.maximum(ball.truth["normal"] @ l, 0.0)[..., None]
        views.append(ds.View(ball.truth["k_d"] * n_l + 0.01 * rng.standard_normal(v.image.shape), v.camera, lit=v.lit))
    maps = ds.fit_texels(ball.scene, views)
    assert maps.determined[ball.mask].mean() < 0.01


def test_it_computes_in_float64_and_leaves_the_flag():
    ball = textured_ball()
    with jax.enable_x64(False):
        maps = ds.fit_texels(ball.scene, ball.views)
        assert jnp.zeros(1).dtype == jnp.float32
    again = ds.fit_texels(ball.scene, ball.views)
    np.testing.assert_array_equal(maps.values["n_s"], again.values["n_s"])


def test_bands_change_nothing():
    ball = textured_ball()
    whole = ds.fit_texels(ball.scene, ball.views)
    banded = ds.fit_texels(ball.scene, ball.views, memory=100_000)
    for name in MAPS:
        np.testing.assert_allclose(banded.values[name], whole.values[name], rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(banded.status, whole.status)


@pytest.mark.parametrize("suffix", [".npy", ".exr", ".png"])
def test_maps_are_written_and_read_back(tmp_path, suffix):
    ball = textured_ball()
    maps = ds.fit_texels(facing_us(ball), ball.views, free=(*MAPS, "normal"))
    written = maps.write(tmp_path / "maps", suffix=suffix)
    assert all(path.is_file() for path in written)
    k_d = ds.read_image(tmp_path / "maps" / f"k_d{suffix}", srgb=False)
    np.testing.assert_allclose(k_d, maps.values["k_d"], atol=1e-5)
    normal = ds.read_image(tmp_path / "maps" / f"normal{suffix}", srgb=False)
    if suffix == ".png":
        normal = 2.0 * normal - 1.0
    np.testing.assert_allclose(normal[ball.mask], maps.values["normal"][ball.mask], atol=1e-4)
    if suffix == ".npy":
        np.testing.assert_array_equal(np.load(tmp_path / "maps" / "n_s_error.npy"), maps.errors["n_s"])
    status = ds.read_image(tmp_path / "maps" / "status.png", srgb=False)[..., 0]
    np.testing.assert_array_equal(np.rint(status * 255), maps.status)
    if suffix != ".png":
        return
    import tomllib

    about = tomllib.loads((tmp_path / "maps" / "maps.toml").read_text())
    n_s = about["scale"]["n_s"] * ds.read_image(tmp_path / "maps" / "n_s.png", srgb=False)
    known = maps.determined & (maps.values["n_s"][..., 0] <= about["scale"]["n_s"])  # the largest .5 % are clipped
    assert known.sum() > 0.99 * maps.determined.sum()
    np.testing.assert_allclose(n_s[known], maps.values["n_s"][known], atol=about["scale"]["n_s"] / 65535)
    assert about["status"]["1"] == "determined"


DILIGENT = "diligent_ball"


def ball_of_photographs(loss: str, step: int) -> tuple[ds.TexelMaps, np.ndarray]:
    """Fit every `step`-th texel of the real ball, normals and all; the angles to the true normals, degrees."""
    folder = measured(DILIGENT)
    scene, views = ds.read_photographs(folder, normals=False)
    surface = ds.read_photographs(folder)[0].objects[0].surface
    assert isinstance(surface, ds.GBuffer)
    mask = np.zeros(surface.mask.shape, bool)
    mask[::step, ::step] = np.asarray(surface.mask)[::step, ::step]
    views = [ds.View(v.image, v.camera, mask, lit=v.lit) for v in views]
    maps = ds.fit_texels(scene, views, free=(*MAPS, "normal"), loss=loss)
    return maps, angle(maps.values["normal"], np.asarray(surface.normal))[mask]


def test_the_real_ball_has_its_normals_within_3_degrees():
    """Plain photometric stereo: 4.2; on the 20-70 % brightest ranks alone: 2.2. Its n_s is not asked for here."""
    maps, off = ball_of_photographs("cauchy", 3)
    assert off.mean() < 2.8  # required: 3
    k_d = np.median(maps.values["k_d"][maps.known], 0)
    np.testing.assert_allclose(k_d, (0.164, 0.138, 0.090), rtol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("loss", "most"), [("squares", 3.0), ("huber", 2.7), ("cauchy", 2.7), ("geman-mcclure", 2.7)])
def test_the_whole_real_ball_has_its_normals_within_3_degrees(loss, most):
    _, off = ball_of_photographs(loss, 1)
    assert off.mean() < most


@pytest.mark.parametrize("size", [1, 2, 3])
def test_nonnegative_least_squares_are_those_of_scipy(size):
    rng = np.random.default_rng(size)
    A, y = rng.standard_normal((200, 8, size)), rng.standard_normal((200, 8))
    G, b = np.einsum("tij,tik->jkt", A, A), np.einsum("tij,ti->jt", A, y)
    x, gain = nonnegative([list(map(jnp.asarray, row)) for row in G], list(map(jnp.asarray, b)))
    for t in range(200):
        expected, norm = scipy.optimize.nnls(A[t], y[t])
        np.testing.assert_allclose([xi[t] for xi in x], expected, atol=1e-10)
        assert abs(y[t] @ y[t] - float(gain[t]) - norm**2) < 1e-10


def test_small_systems_are_solved_and_what_cannot_be_told_apart_has_a_huge_error():
    rng = np.random.default_rng(0)
    J = rng.standard_normal((12, 4))
    A = J.T @ J
    rows = [list(map(jnp.asarray, row)) for row in A]
    np.testing.assert_allclose(
        solve(rows, list(map(jnp.asarray, J.T @ np.ones(12)))), np.linalg.lstsq(J, np.ones(12))[0]
    )
    np.testing.assert_allclose(inverse_diagonal(rows), np.diag(np.linalg.inv(A)), rtol=1e-9)
    J[:, 3] = J[:, 0]
    huge = inverse_diagonal([list(map(jnp.asarray, row)) for row in J.T @ J])
    assert huge[0] > 1e9
    assert huge[3] > 1e9
    assert huge[1] < 10
    assert np.isinf(inverse_diagonal([[jnp.asarray(0.0)]])[0])


def test_photographs_of_any_type_and_byte_order_give_the_same_maps():
    """JAX takes the machine's byte order for granted: what is of another one must not reach it."""
    ball = textured_ball()
    types = [np.dtype(np.float32), np.dtype(">f4"), np.dtype(np.float64), np.dtype(">f8")]
    images = [view.image.astype(np.float32) for view in ball.views]
    native = ds.fit_texels(
        ball.scene, [ds.View(im, v.camera, lit=v.lit) for im, v in zip(images, ball.views, strict=True)]
    )
    mixed = [im.astype(types[i % 4]) for i, im in enumerate(images)]
    maps = ds.fit_texels(
        ball.scene, [ds.View(im, v.camera, lit=v.lit) for im, v in zip(mixed, ball.views, strict=True)]
    )
    np.testing.assert_allclose(maps.values["k_d"], native.values["k_d"], rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(maps.status, native.status)


@pytest.mark.parametrize("free", [("n_s",), ("k_s",), ("k_s", "n_s"), ("k_d",), ("k_a",), ("normal",)])
def test_any_of_the_numbers_can_be_fitted_where_the_others_are_known(free):
    ball = textured_ball(noise=0.002)
    material = ds.Material(k_a=0.0, k_d=(0.4, 0.3, 0.2), k_s=0.5, n_s=20)
    scene = ds.Scene(ds.Object(ball.scene.objects[0].surface, material), ball.scene.lights)
    with jax.enable_x64(True):
        images = [np.asarray(ds.render(scene, v.camera, lit=v.lit)) for v in ball.views]
    rng = np.random.default_rng(0)
    views = [
        ds.View(im + 0.002 * rng.standard_normal(im.shape), v.camera, lit=v.lit)
        for im, v in zip(images, ball.views, strict=True)
    ]
    start = facing_us(ball) if free == ("normal",) else scene
    start = ds.Scene(ds.Object(start.objects[0].surface, material), scene.lights)
    maps = ds.fit_texels(start, views, free=free)
    assert maps.determined.sum() > 300
    for name, truth in (("k_a", 0.0), ("k_d", (0.4, 0.3, 0.2)), ("k_s", 0.5), ("n_s", 20.0)):
        if name in free:
            median = np.median(maps.values[name][maps.determined], 0)
            np.testing.assert_allclose(median, np.broadcast_to(truth, median.shape), rtol=0.02, atol=1e-3)
    if free == ("normal",):
        assert np.median(angle(maps.values["normal"], ball.truth["normal"])[maps.determined]) < 0.5


def test_a_region_of_each_texel_is_a_fit_of_each_texel():
    ball = textured_ball(size=24)
    alone = ds.fit_texels(ball.scene, ball.views)
    each = ds.fit_texels(ball.scene, ball.views, regions=np.arange(24 * 24).reshape(24, 24) + 7)
    both = alone.determined & each.determined
    assert both.sum() > 0.9 * alone.determined.sum()
    for name in MAPS:
        np.testing.assert_allclose(each.values[name][both], alone.values[name][both], rtol=2e-2, atol=1e-3)
        np.testing.assert_allclose(np.median(each.errors[name][both] / alone.errors[name][both]), 1.0, atol=0.08)
    dull = each.status == each.STATUS.index("no highlight seen")
    assert (each.values["n_s"][dull] == 0).all()
    assert np.isinf(each.errors["n_s"][dull]).all()


def test_what_the_views_cannot_tell_apart_is_not_determined():
    """Under one lamp k_a and k_d are one number."""
    ball = textured_ball(noise=0.003)
    rng = np.random.default_rng(0)
    image = 0.1 + ball.truth["k_d"] * np.maximum(ball.truth["normal"] @ lights_about(20)[0], 0.0)[..., None]
    views = [
        ds.View(image + 0.003 * rng.standard_normal(image.shape), ball.views[0].camera, lit=(0,)) for _ in range(8)
    ]
    maps = ds.fit_texels(ball.scene, views, free=("k_a", "k_d"))
    assert not maps.known.any()


def test_a_view_given_twice_counts_once():
    ball = textured_ball()
    once, twice = (ds.fit_texels(ball.scene, ball.views * k) for k in (1, 2))
    np.testing.assert_allclose(twice.errors["k_d"][once.known], once.errors["k_d"][once.known], rtol=1e-3)


def test_a_robust_fit_is_the_same_in_bands():
    ball = textured_ball(shadows=0.1)
    whole = ds.fit_texels(ball.scene, ball.views, loss="huber")
    bands = ds.fit_texels(ball.scene, ball.views, loss="huber", memory=200_000)
    np.testing.assert_allclose(bands.values["k_d"], whole.values["k_d"], rtol=1e-5, atol=1e-6)


def test_grey_photographs_under_coloured_light_know_a_coloured_ambient_term():
    ball = textured_ball(noise=0.002)
    ambient, k_a = np.array([1.0, 0.2, 0.1]), np.array([0.3, 0.0, 0.0])
    scene = ds.Scene(ds.Object(ball.scene.objects[0].surface, ds.Material(k_a=k_a)), ball.scene.lights, ambient=ambient)
    views = [ds.View((v.image + k_a * ambient).mean(-1), v.camera, lit=v.lit) for v in ball.views]
    maps = ds.fit_texels(scene, views)
    truth = ball.truth["k_d"].mean(-1)
    assert np.median(np.abs(maps.values["k_d"][..., 0] / truth - 1)[maps.known]) < 0.01
