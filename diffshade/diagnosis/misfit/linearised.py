"""Linearised: the samples of a state of a set-up, and their derivatives, on which faults are scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

from ...core.backend import PLAINLY, jit_quickly
from ...core.fields import Array
from ...inverse.data.recording import photograph
from ...inverse.data.views import channels
from ...inverse.forward.gram import directions_of
from ...inverse.forward.interface import AbstractForwardModel
from ...inverse.forward.rounding import sawtooth
from ...inverse.pixels.blocks import Block
from ...inverse.pixels.blocks import chunks as in_chunks
from ...inverse.result import Fit
from ...parallel.threads import on_all_cores
from .score_tests import Rows
from .set_up import Corrected, SetUp


@dataclass(frozen=True, eq=False)
class Linearised:
    """The samples of a state and their derivatives, on which faults are scored."""

    set_up: SetUp
    state: Corrected
    predicted: Float[np.ndarray, " n"]
    jacobian: sparse.csr_array
    """The derivatives by all numbers, (numbers, samples)."""
    rows: Rows
    """Those by the unknowns of the fit that are not at a bound."""
    count: int
    """The number of measured samples."""
    changes: dict[str, Any] = field(default_factory=dict)
    """What each kind of fault changes, once it has been asked for."""

    @property
    def fit(self) -> Fit:
        """The fit at this state."""
        return self.state.fit

    @cached_property
    def pictures(self) -> list[np.ndarray]:
        """The whole photographs that the fit predicts."""
        return [photograph(self.fit.scene, view) for view in self.fit.views]

    @cached_property
    def light(self) -> Float[np.ndarray, " n"]:
        """The predictions above black."""
        return self.predicted - np.array([float(view.black) for view in self.fit.views])[self.set_up.view]

    @cached_property
    def at_rims(self) -> Bool[np.ndarray, " n"]:
        """Which samples are at grazing rims."""
        rims = zip(self.set_up.rims, self.fit.views, strict=True)
        return self.of([np.repeat(rim[..., None], channels(view), 2) for (rim, _), view in rims]) > 0

    def of(self, pictures: Sequence[np.ndarray]) -> Float[np.ndarray, " n"]:
        """Return the samples of pictures (h, w, c), one for each view."""
        at = self.set_up
        here = [slice(*ends) for ends in zip(at.first[:-1], at.first[1:], strict=True)]
        flat = [picture.reshape(-1, picture.shape[2]) for picture in pictures]
        return np.concatenate([x[at.pixel[of], at.channel[of]] for x, of in zip(flat, here, strict=True)]).astype(float)


def linearise(set_up: SetUp, state: Corrected) -> Linearised:
    """Return the samples of a state and their derivatives."""
    found: list[list[np.ndarray]] = []
    theta, used = jnp.asarray(state.theta), [channels(view) for view in set_up.fit.views]
    laid = on_all_cores(
        lambda chunk: _samples(theta, set_up.shown, set_up.laid.model, chunk), set_up.chunks(state.excluded)
    )
    for of_chunk, parts in zip(laid, in_chunks(set_up.laid.parts), strict=True):
        arrays = [np.asarray(of) for of in of_chunk]
        for b, part in enumerate(parts):
            c, n = used[part.view], len(part.pixels)
            found.append([of[b][..., :c, :n].reshape(*of[b].shape[:-2], c * n) for of in arrays])
    predicted, J, slope, weight, base = (np.concatenate(of, -1) for of in zip(*found, strict=True))
    index = set_up.shown[set_up.view].T
    shown = index < len(theta)
    places = index[shown], np.nonzero(shown)[1]
    jacobian = sparse.csr_array((J[shown], places), shape=(len(theta), len(predicted)))
    known = set_up.laid.prior_gram(state.theta)
    measured, inside, fit = base > 0, set_up.inside, set_up.fit
    noise, bend = ((of[measured] / base[measured]).sum() for of in (slope**2, weight))
    size = max(view.image.shape[0] * view.image.shape[1] for view in fit.views)
    rows = Rows(
        jacobian[inside],
        slope,
        weight,
        np.unique(set_up.view * size + set_up.pixel, return_inverse=True)[1],
        np.asarray(known.hessian)[np.ix_(inside, inside)],
        np.asarray(known.gradient)[inside],
        float(noise / bend),
        None if fit.evidence.waves is None else sawtooth(fit.rounding, set_up.view, predicted, base),
    )
    return Linearised(set_up, state, predicted, jacobian, rows, int(measured.sum()))


@partial(jit_quickly, options=PLAINLY)
def _samples(theta: Array, shown: Array, model: AbstractForwardModel, chunk: Block) -> tuple[Array, ...]:
    """Return a chunk's predictions, their changes by what each view shows, the cost's slopes and curvatures, weights.

    The weight of a clipped sample, which was not measured, is 0.
    """

    def of_block(block: Block) -> tuple[Array, ...]:
        m, derivative = jax.linearize(lambda q: jnp.stack(model.predict(q, block)), theta)
        seen = block.observed
        terms = model.likelihood.terms(m, seen.target, model.sample_weights(block), seen.clipped)
        J = jax.vmap(derivative)(directions_of(shown, block.view, len(theta))[1])
        return m, J, terms.slope, terms.curvature, model.measured_weights(block)

    return jax.lax.map(of_block, chunk)
