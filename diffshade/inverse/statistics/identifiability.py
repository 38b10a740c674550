"""Identifiability: what the views do not determine, in three grades, each with a sentence and a remedy.

Singular: a column of the Jacobian is zero, or a direction changes no pixel. Lost in noise: the error is as large as the
value. In both cases the value is "not determined". Ill-conditioned: a direction hardly changes a pixel; this only gives
a note. `verdicts/` and `diagnosis.examination` withdraw more values, of which the data contradict each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.thresholds import NEGLIGIBLE, TINY, VAGUE
from ...core.words import Note, listing
from ..unknowns.unknown import Unknown, by_quantity, free_places, logarithms
from .gauges import of_attenuation, quantities, sentence
from .uncertainty import SINGULAR, Matrix, Vector, regular_inverse, scaled

VAGUE_LOG = 0.5  # standard error of a logarithm
ONE_TOO_MANY = "The images can do with one highlight fewer. Leave it out, or add a photograph in which both show."


def condition_number(H: Matrix) -> float:
    """Return the condition number of J with columns of unit length; infinite where J is singular."""
    if not len(H):
        return 1.0
    w = np.linalg.eigvalsh(scaled(H)[0])
    return float(np.sqrt(w[-1] / w[0])) if w[0] > SINGULAR**2 * max(w[-1], 1e-300) else np.inf


def null_directions(H: Matrix) -> tuple[Bool[np.ndarray, " p"], Float[np.ndarray, "m p"]]:
    """Return the unknowns of zero columns, and directions along which no residual changes, as sparse as possible.

    A direction belongs to the null space if its singular value of the scaled J is below 1e-6 of the largest. The basis
    is brought to reduced row echelon form, so that each direction names as few unknowns as possible.
    """
    A, lengths = scaled(H)
    largest = lengths.max(initial=0.0)
    zero = lengths <= TINY**2 * largest if largest > 0 else np.ones(len(H), bool)  # per metre or per 1,000 km
    live = np.flatnonzero(~zero)
    if not len(live) or regular_inverse(A[np.ix_(live, live)], SINGULAR**2) is not None:
        return zero, np.zeros((0, len(H)))
    w, V = np.linalg.eigh(A[np.ix_(live, live)])
    basis = V[:, w < SINGULAR**2 * w[-1]].T
    for i in range(len(basis)):
        row, column = divmod(int(np.argmax(np.abs(basis[i:]))), basis.shape[1])
        basis[[i, i + row]] = basis[[i + row, i]]
        basis[i] /= basis[i, column]
        others = np.arange(len(basis)) != i
        basis[others] -= np.outer(basis[others, column], basis[i])
    directions = np.zeros((len(basis), len(H)))
    directions[:, live] = np.where(np.abs(basis) > 1e-4, basis, 0.0) / lengths[live]
    return zero, directions


def weak_directions(H: Matrix) -> list[Int[np.ndarray, " n"]]:
    """Return which unknowns take part in each direction along which the residuals hardly change.

    The singular value of the scaled J is between 1e-6 and 1e-3 of the largest there. An unknown takes part where it is
    at least a tenth of the largest component.
    """
    A, lengths = scaled(H)
    if regular_inverse(A, NEGLIGIBLE**2) is not None:
        return []
    w, V = np.linalg.eigh(A)
    weak = (w >= SINGULAR**2 * w.max(initial=0.0)) & (w < NEGLIGIBLE**2 * w.max(initial=0.0))
    shares = np.abs(V[:, weak]) * (lengths > 0)[:, None]
    return [np.flatnonzero(share > 0.1 * share.max()) for share in shares.T]


def relative_errors(unknowns: Sequence[Unknown], values: Vector, errors: Vector, scales: Vector) -> Vector:
    """Return each error over the size to compare it with: 1 for a logarithm, else the value or a vector's length.

    For a coordinate this is the object's size in `scales` if that is larger than the vector's length.
    """
    size, together = np.abs(values), by_quantity(unknowns)
    for j, unknown in enumerate(unknowns):
        if unknown.logarithmic:
            continue
        if not np.isfinite(unknown.lower):  # a component of a vector, or a black level, may be 0
            same = together[unknown.quantity]
            length = np.linalg.norm(values[same]) if len(same) > 1 else 0.0
            size[j] = max(length, scales[j]) or np.inf
    with np.errstate(over="ignore"):  # an infinite error over a tiny value
        relative = errors / np.where((size > 0) & np.isfinite(size), size, 1e-300)
    return np.where(np.isinf(size), 0.0, relative)


def vague(
    unknowns: Sequence[Unknown], values: Vector, errors: Vector, scales: Vector
) -> tuple[Bool[np.ndarray, " p"], Bool[np.ndarray, " p"]]:
    """Return the unknowns that are lost in the noise, and those that are 0 within it.

    A value is lost if its error is over 30 % of it, or over .5 in a logarithm. It is 0 within the noise instead if the
    value plus two errors is at most 30 % of `scales`: then it is known to be small.
    """
    log = logarithms(unknowns)
    lost = relative_errors(unknowns, values, errors, scales) > np.where(log, VAGUE_LOG, VAGUE)
    small = lost & ~log & (values + 2.0 * errors <= VAGUE * scales)
    return lost & ~small, small


def singular_notes(
    zero: Bool[np.ndarray, " p"], directions: Float[np.ndarray, "m p"], unknowns: Sequence[Unknown], values: Vector
) -> list[Note]:
    """Say which unknowns these views do not determine at all, and what to do about it."""
    notes = []
    if zero.any():
        names = some_channels(zero, unknowns)
        it = "it" if len(names) == 1 else "them"
        text = (
            f"these views do not determine {listing(names)}: no pixel changes with {it}. Fix {it}, or add a view that "
            f"shows {it}."
        )
        notes.append(Note(text, "not determined", tuple(names)))
    for direction in directions:
        names = tuple(quantities(unknowns, np.flatnonzero(direction)))
        notes.append(Note(sentence(direction, unknowns, values), "not separated", names))
    return list(dict.fromkeys(notes))


def weak_notes(directions: Sequence[Int[np.ndarray, " n"]], unknowns: Sequence[Unknown]) -> list[Note]:
    """Say which unknowns these views hardly separate."""
    notes = []
    for which in directions:
        names = quantities(unknowns, which)
        hardly = f"hardly separate {listing(names)}" if len(names) > 1 else f"hardly separate the parts of {names[0]}"
        text = (
            f"these views {hardly}: changed together, they change the pixels less than a thousandth as much as one by "
            f"one, so the errors are right only if the model is exact. {remedy(names, unknowns)}"
        )
        notes.append(Note(text, "hardly separated", tuple(names)))
    return list(dict.fromkeys(notes))


def vague_notes(
    lost: Bool[np.ndarray, " p"],
    small: Bool[np.ndarray, " p"],
    unknowns: Sequence[Unknown],
    values: Vector,
    errors: Vector,
    scales: Vector,
) -> list[Note]:
    """Say which unknowns are lost in the noise, by how much, and which are 0 within it."""
    notes = []
    relative = relative_errors(unknowns, values, errors, scales)
    for quantity in dict.fromkeys(u.quantity for u, here in zip(unknowns, lost, strict=True) if here):
        members = np.array([u.quantity == quantity for u in unknowns]) & lost
        worst = int(np.argmax(np.where(members, relative, -1.0)))
        names = some_channels(members, unknowns)
        if np.isinf(errors[worst]):
            size = "without limit"
        elif unknowns[worst].logarithmic:
            size = f"a factor of {np.exp(min(relative[worst], 99.0)):.2g}"
        elif values[worst]:
            size = f"{relative[worst]:.0%} of the value"
        else:
            size = f"{errors[worst]:.2g} with the value at 0"
        verb, its = ("is", "its error is") if len(names) == 1 else ("are", "the largest error is")
        advice = ONE_TOO_MANY if _beside_others(unknowns[worst], unknowns) else remedy([quantity], unknowns)
        text = f"{listing(names)} {verb} lost in the noise: {its} {size}. {advice}"
        notes.append(Note(text, "lost in noise", tuple(names)))
    if small.any():
        limits = [
            f"{u.name} {v + 2 * e:.2g}" for u, v, e, here in zip(unknowns, values, errors, small, strict=True) if here
        ]
        names = tuple(u.name for u, here in zip(unknowns, small, strict=True) if here)
        text = f"0 within the noise, with upper limits (value plus two errors): {listing(limits)}."
        notes.append(Note(text, "0 within noise", names))
    return notes


def _beside_others(unknown: Unknown, unknowns: Sequence[Unknown]) -> bool:
    """Whether an unknown is of one highlight of a material that has several."""
    owner = {(place.owner, place.item) for place in unknown.places[:1]}
    others = [place for place in free_places(unknowns) if "highlights" in place.fields]
    return unknown.kind in ("k_s", "n_s") and any((place.owner, place.item) in owner for place in others)


def remedy(names: Sequence[str], unknowns: Sequence[Unknown]) -> str:
    """Return a remedy: the parameter to fix, or the photograph to add."""
    kinds = {unknown.kind for unknown in unknowns if unknown.quantity in names}
    last = names[-1]
    if attenuation := of_attenuation(names, unknowns):
        add = "add photographs with the lamp at three distances, such as 2, 3 and 4.5"
        return f"Fix one, for example {attenuation[-1]}, or {add}."
    if kinds & {"n_s", "k_s"}:
        return f"Fix {last}, or add a photograph with the whole highlight on the object, not clipped."
    if kinds & {"position", "direction", "intensity"}:
        return f"Fix {last}, or add views in which this light shows on other sides of the object."
    return f"Fix {last}, or add a view that shows more of it."


def some_channels(which: Bool[np.ndarray, " p"], unknowns: Sequence[Unknown]) -> list[str]:
    """Return names of unknowns: the quantity's if all its channels are among them, else the channels'."""
    others = {u.quantity for u, here in zip(unknowns, which, strict=True) if not here}
    members = [u for u, here in zip(unknowns, which, strict=True) if here]
    return list(dict.fromkeys(u.name if u.quantity in others else u.quantity for u in members))
