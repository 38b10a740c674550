"""Ranges: the bounds and priors that a user gives, within the range that each field states (`Parameter`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...core.fields import Parameter, parameter, parameter_of
from ...core.words import listing
from .names import concerns, is_named, means, names_of, rest_after
from .places import Known, Place, numbers_of
from .unknown import Named, Unknown, unit_vectors

FACTOR = dataclasses.field(metadata=parameter("factor", lower=0, start=1.0))  # stands for the field of a factor

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
    """Return the range of a number: the meet of those of all its places."""
    ranges = [
        _range_within(place, known[place.whole][1], {n: b for n, b in bounds.items() if concerns(n, number, place)})
        for place in number.places
    ]
    if not number.places:
        ranges = [_range_within(None, FACTOR, {n: b for n, b in bounds.items() if n == number.name})]
    lower, upper = max(low for low, _ in ranges), min(high for _, high in ranges)
    if not lower < upper:
        raise ValueError(
            f"the bounds of '{number.quantity}' leave nothing between {lower:g} and {upper:g}. Widen one of them."
        )
    return lower, upper


def _range_within(place: Place | None, spec: dataclasses.Field, bounds: Mapping[str, Sequence[float | int]]) -> Range:
    """Return the range of a number of a field, within the bounds given."""
    whole = (float(spec.metadata.get("lower", -np.inf)), float(spec.metadata.get("upper", np.inf)))
    if place is not None and "k_t" in place.fields[:-1]:  # a colour of a pattern, whose own field knows no such end
        whole = (0.0, 1.0)
    whole = lower, upper = parameter_of(spec).fit_range or whole
    for name, pair in bounds.items():
        low, high = _pair(f"bounds of '{name}'", pair, "(lower, upper)")
        if not low < high:
            raise ValueError(f"bounds of '{name}' must be lower < upper; got ({low:g}, {high:g}). Swap or widen them.")
        if low < whole[0] or high > whole[1]:
            allowed = f"[{whole[0]:g}, {whole[1]:g}]"
            raise ValueError(f"bounds of '{name}' must lie in {allowed}; got ({low:g}, {high:g}). Stay inside it.")
        lower, upper = max(lower, low), min(upper, high)
    return lower, upper


def prior_of(number: Named, within: Range, priors: Mapping[str, Sequence[Any]]) -> tuple[float, float] | None:
    """Return the prior of a number in the solver's coordinates; of two, the one named last."""
    prior, log = None, number.parameter.logarithmic
    for name, pair in priors.items():
        place = next((place for place in number.places if concerns(name, number, place)), None)
        if place is None and name != number.name:
            continue
        pair = pair if place is None else _of_channel(pair, place.channel or 0, number.parameter)
        mean, width = _pair(f"the prior of '{name}'", pair, "(value, standard deviation)")
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


def _of_channel(pair: Any, channel: int, of: Parameter) -> Any:
    """Return a prior for one channel, of one whose value is a vector or a colour; a direction may have any length."""
    try:
        value, width = pair
        return (value, width) if np.ndim(value) == 0 else (numbers_of(value, of)[channel], width)
    except (TypeError, ValueError, IndexError):
        return pair


def _pair(what: str, pair: Any, example: str) -> tuple[float, float]:
    try:
        low, high = (float(b) for b in pair)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be two numbers; got {pair!r}. Give {example}.") from None
    return low, high
