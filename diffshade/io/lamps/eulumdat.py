"""EULUMDAT files, .ldt: the photometry of European lamps (Stockmar 1990; one number per line, in a fixed order)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ...model.measured_lights import LampLabel
from ..parsing import NUMBER, above_0, count, number, numbers, short
from .c_planes import CandelaTable, LampData, mirrored

SET = 6  # lines per set of lamps, from line 27 on
RATIOS = 10  # direct ratios before the angles


def read_eulumdat(text: str, name: str, lamp_set: int | Literal["all"] | None) -> LampData:
    """Return what a file holds: angles (degrees) and intensities (candela), with its symmetric planes added.

    The file holds candela per 1000 lumens. They are multiplied by the flux of a set of lamps, or of all, and its
    conversion factor, if these are above 0. Raises ValueError for a malformed file.
    """
    texts = [line.strip() for line in text.replace("\x1a", "").splitlines()]
    lines = [line.replace(",", ".") for line in texts]

    def line(i: int, what: str) -> str:
        if i >= len(lines):
            raise ValueError(f"{name} ends before line {i + 1}, {what}. Give the whole EULUMDAT file.")
        return lines[i]

    def whole(i: int, what: str, least: int = 1) -> int:
        return count(line(i, what), f"{name}: line {i + 1}, {what},", least=least)

    symmetry, planes, angles = whole(2, "the symmetry", 0), whole(3, "Mc"), whole(5, "Ng")
    sets = whole(25, "the number of lamp sets")
    after = 26 + SET * sets
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
    rest = [line for line in lines[first + written :] if line]
    if rest and all(NUMBER.fullmatch(word) for line in rest for word in line.split()):
        raise ValueError(
            f"{name} goes on after its {written} intensities. Header and data disagree; check lines 3, 4 and 6."
        )
    notes = [f"what stands after the data is not read: {short(' '.join(rest)[:200])}."] if rest else []
    values = np.array(numbers(lines[first : first + written], f"{name}: an intensity")).reshape(-1, angles)
    lit = range(sets) if lamp_set == "all" else [_chosen(lamp_set, sets, name)]
    if lamp_set is None and sets > 1:
        kinds = ", ".join(f"{i} {short(texts[27 + SET * i])}" for i in range(min(sets, 8)))
        notes.append(f"it has {sets} sets of lamps, of which the first is lit ({kinds}); choose by lamp_set=.")

    flux = sum(number(lines[28 + SET * of], f"{name}: line {29 + SET * of}, the flux,") for of in lit)
    share = above_0(lines[22])  # the light output ratio, %
    factor = number(line(23, "the conversion factor"), f"{name}: line 24, the conversion factor,")
    values = values * (flux / 1000.0 if flux > 0 else 1.0) * (factor if factor > 0 else 1.0)
    label = LampLabel(
        maker=texts[0],
        name=texts[8],
        source=" + ".join(texts[27 + SET * of] for of in lit),
        watts=sum(above_0(lines[31 + SET * of]) or 0.0 for of in lit) or None,
        lumens=flux * share / 100.0 if flux > 0 and share else None,
        source_lumens=flux if flux > 0 else None,
    )
    if symmetry == 1:
        return LampData(CandelaTable(vertical, np.zeros(1), values), label, tuple(notes))
    about = {0: (), 2: (0.0,), 3: (90.0,), 4: (0.0, 90.0)}[symmetry]
    return LampData(CandelaTable(vertical, *mirrored(C[stored], values, about, name)), label, tuple(notes))


def _chosen(lamp_set: int | Literal["all"] | None, sets: int, name: str) -> int:
    """Return the index of the set of lamps that is lit."""
    chosen = 0 if lamp_set is None else lamp_set
    if not isinstance(chosen, int) or not 0 <= chosen < sets:
        raise ValueError(f"{name} has {sets} sets of lamps; got lamp_set={lamp_set!r}. Give 0 to {sets - 1}, or 'all'.")
    return chosen
