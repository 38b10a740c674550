"""Choice: what is assumed of an object, and whether each texel has an n_s of its own, by photographs that are left out.

Whatever predicts them better is taken. A highlight, single observations that are far off, and darkness that says little
are right for most real objects and many photographs; a matte object, or six photographs of anything, are told better by
fewer freedoms. Each texel's own n_s is right for renders and clean materials; on real objects it turns shadows and
bounced light into highlights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

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
from ..estimates import Estimates
from ..prediction import TexelBlock
from ..tiles import TexelTile
from .block_fits import lowest_state, seen_in
from .calibration import GROUPS
from .learning import Assumptions, ObjectModel, every_assumption, first_model, learned
from .observations import BlockObservations, turned_by
from .reflection_shape import lobe_taken
from .robust_descent import DescentState
from .texel_work import BLOCK, TexelWork

FIRST_ROUNDS, ROUNDS = 4, 3  # of learning: from nothing, and from what was learned otherwise
MATTE_NOTE = Note(
    "photographs that were left out are predicted no better with a highlight: the object is taken to be matte.", "matte"
)


class Judged(NamedTuple):
    """A model, and the errors of the views of which something was left out."""

    model: ObjectModel
    errors: Float[np.ndarray, " views"]


def best_model(work: TexelWork, sample: TexelTile) -> ObjectModel:
    """Return the model of an object under the assumptions by which photographs that are left out are predicted best.

    Outliers and darkness are judged by whether another assumption predicts clearly better, with a highlight and without
    one. Lambert's law is judged before, with outliers and darkness assumed. The object is matte where a highlight
    does not lower the error. Where stated errors of the lights explain as much, it is matte and all observations count
    alike. With fewer than six views, of which none can be left out, all is assumed but that law.

    Args:
        work: The fit.
        sample: Texels.
    """
    few = fewer(sample)
    model = from_nothing(work, few, every_assumption()[0])
    if len(sample.counts) < GROUPS:
        return model

    def judged(assumed: Assumptions) -> Judged:
        work.tiles.report_progress("choosing what to assume")
        other = eqx.tree_at(lambda one: one.assumed, model, assumed)
        for _ in range(ROUNDS):
            other = learned(other, work.sample_at_minimum(few, other))
        return Judged(other, errors_of_shared(work, few, [other]))

    like_lights = 3.0  # times chance: errors of the lights look a little like another law, highlights and shadows
    first = {yes: [judged(assumed) for assumed in every_assumption(lambertian=yes)[:2]] for yes in (True, False)}
    lambert, other = (min(first[yes], key=lambda one: mean_error(one.errors)) for yes in (True, False))
    is_other = clearly_better(lambert.errors, other.errors, times=like_lights)
    tried, every = first[not is_other], every_assumption(lambertian=not is_other)
    tried += map(judged, every[2:])
    glossy, matte = (_best_of([one for one in tried if one.model.assumed.glossy == yes]) for yes in (True, False))
    best = glossy if mean_error(glossy.errors) < mean_error(matte.errors) else matte
    plain = tried[-1]  # without a highlight, outliers and shadows
    if clearly_better(plain.errors, best.errors, times=like_lights):
        return best.model
    return plain.model if best is plain or _alike_within_lights(work, few, best, plain) else best.model


def _alike_within_lights(work: TexelWork, sample: TexelTile, one: Judged, other: Judged) -> bool:
    """Return whether errors that are stated of the lights alone turn two models' normals as far apart as they are.

    The test of Hausman (1978): of two estimates that differ by no more than that, the one with fewer freedoms is meant.
    How far the lights turn them is drawn (Barnard 1963), since a normal may jump from one minimum to another.
    """
    if work.stated is None or not np.any(work.stated.direction):
        return False

    def apart(error: Float[np.ndarray, "views 3"]) -> Float[Array, "3 texels"]:
        def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Array:
            n = lowest_state(turned_by(work.observed(block, model), error), model).n
            return jnp.stack([n.x, n.y, n.z])

        return work.each(sample, program, [one.model]) - work.each(sample, program, [other.model])

    random, root, draws = np.random.default_rng(0), work.stated.direction, round(1.0 / MINOR) - 1
    as_said = apart(np.zeros(root.shape[:2], np.float32))
    drawn = (np.einsum("vij,vj->vi", root, random.standard_normal(root.shape[:2])) for _ in range(draws))
    whole = np.nansum(np.square(as_said))
    return any(np.nansum(np.square(apart(error.astype(np.float32)) - as_said)) > whole for error in drawn)


def from_nothing(work: TexelWork, sample: TexelTile, assumed: Assumptions) -> ObjectModel:
    """Return the model that some texels teach under some assumptions."""
    model, name = first_model(work.loss, assumed), type(lobe_taken(work.setup.lobe)).__name__
    for k in range(FIRST_ROUNDS):
        work.tiles.report_progress(f"learning the highlight, {name}:", (k + 1) / FIRST_ROUNDS)
        model = learned(model, work.sample_at_minimum(sample, model))
    return model


def mean_error(errors: Float[np.ndarray, " views"]) -> float:
    """Return the mean of the errors of the views of which something was left out."""
    known = errors[np.isfinite(errors)]
    return float(known.mean()) if len(known) else np.inf


def _best_of(tried: Sequence[Judged]) -> Judged:
    """Return the first of some models, or the best one where that is clearly better."""
    best = min(tried, key=lambda one: mean_error(one.errors))
    return best if clearly_better(tried[0].errors, best.errors) else tried[0]


def errors_of_shared(work: TexelWork, sample: TexelTile, models: Sequence[ObjectModel]) -> Float[np.ndarray, " views"]:
    """Return the mean logarithm of how far each view is from what the models fitted to others predict."""
    seen = views_seen(sample)

    def program(block: TexelBlock, model: ObjectModel, seen: np.ndarray | None) -> tuple[Array, Array]:
        observed = work.observed(block, model)
        state = lowest_state(seen_in(observed, np.asarray(seen) > 0.0), model)
        return _error_of_shared(observed, model, state), observed.counts

    return _mean_of_views(*work.each(sample, program, models, seen.astype(np.float32)), seen)


def own_exponents_predict_better(
    work: TexelWork,
    models: Sequence[ObjectModel],
    sample: TexelTile,
    lobe: AbstractPowerLobe,
    fit: Callable[[TexelTile], Estimates],
) -> bool:
    """Return whether an n_s of each texel clearly predicts views that were left out better than the shared highlight.

    Args:
        work: The robust fit.
        models: Its models of the object's regions.
        sample: Texels.
        lobe: Lobe of the texels' own highlights.
        fit: Returns the estimates of texels with an n_s each.
    """
    sample = fewer(sample)
    seen = views_seen(sample)
    own = fit(eqx.tree_at(lambda tile: tile.counts, sample, sample.counts & seen)).values
    k_d, k_s = (own[name].mean(0)[None] for name in ("k_d", "k_s"))
    numbers = np.concatenate([own["normal"], k_d, k_s, own["n_s"]]).astype(np.float32)

    def program(block: TexelBlock, model: ObjectModel, own: np.ndarray | None) -> tuple[Array, Array]:
        assert own is not None
        observed = work.observed(block, model)
        return _error_of_own(observed, lobe, own), observed.counts

    by_own = _mean_of_views(*work.each(sample, program, models, numbers), seen)
    return clearly_better(errors_of_shared(work, sample, models), by_own)


def clearly_better(
    errors: Float[np.ndarray, " views"], others: Float[np.ndarray, " views"], *, times: float = 1.0
) -> bool:
    """Return whether the other errors are lower by more than some times chance, and by more than a few percent."""
    gain = (errors - others)[np.isfinite(errors) & np.isfinite(others)]
    if len(gain) < 2:
        return False
    by_chance = np.std(gain) / np.sqrt(len(gain) - 1.0)
    return bool(gain.mean() > max(times * by_chance, MINOR))


def fewer(sample: TexelTile) -> TexelTile:
    """Return at most one block of a sample, spread evenly."""
    return sample.part(np.unique(np.linspace(0, len(sample.pixels) - 1, BLOCK).astype(int)))


def views_seen(sample: TexelTile) -> Bool[np.ndarray, "views texels"]:
    """Return by which views each texel is fitted: one group is left out, another one for the next texel."""
    views, texels = sample.counts.shape
    return np.arange(views)[:, None] % GROUPS != np.arange(texels) % GROUPS


def _mean_of_views(
    error: Float[Array, "views texels"],
    counts: Bool[Array, "views texels"],
    seen: Bool[np.ndarray, "views texels"],
) -> Float[np.ndarray, " views"]:
    """Return the mean error of each view over the observations that were left out, NaN where there is none."""
    out = np.asarray(counts) & ~seen
    with np.errstate(invalid="ignore"):
        return np.where(out, np.asarray(error), 0.0).sum(1) / out.sum(1)


@jax.jit
def _error_of_shared(observed: BlockObservations, model: ObjectModel, state: DescentState) -> Array:
    D, S = observed.lights.shading(model.shape, state.n)
    return _error(state.k_d[None] * D + state.k_s[None] * S - observed.y)


@jax.jit
def _error_of_own(observed: BlockObservations, lobe: AbstractPowerLobe, own: Float[Array, "6 texels"]) -> Array:
    lobe = jax.tree.map(lambda leaf: jnp.asarray(leaf, observed.y.dtype), lobe)
    lights = eqx.tree_at(lambda of: of.lobe, observed.lights, lobe)
    D, S = lights.shading_of_power(own[5], Vec3(*own[:3]))
    return _error((own[3][None] * D + own[4][None] * S) / observed.level[None] - observed.y)


def _error(residual: Float[Array, "views texels"]) -> Float[Array, "views texels"]:
    """Return the logarithm of the size of a residual, by which neither the few large nor the many small ones decide."""
    return jnp.log(jnp.abs(residual) + SLIGHT)
