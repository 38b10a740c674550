"""Estimates: one block of texels from photographs to numbers, their errors, and what could be seen there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, UInt8

from ..fields import Array
from ..vectors import Vec3, dot, normalize
from .coefficients import RIDGE, inverse_diagonal
from .descent import HIGH, LOW, Descent, brightest_direction, chosen, descend, sharpest
from .geometry import FLAT, NARROW, out_of_plane, scatter
from .passes import Known, Photographs, Task, evaluate, features, first_weights, looks, reduced
from .sights import Rig, Sights, sights_of

STATUS = ("outside", "determined", "no highlight seen", "not determined", "shadowed", "failed")
OUTSIDE, DETERMINED, NO_HIGHLIGHT, UNDETERMINED, SHADOWED, FAILED = range(len(STATUS))
SEEN = 8.0  # F of the highlight: how much it must explain for each of its numbers, in variances of a sample
MEDIAN = {1: 0.6745, 3: 0.8880}  # of chi / sqrt(C), for C channels
WILD = 100.0  # k_s beside the brightest sample, above which a highlight is a number that ran away
APART = 100.0  # how much larger an error may be for what is not known beside it
HUGE = 1e30  # a value that no map can hold
VAGUE = 0.5  # standard error of log n_s, and of k_s as a share of it, from which on a highlight is not determined
LEANING = 0.2  # standard error of k_d n as a share of its length, up to which it is told which way it points
FARTHER = (4.0, 1.5)  # how far along n_s a texel's valley is looked at: in errors of log n_s, and at most
PROFILE = 6  # steps in which all else comes to its best there
SAME = 0.02  # radians between normals, up to which two minima are one
AS_GOOD = 9.0  # variances of a sample by which two minima may differ and explain the photographs alike
MISFIT = 1.5  # by which what is left may exceed what is left of most texels, beside what chance does
CHANCE = 4.0  # standard deviations that chance does
DRIFT = 4.0  # errors by which a highlight that is not seen may move what is known without it


class Choices(NamedTuple):
    """What a fit of texels was asked for: what is free, and how residuals count."""

    free: tuple[str, ...]
    loss: str
    uniform: bool
    known_noise: bool
    shared: bool = False
    """Whether n_s is a region's, found before."""
    narrow: bool = False
    """Whether the lights come from so near each other that a highlight and a tilted normal look alike."""


class Block(eqx.Module):
    """A block of texels: where they are, and what the views show of them."""

    n: Vec3
    p: Vec3 | None
    v: Vec3
    seen: Photographs
    log_n_s: Float[Array, " texels"]
    """Where it is not fitted: known, with an error of 0, or a region's, with the error that it has there."""
    log_n_s_error: Float[Array, " texels"]


class Estimates(eqx.Module):
    """The numbers of a block of texels and their standard errors; an error is infinite where nothing is known."""

    values: dict[str, Any]
    """Of each name an array (channels, texels)."""
    errors: dict[str, Any]
    """Of n_s its own, of the normal in degrees."""
    residual: Float[Array, " texels"]
    """Root mean square of what is left, in units of the photographs, or of their noise where that is known."""
    status: UInt8[Array, " texels"]
    done: Bool[Array, " texels"]
    """Whether more patience would change nothing."""
    variance: Float[Array, " texels"]
    """Of a sample of weight 1, by what is left; infinite without degrees of freedom."""
    level: Float[Array, " texels"]
    """Weighted mean square of what the views show."""


class Usual(eqx.Module):
    """What is left of most texels: their variance, and that beside their level, whichever of the two noise is like."""

    variance: Float[Array, ""]
    share: Float[Array, ""]

    def explains(self, variance: Array, level: Array, freedom: Array) -> Bool[Array, " texels"]:
        """Return where what is left is no more than chance makes of it (chi squared; Wilson and Hilferty 1931)."""
        of = 2.0 / (9.0 * jnp.maximum(freedom, 1.0))
        chance = (1.0 - of + CHANCE * jnp.sqrt(of)) ** 3
        return variance <= MISFIT**2 * chance * jnp.maximum(self.variance, self.share * level)


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
def estimate(
    rig: Rig, known: Known, block: Block, sigma: Array, usual: Usual, patience: Array, choices: Choices
) -> Estimates:
    """Return the estimates of a block: with a highlight where one explains enough, else without."""
    sights = sights_for(rig, block, choices)

    def best(known: Known, choices: Choices) -> Best:
        return _best(rig, known, sights, block, sigma, patience, choices)

    full, alone = best(known, choices), jnp.ones(block.n.x.shape, bool)
    if choices.narrow:
        other = _best(rig, known, sights, block, sigma, patience, choices, _mirroring(sights, block))
        full, alone = _better(full, other)
    every = jnp.ones(block.n.x.shape, bool)
    if "k_s" not in choices.free:
        return _finish(full, full, block, choices, usual, every, every, alone)
    plain = best(
        known.without_highlight(),
        choices._replace(free=tuple(name for name in choices.free if name not in ("k_s", "n_s"))),
    )
    numbers = full.task.unknowns - plain.task.unknowns
    explained = 2.0 * (plain.descent.found.cost - full.descent.found.cost) / numbers
    seen = (explained > SEEN * jnp.where(full.variance > 0.0, full.variance, 0.0)) & (full.freedom > 0.0)
    brightest = jnp.max(jnp.where(block.seen.counts[:, None], block.seen.target.astype(float), 0.0), (0, 1))
    k_s = full.descent.found.k[full.task.known.linear.index("k_s")]
    tame = (k_s < WILD * brightest[None]).all(0) & full.descent.done & (full.descent.found.cost < HUGE)
    return _finish(full, plain, block, choices, usual, seen, tame, alone)


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
    """Of a sample of weight 1: by what is left, or 1 where the noise is known."""
    left: Float[Array, " texels"]
    """The same by what is left, whatever is known."""
    room: Float[Array, " texels"]
    """How far the lights that reach it are out of one plane (`out_of_plane`), where the normal is free."""


def _best(
    rig: Rig,
    known: Known,
    sights: Any,
    block: Block,
    sigma: Array,
    patience: Array,
    choices: Choices,
    start: Vec3 | None = None,
) -> Best:
    """Find the minimum, from photometric stereo or from normals that are given."""
    task, n, weight = begin(rig, known, block, choices, sigma, sights)
    n = n if start is None else start
    x = sharpest(task, n, weight) if task.sharpening else block.log_n_s
    descent = descend(task, n, x, weight, patience)
    found = descent.found
    channels = block.seen.target.shape[1]
    lit = _lit(task, found.n, found.x)
    freedom = lit * channels - task.unknowns
    believed = jnp.minimum(found.share, lit) * channels - task.unknowns
    variance = jnp.where(freedom > 0, found.squares / jnp.maximum(believed, 1.0), jnp.inf)
    of_sample = jnp.ones_like(variance) if choices.known_noise else variance
    return Best(task, descent, lit, freedom, of_sample, variance, _room(task, descent))


def _room(task: Task, descent: Descent) -> Array:
    """Return how far the lights that reach each texel are out of one plane."""
    if not task.turning:
        return jnp.ones(descent.found.x.shape)
    assert isinstance(task.sights, Sights)
    ambient = "k_a" in task.known.linear
    return out_of_plane(scatter(task.rig, task.sights, descent.weight, descent.found.n, ambient=ambient))


def _mirroring(sights: Sights, block: Block) -> Vec3:
    """Return normals that mirror to us the light of each texel's brightest observation: halfway between it and us."""
    shown = jnp.where(block.seen.counts, block.seen.target.astype(float).mean(1), -jnp.inf)
    strength = sights.strength.mean(1)
    to_light = Vec3(*(jnp.sum(strength * c, 1) for c in (sights.l.x, sights.l.y, sights.l.z)))
    view = jnp.argmax(shown, 0)

    def brightest(component: Array) -> Array:
        return jnp.take_along_axis(jnp.broadcast_to(component, shown.shape), view[None], 0)[0]

    l = normalize(jax.tree.map(brightest, to_light))
    return normalize(l + jax.tree.map(lambda c: c[0] + jnp.zeros_like(l.x), sights.v))


def _better(one: Best, other: Best) -> tuple[Best, Array]:
    """Return the lower of two minima of each texel, and where it is alone: the other explains less, or is the same.

    Of a robust loss the first is kept, which began at photometric stereo: a lower cost may mean no more there than that
    fewer observations are believed.
    """
    robust = one.task.losses != ("squares",)
    first = (one.descent.found.cost <= other.descent.found.cost) | robust
    names = ("descent", "lit", "freedom", "variance", "left", "room")
    kept = Best(one.task, *(chosen(first, getattr(one, name), getattr(other, name)) for name in names))
    worse = jnp.where(first, 1.0, -1.0) * (other.descent.found.cost - one.descent.found.cost)
    same = dot(one.descent.found.n, other.descent.found.n) > jnp.cos(SAME)
    return kept, same | (2.0 * worse > AS_GOOD * kept.variance)


def _farther(best: Best, values: Mapping[str, Any], errors: Mapping[str, Any]) -> dict[str, Any]:
    """Return errors that hold farther along n_s too, where the valley bends and is longer than its curvature says.

    The cost is looked at again a few errors of log n_s up and down, all else at its best there (a profile: Bates and
    Watts 1988, chapter 6): what a number changes by on the way is as many of its errors as the root of what the cost
    rises by.
    """
    task, found = best.task, best.descent.found
    log_error = errors["n_s"][0] / values["n_s"][0]
    step = jnp.minimum(FARTHER[0] * jnp.where(jnp.isfinite(log_error), log_error, FARTHER[1]), FARTHER[1])
    held = dataclasses.replace(task, sharpening=False)

    def towards(sign: Array) -> dict[str, Array]:
        x = jnp.clip(found.x + sign * step, LOW, HIGH)
        there = descend(held, found.n, x, best.descent.weight, jnp.asarray(PROFILE)).found
        rise = 2.0 * jnp.maximum(there.cost - found.cost, 0.0) / best.variance
        change = {name: jnp.abs(a - b) for name, a, b in zip(task.known.linear, there.k, found.k, strict=True)}
        change["n_s"] = values["n_s"] * jnp.abs(x - found.x)[None]
        change["normal"] = jnp.rad2deg(jnp.arccos(jnp.clip(dot(found.n, there.n), -1.0, 1.0)))[None]
        return {name: change[name] / jnp.sqrt(jnp.maximum(rise, 1e-12))[None] for name in errors}

    both = jax.lax.map(towards, jnp.asarray([1.0, -1.0]))
    return {name: jnp.maximum(error, jnp.max(both[name], 0)) for name, error in errors.items()}


def _lit(task: Task, n: Vec3, x: Array) -> Array:
    """Return how many observations that count a light reaches."""

    def add(total: Array, view: Any) -> tuple[Array, None]:
        sight, counts = view
        u = task.sights.shading(sight, n, (), x).u
        return total + jnp.where(counts & (u > 0.0).any(0), 1.0, 0.0), None

    return jax.lax.scan(add, jnp.zeros(x.shape), (task.sights.views, task.seen.counts))[0]


def _errors(best: Best, block: Block, choices: Choices) -> tuple[Sequence[Array], Sequence[Array], Array]:
    """Return the standard errors of the coefficients in each channel and of the rest, and whether all are told apart.

    With nothing held at 0. A region's n_s counts as an unknown of the texel of which the region tells what it tells.
    """
    task, found, size = best.task, best.descent.found, len(best.descent.found.k)
    region = choices.shared and not task.sharpening and task.known.k_s is None
    if region:
        sharp = dataclasses.replace(task, sharpening=True)
        told = evaluate(sharp, found.n, found.x, best.descent.weight)
        found = dataclasses.replace(found, mixed=told.mixed, rest=told.rest)
    known = reduced(found, held=False)
    count = len(known.rest)
    rest = [
        [known.rest[i][j] + (RIDGE * found.rest[i][i] if i == j else 0.0) for j in range(count)] for i in range(count)
    ]
    if region:
        of_region = best.variance / jnp.maximum(block.log_n_s_error, 1e-12) ** 2
        rest[-1][-1] = jnp.maximum(rest[-1][-1], jnp.where(jnp.isfinite(of_region), of_region, 0.0))
    # what one channel's coefficients and the rest know together, the other channels' coefficients eliminated
    z = known.mixed
    corner = [
        [rest[i][j][None] + sum((a * b for a, b in zip(z[i], z[j], strict=True)), 0.0) for j in range(count)]
        for i in range(count)
    ]
    G, B = found.gram, found.mixed
    joint = [[*G[i], *B[i]] for i in range(size)]
    joint += [[*(B[i][j] for i in range(size)), *corner[j]] for j in range(count)]
    each = jnp.zeros_like(found.mixed[0][0]) if size and count else jnp.zeros((1, *found.x.shape))
    joint = [[element + each for element in row] for row in joint]
    inverse = inverse_diagonal(joint)
    deviation = [jnp.sqrt(best.variance[None] * v) for v in inverse]
    largest = jnp.max(jnp.stack([jnp.max(k, 0) for k in found.k]), 0) if size else jnp.ones_like(found.x)
    apart = jnp.ones(found.x.shape, bool)
    for i, name in enumerate(task.known.linear):
        lost = (deviation[i] > 0.3 * largest[None]) & (inverse[i] * joint[i][i] > APART**2)
        apart = apart & (True if name == "k_s" else ~lost.any(0))
    return deviation[:size], [d[0] for d in deviation[size:]], apart


def _named(best: Best, block: Block, choices: Choices) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """Return the values and errors of one fit by name, and whether all of them are told apart."""
    task, found = best.task, best.descent.found
    coefficients, rest, apart = _errors(best, block, choices)
    values = dict(zip(task.known.linear, found.k, strict=True))
    errors = dict(zip(task.known.linear, coefficients, strict=True))
    if task.sharpening:
        values["n_s"] = jnp.exp(found.x)[None]
        errors["n_s"] = values["n_s"] * rest[-1][None]
    elif choices.shared:
        values["n_s"] = jnp.exp(block.log_n_s)[None]
        errors["n_s"] = values["n_s"] * block.log_n_s_error[None]
    if task.turning:
        values["normal"] = jnp.stack([found.n.x, found.n.y, found.n.z])
        errors["normal"] = jnp.rad2deg(jnp.sqrt(rest[0] ** 2 + rest[1] ** 2))[None]
        for name in {"k_d", "normal"} & errors.keys():  # in one plane, whatever the linear theory makes of it
            errors[name] = jnp.where((best.room > FLAT)[None], errors[name], jnp.inf)
    return values, errors, apart


def _finish(
    full: Best, plain: Best, block: Block, choices: Choices, usual: Usual, seen: Array, tame: Array, alone: Array
) -> Estimates:
    """Choose between the fits with and without a highlight, and say what became of each texel.

    `seen`: where a highlight explains enough; `tame`: where the fit with one ended at numbers that mean something;
    `alone`: where no other minimum explains as much.
    """
    values, errors, apart = _named(full, block, choices)
    if full.task.sharpening:
        errors = _farther(full, values, errors)
    level = _level(full.task)
    glossy = seen & tame
    shines = glossy & _highlight_known(full, values, errors)
    told = apart & _told(full, values, errors)
    vague = (seen & ~shines) | ~alone
    if plain is not full:
        matte, of_matte, apart_too = _named(plain, block, choices)
        if full.task.turning:  # a broad highlight, too weak to be seen, may look like a part of k_d or a tilt
            near = plain.room < NARROW
            vague = vague | (near & ~seen & tame & _drifted(values, matte, of_matte))
            near = (near & full.descent.done)[None]
            of_matte = {name: jnp.where(near, jnp.maximum(e, errors[name]), e) for name, e in of_matte.items()}
        told = jnp.where(glossy, told, apart_too & _told(plain, matte, of_matte))
        channels, texels = full.task.seen.target.shape[1:]
        widths = {"k_s": channels, "n_s": 1}
        matte |= {name: jnp.zeros((width, texels)) for name, width in widths.items()}
        of_matte |= {name: jnp.full((width, texels), jnp.inf) for name, width in widths.items()}
        values = {name: chosen(glossy, value, matte[name]) for name, value in values.items()}
        errors = {name: chosen(glossy, error, of_matte[name]) for name, error in errors.items()}
    lit, freedom = (jnp.where(glossy, getattr(full, of), getattr(plain, of)) for of in ("lit", "freedom"))
    left = jnp.where(glossy, full.left, plain.left)
    vague = vague | ~usual.explains(left, level, freedom)
    few = (freedom <= 0) | (lit < (3 if full.task.turning else 1))
    done = jnp.where(glossy, full.descent.done, plain.descent.done)
    finite = jnp.ones(seen.shape, bool)
    for value in values.values():
        finite = finite & (jnp.abs(value) < HUGE).all(0)
    status = jnp.where(shines, DETERMINED, NO_HIGHLIGHT)
    status = jnp.where(vague | ~told, UNDETERMINED, status)
    status = jnp.where(~done | ~finite, FAILED, status)
    status = jnp.where(few, SHADOWED, status)
    if "k_s" in values:  # a highlight that is not believed is not shown: relit, it would be a firefly
        believed = status == DETERMINED
        for name in {"k_s", "n_s"} & values.keys():
            values[name] = jnp.where(believed[None], values[name], 0.0)
            errors[name] = jnp.where(believed[None], errors[name], jnp.inf)
    if "normal" in errors:  # a direction that may be anywhere
        errors["normal"] = jnp.where(errors["normal"] > 90.0, jnp.inf, errors["normal"])
    lost = (few | ~finite)[None]
    values = {name: jnp.where(finite[None], value, 0.0) for name, value in values.items()}
    errors = {name: jnp.where(lost | jnp.isnan(error), jnp.inf, error) for name, error in errors.items()}
    residual = jnp.sqrt(jnp.where(glossy, _mean_square(full), _mean_square(plain)))
    ended = plain.descent.done & full.descent.done
    residual = jnp.where(finite, residual, 0.0)
    return Estimates(values, errors, residual, status.astype(jnp.uint8), ended, left, level)


def _level(task: Task) -> Array:
    """Return the weighted mean square of what the views show."""
    squares = jnp.sum(first_weights(task) * task.seen.target.astype(float) ** 2, (0, 1))
    return squares / jnp.maximum(task.samples, 1.0)


def _told(best: Best, values: Mapping[str, Any], errors: Mapping[str, Any]) -> Array:
    """Return where every number but the highlight's has an error, and the normal one that holds."""
    told = jnp.ones(best.lit.shape, bool)
    for name, error in errors.items():
        told = told if name in ("k_s", "n_s") else told & jnp.isfinite(error).all(0)
    if not best.task.turning:
        return told
    square = jnp.deg2rad(errors["normal"][0]) ** 2
    if "k_d" in values:  # of its channels, the best known one: they all share the error of the vector's length
        share = errors["k_d"] / jnp.where(values["k_d"] > 0.0, values["k_d"], 1e-300)
        square = square + jnp.min(share, 0) ** 2
    return told & (square < LEANING**2)


def _highlight_known(full: Best, values: Mapping[str, Any], errors: Mapping[str, Any]) -> Array:
    """Return where the numbers of a highlight are known, so far as they were free."""
    known = jnp.ones(full.lit.shape, bool)
    if "n_s" in values:
        x = full.descent.found.x
        known = known & (errors["n_s"][0] <= VAGUE * values["n_s"][0]) & (x > LOW) & (x < HIGH)
    if "k_s" in values:  # by the channel that shines most
        k_s, error = values["k_s"], errors["k_s"]
        most = k_s == jnp.max(k_s, 0)[None]
        known = known & jnp.where(most, error <= VAGUE * k_s, True).all(0)
    return known


def _drifted(values: Mapping[str, Any], matte: Mapping[str, Any], of_matte: Mapping[str, Any]) -> Array:
    """Return where a highlight, too weak to be seen, would move the other numbers by more than their errors allow."""
    far = jnp.zeros(next(iter(matte.values())).shape[1:], bool)
    for name, value in matte.items():
        off = jnp.abs(values[name] - value)
        if name == "normal":
            off = jnp.rad2deg(jnp.sqrt(jnp.sum(off**2, 0)))[None]
        far = far | (off > DRIFT * of_matte[name]).any(0)
    return far


def _mean_square(best: Best) -> Array:
    """Return the mean square of the weighted residuals, as the loss believes them."""
    return best.descent.found.squares / jnp.maximum(best.task.samples, 1.0)


@partial(jax.jit, static_argnames="choices")
def residual_sizes(
    rig: Rig, known: Known, block: Block, sigma: Array, patience: Array, choices: Choices
) -> Float[Array, "views texels"]:
    """Return the size of the residuals of each observation, the root mean square of its channels.

    In units in which its median is the standard deviation of Gaussian noise: divided by the root of the share of the
    observations that the unknowns leave, and by the median of chi / sqrt(C) of C channels.
    """
    best = _best(rig, known, sights_for(rig, block, choices), block, sigma, patience, choices)
    task, found = best.task, best.descent.found

    def of_view(look: Any) -> Array:
        F = features(task, look, found.n, found.x, ())
        m = F.predicted(found.k)
        return jnp.sqrt(jnp.mean((m - look.target.astype(found.x.dtype)) ** 2, 0))

    left = jnp.clip((task.samples - task.unknowns) / jnp.maximum(task.samples, 1.0), 0.05, 1.0)
    return jax.lax.map(of_view, looks(task, None)) / (MEDIAN[len(block.seen.target[0])] * jnp.sqrt(left)[None])
