"""Sights: what the texels of a block are to the lights of each view, one view after another.

A view shows m = base + k_a a + k_d u + k_s v in each channel, with a = exposure I_a, and u and v the sums over its
lights of exposure I f_rad f_ang (n.l)_+ and exposure I f_rad f_ang (cos)_+^n_s (E2-E6): `Shading`. All of it but n and
n_s is computed once for a block.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..core.fields import Array
from ..inverse.data.views import View, is_grey, lights_on, noises, switches
from ..inverse.forward.features import DARK
from ..model.lights import AreaLight
from ..model.materials import AbstractLobe
from ..model.reflection import emitters
from ..model.scenes import Scene, light_kinds, stack_scene
from ..model.vectors import Vec3, dot


class LightingSetup(eqx.Module):
    """The lights of each view and how it was exposed: all that is known and the same for every texel."""

    stacks: tuple[Any, ...]
    """Emitters by kind, those of a kind along a leading axis."""
    lit: tuple[tuple[Int[Array, "views _"], Float[Array, "views _"]], ...]
    """For each kind the emitters that are on in each view, and 1 for each, or 0 for padding."""
    exposure: Float[Array, " views"]
    black: Float[Array, " views"]
    ambient: Float[Array, " channels"]
    noise: Any
    """The `Noise` of each view, stacked; None where it is not known."""
    lobe: AbstractLobe
    grey_images: bool = eqx.field(static=True)
    """Whether a photograph has one channel, the mean of three."""
    grey_lights: bool = eqx.field(static=True)
    """Whether all light is grey, so that all channels share u and v."""


def rig_of(scene: Scene, views: Sequence[View]) -> LightingSetup:
    """Gather the lights of each view."""
    grey = is_grey(views[0])
    stacks, lit = [], []
    for members, stack in zip(light_kinds(scene.lights), stack_scene(scene).lights, strict=True):
        on = [[members.index(i) for i in lights_on(scene, view) if i in members] for view in views]
        each = int(np.prod(stack.samples)) if isinstance(stack, AreaLight) else 1
        rows = [[i * each + k for i in row for k in range(each)] for row in on]
        if any(rows):
            stacks.append(emitters(stack))
            lit.append(switches(rows))
    intensities = np.concatenate([np.reshape(stack.intensity, (-1, 3)) for stack in stacks] or [np.zeros((1, 3))])
    return LightingSetup(
        tuple(stacks),
        tuple(lit),
        np.array([float(view.exposure) for view in views]),
        np.array([float(view.black) for view in views]),
        np.mean(scene.ambient, keepdims=True) if grey else np.asarray(scene.ambient),
        noises(views),
        scene.objects[0].material.lobe,
        grey_images=grey,
        grey_lights=bool((intensities == intensities[:, :1]).all()),
    )


class Shading(eqx.Module):
    """u and v of one view, and their derivatives by each of the unknowns that the prediction is not linear in."""

    u: Float[Array, "lamps texels"]
    v: Float[Array, "lamps texels"]
    slopes: tuple[tuple[Any, Any], ...]


class LightingGeometry(eqx.Module):
    """How the light of each view reaches the texels: `l` and the intensity there, exposure included.

    The lamps' axis is one of channels, of length 1 where the light is grey; texels far from all lamps share one column.
    """

    l: Vec3
    """Components (views, emitters, texels or 1)."""
    strength: Float[Array, "views lamps emitters _"]
    v: Vec3
    """Components (1, texels or 1)."""
    lobe: AbstractLobe

    def facing(self, n: Vec3) -> FixedNormalGeometry:
        """Return what is left to compute for normals that stay."""

        def of_view(view: Any) -> tuple[Array, Array]:
            l, strength = view
            n_l, log = _angles(n, l, self.v, self.lobe)
            return jnp.sum(strength * n_l[None], 1), log

        u, log = jax.lax.map(of_view, (self.l, self.strength))
        return FixedNormalGeometry(u, log, self.strength)

    def shading(self, view: Any, n: Vec3, tangents: Sequence[Vec3], x: Array) -> Shading:
        """Return the shading of one view for normals n, with slopes along the tangents and by x = log n_s."""
        l, strength = view

        def at(n: Vec3) -> tuple[Array, ...]:
            n_l, log = _angles(n, l, self.v, self.lobe)
            e = jnp.exp(x)[None] * log
            s = jnp.exp(e)
            return tuple(jnp.sum(strength * row[None], 1) for row in (n_l, s, e * s))

        (u, v, v_x), along = jax.linearize(at, n)
        turned = [along(tangent)[:2] for tangent in tangents]
        return Shading(u, v, (*turned, (jnp.zeros_like(u), v_x)))

    @property
    def views(self) -> Any:
        """What a scan over the views goes through."""
        return self.l, self.strength


class FixedNormalGeometry(eqx.Module):
    """Sights of normals that stay: u, and the logarithm of the highlight's base."""

    u: Float[Array, "views lamps texels"]
    log: Float[Array, "views emitters texels"]
    strength: Float[Array, "views lamps emitters _"]

    def shading(self, view: Any, n: Vec3, tangents: Sequence[Vec3], x: Array) -> Shading:
        """Return the shading of one view, with its slope by x = log n_s."""
        u, log, strength = view
        e = jnp.exp(x)[None] * log
        s = jnp.exp(e)
        v, v_x = (jnp.sum(strength * row[None], 1) for row in (s, e * s))
        return Shading(u, v, ((jnp.zeros_like(u), v_x),))

    @property
    def views(self) -> Any:
        """What a scan over the views goes through."""
        return self.u, self.log, self.strength


def _angles(n: Vec3, l: Vec3, v: Vec3, lobe: AbstractLobe) -> tuple[Array, Array]:
    """Return (n.l)_+ and the logarithm of the highlight's base, DARK where there is no highlight."""
    n = jax.tree.map(lambda c: c[None], n)
    n_l, cosine = dot(n, l), lobe.cosine(n, l, v)
    lit = n_l > 0
    shines = lit & (cosine > 0)
    return jnp.where(lit, n_l, 0.0), jnp.where(shines, jnp.log(jnp.where(shines, cosine, 1.0)), DARK)


def sights_of(setup: LightingSetup, p: Vec3 | None, v: Vec3) -> LightingGeometry:
    """Return the sights of texels at p, seen from v."""

    def of_view(view: Any) -> tuple[Vec3, Array]:
        lit, exposure = view
        directions, strengths = [], []
        for stack, (index, on) in zip(setup.stacks, lit, strict=True):
            lights = jax.tree.map(lambda leaf, index=index: leaf[index], stack)
            l, intensity = jax.vmap(lambda light: light.arriving(p))(lights)
            directions.append(jax.tree.map(_as_rows, l))
            strengths.append(_lamps(setup, jax.tree.map(_as_rows, intensity)) * (exposure * on)[None, :, None])
        if not directions:
            none = jnp.zeros((0, 1))
            return Vec3(none, none, none), jnp.zeros((1, 0, 1))
        width = max(d.x.shape[-1] for d in directions)
        wide = max(s.shape[-1] for s in strengths)
        l = jax.tree.map(lambda *cs: jnp.concatenate([jnp.broadcast_to(c, (len(c), width)) for c in cs]), *directions)
        return l, jnp.concatenate([jnp.broadcast_to(s, (*s.shape[:2], wide)) for s in strengths], 1)

    l, strength = jax.lax.map(of_view, (setup.lit, setup.exposure))
    return LightingGeometry(l, strength, jax.tree.map(lambda c: jnp.reshape(c, (1, -1)), v), setup.lobe)


def _as_rows(component: Array) -> Array:
    """Return one row an emitter, of a column where all texels share it."""
    return jnp.reshape(component, (len(component), -1))


def _lamps(setup: LightingSetup, intensity: Vec3) -> Array:
    """Return the intensity in the channels that differ."""
    if setup.grey_lights:
        return intensity.x[None]
    if setup.grey_images:
        return (intensity.x + intensity.y + intensity.z)[None] / 3.0
    return jnp.stack([intensity.x, intensity.y, intensity.z])
