"""Uncertainty: error bars, and in words what these images cannot tell. p x p matrices in NumPy float64."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from .parameters import Unknown

SINGULAR = 1e-6  # smallest singular value of J, columns of unit length, below which unknowns are not determined

Vector = Float[np.ndarray, " p"]
Matrix = Float[np.ndarray, "p p"]


def scaled(H: Matrix) -> tuple[Matrix, Vector]:
    """Return J^T J with the columns of J scaled to unit length, and their lengths; a zero column stays zero."""
    lengths = np.sqrt(np.diag(H))
    inverse = np.where(lengths > 0, 1.0 / np.where(lengths > 0, lengths, 1.0), 0.0)
    return H * np.outer(inverse, inverse), lengths


def condition_number(H: Matrix) -> float:
    """Return the condition number of J with columns of unit length; infinite where J is singular."""
    if not len(H):
        return 1.0
    w = np.linalg.eigvalsh(scaled(H)[0])
    return float(np.sqrt(w[-1] / w[0])) if w[0] > SINGULAR**2 * max(w[-1], 1e-300) else np.inf


def null_directions(H: Matrix) -> tuple[Bool[np.ndarray, " p"], Float[np.ndarray, "m p"]]:
    """Return the unknowns of zero columns, and directions along which no residual changes, as sparse as they come.

    A direction belongs to the null space where the singular value of the scaled J is below 1e-6 of the largest. The
    basis is brought to reduced row echelon form, so that each direction names as few unknowns as it can.
    """
    A, lengths = scaled(H)
    largest = lengths.max(initial=0.0)
    zero = lengths <= 1e-12 * largest if largest > 0 else np.ones(len(H), bool)
    live = np.flatnonzero(~zero)
    if not len(live):
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


def inverse(H: Matrix) -> Matrix:
    """Return (J^T J)^-1 through the scaled matrix, null directions left out (they do not touch what is determined)."""
    A, lengths = scaled(H)
    w, V = np.linalg.eigh(A)
    regular = w > SINGULAR**2 * w.max(initial=0.0)
    unit = np.where(lengths > 0, 1.0 / np.where(lengths > 0, lengths, 1.0), 0.0)
    return (V[:, regular] / w[regular]) @ V[:, regular].T * np.outer(unit, unit)


def plain_covariance(H: Matrix, sigma2: float) -> Matrix:
    """Return sigma^2 (J^T J)^-1, the covariance for independent noise of equal variance sigma^2."""
    return sigma2 * inverse(H)


def jackknife_covariance(
    H: Float[np.ndarray, "views p p"], g: Float[np.ndarray, "views p"], H_0: Matrix, g_0: Vector
) -> Matrix:
    """Return the covariance by deleting one view at a time, from the Gram of each view; t has views - 1 degrees.

    H_0 and g_0 are of what is known beside the views, and is never deleted.

    Without view v the optimum moves, to first order, by -(H - H_v)^-1 (g - g_v); the covariance is (G-1)/G times the
    sum of squared deviations of these moves from their mean (Tukey 1958; Efron and Tibshirani 1993, ch. 11).
    """
    G = len(H)
    H_all, g_all = H.sum(0) + H_0, g.sum(0) + g_0
    moves = np.array([-inverse(H_all - H_v) @ (g_all - g_v) for H_v, g_v in zip(H, g, strict=True)])
    deviations = moves - moves.mean(0)
    return (G - 1) / G * deviations.T @ deviations


def lone_views(H: Float[np.ndarray, "views p p"]) -> Int[np.ndarray, " p"]:
    """Return for each unknown the one view that alone sees it, such as the view's own exposure; -1 where several do."""
    seen = np.diagonal(H, axis1=1, axis2=2)
    sees = seen > 1e-12 * seen.max(0, initial=0.0)
    return np.where(sees.sum(0) == 1, sees.argmax(0), -1)


def without_lone(
    H: Float[np.ndarray, "views p p"], g: Float[np.ndarray, "views p"], H_0: Matrix, lone: Int[np.ndarray, " p"]
) -> tuple[Float[np.ndarray, "views s s"], Float[np.ndarray, "views s"]]:
    """Return the Gram of each view for the unknowns that several views see, at the best of those it alone sees.

    The Schur complement: a view that is deleted takes its own unknowns with it.
    """
    shared = lone < 0
    reduced_H, reduced_g = [], []
    for v, (H_v, g_v) in enumerate(zip(H, g, strict=True)):
        own = lone == v
        to_own = H_v[np.ix_(shared, own)] @ inverse((H_v + H_0)[np.ix_(own, own)])
        reduced_H.append(H_v[np.ix_(shared, shared)] - to_own @ H_v[np.ix_(own, shared)])
        reduced_g.append(g_v[shared] - to_own @ g_v[own])
    return np.array(reduced_H), np.array(reduced_g)


def deciding_view(H: Float[np.ndarray, "views p p"], H_0: Matrix) -> int | None:
    """Return a view without which less is determined than with it, so that there is no jackknife; or None."""

    def rank(H: Matrix) -> int:
        w = np.linalg.eigvalsh(scaled(H)[0])
        return int(np.sum(w > SINGULAR**2 * w.max(initial=0.0)))

    everything = H.sum(0) + H_0
    return next((v for v in range(len(H)) if rank(everything - H[v]) < rank(everything)), None)


def on_unit_vectors(covariance: Matrix, values: Vector, units: Int[np.ndarray, "u 3"]) -> Matrix:
    """Return the covariance without the lengths of unit vectors, which do not vary: P C P with P = 1 - d d^T."""
    P = np.eye(len(values))
    for unit in units:
        P[np.ix_(unit, unit)] -= np.outer(values[unit], values[unit])
    return P @ covariance @ P


def standard_errors(covariance: Callable[[Bool[np.ndarray, " p"]], Matrix], at_bound: Bool[np.ndarray, " p"]) -> Vector:
    """Return the standard errors, given the covariance of any subset of the unknowns.

    Unknowns at a bound do not move, so the others' errors are without them; the error of one at a bound is what it
    would be if it alone were free to pass.
    """
    inside = ~at_bound
    errors = np.zeros(len(at_bound))
    errors[inside] = np.sqrt(np.diag(covariance(inside)))
    for j in np.flatnonzero(at_bound):
        which = inside.copy()
        which[j] = True
        errors[j] = np.sqrt(np.diag(covariance(which))[np.flatnonzero(which) == j][0])
    return errors


def sentences(
    zero: Bool[np.ndarray, " p"], directions: Float[np.ndarray, "m p"], unknowns: Sequence[Unknown], values: Vector
) -> list[str]:
    """Say which unknowns these views do not determine, and what to do about it."""
    said = []
    if zero.any():
        others = {u.quantity for u, here in zip(unknowns, zero, strict=True) if not here}
        lost = [u for u, here in zip(unknowns, zero, strict=True) if here]  # all channels of it, or some
        names = list(dict.fromkeys(u.name if u.quantity in others else u.quantity for u in lost))
        it = "it" if len(names) == 1 else "them"
        said.append(
            f"these views do not determine {listing(names)}: no pixel changes with {it}. Fix {it}, or add a view that "
            f"shows {it}."
        )
    for direction in directions:
        sentence = _sentence(direction, unknowns, values)
        if sentence not in said:
            said.append(sentence)
    return said


# Along a scale gauge, what reflects and what fades light (it divides) grow as what sends light shrinks.
_GAUGE_SIGN = {"k_a": 1, "k_d": 1, "k_s": 1, "k_e": 1, "constant": 1, "linear": 1, "quadratic": 1}
_GAUGE_SIGN |= {"intensity": -1, "ambient": -1, "exposure": -1}
_FADERS = ("constant", "linear", "quadratic")


def _sentence(direction: Vector, unknowns: Sequence[Unknown], values: Vector) -> str:
    involved = np.flatnonzero(direction)
    names = _quantities(unknowns, involved)
    signs = np.array([_GAUGE_SIGN.get(unknowns[int(j)].quantity.split(".")[-1], 0) for j in involved])
    factors = signs * direction[involved] / np.where(values[involved] == 0, np.inf, values[involved])
    fix = next(
        (n for key in ("constant", "exposure", "intensity", "ambient") for n in names if n.split(".")[-1] == key),
        names[-1],
    )
    if not np.all(np.abs(factors - factors[0]) <= 1e-3 * np.abs(factors[0])) or factors[0] == 0:
        return (
            f"these views cannot separate {listing(names)}: they can be changed together without changing any pixel. "
            f"Fix one, for example {fix}, or add views from other distances or directions."
        )
    senders = _quantities(unknowns, involved[signs < 0])
    faders = [name for name in names if name.split(".")[-1] in _FADERS]
    others = [name for name in names if name not in (*senders, *faders)]
    if senders:
        return (
            f"these views cannot separate {listing(others + faders)} from {listing(senders)}: scaling the former up "
            f"and the latter down by one factor leaves every pixel unchanged. Fix one, for example {fix}."
        )
    pair = f"{listing(others)} from {listing(faders)}" if others and faders else listing(names)
    return (
        f"these views cannot separate {pair}: scaling all of them together leaves every pixel unchanged. "
        f"Fix one, for example {fix}."
    )


def _quantities(unknowns: Sequence[Unknown], which: Int[np.ndarray, " n"]) -> list[str]:
    """Return the names without their channels, each once."""
    return list(dict.fromkeys(unknowns[int(j)].quantity for j in which))


def listing(names: Sequence[str]) -> str:
    """Return names as a phrase: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
