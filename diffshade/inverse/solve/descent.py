"""Descent: Levenberg-Marquardt steps on J^T J within bounds, as a solver of optimistix, and when they are over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, Scalar

from ...core import fields
from ...core.thresholds import TINY
from ..forward.gram import Point
from .elimination import Symmetric

PATIENCE = 6  # steps, rejected ones too
STALLED = 1e-8  # of the cost, that as many steps together must keep on the way to a start


def box_minimum(A: Symmetric, g: Float[Array, " p"], low: Array, high: Array) -> Float[Array, " p"]:
    """Minimise g.z + z.A z/2 over low <= z <= high, where low <= 0 <= high and A is positive definite.

    The primal active-set method (Nocedal and Wright 2006, algorithm 16.3), from z = 0: go towards the minimum over what
    is free until a bound is in the way and hold that; once there, let go of the bound that pushes the wrong way most.
    """

    def move(state: tuple) -> tuple:
        z, held, _, count = state
        free = jnp.where(held, 0.0, 1.0)
        M = A.scaled(free).plus(1.0 - free)
        target = jnp.where(held, z, -M.solve(free * (g + A.times(jnp.where(held, z, 0.0)))))
        bound = jnp.where(target < z, low, high)
        room = jnp.where(~held & (target != z), (bound - z) / jnp.where(target != z, target - z, 1.0), jnp.inf)
        nearest = jnp.min(room)
        blocked = nearest < 1.0
        hits = blocked & (room <= nearest)
        z = jnp.where(hits, bound, jnp.where(blocked, z + nearest * (target - z), target))
        slope = g + A.times(z)
        wrong = jnp.where(held, jnp.where(z <= low, -slope, 0.0) + jnp.where(z >= high, slope, 0.0), -jnp.inf)
        release = ~blocked & (wrong == jnp.max(wrong)) & (wrong > 1e-12 * jnp.max(jnp.abs(g)))
        return z, (held | hits) & ~release, ~blocked & ~jnp.any(release), count + 1

    z = jnp.zeros_like(g)
    start = (z, at_bound(z, g, low, high), jnp.array(False), jnp.array(0))
    return jax.lax.while_loop(lambda state: ~state[2] & (state[3] < 10 * len(g) + 10), move, start)[0]


def at_bound(y: Array, gradient: Array, lower: Array, upper: Array) -> Bool[Array, " p"]:
    """Return the unknowns at a bound which the cost would leave the box to improve."""
    return ((y <= lower) & (gradient >= 0)) | ((y >= upper) & (gradient <= 0))


class State(eqx.Module):
    """Where the solver is between two passes."""

    y_eval: Array  # where to evaluate next
    point: Point  # the last accepted one
    scale: Array  # the running maximum of diag(H)
    step_size: Scalar  # 1/damping
    growth: Scalar  # of the damping, after the next step that is rejected
    done: Bool[Array, ""]
    result: Any
    rejected: Int[Array, ""]  # steps since the last accepted one
    unseen: Int[Array, ""]  # steps whose gain is below rounding
    gain: Scalar  # that the last step predicted, 0 before the first
    steps: Int[Array, ""]


class GramLevenbergMarquardt(optx.AbstractMinimiser):
    """Levenberg-Marquardt for a function that returns its cost and, beside it, a `Point`: one pass a step.

    optimistix's own keeps the whole Jacobian. The point may be elsewhere than where the function was asked: at better
    linear unknowns. Stops after a step, which no pass confirms, when the next one would lower the cost by less than
    `rtol` of it (plus `atol`), if steps go on to shrink as they do; or when rounding leaves no step that lowers it.
    `stalls` is the rule of a caller that knows the costs so far.
    """

    lower: Float[fields.Array, " p"]
    upper: Float[fields.Array, " p"]
    projected: Bool[fields.Array, " p"]
    """Unknowns that are at their best for whatever the others are: damping has nothing to hold there."""
    damping: float = 1e-3
    """That of the first step."""
    rtol: float = 1e-16
    atol: Any = 0.0  # a float to optimistix; of a fit function it is traced
    rounding: float | Array = 0.0
    norm: Callable[[Any], Any] = eqx.field(static=True, default=optx.max_norm)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> State:
        point = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), aux_struct)
        return State(
            y_eval=y,
            point=point,
            scale=jnp.zeros_like(y),
            step_size=jnp.asarray(1.0 / self.damping),
            growth=jnp.asarray(2.0),
            done=jnp.array(False),
            result=optx.RESULTS.successful,
            rejected=jnp.array(0),
            unseen=jnp.array(0),
            gain=jnp.zeros_like(point.total.cost),
            steps=jnp.array(0),
        )

    def newton(self, point: Point, step_size: Scalar, scale: Array) -> tuple[Array, Any]:
        """Return the damped Newton step (H + D/step_size) dy = -g within bounds, by an active set.

        It is the minimum of the damped quadratic model over the box. D, the `scale`, is the running maximum of diag(H),
        so that the step does not depend on the units of an unknown (More 1978).
        """
        low, high = (jnp.asarray(end) - point.theta for end in (self.lower, self.upper))
        damping = jnp.where(self.projected, TINY, 1.0 / step_size + 1e-15)
        dy = box_step(point.total.hessian, point.total.gradient, damping, low, high, scale)
        finite = jnp.all(jnp.isfinite(dy))
        result = optx.RESULTS.where(finite, optx.RESULTS.successful, optx.RESULTS.nonlinear_divergence)
        return jnp.where(finite, dy, 0.0), result

    def _judged(self, state: State, cost: Scalar) -> tuple[Bool[Array, ""], Scalar, Scalar]:
        """Return whether to accept a point of this cost, the next step size, and by how much damping grows next.

        A step that lowers the cost is accepted, and the damping set by the ratio rho of actual to predicted gain
        (Nielsen 1999): damping * max(1/3, 1 - (2 rho - 1)^3), else damping * nu, nu doubled each time. A step whose
        predicted gain and actual change are both below `rounding` is accepted as well: the gradient is then known
        better than the cost.
        """
        first, predicted, actual = state.steps == 0, state.gain, state.point.total.cost - cost
        unseen = (predicted <= self.rounding) & (jnp.abs(actual) <= self.rounding)
        accept = first | ((actual > 0) & (predicted > 0)) | unseen
        rho = jnp.where(predicted > 0, actual / jnp.where(predicted > 0, predicted, 1.0), 0.0)
        rho = jnp.where(unseen, 1.0, rho)
        longer = jnp.minimum(state.step_size / jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * rho - 1.0) ** 3), 1e15)
        step_size = jnp.where(first, state.step_size, jnp.where(accept, longer, state.step_size / state.growth))
        return accept, step_size, jnp.where(accept, 2.0, 2.0 * state.growth)

    def step(self, fn, y, args, options, state, tags) -> tuple[Array, State, Any]:
        cost, tried = fn(state.y_eval, args)
        finite = jnp.isfinite(cost) | (state.steps > 0)  # a later step to a cost that is not finite is refused
        accept, step_size, growth = self._judged(state, cost)
        keep = partial(jax.tree.map, lambda new, old: jnp.where(accept, new, old))
        point = keep(tried, state.point)
        scale = keep(jnp.maximum(state.scale, tried.total.hessian.diagonal()), state.scale)
        dy, result = self.newton(point, step_size, scale)
        rejected = jnp.where(accept, 0, state.rejected + 1)

        cost, predicted = point.total.cost, point.gain(dy)
        # of a step from far away, which gains more than is left, how steps shrink near the minimum cannot be told
        last = jnp.where(accept, jnp.maximum(jnp.minimum(state.gain, cost), predicted), predicted)  # 0 before the first
        following = predicted**2 / jnp.where(last > 0, last, 1.0)
        left = cost - predicted  # what a render without noise leaves is rounding: a pass has to find it
        small = (following <= self.rtol * left + self.atol) & (left >= 0.0) & (step_size >= 1.0)
        rounding = (rejected > 0) & (predicted <= 8 * jnp.finfo(cost.dtype).eps * cost)
        below = jnp.maximum(8 * jnp.finfo(cost.dtype).eps * cost, self.rounding)
        unseen = jnp.where(predicted <= below, state.unseen + 1, 0)
        state = State(
            y_eval=point.theta + dy,
            # by the model that held so far
            point=jax.tree.map(partial(jnp.where, small & accept), point.moved(dy), point),
            scale=scale,
            step_size=step_size,
            growth=growth,
            done=small | rounding | (rejected > 40) | (unseen > 3),  # no damping helps, or only rounding is left
            result=optx.RESULTS.where(finite, result, optx.RESULTS.nonfinite),
            rejected=rejected,
            unseen=unseen,
            gain=predicted,
            steps=state.steps + 1,
        )
        return jnp.asarray(state.point.theta), state, state.point

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], Any]:
        return state.done, state.result

    def postprocess(self, fn, y, aux, args, options, state, tags, result) -> tuple[Array, Point, dict]:
        return y, state.point, {"steps": state.steps, "cost": state.point.total.cost}


def stalls(costs: Sequence[float], least: float) -> bool:
    """Whether `PATIENCE` steps together lowered the cost by less than `least` of it.

    Where a pixel turns from lit to dark the cost has a kink, and steps that promise much keep little.
    """
    return len(costs) > PATIENCE + 1 and costs[-1 - PATIENCE] - costs[-1] < least * costs[-1]


def box_step(H: Symmetric, g: Any, damping: Array, low: Array, high: Array, D: Array | None = None) -> Array:
    """Minimise g.z + z.(H + damping D) z/2 over low <= z <= high; D is diag(H) unless it is given (More 1978)."""
    D = H.diagonal() if D is None else D
    D = jnp.maximum(D, TINY * jnp.max(D))
    scale = jnp.where(D > 0, jax.lax.rsqrt(jnp.where(D > 0, D, 1.0)), 1.0)
    A = H.scaled(scale).plus(jnp.maximum(damping, 0.0))
    A = A.plus(jnp.where(A.diagonal() > 0, 0.0, 1.0))
    return jnp.clip(scale * box_minimum(A, scale * g, low / scale, high / scale), low, high)
