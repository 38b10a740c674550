"""Shot ranking: the evidence with a shot added, how much information that is, and which shot is best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..inverse.result import Fit
from ..inverse.statistics.evidence import Evidence
from ..inverse.statistics.identifiability import null_directions, relative_errors
from ..inverse.statistics.uncertainty import SINGULAR, Matrix, Vector, scaled
from ..inverse.unknowns.unknown import Unknown


def add_shot(evidence: Evidence, hessian: Matrix) -> Evidence:
    """Return the evidence with one more cluster; its gradient is 0, since the expected image is the fitted one."""
    zero, directions = null_directions(evidence.total + hessian)
    return evidence.with_cluster(hessian, ~zero & ~directions.any(0))


def information(fit: Fit, evidence: Evidence) -> tuple[int, float]:
    """Return the rank of the information about the unknowns inside their bounds, and its log det in relative units.

    For a singular matrix the log det uses the largest eigenvalues, as many as the rank.
    """
    inside = ~evidence.at_bound
    H = evidence.total[np.ix_(inside, inside)] / max(evidence.sigma2, 1e-300)
    A, lengths = scaled(H)
    w = np.linalg.eigvalsh(A)
    rank = int(np.sum(w > SINGULAR**2 * w.max(initial=0.0)))
    size = reference_sizes(fit)[inside]
    if rank == len(w):  # the scaled matrix has the better condition
        return rank, float(np.log(w).sum() + 2.0 * np.log(lengths * size).sum())
    largest = np.linalg.eigvalsh(H * np.outer(size, size))[len(w) - rank :]
    return rank, float(np.log(np.maximum(largest, 1e-300)).sum())


def rank_shots(
    fit: Fit,
    names: Sequence[str],
    aim: Bool[np.ndarray, " p"],
    errors: Float[np.ndarray, "shots p"],
    rank: Int[np.ndarray, " shots"],
    gain: Float[np.ndarray, " shots"],
) -> tuple[int, ...]:
    """Return the shots' indices, best first: by rank gained, then by the aim's relative error or else by log det.

    If the views determine everything, no shot gains rank. Values that differ by rounding alone are tied; ties are
    broken by name.
    """

    def key(i: int) -> tuple:
        undetermined, score = 0.0, -gain[i]
        if aim.any():
            relative = (errors[i] / reference_sizes(fit))[aim]
            known = np.isfinite(relative)
            undetermined, score = float(np.sum(~known)), float(np.sqrt(np.sum(relative[known] ** 2)))
        return (-int(rank[i]), undetermined, float(f"{score:.9g}"), names[i], i)

    return tuple(sorted(range(len(names)), key=key))


def reference_sizes(fit: Fit) -> Vector:
    """Return what each error is relative to (see `relative_errors`); 1 for a value without a scale."""
    share = relative_to_values(fit.unknowns, fit.values, np.ones(len(fit.values)), fit.scales)
    return np.where(share > 0, 1.0 / np.where(share > 0, share, 1.0), 1.0)


def relative_to_values(unknowns: Sequence[Unknown], values: Vector, errors: Vector, scales: Vector) -> Vector:
    """Return errors relative to their values; 0 for a bounded value that is 0 and so has no scale."""
    without_scale = (values == 0) & np.array([np.isfinite(u.lower) for u in unknowns])  # a vector's component has one
    nonzero = np.where(without_scale, 1.0, values)
    return np.where(without_scale, 0.0, relative_errors(unknowns, nonzero, errors, scales))
