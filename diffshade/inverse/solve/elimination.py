"""Elimination: normal equations in the shape of an arrow, solved block by block (Triggs et al. 2000, section 6)."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..unknowns.visibility import Arrow


class Dense(eqx.Module):
    """A symmetric matrix."""

    whole: Float[Array, "p p"]

    def diagonal(self) -> Float[Array, " p"]:
        """Return the diagonal."""
        return jnp.diagonal(self.whole)

    def plus(self, diagonal: Float[Array, " p"]) -> Dense:
        """Return the matrix with numbers added to its diagonal."""
        return Dense(self.whole + jnp.diag(diagonal))

    def scaled(self, by: Float[Array, " p"]) -> Dense:
        """Return the matrix with rows and columns multiplied."""
        return Dense(self.whole * jnp.outer(by, by))

    def times(self, z: Float[Array, " p"]) -> Float[Array, " p"]:
        """Return the product with a vector."""
        return self.whole @ z

    def solve(self, b: Float[Array, " p"]) -> Float[Array, " p"]:
        """Return A^-1 b of a positive definite A."""
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(self.whole), b)


class Arrowhead(eqx.Module):
    """A symmetric matrix that is 0 between its blocks: border first, then block after block; 0 where it is padded."""

    border: Float[Array, "f f"]
    side: Float[Array, "blocks g f"]
    blocks: Float[Array, "blocks g g"]

    def _parts(self, z: Float[Array, " n"]) -> tuple[Float[Array, " f"], Float[Array, "blocks g"]]:
        f = len(self.border)
        return z[:f], z[f:].reshape(self.blocks.shape[:2])

    def diagonal(self) -> Float[Array, " n"]:
        """Return the diagonal."""
        of_blocks = jnp.diagonal(self.blocks, axis1=1, axis2=2)
        return jnp.concatenate([jnp.diagonal(self.border), of_blocks.ravel()])

    def plus(self, diagonal: Float[Array, " n"]) -> Arrowhead:
        """Return the matrix with numbers added to its diagonal."""
        of_border, of_blocks = self._parts(diagonal)
        blocks = self.blocks + of_blocks[:, :, None] * jnp.eye(self.blocks.shape[1])[None]
        return Arrowhead(self.border + jnp.diag(of_border), self.side, blocks)

    def scaled(self, by: Float[Array, " n"]) -> Arrowhead:
        """Return the matrix with rows and columns multiplied."""
        of_border, of_blocks = self._parts(by)
        return Arrowhead(
            self.border * jnp.outer(of_border, of_border),
            self.side * of_blocks[:, :, None] * of_border[None, None],
            self.blocks * of_blocks[:, :, None] * of_blocks[:, None, :],
        )

    def times(self, z: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return the product with a vector."""
        z_F, z_G = self._parts(z)
        of_border = self.border @ z_F + jnp.einsum("gif,gi->f", self.side, z_G)
        return jnp.concatenate([of_border, (self.side @ z_F + jnp.einsum("gij,gj->gi", self.blocks, z_G)).ravel()])

    def solve(self, b: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return A^-1 b of a positive definite A, in a time linear in the number of blocks.

        With the border F and the blocks G, $x_F = (A_{FF} - A_{FG} A_{GG}^{-1} A_{GF})^{-1} (b_F - A_{FG} A_{GG}^{-1}
        b_G)$ and $x_G = A_{GG}^{-1} (b_G - A_{GF} x_F)$.
        """
        b_F, b_G = self._parts(b)
        solved = jax.vmap(lambda M, of: jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(M), of))(
            self.blocks, jnp.concatenate([self.side, b_G[..., None]], -1)
        )
        from_F, from_b = solved[..., :-1], solved[..., -1]
        left = self.border - jnp.einsum("gif,gih->fh", self.side, from_F)
        x_F = Dense(left).solve(b_F - jnp.einsum("gif,gi->f", self.side, from_b))
        return jnp.concatenate([x_F, (from_b - from_F @ x_F).ravel()])


Symmetric = Dense | Arrowhead


def in_order(z: Float[Array, " p"], arrow: Arrow | None) -> Float[Array, " n"]:
    """Return a vector in the order of `symmetric`, 0 where it is padded."""
    return z if arrow is None else z.at[_order(arrow)].get(mode="fill", fill_value=0)


def out_of_order(z: Float[Array, " n"], p: int, arrow: Arrow | None) -> Float[Array, " p"]:
    """Return the vector of p numbers whose `in_order` this is."""
    return z if arrow is None else jnp.zeros(p, z.dtype).at[_order(arrow)].set(z, mode="drop")


def symmetric(A: Float[Array, "p p"], arrow: Arrow | None) -> Symmetric:
    """Return a symmetric matrix, which is 0 between the blocks of an arrow, in a shape that is solved quickly."""
    if arrow is None:
        return Dense(A)
    F, G = arrow.border, arrow.blocks
    side = A.at[G[:, :, None], F].get(mode="fill", fill_value=0)
    return Arrowhead(A[F][:, F], side, A.at[G[:, :, None], G[:, None, :]].get(mode="fill", fill_value=0))


def _order(arrow: Arrow) -> Array:
    return jnp.concatenate([arrow.border, arrow.blocks.ravel()])
