"""Laid-out fit: a fit laid out again at its end, to be minimised with a number held or on some of its pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from weakref import WeakKeyDictionary

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from .data.samples import Counts, Samples
from .forward.interface import AbstractForwardModel
from .pixels.blocks import Block, Piece, pieces
from .pixels.blocks import chunks as in_chunks
from .problem import MAX_STEPS, fit_problem, laid_bytes
from .result import Fit
from .running import run, samples_for
from .solve.solvers import Box, Minimum, PriorResiduals, Task, minimise
from .unknowns.unknown import Unknown, coordinates

Masks = Sequence[Bool[np.ndarray, "h w"] | None]
"""For each view the pixels to keep; None keeps all."""


_ALL: WeakKeyDictionary[Fit, tuple[list[Samples], Counts]] = WeakKeyDictionary()
"""The samples of fits while these live: a check asks for them several times."""


class LaidOutFit:
    """A fit laid out again at its end. To be used in float64."""

    def __init__(
        self,
        fit: Fit,
        keep: Masks | None = None,
        *,
        rendered: bool = False,
        beside: Sequence[Unknown] = (),
        at_most: int | None = None,
        sigma: float | None = None,
    ):
        """Lay out the pixels of a fit, or those to keep; `rendered` asks for the model that serves any scene.

        `beside`: numbers that the fit held, which follow its own unknowns. `at_most`: so many pixels, evenly spread.
        `sigma`: another scale of the residuals than the fit's.
        """
        self.samples, counts = samples_of(fit, keep)
        self.fit = fit
        self.unknowns = (*fit.unknowns, *beside)
        problem = fit_problem(
            fit.scene,
            fit.views,
            self.unknowns,
            self.samples,
            counts,
            fit.likelihood.loss,
            fit.clipped,
            rendered=rendered,
        )
        scale = float(fit.likelihood.sigma) if sigma is None else sigma
        self.problem = problem.with_scale(scale, fit.likelihood.loss).with_rounding(fit.rounding)
        self.theta = coordinates(np.array([*fit.values, *(u.start for u in beside)]), self.unknowns)
        self.size = self.problem.size_for(at_most)
        self.parts = pieces(self.samples, self.size, at_most)
        self.chunks = self.lay_out(self.parts)

    @property
    def model(self) -> AbstractForwardModel:
        """The model that predicts the samples."""
        return self.problem.model

    @property
    def task(self) -> Task:
        """What the fit minimised."""
        return self.problem.task(self.fit.squares)

    @property
    def priors(self) -> PriorResiduals:
        """What is known of the unknowns beside the views."""
        return self.problem.priors(self.fit.squares)

    def lay_out(self, parts: Sequence[Piece], size: int | None = None) -> list[Block]:
        """Return the chunks of pieces, a block each, weighed at the fit; blocks of another size where it is given."""
        return self.problem.reweigh(self.theta, self.problem.lay_out(parts, size or self.size))

    def without(self, masks: Masks) -> list[Block]:
        """Return the chunks with no weight on the masked pixels: the same programs serve."""
        size = self.size

        def weigh(chunk: Block, parts: Sequence[Piece]) -> Block:
            kept = np.ones((len(chunk.view), 1, size))
            for b, part in enumerate(parts):
                if (mask := masks[part.view]) is not None:
                    kept[b, 0, : len(part.pixels)] = ~mask.reshape(-1)[part.pixels]
            return eqx.tree_at(lambda c: c.observed.weight, chunk, chunk.observed.weight * kept)

        return [weigh(*of) for of in zip(self.chunks, in_chunks(self.parts), strict=True)]

    def by_view(self) -> list[list[Block]]:
        """Return the chunks of each view apart."""
        parts = pieces(self.samples, self.size)
        return [self.lay_out([p for p in parts if p.view == view]) for view in range(len(self.fit.views))]

    def minimise(
        self, held: Mapping[int, float], theta: Float[np.ndarray, " p"], chunks: Sequence[Block], rtol: float = 1e-16
    ) -> Minimum:
        """Return the minimum from theta, with some unknowns held at a value; all in the solver's coordinates."""
        theta, lower, upper = hold(self.problem.box, theta, held)
        box = dataclasses.replace(self.problem.box, lower=jnp.asarray(lower), upper=jnp.asarray(upper))
        task = Task(self.model, self.priors, box)
        return minimise(theta, task, chunks, squares=self.fit.squares, max_steps=MAX_STEPS, rtol=rtol)


def hold(
    box: Box, theta: Float[np.ndarray, " p"], held: Mapping[int, float]
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Return theta within a box, and the box's lower and upper ends, all with some unknowns held at a value."""
    which, at = np.array(list(held), int), np.array(list(held.values()), float)
    lower, upper = (np.array(bound) for bound in (box.lower, box.upper))
    theta = np.clip(theta, lower, upper)
    for array in (lower, upper, theta):
        array[which] = at
    return theta, lower, upper


def samples_of(fit: Fit, keep: Masks | None = None) -> tuple[list[Samples], Counts]:
    """Return the samples of a fit, or those of the pixels to keep, and their count."""
    if (needs := laid_bytes(fit.scene, fit.views, fit.counts.pixels)) > fit.memory:
        raise ValueError(
            f"repeating a fit needs all of its pixels in memory, here {needs:.3g} bytes, but this fit's memory is "
            f"{fit.memory:.3g}. Fit some of the rows or views, or give fit more memory."
        )
    if fit not in _ALL:
        _ALL[fit] = samples_for(fit.scene, fit.views, fit.unknowns, fit.clipped)
    samples, counts = _ALL[fit]
    if keep is None:
        return samples, counts
    samples = [
        s if kept is None else dataclasses.replace(s, pixels=s.pixels[kept.reshape(-1)[s.pixels]])
        for s, kept in zip(samples, keep, strict=True)
    ]
    return samples, counts.of(samples)


def refit(fit: Fit, keep: Masks, held: Bool[np.ndarray, " p"]) -> Fit:
    """Fit anew on the pixels to keep, with a search of its own and some unknowns held where they are. In float64.

    An unknown that none of the pixels shows is not determined; one that is held counts as at a bound.
    """
    unknowns = [
        dataclasses.replace(u, start=float(v), **({"lower": float(v), "upper": float(v)} if h else {}))
        for u, v, h in zip(fit.unknowns, fit.values, held, strict=True)
    ]
    return run(fit.scene, fit.views, unknowns, *samples_of(fit, keep), fit.likelihood.loss, fit.clipped)
