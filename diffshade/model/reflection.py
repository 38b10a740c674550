"""Reflection: what the points of a surface reflect (E1, E4-E7, E9); the only place where a light meets a material."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from .lights import AbstractEmitter, AbstractLight
from .lobes import Coefficients
from .materials import Material
from .vectors import Vec3, dot


def reflectance(material: Material, k: Coefficients, n: Vec3, l: Vec3, v: Vec3) -> Vec3:
    """Fraction of the light from l that leaves towards v: k_d (n.l)_+ + sum of W (cos)_+^n_s (E4, E5, E6).

    cos is v.r (Phong) or n.h (Blinn); W is k_s or Fresnel's (E7); a highlight is 0 unless n.l > 0. Nothing is
    normalised by n_s and the highlight carries no n.l: the textbook model. At n.l = 0 and cos = 0 the derivative is 0,
    that of the dark side. For speed `inverse.forward.features` and `texels.geometry` have the same as exp(n_s log cos),
    and the report's `reflection.glsl` in the browser.
    """
    total = material.lobe.reflected(k, material.fresnel, n, l, v)
    if not material.highlights:
        return total
    n_l = dot(n, l)
    lit = n_l > 0
    for more, (k_s, n_s) in zip(material.highlights, k.highlights, strict=True):
        W = material.fresnel.weight(k_s, k.eta, jnp.where(lit, n_l, 0.0))
        total = total + W * more.lobe.gated(lit, n_s, n, l, v)
    return total


def reflection(
    material: Material,
    k: Coefficients,
    ambient: Vec3,
    lights: Sequence[AbstractLight],
    p: Vec3 | None,
    n: Vec3,
    v: Vec3,
) -> Vec3:
    """Radiance k_e + k_a I_a + sum over lights of f_rad f_ang I_l reflectance (E9).

    `k` are the coefficients at the points, which may be those of several materials of one kind. `lights` are stacks
    (see `scenes.StackedScene`): each is a light whose leaves have a leading axis, one entry a light of that kind. `p`,
    `n`, `v` have components of one shape; `p` may be None where no light is local.
    """

    def add(total: Vec3, light: AbstractEmitter) -> tuple[Vec3, None]:
        l, intensity = light.arriving(p)
        return total + intensity * reflectance(material, k, n, l, v), None

    total = (k.k_e + k.k_a * ambient) * jnp.ones_like(n.x)
    for stack in map(stacked_emitters, lights):
        if len(jax.tree.leaves(stack)[0]) == 1:
            total, _ = add(total, jax.tree.map(lambda leaf: leaf[0], stack))
        else:  # scanned, so that a hundred lights compile as one; recomputed, so that reverse mode does not store each
            total, _ = jax.lax.scan(jax.checkpoint(add), total, stack)
    return total


def stacked_emitters(stack: AbstractLight) -> AbstractEmitter:
    """Return a stack of lights as a stack of the emitters that they consist of."""
    if isinstance(stack, AbstractEmitter):
        return stack
    each = jax.vmap(lambda light: light.emitters())(stack)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), each)
