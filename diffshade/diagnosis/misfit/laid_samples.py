"""The samples of a fit: their predictions for any parameters, and the derivatives along given directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array
from ...inverse.data.views import channels
from ...inverse.forward.gram import Gram
from ...inverse.forward.interface import AbstractForwardModel
from ...inverse.laid_out_fit import LaidOutFit
from ...inverse.laid_out_problem import prior_gram
from ...inverse.pixels.blocks import Block
from ...inverse.pixels.blocks import chunks as in_chunks
from ...inverse.statistics.uncertainty import Vector, inverse

STEPS = 8  # Gauss-Newton steps
REDUCTIONS = 3  # the most reductions of a step that does not lower the cost
CLOSE = 1e-3  # relative decrease of the cost below which the search stops


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples that count at the minimum of a fit, in the order of `Rows`."""

    view: Int[np.ndarray, " n"]
    pixel: Int[np.ndarray, " n"]
    """The index in the view's flattened image."""
    channel: Int[np.ndarray, " n"]
    predicted: Float[np.ndarray, " n"]

    def of(self, images: Sequence[np.ndarray]) -> Float[np.ndarray, " n"]:
        """Return the samples of images (h, w, c), one for each view."""
        found = np.zeros(len(self.view))
        for i, image in enumerate(images):
            here = self.view == i
            found[here] = image.reshape(-1, image.shape[2])[self.pixel[here], self.channel[here]]
        return found


@dataclass(frozen=True, eq=False)
class Changes:
    """The predictions for some parameters and their derivatives, in the order of `Samples`."""

    predicted: Float[np.ndarray, " n"]
    change: Float[np.ndarray, "t n"]
    """The derivatives by each unknown of the fit, and along each direction."""
    slope: Float[np.ndarray, " n"]
    """The derivative of the cost by the prediction."""
    weight: Float[np.ndarray, " n"]
    """The weight of iterative reweighting; 0 for a clipped sample without information."""
    base: Float[np.ndarray, " n"]
    """1 over the variance of the noise; 0 for a sample that was not measured."""
    cost: float


@dataclass(frozen=True, eq=False)
class End:
    """The end of a search along a direction."""

    theta: Vector
    amount: Vector
    share: float
    """The fraction of the cost that is explained."""


class LaidSamples:
    """A fit laid out with parameters added to its own unknowns. Runs in float64."""

    def __init__(self, laid: LaidOutFit, along: Float[np.ndarray, "k p"]):
        """Find the pixel of each sample; `along`: directions of the parameters, after each unknown of the fit."""
        self.tangents = np.concatenate([np.eye(len(laid.fit.unknowns), len(laid.theta)), along])
        self.laid, self.own = laid, len(laid.fit.unknowns)
        self.inside = np.flatnonzero(~laid.fit.at_bound)
        self.used = [channels(view) for view in laid.fit.views]
        places = [
            np.stack(np.broadcast_arrays(part.view, part.pixels[None], np.arange(self.used[part.view])[:, None]))
            for part in laid.parts
        ]
        place = np.concatenate([of.reshape(3, -1) for of in places], 1).astype(int)
        self.view, self.pixel, self.channel = place[0], place[1], place[2]

    def at(self, theta: Vector) -> Changes:
        """Return the predictions for some parameters, and their derivatives."""
        found: list[list[np.ndarray]] = []
        cost = 0.0
        for chunk, parts in zip(self.laid.chunks, in_chunks(self.laid.parts), strict=True):
            *of_chunk, costs = _changes(jnp.asarray(theta), jnp.asarray(self.tangents), self.laid.model, chunk)
            arrays = [np.asarray(of) for of in of_chunk]
            cost += float(np.sum(np.asarray(costs)))
            for b, part in enumerate(parts):
                n, used = len(part.pixels), self.used[part.view]
                found.append([of[b][..., :used, :n].reshape(*of[b].shape[:-2], used * n) for of in arrays])
        predicted, change, slope, weight, base = (np.concatenate(of, -1) for of in zip(*found, strict=True))
        return Changes(predicted, change, slope, weight, base, cost)

    def known(self, theta: Vector) -> Gram:
        """Return the Gram matrix of the priors."""
        return prior_gram(jnp.asarray(theta), self.laid.priors)

    def search(self, along: Sequence[int]) -> End:
        """Return the minimum along some of the directions and over the unknowns, by Gauss-Newton steps."""
        box, q = self.laid.problem.box, len(self.inside)
        lower, upper = np.asarray(box.lower), np.asarray(box.upper)
        which = np.concatenate([self.inside, self.own + np.asarray(along, int)])
        theta, amount = np.array(self.laid.theta), np.zeros(len(along))
        now = self.at(theta)
        first = cost = self._cost(now, theta)
        for _ in range(STEPS):
            known, J = self.known(theta), now.change[which]
            H, g = (J * now.weight) @ J.T, J @ now.slope
            H[:q, :q] += np.asarray(known.hessian)[np.ix_(self.inside, self.inside)]
            g[:q] += np.asarray(known.gradient)[self.inside]
            step = -inverse(H) @ g
            for _ in range(REDUCTIONS):
                there = np.clip(theta + step @ self.tangents[which], lower, upper)
                then = self.at(there)
                less = self._cost(then, there)
                if less < cost:
                    break
                step = 0.25 * step
            else:
                break
            decrease, theta, amount, now, cost = cost - less, there, amount + step[q:], then, less
            if decrease < CLOSE * cost:
                break
        return End(theta, amount, 1.0 - cost / first if first > 0 else 0.0)

    def _cost(self, of: Changes, theta: Vector) -> float:
        return of.cost + float(self.known(theta).cost) if np.isfinite(of.cost) else np.inf


@jax.jit
def _changes(theta: Array, tangents: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, ...]:
    """Return a chunk's predictions, their changes along tangents, the cost's slopes and curvatures, weights and costs.

    The weight of a clipped sample, which was not measured, is 0.
    """

    def of_block(block: Block) -> tuple[Array, ...]:
        m, derivative = jax.linearize(lambda q: jnp.stack(model.predict(q, block)), theta)
        seen = block.observed
        weight = model.sample_weights(block)
        terms = model.likelihood.terms(m, seen.target, weight, seen.clipped)
        measured, cost = model.measured_weights(block), jnp.sum(terms.cost)
        return m, jax.vmap(derivative)(tangents), terms.slope, terms.curvature, measured, cost

    return jax.lax.map(of_block, chunk)
