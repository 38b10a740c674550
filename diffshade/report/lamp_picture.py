"""Lamp picture: a polar diagram of a lamp's intensity, its summary, and the light on a plane before it."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.backend import in_float64
from ..core.extras import needing
from ..core.fields import check_kind, in_short
from ..model.measured_lights import MeasuredLight
from ..model.photometry import plane
from ..model.vectors import Vec3, cross, dot, normalize
from .figures import DPI

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INCH = 5.0
PIXELS = 121
WIDTH = 2.0  # of the plane, over its distance
LETTERS, LINE = 130, 0.14  # of a line of the summary, and its height in inches
LINES = 5  # of equal light, at most


class PlaneLight(NamedTuple):
    """The light on a plane across a lamp's axis."""

    across: Float[np.ndarray, " n"]
    """Distances from the axis, along `side` and across it."""
    light: Float[np.ndarray, "n n"]
    """The light at each, in lux for candela and metres; row 0 is on the side of C = 90, column 0 on that of C = 180."""


def light_on_plane(lamp: MeasuredLight, distance: float, count: int = PIXELS) -> PlaneLight:
    """Return the light that a lamp sends to a plane across its axis, which is twice as wide as it is distant.

    Args:
        lamp: The lamp.
        distance: From the lamp to the plane, scene units; below 0 the plane is behind the lamp, as a ceiling is.
        count: Points along each side.

    Raises:
        ValueError: The distance is 0 or not finite.
    """
    check_kind("lamp", lamp, MeasuredLight, "read_lamp('lamp.ies')")
    if not 0 < abs(distance) < np.inf:
        raise ValueError(
            f"the distance must be finite and not 0; got {in_short(distance)}. Give for example 3, or -3 for a ceiling."
        )
    along = np.linspace(-WIDTH / 2, WIDTH / 2, count) * abs(distance)
    with in_float64(lamp) as lamp:
        axis = normalize(Vec3.of(lamp.direction))
        side = Vec3.of(lamp.side)
        x = normalize(side - axis * dot(side, axis))
        y = cross(x, axis)
        p = Vec3.of(lamp.position) + axis * distance + x * along[None, :] + y * along[::-1, None]
        l, intensity = lamp.arriving(p)
        light = np.asarray(intensity.stack()).mean(-1) * np.asarray(-dot(l, axis)) * np.sign(distance)
    return PlaneLight(along, light)


def unit_of_light(unit: str) -> str:
    """Return the unit of light on a plane for one of intensity."""
    return "lux" if unit == "cd" else f"{unit.removesuffix('/sr')} per unit of area"


def draw_lamp(lamp: MeasuredLight, *, distance: float = 3.0) -> Figure:
    """Draw a lamp: its intensity over angle, its summary, and the light on a plane across its axis.

    Args:
        lamp: The lamp.
        distance: From the lamp to the plane, metres for lux; 3 by default. Below 0 the plane is behind the lamp, as a
            ceiling is.

    Returns:
        The figure; a notebook shows it, and `write_figure` writes it.

    Raises:
        ValueError: If the distance is 0 or not finite.
        ImportError: matplotlib is not installed.
    """
    with needing("figures", "cannot draw a lamp"):
        from matplotlib.figure import Figure
    shown = light_on_plane(lamp, distance)
    words = "\n".join(textwrap.fill(line, LETTERS, subsequent_indent="  ") for line in str(lamp).splitlines())
    below = LINE * (words.count("\n") + 3)
    figure = Figure(figsize=(2 * INCH, INCH + below), dpi=DPI, layout="constrained")
    rows: Any = figure.add_gridspec(2, 2, height_ratios=(INCH, below))
    _polar(figure.add_subplot(rows[0, 0], projection="polar"), lamp)
    _plane(figure, figure.add_subplot(rows[0, 1]), shown, distance, lamp.label.unit)
    text = figure.add_subplot(rows[1, :])
    text.set_axis_off()
    text.text(0.0, 1.0, words, va="top", family="monospace", fontsize=8, in_layout=False)
    return figure


def _polar(axes: Any, lamp: MeasuredLight) -> None:
    from matplotlib.ticker import MaxNLocator

    profile, peak = lamp.profile, float(np.mean(lamp.intensity))
    vertical, horizontal = np.asarray(profile.vertical), np.asarray(profile.horizontal)
    values = np.asarray(profile.values) * peak
    angles, seen = np.roll(np.arange(15, 360, 30), -4), np.zeros(12)  # between those that are named
    for C, colour in ((0.0, "tab:red"), (90.0, "tab:blue"))[: 1 if len(horizontal) == 1 else 2]:
        name = "all planes" if len(horizontal) == 1 else f"C{C:g} and C{C + 180:g}"
        for sign, at in ((1.0, C), (-1.0, C + 180.0)):
            row = plane(horizontal, values, at)
            axes.plot(sign * np.deg2rad(vertical), row, color=colour, lw=1.5, label=name if sign > 0 else None)
            seen = np.maximum(seen, np.interp(sign * angles % 360, vertical, row, left=0.0, right=0.0))
    axes.set_theta_zero_location("S")  # the axis points down
    axes.set_thetagrids(np.arange(0, 360, 30), [f"{min(a, 360 - a)}°" for a in range(0, 360, 30)])
    axes.set_rlabel_position(angles[seen.argmin()])  # where the least light goes, clear of the curve
    axes.yaxis.set_major_locator(MaxNLocator(LINES))
    axes.tick_params(labelsize=7)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, fontsize=7, frameon=False)  # clear of angles
    axes.set_title(f"intensity, {lamp.label.unit}", fontsize=9)


def _plane(figure: Any, axes: Any, shown: PlaneLight, distance: float, unit: str) -> None:
    ends = (shown.across[0], shown.across[-1]) * 2
    top = float(shown.light.max())
    image = axes.imshow(shown.light, cmap="inferno", extent=ends, vmax=top or 1.0)
    levels = _round_numbers(float(shown.light.min()), top)
    if levels:
        lines = axes.contour(shown.across, shown.across[::-1], shown.light, levels, colors="white", linewidths=0.7)
        axes.clabel(lines, fmt="%g", fontsize=7)
    figure.colorbar(image, ax=axes, shrink=0.8, label=unit_of_light(unit))
    side = "on a plane behind the lamp, such as a ceiling," if distance < 0 else "on a plane"
    axes.set_title(f"{side} at a distance of {abs(distance):g} {'m' if unit == 'cd' else 'units'}", fontsize=9)
    axes.set_xlabel("along C0", fontsize=8)
    axes.set_ylabel("along C90", fontsize=8)
    axes.tick_params(labelsize=7)


def _round_numbers(low: float, high: float) -> list[float]:
    """Return the largest of 1, 2, 5, 10, 20, 50 and so on, and of their tenths, between two numbers."""
    if not high > max(low, 0.0):
        return []
    most = int(np.floor(np.log10(high)))
    series = [float(f"{digit}e{power}") for power in range(most - LINES, most + 1) for digit in (1, 2, 5)]
    return [number for number in series if low < number < high][-LINES:]
