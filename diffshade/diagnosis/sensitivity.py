"""Sensitivity: the derivatives of the fitted values by the photographs and by known parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..core.backend import SOONER, in_float64, jit_quickly
from ..core.fields import Array, check_kind
from ..inverse.forward.gram import directions_of
from ..inverse.forward.interface import AbstractForwardModel
from ..inverse.forward.rendered import costs
from ..inverse.laid_out import LaidOut
from ..inverse.pixels.blocks import Block, total
from ..inverse.pixels.blocks import chunks as in_chunks
from ..inverse.result import Fit
from ..inverse.statistics.uncertainty import inverse
from ..inverse.unknowns.parameters import find_unknowns
from ..inverse.unknowns.slots import Slots, apart, slots_of, values_in
from ..inverse.unknowns.unknown import Unknown, coordinate_slopes, unit_vectors
from ..inverse.unknowns.visibility import shown_unknowns
from ..parallel.threads import on_all_cores


def sensitivity(fit: Fit, name: str) -> Float[np.ndarray, "p k"]:
    r"""Return the derivatives of the fitted values by known parameters.

    At the minimum the gradient F of the cost by the unknowns theta is 0 for all values of the known parameters phi.
    Therefore

    $$ d\theta / d\phi = -(dF / d\theta)^{-1} \; dF / d\phi $$

    with all second derivatives (the implicit function theorem). Values at a bound do not move. The weights of the noise
    and the scale of a robust loss are held fixed.

    Args:
        fit: The fit.
        name: The known parameters: any run of whole segments of a dotted path, as in `fit`. "lights.0.intensity" has
            k = 3 numbers.

    Returns:
        The derivatives, one row per fitted value and one column per known number, in the scene's order.

    Raises:
        ValueError: If a parameter is free in this fit, or a fitted value is not determined.
        TypeError: If `fit` is not a `Fit`.
    """
    check_kind("fit", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    known = find_unknowns(fit.scene, fit.views, (name,), from_scene=True, with_dark_lights=True)
    known = [  # as they are: a known n_s may be 0
        dataclasses.replace(unknown, parameter=dataclasses.replace(unknown.parameter, logarithmic=False))
        for unknown in known
    ]
    free = {place for unknown in fit.unknowns for place in unknown.all_places}
    for place in (place for unknown in known for place in unknown.places if place in free):
        raise ValueError(f"'{name}' names {place}, which is free in this fit. Name a parameter that was known.")
    with in_float64(fit) as fit:
        at, p = _laid_out(fit), len(fit.unknowns)
        second = _second_derivatives_at(fit, at, known, _shown(fit, known))
        moves = _moves(fit, at, second[:p, :p], second[:p, p:])
    for unit in unit_vectors(known):  # phi is the unit vector; a known direction may have any length
        moves[:, unit] /= np.linalg.norm(known[unit[0]].places[0].value_in(fit.scene, fit.views))
    return moves


def image_sensitivity(fit: Fit, view: int) -> Float[np.ndarray, "p h w c"]:
    """Return the derivatives of the fitted values by each sample of one view's photograph.

    As `sensitivity`, with the photograph in place of the known parameters.

    Args:
        fit: The fit.
        view: The index of the view, from 0.

    Returns:
        One image of derivatives per fitted value; 0 where a sample does not count or is clipped.

    Raises:
        ValueError: If the fit has no such view, or a fitted value is not determined.
        TypeError: If `fit` is not a `Fit`.
    """
    check_kind("fit", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
    if not isinstance(view, int | np.integer) or not 0 <= view < len(fit.views):
        raise ValueError(
            f"view must be from 0 to {len(fit.views) - 1}; got {view!r}. Give the index of one of the fit's views."
        )
    with in_float64(fit) as fit:
        at, p, shown = _laid_out(fit), len(fit.unknowns), _shown(fit, [])
        second = _second_derivatives_at(fit, at, [], shown)
        samples = fit.solved.problem.data.samples[view]
        used = samples.photograph.shape[2]
        mixed = np.zeros((p + 1, samples.inside.size, used))
        index = np.arange(p) if shown is None else shown[view]
        for chunk, parts in zip(at.chunks, in_chunks(at.parts), strict=True):
            if any(part.view == view for part in parts):
                for part, of_block in zip(parts, np.asarray(_by_sample(at.theta, shown, at.model, chunk)), strict=True):
                    if part.view == view:
                        block = of_block[:, :used, : len(part.pixels)].swapaxes(1, 2)
                        mixed[index[:, None], part.pixels] = block
        moves = _moves(fit, at, second, mixed[:p].reshape(p, -1))
    return moves.reshape(p, *samples.inside.shape, used)


def _shown(fit: Fit, known: Sequence[Unknown]) -> Int[np.ndarray, "views most"] | None:
    """Return which of the unknowns, and of the known numbers after them, each view can show (`shown_unknowns`).

    A known number that an unknown is a multiple of shows wherever that does.
    """
    products = [x for u in fit.unknowns for x in u.products]
    followed = [
        dataclasses.replace(u, places=(*u.places, *(x.place for x in products if x.base in u.places))) for u in known
    ]
    return shown_unknowns(fit.scene, fit.views, [*fit.unknowns, *followed])


def _laid_out(fit: Fit) -> LaidOut:
    """Return a fit laid out at its minimum, with the forward model that serves any scene."""
    singular = ~fit.evidence.regular
    if singular.any():
        name = fit.names[int(singular.argmax())]
        raise ValueError(f"{name} is not determined, so the fit has no derivative. Fix {name} and fit again.")
    return fit.solved.beside(()).laid_out()


def _moves(fit: Fit, laid: LaidOut, hessian: Any, mixed: Any) -> Float[np.ndarray, "p k"]:
    """Return -H^-1 of the mixed derivatives, in the values' own units."""
    whole = np.asarray(hessian) + np.asarray(_prior_hessian(laid.task.priors, jnp.asarray(laid.theta)))
    free = ~fit.at_bound
    moves = np.zeros((len(free), np.shape(mixed)[1]))
    moves[free] = -inverse(whole[np.ix_(free, free)]) @ np.asarray(mixed)[free]
    return moves / coordinate_slopes(fit.values, fit.unknowns)[:, None]


@jax.jit
def _prior_hessian(priors: Any, theta: Array) -> Array:
    return jax.hessian(lambda q: priors.gram(q).cost)(theta)


def _second_derivatives_at(
    fit: Fit, at: LaidOut, known: Sequence[Unknown], shown: Int[np.ndarray, "views most"] | None
) -> Float[np.ndarray, "q q"]:
    """Return the second derivatives of the cost at the minimum by the unknowns and the known numbers after them."""
    slots = jax.tree.map(jnp.asarray, slots_of(apart(fit.scene)[1], fit.views, known))
    bases = [x.base for u in fit.unknowns for x in u.products]
    along = np.array([[base in u.places for u in known] for base in bases], float).reshape(len(bases), len(known))
    z = np.concatenate([at.theta, values_in(fit.scene, fit.views, known)])
    return total(on_all_cores(lambda chunk: _second_derivatives(z, slots, along, shown, at.model, chunk), at.chunks))


@partial(jit_quickly, options=SOONER)
def _second_derivatives(
    z: Array, slots: Slots, along: Array, shown: Array | None, model: AbstractForwardModel, chunk: Block
) -> Array:
    """Return the second derivatives of a chunk's cost by the unknowns and the known numbers, in this order.

    Each block has derivatives by what its view shows, and by nothing else, so that the time is linear in the views.

    Args:
        z: The unknowns, and the known numbers after them.
        slots: Where the known numbers are in the scene.
        along: 1 where a product of the unknowns (a row) has a known number (a column) as its constant.
        shown: Which of z each view can show, padded with their number; None where each shows all.
        model: The forward model.
        chunk: Blocks of pixels.
    """
    p = model.setting.slots.logarithmic.shape[0]

    def cost(z: Array, block: Block) -> Array:
        setup = slots.insert(z[p:], model.setting.setup) if z.shape[0] > p else model.setting.setup
        held = model.setting.slots.products[2] + along @ (z[p:] - jax.lax.stop_gradient(z[p:]))
        there = eqx.tree_at(lambda m: (m.setting.setup, m.setting.slots.products[2]), model, (setup, held))
        terms = costs(there.likelihood, there.predict(z[:p], block), block.observed)
        return jnp.sum(jnp.stack([jnp.sum(t.cost) for t in terms]))

    def add(sum_: Array, block: Block) -> tuple[Array, None]:
        index, directions = directions_of(shown, block.view, z.shape[0])
        nowhere = jnp.zeros(index.shape[0])
        both = jax.hessian(lambda moved: cost(z + moved @ directions, block))(nowhere)
        return jnp.asarray(sum_).at[index[:, None], index].add(both, mode="drop"), None

    return jax.lax.scan(add, jnp.zeros((z.shape[0], z.shape[0])), chunk)[0]


@partial(jit_quickly, options=SOONER)
def _by_sample(theta: Array, shown: Array | None, model: AbstractForwardModel, chunk: Block) -> Array:
    """Return the derivative of the gradient of the cost by each sample: (blocks, most, channels, pixels)."""

    def of_block(block: Block) -> Array:
        m, derivative = jax.linearize(lambda q: jnp.stack(model.predict(q, block)), theta)
        J = jax.vmap(derivative)(directions_of(shown, block.view, theta.shape[0])[1])
        seen = block.observed

        def slope(y: Array) -> Array:
            shown = eqx.tree_at(lambda o: o.target, seen, y)
            return jnp.stack([t.slope for t in costs(model.likelihood, list(m), shown)])

        by_y = jax.jvp(slope, (seen.target,), (jnp.ones_like(seen.target),))[1]
        return J * (by_y if seen.clipped is None else jnp.where(seen.clipped == 0, by_y, 0.0))[None]

    return jax.lax.map(of_block, chunk)
