"""Faults of a setup as directions of image space: the change of every sample by a small amount of each fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from ...inverse.data.recording import photograph
from ...inverse.data.views import View, channels, lights_on
from ...inverse.forward.rounding import sawtooth
from ...inverse.result import Fit
from ...inverse.unknowns.parameters import find_unknowns
from ...model.bands import widened
from ...model.fresnel import NoFresnel
from ...model.lobes import AbstractPowerLobe, Blinn, Phong
from ...model.materials import Highlight
from ...model.patterns import AbstractPattern
from ...model.scenes import Scene
from ...model.surfaces import Sphere
from .laid_samples import LaidSamples, Samples
from .regions import center_of, rims
from .score_tests import Rows

LEAST_EXPONENT = 1.0  # of a second highlight: with less it looks diffuse
PIXELS = 1 << 14  # number of pixels, in all views together, on which faults are judged
BLURS = (0.6, 1.2, 2.4)  # pixels: the tested standard deviations of a blur
FACTORS = (1 / 16, 1 / 4, 4.0, 16.0)  # tested n_s of a second highlight, over the first's
SPHERES = 4  # with more spheres, their places are not tested

Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Direction:
    """The change of each sample by a fault of amount 1; a fault may have several amounts."""

    kind: str
    which: int
    """The index of the object, of the blur or of the second highlight's n_s; else 0."""
    change: Float[np.ndarray, "k n"]
    along: tuple[int, ...] = ()
    """For a fault of the geometry, its directions in the laid samples."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """A fit as a linear problem at its minimum, and the faults as directions of it."""

    samples: LaidSamples
    """With the geometry's parameters added to the fit's own unknowns."""
    rows: Rows
    inside: Int[np.ndarray, " q"]
    """The unknowns that are not at a bound; the rows' Jacobian has these."""
    count: int
    """The number of measured samples."""
    directions: list[Direction]


def linearised(fit: Fit, excluded: Sequence[Mask | None] | None = None) -> Linearised:
    """Return a fit as a linear problem at its minimum, on evenly spread samples. Runs in float64.

    Args:
        fit: The fit.
        excluded: The pixels of each view that do not count.
    """
    paths = _paths(fit)
    added = find_unknowns(fit.scene, fit.views, list(paths), from_scene=True) if paths else []
    solved = fit.solved if excluded is None else fit.solved.keeping([None if m is None else ~m for m in excluded])
    laid = solved.beside(added).laid_out(PIXELS)
    p = len(fit.unknowns)
    at = {unknown.places[0]: p + j for j, unknown in enumerate(added)}
    moves = _moves(fit, at, len(laid.theta))
    laid_samples = LaidSamples(fit, laid, np.concatenate([np.zeros((0, len(laid.theta))), *moves.values()]))
    end = laid_samples.at(laid.theta)
    samples = Samples(laid_samples.view, laid_samples.pixel, laid_samples.channel, end.predicted)
    inside, known = laid_samples.inside, laid_samples.known(laid.theta)
    measured = end.base > 0
    noise, bend = ((of[measured] / end.base[measured]).sum() for of in (end.slope**2, end.weight))
    rows = Rows(
        end.jacobian,
        end.slope,
        end.weight,
        _pixels(fit, samples),
        np.asarray(known.hessian)[np.ix_(inside, inside)],
        np.asarray(known.gradient)[inside],
        float(noise / bend),
        None if fit.evidence.waves is None else sawtooth(fit.rounding, samples.view, end.predicted, end.base),
    )
    directions = [*_of_images(fit, samples), *_of_geometry(fit, samples, end.along, moves)]
    return Linearised(laid_samples, rows, inside, int(measured.sum()), directions)


def _pixels(fit: Fit, samples: Samples) -> Int[np.ndarray, " n"]:
    """Return the pixel number of each sample."""
    size = max(view.image.shape[0] * view.image.shape[1] for view in fit.views)
    return np.unique(samples.view * size + samples.pixel, return_inverse=True)[1]


def _of_images(fit: Fit, samples: Samples) -> list[Direction]:
    """Return the changes by faults of the camera and the file, and by the other lobe."""
    m = samples.predicted
    black = np.array([float(view.black) for view in fit.views])[samples.view]
    light = m - black
    found = [
        Direction("vignetting", 0, -(light * samples.of([_rho2(view) for view in fit.views]))[None]),
        Direction("gamma", 0, (light * np.log(np.maximum(light, 1e-6)) * (light > 0))[None]),
    ]
    whole = [photograph(fit.scene, view) for view in fit.views]
    for k, sigma in enumerate(BLURS):
        blurred = [ndimage.gaussian_filter(image, (sigma, sigma, 0), mode="nearest") - image for image in whole]
        found.append(Direction("blur", k, samples.of(blurred)[None]))
    other = _other_lobe(fit.scene)
    if other is not None:
        changed = [photograph(other, view) - image for view, image in zip(fit.views, whole, strict=True)]
        found.append(Direction("lobe", 0, samples.of(changed)[None]))
    for k, factor in enumerate(FACTORS):
        two = _with_second_highlight(fit.scene, factor)
        if two is not None:
            changed = [photograph(two, view) - image for view, image in zip(fit.views, whole, strict=True)]
            found.append(Direction("highlight", k, samples.of(changed)[None]))
    return found


def _rho2(view: View) -> np.ndarray:
    """Return the square of each pixel's distance from the image centre, over that of a corner."""
    h, w = view.camera.shape
    row, column = np.mgrid[:h, :w]
    rho2 = ((2 * row + 1 - h) ** 2 + (2 * column + 1 - w) ** 2) / float(h**2 + w**2)
    return np.broadcast_to(rho2[..., None], (h, w, channels(view)))


def _with_second_highlight(scene: Scene, factor: float) -> Scene | None:
    """Return the scene with a second highlight as strong as the first, of n_s by a factor; None if nothing shines."""
    shiny = [i for i, item in enumerate(scene.objects) if shines(item.material.k_s)]
    for i in shiny:
        m = scene.objects[i].material
        if m.highlights or not isinstance(m.lobe, AbstractPowerLobe) or not isinstance(m.fresnel, NoFresnel):
            return None
        second = Highlight(m.k_s, np.maximum(factor * np.asarray(m.n_s, np.float64), LEAST_EXPONENT), m.lobe)
        second = widened(second, len(scene.channels))  # of one band its colour was made RGB
        scene = eqx.tree_at(lambda s, i=i: s.objects[i].material.highlights, scene, (second,))
    return scene if shiny else None


def _other_lobe(scene: Scene) -> Scene | None:
    """Return the scene with Blinn's highlights of four times n_s for Phong's, and the other way round."""
    shiny = [i for i, item in enumerate(scene.objects) if shines(item.material.k_s)]
    for i in shiny:
        material = scene.objects[i].material
        if not isinstance(material.lobe, Phong | Blinn):
            return None
        lobe, factor = (Phong(), 0.25) if isinstance(material.lobe, Blinn) else (Blinn(), 4.0)
        n_s = factor * np.asarray(material.n_s, np.float64)
        scene = eqx.tree_at(lambda s, i=i: (s.objects[i].material.lobe, s.objects[i].material.n_s), scene, (lobe, n_s))
    return scene if shiny else None


def shines(k_s: Any) -> bool:
    """Whether a surface with this k_s has a highlight."""
    return isinstance(k_s, AbstractPattern) or bool(np.any(np.asarray(k_s) > 0))


def _paths(fit: Fit) -> list[str]:
    """Return the parameters of the tested geometry that are not free: spheres, and the places of the lights."""
    own = {path for unknown in fit.unknowns for path, _ in unknown.places}
    own |= {product.path for unknown in fit.unknowns for product in unknown.products}
    paths = [path for group in (*_spheres(fit), *_lights(fit)) for path in group]
    return [path for path in paths if path not in own]


def _spheres(fit: Fit) -> list[list[str]]:
    """Return the radius and the centre of each sphere."""
    objects = fit.scene.objects
    names = [item.name or str(i) for i, item in enumerate(objects) if isinstance(item.surface, Sphere)]
    return (
        [[f"objects.{n}.surface.radius", f"objects.{n}.surface.center"] for n in names] if len(names) <= SPHERES else []
    )


def _lights(fit: Fit) -> list[list[str]]:
    """Return the paths of where each light that is on in a view is, and where it points."""
    on = sorted({i for view in fit.views for i in lights_on(fit.scene, view)})
    return [[f"lights.{i}.{name}" for name in fit.scene.lights[i].placement] for i in on]


def _moves(fit: Fit, at: dict[tuple[str, int], int], p: int) -> dict[tuple[str, int], np.ndarray]:
    """Return the change of the parameters by each fault of geometry, per scene unit, or per degree for the lights."""
    moves: dict[tuple[str, int], np.ndarray] = {}
    for i, paths in enumerate(_spheres(fit)):
        for kind, path in zip(("radius", "center"), paths, strict=True):
            index = [at[path, c] for c in range(3) if (path, c) in at]
            if index:
                moves[kind, i] = np.eye(p)[index]
    turned, lights = np.zeros((3, p)), _lights(fit)
    every = [path for paths in lights for path in paths]
    if every and all(lights) and all((path, 2) in at for path in every):
        center = center_of(fit.scene.objects, fit.views[0].camera)
        for path in every:
            _, i, name = path.split(".")
            place = np.asarray(getattr(fit.scene.lights[int(i)], name), np.float64)
            arm = place if name == "direction" else place - center
            for k, axis in enumerate(np.eye(3)):
                turned[k, [at[path, c] for c in range(3)]] = np.deg2rad(1.0) * np.cross(axis, arm)
        moves["rotation", 0] = turned
    return moves


def _of_geometry(
    fit: Fit, samples: Samples, change: Float[np.ndarray, "k n"], moves: dict[tuple[str, int], np.ndarray]
) -> list[Direction]:
    """Return the changes by faults of geometry, except at grazing rims, where they are not linear."""
    shapes = [(*view.camera.shape, channels(view)) for view in fit.views]
    grazing = [rims(fit.scene.objects, view.camera)[0][..., None] for view in fit.views]
    rim = samples.of([np.broadcast_to(*of) for of in zip(grazing, shapes, strict=True)]) > 0
    found, first = [], 0
    for (kind, i), of in moves.items():
        along = tuple(range(first, first + len(of)))
        first += len(of)
        rows = change[list(along)]
        if kind in ("radius", "center"):
            rows = np.where(rim, 0.0, rows)
        if np.isfinite(rows).all():
            found.append(Direction(kind, i, rows, along))
    return found
