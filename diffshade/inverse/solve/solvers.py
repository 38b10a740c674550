"""The least-squares engine: passes over the pixels on all cores, and between them steps that optimistix decides."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ...core import fields
from ...core.backend import PLAINLY, UNFUSED, jit_quickly
from ...core.thresholds import MAX_STEPS, TINY
from ...model.scenes import Scene
from ...parallel.threads import on_all_cores
from ..forward.gram import ByView, Gram, Point
from ..forward.interface import AbstractForwardModel
from ..pixels.blocks import Block, total
from ..unknowns.unknown import Unknown
from ..unknowns.visibility import Arrow
from .descent import GramLevenbergMarquardt, State, box_step, stalls
from .elimination import Arrowhead, Dense, nothing
from .padding import is_padded, padded_arrow, padded_count, padded_model, to_few_sizes

T = TypeVar("T")

# The damping of the first step: from anywhere, from values that somebody states (as Ceres' own first step has it), and
# from what is nearly the minimum already.
FAR, STATED, NEAR = 1e-3, 1e-4, 1e-8


class PriorResiduals(eqx.Module):
    """What is known of the unknowns beside the views: a residual for each Gaussian prior and each unit vector."""

    index: Int[fields.Array, " k"]
    mean: Float[fields.Array, " k"]
    weight: Float[fields.Array, " k"]
    """sigma/width of each prior: sigma is the scale of the views' residuals."""
    units: Int[fields.Array, "u 3"]
    unit_weight: Float[fields.Array, " u"]
    """Any weight will do: the length of a unit vector changes no pixel, so that 1 is met exactly."""

    def gram(self, theta: Float[fields.Array, " p"], arrow: Arrow | None = None) -> Gram:
        """Return the Gram of these residuals, by the few unknowns of each: linear in their number but for zeros."""
        known = self.weight * (theta[self.index] - self.mean)
        unit = theta[self.units]
        longer = self.unit_weight * 0.5 * (jnp.sum(unit**2, -1) - 1.0)
        slope = self.unit_weight[:, None] * unit
        gradient = jnp.zeros_like(theta).at[self.index].add(self.weight * known)
        hessian = nothing(len(theta), arrow).plus(jnp.zeros_like(theta).at[self.index].add(self.weight**2))
        return Gram(
            0.5 * (known @ known + longer @ longer),
            gradient.at[self.units].add(slope * longer[:, None]),
            hessian.added(jnp.asarray(self.units), jnp.asarray(slope[:, :, None] * slope[:, None, :])),
        )

    def padded(self, whole: int) -> PriorResiduals:
        """Return the residuals with others of no weight: a prior for each of more unknowns, and more unit vectors."""
        more, units = (0, whole - len(self.index) if len(self.index) else 0), to_few_sizes(self.units)
        index, mean, weight = (np.pad(of, more) for of in (self.index, self.mean, self.weight))
        unit_weight = np.pad(self.unit_weight, (0, len(units) - len(self.units)))
        return PriorResiduals(index, mean, weight, units, unit_weight)


class BoxConstraints(eqx.Module):
    """The range of the unknowns, which of them the prediction is linear in, and how they divide into blocks."""

    lower: Float[fields.Array, " p"]
    upper: Float[fields.Array, " p"]
    linear: Bool[fields.Array, " p"]
    arrow: Arrow | None
    in_border: bool = eqx.field(static=True, default=False)
    """Whether the prediction is linear in some unknowns, all of which are in the arrow's border."""

    def padded(self, whole: int) -> BoxConstraints:
        """Return the ranges of more unknowns; these have none."""
        p = len(self.lower)
        more, arrow = (0, whole - p), padded_arrow(self.arrow, p, whole)
        lower = np.pad(self.lower, more, constant_values=-np.inf)
        upper = np.pad(self.upper, more, constant_values=np.inf)
        return BoxConstraints(lower, upper, np.pad(self.linear, more), arrow, self.in_border)


class Task:
    """What is to be minimised: the model that predicts, what is known beside the views, and the range of the unknowns.

    `squares`, the sum of the images', sets the rounding of a cost. Programs have it padded, so that one serves many
    numbers of views, and taken apart, once for the few calls of each step.
    """

    def __init__(
        self,
        model: AbstractForwardModel,
        priors: PriorResiduals,
        box: BoxConstraints,
        squares: float,
        unknowns: Sequence[Unknown],
        scene: Scene,
    ):
        self.priors, self.box, self.squares, self.unknowns, self.scene = priors, box, squares, unknowns, scene
        self._predict_by(model)

    def _predict_by(self, model: AbstractForwardModel) -> None:
        self.model, p = model, len(self.box.lower)
        self.whole = padded_count(model.setting.shown, p)
        """The number of unknowns with the padded ones."""
        self.is_padded = is_padded(model, p, self.whole)
        self.padded_model = padded_model(model, p, self.whole) if self.is_padded else model
        self.padded_priors = self.priors.padded(self.whole)
        self.model_leaves, self.model_structure = jax.tree.flatten(self.padded_model)
        self._take_apart()

    def _take_apart(self) -> None:
        self.padded_box = self.box.padded(self.whole) if self.is_padded else self.box
        self.leaves, self.structure = jax.tree.flatten((self.padded_model, self.padded_priors, self.padded_box))

    def within(self, box: BoxConstraints) -> Task:
        """Return the task with other ranges of the unknowns."""
        task = copy.copy(self)
        task.box = box
        task._take_apart()
        return task

    def using(self, model: AbstractForwardModel) -> Task:
        """Return the task with another model of the same unknowns."""
        task = copy.copy(self)
        task._predict_by(model)
        return task

    def with_padding(self, theta: Any) -> np.ndarray:
        """Return the unknowns with the padded ones."""
        return np.pad(theta, (0, self.whole - len(theta)))

    def own(self, point: Point) -> Point:
        """Return a point without what is padded."""
        if not self.is_padded:
            return point
        point, p, views = jax.tree.map(np.asarray, point), len(self.box.lower), len(self.model.setting.grey)
        gradient, hessian = point.total.gradient[:p], point.total.hessian.part(p, self.box.arrow)
        of = point.views
        by_view = ByView(of.cost[:views], of.gradient[:views], of.hessian[:views], self.model.setting.shown)
        return Point(point.theta[:p], Gram(point.total.cost, gradient, hessian), by_view)

    def of_priors(self, theta: Any) -> Gram:
        """Return the Gram of the priors and unit vectors, as NumPy arrays."""
        p, priors = len(self.box.lower), self.priors
        if not (len(priors.index) or len(priors.units)):
            return Gram(np.zeros(()), np.zeros(p), np.zeros((p, p)))
        of = jax.tree.map(np.asarray, _prior_gram(self.with_padding(theta), self.padded_priors))
        return Gram(of.cost, of.gradient[:p], of.hessian[:p, :p])

    def on_all_cores(self, program: Callable[..., T], theta: Any, chunks: Sequence[Block]) -> list[T]:
        """Return what a compiled program of the unknowns, the model and a chunk gives for each chunk."""
        theta = self.with_padding(theta)
        return on_all_cores(lambda chunk: program(theta, self.padded_model, chunk), chunks)


def point_of(
    theta: Float[fields.Array, " p"],
    model: AbstractForwardModel,
    priors: PriorResiduals,
    box: BoxConstraints,
    summary: Any,
) -> Point:
    """Return the point at theta, from a pass over the pixels there.

    A model that projects gives the Gram at any linear unknowns from one pass: then it is the point at the best linear
    unknowns within their bounds instead of theta's own.
    """

    @jax.jit  # traced once for both
    def at(theta: Any) -> Point:
        views = model.gram(theta, summary)
        known = priors.gram(theta, box.arrow)
        gradient = known.gradient + views.slope(len(theta))
        hessian = known.hessian.added(views.shown, views.hessian)
        return Point(theta, Gram(views.cost.sum() + known.cost, gradient, hessian), views)

    point = at(theta)
    return at(theta + linear_step(point, box)) if model.projects else point


def linear_step(point: Point, box: BoxConstraints) -> Float[fields.Array, " p"]:
    """Return the step of the linear unknowns alone to their optimum within bounds."""
    H, g = point.total.hessian, point.total.gradient
    low = jnp.where(box.linear, box.lower - point.theta, 0.0)
    high = jnp.where(box.linear, box.upper - point.theta, 0.0)
    if box.in_border and isinstance(H, Arrowhead):  # nothing else moves
        F = H.arrow.border
        step = box_step(Dense(H.border), g[F], jnp.full(len(F), TINY), low[F], high[F])
        return jnp.zeros_like(g).at[F].set(step)
    return box_step(H, g, jnp.full_like(low, TINY), low, high)


class Minimum(eqx.Module):
    """Where the solver ended."""

    point: Point
    steps: int = eqx.field(static=True)
    message: str = eqx.field(static=True)
    """Empty where it converged."""
    costs: tuple[float, ...] = eqx.field(static=True, default=())
    """The cost at the start, and the lowest after each step."""

    @property
    def theta(self) -> np.ndarray:
        """The unknowns, in the solver's coordinates."""
        return np.asarray(self.point.theta)


def _summarise(structure: Any, leaves: list[Any], theta: Array, chunk: Block) -> Any:
    return jax.tree.unflatten(structure, leaves).summary(theta, chunk)


_summary = jit_quickly(_summarise, "structure", PLAINLY)
_summary_unfused = jax.jit(_summarise, static_argnames="structure", compiler_options=UNFUSED)


@partial(jit_quickly, static_argnames="structure")
def _evaluate(structure: Any, leaves: list[Any], theta: Array, summary: Any) -> Point:
    model, priors, box = jax.tree.unflatten(structure, leaves)
    return point_of(theta, model, priors, box, summary)


def evaluate(theta: Any, task: Task, chunks: Sequence[Block]) -> Point:
    """Return the point at theta, or, for a model that projects, at its best linear unknowns: one pass, on all cores."""
    return task.own(_evaluated(task.with_padding(theta), task, chunks))


def _evaluated(theta: Any, task: Task, chunks: Sequence[Block]) -> Point:
    """Return `evaluate` with what is padded."""
    program = _summary_unfused if task.model.transparent and jax.default_backend() == "cpu" else _summary
    summaries = on_all_cores(lambda chunk: program(task.model_structure, task.model_leaves, theta, chunk), chunks)
    return _evaluate(task.structure, task.leaves, theta, total(summaries))


@jit_quickly
def _prior_gram(theta: Array, priors: PriorResiduals) -> Gram:
    gram = priors.gram(theta)
    return Gram(gram.cost, gram.gradient, gram.hessian.as_matrix())


def _cost(y: Array, point: Point) -> tuple[Any, Point]:
    """Return the cost at y and, as optimistix's auxiliary output, the point that a pass over the pixels found there."""
    return point.total.cost, point


@jit_quickly
def _begin(theta: Array, solver: GramLevenbergMarquardt, point: Point) -> State:
    state = solver.init(_cost, theta, point, {}, None, point, frozenset())
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, leaf.dtype), state)  # of no weak type, as all later ones


@jit_quickly
def _advance(state: State, solver: GramLevenbergMarquardt, point: Point) -> tuple[State, Array, Array]:
    _, state, _ = solver.step(_cost, None, point, {}, state, frozenset())
    failed = state.result != optx.RESULTS.successful
    return state, state.done | failed, failed


def _solver(
    box: BoxConstraints, squares: Any, *, projects: bool, rtol: Any, damping: float = FAR
) -> GramLevenbergMarquardt:
    rounding = 4.0 * float(jnp.finfo(jnp.result_type(float)).eps) * squares if projects else 0.0
    linear = box.linear if projects else np.zeros(box.linear.shape, bool)
    return GramLevenbergMarquardt(
        lower=box.lower,
        upper=box.upper,
        projected=linear,
        damping=damping,
        rtol=rtol,
        atol=1e-25 * squares,
        rounding=rounding,
    )


def minimum_in_jax(
    theta: Array,
    evaluate_at: Callable[[Array], Point],
    box: BoxConstraints,
    squares: Array,
    *,
    projects: bool,
) -> tuple[Point, Array]:
    """Return the point at the minimum and whether the solver converged, as one pure JAX function.

    It takes the steps of `minimise`, which runs its passes on all cores and cannot be traced.
    """
    found = optx.minimise(
        lambda theta, _: _cost(theta, evaluate_at(theta)),
        _solver(box, squares, projects=projects, rtol=1e-14),
        theta,
        has_aux=True,
        max_steps=MAX_STEPS,
        throw=False,
    )
    return found.aux, found.result == optx.RESULTS.successful


def minimise(
    theta: Any,
    task: Task,
    chunks: Sequence[Block],
    *,
    max_steps: int,
    rtol: float = 1e-16,
    stalled: float = 0.0,
    damping: float = FAR,
    report_progress: Callable[[int, float], None] = lambda step, cost: None,
) -> Minimum:
    """Minimise the cost of the chunks from theta within bounds.

    `damping` is that of the first step. From near the minimum the steps of Newton lead there in three passes; to come
    down from `FAR`, a third at a time, takes as many passes as the unknowns are hard to tell apart.

    Ends as well where it `stalls`: where several steps together lower the cost by less than `stalled` of it.

    This is `optimistix.minimise` step by step: a compiled program asks the solver for each step, and the passes between
    the steps run on all cores, which no traced loop can.
    """
    solver = _solver(task.padded_box, task.squares, projects=task.model.projects, rtol=rtol, damping=damping)
    theta = task.with_padding(theta)
    point = _evaluated(theta, task, chunks)
    state, done, failed = _begin(theta, solver, point), False, False
    costs = [float(point.total.cost)]
    for step in range(1, max_steps + 1):
        state, done, failed = _advance(state, solver, point)
        costs.append(min(costs[-1], float(state.point.total.cost)))
        report_progress(step, costs[-1])
        done = done or stalls(costs, stalled)
        if done or step == max_steps:
            break
        point = _evaluated(state.y_eval, task, chunks)
    message = ""
    if not done:
        message = "the cost still falls, in a direction that these views hardly determine"
    elif failed:
        message = "a step met a number that is not finite"
    return Minimum(jax.tree.map(np.asarray, task.own(state.point)), int(state.steps), message, tuple(costs))
