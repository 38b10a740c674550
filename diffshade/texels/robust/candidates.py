"""Candidates: normals spread evenly over the hemisphere that faces the camera, of which each texel keeps the best few.

A robust cost has several minima over the normals, and a descent ends in the nearest. So every candidate is tried, with
the best k_d and k_s >= 0 for it in closed form. The sums over the views are products of matrices.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array
from ...model.vectors import Vec3, tangents_of
from .observations import BlockObservations, Lights
from .reflection_shape import ReflectionShape

SIDE = 50  # candidates along each side of a square that is mapped onto the hemisphere: 2 to 3 degrees apart
BLOCK = 128  # texels that are searched for together
MIN_RIDGE = 1e-9  # where no view could show a highlight
KEPT = 4  # minima of each texel that are kept: the best of them is 3 degrees better than the lowest on rough metal


@functools.cache
def hemisphere() -> Float[np.ndarray, "rows columns 3"]:
    """Return normals around +z, a square mapped to the hemisphere with equal areas (Shirley, Chiu 1997)."""
    a, b = np.meshgrid(*[(np.arange(SIDE) + 0.5) / SIDE * 2.0 - 1.0] * 2, indexing="ij")
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    ratio = np.where(wide, b, a) / np.where(radius == 0.0, 1.0, radius)
    angle = np.where(wide, np.pi / 4 * ratio, np.pi / 2 - np.pi / 4 * ratio)
    z = 1.0 - radius**2
    flat = np.abs(radius) * np.sqrt(2.0 - radius**2)
    sign = np.where(radius < 0.0, -1.0, 1.0)
    return np.stack([sign * flat * np.cos(angle), sign * flat * np.sin(angle), z], -1)


def lowest_minima(observed: BlockObservations, shape: ReflectionShape, ridge: Float[Array, " texels"]) -> Vec3:
    """Return the normals of the lowest local minima of squares over all candidates, components (KEPT, texels).

    Args:
        observed: What the views show.
        shape: The highlight's.
        ridge: What k_s^2 adds to the cost of each texel.
    """
    lights = _at_centre(observed.lights)
    n = _facing(jax.tree.map(jnp.mean, lights.v))
    D, S = (m.T for m in lights.shading(shape, n))  # (candidates, views)
    squares = (D, S, D * D, D * S, S * S)
    believed = observed.believed.astype(jnp.float32)

    def of_part(part: tuple[Array, Array, Array]) -> Array:
        return _lowest(squares, *part)

    # parts so small that what is known of all their candidates stays in a core's cache
    parts = max(believed.shape[1] // BLOCK, 1)
    split = [jnp.stack(jnp.split(a, parts, -1)) for a in (believed, observed.y, ridge)]
    chosen = jnp.moveaxis(jax.lax.map(of_part, tuple(split)), 0, 1).reshape(KEPT, -1)
    return jax.tree.map(lambda c: c[chosen], n)


def _lowest(
    squares: tuple[Array, ...],
    believed: Float[Array, "views texels"],
    y: Float[Array, "views texels"],
    ridge: Float[Array, " texels"],
) -> Int[Array, "kept texels"]:
    """Return the candidates with the lowest local minima."""
    D, S, DD, DS, SS = squares
    seen = believed * y
    gain = best_coefficients(DD @ believed, DS @ believed, SS @ believed + ridge[None] + MIN_RIDGE, D @ seen, S @ seen)[
        2
    ]
    cost = jnp.maximum(jnp.sum(seen * y, 0)[None] - gain, 0.0)
    # positive floats are ordered like their bits, of which the lowest 12 can hold the candidate
    index = jnp.arange(len(D), dtype=jnp.int32)[:, None]
    ranked = (jax.lax.bitcast_convert_type(cost, jnp.int32) & ~0xFFF) | index
    minimal = jnp.where(_is_local_minimum(cost), ranked, jnp.iinfo(jnp.int32).max)
    kept, last = [], jnp.full(cost.shape[1:], -1, jnp.int32)
    for _ in range(KEPT):
        following = jnp.min(jnp.where(minimal > last[None], minimal, jnp.iinfo(jnp.int32).max), 0)
        last = jnp.where(following == jnp.iinfo(jnp.int32).max, last, following)  # fewer minima: the last one again
        kept.append(last & 0xFFF)
    return jnp.stack(kept)


def best_coefficients(dd: Array, ds: Array, ss: Array, dy: Array, sy: Array) -> tuple[Array, Array, Array]:
    """Return k_d, k_s >= 0 that minimise squares, and by how much they lower them, from the sums over the views."""
    determinant = dd * ss - ds * ds
    safe = jnp.where(determinant > 1e-6 * dd * ss, determinant, jnp.inf)
    k_d, k_s = (ss * dy - ds * sy) / safe, (dd * sy - ds * dy) / safe
    only_d, only_s = jnp.maximum(dy, 0.0) / (dd + 1e-12), jnp.maximum(sy, 0.0) / (ss + 1e-12)
    of_d, of_s = only_d * dy, only_s * sy
    both, matte = (k_d > 0.0) & (k_s > 0.0), of_d >= of_s
    return (
        jnp.where(both, k_d, jnp.where(matte, only_d, 0.0)),
        jnp.where(both, k_s, jnp.where(matte, 0.0, only_s)),
        jnp.where(both, k_d * dy + k_s * sy, jnp.where(matte, of_d, of_s)),
    )


def weighted_coefficients(
    weight: Float[Array, "views texels"],
    D: Float[Array, "views texels"],
    S: Float[Array, "views texels"],
    y: Float[Array, "views texels"],
    ridge: Float[Array, " texels"],
) -> tuple[Array, Array]:
    """Return k_d, k_s >= 0 that minimise weighted squares."""
    dd, ds, ss, dy, sy = (jnp.sum(weight * product, 0) for product in (D * D, D * S, S * S, D * y, S * y))
    k_d, k_s, _ = best_coefficients(dd, ds, ss + ridge + MIN_RIDGE, dy, sy)
    return k_d, k_s


def _facing(toward: Vec3) -> Vec3:
    """Return the candidates turned from around +z to around a direction."""
    a, b = tangents_of(toward)
    x, y, z = jnp.asarray(hemisphere(), jnp.float32).reshape(-1, 3).T
    return a * x + b * y + toward * z


def _at_centre(lights: Lights) -> Lights:
    """Return the lights at the middle of a block, which is small where lamps are near."""
    mean = jax.tree.map(lambda c: jnp.mean(c, -1, keepdims=True), lights.l)
    length = jnp.sqrt(mean.x**2 + mean.y**2 + mean.z**2)
    l = jax.tree.map(lambda c: c / jnp.maximum(length, 1e-6), mean)
    v = jax.tree.map(lambda c: jnp.mean(c, -1, keepdims=True), lights.v)
    return Lights(l, jnp.mean(lights.strength, -1, keepdims=True), v, lights.lobe)


def _is_local_minimum(cost: Float[Array, "candidates texels"]) -> Array:
    """Return where no neighbour on the square of candidates is lower."""
    padded = jnp.pad(cost.reshape(SIDE, SIDE, -1), ((1, 1), (1, 1), (0, 0)), constant_values=jnp.inf)
    across = jnp.minimum(jnp.minimum(padded[:-2], padded[1:-1]), padded[2:])
    around = jnp.minimum(jnp.minimum(across[:, :-2], across[:, 1:-1]), across[:, 2:])
    return cost <= around.reshape(cost.shape)
