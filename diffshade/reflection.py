"""Reflection: what one point of a surface reflects (E1, E4-E6, E9); the only place where a light meets a material."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from .fields import Array
from .lights import AbstractLight
from .materials import Material
from .vectors import Vec3, dot, positive_power


def reflectance(material: Material, n: Vec3, l: Vec3, v: Vec3) -> Vec3:
    """Fraction of the light from l that leaves towards v: k_d (n.l)_+ + k_s (cos)_+^n_s (E4, E5, E6).

    cos is v.r (Phong) or n.h (Blinn); the highlight is 0 unless n.l > 0. Nothing is normalised by n_s and the highlight
    carries no n.l: the textbook model. At n.l = 0 and cos = 0 the derivative is 0, that of the dark side.
    """
    n_l = dot(n, l)
    lit = n_l > 0
    diffuse = jnp.where(lit, n_l, 0.0)
    cosine = material.lobe.cosine(n, l, v)

    def highlight(n_s: Array) -> Array:
        return jnp.where(lit, positive_power(cosine, n_s), 0.0)

    if jnp.ndim(material.n_s) == 0:
        specular = Vec3.of(material.k_s) * highlight(material.n_s)
    else:  # one exponent a channel
        specular = Vec3.of(material.k_s) * Vec3(*(highlight(material.n_s[c]) for c in range(3)))
    return Vec3.of(material.k_d) * diffuse + specular


def reflection(
    material: Material, ambient: Vec3, lights: Sequence[AbstractLight], p: Vec3 | None, n: Vec3, v: Vec3
) -> Vec3:
    """Radiance k_a I_a + sum over lights of f_rad f_ang I_l reflectance (E9).

    `lights` are stacks (see `scenes.StackedScene`): each is a light whose leaves have a leading axis, one entry a light
    of that kind. `p`, `n`, `v` have components of one shape; `p` may be None where no light is local.
    """

    def add(total: Vec3, light: AbstractLight) -> tuple[Vec3, None]:
        l, intensity = light.arriving(p)
        return total + intensity * reflectance(material, n, l, v), None

    total = Vec3.of(material.k_a) * ambient * jnp.ones_like(n.x)
    for stack in lights:
        if len(jax.tree.leaves(stack)[0]) == 1:
            total, _ = add(total, jax.tree.map(lambda leaf: leaf[0], stack))
        else:  # scanned, so that a hundred lights compile as one; recomputed, so that reverse mode does not store each
            total, _ = jax.lax.scan(jax.checkpoint(add), total, stack)
    return total
