"""Readings: the materials that a file holds, why others could not be read, and what was lost of those that were."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.words import MAX_NAMED, errors_at, listing, unused
from ..io.parsing import short
from ..model.materials import Material
from .base_colours import BaseColour


class Reading:
    """What was read from a file. One material that cannot be read does not stop the others."""

    def __init__(self, where: str):
        self.where = where
        self.materials: dict[str, Material] = {}
        self.refused: dict[str, str] = {}
        """Why a material could not be read, by its name."""
        self.base: dict[str, BaseColour] = {}
        """How the points of a material are coloured, by its name, where more than the material says it."""
        self._notes: dict[str, list[str]] = {}
        self._maps: dict[str, tuple[list[str], Collection[str]]] = {}

    def add(self, name: str, read: Callable[[], Material]) -> None:
        """Read a material, or keep the sentence that says why it cannot be read."""
        try:
            with errors_at(self.at(name)):
                self.materials[name] = read()
        except ValueError as error:
            self.refused[name] = str(error)

    def at(self, name: str) -> str:
        """Return where a material is, for messages."""
        return f"{self.where}: {short(name)}"

    def note(self, name: str, sentence: str) -> None:
        """Keep a sentence about a material; the same sentence about several is said once."""
        self._notes.setdefault(sentence, []).append(name)

    def note_maps(self, name: str, maps: list[str], own: Collection[str]) -> None:
        """Keep the names of a material's texture maps, of which `own` may be those of its base colour."""
        self._maps[name] = maps, own

    def notes_on(self, name: str | None = None, *, textured: bool = False) -> Iterator[str]:
        """Yield what was lost or translated, in one line each: of all materials, or of one.

        `textured`: the pictures of base colours are not lost.
        """
        several = len(self.materials) + len(self.refused) > 1
        notes = {sentence: [*names] for sentence, names in self._notes.items()}
        only = "those of the base colour" if textured else "colours"  # maps are never opened to read a material
        for of, (maps, own) in self._maps.items():
            if lost := [key for key in maps if not (textured and key in own)]:
                notes.setdefault(f"texture maps are not read, only {only}: {first_of(lost)}.", []).append(of)
        for sentence, names in notes.items():
            names = list(dict.fromkeys(of for of in names if of))
            if names and name not in (None, *names):
                continue
            whom = listing([short(of) for of in names]) if len(names) <= MAX_NAMED else f"{len(names)} materials"
            yield f"{self.where}: {f'{whom}: ' if several and names else ''}{sentence}"

    def unused(self, name: str) -> str:
        """Return a name that no material has yet: with a number after it if need be."""
        return unused(name, self.materials.keys() | self.refused.keys())


def first_of(names: Iterable[str]) -> str:
    """Return the first eight of the names that a file has, and how many more there are."""
    named = [short(name) for name in dict.fromkeys(names)]
    return ", ".join(named[:8]) + (f" and {len(named) - 8} more" if len(named) > 8 else "")


def load_json(text: str, where: str) -> Any:
    """Return what a JSON text holds."""
    try:
        return json.loads(text)
    except (json.JSONDecodeError, RecursionError, ValueError) as error:
        raise ValueError(f"{where} is not JSON: {short(str(error))}. Correct the file.") from None


def as_number(table: Mapping[str, Any], key: str, default: float, where: str, *, most: float = 1e300) -> float:
    """Return a number of a JSON table, from 0 to `most`."""
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        raise ValueError(f"{where}: {key} must be a finite number; got {short(repr(value)[:80])}. Correct the file.")
    if not 0 <= value <= most:
        limit = f"0 to {most:g}" if most < 1e300 else "at least 0"
        raise ValueError(f"{where}: {key} must be {limit}; got {value:g}. Correct the file.")
    return float(value)


def as_numbers(table: Mapping[str, Any], key: str, default: Any, count: int, where: str) -> Float[np.ndarray, " n"]:
    """Return a list of numbers of a JSON table, each at least 0."""
    value = table.get(key, default)
    if not isinstance(value, list | tuple) or len(value) != count:
        raise ValueError(f"{where}: {key} must be {count} numbers; got {short(repr(value)[:80])}. Correct the file.")
    return np.array([as_number({key: x}, key, 0.0, where) for x in value])


def as_table(value: Any) -> dict[str, Any]:
    """Return a JSON table; anything else is an empty one."""
    return value if isinstance(value, dict) else {}
