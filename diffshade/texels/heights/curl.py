"""The curl of the differences: what they add up to around four neighbouring texels, at several resolutions.

Around a closed path the differences of any height field add up to 0. What they do add up to is noise, or tells of a
discontinuity between the texels. A texel of the next coarser level is the mean of 2 x 2 texels, and the differences of
such means are sums of differences, without a further approximation: of a discontinuity that many texels share, coarser
levels show more.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.robust_scale import robust_scale
from ...core.thresholds import SMALL
from .differences import Differences


class PyramidLevel(NamedTuple):
    """Differences across and down at one resolution."""

    inside: Bool[np.ndarray, "h w"]
    values: tuple[Float[np.ndarray, "h v"], Float[np.ndarray, "g w"]]
    """Across and down; 0 where there is none."""
    variances: tuple[Float[np.ndarray, "h v"], Float[np.ndarray, "g w"]]
    """Infinite where there is no difference."""
    depth: int = 0
    """Number of the level; the texels of the next one are twice as large."""
    shared: Float[np.ndarray, "e u"] | float = 0.0
    """Variance of the curl by what all normals have in common."""

    @classmethod
    def of(
        cls, inside: Bool[np.ndarray, "h w"], across: Differences, down: Differences, tail: float = 0.0
    ) -> PyramidLevel:
        """Return the finest level, without differences where the surface is too steep.

        Args:
            inside: Where there are texels.
            across: Differences across.
            down: Differences down.
            tail: Deviations up to which the curl is to be trusted as if its distribution were normal. The square of a
                normal's noise makes steep differences too large by `tail` times the steepness there.
        """
        variances = [
            np.where(
                pair.steepness > SMALL,
                np.inf,
                ((1.0 + tail * np.minimum(pair.steepness, SMALL)) * pair.deviation) ** 2,
            )
            for pair in (across, down)
        ]
        return cls(inside, (across.value, down.value), (variances[0], variances[1]))

    def curl(self) -> Float[np.ndarray, "g v"]:
        """Return the curl around each four texels in its standard deviations; 0 where a difference is missing."""
        v_across, v_down = self.variances
        variance = v_across[:-1] + v_down[:, 1:] + v_across[1:] + v_down[:, :-1] + self.shared
        return np.where(np.isfinite(variance), self.total() / np.sqrt(variance), 0.0)

    def total(self) -> Float[np.ndarray, "e u"]:
        """Return what the differences add up to around each four texels."""
        across, down = self.values
        return across[:-1] + down[:, 1:] - across[1:] - down[:, :-1]

    def coarser(self) -> PyramidLevel:
        """Return the level of texels of twice the size; those that are not wholly inside are left out."""
        h, w = (size // 2 for size in self.inside.shape)
        inside = np.asarray(self.inside[: 2 * h, : 2 * w].reshape(h, 2, w, 2).all((1, 3)))
        growth = _white_noise(self.depth + 1) / _white_noise(self.depth)
        values, variances = [], []
        for axis in (1, 0):
            turn = (lambda image: image) if axis else np.transpose
            value, variance = (turn(of[1 - axis]) for of in (self.values, self.variances))
            rows, pairs = turn(inside).shape[0], turn(inside).shape[1] - 1

            def mean(image: np.ndarray, middle: float, rows: int = rows, pairs: int = pairs) -> np.ndarray:
                """Add three differences in a row, the middle one with this weight; the mean over two rows."""
                first, second, third = (image[: 2 * rows, k : k + 2 * pairs : 2] for k in range(3))
                total = first + middle * second + third
                return 0.5 * (total[::2] + total[1::2])

            pair = turn(inside[:, 1:] & inside[:, :-1] if axis else inside[1:] & inside[:-1])
            spread = np.where(pair, mean(variance, 4.0) / 6.0 * growth, np.inf)
            values.append(turn(np.where(np.isfinite(spread), 0.5 * mean(value, 2.0), 0.0)))
            variances.append(turn(spread))
        return PyramidLevel(inside, (values[0], values[1]), (variances[0], variances[1]), self.depth + 1)


def _white_noise(depth: int) -> float:
    """Return the variance of a level's differences where the slopes of single texels have independent noise of 1."""
    return 2.0 / 3.0 - 4.0**-depth / 6.0


def levels(finest: PyramidLevel, smallest: int = 6) -> list[PyramidLevel]:
    """Return the levels from the finest one, as long as an image is not smaller than `smallest` texels."""
    found = [finest]
    while min(found[-1].inside.shape) >= 2 * smallest:
        found.append(found[-1].coarser())
    return found


def with_shared(
    found: list[PyramidLevel], modes: Iterable[tuple[Float[np.ndarray, "h v"], Float[np.ndarray, "g w"]]]
) -> list[PyramidLevel]:
    """Return levels whose curl may also be that of modes: differences, across and down, of one deviation each."""
    shared: list[Any] = [0.0] * len(found)
    for mode in modes:
        for k, level in enumerate(levels(found[0]._replace(values=mode))):
            shared[k] = shared[k] + level.total() ** 2
    return [level._replace(shared=of) for level, of in zip(found, shared, strict=True)]


def noise_scale(inside: Bool[np.ndarray, "h w"], across: Differences, down: Differences) -> float:
    """Return how much larger the curl is than noise alone makes it: its median size over that of noise; 0 if unknown.

    Creases and jumps, which few texels have, do not count.
    """
    pairs = [pair._replace(deviation=np.sqrt(pair.deviation**2 - pair.crease**2)) for pair in (across, down)]
    curl = PyramidLevel.of(inside, pairs[0], pairs[1]).curl()
    known = curl[curl != 0]
    return robust_scale(known) if known.size else 0.0
