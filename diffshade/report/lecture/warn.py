"""Warn's lights: a grid of spots that makes a large lamp, and flaps that confine its light (E3, E11)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import numpy as np

from ...model.area_lights import AreaLight
from ...model.attenuation import angular_attenuation
from ...model.cameras import Camera
from ...model.flaps import Flaps
from ...model.lights import SpotLight
from ...model.materials import Material
from ...model.rendering import render
from ...model.scenes import Object, Scene
from ...model.surfaces import Plane
from .lamps import LAMP, WARM, light_in_the_air, light_on_a_floor
from .pages import COLOURS, SCALED, grid, page, show
from .pictures import Picture, displayed, evaluate, finer, toward
from .sketches import arrow, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOBE = 0.35  # how long a lobe is drawn, scene units


def warn_grid() -> Figure:
    """Draw the emitters of an area light, and what grids of 1, 2 x 2, 4 x 4 and 16 x 16 of them light."""
    figure = page("An extended light, Warn's model: a grid of spots that share its intensity", 10.9, 2.95, note=SCALED)
    words = r"$4 \times 4$ spots, each with $\cos^{a_l}\phi$"
    _draw_grid(sheet(figure, (0.1, 0.75), (3.2, 1.75), (-1.25, 1.35), (-1.3, 0.1), words), _over_floor(4))
    for i, count in enumerate((1, 2, 4, 16)):
        label = "1 spot" if count == 1 else rf"${count} \times {count}$ spots"
        show(figure, 3.45 + 1.85 * i, 0.75, _floor_under(_over_floor(count)), label)
    return figure


def warn_flaps() -> Figure:
    """Draw the light of a spot without and with flaps, seen from the side, and where it falls on a floor."""
    flaps = {
        "cone alone": None,
        "$x_{min}$, $x_{max}$": Flaps(x_min=-0.35, x_max=0.2),
        "$x_{min}$, $y_{max}$": Flaps(x_min=-0.35, y_max=0.2),
        "$x_{max}$, $z_{max}$": Flaps(x_max=0.2, z_max=0.25),
        "soft edges": Flaps(x_min=-0.35, x_max=0.2, z_min=-0.4, z_max=0.25, softness=0.2),
    }
    spots = [SpotLight(LAMP, (0, -1, 0), WARM, 27, 2, flaps=each) for each in flaps.values()]
    figure = grid(
        "Warn's flaps let the light pass only between planes across the axes of the world",
        [[light_in_the_air(light) for light in spots], [light_on_a_floor(light) for light in spots]],
        columns=list(flaps),
        sides=["the light\nin the air", "on the\nfloor"],
    )
    for x in (-0.35, 0.2):
        figure.axes[1].axvline(85 + 170 / 2.2 * x, color="white", linestyle=":", linewidth=1)
    return figure


def _over_floor(count: int) -> AreaLight:
    return AreaLight((-0.8, -0.5, -0.8), (1.6, 0, 0), (0, 0, 1.6), (1.4, 1.25, 1.0), exponent=8, samples=count)


def _floor_under(light: AreaLight) -> Picture:
    floor = Object(Plane((0, -1, 0)), Material(k_d=0.75))
    camera = finer(Camera((0, 2.2, 3.6), target=(0, -1, 0), fov=31, shape=(210, 210)))
    image = np.asarray(render(Scene(floor, light), camera), np.float64)
    return displayed(image / image.max())


def _draw_grid(axes: Axes, light: AreaLight) -> None:
    """Draw the cells of an area light seen from above at a slant, and of each emitter its axis and its lobe."""
    corner, u, v = (np.asarray(vector) for vector in (light.corner, light.edge_u, light.edge_v))
    n_u, n_v = light.samples
    for i in range(n_u + 1):
        _line(axes, corner + i / n_u * u, v)
    for j in range(n_v + 1):
        _line(axes, corner + j / n_v * v, u)
    phi = np.linspace(-89.0, 89.0, 90)
    off = toward(phi)
    reach = LOBE * evaluate(angular_attenuation, off.y, light.cutoff, light.exponent, np.zeros(()))
    spots = jax.tree.map(np.asarray, light.emitters())
    for position in np.asarray(spots.position):
        x, y = _flat(position)
        axes.fill(x + reach * off.x, y - reach * off.y, color=COLOURS[3], alpha=0.35, linewidth=0)
        arrow(axes, (x, y), (x, y - LOBE), "black")
        axes.plot(x, y, "o", color=COLOURS[3], markersize=4, markeredgecolor="black", markeredgewidth=0.6)


def _line(axes: Axes, start: np.ndarray, along: np.ndarray) -> None:
    (x0, y0), (x1, y1) = _flat(start), _flat(start + along)
    axes.plot([x0, x1], [y0, y1], color=COLOURS[0], linewidth=1.2)


def _flat(p: np.ndarray) -> tuple[float, float]:
    """Return where a point is drawn: x to the right, y up, z towards the lower left."""
    return float(p[0] - 0.5 * p[2]), float(p[1] - 0.45 * p[2])
