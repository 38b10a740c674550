"""Spots: the spot light nearest to a measured lamp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from ...core.fields import check_kind
from ...core.thresholds import MINOR
from ...model.lights import SpotLight
from ...model.measured_lights import MeasuredLight, Profile

EXPONENT_RANGE = (1e-3, 1e4)


@dataclass(frozen=True)
class SpotFit:
    """The spot light nearest to a lamp, and the remaining difference; `print` it for a sentence."""

    light: SpotLight
    rms: float
    """Root mean square of lamp - spot over the angles of the hemisphere in front of the lamp, and beyond if the lamp
    shines there; 1 is the lamp's peak."""

    @property
    def fits(self) -> bool:
        """Whether the spot fits the lamp: the rms is at most 5 % of the peak."""
        return self.rms <= MINOR

    def __str__(self) -> str:
        a, cutoff = float(self.light.exponent), float(self.light.cutoff)
        what = f"cos^{a:.3g} with a cutoff of {cutoff:.3g} degrees, to {100 * self.rms:.2g} % of the peak (rms)"
        if self.fits:
            return f"the spot light fits the lamp: {what}."
        return f"no spot light fits this lamp; the nearest is {what}. Use the MeasuredLight itself."


def as_spot(lamp: MeasuredLight) -> SpotFit:
    r"""Fit a spot light (E3) to a lamp's profile, by least squares over its angles.

    $$ \min \sum (profile(\gamma, C) - s \cos^a \gamma)^2, \qquad \cos^a \gamma = 0 \text{ beyond the cutoff} $$

    Every degree of gamma from 0 to 90 (or further if the lamp shines there) and every plane of the table have the same
    weight. Fitted are the exponent a, the cutoff (whole degrees; 90 unless another is better) and the peak. Position,
    direction, attenuation and colour are the lamp's.

    Args:
        lamp: The lamp.

    Returns:
        The spot light, and how well it fits.

    Raises:
        TypeError: If `lamp` is not a `MeasuredLight`.
    """
    check_kind("lamp", lamp, MeasuredLight, "read_lamp('lamp.ies')")
    gamma, beam = _beam(lamp.profile)
    cosine = np.cos(np.deg2rad(gamma))
    forward = cosine > 1e-9

    def shape(log_a: float, cutoff: float) -> Float[np.ndarray, " n"]:
        lit = forward & (gamma <= cutoff)
        return np.where(lit, np.where(lit, cosine, 1.0) ** np.exp(log_a), 0.0)

    def scale_and_cost(s: Float[np.ndarray, " n"]) -> tuple[float, float]:
        scale = float((beam @ s).sum() / (len(beam) * (s @ s)))
        return scale, float(np.mean((beam - scale * s) ** 2))

    def best(cutoff: float) -> tuple[float, float, float]:
        found: Any = scipy.optimize.minimize_scalar(
            lambda log_a: scale_and_cost(shape(log_a, cutoff))[1], bounds=np.log(EXPONENT_RANGE), method="bounded"
        )
        return float(found.fun), float(found.x), cutoff

    fits = [best(float(cutoff)) for cutoff in range(90, 0, -1)]
    cost, log_a, cutoff = min(fits, key=lambda one: one[0])
    if fits[0][0] <= 1.02 * cost:  # a cutoff gains nothing
        cost, log_a, cutoff = fits[0]
    scale, _ = scale_and_cost(shape(log_a, cutoff))
    light = SpotLight(
        lamp.position,
        lamp.direction,
        scale * lamp.intensity,
        cutoff,
        float(np.exp(log_a)),
        lamp.attenuation,
        ambient=lamp.ambient,
        specular=None if lamp.specular is None else scale * lamp.specular,
    )
    return SpotFit(light, float(np.sqrt(cost) / beam.max()))


def _beam(profile: Profile) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "h n"]]:
    """Return gamma at every degree, and each plane's profile there."""
    vertical, values = np.asarray(profile.vertical), np.asarray(profile.values)
    planes = values if len(values) == 1 else values[:-1]
    lit = vertical[(planes > 0).any(0)]
    gamma = np.arange(0.0, max(90.0, np.ceil(lit.max(initial=0.0))) + 1.0)
    return gamma, np.stack([np.interp(gamma, vertical, row, left=0.0, right=0.0) for row in planes])
