"""Ranges: the bounds and priors that a user gives, within the range that each field states (`Parameter`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...core.fields import parameter_of
from ...core.words import listing
from .names import check_names, concerns, end_of_run, ratio_name
from .unknown import Unknown, unit_vectors


def check_names_an_unknown(
    where: str,
    name: str,
    found: Sequence[Unknown],
    freed: Sequence[str],
    proportions: Mapping[str, tuple[str, float | None]],
    known: Mapping[str, Any],
) -> None:
    """Refuse a name in bounds or priors that means no unknown."""
    if any(name == ratio_name(u, known) or any(concerns(name, u, path) for path, _ in u.places) for u in found):
        return
    head = name.rpartition(".")[0]
    here = [u for u in found if any(end_of_run(head, path) == path.count(".") + 1 for path, _ in u.places)]
    if head and here:
        channels = [unknown.name[len(unknown.quantity) + 1 :] for unknown in here]
        has = f"has {listing(list(dict.fromkeys(channels)))}" if all(channels) else "is one number"
        raise ValueError(
            f"{where} names '{name}', but {head} {has}. Name {'one of these, or ' if all(channels) else ''}'{head}'."
        )
    if "/" not in name:
        check_names(where, (name,), known)
    for path, (to, _) in proportions.items():
        if path in freed and end_of_run(name, path) is not None:
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


def set_range(unknown: Unknown, bounds: Mapping[str, Sequence[float | int]], known: Mapping[str, Any]) -> None:
    """Set the range of an unknown: the meet of those of all its places."""
    for path, _ in unknown.places:
        named = {name: pair for name, pair in bounds.items() if concerns(name, unknown, path)}
        lower, upper = _range_within(path, known[path][1], named)
        unknown.lower, unknown.upper = max(unknown.lower, lower), min(unknown.upper, upper)
    if not unknown.places:
        named = {name: pair for name, pair in bounds.items() if name == unknown.name}
        unknown.lower, unknown.upper = _range_within(unknown.name, None, named)
    if not unknown.lower < unknown.upper:
        raise ValueError(
            f"the bounds of '{unknown.quantity}' leave nothing between {unknown.lower:g} and {unknown.upper:g}. "
            "Widen one of them."
        )
    unknown.start = float(np.clip(unknown.start, unknown.lower, unknown.upper))


def _range_within(
    path: str, spec: dataclasses.Field | None, bounds: Mapping[str, Sequence[float | int]]
) -> tuple[float, float]:
    """Return the range of a number of a field, within the bounds given; without a field, of a ratio."""
    metadata = {"lower": 0.0} if spec is None else spec.metadata
    whole = (float(metadata.get("lower", -np.inf)), float(metadata.get("upper", np.inf)))
    whole = (0.0, 1.0) if ".k_t." in path else whole  # a colour of a pattern, whose own field knows no such end
    whole = lower, upper = (None if spec is None else parameter_of(spec).fit_range) or whole
    allowed = f"[{lower:g}, {upper:g}]"
    for name, pair in bounds.items():
        low, high = _pair(f"bounds of '{name}'", pair, "(lower, upper)")
        if not low < high:
            raise ValueError(f"bounds of '{name}' must be lower < upper; got ({low:g}, {high:g}). Swap or widen them.")
        if low < whole[0] or high > whole[1]:
            raise ValueError(f"bounds of '{name}' must lie in {allowed}; got ({low:g}, {high:g}). Stay inside it.")
        lower, upper = max(lower, low), min(upper, high)
    return lower, upper


def prior_of(unknown: Unknown, priors: Mapping[str, Sequence[Any]]) -> tuple[float, float] | None:
    """Return the prior of an unknown in the solver's coordinates; of two, the one named last."""
    prior = None
    for name, pair in priors.items():
        channel = next((c for path, c in unknown.places if concerns(name, unknown, path)), None)
        if channel is None and name != unknown.name:
            continue
        pair = _of_unit_length(pair) if unknown.parameter.role == "direction" else pair
        mean, width = _pair(f"the prior of '{name}'", _of_channel(pair, channel or 0), "(value, standard deviation)")
        if not (0 < width < np.inf and np.isfinite(mean)):
            raise ValueError(
                f"the prior of '{name}' must have a finite value and a standard deviation above 0; got ({mean:g}, "
                f"{width:g}). Give (value, standard deviation)."
            )
        if unknown.logarithmic and not mean > 0:
            raise ValueError(f"the prior of '{name}' must have a value above 0; got {mean:g}. It is fitted as a log.")
        if not unknown.lower <= mean <= unknown.upper:
            raise ValueError(
                f"the prior of '{name}' must lie within [{unknown.lower:g}, {unknown.upper:g}]; got {mean:g}. Give a "
                "value in that range, or other bounds."
            )
        prior = (float(np.log(mean)) if unknown.logarithmic else mean, width)
    return prior


def _of_unit_length(pair: Any) -> Any:
    """Return the prior of a direction, which may have any length; the standard deviation is of the unit vector."""
    try:
        value, width = pair
        length = np.linalg.norm(value)
        return (np.asarray(value) / length, width) if np.shape(value) == (3,) and length > 0 else pair
    except (TypeError, ValueError):
        return pair


def _of_channel(pair: Any, channel: int) -> Any:
    """Return a prior for one channel, of one whose value is a vector or a colour."""
    try:
        value, width = pair
        return (value, width) if np.ndim(value) == 0 else (np.ravel(value)[channel], width)
    except (TypeError, ValueError, IndexError):
        return pair


def _pair(what: str, pair: Any, example: str) -> tuple[float, float]:
    try:
        low, high = (float(b) for b in pair)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be two numbers; got {pair!r}. Give {example}.") from None
    return low, high
