"""Own views: what holding an unknown of one block costs, by the block's own views, with all others to second order.

The direction of a light matters to the few views that it is on in. When it is held elsewhere, its own views alone
change much; the others follow through the border that all views share, such as the material, and that moves by a small
part of its error. So all other views are replaced by a quadratic function of the border: the Schur complement of their
Hessian. A refit then takes the time of a block's own views, and one for each unknown takes a time linear in the views.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..core import fields
from ..core.backend import SOONER, UNFUSED, jit_quickly
from .data.view_sets import ViewSet
from .forward.gram import Gram, Point
from .laid_out import LaidOut, hold
from .pixels.blocks import Block, Piece, pieces
from .problem import MAX_STEPS, fit_problem
from .result import Fit
from .solve.solvers import PriorResiduals, minimum_in_jax, point_of
from .statistics.uncertainty import Vector, inverse
from .unknowns.visibility import Arrow, part_of, views_that_show

LEAST = 1e-3  # the least ratio of a reflection to that at the minimum, in logarithms and inverses
SURELY = 5.0  # errors above 0, from which on a reflection has a logarithm and an inverse

_known = jit_quickly(lambda theta, priors, arrow: priors.gram(theta, arrow))


class PriorsAndOthers(PriorResiduals):
    """What is known beside some views: by priors, and by all other views, to second order in the border."""

    center: Float[fields.Array, " f"]
    """The border, the first of the unknowns, where the quadratic was found."""
    slope: Float[fields.Array, " f"]
    curvature: Float[fields.Array, "f f"]
    power: Int[fields.Array, " f"]
    """How far each number of the border is from the center: border - center (0), center log(border/center) (1), or
    center (1 - center/border) (2). The derivative of each by the border is (border/center)^-power."""

    def away(self, theta: Float[fields.Array, " p"]) -> Float[fields.Array, " f"]:
        """Return how far the border is from the center, by `power`."""
        border = theta[jnp.arange(self.center.shape[0])]
        ratio = self._ratio(border)
        bent = self.center * jnp.where(self.power > 1, 1.0 - 1.0 / ratio, jnp.log(ratio))
        return jnp.where(self.power > 0, bent, border - self.center)

    def _ratio(self, border: Float[fields.Array, " f"]) -> Float[fields.Array, " f"]:
        center = jnp.where(self.power > 0, self.center, 1.0)
        return jnp.where(self.power > 0, jnp.maximum(border / center, LEAST), 1.0)

    def gram(self, theta: Float[fields.Array, " p"], arrow: Arrow | None = None) -> Gram:
        """Return the Gram of the priors, with what other views cost added; it is 0 at the center."""
        known, every = super().gram(theta, arrow), jnp.arange(self.center.shape[0])
        border, away = theta[every], self.away(theta)
        rate, bend = self._ratio(border) ** -self.power.astype(float), self.curvature @ away
        return Gram(
            known.cost + self.slope @ (border - self.center) + 0.5 * away @ bend,
            jnp.asarray(known.gradient).at[every].add(self.slope + rate * bend),
            known.hessian.added(every[None], (rate[:, None] * rate[None] * self.curvature)[None]),
        )


class OthersAsQuadratics:
    """For each block of a fit, the quadratic cost of the border from the views that do not show it. In float64."""

    def __init__(self, fit: Fit, laid: LaidOut, end: Point, held: Mapping[int, float] | None = None):
        """Sum up the views at `end`; `held`: unknowns, and where they are held, in the solver's coordinates."""
        self.fit = fit
        arrow, p = laid.problem.box.arrow, len(laid.theta)
        assert arrow is not None
        self.laid, self.theta, self.held = laid, np.asarray(end.theta), dict(held or {})
        self.border, blocks = np.asarray(arrow.border), np.asarray(arrow.blocks)
        self.members = [of[of < p] for of in blocks]
        shows = views_that_show(fit.scene, fit.views, laid.problem.unknowns)
        self.views = [np.flatnonzero(shows[of].any(0)).tolist() for of in self.members]
        known = jax.tree.map(np.asarray, _known(self.theta, laid.priors, arrow))
        every = jax.tree.map(np.asarray, end.total)
        ratio = fit.evidence.loss_ratio  # a robust loss curves less than its weights say

        def curvature(part: str) -> np.ndarray:
            of_priors = getattr(known.hessian, part)
            return (getattr(every.hessian, part) - of_priors) / ratio + of_priors

        moves = np.append(self._moves(), 0.0)[blocks]
        side = curvature("side") * moves[:, :, None]
        to_border = np.swapaxes(side, 1, 2) @ inverse(curvature("blocks") * moves[:, :, None] * moves[:, None, :])
        at_best_H = to_border @ side
        at_best_g = np.einsum("bfg,bg->bf", to_border, np.append(every.gradient, 0.0)[blocks])
        own_H, own_g = self._of_own_views(end)
        self.curvature = (every.hessian.border - known.hessian.border - own_H) / ratio
        self.curvature -= at_best_H.sum(0) - at_best_H
        self.slope = (every.gradient - known.gradient)[self.border] - own_g
        self.slope -= at_best_g.sum(0) - at_best_g
        self.power = self._power()

    def _moves(self) -> Float[np.ndarray, " p"]:
        """Return 1 for each unknown that can move, and 0 at a bound or where it is held."""
        box = self.laid.problem.box
        moves = (self.theta > np.asarray(box.lower)) & (self.theta < np.asarray(box.upper))
        moves[list(self.held)] = False
        return np.where(moves, 1.0, 0.0)

    def _power(self) -> Int[np.ndarray, " f"]:
        """Return `PriorsAndOthers.power` of the border.

        All reflections times 1.1 and all intensities over 1.1 change no pixel. What the priors of the intensities say
        of that is quadratic in the logarithm of a reflection where they are solved for as logarithms, and else in its
        inverse: in the reflection itself only to a few per cent. A reflection that is not clearly above 0 is measured
        as it is: its logarithm and inverse have no meaning there.
        """
        unknowns, border = self.laid.problem.unknowns, self.border
        lights = [unknowns[j] for of in self.members for j in of if unknowns[j].parameter.gauge < 0]
        scales = np.array([unknowns[j].parameter.role == "reflection" for j in border], bool)
        if not lights or not scales.any():
            return np.zeros(len(border), int)
        surely = self.theta > SURELY * self.fit.clusters.standard_errors()
        power = 1 if any(unknown.logarithmic for unknown in lights) else 2
        return np.where(scales & surely[border] & (self._moves()[border] > 0), power, 0)

    def _of_own_views(self, end: Point) -> tuple[Float[np.ndarray, "blocks f f"], Float[np.ndarray, "blocks f"]]:
        """Return H and g of the border by each block's own views."""
        f = len(self.border)
        H, g = np.zeros((len(self.views), f, f)), np.zeros((len(self.views), f))
        every_H, every_g, shown = end.views.together(self.views, len(self.theta))
        assert shown is not None  # no view shows the blocks of others
        for b, (of_H, of_g, index) in enumerate(zip(every_H, every_g, shown, strict=True)):
            here = np.isin(index, self.border)
            at = np.searchsorted(self.border, index[here])
            H[b][np.ix_(at, at)], g[b, at] = of_H[np.ix_(here, here)], of_g[here]
        return H, g

    def blocks(self, which: Iterable[int]) -> dict[int, list[int]]:
        """Return the blocks that have some of the unknowns, and which ones each has; the border's are in none."""
        asked = set(which)
        found = {b: sorted(asked & set(of.tolist())) for b, of in enumerate(self.members)}
        return {b: of for b, of in found.items() if of}

    def of(self, block: int) -> OwnViews:
        """Return the own views of a block, to be minimised."""
        return OwnViews(self, block)


class OwnViews:
    """The views that show one block, beside the quadratic of all others: to be minimised with an unknown held."""

    def __init__(self, others: OthersAsQuadratics, block: int):
        laid, some = others.laid, others.views[block]
        fit, likelihood = others.fit, laid.model.likelihood
        self.index = np.concatenate([others.border, others.members[block]])
        self.held = {k: others.held[j] for k, j in enumerate(self.index.tolist()) if j in others.held}
        samples = tuple(laid.problem.data.samples[v] for v in some)
        scene, views, unknowns = part_of(fit.scene, fit.views, laid.problem.unknowns, some, self.index.tolist())
        own = ViewSet.of(scene, views)  # the counts stay those of all views, so that one program serves
        data = dataclasses.replace(laid.problem.data, views=own.views, lit=own.lit, samples=samples)
        problem = fit_problem(scene, data, unknowns, fit.likelihood.loss)
        rounding = dataclasses.replace(fit.rounding, step=fit.rounding.step[some], srgb=fit.rounding.srgb[some])
        self.problem = problem.with_scale(float(likelihood.sigma), likelihood.loss).with_rounding(rounding)
        parts = pieces(samples, laid.size) or [Piece(0, samples[0], np.zeros(0, int))]
        laid_out = self.problem.lay_out(parts, laid.size)
        weighed = self.problem.reweigh(laid.theta[self.index], laid_out)
        self.squares = self.problem.sum_of_squares(weighed)
        self.chunk = jax.tree.map(lambda *of: jnp.concatenate(of), *weighed)  # one, so that the program is short
        theta = others.theta[self.index]
        known, f = self.problem.priors(fit.squares), len(others.border)
        self.priors = PriorsAndOthers(
            known.index,
            known.mean,
            known.weight,
            known.units,
            known.unit_weight,
            theta[:f],
            others.slope[block],
            others.curvature[block],
            others.power,
        )
        self.leaves, self.structure = jax.tree.flatten((self.problem.model, self.priors, self.problem.box))
        self.best, _ = self._minimise(self.held, theta, 1e-12)

    def rise(self, j: int, t: float, start: Vector, least: float) -> tuple[float, float]:
        """Return by how much the cost rises where an unknown is held, and how much of that the other views add.

        Args:
            j: The unknown.
            t: Where it is held, in the solver's coordinates.
            start: Where to begin, with numbers for all unknowns.
            least: The rise that is small enough not to be looked for.
        """
        (k,) = np.flatnonzero(self.index == j).tolist()
        rtol = min(least / max(self.best, 1e-300), 1e-6)
        cost, of_others = self._minimise({**self.held, k: t}, start[self.index], rtol)
        return cost - self.best, of_others

    def _minimise(self, held: Mapping[int, float], theta: Vector, rtol: float) -> tuple[float, float]:
        """Return the lowest cost, and what other views add to it by bending."""
        theta, lower, upper = hold(self.problem.box, theta, held)
        model = self.problem.model
        program = _minimum_unfused if model.transparent and jax.default_backend() == "cpu" else _minimum
        found = program(self.structure, self.leaves, theta, lower, upper, self.chunk, self.squares, rtol)
        return float(found[0]), float(found[1])


def _minimise(
    structure: Any,
    leaves: list[Any],
    theta: Array,
    lower: Array,
    upper: Array,
    chunk: Block,
    squares: Array,
    rtol: Array,
) -> tuple[Array, Array]:
    model, priors, box = jax.tree.unflatten(structure, leaves)
    box = dataclasses.replace(box, lower=lower, upper=upper)

    def at(theta: Array) -> Point:
        return point_of(theta, model, priors, box, model.summary(theta, chunk))

    found, _ = minimum_in_jax(theta, at, box, squares, projects=model.projects, max_steps=MAX_STEPS, rtol=rtol)
    away = priors.away(found.theta)
    return jnp.asarray(found.total.cost), 0.5 * away @ priors.curvature @ away


_minimum = jit_quickly(_minimise, 0, SOONER)  # over pixels, but of few views
_minimum_unfused = jax.jit(_minimise, static_argnums=0, compiler_options=UNFUSED)
