"""Calibration picture: the outline of each ball, the highlights on it, and which way each light is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.extras import needing
from ..io.encodings import brightened
from ..model.cameras import OrthographicCamera
from .figures import DPI

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..calibration.result import Calibration

INCH = 4.5
LABELLED = 40  # lights at most that have their numbers
MARGIN = 1.25  # radii from a ball's middle that are drawn


def draw_calibration(balls: Sequence[Calibration] | Calibration) -> Figure:
    """Draw what a calibration found, so that a wrong outline is seen.

    A row for each ball: the mean of its photographs there, brightened, with the outline and each light's highlight; and
    the directions to the lights, as seen from the camera, with their errors. Lights have the numbers of their
    photographs.

    Args:
        balls: The calibration, or those of several balls.

    Returns:
        The figure; a notebook shows it, and `write_figure` writes it.

    Raises:
        ImportError: matplotlib is not installed.
    """
    with needing("figures", "cannot draw a calibration"):
        from matplotlib.figure import Figure
    each: Sequence[Calibration] = balls if isinstance(balls, Sequence) else (balls,)
    figure = Figure(figsize=(2 * INCH, INCH * len(each)), dpi=DPI, layout="constrained")
    axes: Any = figure.subplots(len(each), 2, squeeze=False)
    for row, ((left, right), found) in enumerate(zip(axes, each, strict=True), start=1):
        which = f"{found.ball} ball {row} of {len(each)}" if len(each) > 1 else f"{found.ball} ball"
        _outline(left, found, which)
        _directions(right, found)
    return figure


def _outline(axes: Any, found: Calibration, which: str) -> None:
    from matplotlib.patheffects import withStroke

    on_any = [withStroke(linewidth=1.5, foreground="black")]  # readable on a highlight as well as beside it
    centres, radii = np.array([b.middle for b in found.balls]), np.array([[b.radius] for b in found.balls])
    (left, top), (right, bottom) = (centres - MARGIN * radii).min(0), (centres + MARGIN * radii).max(0)
    height, width = found.camera.shape
    left, top, right, bottom = max(left, 0.0), max(top, 0.0), min(right, width), min(bottom, height)
    y0, y1, x0, x1 = int(top), int(np.ceil(bottom)), int(left), int(np.ceil(right))
    mean = np.mean([np.asarray(image[y0:y1], np.float64)[:, x0:x1].mean(-1) for image in found.images], 0)
    axes.imshow(brightened(mean), cmap="gray", extent=(x0, x1, y1, y0))
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    for ball in found.balls:
        column, row = ball.middle
        axes.plot(column + ball.radius * np.cos(angle), row + ball.radius * np.sin(angle), "-", color="tab:red", lw=1)
        if found.ball == "mirror" and isinstance(found.camera, OrthographicCamera):
            half = _seen(found) + np.array([0.0, 0.0, 1.0])  # a distant camera on +z sees l at the normal of h
            half /= np.linalg.norm(half, axis=-1, keepdims=True)
            at = np.stack([column + ball.radius * half[:, 0], row - ball.radius * half[:, 1]], -1)
            axes.plot(at[:, 0], at[:, 1], "+", color="tab:orange", ms=7, path_effects=on_any)
            for i, (x, y) in enumerate(at[:LABELLED]):
                _number(axes, i, x, y, color="orange", path_effects=on_any)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_title(f"{which}: the outline must lie on its edge", fontsize=9)
    axes.set_axis_off()


def _seen(found: Calibration) -> np.ndarray:
    """Return the directions to the lights along the camera's right, up and backward axes."""
    return found.directions @ found.balls[0].axes.T


def _number(axes: Any, i: int, x: float, y: float, **drawn: Any) -> None:
    axes.annotate(str(i + 1), (x, y), fontsize=7, xytext=(3, 3), textcoords="offset points", **drawn)


def _directions(axes: Any, found: Calibration) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    d = _seen(found)
    farthest = np.rad2deg(np.arccos(np.clip(d[:, 2].min(), -1.0, 1.0)))
    for degrees in [degrees for degrees in (30, 60, 90) if degrees < farthest + 30]:
        r = np.sin(np.deg2rad(degrees))
        axes.plot(r * np.cos(angle), r * np.sin(angle), "-", color="0.8", lw=0.8)
        axes.annotate(f"{degrees}°", (0.0, r), fontsize=7, color="0.5", ha="center", va="bottom")
    axes.errorbar(
        d[:, 0], d[:, 1], np.deg2rad(found.errors), np.deg2rad(found.errors), fmt=".", color="tab:orange", ms=3, lw=0.8
    )
    for i, (x, y) in enumerate(d[:LABELLED, :2]):
        _number(axes, i, x, y)
    axes.set_aspect("equal")
    axes.set_title("directions to the lights, from the camera; degrees off its axis", fontsize=9)
    axes.set_axis_off()
