"""Photometric stereo: the normals of a matte surface from its shading (Woodham 1980), where a fit of normals starts."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..core.fields import Array
from ..model.vectors import Vec3, normalize, where
from .linear_systems import solve

MIN_RANK, MAX_RANK = 0.2, 0.7  # ranks of the observations that are used: below are shadows, above highlights
MIN_USED = 4.0  # observations used at least


def photometric_stereo(
    l: Vec3,
    strength: Float[Array, "views lamps emitters _"],
    v: Vec3,
    shown: Float[Array, "views texels"],
    counts: Bool[Array, "views texels"],
) -> Vec3:
    """Return the normals that fit the observations of middle rank, once each is divided by its light.

    Args:
        l: Directions to the lights, components (views, emitters, texels or 1).
        strength: Intensities of the lights, exposure included.
        v: Direction to the camera, the normal where no observation determines one.
        shown: The mean over the channels of each observation, without black, ambient light and emission.
        counts: Which observations count.
    """
    arriving = mean_light(l, strength)
    size = jnp.sqrt(arriving.x**2 + arriving.y**2 + arriving.z**2)
    usable = counts & (size > 0.0)
    per_light = jnp.where(usable, shown / jnp.where(size > 0.0, size, 1.0), jnp.inf)
    number = jnp.sum(usable, 0, dtype=float)
    ordered = jnp.sort(per_light, 0)
    first = jnp.floor(MIN_RANK * number)
    last = jnp.minimum(jnp.maximum(jnp.ceil(MAX_RANK * number), first + MIN_USED), number) - 1.0
    low, high = (jnp.take_along_axis(ordered, jnp.maximum(i, 0.0).astype(int)[None], 0)[0] for i in (first, last))
    middle = usable & (per_light >= low[None]) & (per_light <= high[None])
    L = [jnp.where(middle, c / jnp.where(size > 0.0, size, 1.0), 0.0) for c in (arriving.x, arriving.y, arriving.z)]
    y = jnp.where(middle, per_light, 0.0)
    g = solve([[jnp.sum(a * b, 0) for b in L] for a in L], [jnp.sum(a * y, 0) for a in L])
    n = normalize(Vec3(*g))
    return where(n.x**2 + n.y**2 + n.z**2 > 0.5, n, jax.tree.map(lambda c: c[0] + jnp.zeros_like(n.x), v))


def mean_light(l: Vec3, strength: Float[Array, "views lamps emitters _"]) -> Vec3:
    """Return the light that arrives in each view as a vector, the mean over the channels: sum of I f_rad f_ang l."""
    mean = strength.mean(1)
    return Vec3(*(jnp.sum(mean * c, 1) for c in (l.x, l.y, l.z)))
