"""Grams: what some of the samples say of the unknowns, at a point that need not be a minimum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import Array
from ..inverse.forward.gram import ByView
from ..inverse.forward.interface import AbstractForwardModel
from ..inverse.forward.sums import sum_over
from ..inverse.pixels.blocks import Block


def gram_of(theta: Float[np.ndarray, " p"], model: AbstractForwardModel, chunks: Sequence[Block]) -> ByView:
    """Return what the samples of chunks say, as that of one view, in the solver's coordinates."""
    views = _gram(jnp.asarray(theta), model, sum_over(chunks, _summary, jnp.asarray(theta), model))
    return views.together([range(len(views.cost))], len(theta))


def _summary(theta: Array, model: AbstractForwardModel, chunk: Block) -> Any:
    return model.summary(theta, chunk)


@jax.jit
def _gram(theta: Array, model: AbstractForwardModel, summary: Any) -> ByView:
    return model.gram(theta, summary)
