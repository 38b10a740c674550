"""The least-squares engine: J^T J summed over blocks of pixels, driven by optimistix within bounds."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, Scalar

from ..progress import report_step
from .residuals import Block, Problem


class Gram(eqx.Module):
    """1/2 |r|^2, J^T r and J^T J of residuals r; with a leading axis, one for each view."""

    cost: Float[Array, "..."]
    gradient: Float[Array, "... p"]
    hessian: Float[Array, "... p p"]


def gram_by_view(theta: Float[Array, " p"], problem: Problem) -> Gram:
    """Sum the Gram matrices of the residuals block by block: memory for one block, whatever the number of pixels."""
    p, views = theta.shape[0], problem.exposures.shape[0]

    def add(total: Gram, block: Block) -> tuple[Gram, None]:
        r, derivative = jax.linearize(lambda q: problem.residuals(q, block), theta)
        J = jax.vmap(derivative)(jnp.eye(p))  # for each channel, J^T: (p, pixels)
        of_block = Gram(
            sum(0.5 * jnp.vdot(rc, rc) for rc in r),  # pyright: ignore[reportArgumentType]
            sum(Jc @ rc for Jc, rc in zip(J, r, strict=True)),  # pyright: ignore[reportArgumentType]
            sum(Jc @ Jc.T for Jc in J),  # pyright: ignore[reportArgumentType]
        )
        return jax.tree.map(lambda t, b: t.at[block.view].add(b), total, of_block), None

    zero = Gram(jnp.zeros(views), jnp.zeros((views, p)), jnp.zeros((views, p, p)))
    return jax.lax.scan(add, zero, problem.blocks)[0]


def cost_and_gram(theta: Float[Array, " p"], problem: Problem) -> tuple[Scalar, Gram]:
    """Return 1/2 |r|^2 over all views and, beside it, the Gram of each view."""
    gram = gram_by_view(theta, problem)
    return gram.cost.sum(), gram


class BoxNewton(optx.AbstractDescent):
    """Damped Newton step (H + D/step_size) dy = -g within bounds, by an active set.

    D is the running maximum of diag(H), so that the step does not depend on the units of an unknown (More 1978). An
    unknown at a bound whose gradient points outward stays there; a step that would cross a bound ends on it, and the
    others are solved for again with that step given.
    """

    lower: Float[Array, " p"]
    upper: Float[Array, " p"]

    def init(self, y: Array, f_info_struct: Any) -> tuple[Array, Array, Array, Array]:
        """Return an empty state: the point, its gradient, its Hessian and the scale."""
        p = y.shape[0]
        return y, jnp.zeros(p), jnp.zeros((p, p)), jnp.zeros(p)

    def query(self, y: Array, f_info: Any, state: tuple) -> tuple[Array, Array, Array, Array]:
        """Take a new point."""
        hessian = f_info.hessian.as_matrix()
        return y, f_info.grad, hessian, jnp.maximum(state[3], jnp.diagonal(hessian))

    def step(self, step_size: Scalar, state: tuple) -> tuple[Array, Any]:
        """Return the step of damping 1/step_size from the point."""
        y, g, H, D = state
        D = jnp.maximum(D, 1e-12 * jnp.max(D))
        scale = jnp.where(D > 0, jax.lax.rsqrt(jnp.where(D > 0, D, 1.0)), 1.0)
        low, high = self.lower - y, self.upper - y
        pinned = at_bound(y, g, self.lower, self.upper)
        fixed = jnp.zeros_like(y)
        dy = fixed
        for _ in range(3):  # each round may find more bounds in the way; the clip below makes any round feasible
            free = jnp.where(pinned, 0.0, 1.0)
            A = H * jnp.outer(scale * free, scale * free) + jnp.diag(jnp.where(pinned, 1.0, 1.0 / step_size))
            factor = jax.scipy.linalg.cho_factor(A)
            dy = fixed - scale * jax.scipy.linalg.cho_solve(factor, free * scale * (g + H @ fixed))
            crossing = ~pinned & ((dy < low) | (dy > high))
            fixed = jnp.where(crossing, jnp.clip(dy, low, high), fixed)
            pinned = pinned | crossing
        dy = jnp.clip(dy, low, high)
        finite = jnp.all(jnp.isfinite(dy))
        result = optx.RESULTS.where(finite, optx.RESULTS.successful, optx.RESULTS.nonlinear_divergence)
        return jnp.where(finite, dy, 0.0), result


def at_bound(y: Array, gradient: Array, lower: Array, upper: Array) -> Bool[Array, " p"]:
    """Return the unknowns at a bound which the cost would leave the box to improve."""
    return ((y <= lower) & (gradient >= 0)) | ((y >= upper) & (gradient <= 0))


class GainRatio(optx.AbstractSearch):
    """Accept a step that lowers the cost; set the damping by the ratio of actual to predicted gain (Nielsen 1999).

    With rho that ratio: damping * max(1/3, 1 - (2 rho - 1)^3) after an accepted step, else damping * nu, nu doubled
    each time.
    """

    damping: float = 1e-3

    def init(self, y: Array, f_info_struct: Any) -> tuple[Scalar, Scalar]:
        """Return the first step size, 1/damping, and nu = 2."""
        return jnp.asarray(1.0 / self.damping), jnp.asarray(2.0)

    def step(
        self, first_step: Bool[Array, ""], y: Array, y_eval: Array, f_info: Any, f_eval_info: Any, state: tuple
    ) -> tuple[Scalar, Bool[Array, ""], Any, tuple[Scalar, Scalar]]:
        """Judge the step from y to y_eval and return the next step size."""
        step_size, nu = state
        dy = y_eval - y
        predicted = -(f_info.grad @ dy + 0.5 * dy @ f_info.hessian.mv(dy))
        actual = f_info.as_min() - f_eval_info.as_min()
        accept = first_step | ((actual > 0) & (predicted > 0))
        rho = jnp.where(predicted > 0, actual / jnp.where(predicted > 0, predicted, 1.0), 0.0)
        longer = step_size / jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * rho - 1.0) ** 3)
        step_size = jnp.where(first_step, step_size, jnp.where(accept, longer, step_size / nu))
        nu = jnp.where(accept, 2.0, 2.0 * nu)
        return step_size, accept, optx.RESULTS.successful, (step_size, nu)


class _State(eqx.Module):
    first: Bool[Array, ""]
    y_eval: Array  # where to evaluate next
    cost: Scalar  # of the last accepted point, and its Gram
    gram: Gram
    search: Any
    descent: Any
    done: Bool[Array, ""]
    result: Any
    rejected: Int[Array, ""]  # steps since the last accepted one
    steps: Int[Array, ""]


class GramLevenbergMarquardt(optx.AbstractMinimiser):
    """Levenberg-Marquardt for a function that returns its cost and, beside it, the Gram of each view: one pass a step.

    optimistix's own keeps the whole Jacobian. Stops when the decrease that a Newton step predicts is below `rtol` of
    the cost (plus `atol`), or when rounding leaves no step that lowers it.
    """

    descent: optx.AbstractDescent
    search: optx.AbstractSearch
    listener: Int[Array, ""] | None = None
    """Number of the listener that is told of each step (see `progress`)."""
    rtol: float = 1e-12
    atol: float = 0.0
    norm: Callable[[Any], Any] = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _State:
        cost, gram = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), (f_struct, aux_struct))
        info = _info(cost, gram)
        return _State(
            first=jnp.array(True),
            y_eval=y,
            cost=cost,
            gram=gram,
            search=self.search.init(y, info),
            descent=self.descent.init(y, info),
            done=jnp.array(False),
            result=optx.RESULTS.successful,
            rejected=jnp.array(0),
            steps=jnp.array(0),
        )

    def step(self, fn, y, args, options, state, tags) -> tuple[Array, _State, Any]:
        tried = fn(state.y_eval, args)
        finite = jnp.isfinite(tried[0]) | ~state.first  # later, the search refuses a step to a cost that is not finite
        step_size, accept, _, search = self.search.step(
            state.first, y, state.y_eval, _info(state.cost, state.gram), _info(*tried), state.search
        )
        keep = partial(jax.tree.map, lambda new, old: jnp.where(accept, new, old))
        y = keep(state.y_eval, y)
        cost, gram = keep(tried, (state.cost, state.gram))
        info = _info(cost, gram)
        descent = keep(self.descent.query(y, info, state.descent), state.descent)
        dy, result = self.descent.step(step_size, descent)
        rejected = jnp.where(accept, 0, state.rejected + 1)

        predicted = -(info.grad @ dy + 0.5 * dy @ info.hessian.mv(dy))
        small = (predicted <= self.rtol * cost + self.atol) & (step_size >= 1.0)
        rounding = (rejected > 0) & (predicted <= 8 * jnp.finfo(cost.dtype).eps * cost)
        if self.listener is not None:
            jax.debug.callback(report_step, self.listener, state.steps, cost)
        state = _State(
            first=jnp.array(False),
            y_eval=y + dy,
            cost=cost,
            gram=gram,
            search=search,
            descent=descent,
            done=small | rounding | (rejected > 40),
            result=optx.RESULTS.where(finite, result, optx.RESULTS.nonfinite),
            rejected=rejected,
            steps=state.steps + 1,
        )
        return y, state, gram

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], Any]:
        return state.done, state.result

    def postprocess(self, fn, y, aux, args, options, state, tags, result) -> tuple[Array, Gram, dict]:
        return y, state.gram, {"steps": state.steps, "cost": state.cost}


def _info(cost: Scalar, gram: Gram) -> Any:
    hessian = lx.MatrixLinearOperator(gram.hessian.sum(0), lx.positive_semidefinite_tag)
    return optx.FunctionInfo.EvalGradHessian(cost, gram.gradient.sum(0), hessian)


@eqx.filter_jit
def solve(
    start: Float[Array, " p"],
    problem: Problem,
    lower: Float[Array, " p"],
    upper: Float[Array, " p"],
    max_steps: int,
    listener: Int[Array, ""] | None,
) -> optx.Solution:
    """Minimise the sum of squared residuals from `start` within bounds; `aux` of the solution is each view's Gram."""
    solver = GramLevenbergMarquardt(descent=BoxNewton(lower, upper), search=GainRatio(), listener=listener)
    return optx.minimise(cost_and_gram, solver, start, problem, has_aux=True, max_steps=max_steps, throw=False)
