r"""Between lights: photographs under lights that no view had, as the views of the same object teach to predict them.

At a light between those of the views a shadow or a highlight is there or not, where any interpolation is halfway. Each
view is left out in turn, and a small network learns from many texels how to correct what the others say of it:

$$ shown(l) = model(l) + u(l) + \sigma(l) f(x), $$

u is interpolated (kriging), and sigma is its standard error, small at a light near those of the views; x holds the
model, model + u, a spline through the others (Duchon 1977), the nearest of them, their mean and their largest. One f
serves all texels and lights, so that many materials teach it (as in neural RTI, Dulecha et al. 2020, whose network has
the place of the model). It is kept only if it predicts views and texels from which it has not learned better.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from .unexplained import LEAST_GAIN, Interpolation, Smoothing

FEWEST_VIEWS = 12
NEAREST = 4  # views that are shown to the network one by one
SPACING = 0.5  # between new lights, relative to that between the views' lights
LEAST_SPACING = 0.05  # between lights, in units of a unit vector's change; nearer ones count once
HIDDEN, NETWORKS = (32, 32), 4  # units of each layer; networks that start from other numbers, whose mean is taken
STEPS, BATCH, RATE = 1500, 2048, 1e-2
MOST_SAMPLES = 1 << 18


class Neighbours(NamedTuple):
    """For each of some lights, what the views say of it."""

    views: Int[Array, "lights seen"]
    """Indices of the views that are asked."""
    nearest: Int[Array, "lights near"]
    """Indices of the nearest of them."""
    spline: Float[Array, "lights seen"]
    """Weights of the views in a spline through them."""
    kriging: Float[Array, "lights seen"]
    """Weights of the residuals of the views."""
    spread: Float[Array, " lights"]
    """Standard error of what the residuals say, relative to their size: by how much a light lies apart."""


class Network(NamedTuple):
    """A few networks of the same shape: arrays have an axis of them first."""

    layers: tuple[tuple[Array, Array], ...]
    middle: Float[Array, " inputs"]
    scale: Float[Array, " inputs"]

    def __call__(self, x: Float[Array, "samples inputs"]) -> Float[Array, " samples"]:
        """Return the mean of what the networks say."""
        return _outputs(self.layers, (x - self.middle[None]) / self.scale[None]).mean(0)


class BetweenLights(NamedTuple):
    """How photographs under new lights are predicted."""

    toward: Float[Array, "lights 3"]
    """Unit vectors to the lights of the views, then to the new ones."""
    neighbours: Neighbours
    """Of the new lights."""
    network: Network

    @jax.jit
    def beyond(
        self, beyond: Float[Array, "views channels texels"], model: Float[Array, "lights channels texels"]
    ) -> Float[Array, "lights channels texels"]:
        """Return what is shown beyond the model under the lights of the views, as given, and under the new ones.

        Args:
            beyond: What the views show beyond the model, as a reflectance.
            model: The model's reflectance under all lights.
        """
        views = len(beyond)
        seen = model[:views]

        def under(new: tuple[Neighbours, Array]) -> Array:
            neighbours, here = new
            x, expected = _inputs(neighbours, beyond, seen, here)
            correction = self.network(x.reshape(-1, x.shape[-1])).reshape(here.shape)
            return expected + neighbours.spread * correction - here

        new = jax.lax.map(under, (self.neighbours, model[views:]))
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
    views, channels, texels = beyond.shape
    new = lights_between(toward)
    repeated = len(np.unique(np.asarray(toward, np.float32), axis=0)) < views  # a twin tells all, and teaches nothing
    if views < FEWEST_VIEWS or repeated or not len(new):
        return None
    every = max(1, -(-views * channels * texels // MOST_SAMPLES))
    beyond, model = (np.ascontiguousarray(of[..., ::every], np.float32) for of in (beyond, model))
    others = np.stack([np.delete(np.arange(views), v) for v in range(views)])
    left_out = _neighbours(toward, toward, others, smoothing)
    x, expected = jax.device_get(_of_views(left_out, beyond, model))
    off = (beyond + model - expected) / left_out.spread[:, None, None]
    half = np.zeros(off.shape, int)  # views, and texels, of two halves
    half[1::2] += 1
    half[..., 1::2] += 1
    x, off, half = x.reshape(off.size, -1), off.ravel(), half.ravel()
    judged = np.flatnonzero(half == 2)
    # several networks, and more steps, are no worse
    tried = off[judged] - np.asarray(_network(x, off, half == 0, 1, STEPS // 3)(x[judged]))
    if not np.mean(tried**2) <= (1.0 - LEAST_GAIN) ** 2 * np.mean(off[judged] ** 2):
        return None
    asked = _neighbours(toward, new, np.broadcast_to(np.arange(views), (len(new), views)), smoothing)
    everywhere = np.concatenate([toward, new]).astype(np.float32)
    return BetweenLights(everywhere, asked, _network(x, off, half >= 0, NETWORKS, STEPS))


def from_leaves(leaves: Sequence[Array]) -> tuple[Interpolation | None, BetweenLights | None]:
    """Return what `jax.tree.leaves` of the two gave."""
    interpolation = Interpolation(*[0] * len(Interpolation._fields))  # pyright: ignore[reportArgumentType]
    network = Network(((0, 0),) * (len(HIDDEN) + 1), 0, 0)  # pyright: ignore[reportArgumentType]
    neighbours = Neighbours(*[0] * len(Neighbours._fields))  # pyright: ignore[reportArgumentType]
    between = BetweenLights(0, neighbours, network)  # pyright: ignore[reportArgumentType]
    structures = [jax.tree.structure(of) for of in ((None, None), (interpolation, None), (interpolation, between))]
    found, between = jax.tree.unflatten(next(of for of in structures if of.num_leaves == len(leaves)), leaves)
    return None if found is None else found._replace(width=float(found.width)), between


def lights_between(toward: Float[np.ndarray, "views 3"]) -> Float[np.ndarray, "new 3"]:
    """Return directions around some lights, spread evenly (Vogel 1979): nearer to one than these are apart."""
    apart = np.linalg.norm(toward[:, None] - toward, axis=-1) + 4.0 * np.eye(len(toward))
    once = np.array([not (apart[i, :i] < LEAST_SPACING).any() for i in range(len(apart))])
    if once.sum() < 2:
        return np.zeros((0, 3))
    others = apart[np.ix_(once, once)]
    spacing = float(np.median(np.where(others < LEAST_SPACING, 4.0, others).min(1)))
    count = round(4.0 * np.pi / (SPACING * spacing) ** 2)
    i = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * i / count, np.pi * (3.0 - np.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z * z)
    sphere = np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)
    return sphere[np.linalg.norm(sphere[:, None] - toward, axis=-1).min(1) < spacing]


def _neighbours(
    toward: Float[np.ndarray, "views 3"],
    lights: Float[np.ndarray, "lights 3"],
    views: Int[np.ndarray, "lights seen"],
    smoothing: Smoothing,
) -> Neighbours:
    """Return what some views say of each light."""
    seen = toward[views]
    order = np.argsort(np.linalg.norm(seen - lights[:, None], axis=-1), axis=-1, kind="stable")
    nearest = np.take_along_axis(views, order[:, :NEAREST], -1)
    spline, kriging, spread = (
        np.stack([of(s, l) for s, l in zip(seen, lights, strict=True)]).astype(np.float32)
        for of in (_spline, smoothing.weights, smoothing.spread)
    )
    return Neighbours(views, nearest, spline, kriging, spread)


def _spline(seen: Float[np.ndarray, "seen 3"], light: Float[np.ndarray, "3"]) -> Float[np.ndarray, " seen"]:
    """Return the weights of a thin plate spline, r^2 log r with a linear trend, through what is seen."""

    def bend(to: np.ndarray) -> np.ndarray:
        r = np.linalg.norm(seen - to[..., None, :], axis=-1)
        return r**2 * np.log(np.maximum(r, 1e-12))

    trend = np.concatenate([np.ones((len(seen), 1)), seen], -1)
    A = np.block([[bend(seen), trend], [trend.T, np.zeros((4, 4))]])
    # where all lights are in one plane, the trend that is smallest
    return (np.concatenate([bend(light), [1.0], light]) @ np.linalg.pinv(A, rcond=1e-9))[: len(seen)]


def _inputs(
    of: Neighbours,
    beyond: Float[Array, "views channels texels"],
    model: Float[Array, "views channels texels"],
    here: Float[Array, "channels texels"],
) -> tuple[Float[Array, "channels texels inputs"], Float[Array, "channels texels"]]:
    """Return what the network is shown of one light, and what it corrects."""
    shown = beyond + model
    seen = shown[of.views]
    expected = here + jnp.tensordot(of.kriging, beyond[of.views], 1)
    found = [expected, here, jnp.tensordot(of.spline, seen, 1), seen.mean(0), seen.max(0)]
    return jnp.stack([*found, *shown[of.nearest], *model[of.nearest]], -1), expected


@jax.jit
def _of_views(left_out: Neighbours, beyond: Array, model: Array) -> tuple[Array, Array]:
    """Return the inputs for each view that is left out, and what is expected of it."""
    return jax.lax.map(lambda one: _inputs(one[0], beyond, model, one[1]), (left_out, model))


def _outputs(
    layers: tuple[tuple[Array, Array], ...], x: Float[Array, "samples inputs"]
) -> Float[Array, "networks samples"]:
    def one(layers: tuple[tuple[Array, Array], ...]) -> Array:
        y = x
        for weight, bias in layers[:-1]:
            y = jax.nn.relu(y @ weight + bias[None])
        weight, bias = layers[-1]
        return (y @ weight + bias[None])[..., 0]

    return jax.vmap(one)(layers)


def _network(
    x: Float[np.ndarray, "samples inputs"],
    y: Float[np.ndarray, " samples"],
    taken: Bool[np.ndarray, " samples"],
    networks: int,
    steps: int,
) -> Network:
    """Return networks that were trained on the samples that are taken: the least squares, by Adam."""
    rng = np.random.default_rng(0)
    sizes = (x.shape[1], *HIDDEN, 1)
    layers = tuple(
        (
            (rng.standard_normal((networks, a, b)) * np.sqrt(2.0 / a)).astype(np.float32),
            np.zeros((networks, b), np.float32),
        )
        for a, b in itertools.pairwise(sizes)
    )
    which = rng.choice(np.flatnonzero(taken), (steps, BATCH))
    middle, scale = x[taken].mean(0), np.maximum(x[taken].std(0), 1e-6)
    size = max(float(np.sqrt(np.mean(y[taken] ** 2))), 1e-12)
    *hidden, (weight, bias) = _descended(layers, (x - middle) / scale, y / size, which)
    return Network((*hidden, (size * weight, size * bias)), middle, scale)


@jax.jit
def _descended(
    layers: tuple[tuple[Array, Array], ...], x: Array, y: Array, which: Int[Array, "steps batch"]
) -> tuple[tuple[Array, Array], ...]:
    """Return the layers after steps of Adam (Kingma and Ba 2015), which become shorter as a cosine does."""

    def cost(layers: tuple[tuple[Array, Array], ...], batch: Array) -> Array:
        return jnp.sum(jnp.mean((_outputs(layers, x[batch]) - y[batch][None]) ** 2, -1))

    def step(carry: tuple, item: tuple[Array, Array]) -> tuple[tuple, None]:
        layers, first, second = carry
        k, batch = item
        slope = jax.grad(cost)(layers, batch)
        first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slope)
        second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slope)
        rate = RATE * 0.5 * (1.0 + jnp.cos(jnp.pi * k / len(which)))
        layers = jax.tree.map(
            lambda p, m, v: p - rate * (m / (1.0 - 0.9**k)) / (jnp.sqrt(v / (1.0 - 0.999**k)) + 1e-8),
            layers,
            first,
            second,
        )
        return (layers, first, second), None

    still = jax.tree.map(jnp.zeros_like, layers)
    steps = jnp.arange(1, len(which) + 1, dtype=jnp.float32)
    return jax.lax.scan(step, (layers, still, still), (steps, which))[0][0]
