"""Intensities: a sentence, printed with the errors, on reflections that depend on the given intensities."""

from __future__ import annotations

from collections.abc import Sequence

from ...core.words import listing
from ..unknowns.places import Place
from ..unknowns.unknown import Unknown, free_places

SCALED = ("k_a", "k_d", "k_s")


def taken_as_exact(unknowns: Sequence[Unknown], lights: int, views: int) -> str:
    """Return a sentence on the lights' intensities if reflections are free and the intensities or exposures are not.

    All intensities times 1.3 and all reflections over 1.3 make the same images. With every intensity free, or every
    exposure, that is a gauge, which the fit names.

    Args:
        unknowns: Of the fit.
        lights: How many lights the scene has.
        views: How many views were fitted.
    """
    free = free_places(unknowns)
    names = [name for name in SCALED if any(place.fields == ("material", name) for place in free)]
    senders = (
        [Place("lights", i, ("intensity",)) for i in range(lights)],
        [Place("views", i, ("exposure",)) for i in range(views)],
    )
    if not names or any(of and free.issuperset(of) for of in senders):
        return ""
    verb = "scales" if len(names) == 1 else "scale"
    return (
        f"{listing(names)} {verb} inversely with the lights' intensities, which are taken as exact: no image can check "
        "these."
    )
