"""Tables: the rows of a page, as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.tables import rounded, rows_of
from ...diagnosis.examination import Examination
from ...diagnosis.prediction_bands import PredictionBands
from ...inverse.result import Fit, Prediction

REACH = 0.3  # the longest whisker, over the value; a value with a larger error is not determined
MOST_CORRELATED = 40  # unknowns; with more, only the strongest pairs are shown
STRONGEST = 5
LONGEST = 16  # letters of a name next to a correlation


@dataclass(frozen=True)
class Row:
    """A parameter of the fit; its intervals are relative to the value, in units of the table's reach."""

    name: str
    value: str
    error: str
    interval: str
    remark: str
    interval_68: tuple[float, float] | None = None
    interval_95: tuple[float, float] | None = None


@dataclass(frozen=True)
class PageTable:
    """Rows of text under a header."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str]


def bands(made: PredictionBands, predictions: Sequence[Prediction]) -> dict[str, str]:
    """Return how often samples of photographs that were left out lie inside their bands, in words."""
    inside = [p.coverage for p in predictions if np.isfinite(p.coverage)]
    return {
        "level": f"{made.level:.0%}",
        "source": made.source,
        "inside": f"{np.mean(inside):.0%}" if inside else "none",
        "least": f"{min(inside):.0%}" if inside else "none",
    }


def parameters(fit: Fit, examination: Examination | None) -> dict[str, Any]:
    """Return a row for every parameter, with its error, and with its interval if there is an examination.

    And how far a drawing reaches, what kind of errors they are, and the quantities with a value that is not determined.
    """
    known = fit.determined if examination is None else examination.determined
    errors = fit.errors if examination is None else examination.errors
    made = fit.what_errors_hold(fit.clusters)
    kind = (
        "Errors are the examination's standard errors; the true value lies inside the interval 95 % of the time."
        if examination is not None
        else f"The true value lies within 1.96 errors 95 % of the time. Errors: {made}"
    )
    interval_68, interval_95 = (
        (examination.interval_68, examination.interval_95)
        if examination is not None
        else (np.stack([fit.values - k * errors, fit.values + k * errors], -1) for k in (1.0, 1.96))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = [(ends - fit.values[:, None]) / np.abs(fit.values)[:, None] for ends in (interval_68, interval_95)]
    drawn = known & np.isfinite(relative[1]).all(-1)
    reach = float(np.clip(1.1 * np.abs(relative[1][drawn]).max(initial=1e-6), 1e-6, REACH))
    rows = []
    for j, name in enumerate(fit.names):
        if not known[j]:
            rows.append(Row(name, "", "", "", "not determined"))
            continue
        side = "+" if fit.at_lower[j] else "−" if fit.at_bound[j] else "±"
        remark = "at a bound" if fit.at_bound[j] else ""
        interval = "" if examination is None else _range(interval_95[j], errors[j])
        error = f"{side}{rounded(errors[j], errors[j])}"
        one, two = ((float(low), float(high)) for low, high in (np.clip(r[j] / reach, -1.0, 1.0) for r in relative))
        whiskers = (one, two) if drawn[j] else (None, None)
        rows.append(Row(name, rounded(fit.values[j], errors[j]), error, interval, remark, *whiskers))
    unknown = dict.fromkeys(u.quantity for u, here in zip(fit.unknowns, known, strict=True) if not here)
    return {"rows": rows, "reach": reach, "kind": kind, "unknown": tuple(unknown)}


def _range(ends: np.ndarray, error: float) -> str:
    return " to ".join(rounded(float(end), float(error)) for end in ends)


def correlations(fit: Fit) -> dict[str, Any]:
    """Return the correlations of what is determined, each as strength, sign and words, and the strongest pairs.

    Labels are the names; long ones are abbreviated.
    """
    which = np.flatnonzero(np.diag(fit.covariance) > 0)
    correlation = fit.correlation[np.ix_(which, which)]
    names = tuple(fit.names[j] for j in which)
    upper = np.abs(np.triu(correlation, 1))
    order = [divmod(int(k), len(which)) for k in np.argsort(-upper, axis=None)[:STRONGEST]] if len(which) else []
    strongest = [f"{names[i]} and {names[j]}: {correlation[i, j]:+.2f}" for i, j in order if upper[i, j] > 0.1]
    labels = tuple(name if len(name) <= LONGEST else f"{name[:5]}…{name[-10:]}" for name in names)
    drawn = 1 < len(which) <= MOST_CORRELATED
    cells = [
        [
            (round(abs(float(c)), 3), "negative" if c < 0 else "positive", f"{names[i]}, {names[j]}: {c:+.2f}")
            for j, c in enumerate(row)
        ]
        for i, row in enumerate(correlation if drawn else ())
    ]
    said = [pair.replace("-", "−") for pair in strongest]
    return {"names": names, "labels": labels, "cells": cells, "strongest": said}


def shown(columns: Mapping[str, Any], notes: Sequence[str] = (), which: slice = slice(None)) -> PageTable:
    """Return the table of a result, of these columns, or some of its rows."""
    head, *rows = ([cell.replace("+-", "±") for cell in row] for row in rows_of(columns))
    return PageTable(head, rows[which], notes)
