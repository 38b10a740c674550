"""Light search: lights that each show in views of their own are tried at other places, all of them in one pass.

A narrow highlight that lies beside the photograph's has no slope towards it, so that a fit of many directions may end
with lights that never met their highlights. Two ways lead out. Under broad highlights the lights move first, by the
slopes that those have. And a light whose views cost much more than others' is put at places all around: its own views
say which costs least, whatever the other lights do.
"""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...core.thresholds import FAR_MORE, SMALL
from ..forward.gram import Point
from ..forward.interface import AbstractForwardModel
from ..pixels.blocks import Block
from ..unknowns.light_priors import middle_of
from ..unknowns.unknown import coordinates, values_at
from .solvers import Task, minimise
from .start_search import SHORT, End, follow, turned

ANYWHERE = np.deg2rad(45.0)  # error of a light of which none is stated
NARROW = 0.5  # error of a light, over the width of a highlight, beyond which it may lie beside the photograph's
RINGS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # degrees about a light at which it is tried

Theta = Float[np.ndarray, " p"]
Lights = Sequence[Sequence[int]]
"""For each light the unknowns that are its place (`visibility.places_apart`)."""


def from_broad_highlights(theta: Theta, lights: Lights, task: Task, chunks: Sequence[Block]) -> End:
    """Return where steps end from theta, or from where the lights move under broad highlights, if that is lower.

    Args:
        theta: Where a search ended whose lights began at the scene's places.
        lights: The places.
        task: What is to be minimised.
        chunks: The pixels, without clipped ones.
    """
    end, unknowns = follow(theta, task, chunks), task.unknowns
    begin = coordinates(np.array([unknown.start for unknown in unknowns]), unknowns)
    exponents = np.array([unknown.parameter.role == "exponent" for unknown in unknowns])
    sharpest = values_at(end[1], unknowns)[exponents].max(initial=0.0)
    if max(_error(of, begin, task) for of in lights) * np.sqrt(sharpest) <= NARROW:  # of width n_s^-1/2
        return end
    held = tuple(np.where(exponents, begin, limit) for limit in (task.box.lower, task.box.upper))
    broad = task.within(eqx.tree_at(lambda box: (box.lower, box.upper), task.box, held))
    moved = minimise(begin, broad, chunks, max_steps=SHORT, rtol=1e-4).theta
    return min(end, follow(moved, task, chunks), key=lambda of: of[0])


def at_better_places(
    end: Point, samples: Float[np.ndarray, " views"], lights: Lights, task: Task, chunks: Sequence[Block]
) -> Theta | None:
    """Return the unknowns with each costly light where its views cost least; None where none is better elsewhere.

    Args:
        end: Where a fit ended.
        samples: The samples of each view.
        lights: The places.
        task: What was minimised.
        chunks: The pixels.
    """
    theta, shown = np.asarray(end.theta), np.asarray(task.model.setting.shown)
    shows = np.array([(shown == of[0]).any(1) for of in lights])
    here = shows @ np.asarray(end.views.cost) + _known(theta, lights, task)
    each = here / np.maximum(shows @ samples, 1.0)
    costly = np.flatnonzero(each > FAR_MORE * np.median(each)).tolist()
    if not costly:
        return None
    tried = np.tile(theta, (1 + 6 * len(RINGS), 1))
    for i in costly:
        origin, axis = _about(lights[i], theta, task)
        tried[:, lights[i]] = origin + np.linalg.norm(axis) * turned(axis, RINGS)
    theirs = np.flatnonzero(np.any(shows[costly], 0))
    some = [chunk for chunk in chunks if np.isin(np.asarray(chunk.view), theirs).any()]
    costs = np.array([_costs(of, shows, lights, task, some) for of in tried])
    best, found = costs.argmin(0).tolist(), theta.copy()
    better = [i for i in costly if costs[best[i], i] < (1.0 - SMALL) * here[i]]
    for i in better:
        found[lights[i]] = tried[best[i], lights[i]]
    return found if better else None


def _error(of: Sequence[int], theta: Theta, task: Task) -> float:
    """Return the stated error of a light's direction, radians."""
    far = float(np.linalg.norm(_about(of, theta, task)[1]))
    return max(ANYWHERE if prior is None else prior[1] / far for prior in (task.unknowns[j].prior for j in of))


def _about(of: Sequence[int], theta: Theta, task: Task) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the point that a light turns about, and the vector from there to its place."""
    origin = middle_of(task.scene) if task.unknowns[of[0]].parameter.role == "position" else np.zeros(3)
    return origin, theta[list(of)] - origin


def _costs(
    theta: Theta, shows: Bool[np.ndarray, "lights views"], lights: Lights, task: Task, chunks: Sequence[Block]
) -> Float[np.ndarray, " lights"]:
    """Return what the views of each light cost, and its place by what is known of it beforehand."""
    of_view = np.zeros(shows.shape[1])
    for chunk, of_blocks in zip(chunks, task.on_all_cores(_cost, theta, chunks), strict=True):
        np.add.at(of_view, np.asarray(chunk.view), np.asarray(of_blocks))
    return shows @ of_view + _known(theta, lights, task)


def _known(theta: Theta, lights: Lights, task: Task) -> Float[np.ndarray, " lights"]:
    """Return what the place of each light costs by the priors."""
    cost, index = np.zeros(len(theta)), np.asarray(task.priors.index)
    residuals = np.asarray(task.priors.weight) * (theta[index] - np.asarray(task.priors.mean))
    np.add.at(cost, index, 0.5 * residuals**2)
    return np.array([cost[list(of)].sum() for of in lights])


@jax.jit
def _cost(theta: Float[Array, " p"], model: AbstractForwardModel, chunk: Block) -> Float[Array, " blocks"]:
    def of_block(block: Block) -> Array:
        m, seen = jnp.stack(model.predict(theta, block)), block.observed
        return jnp.sum(model.likelihood.terms(m, seen.target, model.sample_weights(block), seen.clipped).cost)

    return jax.lax.map(of_block, chunk)
