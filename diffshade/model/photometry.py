"""Photometry: the flux, the beam angles and the symmetry of an intensity over angle."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..core.thresholds import NEGLIGIBLE

Angles = Float[np.ndarray, " _"]
Values = Float[np.ndarray, "h v"]


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


def beam_angles(vertical: Angles, horizontal: Angles, values: Values, C: float) -> Float[np.ndarray, " lobes"]:
    """Return the beam angle of each lobe in the plane through the axis and C, degrees: none that reaches half, no lobe.

    It is the angle between the two directions, on either side of a lobe's peak, in which the intensity falls below half
    of the lamp's peak (ANSI/IES LS-1, "beam angle"; CIE S 017, "half-peak divergence"), wherever in the plane they are.
    Beyond the angles of the table it is dark. A lamp that is dark everywhere has no lobe.
    """
    if not values.any():
        return np.zeros(0)
    ahead, behind = (plane(horizontal, values, at) for at in (C, C + 180.0))
    dark = np.zeros(1)
    angle = np.concatenate([vertical[:1], vertical, vertical[-1:]])
    row, other = (
        np.concatenate([dark if vertical[0] > 0 else of[:1], of, dark if vertical[-1] < 180 else of[-1:]])
        for of in (ahead, behind)
    )
    angle, around = np.concatenate([angle, 360.0 - angle[::-1]]), np.concatenate([row, other[::-1]])
    above = around >= 0.5 * values.max()
    if above.all():
        return np.array([360.0])
    first = int(np.argmin(above))  # from a direction that is not in a lobe, once around
    turns = np.concatenate([angle[first:], angle[:first] + 360.0, angle[first : first + 1] + 360.0])
    above, around = (np.concatenate([of[first:], of[:first], of[first : first + 1]]) for of in (above, around))
    i = np.flatnonzero(above[:-1] != above[1:])
    share = (0.5 * values.max() - around[i]) / (around[i + 1] - around[i])
    edges = turns[i] + share * (turns[i + 1] - turns[i])
    return edges[1::2] - edges[::2]


def symmetry(horizontal: Angles, values: Values) -> str:
    """Return the symmetry of a table in words."""
    if len(horizontal) == 1:
        return "the same all around"

    def mirrors(axis: float) -> bool:
        other = np.stack([plane(horizontal, values, 2 * axis - C) for C in horizontal])
        return bool(np.abs(other - values).max() <= NEGLIGIBLE * values.max())

    about = [f"C{axis:g}" for axis in (0.0, 90.0) if mirrors(axis)]
    return f"mirrored about {' and '.join(about)}" if about else "no symmetry"
