"""Sketches: vectors, angles and rays, from the library's own values."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ...model.vectors import Vec3
from .pages import GREY, place
from .pictures import toward

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


RED = "#d1383d"
Point: TypeAlias = tuple[Any, Any]
Ends: TypeAlias = tuple[float, float]
LETTER: dict[str, Any] = {"fontsize": 15, "ha": "center", "va": "center"}


def sheet(figure: Figure, at: Ends, size: Ends, x: Ends, y: Ends, title: str = "", fontsize: float = 10) -> Axes:
    """Return axes of equal scales, without a frame: left and top, width and height on the page, and their ends."""
    axes = place(figure, *at, *size)
    axes.set(xlim=x, ylim=y, aspect="equal")
    axes.set_axis_off()
    axes.set_title(title, fontsize=fontsize, pad=4)
    return axes


def arrow(axes: Axes, tail: Point, tip: Point, colour: str = "black") -> None:
    """Draw an arrow."""
    style: dict[str, Any] = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, tail, arrowprops=style)


def ray(axes: Axes, *points: Point, colour: str = RED) -> None:
    """Draw a ray from point to point, with an arrowhead half-way along each part."""
    for tail, tip in itertools.pairwise(points):
        axes.plot([tail[0], tip[0]], [tail[1], tip[1]], color=colour, linewidth=1.8, solid_capstyle="round")
        middle = 0.45 * np.asarray(tail) + 0.55 * np.asarray(tip)
        before = middle + 0.1 * (np.asarray(tail) - middle)
        arrow(axes, (before[0], before[1]), (middle[0], middle[1]), colour)


def vector(axes: Axes, direction: Vec3, name: str, colour: str = "black") -> None:
    """Draw a unit vector from the origin, its name at the tip."""
    x, y = float(direction.x), float(direction.y)
    arrow(axes, (0, 0), (x, y), colour)
    axes.text(1.11 * x, 1.11 * y, f"${name}$", color=colour, **LETTER)


def arc(axes: Axes, start: float, end: float, radius: float, name: str, *, gap: float = 0.12) -> None:
    """Draw the arc between two angles from the upward normal (degrees, clockwise) about the origin, with its name."""
    along, middle = toward(np.linspace(start, end, 40)), toward(0.5 * (start + end))
    axes.plot(radius * along.x, radius * along.y, color=GREY, linewidth=1.2)
    x, y = (radius + gap) * middle.x, (radius + gap) * middle.y
    axes.text(float(x), float(y), name, ha="center", va="center", fontsize=10)
