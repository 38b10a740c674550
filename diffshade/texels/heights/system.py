"""The linear system of heights: weighted least squares of the differences, solved by algebraic multigrid.

    min sum_e w_e (u_q - u_p - d_e)^2

Its matrix is the Laplacian of the texels' graph. Conjugate gradients are preconditioned by a multigrid cycle (pyamg).
The weights are 1 over variances, so that the sum is in units of the noise: what a solution still lacks is too.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ...core.thresholds import TINY
from .regions import following


class HeightGrid(NamedTuple):
    """The texels of a mask in the order of the image, and the pairs of neighbours among them."""

    inside: Bool[np.ndarray, "h w"]
    pair: Bool[np.ndarray, "2 h w"]
    """Where a pair begins: across, and down."""
    start: Int[np.ndarray, " edges"]
    end: Int[np.ndarray, " edges"]
    """The texels of each pair, all pairs across before all pairs down."""

    @classmethod
    def of(cls, inside: Bool[np.ndarray, "h w"]) -> HeightGrid:
        """Return the grid of a mask."""
        number = np.cumsum(inside, dtype=np.int32).reshape(inside.shape) - 1
        pair = inside & following(inside)
        return cls(inside, pair, np.broadcast_to(number, pair.shape)[pair], following(number)[pair])

    @property
    def size(self) -> int:
        """Number of texels."""
        return int(np.count_nonzero(self.inside))

    def step(self, u: Float[np.ndarray, "texels *of"]) -> Float[np.ndarray, "edges *of"]:
        """Return the difference of each pair."""
        return u[self.end] - u[self.start]

    def mean(
        self, of: Float[np.ndarray, "texels 3"], share: Float[np.ndarray, " edges"]
    ) -> Float[np.ndarray, "edges 3"]:
        """Return the mean of each pair, to which its first texel has this share."""
        return share[:, None] * of[self.start] + (1.0 - share)[:, None] * of[self.end]

    def laplacian(self, weights: Float[np.ndarray, " edges"]) -> scipy.sparse.csr_array:
        """Return the weighted Laplacian, made regular."""
        graph = scipy.sparse.coo_array((weights, (self.start, self.end)), (self.size, self.size))
        matrix = scipy.sparse.csgraph.laplacian(graph, symmetrized=True)
        diagonal = matrix.diagonal()
        return (matrix + scipy.sparse.diags_array(np.where(diagonal > 0, TINY * diagonal, 1.0))).tocsr()


class HeightSystem:
    """The matrix of a grid's weighted differences, and one V-cycle of classical multigrid (Ruge and Stuben 1987)."""

    def __init__(self, grid: HeightGrid, weights: Float[np.ndarray, " edges"]):
        import pyamg

        self.grid, self.weights, self.matrix = grid, weights, grid.laplacian(weights)
        before, after = [("gauss_seidel", {"sweep": way}) for way in ("forward", "backward")]  # symmetric together
        self._cycle = pyamg.ruge_stuben_solver(
            self.matrix,
            interpolation="direct",
            presmoother=before,
            postsmoother=after,
            max_coarse=200,
            coarse_solver="splu",
        ).aspreconditioner(cycle="V")

    def solve(
        self,
        differences: Float[np.ndarray, " edges"],
        start: Float[np.ndarray, " texels"] | None = None,
        *,
        tolerance: float = 1.0,
        most: int = 200,
    ) -> Float[np.ndarray, " texels"]:
        """Return the heights that fit the differences best.

        Args:
            differences: Of each pair.
            start: Heights to begin with; 0 by default.
            tolerance: Ends where the residuals of all pairs together, as a root of squares, are nearer to the best ones
                than this many standard deviations, as the preconditioner estimates.
            most: Most steps.
        """
        from pyamg.krylov import cg

        flow = self.weights * differences
        b = np.bincount(self.grid.end, flow, self.grid.size) - np.bincount(self.grid.start, flow, self.grid.size)
        with warnings.catch_warnings():  # it changes the filters of all
            found, _ = cg(self.matrix, b, start, tolerance, "rMr", maxiter=most, M=self._cycle)
        return found
