"""Over many fits: whatever the material, a fit ends no worse than the truth; and errors are as large as they say."""

from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.stats
from scenarios import OF_MATERIAL, clean_images, same_but, standard_fit, three_lights
from synthetic import (
    ATTENUATION,
    FREE,
    TIED,
    forget,
    noisy,
    one_light_each,
    photograph,
    photographs,
    point_lights,
    standard_scene,
)

import diffshade as ds

# --- ends


CLOSE = ds.Camera(eye=(0, 0, 4), fov=32, shape=(128, 128))
INSIDE = np.asarray(ds.intersect(standard_scene(), CLOSE).mask)
SIGMAS = (0.0, 0.002, 0.005, 0.01, 0.02)


class Case(NamedTuple):
    """A random scene, its photographs without noise and what the fit is given of them."""

    scene: ds.Scene
    clean: list[np.ndarray]
    views: list[ds.View]
    sigma: float

    def cost(self, images: list[np.ndarray]) -> float:
        """Half the sum of squares of images beside the photographs, where the sphere is."""
        return 0.5 * sum(float(np.sum((v.image - i)[INSIDE] ** 2)) for v, i in zip(self.views, images, strict=True))


def random_case(seed: int, number: int) -> Case:
    """Return a random material under one to three random lights; odd numbers have one photograph, with all lights."""
    random = np.random.default_rng([seed, number])
    lobe = (ds.Phong(), ds.Blinn())[random.integers(2)]
    k_a, k_d, k_s = random.uniform(0.0, 1.0, (3, 3))
    material = ds.Material(k_a, k_d, k_s, float(np.exp(random.uniform(0.0, np.log(2000.0)))), lobe=lobe)
    count = int(random.integers(1, 4))
    distance, azimuth = random.uniform(2.0, 5.0, count), random.uniform(0.0, 2.0 * np.pi, count)
    polar = np.deg2rad(random.uniform(10.0, 60.0, count))
    direction = np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    scene = standard_scene(material, [ds.PointLight(p, 1.0, ATTENUATION) for p in (distance * direction).T])
    sigma = float(random.choice(SIGMAS))
    together = number % 2 == 1
    clean = [photograph(scene, CLOSE)] if together else photographs(scene, CLOSE)
    images = [image + sigma * random.standard_normal(image.shape) for image in clean]
    views = [ds.View(image, CLOSE, lit=None if together else (i,)) for i, image in enumerate(images)]
    return Case(scene, clean, views, sigma)


def failure(seed: int, number: int) -> str:
    """Fit a random case from no start; return what is wrong with the end, or nothing."""
    case = random_case(seed, number)
    fit = ds.fit(forget(case.scene), case.views, free=OF_MATERIAL)
    lit = [view.lit for view in case.views]
    found = case.cost([np.asarray(ds.render(fit.scene, case.views[0].camera, lit=on)) for on in lit])
    truth = case.cost(case.clean)
    assert found == pytest.approx(0.5 * fit.rmse**2 * fit.counts.samples, rel=1e-7, abs=1e-18)
    squares = sum(float(np.sum(view.image[INSIDE] ** 2)) for view in case.views)
    if fit.counts.samples != 3 * INSIDE.sum() * len(case.views):
        return f"case {number}: {fit.counts.samples} samples"
    if fit.converged and found <= truth * (1.0 + 1e-9) + 1e-18 * squares:
        return ""
    material = case.scene.objects[0].material
    return (
        f"case {number}: {type(material.lobe).__name__} n_s {float(material.n_s):g} under {len(case.scene.lights)} "
        f"lights, sigma {case.sigma:g}: cost {found:.9g} against the truth's {truth:.9g} at n_s "
        f"{float(fit.material.n_s):g} after {fit.steps} steps"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "half",
    [0, 1],
    ids=["one light in each view", "all lights in one view"],
)
def test_a_fit_that_is_told_nothing_of_the_material_ends_no_worse_than_the_truth(half):
    assert [said for number in range(half, 100, 2) if (said := failure(1, number))] == []


@pytest.mark.slow
def test_of_500_other_materials_498_end_no_worse_than_the_truth():
    failures = [said for number in range(500) if (said := failure(2, number))]
    print(*failures, sep="\n")
    assert len(failures) <= 2, failures


def test_from_far_off_values_of_the_scene_a_fit_ends_elsewhere_which_the_search_does_not():
    free = (*OF_MATERIAL, "lights.0.position")
    truth = three_lights()
    views = one_light_each(photographs(truth))
    where = lambda s: [s.objects[0].material.n_s, s.lights[0].position]  # noqa: E731
    wrong = same_but(forget(truth), where, [5000.0, point_lights()[0].position + np.array((-2.0, 1.0, -1.0))])
    from_scene = ds.fit(wrong, views, free=free, start="scene")
    searched = ds.fit(wrong, views, free=free)
    assert from_scene.rmse > 0.01  # which shows that it did begin where it was told
    np.testing.assert_allclose(searched.values, searched.values_in(truth), rtol=1e-7, atol=1e-7)


# --- errors

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


def test_two_errors_hold_the_truth_as_often_as_they_say(noisy_fits):
    """Nominally 95 %; 600 correlated numbers scatter by some per cent."""
    truth = noisy_fits[0].values_in(standard_scene())
    inside = [np.abs(fit.values - truth) < 1.96 * fit.errors for fit in noisy_fits]
    print(f"coverage {np.mean(inside):.3f}")
    assert 0.92 < np.mean(inside) < 0.99


def test_the_rmse_is_the_noise(noisy_fits):
    np.testing.assert_allclose([fit.rmse for fit in noisy_fits], 0.005, rtol=0.02)


def off(fit: ds.Fit) -> np.ndarray:
    """Return how far each value is from the truth."""
    return fit.values - fit.values_in(standard_scene())


@pytest.mark.slow
def test_weights_by_the_noise_of_counted_photons_make_the_errors_honest():
    noise, clean, seeds = ds.Noise(read=0.001, shot=0.004), clean_images(), range(20)

    def squares(**view: Any) -> float:
        """Return the sum over the seeds of d^T C^-1 d, which is chi-squared where the covariance is right."""
        total = 0.0
        for seed in seeds:
            random = np.random.default_rng(seed)
            images = [i + np.sqrt(1e-6 + 0.004 * i) * random.standard_normal(i.shape) for i in clean]
            found = standard_fit(images, view=view)
            assert not found.at_bound.any()
            if view:
                assert found.rmse == pytest.approx(1.0, abs=0.03)
            total += float(off(found) @ np.linalg.solve(found.covariance, off(found)))
        return total

    low, high = scipy.stats.chi2.interval(1 - 1e-4, 12 * len(seeds))
    assert low < squares(noise=noise) < high
    assert squares() > high  # one size for all


def test_plain_errors_agree_with_the_spread_of_the_estimates_where_noise_grows_with_the_signal():
    clean = clean_images()
    view, estimates, errors = {"noise": ds.Noise(read=0.002, shot=0.001)}, [], []
    for seed in range(20):
        random = np.random.default_rng([seed, 1])
        images = [i + np.sqrt(4e-6 + 0.001 * i) * random.standard_normal(i.shape) for i in clean]
        found = standard_fit(images, view=view)
        estimates.append(off(found))
        errors.append(found.plain_errors)
    mean_square = np.mean(np.square(estimates), 0) / np.mean(np.square(errors), 0)
    low, high = np.array(scipy.stats.chi2.interval(1 - 1e-4, 20)) / 20
    assert (mean_square > low).all(), mean_square
    assert (mean_square < high).all(), mean_square
