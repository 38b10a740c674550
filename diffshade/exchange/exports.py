"""Exports: the text of a material for another program, and notes on the differences there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..core.fields import in_short
from ..core.words import listing
from ..model.lights import AbstractLight
from ..model.materials import Material
from .lobe_refits import Refit


class Draft(NamedTuple):
    """The text of a file, the error of the material in it, and its notes."""

    text: str
    rms: float
    largest: float
    notes: tuple[str, ...]


def together(drafts: Mapping[str, Draft], between: str) -> Draft:
    """Return several materials in one file: the errors of the worst, and the notes with the names of the materials."""
    texts, rms, largest, _ = zip(*drafts.values(), strict=True)
    whom: dict[str, list[str]] = {}
    for name, draft in drafts.items():
        for note in draft.notes:
            whom.setdefault(note, []).append(name)
    notes = (note if len(of) == len(drafts) else f"{listing(of)}: {note}" for note, of in whom.items())
    return Draft(between.join(texts), max(rms), max(largest), tuple(notes))


def stated(rms: float, largest: float) -> str:
    """Return the sentence that states an error."""
    return (
        f"under a light of intensity 1 the radiance differs by {rms:.2g} (rms) and {largest:.2g} (at most) over a "
        "sphere, with the light at 0 to 80 degrees from the viewer."
    )


def notes_on_refit(refit: Refit) -> list[str]:
    """Return the note on a refit; none if the material is unchanged."""
    return [f"{refit}"] if refit.largest else []


def opacity(material: Material) -> float:
    """Return d = 1 - k_t; for a coloured k_t, 1 minus its mean."""
    return 1.0 if material.k_t is None else 1.0 - float(np.mean(material.k_t))


def notes_on_glass(material: Material, program: str, *, colour: bool, eta: bool) -> list[str]:
    """Return notes on k_t and eta for a program without `colour` of k_t or without `eta`."""
    notes = []
    if material.k_t is not None and not colour and np.ptp(material.k_t) > 0:
        notes.append(f"{program} has one opacity for all colours: k_t {in_short(material.k_t)} is written as its mean.")
    if material.eta is not None and not eta:
        notes.append(f"{program} does not refract light: eta {in_short(material.eta)} is not written.")
    return notes


def notes_on_lights(lights: Sequence[AbstractLight], program: str) -> list[str]:
    """Return a note that lights and their attenuation are not written."""
    if not lights:
        return []
    return [f"a material in {program} has no lights: the lights and their attenuation are not written."]


def comment(notes: Sequence[str], mark: str) -> str:
    """Return sentences as comment lines."""
    return "".join(f"{mark} {note}\n" for note in ("written by diffshade", *notes))


def plain(values: Any, between: str = ", ", after: str = "") -> str:
    """Return one number or several as text that is read back exactly."""
    return between.join(f"{float(x)!r}{after}" for x in np.ravel(values))
