"""Renders equal those of the oracle, a second implementation that shares nothing with the library."""

import numpy as np
import oracle
import pytest

import diffshade as ds

LOBES = {"phong": ds.Phong(), "blinn": ds.Blinn()}


def material(k_a=(0.1, 0.05, 0.2), k_d=(0.7, 0.25, 0.2), k_s=(0.4, 0.5, 0.6), n_s=12.5, lobe="phong"):
    return {"k_a": k_a, "k_d": k_d, "k_s": k_s, "n_s": n_s, "lobe": lobe}


def sphere(center=(0, 0, 0), radius=1.0, **coefficients):
    return {"center": center, "radius": radius, "material": material(**coefficients)}


def point(position=(2, 3, 4), intensity=(5, 4, 3), **more):
    return {"type": "point", "position": position, "intensity": intensity, **more}


def directional(direction=(1, -1, -2), intensity=(0.3, 0.6, 0.9)):
    return {"type": "directional", "direction": direction, "intensity": intensity}


def spot(position=(1, 2, 3), direction=(-1, -2.2, -3), intensity=(3, 4, 5), cutoff=20.0, exponent=0.0, **more):
    here = {"position": position, "direction": direction, "intensity": intensity}
    return {"type": "spot", **here, "cutoff": cutoff, "exponent": exponent, **more}


def scene_of(objects, lights, ambient=(0.9, 1, 0.8), background=(0.01, 0.02, 0.03)):
    return {"objects": objects, "lights": lights, "ambient": ambient, "background": background}


def perspective(eye=(0, 0, 4), target=(0, 0, 0), up=(0, 1, 0), fov=36, shape=(12, 16), local_viewer=True):
    return {"eye": eye, "target": target, "up": up, "fov": fov, "shape": shape, "local_viewer": local_viewer}


def orthographic(eye=(0, 0, 4), target=(0, 0, 0), up=(0, 1, 0), height=2.4, shape=(12, 16), local_viewer=True):
    return {"eye": eye, "target": target, "up": up, "height": height, "shape": shape, "local_viewer": local_viewer}


def library_light(light):
    numbers = {k: v for k, v in light.items() if k not in ("type", "attenuation", "clamp")}
    if light["type"] == "directional":
        return ds.DirectionalLight(**numbers)
    attenuation = ds.RadialAttenuation(*light.get("attenuation", (1, 0, 0)), clamp=light.get("clamp", False))
    cls = ds.PointLight if light["type"] == "point" else ds.SpotLight
    return cls(**numbers, attenuation=attenuation)


def library_scene(scene):
    objects = [
        ds.Object(
            ds.Sphere(item["center"], item["radius"]),
            ds.Material(**item["material"] | {"lobe": LOBES[item["material"]["lobe"]]}),
        )
        for item in scene["objects"]
    ]
    return ds.Scene(objects, [library_light(light) for light in scene["lights"]], scene["ambient"], scene["background"])


def library_camera(camera):
    return ds.Camera(**camera) if "fov" in camera else ds.OrthographicCamera(**camera)


def assert_same(image, expected):
    np.testing.assert_allclose(image, expected, rtol=1e-12, atol=1e-14)


OFF_AXIS = {"eye": (2, 3, 3), "target": (0.2, 0.1, -0.1), "up": (0.3, 1, 0.1)}
FRONT_AND_BACK = [
    sphere((0.3, 0, 0.5), 0.7, lobe="blinn", n_s=30),
    sphere((-0.4, 0.2, -1), 1.1, k_d=(0.2, 0.3, 0.9), n_s=3),
]
ONE_OF_EACH = [
    directional(),
    point(attenuation=(0.4, 0.2, 0.1)),
    spot(exponent=5, attenuation=(0, 0, 0.3)),
    point((-3, 1, 2), attenuation=(0.1, 0.05, 0.02), clamp=True),
]

SCENES = {
    "point, none of it attenuated": (scene_of([sphere()], [point()]), perspective()),
    "point, all three coefficients, Blinn": (
        scene_of([sphere(lobe="blinn")], [point(attenuation=(0.3, 0.15, 0.07))]),
        perspective(**OFF_AXIS),
    ),
    "point, 1/d": (scene_of([sphere()], [point(attenuation=(0, 1, 0))]), orthographic()),
    "point, 1/d^2": (scene_of([sphere()], [point(attenuation=(0, 0, 1))]), perspective(shape=(16, 11))),
    "point, clamped here and there": (
        # d runs from .5 to 1.1 on the lit side, and .6 d + .6 d^2 is 1 at d = .88
        scene_of([sphere()], [point((0.8, 0.8, 1), attenuation=(0, 0.6, 0.6), clamp=True)]),
        perspective(),
    ),
    "directional, viewer at infinity": (
        scene_of([sphere(n_s=27)], [directional((-1, -1, -1))]),
        orthographic(local_viewer=False),
    ),
    "directional, viewer at infinity, Blinn, off axis": (
        scene_of([sphere(lobe="blinn", n_s=27)], [directional()]),
        perspective(**OFF_AXIS, local_viewer=False),
    ),
    "orthographic, off axis, local viewer": (
        scene_of([sphere((0.2, -0.1, 0.3), 0.9, n_s=7)], [directional()]),
        orthographic(**OFF_AXIS, shape=(10, 17), height=3),
    ),
    "hard spot": (scene_of([sphere()], [spot(cutoff=12)]), perspective()),
    "hard spot with exponent": (scene_of([sphere()], [spot(cutoff=12, exponent=40)]), perspective()),
    "soft spot": (
        scene_of([sphere(lobe="blinn")], [spot(cutoff=15, exponent=7.5, softness=10, attenuation=(0.5, 0, 0.1))]),
        perspective(),
    ),
    "spot soft up to its axis": (scene_of([sphere()], [spot(cutoff=15, softness=15)]), perspective()),
    "spot of 90 degrees": (scene_of([sphere()], [spot(cutoff=90, exponent=1)]), perspective()),
    "spot with its back to the sphere": (scene_of([sphere()], [spot(direction=(1, 2, 3), cutoff=90)]), perspective()),
    "one light of each kind": (scene_of([sphere()], ONE_OF_EACH), perspective(**OFF_AXIS)),
    "several of each kind": (
        scene_of(
            [sphere(lobe="blinn")],
            [
                *ONE_OF_EACH,
                directional((-1, 0.2, -0.4)),
                point((-2, -3, 1), attenuation=(0, 0, 1)),
                spot((3, 0, 1), (-3, 0, -1), cutoff=30, exponent=2),
                spot((-3, 0, 1), (3, 0, -1), cutoff=17, exponent=0, softness=3),
            ],
        ),
        perspective(**OFF_AXIS),
    ),
    "no light": (scene_of([sphere()], []), perspective()),
    "tilted up past the sphere": (scene_of([sphere()], [point()]), perspective(target=(0, 1.2, 0))),
    "one sphere before the other": (scene_of(FRONT_AND_BACK, ONE_OF_EACH), perspective(fov=50)),
    "the same, listed back to front": (scene_of(FRONT_AND_BACK[::-1], ONE_OF_EACH), perspective(fov=50)),
    "camera inside the sphere": (
        scene_of([sphere(radius=3)], [point((1, 1, 0), attenuation=(1, 0, 0.5))]),
        perspective(eye=(0.5, 0.2, 1)),
    ),
    "sphere behind the camera": (scene_of([sphere((0, 0, 8))], [point()]), perspective()),
    "camera between two spheres": (
        scene_of([sphere((0, 0, 7)), sphere((0.1, 0, 0))], [point()]),
        perspective(),
    ),
    "n_s = 0": (scene_of([sphere(n_s=0)], [directional((1, 0.2, 0.1)), point()]), perspective()),
    "n_s = 0, Blinn": (scene_of([sphere(n_s=0, lobe="blinn")], [directional((1, 0.2, 0.1)), point()]), perspective()),
    "n_s = 200": (scene_of([sphere(n_s=200)], [directional(), point()]), perspective(**OFF_AXIS)),
}


@pytest.mark.parametrize(("scene", "camera"), SCENES.values(), ids=SCENES)
def test_render(scene, camera):
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
