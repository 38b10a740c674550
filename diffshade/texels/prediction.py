"""Prediction: a block of texels, what is fitted in it, and what one view shows of it, as a sum of features."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from ..inverse.data.views import Noise
from ..model.vectors import Vec3
from .geometry import LightingGeometry, ViewGeometry
from .lighting import LightingSetup

COEFFICIENTS = ("k_a", "k_d", "k_s")


class KnownCoefficients(eqx.Module):
    """The coefficients that are not fitted, one number a channel; None where one is fitted."""

    k_a: Float[Array, " channels"] | None
    k_d: Float[Array, " channels"] | None
    k_s: Float[Array, " channels"] | None
    k_e: Float[Array, " channels"]

    @property
    def fitted(self) -> tuple[str, ...]:
        """The names of the coefficients that are fitted."""
        return tuple(name for name in COEFFICIENTS if getattr(self, name) is None)


class Observations(eqx.Module):
    """What the views show of a block of texels."""

    target: Float[Array, "views channels texels"]
    counts: Bool[Array, "views texels"]
    """False where an observation is excluded."""

    @property
    def number(self) -> Float[Array, " texels"]:
        """How many observations of each texel count."""
        return jnp.sum(self.counts, 0, dtype=float)

    @property
    def channels(self) -> int:
        """How many channels a photograph has."""
        return self.target.shape[1]


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


class TexelProblem(eqx.Module):
    """What is fitted at every texel of a block, and to what."""

    setup: LightingSetup
    known: KnownCoefficients
    geometry: LightingGeometry
    block: TexelBlock
    sigma: Float[Array, ""]
    """Scale of the weighted residuals, for a robust loss."""
    stage: Int[Array, ""]
    """Index of the loss in use."""
    options: FitOptions = eqx.field(static=True)

    def without_highlight(self) -> TexelProblem:
        """Return the same with k_s = 0, known."""
        known = dataclasses.replace(self.known, k_s=jnp.zeros_like(self.known.k_e))
        return dataclasses.replace(self, known=known, options=self.options.without("k_s", "n_s"))

    @property
    def observed(self) -> Observations:
        """What the views show."""
        return self.block.observed

    @property
    def losses(self) -> tuple[str, ...]:
        """The losses to minimise one after another: squares alone, or a convex loss and then the one asked for."""
        loss = self.options.loss
        return ("squares",) if loss == "squares" else tuple(dict.fromkeys(["huber", loss]))

    @property
    def fit_normal(self) -> bool:
        """Whether the normals are fitted."""
        return "normal" in self.options.free

    @property
    def fit_exponent(self) -> bool:
        """Whether n_s is fitted."""
        return "n_s" in self.options.free

    @property
    def reweights(self) -> bool:
        """Whether the weights depend on the prediction."""
        return self.options.loss != "squares" or not self.options.homoscedastic

    @property
    def samples(self) -> Float[Array, " texels"]:
        """How many samples of each texel count."""
        return self.observed.number * self.observed.channels

    @property
    def unknowns(self) -> int:
        """How many unknowns a texel has."""
        return self.observed.channels * len(self.known.fitted) + 2 * self.fit_normal + self.fit_exponent


class ViewSlice(NamedTuple):
    """One view of a block of texels in a scan over the views."""

    geometry: ViewGeometry
    exposure: Float[Array, ""]
    black: Float[Array, ""]
    noise: Noise | None
    target: Float[Array, "channels texels"]
    counts: Bool[Array, " texels"]
    weight: Float[Array, "_ texels"] | None


def view_slices(problem: TexelProblem, weight: Float[Array, "views _ texels"] | None) -> ViewSlice:
    """Return all views along a leading axis, for a scan."""
    setup, observed = problem.setup, problem.observed
    views = problem.geometry.views
    return ViewSlice(views, setup.exposure, setup.black, setup.noise, observed.target, observed.counts, weight)


class Features(NamedTuple):
    """The fields of one view; its prediction and the derivatives of its prediction are weighted sums of them."""

    columns: list[Array]
    """a, u and v, those whose coefficients are fitted."""
    derivatives: list[Array]
    """du/da, du/db, dv/da, dv/db by the tilts (a, b) of the normal, and dv/dx by x = log n_s: those that are fitted."""
    base: Array
    """The part of the prediction that is known."""

    def predicted(self, k: Sequence[Array]) -> Array:
        """Return the prediction for these coefficients."""
        return sum((c * column for c, column in zip(k, self.columns, strict=True)), self.base)


def features(problem: TexelProblem, view: ViewSlice, n: Vec3, x: Array, tangents: Sequence[Vec3]) -> Features:
    """Return the features of one view, with derivatives along the tangents of n."""
    known = problem.known
    shading = problem.geometry.shading(view.geometry, n, tangents, x)
    columns = {"k_a": (view.exposure * problem.setup.ambient)[:, None], "k_d": shading.u, "k_s": shading.v}
    base = (view.exposure * known.k_e + view.black)[:, None]
    for name, column in columns.items():
        k = getattr(known, name)
        if k is not None:
            base = base + k[:, None] * column
    derivatives = [du for du, _ in shading.by_tilt] + [dv for _, dv in shading.by_tilt]
    if problem.fit_exponent:
        derivatives.append(shading.v_by_x)
    return Features([columns[name] for name in known.fitted], derivatives, base)


def sample_variance(problem: TexelProblem, view: ViewSlice, m: Array) -> Array:
    """Return the variance of one view's samples at the level m, or 1 where the noise is not known."""
    if view.noise is None:
        return jnp.ones((1, 1))
    return view.noise.variance(jnp.zeros((1, 1)) if problem.options.homoscedastic else m)


def first_weights(problem: TexelProblem) -> Float[Array, "views _ texels"]:
    """Return the weights before there is a prediction: 1/variance at the level of the photograph."""

    def of_view(view: ViewSlice) -> Array:
        weight = 1.0 / sample_variance(problem, view, view.target.astype(float))
        return jnp.where(view.counts[None], weight, 0.0)

    return jax.lax.map(of_view, view_slices(problem, None))
