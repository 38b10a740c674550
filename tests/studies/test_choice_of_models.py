"""Choices between many fits: a verdict where there is one, never where there is none."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from synthetic import CAMERA, MATERIAL, light_positions, noisy, one_light_each, photographs, standard_scene

import diffshade as ds

pytestmark = pytest.mark.slow

SIGMA = 0.005
PHONG = ("k_a", "k_d", "k_s", "n_s")
MATTE = dataclasses.replace(MATERIAL, k_s=np.zeros(3))
BLINN = dataclasses.replace(MATERIAL, lobe=ds.Blinn())


def scene_of(material: ds.Material = MATERIAL, count: int = 8, fade: ds.RadialAttenuation | None = None) -> ds.Scene:
    fade = ds.RadialAttenuation() if fade is None else fade
    return standard_scene(material, [ds.PointLight(p, 1.0, fade) for p in light_positions()[:count]])


def views_of(scene: ds.Scene, seed: int = 0, **options) -> list[ds.View]:
    return one_light_each(noisy(photographs(scene), SIGMA, seed), **options)


def phong(views: Sequence[ds.View], free: Sequence[str] = PHONG, **options) -> ds.Fit:
    tied = ("attenuation",) if {"linear", "quadratic"} & set(free) else ()
    return ds.fit(scene_of(count=len(views)), views, free=free, tied=tied, **options)


def blinn(views: Sequence[ds.View], **options) -> ds.Fit:
    return ds.fit(scene_of(BLINN, len(views)), views, free=PHONG, **options)


def lambert(views: Sequence[ds.View], **options) -> ds.Fit:
    return ds.fit(scene_of(MATTE, len(views)), views, free=("k_a", "k_d"), **options)


@pytest.fixture(scope="module")
def eight():
    return views_of(scene_of())


@pytest.fixture(scope="module")
def fits(eight):
    return {
        "Lambert": lambert(eight),
        "Phong": phong(eight),
        "Blinn": blinn(eight),
    }


# --- verdicts


def test_with_a_highlight_in_eight_views_phong_is_told_from_blinn(fits):
    choice = ds.compare({name: fits[name] for name in ("Blinn", "Phong")})
    assert choice.best == "Phong"
    assert choice.held_out == "8 views"
    assert choice.image_differences[1] > 0.5 / 255


def test_ambient_is_missed_where_it_is_and_not_where_it_is_not():
    bare = dataclasses.replace(MATERIAL, k_a=np.zeros(3))
    without = dataclasses.replace(MATERIAL, k_a=np.zeros(3))
    for material, best in ((MATERIAL, "with"), (bare, None)):
        views = views_of(scene_of(material))
        choice = ds.compare(
            {"with": phong(views), "without": ds.fit(scene_of(without), views, free=("k_d", "k_s", "n_s"))}
        )
        assert choice.best == best


def test_attenuation_is_missed_where_it_is():
    views = views_of(scene_of(fade=ds.RadialAttenuation(1.0, 0.0, 0.1)))
    choice = ds.compare({"none": phong(views), "quadratic": phong(views, (*PHONG, "quadratic"))})
    assert choice.best == "quadratic"


def test_from_one_view_phong_is_not_told_from_blinn():
    """n_s 50 is refitted as another n_s of Blinn, .001 away with noise of .005: patches are left out."""
    for seed in range(2):
        views = views_of(scene_of(count=1), seed)
        choice = ds.compare({"Phong": phong(views), "Blinn": blinn(views)})
        assert choice.best is None
        assert choice.held_out.endswith("pixels")
        assert choice.folds > 30
        assert choice.image_differences[1] < 0.5 / 255
        assert "undecided between" in str(choice)
        assert "Add photographs under other lights." in str(choice)


def test_from_two_views_a_verdict_is_the_right_one():
    views = views_of(scene_of(count=2))
    choice = ds.compare({"Phong": phong(views), "Blinn": blinn(views)})
    assert choice.best in (None, "Phong")
    assert choice.held_out.endswith("pixels")


def test_an_unneeded_term_gets_no_verdict_whatever_the_noise():
    """With three views, whose jackknife has but two degrees of freedom, it is the images that hold it back."""
    scene = scene_of(count=3)
    for seed in range(5):
        views = views_of(scene, seed)
        choice = ds.compare({"Phong": phong(views), "fades": phong(views, (*PHONG, "linear"))})
        assert not choice.worse.any()


# --- the numbers


def error_without_each(views: Sequence[ds.View]) -> float:
    """The error of fits of Phong to all views but one, on that one."""
    squares, count = 0.0, 0
    for k, view in enumerate(views):
        without = ds.fit(scene_of(count=len(views)), [v for j, v in enumerate(views) if j != k], free=PHONG)
        seen = without.predict(view)
        squares, count = squares + np.sum(seen.difference**2), count + seen.counts.sum()
    return float(np.sqrt(squares / count))


def test_the_errors_are_those_of_fits_without_each_view(eight, fits):
    choice = ds.compare({name: fits[name] for name in ("Phong", "Lambert")})
    np.testing.assert_allclose(choice.errors[0], error_without_each(eight), rtol=1e-8)


def test_of_clipped_photographs_too():
    views = [ds.View(np.minimum(v.image, 0.4), CAMERA, lit=v.lit, saturation=0.4) for v in views_of(scene_of(count=4))]
    choice = ds.compare({"Phong": phong(views), "Lambert": lambert(views)})
    np.testing.assert_allclose(choice.errors[0], error_without_each(views), rtol=1e-6)


def test_with_the_noise_known_errors_are_in_its_units(eight):
    views = [ds.View(v.image, CAMERA, lit=v.lit, noise=SIGMA) for v in eight]
    choice = ds.compare({"Phong": phong(views), "Lambert": lambert(views)})
    assert choice.best == "Phong"
    assert 0.95 < choice.errors[0] < 1.05
    assert 0.95 * SIGMA < choice.rmse[0] < 1.05 * SIGMA


def test_clipped_samples_and_outliers_do_not_decide():
    scene = scene_of()
    images = noisy(photographs(scene), SIGMA, 0)
    for image in images:
        image[5:9, 5:9] += 0.5
    views = one_light_each([np.minimum(image, 0.8) for image in images], saturation=0.8)
    robust = {"loss": "cauchy"}
    choice = ds.compare({"Phong": phong(views, **robust), "Lambert": lambert(views, **robust)})
    assert choice.best == "Phong"
    assert choice.errors[0] < 5 * SIGMA


def test_a_view_that_is_another_again_is_no_cluster(eight):
    views = [*eight[:3], eight[0]]
    scene, matte = (scene_of(m, 3) for m in (MATERIAL, MATTE))
    choice = ds.compare({"Phong": ds.fit(scene, views, free=PHONG), "Lambert": ds.fit(matte, views, free=("k_d",))})
    assert choice.held_out == "3 views"


def test_scenes_of_several_objects_are_compared_too():
    floor = ds.Object(ds.Plane((0, -1, 0), (0, 1, 0)), ds.Material(k_d=0.4))
    lamps = [ds.PointLight(p) for p in light_positions()[:3]]
    scene = ds.Scene([ds.Object(ds.Sphere(), MATERIAL), floor], lamps)
    views = views_of(scene)
    free = ("objects.0.material.k_d", "objects.1.material.k_d")
    one = ds.fit(scene, views, free=free, start="scene")
    matte = ds.Scene([ds.Object(ds.Sphere(), MATTE), floor], lamps)
    other = ds.fit(matte, views, free=free, start="scene")
    choice = ds.compare({"shiny": one, "matte": other})
    assert choice.best == "shiny"
    np.testing.assert_allclose(choice.rmse, [one.rmse, other.rmse], rtol=1e-9)
