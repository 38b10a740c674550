"""Fits from end to end: what is rendered is found again, errors hold up, nothing is compiled twice."""

import concurrent.futures
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scenarios
from changed_fits import with_problem
from scenarios import SIGMA, clean_fit, clean_images, noisy_fit, noisy_images, standard_fit
from synthetic import (
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

# --- what is rendered is found again


def phong() -> tuple[ds.Fit, ds.Scene]:
    return clean_fit(), standard_scene()


def two_objects() -> tuple[ds.Fit, ds.Scene]:
    return scenarios.fit_of_two_objects(), scenarios.two_objects()


def blinn_on_a_gbuffer_under_an_orthographic_camera() -> tuple[ds.Fit, ds.Scene]:
    camera = ds.OrthographicCamera((0, 0, 5), shape=CAMERA.shape, local_viewer=False)
    material = ds.Material(MATERIAL.k_a, MATERIAL.k_d, MATERIAL.k_s, 50, lobe=ds.Blinn())
    scene = ds.Scene(ds.Object(seen_by(camera), material), point_lights()[:3])
    fit = ds.fit(forget(scene), one_light_each(photographs(scene, camera), camera), free=FREE, tied=TIED)
    assert isinstance(fit.material.lobe, ds.Blinn)
    return fit, scene


def directional_lights_in_grey() -> tuple[ds.Fit, ds.Scene]:
    lights = [ds.DirectionalLight(-p, (1.0, 0.9, 0.8)) for p in light_positions()[:3]]
    scene = standard_scene(ds.Material(0.1, 0.6, 0.5, 50), lights)
    views = one_light_each([image.mean(-1) for image in photographs(scene)])
    return ds.fit(forget(scene), views, free="material"), scene


@pytest.mark.parametrize(
    "case",
    [
        phong,
        *(
            pytest.param(case, marks=pytest.mark.thorough)
            for case in (two_objects, blinn_on_a_gbuffer_under_an_orthographic_camera, directional_lights_in_grey)
        ),
    ],
)
def test_noiseless_photographs_give_the_truth_back(case):
    fit, truth = case()
    assert fit.converged
    np.testing.assert_allclose(fit.values, fit.values_in(truth), rtol=1e-6)
    assert fit.rmse < 1e-9


# --- errors hold up


def test_errors_are_as_large_as_the_values_of_noisy_photographs_are_off():
    """e^T S^-1 e is chi-squared with p degrees of freedom, so that its mean over p is 1 +- sqrt(2/(seeds p))."""
    fits = [noisy_fit(seed) for seed in range(24)]
    truth = fits[0].values_in(standard_scene())
    errors = [fit.values - truth for fit in fits]
    p = len(truth)
    mean = np.mean([e @ np.linalg.solve(fit.covariance, e) / p for e, fit in zip(errors, fits, strict=True)])
    assert abs(mean - 1) < 3 * np.sqrt(2 / (len(fits) * p))
    assert max(np.abs(e / fit.plain_errors).max() for e, fit in zip(errors, fits, strict=True)) < 4.5
    np.testing.assert_allclose([fit.rmse for fit in fits], SIGMA, rtol=0.04)
    covered = np.mean([np.abs(e) < 1.96 * fit.errors for e, fit in zip(errors, fits, strict=True)])
    assert 0.92 < covered < 0.985


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


@pytest.mark.thorough
def test_a_second_fit_of_the_same_shapes_traces_nothing(traces):
    jax.jit(lambda x: x + 1)(1.0)
    assert traces  # the listener hears a trace
    told, scene, images = forget(standard_scene()), standard_scene(), clean_images()
    other_mask = np.random.default_rng(0).random(CAMERA.shape) > 0.3
    other_scene = standard_scene(ds.Material(0.3, 0.2, 0.1, 7), point_lights(ds.RadialAttenuation(0.9, 0.2, 0.1)))
    moved = ds.Camera(eye=(0.3, 0.2, 4), fov=34, shape=CAMERA.shape)
    exposed = {"exposure": 2.0, "saturation": 0.6}
    standard_fit(images, told)
    standard_fit(images, scene, exposed)
    standard_fit(images, scene, bounds={"k_s": (0.0, 0.3)})  # a wrong model, which a fit looks at again
    # a wrong outline, beside which a fit sees a part of the object
    standard_fit(images, scene, {"camera": ds.Camera(eye=(0.2, 0.3, 4), fov=34, shape=CAMERA.shape)})
    traces.clear()
    standard_fit(images, told)
    standard_fit(noisy_images(0, 0.1), scene)
    standard_fit(images, other_scene)
    standard_fit(images, scene, bounds={"k_s": (0.0, 0.4), "n_s": (2.0, 30.0)})
    standard_fit(images, scene, {"mask": other_mask})
    standard_fit(images, scene, exposed)
    standard_fit(images, scene, {"camera": moved})
    ds.fit(scene, one_light_each(images)[::-1], free=FREE, tied=TIED)
    assert traces == []


@pytest.mark.thorough
def test_fits_of_fewer_views_have_the_same_programs(traces):
    random = np.random.default_rng(0)
    lights = [ds.DirectionalLight(0.3 * random.standard_normal(3) - (0, 0, 1)) for _ in range(12)]
    scene = ds.Scene(standard_scene().objects, lights)
    photographs = [np.asarray(ds.render(scene, CAMERA, lit=k)) for k in range(12)]
    views = [
        ds.View(image + 0.01 * random.standard_normal(image.shape), CAMERA, lit=k)
        for k, image in enumerate(photographs)
    ]
    free = ("k_d", "k_s", "n_s", "direction")
    ds.fit(scene, views, free=free, light_error=1.0)
    for count in (11, 10):
        traces.clear()
        ds.fit(ds.Scene(scene.objects, lights[:count]), views[:count], free=free, light_error=1.0)
        assert traces == []


def test_progress_prints_nothing_where_there_is_no_terminal_and_compiles_nothing(traces, capfd):
    """Output that goes into a file or a pipe stays clean; the result is the same."""
    standard_fit(clean_images(), progress=True)
    traces.clear()
    shown = standard_fit(clean_images(), progress=True)
    assert traces == []
    assert tuple(capfd.readouterr()) == ("", "")
    np.testing.assert_array_equal(shown.values, clean_fit().values)


# --- float64 whatever the flag, NumPy whatever the input


def arrays(fit: ds.Fit) -> list[Any]:
    return [
        *jax.tree.leaves(fit.scene),
        *(a for a in (fit.values, fit.errors, fit.plain_errors, fit.covariance) if a is not None),
        fit.predict(fit.views[0]).image,
        fit.predict(fit.views[0]).difference,
    ]


def test_everything_is_numpy_float64_to_the_same_digits_whatever_the_flag_which_is_as_it_was():
    fits = []
    for flag in (True, False):
        with jax.enable_x64(flag):
            fits.append(fit := standard_fit(noisy_images()))
            assert jax.config.jax_enable_x64 == flag  # pyright: ignore[reportAttributeAccessIssue]
            assert jnp.asarray(0.5).dtype == (jnp.float64 if flag else jnp.float32)
            assert {type(a) for a in arrays(fit)} == {np.ndarray}
            assert {a.dtype for a in arrays(fit)} == {np.dtype(np.float64)}
            assert fit.determined.dtype == fit.at_bound.dtype == bool
            assert {type(x) for x in (fit.rmse, fit.condition)} == {float}
            n_s = standard_fit(clean_images()).material.n_s
            np.testing.assert_allclose(n_s, 50, rtol=1e-9)  # no float32 has that many digits
    for a, b in zip(*map(arrays, fits), strict=True):
        np.testing.assert_array_equal(a, b)


def test_scenes_and_photographs_of_jax_arrays_and_of_float32_are_taken():
    told = jax.tree.map(jnp.asarray, forget(standard_scene()))
    fit = standard_fit([image.astype(np.float32) for image in clean_images()], told)
    assert {type(a) for a in arrays(fit)} == {np.ndarray}
    np.testing.assert_allclose(fit.values, clean_fit().values, rtol=1e-4)


def test_two_threads_find_what_one_finds():
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        together = list(threads.map(lambda seed: standard_fit(noisy_images(seed)).values, range(6)))
    np.testing.assert_array_equal(together, [noisy_fit(seed).values for seed in range(6)])


# --- what is printed


def test_the_table_says_what_was_found():
    fit = noisy_fit()
    lines = str(fit).splitlines()
    assert lines[0] == f"fit of 8 views, {fit.counts.pixels:,} pixels, {fit.counts.samples:,} samples"
    assert (fit.counts.views, fit.counts.pixels) == (8, 8 * int(np.sum(seen_by(CAMERA).mask)))
    assert fit.counts.samples == 3 * fit.counts.pixels
    assert lines[1].split() == ["parameter", "value", "error"]
    assert fit.names == (*(f"{k}.{c}" for k in ("k_a", "k_d", "k_s") for c in "rgb"), "n_s", "linear", "quadratic")
    for line, name, *numbers in zip(lines[2:], fit.names, fit.values, fit.errors, strict=False):
        label, *cells = line.split()
        assert label == name
        np.testing.assert_allclose([float(cell) for cell in cells], numbers, rtol=0.05)
    assert lines[-2].startswith("errors: for independent noise")
    assert "the 8 views agree" in lines[-2]
    assert lines[-1] == f"RMSE {fit.rmse:.4g}   steps {fit.steps}   condition number {fit.condition:.3g}"
    assert fit.notes == ()


def test_correlations_are_those_of_the_covariance():
    fit = noisy_fit()
    errors = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(fit.correlation, fit.covariance / np.outer(errors, errors), rtol=1e-12)
    np.testing.assert_allclose(errors, fit.plain_errors, rtol=1e-12)


@pytest.mark.thorough
def test_what_stands_at_a_bound_is_marked_and_listed():
    fit = standard_fit(noisy_images(), bounds={"k_s": (0.0, 0.3), "n_s": (60.0, 1e4)})
    marked = {line.split()[0] for line in str(fit).splitlines() if line.endswith("  at a bound")}
    assert marked == {n for n, at, known in zip(fit.names, fit.at_bound, fit.determined, strict=True) if at and known}
    of_k_s = [name.startswith("k_s") for name in fit.names]  # which the photographs want beyond its bound
    assert fit.at_bound[of_k_s].all()
    assert not fit.determined[of_k_s].any()
    assert any("want" in note and "beyond the bound" in note for note in fit.notes)
    assert any("k_s.r, k_s.g and k_s.b" in note and "upper bound 0.3" in note for note in fit.notes)
    assert any("n_s" in note and "lower bound 60" in note for note in fit.notes)
    assert all(f"- {note}" in str(fit).splitlines() for note in fit.notes)
    assert fit.material.k_s.tolist() == [0.3, 0.3, 0.3]
    assert float(fit.material.n_s) == 60.0
    assert not fit.covariance[fit.at_bound].any()
    assert not fit.correlation[fit.at_bound].any()


def test_a_poorly_determined_number_and_a_k_d_above_one_are_pointed_out():
    scene = standard_scene(ds.Material(0.1, (1.5, 0.6, 0.5), 0.001, 50))
    images = noisy(photographs(scene), SIGMA, 0)
    fit = standard_fit(images, scene, bounds={"n_s": (1, 200)})
    assert any("0 within the noise" in note and "k_s" in note for note in fit.notes)
    assert any(note.startswith("k_d.r") and "above 1" in note for note in fit.notes)
    unbounded = standard_fit(images, scene)
    assert not unbounded.determined[[unbounded.names.index(f"k_s.{c}") for c in "rgb"]].any()
    assert any("k_s may be of a highlight that no pixel shows: one with an n_s of 4096" in n for n in unbounded.notes)


def test_k_s_is_not_known_to_be_small_where_the_highlight_is_masked_out():
    """The material of the fit is matte, that of the truth glossy: all pixels that count show the same."""
    lights = [ds.DirectionalLight((x, 0.0, -1.0), 0.9) for x in (0.0, 1.0, -1.0)]
    camera, views = ds.Camera((0.0, 0.0, 5.0), fov=30, shape=(32, 32)), []
    true = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.05, (0.7, 0.3, 0.2), 0.4, 100)), lights)
    seen = ds.intersect(true, camera)
    to_eye = np.array([0.0, 0.0, 5.0]) - np.asarray(seen.position)
    to_eye /= np.linalg.norm(to_eye, axis=-1, keepdims=True)
    for i, light in enumerate(lights):
        half = to_eye - light.direction / np.linalg.norm(light.direction)
        cosine = (np.asarray(seen.normal) * half).sum(-1) / np.linalg.norm(half, axis=-1)
        image = np.asarray(ds.render(true, camera, lit=i)) + np.random.default_rng(i).normal(0, 0.005, (32, 32, 3))
        mask = np.asarray(seen.mask) & (cosine < np.cos(np.deg2rad(15.0)))
        views.append(ds.View(image, camera, mask=mask, lit=i))
    fit = ds.fit(forget(true), views, free=("k_a", "k_d", "k_s", "n_s"))
    known = dict(zip(fit.names, fit.determined, strict=True))
    assert known["k_d.r"]
    assert not any(known[f"k_s.{c}"] for c in "rgb")
    assert any("may be of a highlight that no pixel shows" in note for note in fit.notes)


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
    fit = noisy_fit()
    predictions = [fit.predict(view) for view in fit.views]
    squares = [np.sum(p.difference**2) for p in predictions]
    np.testing.assert_allclose([p.rmse**2 * p.counts.sum() for p in predictions], squares, rtol=1e-9)
    np.testing.assert_allclose(fit.rmse, np.sqrt(sum(squares) / sum(p.counts.sum() for p in predictions)), rtol=1e-9)
    np.testing.assert_allclose(fit.costs[-1], 0.5 * sum(squares), rtol=1e-6)
    assert len(fit.costs) == fit.steps + 1
    assert np.all(np.diff(fit.costs) <= 0)


def test_of_several_objects_none_is_the_material():
    with pytest.raises(ValueError, match=r"2 objects.*Use fit\.scene\.objects\[i\]\.material"):
        _ = with_problem(clean_fit(), scene=scenarios.two_objects()).material


def test_what_is_not_free_stays_as_it_was():
    scene, fit = standard_scene(), clean_fit()
    known = eqx.tree_at(lambda s: s.objects[0].material, fit.scene, scene.objects[0].material)
    for a, b in zip(jax.tree.leaves(known), jax.tree.leaves(scene), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    assert [float(l.attenuation.linear) for l in fit.scene.lights] == [fit.values[-2]] * 8  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.thorough
def test_a_single_view_needs_no_list():
    truth = scenarios.two_objects()
    listed = ds.fit(forget(truth), [ds.View(photograph(truth), CAMERA)], free="material")
    np.testing.assert_array_equal(listed.values, scenarios.fit_of_two_objects().values)
