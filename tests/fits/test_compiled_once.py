"""Compiled once: the programs of a few numbers of views serve any, and views that are filled up change no result."""

import contextlib
import dataclasses

import jax
import numpy as np
import pytest

import diffshade as ds
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.forward.sums import residuals
from diffshade.inverse.pixels.blocks import few_sizes, filled
from diffshade.inverse.problem import fit_problem
from diffshade.inverse.solve.solvers import evaluate
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.unknown import coordinates

CAMERA = ds.Camera(eye=(0, 0, 4), fov=32, shape=(20, 20))
FREE = ("k_a", "k_d", "k_s", "n_s", "direction")
STATED = {"free": (*FREE, "exposure", "intensity"), "light_error": 3.0, "intensity_error": 0.05}


@contextlib.contextmanager
def counting_programs():
    """Count what is compiled inside the block."""
    found = []

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            found.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def photographed(count: int) -> tuple[ds.Scene, list[ds.View]]:
    """Return a ball under so many lamps, each alone in a photograph with noise."""
    azimuth, polar = np.deg2rad(360.0 * np.arange(count) / count), np.deg2rad(20.0 + 5.0 * (5 * np.arange(count) % 8))
    towards = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    material = ds.Material(k_a=(0.1, 0.08, 0.06), k_d=(0.6, 0.4, 0.25), k_s=0.5, n_s=20)
    scene, random = ds.Scene(ds.Object(ds.Sphere(), material), [*map(ds.DirectionalLight, towards)]), np.random
    pictures = [np.array(ds.render(scene, CAMERA, lit=k), float) for k in range(count)]
    noise = random.default_rng(1).normal(0.0, 0.005, (count, *pictures[0].shape))
    return scene, [ds.View(of + noise[k], CAMERA, lit=k) for k, of in enumerate(pictures)]


@pytest.mark.parametrize("stated", [STATED, pytest.param({"free": FREE}, marks=pytest.mark.thorough)])
def test_one_more_view_compiles_nothing(stated):
    scenes = [photographed(count) for count in (5, 6, 7)]  # the pictures have programs of their own
    first, *others = scenes
    with counting_programs() as compiled:
        ds.fit(*first, **stated)
    assert compiled  # the count counts
    with counting_programs() as compiled:
        fits = [ds.fit(*of, **stated) for of in others]
    assert not compiled
    assert [len(fit.views) for fit in fits] == [6, 7]


def problem_of(count: int, *, rendered: bool):
    scene, views = photographed(count)
    unknowns = find_unknowns(scene, views, **STATED, from_scene=True)
    data = new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge").data
    return fit_problem(scene, data, unknowns, "squares", rendered=rendered)


@pytest.mark.parametrize("count", [5, 9])
@pytest.mark.parametrize("rendered", [False, True])
def test_views_that_are_filled_up_change_nothing(count, rendered):
    """The cost, its derivatives and what each view says, with lights in blocks of their own (9) and without (5)."""
    with jax.enable_x64(True):
        problem = problem_of(count, rendered=rendered)
        assert problem.copies is not None
        assert (problem.box.arrow is not None) is (count == 9)
        alone, chunks = dataclasses.replace(problem, copies=None), problem.chunks()
        theta = coordinates(np.array([u.start for u in problem.unknowns]), problem.unknowns) + 0.01
        found, expected = (evaluate(theta, of.task(1.0), chunks) for of in (problem, alone))
        np.testing.assert_allclose(found.theta, expected.theta, rtol=1e-9)
        np.testing.assert_allclose(found.total.cost, expected.total.cost, rtol=1e-12)
        np.testing.assert_allclose(found.views.cost, expected.views.cost, rtol=1e-9)
        both, p = (found, expected), len(theta)
        numbers = [(at.total.hessian.as_matrix(), at.total.gradient, at.views.total(p)) for at in both]
        for of_found, of_expected in zip(*numbers, strict=True):
            np.testing.assert_allclose(of_found, of_expected, rtol=1e-9, atol=1e-9 * np.abs(of_expected).max())
        given = [residuals(*of.filled(theta), chunks[0]) for of in (problem, alone)]
        np.testing.assert_allclose(*(np.asarray(r) for r, _ in given), rtol=1e-12, atol=1e-15)


def test_few_numbers_of_views_and_of_their_pixels_serve_all():
    assert [filled(count) for count in (1, 2, 3, 4, 5, 8, 9, 16, 17, 33, 96, 97)] == [
        1, 2, 3, 4, 8, 8, 16, 16, 32, 64, 96, 128,
    ]  # fmt: skip
    assert [few_sizes(count) for count in (1, 2, 3, 4, 5, 6, 7, 8, 3640)] == [1, 2, 3, 4, 4, 6, 6, 8, 3072]
    assert all(2 * few_sizes(count) > count for count in range(1, 5000))


def test_a_fit_function_is_compiled_once_for_a_caller_who_compiles_nothing():
    scene, (view,) = photographed(1)
    with jax.enable_x64(True):
        solve = ds.fit_function(scene, view, free=("k_a", "k_d"))
        first = solve(view.image)
        with counting_programs() as compiled:
            second = solve(1.5 * view.image)
        assert not compiled
        np.testing.assert_allclose(second.values["k_d"], 1.5 * first.values["k_d"], rtol=1e-9)
