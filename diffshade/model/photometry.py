"""Photometry: the flux, the beam angles and the symmetry of an intensity over angle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Angles = Float[np.ndarray, " _"]
Values = Float[np.ndarray, "h v"]
ALIKE = 1e-3  # of the peak: planes that differ by less are the same


def flux(vertical: Angles, horizontal: Angles, values: Values) -> float:
    r"""Return the flux of a table of intensities, in lumens for candela.

    $$ \int\int I(\gamma, C) \sin\gamma \, d\gamma \, dC $$

    The integral is that of the table, linear between its entries, in closed form.

    Args:
        vertical: Angles gamma, degrees.
        horizontal: Angles C, degrees, from 0 to 360, or one for a lamp that is the same all around.
        values: Intensities, one row per horizontal angle.
    """
    a, b = np.deg2rad(vertical[:-1]), np.deg2rad(vertical[1:])
    slope = np.diff(values, axis=1) / (b - a)
    whole, rising = np.cos(a) - np.cos(b), np.sin(b) - np.sin(a) - (b - a) * np.cos(b)
    each = values[:, :-1] @ whole + slope @ rising
    if len(horizontal) == 1:
        return float(2 * np.pi * each[0])
    return float(np.trapezoid(each, np.deg2rad(horizontal)))


def plane(horizontal: Angles, values: Values, C: float) -> Float[np.ndarray, " v"]:
    """Return the intensities in the half plane C, degrees, linear between those of the table."""
    if len(horizontal) == 1:
        return values[0]
    return np.array([np.interp(C % 360.0, horizontal, column) for column in values.T])


def beam_angle(vertical: Angles, horizontal: Angles, values: Values, C: float, share: float = 0.5) -> float:
    """Return the full angle, degrees, across C and C + 180, out to where a share of the peak is last reached."""
    return sum(_outermost(vertical, plane(horizontal, values, at), share * values.max()) for at in (C, C + 180.0))


def _outermost(vertical: Angles, row: Float[np.ndarray, " v"], level: float) -> float:
    """Return the largest angle at which a row reaches a level; 0 if nowhere."""
    above = np.flatnonzero(row >= level)
    if not len(above):
        return 0.0
    i = above[-1]
    if i + 1 == len(row):
        return float(vertical[i])
    return float(vertical[i] + (vertical[i + 1] - vertical[i]) * (row[i] - level) / (row[i] - row[i + 1]))


def symmetry(horizontal: Angles, values: Values) -> str:
    """Return the symmetry of a table in words."""
    if len(horizontal) == 1:
        return "the same all around"

    def mirrors(axis: float) -> bool:
        other = np.stack([plane(horizontal, values, 2 * axis - C) for C in horizontal])
        return bool(np.abs(other - values).max() <= ALIKE * values.max())

    about = [f"C{axis:g}" for axis in (0.0, 90.0) if mirrors(axis)]
    return f"mirrored about {' and '.join(about)}" if about else "no symmetry"
