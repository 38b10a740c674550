"""Block coefficients: k_d and k_s of texels whose normals are known, and what the views show beyond them."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...core.robust_scale import OUTLIER
from ...core.thresholds import TINY
from ...model.vectors import Vec3
from ..between_lights import BetweenLights
from ..blocks import TexelBlock
from ..geometry import lighting_geometry
from ..lighting import LightingSetup
from ..prediction import KnownCoefficients
from .block_fits import FEW_STEPS, lowest_state
from .candidates import weighted_coefficients
from .learning import ObjectModel
from .observations import BlockObservations, Lights, observe, reflectances
from .reflection_shape import ReflectionShape
from .robust_descent import around, begin


class BlockCoefficients(NamedTuple):
    """The coefficients of a block whose normals are known, and how its observations agree with them."""

    k_d: Float[Array, "channels texels"]
    k_s: Float[Array, "channels texels"]
    residual: Float[Array, " texels"]
    """Root mean square, in the photographs' units, or in those of their noise where that is known."""
    doubted: Bool[Array, "views texels"]
    """Observations that are far from the model."""
    counts: Bool[Array, "views texels"]
    level: Float[Array, " texels"]
    """Mean reflectance of all observations."""
    kept: Float[Array, "channels parts texels"] | None
    """What is kept of what the views show beyond the model, as a reflectance."""


def coefficients_of(
    setup: LightingSetup,
    known: KnownCoefficients,
    block: TexelBlock,
    model: ObjectModel,
    n: Float[Array, "3 texels"],
    brightest: Float[Array, ""],
    taken: Float[Array, "parts lights"] | None,
    between: BetweenLights | None = None,
) -> BlockCoefficients:
    """Return k_d and k_s of each channel for normals that are known, by reweighted squares.

    Args:
        setup: The lights of the views.
        known: The coefficients that are not fitted.
        block: The texels.
        model: What the object's texels have in common.
        n: The normals.
        brightest: The largest k_s: no highlight is taken to be brighter than the brightest thing that was seen.
        taken: What is kept of the residuals of a texel, as products with them.
        between: How residuals under further lights are predicted; None where there are only those of the views.
    """
    observed = observe(setup, known, block, model.assumed.dark_is_shadow)
    found, beyond = _coefficients(setup, known, block, observed, model, n, brightest)
    if taken is None:
        return found
    return found._replace(kept=_kept(observed, model, n, found, beyond, taken, between))


@jax.jit
def _coefficients(
    setup: LightingSetup,
    known: KnownCoefficients,
    block: TexelBlock,
    observed: BlockObservations,
    model: ObjectModel,
    n: Float[Array, "3 texels"],
    brightest: Float[Array, ""],
) -> tuple[BlockCoefficients, Float[Array, "views channels texels"]]:
    """Return the coefficients, and what the views show beyond them by Lambert's law, as a reflectance."""
    weighing = model.weighing(observed.level)
    state = begin(observed, model.shape, weighing, Vec3(*n))
    here = around(observed, model.shape, weighing, state)
    ridge = weighing.ridge * weighing.scale**2
    _, _, D, S = here.J
    for _ in range(FEW_STEPS):
        k_d, k_s = weighted_coefficients(here.weight, D, S, observed.y, ridge)
        state = eqx.tree_at(lambda s: (s.k_d, s.k_s), state, (k_d, k_s))
        here = around(observed, model.shape, weighing, state)
    shown, arriving = reflectances(setup, known, block, lighting_geometry(setup, block.p, block.v))
    shown, bright = shown.astype(jnp.float32), (here.weight * D)[:, None]
    _, k_s = jax.vmap(lambda y: weighted_coefficients(here.weight, D, S, y, ridge), 1)(shown)
    k_s = jnp.where(model.assumed.glossy, jnp.minimum(k_s, jnp.asarray(brightest, k_s.dtype)), 0.0)
    matte = jnp.sum(bright * (shown - k_s[None] * S[:, None]), 0)
    k_d = jnp.maximum(matte, 0.0) / (jnp.sum(bright * D[:, None], 0) + TINY)
    lambert, _ = observed.lights.shading(model.shape.of_lambert, state.n)
    beyond = shown - k_d[None] * lambert[:, None] - k_s[None] * S[:, None]
    at_least = jnp.maximum(beyond, 0.0)  # of what was clipped; nothing was shown outside a mask
    beyond = jnp.where(observed.counts[:, None], beyond, at_least)
    samples = jnp.maximum(jnp.sum(observed.counts, 0, dtype=float) * shown.shape[1], 1.0)
    squared = jnp.where(observed.counts[:, None], beyond.astype(float) * arriving, 0.0) ** 2
    if setup.noise is not None:
        squared /= jax.vmap(lambda noise, shown: noise.variance(shown))(
            setup.noise, block.observed.target.astype(float)
        )
    residual = jnp.sqrt(jnp.sum(squared, (0, 1)) / samples)
    doubted = observed.counts & (jnp.abs(here.residual) > OUTLIER * weighing.scale[None] / model.softness)
    return BlockCoefficients(k_d, k_s, residual, doubted, observed.counts, observed.level, None), beyond


@jax.jit
def _kept(
    observed: BlockObservations,
    model: ObjectModel,
    n: Float[Array, "3 texels"],
    of: BlockCoefficients,
    beyond: Float[Array, "views channels texels"],
    taken: Float[Array, "parts lights"],
    between: BetweenLights | None,
) -> Float[Array, "channels parts texels"]:
    """Return what is kept of what the views show beyond the model."""
    if between is not None:
        beyond = between.beyond(beyond, _under(between.toward, observed.lights, model.shape, Vec3(*n), of.k_d, of.k_s))
    return jnp.einsum("pv,vcn->cpn", jnp.asarray(taken, jnp.float32), beyond)


class Shown(NamedTuple):
    """What the model has under some lights, and what the views show beyond it, as reflectances."""

    model: Float[Array, "lights channels texels"]
    beyond: Float[Array, "views channels texels"]


def shown_by(
    setup: LightingSetup,
    known: KnownCoefficients,
    block: TexelBlock,
    model: ObjectModel,
    brightest: Float[Array, ""],
    toward: Float[Array, "lights 3"],
) -> Shown:
    """Return what the views show beyond the model at the minimum of each texel, and the model under distant lights."""
    observed = observe(setup, known, block, model.assumed.dark_is_shadow)
    n = lowest_state(observed, model).n
    k, beyond = _coefficients(setup, known, block, observed, model, jnp.stack([n.x, n.y, n.z]), brightest)
    return Shown(_under(toward, observed.lights, model.shape, n, k.k_d, k.k_s), beyond)


@jax.jit
def _under(
    toward: Float[Array, "lights 3"], lights: Lights, shape: ReflectionShape, n: Vec3, k_d: Array, k_s: Array
) -> Float[Array, "lights channels texels"]:
    """Return the model's reflectance under distant lights."""
    l = Vec3(*jnp.asarray(toward, jnp.float32).T[..., None, None])
    D, S = eqx.tree_at(lambda of: of.l, lights, l).shading(shape.of_lambert, n)
    return k_d[None] * D[:, None] + k_s[None] * S[:, None]
