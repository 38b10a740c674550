"""Status: which texels are determined, which show no highlight, and which are not determined, shadowed or failed.

With k_s free, "determined" includes the highlight: a matte texel, however well known, is "no highlight seen".
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt8

from ..core.fields import Array
from ..core.robust_scale import OUTLIER
from ..core.thresholds import CLEARLY, SLIGHT
from ..inverse.statistics.identifiability import VAGUE_LOG
from .descent import HIGH, LOW
from .minima import TexelMinima
from .standard_errors import NamedNumbers, Numbers

STATUS = ("outside", "determined", "no highlight seen", "not determined", "shadowed", "failed")
OUTSIDE, DETERMINED, NO_HIGHLIGHT, UNDETERMINED, SHADOWED, FAILED = range(len(STATUS))
HIGHLIGHT_F = 8.0  # F statistic from which a highlight is significant: by how much it must lower the cost
MAX_RELATIVE_K_S = 1.0 / SLIGHT  # k_s, relative to the brightest sample, above which the fit has diverged
MAX_NORMAL_ERROR = 0.2  # largest standard error of k_d n, relative to its length, of a determined normal
LARGEST = float(jnp.finfo(jnp.float32).max)  # a larger value does not fit into a map
ROUNDING = 1e-4  # residuals below this share of the signal are rounding, not misfit
MIN_LIT_WITH_NORMAL = 3  # observations that a light must reach where the normal is free


class TypicalResidual(eqx.Module):
    """The residual variance of typical texels, absolute and relative to their level; noise may behave like either."""

    variance: Float[Array, ""]
    relative_variance: Float[Array, ""]

    def accounts_for(self, variance: Array, level: Array, freedom: Array) -> Bool[Array, " texels"]:
        """Return where a residual variance is typical up to chance (chi squared; Wilson and Hilferty 1931)."""
        spread = 2.0 / (9.0 * jnp.maximum(freedom, 1.0))
        chance = (1.0 - spread + OUTLIER * jnp.sqrt(spread)) ** 3
        typical = jnp.maximum(jnp.maximum(self.variance, self.relative_variance * level), ROUNDING**2 * level)
        return variance <= CLEARLY**2 * chance * typical


def highlight_is_significant(full: TexelMinima, plain: TexelMinima) -> Bool[Array, " texels"]:
    """Return where the fit with a highlight is better than the one without by more than chance, by an F test."""
    numbers = full.problem.unknowns - plain.problem.unknowns
    explained = 2.0 * (plain.descent.found.cost - full.descent.found.cost) / numbers
    return (explained > HIGHLIGHT_F * jnp.where(full.variance > 0.0, full.variance, 0.0)) & (full.freedom > 0.0)


def highlight_is_plausible(full: TexelMinima) -> Bool[Array, " texels"]:
    """Return where the fit with a highlight converged to a k_s that is not out of all proportion."""
    found = full.descent.found
    k_s = found.k[full.problem.known.fitted.index("k_s")]
    in_proportion = (k_s < MAX_RELATIVE_K_S * full.problem.block.brightest[None]).all(0)
    return in_proportion & full.descent.converged & (found.cost < LARGEST)


def highlight_is_determined(full: TexelMinima, numbers: NamedNumbers) -> Bool[Array, " texels"]:
    """Return where n_s and k_s, those that are fitted, have small errors by the curvature at the minimum."""
    values, errors = numbers.values, numbers.errors
    determined = jnp.ones(full.lit.shape, bool)
    if "n_s" in values:
        x = full.descent.found.x
        determined = determined & (errors["n_s"][0] <= VAGUE_LOG * values["n_s"][0]) & (x > LOW) & (x < HIGH)
    if "k_s" in values:  # by the channel with the largest k_s
        k_s, error = values["k_s"], errors["k_s"]
        most = k_s == jnp.max(k_s, 0)[None]
        determined = determined & jnp.where(most, error <= k_s, True).all(0)
    return determined


def rest_is_determined(minimum: TexelMinima, values: Numbers, errors: Numbers) -> Bool[Array, " texels"]:
    """Return where all numbers but the highlight's have finite errors, and the normal a small one."""
    determined = jnp.ones(minimum.lit.shape, bool)
    for name, error in errors.items():
        determined = determined if name in ("k_s", "n_s") else determined & jnp.isfinite(error).all(0)
    if not minimum.problem.fit_normal:
        return determined
    square = jnp.deg2rad(errors["normal"][0]) ** 2
    if "k_d" in values:  # of the best known channel: the channels share the error of the vector's length
        relative = errors["k_d"] / jnp.where(values["k_d"] > 0.0, values["k_d"], 1e-300)
        square = square + jnp.min(relative, 0) ** 2
    return determined & (square < MAX_NORMAL_ERROR**2)


def all_finite(values: Numbers) -> Bool[Array, " texels"]:
    """Return where every number fits into a map."""
    finite = jnp.ones(next(iter(values.values())).shape[1:], bool)
    for value in values.values():
        finite = finite & (jnp.abs(value) < LARGEST).all(0)
    return finite


def status_of(
    highlight: Bool[Array, "*texels"],
    undetermined: Bool[Array, "*texels"],
    shadowed: Bool[Array, "*texels"],
    failed: Bool[Array, "*texels"] | bool = False,
) -> UInt8[Array, "*texels"]:
    """Return the status of each texel, by itself or with a highlight that all share.

    Args:
        highlight: Where a highlight is determined.
        undetermined: Where something else is not.
        shadowed: Where too few lights reach the texel.
        failed: Where the fit did not end.
    """
    xp = jnp if isinstance(shadowed, jax.Array) else np  # JAX would compile anew for each tile's number of texels
    status = xp.where(highlight, DETERMINED, NO_HIGHLIGHT)
    status = xp.where(undetermined, UNDETERMINED, status)
    status = xp.where(failed, FAILED, status)
    return xp.where(shadowed, SHADOWED, status).astype(np.uint8)
