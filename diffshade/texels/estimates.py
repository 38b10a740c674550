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

from ..core.fields import Array
from ..model.vectors import Vec3, dot, normalize
from .coefficients import RIDGE, inverse_diagonal, solve
from .descent import FARTHEST, HIGH, LOW, Descent, brightest_direction, chosen, descend, moved, sharpest, tilted
from .geometry import FLAT, out_of_plane, scatter
from .lighting import LightingGeometry, LightingSetup, sights_of
from .normal_equations import Found, Known, Photographs, Task, evaluate, features, first_weights, looks, reduced

STATUS = ("outside", "determined", "no highlight seen", "not determined", "shadowed", "failed")
OUTSIDE, DETERMINED, NO_HIGHLIGHT, UNDETERMINED, SHADOWED, FAILED = range(len(STATUS))
SEEN = 8.0  # F of the highlight: how much it must explain for each of its numbers, in variances of a sample
MEDIAN = {1: 0.6745, 3: 0.8880}  # of chi / sqrt(C), for C channels
WILD = 100.0  # k_s beside the brightest sample, above which a highlight is a number that ran away
APART = 100.0  # how much larger an error may be for what is not known beside it
HUGE = 1e30  # a value that no map can hold
VAGUE = 0.5  # standard error of log n_s, from which on a highlight is not determined
FAINT = 1.0  # and of k_s, as a share of it
LEANING = 0.2  # standard error of k_d n as a share of its length, up to which it is told which way it points
FARTHER = 4.0  # errors up and down to which a texel's valley is looked at
LIKELY = 36.0  # variances by which the cost may rise that errors are to reach: 25, and a place is short of its best
FAR = 3.0  # and of log n_s: a factor of 20, about what minima are apart
PLACES = 2  # that are looked at on each way, each nearer to the best
HELD = 1e6  # how firmly that stays where it is which the way is along
LEVEL = 0.01  # what a cost rises by at least, in variances, where a valley has no slope
BEYOND = 10.0  # k_s beside the brightest sample, farther than which errors do not look: no photograph bounds some above
MISFIT = 1.5  # by which what is left may exceed what is left of most texels, beside what chance does
CHANCE = 4.0  # standard deviations that chance does
EXACT = 1e-4  # of what is shown: less is not left by photographs, but by the digits of a number


class Choices(NamedTuple):
    """What a fit of texels was asked for: what is free, and how residuals count."""

    free: tuple[str, ...]
    loss: str
    homoscedastic: bool
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
        most = jnp.maximum(jnp.maximum(self.variance, self.share * level), EXACT**2 * level)
        return variance <= MISFIT**2 * chance * most


def task_of(setup: LightingSetup, known: Known, lighting: Any, block: Block, choices: Choices, sigma: Array) -> Task:
    """Return what is to be fitted in a block: by squares, or by a convex loss and then by the one asked for."""
    losses = ("squares",) if choices.loss == "squares" else tuple(dict.fromkeys(["huber", choices.loss]))
    return Task(
        setup,
        known,
        lighting,
        block.seen,
        sigma,
        jnp.asarray(0),
        losses,
        homoscedastic=choices.homoscedastic,
        fit_normal="normal" in choices.free,
        fit_exponent="n_s" in choices.free,
    )


@partial(jax.jit, static_argnames="choices")
def estimate(
    setup: LightingSetup, known: Known, block: Block, sigma: Array, usual: Usual, patience: Array, choices: Choices
) -> Estimates:
    """Return the estimates of a block: with a highlight where one explains enough, else without."""
    lighting = sights_for(setup, block, choices)

    def best(known: Known, choices: Choices) -> Best:
        return _best(setup, known, lighting, block, sigma, patience, choices)

    full, other = best(known, choices), None
    if choices.narrow:
        full, other = _lower(
            full, _best(setup, known, lighting, block, sigma, patience, choices, _mirroring(lighting, block))
        )
    every = jnp.ones(block.n.x.shape, bool)
    if "k_s" not in choices.free:
        return _finish(full, full, other, block, choices, usual, every, every)
    plain = best(
        known.without_highlight(),
        choices._replace(free=tuple(name for name in choices.free if name not in ("k_s", "n_s"))),
    )
    numbers = full.task.unknowns - plain.task.unknowns
    explained = 2.0 * (plain.descent.found.cost - full.descent.found.cost) / numbers
    seen = (explained > SEEN * jnp.where(full.variance > 0.0, full.variance, 0.0)) & (full.freedom > 0.0)
    k_s = full.descent.found.k[full.task.known.linear.index("k_s")]
    plausible = (k_s < WILD * _brightest(block)[None]).all(0) & full.descent.done & (full.descent.found.cost < HUGE)
    return _finish(full, plain, other, block, choices, usual, seen, plausible)


def begin(
    setup: LightingSetup, known: Known, block: Block, choices: Choices, sigma: Any = 1.0, lighting: Any = None
) -> tuple[Task, Vec3, Array]:
    """Return what is to be fitted in a block, the normals to begin at, and the weights to begin with."""
    if lighting is None:
        lighting = sights_for(setup, block, choices)
    task = task_of(setup, known, lighting, block, choices, jnp.asarray(sigma))
    n = block.n
    if task.fit_normal:
        shown = (
            block.seen.target.astype(float)
            - (setup.black[:, None] + setup.exposure[:, None] * known.k_e[None])[..., None]
        )
        if known.k_a is not None:
            shown = shown - (setup.exposure[:, None] * (setup.ambient * known.k_a)[None])[..., None]
        assert isinstance(task.lighting, LightingGeometry)
        n = brightest_direction(task.lighting, shown.mean(1), block.seen.counts)
    return task, n, first_weights(task)


def sights_for(setup: LightingSetup, block: Block, choices: Choices) -> Any:
    """Return the sights of a block, those of its own normals where these stay."""
    lighting = sights_of(setup, block.p, block.v)
    return lighting if "normal" in choices.free else lighting.facing(block.n)


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
    setup: LightingSetup,
    known: Known,
    lighting: Any,
    block: Block,
    sigma: Array,
    patience: Array,
    choices: Choices,
    start: Vec3 | None = None,
) -> Best:
    """Find the minimum, from photometric stereo or from normals that are given."""
    task, n, weight = begin(setup, known, block, choices, sigma, lighting)
    n = n if start is None else start
    x = sharpest(task, n, weight) if task.fit_exponent else block.log_n_s
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
    if not task.fit_normal:
        return jnp.ones(descent.found.x.shape)
    assert isinstance(task.lighting, LightingGeometry)
    ambient = "k_a" in task.known.linear
    return out_of_plane(scatter(task.setup, task.lighting, descent.weight, descent.found.n, ambient=ambient))


def _mirroring(lighting: LightingGeometry, block: Block) -> Vec3:
    """Return normals that mirror to us the light of each texel's brightest observation: halfway between it and us."""
    shown = jnp.where(block.seen.counts, block.seen.target.astype(float).mean(1), -jnp.inf)
    strength = lighting.strength.mean(1)
    to_light = Vec3(*(jnp.sum(strength * c, 1) for c in (lighting.l.x, lighting.l.y, lighting.l.z)))
    view = jnp.argmax(shown, 0)

    def brightest(component: Array) -> Array:
        return jnp.take_along_axis(jnp.broadcast_to(component, shown.shape), view[None], 0)[0]

    l = normalize(jax.tree.map(brightest, to_light))
    return normalize(l + jax.tree.map(lambda c: c[0] + jnp.zeros_like(l.x), lighting.v))


def _lower(one: Best, other: Best) -> tuple[Best, Best]:
    """Return the lower of two minima of each texel, and the other one.

    Of a robust loss the first is kept, which began at photometric stereo: a lower cost may mean no more there than that
    fewer observations are believed.
    """
    robust = one.task.losses != ("squares",)
    first = (one.descent.found.cost <= other.descent.found.cost) | robust
    names = ("descent", "lit", "freedom", "variance", "left", "room")

    def of(a: Best, b: Best) -> Best:
        return Best(one.task, *(chosen(first, getattr(a, name), getattr(b, name)) for name in names))

    return of(one, other), of(other, one)


def _brightest(block: Block) -> Float[Array, " texels"]:
    """Return the brightest sample of each texel."""
    return jnp.max(jnp.where(block.seen.counts[:, None], block.seen.target.astype(float), 0.0), (0, 1))


def _farther(
    best: Best, other: Best | None, block: Block, values: Mapping[str, Any], errors: Mapping[str, Any]
) -> dict[str, Any]:
    """Return errors that hold farther along the valley of each texel too, where it bends or another one begins.

    The cost is looked at again to both sides: a few errors along log n_s and along the tilt of the normal that is known
    worst, and at an n_s far off; all else comes near its best there (a profile: Bates and Watts 1988, chapter 6). The
    `other` minimum, where one was looked for, is such a place too. At none of them may a number be off by more of its
    errors than the root of what the cost rises by: the largest error that any place asks for holds.
    """
    task, found = best.task, best.descent.found
    count, most = len(found.rest), BEYOND * _brightest(block)[None]
    A = _with_ridge(reduced(found, held=False).rest, found)

    def asked(n: Vec3, there: Found) -> dict[str, Array]:
        """Return the error that each number must have, for this place to be as unlikely as its cost says."""
        rise = 2.0 * jnp.maximum(there.cost - found.cost, 0.0) / best.variance
        change = {
            name: jnp.minimum(jnp.abs(a - b), most)
            for name, a, b in zip(task.known.linear, there.k, found.k, strict=True)
        }
        if task.fit_exponent:
            change["n_s"] = values["n_s"] * jnp.abs(there.x - found.x)[None]
        if task.fit_normal:
            change["normal"] = jnp.rad2deg(jnp.arccos(jnp.clip(dot(found.n, n), -1.0, 1.0)))[None]
        counts = jnp.where(rise < LIKELY, 1.0 / jnp.sqrt(jnp.maximum(rise, LEVEL)), 0.0)[None]
        return {name: off * counts for name, off in change.items()}

    def towards(way: Array, across: Array) -> dict[str, Array]:
        """Return what is asked for some way off and nearer the best there, along `across` no nearer."""

        def view_slice(place: tuple[Vec3, Array], _: None) -> tuple[Any, dict[str, Array]]:
            there = evaluate(task, *place, best.descent.weight)
            B = _with_ridge(reduced(there, held=True).rest, there)
            firm = HELD * sum((B[i][i] for i in range(count)), jnp.zeros_like(found.x))
            B = [[B[i][j] + firm * across[i] * across[j] for j in range(count)] for i in range(count)]
            return moved(task, *place, [-step for step in solve(B, there.slope)]), asked(place[0], there)

        n = tilted(found.n, way[0], way[1]) if task.fit_normal else found.n
        x = jnp.clip(found.x + way[-1], LOW, HIGH) if task.fit_exponent else found.x
        return _largest(jax.lax.scan(view_slice, (n, x), None, PLACES)[1])

    def along(across: Sequence[Array]) -> list[Array]:
        """Return the way along which `across` . unknowns grows at the least cost, a few errors of it."""
        way = solve(A, across)
        size = jnp.sqrt(jnp.maximum(sum((a * w for a, w in zip(across, way, strict=True)), 0.0), 1e-300))
        way = [FARTHER * jnp.sqrt(best.variance) * w / size for w in way]
        longest = jnp.abs(way[-1]) / FARTHEST[1] if task.fit_exponent else jnp.zeros_like(found.x)
        if task.fit_normal:
            longest = jnp.maximum(longest, jnp.sqrt(way[0] ** 2 + way[1] ** 2) / FARTHEST[0])
        return [w / jnp.maximum(longest, 1.0) for w in way]

    zero, one = jnp.zeros_like(found.x), jnp.ones_like(found.x)
    ways = []
    if task.fit_exponent:
        last = [zero] * (count - 1) + [one]
        ways += [(along(last), last), ([FAR * w for w in last], last)]
    if task.fit_normal:
        C = [solve(A, [one if i == j else zero for i in range(count)]) for j in range(2)]
        turn = 0.5 * jnp.arctan2(2.0 * C[0][1], C[0][0] - C[1][1])  # of the axis that is known worst
        worst = [jnp.cos(turn), jnp.sin(turn)] + [zero] * (count - 2)
        ways.append((along(worst), worst))
    way, across = (jnp.stack([jnp.stack(rows) for rows in each]) for each in zip(*ways, strict=True))
    both = jnp.concatenate([way, -way]), jnp.concatenate([across, across])
    errors = _larger(errors, _largest(jax.lax.map(lambda each: towards(*each), both)))
    return errors if other is None else _larger(errors, asked(other.descent.found.n, other.descent.found))


def _larger(errors: Mapping[str, Any], asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the larger of two errors of each number, where more than one is known."""
    return {name: jnp.maximum(error, asked[name]) if name in asked else error for name, error in errors.items()}


def _largest(tree: Any) -> Any:
    """Return the largest along the first axis of each array."""
    return jax.tree.map(lambda leaf: jnp.max(leaf, 0), tree)


def _with_ridge(A: Sequence[Sequence[Array]], found: Found) -> list[list[Array]]:
    """Return what is known of n and log n_s, and of each a little more than nothing."""
    return [[a + (RIDGE * found.rest[i][i] if i == j else 0.0) for j, a in enumerate(row)] for i, row in enumerate(A)]


def _lit(task: Task, n: Vec3, x: Array) -> Array:
    """Return how many observations that count a light reaches."""

    def add(total: Array, view: Any) -> tuple[Array, None]:
        sight, counts = view
        u = task.lighting.shading(sight, n, (), x).u
        return total + jnp.where(counts & (u > 0.0).any(0), 1.0, 0.0), None

    return jax.lax.scan(add, jnp.zeros(x.shape), (task.lighting.views, task.seen.counts))[0]


def _errors(best: Best, block: Block, choices: Choices) -> tuple[Sequence[Array], Sequence[Array], Array]:
    """Return the standard errors of the coefficients in each channel and of the rest, and whether all are told apart.

    With nothing held at 0. A region's n_s counts as an unknown of the texel of which the region tells what it tells.
    """
    task, found, size = best.task, best.descent.found, len(best.descent.found.k)
    region = choices.shared and not task.fit_exponent and task.known.k_s is None
    if region:
        sharp = dataclasses.replace(task, fit_exponent=True)
        identifiable = evaluate(sharp, found.n, found.x, best.descent.weight)
        found = dataclasses.replace(found, mixed=identifiable.mixed, rest=identifiable.rest)
    known = reduced(found, held=False)
    count = len(known.rest)
    rest = _with_ridge(known.rest, found)
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
    if task.fit_exponent:
        values["n_s"] = jnp.exp(found.x)[None]
        errors["n_s"] = values["n_s"] * rest[-1][None]
    elif choices.shared:
        values["n_s"] = jnp.exp(block.log_n_s)[None]
        errors["n_s"] = values["n_s"] * block.log_n_s_error[None]
    if task.fit_normal:
        values["normal"] = jnp.stack([found.n.x, found.n.y, found.n.z])
        errors["normal"] = jnp.rad2deg(jnp.sqrt(rest[0] ** 2 + rest[1] ** 2))[None]
        for name in {"k_d", "normal"} & errors.keys():  # in one plane, whatever the linear theory makes of it
            errors[name] = jnp.where((best.room > FLAT)[None], errors[name], jnp.inf)
    return values, errors, apart


def _finish(
    full: Best,
    plain: Best,
    other: Best | None,
    block: Block,
    choices: Choices,
    usual: Usual,
    seen: Array,
    plausible: Array,
) -> Estimates:
    """Choose between the fits with and without a highlight, and say what became of each texel.

    `other`: the minimum that was found beside `full`; `seen`: where a highlight explains enough; `plausible`: where
    the fit with one ended at numbers that mean something.
    """
    values, errors, apart = _named(full, block, choices)
    glossy = seen & plausible
    shines = glossy & _highlight_known(full, values, errors)
    if full.task.fit_exponent or full.task.fit_normal:
        errors = _farther(full, other, block, values, errors)
    level = _level(full.task)
    identifiable = apart & _identifiable(full, values, errors)
    vague = seen & ~shines
    if plain is not full:
        matte, of_matte, apart_too = _named(plain, block, choices)
        if full.task.fit_normal:  # a broad highlight, too weak to be seen, may look like a part of k_d or a tilt
            off = _apart(values, matte)
            of_matte = _larger(of_matte, {name: jnp.hypot(errors[name], off[name]) for name in of_matte})
        identifiable = jnp.where(glossy, identifiable, apart_too & _identifiable(plain, matte, of_matte))
        channels, texels = full.task.seen.target.shape[1:]
        widths = {"k_s": channels, "n_s": 1}
        matte |= {name: jnp.zeros((width, texels)) for name, width in widths.items()}
        of_matte |= {name: jnp.full((width, texels), jnp.inf) for name, width in widths.items()}
        values = {name: chosen(glossy, value, matte[name]) for name, value in values.items()}
        errors = {name: chosen(glossy, error, of_matte[name]) for name, error in errors.items()}
    lit, freedom = (jnp.where(glossy, getattr(full, of), getattr(plain, of)) for of in ("lit", "freedom"))
    left = jnp.where(glossy, full.left, plain.left)
    vague = vague | ~usual.explains(left, level, freedom)
    few = (freedom <= 0) | (lit < (3 if full.task.fit_normal else 1))
    done = jnp.where(glossy, full.descent.done, plain.descent.done)
    finite = jnp.ones(seen.shape, bool)
    for value in values.values():
        finite = finite & (jnp.abs(value) < HUGE).all(0)
    status = jnp.where(shines, DETERMINED, NO_HIGHLIGHT)
    status = jnp.where(vague | ~identifiable, UNDETERMINED, status)
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


def _identifiable(best: Best, values: Mapping[str, Any], errors: Mapping[str, Any]) -> Array:
    """Return where every number but the highlight's has an error, and the normal one that holds."""
    identifiable = jnp.ones(best.lit.shape, bool)
    for name, error in errors.items():
        identifiable = identifiable if name in ("k_s", "n_s") else identifiable & jnp.isfinite(error).all(0)
    if not best.task.fit_normal:
        return identifiable
    square = jnp.deg2rad(errors["normal"][0]) ** 2
    if "k_d" in values:  # of its channels, the best known one: they all share the error of the vector's length
        share = errors["k_d"] / jnp.where(values["k_d"] > 0.0, values["k_d"], 1e-300)
        square = square + jnp.min(share, 0) ** 2
    return identifiable & (square < LEANING**2)


def _highlight_known(full: Best, values: Mapping[str, Any], errors: Mapping[str, Any]) -> Array:
    """Return where the numbers of a highlight are known, so far as they were free, by the curvature at the minimum."""
    known = jnp.ones(full.lit.shape, bool)
    if "n_s" in values:
        x = full.descent.found.x
        known = known & (errors["n_s"][0] <= VAGUE * values["n_s"][0]) & (x > LOW) & (x < HIGH)
    if "k_s" in values:  # by the channel that shines most
        k_s, error = values["k_s"], errors["k_s"]
        most = k_s == jnp.max(k_s, 0)[None]
        known = known & jnp.where(most, error <= FAINT * k_s, True).all(0)
    return known


def _apart(values: Mapping[str, Any], matte: Mapping[str, Any]) -> dict[str, Any]:
    """Return how far numbers are from each other, normals in degrees."""
    off = {name: jnp.abs(values[name] - value) for name, value in matte.items()}
    if "normal" in off:
        off["normal"] = jnp.rad2deg(jnp.sqrt(jnp.sum(off["normal"] ** 2, 0)))[None]
    return off


def _mean_square(best: Best) -> Array:
    """Return the mean square of the weighted residuals, as the loss believes them."""
    return best.descent.found.squares / jnp.maximum(best.task.samples, 1.0)


@partial(jax.jit, static_argnames="choices")
def residual_sizes(
    setup: LightingSetup, known: Known, block: Block, sigma: Array, patience: Array, choices: Choices
) -> Float[Array, "views texels"]:
    """Return the size of the residuals of each observation, the root mean square of its channels.

    In units in which its median is the standard deviation of Gaussian noise: divided by the root of the share of the
    observations that the unknowns leave, and by the median of chi / sqrt(C) of C channels.
    """
    best = _best(setup, known, sights_for(setup, block, choices), block, sigma, patience, choices)
    task, found = best.task, best.descent.found

    def of_view(view_slice: Any) -> Array:
        F = features(task, view_slice, found.n, found.x, ())
        m = F.predicted(found.k)
        return jnp.sqrt(jnp.mean((m - view_slice.target.astype(found.x.dtype)) ** 2, 0))

    left = jnp.clip((task.samples - task.unknowns) / jnp.maximum(task.samples, 1.0), 0.05, 1.0)
    return jax.lax.map(of_view, looks(task, None)) / (MEDIAN[len(block.seen.target[0])] * jnp.sqrt(left)[None])
