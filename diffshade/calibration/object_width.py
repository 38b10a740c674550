r"""Object width: how wide an object is beside the distances of its lamps, from photographs of it.

Under near lamps light comes from elsewhere, and is weaker or stronger, at one end of an object than at the other:

$$ l \propto m - w s u, \quad I \propto 1 / |m - w s u|^2 $$

at the point u of the picture, if it is s wide. With the wrong s, three numbers a texel (k_d n) explain its photographs
less well. The typical residual is a median over the photographs, which cast shadows and highlights do not move.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize_scalar

from ..core.robust_scale import GAUSS_95, MAD, jackknife_error
from ..core.thresholds import FEW, SLIGHT, SMALL
from ..texels.lights.response import GROUPS
from ..texels.tiles import LEARNING_SAMPLE
from .laws import SETTLED
from .two_balls import LampPlaces

WHITE = 1.0 - SLIGHT  # of a file's range, or of the brightest sample beyond it, above which a sample may be clipped

Samples = Float[np.ndarray, "texels photographs"]

TRIED = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)  # widths, over the distance between the balls
STEPS = 12  # of reweighting


class Width(NamedTuple):
    """How wide an object is, over the distance between two balls."""

    width: float
    error: float
    """From groups of photographs left out."""
    misfit: float
    """Typical residual over a texel's brightness."""
    misfit_far: float
    """The same with all lamps far away."""

    @property
    def determined(self) -> bool:
        """Whether the photographs show the width."""
        return bool(0.0 < self.width < TRIED[-1] and self.width > GAUSS_95 * self.error)


def picture_points(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w 3"]:
    """Return the points of a picture, x right and y up from its centre, in widths of the object in it."""
    columns = np.flatnonzero(mask.any(0))
    rows, across = np.indices(mask.shape) + 0.5
    flat = np.stack([across - mask.shape[1] / 2, mask.shape[0] / 2 - rows, np.zeros(mask.shape)], -1)
    return flat / (columns[-1] - columns[0] + 1)


def sample_of(mask: Bool[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of some pixels of a mask."""
    rows, columns = np.nonzero(mask)
    some = np.linspace(0, len(rows) - 1, min(LEARNING_SAMPLE, len(rows))).astype(int)
    return rows[some], columns[some]


def find_width(
    shown: Samples,
    points: Float[np.ndarray, "texels 3"],
    lamps: LampPlaces,
    intensities: Float[np.ndarray, " photographs"],
) -> Width | None:
    """Return the width of the object, or None where there are too few photographs.

    Args:
        shown: The mean of the channels of some texels, from 0 to 1.
        points: Where they are, in widths of the object from the place that the lamps are seen from.
        lamps: Around that place, with lengths in distances between the balls.
        intensities: Of the lamps.
    """
    seen = (shown < WHITE * max(1.0, float(shown.max(initial=0.0)))).sum(1) > 3  # photographs of each, for 3 numbers
    shown, points = shown[seen], points[seen]
    if shown.shape[1] < FEW or not len(shown):
        return None

    def misfit(width: float, used: Bool[np.ndarray, " photographs"]) -> float:
        towards = lamps.directions - width * lamps.nearness[:, None] * points[:, None]
        distance = np.linalg.norm(towards, axis=-1, keepdims=True)
        light = towards / distance**3 * intensities[:, None]
        return _misfit(shown[:, used], light[:, used])

    used = np.ones(shown.shape[1], bool)
    tried = [misfit(width, used) for width in TRIED]
    found = _lowest(lambda width: misfit(width, used), TRIED[int(np.argmin(tried))])
    without = []
    for group in range(GROUPS):
        others = np.arange(shown.shape[1]) % GROUPS != group
        without.append(_lowest(lambda width, others=others: misfit(width, others), found))
    return Width(found, float(jackknife_error(np.array(without))), misfit(found, used), tried[0])


def _misfit(shown: Samples, light: Float[np.ndarray, "texels photographs 3"]) -> float:
    """Return the geometric mean of typical residuals over brightness, with the gain of each light free."""
    level = np.median(shown, 1, keepdims=True)
    level = np.maximum(level, SMALL * np.median(level)) + 1e-12
    y, gain = shown / level, np.ones(shown.shape[1])
    counts = shown < WHITE * max(1.0, float(shown.max()))
    weight, typical = counts.astype(float), np.ones_like(level)
    off = y
    for step in range(STEPS):
        a = light * gain[:, None]
        normal = a.swapaxes(1, 2) @ (a * weight[..., None])
        ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        b = np.linalg.solve(normal + ridge, a.swapaxes(1, 2) @ (weight * y)[..., None])
        model = np.maximum((a @ b)[..., 0], 0.0)
        off = y - model
        if step < SETTLED:
            typical = MAD * np.median(np.abs(off), 1, keepdims=True) + SLIGHT
        weight = counts / (1.0 + (off / (2.0 * typical)) ** 2)
        trust = weight / typical**2
        gain = gain * (trust * y * model).sum(0) / np.maximum((trust * model**2).sum(0), 1e-12)
        gain = gain / np.exp(np.log(np.maximum(gain, 1e-6)).mean())
    return float(np.exp(np.log(MAD * np.median(np.abs(off), 1) + SLIGHT / 10.0).mean()))


def _lowest(misfit: Callable[[float], float], near: float) -> float:
    """Return where a misfit is least near the best width of those tried."""
    reach = max(near, TRIED[1])
    return minimize_scalar(misfit, bounds=(near - reach, near + reach), options={"xatol": SLIGHT * reach}).x
