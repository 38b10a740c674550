r"""Between lights: photographs under lights that no view had, as the views of the same object teach to predict them.

At a light between those of the views a shadow or a highlight is there or not, where any interpolation is halfway. Views
are left out in groups, and least squares over many texels tell how to correct what the others say:

$$ shown(l) = e(l) + \sum_j f_j(x) (s_j(l) - e(l)), \quad e(l) = model(l) + u(l), \quad f_j(x) = w_j \cdot (Ax + a)_+ $$

u is what the views show beyond the model, interpolated (kriging). The s_j are the candidates: zero, the photographs
interpolated without a model, the four nearest views. x holds these and the model, grey and relative to the mean of the
views, so that one f serves all texels, colours and lights, and many materials teach it. (Kernels are predicted so in
Bako et al. 2017.) The layer A, a is random, and w linear in what is learned (Rahimi and Recht, "Weighted sums of random
kitchen sinks", 2008). What is shown lies between 0 and twice the largest that the views or the model show. It is kept
only if it predicts views and texels from which it has not learned better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..core.fields import Array
from ..core.thresholds import FEW, MINOR, SLIGHT, TINY
from ..inverse.data.relightable import dome
from .robust.learning import typical_level
from .unexplained import NOISES, WIDTHS, Interpolation, Smoothing

T = TypeVar("T")
# Chosen on the one object at hand of which anything is learned: a dome of 49 lights.
MIN_VIEWS = 12
NEAREST = 4  # views whose numbers are looked at one by one
SPACING = 0.35  # between new lights, and from these to the views', relative to that between the views' lights
GROUPINGS = 2  # in so many ways are views left out
UNITS = 64
MAX_SAMPLES = 1 << 17  # of a texel under a light
SMOOTHEST = Smoothing(max(WIDTHS), min(NOISES))


class Neighbours(NamedTuple):
    """For each of some lights, what the views say of it."""

    beyond: Float[Array, "lights views"]
    """Weights of what the views show beyond the model."""
    shown: Float[Array, "lights views"]
    """Weights of what they show."""
    nearest: Int[Array, "lights near"]
    """Indices of the nearest views."""

    @classmethod
    def of(
        cls, seen: Float[np.ndarray, "seen 3"], lights: Float[np.ndarray, "lights 3"], smoothing: Smoothing
    ) -> Neighbours:
        """Return what views under some lights say of others."""
        beyond, shown = (of.weights(seen, lights).astype(np.float32) for of in (smoothing, SMOOTHEST))
        return cls(beyond, shown, np.argsort(_apart(lights, seen), axis=-1, kind="stable")[:, :NEAREST])


class BetweenLights(NamedTuple):
    """How photographs under new lights are predicted."""

    toward: Float[Array, "lights 3"]
    """Unit vectors to the lights of the views, then to the new ones."""
    neighbours: Neighbours
    """Of the new lights."""
    weights: Float[Array, "candidates units"]
    least: Float[Array, ""]
    """The least mean that a texel's inputs are relative to, as a reflectance: less is mere noise."""

    @jax.jit
    def beyond(
        self, beyond: Float[Array, "views channels texels"], model: Float[Array, "lights channels texels"]
    ) -> Float[Array, "lights channels texels"]:
        """Return what is shown beyond the model under the lights of the views, as given, and under the new ones.

        Args:
            beyond: What the views show beyond the model, as a reflectance.
            model: The model's reflectance under all lights.
        """
        seen, here = model[: len(beyond)], model[len(beyond) :]
        largest = jnp.max(beyond + seen, 0)

        def under(units: Array, candidates: Array, expected: Array, here: Array) -> Array:
            shown = expected + jnp.sum((jnp.asarray(self.weights) @ units)[:, None] * candidates, 0)
            return jnp.clip(shown, 0.0, 2.0 * jnp.maximum(largest, here)) - here

        new = _of_each(under, self.neighbours, beyond, seen, here, self.least)
        return jnp.concatenate([beyond, new.astype(beyond.dtype)])


def learned_between(
    toward: Float[np.ndarray, "views 3"],
    beyond: Float[Array, "views channels texels"],
    model: Float[Array, "views channels texels"],
    smoothing: Smoothing,
) -> BetweenLights | None:
    """Return how photographs under lights between those of the views are predicted, None where no way was learned.

    Args:
        toward: Unit vectors to the light of each view.
        beyond: What some texels show beyond the model, as a reflectance.
        model: The model's reflectance.
        smoothing: How residuals are interpolated.
    """
    views, _, texels = beyond.shape
    # the twin of a photograph tells all of it, and teaches nothing
    if views < MIN_VIEWS or np.triu(_apart(toward, toward) < MINOR, 1).any():
        return None
    every = max(1, -(-GROUPINGS * views * texels // MAX_SAMPLES))
    beyond, model = (np.asarray(of, np.float32)[..., ::every] for of in (beyond, model))
    level = max(typical_level(np.maximum((beyond + model).mean((0, 1)), 0.0)), TINY)
    beyond, model = beyond / level, model / level
    rng, found = np.random.default_rng(0), []
    for out in [out for _ in range(GROUPINGS) for out in np.array_split(rng.permutation(views), FEW)]:
        seen = np.setdiff1d(np.arange(views), out)
        others = Neighbours.of(toward[seen], toward[out], smoothing)
        found.append(_moments(others, beyond[seen], model[seen], model[out], SLIGHT, (beyond + model)[out]))
    by_view = np.concatenate(found).astype(float)
    quarters, left = np.stack([by_view[half::2].sum(0) for half in range(2)]), 0.0  # of the views, and of the texels
    of_both = (of.reshape(4, *by_view.shape[2:]) for of in (quarters, quarters[::-1, ::-1]))
    for learned_from, unseen in zip(*of_both, strict=True):
        off = np.append(_least_squares(learned_from), -1.0)
        left += off @ unseen @ off
    if not left < (1.0 - SLIGHT) ** 2 * quarters[..., -1, -1].sum():
        return None
    new = lights_between(toward)
    weights = _least_squares(quarters.sum((0, 1))).reshape(-1, UNITS).astype(np.float32)
    asked, everywhere = Neighbours.of(toward, new, smoothing), np.concatenate([toward, new]).astype(np.float32)
    return BetweenLights(everywhere, asked, weights, np.asarray(SLIGHT * level, np.float32))


def from_leaves(leaves: Sequence[Array]) -> tuple[Interpolation | None, BetweenLights | None]:
    """Return what `jax.tree.leaves` of the two gave."""
    one = np.zeros(1)
    interpolation, between = Interpolation(one, 1.0, one, one), BetweenLights(one, Neighbours(one, one, one), one, one)
    either = [jax.tree.structure(of) for of in ((None, None), (interpolation, None), (interpolation, between))]
    return next(jax.tree.unflatten(of, leaves) for of in either if of.num_leaves == len(leaves))


def lights_between(toward: Float[np.ndarray, "views 3"]) -> Float[np.ndarray, "new 3"]:
    """Return directions between some lights, spread evenly: nearer to one than these are apart."""
    spacing = float(np.median(np.sort(_apart(toward, toward), -1)[:, 1]))
    least = SPACING * spacing
    sphere = dome(round(4.0 * np.pi / least**2), -1.0)
    nearest = _apart(sphere, toward).min(-1)
    return sphere[(nearest > least) & (nearest < spacing)]


def _apart(lights: Float[np.ndarray, "lights 3"], others: Float[np.ndarray, "others 3"]) -> np.ndarray:
    return np.linalg.norm(lights[:, None] - others, axis=-1)


def _of_each(
    result: Callable[..., T],
    of: Neighbours,
    beyond: Float[Array, "views channels texels"],
    model: Float[Array, "views channels texels"],
    here: Float[Array, "lights channels texels"],
    least: Float[Array, ""],
    *more: Float[Array, "lights channels texels"],
) -> T:
    """Return for each light a result.

    It is of the units of its texels, of the candidates beyond what is expected, of that, of the model's reflectance
    there, and of more.
    """
    shown = beyond + model
    grey = shown.mean(1)
    level = jnp.maximum(grey.mean(0), least)
    expected, smooth = here + jnp.tensordot(of.beyond, beyond, 1), jnp.tensordot(of.shown, shown, 1)
    A, a = np.split(np.random.default_rng(0).standard_normal((UNITS, NEAREST + 3)), [NEAREST + 2], 1)

    def under(light: tuple[Array, ...]) -> T:
        nearest, expected, smooth, here, *more = light
        x = jnp.stack([here.mean(0), smooth.mean(0), *grey[nearest]]) / level[None] - 1.0
        units = jnp.maximum(A.astype(np.float32) @ x + a.astype(np.float32), 0.0)
        candidates = jnp.stack([jnp.zeros_like(here), smooth, *shown[nearest]])
        return result(units, candidates - expected[None], expected, here, *more)

    return jax.lax.map(under, (of.nearest, expected, smooth, here, *more))


@jax.jit
def _moments(
    of: Neighbours,
    beyond: Float[Array, "views channels texels"],
    model: Float[Array, "views channels texels"],
    here: Float[Array, "lights channels texels"],
    least: Float[Array, ""],
    shown: Float[Array, "lights channels texels"],
) -> Float[Array, "lights 2 terms terms"]:
    """Return the products of what is weighed, and, last, of what is shown beyond the expected, of views left out.

    They are summed over every second texel, and over the others.
    """

    def moments(units: Array, candidates: Array, expected: Array, _: Array, shown: Array) -> Array:
        terms = candidates[:, None] * units[None, :, None]
        terms = jnp.concatenate([terms.reshape(-1, *shown.shape), (shown - expected)[None]])
        return jnp.stack([jnp.einsum("ict,jct->ij", half, half) for half in (terms[..., ::2], terms[..., 1::2])])

    return _of_each(moments, of, beyond, model, here, least, shown)


def _least_squares(moments: Float[np.ndarray, "terms terms"]) -> Float[np.ndarray, " weights"]:
    """Return the weights by which what is shown beyond the expected is predicted best."""
    G = moments[:-1, :-1]
    ridge = SLIGHT * np.trace(G) / len(G) + TINY  # of black texels all is 0
    return np.linalg.solve(G + ridge * np.eye(len(G)), moments[:-1, -1])
