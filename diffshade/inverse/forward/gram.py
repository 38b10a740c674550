"""Grams: what a Gauss-Newton step needs of any number of residuals, of all views together or of each."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.fields import Array

Part = tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m m"], Float[np.ndarray, " m"]]


class Gram(eqx.Module):
    """The cost |r|^2/2, J^T r and J^T J of residuals r, weighted by the loss; a leading axis is that of the views."""

    cost: Float[Array, "..."]
    gradient: Float[Array, "... p"]
    hessian: Any
    """Float[Array, "... p p"]; of a point all together, `solve.elimination.Symmetric`."""


class ByView(eqx.Module):
    """What each view, or cluster of samples, says of the unknowns that it can show: H_v, g_v, and which these are.

    Its arrays are JAX's while a fit is minimised, and NumPy's afterwards.
    """

    cost: Float[Array, " views"]
    gradient: Float[Array, "views m"]
    hessian: Float[Array, "views m m"]
    shown: Int[Array, "views m"] | None
    """The unknowns of each view, padded with their number; None where every view shows all."""

    @classmethod
    def of(cls, parts: Sequence[Part], costs: Sequence[float] | Float[np.ndarray, " views"], p: int) -> ByView:
        """Return what views say, given for each which of p unknowns it shows, and H and g for them."""
        most = max(len(index) for index, _, _ in parts)
        gradient, hessian = np.zeros((len(parts), most)), np.zeros((len(parts), most, most))
        shown = np.full((len(parts), most), p)
        for v, (index, H, g) in enumerate(parts):
            m = len(index)
            shown[v, :m], gradient[v, :m], hessian[v, :m, :m] = index, g, H
        return cls(np.array(costs), gradient, hessian, shown)

    def slope(self, p: int) -> Float[Array, " p"]:
        """Return the gradient of all views together, as JAX's array."""
        if self.shown is None:
            return self.gradient.sum(0)
        return jnp.zeros(p).at[self.shown].add(self.gradient, mode="drop")

    def moved(self, step: Float[Array, " p"]) -> ByView:
        """Return what the views say after a small step, by their quadratic models."""
        of_view = step[None] if self.shown is None else jnp.append(step, 0.0)[self.shown]
        slope = jnp.sum(self.hessian * of_view[:, None], -1)
        cost = self.cost + jnp.sum((self.gradient + 0.5 * slope) * of_view, -1)
        return ByView(jnp.maximum(cost, 0.0), self.gradient + slope, self.hessian, self.shown)

    def index(self, p: int) -> Int[np.ndarray, "views m"]:
        """Return which of p unknowns each view shows, padded with their number."""
        return np.tile(np.arange(p), (len(self.cost), 1)) if self.shown is None else np.asarray(self.shown)

    def parts(self, which: Bool[np.ndarray, " p"]) -> Iterator[Part]:
        """Yield for each view which of some unknowns it shows, and H and g for them."""
        index, H, g = self.index(len(which)), np.asarray(self.hessian), np.asarray(self.gradient)
        for shown, H_v, g_v in zip(index, H, g, strict=True):
            here = np.append(which, False)[shown]
            yield shown[here], H_v[np.ix_(here, here)], g_v[here]

    def total(self, p: int) -> Float[np.ndarray, "p p"]:
        """Return the Hessian of all views together."""
        total = np.zeros((p, p))
        for index, H, _ in self.parts(np.ones(p, bool)):
            total[np.ix_(index, index)] += H
        return total

    def seen(self, p: int) -> Float[np.ndarray, "views p"]:
        """Return the diagonal of the Hessian of each view."""
        found = np.zeros((len(self.cost), p))
        for row, (index, H, _) in zip(found, self.parts(np.ones(p, bool)), strict=True):
            row[index] = np.diag(H)
        return found

    def single_view(self, p: int) -> Int[np.ndarray, " p"]:
        """Return for each unknown the one of several views that alone sees it, as it does its exposure; else -1."""
        seen = self.seen(p)
        sees = seen > 1e-12 * seen.max(0, initial=0.0)
        return np.where((sees.sum(0) == 1) & (len(seen) > 1), sees.argmax(0), -1)

    def among(self, which: Bool[np.ndarray, " p"]) -> ByView:
        """Return what the views say of some of the unknowns, with the others held."""
        number = np.where(which, np.cumsum(which) - 1, which.sum())
        shown = np.append(number, which.sum())[self.index(len(which))]
        return dataclasses.replace(self, shown=shown)

    def scaled(self, by: Float[np.ndarray, " p"]) -> ByView:
        """Return what the views say of unknowns in other units: derivatives multiplied by `by`."""
        unit = np.append(by, 0.0)[self.index(len(by))]
        hessian = np.asarray(self.hessian) * unit[:, :, None] * unit[:, None, :]
        return dataclasses.replace(self, gradient=np.asarray(self.gradient) * unit, hessian=hessian)

    def together(self, groups: Sequence[Sequence[int]], p: int) -> ByView:
        """Return the sums over groups of views."""
        parts, found = list(self.parts(np.ones(p, bool))), []
        for of in groups:
            union = np.unique(np.concatenate([parts[v][0] for v in of]))
            H, g = np.zeros((len(union), len(union))), np.zeros(len(union))
            for index, H_v, g_v in (parts[v] for v in of):
                at = np.searchsorted(union, index)
                H[np.ix_(at, at)] += H_v
                g[at] += g_v
            found.append((union, H, g))
        return ByView.of(found, [float(np.asarray(self.cost)[list(of)].sum()) for of in groups], p)


class Point(eqx.Module):
    """A point that was tried: theta, and the Gram there, of views and priors together and of each view."""

    theta: Float[Array, " p"]
    total: Gram
    views: ByView

    def gain(self, step: Float[Array, " p"]) -> Float[Array, ""]:
        """Return by how much a step lowers the cost, by the quadratic model."""
        return -(self.total.gradient @ step + 0.5 * step @ self.total.hessian.times(step))

    def moved(self, step: Float[Array, " p"]) -> Point:
        """Return the point after a step too small for a pass: the quadratic model moves, in total and of each view."""
        of, cost = self.total, jnp.maximum(self.total.cost - self.gain(step), 0.0)  # rounding takes 0 below itself
        total = Gram(cost, of.gradient + of.hessian.times(step), of.hessian)
        return Point(self.theta + step, total, self.views.moved(step))


def directions_of(
    shown: Int[Array, "views most"] | None, view: Int[Array, ""], p: int
) -> tuple[Int[Array, " most"], Float[Array, "most p"]]:
    """Return the indices of the unknowns that a view can show, and the unit vectors along them; 0 for padding."""
    if shown is None:
        return jnp.arange(p), jnp.eye(p)
    index = shown[view]
    return index, jax.nn.one_hot(index, p)
