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
import scipy.ndimage
from jaxtyping import Bool, Float, Num

from ...core.progress import ReportProgress
from ...core.robust_scale import OUTLIER
from ...core.thresholds import TINY
from .curl import around
from .regions import connected, image_of
from .system import HeightGrid, HeightSystem

MIN_CURL = 5.5  # curl beyond so many deviations begins a search: noise does so once in 26 million texels
SEED_LEVELS = 3
STEPS, SOLVES = 8, 10  # of reweighting; of conjugate gradients, each: the next weights ask for other heights
BESIDE = OUTLIER / 2.0  # the same for pairs beside a cut one: a line is followed to where it fades out
MAX_FOLLOWED = 8  # pairs, each time
MIN_PAIRS = 4  # pairs that touch


def contradict(curls: Sequence[Float[np.ndarray, "_ _"]]) -> bool:
    """Return whether a curl is significant at any resolution: whether a search for jumps is worth while."""
    return max((float(np.abs(curl).max(initial=0.0)) for curl in curls), default=0.0) >= MIN_CURL


def discontinuities(
    grid: HeightGrid,
    curls: Sequence[Float[np.ndarray, "_ _"]],
    differences: Float[np.ndarray, " edges"],
    variances: Float[np.ndarray, " edges"],
    testable: Bool[np.ndarray, " edges"],
    report_progress: ReportProgress,
) -> tuple[Bool[np.ndarray, " edges"], Float[np.ndarray, " texels"]]:
    """Return which pairs are cut, and the heights that go with them.

    Args:
        grid: The texels.
        curls: In standard deviations, at several resolutions.
        differences: Of each pair.
        variances: Of each pair.
        testable: Pairs that can show a jump.
        report_progress: Told how far the search is.
    """
    square, u = _doubt(curls[:SEED_LEVELS])[grid.pair] - 1.0, np.zeros(grid.size)

    def solved(weights: Float[np.ndarray, " edges"], **options: int) -> tuple[np.ndarray, np.ndarray]:
        found = HeightSystem(grid, weights / variances).solve(differences, u, **options)
        return found, np.where(testable, (grid.step(found) - differences) ** 2 / variances, 0.0)

    for step in range(STEPS):
        report_progress("discontinuities", step / STEPS)
        u, square = solved(1.0 / (1.0 + square), most=SOLVES)
    cut = square > OUTLIER**2
    for _ in range(3):
        cut = _in_lines(grid, cut)  # a single pair must show again that it is a jump, now that it is not left out
        u, square = solved(np.where(cut, TINY, 1.0))
        cut = _followed(grid, square > OUTLIER**2, square > BESIDE**2)
    return cut, u


def _doubt(curls: Sequence[Float[np.ndarray, "_ _"]]) -> Float[np.ndarray, "2 _ _"]:
    """Return 1 + curl^2 beside each pair, the larger of two, times the most doubt of coarser pairs that contain it."""
    finest, *coarser = curls
    doubt = 1.0 + np.maximum(*_beside(finest**2))
    if coarser:
        within = _doubt(coarser).repeat(2, axis=1).repeat(2, axis=2)
        _, rows, columns = within.shape
        for axis in (1, 0):  # along the pairs, every second one is in two of the coarser level
            doubt[1 - axis, :rows, :columns] *= scipy.ndimage.maximum_filter1d(within[1 - axis], 2, axis)
    return doubt


def _beside(of: Num[np.ndarray, "g v"]) -> tuple[np.ndarray, np.ndarray]:
    """Return what is said of the four texels on one side of each pair and on the other; 0 beyond the border."""
    padded = np.pad(of, 1)
    return np.stack([padded[:-1, 1:], padded[1:, :-1]]), padded[1:, 1:]


def touched(grid: HeightGrid, cut: Bool[np.ndarray, " edges"]) -> Bool[np.ndarray, "h w"]:
    """Return the texels of the pairs that are cut."""
    near = np.zeros(grid.size, bool)
    near[grid.start[cut]] = near[grid.end[cut]] = True
    return image_of(grid.inside, near)


def _in_lines(grid: HeightGrid, cut: Bool[np.ndarray, " edges"]) -> Bool[np.ndarray, " edges"]:
    """Return the cut pairs of which several touch."""
    of_pair = connected(touched(grid, cut), diagonally=True)[grid.inside][grid.start[cut]]
    found = cut.copy()
    found[cut] = np.bincount(of_pair)[of_pair] >= MIN_PAIRS
    return found


def _followed(
    grid: HeightGrid, cut: Bool[np.ndarray, " edges"], candidates: Bool[np.ndarray, " edges"]
) -> Bool[np.ndarray, " edges"]:
    """Return the cut pairs and the candidates that continue them."""
    for _ in range(MAX_FOLLOWED):
        one, other = _beside(around(image_of(grid.pair, cut.astype(int)), 1))
        cut = cut | (candidates & (one + other > 0)[grid.pair])
    return cut
