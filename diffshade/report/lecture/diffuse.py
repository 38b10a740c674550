"""Ambient and diffuse reflection (E1, E4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...model.cameras import Camera
from ...model.lights import DirectionalLight
from ...model.materials import Material
from ...model.reflection import reflectance
from ...model.scenes import Object, Scene
from ...model.surfaces import Plane
from .pages import DPI, GREY, draw_curves, grid, name_axes, page, place, show
from .pictures import ball, evaluate, picture, toward
from .sketches import arrow, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FACE, EDGE = 0.7, 0.8  # half the width of the face that a beam falls on, and of its picture
LENGTH = 0.8  # the length of the ray in the middle
RAYS = 8  # as many as the whole face takes where they fall straight on it
BEAM = "#e08a1e"


def diffuse_over_k_d() -> Figure:
    """Draw a ball over k_d from 0 to 1."""
    values = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
    title = "Diffuse reflection: $k_d$ is the share of the light that is scattered to all sides"
    return grid(title, [[ball(Material(k_d=k_d)) for k_d in values]], columns=[f"$k_d$ = {k:g}" for k in values])


def diffuse_over_theta() -> Figure:
    """Draw I_d against the angle of incidence, and the tile that the light falls on."""
    from matplotlib.patches import Rectangle

    figure = page("Lambert's law: the more the light grazes a face, the darker the face", 7.4, 5.2)
    left, width, angles = 0.85, 6.3, range(0, 91, 15)
    camera = Camera((0, 0, 5), fov=8, shape=(84, 84))
    for degrees in angles:
        l = toward(degrees)
        light = DirectionalLight((-l.x, 0, -l.y))  # seen from above: the page's up is towards the eye
        tile = picture(Scene(Object(Plane(normal=(0, 0, 1)), Material(k_d=1)), light), camera)
        at = left + width * (degrees + 7.5) / 105 - 0.5 * 84 / DPI
        _draw_incidence(sheet(figure, (at - 0.15, 0.42), (1.0, 0.8), (-1.0, 1.0), (-0.1, 1.5)), float(degrees))
        show(figure, at, 1.25, tile).add_patch(Rectangle((-0.5, -0.5), 83, 83, fill=False, color=GREY, linewidth=1))
    axes = place(figure, left, 2.1, width, 2.5)
    theta = np.linspace(0.0, 90.0, 181)
    draw_curves(axes, theta, {f"$k_d$ = {k_d:g}": _diffuse(k_d, theta) for k_d in (1.0, 0.7, 0.4)})
    axes.set_xlim(-7.5, 97.5)
    axes.set_xticks(angles, [f"{degrees}°" for degrees in angles])
    name_axes(axes, r"$\theta$, the angle between normal and light", r"$I_d\ /\ I_l = k_d\,\cos\theta$")
    return figure


def ambient_and_diffuse() -> Figure:
    """Draw a ball over k_a and k_d."""
    ambient, diffuse = (0.0, 0.1, 0.2, 0.3), (0.0, 0.15, 0.3, 0.5, 0.7)
    rows = [[ball(Material(k_a=k_a, k_d=k_d)) for k_d in diffuse] for k_a in ambient]
    return grid(
        "Ambient light $k_a I_a$ lifts everything alike; only diffuse light shows the shape",
        rows,
        columns=[f"$k_d$ = {k_d:g}" for k_d in diffuse],
        sides=[f"$k_a$ = {k_a:g}" for k_a in ambient],
    )


def _diffuse(k_d: float, theta: np.ndarray) -> np.ndarray:
    """Return what a matte surface reflects of light at the angle theta."""
    material, n = Material(k_d=k_d), toward(np.zeros_like(theta))
    return evaluate(lambda l: reflectance(material, material.at(None), n, l, n), toward(theta)).x


def _draw_incidence(axes: Axes, degrees: float) -> None:
    """Draw a beam of evenly spaced rays; the more they graze the face, the fewer hit it."""
    l = toward(degrees)
    x, y = float(l.x), float(l.y)
    axes.plot([-FACE, FACE], [0, 0], color="black", linewidth=2.5)
    axes.plot([0, 0], [0, 1.4], color=GREY, linewidth=0.8, linestyle=":")
    for u in (np.arange(RAYS) - 0.5 * (RAYS - 1)) * 2.0 * FACE / RAYS:
        tail = np.array([LENGTH * x + u * y, LENGTH * y - u * x])  # u is the way across the beam
        if abs(u) < FACE * y:
            arrow(axes, (tail[0], tail[1]), (u / y, 0.03), BEAM)
        elif tail[1] > 0.0:  # it passes the face, and ends where the next picture begins
            way = min(tail[1] / max(y, 1e-9), (tail[0] + EDGE) / x)
            end = tail - way * np.array([x, y])
            axes.plot([tail[0], end[0]], [tail[1], end[1]], color=BEAM, alpha=0.35, linewidth=1.2)
