r"""Between lights: photographs under lights that no view had, as the views of the same object teach to predict them.

At a light between those of the views a shadow or a highlight is there or not, where any interpolation is halfway. Views
are left out, each alone and in groups, and a small network learns from many texels how to correct what the others say:

$$ shown(l) = e(l) + \sigma(l) \sum_j f_j(x) (s_j(l) - e(l)), \quad e(l) = model(l) + u(l) $$

u is interpolated (kriging), and sigma is its standard error, small at a light near those of the views. The s_j are the
candidates: zero, the model, a spline through the views (Duchon 1977), their mean, the four nearest views. x holds them,
the model under the nearest views, and the largest of all, grey and relative to the mean, so that one f serves all
texels, colours and lights, and many materials teach it. (Kernels are predicted so in Bako et al. 2017; a network that
has the place of the model is neural RTI's, Dulecha et al. 2020.) What is shown lies between 0 and twice the largest
that the views or the model show. The network is kept only if it predicts views and texels from which it has not learned
better.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.fields import Array
from ..core.thresholds import FEW, MINOR, SLIGHT
from ..inverse.data.relightable import dome
from .robust.learning import typical_level
from .unexplained import Interpolation, Smoothing

T = TypeVar("T")
Layers = tuple[tuple[Array, Array], tuple[Array, Array]]
# How near new lights are, how views are left out, and the network's size were chosen on the one object at hand of which
# a network learns: a dome of 49 lights.
MIN_VIEWS = 12
NEAREST = 4  # views that are shown to the network one by one
CANDIDATES = 2 * NEAREST
SPACING = 0.35  # between new lights, relative to that between the views' lights
MIN_APART = 0.45  # of the same, from a new light to the views': nearer ones are interpolated as well
GROUPINGS = 2  # in so many ways
HIDDEN = 64  # units of the network's one layer
STEPS, BATCH, RATE, DECAY = 4000, 2048, 2e-2, 0.03
MAX_SAMPLES = 1 << 19
# Of the object's typical level, to which what a texel shows is relative where its own mean is mere noise.


class Neighbours(NamedTuple):
    """For each of some lights, what the views say of it."""

    asked: Float[Array, "lights views"]
    """Weights of the views in their mean: 0 for those that are not asked."""
    nearest: Int[Array, "lights near"]
    """Indices of the nearest of the views that are asked."""
    spline: Float[Array, "lights views"]
    """Weights of the views in a spline through them."""
    kriging: Float[Array, "lights views"]
    """Weights of the residuals of the views."""
    spread: Float[Array, " lights"]
    """Standard error of what the residuals say, relative to their size: by how much a light lies apart."""


class NetworkSamples(NamedTuple):
    """What the network is shown, and what it weighs."""

    x: Float[Array, "inputs samples"]
    """Its inputs, all grey."""
    others: Float[Array, "candidates channels samples"]
    """The candidates, beyond what is expected."""


class Network(NamedTuple):
    """One layer of rectified units. Its outputs are the weights of the candidates."""

    hidden: tuple[Float[Array, "units inputs"], Float[Array, " units"]]
    output: tuple[Float[Array, "candidates units"], Float[Array, " candidates"]]
    middle: Float[Array, " inputs"]
    scale: Float[Array, " inputs"]
    least: Float[Array, ""]
    """The least mean that a texel's inputs are relative to, as a reflectance."""

    def __call__(self, of: NetworkSamples) -> Float[Array, "channels samples"]:
        """Return by how much more than expected is shown, in standard errors."""
        return _weighed((self.hidden, self.output), (of.x - self.middle[:, None]) / self.scale[:, None], of.others)


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
        seen, here = model[: len(beyond)], model[len(beyond) :]
        largest = jnp.max(beyond + seen, 0)

        def under(samples: NetworkSamples, expected: Array, spread: Array, here: Array) -> Array:
            shown = expected + spread * self.network(samples)
            return jnp.clip(shown, 0.0, 2.0 * jnp.maximum(largest, here)) - here

        new = _of_each(under, self.neighbours, beyond, seen, self.network.least, here)
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
    # the twin of a photograph tells all of it, and teaches nothing
    if views < MIN_VIEWS or not _once(toward).all() or not len(new):
        return None
    left_out = _left_out(views)
    every = max(1, -(-(1 + GROUPINGS) * views * texels // MAX_SAMPLES))
    beyond, model = (np.ascontiguousarray(of[..., ::every], np.float32) for of in (beyond, model))
    which, every_view = np.concatenate(left_out), np.arange(views)
    others = _neighbours(toward, [(toward[out], np.setdiff1d(every_view, out)) for out in left_out], smoothing)
    level = typical_level(np.maximum((beyond + model).mean((0, 1)), 0.0))
    least = np.asarray(max(SLIGHT * level, 1e-6), np.float32)
    samples = _left_out_samples(others, beyond, model, least, which).reshape(len(which) * beyond.shape[-1], -1)
    half = ((which % 2)[:, None] + np.arange(beyond.shape[-1]) % 2).ravel()  # views, and texels, of two halves
    tried = _network(samples, channels, least, np.flatnonzero(half == 0), STEPS // 8)  # more steps are no worse
    of, off = _parted(samples[np.flatnonzero(half == 2)], channels)
    if not jnp.mean((off - tried(of)) ** 2) <= (1.0 - SLIGHT) ** 2 * jnp.mean(off**2):
        return None
    asked = _neighbours(toward, [(new, every_view)], smoothing)
    everywhere = np.concatenate([toward, new]).astype(np.float32)
    return BetweenLights(everywhere, asked, _network(samples, channels, least, np.arange(len(samples)), STEPS))


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
    weight, bias, weights, biases, *numbers = given
    return interpolation, BetweenLights(toward, neighbours, Network((weight, bias), (weights, biases), *numbers))


def lights_between(toward: Float[np.ndarray, "views 3"]) -> Float[np.ndarray, "new 3"]:
    """Return directions between some lights, spread evenly: nearer to one than these are apart."""
    once = toward[_once(toward)]
    if len(once) < 2:
        return np.zeros((0, 3))
    spacing = float(np.median(_apart(once).min(1)))
    count = round(4.0 * np.pi / (SPACING * spacing) ** 2)
    sphere = dome(count, -1.0)
    nearest = np.linalg.norm(sphere[:, None] - toward, axis=-1).min(1)
    return sphere[(nearest > MIN_APART * spacing) & (nearest < spacing)]


def _apart(toward: Float[np.ndarray, "views 3"]) -> Float[np.ndarray, "views views"]:
    return np.linalg.norm(toward[:, None] - toward, axis=-1) + 4.0 * np.eye(len(toward))


def _once(toward: Float[np.ndarray, "views 3"]) -> Bool[np.ndarray, " views"]:
    """Return which lights are no twins of ones before them."""
    apart = _apart(toward)
    return np.array([not (apart[i, :i] < MINOR).any() for i in range(len(apart))])


def _left_out(views: int) -> list[Int[np.ndarray, " out"]]:
    """Return the views that are left out together: each alone, then groups drawn at random."""
    rng = np.random.default_rng(0)
    groups = [np.sort(out) for _ in range(GROUPINGS) for out in np.array_split(rng.permutation(views), FEW)]
    return [*np.arange(views)[:, None], *groups]


def _neighbours(
    toward: Float[np.ndarray, "views 3"],
    groups: Sequence[tuple[Float[np.ndarray, "lights 3"], Int[np.ndarray, " seen"]]],
    smoothing: Smoothing,
) -> Neighbours:
    """Return what some views say of each light of a group, one light after another."""
    found = [_of_group(toward, *group, smoothing) for group in groups]
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

    def of_all(weights: Float[np.ndarray, "lights seen"] | float) -> Float[np.ndarray, "lights views"]:
        found = np.zeros((len(lights), len(toward)), np.float32)
        found[:, views] = weights
        return found

    return Neighbours(
        of_all(1.0 / len(views)),
        views[order[:, :NEAREST]],
        of_all(_spline(seen, lights)),
        of_all(weights),
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
    return (np.concatenate([bend(lights), trend(lights)], -1) @ np.linalg.pinv(A, rcond=1e-9, hermitian=True))[
        :, : len(seen)
    ]


def _of_each(
    result: Callable[..., T],
    of: Neighbours,
    beyond: Float[Array, "views channels texels"],
    model: Float[Array, "views channels texels"],
    least: Float[Array, ""],
    here: Float[Array, "lights channels texels"],
    *more: Float[Array, "lights channels texels"],
) -> T:
    """Return for each light the result of its samples, what is expected, its spread, the model there, and more."""
    shown = beyond + model
    grey, grey_model = shown.mean(1), model.mean(1)
    expected = here + jnp.tensordot(of.kriging, beyond, 1)
    spline, mean = jnp.tensordot(of.spline, shown, 1), jnp.tensordot(of.asked, shown, 1)

    def under(light: tuple[Array, ...]) -> T:
        asked, nearest, spread, expected, spline, mean, here, *more = light
        largest = jnp.max(jnp.where(asked[:, None] > 0.0, grey, -jnp.inf), 0)
        level = jnp.maximum(mean.mean(0), least)
        found = [expected.mean(0), here.mean(0), spline.mean(0), largest, *grey[nearest], *grey_model[nearest]]
        x = jnp.stack([*(one / level for one in found), level])
        others = jnp.stack([jnp.zeros_like(here), here, spline, mean, *shown[nearest]]) - expected[None]
        return result(NetworkSamples(x, others), expected, spread, here, *more)

    return jax.lax.map(under, (of.asked, of.nearest, of.spread, expected, spline, mean, here, *more))


@jax.jit
def _left_out_samples(
    left_out: Neighbours, beyond: Array, model: Array, least: Array, which: Int[Array, " lights"]
) -> Float[Array, "lights texels numbers"]:
    """Return the samples of views that are left out, and what they show beyond the expected, in standard errors.

    A sample's numbers are beside one another, so that drawing some samples is quick.
    """

    def row(samples: NetworkSamples, expected: Array, spread: Array, here: Array, shown: Array) -> Array:
        others = samples.others.reshape(-1, samples.x.shape[1])
        return jnp.concatenate([samples.x, others, (shown - expected) / spread]).T

    return _of_each(row, left_out, beyond, model, least, model[which], (beyond + model)[which])


def _parted(
    rows: Float[Array, "samples numbers"], channels: int
) -> tuple[NetworkSamples, Float[Array, "channels samples"]]:
    """Return the samples of rows, and what they show beyond the expected."""
    numbers = rows.T
    ends = np.cumsum([len(numbers) - (CANDIDATES + 1) * channels, CANDIDATES * channels])
    x, others, off = jnp.split(numbers, ends)
    return NetworkSamples(x, others.reshape(CANDIDATES, channels, -1)), off


def _weighed(
    layers: Layers, x: Float[Array, "inputs samples"], others: Float[Array, "candidates channels samples"]
) -> Float[Array, "channels samples"]:
    """Return the candidates, weighed by what the layers make of the inputs."""
    (weight, bias), (weights, biases) = layers
    each = weights @ jax.nn.relu(weight @ x + bias[:, None]) + biases[:, None]
    return jnp.sum(each[:, None] * others, 0)


def _network(
    rows: Float[Array, "samples numbers"],
    channels: int,
    least: Array,
    taken: Int[np.ndarray, " taken"],
    steps: int,
) -> Network:
    """Return the network that was trained on the rows that are taken: the least squares, by Adam."""
    rng = np.random.default_rng(0)
    inputs = rows.shape[1] - (CANDIDATES + 1) * channels

    def layer(size: int, inputs: int) -> tuple[np.ndarray, np.ndarray]:
        weight = rng.standard_normal((size, inputs)) * np.sqrt(2.0 / inputs)
        return weight.astype(np.float32), np.zeros(size, np.float32)

    layers = (layer(HIDDEN, inputs), layer(CANDIDATES, HIDDEN))
    of_rows = np.asarray(rows)
    x, off = of_rows[taken, :inputs], of_rows[taken, -channels:]
    middle, scale = x.mean(0), np.maximum(x.std(0), 1e-6)
    size = np.float32(max(float(np.sqrt(np.mean(off**2))), 1e-12))
    which = taken[rng.integers(0, len(taken), (steps, BATCH))]
    hidden, output = _descended(Network(*layers, middle, scale, least), rows, which, size, channels)
    return Network(hidden, output, middle, scale, least)


@partial(jax.jit, static_argnames="channels")
def _descended(
    begun: Network,
    rows: Float[Array, "samples numbers"],
    which: Int[Array, "steps batch"],
    size: Float[Array, ""],
    channels: int,
) -> Layers:
    """Return the layers after steps of Adam with weight decay, the rate falling as a cosine (Loshchilov, Hutter 2019).

    Args:
        begun: The network to begin with.
        rows: The samples, and what is shown of each.
        which: Samples of each step.
        size: The candidates and what is shown are relative to this.
        channels: Channels of what is shown.
    """

    def cost(layers: Layers, batch: Array) -> Array:
        of, off = _parted(rows[batch], channels)
        return jnp.mean((begun._replace(hidden=layers[0], output=layers[1])(of) - off) ** 2) / size**2

    def step(carry: tuple, item: tuple[Array, Array]) -> tuple[tuple, None]:
        layers, first, second = carry
        k, batch = item
        slope = jax.grad(cost)(layers, batch)
        first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slope)
        second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slope)
        rate = RATE * 0.5 * (1.0 + jnp.cos(jnp.pi * k / len(which)))

        def moved(p: Array, m: Array, v: Array) -> Array:
            return p - rate * (m / (1.0 - 0.9**k) / (jnp.sqrt(v / (1.0 - 0.999**k)) + 1e-8) + DECAY * p)

        return (jax.tree.map(moved, layers, first, second), first, second), None

    layers = (begun.hidden, begun.output)
    still = jax.tree.map(jnp.zeros_like, layers)
    steps = jnp.arange(1, len(which) + 1, dtype=jnp.float32)
    return jax.lax.scan(step, (layers, still, still), (steps, which))[0][0]
