"""Choice: whether photographs obey a model with an n_s of its own at each texel, or one highlight for the whole object.

Both are fitted to two thirds of the views of some texels and predict the rest. Each texel's own n_s is right for
renders and clean materials; on real objects it turns shadows and bounced light into highlights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...model.lobes import AbstractPowerLobe
from ...model.vectors import Vec3
from ..blocks import TexelBlock
from ..estimates import Estimates
from ..tiles import TexelTile
from .block_fits import lowest_state, seen_in
from .learning import ObjectModel
from .observations import BlockObservations, Lights, observe
from .robust_descent import DescentState
from .run import RobustRun

SAMPLE = 384  # texels
EVERY = 3  # one view of so many is predicted


def own_exponents_predict_better(
    run: RobustRun,
    models: Sequence[ObjectModel],
    sample: TexelTile,
    lobe: AbstractPowerLobe,
    fit: Callable[[TexelTile], Estimates],
) -> bool:
    """Return whether an n_s of each texel predicts views that were left out better than the shared highlight.

    Args:
        run: The robust run.
        models: Its models.
        sample: Texels.
        lobe: Lobe of the texels' own highlights.
        fit: Returns the estimates of texels with an n_s each.
    """
    if len(sample.counts) < 2 * EVERY:
        return True
    sample = sample.part(np.unique(np.linspace(0, len(sample.pixels) - 1, SAMPLE).astype(int)))
    seen = np.arange(len(sample.counts)) % EVERY != EVERY - 1
    own = fit(eqx.tree_at(lambda tile: tile.counts, sample, sample.counts & seen[:, None])).values
    k_d, k_s = (own[name].mean(0)[None] for name in ("k_d", "k_s"))
    numbers = np.concatenate([own["normal"], k_d, k_s, own["n_s"]]).astype(np.float32)

    def program(block: TexelBlock, model: ObjectModel, own: np.ndarray | None) -> tuple[Array, Array, Array]:
        observed = observe(run.setup, run.known, block)
        state = lowest_state(seen_in(observed, seen), model)
        lights = eqx.tree_at(lambda of: of.lobe, observed.lights, lobe)
        return _prediction_errors(observed, model, state, lights, own, seen)

    by_shared, by_own, left_out = run.each(sample, program, models, numbers)
    return bool(np.median(by_own[left_out]) < np.median(by_shared[left_out]))


@jax.jit
def _prediction_errors(
    observed: BlockObservations,
    model: ObjectModel,
    state: DescentState,
    lights: Lights,
    own: Float[Array, "6 texels"],
    seen: Bool[Array, " views"],
) -> tuple[Array, Array, Array]:
    """Return how far both predictions are from each observation, and which observations were left out of the fits."""
    D, S = observed.lights.shading(model.shape, state.n)
    by_shared = state.k_d[None] * D + state.k_s[None] * S
    D, S = lights.shading_of_power(own[5], Vec3(*own[:3]))
    by_own = (own[3][None] * D + own[4][None] * S) / observed.level[None]
    return jnp.abs(by_shared - observed.y), jnp.abs(by_own - observed.y), observed.counts & ~seen[:, None]
