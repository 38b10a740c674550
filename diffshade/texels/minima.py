"""Minima: the minimum of every texel for one set of unknowns, and how well it fits the photographs."""

from __future__ import annotations

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import scipy.stats
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from ..core.robust_scale import RARE
from ..core.thresholds import MINOR
from ..model.vectors import Vec3
from .blocks import first_normals, problem_of
from .descent import Descent, best_on_grid, choose, descend
from .lighting import LightingSetup
from .normal_equations import NormalEquations, coefficient
from .prediction import (
    FitOptions,
    KnownCoefficients,
    TexelBlock,
    TexelProblem,
    ViewSlice,
    features,
    first_weights,
    sample_variance,
    view_slices,
)


class TexelMinima(eqx.Module):
    """The minimum of every texel for one set of unknowns."""

    problem: TexelProblem
    descent: Descent
    lit: Float[Array, " texels"]
    """Number of observations that count and that a light reaches."""
    clear: Float[Array, " texels"]
    """Number of those in which k_d shows it above the noise, which may tilt a normal towards a light."""
    freedom: Float[Array, " texels"]
    """Degrees of freedom: their samples less the unknowns."""
    variance: Float[Array, " texels"]
    """Variance of a sample of weight 1: the residual variance, or 1 where the noise is known."""
    residual_variance: Float[Array, " texels"]
    """Variance of a sample of weight 1 from the residuals; infinite without degrees of freedom."""

    @property
    def mean_square(self) -> Float[Array, " texels"]:
        """The mean square of the weighted residuals, with the weights of the loss."""
        return self.descent.found.squares / jnp.maximum(self.problem.samples, 1.0)

    @property
    def level(self) -> Float[Array, " texels"]:
        """The weighted mean square of what the views show."""
        problem = self.problem
        squares = jnp.sum(first_weights(problem) * problem.observed.target.astype(float) ** 2, (0, 1))
        return squares / jnp.maximum(problem.samples, 1.0)


def find_minimum(problem: TexelProblem, max_steps: Int[Array, ""], start: Vec3 | None = None) -> TexelMinima:
    """Find the minimum of every texel, from the normals `start` or, without them, from photometric stereo."""
    n, weight = first_normals(problem) if start is None else start, first_weights(problem)
    x = best_on_grid(problem, n, weight) if problem.fit_exponent else problem.block.log_n_s
    descent = descend(problem, n, x, weight, max_steps)
    found, channels, known_noise = descent.found, problem.observed.channels, problem.options.known_noise
    by_all = found.squares / jnp.maximum(problem.samples - problem.unknowns, 1.0)
    lit, clear = _lit(problem, found, jnp.ones_like(by_all) if known_noise else by_all)
    freedom = lit * channels - problem.unknowns
    freedom_kept = jnp.minimum(found.share, lit) * channels - problem.unknowns
    residual_variance = jnp.where(freedom > 0, found.squares / jnp.maximum(freedom_kept, 1.0), jnp.inf)
    variance = jnp.ones_like(residual_variance) if known_noise else residual_variance
    return TexelMinima(problem, descent, lit, clear, freedom, variance, residual_variance)


def _lit(problem: TexelProblem, found: NormalEquations, variance: Array) -> Float[Array, "2 texels"]:
    """Return how many observations that count a light reaches, and in how many of them k_d shows it above the noise."""
    k_d = coefficient(problem.known, found.k, "k_d")

    def add(total: Array, view: ViewSlice) -> tuple[Array, None]:
        u = problem.geometry.shading(view.geometry, found.n, (), found.x).u
        lit, shown = view.counts & (u > 0.0).any(0), (k_d * u).mean(0)
        noise = jnp.sqrt(variance * sample_variance(problem, view, shown[None])[0])
        return total + jnp.stack([lit, lit & (shown > RARE * noise)]).astype(float), None

    return jax.lax.scan(add, jnp.zeros((2, *found.x.shape)), view_slices(problem, None))[0]


def lower_and_other(one: TexelMinima, other: TexelMinima) -> tuple[TexelMinima, TexelMinima]:
    """Return the lower of two minima of each texel, and the other one.

    For a robust loss the first argument counts as the lower one, because a lower cost may mean only that the loss
    discards more observations.
    """
    robust = one.problem.losses != ("squares",)
    first = (one.descent.found.cost <= other.descent.found.cost) | robust
    return choose_minimum(first, one, other), choose_minimum(first, other, one)


def choose_minimum(condition: Bool[Array, " texels"], a: TexelMinima, b: TexelMinima) -> TexelMinima:
    """Choose texel by texel between two minima of one problem."""
    names = [field.name for field in dataclasses.fields(TexelMinima) if field.name != "problem"]
    return TexelMinima(a.problem, *(choose(condition, getattr(a, name), getattr(b, name)) for name in names))


@partial(jax.jit, static_argnames="options")
def residual_sizes(
    setup: LightingSetup,
    known: KnownCoefficients,
    block: TexelBlock,
    sigma: Float[Array, ""],
    max_steps: Int[Array, ""],
    options: FitOptions,
) -> Float[Array, "views texels"]:
    """Return the size of the residual of each observation, scaled so that its median estimates the noise.

    The size is the root mean square over the C channels. It is divided by the median of chi / sqrt(C) with C degrees of
    freedom, and by the root of the share of the samples that the unknowns leave.
    """
    minimum = find_minimum(problem_of(setup, known, block, sigma, options), max_steps)
    problem, found = minimum.problem, minimum.descent.found

    def of_view(view: ViewSlice) -> Array:
        m = features(problem, view, found.n, found.x, ()).predicted(found.k)
        return jnp.sqrt(jnp.mean((m - view.target.astype(found.x.dtype)) ** 2, 0))

    left = jnp.clip((problem.samples - problem.unknowns) / jnp.maximum(problem.samples, 1.0), MINOR, 1.0)
    channels = block.observed.channels
    scale = scipy.stats.chi.median(channels) * jnp.sqrt(left / channels)
    return jax.lax.map(of_view, view_slices(problem, None)) / scale[None]
