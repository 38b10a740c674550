"""Estimates: the numbers of a block of texels, their standard errors and their status, from photographs."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int, UInt8

from ..core.backend import jit_quickly
from ..core.fields import Array
from .blocks import mirroring_normals, problem_of
from .descent import choose
from .lighting import LightingSetup
from .minima import TexelMinima, find_minimum, lower_and_other
from .prediction import FitOptions, KnownCoefficients, TexelBlock, TexelProblem
from .profile_errors import larger, profile_errors
from .standard_errors import NamedNumbers, Numbers, named_numbers
from .status import (
    DETERMINED,
    MIN_LIT_WITH_NORMAL,
    TypicalResidual,
    all_finite,
    highlight_is_determined,
    highlight_is_plausible,
    highlight_is_significant,
    rest_is_determined,
    status_of,
)


class Estimates(eqx.Module):
    """The numbers of a block of texels and their standard errors; an error is infinite where nothing is known."""

    values: dict[str, Float[Array, "_ texels"]]
    errors: dict[str, Float[Array, "_ texels"]]
    """Those of n_s are of n_s itself, not of its logarithm; that of the normal is in degrees."""
    residual: Float[Array, " texels"]
    """Root mean square of the residuals, in the photographs' units, or in those of their noise where it is known."""
    status: UInt8[Array, " texels"]
    converged: Bool[Array, " texels"]
    """Whether more steps would change nothing."""
    variance: Float[Array, " texels"]
    """Residual variance of a sample of weight 1; infinite without degrees of freedom."""
    level: Float[Array, " texels"]
    """Weighted mean square of what the views show."""


class Candidates(NamedTuple):
    """The minima of a block among which its texels choose."""

    full: TexelMinima
    """With all that is free."""
    other: TexelMinima | None
    """A second minimum with all that is free, where one was searched for."""
    plain: TexelMinima
    """Without a highlight; the same as `full` where k_s is not free."""
    significant: Bool[Array, " texels"]
    """Where a highlight explains more than chance would."""
    plausible: Bool[Array, " texels"]
    """Where the fit with a highlight converged to numbers that make sense."""

    @property
    def glossy(self) -> Bool[Array, " texels"]:
        """Where the texel is fitted with a highlight."""
        return self.significant & self.plausible


@partial(jax.jit, static_argnames="options")
def estimate(
    setup: LightingSetup,
    known: KnownCoefficients,
    block: TexelBlock,
    sigma: Float[Array, ""],
    typical: TypicalResidual,
    max_steps: Int[Array, ""],
    options: FitOptions,
) -> Estimates:
    """Return the estimates of a block, with a highlight where one explains enough, else without.

    Args:
        setup: The lights of the views.
        known: The coefficients that are not fitted.
        block: The texels.
        sigma: Scale of the residuals, for a robust loss.
        typical: The residuals of typical texels, by which a misfit is recognised.
        max_steps: Steps of a descent at most.
        options: What is free, and how residuals are weighted.
    """
    candidates = _candidates(problem_of(setup, known, block, sigma, options), max_steps)
    return _estimates(candidates, typical)


# of so few texels that the program, which takes seven times as long, is compiled in a third of the time
estimate_few = jit_quickly(estimate, static_argnames="options")


def _candidates(problem: TexelProblem, max_steps: Array) -> Candidates:
    """Find the minima with and without a highlight, and where the highlight is real."""
    full, other = find_minimum(problem, max_steps), None
    if problem.options.narrow:
        full, other = lower_and_other(full, find_minimum(problem, max_steps, mirroring_normals(problem)))
    if "k_s" not in problem.options.free:
        everywhere = jnp.ones(problem.samples.shape, bool)
        return Candidates(full, other, full, everywhere, everywhere)
    plain = find_minimum(problem.without_highlight(), max_steps)
    significant = highlight_is_significant(full, plain)
    return Candidates(full, other, plain, significant, highlight_is_plausible(full))


def _estimates(candidates: Candidates, typical: TypicalResidual) -> Estimates:
    """Choose between the fits with and without a highlight, and decide the status of each texel."""
    full, plain = candidates.full, candidates.plain
    numbers = named_numbers(full)
    highlight = candidates.glossy & highlight_is_determined(full, numbers)
    values, errors, determined = _chosen_numbers(candidates, numbers)
    of_full, of_plain = (
        (m.freedom, m.residual_variance, m.lit, m.clear, m.descent.converged, m.mean_square) for m in (full, plain)
    )
    freedom, variance, lit, clear, converged, mean_square = choose(candidates.glossy, of_full, of_plain)
    misfit = ~typical.accounts_for(variance, full.level, freedom)
    shadowed = (freedom <= 0) | (clear < MIN_LIT_WITH_NORMAL if full.problem.fit_normal else lit < 1)
    finite = all_finite(values)
    vague = candidates.significant & ~highlight
    status = status_of(highlight, vague | misfit | ~determined, shadowed, ~converged | ~finite)
    values, errors = _shown(values, errors, status == DETERMINED, finite, shadowed)
    residual, ended = jnp.where(finite, jnp.sqrt(mean_square), 0.0), plain.descent.converged & full.descent.converged
    return Estimates(values, errors, residual, status, ended, variance, full.level)


def _chosen_numbers(
    candidates: Candidates, numbers: NamedNumbers
) -> tuple[dict[str, Array], dict[str, Array], Bool[Array, " texels"]]:
    """Return the values and errors of each texel's minimum, and where all but the highlight is determined."""
    full, plain, values, errors = candidates.full, candidates.plain, numbers.values, numbers.errors
    if full.problem.fit_exponent or full.problem.fit_normal:
        errors = profile_errors(full, candidates.other, values, errors)
    determined = numbers.separable & rest_is_determined(full, values, errors)
    if plain is full:
        return values, errors, determined
    matte = named_numbers(plain)
    matte_errors = matte.errors
    if full.problem.fit_normal:  # a broad highlight that is too weak to be significant looks like k_d or a tilt
        off = _distance(values, matte.values)
        matte_errors = larger(matte_errors, {name: jnp.hypot(errors[name], off[name]) for name in off})
    matte_determined = matte.separable & rest_is_determined(plain, matte.values, matte_errors)
    none = {name: jnp.zeros_like(values[name]) for name in ("k_s", "n_s") if name in values}
    unknown = {name: jnp.full_like(zero, jnp.inf) for name, zero in none.items()}
    values = choose(candidates.glossy, values, matte.values | none)
    errors = choose(candidates.glossy, errors, matte_errors | unknown)
    return values, errors, choose(candidates.glossy, determined, matte_determined)


def _distance(values: Numbers, others: Numbers) -> dict[str, Array]:
    """Return how far the numbers are from others of the same name, normals in degrees."""
    off: dict[str, Array] = {name: jnp.abs(values[name] - value) for name, value in others.items()}
    if "normal" in off:
        off["normal"] = jnp.rad2deg(jnp.sqrt(jnp.sum(off["normal"] ** 2, 0)))[None]
    return off


def _shown(
    values: Numbers,
    errors: Numbers,
    determined: Bool[Array, " texels"],
    finite: Bool[Array, " texels"],
    shadowed: Bool[Array, " texels"],
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the values and errors for the maps: 0 and infinite where they mean nothing."""
    values, errors = dict(values), dict(errors)
    if "k_s" in values:  # an undetermined highlight is left out: relit, it would be a firefly
        for name in {"k_s", "n_s"} & values.keys():
            values[name] = jnp.where(determined[None], values[name], 0.0)
            errors[name] = jnp.where(determined[None], errors[name], jnp.inf)
    if "normal" in errors:  # beyond 90 degrees any direction is possible
        errors["normal"] = jnp.where(errors["normal"] > 90.0, jnp.inf, errors["normal"])
    unknown = (shadowed | ~finite)[None]
    return (
        {name: jnp.where(finite[None], value, 0.0) for name, value in values.items()},
        {name: jnp.where(unknown | jnp.isnan(error), jnp.inf, error) for name, error in errors.items()},
    )
