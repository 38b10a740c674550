r"""Between lights: photographs under lights that no view had, as the views of the same object teach to predict them.

At a light between those of the views a shadow or a highlight is there or not, where any interpolation is halfway. Views
are left out in groups, and a small network learns from many texels how to correct what the others say:

$$ shown(l) = e(l) + \sum_j f_j(x) (s_j(l) - e(l)), \quad e(l) = model(l) + u(l) $$

u is what the views show beyond the model, interpolated (kriging). The s_j are the candidates: zero, the photographs
interpolated without a model, the four nearest views. x holds these and the model, grey and relative to the mean of the
views, so that one f serves all texels, colours and lights, and many materials teach it. (Kernels are predicted so in
Bako et al. 2017; a network that has the place of the model is neural RTI's, Dulecha et al. 2020.) What is shown lies
between 0 and twice the largest that the views or the model show. The network is kept only if it predicts views and
texels from which it has not learned better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
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
# Chosen on the one object at hand of which a network learns: a dome of 49 lights.
MIN_VIEWS = 12
NEAREST = 4  # views that are shown to the network one by one
SPACING = 0.35  # between new lights, and from these to the views', relative to that between the views' lights
GROUPINGS = 2  # in so many ways are views left out
HIDDEN = 64  # units of the network's one layer
STEPS, BATCH, RATE = 2000, 2048, 1e-2
MAX_SAMPLES = STEPS * BATCH // FEW
SMOOTHEST = Smoothing(max(WIDTHS), min(NOISES))


class Neighbours(NamedTuple):
    """For each of some lights, what the views say of it."""

    beyond: Float[Array, "lights views"]
    """Weights of what the views show beyond the model."""
    shown: Float[Array, "lights views"]
    """Weights of what they show."""
    nearest: Int[Array, "lights near"]
    """Indices of the nearest views."""


class Sample(NamedTuple):
    """What the network is shown of some texels under one light, and what it weighs."""

    x: Float[jax.Array, "inputs texels"]
    candidates: Float[Array, "candidates channels texels"]
    """Beyond what is expected."""
    expected: Float[Array, "channels texels"]


class Lessons(NamedTuple):
    """Samples of views that are left out, and what these show."""

    x: Float[Array, "samples inputs"]
    candidates: Float[Array, "samples candidates channels"]
    off: Float[Array, "samples channels"]
    """What is shown beyond the expected."""


class Network(eqx.Module):
    """One layer of rectified units. Its outputs are the weights of the candidates."""

    hidden: eqx.nn.Linear
    output: eqx.nn.Linear

    @classmethod
    def begun(cls) -> Network:
        """Return a network that has learned nothing."""
        one, other = jax.random.split(jax.random.key(0))
        numbers = NEAREST + 2
        return cls(
            eqx.nn.Linear(numbers, HIDDEN, key=one, dtype=jnp.float32),
            eqx.nn.Linear(HIDDEN, numbers, key=other, dtype=jnp.float32),
        )

    def __call__(
        self, x: Float[jax.Array, " inputs"], candidates: Float[Array, "candidates channels"]
    ) -> Float[jax.Array, " channels"]:
        """Return by how much more than expected a texel shows."""
        return jnp.sum(self.output(jax.nn.relu(self.hidden(x)))[:, None] * candidates, 0)


class BetweenLights(NamedTuple):
    """How photographs under new lights are predicted."""

    toward: Float[Array, "lights 3"]
    """Unit vectors to the lights of the views, then to the new ones."""
    neighbours: Neighbours
    """Of the new lights."""
    network: Network
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

        def under(sample: Sample, here: Array) -> Array:
            shown = sample.expected + jax.vmap(self.network, -1, -1)(sample.x, sample.candidates)
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
    new = lights_between(toward)
    every = max(1, -(-GROUPINGS * views * texels // MAX_SAMPLES))
    beyond, model = (np.asarray(of, np.float32)[..., ::every] for of in (beyond, model))
    level = max(typical_level(np.maximum((beyond + model).mean((0, 1)), 0.0)), TINY)
    beyond, model = beyond / level, model / level
    rng, found = np.random.default_rng(0), []
    left_out = [out for _ in range(GROUPINGS) for out in np.array_split(rng.permutation(views), FEW)]
    for out in left_out:
        seen = np.setdiff1d(np.arange(views), out)
        others = _neighbours(toward[seen], toward[out], smoothing)
        found.append(_lessons(others, beyond[seen], model[seen], model[out], SLIGHT, (beyond + model)[out]))
    lessons = jax.tree.map(lambda *of: np.concatenate(of), *found)
    # views, and texels, of two halves
    half = (np.concatenate(left_out)[:, None] % 2 + np.arange(beyond.shape[-1]) % 2).ravel()
    some = rng.integers(0, half.size, (STEPS, BATCH))
    learned_from = np.flatnonzero(half == 0)
    tried = _trained(lessons, learned_from[some % len(learned_from)])
    unseen = Lessons(*(of[half == 2] for of in lessons))
    if not _mean_square(tried, unseen) <= (1.0 - SLIGHT) ** 2 * np.mean(unseen.off**2):
        return None
    asked = _neighbours(toward, new, smoothing)
    everywhere = np.concatenate([toward, new]).astype(np.float32)
    return BetweenLights(everywhere, asked, _trained(lessons, some), np.asarray(SLIGHT * level, np.float32))


def from_leaves(leaves: Sequence[Array]) -> tuple[Interpolation | None, BetweenLights | None]:
    """Return what `jax.tree.leaves` of the two gave."""
    one = np.zeros(1)
    interpolation = Interpolation(one, 1.0, one, one)
    between = BetweenLights(one, Neighbours(one, one, one), jax.eval_shape(Network.begun), one)
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


def _neighbours(
    seen: Float[np.ndarray, "seen 3"], lights: Float[np.ndarray, "lights 3"], smoothing: Smoothing
) -> Neighbours:
    """Return what some views say of each of some lights."""
    beyond, shown = (of.weights(seen, lights).astype(np.float32) for of in (smoothing, SMOOTHEST))
    return Neighbours(beyond, shown, np.argsort(_apart(lights, seen), axis=-1, kind="stable")[:, :NEAREST])


def _of_each(
    result: Callable[..., T],
    of: Neighbours,
    beyond: Float[Array, "views channels texels"],
    model: Float[Array, "views channels texels"],
    here: Float[Array, "lights channels texels"],
    least: Float[Array, ""],
    *more: Float[Array, "lights channels texels"],
) -> T:
    """Return for each light the result of its sample, of the model's reflectance there, and of more."""
    shown = beyond + model
    grey = shown.mean(1)
    level = jnp.maximum(grey.mean(0), least)
    expected, smooth = here + jnp.tensordot(of.beyond, beyond, 1), jnp.tensordot(of.shown, shown, 1)

    def under(light: tuple[Array, ...]) -> T:
        nearest, expected, smooth, here, *more = light
        x = jnp.stack([here.mean(0), smooth.mean(0), *grey[nearest]]) / level[None] - 1.0
        candidates = jnp.stack([jnp.zeros_like(here), smooth, *shown[nearest]])
        return result(Sample(x, candidates - expected[None], expected), here, *more)

    return jax.lax.map(under, (of.nearest, expected, smooth, here, *more))


@jax.jit
def _lessons(
    of: Neighbours,
    beyond: Float[Array, "views channels texels"],
    model: Float[Array, "views channels texels"],
    here: Float[Array, "lights channels texels"],
    least: Float[Array, ""],
    shown: Float[Array, "lights channels texels"],
) -> Lessons:
    """Return what views say of others that are left out, and what these show, one texel and light after another."""

    def lesson(sample: Sample, _: Array, shown: Array) -> Lessons:
        return Lessons(sample.x.T, jnp.moveaxis(sample.candidates, -1, 0), (shown - sample.expected).T)

    found = _of_each(lesson, of, beyond, model, here, least, shown)
    return jax.tree.map(lambda of: of.reshape(-1, *of.shape[2:]), found)


@jax.jit
def _mean_square(network: Network, lessons: Lessons) -> Float[Array, ""]:
    """Return the mean square of what the network is off."""
    return jnp.mean((jax.vmap(network)(jnp.asarray(lessons.x), lessons.candidates) - lessons.off) ** 2)


@jax.jit
def _trained(lessons: Lessons, batches: Int[Array, "steps batch"]) -> Network:
    """Return the network that has learned from batches of lessons: the least squares of what is off, by Adam."""
    import optax

    optimiser = optax.adam(optax.cosine_decay_schedule(RATE, STEPS))

    def cost(network: Network, batch: Array) -> Array:
        return _mean_square(network, jax.tree.map(lambda of: of[batch], lessons))

    def step(carry: tuple, batch: Array) -> tuple[tuple, None]:
        network, state = carry
        moved, state = optimiser.update(jax.grad(cost)(network, batch), state)
        return (optax.apply_updates(network, moved), state), None

    begun: Any = Network.begun()  # of a type that optax does not name
    with jax.numpy_dtype_promotion("standard"):  # optax takes powers by whole numbers
        return jax.lax.scan(step, (begun, optimiser.init(begun)), batches)[0][0]
