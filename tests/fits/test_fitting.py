"""Fits from end to end: what is rendered is found again, errors hold up, nothing is compiled twice."""

import concurrent.futures
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from synthetic import (
    ATTENUATION,
    CAMERA,
    FREE,
    MATERIAL,
    TIED,
    forget,
    light_positions,
    noisy,
    one_light_each,
    photograph,
    photographs,
    point_lights,
    seen_by,
    standard_scene,
)

import diffshade as ds

THREE = point_lights()[:3]


class Case(NamedTuple):
    """A scene, what a fit is told of it, its photographs, and what is to be found."""

    truth: ds.Scene
    told: ds.Scene
    views: Sequence[ds.View]
    free: tuple[str, ...] = FREE
    tied: tuple[str, ...] = TIED

    def fit(self, **options: Any) -> ds.Fit:
        return ds.fit(self.told, self.views, free=self.free, tied=self.tied, **options)


def same_but(scene: ds.Scene, where, *values) -> ds.Scene:
    return eqx.tree_at(where, scene, [np.asarray(v, np.float64) for v in values])


# --- what is rendered is found again


def phong() -> Case:
    scene = standard_scene()
    return Case(scene, forget(scene), one_light_each(photographs(scene)))


def blinn_on_a_gbuffer_under_an_orthographic_camera() -> Case:
    camera = ds.OrthographicCamera((0, 0, 5), shape=CAMERA.shape, local_viewer=False)
    material = ds.Material(MATERIAL.k_a, MATERIAL.k_d, MATERIAL.k_s, 50, lobe=ds.Blinn())
    scene = ds.Scene(ds.Object(seen_by(camera), material), THREE)
    return Case(scene, forget(scene), one_light_each(photographs(scene, camera), camera))


def directional_lights_in_grey() -> Case:
    lights = [ds.DirectionalLight(-p, (1.0, 0.9, 0.8)) for p in light_positions()[:3]]
    scene = standard_scene(ds.Material(0.1, 0.6, 0.5, 50), lights)
    views = one_light_each([image.mean(-1) for image in photographs(scene)])
    return Case(scene, forget(scene), views, ("material",), ())


def spots_of_unknown_shape() -> Case:
    lights = [ds.SpotLight(p, -p + 0.1, 3.0, 25.0, 4.0, ATTENUATION, softness=15.0) for p in light_positions()[:3]]
    truth = standard_scene(lights=lights)
    told = same_but(
        truth, lambda s: [x for l in s.lights for x in (l.exponent, l.cutoff, l.softness)], *[1.0, 22.0, 10.0] * 3
    )
    shape = ("exponent", "cutoff", "softness")
    return Case(truth, forget(told), one_light_each(photographs(truth)), ("k_a", "k_d", "k_s", "n_s", *shape), shape)


def two_objects() -> Case:
    other = ds.Material(0.2, (0.2, 0.5, 0.7), 0.3, 20, lobe=ds.Blinn())
    spheres = ds.Sphere((-0.5, 0, 0), 0.6), ds.Sphere((0.5, 0.2, 0.3), 0.5)
    scene = ds.Scene([ds.Object(spheres[0], MATERIAL), ds.Object(spheres[1], other)], THREE[0])
    return Case(scene, forget(scene), [ds.View(photograph(scene), CAMERA)], ("material",), ())


def sphere_of_unknown_place_and_size() -> Case:
    ball = lambda s: (s.objects[0].surface.center, s.objects[0].surface.radius)  # noqa: E731
    truth = same_but(standard_scene(lights=THREE), ball, (0.02, -0.03, 0.04), 1.02)
    told = same_but(truth, ball, (0.05, -0.04, 0.06), 0.95)
    mask = seen_by(CAMERA, truth.objects[0].surface).mask
    views = one_light_each(photographs(truth), mask=mask)
    return Case(truth, forget(told), views, ("k_a", "k_d", "k_s", "n_s", "center", "radius"), ())


def lights_of_unknown_position() -> Case:
    truth = standard_scene(lights=[ds.PointLight(p + 0.1, 1.0, ATTENUATION) for p in light_positions()[:3]])
    told = same_but(truth, lambda s: [l.position for l in s.lights], *np.add(light_positions()[:3], (0.4, -0.2, 0.5)))
    views = one_light_each(photographs(truth))
    return Case(truth, forget(told), views, ("k_a", "k_d", "k_s", "n_s", "position"), ())


CASES = [
    phong,
    blinn_on_a_gbuffer_under_an_orthographic_camera,
    directional_lights_in_grey,
    spots_of_unknown_shape,
    two_objects,
    sphere_of_unknown_place_and_size,
    lights_of_unknown_position,
]


@pytest.mark.parametrize("case", CASES)
def test_noiseless_photographs_give_the_truth_back(case):
    truth, told, views, free, tied = case()
    fit = ds.fit(told, views, free=free, tied=tied)
    assert fit.converged
    np.testing.assert_allclose(fit.values, fit.values_in(truth), rtol=1e-6)
    assert fit.rmse < 1e-9


# --- errors hold up

SHARP = ds.Camera(eye=(0, 0, 4), fov=32, shape=(64, 64))
SEEDS = 50


@pytest.fixture(scope="module")
def noisy_fits() -> list[ds.Fit]:
    scene = standard_scene()
    clean = photographs(scene, SHARP)
    return [
        ds.fit(forget(scene), one_light_each(noisy(clean, 0.005, seed), SHARP), free=FREE, tied=TIED)
        for seed in range(SEEDS)
    ]


def test_the_plain_covariance_is_that_of_many_noisy_fits(noisy_fits):
    """e^T S^-1 e is chi-squared with p degrees of freedom, so its mean over p is 1 +- sqrt(2/(SEEDS p))."""
    truth = noisy_fits[0].values_in(standard_scene())
    p = len(truth)
    errors = [fit.values - truth for fit in noisy_fits]
    mean = np.mean([e @ np.linalg.solve(fit.covariance, e) / p for e, fit in zip(errors, noisy_fits, strict=True)])
    worst = max(np.abs(e / fit.plain_errors).max() for e, fit in zip(errors, noisy_fits, strict=True))
    print(f"mean {mean:.3f}, worst |z| {worst:.2f}")
    assert abs(mean - 1) < 3 * np.sqrt(2 / (SEEDS * p))
    assert worst < 4.5


def test_the_jackknife_covers_the_truth_as_often_as_it_says(noisy_fits):
    """With t of views - 1 degrees of freedom. Nominally 95 %; 600 correlated numbers scatter by some per cent."""
    truth = noisy_fits[0].values_in(standard_scene())
    t = scipy.stats.t.ppf(0.975, 7)
    inside = [np.abs(fit.values - truth) < t * fit.errors for fit in noisy_fits]
    print(f"coverage {np.mean(inside):.3f}")
    assert 0.92 < np.mean(inside) < 0.99


def test_the_rmse_is_the_noise(noisy_fits):
    np.testing.assert_allclose([fit.rmse for fit in noisy_fits], 0.005, rtol=0.02)


# --- nothing is compiled twice


@pytest.fixture
def traces():
    """The names of the functions that JAX traces."""
    seen: list[str] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == "/jax/core/compile/jaxpr_trace_duration":
            seen.append(str(kwargs.get("fun_name")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield seen
    jax.monitoring.unregister_event_duration_listener(listen)


def test_the_listener_hears_a_trace(traces):
    jax.jit(lambda x: x + 1)(1.0)
    assert traces


def test_a_second_fit_of_the_same_shapes_traces_nothing(traces):
    scene = standard_scene()
    images = photographs(scene)
    ds.fit(forget(scene), one_light_each(images), free=FREE, tied=TIED)
    other_mask = np.random.default_rng(0).random(CAMERA.shape) > 0.3
    other_scene = standard_scene(ds.Material(0.3, 0.2, 0.1, 7), point_lights(ds.RadialAttenuation(0.9, 0.2, 0.1)))
    moved = ds.Camera(eye=(0.3, 0.2, 4), fov=34, shape=CAMERA.shape)
    ds.fit(scene, one_light_each(images, exposure=2.0, saturation=0.6), free=FREE, tied=TIED)
    traces.clear()
    ds.fit(forget(scene), one_light_each(images), free=FREE, tied=TIED)
    ds.fit(scene, one_light_each(noisy(images, 0.1, 0)), free=FREE, tied=TIED)
    ds.fit(other_scene, one_light_each(images), free=FREE, tied=TIED)
    ds.fit(scene, one_light_each(images), free=FREE, tied=TIED, bounds={"k_s": (0.0, 0.4), "n_s": (2.0, 30.0)})
    ds.fit(scene, one_light_each(images, mask=other_mask), free=FREE, tied=TIED)
    ds.fit(scene, one_light_each(images, exposure=2.0, saturation=0.6), free=FREE, tied=TIED)
    ds.fit(scene, one_light_each(images, moved), free=FREE, tied=TIED)
    ds.fit(scene, one_light_each(images[::-1]), free=FREE, tied=TIED)
    assert traces == []


def test_a_second_progress_line_compiles_nothing_either(traces):
    case = phong()
    case.fit(progress=True)
    traces.clear()
    case.fit(progress=True)
    assert traces == []


# --- float64 whatever the flag, NumPy whatever the input


def arrays(fit: ds.Fit) -> list[Any]:
    return [
        *jax.tree.leaves(fit.scene),
        *(a for a in (fit.values, fit.errors, fit.plain_errors, fit.covariance) if a is not None),
        fit.predict(fit.views[0]).image,
        fit.predict(fit.views[0]).difference,
    ]


@pytest.mark.parametrize("flag", [True, False])
def test_everything_is_numpy_float64_and_the_flag_is_as_it_was(flag):
    with jax.enable_x64(flag):
        fit = phong().fit()
        assert jax.config.jax_enable_x64 == flag  # pyright: ignore[reportAttributeAccessIssue]
        assert jnp.asarray(0.5).dtype == (jnp.float64 if flag else jnp.float32)
        found = arrays(fit)
        assert {type(a) for a in found} == {np.ndarray}
        assert {a.dtype for a in found} == {np.dtype(np.float64)}
        assert fit.determined.dtype == fit.at_bound.dtype == bool
        assert {type(x) for x in (fit.rmse, fit.condition)} == {float}
        np.testing.assert_allclose(fit.material.n_s, 50, rtol=1e-9)  # no float32 has that many digits


def test_the_flag_changes_no_digit():
    fits = []
    for flag in (True, False):
        with jax.enable_x64(flag):
            scene = standard_scene()
            fits.append(ds.fit(scene, one_light_each(noisy(photographs(scene), 0.005, 0)), free=FREE, tied=TIED))
    for a, b in zip(*map(arrays, fits), strict=True):
        np.testing.assert_array_equal(a, b)


def test_scenes_and_photographs_of_jax_arrays_and_of_float32_are_taken():
    case = phong()
    told = jax.tree.map(jnp.asarray, case.told)
    views = [ds.View(view.image.astype(np.float32), view.camera, lit=view.lit) for view in case.views]
    fit = ds.fit(told, views, free=FREE, tied=TIED)
    assert {type(a) for a in arrays(fit)} == {np.ndarray}
    np.testing.assert_allclose(fit.values, fit.values_in(case.truth), rtol=1e-4)


def test_two_threads_find_what_one_finds():
    scene = standard_scene()
    clean = photographs(scene)

    def values(seed: int) -> np.ndarray:
        return ds.fit(scene, one_light_each(noisy(clean, 0.005, seed)), free=FREE, tied=TIED).values

    alone = [values(seed) for seed in range(6)]
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        together = list(threads.map(values, range(6)))
    np.testing.assert_array_equal(together, alone)


# --- what is printed


def test_the_table_says_what_was_found():
    fit = ds.fit(standard_scene(), one_light_each(noisy(photographs(standard_scene()), 0.005, 0)), free=FREE, tied=TIED)
    lines = str(fit).splitlines()
    assert lines[0] == f"fit of 8 views, {fit.counts.pixels:,} pixels, {fit.counts.samples:,} samples"
    assert lines[1].split() == ["parameter", "value", "error", "plain", "error"]
    assert fit.names == (*(f"{k}.{c}" for k in ("k_a", "k_d", "k_s") for c in "rgb"), "n_s", "linear", "quadratic")
    assert fit.errors is not None
    for line, name, *numbers in zip(lines[2:], fit.names, fit.values, fit.errors, fit.plain_errors, strict=False):
        label, *cells = line.split()
        assert label == name
        np.testing.assert_allclose([float(cell) for cell in cells], numbers, rtol=0.05)
    assert lines[-1] == f"RMSE {fit.rmse:.4g}   steps {fit.steps}   condition number {fit.condition:.3g}"
    assert fit.notes == ()


def test_what_stands_at_a_bound_is_marked_and_listed():
    views = one_light_each(noisy(photographs(standard_scene()), 0.005, 0))
    fit = ds.fit(standard_scene(), views, free=FREE, tied=TIED, bounds={"k_s": (0.0, 0.3), "n_s": (60.0, 1e4)})
    marked = {line.split()[0] for line in str(fit).splitlines() if line.endswith("  at a bound")}
    assert marked == {n for n, at, known in zip(fit.names, fit.at_bound, fit.determined, strict=True) if at and known}
    assert marked >= {"k_s.r", "k_s.g", "k_s.b", "n_s"}
    assert "- k_s.r, k_s.g and k_s.b are at their upper bound 0.3." in str(fit).splitlines()
    assert "- n_s is at its lower bound 60." in str(fit).splitlines()
    assert fit.material.k_s.tolist() == [0.3, 0.3, 0.3]
    assert float(fit.material.n_s) == 60.0


@pytest.mark.parametrize("clipped", ["hinge", "leave out"])
def test_clipped_samples_are_no_measurements_and_are_counted(clipped):
    """An 8-bit file's highlight: at 1 it is clipped, not measured. Left in, n_s and k_s come out far too low."""
    bright = standard_scene(ds.Material(MATERIAL.k_a, MATERIAL.k_d, 1.2, 50))
    views = one_light_each([np.minimum(image, 1.0) for image in photographs(bright)])
    number = sum(int((view.image == 1.0).sum()) for view in views)
    fit = ds.fit(forget(bright), views, free=FREE, tied=TIED, clipped=clipped)
    assert number > 10
    if clipped == "hinge":
        assert (fit.counts.clipped, fit.counts.left_out) == (number, 0)
        assert f"- {number} samples at an end of the sensor's range, taken to be that or beyond." in str(fit)
    else:
        assert (fit.counts.clipped, fit.counts.left_out) == (0, number)
        assert f"- {number} samples at an end of the sensor's range left out, with their pixels." in str(fit)
    np.testing.assert_allclose(fit.values, fit.values_in(bright), rtol=1e-6)


def test_a_poorly_determined_number_and_a_k_d_above_one_are_pointed_out():
    scene = standard_scene(ds.Material(0.1, (1.5, 0.6, 0.5), 0.001, 50))
    fit = ds.fit(scene, one_light_each(noisy(photographs(scene), 0.005, 0)), free=FREE, tied=TIED)
    assert any("0 within the noise" in note and "k_s" in note for note in fit.notes)
    assert any(note.startswith("k_d.r") and "above 1" in note for note in fit.notes)


# --- what a fit gives


def test_a_prediction_is_the_photograph_without_noise_whatever_its_kind():
    scene = standard_scene(ds.Material(0.1, 0.6, 0.5, 50))
    views = one_light_each(photographs(scene))
    views[1] = grey = ds.View(0.5 * views[1].image.mean(-1), CAMERA, lit=1, exposure=0.5)
    fit = ds.fit(forget(scene), views, free=FREE, tied=TIED)
    held_out = ds.View(photograph(scene), CAMERA, mask=np.random.default_rng(0).random(CAMERA.shape) > 0.5)
    for view, shape in ((grey, (24, 24, 1)), (held_out, (24, 24, 3))):
        prediction = fit.predict(view)
        assert prediction.image.shape == shape
        np.testing.assert_allclose(prediction.image, prediction.target, atol=1e-9)
        assert prediction.rmse < 1e-9
        np.testing.assert_array_equal(prediction.difference[~prediction.counts], 0.0)


def test_the_rmse_of_a_fit_is_that_of_its_predictions():
    scene = standard_scene()
    fit = ds.fit(scene, one_light_each(noisy(photographs(scene), 0.02, 0)), free=FREE, tied=TIED)
    predictions = [fit.predict(view) for view in fit.views]
    squares = sum(np.sum(p.difference**2) for p in predictions)
    np.testing.assert_allclose(fit.rmse, np.sqrt(squares / sum(p.counts.sum() for p in predictions)), rtol=1e-9)
    np.testing.assert_allclose(fit.costs[-1], 0.5 * squares, rtol=1e-6)
    assert len(fit.costs) == fit.steps + 1
    assert np.all(np.diff(fit.costs) <= 0)


def test_the_material_is_that_of_the_only_object():
    assert isinstance(blinn_on_a_gbuffer_under_an_orthographic_camera().fit().material.lobe, ds.Blinn)
    with pytest.raises(ValueError, match=r"^this scene has 2 objects, so .* Use fit\.scene\.objects\[i\]\.material\.$"):
        _ = two_objects().fit().material


def test_what_is_not_free_stays_as_it_was():
    scene = standard_scene()
    fit = ds.fit(scene, one_light_each(photographs(scene)), free=FREE, tied=TIED)
    known = eqx.tree_at(lambda s: s.objects[0].material, fit.scene, scene.objects[0].material)
    for a, b in zip(jax.tree.leaves(known), jax.tree.leaves(scene), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    assert [float(l.attenuation.linear) for l in fit.scene.lights] == [fit.values[-2]] * 8  # pyright: ignore[reportAttributeAccessIssue]


def test_a_single_view_needs_no_list():
    case = two_objects()
    alone = ds.fit(case.told, case.views[0], free=case.free, tied=case.tied)
    np.testing.assert_array_equal(alone.values, case.fit().values)


def test_progress_prints_nothing_where_there_is_no_terminal(capfd):
    """Output that goes into a file or a pipe stays clean; the result is the same."""
    case = phong()
    shown, silent = case.fit(progress=True), case.fit()
    assert tuple(capfd.readouterr()) == ("", "")
    np.testing.assert_array_equal(shown.values, silent.values)
