"""Intensities: what no image can check where they are taken as known, said beside the errors."""

from __future__ import annotations

from collections.abc import Sequence

from .identifiability import listing
from .parameters import Unknown

SCALED = ("k_a", "k_d", "k_s")
SENDERS = ("intensity", "ambient", "exposure")


def taken_as_exact(unknowns: Sequence[Unknown]) -> str:
    """Return a sentence on the lights' intensities where reflections are free and none of what sends light is; else ''.

    All intensities times 1.3 and all reflections over 1.3 make the same images.
    """
    kinds = {u.kind for u in unknowns if "/" not in u.quantity}
    names = [name for name in SCALED if name in kinds]
    if not names or kinds & set(SENDERS):
        return ""
    verb = "scales" if len(names) == 1 else "scale"
    return f"{listing(names)} {verb} inversely with the lights' intensities, taken as exact: no image can check them."
