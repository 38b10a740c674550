"""Outliers: pixels far from what the model shows, which least squares follows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...core.masks import Mask
from ...core.robust_scale import OUTLIER, robust_scale
from ...core.thresholds import MOST, SMALL
from ..forward.sums import residuals
from ..laid_out import LaidOut
from ..misfit.noise_tests import BINS, FALSE_ALARM, leftovers, whiteness
from ..pixels.blocks import chunks as in_chunks
from ..problem import PART
from ..result import Fit
from ..statistics.uncertainty import Vector
from ..unknowns.unknown import values_at

ROUNDS = 10  # of leaving out; where a tenth of the pixels is far off, the fourth changes nothing any more


class WithoutOutliers(NamedTuple):
    """A fit repeated without the pixels that are far from what it shows."""

    share: float
    """The share of the pixels that are left out."""
    of_a_view: float
    """The largest share of one view."""
    moves: Vector
    """How far the values are then from those with all pixels."""
    is_noise: bool
    """Whether the residuals of the others are noise."""
    explained: float
    """The share of the residuals' squares that goes with them."""
    together: float
    """The share of them whose neighbours to both sides are left out too."""

    @property
    def is_the_cause(self) -> bool:
        """Whether they are what is wrong, alone or for the most part; pixels that touch are a place, no outliers."""
        return self.is_noise or (self.explained > MOST and self.together < SMALL)

    def sentence(self, fit: Fit) -> str:
        """Say what was left out, which value it moves most, and the remedy."""
        known = np.where(fit.determined, fit.plain_errors, np.inf)
        j = int(np.argmax(np.abs(self.moves) / known))
        rest = ", and the rest is noise" if self.is_noise else ""
        return (
            f"{self.share:.2%} of the pixels are far from what the model shows, as of shadows, dust, text and "
            f"things in front of the object, and least squares follows them: without them {fit.names[j]} is "
            f"{fit.values[j] + self.moves[j]:.3g}{rest}. Mask them out with View.mask, or fit with loss='cauchy'."
        )


def without_outliers(fit: Fit) -> WithoutOutliers:
    """Fit again without the pixels that lie `OUTLIER` robust deviations from the fit, until these stay the same.

    Of more than `PART` pixels, so many are looked at.
    """
    all_pixels = fit.solved.problem.data.part(PART)
    whole = fit.solved.changed(data=all_pixels).laid_out()
    with_all = without = whole.minimise()
    rest, far = whole, [np.zeros(view.camera.shape, bool) for view in fit.views]
    for _ in range(ROUNDS):
        before, far = far, _far(whole, without.theta)
        if all(map(np.array_equal, before, far)):
            break
        rest = fit.solved.changed(theta=without.theta, data=all_pixels.keeping([~of for of in far])).laid_out()
        without = rest.minimise()
    moves = values_at(without.theta, fit.unknowns) - values_at(with_all.theta, fit.unknowns)
    is_noise = whiteness(leftovers(rest, without.theta)).p_value > FALSE_ALARM
    left, all_squares = (float(np.sum(end.point.views.cost)) for end in (without, with_all))
    out, pixels = np.array([of.sum() for of in far]), np.maximum(all_pixels.pixels, 1)
    rows = [of.reshape(-1)[samples.pixels] for of, samples in zip(far, all_pixels.samples, strict=True)]
    inner = sum(int(np.sum(row[:-2] & row[1:-1] & row[2:])) for row in rows)
    explained, together = 1.0 - left / all_squares, inner / max(out.sum(), 1)
    return WithoutOutliers(out.sum() / pixels.sum(), np.max(out / pixels), moves, is_noise, explained, together)


def _far(laid: LaidOut, theta: Float[np.ndarray, " p"]) -> Sequence[Mask]:
    """Return the pixels of each view that are far from what the model shows at theta.

    They are far by the scale of all residuals, and by that of those where as much light is: most noise grows with it.
    """
    found = [tuple(map(np.asarray, of)) for of in laid.task.on_all_cores(residuals, theta, laid.chunks)]
    off, light = (np.concatenate([of[i][of[1]] for of in found]) for i in (0, 2))
    alike = np.array_split(np.argsort(light), min(BINS, len(light)))
    scale = np.maximum(robust_scale(off), [robust_scale(off[of]) for of in alike])
    edges = light[[of[0] for of in alike[1:]]]
    masks = [np.zeros(view.camera.shape, bool) for view in laid.problem.data.views]
    for (r, counts, m), pieces in zip(found, in_chunks(laid.parts), strict=True):
        far = np.any((np.abs(r) > OUTLIER * scale[np.searchsorted(edges, m)]) & counts, 1)
        for of_piece, piece in zip(far, pieces, strict=True):
            masks[piece.view].reshape(-1)[piece.pixels] |= of_piece[: len(piece.pixels)]
    return masks
