"""Tables: the text and the JSON of results, made from their fields."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np

DIGITS = np.finfo(np.float32).precision  # 6: of a number at most, and as many decimals


def rounded(value: float | np.floating, error: float | np.floating) -> str:
    """Return a number to the second digit of its error, a number without an error to 6 digits, and NaN as a dash."""
    if not math.isfinite(value):
        return "-"
    if not 0.0 < error < math.inf:
        return f"{value:.{DIGITS}g}"
    decimals = 1 - math.floor(math.log10(error))
    if decimals <= DIGITS:
        return f"{value:z.{max(decimals, 0)}f}"
    digits = decimals + 1 + math.floor(math.log10(max(abs(value), error)))
    return f"{value:.{min(digits, DIGITS)}g}"


def with_error(value: float | np.floating, error: float | np.floating) -> str:
    """Return a number and its error."""
    return f"{rounded(value, error)} +- {rounded(error, error)}"


cells = np.vectorize(rounded, otypes=[object])
"""The numbers of an array as `rounded` has them, by an array of errors."""


def parameters(
    names: Sequence[str],
    values: Iterable[float | np.floating],
    errors: Iterable[float | np.floating],
    known: Iterable[bool | np.bool_],
) -> dict[str, Any]:
    """Return the columns of a table of parameters, of which some may not be determined."""
    rows = [*zip(values, errors, known, strict=True)]
    return {
        "parameter": names,
        "value": [rounded(value, error) if here else "not determined" for value, error, here in rows],
        "error": [rounded(error, error) if here else "" for _, error, here in rows],
    }


def as_text(*parts: str | Mapping[str, Any], notes: Sequence[str] = ()) -> str:
    """Return what a result prints.

    Args:
        parts: Sentences, and the columns of tables, in their order.
        notes: Sentences below it.
    """
    lines = [line for part in parts for line in ([part] if isinstance(part, str) else _aligned(part))]
    return "\n".join([*lines, *(f"- {note}" for note in notes)])


def rows_of(columns: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the rows of a table as text, that of the heads first.

    Args:
        columns: The cells below the head of each column: words, or numbers, of which those that are not whole get 4
            digits. Cells that are vectors fill as many columns, whose heads are the head's words.
    """
    filled = []
    for head, column in columns.items():
        vectors = np.ndim(column) == 2
        each = zip_longest(head.split(), np.transpose(column), fillvalue="") if vectors else [(head, column)]
        filled += [[name, *map(_cell, of)] for name, of in each]
    return [*zip(*filled, strict=True)]


def _aligned(columns: Mapping[str, Any]) -> list[str]:
    """Return the lines of a table, with the first column to the left and the others to the right."""
    rows = rows_of(columns)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join([name.ljust(widths[0]), *map(str.rjust, row, widths[1:])]).rstrip() for name, *row in rows]


def _cell(value: Any) -> str:
    if isinstance(value, int | np.integer):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float | np.floating) else str(value)


def as_json(value: Any) -> Any:
    """Return a result, or what is in one, for JSON.

    Results become objects with a key for each field, arrays lists, and numbers that are not finite null. Fields with
    `repr=False` are left out: scenes, photographs and all else that is not a number, a word or some of them.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: as_json(getattr(value, field.name)) for field in dataclasses.fields(value) if field.repr}
    if (as_dict := getattr(value, "_asdict", None)) is not None:  # of a NamedTuple
        return as_json(as_dict())
    if isinstance(value, Mapping):
        return {str(key): as_json(item) for key, item in value.items()}
    if (as_list := getattr(value, "tolist", None)) is not None:  # of NumPy
        return as_json(as_list())
    if isinstance(value, list | tuple):
        return [as_json(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
