"""The C planes of a lamp's table: symmetric planes are added until they cover the full circle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ...model.measured_lights import LampLabel

Angles = Float[np.ndarray, " _"]
Values = Float[np.ndarray, "_ _"]
STEPS = (0.25, 1.0)  # degrees of gamma, of tables that are resampled


class LampData(NamedTuple):
    """What a lamp file holds."""

    table: CandelaTable
    label: LampLabel
    notes: tuple[str, ...] = ()
    """What of the file is not in the table, in one line each."""
    tilt: tuple[Angles, Angles] | None = None
    """Angles of tilt and the factors there."""


class CandelaTable(NamedTuple):
    """The table of a lamp file: angles in degrees, and candela at each pair of angles."""

    vertical: Angles
    horizontal: Angles
    candela: Values


def whole_circle(horizontal: Angles, values: Values, name: str) -> tuple[Angles, Values]:
    """Add the planes that LM-63 implies by the last angle: 0 rotational symmetry, 90 quarters, 180 halves, 360 none.

    Planes that go round but for the last, such as 0 to 345, are closed; so are planes from -90 or -180.
    """
    if len(horizontal) == 1:
        return np.zeros(1), values
    first, last = float(horizontal[0]), float(horizontal[-1])
    gap = 360.0 - (last - first)
    if (gap == 180.0 and first % 90.0 == 0.0) or (gap == 270.0 and first == 0.0):  # between two mirror planes
        about = (first, last)
    elif gap == 0.0 or (first == 0.0 and 0.0 < gap <= 1.5 * float(np.diff(horizontal).max())):
        about = ()
    else:
        raise ValueError(
            f"{name}: the horizontal angles must go from 0 to 0, 90, 180 or 360 degrees, or from 90 to 270; got "
            f"{first:g} to {last:g}. Correct the file."
        )
    return mirrored(horizontal, values, about, name)


def turned(vertical: Angles, horizontal: Angles, values: Values, kind: str, name: str) -> CandelaTable:
    """Return the C planes of a type A or B table about its axis V = H = 0 (LM-75).

    Directions to the right, up and forward, as seen from behind the lamp, are (sin H, cos H sin V, cos H cos V) for
    type B, whose planes contain the horizontal axis, and (cos V sin H, sin V, cos V cos H) for type A. Angles from 0 on
    are mirrored to negative ones. Beyond the angles of the table it is dark. C = 0 is to the right and C = 90 up.

    Args:
        vertical: Angles V, degrees.
        horizontal: Angles H, degrees.
        values: One row per horizontal angle.
        kind: "A" or "B".
        name: The file, for messages.
    """
    for axis, angles in ((1, vertical), (0, horizontal)):
        if (np.diff(angles) <= 0).any() or np.abs(angles).max() > 180 or angles[0] > 0:
            raise ValueError(f"{name}: angles of type {kind} must rise from 0 or less to at most 180. Correct them.")
        if angles[0] == 0 and len(angles) > 1:
            values = np.concatenate([np.flip(values, axis).take(range(len(angles) - 1), axis), values], axis)
    vertical, horizontal = (np.concatenate([-a[:0:-1], a]) if a[0] == 0 else a for a in (vertical, horizontal))
    if min(len(vertical), len(horizontal)) < 2:
        raise ValueError(f"{name}: type {kind} must have two vertical and two horizontal angles or more. Correct them.")
    wide = max(np.abs(vertical).max(), np.abs(horizontal).max()) > 90
    step = float(np.clip(min(np.diff(vertical).min(), np.diff(horizontal).min()), *STEPS))
    gamma = np.linspace(0.0, 180.0 if wide else 90.0, round((180.0 if wide else 90.0) / step) + 1)
    C = np.linspace(0.0, 360.0, 181)
    sine, cosine = np.sin(np.deg2rad(gamma)), np.cos(np.deg2rad(gamma))
    right, up = np.cos(np.deg2rad(C))[:, None] * sine, np.sin(np.deg2rad(C))[:, None] * sine
    along, across = (right, up) if kind == "B" else (up, right)
    within = np.rad2deg(np.arcsin(np.clip(along, -1.0, 1.0)))
    around = np.rad2deg(np.arctan2(np.where(np.abs(across) < 1e-12, 0.0, across), cosine))
    H, V = (within, around) if kind == "B" else (around, within)
    look_up = scipy.interpolate.RegularGridInterpolator(
        (horizontal, vertical), values, bounds_error=False, fill_value=0.0
    )
    inside = np.stack([_nearly(H, horizontal), _nearly(V, vertical)], -1)
    return CandelaTable(gamma, C, look_up(inside))


def _nearly(angle: Values, angles: Angles) -> Values:
    """Return angles with those at an end of the table, but for rounding, on it."""
    ends = np.clip(angle, angles[0], angles[-1])
    return np.where(np.abs(ends - angle) < 1e-6, ends, angle)


def mirrored(horizontal: Angles, values: Values, about: Sequence[float], name: str) -> tuple[Angles, Values]:
    """Return the planes from 0 to 360 degrees, given some of them and the mirror planes.

    `about`: the angles of the mirror planes; at the angle a, the plane C is mirrored to 2a - C.
    """
    if horizontal[-1] - horizontal[0] == 360 and len(horizontal) > 2:  # the last plane is the first
        horizontal, values = horizontal[:-1], values[:-1]
    if (np.diff(horizontal % 360.0) == 0).any() or (np.abs(horizontal) > 360).any():
        raise ValueError(f"{name}: the horizontal angles must differ and be at most 360 degrees. Correct the file.")
    planes = {float(C): row for C, row in zip(np.round(horizontal % 360.0, 6), values, strict=True)}
    for axis in about:
        planes |= {round((2 * axis - C) % 360.0, 6) % 360.0: row for C, row in planes.items()}
    angles = sorted(planes)
    rows = [planes[C] for C in angles]
    if angles[0] > 0:  # the circle begins between two planes
        after, before = angles[0], 360.0 - angles[-1]
        angles.insert(0, 0.0)
        rows.insert(0, (before * rows[0] + after * rows[-1]) / (before + after))
    return np.array([*angles, 360.0]), np.array([*rows, rows[0]])
