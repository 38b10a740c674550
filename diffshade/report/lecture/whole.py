"""The whole sum: its terms one by one, and materials under lights of many colours (E9, E10)."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from ...model.cameras import Camera
from ...model.lights import PointLight
from ...model.lobes import Blinn
from ...model.materials import Material
from ...model.named_materials import material, material_names
from ...model.scenes import Object, Scene
from ...model.surfaces import Box, Plane, Sphere
from .pages import grid
from .pictures import DARK, ball, line_drawing, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def terms() -> Figure:
    """Draw one scene as lines, and with the terms of the sum added one by one."""
    camera = Camera((0, 2.2, 6.5), target=(0, -0.25, 0), fov=34, shape=(240, 360))
    scene = _still_life()
    off = {"k_d": np.zeros(3), "k_s": np.zeros(3)}
    images = [
        line_drawing(scene, camera),
        picture(_changed(scene, **off), camera),
        picture(_changed(scene, k_s=off["k_s"]), camera),
        picture(scene, camera),
    ]
    labels = ["outlines", "ambient: no shape", "+ diffuse: shape", "+ specular: material"]
    return grid("The terms of the sum, one by one", [images[:2], images[2:]], labels=labels)


def colour_of_light() -> Figure:
    """Draw a white and a blue ball under white and under red light."""
    blue, white = Material((0, 0, 0.04), (0, 0.03, 0.85)), Material(0.04, 0.85)
    balls = [Object(Sphere((-1.05, 0, 0), 0.95), white), Object(Sphere((1.05, 0, 0), 0.95), blue)]
    camera = Camera((0, 0, 8), fov=16, shape=(180, 340))
    row = [
        picture(Scene(balls, PointLight((3, 4, 6), colour), ambient=colour, background=DARK), camera)
        for colour in ((1, 1, 1), (1, 0, 0))
    ]
    title = "A blue ball reflects the blue of white light; red light has none"
    return grid(title, [row], columns=["a white and a blue ball in white light", "the same two in red light"])


def object_colours() -> Figure:
    """Draw balls over O_d and O_s, the colours of the object and of its highlight."""
    diffuse = {"red": (0.9, 0.1, 0.06), "gold": (0.85, 0.55, 0.1), "blue": (0.08, 0.25, 0.9)}
    highlights = {"$O_s$ white, plastic": (1, 1, 1), "$O_s = O_d$, metal": None, "$O_s$ green": (0.15, 0.9, 0.2)}
    rows = [
        [
            ball(Material.foley(O_d=O_d, O_s=O_s or O_d, k_a=0.1, k_d=0.4, k_s=0.8, n_s=12))
            for O_s in highlights.values()
        ]
        for O_d in diffuse.values()
    ]
    return grid(
        "$k_d\\,O_d$ and $k_s\\,O_s$: the highlight has a colour of its own",
        rows,
        columns=list(highlights),
        sides=[f"$O_d$ {name}" for name in diffuse],
    )


def materials_and_lights() -> Figure:
    """Draw balls of five materials under one, two and three lights."""
    names = ("ruby", "gold", "emerald", "chrome", "cyan_plastic")
    balls = [Object(Sphere((2.15 * (i - 2), 0, 0)), material(name)) for i, name in enumerate(names)]
    floor = Object(Plane((0, -1, 0)), Material(0.04, 0.4, lobe=Blinn()))
    camera = Camera((0, 2.0, 14), target=(0, -0.05, 0), fov=10.5, shape=(150, 640))
    key, left, right = PointLight((1, 6, 8), 0.9), (-9, 3, 4), (9, 3, 4)
    lights = {
        "one white\nlamp": [key],
        "a warm and\na cool lamp": [PointLight(left, (1.0, 0.55, 0.2)), PointLight(right, (0.2, 0.5, 1.0))],
        "red, green\nand blue": [
            PointLight(left, (0.9, 0.05, 0.05)),
            PointLight((0, 7, 5), (0.05, 0.8, 0.05)),
            PointLight(right, (0.1, 0.1, 1.0)),
        ],
    }
    rows = [[picture(Scene([floor, *balls], lamps, ambient=0.3, background=DARK), camera)] for lamps in lights.values()]
    words = ", ".join(name.replace("_", " ") for name in names)
    return grid(
        "Materials under several lights: their light adds up",
        rows,
        sides=list(lights),
        note=f"from left to right: {words}",
    )


def teapot_materials() -> Figure:
    """Draw a ball of each of the 24 materials of the OpenGL teapots."""
    names = material_names()
    images = [ball(material(name), PointLight((3, 4, 6), 0.85), ambient=0.4) for name in names]
    return grid(
        "The 24 materials of the OpenGL teapots",
        [images[i : i + 6] for i in range(0, len(images), 6)],
        labels=[name.replace("_", " ") for name in names],
    )


def _still_life() -> Scene:
    table = Object(Box((0, -0.85, 0), (4.4, 0.2, 3.4)), Material((0.06, 0.045, 0.03), (0.45, 0.33, 0.22), 0.15, 8))
    red = Object(Sphere((-1.25, -0.0, 0.3), 0.75), Material((0.1, 0.02, 0.015), (0.6, 0.1, 0.08), 0.7, 60))
    gold = Object(Sphere((0.35, -0.3, 0.9), 0.45), Material((0.1, 0.075, 0.02), (0.45, 0.32, 0.08), 0.6, 25))
    block = Object(
        Box((1.15, -0.1, -0.35), (1, 1.3, 1), (0, 30, 0)), Material((0.03, 0.06, 0.1), (0.12, 0.3, 0.5), 0.3, 12)
    )
    return Scene([table, red, gold, block], PointLight((2.5, 5, 5)), background=DARK)


def _changed(scene: Scene, **terms: np.ndarray) -> Scene:
    objects = [
        dataclasses.replace(item, material=dataclasses.replace(item.material, **terms)) for item in scene.objects
    ]
    return dataclasses.replace(scene, objects=tuple(objects))
