"""Passes over the views: the best coefficients of every texel, and what a step of n and n_s needs beside them.

Variable projection (Golub and Pereyra 1973, in Kaufman's form of 1975) at every texel at once. A scan over the views
adds up a few arrays of one number a texel: memory does not grow with the views, and all a view needs stays in a cache.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from ..inverse.forward.losses import LOSSES
from ..model.vectors import Vec3
from .coefficients import cholesky, forward, nonnegative
from .lighting import FixedNormalGeometry, LightingGeometry, LightingSetup

COEFFICIENTS = ("k_a", "k_d", "k_s")


class Known(eqx.Module):
    """The coefficients that are not fitted, one number a channel; None where one is."""

    k_a: Float[Array, " channels"] | None
    k_d: Float[Array, " channels"] | None
    k_s: Float[Array, " channels"] | None
    k_e: Float[Array, " channels"]

    @property
    def linear(self) -> tuple[str, ...]:
        """The names of those that are fitted."""
        return tuple(name for name in COEFFICIENTS if getattr(self, name) is None)

    def without_highlight(self) -> Known:
        """Return the same with k_s known, and 0."""
        return dataclasses.replace(self, k_s=jnp.zeros_like(self.k_e))


class Photographs(eqx.Module):
    """What the views show of a block of texels."""

    target: Float[Array, "views channels texels"]
    counts: Bool[Array, "views texels"]
    """False where an observation does not count."""

    @property
    def observations(self) -> Float[Array, " texels"]:
        """How many observations of each texel count."""
        return jnp.sum(self.counts, 0, dtype=float)


class Task(eqx.Module):
    """What is to be fitted at every texel of a block."""

    setup: LightingSetup
    known: Known
    lighting: LightingGeometry | FixedNormalGeometry
    seen: Photographs
    sigma: Float[Array, ""]
    """Scale of the weighted residuals, for a robust loss."""
    stage: Int[Array, ""]
    """Which of the losses counts."""
    losses: tuple[str, ...] = eqx.field(static=True)
    """One after another: a convex one before one that is not."""
    homoscedastic: bool = eqx.field(static=True)
    """Whether the noise is the same at every level."""
    fit_normal: bool = eqx.field(static=True)
    """Whether the normals are fitted."""
    fit_exponent: bool = eqx.field(static=True)
    """Whether n_s is."""

    @property
    def reweighs(self) -> bool:
        """Whether weights depend on the prediction."""
        return self.losses != ("squares",) or not self.homoscedastic

    @property
    def samples(self) -> Float[Array, " texels"]:
        """How many samples of each texel count."""
        return self.seen.observations * self.seen.target.shape[1]

    @property
    def unknowns(self) -> int:
        """How many numbers a texel has."""
        return len(self.seen.target[0]) * len(self.known.linear) + 2 * self.fit_normal + self.fit_exponent


class Found(eqx.Module):
    """Every texel at some n and n_s: the best coefficients there, and what a Gauss-Newton step needs."""

    n: Vec3
    x: Float[Array, " texels"]
    """log n_s."""
    k: tuple[Float[Array, "channels texels"], ...]
    """Those of `Known.linear`."""
    cost: Float[Array, " texels"]
    """Half the sum over views of C sigma^2 rho(sum over the C channels of w r^2 / (C sigma^2))."""
    squares: Float[Array, " texels"]
    """sum w r^2 with the weights of the loss."""
    share: Float[Array, " texels"]
    """Sum of the weights of the loss: how many observations it believes."""
    gram: tuple[tuple[Float[Array, "_ texels"], ...], ...]
    """G, of the coefficients, in each channel; B, of them with the rest; P, of the rest; and the slopes of the cost."""
    mixed: tuple[tuple[Float[Array, "channels texels"], ...], ...]
    rest: tuple[tuple[Float[Array, " texels"], ...], ...]
    slope: tuple[Float[Array, " texels"], ...]
    weight: Any
    """The weights at this prediction, (views, _, texels); None where they never change."""


def tangents(n: Vec3) -> tuple[Vec3, Vec3]:
    """Return two unit vectors at right angles to n and to each other, with no jump but at n = -z (Duff et al. 2017)."""
    sign = jnp.where(n.z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + n.z)
    b = n.x * n.y * a
    return Vec3(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3(b, sign + n.y * n.y * a, -n.y)


class ViewSlice(NamedTuple):
    """One view of a block of texels, as a scan comes upon it."""

    sight: Any
    exposure: Array
    black: Array
    noise: Any
    target: Float[Array, "channels texels"]
    counts: Bool[Array, " texels"]
    weight: Float[Array, "_ texels"] | None


def looks(task: Task, weight: Array | None) -> ViewSlice:
    """Return what a scan over the views goes through."""
    setup, seen = task.setup, task.seen
    return ViewSlice(task.lighting.views, setup.exposure, setup.black, setup.noise, seen.target, seen.counts, weight)


class Features(NamedTuple):
    """The fields of one view that its prediction and its slopes are sums of, and what is known beside them."""

    columns: list[Array]
    """a, u and v, those whose coefficients are fitted."""
    slopes: list[Array]
    """Derivatives of u by the tangents, of v by them, and of v by log n_s: those that are fitted."""
    base: Array

    def predicted(self, k: Sequence[Array]) -> Array:
        """Return what the view shows with these coefficients."""
        return sum((c * column for c, column in zip(k, self.columns, strict=True)), self.base)


def features(task: Task, view_slice: ViewSlice, n: Vec3, x: Array, basis: tuple[Vec3, ...]) -> Features:
    """Return the features of one view."""
    known = task.known
    shading = task.lighting.shading(view_slice.sight, n, basis, x)
    of = {"k_a": (view_slice.exposure * task.setup.ambient)[:, None], "k_d": shading.u, "k_s": shading.v}
    base = (view_slice.exposure * known.k_e + view_slice.black)[:, None]
    for name, column in of.items():
        k = getattr(known, name)
        if k is not None:
            base = base + k[:, None] * column
    turned, sharpened = shading.slopes[:-1], shading.slopes[-1]
    slopes = [du for du, _ in turned] + [dv for _, dv in turned] + ([sharpened[1]] if task.fit_exponent else [])
    return Features([of[name] for name in known.linear], slopes, base)


def variance(task: Task, view_slice: ViewSlice, m: Array) -> Array:
    """Return the variance of one view's samples at the level m, or 1 where it is not known."""
    if view_slice.noise is None:
        return jnp.ones((1, 1))
    return view_slice.noise.variance(jnp.zeros((1, 1)) if task.homoscedastic else m)


def first_weights(task: Task) -> Float[Array, "views _ texels"]:
    """Return the weights before there is a prediction: 1/variance at the level of the photograph."""

    def of_view(view_slice: ViewSlice) -> Array:
        w = 1.0 / variance(task, view_slice, view_slice.target.astype(float))
        return jnp.where(view_slice.counts[None], w, 0.0)

    return jax.lax.map(of_view, looks(task, None))


class Sums(NamedTuple):
    """Weighted sums over the views of products of features, and of features and the photographs."""

    products: list[list[Float[Array, "_ texels"]]]
    """Of all features, columns first: a symmetric matrix in each channel."""
    right: list[Float[Array, "channels texels"]]
    squares: Float[Array, " texels"]


def sums(task: Task, n: Vec3, x: Array, weight: Array, *, slopes: bool) -> Sums:
    """Add up the products of the features, one view after another; `slopes` says whether those of the slopes too."""
    size = len(task.known.linear) + (4 * task.fit_normal + task.fit_exponent if slopes else 0)
    basis = tangents(n) if task.fit_normal and slopes else ()
    pairs = [(i, j) for i in range(size) for j in range(i + 1)]

    def add(total: Any, view_slice: ViewSlice) -> tuple[Any, None]:
        F = features(task, view_slice, n, x, basis)
        rows = [*F.columns, *(F.slopes if slopes else ())]
        r, w = view_slice.target.astype(x.dtype) - F.base, view_slice.weight
        assert w is not None
        products, right, squares = total
        weighted = [w * row for row in rows]
        products = [p + weighted[i] * rows[j] for p, (i, j) in zip(products, pairs, strict=True)]
        right = [b + row * r for b, row in zip(right, weighted, strict=True)]
        return (products, right, squares + jnp.sum(w * r * r, 0)), None

    channels = task.seen.target.shape[1]
    alike = task.setup.grey_lights and task.homoscedastic
    wide = {True: jnp.zeros((channels, *x.shape)), False: jnp.zeros((1 if alike else channels, *x.shape))}
    ambient = [name == "k_a" for name in task.known.linear] + [False] * (size - len(task.known.linear))
    start = ([wide[ambient[i] or ambient[j]] for i, j in pairs], [wide[True]] * size, jnp.zeros(x.shape))
    (products, right, squares), _ = jax.lax.scan(add, start, looks(task, weight))
    return Sums(_square(products, pairs, size), right, squares)


def project(task: Task, n: Vec3, x: Array, weight: Array) -> Array:
    """Return the cost of squares at the best coefficients."""
    products, right, squares = sums(task, n, x, weight, slopes=False)
    return 0.5 * (squares - jnp.sum(nonnegative(products, right)[1], 0))


def evaluate(task: Task, n: Vec3, x: Array, weight: Array) -> Found:
    """Find the best coefficients at n and x for these weights, and what a step needs."""
    linear = task.known.linear
    size = len(linear)
    products, right, squares = sums(task, n, x, weight, slopes=True)
    k, gain = nonnegative([row[:size] for row in products[:size]], right[:size])
    of_name = dict(zip(linear, k, strict=True))
    k_d, k_s = (_coefficient(of_name, task.known, name) for name in ("k_d", "k_s"))
    # the derivative by each unknown as a sum of features: k_d du/dt + k_s dv/dt, and k_s dv/dlog n_s
    terms = [[(k_d, size), (k_s, size + 2)], [(k_d, size + 1), (k_s, size + 3)]] if task.fit_normal else []
    terms += [[(k_s, size + 4 * task.fit_normal)]] if task.fit_exponent else []

    def with_terms(of: Callable[[int], Array], J: list[tuple[Array, int]]) -> Array:
        return sum((c * of(f) for c, f in J), jnp.zeros((1, 1)))

    mixed = [[with_terms(lambda f, row=row: row[f], J) for J in terms] for row in products[:size]]
    rest = [
        [jnp.sum(with_terms(lambda f, J=J: with_terms(lambda g: products[f][g], J), K), 0) for J in terms]
        for K in terms
    ]
    slope = []
    for j, J in enumerate(terms):
        predicted = sum((c * row[j] for c, row in zip(k, mixed, strict=True)), jnp.zeros((1, 1)))
        slope.append(jnp.sum(predicted - with_terms(lambda f: right[f], J), 0))
    cost = 0.5 * (squares - jnp.sum(gain, 0))
    gram = [row[:size] for row in products[:size]]
    G, B, P = map(_tuples, (gram, mixed, rest))
    found = Found(n, x, tuple(k), cost, 2.0 * cost, task.seen.observations, G, B, P, tuple(slope), None)
    return reweigh(task, found) if task.reweighs else found


def _coefficient(found: dict[str, Array], known: Known, name: str) -> Array:
    """Return a coefficient that was found or was known."""
    return found[name] if name in found else getattr(known, name)[:, None]


def reweigh(task: Task, found: Found) -> Found:
    """Return what was found with the cost of its residuals, and the weights that they leave each observation."""

    def add(total: Any, view_slice: ViewSlice) -> tuple[Any, Array]:
        F = features(task, view_slice, found.n, found.x, ())
        m = F.predicted(found.k)
        precise = jnp.where(view_slice.counts[None], 1.0 / variance(task, view_slice, m), 0.0)
        r2 = jnp.sum(precise * (m - view_slice.target.astype(found.x.dtype)) ** 2, 0)
        scale = len(view_slice.target) * task.sigma**2  # of an observation: all its channels have one say
        rho, believed = jax.lax.switch(task.stage, [_loss(name) for name in task.losses], r2 / scale)
        cost, squares, share = total
        cost = cost + 0.5 * scale * rho
        return (cost, squares + believed * r2, share + jnp.where(view_slice.counts, believed, 0.0)), precise * believed[
            None
        ]

    zero = jnp.zeros(found.x.shape)
    of, weight = jax.lax.scan(add, (zero, zero, zero), looks(task, None))
    return eqx.tree_at(
        lambda f: (f.cost, f.squares, f.share, f.weight), found, (*of, weight), is_leaf=lambda leaf: leaf is None
    )


def _loss(name: str) -> Callable[[Array], tuple[Array, Array]]:
    """Return a function of s = (r/sigma)^2: rho, and the weight rho' of the residual."""
    return lambda s: (LOSSES[name].value(s), LOSSES[name].slope(s))


def _square(lower: list[Array], pairs: list[tuple[int, int]], size: int) -> list[list[Array]]:
    """Return a symmetric matrix from its lower half."""
    return [[lower[pairs.index((max(i, j), min(i, j)))] for j in range(size)] for i in range(size)]


def _tuples(rows: Any) -> tuple[tuple[Any, ...], ...]:
    return tuple(map(tuple, rows))


class Reduced(NamedTuple):
    """What is known of n and log n_s once the coefficients are eliminated, and what eliminated them."""

    rest: list[list[Array]]
    """P - B^T G^-1 B."""
    factor: list[list[Array]]
    """L of G = L L^T, in each channel."""
    mixed: list[list[Array]]
    """L^-1 B: for each of the rest one number a coefficient."""


def reduced(found: Found, *, held: bool) -> Reduced:
    """Eliminate the coefficients; `held` takes those that are 0 for known."""
    size, count = len(found.k), len(found.rest)
    free = [k > 0.0 for k in found.k]

    def kept(i: int, j: int) -> Array:
        value = found.gram[i][j]
        return jnp.where(free[i] & free[j], value, 1.0 * (i == j)) if held else value

    L = cholesky([[kept(i, j) for j in range(size)] for i in range(size)])
    z = []
    for j in range(count):
        column = [found.mixed[i][j] for i in range(size)]
        z.append(forward(L, [jnp.where(f, b, 0.0) for f, b in zip(free, column, strict=True)] if held else column))

    def left(i: int, j: int) -> Array:
        return found.rest[i][j] - sum((jnp.sum(a * b, 0) for a, b in zip(z[i], z[j], strict=True)), 0.0)

    return Reduced([[left(i, j) for j in range(count)] for i in range(count)], L, z)
