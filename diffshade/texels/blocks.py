"""Blocks: one block of texels, what is fitted in it, and where the fit starts."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..core.fields import Array
from ..model.vectors import Vec3, normalize
from .geometry import AbstractLightingGeometry, FreeNormalGeometry, lighting_geometry
from .light_directions import scatter
from .lighting import LightingSetup
from .photometric_stereo import mean_light
from .prediction import KnownCoefficients, Observations, TexelProblem, first_weights


class FitOptions(NamedTuple):
    """What is free in a fit of texels, and how residuals are weighted."""

    free: tuple[str, ...]
    loss: str
    homoscedastic: bool
    """Whether the noise is the same at every level."""
    known_noise: bool
    shared: bool = False
    """Whether n_s belongs to a region and has been found before."""
    narrow: bool = False
    """Whether the lights are so close together that a highlight and a tilted normal look alike."""

    def without(self, *names: str) -> FitOptions:
        """Return the same with these names not free."""
        return self._replace(free=tuple(name for name in self.free if name not in names))


class TexelBlock(eqx.Module):
    """A block of texels: where they are, and what the views show of them."""

    n: Vec3
    p: Vec3 | None
    v: Vec3
    observed: Observations
    log_n_s: Float[Array, " texels"]
    """The value of log n_s where it is not fitted: the scene's, or a region's."""
    log_n_s_error: Float[Array, " texels"]
    """Its standard error: 0 for the scene's value."""

    @property
    def brightest(self) -> Float[Array, " texels"]:
        """The brightest sample of each texel."""
        target = self.observed.target.astype(float)
        return jnp.max(jnp.where(self.observed.counts[:, None], target, 0.0), (0, 1))


def geometry_of(setup: LightingSetup, block: TexelBlock, options: FitOptions) -> AbstractLightingGeometry[Any]:
    """Return the lighting geometry of a block, for free or for fixed normals."""
    geometry = lighting_geometry(setup, block.p, block.v)
    return geometry if "normal" in options.free else geometry.with_normals(block.n)


def begin(
    setup: LightingSetup,
    known: KnownCoefficients,
    geometry: AbstractLightingGeometry[Any],
    block: TexelBlock,
    options: FitOptions,
    sigma: Float[Array, ""],
) -> tuple[TexelProblem, Vec3, Float[Array, "views _ texels"]]:
    """Return what is fitted in a block, and the normals and weights that the fit starts from."""
    problem = TexelProblem(
        setup,
        known,
        geometry,
        block.observed,
        jnp.asarray(sigma),
        jnp.asarray(0),
        _losses(options.loss),
        homoscedastic=options.homoscedastic,
        fit_exponent="n_s" in options.free,
    )
    n = block.n
    if geometry.fits_normal:
        n = geometry.first_normals(n, reflected(setup, known, block).mean(1), block.observed.counts)
    return problem, n, first_weights(problem)


def _losses(loss: str) -> tuple[str, ...]:
    """Return the losses to minimise one after another: squares alone, or a convex loss and then the one asked for."""
    return ("squares",) if loss == "squares" else tuple(dict.fromkeys(["huber", loss]))


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


def mirroring_normals(geometry: FreeNormalGeometry, block: TexelBlock) -> Vec3:
    """Return normals that mirror the light of each texel's brightest observation to the camera: (l + v) / |l + v|."""
    shown = jnp.where(block.observed.counts, block.observed.target.astype(float).mean(1), -jnp.inf)
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
