"""Named materials: the 24 materials of the OpenGL teapots, by their names there."""

from __future__ import annotations

import csv
import functools
from importlib.resources import files

from ..core.fields import in_short
from ..core.words import did_you_mean
from .lobes import Blinn
from .materials import Material


def material(name: str) -> Material:
    """Return the material of a name, for example "emerald" or "black_rubber"; its highlight is Blinn's.

    The coefficients are those of teapots.c in the OpenGL Programming Guide (SGI 1993); n_s is 128 times its shininess.

    Args:
        name: Name of the material; `material_names()` lists them.

    Returns:
        The material.

    Raises:
        ValueError: The name is unknown.
        TypeError: The name is not a string.
    """
    known = _table()
    if not isinstance(name, str):
        raise TypeError(f"the name of a material must be a word; got {in_short(name)}. Give for example 'emerald'.")
    if name not in known:
        raise ValueError(f"no material is named '{name}'. {did_you_mean(name, known)}")
    k_a, k_d, k_s, n_s = known[name]
    return Material(k_a, k_d, k_s, n_s, Blinn())


def material_names() -> tuple[str, ...]:
    """Return the names that `material` accepts.

    Returns:
        The names, in the order of the table.
    """
    return tuple(_table())


@functools.cache
def _table() -> dict[str, tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], float]]:
    text = files("diffshade.model").joinpath("named_materials.csv").read_text(encoding="utf-8")
    rows = {}
    for row in csv.DictReader(text.splitlines()):
        k_a, k_d, k_s = (tuple(float(row[f"k{term}_{channel}"]) for channel in "rgb") for term in "ads")
        rows[row["name"]] = (k_a, k_d, k_s, float(row["shininess128"]))
    return rows
