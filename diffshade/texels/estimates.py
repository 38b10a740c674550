"""Estimates: one block of texels from photographs to numbers, their errors, and what could be seen there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float, UInt8

from ..fields import Array
from ..vectors import Vec3
from .coefficients import RIDGE, inverse_diagonal
from .descent import HIGH, LOW, Descent, brightest_direction, chosen, descend, sharpest
from .passes import Known, Photographs, Task, features, first_weights, looks, reduced
from .sights import Rig, Sights, sights_of

STATUS = ("outside", "determined", "no highlight seen", "not determined", "shadowed", "failed")
OUTSIDE, DETERMINED, NO_HIGHLIGHT, UNDETERMINED, SHADOWED, FAILED = range(len(STATUS))
SEEN = 8.0  # F of the highlight: how much it must explain for each of its numbers, in variances of a sample
HUGE = 1e30  # a value that no map can hold
VAGUE = 0.5  # standard error of log n_s, from which on it is not determined


class Choices(NamedTuple):
    """What a fit of texels was asked for: what is free, and how residuals count."""

    free: tuple[str, ...]
    loss: str
    uniform: bool
    known_noise: bool


class Block(eqx.Module):
    """A block of texels: where they are, and what the views show of them."""

    n: Vec3
    p: Vec3 | None
    v: Vec3
    seen: Photographs
    log_n_s: Float[Array, " texels"]


class Estimates(eqx.Module):
    """The numbers of a block of texels and their standard errors; an error is infinite where nothing is known."""

    values: dict[str, Any]
    """Of each name an array (channels, texels)."""
    errors: dict[str, Any]
    """Of n_s its own, of the normal in degrees."""
    residual: Float[Array, " texels"]
    """Root mean square of what is left, in units of the photographs, or of their noise where that is known."""
    status: UInt8[Array, " texels"]


def task_of(rig: Rig, known: Known, sights: Any, block: Block, choices: Choices, sigma: Array) -> Task:
    """Return what is to be fitted in a block: by squares, or by a convex loss and then by the one asked for."""
    losses = ("squares",) if choices.loss == "squares" else tuple(dict.fromkeys(["huber", choices.loss]))
    return Task(
        rig,
        known,
        sights,
        block.seen,
        sigma,
        jnp.asarray(0),
        losses,
        uniform=choices.uniform,
        turning="normal" in choices.free,
        sharpening="n_s" in choices.free,
    )


@partial(jax.jit, static_argnames="choices")
def estimate(rig: Rig, known: Known, block: Block, sigma: Array, patience: Array, choices: Choices) -> Estimates:
    """Return the estimates of a block: with a highlight where one explains enough, else without."""
    sights = sights_for(rig, block, choices)

    def best(known: Known, choices: Choices) -> Best:
        return _best(rig, known, sights, block, sigma, patience, choices)

    full = best(known, choices)
    if "k_s" not in choices.free:
        return _finish(full, full, choices, jnp.ones(block.n.x.shape, bool))
    dark = eqx.tree_at(lambda k: k.k_s, known, jnp.zeros_like(known.k_e), is_leaf=lambda leaf: leaf is None)
    matte = choices._replace(free=tuple(name for name in choices.free if name not in ("k_s", "n_s")))
    plain = best(dark, matte)
    numbers = full.task.unknowns - plain.task.unknowns
    explained = 2.0 * (plain.descent.found.cost - full.descent.found.cost) / numbers
    enough = explained > SEEN * jnp.where(full.variance > 0.0, full.variance, 0.0)
    return _finish(full, plain, choices, enough & (full.freedom > 0.0))


def begin(
    rig: Rig, known: Known, block: Block, choices: Choices, sigma: Any = 1.0, sights: Any = None
) -> tuple[Task, Vec3, Array]:
    """Return what is to be fitted in a block, the normals to begin at, and the weights to begin with."""
    if sights is None:
        sights = sights_for(rig, block, choices)
    task = task_of(rig, known, sights, block, choices, jnp.asarray(sigma))
    n = block.n
    if task.turning:
        shown = (
            block.seen.target.astype(float) - (rig.black[:, None] + rig.exposure[:, None] * known.k_e[None])[..., None]
        )
        if known.k_a is not None:
            shown = shown - (rig.exposure[:, None] * (rig.ambient * known.k_a)[None])[..., None]
        assert isinstance(task.sights, Sights)
        n = brightest_direction(task.sights, shown.mean(1), block.seen.counts)
    return task, n, first_weights(task)


def sights_for(rig: Rig, block: Block, choices: Choices) -> Any:
    """Return the sights of a block, those of its own normals where these stay."""
    sights = sights_of(rig, block.p, block.v)
    return sights if "normal" in choices.free else sights.facing(block.n)


class Best(eqx.Module):
    """The minimum of every texel for one set of unknowns."""

    task: Task
    descent: Descent
    lit: Float[Array, " texels"]
    """How many observations a light reaches that count."""
    freedom: Float[Array, " texels"]
    """By how much those outnumber the unknowns."""
    variance: Float[Array, " texels"]
    """Of a sample of weight 1."""


def _best(rig: Rig, known: Known, sights: Any, block: Block, sigma: Array, patience: Array, choices: Choices) -> Best:
    """Find the minimum."""
    task, n, weight = begin(rig, known, block, choices, sigma, sights)
    x = sharpest(task, n, weight) if task.sharpening else block.log_n_s
    descent = descend(task, n, x, weight, patience)
    found = descent.found
    channels = block.seen.target.shape[1]
    lit = _lit(task, found.n, found.x)
    freedom = lit * channels - task.unknowns
    believed = jnp.minimum(found.share, lit) * channels - task.unknowns
    variance = jnp.where(freedom > 0, found.squares / jnp.maximum(believed, 1.0), jnp.inf)
    return Best(task, descent, lit, freedom, jnp.ones_like(variance) if choices.known_noise else variance)


def _lit(task: Task, n: Vec3, x: Array) -> Array:
    """Return how many observations that count a light reaches."""

    def add(total: Array, view: Any) -> tuple[Array, None]:
        sight, counts = view
        u = task.sights.shading(sight, n, (), x).u
        return total + jnp.where(counts & (u > 0.0).any(0), 1.0, 0.0), None

    return jax.lax.scan(add, jnp.zeros(x.shape), (task.sights.views, task.seen.counts))[0]


def _errors(best: Best) -> tuple[Sequence[Array], Sequence[Array]]:
    """Return the standard errors of the coefficients in each channel, and of the rest: with nothing held at 0."""
    found, size = best.descent.found, len(best.descent.found.k)
    known = reduced(found, held=False)
    count = len(known.rest)
    rest = [
        [known.rest[i][j] + (RIDGE * found.rest[i][i] if i == j else 0.0) for j in range(count)] for i in range(count)
    ]
    # what one channel's coefficients and the rest know together, the other channels' coefficients eliminated
    corner = [
        [
            rest[i][j][None] + sum((a * b for a, b in zip(known.mixed[i], known.mixed[j], strict=True)), 0.0)
            for j in range(count)
        ]
        for i in range(count)
    ]
    G, B = found.gram, found.mixed
    joint = [[*G[i], *B[i]] for i in range(size)]
    joint += [[*(B[i][j] for i in range(size)), *corner[j]] for j in range(count)]
    each = jnp.zeros_like(found.mixed[0][0]) if size and count else jnp.zeros((1, *found.x.shape))
    joint = [[element + each for element in row] for row in joint]
    deviation = [jnp.sqrt(best.variance[None] * v) for v in inverse_diagonal(joint)]
    return deviation[:size], [d[0] for d in deviation[size:]]


def _named(best: Best) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the values and errors of one fit by name."""
    task, found = best.task, best.descent.found
    coefficients, rest = _errors(best)
    values = dict(zip(task.known.linear, found.k, strict=True))
    errors = dict(zip(task.known.linear, coefficients, strict=True))
    if task.sharpening:
        values["n_s"] = jnp.exp(found.x)[None]
        errors["n_s"] = values["n_s"] * rest[-1][None]
    if task.turning:
        values["normal"] = jnp.stack([found.n.x, found.n.y, found.n.z])
        errors["normal"] = jnp.rad2deg(jnp.sqrt(rest[0] ** 2 + rest[1] ** 2))[None]
    return values, errors


def _finish(full: Best, plain: Best, choices: Choices, shines: Array) -> Estimates:
    """Choose between the fits with and without a highlight, and say what became of each texel."""
    values, errors = _named(full)
    status = jnp.where(shines, DETERMINED, NO_HIGHLIGHT)
    done = jnp.where(shines, full.descent.done, plain.descent.done)
    freedom = jnp.where(shines, full.freedom, plain.freedom)
    residual = jnp.sqrt(jnp.where(shines, _mean_square(full), _mean_square(plain)))
    vague = jnp.zeros(shines.shape, bool)
    if "n_s" in choices.free:
        x = full.descent.found.x
        vague = shines & ((errors["n_s"][0] > VAGUE * values["n_s"][0]) | (x <= LOW) | (x >= HIGH))
    if plain is not full:
        matte, of_matte = _named(plain)
        channels = full.task.seen.target.shape[1]
        matte |= {"k_s": jnp.zeros((channels, *shines.shape)), "n_s": jnp.zeros((1, *shines.shape))}
        nothing = jnp.full((1, *shines.shape), jnp.inf)
        of_matte |= {"k_s": jnp.broadcast_to(nothing, (channels, *shines.shape)), "n_s": nothing}
        values = {name: chosen(shines, value, matte[name]) for name, value in values.items()}
        errors = {name: chosen(shines, error, of_matte[name]) for name, error in errors.items()}
    vague = vague | ~jnp.all(
        jnp.stack([jnp.isfinite(e).all(0) for a, e in errors.items() if a not in ("k_s", "n_s")]), 0
    )
    few = (freedom <= 0) | (jnp.where(shines, full.lit, plain.lit) < (3 if full.task.turning else 1))
    finite = jnp.all(jnp.stack([(jnp.abs(value) < HUGE).all(0) for value in values.values()]), 0)
    status = jnp.where(vague, UNDETERMINED, status)
    status = jnp.where(~done | ~finite, FAILED, status)
    status = jnp.where(few, SHADOWED, status)
    lost = few | ~finite
    values = {name: jnp.where(finite[None], value, 0.0) for name, value in values.items()}
    errors = {name: jnp.where(lost[None] | jnp.isnan(error), jnp.inf, error) for name, error in errors.items()}
    return Estimates(values, errors, residual, status.astype(jnp.uint8))


def _mean_square(best: Best) -> Array:
    """Return the mean square of the weighted residuals, as the loss believes them."""
    return best.descent.found.squares / jnp.maximum(best.task.samples, 1.0)


@partial(jax.jit, static_argnames="choices")
def residual_sizes(
    rig: Rig, known: Known, block: Block, sigma: Array, patience: Array, choices: Choices
) -> Float[Array, "views texels"]:
    """Return the size of the residuals of each observation, the root of the sum of squares over its channels.

    Divided by what makes its median, in Gaussian noise, that of one channel: the root of the number of channels, and of
    the share of the observations that the unknowns leave.
    """
    best = _best(rig, known, sights_for(rig, block, choices), block, sigma, patience, choices)
    task, found = best.task, best.descent.found

    def of_view(look: Any) -> Array:
        F = features(task, look, found.n, found.x, ())
        m = sum((k * column for k, column in zip(found.k, F.columns, strict=True)), F.base)
        return jnp.sqrt(jnp.mean((m - look.target.astype(found.x.dtype)) ** 2, 0))

    left = jnp.clip((task.samples - task.unknowns) / jnp.maximum(task.samples, 1.0), 0.05, 1.0)
    return jax.lax.map(of_view, looks(task, None)) / jnp.sqrt(left)[None]
