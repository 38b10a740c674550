"""Conventions: lights in other axes or in another order than the photographs, where the normals are unknown.

Another order leaves no normals that explain the photographs. Other axes leave normals that explain them as well, turned
or mirrored; but those of a thing face the camera, point outward at its outline, and are those of one surface.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.polynomial import legendre

from ..core.thresholds import BLACK, CLEARLY, MINOR, MOST, SMALL, TINY
from ..core.words import Note
from ..inverse.data.views import View, lights_on
from ..inverse.misfit.changes import SMOOTH_DEGREE
from ..inverse.misfit.conventions import HEALED, MIN_VIEWS, axes_in_words, orders
from ..model.cameras import axes
from ..model.scenes import Scene
from .tiles import TexelTile

DEGREE = 2 * SMOOTH_DEGREE  # of the height whose slopes are compared with those of the normals


@dataclass(frozen=True, eq=False)
class _Shading:
    """What the texels of an object show."""

    seen: Float[np.ndarray, "views n"]
    """Brightness, of exposure 1."""
    used: Bool[np.ndarray, "views n"]
    """Neither the darkest third, which may be in shadow, nor the brightest tenth, which may be a highlight."""
    place: Float[np.ndarray, "2 n"]
    """From -1 to 1 across the object, along x and y."""


def other_light_convention(
    scene: Scene, views: Sequence[View], sample: TexelTile, middle: Float[np.ndarray, "3"]
) -> Note | None:
    """Return a sentence if the lights are described in other axes, or listed in another order, than the photographs.

    Args:
        scene: The scene; each view needs one of its lights.
        views: The photographs.
        sample: Some texels of the object.
        middle: The middle of the object, to which lamps are near.
    """
    on = [lights_on(scene, view) for view in views]
    if len(views) < 2 * MIN_VIEWS or any(len(lit) != 1 for lit in on):
        return None
    lamps = [scene.lights[lit[0]] for lit in on]
    towards = [_towards(lamp, middle) for lamp in lamps]
    if any(of is None for of in towards):
        return None
    camera = np.array([np.asarray(axis.stack()) for axis in axes(views[0].camera)])
    power = [float(np.mean(np.asarray(getattr(lamp, "intensity", 1.0)))) for lamp in lamps]
    l = np.array(power)[:, None] * np.array(towards) @ camera.T
    if np.linalg.cond(l) > 1.0 / SMALL:  # nearly in one plane, or along one line
        return None
    shading = _shading(views, sample)
    given = _squares(l, shading)
    others = [(_squares(l[order], shading), words) for words, order in orders(len(l))]
    best, words = min(others)
    if best < HEALED * given and all(CLEARLY * best < squares for squares, other in others if other != words):
        return _said(words)
    return _other_axes(_normals(l, shading), shading)


def _said(words: str) -> Note:
    return Note(f"{words}. Nothing is determined until it is corrected.", "cause", ("convention",))


def _towards(lamp: Any, middle: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"] | None:
    """Return the direction to a lamp; None if it has none."""
    place = next(iter(lamp.placement), "")
    if place not in ("direction", "position"):
        return None
    towards = -np.asarray(lamp.direction) if place == "direction" else np.asarray(lamp.position) - middle
    return towards / np.linalg.norm(towards)


def _other_axes(n: Float[np.ndarray, "n 3"], shading: _Shading) -> Note | None:
    """Return a sentence if the normals are those of a surface in other axes alone."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            A = np.array(signs)[:, None] * np.eye(3)[list(order)]
            found.append((_looks_like_a_surface(n @ A.T, shading), A))
    given = next(score for score, A in found if (np.eye(3) == A).all())
    score, A = max(found, key=lambda one: one[0])
    if score < 1.0 + MOST or score - given < 3.0 * SMALL:
        return None
    return _said(axes_in_words(A))


def _looks_like_a_surface(n: Float[np.ndarray, "n 3"], shading: _Shading) -> float:
    """Return how much normals look like those of a thing, at most 3: the more of the three signs, the more it is one.

    They face the camera, steep ones point away from the middle, and their slopes are those of a height.
    """
    facing = float(np.mean(n[:, 2] > 0.0))
    if facing < 1.0 - SMALL:
        return 0.0
    away = shading.place - shading.place.mean(1, keepdims=True)
    away = away / np.maximum(np.linalg.norm(away, axis=0), TINY)
    steep = n[:, 2] < 1.0 - BLACK  # as at the outline
    outward = float(np.mean(np.sum(n[steep, :2].T * away[:, steep], 0))) if steep.mean() > MINOR else 0.0
    return facing + outward + _integrable(n, shading.place)


def _integrable(n: Float[np.ndarray, "n 3"], place: Float[np.ndarray, "2 n"]) -> float:
    """Return the share of the slopes' squares that a smooth height explains."""
    flat = n[:, 2] > 2.0 * SMALL  # steeper slopes are too large to compare
    p, q = (-n[flat, k] / n[flat, 2] for k in (0, 1))
    weight = n[flat, 2]
    x, y = place[:, flat]
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j > 0]
    X, Y = legendre.legvander(x, DEGREE), legendre.legvander(y, DEGREE)
    slopes = np.eye(DEGREE + 1)
    dX, dY = (np.stack([legendre.legval(at, legendre.legder(c)) for c in slopes], -1) for at in (x, y))
    both = ((dX, Y), (X, dY))
    A = np.concatenate([np.stack([of[:, i] * by[:, j] * weight for i, j in powers], -1) for of, by in both])
    b = np.concatenate([p * weight, q * weight])
    c = np.linalg.lstsq(A, b, rcond=None)[0]
    return float(1.0 - np.sum((b - A @ c) ** 2) / max(np.sum(b**2), TINY))


def _normals(l: Float[np.ndarray, "views 3"], of: _Shading) -> Float[np.ndarray, "n 3"]:
    """Return the normals by least squares (Woodham 1980)."""
    g = _by_squares(l, of)
    return g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), TINY)


def _by_squares(l: Float[np.ndarray, "views 3"], of: _Shading) -> Float[np.ndarray, "n 3"]:
    H = np.einsum("vn,vi,vj->nij", of.used, l, l) + TINY * np.eye(3)
    return np.linalg.solve(H, np.einsum("vn,vi->ni", of.used * of.seen, l)[..., None])[..., 0]


def _squares(l: Float[np.ndarray, "views 3"], of: _Shading) -> float:
    """Return the sum of squares that normals leave."""
    return float(np.sum(of.used * (of.seen - l @ _by_squares(l, of).T) ** 2))


def _shading(views: Sequence[View], sample: TexelTile) -> _Shading:
    """Return what some texels show."""
    seen = sample.target.mean(1) / np.array([float(view.exposure) for view in views])[:, None]
    rank = np.argsort(np.argsort(seen, 0), 0) / len(seen)
    used = sample.counts & (rank >= 1 / 3) & (rank < 1.0 - SMALL)
    row, column = np.divmod(sample.pixels, views[0].camera.shape[1])
    return _Shading(seen, used, _place(row, column))


def _place(row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> Float[np.ndarray, "2 n"]:
    middle = [(of.max() + of.min()) / 2 for of in (column, row)]
    half = max(np.ptp(row), np.ptp(column), 1) / 2
    return np.array([(column - middle[0]) / half, (middle[1] - row) / half])
