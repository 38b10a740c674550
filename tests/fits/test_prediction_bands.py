"""Bands that hold the samples of photographs that a fit has not seen."""

import dataclasses
from functools import cache

import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.diagnosis.prediction_bands import groups_of
from diffshade.inverse.data.recording import record

CAMERA = ds.OrthographicCamera((0, 0, 4), height=2.2, shape=(20, 20))


def directions(number, seed=2):
    """Directions toward lights in front of the object, drawn at random."""
    random = np.random.default_rng(seed)
    across = random.uniform(-0.7, 0.7, (number, 2))
    return np.column_stack([across, np.ones(number)])


@cache
def problem():
    """A scene that knows the wrong highlight, and photographs of 24 lights with noise and exposures of their own."""
    lights = [ds.DirectionalLight(tuple(-l)) for l in directions(24)]
    true, told = (ds.Material(k_d=(0.6, 0.4, 0.2), k_s=0.3, n_s=n) for n in (20, 60))
    scene = ds.Scene(ds.Object(ds.Sphere(), true), lights)
    random = np.random.default_rng(0)
    views = []
    for i in range(24):
        with jax.enable_x64(True):
            radiance = np.asarray(ds.render(scene, CAMERA, lit=i))
        exposure = float(random.uniform(0.5, 2.0))
        image = exposure * (radiance + 0.01 * random.normal(size=radiance.shape)) + 0.02
        views.append(ds.View(image, CAMERA, lit=i, exposure=exposure, black=0.02))
    return ds.Scene(ds.Object(ds.Sphere(), told), lights), tuple(views)


def fit(views):
    return ds.fit(problem()[0], views, free=("k_d",))


def fit_texels(views):
    return ds.fit_texels(problem()[0], views, free=("k_d",))


@pytest.mark.thorough
@pytest.mark.parametrize("fitting", [fit, fit_texels])
def test_bands_hold_photographs_that_were_left_out(fitting):
    views = problem()[1]
    bands = ds.fit_bands(fitting, views[:16], groups=4)
    assert sorted(i for group in bands.groups for i in group) == sorted([*range(16)] * 2)
    inside = bands.coverage(views[16:])
    assert 0.86 < inside.mean() < 0.94
    assert "90% of the samples of a photograph not seen, from 16 photographs left out in 4 groups" in f"{bands}"
    seen = bands.predict(views[20])
    assert seen.coverage == inside[4]
    plain = bands.result.predict(views[20])
    np.testing.assert_array_equal(seen.image, plain.image)
    assert np.isnan(plain.coverage)
    assert seen.lower is not None
    assert seen.upper is not None
    width = np.median((seen.upper - seen.lower)[seen.counts]) / float(views[20].exposure)
    noise = 2 * 1.64 * 0.01
    assert 0.8 * noise < width < 3 * noise


@pytest.mark.slow
def test_bands_are_in_linear_light_through_the_sensor_that_the_fit_found():
    scene, views = problem()
    vignetting = ds.Vignetting(second=-0.3)
    ends = {"saturation": 1.0, "floor": 0.2}
    coded = []
    for view in views:
        through = dataclasses.replace(view, sensor=ds.Sensor(gamma=1.8, vignetting=vignetting))
        image = record((np.asarray(view.image) - 0.02) / float(view.exposure), through)
        told = ds.Sensor(vignetting=vignetting)
        coded.append(dataclasses.replace(view, image=np.clip(image, 0.2, 1.0), sensor=told, **ends))
    free = ("k_d", "k_s", "n_s", "sensor.gamma")
    bands = ds.fit_bands(lambda some: ds.fit(scene, some, free=free, tied=("sensor",)), coded[:16], groups=4)
    unseen = [dataclasses.replace(view, sensor=None) for view in coded[16:]]
    assert 0.84 < bands.coverage(unseen).mean() < 0.96
    found = bands.predict(unseen[0])
    sample = found.counts & (views[16].image > 0.1)
    np.testing.assert_allclose(found.target[sample], views[16].image[sample], rtol=0.1)
    predicted = np.array([bands.predict(view).image for view in unseen])
    true = np.array([view.image for view in views[16:]])
    bright, dark = true > 1.1, np.broadcast_to(bands.inside[..., None], true.shape) & (true < 0.04)
    assert bright.sum() > 50  # of these the photographs show an end of their range: 1, and 0.2 ** 1.8 = 0.055
    np.testing.assert_allclose(predicted[bright], true[bright], rtol=0.1)
    assert np.median(predicted[dark]) < 0.03
    with pytest.raises(ValueError, match=r"one sensor for all photographs.*tied=\('sensor',\)"):
        ds.fit_bands(lambda some: ds.fit(scene, some, free=("k_d", "sensor.gamma")), coded[:16], groups=4)


def test_groups_are_spread_over_the_lights_and_of_neighbours():
    """No light's nearest neighbours are left out with it as often as by chance, and in other groups more often."""
    toward = directions(24) / np.linalg.norm(directions(24), axis=-1, keepdims=True)
    alike = [[i] for i in range(24)]
    alike[3].append(24)
    groups = groups_of(toward[[*range(24), 3]], alike, 8)
    assert len(groups) == 8
    apart = np.linalg.norm(toward[:, None] - toward, axis=-1)
    nearest = np.argsort(apart, axis=1)[:, 1]
    shares = []
    for kind in (groups[:4], groups[4:]):
        assert sorted(i for group in kind for i in group) == list(range(25))
        assert any({3, 24} <= set(group) for group in kind)
        assert {len(group) for group in kind} <= {6, 7}
        group_of = {i: k for k, group in enumerate(kind) for i in group}
        shares.append(np.mean([group_of[i] == group_of[j] for i, j in enumerate(nearest)]))
    assert shares[0] < 0.1
    assert shares[1] > 0.6
    assert sorted(i for group in groups_of(toward, alike[:3], 3) for i in group) == [0, 1, 2]


def test_neighbours_are_quarters_of_any_number_of_lights():
    """Corners of 3, 4, 3 and 4 lights stay apart."""
    corners = [np.array([x, y]) for x in (-1.0, 0.9) for y, number in ((-0.8, 3), (0.8, 4)) for _ in range(number)]
    across = np.array(corners) + 0.1 * np.random.default_rng(0).random((14, 2))
    toward = np.column_stack([across, 0.1 * np.ones(14)])
    groups = groups_of(toward, [[i] for i in range(14)], 8)
    assert set(groups[4:]) == {(0, 1, 2), (3, 4, 5, 6), (7, 8, 9), (10, 11, 12, 13)}


def test_what_can_have_no_bands_is_refused():
    views = problem()[1]
    with pytest.raises(ValueError, match="at least 8 different lights; got 7"):
        ds.fit_bands(fit_texels, views[:7])
    with pytest.raises(ValueError, match=r"level must be from 0\.5 to 0\.95; got 1\.5"):
        ds.fit_bands(fit, views, level=1.5)
    with pytest.raises(ValueError, match="groups must be a whole number of at least 2; got 1"):
        ds.fit_bands(fit, views, groups=1)
    other = dataclasses.replace(views[5], camera=ds.OrthographicCamera((0, 0, 4), height=2.0, shape=(20, 20)))
    with pytest.raises(ValueError, match=r"one camera, all grey or all in colour; views\[5\] differs"):
        ds.fit_bands(fit, [*views[:5], other])
    with pytest.raises(TypeError, match="fit must return a Fit or TexelMaps; got NoneType"):
        ds.fit_bands(lambda _: None, views)  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
@pytest.mark.parametrize("fitting", [fit, fit_texels])
def test_a_report_shows_how_often_photographs_that_were_left_out_lie_inside(fitting, tmp_path):
    views = problem()[1]
    bands = ds.fit_bands(fitting, views[:16], groups=4)
    ds.write_report(tmp_path / "page.html", bands, held_out=views[16:20])
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    inside = bands.coverage(views[16:20])
    held = f"hold {inside.mean():.0%} of the samples of these photographs, and {inside.min():.0%} of those of the worst"
    assert held in page
    assert page.count("% inside bands") == 4
    with pytest.raises(ValueError, match="bands are reported beside photographs; got no held_out"):
        ds.write_report(tmp_path / "other.html", bands)
    assert not (tmp_path / "other.html").exists()
