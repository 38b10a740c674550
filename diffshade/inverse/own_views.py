"""Own views: what it costs to hold an unknown, by the views that show it, with all others to second order.

The direction of a light matters to the few views that it is on in. When it is held elsewhere, its own views alone
change much; the others follow through what all views share, such as the material, and that moves by a small part of its
error. So the cost of the others is replaced by a quadratic function. A refit then takes the time of a few views.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..core import fields
from ..core.backend import SOONER, UNFUSED, jit_quickly
from ..core.robust_scale import OUTLIER
from ..core.thresholds import MAX_STEPS, NEGLIGIBLE
from .forward.gram import ByView, Gram, Point
from .laid_out import LaidOut, hold
from .pixels.blocks import Block, Piece
from .result import Fit
from .solve.solvers import PriorResiduals, Task, minimum_in_jax, point_of
from .statistics.uncertainty import Vector
from .unknowns.visibility import Arrow


class BesideOthers(PriorResiduals):
    """What is known beside some views: by priors, and by all other views, to second order about a minimum."""

    others: ByView
    """The gradient and the Hessian of the other views there; 0 for the views themselves."""
    center: Float[fields.Array, " p"]
    by_ratio: Bool[fields.Array, " p"]
    """Whether the cost is quadratic in center log(theta/center), and not in theta."""

    def away(self, theta: Float[fields.Array, " p"]) -> tuple[Array, Array]:
        """Return how far each unknown that a view shows is from the center, and the derivative of that."""
        center = jnp.where(self.by_ratio, self.center, 1.0)
        ratio = jnp.where(self.by_ratio, jnp.maximum(theta / center, NEGLIGIBLE), 1.0)
        away = jnp.where(self.by_ratio, center * jnp.log(ratio), theta - self.center)
        shown = self.others.shown
        return away.at[shown].get(mode="fill", fill_value=0.0), (1.0 / ratio).at[shown].get(mode="fill", fill_value=0.0)

    def gram(self, theta: Float[fields.Array, " p"], arrow: Arrow | None = None) -> Gram:
        """Return the Gram of the priors, with what other views cost added; that is 0 at the center."""
        known, others, (away, rate) = super().gram(theta, arrow), self.others, self.away(theta)
        bend = jnp.einsum("vij,vj->vi", others.hessian, away)
        gradient = rate * (others.gradient + bend)
        return Gram(
            known.cost + jnp.sum(away * (others.gradient + 0.5 * bend)),
            jnp.asarray(known.gradient).at[others.shown].add(gradient, mode="drop"),
            known.hessian.added(others.shown, rate[:, :, None] * rate[:, None] * others.hessian),
        )


def _minimise(
    structure: Any, leaves: Sequence[Any], theta: Array, ends: Array, chunk: Block, squares: Array, rtol: Array
) -> tuple[Array, Array]:
    """Return the lowest cost of some views beside all others, and how much of that is how the others bend."""
    model, known, box = jax.tree.unflatten(structure, leaves)
    box = dataclasses.replace(box, lower=ends[0], upper=ends[1])

    def at(theta: Array) -> Point:
        return point_of(theta, model, known, box, model.summary(theta, chunk))

    found, _ = minimum_in_jax(theta, at, box, squares, projects=model.projects, max_steps=MAX_STEPS, rtol=rtol)
    away, _ = known.away(found.theta)
    return jnp.asarray(found.total.cost), 0.5 * jnp.einsum("vi,vij,vj->", away, known.others.hessian, away)


_minimum = jit_quickly(_minimise, 0, SOONER)  # over pixels, but of few views
_minimum_unfused = jax.jit(_minimise, static_argnums=0, compiler_options=UNFUSED)


class OwnViews:
    """The views that show some unknowns, beside all others: to be minimised with one of these held. In float64."""

    def __init__(self, fit: Fit, laid: LaidOut, end: Point, which: Sequence[int], held: Mapping[int, float]):
        """Take the views apart.

        Args:
            fit: The fit.
            laid: Its problem.
            end: The minimum.
            which: The unknowns.
            held: Unknowns that are held there, and where, in the solver's coordinates.
        """
        self.laid, self.held, views, theta = laid, held, end.views, np.asarray(end.theta)
        own = np.any(np.isin(views.index(len(theta)), which), axis=1)
        other = np.where(own, 0.0, 1.0)
        ratio = fit.evidence.loss_ratio  # a robust loss curves less than its weights say
        hessian = other[:, None, None] / ratio * views.hessian
        others = ByView(other * views.cost, other[:, None] * views.gradient, hessian, views.shown)
        priors = {of.name: getattr(laid.priors, of.name) for of in dataclasses.fields(laid.priors)}
        known = BesideOthers(**priors, others=others, center=theta, by_ratio=_by_ratio(fit, theta))
        self.task = Task(laid.model, known, laid.problem.box)
        none = Piece(first := int(own.argmax()), laid.problem.data.samples[first], np.zeros(0, int))
        chunks = laid.lay_out([part for part in laid.parts if own[part.view]] or [none])
        self.chunk = jax.tree.map(lambda *of: jnp.concatenate(of), *chunks)  # one, so that the program is short
        self.best, _ = self._minimise(held, theta, 1e-12)

    def rise(self, j: int, t: float, start: Vector, least: float) -> tuple[float, float]:
        """Return by how much the cost rises where an unknown is held, and how much of that other views bend by.

        Args:
            j: The unknown.
            t: Where it is held, in the solver's coordinates.
            start: Where to begin.
            least: The rise that is small enough not to be looked for.
        """
        cost, of_others = self._minimise({**self.held, j: t}, start, min(least / max(self.best, 1e-300), 1e-6))
        return cost - self.best, of_others

    def _minimise(self, held: Mapping[int, float], theta: Vector, rtol: float) -> tuple[float, float]:
        theta, lower, upper = hold(self.laid.problem.box, theta, held)
        unfused = self.laid.model.transparent and jax.default_backend() == "cpu"
        task, of = self.task, (theta, np.stack([lower, upper]), self.chunk, self.laid.squares, rtol)
        found = (_minimum_unfused if unfused else _minimum)(task.structure, task.leaves, *of)
        return float(found[0]), float(found[1])


def _by_ratio(fit: Fit, theta: Vector) -> Bool[np.ndarray, " p"]:
    """Return the unknowns in whose logarithms other views are quadratic, where lights scale with reflections.

    All reflections times 1.1 and all intensities over 1.1 change no pixel: a quadratic function of their logarithms has
    that, one of themselves only to a few per cent. A number that is not clearly above 0 has no logarithm.
    """
    scales = np.array([u.parameter.gauge != 0 for u in fit.unknowns])
    lights = any(u.parameter.gauge < 0 for u in fit.unknowns)
    plain = np.array([not u.logarithmic for u in fit.unknowns])
    surely = theta > OUTLIER * fit.clusters.standard_errors()
    return scales & plain & surely & lights


def blocks(laid: LaidOut, which: Iterable[int]) -> list[list[int]]:
    """Return those of some unknowns that few views show, by the blocks of the problem's arrow."""
    arrow, asked = laid.problem.box.arrow, set(which)
    found = [] if arrow is None else [sorted(asked & set(of)) for of in np.asarray(arrow.blocks).tolist()]
    return [of for of in found if of]
