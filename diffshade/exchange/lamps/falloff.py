"""Fall-off: the attenuation of a lamp from lux measured at several distances (E2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from ...core.fields import Numbers
from ...core.words import listing
from ...inverse.statistics.identifiability import VAGUE
from ...model.attenuation import RadialAttenuation

NAMES = ("constant", "linear", "quadratic")
ALIKE = 0.95  # correlation above which two numbers are one to the table


@dataclass(frozen=True)
class Falloff:
    """How a lamp fades with distance: `attenuation` for a light of intensity 1, and what the table tells of it."""

    attenuation: RadialAttenuation
    errors: Float[np.ndarray, "3"]
    """Standard errors of constant, linear and quadratic."""
    correlation: Float[np.ndarray, "3 3"]
    rms: float
    """Root mean square of lux/model - 1."""
    slope: float
    """d log lux / d log distance, by least squares: -2 of a lamp that is a point."""
    undetermined: tuple[str, ...]
    """The coefficients that the table does not determine: an error above 30 % of the value."""
    rows: int

    def __str__(self) -> str:
        values = [float(getattr(self.attenuation, name)) for name in NAMES]
        lines = [f"slope {self.slope:.3g} (log lux over log distance), residuals {100 * self.rms:.2g} % (rms)"]
        lines += [
            f"{name:<9} not determined" if name in self.undetermined else f"{name:<9} {value:.4g} +-{error:.2g}"
            for name, value, error in zip(NAMES, values, self.errors, strict=True)
        ]
        return "\n".join([*lines, *self.sentences])

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the table cannot tell, and what to do about it."""
        points, said = _count(self.rows), []
        vague = [NAMES.index(name) for name in self.undetermined]
        alike = [i for i in vague if any(abs(self.correlation[i, j]) > ALIKE for j in vague if j != i)]
        if len(alike) > 1:
            highest = max((self.correlation[i, j] for i in alike for j in alike if i < j), key=abs)
            names = listing([NAMES[i] for i in alike])
            said.append(
                f"{points} points do not separate {names}: what one takes from the curve the other gives back "
                f"(correlation {highest:.2f}). Measure nearer and farther, or set one to 0."
            )
        said += [
            f"{points} points do not determine {NAMES[i]}: its error is over {100 * VAGUE:.0f} % of it. Measure "
            "nearer and farther, or set it to 0."
            for i in vague
            if i not in alike
        ]
        return tuple(said)


def fit_falloff(distance: Numbers, lux: Numbers) -> Falloff:
    r"""Fit the attenuation of a lamp, each a at least 0, to a table of distances and lux (E2).

    $$ \min \sum (E (a_0 + a_1 d + a_2 d^2) - 1)^2 $$

    over the rows, E in lux: the relative error of each to first order, which is linear in the three (Lawson and Hanson
    1974): a light of intensity 1 with this attenuation gives lux at a distance in the table's unit. `distance`, `lux`:
    (N,), above 0, at least four rows at three distances. The standard errors take the scatter from the residuals.
    Raises ValueError for fewer rows or distances, and for a number that is not finite or not above 0.
    """
    d, E = (_column(name, value) for name, value in (("distance", distance), ("lux", lux)))
    if d.shape != E.shape or len(d) < 4 or len(np.unique(d)) < 3:
        raise ValueError(
            f"fit_falloff needs at least four rows at three distances, a lux for each; got {len(d)} and {len(E)}. "
            "Add rows."
        )
    powers = np.stack([d**0, d, d * d], -1)
    size = np.array([1.0, d.mean(), d.mean() ** 2])  # of one size at the mean distance, so that rounding is small
    A = E[:, None] * powers / size
    solution, _ = nnls(A, np.ones(len(d)))
    residuals = A @ solution - 1.0
    covariance = np.linalg.pinv(A.T @ A) * (residuals @ residuals) / (len(d) - 3)
    values, errors = solution / size, np.sqrt(np.diag(covariance)) / size
    spread = np.maximum(np.sqrt(np.diag(covariance)), 1e-300)
    vague = tuple(name for name, v, e in zip(NAMES, values, errors, strict=True) if e > VAGUE * v)
    slope = float(np.polyfit(np.log(d), np.log(E), 1)[0])
    return Falloff(
        RadialAttenuation(*values),
        errors,
        covariance / np.outer(spread, spread),
        float(np.sqrt(np.mean(residuals**2))),
        slope,
        vague,
        len(d),
    )


def _column(name: str, value: Numbers) -> Float[np.ndarray, " n"]:
    column = np.asarray(value, np.float64)
    if column.ndim != 1 or not (np.isfinite(column) & (column > 0)).all():
        raise ValueError(f"{name} must be a list of finite numbers above 0; got {value!r}. Leave the others out.")
    return column


def _count(n: int) -> str:
    words: Sequence[str] = ("four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
    return words[n - 4] if n < 4 + len(words) else str(n)
