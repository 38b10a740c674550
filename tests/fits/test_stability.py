"""Stability: how far values move without some of the data, and that errors hold it."""

import dataclasses
from functools import cache

import jax
import numpy as np
import pytest
from scenarios import clean_fit, clean_images, noisy_fit, standard_fit
from synthetic import CAMERA, noisy, photographs, standard_scene
from unexplained import unexplained  # noqa: F401

import diffshade as ds
from diffshade.core.progress import silent
from diffshade.core.words import Note
from diffshade.diagnosis.patches import find_clusters
from diffshade.inverse.verdicts.stability import (
    FitWithout,
    _enough,
    allow_for_omissions,
    angle_to_highlight,
    dependence,
    highlight,
    how_far,
    left_out,
    moved,
    moves,
    refit,
    refits,
)


def refitted(fit: ds.Fit) -> list[FitWithout]:
    with jax.enable_x64(True):
        return refits(fit, find_clusters(fit), left_out(fit), silent)


def test_a_mirror_direction_is_where_v_is_r():
    """A light at the eye's own direction: v.r at a point whose normal is at angle a to it is cos 2a."""
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5, 0.3, 30)), ds.DirectionalLight((0, 0, -1), 7.0))
    camera = ds.OrthographicCamera((0, 0, 5), height=2.0, shape=(41, 41), local_viewer=False)
    view = ds.View(np.zeros((41, 41, 3)), camera)
    angle = angle_to_highlight(scene, view)
    x = np.linspace(-1, 1, 41 + 1)
    middle = 0.5 * (x[1:] + x[:-1])
    r = np.hypot(*np.meshgrid(middle, middle))
    near = r < 0.69
    np.testing.assert_allclose(angle[near], 2.0 * np.rad2deg(np.arcsin(r[near])), atol=1e-3)
    assert (angle[r > 1.01] == 180.0).all()


def test_the_highlight_is_what_k_s_adds():
    scene = standard_scene()
    view = ds.View(np.zeros((*CAMERA.shape, 3)), CAMERA, lit=(0,))
    shine = highlight(scene, view)
    assert shine.max() > 0.1
    assert shine.min() == 0.0
    assert angle_to_highlight(scene, view)[shine > 0.5 * shine.max()].max() < 12.0  # cos^50 is a half at 9.5 degrees


def test_what_is_left_out_is_said_and_is_left_out():
    fit = standard_fit([np.minimum(image, 0.4) for image in clean_images()], view={"saturation": 0.4})
    found = dict(left_out(fit))
    assert list(found) == [
        "the odd views",
        "the even views",
        "saturated pixels and 1 px around them",
        "saturated pixels and 3 px around them",
        "the brightest half of the highlight",
    ]  # a pixel of these is 6 degrees wide
    odd, even, near, far, bright = found.values()
    assert [keep is None for keep in odd] == [True, False] * 4
    assert [keep is None for keep in even] == [False, True] * 4
    assert not odd[1].any()  # pyright: ignore[reportOptionalMemberAccess]
    ends = np.asarray(fit.views[0].image).max(-1) >= 0.4
    grown = np.pad(ends, 1)
    grown = grown[1:-1, 1:-1] | grown[2:, 1:-1] | grown[:-2, 1:-1] | grown[1:-1, 2:] | grown[1:-1, :-2]
    np.testing.assert_array_equal(near[0], ~grown)
    assert far[0].sum() < near[0].sum()  # pyright: ignore[reportOptionalMemberAccess]
    shine = highlight(fit.scene, fit.views[0])
    seen = shine[shine > 0.02 * shine.max()]
    np.testing.assert_array_equal(bright[0], ~(shine > np.median(seen)))
    three = jax.tree.map(lambda leaf: leaf[:3], fit.evidence.clusters)
    few = dataclasses.replace(fit.evidence, clusters=three)
    fewer = dataclasses.replace(fit, clusters=dataclasses.replace(fit.clusters, evidence=few))
    assert next(left_out(fewer))[0].startswith("saturated")
    assert _enough(fit, [None] * 8)
    some = np.zeros(CAMERA.shape, bool)
    some[12, 6:14] = True  # 8 pixels, 24 samples, 12 unknowns
    assert not _enough(fit, [some if i == 7 else np.zeros_like(some) for i in range(8)])


def test_how_far_a_number_moved_is_over_its_value_or_in_its_logarithm():
    fit = noisy_fit()
    np.testing.assert_allclose(
        how_far(fit, 1.2 * fit.values), np.where(np.array(fit.names) == "n_s", np.log(1.2), 0.2), rtol=1e-9
    )


def test_of_the_model_itself_nothing_moves():
    done = refitted(noisy_fit())
    assert [one.without for one in done] == [
        "the odd views",
        "the even views",
        "the brightest half of the highlight",
    ]
    assert not any(one.moved.any() for one in done)
    assert [one.fit.counts.views for one in done] == [4, 4, 8]
    assert done[2].fit.counts.pixels < noisy_fit().counts.pixels
    for one in done:
        assert one.fit.determined.all()
        assert np.all(np.abs(one.fit.values - noisy_fit().values) < 5 * one.fit.plain_errors)


def test_what_moved_raises_the_cost_by_three_errors_squared():
    fit = noisy_fit()
    keep = [None, np.zeros(CAMERA.shape, bool)] * 4
    with jax.enable_x64(True):
        again = refit(fit, keep)
        laid = fit.solved.keeping(keep).laid_out()
        j = fit.names.index("k_d.r")
        held, free = (laid.minimise(of, rtol=1e-8).point.total.cost for of in ({j: float(laid.theta[j])}, {}))
        rise = 2.0 * float(held - free)  # by k_d.r as all photographs have it
        for errors, expected in ((2.9, False), (3.1, True)):
            of_one = np.full(len(fit.names), rise / errors**2)
            assert moved(fit, np.zeros(len(fit.names)), of_one, again, keep)[j] == expected


def test_of_photographs_without_noise_nothing_is_made_anew():
    assert refitted(clean_fit()) == []


@cache
def of_two_highlights() -> ds.Fit:
    """A core of its own, as of a coat of varnish: n_s is what the core says, or what the rest says."""
    scene = standard_scene(ds.Material((0.1, 0.08, 0.06), (0.6, 0.4, 0.25), 0.15, 8))
    core = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0, 0, 1.5, 200)), scene.lights)
    both = [a + b for a, b in zip(photographs(scene), photographs(core), strict=True)]
    return standard_fit(noisy(both, 0.003, 0))


def test_where_a_cause_is_named_nothing_is_left_out():
    assert refitted(dataclasses.replace(noisy_fit(), notes=(Note("a light is off", "cause"),))) == []


@pytest.mark.usefixtures("unexplained")
def test_a_highlight_of_another_shape_moves_further_than_its_error_and_that_is_its_error():
    fit = dataclasses.replace(of_two_highlights(), notes=())
    plain = dataclasses.replace(fit, errors=fit.clusters.wide_errors(), determined=np.ones(12, bool))
    fit = allow_for_omissions(plain, silent)
    n_s = fit.names.index("n_s")
    assert not fit.determined[n_s]
    assert any("n_s depends on which data" in note for note in fit.notes)
    kept = fit.determined & (fit.errors > plain.errors)
    distance, far = moves(plain, refitted(plain))
    assert far[n_s]
    assert np.all(fit.errors <= np.hypot(plain.errors, distance) * (1 + 1e-6))
    assert kept.any()


def test_what_moves_is_said_and_whether_its_error_holds_it():
    fit = noisy_fit()
    k_s = np.array([u.quantity == "k_s" for u in fit.unknowns])
    again = [FitWithout("the odd views", fit, k_s)]
    (lost,), (kept,) = (dependence(fit, again, of) for of in (k_s, ~k_s))
    assert lost.startswith("k_s depends on which data are included")
    assert "the odd views" in lost
    assert kept == f"{lost} Its error allows for this."
