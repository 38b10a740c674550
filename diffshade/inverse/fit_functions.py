"""Fit functions: a small fit as a pure JAX function of its images, for `jax.vmap` and `jax.grad`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..core import fields
from ..core.backend import check_backend, in_float64
from ..core.fields import as_float64
from ..model.scenes import Scene
from .data.view_sets import ViewSet
from .data.views import View
from .fitting import check_choices, check_free
from .forward.gram import Point
from .forward.interface import AbstractForwardModel
from .forward.layout import lay_plain
from .pixels.blocks import Block
from .problem import fit_problem, with_samples_for
from .solve.descent import TINY, box_step
from .solve.elimination import Dense
from .solve.solvers import Box, PriorResiduals, minimum_in_jax, point_of
from .solve.start_search import candidates
from .unknowns.parameters import find_unknowns
from .unknowns.unknown import Unknown, coordinates, natural

MAX_STEPS = 60
TOGETHER = 32  # fits of a batch that take their steps together
FINER = 4  # times as many exponents are tried as by `fit`, which follows several starts: here one is followed


class FittedValues(eqx.Module):
    """What a fit function returns; under `jax.vmap` every array has the batch's axis first."""

    values: dict[str, Float[Array, "..."]]
    """The unknowns by name, in their own units."""
    cost: Float[Array, "..."]
    """Half the sum of squares of the residuals."""
    converged: Bool[Array, "..."]
    """Whether the solver ended because no step within the bounds lowers the cost by more than rounding does."""
    determined: dict[str, Bool[Array, "..."]]
    """Whether the images determine an unknown. They do not if the prediction is the same at its other values, such as
    those of n_s where k_s is 0, or at other values of several unknowns together. The value is then one of many that
    cost the same."""


class FitFunction(eqx.Module):
    """A fit of one setup as a pure JAX function of its images; `fit_function` makes it.

    `function(*images)` takes one image for each view and returns `FittedValues`; `function.residuals(theta, *images)`
    are the residuals at the unknowns, in the order of `names`.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    """The unknowns."""
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """The shape of each view's image."""
    model: AbstractForwardModel
    priors: PriorResiduals
    box: Box
    chunk: Block
    index: Int[fields.Array, "blocks channels pixels"]
    """Where each sample is in the images, one after another; -1 for padding."""
    start: Float[fields.Array, " p"]
    groups: tuple[tuple[Int[fields.Array, " m"], Float[fields.Array, "n m"]], ...]
    """For each group of unknowns that a search tries together: their indices, and the values, in coordinates."""

    __hash__ = object.__hash__  # jax.jit looks the program of a function up by it; arrays have none
    __eq__ = object.__eq__

    def __call__(self, *images: Float[ArrayLike, "..."]) -> FittedValues:
        """Fit the images.

        The minimum is searched for as by `fit`: the image is linear in some unknowns, which are solved for at each
        candidate of the others; from the best, Levenberg-Marquardt steps within bounds follow. The derivative by the
        images is that of the minimum (implicit function theorem): with C the cost, d theta = -(d2C/dtheta2)^-1
        d2C/dtheta dy dy. It is 0 for an unknown at a bound, for one that changes no prediction, and along a direction
        that changes none.

        Args:
            images: The image of each view, of the shape of the one given to `fit_function`.

        Returns:
            The values, the cost, whether the solver converged, and which values the images determine.

        Raises:
            ValueError: An image has another shape.
        """
        of = self._in_jax()
        targets = of._targets(images)
        theta, cost, converged, gram = _solved(of, targets)
        values = natural(theta, of.model.setting.slots.logarithmic)
        shown = of.shown(theta, gram, targets)
        _, idle = _idle(gram, shown)
        determined = shown & jnp.all(jnp.abs(idle) < _half_the_digits(idle), -1)
        by_name = [dict(zip(self.names, of_each, strict=True)) for of_each in (values, determined)]
        return FittedValues(by_name[0], cost, converged, by_name[1])

    def residuals(self, theta: Float[Array, " p"], *images: Float[ArrayLike, "..."]) -> Float[Array, " samples"]:
        """Return prediction - image, for every sample that counts; 0 for padding.

        Args:
            theta: The unknowns, in the order of `names`; exponents as their logarithms.
            images: The image of each view.

        Returns:
            The residuals.

        Raises:
            ValueError: An image has another shape.
        """
        of = self._in_jax()
        return of._residuals(theta, of._targets(images)).ravel()

    def _in_jax(self) -> FitFunction:
        """Return the function with arrays of the precision of the program that calls it."""
        return jax.tree.map(jnp.asarray, self)

    def _targets(self, images: Sequence[ArrayLike]) -> Float[Array, "blocks channels pixels"]:
        shapes = tuple(jnp.shape(image) for image in images)
        if shapes != self.shapes:
            raise ValueError(
                f"this fit function needs images of shapes {self.shapes}; got {shapes}. Give one for each view, or "
                "jax.vmap over the axis of the batch."
            )
        samples = jnp.concatenate([jnp.ravel(jnp.asarray(image, float)) for image in images])[self.index]
        return jnp.where(self.index >= 0, samples, 0.0)

    def _weights(self) -> Float[Array, "blocks channels pixels"]:
        return jnp.asarray(jax.vmap(self.model.sample_weights)(self.chunk))

    def _predictions(self, theta: Array) -> Float[Array, "blocks channels pixels"]:
        return jax.lax.map(lambda block: jnp.stack(self.model.predict(theta, block)), self.chunk)

    def _residuals(self, theta: Array, targets: Array) -> Array:
        return jnp.sqrt(self._weights()) * (self._predictions(theta) - targets)

    def cost(self, theta: Array, targets: Array) -> Array:
        """Return half the sum of squares of the residuals."""
        return 0.5 * jnp.sum(self._residuals(theta, targets) ** 2) + self.priors.gram(theta).cost

    def minimum(self, targets: Array) -> tuple[Array, Array, Array, Array]:
        """Return the minimum, its cost, whether the solver converged, and J^T J there."""
        first = self._candidates(jnp.asarray(self.start), 0)
        theta, converged, gram = _searched(self, self._prepared(first), targets)
        return theta, self.cost(theta, targets), converged, gram

    def shown(self, theta: Float[Array, " p"], gram: Float[Array, "p p"], targets: Array) -> Bool[Array, " p"]:
        """Return the unknowns that change the prediction, given J^T J, by more than rounding.

        Of an unknown that the prediction is linear in, any change will do; another one changes by 1 (of an exponent its
        logarithm) or by its value. Normal equations keep half of the digits.
        """
        effect = jnp.sqrt(jnp.diagonal(gram)) * jnp.maximum(1.0, jnp.abs(theta))
        rounding = _half_the_digits(gram) * jnp.sqrt(jnp.sum(self._weights() * targets**2))
        return effect > jnp.where(jnp.asarray(self.box.linear), 0.0, rounding)

    def _candidates(self, theta: Array, group: int) -> Float[Array, "n p"]:
        """Return theta with the unknowns of a group at each of their values; theta alone where there is no group."""
        if not self.groups:
            return theta[None]
        members, values = self.groups[group]
        return jax.vmap(theta.at[members].set)(jnp.asarray(values))

    def _prepared(self, thetas: Float[Array, "n p"]) -> Prepared:
        """Return what a search needs of some candidates and does not depend on the images."""
        linear = jnp.asarray(self.box.linear)
        weights = self._weights().ravel()

        def prepared(theta: Array) -> Prepared:
            begin = jnp.clip(jnp.where(linear, 0.0, theta), self.box.lower, self.box.upper)
            m, derivative = jax.linearize(lambda q: self._predictions(q).ravel(), begin)
            J = jax.vmap(derivative)(jnp.diag(jnp.where(linear, 1.0, 0.0)))
            weighted, slopes = weights * m, weights[None] * J
            return Prepared(begin, weighted, slopes, slopes @ J.T, slopes @ m, 0.5 * weighted @ m)

        return jax.lax.map(prepared, thetas)

    def _best(self, of: Prepared, targets: Array) -> Float[Array, " p"]:
        """Return the best of some candidates, each at its best linear unknowns."""
        linear, y = jnp.asarray(self.box.linear), targets.ravel()

        def solved(theta: Array, A: Array, g: Array, cost: Array) -> tuple[Array, Array]:
            low = jnp.where(linear, self.box.lower - theta, 0.0)
            high = jnp.where(linear, self.box.upper - theta, 0.0)
            step = box_step(Dense(A), g, jnp.full_like(theta, TINY), low, high)
            return theta + step, cost + g @ step + 0.5 * step @ A @ step

        found, costs = jax.vmap(solved)(of.theta, of.hessian, of.gradient - of.slopes @ y, of.cost - of.weighted @ y)
        return found[jnp.argmin(jnp.where(jnp.isfinite(costs), costs, jnp.inf))]

    def search(self, first: Prepared, targets: Array) -> tuple[Array, Array, Array]:
        """Return the minimum, whether the solver converged, and J^T J there, from the best of the candidates."""
        chunk = eqx.tree_at(lambda c: c.observed.target, self.chunk, targets)

        def evaluate(theta: Array) -> Point:
            return point_of(theta, self.model, self.priors, self.box, self.model.summary(theta, chunk))

        theta = self._best(first, targets)
        later = [*range(1, len(self.groups)), *range(len(self.groups))] if len(self.groups) > 1 else []
        for group in later:  # one after another, twice
            theta = self._best(self._prepared(self._candidates(theta, group)), targets)
        squares = jnp.sum(self._weights() * targets**2)
        projects = self.model.projects
        point, converged = minimum_in_jax(theta, evaluate, self.box, squares, projects=projects, max_steps=MAX_STEPS)
        return jnp.asarray(point.theta), converged, point.total.hessian.as_matrix()


class Prepared(eqx.Module):
    """Candidates of a search, each at linear unknowns of 0, and their quadratic model of the cost: a leading axis each.

    W are the weights, m the prediction and J its derivatives by the linear unknowns; the last has a factor 1/2.
    """

    theta: Float[Array, "... p"]
    weighted: Float[Array, "... samples"]
    slopes: Float[Array, "... p samples"]
    hessian: Float[Array, "... p p"]
    gradient: Float[Array, "... p"]
    cost: Float[Array, "..."]


def _half_the_digits(of: Array) -> float:
    return float(jnp.finfo(of.dtype).eps) ** 0.5


def _idle(gram: Float[Array, "p p"], among: Bool[Array, " p"]) -> tuple[Float[Array, " p"], Float[Array, "p p"]]:
    """Return a scale for some unknowns, 0 for others, and directions of the scaled ones that change no prediction.

    Scaled, each changes the prediction as much as any other. A direction is a column of the matrix; others are 0.
    """
    scale = jnp.where(among, jax.lax.rsqrt(jnp.where(among, jnp.diagonal(gram), 1.0)), 0.0)
    size, direction = jnp.linalg.eigh(gram * jnp.outer(scale, scale) + jnp.diag(jnp.where(among, 0.0, 1.0)))
    return scale, jnp.where(size < len(gram) * jnp.finfo(gram.dtype).eps, direction, 0.0)


@jax.custom_jvp
def _solved(function: FitFunction, targets: Array) -> tuple[Array, Array, Array, Array]:
    return function.minimum(targets)


@_solved.defjvp
def _(primals: tuple, tangents: tuple) -> tuple:
    """Return the implicit derivative, by the images alone."""
    (of, targets), along = primals, tangents[1]
    theta, _, converged, gram = found = _solved(of, targets)
    free = of.shown(theta, gram, targets) & (theta > of.box.lower) & (theta < of.box.upper)
    scale, idle = jax.lax.stop_gradient(_idle(gram, free))
    mixed = jax.jvp(lambda y: jax.grad(of.cost)(theta, y), (targets,), (along,))[1]
    held = idle @ idle.T
    kept = jnp.eye(len(theta)) - held
    H = jax.hessian(of.cost)(theta, targets) * jnp.outer(scale, scale) + jnp.diag(jnp.where(free, 0.0, 1.0))
    d_theta = -scale * jnp.linalg.solve(kept @ H @ kept + held, kept @ (scale * mixed))
    d_cost = jax.jvp(lambda y: of.cost(theta, y), (targets,), (along,))[1]
    no_slope = np.zeros(converged.shape, jax.dtypes.float0)
    return found, (d_theta, d_cost, no_slope, jnp.zeros_like(gram))  # of the Gram, only what it shows is asked


@jax.custom_batching.custom_vmap
def _searched(function: FitFunction, first: Prepared, targets: Array) -> tuple[Array, Array, Array]:
    return function.search(first, targets)


@_searched.def_vmap
def _(size: int, batched: tuple, function: FitFunction, first: Prepared, targets: Array) -> tuple:
    """Search for a few at once, whose pixels stay in a core's cache: none then waits for the slowest of all."""
    if any(jax.tree.leaves(batched[:2])):  # over settings, not images
        axes = jax.tree.map(lambda moves: 0 if moves else None, tuple(batched))
        found = jax.vmap(FitFunction.search, axes)(function, first, targets)
    else:
        found = jax.lax.map(lambda y: function.search(first, y), targets, batch_size=min(size, TOGETHER))
    return found, (True, True, True)


def fit_function(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Sequence[str],
    bounds: Mapping[str, Sequence[float]] | None = None,
) -> FitFunction:
    """Return a fit as a pure JAX function of its images: `jax.vmap` fits many at once, `jax.grad` goes through it.

    The cost is a sum of squares; there is no error bar. Use `fit` for one fit of which more is to be known. The
    function computes in the precision of the program that calls it: in float32 the normal equations keep about three
    digits, so call it under `jax.enable_x64`.

    Args:
        scene: What is known; the free values need not be.
        views: The setup, as in `fit`: cameras, masks, and which lights are on. Their images show which pixels count and
            give the shapes; the function is given others.
        free: Names of what is fitted, as in `fit`.
        bounds: Ranges by name, as in `fit`.

    Returns:
        The function.

    Raises:
        ValueError: As `fit` raises it; or a view has noise, a sensor or clipped samples, which this function does not
            know.
        TypeError: As `fit` raises it.
    """
    views = (views,) if isinstance(views, View) else tuple(views)
    check_choices(scene, views, (), "squares", "hinge", "search")
    check_backend()
    with in_float64((jax.tree.map(as_float64, scene), views)) as (scene, views):
        data = ViewSet.of(scene, views)
        unknowns = find_unknowns(scene, data.views, free, bounds=bounds, grey=bool(data.grey))
        check_free(unknowns)
        data = with_samples_for(scene, data, unknowns, "hinge")
        for i, view in enumerate(views):
            if view.sensor is not None:
                raise ValueError(
                    f"a fit function takes linear images; views[{i}] has a sensor. Leave it out and give linear "
                    "images, or use fit."
                )
            if view.noise is not None:
                raise ValueError(
                    f"a fit function counts all samples alike; views[{i}] has noise. Leave it out, or use fit."
                )
        if data.counts.clipped:
            raise ValueError(
                f"a fit function knows no clipped samples; {data.counts.clipped} of the views' samples are. Mask them "
                "out, or use fit."
            )
        problem = fit_problem(scene, data, unknowns, "squares")
        gathered = problem.gather(problem.block_size)
        shapes = tuple(np.shape(view.image) for view in views)
        made = FitFunction(
            tuple(unknown.name for unknown in unknowns),
            tuple(shape[:2] if shape[2] == 1 else shape for shape in shapes),
            problem.model,
            problem.priors(1.0),
            problem.box,
            lay_plain(problem.model, gathered),
            _index(gathered, shapes),
            coordinates(np.array([unknown.start for unknown in unknowns]), unknowns),
            _groups(unknowns, scene),
        )
        return jax.tree.map(np.asarray, made)


def _index(gathered: Block, shapes: Sequence[tuple[int, ...]]) -> Int[np.ndarray, "blocks channels pixels"]:
    """Return where each sample of a chunk is in the images, flattened and one after another; -1 for padding."""
    view = np.asarray(gathered.view)
    first = np.take(np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)]), view)
    width, channels = (np.take([shape[axis] for shape in shapes], view) for axis in (1, 2))
    pixel = (gathered.points.row * width[:, None] + gathered.points.column).astype(int)
    channel = np.minimum(np.arange(gathered.observed.target.shape[1]), channels[:, None] - 1)
    at = first[:, None, None] + pixel[:, None] * channels[:, None, None] + channel[:, :, None]
    return np.where(gathered.observed.weight, at, -1)


def _groups(unknowns: Sequence[Unknown], scene: Scene) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return the groups of unknowns of `start_search.candidates`, exponents spaced more closely."""
    start = coordinates(np.array([unknown.start for unknown in unknowns]), unknowns)
    found = []
    for tried in candidates(unknowns, scene, start):
        members = np.flatnonzero((tried != tried[:1]).any(0))
        values = tried[:, members]
        if all(unknowns[int(j)].logarithmic for j in members):
            finer = np.linspace(0, len(values) - 1, FINER * (len(values) - 1) + 1)
            values = np.stack([np.interp(finer, np.arange(len(values)), column) for column in values.T], -1)
        found.append((members, values))
    return tuple(found)
