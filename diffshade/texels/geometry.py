r"""Lighting geometry: how the light of each view reaches a block of texels, for free and for fixed normals.

A view shows in each channel, summed over its lights (E2-E6),

$$ m = base + k_a a + k_d u + k_s v, \quad a = t I_a, \quad u = \sum t I f_{rad} f_{ang} (n \cdot l)_+, \quad
   v = \sum t I f_{rad} f_{ang} (\cos)_+^{n_s} $$

with the exposure t. All but n and n_s is computed once for a block.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..core.fields import Array
from ..inverse.forward.lighting import DARK
from ..model.lobes import AbstractPowerLobe
from ..model.vectors import Vec3, dot
from .lighting import LightingSetup

Angles = tuple[Float[Array, "*views emitters texels"], Float[Array, "*views emitters texels"]]  # (n.l)_+, log of cos


class UnitShading(NamedTuple):
    """u and v of one view: its shading for k_d = 1 and for k_s = 1, and their derivatives."""

    u: Float[Array, "lamps texels"]
    v: Float[Array, "lamps texels"]
    by_tilt: list[tuple[Float[Array, "lamps texels"], Float[Array, "lamps texels"]]]
    """(du, dv) along each tangent of the normal."""
    v_by_x: Float[Array, "lamps texels"]
    """dv/dx, x = log n_s."""


class ViewGeometry(NamedTuple):
    """One view as `LightingGeometry.shading` needs it."""

    l: Vec3
    strength: Float[Array, "*views lamps emitters _"]
    angles: Angles | None


class LightingGeometry(eqx.Module):
    """How the light of each view reaches a block of texels: directions and intensities, exposure included.

    The axis `lamps` is one of channels, of length 1 where all light is grey.
    """

    l: Vec3
    """Components (views, emitters, texels or 1)."""
    strength: Float[Array, "views lamps emitters _"]
    v: Vec3
    """Components (1, texels or 1)."""
    lobe: AbstractPowerLobe
    angles: Angles | None = None
    """Those of normals that stay as they are, for which they are computed once."""

    @property
    def views(self) -> ViewGeometry:
        """All views along a leading axis, for a scan."""
        return ViewGeometry(self.l, self.strength, self.angles)

    def shading(self, view: ViewGeometry, n: Vec3, tangents: Sequence[Vec3], x: Array) -> UnitShading:
        """Return u and v of one view, with derivatives along the tangents of n and by x = log n_s."""

        def at(n: Vec3) -> tuple[Array, ...]:
            n_l, log_base = _angles(n, view.l, self.v, self.lobe) if view.angles is None else view.angles
            exponent = jnp.exp(x)[None] * log_base
            power = jnp.exp(exponent)
            return tuple(jnp.sum(view.strength * row[None], 1) for row in (n_l, power, exponent * power))

        (u, v, v_by_x), derivative = jax.linearize(at, n)
        by_tilt = [(du, dv) for du, dv, _ in map(derivative, tangents)]
        return UnitShading(u, v, by_tilt, v_by_x)

    def with_normals(self, n: Vec3) -> LightingGeometry:
        """Return the geometry for normals that stay as they are."""
        angles = jax.lax.map(lambda l: _angles(n, l, self.v, self.lobe), self.l)
        return LightingGeometry(self.l, self.strength, self.v, self.lobe, angles)


def _angles(n: Vec3, l: Vec3, v: Vec3, lobe: AbstractPowerLobe) -> Angles:
    """Return (n.l)_+ and the logarithm of the highlight's base, DARK where there is no highlight."""
    n = jax.tree.map(lambda c: c[None], n)
    n_l, cosine = dot(n, l), lobe.cosine(n, l, v)
    lit = n_l > 0
    shines = lit & (cosine > 0)
    return jnp.where(lit, n_l, 0.0), jnp.where(shines, jnp.log(jnp.where(shines, cosine, 1.0)), DARK)


def lighting_geometry(setup: LightingSetup, p: Vec3 | None, v: Vec3) -> LightingGeometry:
    """Return the geometry of texels at the points p, seen from the direction v."""

    def of_view(view: tuple[tuple[tuple[Array, Array], ...], Array]) -> tuple[Vec3, Array]:
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
    """Return one row an emitter, with one column where all texels share it."""
    return jnp.reshape(component, (len(component), -1))


def _lamps(setup: LightingSetup, intensity: Vec3) -> Array:
    """Return the intensity in the channels that differ."""
    if setup.grey_lights:
        return intensity.x[None]
    if setup.grey_images:
        return (intensity.x + intensity.y + intensity.z)[None] / 3.0
    return jnp.stack([intensity.x, intensity.y, intensity.z])
