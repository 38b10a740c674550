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
from typing import Any, NamedTuple

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
    left_out = _neighbours(toward, toward[:, None], others, smoothing)
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
    asked = _neighbours(toward, new[None], np.arange(views)[None], smoothing)
    everywhere = np.concatenate([toward, new]).astype(np.float32)
    return BetweenLights(everywhere, asked, _network(x, off, half >= 0, NETWORKS, STEPS))


def from_leaves(leaves: Sequence[Array]) -> tuple[Interpolation | None, BetweenLights | None]:
    """Return what `jax.tree.leaves` of the two gave."""
    if not leaves:
        return None, None
    given = iter(leaves)

    def taken(kind: Any) -> Any:
        return kind(*itertools.islice(given, len(kind._fields)))

    interpolation = taken(Interpolation)
    interpolation = interpolation._replace(width=float(interpolation.width))
    if len(leaves) == len(Interpolation._fields):
        return interpolation, None
    toward, neighbours = next(given), taken(Neighbours)
    *layers, middle, scale = given
    network = Network(tuple(zip(layers[::2], layers[1::2], strict=True)), middle, scale)
    return interpolation, BetweenLights(toward, neighbours, network)


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
    lights: Float[np.ndarray, "groups lights 3"],
    views: Int[np.ndarray, "groups seen"],
    smoothing: Smoothing,
) -> Neighbours:
    """Return what some views say of each light of a group, one light after another."""
    found = [_of_group(toward, *group, smoothing) for group in zip(lights, views, strict=True)]
    return jax.tree.map(lambda *of: np.concatenate(of), *found)


def _of_group(
    toward: Float[np.ndarray, "views 3"],
    lights: Float[np.ndarray, "lights 3"],
    views: Int[np.ndarray, " seen"],
    smoothing: Smoothing,
) -> Neighbours:
    seen = toward[views]
    order = np.argsort(np.linalg.norm(seen - lights[:, None], axis=-1), axis=-1, kind="stable")
    weights = smoothing.weights(seen, lights)
    return Neighbours(
        np.broadcast_to(views, (len(lights), len(views))),
        views[order[:, :NEAREST]],
        _spline(seen, lights).astype(np.float32),
        weights.astype(np.float32),
        smoothing.spread(seen, lights, weights).astype(np.float32),
    )


def _spline(
    seen: Float[np.ndarray, "seen 3"], lights: Float[np.ndarray, "lights 3"]
) -> Float[np.ndarray, "lights seen"]:
    """Return the weights of a thin plate spline, r^2 log r with a linear trend, through what is seen."""

    def bend(to: np.ndarray) -> np.ndarray:
        r = np.linalg.norm(seen - to[:, None], axis=-1)
        return r**2 * np.log(np.maximum(r, 1e-12))

    def trend(of: np.ndarray) -> np.ndarray:
        return np.concatenate([np.ones((len(of), 1)), of], -1)

    A = np.block([[bend(seen), trend(seen)], [trend(seen).T, np.zeros((4, 4))]])
    # where all lights are in one plane, the trend that is smallest
    return (np.concatenate([bend(lights), trend(lights)], -1) @ np.linalg.pinv(A, rcond=1e-9))[:, : len(seen)]


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
