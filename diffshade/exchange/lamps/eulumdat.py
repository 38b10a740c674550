"""EULUMDAT files, .ldt: the photometry of European lamps (Stockmar 1990; one number per line, in a fixed order)."""

from __future__ import annotations

import numpy as np

from ..parsing import count, number, numbers
from .c_planes import Table, mirrored

SET = 6  # lines per set of lamps, from line 27 on
RATIOS = 10  # direct ratios before the angles


def read_eulumdat(text: str, name: str) -> Table:
    """Return the angles (degrees) and the intensities (candela) of a file, with its symmetric planes added.

    The file holds candela per 1000 lumens. They are multiplied by the flux of its first set of lamps and its conversion
    factor, if these are above 0. Raises ValueError for a malformed file.
    """
    lines = [line.strip().replace(",", ".") for line in text.replace("\x1a", "").splitlines()]

    def line(i: int, what: str) -> str:
        if i >= len(lines):
            raise ValueError(f"{name} ends before line {i + 1}, {what}. Give the whole EULUMDAT file.")
        return lines[i]

    def whole(i: int, what: str, least: int = 1) -> int:
        return count(line(i, what), f"{name}: line {i + 1}, {what},", least=least)

    symmetry, planes, angles = whole(2, "the symmetry", 0), whole(3, "Mc"), whole(5, "Ng")
    after = 26 + SET * whole(25, "the number of lamp sets")
    line(after + RATIOS + planes + angles - 1, "the last angle")
    if symmetry > 4 or (symmetry in (2, 3, 4) and planes % (4 if symmetry > 2 else 2)):
        raise ValueError(
            f"{name}: line 3, the symmetry, must be 0 to 4 and its planes must divide the circle; got {symmetry} with "
            f"{planes} planes. Correct line 3 or 4."
        )
    angle = np.array(numbers(lines[after + RATIOS : after + RATIOS + planes + angles], f"{name}: an angle"))
    C, vertical = angle[:planes], angle[planes:]
    last = {0: planes - 1, 1: 0, 2: planes // 2, 3: planes // 2, 4: planes // 4}[symmetry]
    begin = 3 * planes // 4 if symmetry == 3 else 0  # for symmetry about the plane at 90 degrees: from 270 over 0 to 90
    stored = (begin + np.arange(last + 1)) % planes  # the planes in the file
    first = after + RATIOS + planes + angles
    written = len(stored) * angles
    line(first + written - 1, "the last intensity")
    if any(rest for rest in lines[first + written :]):
        raise ValueError(
            f"{name} goes on after its {written} intensities. Header and data disagree; check lines 3, 4 and 6."
        )
    values = np.array(numbers(lines[first : first + written], f"{name}: an intensity")).reshape(-1, angles)
    flux = number(line(28, "the flux"), f"{name}: line 29, the flux,")
    factor = number(line(23, "the conversion factor"), f"{name}: line 24, the conversion factor,")
    values = values * (flux / 1000.0 if flux > 0 else 1.0) * (factor if factor > 0 else 1.0)
    if symmetry == 1:
        return Table(vertical, np.zeros(1), values)
    about = {0: (), 2: (0.0,), 3: (90.0,), 4: (0.0, 90.0)}[symmetry]
    return Table(vertical, *mirrored(C[stored], values, about, name))
