"""Descent: n and n_s of every texel by Levenberg-Marquardt on the reduced problem, each with a damping of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..core.fields import Array
from ..model.materials import EXPONENT_RANGE
from ..model.vectors import Vec3, normalize, where
from .coefficients import solve
from .lighting import LightingGeometry
from .normal_equations import Found, Task, evaluate, first_weights, project, reduced, tangents

T = TypeVar("T")
LOW, HIGH = (float(end) for end in np.log(EXPONENT_RANGE))
GRID = np.log(0.5 * 4.0 ** np.arange(7))  # of log n_s, for a start: a factor of 4 is well within reach of a descent
CLOSE = 1e-3  # what a step still promises, as a share of the variance of a sample, when a texel is done
FIRM = 1e-3  # how much of what is known of an unknown alone is left to it at least, beside the coefficients
FARTHEST = (0.3, 1.5)  # a step of the normal (its tangent) and of log n_s


class Descent(eqx.Module):
    """Where every texel is on its way."""

    found: Found
    weight: Float[Array, "views _ texels"]
    damping: Float[Array, " texels"]
    done: Bool[Array, " texels"]


def descend(task: Task, n: Vec3, x: Array, weight: Array, patience: Array) -> Descent:
    """Return the minimum of every texel from n and x = log n_s on; `done` where `patience` steps reached it.

    One stage for each loss of the task, each from where the last one ended.
    """
    freedom = jnp.maximum(task.samples - task.unknowns, 1.0)
    squares = jnp.sum(first_weights(task) * task.seen.target.astype(x.dtype) ** 2, (0, 1))

    def step(task: Task, state: tuple[Descent, Array]) -> tuple[Descent, Array]:
        now, steps = state
        tried, promised = _tried(task, now.found, now.damping, now.weight)
        fell = now.found.cost - tried.cost
        better = (fell > 0.0) & ~now.done
        enough = CLOSE * 2.0 * tried.cost / freedom + 1e-24 * squares
        done = now.done | ((promised <= enough) & (fell <= enough)) | (now.damping > 1e8)
        new = now.weight if tried.weight is None else chosen(better, tried.weight, now.weight)
        damping = jnp.where(better, 0.2 * now.damping, 5.0 * now.damping + 0.01)
        return Descent(chosen(better, tried, now.found), new, damping, done), steps + 1

    def stage(last: Descent, loss: Array) -> tuple[Descent, None]:
        of_stage = eqx.tree_at(lambda t: t.stage, task, loss)
        start = _begun(last.found, last.weight)
        many = (start, jnp.asarray(0))
        end, _ = jax.lax.while_loop(
            lambda s: (s[1] < patience) & ~jnp.all(s[0].done), lambda s: step(of_stage, s), many
        )
        return end, None

    if not task.fit_normal and not task.fit_exponent and not task.reweighs:  # there is nothing to step
        found = evaluate(task, n, x, weight)
        return Descent(found, weight, jnp.zeros_like(x), jnp.ones(x.shape, bool))
    shapes = jax.eval_shape(evaluate, task, n, x, weight)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    nothing = eqx.tree_at(lambda f: (f.n, f.x), nothing, (n, x))
    return jax.lax.scan(stage, _begun(nothing, weight), jnp.arange(len(task.losses)))[0]


def chosen(condition: Bool[Array, " texels"], a: T, b: T) -> T:
    """Choose texel by texel between two trees of arrays whose last axis is the texels."""
    return jax.tree.map(lambda x, y: jnp.where(jnp.reshape(condition, (1,) * (x.ndim - 1) + (-1,)), x, y), a, b)


def _begun(found: Found, weight: Array) -> Descent:
    """Return a descent whose first step goes nowhere and is taken."""
    still = [jnp.zeros_like(slope) for slope in found.slope]
    found = eqx.tree_at(lambda f: (f.cost, f.slope), found, (jnp.full_like(found.x, jnp.inf), tuple(still)))
    return Descent(found, weight, jnp.full_like(found.x, 1e-3), jnp.zeros(found.x.shape, bool))


def _tried(task: Task, found: Found, damping: Array, weight: Array) -> tuple[Found, Array]:
    """Return every texel after one damped step, and by how much that promised to lower the cost."""
    A = reduced(found, held=True).rest
    count = len(A)
    scale = [jnp.maximum(A[i][i], FIRM * found.rest[i][i]) for i in range(count)]
    damped = [[scale[i] * (1.0 + damping) if i == j else A[i][j] for j in range(count)] for i in range(count)]
    step = [-s for s in solve(damped, found.slope)]
    promised = -sum((g * s for g, s in zip(found.slope, step, strict=True)), jnp.zeros(found.x.shape))
    n, x = moved(task, found.n, found.x, step)
    return evaluate(task, n, x, weight), promised


def moved(task: Task, n: Vec3, x: Array, step: Sequence[Array]) -> tuple[Vec3, Array]:
    """Return n and x = log n_s a step on, which is no longer than what a linear model is good for."""
    if task.fit_exponent:
        x = jnp.clip(x + jnp.clip(step[-1], -FARTHEST[1], FARTHEST[1]), LOW, HIGH)
    return (tilted(n, step[0], step[1]) if task.fit_normal else n), x


def tilted(n: Vec3, a: Array, b: Array) -> Vec3:
    """Return normals tilted by a and b along their tangents."""
    along, across = tangents(n)
    far = jnp.sqrt(a**2 + b**2)
    shorter = jnp.where(far > FARTHEST[0], FARTHEST[0] / jnp.where(far > 0, far, 1.0), 1.0)
    return normalize(n + along * (a * shorter) + across * (b * shorter))


def costs_on_grid(task: Task, n: Vec3, weight: Array) -> Float[Array, "grid texels"]:
    """Return the cost of squares at every n_s of the grid."""
    return jax.lax.map(lambda x: project(task, n, jnp.full(n.x.shape, x), weight), jnp.asarray(GRID))


def sharpest(task: Task, n: Vec3, weight: Array) -> Float[Array, " texels"]:
    """Return the best log n_s of the grid, by squares."""
    return jnp.asarray(GRID)[jnp.argmin(costs_on_grid(task, n, weight), 0)]


def brightest_direction(lighting: LightingGeometry, seen_light: Array, counts: Array) -> Vec3:
    """Return normals by photometric stereo of a matte surface (Woodham 1980), from each texel's middle observations.

    `seen_light`: (views, texels), what each view shows beyond black and ambient, the mean of its channels. Of the
    observations, each divided by its light, the darkest fifth (shadows) and the brightest three tenths (highlights) are
    left out.
    """
    mean = lighting.strength.mean(1)  # (views, emitters, texels)
    arriving = Vec3(*(jnp.sum(mean * c, 1) for c in (lighting.l.x, lighting.l.y, lighting.l.z)))
    size = jnp.sqrt(arriving.x**2 + arriving.y**2 + arriving.z**2)
    usable = counts & (size > 0.0)
    per_light = jnp.where(usable, seen_light / jnp.where(size > 0.0, size, 1.0), jnp.inf)
    number = jnp.sum(usable, 0, dtype=float)
    order = jnp.sort(per_light, 0)
    first = jnp.floor(0.2 * number)
    last = jnp.minimum(jnp.maximum(jnp.ceil(0.7 * number), first + 4.0), number) - 1.0
    low, high = (jnp.take_along_axis(order, jnp.maximum(i, 0.0).astype(int)[None], 0)[0] for i in (first, last))
    middle = usable & (per_light >= low[None]) & (per_light <= high[None])
    l = [jnp.where(middle, c / jnp.where(size > 0.0, size, 1.0), 0.0) for c in (arriving.x, arriving.y, arriving.z)]
    y = jnp.where(middle, per_light, 0.0)
    g = solve([[jnp.sum(a * b, 0) for b in l] for a in l], [jnp.sum(a * y, 0) for a in l])
    n = normalize(Vec3(*g))
    return where(n.x**2 + n.y**2 + n.z**2 > 0.5, n, jax.tree.map(lambda c: c[0] + jnp.zeros_like(n.x), lighting.v))
