"""Shadows: a light reaches a point only if nothing opaque stands between."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest
from refusals import refuses
from shadows import WHITE, expected, inner, ring, scenes

import diffshade as ds

FLOOR = ds.Object(ds.Plane((0, -1, 0)), WHITE)
ABOVE = ds.OrthographicCamera((0, 5, 0), target=(0, 0, 0), up=(0, 0, -1), shape=(16, 16), height=4)
DOWN = ds.DirectionalLight((0, -1, 0))


@pytest.mark.thorough
@pytest.mark.parametrize("number", [0, *(i for i in range(1, 10))])
def test_povray_lights_the_same_pixels(number):
    """But for pixels on an edge."""
    scene, camera = list(scenes())[number]
    of_povray = expected()[number]
    lit: Any = (np.asarray(ds.render(scene, camera)) > 0).any(-1)
    here = inner(of_povray)
    assert here.mean() > 0.7
    np.testing.assert_array_equal(lit[here], of_povray[here])
    without: Any = np.asarray(ds.render(dataclasses.replace(scene, shadows=False), camera)).any(-1)
    assert (without & ~of_povray & here).sum() > 100  # there is a shadow


@pytest.mark.thorough
def test_only_what_stands_between_and_is_opaque():
    """A ball 1 above the floor, of radius .5, seen from above beside its own shadow."""
    ball = ds.Sphere((0, 0, 0), 0.5)
    slanted = ds.DirectionalLight((1, -1, 0))

    def lit(light, material=WHITE, shape: Any = ball):
        image = ds.render(ds.Scene([FLOOR, ds.Object(shape, material)], light, 0, shadows=True), ABOVE)
        return (np.asarray(image)[8, [3, 12]] > 0).any(-1).tolist()  # the floor at x = -1.1 and at x = 1.1

    assert lit(slanted) == [True, False]
    assert lit(ds.PointLight((-2, 1, 0))) == [True, False]
    assert lit(ds.PointLight((0.6, -0.6, 0))) == [True, True]  # below the ball
    assert lit(slanted, ds.Material(k_d=0.5, k_t=0.5)) == [True, True]
    assert lit(slanted, shape=ds.Box(size=(1, 1, 1))) == [True, False]


@pytest.mark.thorough
def test_an_area_light_has_a_penumbra_and_its_ambient_light_is_kept_back_too():
    lamp = ds.AreaLight((-0.5, 3, -0.5), (1, 0, 0), (0, 0, 1), cutoff=90, exponent=0, samples=6)
    disc = ds.Object(ds.Box((0, 1, 0), (0.5, 0.1, 0.5)), ds.Material())
    scene = ds.Scene([FLOOR, disc], lamp, 0, shadows=True)
    below = ds.OrthographicCamera((0, 0.5, 0), target=(0, -1, 0), up=(0, 0, -1), shape=(33, 33), height=3)
    shadow = np.asarray(ds.render(scene, below))[16, :, 0]
    free = np.asarray(ds.render(dataclasses.replace(scene, shadows=False), below))[16, :, 0]
    share = shadow / free
    assert share[0] == 1
    assert share[16] == 0
    assert (np.diff(share[:17]) <= 1e-6).all()
    assert len(np.unique(np.round(share[:17], 3))) > 4
    own = ds.Scene([ds.Object(FLOOR.surface, ds.Material(k_a=1)), disc], dataclasses.replace(lamp, ambient=1.0), 0)
    kept = np.asarray(ds.render(dataclasses.replace(own, shadows=True), below))[16, :, 0]
    assert kept[16] == 0 < kept[0]


@pytest.mark.thorough
def test_derivatives_are_those_of_what_is_lit():
    def brightness(intensity, shadows):
        lamp = ds.PointLight((-1, 3, 1), intensity)
        scene = ds.Scene([FLOOR, ds.Object(ds.Sphere(radius=0.5), WHITE)], lamp, 0, shadows=shadows)
        return ds.render(scene, ABOVE).sum()

    value, slope = jax.value_and_grad(lambda i: brightness(i, True))(2.0)
    np.testing.assert_allclose(2.0 * slope, value, rtol=1e-12)
    assert value < brightness(2.0, False)


@pytest.mark.thorough
def test_a_fit_under_shadows_finds_the_material():
    """With the geometry known, a ring above a floor."""
    floor = ds.Object(FLOOR.surface, ds.Material(0.3, 0.6), name="floor")
    above = ds.Object(ds.Mesh(*ring(around=12, across=6)), WHITE)
    truth = ds.Scene([floor, above], ds.PointLight((-1, 2, 1), 0.8), 0.2, shadows=True)
    view = ds.View(np.asarray(ds.render(truth, ABOVE)).mean(-1), ABOVE)
    found = ds.fit(truth, [view], free=("floor.material.k_a", "floor.material.k_d")).scene.objects[0].material
    np.testing.assert_allclose((found.k_a[0], found.k_d[0]), (0.3, 0.6), rtol=1e-6)


@pytest.mark.thorough
def test_a_mesh_is_met_by_any_ray():
    """A mesh of a box is that box: seen, shaded and through glass that bends rays."""
    corners = 0.4 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    mesh, box = ds.Mesh(corners, faces), ds.Box(size=(0.8, 0.8, 0.8))
    np.testing.assert_allclose(mesh.extent(), box.extent())
    glass = ds.Object(ds.Sphere((0.1, 0, 1.5), 0.5), ds.Material(k_s=0.2, k_t=0.9, eta=1.4))
    camera = ds.Camera(eye=(1.1, 0.8, 4), fov=35, shape=(48, 48))

    def image(shape):
        objects = [FLOOR, ds.Object(shape, ds.Material(0.1, 0.7, 0.3, 9)), glass]
        return np.asarray(ds.render(ds.Scene(objects, ds.PointLight((2, 3, 2)), shadows=True), camera))

    other = np.abs(image(mesh) - image(box)).max(-1) > 1e-9
    assert other.mean() < 0.01  # rays through an edge of either
    points = ds.intersect(ds.Scene(ds.Object(mesh)), camera)
    p = np.asarray(points.position)[np.asarray(points.mask)]
    np.testing.assert_allclose(np.abs(p).max(-1), 0.4, rtol=1e-6)


@pytest.mark.thorough
def test_normals_between_those_of_the_vertices():
    vertices, faces = ring(around=64, across=32)
    circle = vertices * (1, 1, 0) / np.linalg.norm(vertices[:, :2], axis=-1, keepdims=True)
    camera = ds.OrthographicCamera((0, 0, 3), shape=(32, 32), height=3)
    found = ds.intersect(ds.Scene(ds.Object(ds.Mesh(vertices, faces, normals=vertices - circle))), camera)
    p, n = (np.asarray(of)[np.asarray(found.mask)] for of in (found.position, found.normal))
    middle = p * (1, 1, 0) / np.linalg.norm(p[:, :2], axis=-1, keepdims=True)
    exact = (p - middle) / np.linalg.norm(p - middle, axis=-1, keepdims=True)
    assert np.abs(n - exact).max() < 0.02
    assert len(n) > 200


def test_a_ray_meets_the_nearest_triangle_of_a_mesh():
    """A square behind half of another one."""
    square = np.array([(-1.0, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    vertices = np.concatenate([square * (0.5, 1, 1) - (0.5, 0, 0), square * (0.75, 1, 1) - (0.25, 0, 1)])
    mesh = ds.Mesh(vertices, [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)])
    found = ds.intersect(ds.Scene(ds.Object(mesh)), ds.OrthographicCamera((0, 0, 4), shape=(8, 8), height=2.0))
    assert np.asarray(found.mask).tolist() == [[True] * 6 + [False] * 2] * 8  # to x = 0.5
    np.testing.assert_allclose(np.asarray(found.position)[:, :6, 2], [[0.0] * 4 + [-1.0] * 2] * 8, atol=1e-6)
    np.testing.assert_allclose(np.asarray(found.normal)[:, :6], np.broadcast_to([0.0, 0, 1], (8, 6, 3)), atol=1e-6)


def test_what_has_no_shadow_is_refused():
    camera = ds.OrthographicCamera((0, 0, 4), shape=(8, 8))
    buffer = ds.intersect(ds.Scene(ds.Object(ds.Sphere())), camera)
    refuses(lambda: ds.Scene(ds.Object(buffer, WHITE), DOWN, shadows=True), "GBuffer", "shadows=True", "Mesh")
    view = ds.View(np.ones((8, 8, 3)), camera)
    scene = ds.Scene(ds.Object(ds.Sphere(), WHITE), DOWN, shadows=True)
    refuses(lambda: ds.fit_texels(scene, [view] * 3, free=("k_d",)), "shadows=True", "ds.fit")
    refuses(lambda: ds.Mesh(np.zeros((3, 2)), [(0, 1, 2)]), "Mesh.vertices", "(3, 2)")
    refuses(lambda: ds.Mesh(np.zeros((3, 3)), [(0, 1, 3)]), "Mesh.faces", "3 vertices", "3")
    refuses(lambda: ds.Mesh(np.full((3, 3), np.nan), [(0, 1, 2)]), "Mesh.vertices", "finite")
    refuses(lambda: ds.Mesh(np.eye(3), [(0, 1, 2)], normals=np.zeros((3, 3))), "Mesh.normals", "3 vertices")


def test_shadows_stand_in_scene_files(tmp_path):
    scene = ds.Scene(FLOOR, DOWN, shadows=True)
    ds.write_scene(tmp_path / "a.toml", scene)
    assert ds.read_scene(tmp_path / "a.toml").shadows
