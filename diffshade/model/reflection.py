"""Reflection: what the points of a surface reflect (E1, E4-E7, E9); the only place where a light meets a material."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp

from ..core.fields import Array, Colour
from ..core.thresholds import SMALL
from .lights import AbstractEmitter, AbstractLight
from .lobes import AbstractLobe, Coefficients
from .materials import Material
from .vectors import Vec3, dot

Reached: TypeAlias = Callable[[Vec3, Array | None], Array]


def reflectance(material: Material, k: Coefficients, n: Vec3, l: Vec3, v: Vec3) -> Vec3:
    """Fraction of the light from l that leaves towards v: k_d (n.l)_+ + sum of W (cos)_+^n_s (E4, E5, E6).

    cos is v.r (Phong) or n.h (Blinn); W is k_s or Fresnel's (E7); a highlight is 0 unless n.l > 0. Nothing is
    normalised by n_s and the highlight carries no n.l: the textbook model. At n.l = 0 and cos = 0 the derivative is 0,
    that of the dark side. For speed `inverse.forward.features` and `texels.geometry` have the same as exp(n_s log cos),
    and the report's `reflection.glsl` in the browser.
    """
    return _with_highlights(material.lobe.reflected(k, material.fresnel, n, l, v), material, k, n, l, v)


def diffuse_and_specular(material: Material, k: Coefficients, n: Vec3, l: Vec3, v: Vec3) -> tuple[Vec3, Vec3]:
    """The two parts of `reflectance`, for a light whose colours are apart: k_d (n.l)_+, and the highlights."""
    lobe = material.lobe
    assert isinstance(lobe, AbstractLobe)  # the scene checks it
    diffuse, specular = lobe.diffuse_and_specular(k, material.fresnel, n, l, v)
    return diffuse, _with_highlights(specular, material, k, n, l, v)


def _with_highlights(total: Vec3, material: Material, k: Coefficients, n: Vec3, l: Vec3, v: Vec3) -> Vec3:
    """Return a reflectance with those of the further highlights added."""
    if not material.highlights:
        return total
    n_l = dot(n, l)
    lit = n_l > 0
    for more, (k_s, n_s) in zip(material.highlights, k.highlights, strict=True):
        W = material.fresnel.weight(k_s, k.eta, jnp.where(lit, n_l, 0.0))
        total = total + W * more.lobe.gated(lit, n_s, n, l, v)
    return total


def towards_light(n_l: Array, n_v: Array, l_v: Array) -> Array:
    r"""Return what a rough surface reflects towards the light beyond Lambert's law, over that, where B / A is 1.

    $$ (l \cdot v - n \cdot l \; n \cdot v)_+ / \max(n \cdot l, n \cdot v) $$

    This is $\cos(\phi_l - \phi_v)_+ \sin\alpha \tan\beta$ of Oren and Nayar (1994), eq. 30.
    """
    n_v = jnp.maximum(n_v, SMALL)
    return jnp.maximum(l_v - n_l * n_v, 0.0) / jnp.maximum(n_l, n_v)


def reflection(
    material: Material,
    k: Coefficients,
    ambient: Vec3,
    lights: Sequence[AbstractLight],
    p: Vec3 | None,
    n: Vec3,
    v: Vec3,
    reached: Reached | None = None,
) -> Vec3:
    """Radiance k_e + k_a I_a + sum over lights of f_rad f_ang I_l reflectance (E9).

    A light whose colours are apart adds f_rad f_ang (k_a I_la + I_ld diffuse + I_ls specular) instead, as in OpenGL
    (The OpenGL Graphics System 1.1, section 2.13.1).

    `k` are the coefficients at the points, which may be those of several materials of one kind. `lights` are stacks
    (see `scenes.StackedScene`): each is a light whose leaves have a leading axis, one entry a light of that kind. `p`,
    `n`, `v` have components of one shape; `p` may be None where no light is local. `reached` says which points light
    from a direction and distance reaches: all if it is None.
    """

    def arriving(light: AbstractEmitter) -> tuple[Vec3, Vec3]:
        l, intensity = light.arriving(p)
        if reached is None:
            return l, intensity
        there = reached(l, light.path(p).d)
        return l, Vec3(*(jnp.where(there, c, 0.0) for c in (intensity.x, intensity.y, intensity.z)))

    def add(total: Vec3, light: AbstractEmitter) -> tuple[Vec3, None]:
        l, intensity = arriving(light)
        return total + intensity * reflectance(material, k, n, l, v), None

    def add_apart(total: Vec3, light: tuple[AbstractEmitter, Colours]) -> tuple[Vec3, None]:
        unit, colours = light
        l, f = arriving(unit)
        if colours.specular is None:
            returned = Vec3.of(colours.diffuse) * reflectance(material, k, n, l, v)
        else:
            diffuse, specular = diffuse_and_specular(material, k, n, l, v)
            returned = Vec3.of(colours.diffuse) * diffuse + Vec3.of(colours.specular) * specular
        return total + f * (returned if colours.ambient is None else returned + k.k_a * Vec3.of(colours.ambient)), None

    total = (k.k_e + k.k_a * ambient) * jnp.ones_like(n.x)
    for stack in lights:
        adds, entries = (add, stacked_emitters(stack)) if stack.has_one_colour else (add_apart, _apart(stack))
        if len(jax.tree.leaves(entries)[0]) == 1:
            total, _ = adds(total, jax.tree.map(lambda leaf: leaf[0], entries))
        else:  # scanned, so that a hundred lights compile as one; recomputed, so that reverse mode does not store each
            total, _ = jax.lax.scan(jax.checkpoint(adds), total, entries)
    return total


class Colours(NamedTuple):
    """The colours of a light that are apart."""

    ambient: Colour | None
    diffuse: Colour
    specular: Colour | None


def _apart(stack: Any) -> tuple[AbstractEmitter, Colours]:
    """Return a stack of lights as the emitters of their light at unit intensity, and the colours of each emitter."""
    colours = Colours(stack.ambient, stack.intensity, stack.specular)
    unit = eqx.tree_at(
        lambda light: (light.ambient, light.intensity, light.specular),
        stack,
        (None, jnp.ones_like(stack.intensity), None),
        is_leaf=lambda leaf: leaf is None,
    )
    emitters = stacked_emitters(unit)
    each = len(jax.tree.leaves(emitters)[0]) // max(len(stack.intensity), 1)  # none of a kind may be on
    return emitters, jax.tree.map(lambda colour: jnp.repeat(jnp.asarray(colour), each, 0), colours)


def stacked_emitters(stack: AbstractLight) -> AbstractEmitter:
    """Return a stack of lights as a stack of the emitters that they consist of."""
    if isinstance(stack, AbstractEmitter):
        return stack
    each = jax.vmap(lambda light: light.emitters())(stack)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), each)
