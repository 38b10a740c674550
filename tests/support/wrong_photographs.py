"""Photographs of a ball by the independent oracle, right or with one fault that its description does not know.

Each kind of fault is one entry of `FAULTS`: what it changes in what is photographed, in the photographs as they are
stored, or in what the fit is told. The truth is always the same material under the same lamps.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np
import oracle
from PIL import Image
from scipy import ndimage

import diffshade as ds

FREE = ("k_a", "k_d", "k_s", "n_s")
MATERIALS = {
    "matte": {"k_a": (0.05, 0.04, 0.03), "k_d": (0.6, 0.45, 0.3), "k_s": (0.08, 0.08, 0.08), "n_s": 8.0},
    "glossy": {"k_a": (0.05, 0.04, 0.03), "k_d": (0.5, 0.35, 0.2), "k_s": (0.4, 0.4, 0.4), "n_s": 40.0},
}
NOISE = 0.003
SIDE = 48
SPHERE = {"type": "sphere", "center": (0.0, 0.0, 0.0), "radius": 1.0}
CAMERA = {"eye": (0, 0, 4), "target": (0, 0, 0), "up": (0, 1, 0), "local_viewer": True, "fov": 36.0}
NEAR = (
    "lamps farther",
    "attenuation forgotten",
    "lamps told distant",
)  # faults of lamps at a distance; of all others they are at infinity


@dataclass(frozen=True)
class Photographed:
    """What stands before the camera, as the oracle takes it, one lamp for each photograph; and what is told of it."""

    scene: dict[str, Any]
    camera: dict[str, Any]
    lamps: tuple[dict[str, Any], ...]
    near: bool
    random: np.random.Generator
    seed: int
    told: dict[str, Any] = field(default_factory=dict)
    """What the user says otherwise: fields of `scene`, and `lamps`."""
    samples: int = 1
    """Along each side of a pixel, which is their mean."""

    def but(self, **changed: Any) -> Photographed:
        return dataclasses.replace(self, **changed)


@dataclass(frozen=True)
class Fault:
    """One kind of wrong set-up."""

    before: Callable[[Photographed], Photographed] = lambda of: of
    """What is photographed that the user does not tell."""
    stored: Callable[[Sequence[np.ndarray], Photographed], Sequence[np.ndarray]] = lambda images, _: images
    """What becomes of the photographs, noise included."""
    free: tuple[str, ...] = FREE
    fewest: int = 1
    """The photographs that it needs."""
    noise: float = NOISE
    true: Mapping[str, Any] = field(default_factory=dict)
    """Coefficients of the material that are others here."""
    named: tuple[str, ...] = ()
    """The kinds of the library's table that are it, or whose mend heals it; none: noise of another kind."""
    is_gauge: bool = False
    """Whether no image shows it: other numbers of a right description make the same photographs, within their noise."""


def towards(count: int, random: np.random.Generator) -> np.ndarray:
    """Directions to lamps, 15 to 60 degrees off the camera's axis, all round."""
    polar = np.deg2rad(15.0 + 45.0 * (np.arange(count) * 0.618 % 1.0) + random.uniform(-3, 3, count))
    azimuth = 2 * np.pi * np.arange(count) / count + random.uniform(0, 2 * np.pi)
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)


def turned(v: np.ndarray, axis: np.ndarray, degrees: float) -> np.ndarray:
    axis, angle = axis / np.linalg.norm(axis), np.deg2rad(degrees)
    along = np.outer(v @ axis, axis) * (1 - np.cos(angle))
    return v * np.cos(angle) + np.cross(axis, v) * np.sin(angle) + along


def lamps_at(places: np.ndarray, near: bool, intensity: np.ndarray | float = 1.0) -> tuple[dict[str, Any], ...]:
    """Return a lamp at each place: the direction to one at infinity, or the position of one that is near."""
    power = np.broadcast_to(intensity, len(places))
    return tuple(
        {"type": "point", "position": tuple(4.0 * at), "intensity": (14.0 * p,) * 3, "attenuation": (0, 0, 1)}
        if near
        else {"type": "directional", "direction": tuple(-at), "intensity": (p,) * 3}
        for at, p in zip(places, power, strict=True)
    )


def photographed(material: str, count: int, seed: int, near: bool) -> Photographed:
    random = np.random.default_rng(seed)
    lamps = lamps_at(towards(count, random), near)
    item = SPHERE | {"material": {**MATERIALS[material], "lobe": "phong"}}
    scene = {"objects": [item], "ambient": (1, 1, 1), "background": (0, 0, 0)}
    return Photographed(scene, CAMERA | {"shape": (SIDE, SIDE)}, lamps, near, random, seed)


def rendered(of: Photographed) -> list[np.ndarray]:
    extra, n = of.scene.get("beside", []), of.samples
    camera = of.camera | {"shape": (n * SIDE, n * SIDE)}
    images = [oracle.render(of.scene | {"lights": [lamp, *extra]}, camera) for lamp in of.lamps]
    return [image.reshape(SIDE, n, SIDE, n, -1).mean((1, 3)) for image in images]


def _directions_off(of: Photographed, degrees: np.ndarray) -> Photographed:
    places = np.array([-np.array(lamp["direction"]) for lamp in of.lamps])
    moved = np.concatenate(
        [turned(at[None], of.random.standard_normal(3), d) for at, d in zip(places, degrees, strict=True)]
    )
    return of.but(lamps=lamps_at(moved, False), told={"lamps": of.lamps})


def _all_turned(of: Photographed, degrees: float = 3.0) -> Photographed:
    axis = of.random.standard_normal(3)
    places = turned(np.array([-np.array(lamp["direction"]) for lamp in of.lamps]), axis, degrees)
    return of.but(lamps=lamps_at(places, False), told={"lamps": of.lamps})


def _intensities_off(of: Photographed, relative: float) -> Photographed:
    places = np.array([-np.array(lamp["direction"]) for lamp in of.lamps])
    factors = 1.0 + relative * of.random.standard_normal(len(places))
    return of.but(lamps=lamps_at(places, False, factors), told={"lamps": of.lamps})


def _with(of: Photographed, **scene: Any) -> Photographed:
    return of.but(scene=of.scene | scene)


def _of_material(of: Photographed, **coefficients: Any) -> Photographed:
    (item,) = of.scene["objects"]
    return _with(of, objects=[item | {"material": item["material"] | coefficients}])


def _arriving(distance: float) -> float:
    """The mean of 1 / d^2 over the part of the ball that a lamp lights, by the squares of the cosines.

    What is told of a lamp is as strong there as the lamp is: otherwise all reflections are off by one factor.
    """
    cosine = np.linspace(0.0, 1.0, 1001)
    return float(np.average(1.0 / (1.0 + distance**2 - 2.0 * distance * cosine), weights=cosine**2))


def _told_farther(of: Photographed) -> Photographed:
    stronger = _arriving(4.0) / _arriving(4.4)
    told = tuple(
        lamp | {"position": tuple(1.1 * np.array(at)), "intensity": tuple(stronger * np.array(power))}
        for lamp in of.lamps
        for at, power in [(lamp["position"], lamp["intensity"])]
    )
    return of.but(told={"lamps": told})


def _attenuation_forgotten(of: Photographed) -> Photographed:
    even = {"intensity": (14.0 * _arriving(4.0),) * 3, "attenuation": (1, 0, 0)}
    return of.but(told={"lamps": tuple(lamp | even for lamp in of.lamps)})


def _told_distant(of: Photographed) -> Photographed:
    far = lamps_at(np.array([np.array(lamp["position"]) for lamp in of.lamps]), False, 14.0 * _arriving(4.0))
    return of.but(told={"lamps": far})


def vignetted(image: np.ndarray, share: float) -> np.ndarray:
    row, column = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    return image * (1.0 - share * (row**2 + column**2) / (2 * (SIDE / 2) ** 2))[..., None]


def _shadowed(images: Sequence[np.ndarray], of: Photographed) -> list[np.ndarray]:
    """A stick's shadow across the first photograph."""
    image = images[0].copy()
    ambient = np.array(of.scene["objects"][0]["material"]["k_a"])
    rows = slice(SIDE // 3, SIDE // 3 + SIDE // 8)
    lit = image[rows].sum(-1) > 3 * NOISE * 3
    image[rows][lit] = ambient + NOISE * of.random.standard_normal((int(lit.sum()), 3))
    return [image, *images[1:]]


def _bounced(images: Sequence[np.ndarray], of: Photographed) -> list[np.ndarray]:
    """A table below gives back a twentieth of what it gets, to what faces it."""
    row, column = np.mgrid[:SIDE, :SIDE]
    half = 4.0 * np.tan(np.deg2rad(of.camera["fov"] / 2))
    y = half * (1 - 2 * (row + 0.5) / SIDE) / 1.1
    x = half * (2 * (column + 0.5) / SIDE - 1) / 1.1
    inside = x**2 + y**2 < 1
    k_d = np.array(of.scene["objects"][0]["material"]["k_d"])
    return [image + (0.05 * np.where(inside, (1 - y) / 2, 0.0))[..., None] * k_d for image in images]


def through_jpeg(image: np.ndarray) -> np.ndarray:
    stored = Image.fromarray(np.round(255 * ds.srgb_encode(np.clip(image, 0, 1))).astype(np.uint8))
    stored.save(file := io.BytesIO(), "jpeg", quality=90)
    return np.asarray(ds.srgb_decode(np.asarray(Image.open(file)) / 255.0))


def in_eight_bits(image: np.ndarray, higher: float = 0.0) -> np.ndarray:
    """Return an image by so many steps `higher` than to the nearest: -.5 cuts off."""
    stored = np.rint(255 * np.asarray(ds.srgb_encode(np.clip(image, 0, 1))) + higher)
    return np.asarray(ds.srgb_decode(np.clip(stored, 0, 255) / 255))


def _of_each(change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., list[np.ndarray]]:
    return lambda images, _: [change(image) for image in images]


def photon_noise(image: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Beside the noise that all have, that of 2,500 photons at white."""
    return image + 0.02 * np.sqrt(np.maximum(image, 0.0)) * random.standard_normal(image.shape)


def through_gamma_of_green(image: np.ndarray) -> np.ndarray:
    return np.sign(image) * np.abs(image) ** np.array([1.0, 1.05, 1.0])


def _first_but(factor: float) -> Callable[..., list[np.ndarray]]:
    return lambda images, _: [factor * images[0], *images[1:]]


def _swapped(images: Sequence[np.ndarray], _: Photographed) -> list[np.ndarray]:
    return [images[1], images[0], *images[2:]]


LIGHTS = ("light", "rotation")
STRAY = (
    "elsewhere",
    "stray light",
    "uneven light",
    "uneven view",
    "colour",
)  # "look for light from other things, and shadows"
DARK = {"k_a": (0.01, 0.005, 0.0)}
FAULTS: Mapping[str, Fault] = {
    "light off": Fault(lambda of: _directions_off(of, np.r_[3.0, np.zeros(len(of.lamps) - 1)]), named=LIGHTS),
    "lights off": Fault(
        lambda of: _directions_off(of, np.abs(of.random.normal(0, 1.0, len(of.lamps)))), fewest=4, named=LIGHTS
    ),
    "lights turned": Fault(_all_turned, named=LIGHTS),
    "intensities off": Fault(lambda of: _intensities_off(of, 0.02), fewest=4, named=("exposure",)),
    "unlisted lamp": Fault(
        lambda of: _with(of, beside=[{"type": "directional", "direction": (-1, -0.3, -0.4), "intensity": (0.05,) * 3}]),
        named=STRAY,
    ),
    "srgb as linear": Fault(
        stored=_of_each(lambda image: np.asarray(ds.srgb_encode(np.clip(image, 0, 1)))), named=("encoding", "gamma")
    ),
    "blinn": Fault(lambda of: _of_material(of, lobe="blinn"), named=("lobe",)),
    "distant viewer": Fault(lambda of: of.but(camera=of.camera | {"local_viewer": False}), named=("viewer",)),
    "shadow": Fault(stored=_shadowed, named=(*STRAY, "outliers")),
    "clipped below 1": Fault(stored=_of_each(lambda image: np.minimum(image, 0.6)), named=("clipped",)),
    "focal length": Fault(lambda of: of.but(camera=of.camera | {"fov": 36.0 * 1.05}), named=("radius",)),
    "black level": Fault(stored=_of_each(lambda image: image + 0.01), named=("black",)),
    "gamma of green": Fault(stored=_of_each(through_gamma_of_green), named=("gamma of a colour",)),
    "averaged pixels": Fault(lambda of: of.but(samples=5), named=("pixels",)),
    "blur": Fault(stored=_of_each(lambda image: ndimage.gaussian_filter(image, (1.0, 1.0, 0))), named=("blur",)),
    "floor at 0": Fault(
        lambda of: _of_material(of, **DARK),
        _of_each(lambda image: np.maximum(image, 0.0)),
        noise=0.01,
        true=DARK,
        named=("floor",),
    ),
    "photon noise": Fault(stored=lambda images, of: [photon_noise(image, of.random) for image in images]),
    "vignetting": Fault(stored=_of_each(lambda image: vignetted(image, 0.08)), named=("vignetting",)),
    "bounced light": Fault(stored=_bounced, named=STRAY),
    "half a pixel": Fault(
        stored=_of_each(lambda image: ndimage.shift(image, (0.0, 0.5, 0.0), order=1)), named=("shift", "center")
    ),
    "fog": Fault(
        lambda of: _with(of, atmosphere={"type": "fog", "density": 0.03, "I_dc": (0.5, 0.5, 0.5)}), is_gauge=True
    ),
    "k_a forgotten": Fault(free=("k_d", "k_s", "n_s"), named=("ambient",)),
    "lamps farther": Fault(_told_farther, fewest=4, named=("distance",)),
    "attenuation forgotten": Fault(_attenuation_forgotten, named=("attenuation",)),
    "lamps told distant": Fault(_told_distant, named=("near",)),
    "a render of Blinn's lobe": Fault(
        lambda of: _of_material(of, lobe="blinn"), _of_each(in_eight_bits), noise=0.0, named=("lobe",)
    ),
    "a render, lights turned": Fault(
        partial(_all_turned, degrees=0.3), _of_each(in_eight_bits), noise=0.0, named=LIGHTS
    ),
    "a render of averages": Fault(
        lambda of: of.but(samples=5), _of_each(in_eight_bits), noise=0.0, named=("pixels", "blur")
    ),
    "jpeg": Fault(stored=_of_each(through_jpeg), named=("chroma",)),
    "exposure": Fault(stored=_first_but(1.1), fewest=4, named=("exposure",)),
    "swapped": Fault(stored=_swapped, fewest=4, named=("convention",)),
    "gain of red": Fault(
        stored=lambda images, _: [images[0] * np.array([1.1, 1.0, 0.95]), *images[1:]], fewest=4, named=("exposure",)
    ),
}


def told(of: Photographed, *, forgotten: bool = False) -> ds.Scene:
    """What a user tells the fit: the lamps, and a wrong material."""
    lamps = of.told.get("lamps", of.lamps)
    lights = [
        ds.DirectionalLight(lamp["direction"], lamp["intensity"])
        if lamp["type"] == "directional"
        else ds.PointLight(lamp["position"], lamp["intensity"], ds.RadialAttenuation(*lamp["attenuation"]))
        for lamp in lamps
    ]
    return ds.Scene(ds.Object(ds.Sphere(), ds.Material(0.0 if forgotten else 0.9, 0.9, 0.9, 3.0)), lights)


@cache
def clean(material: str, count: int, seed: int, kind: str | None) -> tuple[Photographed, tuple[np.ndarray, ...]]:
    """What is photographed and its images without noise, by the oracle."""
    fault = FAULTS[kind] if kind else Fault()
    of = fault.before(photographed(material, count, seed, kind in NEAR))
    return of, tuple(rendered(of))


def fitted(material: str, count: int, seed: int, kind: str | None, **options: Any) -> ds.Fit:
    """Fit photographs with a fault of this kind, or with none."""
    fault = FAULTS[kind] if kind else Fault()
    of, images = clean(material, count, seed, kind)
    noisy = [image + fault.noise * of.random.standard_normal(image.shape) for image in images]
    camera = ds.Camera(eye=(0, 0, 4), fov=36.0, shape=(SIDE, SIDE))
    views = [ds.View(image, camera, lit=(i,)) for i, image in enumerate(fault.stored(noisy, of))]
    return ds.fit(told(of, forgotten="k_a" not in fault.free), views, free=options.pop("free", fault.free), **options)


def truth(material: str, fit: ds.Fit, kind: str | None = None) -> np.ndarray:
    """The true values of what a fit finds."""
    of = {**MATERIALS[material], **(FAULTS[kind].true if kind else {})}
    names = [name.split(".") for name in fit.names]
    return np.array(
        [float(of[name]) if not of_channel else of[name]["rgb".index(of_channel[0])] for name, *of_channel in names]
    )
