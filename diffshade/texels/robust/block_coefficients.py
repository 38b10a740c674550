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
from ..geometry import lighting_geometry
from ..lighting import LightingSetup
from ..prediction import KnownCoefficients, TexelBlock
from .block_fits import FEW_STEPS
from .candidates import weighted_coefficients
from .learning import ObjectModel
from .observations import BlockObservations, reflectances
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


@jax.jit
def coefficients_of(
    setup: LightingSetup,
    known: KnownCoefficients,
    block: TexelBlock,
    observed: BlockObservations,
    model: ObjectModel,
    n: Vec3,
    brightest: Float[Array, ""],
) -> tuple[BlockCoefficients, Float[Array, "views channels texels"]]:
    """Return k_d and k_s of each channel, and what the views show beyond them by Lambert's law, as a reflectance.

    Args:
        setup: The lights of the views.
        known: The coefficients that are not fitted.
        block: The texels.
        observed: What the views show of them.
        model: What the object's texels have in common.
        n: The normals, which are known.
        brightest: The largest k_s: no highlight is taken to be brighter than the brightest thing that was seen.
    """
    weighing = model.weighing(observed.level)
    state = begin(observed, model.shape, weighing, n)
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
    return BlockCoefficients(k_d, k_s, residual, doubted, observed.counts, observed.level), beyond


@jax.jit
def kept_of(
    observed: BlockObservations,
    model: ObjectModel,
    n: Vec3,
    of: BlockCoefficients,
    beyond: Float[Array, "views channels texels"],
    taken: Float[Array, "parts lights"],
    between: BetweenLights | None,
) -> Float[Array, "channels parts texels"]:
    """Return what is kept of what the views show beyond the model.

    Args:
        observed: What the views show.
        model: What the object's texels have in common.
        n: The normals.
        of: The coefficients.
        beyond: What is beyond the model.
        taken: What is kept of a texel, as products with it.
        between: How what is beyond is predicted under further lights; None where there are only those of the views.
    """
    if between is not None:
        beyond = between.beyond(beyond, shown_under(between.toward, observed, model, n, of))
    return jnp.einsum("pv,vcn->cpn", jnp.asarray(taken, jnp.float32), beyond)


@jax.jit
def shown_under(
    toward: Float[Array, "lights 3"], observed: BlockObservations, model: ObjectModel, n: Vec3, of: BlockCoefficients
) -> Float[Array, "lights channels texels"]:
    """Return the model's reflectance under distant lights."""
    l = Vec3(*jnp.asarray(toward, jnp.float32).T[..., None, None])
    D, S = eqx.tree_at(lambda lights: lights.l, observed.lights, l).shading(model.shape.of_lambert, n)
    return of.k_d[None] * D[:, None] + of.k_s[None] * S[:, None]
