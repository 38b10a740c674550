r"""Turned lights: photographs whose light is not where it is said to be, or that are swapped with each other.

Where a texel shows no highlight it has y = k_d n.l. Its k_d and n are known from the other photographs too, so that one
photograph's texels say where its light is, by least squares under a robust loss (Woodham 1980, with the light unknown).
A photograph that shows highlights for the most part says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...core.robust_scale import robust_scale
from ...core.thresholds import DEGREE, FAR_MORE, SMALL, TINY
from ...core.words import Note, first_of
from ..prediction import TexelBlock
from ..tiles import TexelTile
from .learning import MIN_SAMPLES, ObjectModel
from .neighbours import ITERATIONS
from .observations import BlockObservations
from .robust_descent import DescentState
from .texel_work import TexelWork

LEAST = FAR_MORE**2 * DEGREE  # a light that is less far off is as well known as lights are


class MatteTexels(NamedTuple):
    """What texels are, by all photographs, and what each photograph shows of them without its highlight."""

    facing: Float[Array, "3 texels"]
    """k_d n."""
    shown: Float[Array, "views texels"]
    counts: Bool[Array, "views texels"]
    toward: Float[Array, "3 views texels"]
    """Each view's light, as it is said to be."""
    matte: Float[Array, "views texels"]
    """What the model shows of each observation without its highlight."""
    highlight: Float[Array, "views texels"]


@jax.jit
def _matte(observed: BlockObservations, model: ObjectModel, state: DescentState) -> MatteTexels:
    lights, n, k_d = observed.lights, state.n, state.k_d
    D, S = lights.shading(model.shape, n)
    matte, highlight = (jnp.where(observed.counts, part, 0.0) for part in (k_d[None] * D, state.k_s[None] * S))
    counts = observed.counts & (observed.y > SMALL) & (highlight < SMALL * matte + TINY)
    mean = [jnp.broadcast_to(jnp.sum(lights.strength * c, 1), D.shape) for c in (lights.l.x, lights.l.y, lights.l.z)]
    facing = k_d[None] * jnp.stack([n.x, n.y, n.z])
    return MatteTexels(facing, observed.y - highlight, counts, jnp.stack(mean), matte, highlight)


def matte_texels(work: TexelWork, models: Sequence[ObjectModel], sample: TexelTile) -> MatteTexels:
    """Return what texels of a sample are without their highlights, by the models of the object's regions."""

    def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> MatteTexels:
        observed, state = work.at_minimum(block, model)
        return _matte(observed, model, state)

    return work.each(sample, program, models)


def note_on_turned_lights(work: TexelWork, models: Sequence[ObjectModel], sample: TexelTile) -> tuple[Note, ...]:
    """Return a note that names the photographs whose light is far from where it is said to be.

    Args:
        work: The fit.
        models: The models of the object's regions.
        sample: Texels.
    """
    texels, said = matte_texels(work, models, sample), work.toward(sample)
    lit = (np.linalg.norm(said, axis=-1) > 0.0) & (texels.highlight.sum(1) < texels.matte.sum(1))
    found = np.stack([_seen_in(texels, v) if lit[v] else said[v] for v in range(len(said))])
    return note_on_directions(found, said, lit)


def note_on_directions(
    found: Float[np.ndarray, "views 3"], said: Float[np.ndarray, "views 3"], lit: Bool[np.ndarray, " views"]
) -> tuple[Note, ...]:
    """Return a note that names lights which are farther off than lights are, and than most of those that are lit."""
    off = angle(found, said)
    usual = float(np.median(off[lit])) if lit.any() else 0.0
    far = np.flatnonzero(off > max(LEAST, FAR_MORE**2 * usual))
    return (Note(_in_words(far, found, said, off), "disagrees"),) if len(far) else ()


def _seen_in(texels: MatteTexels, view: int) -> Float[np.ndarray, "3"]:
    """Return the direction to the light of a view by what it shows; as it is said where it shows too little."""
    some = np.asarray(texels.counts[view])
    said = np.asarray(texels.toward[:, view])
    x = said.mean(-1).astype(float)
    if some.sum() >= MIN_SAMPLES:
        A = np.asarray(texels.facing).T[some].astype(float)
        left = np.asarray(texels.shown[view] - texels.matte[view])[some]
        change = np.zeros(3)
        for _ in range(ITERATIONS):
            e = left - A @ change
            weight = 1.0 / (1.0 + (e / max(robust_scale(e), TINY)) ** 2)
            change = np.linalg.lstsq((A.T * weight) @ A, (A.T * weight) @ left, rcond=TINY)[0]
        x = x + change
    return x / np.linalg.norm(x)


def _in_words(
    far: np.ndarray, found: Float[np.ndarray, "views 3"], said: Float[np.ndarray, "views 3"], off: np.ndarray
) -> str:
    """Return which lights are off, and by how much, or that two photographs are swapped."""
    if len(far) == 2 and (angle(found[far], said[far[::-1]]) < LEAST).all():
        return f"views[{far[0]}] and views[{far[1]}] each show the other's light: the photographs are swapped."
    far = far[np.argsort(-off[far], kind="stable")]
    named = first_of([f"views[{v}] by {np.rad2deg(off[v]):.0f} degrees" for v in far])
    return (
        f"lights are not where they are said to be, by what the other photographs say: {named}. Check them, and "
        "whether such a photograph is shifted or has another encoding, which looks alike."
    )


def angle(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the angle between unit vectors, radians."""
    return 2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2.0, 0.0, 1.0))
