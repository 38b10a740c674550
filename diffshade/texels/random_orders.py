"""Random orders: whether lights that are listed in a random order explain the photographs as well as the list does.

What a model leaves out, as of metal, is left out in any order: no misfit by itself tells that an order is wrong. But
photographs under lights that are near each other are alike, of any material and exposure. The right list therefore
agrees with them better than others do, and a wrong one is one of the others: the best of a hundred by chance, once in a
hundred times (a permutation test of two matrices; Mantel 1967). Photographs of a matte plane are all alike, but for
their brightness: there only the right list explains them as matte.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.thresholds import DEGREE, FEW, TINY
from .lights.matte import pseudo_normals

Samples = Float[np.ndarray, "views texels"]
Counted = Bool[np.ndarray, "views texels"]
Directions = Float[np.ndarray, "views 3"]


def random_order_is_as_good(
    seen: Samples, counts: Counted, towards: Directions, power: Float[np.ndarray, " views"]
) -> bool:
    """Whether some list of the lights in random order agrees with photographs as well as the list that is given.

    Args:
        seen: What the photographs show, of exposure 1.
        counts: What of it counts.
        towards: Unit vectors to the lights.
        power: The power of each.
    """
    lit = power > 0.0
    seen, counts, towards, power = seen[lit], counts[lit], towards[lit], power[lit]
    if counts.sum(0).max(initial=0) < 2 or _lights_apart(towards) < FEW:
        return False
    random, alike, given = np.random.default_rng(0), _alike(seen, counts), np.arange(len(power))
    lists = 99  # a wrong one passes as the best of a hundred, by either of two measures, once in fifty times
    others = [random.permutation(given) for _ in range(lists)]
    # over all lists the cosines between lights have one mean and one variance: the sum tells the correlation
    agreement = [np.sum(alike * (towards[order] @ towards[order].T)) for order in (given, *others)]
    if max(agreement[1:]) < agreement[0]:
        return False
    few = 100  # texels tell orders apart: each has as many numbers as there are views
    some = np.linspace(0, seen.shape[1] - 1, min(seen.shape[1], few)).astype(int)

    def misfit(order: Int[np.ndarray, " views"]) -> float:
        return pseudo_normals(seen[:, some] / power[order, None], counts[:, some], towards[order])[1]

    least = misfit(given)
    return any(misfit(order) <= least for order in others)


def _lights_apart(towards: Directions) -> int:
    """Return how many lights are a degree from each other at least: of fewer, lists in random order are the same."""
    apart: list[np.ndarray] = []
    for l in towards:
        apart += [l] if all(np.linalg.norm(l - other) > DEGREE for other in apart) else []
    return len(apart)


def _alike(seen: Samples, counts: Counted) -> Float[np.ndarray, "views views"]:
    """Return the cosine between each two photographs, over the texels that count in both."""
    seen, counted = np.where(counts, seen, 0.0), counts.astype(float)
    square = seen**2 @ counted.T
    return (seen @ seen.T) / np.maximum(np.sqrt(square * square.T), TINY)
