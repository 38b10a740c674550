"""Observations of a block: what the views show of its texels as reflectance, and which of it is believed.

Each photograph is divided by the light that reaches the texel, channel by channel, so that lamps of other colours
agree. The mean over the channels is divided by its own mean over the views, the level of the texel: what is left has
one scale for all texels. The darkest observations are left out of the search, for most of them lie in shadow.
"""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...model.diffuse_laws import LAMBERT, DiffuseLaw
from ...model.lobes import AbstractPowerLobe
from ...model.vectors import Vec3, dot, normalize
from ..blocks import TexelBlock, reflected
from ..geometry import LightingGeometry, lighting_geometry
from ..lighting import LightingSetup
from ..prediction import KnownCoefficients
from .reflection_shape import ReflectionShape, powers_of

DARKEST_SHARE = 0.15  # share of the observations that is left out, so long as MIN_BELIEVED are left
MIN_BELIEVED = 5
DARK_TRUST = 0.25  # weight of the darkest in a descent: they may show a steep slope as well as a shadow


class Lights(eqx.Module):
    """The lights of each view as they reach a block of texels, each view's together of strength 1."""

    l: Vec3
    """Components (views, emitters, texels or 1)."""
    strength: Float[Array, "views emitters _"]
    v: Vec3
    """Components (1, 1, texels or 1)."""
    lobe: AbstractPowerLobe

    def shading(self, shape: ReflectionShape, n: Vec3) -> tuple[Array, Array]:
        """Return D and S of each view, for normals of shape (1, texels)."""
        lit, D, cosine = self._cosines(n, shape.diffuse)
        S, _ = shape.at(cosine)
        return self._sum(jnp.maximum(D, 0.0)), self._sum(jnp.where(lit, S, 0.0))

    def shading_of_powers(self, n: Vec3) -> Float[Array, "powers views texels"]:
        """Return each power of the cosine that a highlight has."""
        lit, _, cosine = self._cosines(n)
        return jnp.stack([self._sum(jnp.where(lit, power, 0.0)) for power in powers_of(cosine)])

    def shading_of_power(self, n_s: Float[Array, " texels"], n: Vec3) -> tuple[Array, Array]:
        """Return D by Lambert's law, and a single power of the cosine, of each view."""
        lit, n_l, cosine = self._cosines(n)
        power = jnp.where(lit & (cosine > 0.0), jnp.maximum(cosine, 1e-6) ** n_s[None, None], 0.0)
        return self._sum(jnp.where(lit, n_l, 0.0)), self._sum(power)

    def slopes(self, shape: ReflectionShape, n: Vec3, tangents: tuple[Vec3, Vec3]) -> tuple[Array, ...]:
        """Return D and S of each view, and the derivatives of both along two tangents of the normals."""
        (n_l, D, cosine), along = jax.linearize(partial(self._of_normal, diffuse=shape.diffuse), n)
        lit, shows, cosine = n_l > 0.0, D > 0.0, jnp.clip(cosine, 0.0, 1.0)
        S, by_cosine = shape.at(cosine)
        found = [jnp.where(shows, D, 0.0), jnp.where(lit, S, 0.0)]
        for tangent in tangents:
            _, dD, dcosine = along(tangent)
            found += [jnp.where(shows, dD, 0.0), jnp.where(lit & (cosine > 0.0), by_cosine * dcosine, 0.0)]
        return tuple(map(self._sum, found))

    def facing_camera(self) -> Float[Array, "views _"]:
        """Return what each view's lights show of a surface that faces the camera."""
        return self._sum(jnp.maximum(dot(self.l, self.v), 0.0))

    def reach(self, n: Vec3) -> Bool[Array, "views texels"]:
        """Return in which views a light reaches the texels."""
        return self._sum(jnp.where(self._cosines(n)[0], 1.0, 0.0)) > 0.0

    def _of_normal(self, n: Vec3, diffuse: DiffuseLaw = LAMBERT) -> tuple[Array, Array, Array]:
        """Return n.l of each emitter, D, below 0 where none of its light comes out, and the cosine of the lobe."""
        n = jax.tree.map(lambda c: c[None, None], n)
        n_l = dot(n, self.l)
        D = diffuse.at(n_l, dot(n, self.v), dot(self.l, self.v))
        return n_l, D, self.lobe.cosine(n, self.l, self.v)

    def _cosines(self, n: Vec3, diffuse: DiffuseLaw = LAMBERT) -> tuple[Array, Array, Array]:
        n_l, D, cosine = self._of_normal(n, diffuse)
        return n_l > 0.0, D, jnp.clip(cosine, 0.0, 1.0)

    def _sum(self, each: Float[Array, "views emitters texels"]) -> Float[Array, "views texels"]:
        return each[:, 0] if each.shape[1] == 1 else jnp.sum(self.strength * each, 1)


class BlockObservations(eqx.Module):
    """What the views show of a block of texels, in single precision: what the model leaves out is far larger."""

    y: Float[Array, "views texels"]
    """Grey reflectance, of mean 1 over the views."""
    counts: Bool[Array, "views texels"]
    believed: Bool[Array, "views texels"]
    """Those that count without the darkest."""
    level: Float[Array, " texels"]
    lights: Lights

    @property
    def trust(self) -> Float[Array, "views texels"]:
        """Weight of each observation before its residual is known."""
        dark = jnp.where(self.counts, DARK_TRUST, 0.0)
        return jnp.where(self.believed, 1.0, dark).astype(self.y.dtype)

    def each_view(self) -> BlockObservations:
        """Return the same with one more axis of length 1 after that of the views, to be scanned."""
        lights = self.lights
        l, strength = jax.tree.map(lambda leaf: leaf[:, None], (lights.l, lights.strength))
        v, lobe = jax.tree.map(lambda c: jnp.broadcast_to(c, (len(self.y), *jnp.shape(c))), (lights.v, lights.lobe))
        every = Lights(l, strength, v, lobe)
        level = jnp.broadcast_to(self.level[None], self.y.shape)
        return BlockObservations(self.y[:, None], self.counts[:, None], self.believed[:, None], level, every)


def reflectances(
    setup: LightingSetup, known: KnownCoefficients, block: TexelBlock, geometry: LightingGeometry
) -> tuple[Float[Array, "views channels texels"], Float[Array, "views _ _"]]:
    """Return what the views show for each unit of light that arrives, and that light."""
    arriving = jnp.sum(geometry.strength, 2)
    return reflected(setup, known, block) / jnp.where(arriving > 0.0, arriving, 1.0), arriving


@jax.jit
def observe(
    setup: LightingSetup, known: KnownCoefficients, block: TexelBlock, dark_is_shadow: Bool[Array, ""]
) -> BlockObservations:
    """Return what the views show of a block."""
    geometry = lighting_geometry(setup, block.p, block.v)
    per_light, arriving = reflectances(setup, known, block, geometry)
    reached = block.observed.counts & (arriving > 0.0).all(1)
    grey = jnp.where(reached, per_light.mean(1), 0.0)
    number = jnp.sum(reached, 0, dtype=float)
    level = jnp.maximum(jnp.sum(grey, 0) / jnp.maximum(number, 1.0), 1e-12)
    strength = (geometry.strength / jnp.where(arriving > 0.0, arriving, 1.0)[:, :, None]).mean(1)
    v = jax.tree.map(lambda c: c[None], geometry.v)
    lights = Lights(geometry.l, strength, v, geometry.lobe)
    spare = jnp.maximum(number - MIN_BELIEVED, 0.0)
    dropped = jnp.clip(jnp.floor(DARKEST_SHARE * number + 1.0), 0.0, spare).astype(int)
    ordered = jnp.sort(jnp.where(reached, grey, jnp.inf).astype(jnp.float32), 0)
    least = jnp.take_along_axis(ordered, jnp.minimum(dropped, len(grey) - 1)[None], 0)
    single = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), lights)
    believed = reached & ((grey.astype(jnp.float32) >= least) | ~jnp.asarray(dark_is_shadow))
    return BlockObservations(
        (grey / level[None]).astype(jnp.float32), reached, believed, level.astype(jnp.float32), single
    )


@jax.jit
def turned_by(observed: BlockObservations, error: Float[Array, "views 3"]) -> BlockObservations:
    """Return the same under lights whose unit vectors are off by some error."""
    off = Vec3(*(error[:, i, None, None] for i in range(3)))
    return eqx.tree_at(lambda o: o.lights.l, observed, normalize(observed.lights.l + off))
