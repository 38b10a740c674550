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
from ..inverse.result import Fit
from ..inverse.statistics.uncertainty import inverse
from ..inverse.unknowns.names import everything
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
    for unknown in known:  # a known n_s may be 0
        unknown.parameter = dataclasses.replace(unknown.parameter, logarithmic=False)
    places = {place for u in fit.unknowns for place in [*u.places, *((x.path, x.channel) for x in u.products)]}
    for unknown in known:
        for path, channel in unknown.places:
            if (path, channel) in places:
                raise ValueError(f"'{name}' names {path}, which is free in this fit. Name a parameter that was known.")
    with in_float64(fit) as fit:
        at = _laid_out(fit)
        slots = jax.tree.map(jnp.asarray, slots_of(apart(fit.scene)[1], fit.views, known))
        phi = values_in(fit.scene, fit.views, known)
        bases = [x.base for u in fit.unknowns for x in u.products]
        along = jnp.asarray([[1.0 * (base in u.places) for u in known] for base in bases]).reshape(
            len(bases), len(known)
        )
        shown = _shown(fit, known, followed=bool(np.any(along)))
        z, p = jnp.asarray(np.concatenate([at.theta, phi])), len(at.theta)
        second = total(
            on_all_cores(lambda chunk: _second_derivatives(z, slots, along, shown, at.model, chunk), at.chunks)
        )
        moves = _moves(fit, at, second[:p, :p], second[:p, p:])
    values = {path: np.asarray(value) for path, value, _ in everything(fit.scene, fit.views)}
    for unit in unit_vectors(known):  # phi is the unit vector; a known direction may have any length
        moves[:, unit] /= np.linalg.norm(values[known[unit[0]].places[0][0]])
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
        at = _laid_out(fit)
        theta, p = jnp.asarray(at.theta), len(at.theta)
        empty = jax.tree.map(jnp.asarray, slots_of(apart(fit.scene)[1], fit.views, []))
        along = jnp.zeros((sum(len(u.products) for u in fit.unknowns), 0))
        shown = _shown(fit, [], followed=False)
        second = total(
            on_all_cores(lambda chunk: _second_derivatives(theta, empty, along, shown, at.model, chunk), at.chunks)
        )
        some = [chunk for chunk in at.chunks if (np.asarray(chunk.view) == view).any()]
        slopes = on_all_cores(lambda chunk: _by_sample(theta, shown, at.model, chunk), some)
        views = np.concatenate([np.asarray(chunk.view) for chunk in some])
        by_block = np.concatenate([np.asarray(s) for s in slopes])[views == view]  # (blocks, most, channels, pixels)
        samples = fit.solved.problem.data.samples[view]
        _, channels, size = by_block.shape[1:]
        number = -(-len(samples.pixels) // size)
        flat = by_block[:number].transpose(1, 0, 3, 2).reshape(len(shown[view]), number * size, channels)
        used = samples.photograph.shape[2]
        mixed = np.zeros((p + 1, len(samples.pixels) * used))
        mixed[shown[view]] = flat[:, : len(samples.pixels), :used].reshape(len(flat), -1)
        moves = _moves(fit, at, second, mixed[:p])
    image = np.zeros((len(moves), samples.inside.size, used))
    image[:, samples.pixels] = moves.reshape(len(moves), -1, used)
    return image.reshape(len(moves), *samples.inside.shape, used)


def _shown(fit: Fit, known: Sequence[Unknown], *, followed: bool) -> Int[np.ndarray, "views most"]:
    """Return which of the unknowns, and of the known numbers after them, each view can show, padded with their number.

    Known numbers that unknowns are multiples of (`followed`) show wherever those do.
    """
    p, k = len(fit.unknowns), len(known)

    def of(numbers: Sequence[Unknown], padding: int) -> np.ndarray:
        found = shown_unknowns(fit.scene, fit.views, numbers)
        every = np.tile(np.arange(len(numbers)), (len(fit.views), 1)) if found is None else found
        return np.where(every < len(numbers), every, padding)

    of_known = np.tile(np.arange(k), (len(fit.views), 1)) if followed else of(known, k)
    return np.concatenate([of(fit.unknowns, p + k), p + of_known], 1)


def _laid_out(fit: Fit) -> LaidOut:
    """Return a fit laid out at its minimum, with the forward model that serves any scene."""
    singular = ~fit.evidence.regular
    if singular.any():
        name = fit.names[int(singular.argmax())]
        raise ValueError(f"{name} is not determined, so the fit has no derivative. Fix {name} and fit again.")
    return fit.solved.beside(()).laid_out()


def _moves(fit: Fit, laid: LaidOut, hessian: Any, mixed: Any) -> Float[np.ndarray, "p k"]:
    """Return -H^-1 of the mixed derivatives, in the values' own units."""
    whole = np.asarray(hessian) + np.asarray(_prior_hessian(laid.priors, jnp.asarray(laid.theta)))
    free = ~fit.at_bound
    moves = np.zeros((len(free), np.shape(mixed)[1]))
    moves[free] = -inverse(whole[np.ix_(free, free)]) @ np.asarray(mixed)[free]
    return moves / coordinate_slopes(fit.values, fit.unknowns)[:, None]


@jax.jit
def _prior_hessian(priors: Any, theta: Array) -> Array:
    return jax.hessian(lambda q: priors.gram(q).cost)(theta)


@partial(jit_quickly, options=SOONER)
def _second_derivatives(
    z: Array, slots: Slots, along: Array, shown: Array, model: AbstractForwardModel, chunk: Block
) -> Array:
    """Return the second derivatives of a chunk's cost by the unknowns and the known numbers, in this order.

    Each block has derivatives by what its view shows, and by nothing else, so that the time is linear in the views.

    Args:
        z: The unknowns, and the known numbers after them.
        slots: Where the known numbers are in the scene.
        along: 1 where a product of the unknowns (a row) has a known number (a column) as its constant.
        shown: Which of z each view can show, padded with their number.
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
def _by_sample(theta: Array, shown: Array, model: AbstractForwardModel, chunk: Block) -> Array:
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
