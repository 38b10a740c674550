r"""Profile errors: standard errors that also hold farther along the valley of the cost of each texel.

Where the valley bends, or another minimum lies in it, the curvature at the minimum gives errors that are too small. So
the cost is evaluated at a few places along the valley: some errors away in log n_s and in the tilt of the normal that
is known worst, and at a distant n_s, to both sides; at each place all other unknowns come near their best (a profile of
the cost: Bates and Watts 1988, chapter 6). An error sigma must satisfy at every such place

$$ |change| \le \sigma \sqrt{2 \, rise / variance} $$

so the error reported is the largest that any place requires.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..core.fields import Array
from ..core.robust_scale import OUTLIER
from ..core.thresholds import SINGLE, SLIGHT, SMALL
from ..model.vectors import Vec3, dot
from .descent import HIGH, LOW, MAX_LOG_N_S_STEP, MAX_TILT, moved, tilted
from .linear_systems import solve
from .minima import TexelMinima
from .normal_equations import NormalEquations, eliminate_coefficients, evaluate
from .standard_errors import Numbers

REACH = OUTLIER  # distance along the valley, in standard errors of the curvature

DISTANT_LOG_N_S = 3.0  # and in log n_s: a factor of 20, about the distance between two minima
STEPS = 2  # places on each way, for each loss, each nearer to the best of the other unknowns
MAX_RISE = (REACH + 2.0) ** 2  # of the cost, in variances: a place is not quite at its best
STIFFNESS = 1.0 / SINGLE  # how firmly the unknown along the way is held, relative to the curvature
MAX_K_S_CHANGE = 1.0 / SMALL  # largest change of k_s that counts, over the brightest sample: some k_s are unbounded


def profile_errors(
    minimum: TexelMinima, other: TexelMinima | None, values: Numbers, errors: Numbers
) -> dict[str, Array]:
    """Return the errors, enlarged to hold along the valley of each texel and, if given, at its `other` minimum."""
    limit = MAX_K_S_CHANGE * minimum.problem.block.brightest[None]
    ways = _ways(minimum)
    step, fixed = (jnp.stack([jnp.stack(way) for way in each]) for each in zip(*ways, strict=True))
    both_sides = jnp.concatenate([step, -step]), jnp.concatenate([fixed, fixed])

    def required_along(way: tuple[Array, Array]) -> dict[str, Array]:
        return _required_along(minimum, values, limit, *way)

    errors = larger(errors, _largest(jax.lax.map(required_along, both_sides)))
    if other is not None:
        errors = larger(errors, _required(minimum, values, limit, other.descent.found.n, other.descent.found))
    return dict(errors)


def _required(minimum: TexelMinima, values: Numbers, limit: Array, n: Vec3, there: NormalEquations) -> dict[str, Array]:
    """Return the error of each number for which this place is as improbable as the rise of its cost says."""
    problem, found = minimum.problem, minimum.descent.found
    rise = 2.0 * jnp.maximum(there.cost - found.cost, 0.0) / minimum.variance
    coefficients = zip(problem.known.fitted, there.k, found.k, strict=True)
    change: dict[str, Array] = {name: jnp.minimum(jnp.abs(a - b), limit) for name, a, b in coefficients}
    if problem.fit_exponent:
        change["n_s"] = values["n_s"] * jnp.abs(there.x - found.x)[None]
    if problem.fit_normal:
        change["normal"] = jnp.rad2deg(jnp.arccos(jnp.clip(dot(found.n, n), -1.0, 1.0)))[None]
    scale = jnp.where(rise < MAX_RISE, 1.0 / jnp.sqrt(jnp.maximum(rise, SLIGHT)), 0.0)[None]
    return {name: off * scale for name, off in change.items()}


def _required_along(minimum: TexelMinima, values: Numbers, limit: Array, step: Array, fixed: Array) -> dict[str, Array]:
    """Return the errors required a step away and nearer to the best there, while `fixed` . unknowns stays the same."""
    problem, found = minimum.problem, minimum.descent.found
    count = len(found.P)

    def improve(place: tuple[Vec3, Array], _: None) -> tuple[tuple[Vec3, Array], dict[str, Array]]:
        there = evaluate(problem, *place, minimum.descent.weight)
        S = eliminate_coefficients(there, hold_zeros=True).S
        stiff = STIFFNESS * sum((S[i][i] for i in range(count)), jnp.zeros_like(found.x))
        S = [[S[i][j] + stiff * fixed[i] * fixed[j] for j in range(count)] for i in range(count)]
        required = _required(minimum, values, limit, place[0], there)
        return moved(problem, *place, [-s for s in solve(S, there.slope)]), required

    n = tilted(found.n, step[0], step[1]) if problem.fit_normal else found.n
    x = jnp.clip(found.x + step[-1], LOW, HIGH) if problem.fit_exponent else found.x
    # a loss that is not convex bends the valley more: twice the steps
    return _largest(jax.lax.scan(improve, (n, x), None, STEPS * len(problem.losses))[1])


def _ways(minimum: TexelMinima) -> list[tuple[list[Array], list[Array]]]:
    """Return the ways along the valley: a step of the unknowns, and the combination of unknowns that it changes."""
    problem, found = minimum.problem, minimum.descent.found
    count = len(found.P)
    S = eliminate_coefficients(found, hold_zeros=False).S
    zero, one = jnp.zeros_like(found.x), jnp.ones_like(found.x)
    ways = []
    if problem.fit_exponent:
        exponent = [zero] * (count - 1) + [one]
        distant = [DISTANT_LOG_N_S * w for w in exponent]
        ways += [(_along(minimum, S, exponent), exponent), (distant, exponent)]
    if problem.fit_normal:
        C = [solve(S, [one if i == j else zero for i in range(count)]) for j in range(2)]
        turn = 0.5 * jnp.arctan2(2.0 * C[0][1], C[0][0] - C[1][1])  # of the principal axis of the tilts' covariance
        worst = [jnp.cos(turn), jnp.sin(turn)] + [zero] * (count - 2)
        ways.append((_along(minimum, S, worst), worst))
    return ways


def _along(minimum: TexelMinima, S: Sequence[Sequence[Array]], direction: Sequence[Array]) -> list[Array]:
    """Return the step that changes `direction` . unknowns by `REACH` standard errors at the least cost."""
    problem, found = minimum.problem, minimum.descent.found
    step = solve(S, direction)
    size = jnp.sqrt(jnp.maximum(sum((a * s for a, s in zip(direction, step, strict=True)), 0.0), 1e-300))
    step = [REACH * jnp.sqrt(minimum.variance) * s / size for s in step]
    longest = jnp.abs(step[-1]) / MAX_LOG_N_S_STEP if problem.fit_exponent else jnp.zeros_like(found.x)
    if problem.fit_normal:
        longest = jnp.maximum(longest, jnp.sqrt(step[0] ** 2 + step[1] ** 2) / MAX_TILT)
    return [s / jnp.maximum(longest, 1.0) for s in step]


def larger(errors: Numbers, required: Numbers) -> dict[str, Float[Array, "_ texels"]]:
    """Return the larger of two errors of each number, or the only one."""
    return {name: jnp.maximum(error, required[name]) if name in required else error for name, error in errors.items()}


def _largest(stacked: Mapping[str, Array]) -> dict[str, Array]:
    """Return the largest along the first axis of each array."""
    return {name: jnp.max(leaf, 0) for name, leaf in stacked.items()}
