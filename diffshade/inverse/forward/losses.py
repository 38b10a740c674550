"""Losses: the cost of a residual by squares or a robust loss, and of a sample that the sensor clipped."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Float, Int8

from ...core.fields import Array

Numbers = Float[Array, "..."]
Sides = Int8[Array, "..."]


class Rho(NamedTuple):
    """A loss rho of s = (r/sigma)^2, and its derivative rho'(s), the weight of a residual."""

    value: Callable[[Numbers], Numbers]
    slope: Callable[[Numbers], Numbers]

    def influence(self, r: Numbers) -> tuple[Numbers, Numbers]:
        """Return psi(r) = r rho'(r^2) of residuals in units of the scale, and its derivative."""
        return jax.jvp(lambda r: r * self.slope(r**2), (r,), (jnp.ones_like(r),))


# Tuned to an efficiency of 95 % on Gaussian noise (Holland and Welsch 1977).
HUBER, CAUCHY, GEMAN_MCCLURE = 1.345, 2.385, 3.787

LOSSES = {
    "squares": Rho(lambda s: s, jnp.ones_like),
    # Huber (1964): quadratic, then linear
    "huber": Rho(
        lambda s: jnp.where(s <= HUBER**2, s, 2.0 * HUBER * _root(s, HUBER) - HUBER**2),
        lambda s: jnp.where(s <= HUBER**2, 1.0, HUBER / _root(s, HUBER)),
    ),
    "cauchy": Rho(
        lambda s: CAUCHY**2 * jnp.log1p(s / CAUCHY**2),
        lambda s: 1.0 / (1.0 + s / CAUCHY**2),
    ),
    # Geman and McClure (1987): an outlier has no say at all
    "geman-mcclure": Rho(
        lambda s: s / (1.0 + s / GEMAN_MCCLURE**2),
        lambda s: 1.0 / (1.0 + s / GEMAN_MCCLURE**2) ** 2,
    ),
}
NOT_CONVEX = ("cauchy", "geman-mcclure")


def _root(s: Numbers, least: float) -> Numbers:
    return jnp.sqrt(jnp.maximum(s, least**2))


def _mills(z: Numbers) -> tuple[Numbers, Numbers]:
    """Return M = phi(z)/Phi(z) and M (M + z), which is -M', by the asymptotic series where they would cancel."""
    far = z < -20.0
    near = jnp.where(far, 0.0, z)
    ratio = jnp.exp(norm.logpdf(near) - norm.logcdf(near))
    z = jnp.where(far, z, -20.0)
    t = 1.0 / z**2
    series = 1.0 - t * (1.0 - t * (3.0 - t * (15.0 - 105.0 * t)))  # Phi(z) = -phi(z)/z * series
    excess = 1.0 - t * (3.0 - t * (15.0 - 105.0 * t))  # (1 - series) z^2
    return jnp.where(far, -z / series, ratio), jnp.where(far, excess / series**2, ratio * (ratio + near))


class Terms(NamedTuple):
    """What one sample adds, as a function of its prediction m: the cost, its slope and its curvature."""

    cost: Numbers
    slope: Numbers
    curvature: Numbers


class Likelihood(eqx.Module):
    """The cost of a prediction m for an observation y of weight w: sigma^2 rho(w (m - y)^2 / sigma^2) / 2."""

    sigma: Numbers
    """Scale of the weighted residuals; 1 where the noise is known."""
    loss: str = eqx.field(static=True, default="squares")
    tobit: bool = eqx.field(static=True, default=False)

    def terms(self, m: Numbers, y: Numbers, weight: Numbers, clipped: Sides | None) -> Terms:
        """Return cost, slope and curvature in m of samples y of weight w.

        The curvature is the weight of iterated reweighting, w rho'(s), never negative (Holland and Welsch 1977). A
        sample clipped at the top (`clipped` 1) says only that m >= y, at the bottom (-1) that m <= y: its residual is
        one-sided (hinge); or, with `tobit`, it costs -sigma^2 log Phi(+-z) with z = sqrt(w)(m - y)/sigma, the
        likelihood of a Gaussian sample beyond y (Tobin 1958).
        """
        root = jnp.sqrt(weight)
        r = root * (m - y)
        if clipped is not None:
            counts = (clipped == 0) | ((clipped > 0) & (r < 0)) | ((clipped < 0) & (r > 0))
            r = jnp.where(counts, r, 0.0)
            weight = jnp.where(counts, weight, 0.0)
        rho = LOSSES[self.loss]
        s = (r / self.sigma) ** 2
        bend = rho.slope(s)
        terms = Terms(0.5 * self.sigma**2 * rho.value(s), root * r * bend, weight * bend)
        if clipped is None or not self.tobit:
            return terms
        side = jnp.where(clipped < 0, -1.0, 1.0)
        z = side * root * (m - y) / self.sigma
        mills, bend = _mills(z)
        beyond = Terms(-(self.sigma**2) * norm.logcdf(z), -side * self.sigma * root * mills, root**2 * bend)
        seen = root > 0
        return Terms(*(jnp.where((clipped != 0) & seen, b, t) for b, t in zip(beyond, terms, strict=True)))

    def spread(self, m: Numbers, y: Numbers, weight: Numbers, clipped: Sides | None) -> Numbers:
        """Return sums over the samples that were measured: their number, r^2, psi^2, psi' and rho' (see `variance`)."""
        measured = weight > 0 if clipped is None else (weight > 0) & (clipped == 0)
        r = jnp.where(measured, jnp.sqrt(weight) * (m - y), 0.0)
        rho = LOSSES[self.loss]
        psi, slope = rho.influence(r / self.sigma)
        each = jnp.ones_like(r), r**2, (self.sigma * psi) ** 2, slope, rho.slope((r / self.sigma) ** 2)
        return jnp.stack([jnp.sum(jnp.where(measured, x, 0.0)) for x in each])


def variance(spread: Numbers, unknowns: int) -> float:
    """Return the factor of H^-1 in the covariance of an M-estimate (Huber 1981, section 7.6), from sums of `spread`.

    sigma^2 = sum psi^2 / (N - p) / (mean psi')^2 for the covariance sigma^2 (J^T J)^-1; H is J^T J weighted by rho'.
    For squares it is the residual variance.
    """
    count, _, psi2, slope, weight = (float(x) for x in spread)
    mean_slope = max(slope / count, 1e-3)
    return psi2 / max(count - unknowns, 1.0) / mean_slope**2 * (weight / count)
