"""No start is needed: whatever the material, a fit ends no worse than the truth; and where fits begin."""

from collections.abc import Sequence

import jax
import numpy as np
import pytest
from scenarios import clean_fit, clean_images, noisy_fit, noisy_images, same_but, standard_fit
from synthetic import CAMERA, noisy, one_light_each, photographs, seen_by, standard_scene

import diffshade as ds
from diffshade.inverse.data.view_sets import ViewSet
from diffshade.inverse.fitting import new_problem
from diffshade.inverse.solve import start_search
from diffshade.inverse.solve.solvers import FAR, NEAR
from diffshade.inverse.solve.start_search import (
    _distinct,
    _lowest,
    groups_to_try,
    is_local,
    steepest,
    turned,
    with_wide_edges,
)
from diffshade.inverse.solving import find_start, lay_out_part
from diffshade.inverse.unknowns.parameters import find_unknowns

SMALL = ds.Camera(eye=(0, 0, 4), fov=32, shape=(8, 8))


# --- ends


@pytest.mark.parametrize("seed", range(6))
def test_a_fit_that_is_told_nothing_of_the_material_ends_no_worse_than_the_truth(seed):
    random = np.random.default_rng(seed)
    n_s = np.exp(random.uniform(0.0, np.log(300.0)))
    k_a, k_d, k_s = random.uniform(0.0, 1.0, (3, 3))
    truth = standard_scene(ds.Material(k_a, k_d, k_s, n_s))
    clean = photographs(truth)
    images = noisy(clean, random.choice([0.0, 0.002, 0.02]), seed)
    fit = standard_fit(images)
    assert fit.converged
    inside = seen_by(CAMERA).mask

    def squares(predicted: Sequence[np.ndarray]) -> float:
        return sum(float(np.sum((y - m)[inside] ** 2)) for y, m in zip(images, predicted, strict=True))

    found = squares(photographs(fit.scene))
    assert found <= squares(clean) * (1.0 + 1e-9) + 1e-15
    assert found == pytest.approx(fit.rmse**2 * fit.counts.samples, rel=1e-7, abs=1e-18)


@pytest.mark.thorough
def test_a_fit_is_the_same_in_any_unit_of_length():
    def fitted(unit):
        places = ((2, 3, 4), (1, 1, 2.5))
        fades = ds.RadialAttenuation(1.0, 0.1 / unit, 0.5 / unit**2)
        lamps = tuple(ds.PointLight(unit * np.array(at), 10.0, fades) for at in places)
        ball = ds.Object(ds.Sphere(radius=unit), ds.Material(0.05, (0.6, 0.4, 0.2), 0.3, 30))
        scene, camera = ds.Scene(ball, lamps), ds.Camera((0, 0, 4 * unit), fov=35, shape=(48, 48))
        images = noisy([np.asarray(ds.render(scene, camera, lit=i), np.float64) for i in (0, 1)], 0.004, 0)
        views = [ds.View(image, camera, lit=i) for i, image in enumerate(images)]
        return ds.fit(scene, views, free=("k_a", "k_d", "k_s", "n_s", "attenuation"), tied="attenuation")

    large, small = fitted(1.0), fitted(1e5)
    assert small.determined.all()
    units = np.append(np.ones(10), (1e5, 1e10))
    np.testing.assert_allclose(units * small.values, large.values, atol=1e-2 * large.errors.min(), rtol=1e-3)
    np.testing.assert_allclose(units * small.errors, large.errors, rtol=1e-2)


# --- the scene's values, which a search does not look at and start="scene" begins with


def test_the_search_gives_identical_values_whatever_the_scene_says_of_the_material():
    for material in (ds.Material(0.1, 0.8, 0.5, 120), ds.Material(0.0, 0.0, 0.0, 5000)):
        np.testing.assert_array_equal(standard_fit(noisy_images(), standard_scene(material)).values, noisy_fit().values)


def test_a_fit_may_begin_at_the_scenes_values():
    stays = standard_fit(clean_images(), standard_scene(), start="scene")
    np.testing.assert_allclose(stays.values, stays.values_in(standard_scene()), rtol=1e-9, atol=1e-9)
    assert stays.converged
    assert stays.steps <= 3
    far = standard_fit(clean_images(), standard_scene(ds.Material(0.9, 0.9, 0.9, 2.0)), start="scene")
    assert far.costs[0] > 1e3 * clean_fit().costs[0]
    assert far.costs[0] > 1.0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("sensor", "steps", "near"),
    [
        (None, 1, False),
        (None, None, True),
        (ds.Sensor(blur=0.5), None, False),
    ],
)
def test_a_start_is_near_where_the_search_reached_the_minimum_of_the_same_model(sensor, steps, near, monkeypatch):
    if steps is not None:
        monkeypatch.setattr(start_search, "SHORT", steps)
    with jax.enable_x64(True):
        scene = standard_scene()
        views = one_light_each(photographs(scene, SMALL), SMALL, sensor=sensor)
        unknowns = find_unknowns(scene, views, ("k_d", "n_s"))
        problem = new_problem(scene, ViewSet.of(scene, views), unknowns, "squares", "hinge")
        _, damping = find_start(lay_out_part(problem))
    assert damping == (NEAR if near else FAR)


# --- what a search tries


def tries(scene: ds.Scene, *free: str) -> np.ndarray:
    """Return the values that the only group of unknowns is tried with; n_s as its logarithm."""
    views = [ds.View(np.zeros((8, 8, 3)), SMALL)]
    unknowns = find_unknowns(scene, views, free)
    (group,) = groups_to_try(unknowns, scene)
    return group.at(np.array([u.start for u in unknowns]))


BALL = ds.Scene(ds.Object(ds.Sphere((1, 2, 3), 0.5)), ds.PointLight((1, 2, 5)))


def angles(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    cosines = vectors @ axis / np.linalg.norm(vectors, axis=-1) / np.linalg.norm(axis)
    return np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))


def test_directions_are_tried_on_rings_around_the_scenes():
    axis = np.array([0.3, -2.0, 1.0])
    around = turned(axis, (20.0, 70.0))
    np.testing.assert_allclose(np.linalg.norm(around, axis=-1), 1.0)
    np.testing.assert_allclose(angles(around, axis), [0.0] + [20.0] * 6 + [70.0] * 6, atol=1e-5)
    for ring in (around[1:7], around[7:]):  # evenly spread
        np.testing.assert_allclose(ring.mean(0), axis * (ring.mean(0) @ axis) / (axis @ axis), atol=1e-12)
        np.testing.assert_allclose(np.diff(angles(ring[1:], ring[0])[:3]), np.diff(angles(ring[1:], ring[0])[:1:-1]))


def test_positions_are_tried_around_the_object_nearer_and_farther():
    offset = tries(BALL, "position") - (1, 2, 3)
    assert len(offset) == 1 + 3 * 19
    np.testing.assert_allclose(offset[0], (0, 0, 2))
    lengths = np.linalg.norm(offset[1:], axis=-1).reshape(3, 19)
    np.testing.assert_allclose(lengths, np.repeat([[1.2], [2.0], [3.2]], 19, 1))
    assert set(angles(offset, np.array([0, 0, 1])).round(3)) == {0.0, 20.0, 40.0, 70.0}


def test_a_light_in_the_middle_of_the_object_is_tried_in_front_of_it():
    within = same_but(BALL, lambda s: [s.lights[0].position], [(1, 2, 3)])
    offset = tries(within, "position") - (1, 2, 3)
    np.testing.assert_allclose(offset[0], 0.0)
    np.testing.assert_allclose(offset[20], (0, 0, 1.5), atol=1e-12)  # three radii


def test_the_middle_of_a_g_buffer_is_that_of_what_it_shows():
    seen = seen_by(SMALL, ds.Sphere((0.1, 0.2, 0.3), 0.5))
    scene = ds.Scene(ds.Object(seen), ds.PointLight((0, 0, 5)))
    middle = np.asarray(seen.position)[np.asarray(seen.mask)].mean(0)
    offset = tries(scene, "position") - middle
    np.testing.assert_allclose(np.linalg.norm(offset[1:20], axis=-1), 0.6 * np.linalg.norm((0, 0, 5) - middle))


def test_a_sphere_is_tried_a_quarter_of_its_radius_away_and_smaller_and_larger():
    steps = tries(BALL, "center") - (1, 2, 3)
    np.testing.assert_allclose(steps, 0.125 * np.array([[0, 0, 0], *np.eye(3), *-np.eye(3)]))
    np.testing.assert_allclose(tries(BALL, "radius")[:, 0], (0.5, 0.425, 0.6))


def test_exponents_and_angles_are_tried_over_all_of_their_range():
    spot = ds.Scene(ds.Object(ds.Sphere()), ds.SpotLight((0, 0, 5), (0, 0, -1), 1.0, 25.0, 3.0, softness=2.0))
    np.testing.assert_allclose(np.exp(tries(BALL, "n_s")[:, 0]), 4.0 ** np.arange(7))
    np.testing.assert_allclose(tries(spot, "exponent")[:, 0], (3, 0, 1, 4, 16, 64))
    np.testing.assert_allclose(tries(spot, "cutoff")[:, 0], (25, 10, 20, 30, 40, 50, 60, 75))
    np.testing.assert_allclose(
        angles(tries(spot, "direction"), np.array([0, 0, -1])), [0] + [20] * 6 + [45] * 6 + [80] * 6, atol=1e-5
    )
    ball = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_t=0.5, eta=1.7)), ds.PointLight((0, 0, 5)))
    np.testing.assert_allclose(tries(ball, "eta")[:, 0], np.linspace(1.0, 2.5, 16))


def test_groups_are_tried_one_by_one_and_unknowns_of_a_kind_together():
    views = [ds.View(np.zeros((8, 8, 3)), SMALL)]
    unknowns = find_unknowns(BALL, views, ("k_d", "n_s", "radius"))
    begin = np.arange(1.0, 6.0)
    for name, group in zip(("radius", "n_s"), groups_to_try(unknowns, BALL), strict=True):
        at = group.at(begin)
        moved = np.array([u.kind == name for u in unknowns])
        np.testing.assert_array_equal(at[:, ~moved], np.tile(begin[~moved], (len(at), 1)))
        assert np.ptp(at[:, moved]) > 0


def test_a_cutoff_is_searched_for_with_a_wide_edge_where_the_softness_is_known():
    def spot(softness: float) -> ds.Scene:
        light = ds.SpotLight((0, 0, 5), (0, 0, -1), 1.0, 25.0, 3.0, softness=softness)
        return ds.Scene(ds.Object(ds.Sphere()), light)

    def softness(scene: ds.Scene, *free: str) -> float:
        views = [ds.View(np.zeros((8, 8, 3)), SMALL)]
        return float(with_wide_edges(scene, find_unknowns(scene, views, free)).lights[0].softness)  # pyright: ignore[reportAttributeAccessIssue]

    assert softness(spot(2.0), "cutoff") == 5.0
    assert softness(spot(7.0), "cutoff") == 7.0
    assert softness(spot(2.0), "cutoff", "softness") == 2.0
    assert softness(spot(2.0), "exponent") == 2.0


def test_a_search_for_more_than_a_material_is_local_and_that_of_an_index_leaves_out_what_is_steep():
    ball = ds.Scene(ds.Object(ds.Sphere(), ds.Material(k_t=0.5, eta=1.7)), ds.PointLight((0, 0, 5)))
    views = [ds.View(np.zeros((8, 8, 3)), SMALL)]
    for free, local, steep in (
        (("k_d", "n_s"), False, False),
        (("k_d", "position"), True, False),
        (("eta",), True, True),
    ):
        unknowns = find_unknowns(ball, views, free)
        assert is_local(unknowns) == local
        assert (steepest(unknowns) is not None) == steep


def test_of_a_list_of_costs_the_local_minima_are_followed_each_once():
    assert _lowest([3.0, 1.0, 2.0, 0.5, np.inf, 4.0]) == [1, 3, 5]
    assert _lowest([np.inf, np.inf]) == []
    assert _lowest([1.0, 1.0]) == [0, 1]
    a, b = np.zeros(2), np.array([0.0, 1e-6])
    assert [cost for cost, _ in _distinct([(1.0, a), (2.0, b), (3.0, a + 1e-12)])] == [1.0, 2.0]
