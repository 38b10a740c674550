"""Linearised: the samples of a state of a set-up, and their derivatives, on which faults are looked for."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int
from PIL import Image
from scipy import ndimage

from ...core.backend import PLAINLY, jit_quickly
from ...core.fields import Array
from ...io.encodings import srgb_decode, srgb_encode
from ...io.lazy_images import LazyImage
from ...model.cameras import SomePixels
from ...model.scenes import Scene, with_pixels
from ..data.recording import photograph
from ..data.views import View, channels
from ..forward.gram import directions_of
from ..forward.interface import AbstractForwardModel
from ..pixels.blocks import Block
from ..pixels.blocks import chunks as in_chunks
from ..result import Fit
from ..statistics.uncertainty import Matrix, Vector
from .regions import seen_points
from .set_up import Corrected, SetUp

BLUR_SIGMAS = (0.6, 1.2, 2.4)  # pixels: the tested standard deviations of a blur
LUMA = (0.299, 0.587, 0.114)  # of red, green and blue (ITU-R BT.601)


@dataclass(frozen=True, eq=False)
class Linearised:
    """The samples of a state and their derivatives, on which faults are looked for."""

    set_up: SetUp
    state: Corrected
    predicted: Float[np.ndarray, " n"]
    jacobian: scipy.sparse.csr_array
    """The derivatives by all numbers of the set-up, those of the fit first, (numbers, samples)."""
    slope: Float[np.ndarray, " n"]
    """The derivative of the cost by the prediction: weight times (prediction - photograph)."""
    weight: Float[np.ndarray, " n"]
    """0 for a clipped sample whose limit is met."""
    count: int
    """The number of measured samples."""
    known_hessian: Matrix
    """That of the priors of all numbers."""
    known_gradient: Vector

    @property
    def fit(self) -> Fit:
        """The fit at this state."""
        return self.state.fit

    @property
    def drawable(self) -> bool:
        """Whether the photographs can be drawn as a whole: those of files that are not in memory are not."""
        return not any(isinstance(view.image, LazyImage) for view in self.fit.views)

    @cached_property
    def samples(self) -> list[Int[np.ndarray, "2 n"]]:
        """The pixel and the channel of each sample of each view."""
        return np.split(np.stack([self.set_up.pixel, self.set_up.channel]), self.set_up.first[1:-1], axis=1)

    @cached_property
    def few(self) -> list[Few]:
        """What is drawn of each view: the pixels that are looked at, but of a sensor, which may blur, the whole."""
        most = max(len(np.unique(pixel)) for pixel, _ in self.samples)
        room = 1 << (most - 1).bit_length()  # of few lengths, so of few programs
        return [_few(*of, room) for of in zip(self.fit.views, self.samples, strict=True)]

    @cached_property
    def looks(self) -> Float[np.ndarray, "looks n"]:
        """What blurs of `BLUR_SIGMAS` change in the photographs that the fit predicts, shifts, and blurred colours.

        The shifts are by a pixel, along a row and along a column.
        """

        def look(view: View, samples: Int[np.ndarray, "2 n"]) -> Float[np.ndarray, "looks n"]:
            picture = photograph(self.fit.scene, view)
            blurs = (ndimage.gaussian_filter(picture, sigma, axes=(0, 1), mode="nearest") for sigma in BLUR_SIGMAS)
            shifts = (np.gradient(picture, axis=axis) for axis in (1, 0))
            each = itertools.chain((of - picture for of in blurs), shifts, _duller(picture))
            return np.array([_at(samples, of) for of in each])

        return np.concatenate(list(map(look, self.fit.views, self.samples)), 1)

    @cached_property
    def light(self) -> Float[np.ndarray, " n"]:
        """The predictions above black."""
        return self.predicted - np.array([float(view.black) for view in self.fit.views])[self.set_up.view]

    @property
    def photographed(self) -> Float[np.ndarray, " n"]:
        """What the photographs show above black; of a sample without weight, what is predicted."""
        return self.light - self.slope / np.where(self.weight > 0, self.weight, np.inf)

    @cached_property
    def at_rims(self) -> Bool[np.ndarray, " n"]:
        """Which samples are at grazing rims."""

        def at_rim(scene: Scene, view: View) -> Float[np.ndarray, "h w c"]:
            return np.repeat(seen_points(scene.objects, view.camera).grazing[..., None], channels(view), 2)

        return self.drawn(at_rim) > 0

    def drawn(
        self, picture_of: Callable[[Scene, View], np.ndarray] = photograph, scene: Scene | None = None
    ) -> Float[np.ndarray, "n ..."]:
        """Return the samples of pictures of a scene, by default the fit's: (h, w, c, ...), by default photographs."""
        scene = self.fit.scene if scene is None else scene
        return np.concatenate([_at(few.samples, picture_of(few.part_of(scene), few.view)) for few in self.few])


class Few(NamedTuple):
    """A view of the pixels of it that are drawn."""

    view: View
    pixels: Int[np.ndarray, " n"] | None
    """None for all."""
    samples: Int[np.ndarray, "2 n"]
    """Which of the pixels each sample is of, and its channel."""

    def part_of(self, scene: Scene) -> Scene:
        """Return a scene as the view sees it."""
        return scene if self.pixels is None else with_pixels(scene, self.pixels)


def _few(view: View, samples: Int[np.ndarray, "2 n"], room: int) -> Few:
    if view.sensor is not None:
        return Few(view, None, samples)
    pixels, place = np.unique(samples[0], return_inverse=True)
    pixels = np.pad(pixels, (0, room - len(pixels)))
    camera = SomePixels.of(view.camera, pixels)
    none = np.zeros((*camera.shape, channels(view)))
    return Few(replace(view, image=none, camera=camera, mask=None), pixels, np.stack([place, samples[1]]))


def _at(samples: Int[np.ndarray, "2 n"], picture: Float[np.ndarray, "h w c ..."]) -> Float[np.ndarray, "n ..."]:
    """Return samples of a picture, by their pixels and channels."""
    pixel, channel = samples
    return picture.reshape(-1, *picture.shape[2:])[pixel, channel].astype(float)


def _duller(picture: Float[np.ndarray, "h w c"]) -> Iterator[Float[np.ndarray, "h w c"]]:
    """Yield what a JPEG file changes of red and of blue if it keeps colours smaller than brightness (ITU-T T.871).

    Pictures that are grey, or of other bands than red, green and blue, have no such colours.
    """
    of_colours = list(itertools.product((2, 4), (0, 2)))  # half the size, and less where the file rounds it, too
    if picture.shape[2] != len(LUMA):
        yield from [np.zeros_like(picture)] * len(of_colours)
        return
    shown = np.clip(picture, 0.0, 1.0)
    encoded = srgb_encode(shown)
    for factor, c in of_colours:
        plane = Image.fromarray((encoded[..., c] - encoded @ LUMA).astype(np.float32))
        lost = np.asarray(plane.reduce(factor).resize(plane.size, Image.Resampling.BILINEAR)) - np.asarray(plane)
        change = np.zeros(len(LUMA))
        change[[c, 1]] = 1.0, -LUMA[c] / LUMA[1]  # brightness stays
        yield srgb_decode(encoded + lost[..., None] * change) - shown


def linearise(set_up: SetUp, state: Corrected) -> Linearised:
    """Return the samples of a state and their derivatives."""
    found: list[list[np.ndarray]] = []
    p, used, task = len(state.theta), [channels(view) for view in set_up.fit.views], set_up.laid.task
    laid = task.on_all_cores(_samples, state.theta, set_up.chunks(state.excluded))
    for of_chunk, parts in zip(laid, in_chunks(set_up.laid.parts), strict=True):
        arrays = [np.asarray(of) for of in of_chunk]
        for b, part in enumerate(parts):
            c, n = used[part.view], len(part.pixels)
            found.append([of[b][..., :c, :n].reshape(*of[b].shape[:-2], c * n) for of in arrays])
    predicted, J, slope, weight, base = (np.concatenate(of, -1) for of in zip(*found, strict=True))
    index = set_up.shown[set_up.view].T
    shown = index < p
    jacobian = scipy.sparse.csr_array((J[shown], (index[shown], np.nonzero(shown)[1])), shape=(p, len(predicted)))
    known = task.of_priors(state.theta)
    hessian, gradient = np.asarray(known.hessian), np.asarray(known.gradient)
    return Linearised(set_up, state, predicted, jacobian, slope, weight, int(np.sum(base > 0)), hessian, gradient)


@partial(jit_quickly, options=PLAINLY)
def _samples(theta: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, ...]:
    """Return a chunk's predictions, their changes by what each view shows, the cost's slopes and curvatures, weights.

    The weight of a clipped sample, which was not measured, is 0.
    """

    def of_block(block: Block) -> tuple[Array, ...]:
        m, derivative = jax.linearize(lambda q: jnp.stack(model.predict(q, block)), theta)
        seen = block.observed
        terms = model.likelihood.terms(m, seen.target, model.sample_weights(block), seen.clipped)
        J = jax.vmap(derivative)(directions_of(model.setting.shown, block.view, len(theta))[1])
        return m, J, terms.slope, terms.curvature, model.measured_weights(block)

    return jax.lax.map(of_block, chunk)
