"""Constraints: known relations between free numbers, besides their bounds, and the unknowns that remain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.fields import as_coefficient, as_colour, as_exponent, as_surround
from .names import check_names, end_of_run
from .unknown import Product, Unknown

COLOURS = (as_colour, as_surround, as_coefficient)


@dataclass(frozen=True)
class Grey:
    """The channels of a number are equal: one unknown for the three of each colour, or of each n_s with three.

    Args:
        name: Any run of whole segments of a dotted path, as in `fit`; it must be free.
    """

    name: str


@dataclass(frozen=True)
class Proportional:
    r"""A number is proportional to another one, channel by channel.

    $$ name = factor \cdot to $$

    `Proportional("k_s", "k_d")` is a highlight of the surface's own colour.

    Args:
        name: One of k_a, k_d and k_s: a run of whole segments of a dotted path, as in `fit`. With a factor it is fixed
            by this constraint and must not be free.
        to: The other one.
        factor: The ratio, at least 0; None makes it an unknown.
    """

    name: str
    to: str
    factor: float | None = None


def has_factor(constraint: Grey | Proportional) -> bool:
    """Whether a constraint fixes a number by a known factor."""
    return isinstance(constraint, Proportional) and constraint.factor is not None


def colourless(constraints: Sequence[Grey | Proportional], freed: Sequence[str], known: Mapping[str, Any]) -> set[str]:
    """Return the paths of the colours whose channels are one unknown."""
    found = set()
    for constraint in constraints:
        if isinstance(constraint, Grey):
            (name,) = check_names("constraints", (constraint.name,), known)
            for path in (path for path in freed if end_of_run(name, path) is not None):
                if known[path][1].metadata["converter"] not in (*COLOURS, as_exponent):
                    raise ValueError(f"Grey needs colours; '{name}' names {path}, which is not one. Leave it out.")
                if any(isinstance(c, Proportional) and end_of_run(c.name, path) is not None for c in constraints):
                    raise ValueError(
                        f"Grey names '{name}', which Proportional makes follow another. Name that instead."
                    )
                found.add(path)
    return found


def proportions_of(
    constraints: Sequence[Grey | Proportional], freed: Sequence[str], known: Mapping[str, Any]
) -> dict[str, tuple[str, float | None]]:
    """Return for each path that is proportional to another: that other, and the factor where it is given."""
    found: dict[str, tuple[str, float | None]] = {}
    for constraint in constraints:
        if not isinstance(constraint, Proportional):
            continue
        for name in check_names("constraints", (constraint.name, constraint.to), known):
            if name.split(".")[-1] not in ("k_a", "k_d", "k_s"):
                raise ValueError(f"Proportional relates two of k_a, k_d and k_s; got '{name}'. Name one of these.")
        factor = constraint.factor
        if factor is not None and not (isinstance(factor, float | int | np.number) and 0 <= factor < np.inf):
            raise ValueError(
                f"the factor of {constraint} must be finite and at least 0; got {factor!r}. Give such a one."
            )
        for path in known:
            if end_of_run(constraint.name, path) is None or (factor is None and path not in freed):
                continue
            if factor is not None and path in freed:
                raise ValueError(
                    f"'{path}' is fixed by {constraint} and free as well. Leave it out of free, or give no factor."
                )
            others = [p for p in known if end_of_run(constraint.to, p) is not None]
            beside = [p for p in others if p.rpartition(".")[0] == path.rpartition(".")[0]]
            to = next(iter(beside or others))
            if path in found or to in found or to == path or (len(others) > 1 and len(beside) != 1):
                raise ValueError(
                    f"{constraint} does not say which number {path} is proportional to. Name one that is not "
                    "constrained itself, by its whole path."
                )
            if factor is not None and to not in freed:
                raise ValueError(
                    f"{constraint} relates {path} and {to}, both known. Free {to}, or set {path} in the scene."
                )
            found[path] = (to, factor)
    return found


def make_proportional(
    path: str,
    to: str,
    factor: float | None,
    found: Sequence[Unknown],
    known: Mapping[str, Any],
    *,
    from_scene: bool,
) -> list[Unknown]:
    """Make the places of `path` multiples of `to`; return the unknown factor where it is one."""
    at = {place: j for j, unknown in enumerate(found) for place in unknown.places}
    value, base = (np.asarray(known[name][0], np.float64) for name in (path, to))
    new = []
    if factor is None:
        start = float(value.sum() / base.sum()) if from_scene and base.sum() > 0 else 1.0
        new = [Unknown(f"{path}/{to}", f"{path}/{to}", 0.0, np.inf, start)]
    for c in range(len(value)):
        j = at.get((to, c))
        if new and j is None:
            new[0].products.append(Product(path, c, float(base[c]), base=(to, c)))
        elif new:
            new[0].products.append(Product(path, c, 1.0, j))
        elif j is not None:
            found[j].products.append(Product(path, c, float(factor or 0.0)))
    return new
