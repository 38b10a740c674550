"""Grams: what a Gauss-Newton step needs of any number of residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array


class Gram(eqx.Module):
    """The cost |r|^2/2, J^T r and J^T J of residuals r, weighted by the loss; a leading axis is that of the views."""

    cost: Float[Array, "..."]
    gradient: Float[Array, "... p"]
    hessian: Any
    """Float[Array, "... p p"]; of a point all together, `solve.elimination.Symmetric`."""


class ViewGrams(eqx.Module):
    """The Gram of each view, of the unknowns alone that it can show."""

    of: Gram
    shown: Int[Array, "views most"] | None
    """The unknowns of each view, padded with their number; None where every view shows all."""

    @property
    def cost(self) -> Float[Array, " views"]:
        """The cost of each view."""
        return self.of.cost

    def total(self, p: int) -> Gram:
        """Return the Gram of all views together."""
        if self.shown is None:
            return jax.tree.map(lambda leaf: leaf.sum(0), self.of)
        rows, columns = self.shown[:, :, None], self.shown[:, None, :]
        hessian = jnp.zeros((p, p)).at[rows, columns].add(self.of.hessian, mode="drop")
        return Gram(self.of.cost.sum(), self.gradient(p), hessian)

    def gradient(self, p: int) -> Float[Array, " p"]:
        """Return the gradient of all views together."""
        if self.shown is None:
            return self.of.gradient.sum(0)
        return jnp.zeros(p).at[self.shown].add(self.of.gradient, mode="drop")

    def seen(self, p: int) -> Float[np.ndarray, "views p"]:
        """Return the diagonal of the Gram of each view."""
        diagonal = np.diagonal(np.asarray(self.of.hessian), axis1=1, axis2=2)
        if self.shown is None:
            return diagonal
        padded = np.zeros((len(self.shown), p + 1))
        np.put_along_axis(padded, np.asarray(self.shown), diagonal, 1)
        return padded[:, :p]

    def together(
        self, groups: Sequence[Sequence[int]], p: int
    ) -> tuple[Float[np.ndarray, "groups m m"], Float[np.ndarray, "groups m"], Int[np.ndarray, "groups m"] | None]:
        """Return H and g of groups of views, of the unknowns that each can show, and which those are."""
        H, g = np.asarray(self.of.hessian), np.asarray(self.of.gradient)
        if self.shown is None:
            return (
                np.array([H[list(of)].sum(0) for of in groups]),
                np.array([g[list(of)].sum(0) for of in groups]),
                None,
            )
        shown = np.asarray(self.shown)
        unions = [np.setdiff1d(shown[list(of)], [p]) for of in groups]
        most = max(map(len, unions))
        found_H, found_g = np.zeros((len(groups), most, most)), np.zeros((len(groups), most))
        index = np.full((len(groups), most), p)
        for c, (of, union) in enumerate(zip(groups, unions, strict=True)):
            index[c, : len(union)] = union
            for view in of:
                here = shown[view] < p
                at = np.searchsorted(union, shown[view][here])
                found_H[c][np.ix_(at, at)] += H[view][np.ix_(here, here)]
                found_g[c][at] += g[view][here]
        return found_H, found_g, index


class Point(eqx.Module):
    """A point that was tried: theta, and the Gram there, of views and priors together and of each view."""

    theta: Float[Array, " p"]
    total: Gram
    views: ViewGrams


def directions_of(
    shown: Int[Array, "views most"] | None, view: Int[Array, ""], p: int
) -> tuple[Int[Array, " most"], Float[Array, "most p"]]:
    """Return the indices of the unknowns that a view can show, and the unit vectors along them; 0 for padding."""
    if shown is None:
        return jnp.arange(p), jnp.eye(p)
    index = shown[view]
    return index, jax.nn.one_hot(index, p)
