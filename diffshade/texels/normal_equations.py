r"""Normal equations: the best coefficients of every texel at some n and n_s, and the equations of a Gauss-Newton step.

Variable projection (Golub and Pereyra 1973, in Kaufman's form of 1975) at all texels at once: the prediction is linear
in the coefficients k, so these are solved for exactly, and a step of the other unknowns q (the tilts of the normal and
x = log n_s) sees the cost at the best k. With the Jacobian's columns A = dm/dk and J = dm/dq,

$$ G = A^T W A, \quad B = A^T W J, \quad P = J^T W J $$

are sums over the views of products of features. A scan over the views adds up arrays of one number a texel: memory does
not grow with the number of views, and what one view needs stays in a core's cache.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..core.fields import Array
from ..core.thresholds import TINY
from ..inverse.forward.losses import LOSSES
from ..model.vectors import Vec3, tangents_of
from .linear_systems import cholesky, forward, nonnegative
from .prediction import KnownCoefficients, TexelProblem, ViewSlice, features, sample_variance, view_slices

_Sums = tuple[list[Array], list[Array], Array]  # products, right, squares
_Costs = tuple[Array, Array, Array]  # cost, squares, share


class NormalEquations(eqx.Module):
    """Every texel at some n and x = log n_s: the best coefficients k there, the cost, and the normal equations."""

    n: Vec3
    x: Float[Array, " texels"]
    k: Sequence[Float[Array, "channels texels"]]
    """Those of `KnownCoefficients.fitted`."""
    cost: Float[Array, " texels"]
    """Half the sum over views of C sigma^2 rho(sum over the C channels of w r^2 / (C sigma^2))."""
    squares: Float[Array, " texels"]
    """Sum of w r^2 with the weights of the loss."""
    share: Float[Array, " texels"]
    """Sum of the weights of the loss: how many observations it keeps."""
    G: Sequence[Sequence[Float[Array, "_ texels"]]]
    """A^T W A, of the coefficients, in each channel."""
    B: Sequence[Sequence[Float[Array, "channels texels"]]]
    """A^T W J, of the coefficients with the other unknowns."""
    P: Sequence[Sequence[Float[Array, " texels"]]]
    """J^T W J, of the other unknowns."""
    slope: Sequence[Float[Array, " texels"]]
    """Derivative of the cost by the other unknowns."""
    weight: Float[Array, "views _ texels"] | None
    """The weights at this prediction; None where they never change."""


class Sums(NamedTuple):
    """Weighted sums over the views of products of features, and of features and photographs."""

    products: list[list[Float[Array, "_ texels"]]]
    """Of all features, columns first: a symmetric matrix in each channel."""
    right: list[Float[Array, "channels texels"]]
    """Of each feature and the photographs."""
    squares: Float[Array, " texels"]
    """Of the photographs themselves."""


def sums(
    problem: TexelProblem, n: Vec3, x: Array, weight: Float[Array, "views _ texels"], *, derivatives: bool
) -> Sums:
    """Add up the products of the features over the views, with or without those of the derivatives."""
    linear = len(problem.known.fitted)
    size = linear + (4 * problem.fit_normal + problem.fit_exponent if derivatives else 0)
    tangents = tangents_of(n) if problem.fit_normal and derivatives else ()
    pairs = [(i, j) for i in range(size) for j in range(i + 1)]

    def add(total: _Sums, view: ViewSlice) -> tuple[_Sums, None]:
        F = features(problem, view, n, x, tangents)
        rows = [*F.columns, *(F.derivatives if derivatives else ())]
        r, w = view.target.astype(x.dtype) - F.base, view.weight
        assert w is not None
        products, right, squares = total
        weighted = [w * row for row in rows]
        products = [p + weighted[i] * rows[j] for p, (i, j) in zip(products, pairs, strict=True)]
        right = [b + row * r for b, row in zip(right, weighted, strict=True)]
        return (products, right, squares + jnp.sum(w * r * r, 0)), None

    channels = problem.observed.channels
    equal_channels = problem.setup.grey_lights and problem.options.homoscedastic
    all_channels = jnp.zeros((channels, *x.shape))
    of_features = jnp.zeros((1 if equal_channels else channels, *x.shape))
    ambient = [name == "k_a" for name in problem.known.fitted] + [False] * (size - linear)
    products: list[Array] = [all_channels if ambient[i] or ambient[j] else of_features for i, j in pairs]
    right: list[Array] = [all_channels] * size
    start = (products, right, jnp.zeros(x.shape))
    (products, right, squares), _ = jax.lax.scan(add, start, view_slices(problem, weight))
    return Sums(_symmetric(products, pairs, size), right, squares)


def _symmetric(lower: list[Array], pairs: list[tuple[int, int]], size: int) -> list[list[Array]]:
    """Return a symmetric matrix from its lower half."""
    return [[lower[pairs.index((max(i, j), min(i, j)))] for j in range(size)] for i in range(size)]


def cost_at(problem: TexelProblem, n: Vec3, x: Array, weight: Float[Array, "views _ texels"]) -> Array:
    """Return the cost of squares at the best coefficients."""
    of_views = sums(problem, n, x, weight, derivatives=False)
    return 0.5 * (of_views.squares - jnp.sum(nonnegative(of_views.products, of_views.right)[1], 0))


Terms = list[tuple[Array, int]]  # a derivative of the prediction, as a sum of coefficients times features


def combined(terms: Terms, of_feature: Sequence[Array]) -> Array:
    """Return the sum of c times what belongs to feature f, over the terms (c, f) of a derivative."""
    return sum((c * of_feature[f] for c, f in terms), jnp.zeros((1, 1)))


def combined_twice(first: Terms, second: Terms, products: Sequence[Sequence[Array]]) -> Array:
    """Return the product of two derivatives from the products of their features."""
    return sum((c * combined(second, products[f]) for c, f in first), jnp.zeros((1, 1)))


def derivatives_of_prediction(problem: TexelProblem, k: Sequence[Array]) -> list[Terms]:
    """Return J, so far as it is fitted: dm/da = k_d du/da + k_s dv/da, the same by b, and dm/dx = k_s dv/dx."""
    k_d, k_s = (coefficient(problem.known, k, name) for name in ("k_d", "k_s"))
    first = len(k)  # features begin with one column for each fitted coefficient
    J: list[Terms] = []
    if problem.fit_normal:
        du_da, du_db, dv_da, dv_db = range(first, first + 4)
        J += [[(k_d, du_da), (k_s, dv_da)], [(k_d, du_db), (k_s, dv_db)]]
    if problem.fit_exponent:
        dv_dx = first + 4 * problem.fit_normal
        J += [[(k_s, dv_dx)]]
    return J


def coefficient(known: KnownCoefficients, k: Sequence[Array], name: str) -> Array:
    """Return a coefficient in each channel, fitted or known."""
    return k[known.fitted.index(name)] if name in known.fitted else getattr(known, name)[:, None]


def evaluate(problem: TexelProblem, n: Vec3, x: Array, weight: Float[Array, "views _ texels"]) -> NormalEquations:
    """Find the best coefficients at n and x for these weights, and the normal equations there."""
    size = len(problem.known.fitted)
    products, right, squares = sums(problem, n, x, weight, derivatives=True)
    G = [row[:size] for row in products[:size]]
    k, gain = nonnegative(G, right[:size])
    J = derivatives_of_prediction(problem, k)
    B = [[combined(of_q, row) for of_q in J] for row in products[:size]]
    P = [[jnp.sum(combined_twice(of_p, of_q, products), 0) for of_q in J] for of_p in J]
    slope = []
    for j, of_q in enumerate(J):
        predicted = sum((c * row[j] for c, row in zip(k, B, strict=True)), jnp.zeros((1, 1)))
        slope.append(jnp.sum(predicted - combined(of_q, right), 0))
    cost = 0.5 * (squares - jnp.sum(gain, 0))
    found = NormalEquations(n, x, k, cost, 2.0 * cost, problem.observed.number, G, B, P, slope, None)
    return reweight(problem, found) if problem.reweights else found


def reweight(problem: TexelProblem, found: NormalEquations) -> NormalEquations:
    """Return the normal equations with the cost of their residuals, and with the weights for the next step."""
    losses = [lambda s, of=LOSSES[name]: (of.value(s), of.slope(s)) for name in problem.losses]  # rho and its weight

    def add(total: _Costs, view: ViewSlice) -> tuple[_Costs, Array]:
        m = features(problem, view, found.n, found.x, ()).predicted(found.k)
        precision = jnp.where(view.counts[None], 1.0 / sample_variance(problem, view, m), 0.0)
        r2 = jnp.sum(precision * (m - view.target.astype(found.x.dtype)) ** 2, 0)
        scale = len(view.target) * problem.sigma**2  # the channels of an observation are weighted together
        rho, kept = jax.lax.switch(problem.stage, losses, r2 / scale)
        cost, squares, share = total
        cost, squares = cost + 0.5 * scale * rho, squares + kept * r2
        return (cost, squares, share + jnp.where(view.counts, kept, 0.0)), precision * kept[None]

    zero = jnp.zeros(found.x.shape)
    (cost, squares, share), weight = jax.lax.scan(add, (zero, zero, zero), view_slices(problem, None))
    return dataclasses.replace(found, cost=cost, squares=squares, share=share, weight=weight)


class ReducedSystem(NamedTuple):
    """The normal equations of n and x once the coefficients are eliminated."""

    S: list[list[Array]]
    """The Schur complement P - B^T G^-1 B, with a small ridge relative to P."""
    Z: list[list[Array]]
    """L^-1 B, one row for each of the other unknowns, with the Cholesky factor L of G in each channel."""


def eliminate_coefficients(found: NormalEquations, *, hold_zeros: bool) -> ReducedSystem:
    """Eliminate the coefficients; `hold_zeros` treats those that are 0 as known."""
    G, B, count = found.G, found.B, len(found.P)
    if hold_zeros:
        free = [k > 0.0 for k in found.k]
        G = [[jnp.where(free[i] & free[j], g, 1.0 * (i == j)) for j, g in enumerate(row)] for i, row in enumerate(G)]
        B = [[jnp.where(f, b, 0.0) for b in row] for f, row in zip(free, B, strict=True)]
    L = cholesky(G)
    Z = [forward(L, [row[j] for row in B]) for j in range(count)]

    def schur(i: int, j: int) -> Array:
        explained = sum((jnp.sum(a * b, 0) for a, b in zip(Z[i], Z[j], strict=True)), 0.0)
        return found.P[i][j] * (1.0 + TINY * (i == j)) - explained

    return ReducedSystem([[schur(i, j) for j in range(count)] for i in range(count)], Z)
