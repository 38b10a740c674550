"""Random set-ups of a sphere in 3 to 8 photographs, right and with one fault each that a user would not notice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import numpy as np
from scipy import ndimage
from synthetic import photograph

import diffshade as ds

FREE = ("k_a", "k_d", "k_s", "n_s")
FAULTS = ("vignetting", "gamma", "blur", "radius large", "radius small", "lights turned", "lobe", "prior")
KINDS = {
    "vignetting": ("vignetting",),
    "gamma": ("gamma", "encoding"),
    "blur": ("blur",),
    "radius large": ("outline", "radius"),
    "radius small": ("outline", "radius"),
    "lights turned": ("rotation", "light"),
    "lobe": ("lobe",),
    "prior": ("prior",),
}


# views, pixels along a side, whether the lights are near, Blinn's lobe: a few, so that few programs are compiled
STRUCTURES = (
    (3, 64, False, False),
    (8, 64, True, False),
    (5, 96, False, True),
    (4, 128, True, False),
    (6, 64, False, False),
    (8, 96, True, True),
    (3, 256, False, False),
    (5, 64, True, False),
)


@dataclass(frozen=True, eq=False)
class SetUp:
    """A set-up: the truth, the camera, and the noise of its photographs."""

    truth: ds.Scene
    camera: ds.Camera
    noise: float
    seed: int

    def views(self, images: Any) -> list[ds.View]:
        """Add noise, the same for the same set-up, and make views of one light each."""
        random = np.random.default_rng(self.seed)
        noisy = [image + self.noise * random.standard_normal(image.shape) for image in images]
        return [ds.View(image, self.camera, lit=(i,)) for i, image in enumerate(noisy)]

    def images(self, scene: ds.Scene | None = None) -> list[np.ndarray]:
        scene = scene or self.truth
        return [photograph(scene, self.camera, (i,)) for i in range(len(scene.lights))]

    def told(self, **surface: Any) -> ds.Scene:
        """What the user says: the truth with a wrong material."""
        (item,) = self.truth.objects
        lobe = item.material.lobe
        material = ds.Material(0.9, 0.9, 0.9, 3.0, lobe=lobe)
        return ds.Scene(ds.Object(ds.Sphere(**surface), material), self.truth.lights)


def set_up(seed: int) -> SetUp:
    """Return a random set-up of one of the structures, by turns."""
    random = np.random.default_rng(1000 + seed)
    count, size, near, blinn = STRUCTURES[seed % len(STRUCTURES)]
    polar = np.deg2rad(random.uniform(10, 65, count))
    azimuth = 2 * np.pi * (np.arange(count) / count) + random.uniform(-0.4, 0.4, count)
    towards = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    if near:
        lights: list[Any] = [ds.PointLight(d * t) for d, t in zip(random.uniform(3, 6, count), towards, strict=True)]
    else:
        lights = [ds.DirectionalLight(-t) for t in towards]
    material = ds.Material(
        random.uniform(0.0, 0.12, 3) * (random.random() < 0.8),
        random.uniform(0.15, 0.8, 3),
        random.uniform(0.1, 0.6) * np.ones(3),
        float(np.exp(random.uniform(np.log(6), np.log(150)))),
        lobe=ds.Blinn() if blinn else ds.Phong(),
    )
    camera = ds.Camera(eye=(0, 0, 4), fov=float(random.uniform(34, 44)), shape=(size, size))
    noise = float(np.exp(random.uniform(np.log(1e-3), np.log(1e-2))))
    return SetUp(ds.Scene(ds.Object(ds.Sphere(), material), lights), camera, noise, seed)


def turned(scene: ds.Scene, degrees: float, axis: np.ndarray) -> ds.Scene:
    """Return a scene whose lights are turned together about its middle."""
    angle, axis = np.deg2rad(degrees), axis / np.linalg.norm(axis)

    def turn(v: np.ndarray) -> np.ndarray:
        return v * np.cos(angle) + np.cross(axis, v) * np.sin(angle) + axis * (axis @ v) * (1 - np.cos(angle))

    for i, light in enumerate(scene.lights):
        name = "direction" if isinstance(light, ds.DirectionalLight) else "position"
        where = lambda s, i=i, name=name: getattr(s.lights[i], name)  # noqa: E731
        scene = eqx.tree_at(where, scene, turn(np.asarray(where(scene), np.float64)))
    return scene


def faulty(of: SetUp, fault: str | None) -> tuple[ds.Scene, list[ds.View], dict[str, Any]]:
    """Return the scene, views and options that a user gives the fit, with one fault or none."""
    random = np.random.default_rng(2000 + of.seed)
    told, options = of.told(), {}
    if fault == "lobe":
        (item,) = of.truth.objects
        other = ds.Phong() if isinstance(item.material.lobe, ds.Blinn) else ds.Blinn()
        told = eqx.tree_at(lambda s: s.objects[0].material, told, ds.Material(0.9, 0.9, 0.9, 3.0, lobe=other))
    if fault == "radius large":
        told = of.told(radius=1.1)
    if fault == "radius small":
        told = of.told(radius=0.95)
    axis = random.standard_normal(3)
    images = of.images(turned(of.truth, 2.0, axis) if fault == "lights turned" else None)
    if fault == "vignetting":
        h, w = of.camera.shape
        row, column = np.mgrid[:h, :w]
        rho2 = ((row - (h - 1) / 2) ** 2 + (column - (w - 1) / 2) ** 2) / ((h / 2) ** 2 + (w / 2) ** 2)
        images = [image * (1 - 0.25 * rho2[..., None]) for image in images]
    if fault == "gamma":
        power = 1.2 if random.random() < 0.5 else 1 / 1.2
        images = [image**power for image in images]
    if fault == "blur":
        images = [ndimage.gaussian_filter(image, (1.5, 1.5, 0)) for image in images]
    if fault == "prior":
        (item,) = of.truth.objects
        name = str(random.choice(["k_d", "k_s", "n_s"]))
        value = np.asarray(getattr(item.material, name))
        width = float(np.exp(random.uniform(np.log(1e-3), np.log(2e-2))))
        options["priors"] = {name: (value * 1.3, width * (1.0 if name == "n_s" else float(value.max())))}
    return told, of.views(images), options


def fitted(of: SetUp, fault: str | None) -> ds.Fit:
    told, views, options = faulty(of, fault)
    return ds.fit(told, views, free=FREE, **options)
