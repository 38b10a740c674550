"""The linear system of heights: weighted least squares of the differences, solved by algebraic multigrid.

    min sum_e w_e (u_q - u_p - d_e)^2

Its matrix is the Laplacian of the texels' graph. Conjugate gradients are preconditioned by a multigrid cycle (pyamg).
The weights are 1 over variances, so that the sum is in units of the noise: what a solution still lacks is too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ...core.thresholds import TINY


class HeightGrid(NamedTuple):
    """The texels of a mask in the order of the image, and the pairs of neighbours among them."""

    inside: Bool[np.ndarray, "h w"]
    number: Int[np.ndarray, "h w"]
    """Number of each texel; -1 outside."""
    start: Int[np.ndarray, " edges"]
    end: Int[np.ndarray, " edges"]
    """The texels of each pair, all pairs across before all pairs down."""
    across: Bool[np.ndarray, "h v"]
    down: Bool[np.ndarray, "g w"]
    """Where a pair begins."""

    @classmethod
    def of(cls, inside: Bool[np.ndarray, "h w"]) -> HeightGrid:
        """Return the grid of a mask."""
        number = np.full(inside.shape, -1, np.int32)
        number[inside] = np.arange(inside.sum(), dtype=np.int32)
        across, down = inside[:, :-1] & inside[:, 1:], inside[:-1] & inside[1:]
        start = np.concatenate([number[:, :-1][across], number[:-1][down]])
        end = np.concatenate([number[:, 1:][across], number[1:][down]])
        return cls(inside, number, start, end, across, down)

    @property
    def size(self) -> int:
        """Number of texels."""
        return int(self.number.max()) + 1

    def edges(self, across: np.ndarray, down: np.ndarray) -> np.ndarray:
        """Return numbers of pairs, given as arrays of the image's shape, as one row."""
        return np.concatenate([across[self.across], down[self.down]])

    def images(self, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers of pairs as arrays of the image's shape, across and down; 0 where there is no pair."""
        count = int(self.across.sum())
        across, down = (np.zeros(pairs.shape, edges.dtype) for pairs in (self.across, self.down))
        across[self.across], down[self.down] = edges[:count], edges[count:]
        return across, down

    def image(self, texels: np.ndarray, outside: int = 0) -> np.ndarray:
        """Return numbers of texels as an array of the image's shape."""
        found = np.full(self.inside.shape, outside, texels.dtype)
        found[self.inside] = texels
        return found

    def step(self, u: Float[np.ndarray, " texels"]) -> Float[np.ndarray, " edges"]:
        """Return the difference of each pair."""
        return u[self.end] - u[self.start]

    def gather(self, edges: Float[np.ndarray, " edges"]) -> Float[np.ndarray, " texels"]:
        """Return what flows into each texel: the transpose of `step`."""
        into = np.bincount(self.end, edges, self.size) - np.bincount(self.start, edges, self.size)
        return into.astype(float)  # NumPy counts in whole numbers where there are no pairs


class HeightSystem:
    """The matrix of a grid's weighted differences, and its multigrid hierarchy."""

    def __init__(self, grid: HeightGrid, weights: Float[np.ndarray, " edges"]):
        self.grid, self.weights = grid, weights
        self.matrix = laplacian(grid, weights)
        self._cycle = _multigrid(self.matrix)

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
        b = self.grid.gather(self.weights * differences)
        x = np.zeros_like(b) if start is None else start.copy()
        r = b - self.matrix @ x
        z = self._cycle(r)
        p, energy = z, float(r @ z)
        for _ in range(most):
            if energy <= tolerance**2:
                break
            q = self.matrix @ p
            step = energy / float(p @ q)
            x += step * p
            r -= step * q
            z = self._cycle(r)
            last, energy = energy, float(r @ z)
            p = z + (energy / last) * p
        return x


def laplacian(grid: HeightGrid, weights: Float[np.ndarray, " edges"]) -> scipy.sparse.csr_array:
    """Return the weighted Laplacian of a grid, made regular."""
    size = grid.size
    diagonal = np.bincount(grid.start, weights, size) + np.bincount(grid.end, weights, size)
    own = np.arange(size, dtype=np.int32)
    rows = np.concatenate([grid.start, grid.end, own])
    columns = np.concatenate([grid.end, grid.start, own])
    values = np.concatenate([-weights, -weights, np.where(diagonal > 0, diagonal * (1.0 + TINY), 1.0)])
    return scipy.sparse.coo_array((values, (rows, columns)), (size, size)).tocsr()


def _multigrid(matrix: scipy.sparse.csr_array) -> Callable[[np.ndarray], np.ndarray]:
    """Return one V-cycle of classical algebraic multigrid (Ruge and Stuben 1987)."""
    import pyamg

    before, after = [("gauss_seidel", {"sweep": way}) for way in ("forward", "backward")]  # symmetric together
    levels = pyamg.ruge_stuben_solver(
        matrix,
        interpolation="direct",
        presmoother=before,
        postsmoother=after,
        max_coarse=200,
        coarse_solver="splu",
    )
    return levels.aspreconditioner(cycle="V").matvec
