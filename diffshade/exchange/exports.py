"""Drafts: the text of a material for another program, with what is different there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..core.fields import in_short
from ..model.lights import AbstractLight
from ..model.materials import Material
from .refits import Refit


class Draft(NamedTuple):
    """The text of a file, the error of the material in it, and the sentences about it."""

    text: str
    rms: float
    largest: float
    notes: tuple[str, ...]


def stated(rms: float, largest: float) -> str:
    """Return the sentence that states an error."""
    return (
        f"under a light of intensity 1 the radiance differs by {rms:.2g} (rms) and {largest:.2g} (at most) over a "
        "sphere lit from 0 to 80 degrees off the viewer."
    )


def said_of(refit: Refit) -> list[str]:
    """Return what is to be said of a refit: nothing, where the material is as it was."""
    return [f"{refit}"] if refit.largest else []


def opacity(material: Material) -> float:
    """Return d = 1 - k_t; of a coloured k_t, 1 less its mean."""
    return 1.0 if material.k_t is None else 1.0 - float(np.mean(material.k_t))


def said_of_glass(material: Material, program: str, *, colour: bool, eta: bool) -> list[str]:
    """Say what of k_t and eta a program does not know."""
    said = []
    if material.k_t is not None and not colour and np.ptp(material.k_t) > 0:
        said.append(f"{program} has one opacity for all colours: k_t {in_short(material.k_t)} is written as its mean.")
    if material.eta is not None and not eta:
        said.append(f"{program} does not bend light: eta {in_short(material.eta)} is left out.")
    return said


def said_of_lights(lights: Sequence[AbstractLight], program: str) -> list[str]:
    """Say that lights are not written, and with them their attenuation."""
    if not lights:
        return []
    return [f"lights, and with them their attenuation a0, a1, a2, are no part of a material in {program} and left out."]


def comment(notes: Sequence[str], mark: str) -> str:
    """Return sentences as comment lines."""
    return "".join(f"{mark} {note}\n" for note in ("written by diffshade", *notes))


def plain(values: Any, between: str = ", ", after: str = "") -> str:
    """Return a number, or several, as text that reads back as they were."""
    return between.join(f"{float(x)!r}{after}" for x in np.ravel(values))
