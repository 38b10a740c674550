"""Linear systems: small systems solved at all texels at once, unrolled element by element instead of by LAPACK."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Float

from ..core.fields import Array
from ..core.thresholds import TINY

Numbers = Float[Array, "..."]
Matrix = Sequence[Sequence[Numbers]]


def cholesky(A: Matrix) -> list[list[Numbers]]:
    """Return L of L L^T = A + ridge, with 1/L_jj on its diagonal; a column of zeros gets L_jj = 1."""
    L: list[list[Numbers]] = []
    for i, row in enumerate(A):
        diagonal = row[i]
        L.append([])
        for j in range(i):
            L[i].append((row[j] - sum((L[i][k] * L[j][k] for k in range(j)), 0.0)) * L[j][j])
        rest = diagonal * (1.0 + TINY) - sum((L[i][k] ** 2 for k in range(i)), 0.0)
        pivot = jnp.where(rest > 0.1 * TINY * diagonal, rest, TINY * diagonal)
        L[i].append(1.0 / jnp.sqrt(jnp.where(diagonal > 0.0, pivot, 1.0)))
    return L


def forward(L: Matrix, b: Sequence[Numbers]) -> list[Numbers]:
    """Return L^-1 b."""
    z: list[Numbers] = []
    for i, row in enumerate(L):
        z.append((b[i] - sum((row[k] * z[k] for k in range(i)), 0.0)) * row[i])
    return z


def backward(L: Matrix, z: Sequence[Numbers]) -> list[Numbers]:
    """Return L^-T z."""
    p = len(L)
    x = list(z)
    for i in reversed(range(p)):
        x[i] = (x[i] - sum((L[k][i] * x[k] for k in range(i + 1, p)), 0.0)) * L[i][i]
    return x


def solve(A: Matrix, b: Sequence[Numbers]) -> list[Numbers]:
    """Return A^-1 b."""
    L = cholesky(A)
    return backward(L, forward(L, b))


def inverse_diagonal(A: Matrix) -> list[Numbers]:
    """Return the diagonal of A^-1, infinite where a column of A is zero."""
    L = cholesky(A)
    found: list[Numbers] = []
    for j in range(len(A)):
        unit = [jnp.ones_like(A[j][j]) if i == j else jnp.zeros_like(A[j][j]) for i in range(len(A))]
        found.append(jnp.where(A[j][j] > 0.0, sum((z**2 for z in forward(L, unit)), 0.0), jnp.inf))
    return found


def nonnegative(A: Matrix, b: Sequence[Numbers]) -> tuple[list[Numbers], Numbers]:
    """Return the x >= 0 that maximises b.x - x.A x/2, and b.x there, which is twice the maximum.

    x is the unconstrained optimum where that has no negative element, else the best optimum with an element held at 0.
    With up to three elements the recursion visits every face of the octant (Lawson and Hanson 1974, chapter 23, treat
    any number).
    """
    if not b:
        return [], jnp.zeros((1, 1))
    x = solve(A, b)
    gain = sum((bi * xi for bi, xi in zip(b, x, strict=True)), 0.0)
    inside = jnp.all(jnp.stack([xi >= 0.0 for xi in x]), 0)
    best = [jnp.zeros_like(xi) for xi in x]
    most = jnp.zeros_like(gain)
    for held in range(len(b)):
        rest = [i for i in range(len(b)) if i != held]
        if not rest:
            break
        y, gained = nonnegative([[A[i][j] for j in rest] for i in rest], [b[i] for i in rest])
        y.insert(held, jnp.zeros_like(gained))
        better = gained > most
        best = [jnp.where(better, yi, xi) for yi, xi in zip(y, best, strict=True)]
        most = jnp.where(better, gained, most)
    return [jnp.where(inside, xi, yi) for xi, yi in zip(x, best, strict=True)], jnp.where(inside, gain, most)
