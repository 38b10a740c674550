"""Laws of shading: the light of each photograph of a matte ball, and the law that all photographs share."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ..core.robust_scale import robust_scale
from ..core.thresholds import MAX_STEPS, ROUNDING
from ..inverse.forward.losses import CAUCHY
from ..inverse.solve.elimination import eliminate
from .balls import Vectors

Table = Float[np.ndarray, "photographs pixels"]

LAWS = {"E4": 0, "E1 and E4": 1, "any": 5}  # laws of shading, and how many parameters the photographs share
PRIOR = 0.3  # standard deviation of the shared parameters: it decides what one photograph leaves open
SETTLED = 8  # the step after which the scale of the loss is fixed


@dataclass(frozen=True, eq=False)
class Shading:
    """The samples of several photographs at the same pixels of a ball, sorted by patch."""

    values: Table
    """The mean of the channels; NaN where a sample is clipped."""
    n: Float[np.ndarray, "pixels 3"]
    n_v: Float[np.ndarray, " pixels"]
    patch: Int[np.ndarray, " pixels"]


@dataclass(frozen=True, eq=False)
class PhotographLights:
    """The light of each photograph: b = k_d I l, with l towards the light."""

    b: Vectors
    covariance: Float[np.ndarray, "photographs 3 3"]
    """The covariance of b, by leaving out one patch of the ball at a time."""
    shared: Float[np.ndarray, " m"]
    """The shared parameters: the ambient light over the median |b|, and s_1 to s_4 of the law."""
    residuals: Table
    weights: Table
    """The weight of each pixel by the loss; 0 where it is clipped."""
    lit: Table
    """What the light alone, without ambient light, adds at each pixel."""

    @property
    def intensity(self) -> Float[np.ndarray, " photographs"]:
        """k_d I of each photograph."""
        return np.linalg.norm(self.b, axis=-1)

    @property
    def direction(self) -> Vectors:
        """l of each photograph."""
        return self.b / self.intensity[:, None]


class Linear(NamedTuple):
    """Residuals, and their derivatives with respect to each photograph's own and the shared parameters."""

    residuals: np.ndarray
    own: np.ndarray
    shared: np.ndarray
    lit: np.ndarray


class Normal(NamedTuple):
    """The normal equations: a block for each photograph, its coupling to the shared parameters, and their block."""

    own: np.ndarray
    coupling: np.ndarray
    shared: np.ndarray
    own_gradient: np.ndarray
    shared_gradient: np.ndarray


def find_lamps(shading: Shading, law: str, directions: Vectors | None = None) -> PhotographLights:
    """Find the light of each photograph of a matte ball, by least squares with a Cauchy loss.

    I = a + |b| F(n.l, n.v) where n.l > 0, else a; l = b/|b|. The law "E4" is Lambert's, F = n.l and a = 0 (Woodham
    1980, "Photometric method for determining surface orientation from multiple images"). "E1 and E4" adds an ambient a,
    the same for all photographs. "any" is F = u (1 + s_1 (1-u) + s_2 (1-u)^2 + s_3 (1-n.v) + s_4 (1-n.v)^2) with u =
    n.l, the same for all photographs, for a rough ball or a camera's curve. The shared parameters have a prior of 0 +-
    0.3. The attached shadow follows from the l that is found.

    The solver is Gauss-Newton with Levenberg's damping; the photographs' own blocks are eliminated.

    Args:
        shading: The samples of the photographs.
        law: A key of `LAWS`.
        directions: Known unit vectors towards the lights; then only the lengths |b| are unknown.
    """
    known = np.isfinite(shading.values)
    b = _lambert(shading)
    ways = np.broadcast_to(np.eye(3), (len(b), 3, 3))
    if directions is not None:
        b = directions * np.linalg.norm(b, axis=-1, keepdims=True)
        ways = directions[:, :, None]
    s, unit = np.zeros(LAWS[law]), float(np.median(np.linalg.norm(b, axis=-1)))
    damping, cost, scale, best = 1e-6, np.inf, 0.0, (b, s)
    weights, normal = np.zeros(known.shape), None
    for step in range(MAX_STEPS):
        at = _linear(shading, b, s, unit, ways)
        if step <= SETTLED:
            scale, cost = max(robust_scale(at.residuals[known]), 1e-6 * unit), np.inf
        ratio = (at.residuals / (CAUCHY * scale)) ** 2
        now = float((CAUCHY * scale) ** 2 * np.log1p(ratio)[known].sum() + (scale / PRIOR) ** 2 * s @ s)
        if now <= cost:
            settled = cost - now <= ROUNDING * now
            best, cost, damping = (b, s), now, damping / 10.0
            weights = np.where(known, 1.0 / (1.0 + ratio), 0.0)
            normal = _with_prior(_normal(at, weights, slice(None)), s, scale)
        else:
            settled, damping = damping > 1e3, damping * 100.0
        if settled or normal is None:
            break
        own, shared = _solve(normal, max(damping, 1e-9))
        b, s = best[0] + np.einsum("ijk,ik->ij", ways, own), best[1] + shared
    assert normal is not None  # the first cost is below infinity
    b, s = best
    at = _linear(shading, b, s, unit, ways)
    ends = np.searchsorted(shading.patch, np.arange(shading.patch.max() + 2))
    patches = [slice(first, last) for first, last in itertools.pairwise(ends) if last > first]
    without = [jax.tree.map(np.subtract, normal, _normal(at, weights, patch)) for patch in patches]
    moved = np.einsum("ijk,pik->pij", ways, np.array([_solve(one, 1e-9)[0] for one in without]))
    # the cost's curvature is psi' = (1 - t^2) w^2, t = r / (2.385 sigma); the normal equations have the weights w
    t2 = (at.residuals / (CAUCHY * scale)) ** 2
    moved = (moved - moved.mean(0)) * weights.sum() / ((1.0 - t2) * weights**2).sum()
    covariance = (len(moved) - 1) / len(moved) * np.einsum("pij,pik->ijk", moved, moved)
    return PhotographLights(b, covariance, s, np.where(known, at.residuals, np.nan), weights, at.lit)


def _lambert(shading: Shading) -> Vectors:
    """Return each photograph's b by Lambert's law, from the brighter half of its pixels, which are lit."""
    found = []
    for values in shading.values:
        bright = np.isfinite(values) & (values >= np.nanmedian(values))
        found.append(np.linalg.lstsq(shading.n[bright], values[bright], rcond=None)[0])
    return np.array(found)


def _linear(shading: Shading, b: Vectors, s: np.ndarray, unit: float, ways: np.ndarray) -> Linear:
    length = np.linalg.norm(b, axis=-1)[:, None]
    l = b / length
    n_l = l @ shading.n.T
    u = np.where(n_l > 0, n_l, 0.0)
    F, slope, shared = u, np.where(n_l > 0, 1.0, 0.0), [np.full_like(u, unit)] if len(s) else []
    if len(s) > 1:
        rim = np.broadcast_to(1.0 - shading.n_v, u.shape)
        shapes = (u * (1 - u), u * (1 - u) ** 2, u * rim, u * rim**2)
        slopes = (1 - 2 * u, (1 - u) * (1 - 3 * u), rim, rim**2)
        F = u + sum(k * shape for k, shape in zip(s[1:], shapes, strict=True))
        slope = slope * (1.0 + sum(k * each for k, each in zip(s[1:], slopes, strict=True)))
        shared += [length * shape for shape in shapes]
    by_b = F[:, None] * l[:, :, None] + slope[:, None] * (shading.n.T - u[:, None] * l[:, :, None])
    lit = length * F
    ambient = s[0] * unit if len(s) else 0.0
    residuals = np.where(np.isfinite(shading.values), ambient + lit - shading.values, 0.0)
    return Linear(residuals, np.einsum("ijk,ijp->ikp", ways, by_b), np.array(shared).reshape(len(s), *u.shape), lit)


def _normal(at: Linear, weights: Table, pixels: slice) -> Normal:
    """Return the normal equations of a range of pixels."""
    own, shared = at.own[..., pixels], at.shared[..., pixels]
    weighted, r = own * weights[:, None, pixels], (weights * at.residuals)[:, pixels]
    return Normal(
        weighted @ own.swapaxes(1, 2),
        np.einsum("ikp,mip->ikm", weighted, shared),
        np.einsum("mip,ip,nip->mn", shared, weights[:, pixels], shared, optimize=True),
        np.einsum("ikp,ip->ik", own, r),
        np.einsum("mip,ip->m", shared, r),
    )


def _with_prior(normal: Normal, s: np.ndarray, scale: float) -> Normal:
    strength = (scale / PRIOR) ** 2
    return normal._replace(
        shared=normal.shared + strength * np.eye(len(s)), shared_gradient=normal.shared_gradient + strength * s
    )


def _solve(normal: Normal, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps of each photograph's own and of the shared parameters."""
    own, shared = (of + damping * of * np.eye(of.shape[-1]) for of in (normal.own, normal.shared))
    inverses = np.linalg.inv(own + 1e-300 * np.eye(own.shape[-1]))
    by_shared, alone, of_matrix, of_right = eliminate(inverses, normal.coupling, normal.own_gradient[..., None])
    s = -np.linalg.solve(shared - of_matrix, normal.shared_gradient - of_right[..., 0].sum(0))
    return -alone[..., 0] - by_shared @ s, s
