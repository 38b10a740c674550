"""Samples that are not what least squares expects: clipped, outliers, and noise that depends on the level."""

from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scenarios import SIGMA, clean_images, noisy_fit, noisy_images, standard_fit
from synthetic import CAMERA, noisy, photographs, seen_by, standard_scene
from unexplained import unexplained  # noqa: F401

import diffshade as ds
from diffshade.inverse.data.samples import find_samples


@cache
def inside() -> np.ndarray:
    return np.asarray(seen_by(CAMERA).mask)


SCENE = standard_scene()


def off(fit: ds.Fit, truth: ds.Scene = SCENE) -> np.ndarray:
    """Return how far each value is from the truth."""
    return fit.values - fit.values_in(truth)


# --- clipped samples

SHINY = standard_scene(ds.Material(0.1, 0.6, 0.8, 50))
CLIPPED_ARE: dict[str, dict[str, Any]] = {"hinge": {}, "tobit": {"noise": SIGMA}, "exclude": {}}


@cache
def clipped_highlights() -> tuple[list[np.ndarray], float]:
    """Return photographs of which the brightest 0.7 % of samples are clipped, and the level."""
    images = noisy(photographs(SHINY), SIGMA, 0)
    level = float(np.quantile(np.concatenate([image[inside()].ravel() for image in images]), 0.993))
    return [np.minimum(image, level) for image in images], level


@pytest.mark.parametrize("clipped", ["hinge", pytest.param("tobit", marks=pytest.mark.thorough), "exclude"])
def test_clipped_highlights_leave_the_exponent_within_a_percent(clipped):
    images, level = clipped_highlights()
    found = standard_fit(images, view={"saturation": level, **CLIPPED_ARE[clipped]}, clipped=clipped)
    number = sum(int((image[inside()] >= level).sum()) for image in images)
    left_out = clipped == "exclude"
    assert (found.counts.clipped, found.counts.left_out) == ((0, number) if left_out else (number, 0))
    (note,) = [note for note in found.notes if note.kind == "clipped"]
    assert f"{number:,} clipped samples" in note
    assert ("excludes" in note) == left_out
    assert float(found.material.n_s) == pytest.approx(50, rel=0.02)
    assert np.abs(off(found, SHINY) / found.plain_errors).max() < 4.5
    assert found.rmse == pytest.approx(1.0 if clipped == "tobit" else SIGMA, rel=0.05)


@pytest.mark.usefixtures("unexplained")
def test_clipped_highlights_that_are_taken_for_the_truth_flatten_the_highlight():
    images, _ = clipped_highlights()
    found = standard_fit(images, view={"saturation": np.inf})
    assert float(found.material.n_s) < 40
    assert found.counts.clipped == found.counts.left_out == 0


@pytest.mark.thorough
def test_samples_clipped_at_the_floor_say_only_that_the_truth_is_below():
    black = -0.09  # so that what is in shadow is about 0, on both sides
    images = [np.maximum(image, 0.0) for image in noisy([i + black for i in clean_images()], SIGMA, 0)]
    ignored = standard_fit(images, view={"black": black})
    hinge = standard_fit(images, view={"black": black, "floor": 0.0})
    tobit = standard_fit(images, view={"black": black, "floor": 0.0, "noise": SIGMA}, clipped="tobit")
    assert np.abs(off(ignored)[:9]).max() > 0.02
    assert np.abs(off(hinge)[:9]).max() < 0.01
    assert hinge.counts.clipped == sum(int((image[inside()] <= 0.0).sum()) for image in images) > 0
    # a hinge takes what noise lifts above the floor as it is; the likelihood of a censored sample does not
    assert np.abs(off(tobit) / tobit.plain_errors).max() < 4.5
    assert np.abs(off(hinge)[:3]).max() > np.abs(off(tobit)[:3]).max()


# --- outliers


def shadowed() -> list[np.ndarray]:
    """Return the noisy photographs with a tenth of their pixels darker than they should be."""
    random = np.random.default_rng(1)
    return [
        np.where(random.random(i.shape[:2])[..., None] < 0.1, i * random.uniform(0.0, 0.6, (*i.shape[:2], 1)), i)
        for i in noisy_images()
    ]


LOSSES = ["cauchy", *(pytest.param(of, marks=pytest.mark.slow) for of in ("geman-mcclure", "huber"))]


@pytest.mark.thorough
@pytest.mark.parametrize("loss", LOSSES)
def test_a_robust_loss_finds_the_material_through_shadows(loss):
    assert np.abs(off(standard_fit(shadowed()))[:9]).max() > 0.02
    robust = standard_fit(shadowed(), loss=loss)
    assert robust.converged
    assert np.abs(off(robust)[:9]).max() < 0.01
    assert float(robust.likelihood.sigma) == pytest.approx(SIGMA, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("loss", LOSSES)
def test_a_robust_loss_costs_little_where_there_are_no_shadows(loss):
    squares, alone = noisy_fit(), standard_fit(noisy_images(), loss=loss)
    assert np.abs(off(alone) / alone.plain_errors).max() < 4.5
    np.testing.assert_allclose(alone.plain_errors, squares.plain_errors, rtol=0.1)
    assert (alone.plain_errors > squares.plain_errors).all()  # 95 % as efficient, and said so
    assert float(alone.likelihood.sigma) == pytest.approx(SIGMA, rel=0.04)


# --- noise


@pytest.mark.thorough
@pytest.mark.usefixtures("unexplained")
def test_noise_that_grows_with_the_signal_is_weighed_as_it_is_told():
    read, shot = 0.002, 0.001
    random = np.random.default_rng(0)
    images = [i + np.sqrt(read**2 + shot * i) * random.standard_normal(i.shape) for i in clean_images()]
    found = standard_fit(images, view={"noise": ds.Noise(read=read, shot=shot)})
    assert found.rmse == pytest.approx(1.0, abs=0.04)
    assert np.abs(off(found) / found.plain_errors).max() < 4.5
    twice = standard_fit(images, view={"noise": ds.Noise(read=2 * read, shot=4 * shot)})
    np.testing.assert_allclose(twice.values, found.values, rtol=1e-6)
    np.testing.assert_allclose(twice.rmse, 0.5 * found.rmse, rtol=1e-6)
    np.testing.assert_allclose(twice.plain_errors, 2 * found.plain_errors, rtol=1e-4)
    half = standard_fit(images, view={"noise": ds.Noise(read=0.5 * read, shot=0.25 * shot)})
    np.testing.assert_allclose(half.plain_errors, found.plain_errors, rtol=0.04)  # which are by the residuals then
    kinds = [[note.kind for note in fit.notes if "noise" in note.kind] for fit in (twice, found, half)]
    assert kinds == [["below noise"], [], ["beyond noise"]]


@pytest.mark.parametrize("levels", [255, 1023])
@pytest.mark.parametrize("srgb", [True, False])
def test_the_variance_of_rounding_to_the_levels_of_a_file_is_what_rounding_makes(levels, srgb):
    random = np.random.default_rng(0)
    for center in (0.04, 0.1, 0.3, 0.6):
        m = random.uniform(0.5 * center, 1.5 * center, 200_000)  # tens of steps
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
    image = np.minimum(clean_images()[0].astype(np.float32), np.float32(0.45))
    samples = find_samples(SCENE, ds.View(image, CAMERA, lit=(0,), saturation=0.45))
    assert (samples.ends() == 1).sum() == (image == np.float32(0.45)).sum() > 0
    dark = np.maximum(image, np.float32(0.07))
    samples = find_samples(SCENE, ds.View(dark, CAMERA, lit=(0,), floor=0.07))
    assert (samples.ends() == -1).any()
