"""Hidden highlights: how large k_s may be where no view says how wide its highlight is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from scipy import special

from ..core.thresholds import SLIGHT
from ..core.words import Note, listing
from .laid_out import LaidOut
from .solve.solvers import Minimum
from .solve.start_search import at_best_linear
from .statistics.identifiability import null_directions, some_channels
from .statistics.uncertainty import Vector, inverse
from .unknowns.unknown import Unknown


class Hidden(NamedTuple):
    """What hidden highlights say of k_s."""

    errors: Vector
    """The least that the error of each unknown is; 0 of all but k_s."""
    n_s: Vector
    """That of the highlight by which it is so large."""


def hidden_highlights(laid: LaidOut, end: Minimum, lost: Bool[np.ndarray, " p"], sigma2: float) -> Hidden:
    """Return the least that errors of k_s are, where the n_s of its highlight is lost.

    A k_s that is 0 within the noise is so at the n_s that was found. A narrower highlight may lie where no pixel shows
    it: outside of the masks, or between pixels. So k_s is found again at every n_s of the search that fits as well, and
    two errors reach from its value to the highest of its limits, each its value there plus two errors.

    Args:
        laid: The problem that was minimised.
        end: Its minimum.
        lost: Which unknowns the views do not determine.
        sigma2: Variance of a sample of weight 1.
    """
    unknowns, box, theta = laid.problem.unknowns, laid.problem.box, end.theta
    least, widest = np.zeros(len(unknowns)), np.zeros(len(unknowns))
    for j in [j for j, unknown in enumerate(unknowns) if lost[j] and unknown.kind == "n_s"]:
        holders = {place.holder for place in unknowns[j].places}
        beside = np.array([u.kind == "k_s" and any(place.holder in holders for place in u.places) for u in unknowns])
        if not beside.any():
            continue
        others = np.arange(len(unknowns)) != j
        # noise alone lets a highlight that is not there lower the cost, by all of its numbers
        by_chance = 0.5 * sigma2 * special.chdtri(beside.sum() + 1.0, SLIGHT)
        for x in np.unique(np.clip(np.log(unknowns[j].parameter.search), box.lower[j], box.upper[j])):
            point, cost, found = at_best_linear(np.where(others, theta, x), laid.task, laid.chunks)
            if cost > end.point.total.cost + by_chance:
                continue
            H = np.asarray(point.total.hessian.as_matrix())[np.ix_(others, others)]
            zero, directions = null_directions(H)
            error = np.where(zero | directions.any(0), np.inf, np.sqrt(sigma2 * np.diag(inverse(H))))
            limit = np.minimum(found, box.upper)
            limit[others] = np.minimum(found[others] + 2.0 * error, box.upper[others])
            larger = beside & ((limit - theta) / 2.0 > least)
            least, widest = np.where(larger, (limit - theta) / 2.0, least), np.where(larger, np.exp(x), widest)
    return Hidden(least, widest)


def hidden_notes(hidden: Hidden, lost: Bool[np.ndarray, " p"], unknowns: Sequence[Unknown]) -> Iterator[Note]:
    """Say which k_s are lost since a highlight may be hidden, and of which n_s."""
    here = lost & (hidden.errors > 0.0)
    for n_s in dict.fromkeys(hidden.n_s[here].tolist()):
        names = some_channels(here & (hidden.n_s == n_s), unknowns)
        text = (
            f"{listing(names)} may be of a highlight that no pixel shows: one with an n_s of {n_s:.0f} would fit as "
            "well, outside of the masks or between pixels. Bound n_s to what the material can have, such as "
            "bounds={'n_s': (1, 500)}, or add a photograph with the whole highlight on the object."
        )
        yield Note(text, "hidden highlight", tuple(names))
