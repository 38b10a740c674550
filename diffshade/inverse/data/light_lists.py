"""Lists of lights: what is said of the light of each photograph, a line each, as people and domes write it.

A dome's list, `NAME.lp`, has the count of its lights, then a name and x y z a line. Numbers are separated by white
space, semicolons or commas; a comma within a number is its decimal sign.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...core.thresholds import SLIGHT
from ...core.words import count
from ...io.parsing import read_text, short

UNIT = 2 * SLIGHT  # by which a length may differ from 1: that of numbers of two decimals does
COMMENTS = ("#", "//", ";", "%")
NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?|[+-]?(inf|nan)", re.ASCII | re.IGNORECASE)
EITHER = re.compile(r"(?<![\d.])\d+,\d+(?![\d.])", re.ASCII)  # two whole numbers, or one with a decimal comma
NO_LETTERS = re.compile(r"[\s;,.\d+-]*", re.ASCII)
SUFFIX = re.compile(r"\.[A-Za-z]\w*\"?(?=[\s;,])")  # where a name ends


class LightList(NamedTuple):
    """A dome's list of lights."""

    path: Path
    names: tuple[str, ...]
    """Of the photographs, without folders."""
    directions: Float[np.ndarray, "lights 3"]
    """Unit vectors towards the lights."""
    notes: tuple[str, ...]
    """What the file says that is not used."""


def lines_of(path: Path, *, comments: bool = False) -> list[tuple[int, str]]:
    """Return the lines of a text, but for empty ones and, unless asked for, comments, each with its number."""
    lines = enumerate(read_text(path, "list of lights").splitlines(), 1)
    return [(number, line.strip()) for number, line in lines if line.strip() and (comments or not is_comment(line))]


def is_comment(line: str) -> bool:
    """Return whether a line begins as comments do."""
    return line.strip().startswith(COMMENTS)


def numbers_in(text: str) -> list[float]:
    """Return the numbers of a line; raise ValueError for anything else, or if its commas could mean either."""
    text = text.replace("\N{MINUS SIGN}", "-")
    words = [word.strip(",") for word in re.split(r"[\s;]+", text) if word.strip(",")]
    if not all(NUMBER.fullmatch(word) for word in words):  # commas separate numbers
        words = [word for word in re.split(r"[\s;,]+", text) if word]
        if len(words) > 3 and EITHER.search(text):
            raise ValueError(f"the commas in {short(text)} separate numbers or are decimal signs")
    return [float(word.replace(",", ".")) for word in words]


def read_lp(path: Path) -> LightList:
    """Read a dome's list of lights.

    Args:
        path: A text file: the count, which may be missing, then a name (which may have spaces and folders, of which the
            last part counts) and x y z a line, x right, y up, z to the camera. Further columns are not used.

    Returns:
        The list.

    Raises:
        ValueError: If it is no such list, or a direction has no length.
        FileNotFoundError: If it does not exist.
    """
    lines = lines_of(path)
    says = lines[0][1].strip(" ;,") if lines else ""
    if says.isdecimal() and len(says) < 10:
        first, lines = lines[0][0], lines[1:]
        if len(lines) < int(says):  # names, too, may begin as comments do
            lines = [line for line in lines_of(path, comments=True) if line[0] > first and _is_light(path, *line)]
        if len(lines) != int(says):
            raise ValueError(
                f"{path} must have {count(int(says), 'line')} after its first, as that says; got {len(lines)}. Correct "
                "the list."
            )
    if not lines:
        raise ValueError(
            f"{path} must begin with the count of its lights; got {says or 'nothing'!r}. Write it on the first line, "
            "and below it a name and x y z a light."
        )
    rows = [_row(path, *line) for line in lines]
    directions, notes = unit_vectors(
        path, np.array([numbers[:3] for _, numbers in rows]), [number for number, _ in lines]
    )
    if any(len(numbers) > 3 for _, numbers in rows):
        notes.append(f"the columns of {path.name} after x, y and z are not used.")
    return LightList(path, tuple(name for name, _ in rows), directions, tuple(notes))


def _is_light(path: Path, number: int, line: str) -> bool:
    """Return whether a line is no comment, or is one that a suffix and numbers make a light."""
    if not is_comment(line):
        return True
    try:
        return SUFFIX.search(line) is not None and bool(_row(path, number, line))
    except ValueError:
        return False


def _row(path: Path, number: int, line: str) -> tuple[str, list[float]]:
    """Return the name in a line, without its folders, and its numbers."""
    ends = [found.end() for found in SUFFIX.finditer(line)]
    splits = [(line[: ends[-1]], line[ends[-1] :], sys.maxsize)] if ends else []
    plain = bool(ends) and NO_LETTERS.fullmatch(line[ends[-1] :].replace("\N{MINUS SIGN}", "-"))
    for separator, most in () if plain else ((None, 3), (";", 3), (",", 3), (None, 1)):
        name, *last = line.strip(" ;,").rsplit(separator, most)
        if separator != "," or "," not in name:
            splits.append((name, ";".join(last), 3))  # a name without suffix may end in a number: x, y, z are the last
    for name, rest, most in splits:
        try:
            numbers = numbers_in(rest)
        except ValueError:
            continue
        if 3 <= len(numbers) <= most:
            return re.split(r"[\\/]|^[A-Za-z]:", name.strip(' "\t').rstrip("\\/"))[-1], numbers
    raise ValueError(
        f"{path} must have a name and three numbers a line; got {short(line)} on line {number}. Correct it."
    )


def unit_vectors(
    path: Path, vectors: Float[np.ndarray, "lights 3"], lines: Sequence[int]
) -> tuple[Float[np.ndarray, "lights 3"], list[str]]:
    """Return the vectors of a file as unit vectors, and what their lengths say that is not used.

    Args:
        path: The file.
        vectors: Towards the lights.
        lines: The line of each.

    Raises:
        ValueError: If one is not finite, or has no length.
    """
    length = np.linalg.norm(vectors, axis=1)
    if (wrong := ~(np.isfinite(length) & (length > 0.0))).any():
        first = int(wrong.argmax())
        raise ValueError(
            f"{path} must hold directions towards the lights; got {vectors[first].tolist()}, which is no direction, on "
            f"line {lines[first]}. Correct it, or leave the photograph out."
        )
    notes = []
    least, most = int(length.argmin()), int(length.argmax())
    if length[most] - length[least] > 2.0 * UNIT * length[most]:
        notes = [
            f"the lengths of the vectors in {path.name}, {length[least]:.4g} on line {lines[least]} to "
            f"{length[most]:.4g} on line {lines[most]}, are not used, only their directions."
        ]
    elif not abs(length[most] - 1.0) <= UNIT or not abs(length[least] - 1.0) <= UNIT:
        one, other = f"{length[least]:.4g}", f"{length[most]:.4g}"
        lengths = f"the length {one}" if one == other else f"lengths from {one} to {other}"
        notes = [f"the vectors in {path.name} have {lengths}, and are made unit vectors."]
    if (vectors[:, 2] < 0.0).all():
        notes.append(f"all lights in {path.name} are behind the object, z < 0: z must point to the camera.")
    return vectors / length[:, None], notes


def as_lp(names: Sequence[str], directions: Float[np.ndarray, "photographs 3"]) -> list[str]:
    """Return names and directions as the lines of a dome's list."""
    rows = zip(names, directions, strict=True)
    return [f"{len(names)}", *(f"{name} {' '.join(f'{x:.10g}' for x in l)}" for name, l in rows)]
