"""Blocks: where the fit of a block of texels starts, and how its lights are distributed."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..core.fields import Array
from ..model.vectors import Vec3, normalize
from .geometry import lighting_geometry
from .light_directions import scatter
from .lighting import LightingSetup
from .photometric_stereo import mean_light, photometric_stereo
from .prediction import FitOptions, KnownCoefficients, TexelBlock, TexelProblem


def problem_of(
    setup: LightingSetup,
    known: KnownCoefficients,
    block: TexelBlock,
    sigma: Float[Array, ""] | float,
    options: FitOptions,
) -> TexelProblem:
    """Return what is fitted in a block."""
    geometry = lighting_geometry(setup, block.p, block.v)
    if "normal" not in options.free:
        geometry = geometry.with_normals(block.n)
    return TexelProblem(setup, known, geometry, block, jnp.asarray(sigma), jnp.asarray(0), options)


def first_normals(problem: TexelProblem) -> Vec3:
    """Return the normals that a fit starts from: those of photometric stereo, or the surface's where they are known."""
    block, geometry = problem.block, problem.geometry
    if not problem.fit_normal:
        return block.n
    shown = reflected(problem.setup, problem.known, block).mean(1)
    return photometric_stereo(geometry.l, geometry.strength, geometry.v, shown, block.observed.counts)


def reflected(
    setup: LightingSetup, known: KnownCoefficients, block: TexelBlock
) -> Float[Array, "views channels texels"]:
    """Return the photographs without black, emission and ambient light, so far as these are known."""
    shown = (
        block.observed.target.astype(float)
        - (setup.black[:, None] + setup.exposure[:, None] * known.k_e[None])[..., None]
    )
    if known.k_a is not None:
        shown = shown - (setup.exposure[:, None] * (setup.ambient * known.k_a)[None])[..., None]
    return shown


def mirroring_normals(problem: TexelProblem) -> Vec3:
    """Return normals that mirror the light of each texel's brightest observation to the camera: (l + v) / |l + v|."""
    geometry, observed = problem.geometry, problem.observed
    shown = jnp.where(observed.counts, observed.target.astype(float).mean(1), -jnp.inf)
    view = jnp.argmax(shown, 0)

    def at_brightest(component: Array) -> Array:
        return jnp.take_along_axis(jnp.broadcast_to(component, shown.shape), view[None], 0)[0]

    l = normalize(jax.tree.map(at_brightest, mean_light(geometry.l, geometry.strength)))
    return normalize(l + jax.tree.map(lambda c: c[0] + jnp.zeros_like(l.x), geometry.v))


@partial(jax.jit, static_argnames="ambient")
def scatter_of_block(setup: LightingSetup, block: TexelBlock, ambient: bool) -> Float[Array, "3 3 texels"]:
    """Return the scatter matrix S of the lights of each texel, over all views in which it counts."""
    geometry = lighting_geometry(setup, block.p, block.v)
    weight = jnp.where(block.observed.counts[:, None], 1.0, 0.0)
    return jnp.asarray(scatter(geometry.l, geometry.strength, setup.exposure, weight, None, ambient=ambient))
