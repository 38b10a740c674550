"""Faults of a set-up as directions of image space: what a small amount of each would change in every sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from ..fields import Array
from ..inverse.blocks import Block
from ..inverse.blocks import chunks as in_chunks
from ..inverse.outcome import Fit
from ..inverse.parameters import find_unknowns
from ..inverse.refits import Laid
from ..inverse.study import weights
from ..inverse.views import View, is_grey, photograph
from ..lights import DirectionalLight, PointLight, SpotLight
from ..materials import Blinn, Phong
from ..measured_lights import MeasuredLight
from ..scenes import Scene
from ..surfaces import Sphere
from .regions import centre_of, rims
from .score_tests import Rows

PIXELS = 1 << 14  # of all views, on which faults are judged
BLURS = (0.6, 1.2, 2.4)  # pixels: the standard deviations of the blur that are tried
SPHERES = 4  # objects at most whose places are tried

Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Direction:
    """What one fault changes in each sample, for an amount of 1, or for each of a few amounts."""

    kind: str
    which: int
    """The number of the object, or 0; of a blur which one it is."""
    change: Float[np.ndarray, "k n"]
    index: tuple[int, ...] = ()
    """Which numbers of the fit laid out again are its amounts, where they are."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """A fit as a linear problem at its end, and the faults as directions of it."""

    laid: Laid
    """The fit, with the numbers of the geometry beside its own unknowns."""
    rows: Rows
    inside: Int[np.ndarray, " q"]
    """The unknowns that are not at a bound, which the rows' Jacobian is of."""
    count: int
    """Samples that were measured."""
    directions: list[Direction]


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples that count at the end of a fit, in the order of `Rows`."""

    view: Int[np.ndarray, " n"]
    pixel: Int[np.ndarray, " n"]
    """In its view's flattened image."""
    channel: Int[np.ndarray, " n"]
    predicted: Float[np.ndarray, " n"]

    def of(self, images: Sequence[np.ndarray]) -> Float[np.ndarray, " n"]:
        """Return the samples of images (h, w, c), one for each view."""
        found = np.zeros(len(self.view))
        for i, image in enumerate(images):
            here = self.view == i
            found[here] = image.reshape(-1, image.shape[2])[self.pixel[here], self.channel[here]]
        return found


def linearised(fit: Fit, out: Sequence[Mask | None] | None = None) -> Linearised:
    """Return a fit as a linear problem at its end, on samples that are evenly spread. In float64.

    `out`: for each view the pixels that do not count.
    """
    keep = None if out is None else [None if mask is None else ~mask for mask in out]
    paths = _paths(fit)
    beside = find_unknowns(fit.scene, fit.views, list(paths), from_scene=True) if paths else []
    laid = Laid(fit, keep, rendered=True, beside=beside, at_most=PIXELS)
    p = len(fit.unknowns)
    at = {unknown.places[0]: p + j for j, unknown in enumerate(beside)}
    moves = _moves(fit, at, len(laid.theta))
    tangents = np.concatenate([np.eye(p, len(laid.theta)), *moves.values()])
    theta, blocks = jnp.asarray(laid.theta), []
    for chunk, parts in zip(laid.chunks, in_chunks(laid.parts), strict=True):
        m, change, slope, weight, base = map(np.asarray, _changes(theta, jnp.asarray(tangents), laid.study.form, chunk))
        for b, part in enumerate(parts):
            n, used = len(part.pixels), 1 if is_grey(fit.views[part.view]) else 3
            place = [np.full((used, n), part.view), np.broadcast_to(part.pixels, (used, n))]
            place.append(np.broadcast_to(np.arange(used)[:, None], (used, n)))
            numbers = [of[b, :used, :n] for of in (m, slope, weight, base)]
            blocks.append(([x.reshape(-1) for x in (*place, *numbers)], change[b, :, :used, :n].reshape(-1, used * n)))
    view, pixel, channel, m, slope, weight, base = (np.concatenate([of[0][k] for of in blocks]) for k in range(7))
    change = np.concatenate([of[1] for of in blocks], 1)
    samples = Samples(view.astype(int), pixel.astype(int), channel.astype(int), m)
    inside = np.flatnonzero(~fit.at_bound)
    known = jax.tree.map(np.asarray, laid.study.soft().gram(theta))
    measured = base > 0
    rows = Rows(
        change[inside],
        slope,
        weight,
        _pixels(fit, samples),
        known.hessian[np.ix_(inside, inside)],
        known.gradient[inside],
        float(np.sum((slope**2)[measured] / base[measured]) / np.sum(weight[measured] / base[measured])),
    )
    directions = [*_of_images(fit, samples), *_of_geometry(fit, samples, change[p:], moves)]
    return Linearised(laid, rows, inside, int(measured.sum()), directions)


@jax.jit
def _changes(theta: Array, tangents: Array, form: Any, chunk: Block) -> tuple[Array, ...]:
    """Return the predictions of a chunk, their changes along tangents, the cost's slopes and curvatures, and weights.

    A clipped sample, which was not measured, weighs nothing.
    """

    def of_block(block: Block) -> tuple[Array, ...]:
        m, derivative = jax.linearize(lambda q: jnp.stack(form.predict(q, block)), theta)
        seen = block.observed
        weight = weights(form, block)
        terms = form.likelihood.terms(m, seen.target, weight, seen.clipped)
        measured = weight if seen.clipped is None else jnp.where(seen.clipped == 0, weight, 0.0)
        return m, jax.vmap(derivative)(tangents), terms.slope, terms.curvature, measured

    return jax.lax.map(of_block, chunk)


def _pixels(fit: Fit, samples: Samples) -> Int[np.ndarray, " n"]:
    """Return the number of the pixel that each sample is of."""
    size = max(view.image.shape[0] * view.image.shape[1] for view in fit.views)
    return np.unique(samples.view * size + samples.pixel, return_inverse=True)[1]


def _of_images(fit: Fit, samples: Samples) -> list[Direction]:
    """Return what faults of the camera and the file change, and the other form of highlight."""
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
    return found


def _rho2(view: View) -> np.ndarray:
    """Return the square of each pixel's distance from the middle, over that of a corner."""
    h, w = view.camera.shape
    row, column = np.mgrid[:h, :w]
    rho2 = ((2 * row + 1 - h) ** 2 + (2 * column + 1 - w) ** 2) / float(h**2 + w**2)
    return np.broadcast_to(rho2[..., None], (h, w, 3))


def _other_lobe(scene: Scene) -> Scene | None:
    """Return the scene with Blinn's highlights for Phong's of a quarter of the exponent, and the other way."""
    shiny = [i for i, item in enumerate(scene.objects) if np.any(np.asarray(item.material.k_s) > 0)]
    for i in shiny:
        material = scene.objects[i].material
        if not isinstance(material.lobe, Phong | Blinn):
            return None
        lobe, factor = (Phong(), 0.25) if isinstance(material.lobe, Blinn) else (Blinn(), 4.0)
        n_s = factor * np.asarray(material.n_s, np.float64)
        scene = eqx.tree_at(lambda s, i=i: (s.objects[i].material.lobe, s.objects[i].material.n_s), scene, (lobe, n_s))
    return scene if shiny else None


def _paths(fit: Fit) -> list[str]:
    """Return the numbers of the scene that may be wrong together: spheres, and where all lights are."""
    own = {path for unknown in fit.unknowns for path, _ in unknown.places}
    own |= {product.path for unknown in fit.unknowns for product in unknown.products}
    paths = [path for of in (*_spheres(fit), *_lights(fit)) for path in of]
    return [path for path in paths if path not in own]


def _spheres(fit: Fit) -> list[list[str]]:
    """Return the radius and the centre of each sphere."""
    objects = fit.scene.objects
    names = [item.name or str(i) for i, item in enumerate(objects) if isinstance(item.surface, Sphere)]
    return (
        [[f"objects.{n}.surface.radius", f"objects.{n}.surface.center"] for n in names] if len(names) <= SPHERES else []
    )


def _lights(fit: Fit) -> list[list[str]]:
    """Return where each light is, and where it points."""
    found = []
    for i, light in enumerate(fit.scene.lights):
        if isinstance(light, DirectionalLight):
            found.append([f"lights.{i}.direction"])
        elif isinstance(light, SpotLight):
            found.append([f"lights.{i}.position", f"lights.{i}.direction"])
        elif isinstance(light, PointLight | MeasuredLight):
            found.append([f"lights.{i}.position"])
    return found


def _moves(fit: Fit, at: dict[tuple[str, int], int], p: int) -> dict[tuple[str, int], np.ndarray]:
    """Return how each fault of geometry moves the numbers, in scene units, or for the lights in degrees."""
    moves: dict[tuple[str, int], np.ndarray] = {}
    for i, paths in enumerate(_spheres(fit)):
        for kind, path in zip(("radius", "center"), paths, strict=True):
            index = [at[path, c] for c in range(3) if (path, c) in at]
            if index:
                moves[kind, i] = np.eye(p)[index]
    turned, lights = np.zeros((3, p)), _lights(fit)
    every = [path for paths in lights for path in paths]
    if every and len(lights) == len(fit.scene.lights) and all((path, 2) in at for path in every):
        centre = centre_of(fit.scene.objects, fit.views[0].camera)
        for path in every:
            _, i, name = path.split(".")
            place = np.asarray(getattr(fit.scene.lights[int(i)], name), np.float64)
            arm = place if name == "direction" else place - centre
            for k, axis in enumerate(np.eye(3)):
                turned[k, [at[path, c] for c in range(3)]] = np.deg2rad(1.0) * np.cross(axis, arm)
        moves["rotation", 0] = turned
    return moves


def _of_geometry(
    fit: Fit, samples: Samples, change: Float[np.ndarray, "k n"], moves: dict[tuple[str, int], np.ndarray]
) -> list[Direction]:
    """Return what faults of geometry change, but for rims seen at a grazing angle, where it is not linear."""
    rim = (
        samples.of(
            [
                np.broadcast_to(rims(fit.scene.objects, view.camera)[0][..., None], (*view.camera.shape, 3))
                for view in fit.views
            ]
        )
        > 0
    )
    found, first = [], 0
    for (kind, i), of in moves.items():
        rows = change[first : first + len(of)]
        first += len(of)
        if kind in ("radius", "center"):
            rows = np.where(rim, 0.0, rows)
        index = tuple(np.flatnonzero(of.any(0)).tolist()) if kind in ("radius", "center") else ()
        if np.isfinite(rows).all():
            found.append(Direction(kind, i, rows, index))
    return found
