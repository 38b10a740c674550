"""Set-up: a fit laid out beside the numbers that faults move: exposures, the places of lights, spheres."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...core.backend import PLAINLY, jit_quickly
from ...core.fields import Array
from ...inverse.data.views import channels, lights_on
from ...inverse.forward.gram import directions_of
from ...inverse.forward.interface import AbstractForwardModel
from ...inverse.forward.rounding import sawtooth
from ...inverse.pixels.blocks import Block
from ...inverse.pixels.blocks import chunks as in_chunks
from ...inverse.result import Fit
from ...inverse.solve.solvers import NEAR
from ...inverse.statistics.uncertainty import Vector
from ...inverse.unknowns.parameters import find_unknowns
from ...inverse.unknowns.slots import put_back
from ...inverse.unknowns.unknown import values_at
from ...inverse.unknowns.visibility import shown_unknowns
from ...model.surfaces import Sphere
from ...parallel.threads import on_all_cores
from .jacobian import Jacobian
from .regions import center_of, rims
from .score_tests import Rows, Score
from .states import Linearised, Mask, Masks, Move, State

PIXELS = 1 << 14  # number of pixels, in all views together, on which faults are judged
SPHERES = 4  # with more spheres, their places are not tested
RTOL = 1e-6  # of the cost: where the minimisations of refits stop
STEPS = 8  # of a fault's amount
REDUCTIONS = 3  # the most reductions of a step that does not lower the cost
CLOSE = 1e-3  # relative decrease of the cost below which a refit stops


class SetUp:
    """A fit and the minima with some of its faults corrected. Runs in float64; one program serves all minima."""

    def __init__(self, fit: Fit):
        """Lay the fit out, on some of its pixels, and minimise there."""
        self.fit, self.samples = fit, fit.solved.problem.samples
        self.center = center_of(fit.scene.objects, fit.views[0].camera)
        self.lit = [tuple(lights_on(fit.scene, view)) for view in fit.views]
        self.rims = [rims(fit.scene.objects, view.camera) for view in fit.views]
        own = {path for u in fit.unknowns for path, _ in u.places} | {p.path for u in fit.unknowns for p in u.products}
        paths = [path for path in self._paths() if path not in own]
        added = find_unknowns(fit.scene, fit.views, paths, from_scene=True) if paths else []
        self.laid = fit.solved.beside(added).laid_out(PIXELS)
        self.own, self.inside = len(fit.unknowns), np.flatnonzero(~fit.at_bound)
        self.places: dict[str, list[int]] = {}
        """The index of each number that faults move."""
        for j, unknown in enumerate(added):
            self.places.setdefault(unknown.places[0][0], []).append(self.own + j)
        shown, p = shown_unknowns(fit.scene, fit.views, self.laid.problem.unknowns), self.own + len(added)
        self.shown = np.tile(np.arange(p), (len(fit.views), 1)) if shown is None else shown
        where = [
            np.broadcast_arrays(v, pixels, np.arange(channels(fit.views[v]))[:, None])
            for v, _, pixels in self.laid.parts
        ]
        place = np.concatenate([np.reshape(of, (3, -1)) for of in where], 1).astype(int)
        self.view, self.pixel, self.channel = place
        self.base = self._minimise(self.laid.theta, (None,) * len(fit.views), {})

    def _paths(self) -> list[str]:
        """Return the names of what faults move."""
        scene, on = self.fit.scene, sorted(set().union(*self.lit))
        spheres = [x.name or str(i) for i, x in enumerate(scene.objects) if isinstance(x.surface, Sphere)]
        return [
            *(f"views.{i}.exposure" for i in range(len(self.lit))),
            *(f"lights.{i}.{name}" for i in on for name in scene.lights[i].placement),
            *(f"objects.{n}.surface.{x}" for n in spheres for x in ("radius", "center") if len(spheres) <= SPHERES),
        ]

    def exclude(self, state: State, masks: Mapping[int, Mask]) -> State:
        """Return the minimum with more pixels of some views left out."""
        excluded = list(state.excluded)
        for view, mask in masks.items():
            excluded[view] = mask if (known := excluded[view]) is None else mask | known
        return self._minimise(state.theta, tuple(excluded), state.amounts)

    def corrected(
        self, at: Linearised, of: tuple[str, int], test: Callable[[Linearised], tuple[Move, Score] | None]
    ) -> State:
        """Return the minimum with a fault corrected: steps of its amount, each followed by a minimisation.

        Args:
            at: Where it was found.
            of: Its kind, and which case of it.
            test: Its move and its score at a state; None where it cannot be seen.
        """
        state = at.state
        for _ in range(STEPS):
            found = test(at)
            if found is None:
                break
            move, score = found
            for k in range(REDUCTIONS):
                amount, theta = 0.25**k * score.amount, state.theta.copy()
                theta[self.inside] -= 0.25**k * score.moves
                known = state.amounts.get(of, np.zeros(len(amount)))
                then = self._minimise(move.along(theta, amount), state.excluded, {**state.amounts, of: known + amount})
                if then.costs.sum() < state.costs.sum():
                    break
            else:
                break
            less = state.share(then)
            state = then
            if less < CLOSE:
                break
            at = self.linearised(state)
        return state

    def _minimise(self, theta: Vector, excluded: Masks, amounts: Mapping[tuple[str, int], Vector]) -> State:
        held = {j: float(theta[j]) for j in range(self.own, len(theta))}
        end = self.laid.minimise(held, theta, self._chunks(excluded), rtol=RTOL, damping=NEAR)
        values, fit = values_at(end.theta, self.laid.problem.unknowns), self.fit
        scene, views = put_back(fit.scene, fit.views, self.laid.problem.unknowns, values)
        fit = dataclasses.replace(fit, solved=fit.solved.drawn_as(scene, views), values=values[: self.own])
        return State(end.theta, fit, np.array(end.point.views.cost) * self._inflation(excluded), excluded, amounts)

    def _chunks(self, excluded: Masks) -> list[Block]:
        return self.laid.chunks if all(mask is None for mask in excluded) else self.laid.without(excluded)

    def _inflation(self, excluded: Masks) -> Float[np.ndarray, " views"]:
        """Return for each view all samples over those that are not left out."""
        found = np.ones(len(excluded))
        for view, mask in enumerate(excluded):
            if mask is not None:
                found[view] = 1.0 / max(np.mean(~mask.reshape(-1)[self.pixel[self.view == view]]), 1e-6)
        return found

    def linearised(self, state: State) -> Linearised:
        """Return the samples of a state and their derivatives."""
        found: list[list[np.ndarray]] = []
        theta, used = jnp.asarray(state.theta), [channels(view) for view in self.fit.views]
        laid = on_all_cores(
            lambda chunk: _samples(theta, self.shown, self.laid.model, chunk), self._chunks(state.excluded)
        )
        for of_chunk, parts in zip(laid, in_chunks(self.laid.parts), strict=True):
            arrays = [np.asarray(of) for of in of_chunk]
            for b, part in enumerate(parts):
                c, n = used[part.view], len(part.pixels)
                found.append([of[b][..., :c, :n].reshape(*of[b].shape[:-2], c * n) for of in arrays])
        predicted, J, slope, weight, base = (np.concatenate(of, -1) for of in zip(*found, strict=True))
        first = np.searchsorted(self.view, np.arange(len(used) + 1))
        jacobian, known = Jacobian(J, self.shown, first, len(theta)), self.laid.prior_gram(state.theta)
        measured, inside, fit = base > 0, self.inside, self.fit
        noise, bend = ((of[measured] / base[measured]).sum() for of in (slope**2, weight))
        size = max(view.image.shape[0] * view.image.shape[1] for view in fit.views)
        rows = Rows(
            jacobian.of(np.isin(np.arange(len(theta)), inside)),
            slope,
            weight,
            np.unique(self.view * size + self.pixel, return_inverse=True)[1],
            np.asarray(known.hessian)[np.ix_(inside, inside)],
            np.asarray(known.gradient)[inside],
            float(noise / bend),
            None if fit.evidence.waves is None else sawtooth(fit.rounding, self.view, predicted, base),
        )
        return Linearised(self, state, predicted, jacobian, rows, int(measured.sum()))


@partial(jit_quickly, options=PLAINLY)
def _samples(theta: Array, shown: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, ...]:
    """Return a chunk's predictions, their changes by what each view shows, the cost's slopes and curvatures, weights.

    The weight of a clipped sample, which was not measured, is 0.
    """

    def of_block(block: Block) -> tuple[Array, ...]:
        m, derivative = jax.linearize(lambda q: jnp.stack(model.predict(q, block)), theta)
        seen = block.observed
        terms = model.likelihood.terms(m, seen.target, model.sample_weights(block), seen.clipped)
        J = jax.vmap(derivative)(directions_of(shown, block.view, len(theta))[1])
        return m, J, terms.slope, terms.curvature, model.measured_weights(block)

    return jax.lax.map(of_block, chunk)
