"""Discontinuities: the pairs of neighbours between which the height jumps, found from the curl of the differences.

Cut pairs are those that a solution robust to them leaves with large residuals. The cost

    sum_e log(1 + t_e^2),  t_e = (u_q - u_p - d_e) / s_e

of Cauchy's distribution is lowest, for a jump that fades out, where the jump is left to the pairs along one line. Its
minimum is approached by least squares, reweighted by 1 / (1 + t^2). Least squares of equal weights spread a jump over
the whole image and are a bad beginning. The search therefore begins with low weights beside texels around which the
curl is large, at three resolutions: these lie along the line.

Bilateral normal integration (Cao et al. 2022) compares, at each texel, the residuals on its two sides instead. Where a
jump grows slowly along its line no single residual is large, and it stays with plain least squares.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ...core.progress import ReportProgress
from ...core.robust_scale import OUTLIER
from ...core.thresholds import TINY
from .curl import PyramidLevel
from .regions import connected
from .system import HeightGrid, HeightSystem

MIN_CURL = 5.5  # curl beyond so many deviations begins a search: noise does so once in 26 million texels
SEED_LEVELS = 3
STEPS, SOLVES = 8, 10  # of reweighting; of conjugate gradients, each: the next weights ask for other heights
BESIDE = OUTLIER / 2.0  # the same for pairs beside a cut one: a line is followed to where it fades out
MAX_FOLLOWED = 8  # pairs, each time
MIN_PAIRS = 4  # pairs that touch


def contradict(levels: Sequence[PyramidLevel]) -> bool:
    """Return whether a curl is significant at any resolution: whether a search for jumps is worth while."""
    return any(np.abs(level.curl()).max(initial=0.0) >= MIN_CURL for level in levels)


def discontinuities(
    grid: HeightGrid,
    levels: Sequence[PyramidLevel],
    differences: Float[np.ndarray, " edges"],
    variances: Float[np.ndarray, " edges"],
    report_progress: ReportProgress,
) -> tuple[Bool[np.ndarray, " edges"], Float[np.ndarray, " texels"]]:
    """Return which pairs are cut, and the heights that go with them.

    Args:
        grid: The texels.
        levels: The differences at several resolutions, without those that cannot show a jump.
        differences: Of each pair.
        variances: Of each pair.
        report_progress: Told how far the search is.
    """
    testable = np.isfinite(grid.edges(*levels[0].variances))
    base = 1.0 / variances
    weights, u = grid.edges(*seeds(levels[:SEED_LEVELS])), None
    square = np.zeros(testable.shape)
    for step in range(STEPS):
        report_progress("discontinuities", step / STEPS)
        u = HeightSystem(grid, base * weights).solve(differences, u, most=SOLVES)
        square = np.where(testable, (grid.step(u) - differences) ** 2 * base, 0.0)
        weights = 1.0 / (1.0 + square)
    assert u is not None
    cut = square > OUTLIER**2
    for _ in range(3):
        cut = _in_lines(grid, cut)  # a single pair must show again that it is a jump, now that it is not left out
        u = HeightSystem(grid, base * np.where(cut, TINY, 1.0)).solve(differences, u)
        square = np.where(testable, (grid.step(u) - differences) ** 2 * base, 0.0)
        cut = _followed(grid, square > OUTLIER**2, square > BESIDE**2)
    return cut, u


def seeds(levels: Sequence[PyramidLevel]) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights to begin with, across and down: low beside a large curl, of this level and of coarser ones."""
    finest, *coarser = levels
    square = finest.curl() ** 2
    rows, columns = np.pad(square, ((1, 1), (0, 0))), np.pad(square, ((0, 0), (1, 1)))
    across = 1.0 / (1.0 + np.maximum(rows[:-1], rows[1:]))
    down = 1.0 / (1.0 + np.maximum(columns[:, :-1], columns[:, 1:]))
    if coarser and min(coarser[0].inside.shape) > 1:
        far_across, far_down = seeds(coarser)
        across *= _spread(far_across, across.shape)
        down *= _spread(far_down.T, down.T.shape).T
    return across, down


def _spread(coarse: Float[np.ndarray, "h v"], shape: tuple[int, int]) -> Float[np.ndarray, "h2 v2"]:
    """Return weights across for the finer level: the lowest of the coarse differences that a fine one is a part of."""
    fine = np.ones(shape)
    rows, pairs = 2 * coarse.shape[0], coarse.shape[1]
    for k in range(3):
        part = fine[:rows, k : k + 2 * pairs : 2]
        np.minimum(part, np.repeat(coarse, 2, axis=0), out=part)
    return fine


def _in_lines(grid: HeightGrid, cut: Bool[np.ndarray, " edges"]) -> Bool[np.ndarray, " edges"]:
    """Return the cut pairs of which several touch."""
    near = np.zeros(grid.size, bool)
    near[grid.start[cut]] = near[grid.end[cut]] = True
    of_pair = connected(grid.image(near), diagonally=True)[grid.inside][grid.start[cut]]
    found = cut.copy()
    found[cut] = np.bincount(of_pair)[of_pair] >= MIN_PAIRS
    return found


def _followed(
    grid: HeightGrid, cut: Bool[np.ndarray, " edges"], candidates: Bool[np.ndarray, " edges"]
) -> Bool[np.ndarray, " edges"]:
    """Return the cut pairs and the candidates that continue them."""
    for _ in range(MAX_FOLLOWED):
        more = cut | (candidates & _beside(grid, cut))
        if (more == cut).all():
            break
        cut = more
    return cut


def _beside(grid: HeightGrid, cut: Bool[np.ndarray, " edges"]) -> Bool[np.ndarray, " edges"]:
    """Return which pairs share four neighbouring texels with another pair that is cut."""
    across, down = (image.astype(np.int8) for image in grid.images(cut))
    around = across[:-1] + across[1:] + down[:, :-1] + down[:, 1:]
    rows, columns = np.pad(around, ((1, 1), (0, 0))), np.pad(around, ((0, 0), (1, 1)))
    return grid.edges(rows[:-1] + rows[1:] - 2 * across > 0, columns[:, :-1] + columns[:, 1:] - 2 * down > 0)
