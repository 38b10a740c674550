"""Named materials: the 24 of the OpenGL teapots, and 100 that were measured, by their names there."""

from __future__ import annotations

import csv
import functools
from importlib.resources import files
from typing import NamedTuple

from ..core.fields import in_short
from ..core.words import did_you_mean
from .lobes import AbstractPowerLobe, Blinn, Phong
from .materials import Highlight, Material

MEASURED = "merl_"


def material(name: str, *, lobe: AbstractPowerLobe | None = None, highlights: int = 1) -> Material:
    """Return the material of a name, for example "emerald", "black_rubber" or "merl_brass".

    The 24 materials of the OpenGL teapots have the coefficients of teapots.c in the OpenGL Programming Guide (SGI 1993)
    and Blinn's highlight; n_s is 128 times its shininess.

    The 100 whose names begin with "merl_" are fitted to measurements: to the ABC model (Löw et al. 2012) of the MERL
    database (Matusik et al. 2003), whose parameters are in dj_brdf.h (Dupuy, public domain). What is fitted is
    f (n.l) pi, by k_d (n.l) and one or two highlights, which carry no n.l, where light and viewer are at most 75
    degrees from the normal and 0 to 80 degrees apart. They have no k_a. `material_error` states what the fit leaves.

    Args:
        name: Name of the material; `material_names()` and `measured_material_names()` list them.
        lobe: Of a measured one, `Phong()` or `Blinn()`; by default the nearer one.
        highlights: Of a measured one, 1 or 2; with 2, a second one is left out where it gains nothing.

    Returns:
        The material.

    Raises:
        ValueError: The name is unknown; or a lobe or a number of highlights is not possible.
        TypeError: The name is not a string.
    """
    if not isinstance(name, str):
        raise TypeError(f"the name of a material must be a word; got {in_short(name)}. Give for example 'emerald'.")
    if name.startswith(MEASURED):
        row = _measured(name, lobe, highlights)
        pairs = ((row.numbers[at : at + 3], row.numbers[at + 3]) for at in (3, 7))
        terms = [Highlight(k_s, n_s, row.lobe) for k_s, n_s in pairs if any(k_s)]
        first, *more = terms or [Highlight(0.0, 10.0, row.lobe)]
        return Material(0.0, row.numbers[:3], first.k_s, first.n_s, row.lobe, highlights=tuple(more))
    known = _table()
    if name not in known:
        raise ValueError(f"no material is named '{name}'. {did_you_mean(name, known)}")
    if lobe is not None or highlights != 1:
        raise ValueError(f"'{name}' has one highlight, Blinn's; got another lobe or number. Use with_lobe for Phong's.")
    k_a, k_d, k_s, n_s = known[name]
    return Material(k_a, k_d, k_s, n_s, Blinn())


def material_names() -> tuple[str, ...]:
    """Return the names of the OpenGL teapots' materials, which `material` accepts.

    Returns:
        The names, in the order of the table.
    """
    return tuple(_table())


def measured_material_names() -> tuple[str, ...]:
    """Return the names of the measured materials, which `material` accepts.

    Returns:
        The names, in the order of the table.
    """
    return tuple(_measurements())


class MaterialError(NamedTuple):
    """What the fit of a measured material leaves, under a light of intensity 1; `print` it for a sentence."""

    rms: float
    """Root mean square difference of radiance; beyond a radiance of 1, the relative difference."""
    largest: float
    """The largest difference, measured alike."""
    peak: float
    """The largest radiance of the measurement."""

    def __str__(self) -> str:
        return (
            f"the radiance differs from the measured one by {self.rms:.2g} (rms) and {self.largest:.2g} (at most), "
            f"relative where it exceeds 1 (it reaches {self.peak:.3g}), with light and viewer at most 75 degrees from "
            "the normal."
        )


def material_error(name: str, *, lobe: AbstractPowerLobe | None = None, highlights: int = 1) -> MaterialError:
    """Return how far a measured material is from its measurement.

    Args:
        name: Name of a measured material.
        lobe: As for `material`.
        highlights: As for `material`.

    Returns:
        The error.

    Raises:
        ValueError: The name is not that of a measured material; or a lobe or a number of highlights is not possible.
    """
    return MaterialError(*_measured(name, lobe, highlights).numbers[11:])


class _MeasuredFit(NamedTuple):
    """A fit to a measured material: k_d, k_s and n_s of two highlights, rms, largest and peak."""

    lobe: AbstractPowerLobe
    highlights: int
    numbers: tuple[float, ...]


def _measured(name: str, lobe: AbstractPowerLobe | None, highlights: int) -> _MeasuredFit:
    """Return the fit of this lobe, or the nearer one, with so many highlights."""
    known = _measurements()
    if name not in known:
        raise ValueError(f"no measured material is named '{name}'. {did_you_mean(str(name), known)}")
    if highlights not in (1, 2):
        raise ValueError(f"a measured material has 1 or 2 highlights; got {in_short(highlights)}. Give one of them.")
    if lobe is not None and type(lobe) not in (Phong, Blinn):
        raise ValueError(f"the lobe must be Phong() or Blinn(); got {in_short(lobe)}. Use with_lobe for another.")
    rows = [row for row in known[name] if row.highlights == highlights and type(lobe) in (type(None), type(row.lobe))]
    return min(rows, key=lambda row: row.numbers[11])


@functools.cache
def _measurements() -> dict[str, tuple[_MeasuredFit, ...]]:
    text = files("diffshade.model").joinpath("measured_materials.csv").read_text(encoding="utf-8")
    rows: dict[str, tuple[_MeasuredFit, ...]] = {}
    for name, lobe, highlights, *numbers in list(csv.reader(text.splitlines()))[1:]:
        row = _MeasuredFit(Phong() if lobe == "Phong" else Blinn(), int(highlights), tuple(map(float, numbers)))
        rows[name] = (*rows.get(name, ()), row)
    return rows


@functools.cache
def _table() -> dict[str, tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], float]]:
    text = files("diffshade.model").joinpath("named_materials.csv").read_text(encoding="utf-8")
    rows = {}
    for row in csv.DictReader(text.splitlines()):
        k_a, k_d, k_s = (tuple(float(row[f"k{term}_{channel}"]) for channel in "rgb") for term in "ads")
        rows[row["name"]] = (k_a, k_d, k_s, float(row["shininess128"]))
    return rows
