"""The scenes that the oracle and the library both render: plain dicts, and how the library writes them."""

from typing import Any

import numpy as np

import diffshade as ds

LOBES = {"phong": ds.Phong(), "blinn": ds.Blinn()}
FRESNEL = {"none": ds.NoFresnel(), "schlick": ds.Schlick(), "dielectric": ds.Dielectric()}
SURFACES = {"sphere": ds.Sphere, "plane": ds.Plane, "box": ds.Box}
LIGHTS = {
    "point": ds.PointLight,
    "directional": ds.DirectionalLight,
    "spot": ds.SpotLight,
    "area": ds.AreaLight,
}


def material(k_a=(0.1, 0.05, 0.2), k_d=(0.7, 0.25, 0.2), k_s=(0.4, 0.5, 0.6), n_s=12.5, lobe="phong", **more):
    return {"k_a": k_a, "k_d": k_d, "k_s": k_s, "n_s": n_s, "lobe": lobe, **more}


def sphere(center=(0, 0, 0), radius=1.0, **coefficients):
    return {"type": "sphere", "center": center, "radius": radius, "material": material(**coefficients)}


def plane(point=(0, -1, 0), normal=(0, 1, 0), **coefficients):
    return {"type": "plane", "point": point, "normal": normal, "material": material(**coefficients)}


def box(center=(0, 0, 0), size=(1.2, 0.9, 1.4), rotation=(0, 0, 0), **coefficients):
    return {"type": "box", "center": center, "size": size, "rotation": rotation, "material": material(**coefficients)}


def chequer(a=(0.9, 0.8, 0.7), b=(0.1, 0.2, 0.3), period=0.73, **more):
    return {"a": a, "b": b, "period": period, **more}


def glass(k_t=(0.9, 0.8, 0.7), eta=1.5, **more):
    """Of the coefficients of a transparent object."""
    return {"k_t": k_t, "eta": eta, **more}


def made_of(item, coefficients):
    """Return an object with some of its coefficients changed."""
    return item | {"material": item["material"] | coefficients}


def point(position=(2, 3, 4), intensity=(5, 4, 3), **more):
    return {"type": "point", "position": position, "intensity": intensity, **more}


def directional(direction=(1, -1, -2), intensity=(0.3, 0.6, 0.9)):
    return {"type": "directional", "direction": direction, "intensity": intensity}


def spot(position=(1, 2, 3), direction=(-1, -2.2, -3), intensity=(3, 4, 5), cutoff=20.0, exponent=0.0, **more):
    here = {"position": position, "direction": direction, "intensity": intensity}
    return {"type": "spot", **here, "cutoff": cutoff, "exponent": exponent, **more}


def area(corner=(-0.5, 1, 1.9), edge_u=(0, 0.8, -0.9), edge_v=(1.6, 0, 0), intensity=(3, 2, 1), samples=(3, 2), **more):
    here = {"corner": corner, "edge_u": edge_u, "edge_v": edge_v, "intensity": intensity, "samples": samples}
    return {"type": "area", **here, **more}


def depth_cueing(z_f=3.0, z_b=5.0, s_f=1.0, s_b=0.0, I_dc=(0.5, 0.6, 0.7), **more):
    return {"type": "depth cueing", "z_f": z_f, "z_b": z_b, "s_f": s_f, "s_b": s_b, "I_dc": I_dc, **more}


def fog(density=0.2, I_dc=(0.5, 0.6, 0.7), **more):
    return {"type": "fog", "density": density, "I_dc": I_dc, **more}


def scene_of(objects, lights, ambient=(0.9, 1, 0.8), background=(0.01, 0.02, 0.03), atmosphere=None):
    scene = {"objects": objects, "lights": lights, "ambient": ambient, "background": background}
    return scene if atmosphere is None else scene | {"atmosphere": atmosphere}


def perspective(eye=(0, 0, 4), target=(0, 0, 0), up=(0, 1, 0), fov=36, shape=(12, 16), local_viewer=True):
    return {"eye": eye, "target": target, "up": up, "fov": fov, "shape": shape, "local_viewer": local_viewer}


def orthographic(eye=(0, 0, 4), target=(0, 0, 0), up=(0, 1, 0), height=2.4, shape=(12, 16), local_viewer=True):
    return {"eye": eye, "target": target, "up": up, "height": height, "shape": shape, "local_viewer": local_viewer}


def library_light(light):
    numbers = {k: v for k, v in light.items() if k not in ("type", "attenuation", "clamp")}
    if light["type"] == "directional":
        return ds.DirectionalLight(**numbers)
    attenuation = ds.RadialAttenuation(*light.get("attenuation", (1, 0, 0)), clamp=light.get("clamp", False))
    if "flaps" in light:
        numbers["flaps"] = ds.Flaps(**light["flaps"])
    return LIGHTS[light["type"]](**numbers, attenuation=attenuation)


def library_material(given):
    values: dict[str, Any] = {k: ds.Chequer(**v) if isinstance(v, dict) else v for k, v in given.items()}
    values |= {"lobe": LOBES[given["lobe"]], "fresnel": FRESNEL[given.get("fresnel", "none")]}
    return ds.Material.foley(**values) if "O_d" in given else ds.Material(**values)


def library_object(item):
    numbers = {k: v for k, v in item.items() if k not in ("type", "material")}
    return ds.Object(SURFACES[item["type"]](**numbers), library_material(item["material"]))


def library_atmosphere(air):
    numbers = {k: v for k, v in air.items() if k != "type"}
    return ds.DepthCueing(**numbers) if air["type"] == "depth cueing" else ds.Fog(**numbers)


def library_scene(scene):
    air = scene.get("atmosphere")
    return ds.Scene(
        [library_object(item) for item in scene["objects"]],
        [library_light(light) for light in scene["lights"]],
        scene["ambient"],
        scene["background"],
        None if air is None else library_atmosphere(air),
    )


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

FAINT = (0.02, 0.05, 0.1)  # k_s from which Schlick's W rises far
ONE = [point(attenuation=(0.4, 0.2, 0.1))]
TWO = [*ONE, directional()]
# From 1.2 to 8.6 along the view axis: nearer than z_f, between, and beyond z_b.
ROW = [
    sphere((-0.9, -0.3, 2.2), 0.5),
    sphere((-0.3, 0.2, 0.5), 0.7, k_d=(0.2, 0.7, 0.3)),
    sphere((1.6, 0.6, -3), 1.6, k_d=(0.2, 0.3, 0.9)),
]
WALL = plane((0, 0, -2.5), (0, 0, 1), k_a=chequer(), k_d=(0.1, 0.1, 0.1))
BALL = sphere((0.1, 0.05, 0.2), 0.9, **glass())
GLASS_BOX = box((0.1, 0, 0.3), (1.3, 1.1, 0.9), (25, 35, 10), **glass())
# Three objects whose pictures overlap: all behind the first are seen through it. (Of one kind, so that any order of
# them is one compiled program.)
THREE = [
    sphere((-0.35, 0.1, 1), 0.55, **glass((0.7, 0.8, 0.9), 1.0)),
    sphere((0.15, 0.1, 0), 0.7, n_s=40, **glass((0.5, 0.9, 0.6), 1.0)),
    sphere((0.2, -0.3, -1.6), 0.9, k_d=(0.1, 0.2, 0.9), **glass((0.8, 0.4, 0.7), 1.0)),
]
MANY = [
    plane((0, 0, 1.9), (0.1, 0.1, 1), **glass((0.9, 0.9, 0.8), 1.0)),
    sphere((-0.2, 0.1, 1), 0.6, **glass((0.9, 0.8, 0.9), 1.2)),
    box((0.2, 0.1, -0.4), (1.1, 1.2, 0.5), (20, 30, 10), **glass((0.8, 0.9, 0.9), 1.3)),
    sphere((0.2, -0.2, -2), 0.9, **glass((0.9, 0.7, 0.9), 1.1)),
    box((-0.2, 0, -3.6), (2.1, 1.9, 0.6), (-10, 15, 40), **glass((0.9, 0.9, 0.9), 1.05)),
    plane((0, 0, -5), (0, 0.1, -1), k_a=chequer(period=1.1), **glass((0.3, 0.2, 0.1), 1.0)),
]
MIXED = [
    sphere((-0.8, 0.4, 0), 0.5, lobe="blinn", n_s=30),
    sphere((0.1, 0.5, 0.3), 0.4, fresnel="schlick", k_s=FAINT, n_s=2),
    box((0.9, 0.3, 0), (0.7, 0.6, 0.7), (30, 40, 0), fresnel="dielectric", k_s=(0, 0, 0), eta=1.5, n_s=3),
    sphere((-0.3, -0.4, 0.8), 0.4, n_s=(3.0, 20.0, 90.0)),
    box((0.7, -0.5, 0.4), (0.6, 0.5, 0.4), (10, -30, 20), lobe="blinn", n_s=(9.0, 2.0, 40.0), k_e=(0.1, 0, 0.2)),
    plane((0, -0.9, 0), fresnel="schlick", lobe="blinn", k_d=chequer(u=(1, 0, 0), v=(0, 0, 1))),
]
TWO_KINDS_OF_GLASS = [
    sphere((-0.3, 0, 1), 0.6, lobe="blinn", fresnel="schlick", k_s=FAINT, n_s=4, **glass(eta=1.3)),
    box((0.5, 0.1, 0), (0.9, 1.1, 0.6), (10, 35, 5), fresnel="dielectric", k_s=(0, 0, 0), n_s=4, **glass(eta=1.45)),
    plane((0, 0, -2.5), (0, 0, 1), k_a=(0.5, 0.4, 0.3)),
]
MIXED_GLASS = [*TWO_KINDS_OF_GLASS[:2], sphere((0, -0.2, -1.5), 0.8, n_s=(3.0, 20.0, 90.0), **glass(eta=1.0)), WALL]
NEAR_BALL = {"eye": (0.4, 0.1, 0.5), "target": (0.1, 0.05, -2.5), "fov": 70}

SCENES = {
    "point, none of it attenuated": (scene_of([sphere()], [point()]), perspective()),
    "point, all three coefficients, Blinn": (
        scene_of([sphere(lobe="blinn")], [point(attenuation=(0.3, 0.15, 0.07))]),
        perspective(**OFF_AXIS),
    ),
    "point, 1/d": (scene_of([sphere()], [point(attenuation=(0, 1, 0))]), orthographic()),
    "point, 1/d^2": (scene_of([sphere()], [point(attenuation=(0, 0, 1))]), perspective()),
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
        orthographic(**OFF_AXIS, height=3),
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
    "a spot and a point light with flaps": (
        scene_of(
            [sphere()],
            [
                spot(cutoff=20, exponent=5, flaps={"x_min": -0.31, "x_max": 0.42, "y_max": 0.63}),
                point(flaps={"y_min": -0.5, "y_max": 0.5, "z_min": 0.6, "softness": 0.35}),
            ],
        ),
        perspective(),
    ),
    "an area light with flaps": (
        scene_of([sphere()], [area(samples=(2, 2), flaps={"x_min": -0.4, "z_max": 0.9, "softness": 0.2})]),
        perspective(),
    ),
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
    # E7, E9, E10
    "Schlick": (
        scene_of([sphere(fresnel="schlick", k_s=FAINT, n_s=2)], [*ONE, directional((-1, 0.3, 0.2))]),
        perspective(),
    ),
    "Schlick, Blinn": (scene_of([sphere(fresnel="schlick", k_s=FAINT, lobe="blinn", n_s=0.5)], TWO), perspective()),
    "dielectric": (
        scene_of([sphere(fresnel="dielectric", k_s=(0, 0, 0), eta=1.5, n_s=2)], [*TWO, directional((-1, 0.3, 0.2))]),
        perspective(**OFF_AXIS),
    ),
    "dielectric thinner than air, Blinn": (
        scene_of([sphere(fresnel="dielectric", k_s=(0, 0, 0), eta=0.7, n_s=2, lobe="blinn")], TWO),
        perspective(),
    ),
    "emission": (scene_of([sphere(k_e=(0.2, 0.1, 0.05))], TWO), perspective()),
    "Foley's colours": (
        scene_of([sphere(k_a=(0.3, 0.3, 0.3), k_d=(0.6,) * 3, O_d=(0.9, 0.4, 0.2), O_s=(1, 0.8, 0.6))], TWO),
        perspective(),
    ),
    "one n_s a channel": (scene_of([sphere(n_s=(3.0, 20.0, 90.0))], TWO), perspective()),
    # E11
    "area light": (scene_of([sphere()], [area(attenuation=(0.3, 0.1, 0.05))]), perspective()),
    "area light with a cutoff and an exponent": (
        scene_of([sphere(lobe="blinn")], [area(cutoff=25, exponent=3)]),
        perspective(),
    ),
    "area light that shines past the sphere": (
        scene_of([sphere()], [area((-1, 1.3, 0.2), (2, 0, 0), (0, 0.1, 1.3))]),
        perspective(),
    ),
    "area lights of several kinds, and a spot": (
        scene_of(
            [sphere()],
            [
                area(),
                spot(cutoff=12),
                area((-3, 1, 1), (0, 1, -1), (1, 0, 1), attenuation=(0, 0, 0.3)),
                area((-3, -2, 2), (1, 0, -1), (0, 1, 0), samples=(1, 4)),
            ],
        ),
        perspective(**OFF_AXIS),
    ),
    # E14
    "depth cueing": (scene_of(ROW, TWO, atmosphere=depth_cueing()), perspective()),
    "depth cueing, along the ray": (scene_of(ROW, TWO, atmosphere=depth_cueing(radial=True)), perspective(fov=45)),
    "depth cueing between two levels": (
        scene_of(ROW, TWO, atmosphere=depth_cueing(2.5, 6, 0.9, 0.2)),
        perspective(eye=(1.5, 0.5, 4), up=(0.2, 1, 0)),
    ),
    "depth cueing towards the viewer": (scene_of(ROW, TWO, atmosphere=depth_cueing(2, 6, 0.1, 0.8)), perspective()),
    "depth cueing, orthographic": (scene_of(ROW, TWO, atmosphere=depth_cueing()), orthographic(eye=(0.5, 0.3, 4))),
    "depth cueing, orthographic, along the ray": (
        scene_of(ROW, TWO, atmosphere=depth_cueing(radial=True)),
        orthographic(eye=(0.5, 0.3, 4)),
    ),
    "fog": (scene_of(ROW, TWO, atmosphere=fog()), perspective(eye=(1.5, 0.5, 4), up=(0.2, 1, 0))),
    "fog, along the ray": (scene_of(ROW, TWO, atmosphere=fog(radial=True)), perspective(fov=45)),
    "fog, squared": (scene_of(ROW, TWO, atmosphere=fog(squared=True)), perspective(fov=45)),
    "fog, squared, along the ray": (
        scene_of(ROW, TWO, atmosphere=fog(squared=True, radial=True)),
        perspective(fov=45),
    ),
    "fog on an area light, emission and a chequer": (
        scene_of([sphere(k_d=chequer(), k_e=(0.2, 0.1, 0.05))], [area(samples=(2, 2))], atmosphere=fog()),
        perspective(),
    ),
    # planes, boxes, patterns
    "floor": (
        scene_of([sphere(), plane(k_d=chequer(u=(1, 0, 0), v=(0, 0, 1)))], TWO),
        perspective(eye=(0.5, 0.8, 4), fov=60),
    ),
    "floor from below": (
        scene_of([sphere(), plane(normal=(0.1, 2, 0.3), k_d=chequer(u=(1, 0, 0), v=(0, 0, 1)))], TWO),
        perspective(eye=(0.5, -3, 4), fov=60),
    ),
    "box straight on": (scene_of([box()], TWO), orthographic(local_viewer=False)),
    "box from a corner": (scene_of([box()], TWO), perspective(**OFF_AXIS)),
    "boxes, turned": (
        scene_of([box((-0.3, 0, 0), rotation=(20, 30, 40)), box((0.6, 0.2, 0.5), (0.5, 1, 0.7), (-50, 10, 80))], TWO),
        perspective(),
    ),
    "camera inside a box": (
        scene_of([box(size=(4, 3, 9), rotation=(10, 20, 30))], [point((0.5, 0.5, 1))]),
        perspective(eye=(0.5, 0.2, 1), fov=90),
    ),
    "chequered ball, hard": (scene_of([sphere(k_d=chequer())], TWO), perspective()),
    "chequered ball, smooth": (
        scene_of([sphere(k_d=chequer(smooth=True, u=(0.5, 0.5, 0), v=(0, -0.3, 1)))], TWO),
        perspective(),
    ),
    "a pattern in every coefficient": (
        scene_of(
            [
                sphere(
                    k_a=chequer(period=0.4),
                    k_d=chequer(smooth=True),
                    k_s=chequer(period=1.3),
                    k_e=chequer((0.1, 0, 0), (0, 0.1, 0)),
                    k_t=chequer((0.9, 0.5, 0.2), (0, 0.1, 0.3), 0.9),
                ),
                WALL,
            ],
            TWO,
        ),
        perspective(),
    ),
    # E13 with eta = 1: simple transparency
    "a clear ball before a wall": (scene_of([made_of(BALL, glass(eta=1.0)), WALL], ONE), perspective()),
    "a clear ball alone": (scene_of([made_of(BALL, glass(eta=1.0))], ONE), perspective()),
    "k_t of 0 and 1": (scene_of([made_of(BALL, glass((0, 1, 0.5), 1.1)), WALL], ONE), perspective()),
    "three overlap": (scene_of(THREE, ONE), perspective()),
    "three of glass overlap": (scene_of([made_of(ball, glass(eta=1.3)) for ball in THREE], ONE), perspective()),
    # E12
    "a glass ball before a wall": (scene_of([BALL, WALL], ONE), perspective()),
    "a glass ball before a wall, orthographic": (scene_of([BALL, WALL], ONE), orthographic(**OFF_AXIS)),
    "a bubble before a wall": (scene_of([made_of(BALL, glass(eta=0.75)), WALL], ONE), perspective()),
    "a glass box before a wall": (scene_of([GLASS_BOX, WALL], ONE), perspective()),
    "a box thinner than air before a wall": (
        scene_of([made_of(GLASS_BOX, glass(eta=0.8)), WALL], ONE),
        perspective(),
    ),
    "a slab before a wall": (
        scene_of([box((0, 0, 0.3), (9, 9, 0.9), (0, 30, 0), **glass(eta=1.61)), WALL], ONE),
        perspective(),
    ),
    "camera in a glass ball": (
        scene_of([sphere((0.1, 0.05, 0.2), 1.9, **glass()), WALL], ONE),
        perspective(**NEAR_BALL),
    ),
    "camera in a glass box": (
        scene_of([box((0.1, 0, 0.3), (2.5, 2.1, 3), (25, 35, 10), **glass()), WALL], ONE),
        perspective(**NEAR_BALL),
    ),
    "a glass ball in a wall": (
        scene_of([BALL, WALL | {"point": (0, 0, 0.1), "normal": (0.3, 0.1, 1)}], ONE),
        perspective(),
    ),
    "a ball in a glass ball": (scene_of([BALL, sphere((0.2, 0, 0.1), 0.4), WALL], ONE), perspective()),
    "a glass ball in a glass ball": (
        scene_of([BALL, sphere((0.2, 0, 0.1), 0.4, **glass((0.6, 0.7, 0.8), 1.8)), WALL], ONE),
        perspective(),
    ),
    "one glass ball behind the other": (
        scene_of([sphere((-0.2, 0, -1.4), 1.1, **glass(eta=1.2)), BALL, WALL], ONE),
        perspective(),
    ),
    "glass balls that overlap": (
        scene_of([sphere((-0.5, 0.1, -0.3), 0.8, **glass(eta=1.2)), BALL, WALL], ONE),
        perspective(),
    ),
    "a clear plane through a glass ball": (
        scene_of([BALL, plane((0, 0, 0.1), (0.3, 0.1, 1), **glass((0.5, 0.6, 0.7), 1.0)), WALL], ONE),
        perspective(),
    ),
    "glass in depth cueing": (scene_of([BALL, WALL], ONE, atmosphere=depth_cueing(3, 7)), perspective()),
    "glass in fog along the ray": (scene_of([BALL, WALL], ONE, atmosphere=fog(radial=True)), perspective()),
    "glass in fog along parallel rays": (scene_of([BALL, WALL], ONE, atmosphere=fog(radial=True)), orthographic()),
    "six deep": (scene_of(MANY, ONE), perspective()),
    # several of everything
    "every lobe, Fresnel term and kind of n_s": (scene_of(MIXED, TWO), perspective(eye=(0.3, 0.5, 4))),
    "two kinds of glass": (scene_of(TWO_KINDS_OF_GLASS, ONE), perspective()),
    "every kind of glass": (scene_of(MIXED_GLASS, ONE, atmosphere=fog(0.1)), perspective()),
}


LONG_TO_COMPILE = {"six deep", "every kind of glass"}
# what the default tier leaves to the others
LONG_TO_RENDER = {
    "a ball in a glass ball",
    "a box thinner than air before a wall",
    "a clear ball before a wall",
    "a glass ball before a wall, orthographic",
    "a glass ball in a glass ball",
    "a glass ball in a wall",
    "a slab before a wall",
    "camera in a glass box",
    "glass in depth cueing",
    "glass in fog along parallel rays",
    "the same, listed back to front",
    "three of glass overlap",
    "six deep",
    "area lights of several kinds, and a spot",
    "every kind of glass",
    "one glass ball behind the other",
    "glass balls that overlap",
    "a clear plane through a glass ball",
    "three overlap",
}


def needed(scene) -> set[str]:
    """Which equations a picture of a scene needs."""
    return equations(library_scene(scene)) | {"E10" for item in scene["objects"] if "O_d" in item["material"]}


def equations(scene: ds.Scene) -> set[str]:
    """Which equations a picture of the library's scene needs; Foley's form (E10) is not seen from there."""
    materials = [item.material for item in scene.objects]
    clear = [m for m in materials if m.k_t is not None]
    lights, lit = scene.lights, len(scene.lights) > 0
    fading = [getattr(light, "attenuation", ds.RadialAttenuation()) for light in lights]
    uses = {
        "E1": any(_some(m.k_a) for m in materials),
        "E2": any((f.constant, f.linear, f.quadratic) != (1, 0, 0) for f in fading),
        "E3": any(isinstance(light, ds.SpotLight | ds.AreaLight) for light in lights),
        "E4": lit and any(_some(m.k_d) for m in materials),
        "E5": lit and any(isinstance(m.lobe, ds.Phong) for m in materials),
        "E6": lit and any(isinstance(m.lobe, ds.Blinn) for m in materials),
        "E7": lit and any(not isinstance(m.fresnel, ds.NoFresnel) for m in materials),
        "E8": lit,
        "E9": len(lights) > 1 or any(_some(m.k_e) for m in materials),
        "E11": any(isinstance(light, ds.AreaLight) for light in lights),
        "E12": any(m.eta not in (None, 1) for m in clear),
        "E13": len(clear) > 0,
        "E14": scene.atmosphere is not None,
    }
    return {name for name, is_used in uses.items() if is_used}


def _some(colour) -> bool:
    return isinstance(colour, ds.Chequer) or bool(np.any(colour))
