"""Choice: what is assumed of an object, and whether each texel has an n_s of its own, by photographs that are left out.

Whatever predicts them better is taken. A highlight, single observations that are far off, and darkness that says little
are right for most real objects and many photographs; a matte object, or six photographs of anything, are told better by
fewer freedoms. Each texel's own n_s is right for renders and clean materials; on real objects it turns shadows and
bounced light into highlights.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...core.thresholds import MINOR, SLIGHT
from ...core.words import Note
from ...model.lobes import AbstractPowerLobe
from ...model.vectors import Vec3
from ..blocks import TexelBlock
from ..estimates import Estimates
from ..tiles import TexelTile
from .block_fits import lowest_state, seen_in
from .calibration import FEW_VIEWS
from .learning import Assumptions, ObjectModel, assuming, first_model, learned
from .observations import BlockObservations, observe
from .robust_descent import DescentState
from .texel_work import TexelWork

SAMPLE = 384  # texels: twice as many choose alike
FEW_FOLDS, MANY_FOLDS = 3, 6  # groups of views that are left out in turn: with few views, few of them at a time
ROUNDS = 3  # of learning under each assumption
MATTE_NOTE = Note(
    "photographs that were left out are predicted no better with a highlight: the object is taken to be matte.", "matte"
)
FEWEST_VIEWS = 6  # from which groups of them can be left out


def best_assumptions(work: TexelWork, sample: TexelTile) -> Assumptions:
    """Return the assumptions by which photographs that are left out are predicted best.

    One after another is changed where that predicts clearly better. Where it is all the same, the object is matte.

    Args:
        work: The fit.
        sample: Texels.
    """
    assumed = assuming()
    if len(sample.counts) < FEWEST_VIEWS:
        return assumed
    few = fewer(sample)
    errors = {assumed.key: errors_without(work, few, assumed)}
    changed = True
    while changed:
        changed = False
        for other in assumed.each_flipped():
            if other.key not in errors:
                work.tiles.report_progress("choosing what to assume:", min(len(errors) / 2 ** len(other.key), 1.0))
                errors[other.key] = errors_without(work, few, other)
            now, then = errors[assumed.key], errors[other.key]
            if clearly_better(now, then) or (other.is_matte_of(assumed) and then.mean() < now.mean()):
                assumed, changed = other, True
    return assumed


def errors_without(work: TexelWork, sample: TexelTile, assumed: Assumptions) -> Float[np.ndarray, " views"]:
    """Return how far each view is from what the others predict under some assumptions."""
    model = first_model(work.loss, assumed)
    for _ in range(ROUNDS):
        model = learned(model, work.sample_at_minimum(sample, model))
    return errors_of_shared(work, sample, model)


def errors_of_shared(work: TexelWork, sample: TexelTile, model: ObjectModel) -> Float[np.ndarray, " views"]:
    """Return how far each view is from what a model fitted to others predicts."""

    def error(seen: Bool[np.ndarray, " views"]) -> tuple[Array, Array]:
        def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> tuple[Array, Array]:
            observed = observe(work.setup, work.known, block, model.assumed.dark_is_shadow)
            state = lowest_state(seen_in(observed, seen), model)
            return _error_of_shared(observed, model, state), observed.counts

        return work.each(sample, program, [model])

    return _of_each_view(len(sample.counts), error)


def own_exponents_predict_better(
    work: TexelWork,
    model: ObjectModel,
    sample: TexelTile,
    lobe: AbstractPowerLobe,
    fit: Callable[[TexelTile], Estimates],
) -> bool:
    """Return whether an n_s of each texel clearly predicts views that were left out better than the shared highlight.

    Args:
        work: The robust fit.
        model: Its model of the object.
        sample: Texels.
        lobe: Lobe of the texels' own highlights.
        fit: Returns the estimates of texels with an n_s each.
    """
    sample = fewer(sample)

    def error(seen: Bool[np.ndarray, " views"]) -> tuple[Array, Array]:
        own = fit(eqx.tree_at(lambda tile: tile.counts, sample, sample.counts & seen[:, None])).values
        k_d, k_s = (own[name].mean(0)[None] for name in ("k_d", "k_s"))
        numbers = np.concatenate([own["normal"], k_d, k_s, own["n_s"]]).astype(np.float32)

        def program(block: TexelBlock, model: ObjectModel, own: np.ndarray | None) -> tuple[Array, Array]:
            assert own is not None
            observed = observe(work.setup, work.known, block, model.assumed.dark_is_shadow)
            return _error_of_own(observed, lobe, own), observed.counts

        return work.each(sample, program, [model], numbers)

    return clearly_better(errors_of_shared(work, sample, model), _of_each_view(len(sample.counts), error))


def _of_each_view(
    views: int, error: Callable[[Bool[np.ndarray, " views"]], tuple[Array, Array]]
) -> Float[np.ndarray, " views"]:
    """Return the mean error of each view over the observations that count, from fits without it.

    Args:
        views: Number of views.
        error: Takes which views are seen; returns the error of every observation, and which observations count.
    """
    fold, found = np.arange(views) % (FEW_FOLDS if views >= FEW_VIEWS else MANY_FOLDS), np.zeros(views)
    for out in range(fold.max() + 1):
        of, counts = map(np.asarray, error(fold != out))
        left_out = fold == out
        found[left_out] = np.where(counts, of, 0.0).sum(1)[left_out] / np.maximum(counts.sum(1), 1)[left_out]
    return found


def clearly_better(errors: Float[np.ndarray, " views"], others: Float[np.ndarray, " views"]) -> bool:
    """Return whether the other errors are lower by more than chance, and by more than a few percent."""
    gain = errors - others
    by_chance = np.std(gain) / np.sqrt(max(len(gain) - 1.0, 1.0))
    return bool(gain.mean() > max(by_chance, MINOR))


def fewer(sample: TexelTile) -> TexelTile:
    """Return some texels of a sample."""
    return sample.part(np.unique(np.linspace(0, len(sample.pixels) - 1, SAMPLE).astype(int)))


@jax.jit
def _error_of_shared(observed: BlockObservations, model: ObjectModel, state: DescentState) -> Array:
    D, S = observed.lights.shading(model.shape, state.n)
    return _error(state.k_d[None] * D + state.k_s[None] * S - observed.y)


@jax.jit
def _error_of_own(observed: BlockObservations, lobe: AbstractPowerLobe, own: Float[Array, "6 texels"]) -> Array:
    lights = eqx.tree_at(lambda of: of.lobe, observed.lights, lobe)
    D, S = lights.shading_of_power(own[5], Vec3(*own[:3]))
    return _error((own[3][None] * D + own[4][None] * S) / observed.level[None] - observed.y)


def _error(residual: Float[Array, "views texels"]) -> Float[Array, "views texels"]:
    """Return the logarithm of the size of a residual, by which neither the few large nor the many small ones decide."""
    return jnp.log(jnp.abs(residual) + SLIGHT)
