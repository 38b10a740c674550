"""Renders equal those of the oracle, a second implementation that shares nothing with the library."""

import itertools

import numpy as np
import oracle
import pytest
from oracle_scenes import (
    LOBES,
    LONG_TO_COMPILE,
    OFF_AXIS,
    ONE_OF_EACH,
    SCENES,
    assert_same,
    chequer,
    directional,
    fog,
    library_camera,
    library_scene,
    needed,
    orthographic,
    perspective,
    point,
    scene_of,
    sphere,
    spot,
)

import diffshade as ds


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LONG_TO_COMPILE)) for n in SCENES])
def test_render(name):
    scene, camera = SCENES[name]
    expected = oracle.render(scene, camera)
    assert_same(ds.render(library_scene(scene), library_camera(camera)), expected)


def share_of_points_that_change(name, **changes):
    scene, camera = SCENES[name]
    image, changed = (
        oracle.render(scene | {"lights": [light | c for light in scene["lights"]]}, camera) for c in ({}, changes)
    )
    inside = (image != scene["background"]).any(-1)
    return (image != changed).any(-1)[inside].mean()


def test_the_scenes_show_what_their_names_say():
    dark = {"intensity": (0, 0, 0)}
    lit = share_of_points_that_change("point, clamped here and there", **dark)
    clamped = share_of_points_that_change("point, clamped here and there", clamp=False)
    assert 0.1 < clamped < lit - 0.1
    for name in ("hard spot", "hard spot with exponent", "soft spot", "spot soft up to its axis"):
        in_the_cone = share_of_points_that_change(name, **dark)
        outside = share_of_points_that_change(name, cutoff=90, softness=0)
        assert in_the_cone > 0.2
        assert outside > 0.2
    scene, camera = SCENES["one sphere before the other"]
    together = oracle.render(scene, camera)
    for i in range(2):
        alone = oracle.render(scene | {"objects": scene["objects"][i : i + 1]}, camera)
        assert (together != alone).any(-1).sum() > 10


def without(part, *names):
    return {k: v for k, v in part.items() if k not in names}


def with_materials(scene, change):
    return scene | {"objects": [item | {"material": change(item["material"])} for item in scene["objects"]]}


# For each equation that the first scenes do without: the scene as it would be without that equation.
LESS = {
    "E7": lambda scene: with_materials(scene, lambda m: without(m, "fresnel")),
    "E10": lambda scene: with_materials(scene, lambda m: without(m, "O_d", "O_s")),
    "E11": lambda scene: (
        scene
        | {"lights": [light | {"samples": (1, 1)} if light["type"] == "area" else light for light in scene["lights"]]}
    ),
    "E12": lambda scene: with_materials(scene, lambda m: m | {"eta": 1.0}),
    "E13": lambda scene: with_materials(scene, lambda m: without(m, "k_t")),
    "E14": lambda scene: without(scene, "atmosphere"),
}


@pytest.mark.parametrize("equation", LESS)
def test_a_scene_that_needs_an_equation_would_look_different_without_it(equation):
    of_it = [name for name, (scene, _) in SCENES.items() if equation in needed(scene)]
    assert of_it
    for name in of_it:
        scene, camera = SCENES[name]
        picture, less = oracle.render(scene, camera), oracle.render(LESS[equation](scene), camera)
        assert (np.abs(picture - less) > 1e-4).any(-1).mean() > 0.05, name


def test_the_scenes_of_glass_show_what_their_names_say():
    """Total reflection is seen on the rim of a bubble and in a glass box, and nowhere in a glass ball."""

    def opaque(name):
        """Count the pixels that show the first object and nothing behind it."""
        scene, camera = SCENES[name]
        alone = scene | {"objects": scene["objects"][:1]}
        black, white = (oracle.render(alone | {"background": (x,) * 3}, camera) for x in (0, 9))
        solid = oracle.render(with_materials(alone, lambda m: without(m, "k_t")) | {"background": (9,) * 3}, camera)
        return ((black == white) & (solid != 9)).all(-1).sum()

    assert opaque("a bubble before a wall") > 10
    assert opaque("a glass box before a wall") > 10
    assert opaque("a box thinner than air before a wall") > 3
    assert opaque("camera in a glass box") > 10
    assert opaque("a glass ball before a wall") == 0
    assert opaque("a slab before a wall") == 0
    scene, camera = SCENES["three overlap"]
    alone = [oracle.render(scene | {"objects": [item]}, camera) != scene["background"] for item in scene["objects"]]
    assert np.all(alone, 0).any(-1).sum() > 5
    for name in ("depth cueing", "depth cueing, along the ray"):
        scene, camera = SCENES[name]
        air = scene["atmosphere"]
        picture = oracle.render(scene, camera)
        near = (oracle.render(without(scene, "atmosphere"), camera) == picture) & (picture != scene["background"])
        assert near.all(-1).sum() > 3  # nearer than z_f
        assert (picture == air["I_dc"]).all(-1).sum() > 3  # beyond z_b
        between = ~near & (picture != air["I_dc"]) & (picture != scene["background"])
        assert between.all(-1).sum() > 10


@pytest.mark.parametrize("order", list(itertools.permutations(range(3)))[1:])
def test_the_order_of_transparent_objects_changes_nothing(order):
    scene, camera = SCENES["three of glass overlap"]
    reordered = scene | {"objects": [scene["objects"][i] for i in order]}
    images = [np.asarray(ds.render(library_scene(s), library_camera(camera))) for s in (scene, reordered)]
    np.testing.assert_allclose(images[1], images[0], rtol=1e-15, atol=0)


@pytest.mark.slow
def test_the_order_of_objects_of_many_kinds_changes_nothing():
    scene, camera = SCENES["two kinds of glass"]
    reordered = scene | {"objects": scene["objects"][::-1]}
    images = [np.asarray(ds.render(library_scene(s), library_camera(camera))) for s in (scene, reordered)]
    np.testing.assert_allclose(images[1], images[0], rtol=1e-14, atol=0)


@pytest.mark.parametrize("lit", [(), (0,), (1,), (2, 0), (0, 1, 2, 3)])
def test_only_the_lights_that_are_lit(lit):
    scene, camera = scene_of([sphere()], ONE_OF_EACH), perspective()
    expected = oracle.render(scene | {"lights": [ONE_OF_EACH[i] for i in lit]}, camera)
    assert_same(ds.render(library_scene(scene), library_camera(camera), lit=lit), expected)


@pytest.mark.parametrize("lobe", LOBES)
@pytest.mark.parametrize("local_viewer", [True, False])
def test_shade_a_gbuffer(lobe, local_viewer):
    random = np.random.default_rng(7)
    shape = (12, 16)
    normal = random.normal(size=(*shape, 3))  # to all sides: a G-buffer's normals are never flipped
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    position = random.normal(size=(*shape, 3))
    mask = random.random(shape) < 0.7
    normal[~mask] = position[~mask] = np.nan
    scene = scene_of([sphere(lobe=lobe)], [*ONE_OF_EACH, spot((-3, 0, 1), (3, 0, -1), cutoff=40, softness=3)])
    camera = perspective(**OFF_AXIS, local_viewer=local_viewer)
    expected = oracle.shade(scene, normal, position, mask, camera)
    image = ds.shade(library_scene(scene), ds.GBuffer(normal, position, mask), library_camera(camera))
    assert_same(image, expected)


def test_shade_a_gbuffer_in_fog():
    random = np.random.default_rng(8)
    position = random.normal(size=(12, 16, 3))
    normal = np.broadcast_to([0.6, 0, 0.8], position.shape)
    mask = random.random((12, 16)) < 0.7
    scene, camera = scene_of([sphere(k_d=chequer())], [directional()], atmosphere=fog()), perspective(**OFF_AXIS)
    expected = oracle.shade(scene, normal, position, mask, camera)
    assert_same(ds.shade(library_scene(scene), ds.GBuffer(normal, position, mask), library_camera(camera)), expected)


def test_shade_normals_alone():
    normal = np.array([[(0, 0, 1), (0.6, 0, 0.8), (0, 0, -1), (0, 0, 0)]], float)
    scene = scene_of([sphere(n_s=3)], [directional((-1, -1, -1)), directional((1, 0, 0))])
    camera = orthographic(local_viewer=False, shape=(1, 4))
    mask = np.array([[True, True, True, False]])  # where the normal is not zero
    expected = oracle.shade(scene, normal, np.zeros_like(normal), mask, camera)
    assert_same(ds.shade(library_scene(scene), ds.GBuffer(normal), library_camera(camera)), expected)


# One point in an exact position to one light and the viewer: n, l, v and d at the edges of every definition.
UP, DOWN, RIGHT, LEFT = (0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0)
CORNERS = {
    "light on the point": (UP, point((0, 0, 0), attenuation=(0, 0, 1)), UP),
    "light nearly on the point": (UP, point((0, 0, 1e-7), attenuation=(0, 0, 1)), UP),
    "light grazes": (UP, point((2, 0, 0)), UP),
    "light behind": (UP, point((0, 0, -2)), UP),
    "l = v = n": (UP, point((0, 0, 3)), UP),
    "l = -v": (UP, point((0, 0, 4)), DOWN),  # lengths of 2^k: l + v is exactly 0
    "v.r = 0": (UP, point((0, 0, 3)), RIGHT),
    "n.h = 0": (UP, point((4, 0, 4)), (1, 0, -1)),
    "viewer behind": (UP, point((3, 0, 1)), (-1, 0, -2)),
    "n.l > 0, mirror direction away from the viewer": (UP, point((3, 0, 1)), (3, 0, 1)),
    "cutoff 0, on the axis": (UP, spot((0, 0, 2), DOWN, cutoff=0, exponent=3), UP),
    "cutoff 0, off the axis": (UP, spot((0.1, 0, 2), DOWN, cutoff=0), UP),
    "cutoff 90, at 90 degrees, exponent 0": (LEFT, spot((-2, 0, 0), UP, cutoff=90), LEFT),
    "cutoff 90, at 90 degrees, exponent 2": (LEFT, spot((-2, 0, 0), UP, cutoff=90, exponent=2), LEFT),
    "cutoff 90, soft, at 90 degrees": (LEFT, spot((-2, 0, 0), UP, cutoff=90, softness=5), LEFT),
    "cutoff 90, on the axis": (UP, spot((0, 0, 2), DOWN, cutoff=90, exponent=4), UP),
    "cutoff 90, behind the spot": (UP, spot((0, 0, 2), UP, cutoff=90), UP),
    "cutoff 90, all of it soft": (UP, spot((1, 0, 2), DOWN, cutoff=90, softness=90), UP),
    "spot on the point": (UP, spot((0, 0, 0), DOWN, cutoff=90), UP),
    "attenuation of exactly 1": (UP, point((0, 0, 2), attenuation=(0, 0, 0.25), clamp=True), UP),
    "attenuation clamped on the point's own skin": (UP, point((0, 0, 1e-3), attenuation=(0, 0, 1), clamp=True), UP),
}


@pytest.mark.parametrize(("n", "light", "towards_viewer"), CORNERS.values(), ids=CORNERS)
def test_corner(n, light, towards_viewer):
    camera = orthographic(eye=tuple(4 * x for x in towards_viewer), up=(0, 1, 0), shape=(1, 1))
    normal, position = np.array([[n]], float), np.zeros((1, 1, 3))
    gbuffer = ds.GBuffer(normal, position)
    for lobe in LOBES:
        for n_s in (0, 1, 0.5, 30):
            scene = scene_of([sphere(lobe=lobe, n_s=n_s)], [light])
            expected = oracle.shade(scene, normal, position, np.array([[True]]), camera)
            assert_same(ds.shade(library_scene(scene), gbuffer, library_camera(camera)), expected)
