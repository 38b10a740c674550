"""What the air does: depth cueing and fog (E14)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...model.attenuation import AbstractAtmosphere, DepthCueing, Fog
from ...model.cameras import Camera
from ...model.lights import DirectionalLight
from ...model.materials import Material
from ...model.patterns import Chequer
from ...model.scenes import Object, Scene
from ...model.surfaces import Box, Sphere
from .pages import draw_curves, grid, name_axes, page, place
from .pictures import PALE, evaluate, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def visibility() -> Figure:
    """Draw s over the distance z."""
    figure = page(r"What is left of a colour at a distance, $I' = s I + (1 - s) I_{dc}$", 7.4, 4.2)
    axes = place(figure, 0.75, 0.55, 6.4, 3.0)
    z = np.linspace(0.0, 12.0, 601)
    airs: dict[str, AbstractAtmosphere] = {
        "depth cueing: linear": DepthCueing(2.0, 9.0, s_f=1.0, s_b=0.15),
        r"fog: $\exp(-\rho z)$, $\rho$ = 0.2": Fog(0.2),
        r"fog: $\exp(-(\rho z)^2)$, $\rho$ = 0.2": Fog(0.2, squared=True),
    }
    draw_curves(axes, z, {name: evaluate(air.visibility, z) for name, air in airs.items()})
    for at, s in ((2.0, 1.0), (9.0, 0.15)):
        axes.plot([at, at, 0], [0, s, s], ":", color="0.4", linewidth=1)
    axes.set_ylim(0, 1.1)
    axes.set_xticks([0, 2, 9, 12], ["0", "$z_f$", "$z_b$", "12"], fontsize=11)
    axes.set_yticks([0, 0.15, 1], ["0", "$s_b$", "$s_f$"], fontsize=11)
    name_axes(axes, "$z$, distance from the eye", "$s$")
    return figure


def depth_cueing() -> Figure:
    """Draw a row of spheres that goes away from the eye, without and with depth cueing, and in fog."""
    airs: dict[str, AbstractAtmosphere | None] = {
        "no attenuation": None,
        "depth cueing, $z_f$ = 6, $z_b$ = 24": DepthCueing(6, 24, I_dc=PALE),
        r"fog, $\rho$ = 0.06": Fog(0.06, I_dc=PALE),
    }
    # it ends before its squares are narrower than a pixel
    floor = Object(
        Box((0, -1.1, -12), (80, 0.2, 48)),
        Material(k_a=Chequer((0.1, 0.12, 0.1), (0.3, 0.32, 0.28), 6, u=(1, 0, 0), v=(0, 0, 1))),
    )
    row = [
        Object(Sphere((-3.2 + 2.0 * i, 0, 0.8 - 3.2 * i)), Material(0.05, (0.6, 0.14, 0.08), 0.5, 30)) for i in range(8)
    ]
    camera = Camera((0, 1.6, 8), target=(0, -0.1, -4), fov=24, shape=(190, 620))
    rows = [
        [picture(Scene([floor, *row], DirectionalLight((-1, -1.5, -1)), background=PALE, atmosphere=air), camera)]
        for air in airs.values()
    ]
    return grid("Depth cueing: what is far takes the colour of the air", rows, labels=list(airs))
