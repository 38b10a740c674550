"""Text files of other programs: read whole within a bound, and their numbers without surprises."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

LARGEST = 16 * 2**20  # bytes: no material and no lamp is nearly as large; reading takes at most 64 times a file's size
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def read_text(path: str | Path, noun: str) -> str:
    """Return the text of a file, UTF-8 or else Latin-1, which these formats are written in.

    Raises FileNotFoundError where there is none, and ValueError for one that is no text or too large.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no {noun} {path}. Give the path of a file.")
    if (size := path.stat().st_size) > LARGEST:
        raise ValueError(
            f"{path} has {size} bytes, too many for a {noun}; at most {LARGEST} are read. Give another file."
        )
    data = path.read_bytes()
    if b"\0" in data:
        raise ValueError(f"{path} is no {noun}: it holds zero bytes, which no text has. Give another file.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def number(word: str, where: str) -> float:
    """Return the number that a word is; not `nan`, `inf`, `1_000` or one too large, which Python would take."""
    found = float(word) if NUMBER.fullmatch(word) and len(word) < 400 else math.nan
    if not math.isfinite(found):
        raise ValueError(f"{where} must be a finite number; got {short(word)}. Mend it.")
    return found


def count(word: str, where: str, *, least: int = 1) -> int:
    """Return the whole number that a word is, at least `least`."""
    found = number(word, where)
    if not (found == int(found) and found >= least):
        raise ValueError(f"{where} must be a whole number of at least {least}; got {short(word)}. Mend it.")
    return int(found)


def numbers(words: Sequence[str], where: str) -> list[float]:
    """Return the numbers that words are."""
    return [number(word, where) for word in words]


def short(word: str) -> str:
    """Return a word as a message shows it: one line of a few characters, whatever the file holds."""
    shown = repr(word)
    return shown if len(shown) <= 40 else f"{shown[:36]}...'"
