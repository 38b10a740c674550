"""Samples of a fit laid out again: predictions at any numbers, and their changes along directions of these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array
from ...inverse.data.views import is_grey
from ...inverse.forward.gram import Gram
from ...inverse.forward.interface import AbstractForwardModel
from ...inverse.pixels.blocks import Block
from ...inverse.pixels.blocks import chunks as in_chunks
from ...inverse.problem import prior_gram
from ...inverse.refits import LaidOutFit
from ...inverse.statistics.uncertainty import Vector, inverse

STEPS = 8  # of Gauss and Newton
HALVINGS = 3  # of a step that does not lower the cost
CLOSE = 1e-3  # of the cost, by which a step lowers it at least to be followed by another


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples that count at the end of a fit, in the order of `Rows`."""

    view: Int[np.ndarray, " n"]
    pixel: Int[np.ndarray, " n"]
    """In its view's flattened image."""
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
    """What the samples are at some numbers, in the order of `Samples`."""

    predicted: Float[np.ndarray, " n"]
    change: Float[np.ndarray, "t n"]
    """Of each unknown of the fit, and along each direction."""
    slope: Float[np.ndarray, " n"]
    """Of the cost in the prediction."""
    weight: Float[np.ndarray, " n"]
    """Of iterated reweighting; 0 where a clipped sample says nothing."""
    base: Float[np.ndarray, " n"]
    """1 over the variance of the noise; 0 where a sample was not measured."""
    cost: float


@dataclass(frozen=True, eq=False)
class End:
    """Where a search along a direction ended."""

    theta: Vector
    amount: Vector
    share: float
    """Which part of the cost is gone."""


class LaidSamples:
    """A fit laid out again, with numbers beside its own unknowns. To be used in float64."""

    def __init__(self, laid: LaidOutFit, along: Float[np.ndarray, "k p"]):
        """Find where each sample is; `along`: directions of the numbers, beside each unknown of the fit."""
        self.tangents = np.concatenate([np.eye(len(laid.fit.unknowns), len(laid.theta)), along])
        self.laid, self.own = laid, len(laid.fit.unknowns)
        self.inside = np.flatnonzero(~laid.fit.at_bound)
        self.used = [1 if is_grey(view) else 3 for view in laid.fit.views]
        places = [
            np.stack(np.broadcast_arrays(part.view, part.pixels[None], np.arange(self.used[part.view])[:, None]))
            for part in laid.parts
        ]
        place = np.concatenate([of.reshape(3, -1) for of in places], 1).astype(int)
        self.view, self.pixel, self.channel = place[0], place[1], place[2]

    def at(self, theta: Vector) -> Changes:
        """Return the predictions at some numbers, and what each unknown and each direction changes."""
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
        """Return what is known of the numbers beside the samples."""
        return prior_gram(jnp.asarray(theta), self.laid.priors)

    def search(self, along: Sequence[int]) -> End:
        """Return the minimum along some of the directions, the unknowns at their best, by Gauss and Newton's steps."""
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
            for _ in range(HALVINGS):
                there = np.clip(theta + step @ self.tangents[which], lower, upper)
                then = self.at(there)
                less = self._cost(then, there)
                if less < cost:
                    break
                step = 0.25 * step
            else:
                break
            gone, theta, amount, now, cost = cost - less, there, amount + step[q:], then, less
            if gone < CLOSE * cost:
                break
        return End(theta, amount, 1.0 - cost / first if first > 0 else 0.0)

    def _cost(self, of: Changes, theta: Vector) -> float:
        return of.cost + float(self.known(theta).cost) if np.isfinite(of.cost) else np.inf


@jax.jit
def _changes(theta: Array, tangents: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, ...]:
    """Return a chunk's predictions, their changes along tangents, the cost's slopes and curvatures, weights and costs.

    A clipped sample, which was not measured, has no weight of its own.
    """

    def of_block(block: Block) -> tuple[Array, ...]:
        m, derivative = jax.linearize(lambda q: jnp.stack(model.predict(q, block)), theta)
        seen = block.observed
        weight = model.sample_weights(block)
        terms = model.likelihood.terms(m, seen.target, weight, seen.clipped)
        measured, cost = model.measured_weights(block), jnp.sum(terms.cost)
        return m, jax.vmap(derivative)(tangents), terms.slope, terms.curvature, measured, cost

    return jax.lax.map(of_block, chunk)
