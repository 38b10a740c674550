"""Elimination: normal equations in the shape of an arrow, solved block by block (Triggs et al. 2000, section 6)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..unknowns.visibility import Arrow


def solve(A: Float[Array, "p p"], b: Float[Array, " p"], arrow: Arrow | None) -> Float[Array, " p"]:
    """Return A^-1 b of a positive definite A, which is 0 between the blocks of an arrow.

    With the border F and the blocks G of it, $x_F = (A_{FF} - A_{FG} A_{GG}^{-1} A_{GF})^{-1} (b_F - A_{FG} A_{GG}^{-1}
    b_G)$ and $x_G = A_{GG}^{-1} (b_G - A_{GF} x_F)$: linear in the number of blocks.
    """
    if arrow is None:
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(A), b)
    F, G = arrow.border, arrow.blocks
    inside = len(b) > G
    both = inside[:, :, None] & inside[:, None, :]
    A_GG = jnp.where(both, A.at[G[:, :, None], G[:, None, :]].get(mode="fill", fill_value=0.0), jnp.eye(G.shape[1]))
    A_GF = A.at[G[:, :, None], F].get(mode="fill", fill_value=0.0)
    b_G = b.at[G].get(mode="fill", fill_value=0.0)
    solved = jax.vmap(lambda M, of: jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(M), of))(
        A_GG, jnp.concatenate([A_GF, b_G[..., None]], -1)
    )
    from_F, from_b = solved[..., :-1], solved[..., -1]
    A_FF = A[F][:, F] - jnp.einsum("gif,gih->fh", A_GF, from_F)
    b_F = b[F] - jnp.einsum("gif,gi->f", A_GF, from_b)
    x_F = jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(A_FF), b_F)
    x_G = from_b - from_F @ x_F
    return jnp.zeros_like(b).at[F].set(x_F).at[G].set(x_G, mode="drop")
