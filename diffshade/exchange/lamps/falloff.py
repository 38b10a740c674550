"""Falloff: the attenuation of a lamp from lux measured at several distances (E2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from ...core.arrays import float64_of
from ...core.fields import Numbers
from ...core.tables import as_text, parameters
from ...core.thresholds import MINOR, VAGUE
from ...core.words import listing
from ...model.attenuation import RadialAttenuation

NAMES = RadialAttenuation.numbers()  # by the power of the distance


@dataclass(frozen=True)
class Falloff:
    """The attenuation of a lamp, for a light of intensity 1, with errors; `print` it for the table."""

    attenuation: RadialAttenuation
    errors: Float[np.ndarray, "3"]
    """Standard errors of constant, linear and quadratic."""
    correlation: Float[np.ndarray, "3 3"]
    rms: float
    """Root mean square of lux/model - 1."""
    slope: float
    """d log lux / d log distance, by least squares; -2 for a point light."""
    undetermined: tuple[str, ...]
    """The coefficients that the table does not determine: their errors exceed 30 % of the value."""
    rows: int

    def __str__(self) -> str:
        values = [float(getattr(self.attenuation, name)) for name in NAMES]
        known = [name not in self.undetermined for name in NAMES]
        return as_text(
            f"slope {self.slope:.3g} (log lux over log distance), residuals {100 * self.rms:.2g} % (rms)",
            parameters(NAMES, values, self.errors, known),
            notes=self.sentences,
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """What the table does not determine, and remedies."""
        points, notes = _count(self.rows), []
        vague = [NAMES.index(name) for name in self.undetermined]
        merged = [i for i in vague if any(abs(self.correlation[i, j]) > (1.0 - MINOR) for j in vague if j != i)]
        if len(merged) > 1:
            highest = max((self.correlation[i, j] for i in merged for j in merged if i < j), key=abs)
            notes.append(
                f"{points} points do not separate {listing([NAMES[i] for i in merged])} (correlation {highest:.2f}). "
                "Measure nearer and farther, or set one to 0."
            )
        notes += [
            f"{points} points do not determine {NAMES[i]}: its error exceeds {100 * VAGUE:.0f} % of its value. Measure "
            "nearer and farther, or set it to 0."
            for i in vague
            if i not in merged
        ]
        return tuple(notes)


def fit_falloff(distance: Numbers, lux: Numbers) -> Falloff:
    r"""Fit the attenuation of a lamp to measured distances and lux (E2).

    $$ \min \sum (E (a_0 + a_1 d + a_2 d^2) - 1)^2 $$

    over the rows, with E in lux and each a at least 0 (non-negative least squares; Lawson and Hanson 1974). This is the
    relative error to first order, and is linear in the three coefficients. A light of intensity 1 with this attenuation
    gives lux at a distance in the table's unit. The standard errors are by the scatter of the residuals.

    Args:
        distance: Distances, above 0, any unit; at least four rows at three different distances.
        lux: The lux at each distance, above 0.

    Returns:
        The attenuation, with errors and notes.

    Raises:
        ValueError: If there are too few rows or distances, or a number is not finite and above 0.
    """
    d, E = (_column(name, value) for name, value in (("distance", distance), ("lux", lux)))
    if d.shape != E.shape or len(d) < 4 or len(np.unique(d)) < 3:
        raise ValueError(
            "fit_falloff needs at least four rows at three different distances, with one lux each; got "
            f"{len(d)} distances and {len(E)} lux. Add rows."
        )
    powers = np.stack([d**0, d, d * d], -1)
    size = np.array([1.0, d.mean(), d.mean() ** 2])  # equal sizes at the mean distance, for small rounding errors
    A = E[:, None] * powers / size
    solution, _ = scipy.optimize.nnls(A, np.ones(len(d)))
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
    column = float64_of(name, value)
    if column.ndim != 1 or not (np.isfinite(column) & (column > 0)).all():
        raise ValueError(f"{name} must be a list of finite numbers above 0; got {value!r}. Remove the other rows.")
    return column


def _count(n: int) -> str:
    words: Sequence[str] = ("four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
    return words[n - 4] if n < 4 + len(words) else str(n)
