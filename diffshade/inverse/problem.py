"""Problem: what a fit minimises: the unknowns, the samples, and the model that predicts them.

A fit goes on in stages that each add something and change nothing. A `LaidOut` has the pixels with their weights, and
is minimised: `solving.solve` searches for a start and settles the scale of the residuals on a part of them, and goes on
with all. A `Solved` is the problem and its minimum: what a `Fit` holds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..model.scenes import Object, Scene, over_pixels_and_rest
from ..parallel.threads import on_all_cores
from .data.view_sets import ViewSet
from .forward.features import feature_model, features_can_serve
from .forward.interface import AbstractForwardModel
from .forward.layout import points_of, weigh, with_weights, without_clipped
from .forward.losses import Likelihood
from .forward.rendered import AROUND, RenderedModel, prepare
from .forward.rounding import Rounding
from .forward.sums import sum_of_squares, weights_of_views
from .pixels.blocks import (
    BLOCK,
    MANY,
    Block,
    Piece,
    block_size,
    chunks,
    observed,
    pieces,
    shares,
    views_of,
)
from .solve.solvers import BoxConstraints, PriorResiduals, Task
from .solve.start_search import steepest
from .unknowns.unknown import Unknown, coordinates, free_places, unit_vectors
from .unknowns.visibility import arrow_of

PART = 2 * MANY  # pixels on which the search for a start follows its candidates
FEW = 2 * BLOCK  # pixels on which it judges them, where they are many

Theta = Float[np.ndarray, " p"]


@dataclass(frozen=True, eq=False)
class FitProblem:
    """The unknowns of a scene, the samples that count, and the model that predicts them. To be used in float64."""

    scene: Scene
    data: ViewSet
    """The views, and their samples that count."""
    unknowns: Sequence[Unknown]
    loss: str
    model: AbstractForwardModel
    """It begins with squares, scale 1 and no steps of the files; later stages replace these."""
    box: BoxConstraints
    block_size: int
    over_pixels: tuple[Object, ...]
    """What of the objects comes with the pixels (`slots.apart`)."""

    def with_scale(self, sigma: float, loss: str) -> FitProblem:
        """Return the problem with another scale of the residuals and another loss."""
        if loss == self.model.likelihood.loss and sigma == float(self.model.likelihood.sigma):
            return self
        # a strong type: with a weak one, all programs would be compiled again
        likelihood = Likelihood(jnp.asarray(np.float64(sigma)), loss, self.model.likelihood.tobit)
        return dataclasses.replace(self, model=self.model.use(likelihood))

    def with_rounding(self, rounding: Rounding) -> FitProblem:
        """Return the problem with the steps of the views' files."""
        if not (rounding.exists or self.model.setting.rounding.exists):
            return self
        model = eqx.tree_at(lambda m: m.setting.rounding, self.model, jax.tree.map(jnp.asarray, rounding))
        return dataclasses.replace(self, model=model)

    @property
    def settles(self) -> bool:
        """Whether the scale of the residuals or the weights of the samples follow the unknowns."""
        follows = not self.data.noise_known and any(u.prior is not None for u in self.unknowns)
        return self.loss != "squares" or not self.data.homoscedastic or follows

    def values(self, parts: Sequence[Piece]) -> list[Float[np.ndarray, " _"]]:
        """Return the samples of each view, in pieces of them, that are not clipped."""
        found = [[np.zeros(0)] for _ in self.data.views]
        for view, samples, pixels in parts:
            values = samples.values(pixels)
            found[view].append(values[samples.sensor_range.clipped(values) == 0])
        return [np.concatenate(of) for of in found]

    def size_for(self, at_most: int | None) -> int:
        """Return how many pixels a block holds of so many evenly spread ones."""
        return min(self.block_size, block_size(shares(self.data.pixels, at_most)))

    def chunks(self, at_most: int | None = None, size: int | None = None) -> list[Block]:
        """Return the chunks of all pixels, or of some, evenly spread; in blocks of another size where it is given."""
        size = size or self.size_for(at_most)
        return self.lay_out(self.pieces(at_most, size), size)

    def pieces(self, at_most: int | None, size: int) -> list[Piece]:
        """Return the pieces of all pixels, or of some, evenly spread."""
        return pieces(self.data.samples, size, at_most)

    def lay_out(self, parts: Sequence[Piece], size: int) -> list[Block]:
        """Return the chunks of pieces of at most so many pixels, a block a piece.

        Chunks that show the same points share them: those that a camera sees under a hundred lights are found once.
        """
        found = chunks(parts)
        points = points_of(found, self.data, self.model, self.over_pixels, size)
        most = 1 if self.data.grey else len(self.scene.channels)

        def chunk(of: tuple[list[Piece], Any]) -> Block:
            of_chunk, shown = of
            seen = observed(of_chunk, size, most, clipping=self.data.counts.clipped > 0)
            return with_weights(self.model, Block(views_of(of_chunk), shown, seen), noise_known=self.data.noise_known)

        return on_all_cores(chunk, zip(found, points, strict=True))

    def few(self) -> list[Block]:
        """Return the chunks of a few pixels, without clipped samples."""
        return self.measured(self.chunks(FEW))

    def measured(self, laid: list[Block]) -> list[Block]:
        """Return chunks in which no clipped sample counts."""
        return on_all_cores(without_clipped, laid) if self.data.counts.clipped else laid

    def reweigh(self, theta: Theta, laid: list[Block]) -> list[Block]:
        """Return the chunks with weights by the noise at the level that theta predicts."""
        if self.data.homoscedastic:
            return laid
        return on_all_cores(lambda chunk: weigh(jnp.asarray(theta), self.model, chunk), laid)

    def sum_of_squares(self, chunks: Sequence[Block]) -> float:
        """Return the weighted sum of squares of the samples of chunks; 1 where all are 0."""
        return sum(sum_of_squares(self._weights, chunk) for chunk in chunks) or 1.0

    @cached_property
    def _weights(self) -> Float[np.ndarray, " views"]:
        return np.asarray(weights_of_views(self.model)) if self.data.noise_known else np.ones(len(self.data.views))

    def priors(self, squares: float) -> PriorResiduals:
        """Return the residuals of the priors and unit vectors; `squares` is the sum of squares of the images."""
        known = [(j, *u.prior) for j, u in enumerate(self.unknowns) if u.prior is not None]
        index, mean, width = (np.array([row[k] for row in known]) for k in range(3))
        units = np.array(unit_vectors(self.unknowns), int).reshape(-1, 3)
        weight = float(self.model.likelihood.sigma) / width.astype(float)
        return PriorResiduals(
            index.astype(int), mean.astype(float), weight, units, np.full(len(units), np.sqrt(squares))
        )

    def task(self, squares: float) -> Task:
        """Return what is to be minimised."""
        return Task(self.model, self.priors(squares), self.box, squares, self.unknowns, self.scene)


def fit_problem(
    scene: Scene, data: ViewSet, unknowns: Sequence[Unknown], loss: str, *, rendered: bool = False
) -> FitProblem:
    """Return the problem of a fit, with the fastest model that serves.

    Args:
        scene: The scene; it has values for the unknowns too.
        data: The photographs, and their samples that count.
        unknowns: What is to be found.
        loss: "squares", "huber", "cauchy" or "geman-mcclure".
        rendered: Whether to take the model for any scene even if a faster one would do.
    """
    setting = prepare(scene, data.views, unknowns)
    likelihood = Likelihood(np.asarray(1.0), "squares", data.clipped == "tobit")
    model: AbstractForwardModel
    if features_can_serve(scene, data.views, unknowns) and not rendered:
        shared = loss == "squares" and not data.counts.clipped and data.homoscedastic
        model = feature_model(setting, likelihood, scene, unknowns, shared=shared, grey=data.grey)
    else:
        model = RenderedModel(setting, likelihood, steepest(unknowns))
    lower, upper = (coordinates(np.array([getattr(u, end) for u in unknowns]), unknowns) for end in ("lower", "upper"))
    linear, arrow = np.array([u.parameter.linear for u in unknowns]), arrow_of(scene, data.views, unknowns)
    in_border = arrow is not None and linear.any() and linear[arrow.border].sum() == linear.sum()
    box = BoxConstraints(lower, upper, linear, arrow, bool(in_border))
    size = block_size(data.pixels, len(AROUND) if setting.blurred else 1)
    over_pixels, _ = over_pixels_and_rest(scene.objects)
    return FitProblem(scene, data, unknowns, loss, model, box, size, over_pixels)


def moves_surface(unknowns: Sequence[Unknown]) -> bool:
    """Whether a surface is free."""
    return any(place.part == "surface" for place in free_places(unknowns))
