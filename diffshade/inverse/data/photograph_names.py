"""Names of photographs: their order, and which file a list means by one."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...io.raw_files import SUFFIXES as RAW_SUFFIXES


def is_raw(name: str) -> bool:
    """Whether a file is what a camera's sensor gave."""
    return Path(name).suffix.lower() in RAW_SUFFIXES


def pattern(name: str) -> str:
    """Return what a name has in common with those of one series: all but its digits."""
    return re.sub(r"\d+", "0", Path(name).stem)


def natural_order(name: str) -> list[Any]:
    """Return a key by which 2 comes before 10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def by_name(wanted: Sequence[str], there: Sequence[str]) -> list[int | None]:
    """Return which of the names that are there is meant by each that is wanted; None for none.

    They may differ in case, in blanks, in how accents are composed (by a Mac or by others), and in the suffix. Of a RAW
    file and what the camera made of it, the RAW file counts.
    """
    exact = {name: i for i, name in enumerate(there)}
    alike = {_key(name): i for i, name in enumerate(there)}
    stems: dict[str, int] = {}
    for i, name in enumerate(there):
        if _key(Path(name).stem) not in stems or is_raw(name):
            stems[_key(Path(name).stem)] = i
    places = ((exact, lambda name: name), (alike, _key), (stems, _key), (stems, lambda name: _key(Path(name).stem)))
    return [next((of[key(name)] for of, key in places if key(name) in of), None) for name in wanted]


def _key(name: str) -> str:
    return " ".join(unicodedata.normalize("NFC", name).casefold().split())


def in_order(wanted: Sequence[str], there: Sequence[str]) -> list[int]:
    """Return which of as many other names goes with each name that is wanted.

    Where both are numbered, the order is that of the numbers: a list that was sorted as text has 10 before 2.
    """
    numbered = all(len({pattern(name) for name in names}) == 1 for names in (wanted, there))
    if not numbered:
        return list(range(len(wanted)))
    ranks = [sorted(range(len(names)), key=lambda i, names=names: natural_order(names[i])) for names in (wanted, there)]
    pairs = dict(zip(*ranks, strict=True))
    return [pairs[i] for i in range(len(wanted))]
