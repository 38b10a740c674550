"""Lights of many views, tried at other places all at once: narrow highlights that lie beside the photographs'."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from textured import angles_to

import diffshade as ds
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.solve.light_search import at_better_places
from diffshade.inverse.solve.solvers import evaluate
from diffshade.inverse.solve.start_search import groups_to_try
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.unknown import coordinates
from diffshade.inverse.unknowns.visibility import arrow_of, places_apart
from tests.support.textured import lights_about

FREE = ("k_d", "k_s", "n_s", "direction")
CAMERA = ds.OrthographicCamera((0.0, 0.0, 4.0), shape=(48, 48), height=2.2, local_viewer=False)
GLOSSY = ds.Material(k_a=0.0, k_d=0.05, k_s=2.0, n_s=300.0)


def lit_from(towards: np.ndarray, material: ds.Material = GLOSSY) -> ds.Scene:
    return ds.Scene(ds.Object(ds.Sphere(), material), [ds.DirectionalLight(-l) for l in towards])


def photographs(towards: np.ndarray, material: ds.Material = GLOSSY) -> list[ds.View]:
    random, scene = np.random.default_rng(0), lit_from(towards, material)
    images = [np.asarray(ds.render(scene, CAMERA, lit=i)) for i in range(len(towards))]
    return [ds.View(i + 0.005 * random.standard_normal(i.shape), CAMERA, lit=k) for k, i in enumerate(images)]


def moved(towards: np.ndarray, degrees: float, seed: int = 0) -> np.ndarray:
    off = towards + np.deg2rad(degrees) * np.random.default_rng(seed).standard_normal(towards.shape)
    return off / np.linalg.norm(off, axis=-1, keepdims=True)


def turned_by(direction: np.ndarray, degrees: float) -> np.ndarray:
    across = np.cross(direction, [0.0, 1.0, 0.0])
    return np.cos(np.deg2rad(degrees)) * direction + np.sin(np.deg2rad(degrees)) * across / np.linalg.norm(across)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("n_s", "error", "wrong"),
    [
        pytest.param(1000.0, 5.0, 0.0, id="all are 5 degrees off, and highlights 2 degrees wide"),
        pytest.param(300.0, 2.0, 40.0, id="one is 40 degrees off"),
    ],
)
def test_lights_whose_narrow_highlights_lie_beside_the_photographs_are_found(n_s, error, wrong):
    towards, material = lights_about(12), ds.Material(k_a=0.0, k_d=0.05, k_s=2.0, n_s=n_s)
    stated = moved(towards, error)
    stated[3] = turned_by(stated[3], wrong)
    fit = ds.fit(lit_from(stated), photographs(towards, material), free=FREE, light_error=error)
    assert angles_to(fit.scene, towards).max() < 0.15
    assert abs(float(fit.material.n_s) / n_s - 1.0) < 0.02
    assert fit.rmse == pytest.approx(0.005, rel=0.02)


def laid_out(towards: np.ndarray, material: ds.Material = GLOSSY):
    scene, views = lit_from(towards, material), photographs(towards, material)
    unknowns = find_unknowns(scene, views, FREE, light_error=5.0, from_scene=True)
    problem = new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge")
    theta = coordinates(np.array([unknown.start for unknown in unknowns]), unknowns)
    return problem, theta, places_apart(unknowns, problem.box.arrow)


@pytest.mark.thorough
def test_only_lights_whose_views_cost_more_elsewhere_are_moved_and_all_of_them_at_once():
    with jax.enable_x64(True):
        towards = lights_about(12)
        problem, theta, lights = laid_out(towards)
        chunks = problem.chunks()
        samples = 3.0 * np.array(problem.data.pixels)
        task = problem.with_scale(0.005, "squares").task(problem.sum_of_squares(chunks))

        def better(theta):
            end = evaluate(theta, task, chunks)  # at the best k_d and k_s
            found = at_better_places(end, samples, lights, task, chunks)
            return None if found is None else np.where(found == end.theta, theta, found)

        assert len(lights) == 12
        assert better(theta) is None
        beside = theta.copy()
        for i, degrees in ((2, 6.0), (7, 9.0)):
            beside[lights[i]] = turned_by(theta[lights[i]], degrees)
        found = better(beside)
        assert found is not None
        apart = [np.linalg.norm(np.stack([at[of] - theta[of] for of in lights]), axis=-1) for at in (beside, found)]
        np.testing.assert_array_equal(np.flatnonzero(found != beside), sorted(lights[2] + lights[7]))
        assert (apart[1][[2, 7]] < 0.6 * apart[0][[2, 7]]).all()
        np.testing.assert_allclose(np.linalg.norm(found[lights], axis=-1), 1.0, rtol=1e-12)


def test_a_search_does_not_go_from_light_to_light_where_each_has_its_own_views():
    """Of directions without a stated error, whose search one by one takes a time quadratic in the lights."""
    towards = lights_about(12)
    scene, views = lit_from(towards), photographs(towards)
    unknowns = find_unknowns(scene, views, FREE)
    problem = new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge")
    assert len(groups_to_try(unknowns, scene)) == 13
    assert len(groups_to_try(unknowns, scene, problem.box.arrow)) == 1


def test_spots_with_two_places_and_lights_that_are_on_together_are_searched_one_by_one():
    towards = lights_about(20)
    spots = [ds.SpotLight(5.0 * l, -l, cutoff=30.0, softness=5.0) for l in towards]
    scene = ds.Scene(ds.Object(ds.Sphere(), GLOSSY), spots)

    def places(free: tuple[str, ...], lit: list[tuple[int, ...]]) -> list[list[int]]:
        views = [ds.View(np.zeros((48, 48, 3)), CAMERA, lit=of) for of in lit]
        unknowns = find_unknowns(scene, views, free)
        return places_apart(unknowns, arrow_of(scene, views, unknowns))

    alone, pairs = [(i,) for i in range(20)], [(2 * i, 2 * i + 1) for i in range(10)]
    assert len(places(("k_d", "position"), alone)) == 20
    assert places(("k_d", "position", "direction"), alone) == []
    assert places(("k_d", "position"), pairs) == []
