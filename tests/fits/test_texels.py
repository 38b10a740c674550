"""Fits of texels: the maps of a textured ball, their status and errors, and a comparison with SciPy."""

from __future__ import annotations

import dataclasses
import tomllib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from bumpy import bumpy, degrees_between
from small_blocks import small_blocks  # noqa: F401
from textured import Ball, angle, facing_us, lights_about, textured_ball

import diffshade as ds
from diffshade.core.words import Note
from diffshade.texels import tiles
from diffshade.texels.linear_systems import inverse_diagonal, nonnegative, solve

MAPS = ("k_d", "k_s", "n_s")
SIZE = 32
COLOURED = np.random.default_rng(1).uniform(0.5, 2.0, (20, 3))  # the lights


@pytest.fixture(scope="module")
def ball() -> Ball:
    return textured_ball(SIZE, intensity=COLOURED)


@pytest.fixture(scope="module")
def maps(ball):
    with jax.enable_x64(False):  # as most users have it
        found = ds.fit_texels(ball.scene, ball.views)
        assert jnp.zeros(1).dtype == jnp.float32
    return found


def off(maps: ds.TexelMaps, ball: Ball, name: str, where: np.ndarray) -> np.ndarray:
    """The relative error of a map."""
    truth = ball.truth[name].reshape(*ball.mask.shape, -1)
    return np.abs(maps.values[name] / np.where(truth == 0, 1, truth) - 1)[where]


def honest(maps: ds.TexelMaps, ball: Ball, name: str, where: np.ndarray) -> bool:
    """Whether 68 and 95 % of the values lie within one and two standard errors of the truth."""
    truth = ball.truth[name].reshape(*ball.mask.shape, -1)
    score = np.abs(maps.values[name] - truth)[where] / maps.errors[name][where]
    return bool(0.6 < np.mean(score < 1) < 0.77 and np.mean(score < 2) > 0.9)


def test_colours_and_exponents_of_a_textured_ball_are_found(ball, maps):
    seen = maps.determined
    assert seen.sum() > 250
    assert np.median(off(maps, ball, "k_d", maps.known)) < 0.01  # required: 2 %
    assert np.median(off(maps, ball, "k_s", seen)) < 0.05
    assert np.median(off(maps, ball, "n_s", seen)) < 0.04  # required: 10 %
    for name in MAPS:
        assert honest(maps, ball, name, maps.known if name == "k_d" else seen), name
    assert 0.009 < np.median(maps.residual[maps.known]) < 0.01  # the noise, but for what the numbers took up of it


def test_a_black_that_is_known_changes_nothing(ball, maps):
    shifted = [ds.View(v.image + 0.05, v.camera, v.mask, lit=v.lit, black=0.05) for v in ball.views]
    with jax.enable_x64(False):
        found = ds.fit_texels(ball.scene, shifted)
    np.testing.assert_array_equal(found.known, maps.known)
    np.testing.assert_allclose(found.values["k_d"][maps.known], maps.values["k_d"][maps.known], rtol=1e-3)


def test_every_texel_is_where_scipy_ends_from_the_truth(ball, maps):
    """No texel's cost is above that of SciPy's bounded least squares begun at the truth."""
    l, y = lights_about(20), np.stack([view.image for view in ball.views])
    ratios = []
    for row, column in np.argwhere(maps.determined)[::19]:
        n = ball.truth["normal"][row, column]
        u, cosine = np.maximum(l @ n, 0.0), 2.0 * (l @ n) * n[2] - l[:, 2]
        log = np.log(np.where((u > 0) & (cosine > 0), np.maximum(cosine, 1e-300), 1e-300))

        def residuals(q, u=u, log=log, of=y[:, row, column]):
            return (COLOURED * (q[:3] * u[:, None] + q[3:6] * np.exp(np.exp(q[6]) * log)[:, None]) - of).ravel()

        def here(of, row=row, column=column):
            n_s = np.atleast_1d(of["n_s"][row, column])
            return np.concatenate([of["k_d"][row, column], of["k_s"][row, column], np.log(n_s)])

        low, high = [0.0] * 6 + [np.log(0.1)], [np.inf] * 6 + [np.log(1e4)]
        best = scipy.optimize.least_squares(residuals, here(ball.truth), bounds=(low, high), xtol=1e-12, ftol=1e-12)
        mine = residuals(here({k: v.astype(np.float64) for k, v in maps.values.items()}))
        assert 0.5 * mine @ mine < best.cost + 0.02 * 2.0 * best.cost / (60 - 7), (row, column)
        freedom = 3 * (u > 0).sum() - 7  # what is dark whatever the numbers are tells nothing of the noise
        covariance = np.linalg.inv(best.jac.T @ best.jac) * 2.0 * best.cost / freedom
        errors = np.concatenate([maps.errors[name][row, column] for name in MAPS])
        errors[-1] /= maps.values["n_s"][row, column, 0]
        ratios.append(errors / np.sqrt(np.diag(covariance)))
    assert len(ratios) > 10
    assert np.min(ratios) > 0.97
    # those of the curvature at the minimum, but for highlights seen on one flank only: there k_s and n_s may be larger
    # than the curvature says
    np.testing.assert_allclose(np.array(ratios)[:, :3], 1.0, atol=0.1)
    np.testing.assert_allclose(np.median(ratios, 0), 1.0, atol=0.1)


def test_every_texel_has_a_status(ball, maps):
    """Only one view counts on the left; only the middle of the ball shows a highlight."""
    dark = np.ones(ball.mask.shape, bool)
    dark[:, :6] = False
    views = [ball.views[0], *(ds.View(v.image, v.camera, dark, lit=v.lit) for v in ball.views[1:])]
    found = ds.fit_texels(ball.scene, views)
    name = np.array(found.STATUS)[found.status]
    alone = ball.mask & ~dark
    assert alone.any()
    assert (name[alone] == "shadowed").all()
    assert (name[~ball.mask] == "outside").all()
    assert np.isinf(found.errors["k_d"][alone]).all()
    np.testing.assert_allclose(found.values["k_d"][dark], maps.values["k_d"][dark], rtol=1e-5)
    rim = name == "no highlight seen"
    assert rim.sum() > 50
    assert (found.values["k_s"][rim] == 0).all()
    assert np.isinf(found.errors["n_s"][rim]).all()
    np.testing.assert_array_equal(found.known, (name == "determined") | rim)
    assert all(np.isfinite(value).all() for value in found.values.values())
    assert not any(np.isnan(error).any() for error in found.errors.values())
    lines = str(found).splitlines()
    assert lines[0].startswith(f"maps of {ball.mask.sum()} texels, 32 x 32")
    assert next(line for line in lines if "no highlight" in line).split()[3] == str(rim.sum())
    assert float(next(line for line in lines if line.startswith("k_d.r")).split()[3]) == pytest.approx(
        np.median(found.values["k_d"][..., 0][found.known]), rel=1e-3
    )


def test_a_matte_ball_has_no_highlight():
    """Noise is not taken for a highlight: hardly a texel of a matte ball gets one."""
    matte = textured_ball(SIZE, intensity=COLOURED, gloss=0.0)
    found = ds.fit_texels(matte.scene, matte.views)
    assert found.determined[matte.mask].mean() < 0.01


def test_masked_and_clipped_observations_are_excluded():
    """Pixels outside a mask and clipped samples do not count; arrays may have another byte order.

    Where they were clipped need not be said, if many samples show it.
    """
    ball = textured_ball(SIZE, noise=0.002, intensity=COLOURED)
    level, half = 0.5, np.zeros(ball.mask.shape, bool)
    half[:, : SIZE // 2] = True
    clipped = [np.minimum(view.image, level) for view in ball.views]
    believed = ds.fit_texels(
        ball.scene, [eqx.tree_at(lambda v: v.image, *pair) for pair in zip(ball.views, clipped, strict=True)]
    )
    clipped[0] = np.where(half[..., None], clipped[0], 9.0)
    views = [
        ds.View(im.astype(">f8"), v.camera, None if i else half, lit=v.lit, saturation=level)
        for i, (im, v) in enumerate(zip(clipped, ball.views, strict=True))
    ]
    identifiable = ds.fit_texels(ball.scene, views)
    assert off(identifiable, ball, "k_d", identifiable.known).mean() < 0.01
    assert off(believed, ball, "k_d", believed.known).mean() < 0.01
    of_one = [np.where(view.image == 1.0, 0.999, view.image) for view in ball.views]
    at_one = [ds.View(np.minimum(im, 1.0), v.camera, lit=v.lit) for im, v in zip(of_one, ball.views, strict=True)]
    whole = ds.fit_texels(ball.scene, at_one)
    assert off(whole, ball, "k_d", whole.known).mean() < 0.01  # 1 exactly is the end of a file's range


def test_bands_and_an_interruption_change_nothing(ball, maps, tmp_path, monkeypatch):
    read, count = tiles.ViewReader.read, iter(range(5))

    def of_band(source, first, last, height):  # a sample for what is usual is read row by row, before the bands
        return last - first > 1

    def stopped(*arguments):
        if of_band(*arguments) and next(count, None) is None:
            raise KeyboardInterrupt
        return read(*arguments)

    monkeypatch.setattr(tiles.ViewReader, "read", stopped)
    with pytest.raises(KeyboardInterrupt):
        ds.fit_texels(ball.scene, ball.views, memory=100_000, out=tmp_path / "maps")
    done = np.load(tmp_path / "maps" / "done.npy")
    assert 0 < done.sum() <= 5 < len(done)
    again = []
    monkeypatch.setattr(
        tiles.ViewReader, "read", lambda *arguments: again.append(of_band(*arguments)) or read(*arguments)
    )
    banded = ds.fit_texels(ball.scene, ball.views, memory=100_000, out=tmp_path / "maps")
    assert sum(again) == len(done) - done.sum()
    about = tomllib.loads((tmp_path / "maps" / "maps.toml").read_text())
    assert about["units"]["k_d_error"] == "those of k_d"
    for name in MAPS:
        np.testing.assert_allclose(banded.values[name], maps.values[name], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(banded.errors[name], maps.errors[name], rtol=1e-5)
    np.testing.assert_array_equal(banded.status, maps.status)


@pytest.fixture(scope="module")
def turned():
    ball = textured_ball(SIZE, noise=0.005)
    return ball, ds.fit_texels(facing_us(ball), ball.views, free=(*MAPS, "normal"))


@pytest.mark.thorough
def test_normals_are_found_with_the_rest(turned):
    ball, maps = turned
    away = angle(maps.values["normal"], ball.truth["normal"])[maps.known]
    assert np.mean(away) < 0.5  # required
    assert np.median(away) < 0.35
    assert np.median(off(maps, ball, "k_d", maps.known)) < 0.01
    # the root of two squares of a Gaussian each: its median is 1.18 of either
    predicted = maps.errors["normal"][..., 0][maps.known] / np.sqrt(2.0)
    assert 0.85 < np.median(away / predicted) / 1.18 < 1.15
    np.testing.assert_allclose(np.linalg.norm(maps.values["normal"][ball.mask], axis=-1), 1.0, atol=1e-6)
    assert "degrees" in str(maps)
    drawn = maps.shade(lit=3)[maps.known] - ball.views[3].image[maps.known]
    assert 0.004 < np.sqrt(np.mean(drawn**2)) < 0.006  # the noise
    rendered = ds.render(maps.as_scene(), maps.camera, lit=3)
    np.testing.assert_array_equal(np.asarray(rendered)[maps.status > 0], maps.shade(lit=3)[maps.status > 0])


@pytest.mark.thorough
def test_errors_of_normals_hold_where_lights_are_all_about(turned):
    ball, maps = turned
    assert maps.notes == ()
    assert maps.known.sum() > 0.8 * ball.mask.sum()
    assert (
        np.mean((angle(maps.values["normal"], ball.truth["normal"]) > 5.0 * maps.errors["normal"][..., 0])[maps.known])
        <= 0.01
    )


AROUND = np.linspace(-1.1, 1.1, 20)
ARC = np.stack([np.sin(AROUND), 0.4 * np.cos(AROUND), 0.9 * np.cos(AROUND)], -1)


@pytest.mark.thorough
@pytest.mark.parametrize(("count", "cone"), [(3, 60.0), (4, 70.0)])
def test_a_normal_that_noise_tilts_towards_a_third_light_is_not_determined(count, cone):
    of = bumpy("matte", count, cone)
    scene = eqx.tree_at(lambda s: s.objects[0].material, of.scene, ds.Material(0.0, 0.5, 0.0))
    maps = ds.fit_texels(scene, of.views, free=("k_d", "normal"))
    off = degrees_between(maps.values["normal"], of.normal)
    lit = (of.normal @ of.to_light.T > 0.0).sum(-1)
    few, enough = of.mask & (lit < 3), of.mask & (lit >= 3)
    assert few.sum() > 100
    assert maps.determined[few].mean() < 0.02
    assert maps.determined[enough].mean() > 0.8
    assert np.quantile(off[enough & maps.determined], 0.95) < 1.0


def test_coplanar_lights_determine_no_normal_and_a_note_names_the_remedy(turned, caplog):
    """The lights are within half a degree of the plane, as people set them up by hand."""
    lights = ARC + 0.005 * np.random.default_rng(3).standard_normal(ARC.shape)
    ball = textured_ball(SIZE, noise=0.005, to_light=lights)
    maps = ds.fit_texels(facing_us(ball), ball.views, free=(*MAPS, "normal"))
    assert not maps.known.any()
    assert np.isinf(maps.errors["normal"][maps.status > 0]).mean() > 0.9
    assert [record.getMessage() for record in caplog.records] == list(maps.notes)
    for words in ("lights of the texels lie in one plane", "Add photographs under lights out of the plane"):
        assert words in maps.notes[0]
    assert maps.notes[0] in f"{maps}"
    doubted = maps.status > 0  # none is determined
    for name in ("k_s", "n_s"):
        assert (maps.values[name] == 0).all()
        assert np.isinf(maps.errors[name][doubted]).all()
    error = maps.errors["normal"]
    assert ((error <= 90.0) | np.isinf(error)).all()


@pytest.mark.thorough
def test_lights_about_one_texel_count_where_they_reach_it(turned):
    """Half of the lights lie in a plane; where a mask leaves only those, nothing is known."""
    even = np.arange(20) % 2 == 0
    ball = textured_ball(SIZE, noise=0.005, to_light=np.where(even[:, None], ARC, lights_about(20)))
    right = np.broadcast_to(np.arange(SIZE) >= SIZE // 2, ball.mask.shape)
    views = [v if i % 2 == 0 else ds.View(v.image, v.camera, right, lit=v.lit) for i, v in enumerate(ball.views)]
    maps = ds.fit_texels(facing_us(ball), views, free=(*MAPS, "normal"))
    assert not maps.known[~right].any()
    assert maps.known[right].mean() > 0.4
    assert len(maps.notes) == 1
    assert "% of the texels" in maps.notes[0]


def test_one_outlier_does_not_scale_a_map(ball, tmp_path):
    """Neither its PNG nor its preview is scaled to it; `maps.toml` lists the units."""
    k_s = np.random.default_rng(0).uniform(0.2, 0.6, (*ball.mask.shape, 1)).astype(np.float32)
    k_s[7, 9] = 31.0
    normal = np.broadcast_to(np.array((0, 0, 1), np.float32), (*ball.mask.shape, 3))
    values = {"k_s": k_s, "n_s": 10.0 * k_s, "normal": normal}
    status = np.ones(ball.mask.shape, np.uint8)
    camera = ball.views[0].camera
    maps = ds.TexelMaps(values, values, status, k_s[..., 0], ball.scene, camera, ("a note",))
    written = maps.write(tmp_path, suffix=".png")
    about = tomllib.loads((tmp_path / "maps.toml").read_text())
    assert about["scale"]["k_s"] == 1.0
    assert about["scale"]["n_s"] == pytest.approx(6.0, rel=0.05)
    assert about["units"]["normal_error"] == "degrees"
    assert about["notes"] == ["a note"]
    assert tmp_path / "k_s_preview.png" in written
    assert np.median(ds.read_image(tmp_path / "k_s_preview.png")) > 0.5
    kept = ds.read_image(tmp_path / "n_s.png", srgb=False) * about["scale"]["n_s"]
    np.testing.assert_allclose(np.delete(kept, 7 * SIZE + 9), np.delete(10.0 * k_s, 7 * SIZE + 9), atol=0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", [".npy", ".exr", ".png"])
def test_maps_are_written_and_read_back(turned, tmp_path, suffix):
    ball, maps = turned
    written = maps.write(tmp_path / "maps", suffix=suffix)
    assert sorted(written) == sorted((tmp_path / "maps").iterdir())
    assert len(written) == (13 if suffix == ".png" else 18)  # 4 of them to look at
    about = tomllib.loads((tmp_path / "maps" / "maps.toml").read_text())
    assert about["status"]["1"] == "determined"
    status = ds.read_image(tmp_path / "maps" / "status.png", srgb=False)[..., 0]
    np.testing.assert_array_equal(np.rint(status * 255), maps.status)
    for name, value in maps.values.items():
        read = ds.read_image(tmp_path / "maps" / f"{name}{suffix}", srgb=False)
        where, scale = maps.trusted(name) & ball.mask, 1.0
        if suffix == ".png":
            scale = about["scale"].get(name, 1.0)
            read = 2.0 * read - 1.0 if name == "normal" else scale * read
            value = value if name == "normal" else np.minimum(value, scale)  # the largest half percent
        else:
            error = ds.read_image(tmp_path / "maps" / f"{name}_error{suffix}", srgb=False)
            np.testing.assert_array_equal(error, maps.errors[name])
        np.testing.assert_allclose(read[where], value[where], atol=1e-4 * scale if suffix == ".png" else 0.0)
    with pytest.raises(ValueError, match=r"\.npy, \.exr, \.png; got '\.jpg'"):
        maps.write(tmp_path / "others", suffix=".jpg")
    assert not (tmp_path / "others").exists()


@pytest.mark.thorough
def test_shadows_are_outliers():
    ball = textured_ball(SIZE, shadows=0.1, intensity=COLOURED)
    squares, robust = (ds.fit_texels(ball.scene, ball.views, loss=loss) for loss in ("squares", "huber"))
    assert np.median(off(squares, ball, "k_d", squares.known)) > 0.04
    assert np.median(off(robust, ball, "k_d", robust.known)) < 0.012
    assert np.median(off(robust, ball, "n_s", robust.determined)) < 0.05


@pytest.mark.thorough
def test_lamps_nearby_a_near_viewer_and_noise_that_is_known():
    """`render` draws the views, so that positions, falloff and emitters count; the maps draw them again."""
    camera = ds.Camera(eye=(0, 0, 4), fov=30, shape=(24, 24))
    fade, on = ds.RadialAttenuation(0.4, 0.1, 0.05), lights_about(12)
    lights = [
        *(ds.PointLight(2.5 * l, intensity=(2.0, 1.5, 1.0), attenuation=fade) for l in on[:10]),
        *(ds.AreaLight(2.0 * l, (0.3, 0, 0), (0, 0.3, 0), 2.0, samples=(2, 1)) for l in -on[10:]),
    ]
    material = ds.Material(k_a=0.05, k_d=(0.6, 0.4, 0.2), k_s=0.4, n_s=8, lobe=ds.Blinn(), k_e=0.02)
    scene = ds.Scene(ds.Object(ds.Sphere(), material), lights, ambient=0.5)
    with jax.enable_x64(True):
        alone = [np.asarray(ds.render(scene, camera, lit=i)) for i in range(12)]
    none = (0.05 * 0.5 + 0.02) * (alone[0] > 0)  # of ambient light and emission
    random, views = np.random.default_rng(0), []
    for lit in [*((i,) for i in range(12)), (10, 3), (3, 7), (11, 0)]:
        image = 2.0 * (sum(alone[i] - none for i in lit) + none) + 0.01
        image += 2e-4 * random.standard_normal(image.shape)
        views.append(ds.View(image, camera, lit=lit, exposure=2.0, black=0.01, noise=2e-4))
    wrong = eqx.tree_at(lambda s: s.objects[0].material.k_a, scene, np.full(3, 0.3))  # what is free is not looked at
    maps = ds.fit_texels(wrong, views, free=("k_a", *MAPS))
    good = maps.determined & (maps.errors["n_s"][..., 0] < 0.5)
    assert good.sum() > 100
    for name, truth in (("k_a", 0.05), ("k_d", (0.6, 0.4, 0.2)), ("k_s", 0.4), ("n_s", 8.0)):
        score = np.abs(maps.values[name] - np.broadcast_to(truth, maps.values[name].shape))[good]
        assert 0.6 < np.mean(score < maps.errors[name][good]) < 0.78, name
    np.testing.assert_allclose(np.median(maps.values["k_d"][good], 0), (0.6, 0.4, 0.2), atol=1e-3)
    assert 0.8 < np.median(maps.residual[good]) < 0.95  # in units of the noise, of which 10 numbers of 45 take up some
    np.testing.assert_allclose(maps.shade(lit=11)[good], alone[11][good], atol=3e-3)


@pytest.mark.thorough
def test_regions_of_grey_photographs_share_one_exponent():
    """Under lamps and ambient light of colour, of which a grey photograph shows the mean."""
    ball = textured_ball(SIZE, intensity=np.array([1.0, 0.8, 0.6]))
    ambient, k_a = np.array([1.0, 0.2, 0.1]), np.array([0.3, 0.0, 0.0])
    scene = ds.Scene(ds.Object(ball.scene.objects[0].surface, ds.Material(k_a=k_a)), ball.scene.lights, ambient=ambient)
    views = [ds.View((v.image + k_a * ambient).mean(-1), v.camera, lit=v.lit) for v in ball.views]
    left = np.broadcast_to(np.mgrid[-1.1:1.1:32j] < 0.1, ball.mask.shape)
    maps = ds.fit_texels(scene, views, regions=5 + 2 * left.astype(int))
    assert maps.values["k_d"].shape == (SIZE, SIZE, 1)
    assert maps.shade(lit=0).shape == (SIZE, SIZE, 3)
    grey = (ball.truth["k_d"] * [1.0, 0.8, 0.6]).mean(-1) / 0.8
    assert np.median(np.abs(maps.values["k_d"][..., 0] / grey - 1)[maps.known]) < 0.01
    for side, truth in ((left, 12.0), (~left, 40.0)):
        n_s, error = (np.unique(of["n_s"][..., 0][side & maps.determined]) for of in (maps.values, maps.errors))
        assert len(n_s) == 1
        assert abs(n_s[0] - truth) < 3 * error[0] < 0.06 * truth


def test_numbers_that_the_views_cannot_separate_are_not_determined(ball):
    """Under one lamp only the sum of k_a and k_d is determined."""
    random = np.random.default_rng(0)
    image = 0.1 + ball.truth["k_d"] * np.maximum(ball.truth["normal"] @ lights_about(20)[0], 0.0)[..., None]
    noisy = [image + 0.003 * random.standard_normal(image.shape) for _ in range(8)]
    views = [ds.View(image, ball.views[0].camera, lit=(0,)) for image in noisy]
    maps = ds.fit_texels(ball.scene, views, free=("k_a", "k_d"))
    assert not maps.known.any()


def test_a_highlight_is_found_where_the_rest_is_known(ball):
    grey = ds.Material(k_a=0.0, k_d=0.3, k_s=0.9, n_s=20)
    scene = ds.Scene(ds.Object(ball.scene.objects[0].surface, grey), ball.scene.lights)
    with jax.enable_x64(True):
        images = [np.asarray(ds.render(scene, v.camera, lit=v.lit)) for v in ball.views[:8]]
    views = [ds.View(image, v.camera, lit=v.lit) for image, v in zip(images, ball.views, strict=False)]
    maps = ds.fit_texels(scene, views, free="k_s")
    assert maps.determined.sum() > 200
    away = np.abs(maps.values["k_s"][maps.determined] - 0.9)
    assert np.quantile(away, 0.9) < 1e-3  # at the rim the highlight is too faint for float32


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


def test_small_systems_are_solved_and_dependent_columns_have_a_huge_error():
    J = np.random.default_rng(0).standard_normal((12, 4))
    rows = [list(map(jnp.asarray, row)) for row in J.T @ J]
    expected = np.linalg.lstsq(J, np.ones(12))[0]
    np.testing.assert_allclose(solve(rows, list(map(jnp.asarray, J.T @ np.ones(12)))), expected)
    np.testing.assert_allclose(inverse_diagonal(rows), np.diag(np.linalg.inv(J.T @ J)), rtol=1e-9)
    J[:, 3] = J[:, 0]
    huge = inverse_diagonal([list(map(jnp.asarray, row)) for row in J.T @ J])
    assert huge[0] > 1e9
    assert huge[3] > 1e9
    assert huge[1] < 10
    assert np.isinf(inverse_diagonal([[jnp.asarray(0.0)]])[0])


@pytest.mark.thorough
@pytest.mark.parametrize("material", ["matte", "glossy"])
def test_highlights_that_are_not_free_are_said(material):
    of = bumpy(material, 12, 40.0)
    dull = dataclasses.replace(of.scene.objects[0], material=ds.Material(k_d=0.5))
    maps = ds.fit_texels(ds.Scene(dull, of.scene.lights), of.views, free=("k_d", "normal"))
    said = [note for note in maps.notes if isinstance(note, Note) and note.kind == "missing highlight"]
    assert bool(said) == (material == "glossy")
    assert all("Free k_s and n_s too" in note for note in said)
