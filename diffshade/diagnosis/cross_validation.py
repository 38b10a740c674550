"""Cross-validation: photographs, or patches of them, held out one at a time and predicted by a fit to the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from ..inverse.forward.interface import AbstractForwardModel
from ..inverse.forward.losses import LOSSES
from ..inverse.laid_out import LaidOut
from ..inverse.pixels.blocks import BLOCK, Block, Piece
from ..inverse.pixels.blocks import chunks as in_chunks
from ..inverse.result import Fit
from ..inverse.solve.solvers import evaluate
from ..inverse.statistics.uncertainty import single_views
from .patches import cut_in_patches, patch_width, residual_images

FEWEST_VIEWS = 3  # with fewer views, patches are held out


@dataclass(frozen=True, eq=False)
class Folds:
    """The pixels that count, divided into folds (views or patches) that are held out one at a time."""

    pieces: list[Piece]
    size: int
    fold: Int[np.ndarray, " pieces"]
    """The fold of each piece."""
    by_view: bool
    words: str

    @property
    def count(self) -> int:
        """The number of folds."""
        return int(self.fold.max()) + 1


def make_folds(fit: Fit) -> Folds:
    """Return the folds: views (one fold per camera and set of lights) if there are at least three, else patches."""
    data, size = fit.solved.problem.data, fit.solved.problem.block_size
    samples = data.samples
    groups = [[v for v in group if len(samples[v].pixels)] for group in data.setups]
    groups = [group for group in groups if group]  # a view that repeats an earlier one has no pixels
    if len(groups) >= FEWEST_VIEWS:
        parts = [Piece(v, samples[v], samples[v].pixels) for group in groups for v in group]
        fold = np.array([k for k, group in enumerate(groups) for _ in group])
        return _in_blocks(parts, fold, size, f"{len(groups)} views")
    width = patch_width(*residual_images(fit))
    parts, fold = cut_in_patches(fit, samples, width)
    count = len(set(fold))
    if count < 2:
        raise ValueError(
            f"compare needs at least two patches of uncorrelated residuals; got {count}, since the residuals of these "
            f"views are correlated over {width} pixels. Add photographs."
        )
    size = min(BLOCK, max(64, 1 << int(np.ceil(np.log2(max(len(part.pixels) for part in parts))))))
    return _in_blocks(parts, fold, size, f"{count} patches of {width} x {width} pixels")


def _in_blocks(parts: Sequence[Piece], fold: Int[np.ndarray, " n"], size: int, words: str) -> Folds:
    """Cut the pixels of each piece into blocks."""
    found = [
        (k, Piece(part.view, part.samples, part.pixels[at : at + size]))
        for k, part in zip(fold, parts, strict=True)
        for at in range(0, len(part.pixels), size)
    ]
    return Folds([p for _, p in found], size, np.array([k for k, _ in found]), words.endswith("views"), words)


@dataclass(frozen=True, eq=False)
class Scores:
    """The held-out errors of a model."""

    laid: LaidOut
    chunks: list[Block]
    squares: Float[np.ndarray, " folds"]
    """Sum of squares of each fold, predicted without it."""
    samples: Float[np.ndarray, " folds"]
    rounding: float
    """The mean square of what float32 rounds away of a sample: a smaller error tells nothing of a model."""
    rmse: float
    held: tuple[str, ...]
    """The unknowns that only one view determines."""
    converged: bool
    """Whether every fit without a fold converged."""

    def predicted(self, c: int) -> tuple[np.ndarray, ...]:
        """Return the fit's predictions of a chunk, and the weight of each measured sample, else 0."""
        return _predictions(jnp.asarray(self.laid.theta), self.laid.model, self.chunks[c])


def cross_validate(laid: LaidOut, folds: Folds, scale: float, report_progress: Callable[[float], None]) -> Scores:
    """Predict each fold by a fit to the others."""
    problem, rho = laid.problem, LOSSES[laid.model.likelihood.loss].value
    chunks = problem.lay_out(folds.pieces, folds.size)  # weights by the photograph, the same for every model
    weighed = problem.reweigh(laid.theta, chunks)
    gathered, fold_of = in_chunks(folds.pieces), {id(p): k for p, k in zip(folds.pieces, folds.fold, strict=True)}
    of_block = [np.array([fold_of.get(id(p), -1) for p in of]) for of in gathered]  # -1 where a chunk is filled up
    empty = laid.lay_out([p._replace(pixels=p.pixels[:0]) for p in gathered[0]], folds.size)[0]
    # Without its view, a view's own exposure is unknown.
    single_view = single_views(evaluate(laid.theta, laid.task, weighed).views.seen(len(laid.theta)))
    single_view = single_view if folds.by_view else np.full(len(single_view), -1)
    squares, samples, signal, converged = np.zeros(folds.count), np.zeros(folds.count), 0.0, True
    for k in range(folds.count):
        report_progress(k / folds.count)
        views = [part.view for part, fold in zip(folds.pieces, folds.fold, strict=True) if fold == k]
        held = {int(j): float(laid.theta[j]) for j in np.flatnonzero(np.isin(single_view, views))}
        others = [
            _without(chunk, empty, blocks == k) if (blocks == k).any() else chunk
            for chunk, blocks in zip(weighed, of_block, strict=True)
            if ((blocks != k) & (blocks >= 0)).any()
        ]
        end = laid.minimise(held, chunks=others)
        converged &= not end.message
        for chunk, blocks in zip(chunks, of_block, strict=True):
            if (blocks == k).any():
                mine = np.flatnonzero(blocks == k)
                m, weight = (x[mine] for x in _predictions(jnp.asarray(end.theta), laid.model, chunk))
                target = np.asarray(chunk.observed.target)[mine]
                s = weight * (m - target) ** 2 / scale**2
                squares[k] += scale**2 * float(np.sum(rho(s)))
                samples[k] += float(np.sum(weight > 0))
                signal += float(np.sum(weight * target**2))
    own = dict.fromkeys(u.quantity for u, alone in zip(problem.unknowns, single_view, strict=True) if alone >= 0)
    rounding = float(np.finfo(np.float32).eps) ** 2 * signal / float(samples.sum())
    scores = Scores(laid, chunks, squares, samples, rounding, 0.0, tuple(own), converged)
    residual = 0.0
    for c, chunk in enumerate(chunks):
        m, weight = scores.predicted(c)
        residual += float(np.sum(((m - np.asarray(chunk.observed.target)) ** 2)[weight > 0]))
    return dataclasses.replace(scores, rmse=float(np.sqrt(residual / samples.sum())))


def _without(chunk: Block, empty: Block, out: Bool[np.ndarray, " blocks"]) -> Block:
    """Return a chunk with some blocks emptied; its shape stays the same, so that nothing is compiled again."""
    return jax.tree.map(
        lambda leaf, none: jnp.where(out.reshape(-1, *[1] * (leaf.ndim - 1)), none[:1], leaf), chunk, empty
    )


def _predictions(theta: Array, model: AbstractForwardModel, chunk: Block) -> tuple[np.ndarray, ...]:
    return tuple(map(np.asarray, _predicted(theta, model, chunk)))


@jax.jit
def _predicted(theta: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, Array]:
    """Return the predictions of a chunk, and the weights of its samples; 0 for a clipped sample."""

    def of_block(block: Block) -> tuple[Array, Array]:
        weight, seen = model.sample_weights(block), block.observed
        measured = weight if seen.clipped is None else jnp.where(seen.clipped == 0, weight, 0.0)
        return jnp.stack(model.predict(theta, block)), measured

    return jax.lax.map(of_block, chunk)
