"""IES LM-63 files: the photometry of North American lamps (ANSI/IES LM-63-2002, -2019)."""

from __future__ import annotations

import numpy as np

from ..parsing import count, number, numbers, short
from .c_planes import Table, whole_circle

HEADER = 13  # numbers in the header, before the angles


def read_ies(text: str, name: str) -> Table:
    """Return the angles (degrees) and the intensities (candela) of a type C file, with its symmetric planes added.

    The candela are multiplied by the file's multiplier, ballast factor and ballast-lamp factor. Factors for a tilted
    lamp (TILT=INCLUDE or a separate file) are ignored: the lamp is as measured. Raises ValueError for a malformed file.
    """
    lines = text.splitlines()
    at = next((i for i, line in enumerate(lines) if line.strip().upper().startswith("TILT=")), None)
    if at is None:
        raise ValueError(f"{name} is not an IES file: it has no line TILT=. Give a file in the format LM-63.")
    words = " ".join(lines[at + 1 :]).replace(",", " ").split()
    if lines[at].strip()[5:].strip().upper() == "INCLUDE":
        pairs = count(_word(words, 1, name), f"{name}: the number of tilt angles")
        words = words[2 + 2 * pairs :]
    _word(words, HEADER - 1, name)
    n_v, n_h = (
        count(words[3], f"{name}: the number of vertical angles"),
        count(words[4], f"{name}: of horizontal angles"),
    )
    kind = count(words[5], f"{name}: the photometric type")
    if kind != 1:
        raise ValueError(
            f"{name} is of photometric type {'?CBA'[kind] if kind < 4 else kind}; only C is read. Convert it."
        )
    expected = HEADER + n_v + n_h + n_v * n_h
    if len(words) != expected:
        raise ValueError(
            f"{name} must have {expected} numbers after TILT, for {n_v} vertical and {n_h} horizontal angles; got "
            f"{len(words)}. Header and data disagree, or the file is cut off; give the whole file."
        )
    scale = number(words[2], f"{name}: the multiplier") * number(words[10], f"{name}: the ballast factor")
    scale *= number(words[11], f"{name}: the ballast-lamp factor")
    values = np.array(numbers(words[HEADER:], f"{name}: an angle or a candela value"))
    vertical, horizontal, candela = np.split(values, [n_v, n_v + n_h])
    return Table(vertical, *whole_circle(horizontal, candela.reshape(n_h, n_v) * scale, name))


def _word(words: list[str], i: int, name: str) -> str:
    if i >= len(words):
        raise ValueError(
            f"{name} ends after TILT at {short(' '.join(words[-3:]))}. It is cut off; give the whole file."
        )
    return words[i]
