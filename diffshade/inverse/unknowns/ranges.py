"""Ranges: the bounds and priors that a user gives, within the range that each field states (`Parameter`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...core.fields import parameter_of
from ...core.words import listing
from .names import is_named, means, names_of, rest_after
from .places import Known, Place, numbers_of
from .unknown import Named, Unknown, unit_vectors

Range = tuple[float, float]


def check_names_an_unknown(
    where: str,
    name: str,
    found: Sequence[Named],
    proportions: Mapping[Place, tuple[Place, float | None]],
    known: Known,
) -> None:
    """Refuse a name in bounds or priors that means no unknown."""
    if any(is_named(name, of) for of in found):
        return
    head = name.rpartition(".")[0]
    here = [of for of in found if any(rest_after(head, place) == "" for place in of.places)]
    if head and here:
        channels = [of.channel for of in here]
        has = f"has {listing(list(dict.fromkeys(channels)))}" if all(channels) else "is one number"
        raise ValueError(
            f"{where} names '{name}', but {head} {has}. Name {'one of these, or ' if all(channels) else ''}'{head}'."
        )
    if "/" not in name:
        names_of(where, (name,), known)
    for place, (to, _) in proportions.items():
        if means(name, place):
            raise ValueError(f"{where} names '{name}', which follows {to} by a constraint. Name that instead.")
    raise ValueError(f"{where} names '{name}', which is not free. Add it to free, or leave it out.")


def check_directions(unknowns: Sequence[Unknown]) -> None:
    """Refuse bounds that no unit vector is within."""
    for members in unit_vectors(unknowns):
        low, high = (np.array([getattr(unknowns[j], end) for j in members]) for end in ("lower", "upper"))
        nearest = np.linalg.norm(np.clip(0.0, low, high))
        farthest = np.linalg.norm(np.maximum(np.abs(low), np.abs(high)))
        if not nearest <= 1.0 <= farthest:
            raise ValueError(
                f"the bounds of '{unknowns[members[0]].quantity}' hold no unit vector, which a direction is in a fit. "
                "Widen them, or bound one component, for example 'direction.z'."
            )


def range_of(number: Named, bounds: Mapping[str, Sequence[float | int]], known: Known) -> Range:
    """Return the range of a number: the meet of those of all its places and of its bounds."""
    ranges = [_range_at(place, known[place.whole][1]) for place in number.places] or [(0.0, np.inf)]
    whole = lower, upper = max(low for low, _ in ranges), min(high for _, high in ranges)
    for name, pair in ((name, pair) for name, pair in bounds.items() if is_named(name, number)):
        low, high = _pair(f"bounds of '{name}'", pair, "(lower, upper)")
        if not low < high:
            raise ValueError(f"bounds of '{name}' must be lower < upper; got ({low:g}, {high:g}). Swap or widen them.")
        if low < whole[0] or high > whole[1]:
            allowed = f"[{whole[0]:g}, {whole[1]:g}]"
            raise ValueError(f"bounds of '{name}' must lie in {allowed}; got ({low:g}, {high:g}). Stay inside it.")
        lower, upper = max(lower, low), min(upper, high)
    if not lower < upper:
        raise ValueError(
            f"the bounds of '{number.quantity}' leave nothing between {lower:g} and {upper:g}. Widen one of them."
        )
    return lower, upper


def _range_at(place: Place, spec: dataclasses.Field) -> Range:
    """Return the range of the numbers of a field in a fit."""
    if "k_t" in place.fields[:-1]:  # a colour of a pattern, whose own field knows no such end
        return 0.0, 1.0
    whole = (float(spec.metadata.get("lower", -np.inf)), float(spec.metadata.get("upper", np.inf)))
    return parameter_of(spec).fit_range or whole


def prior_of(number: Named, within: Range, priors: Mapping[str, Sequence[Any]]) -> tuple[float, float] | None:
    """Return the prior of a number in the solver's coordinates; of two, the one named last."""
    prior, log = None, number.parameter.logarithmic
    for name, pair in ((name, pair) for name, pair in priors.items() if is_named(name, number)):
        mean, width = _pair(f"the prior of '{name}'", _of_channel(pair, number), "(value, standard deviation)")
        if not (0 < width < np.inf and np.isfinite(mean)):
            raise ValueError(
                f"the prior of '{name}' must have a finite value and a standard deviation above 0; got ({mean:g}, "
                f"{width:g}). Give (value, standard deviation)."
            )
        if log and not mean > 0:
            raise ValueError(f"the prior of '{name}' must have a value above 0; got {mean:g}. It is fitted as a log.")
        if not within[0] <= mean <= within[1]:
            raise ValueError(
                f"the prior of '{name}' must lie within [{within[0]:g}, {within[1]:g}]; got {mean:g}. Give a value in "
                "that range, or other bounds."
            )
        prior = (float(np.log(mean)) if log else mean, width)
    return prior


def _of_channel(pair: Any, number: Named) -> Any:
    """Return a prior for one number of a vector or a colour, if it is one of all; a direction may have any length."""
    try:
        value, width = pair
        if np.ndim(value) == 0:
            return pair
        return numbers_of(value, number.parameter)[number.places[0].channel], width
    except (TypeError, ValueError, IndexError):
        return pair


def _pair(what: str, pair: Any, example: str) -> tuple[float, float]:
    try:
        low, high = (float(b) for b in pair)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be two numbers; got {pair!r}. Give {example}.") from None
    return low, high
