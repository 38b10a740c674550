"""The C planes of a lamp's table: symmetric planes are added until they cover the full circle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Angles = Float[np.ndarray, " _"]
Values = Float[np.ndarray, "_ _"]


class Table(NamedTuple):
    """The table of a lamp file: angles in degrees, and candela at each pair of angles."""

    vertical: Angles
    horizontal: Angles
    candela: Values


def whole_circle(horizontal: Angles, values: Values, name: str) -> tuple[Angles, Values]:
    """Add the planes that LM-63 implies by the last angle: 0 rotational symmetry, 90 quarters, 180 halves, 360 none."""
    ends = (horizontal[0], horizontal[-1])
    if len(horizontal) == 1:
        return np.zeros(1), values
    about = {(0.0, 90.0): (0.0, 90.0), (0.0, 180.0): (0.0,), (90.0, 270.0): (90.0,), (0.0, 360.0): ()}.get(ends)
    if about is None:
        raise ValueError(
            f"{name}: the horizontal angles must go from 0 to 0, 90, 180 or 360 degrees, or from 90 to 270; got "
            f"{ends[0]:g} to {ends[1]:g}. Correct the file."
        )
    return mirrored(horizontal, values, about, name)


def mirrored(horizontal: Angles, values: Values, about: Sequence[float], name: str) -> tuple[Angles, Values]:
    """Return the planes from 0 to 360 degrees, given some of them and the mirror planes.

    `about`: the angles of the mirror planes; at the angle a, the plane C is mirrored to 2a - C.
    """
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
