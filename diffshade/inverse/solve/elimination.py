"""Elimination: a symmetric matrix of the unknowns, whole, or as an arrow that is solved block by block."""

from __future__ import annotations

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...core import fields
from ..unknowns.visibility import Arrow

Shared = TypeVar("Shared", Array, np.ndarray)


def eliminate(inverses: Shared, side: Shared, right: Shared) -> tuple[Shared, Shared, Shared, Shared]:
    """Return B^-1 C and B^-1 b of blocks of unknowns, the sum of C^T B^-1 C, and C^T B^-1 b of each block.

    The Schur complement of the blocks is the matrix of the border less the third, with a right side that is less the
    sum of the last (Triggs et al. 2000). The arrays are NumPy's or JAX's.

    Args:
        inverses: B^-1 [blocks, g, g].
        side: C, the rows that couple each block to the border [blocks, g, f].
        right: b, right sides of the blocks [blocks, g, k].
    """
    by_border, alone, rows = inverses @ side, inverses @ right, (len(side) * side.shape[1], side.shape[2])
    return by_border, alone, side.reshape(rows).T @ by_border.reshape(rows), side.swapaxes(1, 2) @ alone


class Dense(eqx.Module):
    """A symmetric matrix."""

    whole: Float[fields.Array, "p p"]

    def part(self, p: int, _: None) -> Dense:
        """Return the rows and columns of the first p unknowns."""
        return Dense(self.whole[:p, :p])

    def as_matrix(self) -> Float[fields.Array, "p p"]:
        """Return all numbers."""
        return self.whole

    def diagonal(self) -> Float[Array, " p"]:
        """Return the diagonal."""
        return jnp.diagonal(self.whole)

    def added(self, index: Int[Array, "k m"] | None, parts: Float[Array, "k m m"]) -> Dense:
        """Return the matrix with others added, each at the rows and columns of its indices; p is nowhere.

        Without indices they are added as they are.
        """
        if index is None:
            return Dense(self.whole + parts.sum(0))
        return Dense(jnp.asarray(self.whole).at[index[:, :, None], index[:, None, :]].add(parts, mode="drop"))

    def plus(self, diagonal: Float[Array, " p"]) -> Dense:
        """Return the matrix with numbers added to its diagonal."""
        return Dense(self.whole + jnp.diag(diagonal))

    def scaled(self, by: Float[Array, " p"]) -> Dense:
        """Return the matrix with rows and columns multiplied."""
        return Dense(self.whole * jnp.outer(by, by))

    def times(self, z: Float[Array, " p"]) -> Float[fields.Array, " p"]:
        """Return the product with a vector."""
        return self.whole @ z

    def solve(self, b: Float[Array, " p"]) -> Float[Array, " p"]:
        """Return A^-1 b of a positive definite A."""
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(self.whole), b)


class Arrowhead(eqx.Module):
    """A symmetric matrix that is 0 between the blocks of an arrow: never laid out whole, and linear in the blocks."""

    border: Float[Array, "f f"]
    side: Float[Array, "blocks g f"]
    blocks: Float[Array, "blocks g g"]
    """0 where a block is padded."""
    arrow: Arrow
    p: int = eqx.field(static=True)

    def part(self, p: int, arrow: Arrow) -> Arrowhead:
        """Return the rows and columns of the first p unknowns, which the first blocks of the arrow have."""
        n = len(arrow.blocks)
        return Arrowhead(self.border, self.side[:n], self.blocks[:n], arrow, p)

    def _parts(self, z: Float[Array, " p"]) -> tuple[Float[Array, " f"], Float[Array, "blocks g"]]:
        return z[self.arrow.border], z.at[self.arrow.blocks].get(mode="fill", fill_value=0)

    def _whole(self, of_border: Float[Array, " f"], of_blocks: Float[Array, "blocks g"]) -> Float[Array, " p"]:
        z = jnp.zeros(self.p, of_border.dtype).at[self.arrow.border].set(of_border)
        return z.at[self.arrow.blocks].set(of_blocks, mode="drop")

    def _with(self, border: Array, side: Array, blocks: Array) -> Arrowhead:
        return Arrowhead(border, side, blocks, self.arrow, self.p)

    def as_matrix(self) -> Float[Array, "p p"]:
        """Return all numbers."""
        return jax.vmap(self.times)(jnp.eye(self.p))

    def diagonal(self) -> Float[Array, " p"]:
        """Return the diagonal."""
        return self._whole(jnp.diagonal(self.border), jnp.diagonal(self.blocks, axis1=1, axis2=2))

    def added(self, index: Int[Array, "k m"], parts: Float[Array, "k m m"]) -> Arrowhead:
        """Return the matrix with small ones added, each at the rows and columns of its indices; p is nowhere.

        None of the small ones may have unknowns of two blocks, and all their numbers must be finite.
        """
        F, G = self.arrow.border, jnp.asarray(self.arrow.blocks)
        block = jnp.full(self.p + 1, len(G)).at[G].set(jnp.arange(len(G))[:, None]).at[self.p].set(len(G))
        of = block[index].min(1)  # the block of each small one; len(G) where it has none
        # products with zeros and ones: XLA's CPU backend scatters a number at a time (7 ms a step at 96 views, not 4)
        among_F = jnp.where(index[:, :, None] == F[None, None], 1.0, 0.0)
        members = G.at[of].get(mode="fill", fill_value=self.p)[:, None]
        among_G = jnp.where((index[:, :, None] == members) & (members < self.p), 1.0, 0.0)
        by_F, by_G = parts @ among_F, parts @ among_G
        return self._with(
            self.border + jnp.einsum("kmf,kmh->fh", among_F, by_F),
            self.side.at[of].add(jnp.einsum("kmg,kmf->kgf", among_G, by_F), mode="drop"),
            self.blocks.at[of].add(jnp.einsum("kmg,kmh->kgh", among_G, by_G), mode="drop"),
        )

    def plus(self, diagonal: Float[Array, " p"]) -> Arrowhead:
        """Return the matrix with numbers added to its diagonal."""
        of_border, of_blocks = self._parts(diagonal)
        blocks = self.blocks + of_blocks[:, :, None] * jnp.eye(self.blocks.shape[1])[None]
        return self._with(self.border + jnp.diag(of_border), self.side, blocks)

    def scaled(self, by: Float[Array, " p"]) -> Arrowhead:
        """Return the matrix with rows and columns multiplied."""
        of_border, of_blocks = self._parts(by)
        return self._with(
            self.border * jnp.outer(of_border, of_border),
            self.side * of_blocks[:, :, None] * of_border[None, None],
            self.blocks * of_blocks[:, :, None] * of_blocks[:, None, :],
        )

    def times(self, z: Float[Array, " p"]) -> Float[Array, " p"]:
        """Return the product with a vector."""
        z_F, z_G = self._parts(z)
        of_border = self.border @ z_F + jnp.einsum("gif,gi->f", self.side, z_G)
        return self._whole(of_border, self.side @ z_F + jnp.einsum("gij,gj->gi", self.blocks, z_G))

    def solve(self, b: Float[Array, " p"]) -> Float[Array, " p"]:
        """Return A^-1 b of a positive definite A, in a time linear in the number of blocks.

        With the border F and the blocks G, $x_F = (A_{FF} - A_{FG} A_{GG}^{-1} A_{GF})^{-1} (b_F - A_{FG} A_{GG}^{-1}
        b_G)$ and $x_G = A_{GG}^{-1} (b_G - A_{GF} x_F)$.
        """
        b_F, b_G = self._parts(b)
        one = jnp.eye(self.blocks.shape[1])
        padded = jnp.where(self.arrow.blocks < self.p, 0.0, 1.0)
        inverses = jax.vmap(lambda M: jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(M), one))(
            self.blocks + padded[:, :, None] * one[None]
        )
        by_border, alone, of_matrix, of_right = eliminate(inverses, self.side, b_G[:, :, None])
        x_F = Dense(self.border - of_matrix).solve(b_F - of_right[..., 0].sum(0))
        return self._whole(x_F, alone[..., 0] - by_border @ x_F)


Symmetric = Dense | Arrowhead


def nothing(p: int, arrow: Arrow | None) -> Symmetric:
    """Return the matrix of zeros of p unknowns, in the shape that is solved quickly."""
    if arrow is None:
        return Dense(jnp.zeros((p, p)))
    f, (blocks, g) = len(arrow.border), arrow.blocks.shape
    return Arrowhead(jnp.zeros((f, f)), jnp.zeros([blocks, g, f]), jnp.zeros([blocks, g, g]), arrow, p)
