"""Padding: programs have more views, lights and unknowns than a fit, and its numbers do not change by it."""

import functools

import jax
import numpy as np
import pytest
from normal_equations import SMALL, lights_of_several_kinds_and_views_of_every_sort, summary

import diffshade as ds
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.data.views import is_grey
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.pixels.blocks import total
from diffshade.inverse.problem import fit_problem
from diffshade.inverse.solve.solvers import evaluate, point_of
from diffshade.inverse.unknowns.parameters import find_unknowns

same = functools.partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-12)
FREE = ("k_d", "k_s", "n_s", "direction", "exposure")


def lamps(count: int) -> tuple[ds.Scene, list[ds.View]]:
    """A ball, and noise in its place, under one lamp at a time; the last photograph has all of them."""
    random = np.random.default_rng(count)
    towards = random.standard_normal((count - 1, 3)) * 0.3 + (0.0, 0.0, 1.0)
    scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5, 0.3, 20)), [ds.DirectionalLight(-l) for l in towards])
    lit = [*range(count - 1), None]
    return scene, [ds.View(random.random((*SMALL.shape, 3)), SMALL, lit=k) for k in lit]


def cases():
    for count in (4, 5, 7, 11, 13):  # of 11 on, each light has a block of the arrow
        scene, views = lamps(count)
        yield pytest.param(scene, views, FREE, {}, id=f"{count} views")
    scene, views = lamps(5)
    priors = {"light_error": 2.0, "priors": {"k_d": (0.4, 0.1)}}
    yield pytest.param(scene, views, FREE, priors, id="with priors")
    noise = [ds.View(v.image, SMALL, lit=v.lit, noise=ds.Noise(0.01, 0.1)) for v in views]
    yield pytest.param(scene, noise, FREE, {}, id="with noise")
    tied = {"tied": ("exposure",), "constraints": (ds.Proportional("k_s", "k_d"),)}
    yield pytest.param(scene, views, FREE, tied, id="tied and proportional")
    yield pytest.param(scene, views, ("k_d", "k_s", "n_s"), {}, id="known lights")
    sensors = [ds.View(v.image, SMALL, lit=v.lit, sensor=ds.Sensor(gamma=1.1 + 0.1 * i)) for i, v in enumerate(views)]
    yield pytest.param(scene, sensors, (*FREE, "sensor.gamma"), {}, id="sensors")
    mixed, several, free, tied = lights_of_several_kinds_and_views_of_every_sort()
    yield pytest.param(mixed, [*several, several[1]], free, {"tied": tied}, id="several kinds")


@pytest.mark.thorough
@pytest.mark.parametrize("rendered", [False, True])
@pytest.mark.parametrize(("scene", "views", "free", "options"), [*cases()])
def test_a_padded_task_has_the_same_point(scene, views, free, options, rendered):
    with jax.enable_x64(True):
        data = ViewSet.of(scene, views)
        grey = all(map(is_grey, views))
        unknowns = find_unknowns(scene, views, free, grey=grey, **options)
        problem = new_problem(scene, data, unknowns, "squares", "hinge")
        problem = fit_problem(scene, problem.data, unknowns, "squares", rendered=rendered)
        theta = np.random.default_rng(1).uniform(0.3, 0.8, len(unknowns))
        task, chunks = problem.task(1.0), problem.chunks()
        assert task.is_padded is (len(views) != 4)
        found = evaluate(theta, task, chunks)
        sums = total([summary(theta, problem.model, chunk) for chunk in chunks])
        plain = point_of(theta, problem.model, task.priors, problem.box, sums)
        known = task.priors.gram(theta)
        np.testing.assert_allclose(task.of_priors(theta).hessian, known.hessian.as_matrix(), rtol=1e-13, atol=0.0)
    same(found.theta, plain.theta)
    for now, then in ((found.total, plain.total), (found.views, plain.views)):
        same(now.cost, then.cost)
        same(now.gradient, then.gradient)
    same(found.total.hessian.as_matrix(), plain.total.hessian.as_matrix())
    same(found.views.hessian, plain.views.hessian)


@pytest.mark.parametrize("free", ["direction", "exposure", "intensity"])
@pytest.mark.parametrize(("few", "many"), [(5, 6), (10, 12)])
def test_programs_are_those_of_a_few_numbers_of_views(free, few, many):
    random, tasks = np.random.default_rng(0), []
    for count in (few, many):
        lights = [ds.DirectionalLight(0.3 * random.standard_normal(3) - (0.0, 0.0, 1.0)) for _ in range(count)]
        scene = ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.1, 0.5, 0.3, 20)), lights)
        views = [ds.View(random.random((*SMALL.shape, 3)), SMALL, lit=k) for k in range(count)]
        error = 1.0 if free == "direction" else None
        unknowns = find_unknowns(scene, views, ("k_d", "k_s", "n_s", free), light_error=error)
        tasks.append(new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge").task(1.0))
    first, second = tasks
    assert first.structure == second.structure
    assert [np.shape(leaf) for leaf in first.leaves] == [np.shape(leaf) for leaf in second.leaves]
