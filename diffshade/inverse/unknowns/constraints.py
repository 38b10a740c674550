"""Constraints: known relations between free numbers, besides their bounds, and the unknowns that remain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.fields import as_coefficient, as_colour, as_exponent, as_surround
from .names import means, names_of, segments_of
from .places import Known, Place
from .unknown import Named, Product

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


def colourless(constraints: Sequence[Grey | Proportional], freed: Sequence[Place], known: Known) -> set[Place]:
    """Return the places of the colours whose channels are one unknown."""
    found = set()
    for constraint in constraints:
        if isinstance(constraint, Grey):
            (name,) = names_of("constraints", (constraint.name,), known)
            for place in (place for place in freed if means(name, place)):
                if known[place][1].metadata["converter"] not in (*COLOURS, as_exponent):
                    raise ValueError(f"Grey needs colours; '{name}' names {place}, which is not one. Leave it out.")
                if any(isinstance(c, Proportional) and means(c.name, place) for c in constraints):
                    raise ValueError(
                        f"Grey names '{name}', which Proportional makes follow another. Name that instead."
                    )
                found.add(place)
    return found


def proportions_of(
    constraints: Sequence[Grey | Proportional], freed: Sequence[Place], known: Known
) -> dict[Place, tuple[Place, float | None]]:
    """Return for each place that is proportional to another: that other, and the factor where it is given."""
    found: dict[Place, tuple[Place, float | None]] = {}
    for constraint in constraints:
        if not isinstance(constraint, Proportional):
            continue
        for name in names_of("constraints", (constraint.name, constraint.to), known):
            if segments_of(name)[-1] not in ("k_a", "k_d", "k_s"):
                raise ValueError(f"Proportional relates two of k_a, k_d and k_s; got '{name}'. Name one of these.")
        factor = constraint.factor
        if factor is not None and not (isinstance(factor, float | int | np.number) and 0 <= factor < np.inf):
            raise ValueError(
                f"the factor of {constraint} must be finite and at least 0; got {factor!r}. Give such a one."
            )
        for place in known:
            if not means(constraint.name, place) or (factor is None and place not in freed):
                continue
            if factor is not None and place in freed:
                raise ValueError(
                    f"'{place}' is fixed by {constraint} and free as well. Leave it out of free, or give no factor."
                )
            others = [other for other in known if means(constraint.to, other)]
            beside = [other for other in others if other.holder == place.holder]
            to = next(iter(beside or others))
            if place in found or to in found or to == place or (len(others) > 1 and len(beside) != 1):
                raise ValueError(
                    f"{constraint} does not say which number {place} is proportional to. Name one that is not "
                    "constrained itself, by its whole path."
                )
            if factor is not None and to not in freed:
                raise ValueError(
                    f"{constraint} relates {place} and {to}, both known. Free {to}, or set {place} in the scene."
                )
            found[place] = (to, factor)
    return found


def products_of(
    proportions: Mapping[Place, tuple[Place, float | None]], found: Sequence[Named], known: Known
) -> list[list[Product]]:
    """Return for each unknown the places that hold multiples of it; unknown factors come last, in their order."""
    at = {place: j for j, named in enumerate(found) for place in named.places}
    factors = [j for j, named in enumerate(found) if not named.places]
    products: list[list[Product]] = [[] for _ in found]
    for place, (to, factor) in proportions.items():
        own = factors.pop(0) if factor is None else -1
        for c, base in enumerate(np.asarray(known[to][0], np.float64)):
            j = at.get(to.at(c))
            if j is not None and factor is not None:
                products[j].append(Product(place.at(c), float(factor), to.at(c)))
            else:
                products[own].append(Product(place.at(c), float(base) if j is None else 1.0, to.at(c), j))
    return products
