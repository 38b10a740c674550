"""Lights whose directions are fitted with the material, from a stated error, and what each view can show of them."""

from __future__ import annotations

import dataclasses
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grams import by_view, whole
from textured import angles_to

import diffshade as ds
from diffshade.core.fields import parameter
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.solve.descent import box_step
from diffshade.inverse.solve.elimination import Arrowhead, Dense, nothing
from diffshade.inverse.solve.solvers import evaluate, linear_step, minimise
from diffshade.inverse.statistics.evidence import Evidence
from diffshade.inverse.statistics.gauges import sentence
from diffshade.inverse.unknowns.parameters import find_unknowns
from diffshade.inverse.unknowns.places import Place
from diffshade.inverse.unknowns.unknown import Unknown, coordinates
from diffshade.inverse.unknowns.visibility import Arrow, arrow_of, seeds_of, shown_unknowns
from tests.support.textured import lights_about

FREE = ("k_d", "k_s", "n_s", "direction")
CAMERA = ds.OrthographicCamera((0.0, 0.0, 4.0), shape=(32, 32), height=2.2, local_viewer=False)
MATERIAL = ds.Material(k_a=0.0, k_d=(0.5, 0.4, 0.3), k_s=0.3, n_s=20.0)


def photographed(count: int, *, off: float = 2.0, noise: float = 0.005, seed: int = 0):
    """A ball under lights whose stated directions are off; return the scene as stated, its views, and the truth."""
    rng, towards = np.random.default_rng(seed), lights_about(count)
    ball = ds.Object(ds.Sphere(), MATERIAL)
    true = ds.Scene(ball, [ds.DirectionalLight(-l) for l in towards])
    views = []
    for i in range(count):
        image = np.asarray(ds.render(true, CAMERA, lit=i))
        views.append(ds.View(image + noise * rng.standard_normal(image.shape), CAMERA, lit=i))
    stated = towards + np.deg2rad(off) * rng.standard_normal(towards.shape)
    return ds.Scene(ball, [ds.DirectionalLight(-l) for l in stated]), views, towards


def test_directions_come_back_with_the_material():
    scene, views, towards = photographed(12)
    fit = ds.fit(scene, views, free=FREE, light_error=2.0)
    assert fit.determined.all()
    assert angles_to(fit.scene, towards).max() < 0.2
    np.testing.assert_allclose(fit.material.k_d, MATERIAL.k_d, rtol=5e-3)
    assert abs(float(fit.material.n_s) / 20.0 - 1.0) < 0.02
    at = [name.split(".direction")[0] for name in fit.names if "direction" in name]
    assert len(at) == 36
    truth = fit.values_in(ds.Scene(scene.objects[0], [ds.DirectionalLight(-l) for l in towards]))
    assert np.mean(np.abs(fit.values - truth) <= 1.96 * fit.errors) > 0.8


def test_each_view_shows_its_own_light_and_the_material():
    scene, views, _ = photographed(4)
    unknowns = find_unknowns(scene, views, FREE)
    shown = shown_unknowns(scene, views, unknowns)
    assert shown is not None
    names = [[unknowns[j].name for j in row if j < len(unknowns)] for row in shown]
    for i, of_view in enumerate(names):
        assert {name.split(".")[1] for name in of_view if "direction" in name} == {f"{i}"}
        assert {"k_d.r", "n_s"} <= set(of_view)
    assert shown_unknowns(scene, views, find_unknowns(scene, views, ("k_d",))) is None


# --- the arrow


def problem_of(count: int, free: tuple[str, ...] = FREE, views: list[ds.View] | None = None):
    scene, seen, _ = photographed(count)
    views = seen if views is None else views
    unknowns = find_unknowns(scene, views, free, light_error=2.0, from_scene=True)
    return new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge")


def test_the_directions_of_each_light_are_a_block_and_the_material_is_the_border():
    problem = problem_of(10, (*FREE, "exposure"))
    arrow, names = problem.box.arrow, [unknown.name for unknown in problem.unknowns]
    assert arrow is not None
    assert [names[j] for j in arrow.border] == ["k_d.r", "k_d.g", "k_d.b", "k_s.r", "k_s.g", "k_s.b", "n_s"]
    blocks = [{names[j] for j in row} for row in np.asarray(arrow.blocks)]
    assert {f"views.{i}.exposure" for i in range(10)} <= set().union(*blocks)
    for of in blocks:
        (exposure,) = (name for name in of if "exposure" in name)
        i = exposure.split(".")[1]
        assert of == {exposure, *(f"lights.{i}.direction.{axis}" for axis in "xyz")}


def test_unknowns_that_all_views_share_have_no_arrow_and_neither_have_lights_that_are_all_on():
    scene, views, _ = photographed(10)
    assert arrow_of(scene, views, find_unknowns(scene, views, ("k_d", "n_s"))) is None
    together = [dataclasses.replace(view, lit=tuple(range(10))) for view in views]
    assert arrow_of(scene, together, find_unknowns(scene, together, FREE)) is None


@pytest.mark.thorough
def test_elimination_gives_the_dense_solution():
    with jax.enable_x64(True):
        problem, random = problem_of(9, (*FREE, "exposure")), np.random.default_rng(0)
        theta = coordinates(np.array([u.start for u in problem.unknowns]), problem.unknowns)
        task = problem.task(problem.sum_of_squares(problem.chunks()))
        point = evaluate(theta, task, problem.chunks())
        assert isinstance(point.total.hessian, Arrowhead)
        H = np.asarray(point.total.hessian.as_matrix())
        added = point.views.total(len(H)) + np.asarray(task.priors.gram(theta).hessian.as_matrix())
        np.testing.assert_allclose(H, added, rtol=1e-12)
        more = jnp.asarray(1e-3 * (np.diag(H) + 1.0))
        D, by_blocks = H + np.diag(more), point.total.hessian.plus(more)
        b = random.standard_normal(len(D))
        for found, dense in ((by_blocks.times(jnp.asarray(b)), D @ b), (by_blocks.diagonal(), np.diag(D))):
            np.testing.assert_allclose(found, dense, rtol=1e-9)
        np.testing.assert_allclose(by_blocks.solve(jnp.asarray(b)), np.linalg.solve(D, b), rtol=1e-9)
        scale = jnp.asarray(random.uniform(0.5, 2.0, len(D)))
        np.testing.assert_allclose(by_blocks.scaled(scale).as_matrix(), D * np.outer(scale, scale), rtol=1e-12)
        low, high = -random.uniform(0.0, 0.1, len(D)), random.uniform(0.0, 0.1, len(D))
        of = (jnp.asarray(b), jnp.full(len(D), 1e-6), jnp.asarray(low), jnp.asarray(high))
        step, dense = (np.asarray(box_step(A, *of)) for A in (by_blocks, Dense(jnp.asarray(D))))
        assert (np.isclose(step, low) | np.isclose(step, high)).any()
        np.testing.assert_allclose(step, dense, rtol=1e-9, atol=1e-12)


@pytest.mark.thorough
def test_a_block_of_fewer_unknowns_than_others_is_padded():
    arrow, p = Arrow(jnp.array([2]), jnp.array([[0, 1], [3, 4], [5, 6]])), 6  # 6 is nowhere
    with jax.enable_x64(True):
        A = nothing(p, arrow).plus(jnp.arange(1.0, 7.0)).added(jnp.array([[2, 5, 6], [2, 0, 1]]), jnp.ones((2, 3, 3)))
        whole = np.diag(np.arange(1.0, 7.0))
        for index in ([2, 5], [2, 0, 1]):
            whole[np.ix_(index, index)] += 1.0
        np.testing.assert_array_equal(A.as_matrix(), whole)
        np.testing.assert_allclose(A.solve(jnp.ones(p)), np.linalg.solve(whole, np.ones(p)), rtol=1e-12)
        np.testing.assert_allclose(A.times(jnp.ones(p)), whole.sum(1), rtol=1e-12)


def test_small_matrices_are_added_where_the_dense_matrix_adds_them():
    arrow, p = Arrow(jnp.array([2, 7]), jnp.array([[0, 1, 9], [3, 4, 8], [5, 6, 9]])), 9  # 9 is nowhere
    rows = [2, 0, 1, 9], [7, 1, 9, 9], [2, 7, 9, 9], [9, 9, 9, 9], [8, 3, 2, 7], [0, 0, 1, 2], [5, 6, 7, 9]
    with jax.enable_x64(True):
        parts = np.random.default_rng(0).standard_normal((len(rows), 4, 4))
        parts = jnp.asarray(parts + parts.transpose(0, 2, 1))

        @jax.jit
        def sums(parts):
            ends = [nothing(p, of).added(jnp.array(rows), parts) for of in (arrow, None)]
            return ends[0], ends[0].as_matrix(), ends[1].as_matrix()

        by_blocks, *matrices = sums(parts)
        np.testing.assert_allclose(*matrices, rtol=1e-13, atol=1e-14)
        assert isinstance(by_blocks, Arrowhead)
        np.testing.assert_array_equal(by_blocks.blocks[0, 2], 0.0)


def test_a_fit_by_elimination_ends_where_the_dense_one_does():
    with jax.enable_x64(True):
        problem = problem_of(12)
        chunks = problem.chunks()
        squares = problem.sum_of_squares(chunks)
        theta = coordinates(np.array([u.start for u in problem.unknowns]), problem.unknowns)
        dense = dataclasses.replace(problem, box=dataclasses.replace(problem.box, arrow=None))
        ends = [minimise(theta, p.task(squares), chunks, max_steps=100) for p in (problem, dense)]
        assert problem.box.arrow is not None
        np.testing.assert_allclose(ends[0].theta, ends[1].theta, rtol=1e-9, atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("bounded", [False, True])
def test_the_step_of_the_material_alone_is_that_of_all_with_the_rest_held(bounded):
    with jax.enable_x64(True):
        problem = problem_of(12)
        chunks = problem.chunks()
        theta = coordinates(np.array([u.start for u in problem.unknowns]), problem.unknowns)
        point = evaluate(theta, problem.task(problem.sum_of_squares(chunks)), chunks)
        slope = np.random.default_rng(0).standard_normal(len(theta)) * np.asarray(point.total.hessian.diagonal())
        point = eqx.tree_at(lambda at: at.total.gradient, point, jnp.asarray(0.01 * slope))
        box = problem.box
        assert box.in_border
        if bounded:
            box = dataclasses.replace(box, upper=np.where(box.linear, point.theta + 0.003, box.upper))
        alone = linear_step(point, box)
        held = linear_step(point, dataclasses.replace(box, in_border=False))
        np.testing.assert_allclose(alone, held, rtol=1e-9, atol=1e-12)
        assert not np.asarray(alone)[~box.linear].any()
        assert bool((np.abs(np.asarray(alone) - 0.003) < 1e-12).any()) is bounded


def test_seeds_take_unknowns_together_that_no_view_shows_both_of():
    scene, views, _ = photographed(10)
    unknowns = find_unknowns(scene, views, (*FREE, "exposure"))
    shown = shown_unknowns(scene, views, unknowns)
    assert shown is not None
    seeds, of_view = seeds_of(shown, len(unknowns)) or (None, None)
    assert seeds is not None
    assert of_view is None
    assert len(seeds) == shown.shape[1] == 7 + 4
    np.testing.assert_array_equal(seeds.sum(0), 1.0)
    for row in shown:
        assert (seeds[np.arange(11), row] == 1.0).all()


@pytest.mark.parametrize(
    ("p", "shown", "of_view"),
    [
        (4, [[0, 1, 2], [0, 1, 3]], None),  # each view has all of the directions, in order
        (3, [[0, 1, 2], [0, 1, 3]], [[0, 1, 2], [0, 1, 0]]),  # padded
        (3, [[0, 1], [1, 2], [0, 2]], [[0, 1], [1, 2], [0, 2]]),  # more directions than any view shows unknowns
    ],
)
def test_seeds_say_which_unknown_has_each_unless_all_are_in_order(p, shown, of_view):
    seeds, found = seeds_of(np.array(shown), p) or (None, None)
    assert seeds is not None
    if of_view is None:
        assert found is None
    else:
        np.testing.assert_array_equal(found, of_view)
    for row, seed in zip(shown, of_view or [range(len(seeds))] * len(shown), strict=True):
        assert all(seeds[k, j] == 1.0 for k, j in zip(seed, row, strict=True) if j < p)


@pytest.mark.thorough
def test_lights_that_share_views_pairwise_are_fitted():
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(24, 24))
    ball = ds.Object(ds.Sphere(), ds.Material(k_a=0.0, k_d=0.5, k_s=0.3, n_s=20.0))
    towards = (-0.5, 0.2, -1), (0.0, 0.2, -1), (0.6, 0.2, -1)
    true = ds.Scene(ball, [ds.DirectionalLight(l, 0.5 + 0.1 * k) for k, l in enumerate(towards)])
    lit = ((0, 1), (1, 2), (0, 2))
    views = [ds.View(np.asarray(ds.render(true, camera, lit=of)), camera, lit=of) for of in lit]
    scene = ds.Scene(ball, [ds.DirectionalLight(l) for l in towards])
    fit = ds.fit(scene, views, free="intensity")
    np.testing.assert_allclose(fit.values, np.repeat([0.5, 0.6, 0.7], 3), rtol=1e-5)


@pytest.mark.thorough
def test_directions_alone_are_fitted():
    """Then nothing is linear, and nothing is shared by the views."""
    scene, views, towards = photographed(10)
    fit = ds.fit(scene, views, free="direction", light_error=2.0)
    assert angles_to(fit.scene, towards).max() < 0.2


@pytest.mark.thorough
def test_errors_from_the_grams_of_what_each_view_shows_are_those_of_whole_grams():
    """Plain, by jackknife, the tests of independence, and with a cluster added, an unknown held or left out."""
    scene, views, _ = photographed(9, noise=0.02)
    fit = ds.fit(scene, views, free=FREE, light_error=2.0)
    compact, p = fit.evidence, len(fit.values)
    grams = whole(compact.clusters, p)
    H = grams.hessian
    assert compact.clusters.hessian.shape[1] < p
    dense = dataclasses.replace(compact, clusters=by_view(H, np.asarray(grams.gradient)))
    some = np.arange(p) % 5 > 0
    pairs: list[tuple[Evidence, Evidence]] = [
        (compact, dense),
        (compact.of(some), dense.of(some)),
        (compact.with_cluster(H[3], compact.regular), dense.with_cluster(H[3], dense.regular)),
    ]
    for one, other in pairs:
        np.testing.assert_allclose(one.total, other.total, rtol=1e-12)
        np.testing.assert_array_equal(one.single_view, other.single_view)
        np.testing.assert_allclose(one.plain_errors(), other.plain_errors(), rtol=1e-9)
        np.testing.assert_allclose(one.clustered_errors(), other.clustered_errors(), rtol=1e-9)
        for a, b in zip(one.independence_p_values(), other.independence_p_values(), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9)
        np.testing.assert_allclose(one.scatter(), other.scatter(), rtol=1e-9)
        assert one.deciding() == other.deciding()


# --- what the views leave open


@pytest.mark.thorough
def test_the_scale_of_freed_intensities_is_named_whether_priors_set_it_or_nothing_does():
    scene, views, _ = photographed(4)
    free, grey = (*FREE, "intensity"), ds.Grey("intensity")
    nothing = ds.fit(scene, views, free=free, constraints=grey, light_error=2.0)
    (said,) = [note for note in nothing.notes if note.kind == "not separated"]
    assert "cannot separate k_d and k_s from the intensity of lights 0 to 3: scaling the former up" in said
    assert "or give intensity_error" in said
    priors = ds.fit(scene, views, free=free, constraints=grey, light_error=2.0, intensity_error=0.05)
    (said,) = [note for note in priors.notes if note.kind == "gauge"]
    assert "without priors the views cannot separate k_d and k_s from the intensity of lights 0 to 3" in said
    known = float(re.search(r"k_d.r times the mean intensity .* is known to ([\d.]+) %", said)[1])  # pyright: ignore
    assert known < 0.1  # per cent
    assert priors.errors[0] / priors.values[0] > 0.02  # .05 over the root of 4
    assert not [note for note in ds.fit(scene, views, free=FREE, light_error=2.0).notes if note.kind == "gauge"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"center": lambda x: [0.0, 0.0, 1.0], "position": lambda x: [0.0, 0.0, 1.0]}, "moving them together"),
        ({"center": lambda x: x - 4.0, "position": lambda x: x - 4.0, "radius": lambda x: x}, "about one point"),
        ({"center": lambda x: x**2, "position": lambda x: -x}, "they can be changed together"),
    ],
)
def test_places_that_no_pixel_shows_are_said_to_move_or_to_grow_together(changes, words):
    kinds = {"center": parameter("position"), "position": parameter("position"), "radius": parameter("")}
    values = {"center": np.array([0.1, 0.2, 0.3]), "position": np.array([2.0, 3.0, 4.0]), "radius": np.array([1.5])}
    unknowns, found, direction = [], [], []
    for name in changes:
        for axis, value, change in zip("xyz", values[name], np.ravel(changes[name](values[name])), strict=False):
            channel = "" if name == "radius" else axis
            place = Place("objects", 0, ("surface", name))
            unknowns.append(Unknown(name, channel, (place,), kinds[name]["parameter"], -9.0, 9.0, 0.0))
            found.append(value)
            direction.append(change)
    assert words in sentence(np.array(direction), unknowns, np.array(found))


# --- what lies beside it


@pytest.mark.thorough
def test_intensities_with_relative_errors_keep_the_mean_of_the_stated_ones():
    """The scale is that of the stated intensities, to their error over the root of their number."""
    scene, views, towards = photographed(16)
    factors = np.exp(0.05 * np.random.default_rng(3).standard_normal(16))
    views = [dataclasses.replace(view, image=view.image * f) for view, f in zip(views, factors, strict=True)]
    free, grey = (*FREE, "intensity"), ds.Grey("intensity")
    fit = ds.fit(scene, views, free=free, light_error=2.0, intensity_error=0.05, constraints=grey)
    assert fit.determined.all()
    assert angles_to(fit.scene, towards).max() < 0.2
    found = np.array([float(np.mean(light.intensity)) for light in fit.scene.lights])  # pyright: ignore
    assert abs(np.log(found).mean()) < 1e-4
    np.testing.assert_allclose(found / found.mean(), factors / factors.mean(), rtol=3e-3)
    scale = np.asarray(fit.material.k_d) * found.mean() / (np.asarray(MATERIAL.k_d) * factors.mean())
    np.testing.assert_allclose(scale, 1.0, atol=3e-3)
    relative = fit.errors[:3] / fit.values[:3]
    assert (relative > 0.9 * 0.05 / 4.0).all()
    assert (relative < 1.5 * 0.05 / 4.0).all()


@pytest.mark.slow
def test_a_view_of_fewer_lights_is_padded():
    scene, views, _ = photographed(3)
    more = [*views, ds.View(views[0].image, CAMERA, lit=(0, 1, 2))]
    unknowns = find_unknowns(scene, more, FREE)
    shown = shown_unknowns(scene, more, unknowns)
    assert shown is None or (shown[:3] == len(unknowns)).any(1).all()
    with jax.enable_x64(True):
        fit = ds.fit(scene, more, free=("k_d", "direction"), light_error=2.0)
    assert np.isfinite(fit.values).all()


def test_lights_that_are_off_are_not_freed():
    scene, views, _ = photographed(5)
    names = [unknown.name for unknown in find_unknowns(scene, views[:2], FREE)]
    assert {name.split(".")[1] for name in names if "direction" in name} == {"0", "1"}
    with pytest.raises(ValueError, match=r"lights.4.direction cannot be freed: its light is on in no view"):
        ds.fit(scene, views[:2], free=("lights.4.direction",))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"light_error": 0.0}, "is free, but light_error says that it is exact: 0"),
        ({"light_error": -1.0}, "light_error must be one number of at least 0, or one for each of the 3 lights"),
        ({"light_error": [1.0, 1.0]}, "one for each of the 3 lights"),
        ({"intensity_error": -0.1}, "intensity_error must be one number of at least 0"),
    ],
)
def test_wrong_errors_are_refused(given, message):
    scene, views, _ = photographed(3)
    with pytest.raises(ValueError, match=message):
        ds.fit(scene, views, **({"free": FREE} | given))


@pytest.mark.thorough
def test_errors_of_lights_that_are_known_are_part_of_the_errors():
    free, truth = ("k_d", "k_s", "n_s"), np.array([*MATERIAL.k_d, *[0.3] * 3, 20.0])
    for seed in range(2):
        scene, views, _ = photographed(12, seed=seed)
        fit, without = ds.fit(scene, views, free=free, light_error=2.0), ds.fit(scene, views, free=free)
        np.testing.assert_array_equal(fit.values, without.values)
        assert (fit.errors >= without.errors).all()
        assert (np.abs(fit.values - truth) <= 1.96 * fit.errors).all()
        hold, one_sided = (note for note in fit.notes if note.kind == "lights")
        assert "n_s" in hold.names
        assert one_sided.names == ("k_s", "n_s")


@pytest.mark.thorough
def test_known_lights_that_are_exact_change_nothing():
    scene, views, _ = photographed(3)
    exact, without = (ds.fit(scene, views, free="k_d", light_error=error) for error in (np.zeros(3), None))
    np.testing.assert_array_equal(exact.errors, without.errors)


@pytest.mark.thorough
def test_errors_of_known_intensities_are_those_of_the_reflections():
    scene, views, _ = photographed(4, off=0.0)
    fit = ds.fit(scene, views, free=("k_d",), intensity_error=0.05)
    by_light = ds.sensitivity(fit, "intensity").reshape(3, 4, 3).sum(-1)  # all channels of a light change together
    np.testing.assert_allclose(fit.errors, 0.05 * np.linalg.norm(by_light, axis=-1), rtol=0.02)


def test_the_error_of_a_position_grows_with_its_distance():
    ball = ds.Object(ds.Sphere(), MATERIAL)
    scene = ds.Scene(ball, [ds.PointLight((2.0, 3.0, 6.0)), ds.PointLight((4.0, 6.0, 12.0))])
    views = [ds.View(np.full((32, 32, 3), 0.2), CAMERA, lit=i) for i in range(2)]
    priors = [unknown.prior for unknown in find_unknowns(scene, views, ("position",), light_error=1.0)]
    widths = [prior[1] for prior in priors if prior is not None]
    np.testing.assert_allclose(widths, np.deg2rad(1.0) * np.repeat([7.0, 14.0], 3), rtol=1e-12)
