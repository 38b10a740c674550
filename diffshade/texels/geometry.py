r"""Lighting geometry: how the light of each view reaches a block of texels, for free and for fixed normals.

A view shows in each channel, summed over its lights (E2-E6),

$$ m = base + k_a a + k_d u + k_s v, \quad a = t I_a, \quad u = \sum t I f_{rad} f_{ang} (n \cdot l)_+, \quad
   v = \sum t I f_{rad} f_{ang} (\cos)_+^{n_s} $$

with the exposure t. All but n and n_s is computed once for a block.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..core.fields import Array
from ..inverse.forward.lighting import DARK
from ..model.lobes import AbstractPowerLobe
from ..model.vectors import Vec3, dot
from .light_directions import out_of_plane, scatter
from .lighting import LightingSetup
from .photometric_stereo import photometric_stereo


class UnitShading(eqx.Module):
    """u and v of one view: its shading for k_d = 1 and for k_s = 1, and their derivatives."""

    u: Float[Array, "lamps texels"]
    v: Float[Array, "lamps texels"]
    by_tilt: tuple[tuple[Float[Array, "lamps texels"], Float[Array, "lamps texels"]], ...]
    """(du, dv) by each tilt of the normal; empty for fixed normals."""
    v_by_x: Float[Array, "lamps texels"]
    """dv/dx, x = log n_s."""


class FreeNormalView(NamedTuple):
    """One view as `FreeNormalGeometry.shading` needs it: directions to the lights, and their intensities."""

    l: Vec3
    strength: Float[Array, "*views lamps emitters _"]


class FixedNormalView(NamedTuple):
    """One view as `FixedNormalGeometry.shading` needs it: u, the log of the highlight's base, and the intensities."""

    u: Float[Array, "*views lamps texels"]
    log_base: Float[Array, "*views emitters texels"]
    strength: Float[Array, "*views lamps emitters _"]


OneView = TypeVar("OneView", FreeNormalView, FixedNormalView)


class AbstractLightingGeometry(eqx.Module, Generic[OneView]):
    """How the light of each view reaches a block of texels, and what follows from whether their normals are fitted.

    The axis `lamps` is one of channels, of length 1 where all light is grey.
    """

    @property
    @abstractmethod
    def fits_normal(self) -> bool:
        """Whether the normals are unknowns."""

    @property
    @abstractmethod
    def views(self) -> OneView:
        """All views along a leading axis, for a scan."""

    @abstractmethod
    def shading(self, view: OneView, n: Vec3, tangents: Sequence[Vec3], x: Array) -> UnitShading:
        """Return u and v of one view, with derivatives along the tangents of n and by x = log n_s."""

    @abstractmethod
    def first_normals(self, n: Vec3, shown: Float[Array, "views texels"], counts: Bool[Array, "views texels"]) -> Vec3:
        """Return the normals where a fit starts.

        Args:
            n: The normals of the scene's surface.
            shown: The mean over the channels of each observation, without black, ambient light and emission.
            counts: Which observations count.
        """

    @abstractmethod
    def out_of_plane(
        self, setup: LightingSetup, weight: Float[Array, "views _ texels"], n: Vec3, *, ambient: bool
    ) -> Float[Array, " texels"]:
        """Return the sine by which the lights that reach each texel leave one plane; 1 for fixed normals."""


@final
class FreeNormalGeometry(AbstractLightingGeometry[FreeNormalView]):
    """Texels whose normals are fitted: directions and intensities of the light, exposure included."""

    l: Vec3
    """Components (views, emitters, texels or 1)."""
    strength: Float[Array, "views lamps emitters _"]
    v: Vec3
    """Components (1, texels or 1)."""
    lobe: AbstractPowerLobe

    @property
    def fits_normal(self) -> bool:
        return True

    @property
    def views(self) -> FreeNormalView:
        return FreeNormalView(self.l, self.strength)

    def shading(self, view: FreeNormalView, n: Vec3, tangents: Sequence[Vec3], x: Array) -> UnitShading:
        l, strength = view

        def at(n: Vec3) -> tuple[Array, ...]:
            n_l, log_base = _angles(n, l, self.v, self.lobe)
            exponent = jnp.exp(x)[None] * log_base
            power = jnp.exp(exponent)
            return tuple(jnp.sum(strength * row[None], 1) for row in (n_l, power, exponent * power))

        (u, v, v_by_x), derivative = jax.linearize(at, n)
        by_tilt = []
        for tangent in tangents:
            du, dv, _ = derivative(tangent)
            by_tilt.append((du, dv))
        return UnitShading(u, v, tuple(by_tilt), v_by_x)

    def first_normals(self, n: Vec3, shown: Array, counts: Array) -> Vec3:
        return photometric_stereo(self.l, self.strength, self.v, shown, counts)

    def out_of_plane(self, setup: LightingSetup, weight: Array, n: Vec3, *, ambient: bool) -> Array:
        return out_of_plane(scatter(self.l, self.strength, setup.exposure, weight, n, ambient=ambient))

    def with_normals(self, n: Vec3) -> FixedNormalGeometry:
        """Return the geometry for normals that stay as they are."""

        def of_view(view: FreeNormalView) -> tuple[Array, Array]:
            l, strength = view
            n_l, log_base = _angles(n, l, self.v, self.lobe)
            return jnp.sum(strength * n_l[None], 1), log_base

        u, log_base = jax.lax.map(of_view, self.views)
        return FixedNormalGeometry(u, log_base, self.strength)


@final
class FixedNormalGeometry(AbstractLightingGeometry[FixedNormalView]):
    """Texels whose normals are known: u is known too, and v up to n_s."""

    u: Float[Array, "views lamps texels"]
    log_base: Float[Array, "views emitters texels"]
    strength: Float[Array, "views lamps emitters _"]

    @property
    def fits_normal(self) -> bool:
        return False

    @property
    def views(self) -> FixedNormalView:
        return FixedNormalView(self.u, self.log_base, self.strength)

    def shading(self, view: FixedNormalView, n: Vec3, tangents: Sequence[Vec3], x: Array) -> UnitShading:
        u, log_base, strength = view
        exponent = jnp.exp(x)[None] * log_base
        power = jnp.exp(exponent)
        v, v_by_x = (jnp.sum(strength * row[None], 1) for row in (power, exponent * power))
        return UnitShading(u, v, (), v_by_x)

    def first_normals(self, n: Vec3, shown: Array, counts: Array) -> Vec3:
        return n

    def out_of_plane(self, setup: LightingSetup, weight: Array, n: Vec3, *, ambient: bool) -> Array:
        return jnp.ones(n.x.shape)


def _angles(n: Vec3, l: Vec3, v: Vec3, lobe: AbstractPowerLobe) -> tuple[Array, Array]:
    """Return (n.l)_+ and the logarithm of the highlight's base, DARK where there is no highlight."""
    n = jax.tree.map(lambda c: c[None], n)
    n_l, cosine = dot(n, l), lobe.cosine(n, l, v)
    lit = n_l > 0
    shines = lit & (cosine > 0)
    return jnp.where(lit, n_l, 0.0), jnp.where(shines, jnp.log(jnp.where(shines, cosine, 1.0)), DARK)


def lighting_geometry(setup: LightingSetup, p: Vec3 | None, v: Vec3) -> FreeNormalGeometry:
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
    return FreeNormalGeometry(l, strength, jax.tree.map(lambda c: jnp.reshape(c, (1, -1)), v), setup.lobe)


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
