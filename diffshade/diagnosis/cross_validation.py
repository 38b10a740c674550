"""Cross-validation: photographs, or patches of them, held out one at a time and predicted by a fit to the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from ..inverse.forward.losses import LOSSES
from ..inverse.forward.sums import residuals
from ..inverse.laid_out import LaidOut
from ..inverse.result import Fit
from ..inverse.solve.solvers import evaluate
from .patches import Parts, cut_in_patches, keep_only, patch_width, residual_images

MIN_VIEWS = 3  # with fewer views, patches are held out


def make_folds(fit: Fit) -> Parts:
    """Return the folds: views (one fold per camera and set of lights) if there are at least three, else patches."""
    data = fit.solved.problem.data
    views = [
        keep_only(data, group)
        for group in data.setups
        if any(len(data.samples[view].pixels) for view in group)  # one that repeats an earlier one has none
    ]
    if len(views) >= MIN_VIEWS:
        return Parts(views, f"{len(views)} views", by_view=True)
    width = patch_width(*residual_images(fit))
    patches = cut_in_patches(data, width)
    if len(patches) < 2:
        raise ValueError(
            f"compare needs at least two patches of uncorrelated residuals; got {len(patches)}, since the residuals of "
            f"these views are correlated over {width} pixels. Add photographs."
        )
    return patches


@dataclass(frozen=True, eq=False)
class Scores:
    """The held-out errors of a model."""

    squares: Float[np.ndarray, " folds"]
    """Sum of squares of each fold, predicted without it."""
    samples: Float[np.ndarray, " folds"]
    rounding: float
    """The mean square of what float32 rounds away of a sample: a smaller error tells nothing of a model."""
    held: tuple[str, ...]
    """The unknowns that only one view determines."""
    converged: bool
    """Whether every fit without a fold converged."""

    @property
    def error(self) -> float:
        """The mean square error of the held-out samples."""
        return float(self.squares.sum() / self.samples.sum())


def cross_validate(laid: LaidOut, folds: Parts, scale: float, report_progress: Callable[[float], None]) -> Scores:
    """Predict each fold by a fit to the others.

    Args:
        laid: The model.
        folds: What is held out.
        scale: The residual to which those of a robust loss are compared.
        report_progress: Reports the share that is done.
    """
    problem, rho = laid.problem, LOSSES[laid.model.likelihood.loss].value
    chunks = folds.lay_out(problem)  # weights by the photograph, the same for every model
    weighed = [problem.reweigh(laid.theta, of) for of in chunks]
    # Without its view, a view's own exposure is unknown.
    point = evaluate(laid.theta, laid.task, [chunk for of in weighed for chunk in of])
    single_view = point.views.single_view(len(laid.theta))
    single_view = single_view if folds.by_view else np.full(len(single_view), -1)
    squares, samples, converged = np.zeros(len(folds)), np.zeros(len(folds)), True
    for k, part in enumerate(folds.samples):
        report_progress(k / len(folds))
        alone = np.isin(single_view, [view for view, s in enumerate(part) if len(s.pixels)])
        held = {int(j): float(laid.theta[j]) for j in np.flatnonzero(alone)}
        end = laid.minimise(held, chunks=[chunk for i, of in enumerate(weighed) if i != k for chunk in of])
        converged &= not end.message
        for r, counts, _ in jax.tree.map(np.asarray, laid.task.on_all_cores(residuals, end.theta, chunks[k])):
            squares[k] += scale**2 * float(np.sum(rho((r[counts] / scale) ** 2)))
            samples[k] += float(counts.sum())
    own = dict.fromkeys(u.quantity for u, view in zip(problem.unknowns, single_view, strict=True) if view >= 0)
    rounding = float(np.finfo(np.float32).eps) ** 2 * laid.squares / float(samples.sum())
    return Scores(squares, samples, rounding, tuple(own), converged)
