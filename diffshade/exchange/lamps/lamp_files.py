"""Lamps: measured photometry as lights, and the spot light nearest to a lamp."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from ...core.fields import Numbers, check_kind
from ...model.attenuation import RadialAttenuation
from ...model.lights import SpotLight
from ...model.measured_lights import MeasuredLight, Profile
from ..parsing import read_text
from .eulumdat import read_eulumdat
from .ies import read_ies

READERS = {".ies": read_ies, ".ldt": read_eulumdat}
POOR = 0.05  # rms over peak: above it cos^a does not fit the lamp
EXPONENT_RANGE = (1e-3, 1e4)


def read_lamp(
    path: str | Path,
    *,
    position: Numbers = (0.0, 0.0, 0.0),
    direction: Numbers = (0.0, -1.0, 0.0),
    side: Numbers = (1.0, 0.0, 0.0),
) -> MeasuredLight:
    """Read a lamp from an IES (LM-63, type C) or EULUMDAT file.

    The profile is relative to the peak, the intensity is the peak in candela, and the attenuation is 1/d^2. With
    lengths in metres, the light arriving at a surface is in lux. Use `dataclasses.replace(lamp, intensity=1)` for the
    units of other lights. Reading needs at most 64 times the file's size of memory.

    Args:
        path: The file, .ies or .ldt.
        position: The lamp's position, scene units.
        direction: The direction of the lamp's axis; by default downwards.
        side: The direction of the plane C = 0, across the axis; by default +x.

    Returns:
        The lamp as a light.

    Raises:
        ValueError: If the suffix is unknown, or the file is malformed.
        FileNotFoundError: If the file does not exist.
    """
    path = Path(path)
    if path.suffix.lower() not in READERS:
        raise ValueError(f"a lamp file must end in .ies or .ldt; got '{path.suffix}'. Rename or convert {path}.")
    table = READERS[path.suffix.lower()](read_text(path, "lamp file"), f"{path}")
    peak = float(table.candela.max())
    if not (np.isfinite(table.candela).all() and table.candela.min() >= 0 and peak > 0):
        raise ValueError(f"{path}: the intensities must be finite, at least 0 and not all 0. Correct the file.")
    try:
        profile = Profile(table.vertical, table.horizontal, table.candela / peak)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return MeasuredLight(position, direction, profile, peak, RadialAttenuation(0, 0, 1), side)


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
        return self.rms <= POOR

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
        found = minimize_scalar(
            lambda log_a: scale_and_cost(shape(log_a, cutoff))[1], bounds=np.log(EXPONENT_RANGE), method="bounded"
        )
        return float(found.fun), float(found.x), cutoff

    fits = [best(float(cutoff)) for cutoff in range(90, 0, -1)]
    cost, log_a, cutoff = min(fits, key=lambda one: one[0])
    if fits[0][0] <= 1.02 * cost:  # a cutoff gains nothing
        cost, log_a, cutoff = fits[0]
    scale, _ = scale_and_cost(shape(log_a, cutoff))
    light = SpotLight(
        lamp.position, lamp.direction, scale * lamp.intensity, cutoff, float(np.exp(log_a)), lamp.attenuation
    )
    return SpotFit(light, float(np.sqrt(cost) / beam.max()))


def _beam(profile: Profile) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "h n"]]:
    """Return gamma at every degree, and each plane's profile there."""
    vertical, values = np.asarray(profile.vertical), np.asarray(profile.values)
    planes = values if len(values) == 1 else values[:-1]
    lit = vertical[(planes > 0).any(0)]
    gamma = np.arange(0.0, max(90.0, np.ceil(lit.max(initial=0.0))) + 1.0)
    return gamma, np.stack([np.interp(gamma, vertical, row, left=0.0, right=0.0) for row in planes])
