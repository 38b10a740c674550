"""Disagreement: photographs, and places in them, that the other photographs contradict."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...core.thresholds import MOST
from ...core.words import MAX_NAMED, Note, count
from .learning import MIN_SAMPLES

CELLS = 8  # cells along each side of the image
WHOLE_PHOTOGRAPH = 3.0, 0.1  # a photograph disagrees beyond this multiple of the median share, and this much more


class Disagreement(NamedTuple):
    """A photograph that disagrees with the others, in one cell or as a whole."""

    view: int
    cell: int | None
    share: float


def cells_of(pixels: Int[np.ndarray, " n"], shape: tuple[int, int]) -> Int[np.ndarray, " n"]:
    """Return the cell of a coarse grid over the image that each pixel lies in."""
    row, column = np.divmod(pixels, shape[1])
    return row * CELLS // shape[0] * CELLS + column * CELLS // shape[1]


def disagreements(doubts: Float[np.ndarray, "views cells 2"]) -> list[Disagreement]:
    """Return the photographs and cells in which far more observations are doubted than in other photographs.

    Args:
        doubts: Numbers of observations of each view and cell: the doubted ones, and all.
    """
    doubted, number = doubts[..., 0], doubts[..., 1]
    whole = doubted.sum(1) / np.maximum(number.sum(1), 1.0)
    usual = float(np.median(whole))
    found = [
        Disagreement(v, None, float(share))
        for v, share in enumerate(whole)
        if share > max(WHOLE_PHOTOGRAPH[0] * usual, usual + WHOLE_PHOTOGRAPH[1]) and number[v].sum() >= MIN_SAMPLES
    ]
    named = {one.view for one in found}
    share = np.where(number >= MIN_SAMPLES, doubted / np.maximum(number, 1.0), np.nan)
    for cell in np.flatnonzero((~np.isnan(share)).sum(0) >= 2):
        ordinary = np.nanmedian(share[:, cell])
        for v in np.flatnonzero(share[:, cell] > MOST):
            if int(v) not in named and ordinary < MOST / 2.0:
                found.append(Disagreement(int(v), int(cell), float(share[v, cell])))
    return sorted(found, key=lambda one: -one.share)


def note_on_disagreements(found: list[Disagreement], shape: tuple[int, int]) -> tuple[Note, ...]:
    """Return notes that name the photographs, and the places in them, that disagree with the others."""
    whole, places = [d for d in found if d.cell is None], [d for d in found if d.cell is not None]
    notes = []
    if whole:
        named = ", ".join(f"views[{d.view}] at {d.share:.0%} of its texels" for d in whole[:MAX_NAMED])
        more = f", and {len(whole) - MAX_NAMED} more," if len(whole) > MAX_NAMED else ""
        notes.append(
            Note(
                f"{named}{more} disagree with the other photographs, which count for the result. Check the light and "
                "the exposure.",
                "disagrees",
            )
        )
    if places:
        views = list(dict.fromkeys(d.view for d in places))
        named = ", ".join(f"views[{d.view}] around {_place(d.cell or 0, shape)}" for d in places[:MAX_NAMED])
        more = "" if len(places) <= MAX_NAMED else f", and other places of {count(len(views), 'photograph')}"
        notes.append(
            Note(
                f"{named}{more} disagree with the other photographs there: cast shadow, bounced light, or something in "
                "the way. They count little.",
                "place_disagrees",
            )
        )
    return tuple(notes)


def _place(cell: int, shape: tuple[int, int]) -> str:
    """Return the middle of a cell in words."""
    row, column = divmod(cell, CELLS)
    return f"row {int((row + 0.5) * shape[0] / CELLS)}, column {int((column + 0.5) * shape[1] / CELLS)}"
