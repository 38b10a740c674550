"""Image fits: the minimum of a fit as an implicit function of its images, and which unknowns these determine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..core import fields
from .forward.gram import Point
from .forward.interface import AbstractForwardModel
from .pixels.blocks import Block
from .solve.solvers import BoxConstraints, PriorResiduals, minimum_in_jax, point_of
from .solve.start_search import best_linear

TOGETHER = 16  # fits of a batch that take their steps together: their pixels stay in a core's cache

Samples = Float[Array, "blocks channels pixels"]


class ImageFit(eqx.Module):
    """A fit whose images are given later: the model and the samples in blocks, and where the search begins."""

    model: AbstractForwardModel
    """Of which all samples of a view weigh alike."""
    priors: PriorResiduals
    box: BoxConstraints
    chunk: Block
    index: Int[fields.Array, "blocks channels pixels"]
    """Where each sample is in the images, one after another; -1 for padding."""
    start: Float[fields.Array, " p"]
    groups: tuple[tuple[Int[fields.Array, " m"], Float[fields.Array, "n m"]], ...]
    """For each group of unknowns that a search tries together: which they are, and the values that it tries."""

    def targets(self, samples: Float[Array, " samples"]) -> Samples:
        """Return the samples of all images, one after another, in blocks; 0 for padding."""
        return jnp.where(self.index >= 0, samples[self.index], 0.0)

    def residuals(self, theta: Float[Array, " p"], targets: Samples) -> Samples:
        """Return prediction - image over the standard deviation of the noise."""
        predicted = jax.lax.map(lambda block: jnp.stack(self.model.predict(theta, block)), self.chunk)
        return self._whitened(predicted - targets)

    def cost(self, theta: Float[Array, " p"], targets: Samples) -> Float[Array, ""]:
        """Return half the sum of squares of the residuals."""
        return 0.5 * jnp.sum(self.residuals(theta, targets) ** 2) + self.priors.gram(theta).cost

    def minimum(self, targets: Samples) -> tuple[Array, tuple[Array, Array]]:
        """Return the minimum, 1 where the solver converged, and J^T J there; with the derivatives of an implicit root.

        The root is that of the gradient, by the unknowns that are not at a bound.
        """

        def gradient(theta: Array) -> Array:
            inside = (theta > self.box.lower) & (theta < self.box.upper)
            cost = jax.grad(lambda q: self.cost(jnp.where(inside, q, jax.lax.stop_gradient(theta)), targets))
            return cost(theta)

        def solved(*_: Any) -> tuple[Array, tuple[Array, Array]]:
            found, converged = _searched(self, targets)
            as_number = jnp.where(converged, 1.0, 0.0)  # whose derivative custom_root makes a zero of its own kind
            return jnp.asarray(found.theta), (as_number, found.total.hessian.as_matrix())

        return jax.lax.custom_root(gradient, jnp.asarray(self.start), solved, _inverse_of, has_aux=True)

    def search(self, targets: Samples) -> tuple[Point, Array]:
        """Return the minimum and whether the solver converged, from the best of the points that are tried."""
        chunk = eqx.tree_at(lambda c: c.observed.target, self.chunk, targets)
        theta, projects = jnp.asarray(self.start), self.model.projects

        def evaluate(theta: Array) -> Point:
            return point_of(theta, self.model, self.priors, self.box, self.model.summary(theta, chunk))

        def judged(theta: Array) -> tuple[Any, Any]:
            point = evaluate(theta)
            return (point.theta, point.total.cost) if projects else best_linear(point, self.box)

        for members, values in self.groups * min(len(self.groups), 2):
            tried = jax.vmap(theta.at[members].set)(values)
            found, costs = jax.lax.map(lambda at: judged(jnp.clip(at, self.box.lower, self.box.upper)), tried)
            theta = found[jnp.argmin(jnp.where(jnp.isfinite(costs), costs, jnp.inf))]
        return minimum_in_jax(theta, evaluate, self.box, self._squares(targets), projects=projects)

    def determined(self, theta: Float[Array, " p"], gram: Float[Array, "p p"], targets: Samples) -> Bool[Array, " p"]:
        """Return which unknowns change the prediction by more than rounding, in no direction that changes none.

        Of an unknown that the prediction is linear in, any change will do; another one changes by 1 (of an exponent its
        logarithm) or by its value. Normal equations keep half of the digits.
        """
        half_the_digits = float(jnp.finfo(gram.dtype).eps) ** 0.5
        effect = jnp.sqrt(jnp.diagonal(gram)) * jnp.maximum(1.0, jnp.abs(theta))
        rounding = half_the_digits * jnp.sqrt(self._squares(targets))
        shown = effect > jnp.where(self.box.linear, 0.0, rounding)
        scale = jnp.where(shown, jax.lax.rsqrt(jnp.where(shown, jnp.diagonal(gram), 1.0)), 0.0)
        scaled = gram * jnp.outer(scale, scale) + jnp.diag(jnp.where(shown, 0.0, 1.0))
        size, direction = jnp.linalg.eigh(scaled)
        idle = jnp.where(size < len(gram) * jnp.finfo(gram.dtype).eps, direction, 0.0)
        return shown & jnp.all(jnp.abs(idle) < half_the_digits, -1)

    def _whitened(self, samples: Samples) -> Samples:
        """Return samples over the standard deviation of their view's noise; 0 where none counts."""
        weights = jax.lax.stop_gradient(jax.lax.map(self.model.sample_weights, self.chunk))
        counts = (self.index >= 0) & (weights > 0.0)
        return jnp.where(counts, jnp.sqrt(jnp.where(counts, weights, 1.0)) * samples, 0.0)

    def _squares(self, targets: Samples) -> Float[Array, ""]:
        """Return the sum of squares of the images, with which rounding is compared."""
        return jnp.sum(self._whitened(targets) ** 2)


@jax.custom_batching.custom_vmap
def _searched(fit: ImageFit, targets: Array) -> tuple[Point, Array]:
    return fit.search(targets)


@_searched.def_vmap
def _(size: int, batched: list, fit: ImageFit, targets: Array) -> tuple:
    """Search for a few at once: none of the others then waits for the slowest of all."""
    each, shared = eqx.partition((fit, targets), tuple(batched))

    def search(one: tuple) -> tuple[Point, Array]:
        fit, targets = eqx.combine(one, shared)
        return fit.search(targets)

    found = jax.lax.map(search, each, batch_size=min(size, TOGETHER))
    return found, jax.tree.map(lambda _: True, found)


def _inverse_of(hessian: Callable[[Array], Array], slope: Float[Array, " p"]) -> Float[Array, " p"]:
    """Return H^-1 slope, with 0 for unknowns and along directions that change nothing, given the product by H."""
    H = jax.vmap(hessian)(jnp.eye(len(slope), dtype=slope.dtype))
    D = jnp.diagonal(H)
    seen = jnp.finfo(H.dtype).eps * jnp.max(D) < D
    scale = jnp.where(seen, jax.lax.rsqrt(jnp.where(seen, D, 1.0)), 0.0)
    return scale * (jnp.linalg.pinv(H * jnp.outer(scale, scale), hermitian=True) @ (scale * slope))
