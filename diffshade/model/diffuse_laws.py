r"""Diffuse laws: how k_d reflects at each angle, by Lambert's law or as real things depart from it.

$$ D = (n \cdot l + w + r (l \cdot v - n \cdot l \; n \cdot v)_+ \min(1, (n \cdot l)_+ / n \cdot v))_+ / (1 + w) $$

Clay, plaster and stone reflect more towards the light. r is B / A of Oren and Nayar (1994), eq. 30, whose product of
cosine, sine and tangent is written here without angles. Light enters wax, marble and skin and comes out nearby: w is
how far beyond the terminator they are lit ("wrap lighting": Green 2004, GPU Gems, chapter 16).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import ArrayLike, Float

from ..core.fields import Array
from ..core.thresholds import SMALL


class DiffuseLaw(NamedTuple):
    """How k_d reflects; r = w = 0 is Lambert's law."""

    roughness: Float[ArrayLike, ""]
    """r: .9 of the roughest surface of Oren and Nayar."""
    translucency: Float[ArrayLike, ""]
    """w: the surface is lit where n.l is above -w."""

    def at(self, n_l: Array, n_v: Array, l_v: Array) -> Array:
        """Return D from the cosines between normal, light and viewer, below 0 where the last ( )_+ makes it 0."""
        n_v = jnp.maximum(n_v, SMALL)
        towards_light = jnp.maximum(l_v - n_l * n_v, 0.0) * jnp.clip(n_l / n_v, 0.0, 1.0)
        return (n_l + self.translucency + self.roughness * towards_light) / (1.0 + self.translucency)


LAMBERT = DiffuseLaw(0.0, 0.0)


def under_coat(n_l: Array, n_v: Array, l_v: Array) -> Array:
    r"""Return D of a colour under a clear coat, which less light passes at grazing angles, on its way in and out.

    $$ D = (n \cdot l)_+ (1 - (1 - n \cdot l)^5) (1 - (1 - n \cdot v)^5) $$

    By Schlick's approximation (1994, eq. 15) of Fresnel's law, over what passes where n, l and v are the same.
    """
    n_l = jnp.clip(n_l, 0.0, 1.0)
    return n_l * (1.0 - (1.0 - n_l) ** 5) * (1.0 - (1.0 - n_v) ** 5)
