"""Text files of other programs: reading them within a size limit, and parsing their numbers strictly."""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Sequence
from pathlib import Path

LARGEST = 16 * 2**20  # bytes, far above any material or lamp; reading needs at most 64 times a file's size
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def read_text(path: str | Path, noun: str, *, largest: float | None = None) -> str:
    """Return the text of a file, decoded as its byte-order mark says, else as UTF-8 or as Latin-1.

    Args:
        path: The file.
        noun: What the file is, for messages.
        largest: Bytes that are read at most; `LARGEST` by default.

    Raises:
        ValueError: If the file is too large or not a text.
        FileNotFoundError: If the file does not exist.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no {noun} {path}. Give the path of a file.")
    largest = LARGEST if largest is None else largest
    if (size := path.stat().st_size) > largest:
        raise ValueError(f"{path} has {size} bytes, too many for a {noun}. Give one of at most {largest}.")
    data = path.read_bytes()
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    if b"\0" in data:
        raise ValueError(f"{path} is not a {noun}: it holds zero bytes, which a text does not. Give a text file.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_glb(path: Path, *, largest: float = LARGEST) -> tuple[str, int]:
    """Return the JSON of a binary glTF file, and where its other parts begin, which may be large (glTF 2.0, 4.4).

    Raises:
        ValueError: If the file is not binary glTF 2.0, or its JSON is too large.
        FileNotFoundError: If the file does not exist.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no material file {path}. Give the path of a file.")
    with open(path, "rb") as file:
        head = file.read(20)
        size = int.from_bytes(head[12:16], "little")
        if len(head) < 20 or head[:4] != b"glTF" or head[4] != 2 or head[16:] != b"JSON":
            raise ValueError(f"{path} is not binary glTF 2.0: its first bytes are others. Give a .glb file.")
        if size > largest:
            raise ValueError(f"{path} has {size} bytes of JSON; at most {largest} are read. Give a smaller file.")
        return file.read(size).decode("utf-8", "replace"), 20 + size


def number(word: str, where: str) -> float:
    """Parse a finite number; unlike Python, refuse `nan`, `inf`, `1_000` and numbers that overflow."""
    found = float(word) if NUMBER.fullmatch(word) and len(word) < 400 else math.nan
    if not math.isfinite(found):
        raise ValueError(f"{where} must be a finite number; got {short(word)}. Correct the file.")
    return found


def count(word: str, where: str, *, least: int = 1) -> int:
    """Parse a whole number of at least `least`."""
    found = number(word, where)
    if not (found == int(found) and found >= least):
        raise ValueError(f"{where} must be a whole number of at least {least}; got {short(word)}. Correct the file.")
    return int(found)


def numbers(words: Sequence[str], where: str) -> list[float]:
    """Parse several numbers."""
    return [number(word, where) for word in words]


def above_0(word: str) -> float | None:
    """Return a number above 0, and None for anything else: what a file may state, or leave out."""
    found = float(word) if NUMBER.fullmatch(word) and len(word) < 400 else 0.0
    return found if 0 < found < math.inf else None


def short(word: str) -> str:
    """Return a word for a message: one line, at most 40 characters."""
    shown = repr(word)
    return shown if len(shown) <= 40 else f"{shown[:36]}...'"
