"""Spectra: the fitted values and the residuals of a scene of bands, drawn over the bands."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...diagnosis.examination import Examination
from ...inverse.result import Fit
from ...model.bands import wavelength
from .charts import Chart, Frame, Ticks, Vector, errors_of_each
from .pictures import evenly

MOST_NAMES = 4  # below an axis


def spectra(fit: Fit, examination: Examination | None) -> list[Chart]:
    """Draw each quantity that has values of its own in several bands, with the interval of 95 %."""
    bands = fit.scene.bands
    found = []
    for quantity in dict.fromkeys(unknown.quantity for unknown in fit.unknowns):
        at = {u.channel: j for j, u in enumerate(fit.unknowns) if u.quantity == quantity}
        if len(bands) > 1 and set(at) == set(bands):
            found.append(_spectrum(fit, examination, quantity, [at[band] for band in bands]))
    return found


def _spectrum(fit: Fit, examination: Examination | None, quantity: str, members: Sequence[int]) -> Chart:
    bands = fit.scene.bands
    values, errors = fit.values[members], fit.errors[members]
    known = (fit.determined if examination is None else examination.determined)[members]
    low, high = values - 1.96 * errors, values + 1.96 * errors
    if examination is not None:
        low, high = examination.interval_95[members].T
    drawn = np.flatnonzero(known & np.isfinite(low) & np.isfinite(high))
    label, x = _axis(bands)
    if len(drawn) < 2:
        words = f"{len(drawn)} of the {len(bands)} bands are determined, too few to draw."
        return Chart(quantity, label, "value", (), (), words=words)
    least, most = float(low[drawn].min()), float(high[drawn].max())
    margin = 0.08 * (most - least) or 1e-12
    frame = Frame((float(x.min()), float(x.max())), (least - margin, most + margin))
    lowest, highest = (int(drawn[np.argmin(sign * values[drawn])]) for sign in (1, -1))
    words = (
        f"From {values[lowest]:.3g} at {bands[lowest]} to {values[highest]:.3g} at {bands[highest]}; the largest error "
        f"is {np.max(high[drawn] - low[drawn]) / 3.92:.2g}."
    )
    if len(drawn) < len(bands):
        words += f" {len(bands) - len(drawn)} of the {len(bands)} bands are not determined and left out."
    drawn = drawn[np.argsort(x[drawn], kind="stable")]
    tips = [f"{quantity}.{bands[i]} = {values[i]:.4g}: {low[i]:.4g} to {high[i]:.4g}" for i in drawn]
    dots = [(frame.across(float(x[i])), frame.up(float(values[i])), tip) for i, tip in zip(drawn, tips, strict=True)]
    band, line = frame.band(x[drawn], low[drawn], high[drawn]), frame.path(x[drawn], values[drawn])
    chart = frame.chart(quantity, label, "value", words=words, band=band, line=line, dots=tuple(dots))
    return chart if label.endswith("nm") else dataclasses.replace(chart, x_ticks=_names(frame, bands))


def errors_of_bands(errors: Vector, bands: Sequence[str]) -> Chart:
    """Draw the error of each band."""
    chart = errors_of_each(errors, bands, title="Each band", x_label="band")
    return dataclasses.replace(chart, x_ticks=_names(Frame((-0.5, len(bands) - 0.5), (0.0, 1.0)), bands))


def _axis(bands: Sequence[str]) -> tuple[str, Vector]:
    """Return the label of the axis of bands, and where each band is on it."""
    lengths = [wavelength(band) for band in bands]
    if None in lengths:
        return "band", np.arange(len(bands), dtype=float)
    return "wavelength, nm", np.array(lengths, float)


def _names(frame: Frame, bands: Sequence[str]) -> Ticks:
    """Return the positions and names of a few bands."""
    return tuple((frame.across(i), bands[i]) for i in evenly(len(bands), MOST_NAMES))
