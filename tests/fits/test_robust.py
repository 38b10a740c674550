"""Samples that are not what least squares expects: clipped, outliers, and noise that depends on the level."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from synthetic import CAMERA, FREE, TIED, forget, noisy, one_light_each, photographs, seen_by, standard_scene

import diffshade as ds
from diffshade.inverse.views import find_samples

CLOSE = ds.Camera(eye=(0, 0, 4), fov=32, shape=(64, 64))
INSIDE = np.asarray(seen_by(CLOSE).mask)
SCENE = standard_scene()
SIGMA = 0.005


def fit(images: Sequence[np.ndarray], camera: ds.Camera = CLOSE, *, view: Any = None, **options: Any) -> ds.Fit:
    return ds.fit(forget(SCENE), one_light_each(images, camera, **(view or {})), free=FREE, tied=TIED, **options)


def off(fit: ds.Fit, truth: ds.Scene = SCENE) -> np.ndarray:
    """Return how far each value is from the truth."""
    return fit.values - fit.values_in(truth)


# --- clipped samples

SHINY = standard_scene(ds.Material(0.1, 0.6, 0.8, 50))
CLIPPED_ARE = {
    "hinge": {},
    "tobit": {"noise": SIGMA},
    "leave out": {},
}


def clipped_highlights() -> tuple[list[np.ndarray], float]:
    """Return photographs of which the brightest 0.7 % of samples are clipped, and the level."""
    images = noisy(photographs(SHINY, CLOSE), SIGMA, 0)
    level = float(np.quantile(np.concatenate([image[INSIDE].ravel() for image in images]), 0.993))
    return [np.minimum(image, level) for image in images], level


@pytest.mark.parametrize("clipped", CLIPPED_ARE)
def test_clipped_highlights_leave_the_exponent_within_a_percent(clipped):
    images, level = clipped_highlights()
    found = fit(images, view={"saturation": level, **CLIPPED_ARE[clipped]}, clipped=clipped)
    counts = found.counts
    assert (counts.left_out if clipped == "leave out" else counts.clipped) == sum(
        int((image[INSIDE] >= level).sum()) for image in images
    )
    assert sum(note.count("at an end of the sensor's range") for note in found.notes) == 1
    assert float(found.material.n_s) == pytest.approx(50, rel=0.01)
    assert np.abs(off(found, SHINY) / found.plain_errors).max() < 4.5
    assert found.rmse == pytest.approx(1.0 if clipped == "tobit" else SIGMA, rel=0.02)


def test_clipped_highlights_that_are_taken_for_the_truth_flatten_the_highlight():
    images, _ = clipped_highlights()
    found = fit(images, view={"saturation": np.inf})
    assert float(found.material.n_s) < 40
    assert found.counts.clipped == found.counts.left_out == 0


def test_samples_clipped_at_the_floor_say_only_that_the_truth_is_below():
    black = -0.09  # so that what is in shadow is about 0, on both sides
    images = [np.maximum(image, 0.0) for image in noisy([i + black for i in photographs(SCENE, CLOSE)], SIGMA, 0)]
    taken = {"black": black}
    ignored = fit(images, view=taken)
    hinge = fit(images, view={**taken, "floor": 0.0})
    tobit = fit(images, view={**taken, "floor": 0.0, "noise": SIGMA}, clipped="tobit")
    assert np.abs(off(ignored)[:9]).max() > 0.02
    assert np.abs(off(hinge)[:9]).max() < 0.005
    assert hinge.counts.clipped == sum(int((image[INSIDE] <= 0.0).sum()) for image in images) > 0
    # a hinge takes what noise lifts above the floor as it is; the likelihood of a censored sample does not
    assert np.abs(off(tobit) / tobit.plain_errors).max() < 4.5
    assert np.abs(off(hinge)[:3]).max() > np.abs(off(tobit)[:3]).max()


# --- outliers


@pytest.mark.parametrize("loss", ["huber", "cauchy", "geman-mcclure"])
def test_a_robust_loss_finds_the_material_through_shadows_and_costs_little_where_there_are_none(loss):
    clean = noisy(photographs(SCENE, CLOSE), SIGMA, 0)
    random = np.random.default_rng(1)
    shadowed = [
        np.where(random.random(i.shape[:2])[..., None] < 0.1, i * random.uniform(0.0, 0.6, (*i.shape[:2], 1)), i)
        for i in clean
    ]
    assert np.abs(off(fit(shadowed))[:9]).max() > 0.02
    robust = fit(shadowed, loss=loss)
    assert robust.converged
    assert np.abs(off(robust)[:9]).max() < 0.005
    assert float(robust.likelihood.sigma) == pytest.approx(SIGMA, rel=0.25)

    squares, alone = fit(clean), fit(clean, loss=loss)
    assert np.abs(off(alone) / alone.plain_errors).max() < 4.5
    np.testing.assert_allclose(alone.plain_errors, squares.plain_errors, rtol=0.1)
    assert (alone.plain_errors > squares.plain_errors).all()  # 95 % as efficient, and said so
    assert float(alone.likelihood.sigma) == pytest.approx(SIGMA, rel=0.02)


# --- noise


@pytest.mark.slow
def test_weights_by_the_noise_of_counted_photons_make_the_errors_honest():
    noise, clean, seeds = ds.Noise(read=0.001, shot=0.004), photographs(SCENE), range(20)

    def squares(**view: Any) -> float:
        """Return the sum over the seeds of d^T C^-1 d, which is chi-squared where the covariance is right."""
        total = 0.0
        for seed in seeds:
            random = np.random.default_rng(seed)
            images = [i + np.sqrt(1e-6 + 0.004 * i) * random.standard_normal(i.shape) for i in clean]
            found = fit(images, CAMERA, view=view)
            assert not found.at_bound.any()
            if view:
                assert found.rmse == pytest.approx(1.0, abs=0.03)
            total += float(off(found) @ np.linalg.solve(found.covariance, off(found)))
        return total

    low, high = scipy.stats.chi2.interval(1 - 1e-4, 12 * len(seeds))
    assert low < squares(noise=noise) < high
    assert squares() > high  # one size for all


def test_plain_errors_agree_with_the_spread_of_the_estimates_where_noise_grows_with_the_signal():
    clean = photographs(SCENE)
    view, estimates, errors = {"noise": ds.Noise(read=0.002, shot=0.001)}, [], []
    for seed in range(20):
        random = np.random.default_rng([seed, 1])
        images = [i + np.sqrt(4e-6 + 0.001 * i) * random.standard_normal(i.shape) for i in clean]
        found = fit(images, CAMERA, view=view)
        estimates.append(off(found))
        errors.append(found.plain_errors)
    mean_square = np.mean(np.square(estimates), 0) / np.mean(np.square(errors), 0)
    low, high = np.array(scipy.stats.chi2.interval(1 - 1e-4, 20)) / 20
    assert (mean_square > low).all(), mean_square
    assert (mean_square < high).all(), mean_square


@pytest.mark.parametrize("levels", [255, 1023])
@pytest.mark.parametrize("srgb", [True, False])
def test_the_variance_of_rounding_to_the_levels_of_a_file_is_what_rounding_makes(levels, srgb):
    random = np.random.default_rng(0)
    for centre in (0.04, 0.1, 0.3, 0.6):
        m = random.uniform(0.5 * centre, 1.5 * centre, 200_000)  # tens of steps
        code = np.asarray(ds.srgb_encode(m)) if srgb else m
        code = np.round(levels * code) / levels
        rounded = np.asarray(ds.srgb_decode(code)) if srgb else code
        noise = ds.Noise(read=0.0, levels=levels, srgb=1.0 * srgb)
        said = float(np.mean(np.asarray(noise.variance(jnp.asarray(m)))))
        assert said == pytest.approx(float(np.mean((rounded - m) ** 2)), rel=0.03)
    dark = ds.Noise(read=0.5, shot=3.0, levels=levels, srgb=1.0 * srgb).variance(jnp.asarray([0.0, -1.0, 2e-3]))
    slope = 1 / 12.92 if srgb else 1.0
    np.testing.assert_allclose(dark, 0.25 + 3.0 * np.array([0, 0, 2e-3]) + (slope / levels) ** 2 / 12, rtol=1e-12)


def test_a_level_is_as_the_image_holds_it():
    """float32(0.45) is below 0.45, and clipped all the same."""
    scene = standard_scene()
    image = np.minimum(photographs(scene)[0].astype(np.float32), np.float32(0.45))
    samples = find_samples(scene, ds.View(image, CAMERA, lit=(0,), saturation=0.45))
    assert (samples.ends() == 1).sum() == (image == np.float32(0.45)).sum() > 0
    dark = np.maximum(image, np.float32(0.07))
    samples = find_samples(scene, ds.View(dark, CAMERA, lit=(0,), floor=0.07))
    assert (samples.ends() == -1).any()
