"""Rays: how the light of a lamp, and of a light at infinity, reaches surfaces (E2, E4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from ...core.fields import Array
from ...model.cameras import Rays
from ...model.lights import AbstractEmitter, DirectionalLight, PointLight
from ...model.surfaces import Plane, Sphere
from ...model.vectors import Vec3
from .pages import page
from .pictures import evaluate, toward
from .sketches import LETTER, arrow, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLOOR, BALL = Plane((0, -1, 0)), Sphere((0.9, -0.4, 0), 0.6)
LAMP, SUN = PointLight((-0.7, 1.0, 0)), DirectionalLight((0.55, -1, 0))
LIGHT = "#e0a000"
WIDTH = 2.2  # half of a panel


def rays_of_light() -> Figure:
    """Draw the rays of a point light and of a light at infinity, each as far as the surface that it meets."""
    figure = page("A lamp sends its rays to all sides; those of a light at infinity are parallel", 10.2, 4.15)
    angles = np.arange(5.0, 360.0, 10)
    above = np.linspace(-3.5, 1.9, 20)
    across, up = float(LAMP.position[0]), float(LAMP.position[1])
    axes = _panel(figure, 0.2, "point light: another $l$ at each point")
    _draw_rays(axes, np.full_like(angles, across), np.full_like(angles, up), toward(angles))
    axes.plot(across, up, "o", color=LIGHT, markersize=11, markeredgecolor="black", zorder=4)
    _draw_to_light(axes, LAMP)
    axes = _panel(figure, 5.2, "light at infinity: one $l$ at all points")
    _draw_rays(axes, above, np.full_like(above, 1.75), -evaluate(lambda p: SUN.path(p).l, None))
    _draw_to_light(axes, SUN)
    return figure


def _panel(figure: Figure, left: float, title: str) -> Axes:
    """Return a section through the floor and the ball."""
    axes = sheet(figure, (left, 0.75), (4.8, 3.25), (-WIDTH, WIDTH), (-1.2, 1.78), title)
    angle = np.linspace(0, 2 * np.pi, 200)
    x, y, _ = BALL.center
    axes.fill_between([-WIDTH, WIDTH], -1.2, float(FLOOR.point[1]), color="0.8", linewidth=0)
    axes.fill(x + BALL.radius * np.cos(angle), y + BALL.radius * np.sin(angle), color="#dcb3ac", zorder=2)
    return axes


def _draw_rays(axes: Axes, x: np.ndarray, y: np.ndarray, direction: Vec3) -> None:
    """Draw rays up to the first surface that each meets, or as far as the page goes."""
    direction = direction + Vec3(0 * x, 0 * x, 0 * x)
    distance = evaluate(_distance, Rays(Vec3(x, y, 0 * x), direction))
    for x0, y0, along_x, along_y, d in zip(x, y, direction.x, direction.y, distance, strict=True):
        before = (-WIDTH - x0) / along_x if x0 < -WIDTH else 0.0  # to where the ray comes onto the page
        start = x0 + before * along_x, y0 + before * along_y
        if np.isfinite(d):
            arrow(axes, start, (x0 + d * along_x, y0 + d * along_y), LIGHT)
        else:
            axes.plot([start[0], x0 + 5 * along_x], [start[1], y0 + 5 * along_y], color=LIGHT, linewidth=1.6)


def _distance(rays: Rays) -> Array:
    """Return the distance to the nearest surface, infinite where a ray meets none."""
    hits = [surface.intersect(rays) for surface in (FLOOR, BALL)]
    return jnp.min(jnp.stack([jnp.where(hit.inside, hit.distance, jnp.inf) for hit in hits]), 0)


def _draw_to_light(axes: Axes, light: AbstractEmitter) -> None:
    """Draw l at some points of the surfaces."""
    top = toward(-46)
    on_ball = (BALL.center[0] + BALL.radius * top.x, BALL.center[1] + BALL.radius * top.y)
    for x, y in ((-1.84, -1.0), (-0.7, -1.0), on_ball):
        p = Vec3(*(np.asarray(float(c)) for c in (x, y, 0.0)))
        l = evaluate(lambda p: light.path(p).l, p)
        arrow(axes, (float(x), float(y)), (float(x + 0.5 * l.x), float(y + 0.5 * l.y)))
        axes.plot(x, y, "o", color="black", markersize=4, zorder=5)
        axes.text(float(x + 0.6 * l.x), float(y + 0.6 * l.y), "$l$", **LETTER)
