"""IES LM-63 files: the photometry of North American lamps (ANSI/IES LM-63-2002, -2019)."""

from __future__ import annotations

import re

import numpy as np
from jaxtyping import Float

from ...model.measured_lights import LampLabel
from ..parsing import NUMBER, above_0, count, number, numbers, short
from .c_planes import CandelaTable, LampData, turned, whole_circle

HEADER = 13  # numbers in the header, before the angles
KINDS = {1: "C", 2: "B", 3: "A"}
_KEYWORD = re.compile(r"\s{0,99}\[([^\]]{1,40})\][ \t]{0,99}([^\r\n]{0,400})")

Tilt = tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]


def read_ies(text: str, name: str) -> LampData:
    """Return what a file holds: angles (degrees) and intensities (candela), with its symmetric planes added.

    The candela are multiplied by the file's multiplier, ballast factor and ballast-lamp factor. Types A and B are
    resampled as type C. Raises ValueError for a malformed file.
    """
    lines = text.splitlines()
    at = next((i for i, line in enumerate(lines) if line.strip().upper().startswith("TILT=")), None)
    if at is None:
        raise ValueError(f"{name} is not an IES file: it has no line TILT=. Give a file in the format LM-63.")
    words, notes, tilt = " ".join(lines[at + 1 :]).replace(",", " ").split(), [], None
    named = lines[at].strip()[5:].strip()
    if named.upper() == "INCLUDE":
        pairs = 2 * count(_word(words, 1, name), f"{name}: the number of tilt angles")
        tilt, words = _tilt(words[1 : 2 + pairs], name), words[2 + pairs :]
    elif named.upper() not in ("NONE", ""):
        notes.append(f"TILT names the file {short(named)}, which is not opened; give tilt= if the lamp is tilted.")
    _word(words, HEADER - 1, name)
    n_v = count(words[3], f"{name}: the number of vertical angles")
    n_h = count(words[4], f"{name}: of horizontal angles")
    kind = KINDS.get(count(words[5], f"{name}: the photometric type"), "")
    if not kind:
        raise ValueError(f"{name} must be of photometric type 1 (C), 2 (B) or 3 (A); got {words[5]}. Correct the file.")
    expected = HEADER + n_v + n_h + n_v * n_h
    after = words[expected:]
    if len(words) < expected or (after and all(map(NUMBER.fullmatch, after))):
        raise ValueError(
            f"{name} must have {expected} numbers after TILT, for {n_v} vertical and {n_h} horizontal angles; got "
            f"{len(words)}. Header and data disagree, or the file is cut off; give the whole file."
        )
    if after:
        notes.append(f"what stands after the data is not read: {short(' '.join(after[:20]))}.")
    scale = number(words[2], f"{name}: the multiplier") * number(words[10], f"{name}: the ballast factor")
    scale *= number(words[11], f"{name}: the ballast-lamp factor")
    values = np.array(numbers(words[HEADER:expected], f"{name}: an angle or a candela value"))
    vertical, horizontal, candela = np.split(values, [n_v, n_v + n_h])
    candela = candela.reshape(n_h, n_v) * scale
    label = _label(lines[:at], words)
    if kind == "C":
        return LampData(CandelaTable(vertical, *whole_circle(horizontal, candela, name)), label, tuple(notes), tilt)
    return LampData(turned(vertical, horizontal, candela, kind, name), label, tuple(notes), tilt)


def read_tilt(text: str, name: str) -> Tilt:
    """Return the angles and factors of a tilt file, whose first number is the lamp's position in the luminaire."""
    return _tilt(text.replace(",", " ").split()[1:], name)


def _tilt(words: list[str], name: str) -> Tilt:
    pairs = count(_word(words, 0, name), f"{name}: the number of tilt angles")
    found = np.array(numbers(words[1 : 1 + 2 * pairs], f"{name}: a tilt angle or factor"))
    if len(found) != 2 * pairs or (np.diff(found[:pairs]) <= 0).any() or (found[pairs:] < 0).any():
        raise ValueError(f"{name}: {pairs} tilt angles must increase, with a factor of at least 0 each. Correct them.")
    return found[:pairs], found[pairs:]


def _label(lines: list[str], words: list[str]) -> LampLabel:
    """Return who made the lamp, what it is, and what the file states of its flux."""
    found: dict[str, str] = {}
    for line in lines:
        if keyword := _KEYWORD.match(line):
            found.setdefault(keyword.group(1).upper(), keyword.group(2).strip())
    lamps, lumens = above_0(words[0]), above_0(words[1])  # lumens of -1: absolute photometry
    return LampLabel(
        maker=found.get("MANUFAC", ""),
        name=found.get("LUMINAIRE", "") or found.get("LUMCAT", ""),
        source=found.get("LAMP", "") or found.get("LAMPCAT", ""),
        watts=above_0(words[12]),
        lumens=above_0(found.get("_ABSOLUTELUMENS", "")),
        source_lumens=lamps * lumens if lamps and lumens else None,
        unit=found.get("_INTENSITYUNITS", "") or "cd",
    )


def _word(words: list[str], i: int, name: str) -> str:
    if i >= len(words):
        raise ValueError(f"{name} ends after TILT at {short(' '.join(words[-3:]))}. Give the whole file.")
    return words[i]
