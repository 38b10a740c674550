"""Linearised: the samples of a state of a set-up, and their derivatives, on which faults are looked for."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Float
from PIL import Image
from scipy import ndimage

from ...core.backend import PLAINLY, jit_quickly
from ...core.fields import Array
from ...io.encodings import srgb_decode, srgb_encode
from ...io.lazy_images import LazyImage
from ..data.recording import photograph
from ..data.views import View, channels
from ..forward.gram import directions_of
from ..forward.interface import AbstractForwardModel
from ..pixels.blocks import Block
from ..pixels.blocks import chunks as in_chunks
from ..result import Fit
from ..statistics.uncertainty import Matrix, Vector
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
    def looks(self) -> Float[np.ndarray, "looks n"]:
        """What blurs of `BLUR_SIGMAS` change in the photographs that the fit predicts, shifts, and blurred colours.

        The shifts are by a pixel, along a row and along a column.
        """

        def look(view: View) -> Float[np.ndarray, "h w c looks"]:
            picture = photograph(self.fit.scene, view)
            blurs = (ndimage.gaussian_filter(picture, sigma, axes=(0, 1), mode="nearest") for sigma in BLUR_SIGMAS)
            shifts = (np.gradient(picture, axis=axis) for axis in (1, 0))
            return np.stack([*(of - picture for of in blurs), *shifts, *_duller(picture)], -1)

        return self.of(map(look, self.fit.views)).T

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
        rims = zip(self.set_up.rims, self.fit.views, strict=True)
        return self.of(np.repeat(rim[..., None], channels(view), 2) for (rim, _), view in rims) > 0

    def of(self, pictures: Iterable[np.ndarray]) -> Float[np.ndarray, "n ..."]:
        """Return the samples of pictures (h, w, c, ...), one for each view, of which one at a time is in memory."""
        at, found = self.set_up, []
        for picture, first, end in zip(pictures, at.first[:-1], at.first[1:], strict=True):
            flat = picture.reshape(-1, *picture.shape[2:])
            found.append(flat[at.pixel[first:end], at.channel[first:end]].astype(float))
        return np.concatenate(found)


def _duller(picture: Float[np.ndarray, "h w c"]) -> Iterator[Float[np.ndarray, "h w c"]]:
    """Yield what a JPEG file changes of red and of blue if it keeps colours smaller than brightness (ITU-T T.871).

    Pictures that are grey, or of other bands than red, green and blue, have no such colours.
    """
    coloured = picture.shape[2] == len(LUMA)
    shown = np.clip(picture, 0.0, 1.0)
    encoded = srgb_encode(shown)
    for factor, c in itertools.product((2, 4), (0, 2)):  # half the size, and less where the file rounds it, too
        if not coloured:
            yield np.zeros_like(picture)
            continue
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
