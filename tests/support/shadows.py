"""Ten scenes with shadows, and which of their pixels POV-Ray lights; `python tests/support/shadows.py` asks it again.

White matt spheres, boxes, floors and meshes under points and lights at infinity. What stands in shadows.npz
is POV-Ray 3.7's answer, one bit a pixel.
"""

import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import diffshade as ds
from diffshade.model.surfaces import rotation_axes

FILE = Path(__file__).with_suffix(".npz")
SIDE = 96
WHITE = ds.Material(k_d=1.0)


def ring(thin=0.35, around=24, across=12):
    """A torus around the z axis: it shades itself."""
    u, v = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij")
    vertices = np.stack(
        [(1 + thin * np.cos(v)) * np.cos(u), (1 + thin * np.cos(v)) * np.sin(u), thin * np.sin(v)], -1
    ).reshape(-1, 3)
    at = np.arange(around * across).reshape(around, across)
    right, up = np.roll(at, -1, 0), np.roll(at, -1, 1)
    diagonal = np.roll(right, -1, 1)
    return vertices, np.concatenate(
        [np.stack(of, -1).reshape(-1, 3) for of in ((at, right, diagonal), (at, diagonal, up))]
    )


def turned(vertices, degrees, by):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return vertices @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) + by


def scenes():
    """Yield each scene with its camera."""
    random = np.random.default_rng(3)
    floor, wall = ds.Plane((0, -1, 0), (0, 1, 0)), ds.Plane((0, 0, -2), (0, 0, 1))
    for i in range(10):
        shapes: list = [floor, wall][: 1 + i % 2]
        for _ in range(2):
            shapes.append(ds.Sphere(random.uniform((-1.2, -0.6, -1), (1.2, 0.8, 1)), random.uniform(0.25, 0.5)))
        size, turn = random.uniform(0.3, 0.9, 3), random.uniform(-60, 60, 3)
        shapes.append(ds.Box(random.uniform((-1.2, -0.5, -1), (1.2, 0.8, 1)), size, turn))
        if i % 3 == 0:
            vertices, faces = ring()
            shapes.append(ds.Mesh(turned(0.7 * vertices, random.uniform(-80, 80), random.uniform(-0.4, 0.4, 3)), faces))
        lamp = random.uniform((-2.5, 1.5, 1), (2.5, 3, 3))
        light = ds.DirectionalLight(-lamp) if i % 2 else ds.PointLight(lamp)
        eye = random.uniform((-1.5, 0.2, 4), (1.5, 2, 5))
        camera = ds.Camera(eye, target=(0, -0.2, 0), fov=45, shape=(SIDE, SIDE))
        yield ds.Scene([ds.Object(shape, WHITE) for shape in shapes], light, 0, shadows=True), camera


def pov(scene, camera):
    """Return the scene in POV-Ray's language, with a camera of explicit vectors, so that no hand is turned."""
    backward = (camera.eye - camera.target) / np.linalg.norm(camera.eye - camera.target)
    right = np.cross(camera.up, backward) / np.linalg.norm(np.cross(camera.up, backward))
    width = 2 * np.tan(np.deg2rad(camera.fov) / 2)
    eye, axes = vector(camera.eye), (vector(width * right), vector(width * np.cross(backward, right)))
    lines = [
        "#version 3.7; global_settings { assumed_gamma 1 max_trace_level 2 }",
        "#default { texture { pigment { rgb 1 } finish { ambient 0 diffuse 1 } } }",
        f"camera {{ location {eye} right {axes[0]} up {axes[1]} direction {vector(-backward)} }}",
        *(solid(item.surface) for item in scene.objects),
    ]
    for light in scene.lights:
        if isinstance(light, ds.PointLight):
            lines.append(f"light_source {{ {vector(light.position)} rgb 1 }}")
        else:
            place = -1e4 * light.direction / np.linalg.norm(light.direction)
            lines.append(f"light_source {{ {vector(place)} rgb 1 parallel point_at <0, 0, 0> }}")
    return "\n".join(lines)


def solid(surface):
    match surface:
        case ds.Sphere():
            return f"sphere {{ {vector(surface.center)}, {float(surface.radius):.9g} }}"
        case ds.Plane():
            n = surface.normal / np.linalg.norm(surface.normal)
            return f"plane {{ {vector(n)}, {float(n @ surface.point):.9g} }}"
        case ds.Box():
            half, axes = vector(0.5 * surface.size), [axis.stack() for axis in rotation_axes(surface.rotation)]
            matrix = ", ".join(f"{x:.9g}" for x in np.ravel([*axes, surface.center]))
            return f"box {{ -{half}, {half} matrix <{matrix}> }}"
        case _:
            triangles = np.reshape(surface.corners, (-1, 3, 3))
            each = (f"triangle {{ {', '.join(map(vector, corners))} }}" for corners in triangles)
            return f"mesh {{ {' '.join(each)} }}"


def vector(numbers):
    return "<" + ", ".join(f"{float(x):.9g}" for x in numbers) + ">"


def lit_by_povray(scene, camera):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scene.pov")
        file.write_text(pov(scene, camera))
        options = [f"+W{SIDE}", f"+H{SIDE}", "-A", "-D", "+FP16", f"+O{file.with_suffix('.ppm')}", f"+I{file}"]
        subprocess.run(["povray", *options], check=True, capture_output=True)
        pixels = file.with_suffix(".ppm").read_bytes()[-SIDE * SIDE * 6 :]
    return np.frombuffer(pixels, ">u2").reshape(SIDE, SIDE, 3).any(-1)


def expected() -> Any:
    """Return which pixels POV-Ray lights, scene by scene."""
    bits: Any = np.unpackbits(np.load(FILE)["lit"], axis=-1)
    return bits > 0


def inner(lit: Any) -> Any:
    """Return the pixels all of whose neighbours are lit alike: no edge passes through them."""
    near = np.stack([np.roll(lit, shift, (-2, -1)) for shift in np.ndindex(3, 3)])
    near = np.roll(near, (-1, -1), (-2, -1))
    return near.all(0) | ~near.any(0)


if __name__ == "__main__":
    np.savez_compressed(FILE, lit=np.packbits([lit_by_povray(*of) for of in scenes()], axis=-1))
    print(f"wrote {FILE}")
