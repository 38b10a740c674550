"""The samples of a fit: their predictions for any parameters, and the derivatives along given directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.fields import Array
from ...inverse.data.views import channels
from ...inverse.forward.gram import Gram, directions_of
from ...inverse.forward.interface import AbstractForwardModel
from ...inverse.laid_out import LaidOut
from ...inverse.pixels.blocks import Block
from ...inverse.pixels.blocks import chunks as in_chunks
from ...inverse.result import Fit
from ...inverse.statistics.uncertainty import Vector, inverse
from ...inverse.unknowns.visibility import shown_unknowns
from .jacobian import Jacobian

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
        found, first = np.zeros(len(self.view)), np.searchsorted(self.view, np.arange(len(images) + 1))
        for i, image in enumerate(images):
            here = slice(first[i], first[i + 1])
            found[here] = image.reshape(-1, image.shape[2])[self.pixel[here], self.channel[here]]
        return found


@dataclass(frozen=True, eq=False)
class Changes:
    """The predictions for some parameters and their derivatives, in the order of `Samples`."""

    predicted: Float[np.ndarray, " n"]
    jacobian: Jacobian
    """The derivatives by the unknowns of the fit that are not at a bound."""
    along: Float[np.ndarray, "k n"]
    """The derivatives along each direction."""
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

    def __init__(self, fit: Fit, laid: LaidOut, along: Float[np.ndarray, "k p"]):
        """Find the pixel of each sample; `along`: directions of the parameters."""
        own, p = len(fit.unknowns), len(laid.theta)
        self.laid, self.along = laid, along
        self.inside = np.flatnonzero(~fit.at_bound)
        shown = shown_unknowns(fit.scene, fit.views, fit.unknowns)
        shown = np.tile(np.arange(own), (len(fit.views), 1)) if shown is None else shown
        self.shown = np.where(shown < own, shown, p)
        self.used = [channels(view) for view in fit.views]
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
            *of_chunk, costs = _changes(jnp.asarray(theta), self.shown, self.along, self.laid.model, chunk)
            arrays = [np.asarray(of) for of in of_chunk]
            cost += float(np.sum(np.asarray(costs)))
            for b, part in enumerate(parts):
                n, used = len(part.pixels), self.used[part.view]
                found.append([of[b][..., :used, :n].reshape(*of[b].shape[:-2], used * n) for of in arrays])
        predicted, rows, along, slope, weight, base = (np.concatenate(of, -1) for of in zip(*found, strict=True))
        first = np.searchsorted(self.view, np.arange(len(self.shown) + 1))
        jacobian = Jacobian(rows, self.shown, first, len(self.laid.theta)).of(self._is_inside)
        return Changes(predicted, jacobian, along, slope, weight, base, cost)

    @property
    def _is_inside(self) -> Bool[np.ndarray, " p"]:
        return np.isin(np.arange(len(self.laid.theta)), self.inside)

    def known(self, theta: Vector) -> Gram:
        """Return the Gram matrix of the priors."""
        return self.laid.prior_gram(theta)

    def search(self, along: Sequence[int]) -> End:
        """Return the minimum along some of the directions and over the unknowns, by Gauss-Newton steps."""
        box, q = self.laid.problem.box, len(self.inside)
        lower, upper = np.asarray(box.lower), np.asarray(box.upper)
        directions = self.along[list(along)]
        theta, amount = np.array(self.laid.theta), np.zeros(len(along))
        now = self.at(theta)
        first = cost = self._cost(now, theta)
        for _ in range(STEPS):
            known, J = self.known(theta), now.jacobian.beside(now.along[list(along)])
            H, g = J.gram(now.weight), J.times(now.slope[None])[0]
            H[:q, :q] += np.asarray(known.hessian)[np.ix_(self.inside, self.inside)]
            g[:q] += np.asarray(known.gradient)[self.inside]
            step = -inverse(H) @ g
            for _ in range(REDUCTIONS):
                there = theta + step[q:] @ directions
                there[self.inside] += step[:q]
                there = np.clip(there, lower, upper)
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
def _changes(theta: Array, shown: Array, along: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, ...]:
    """Return a chunk's predictions, their changes, the cost's slopes and curvatures, weights and costs.

    The changes are those by the unknowns that each view shows, and those along directions. The weight of a clipped
    sample, which was not measured, is 0.
    """

    def of_block(block: Block) -> tuple[Array, ...]:
        m, derivative = jax.linearize(lambda q: jnp.stack(model.predict(q, block)), theta)
        seen = block.observed
        weight = model.sample_weights(block)
        terms = model.likelihood.terms(m, seen.target, weight, seen.clipped)
        measured, cost = model.measured_weights(block), jnp.sum(terms.cost)
        each = directions_of(shown, block.view, len(theta))[1]
        return m, jax.vmap(derivative)(each), jax.vmap(derivative)(along), terms.slope, terms.curvature, measured, cost

    return jax.lax.map(of_block, chunk)
