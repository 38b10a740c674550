"""Block fits: the compiled programs of a robust fit that find normals, their spread, and what errors follow from."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...model.vectors import Vec3, dot
from ..geometry import lighting_geometry
from ..light_directions import out_of_plane, scatter
from ..lighting import LightErrors, LightingSetup
from ..linear_systems import inverse_diagonal, solve
from ..photometric_stereo import mean_light
from ..prediction import KnownCoefficients, TexelBlock
from .candidates import lowest_minima
from .learning import RIDGE, SHARPNESS, ObjectModel
from .observations import BlockObservations, reflectances
from .reflection_shape import ReflectionShape
from .robust_descent import DescentState, Local, Weighing, around, begin, descend, lowest, system

FEW_STEPS, MORE_STEPS, FEW_STARTS = 3, 5, 2  # steps from every start, then from the best


class Normals(NamedTuple):
    """The normals of a block, and what their errors follow from."""

    n: Float[Array, "3 texels"]
    spread: Float[Array, "3 texels"]
    """By the curvature at the minimum and the misfit: of the normal, radians, and of k_d and k_s."""
    by_lights: Float[Array, " texels"]
    """Standard deviation of the normal about each axis that follows from the errors of the lights, radians."""
    lit: Float[Array, " texels"]
    """Number of observations that count and that a light reaches."""
    plane: Float[Array, " texels"]
    """Sine by which the lights that reach a texel leave one plane."""
    by_bounce: Float[Array, " texels"]
    """By how much bounced light turns the normal, radians, if it is as bright as where no light should be."""
    brighter: Float[Array, " texels"]
    """Share of the observations that are brighter than the model and believed less than half, with one more of them."""
    by_choice: Float[Array, " texels"]
    """How far the normal is from the next lowest minimum's, radians, as far as that may be the right one."""


def lowest_state(observed: BlockObservations, model: ObjectModel) -> DescentState:
    """Return the lowest minimum of each texel."""
    return jax.tree.map(lambda leaf: leaf[0], lowest_two(observed, model))


@jax.jit
def lowest_two(observed: BlockObservations, model: ObjectModel) -> DescentState:
    """Return the two lowest minima of each texel, the lowest first; both are the same where there is one."""
    weighing = model.weighing(observed.level)
    n = lowest_minima(observed, model.shape, weighing.ridge * weighing.scale**2)

    def from_start(n: Vec3) -> DescentState:
        return descend(observed, model.shape, weighing, begin(observed, model.shape, weighing, n), FEW_STEPS)

    def further(state: DescentState) -> DescentState:
        return descend(observed, model.shape, weighing, state, MORE_STEPS)

    few = lowest(jax.vmap(from_start)(n), FEW_STARTS)
    return lowest(jax.vmap(further)(few), FEW_STARTS)


@jax.jit
def normals_of(
    setup: LightingSetup,
    block: TexelBlock,
    observed: BlockObservations,
    model: ObjectModel,
    both: DescentState,
    light_error: LightErrors,
) -> Normals:
    """Return the normals of a block at their lowest minima, and what their errors follow from."""
    state, other = (jax.tree.map(lambda leaf, i=i: leaf[i], both) for i in range(2))
    weighing = model.weighing(observed.level)
    here = around(observed, model.shape, weighing, state)
    A = system(observed, model.shape, weighing, state).A
    A = [[a + (RIDGE if i == j else 0.0) for j, a in enumerate(row)] for i, row in enumerate(A)]
    freedom = jnp.maximum(jnp.sum(here.weight, 0) - 4.0, 1.0)
    variance = jnp.sum(here.weight * here.residual**2, 0) / freedom
    tilt_a, tilt_b, k_d, _ = (variance * c for c in inverse_diagonal(A))
    # how unlikely a large k_s is says how large it may be, not how well it is seen
    seen = [*A[:3], [*A[3][:3], A[3][3] - weighing.ridge * weighing.scale**2]]
    k_s = variance * inverse_diagonal(seen)[3]
    reached = observed.lights.reach(state.n) & observed.counts
    weight = jnp.where(observed.counts, 1.0, 0.0)[:, None]
    geometry = lighting_geometry(setup, block.p, block.v)
    n = jax.tree.map(lambda c: c.astype(float), state.n)
    S = scatter(geometry.l, geometry.strength, setup.exposure, weight, n, ambient=False)
    return Normals(
        jnp.stack([state.n.x, state.n.y, state.n.z]),
        jnp.stack([jnp.sqrt(tilt_a + tilt_b), jnp.sqrt(k_d) * observed.level, jnp.sqrt(k_s) * observed.level]),
        _by_lights(observed, model.shape, weighing, state, A, here, light_error),
        jnp.sum(reached, 0, dtype=jnp.float32),
        out_of_plane(S),
        by_bounce(observed, model, state, A, here),
        _brighter(observed, here),
        _by_choice(model, state, other),
    )


def by_bounce(
    observed: BlockObservations, model: ObjectModel, state: DescentState, A: list[list[Array]], here: Local
) -> Float[Array, " texels"]:
    """Return by how much the normals turn, to first order, where each light also arrives from around the camera.

    What surrounds a texel is lit like a surface that faces the camera, and the texel reflects it like light.
    """
    reflected = state.k_d + state.k_s * model.shape.albedo
    bounced = model.bounced * reflected[None] * observed.lights.facing_camera()
    turn = solve(A, [jnp.sum(here.weight * column * bounced, 0) for column in here.J])
    return jnp.sqrt(turn[0] ** 2 + turn[1] ** 2)


def _by_choice(model: ObjectModel, state: DescentState, other: DescentState) -> Float[Array, " texels"]:
    """Return the root mean square of how far the normal is off if either minimum is right, by how well they fit."""
    share = jax.nn.sigmoid((state.cost - other.cost) * (SHARPNESS * model.softness) ** 2 / 2.0)
    return jnp.sqrt(share) * _angle(other.n, state.n)


def _angle(a: Vec3, b: Vec3) -> Float[Array, "..."]:
    """Return the angle between unit vectors, radians."""
    apart = a - b
    return 2.0 * jnp.arcsin(jnp.clip(jnp.sqrt(dot(apart, apart)) / 2.0, 0.0, 1.0))


def _brighter(observed: BlockObservations, here: Local) -> Float[Array, " texels"]:
    """Return the share of the observations that are brighter than the model and doubted, with one more of them."""
    doubted = observed.counts & (here.residual < 0.0) & (here.weight < 0.5 * observed.trust)
    number = jnp.sum(observed.counts, 0, dtype=jnp.float32)
    return (jnp.sum(doubted, 0, dtype=jnp.float32) + 1.0) / jnp.maximum(number, 1.0)


def _by_lights(
    observed: BlockObservations,
    shape: ReflectionShape,
    weighing: Weighing,
    state: DescentState,
    A: list[list[Array]],
    here: Local,
    light_error: LightErrors,
) -> Float[Array, " texels"]:
    """Return the standard deviation of the normals about each axis that follows from the errors of the lights."""
    lights, J, weight = observed.lights, here.J, here.weight

    def shown(l: Vec3) -> Array:
        D, S = eqx.tree_at(lambda one: one.l, lights, l).shading(shape, state.n)
        return state.k_d[None] * D + state.k_s[None] * S

    whole = jax.tree.map(lambda c: jnp.broadcast_to(c, jnp.broadcast_shapes(c.shape, state.k_d.shape)), lights.l)
    as_said = shown(whole)
    changes = [as_said * jnp.asarray(light_error.brightness, whole.x.dtype)[:, None]]
    for column in range(3):
        root = light_error.direction[:, :, column]
        error = Vec3(*(jnp.asarray(root[:, i], whole.x.dtype)[:, None, None] for i in range(3)))
        turn = error - whole * dot(error, whole)  # the vector stays of length 1
        changes.append(jax.jvp(shown, (whole,), (turn,))[1])
    pull = sum((weight * change) ** 2 for change in changes)
    B = [[jnp.sum(pull * J[i] * J[j], 0) for j in range(4)] for i in range(4)]
    columns = [solve(A, [row[j] for row in B]) for j in range(4)]  # A^-1 B
    rows = [solve(A, [columns[j][i] for j in range(4)]) for i in range(2)]  # its first two rows, times A^-1
    squares = jnp.maximum(rows[0][0] + rows[1][1], 0.0)
    for pattern in () if light_error.alike is None else light_error.alike:
        change = weight * as_said * jnp.asarray(pattern, whole.x.dtype)[:, None]
        turn = solve(A, [jnp.sum(column * change, 0) for column in J])
        squares += turn[0] ** 2 + turn[1] ** 2
    return jnp.sqrt(squares / 2.0)


@jax.jit
def brightest_of(setup: LightingSetup, known: KnownCoefficients, block: TexelBlock) -> Float[Array, " texels"]:
    """Return the largest reflectance that any view and channel shows of each texel."""
    shown, arriving = reflectances(setup, known, block, lighting_geometry(setup, block.p, block.v))
    reached = block.observed.counts & (arriving > 0.0).all(1)
    return jnp.max(jnp.where(reached[:, None], shown, 0.0), (0, 1))


@jax.jit
def beyond_grey(observed: BlockObservations, model: ObjectModel, state: DescentState) -> Float[Array, "views texels"]:
    """Return what the views show beyond the maps' model, with Lambert's law, as a grey reflectance."""
    D, S = observed.lights.shading(model.shape.of_lambert, state.n)
    beyond = observed.y - state.k_d[None] * D - state.k_s[None] * S
    return jnp.where(observed.counts, beyond * observed.level[None], 0.0)


class Turned(NamedTuple):
    """By how much a block's numbers change when only some views are believed."""

    angle: Float[Array, "parts texels"]
    """Of the normal, radians."""
    k_d: Float[Array, "parts texels"]
    k_s: Float[Array, "parts texels"]
    reached: Float[Array, "parts texels"]
    """Share of the part's views whose lights reach the texel."""


def turned(observed: BlockObservations, model: ObjectModel, parts: Bool[np.ndarray, "parts views"]) -> Turned:
    """Return by how much the numbers of a block change when each part of the views is fitted alone."""
    whole = lowest_state(observed, model)
    each = [_change(observed, whole, lowest_state(seen_in(observed, part[:, None]), model), part) for part in parts]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


@jax.jit
def seen_in(observed: BlockObservations, part: Bool[Array, "views _"]) -> BlockObservations:
    """Return the same with the observations of some views alone."""
    seen = (observed.believed & part, observed.counts & part)
    return eqx.tree_at(lambda o: (o.believed, o.counts), observed, seen)


@jax.jit
def _change(
    observed: BlockObservations, whole: DescentState, state: DescentState, part: Bool[Array, " views"]
) -> Turned:
    """Return by how much a state of some views differs from that of all."""
    reach = observed.lights.reach(whole.n) & part[:, None]
    reached = jnp.sum(reach, 0, dtype=jnp.float32) / jnp.sum(part, dtype=jnp.float32)
    level = observed.level
    return Turned(_angle(state.n, whole.n), (state.k_d - whole.k_d) * level, (state.k_s - whole.k_s) * level, reached)


@jax.jit
def lights_toward(setup: LightingSetup, block: TexelBlock) -> Float[Array, "views 3 texels"]:
    """Return the light of each view that arrives at each texel, as a vector towards it."""
    geometry = lighting_geometry(setup, block.p, block.v)
    light = mean_light(geometry.l, geometry.strength)
    each = [jnp.broadcast_to(c, (len(c), *block.n.x.shape)) for c in (light.x, light.y, light.z)]
    return jnp.stack(each, 1)
