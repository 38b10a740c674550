"""Arrowheads: the inverse of a matrix in which most unknowns touch few others, such as those of each light."""

from __future__ import annotations

import numpy as np
import scipy
from jaxtyping import Float

FEWEST = 64  # unknowns; with fewer, the dense inverse is as fast
WIDE = 0.25  # an unknown that touches more than this fraction of the others belongs to the border

Matrix = Float[np.ndarray, "p p"]


def regular_inverse(A: Matrix, least: float) -> Matrix | None:
    """Return the inverse of an arrowhead whose smallest eigenvalue is at least `least` of its largest.

    None is returned for any other matrix, and where that is not certain: |A| |A^-1| is below 1/least, in the largest
    sum of a column.
    """
    if len(A) < FEWEST:
        return None
    try:
        C = _by_blocks(A)
    except np.linalg.LinAlgError:  # singular
        return None
    if C is None or not np.abs(A).sum(0).max() * np.abs(C).sum(0).max() < 1.0 / least:
        return None
    return C if (np.diag(C) > 0.0).all() else None


def _by_blocks(A: Matrix) -> Matrix | None:
    """Return the inverse of a border F and blocks G that do not touch each other; None where there are no such blocks.

    $C_{FF} = (A_{FF} - A_{FG} A_{GG}^{-1} A_{GF})^{-1}$, $C_{GF} = -W C_{FF}$ and $C_{GG} = A_{GG}^{-1} + W C_{FF}
    W^T$ with $W = A_{GG}^{-1} A_{GF}$.
    """
    touches = A != 0.0
    wide = touches.mean(0) > WIDE
    F, G = np.flatnonzero(wide), np.flatnonzero(~wide)
    _, label = scipy.sparse.csgraph.connected_components(scipy.sparse.csr_array(touches[np.ix_(G, G)]), directed=False)
    sizes = np.bincount(label, minlength=1)
    if len(F) + sizes.max() > len(A) / 2:
        return None
    order, ends = np.argsort(label, kind="stable"), np.cumsum(sizes)
    C = np.zeros_like(A)
    for size in np.unique(sizes):  # blocks of one size are inverted together
        of = G[order[(ends[sizes == size] - size)[:, None] + np.arange(size)]]
        rows, columns = of[:, :, None], of[:, None, :]
        C[rows, columns] = np.linalg.inv(A[rows, columns])
        C[of[:, :, None], F] = C[rows, columns] @ A[of[:, :, None], F]
    W = C[np.ix_(G, F)]
    C_FF = np.linalg.inv(A[np.ix_(F, F)] - A[np.ix_(F, G)] @ W)
    C[np.ix_(G, G)] += (W @ C_FF) @ W.T
    C[np.ix_(G, F)] = -W @ C_FF
    C[np.ix_(F, G)] = C[np.ix_(G, F)].T
    C[np.ix_(F, F)] = C_FF
    return C
