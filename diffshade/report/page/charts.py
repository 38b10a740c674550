"""Charts: the geometry of small drawings, which the page's template writes as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Shaped

from ...core.thresholds import SINGLE
from ...diagnosis.examination import Examination
from ...inverse.result import Fit
from .residuals import Curve, Residuals

Ticks: TypeAlias = tuple[tuple[float, str], ...]
Bar: TypeAlias = tuple[float, float, float, float, str]
Vector: TypeAlias = Shaped[np.ndarray, " n"]
WIDTH, HEIGHT = 340, 210  # as charts.html has them
LEFT, RIGHT, TOP, BOTTOM = 66, 12, 12, 40


@dataclass(frozen=True)
class Chart:
    """A drawing: its axes, paths, dots and bars, in pixels."""

    title: str
    x_label: str
    y_label: str
    x_ticks: Ticks
    y_ticks: Ticks
    words: str = ""
    """What the chart shows, as text; it is read to blind users too."""
    band: str = ""
    line: str = ""
    curve: str = ""
    """A second line for comparison."""
    dots: tuple[tuple[float, float, str], ...] = ()
    """Position and tooltip."""
    bars: tuple[Bar, ...] = ()
    zero: float | None = None
    """Height of the line at 0."""
    verticals: tuple[tuple[float, str], ...] = ()
    """Positions of vertical lines, and their names."""
    foremost: bool = False
    """Whether it is shown without a click."""


@dataclass(frozen=True)
class Frame:
    """The mapping from data to pixels."""

    x: tuple[float, float]
    y: tuple[float, float]
    log: bool = False
    """Whether y holds decimal logarithms."""

    def across(self, x: float | int | np.number) -> float:
        """Return the horizontal position of x."""
        return round(LEFT + (float(x) - self.x[0]) / (self.x[1] - self.x[0]) * (WIDTH - LEFT - RIGHT), 2)

    def up(self, y: float | int | np.number) -> float:
        """Return the vertical position of y."""
        return round(HEIGHT - BOTTOM - (float(y) - self.y[0]) / (self.y[1] - self.y[0]) * (HEIGHT - TOP - BOTTOM), 2)

    def path(self, x: Vector, y: Vector) -> str:
        """Return a path through points."""
        return "M" + "L".join(f"{self.across(float(a))},{self.up(float(b))}" for a, b in zip(x, y, strict=True))

    def band(self, x: Vector, low: Vector, high: Vector) -> str:
        """Return the area between two curves."""
        return self.path(np.append(x, x[::-1]), np.append(low, high[::-1])) + "Z"

    def x_ticks(self, *, whole: bool = False) -> Ticks:
        """Return the positions and labels of round numbers on the x axis; `whole`: whole numbers only."""
        return tuple((self.across(v), _short(v)) for v in _round_numbers(self.x, 5, whole=whole))

    def y_ticks(self) -> Ticks:
        """Return the positions and labels of round numbers on the y axis."""
        numbers = _round_numbers(self.y, 4, whole=self.log)
        return tuple((self.up(v), f"1e{v:g}" if self.log else _short(v)) for v in numbers)

    def bar(self, left: float, right: float, y: float | np.number, words: str, *, gap: float = 0.0) -> Bar:
        """Return a bar from 0 to y, with a gap of so many pixels to the next."""
        x, top = self.across(left), self.up(y)
        return x, top, round(max(self.across(right) - x - gap, 0.2), 2), round(self.up(0.0) - top, 2), words

    def chart(self, title: str, x_label: str, y_label: str, *, whole: bool = False, **drawn: Any) -> Chart:
        """Return a chart with round numbers on both axes, on x `whole` ones only."""
        return Chart(title, x_label, y_label, self.x_ticks(whole=whole), self.y_ticks(), **drawn)


def _round_numbers(ends: tuple[float, float], most: int, *, whole: bool = False) -> list[float]:
    """Return the multiples of 1, 2, 2.5 or 5 times a power of ten on an axis, with `most` steps between its ends."""
    ends_apart = ends[1] - ends[0]
    decade = 10.0 ** np.floor(np.log10(ends_apart / most))
    steps = decade * np.array([1.0, 2.0, 2.5, 5.0, 10.0])
    if whole:
        steps = np.maximum(np.rint(steps), 1.0)
    step = steps[ends_apart <= most * steps * (1.0 + SINGLE)][0]
    first, last = np.ceil(ends[0] / step - SINGLE), np.floor(ends[1] / step + SINGLE)
    return [float(step * k) for k in np.arange(first, last + 1.0) + 0.0]


def _short(value: float) -> str:
    return f"{value:.10g}".replace("-", "−")


def over_angle(curve: Curve, title: str, x_label: str, rmse: float) -> Chart:
    """Draw residuals over an angle: their mean, and the central 80 %."""
    reach = 1.15 * max(float(np.abs([curve.low, curve.high, curve.mean]).max()), 1e-12)
    top = 1.03 * float(curve.angle[-1])
    frame = Frame((0.0, top), (-reach, reach))
    by_chance = 2.0 * rmse / np.sqrt(curve.count)
    worst = int((np.abs(curve.mean) - by_chance).argmax())
    words = (
        f"The mean deviates most at {curve.angle[worst]:.0f}°: {_signed(curve.mean[worst])}, "
        f"{abs(curve.mean[worst]) / max(rmse, 1e-300):.2g} times the RMSE. Independent noise alone stays within "
        f"±{by_chance[worst]:.1g}."
    )
    rows = zip(curve.angle, curve.mean, curve.count, strict=True)
    dots = [(frame.across(a), frame.up(m), f"{a:.0f}°: mean {_signed(m)} of {c:,} samples") for a, m, c in rows]
    return frame.chart(
        title,
        x_label,
        "fit − photograph",
        words=words,
        band=frame.band(curve.angle, curve.low, curve.high),
        line=frame.path(curve.angle, curve.mean),
        dots=tuple(dots),
        zero=frame.up(0.0),
    )


def histogram(residuals: Residuals) -> Chart:
    """Draw the histogram of the residuals, with that of normal noise of the same RMSE."""
    values = residuals.values
    rms = float(np.sqrt(np.mean(values**2))) or 1e-12
    edges = np.linspace(-4.0 * rms, 4.0 * rms, 49)
    counts, _ = np.histogram(values, edges)
    share = counts / len(values)
    middle = 0.5 * (edges[1:] + edges[:-1])
    normal = np.exp(-0.5 * (middle / rms) ** 2) * (edges[1] - edges[0]) / (rms * np.sqrt(2.0 * np.pi))
    frame = Frame((float(edges[0]), float(edges[-1])), (0.0, 1.12 * float(max(share.max(), normal.max()))))
    bars = [
        frame.bar(left, right, of, f"{_signed(left)} to {_signed(right)}: {of:.2%}", gap=0.6)
        for left, right, of in zip(edges[:-1], edges[1:], share, strict=True)
    ]
    beyond = float(np.mean(np.abs(values) > 3.0 * rms))
    return frame.chart(
        "Histogram",
        "fit − photograph",
        "share of samples",
        words=f"{beyond:.2%} of the samples exceed three times the RMSE; for normal noise (the line), 0.27% would.",
        bars=tuple(bars),
        curve=frame.path(middle, normal),
    )


def convergence(fit: Fit) -> Chart | None:
    """Draw the cost of each pass above the lowest cost; None if there were too few passes."""
    above = fit.costs - fit.costs.min(initial=np.inf) if len(fit.costs) else fit.costs
    passes = np.flatnonzero(above > 0)
    if len(passes) < 2:
        return None
    y = np.log10(above[passes] / max(float(fit.costs.min()), 1e-300))
    frame = Frame(
        (0.0, float(max(passes[-1], 1))), (float(np.floor(y.min())), float(np.ceil(y.max() + 1e-9))), log=True
    )
    points = zip(passes, y, above[passes], strict=True)
    return frame.chart(
        "Convergence",
        "pass over all pixels",
        "cost above the lowest, relative",
        whole=True,
        words=f"The cost fell from {fit.costs[0]:.6g} to {fit.costs.min():.6g} in {fit.steps} passes over all pixels.",
        line=frame.path(passes, y),
        dots=tuple((frame.across(k), frame.up(v), f"pass {k}: {a:.3g} above") for k, v, a in points),
    )


def profile(examination: Examination, j: int) -> Chart | None:
    """Draw the profile of an unknown, the rise of the cost in squares of errors; None if it was not evaluated."""
    name, points = examination.fit.names[j], examination.profiles[j]
    points = points[np.concatenate([[True], np.diff(points[:, 0]) > 0])]
    if len(points) < 4 or not np.any(points[:, 1] > 0):
        return None
    t, rise = _smooth(points)
    interval_68, interval_95 = examination.interval_68[j], examination.interval_95[j]
    frame = Frame((float(t[0]), float(t[-1])), (0.0, 1.08 * float(rise.max())))
    words = f"68 %: {interval_68[0]:.5g} to {interval_68[1]:.5g}; 95 %: {interval_95[0]:.5g} to {interval_95[1]:.5g}."
    if not examination.determined[j]:
        words += f" Nevertheless {name} is not determined; see the notes above."
    dots = [(frame.across(x), frame.up(e * e), f"{name} = {x:.6g}: {e:.2f} errors away") for x, e in points]
    inside = [
        (v, words) for ends, words in ((interval_68, "68 %"), (interval_95, "95 %")) for v in ends if t[0] <= v <= t[-1]
    ]
    return frame.chart(
        f"Profile of {name}",
        name,
        "rise of the cost, errors²",
        words=words,
        line=frame.path(t, rise),
        dots=tuple(dots),
        verticals=tuple((frame.across(v), words) for v, words in inside),
        foremost=examination.fit.unknowns[j].kind == "n_s",
    )


def _smooth(points: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Return a curve through a profile, by monotone interpolation of the signed distance in errors."""
    from scipy.interpolate import PchipInterpolator

    lowest = int(points[:, 1].argmin())
    signed = np.where(np.arange(len(points)) < lowest, -points[:, 1], points[:, 1])
    t = np.linspace(points[0, 0], points[-1, 0], 81)
    return t, np.asarray(PchipInterpolator(points[:, 0], signed)(t)) ** 2


def errors_of_each(
    errors: Vector, names: Sequence[str], label: str = "RMSE", title: str = "Each view", x_label: str = "view"
) -> Chart:
    """Draw one error for each view, or for each band."""
    known = np.nan_to_num(errors)
    frame = Frame((-0.5, len(known) - 0.5), (0.0, 1.12 * float(max(known.max(), 1e-12))))
    each = enumerate(zip(known, names, strict=True))
    bars = [frame.bar(i - 0.4, i + 0.4, of, f"{name}: {label} {of:.3g}") for i, (of, name) in each]
    worst = int(known.argmax())
    words = f"The largest is {known[worst]:.3g} ({names[worst]}); the median is {np.median(known):.3g}."
    return frame.chart(title, x_label, label, whole=True, words=words, bars=tuple(bars))


def _signed(value: float | np.number) -> str:
    return f"{value:+.2g}".replace("-", "−")
