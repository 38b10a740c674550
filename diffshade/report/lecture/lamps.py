"""Lights: their kinds, and how their light fades with distance and off the axis (E2, E3, E11)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...model.area_lights import AreaLight
from ...model.attenuation import RadialAttenuation, angular_attenuation
from ...model.cameras import Camera, OrthographicCamera
from ...model.lights import AbstractLight, DirectionalLight, PointLight, SpotLight
from ...model.materials import Material
from ...model.scenes import Object, Scene
from ...model.surfaces import Box, Plane, Sphere
from ...model.vectors import Vec3
from .pages import draw_curves, grid, name_axes, page, place, show
from .pictures import DARK, Picture, displayed, evaluate, fine, picture, toward

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAMP, WARM = (0, 1, 0), (1.0, 0.85, 0.6)


def kinds_of_light() -> Figure:
    """Draw one scene under a point, a directional, a spot and an area light."""
    lights: dict[str, AbstractLight] = {
        "point: from one place": PointLight((-1.2, 2.6, 1.6)),
        "directional: from infinity": DirectionalLight((0.6, -1.2, -0.5)),
        "spot: into a cone": SpotLight((-1.2, 2.6, 1.6), (1.0, -2.6, -1.4), cutoff=24, softness=3),
        "area: a rectangle of emitters": AreaLight((-2.2, 2.6, 0.6), (2, 0, 0), (0, 0, 2), exponent=0, samples=7),
    }
    images = [_room(light) for light in lights.values()]
    return grid("Four kinds of light", [images[:2], images[2:]], labels=list(lights))


def attenuation_curves() -> Figure:
    """Draw f_rad over the distance, and f_ang over the angle off the axis."""
    figure = page(
        "How light fades: with the distance $d$ from the lamp, and with the angle off a spot's axis", 9.6, 4.3
    )
    d = np.linspace(0.02, 6.0, 400)
    laws = {
        "1": RadialAttenuation(1, 0, 0),
        "$1/d$": RadialAttenuation(0, 1, 0),
        "$1/d^2$": RadialAttenuation(0, 0, 1),
        "$1/(1 + 0.3 d + 0.2 d^2)$": RadialAttenuation(1, 0.3, 0.2),
        "min(1, $1/d^2$)": RadialAttenuation(0, 0, 1, clamp=True),
    }
    axes = place(figure, 0.75, 0.75, 3.9, 2.85)
    draw_curves(axes, d, {name: evaluate(law, d) for name, law in laws.items()})
    axes.lines[-1].set_linestyle("--")
    axes.set_ylim(0, 2)
    axes.legend(fontsize=9, frameon=False)
    name_axes(axes, "$d$, scene units", "$f_{rad}$", "radial: $1/(a_0 + a_1 d + a_2 d^2)$")

    phi = np.linspace(0.0, 80.0, 801)
    axes = place(figure, 5.5, 0.75, 3.9, 2.85)
    spots = {f"$a_l$ = {exponent}": (exponent, 0.0) for exponent in (0, 2, 8, 32)} | {"$a_l$ = 2, soft edge": (2, 20.0)}
    curves = {
        name: evaluate(angular_attenuation, toward(phi).y, *(np.asarray(float(x)) for x in (40, exponent, softness)))
        for name, (exponent, softness) in spots.items()
    }
    draw_curves(axes, phi, curves)
    axes.set_xticks(range(0, 81, 10), [f"{degrees}°" for degrees in range(0, 81, 10)])
    axes.axvline(40, color="0.4", linewidth=0.8, linestyle=":")
    axes.text(40.6, 0.02, r"cutoff $\theta_l$ = 40°", fontsize=9)
    axes.set_ylim(0, 1.05)
    axes.legend(fontsize=9, frameon=False, loc="upper right")
    name_axes(axes, r"$\phi$, the angle off the axis", "$f_{ang}$", r"angular: $\cos^{a_l}\phi$ up to the cutoff")
    return figure


def attenuation_at_most_1() -> Figure:
    """Draw 1/d^2 and min(1, 1/d^2), and a wall that a near lamp lights with each."""
    figure = page("$\\min(1, f_{rad})$: near to a lamp nothing is brighter than the lamp itself", 10.2, 3.9)
    laws = {"$1/d^2$": RadialAttenuation(0, 0, 1), "min(1, $1/d^2$)": RadialAttenuation(0, 0, 1, clamp=True)}
    axes, d = place(figure, 0.75, 0.85, 3.2, 2.4), np.linspace(0.2, 4.0, 381)
    draw_curves(axes, d, {name: evaluate(law, d) for name, law in laws.items()})
    axes.lines[-1].set_linestyle("--")
    axes.legend(fontsize=9, frameon=False)
    axes.set(xlim=(0, 4), ylim=(0, 3), xticks=range(5))
    name_axes(axes, "$d$, scene units", "$f_{rad}$")
    for i, (name, law) in enumerate(laws.items()):
        wall = Object(Plane((0, 0, -0.4), (0, 0, 1)), Material(k_d=(0.8, 0.62, 0.4)))
        camera = OrthographicCamera((0, 0, 5), height=3.4, shape=(288, 330))
        show(figure, 4.3 + 2.85 * i, 0.85, picture(Scene(wall, PointLight((0, 0, 0), 1, law)), camera), name)
    return figure


def parallel_faces() -> Figure:
    """Draw two parallel faces of one material, the second twice as far away, without and with attenuation."""
    laws = {
        "without attenuation": RadialAttenuation(1, 0, 0),
        "with attenuation, $1/d$": RadialAttenuation(0, 1, 0),
    }
    title = "Why attenuation exists: without it two parallel faces are one"
    return grid(title, [[_cards(law, 2, 2.4, (220, 330)) for law in laws.values()]], columns=list(laws))


def radial_attenuation() -> Figure:
    """Draw six parallel faces, 4 to 24 from the lamp, with f_rad = 1, 1/d, 1/d^2 and a mixture of them."""
    laws = {
        "1": RadialAttenuation(1, 0, 0),
        "$1/d$": RadialAttenuation(0, 1, 0),
        "$1/d^2$": RadialAttenuation(0, 0, 1),
        "$1/(1 + 0.1d + 0.01d^2)$": RadialAttenuation(1, 0.1, 0.01),
    }
    figure = grid(
        "Radial attenuation: $1/d^2$ is what a lamp does, and often too much of it",
        [[_cards(law, 6, 3.4, (210, 250)) for law in laws.values()]],
        columns=list(laws),
        note="Six faces of one material; the lamp is as bright as the nearest needs.",
    )
    for i in range(6):  # in the upper left corner of each card
        x, y = (0.42 * (i - 2.5) - 0.7) * 210 / 3.4 + 125, (0.3 * (2.5 - i) - 0.55) * 210 / 3.4 + 105
        figure.axes[0].text(x, y, f"$d$ = {4 * i + 4}", fontsize=7)
    return figure


def spot_cone() -> Figure:
    """Draw the light within a spot's cone, seen from the side, and where it falls on a floor."""
    spots = {
        r"cutoff $\theta_l$ = 25°": SpotLight(LAMP, (0, -1, 0), WARM, 25),
        "exponent $a_l$ = 30": SpotLight(LAMP, (0, -1, 0), WARM, 25, 30),
        "soft edge, 12°": SpotLight(LAMP, (0, -1, 0), WARM, 25, softness=12),
        "attenuation $1/d$": SpotLight(LAMP, (0, -1, 0), WARM, 25, attenuation=RadialAttenuation(0, 1, 0)),
    }
    figure = grid(
        "A spot shines into a cone about its axis: $\\phi \\leq \\theta_l$",
        [[light_in_the_air(light) for light in spots.values()], [light_on_a_floor(light) for light in spots.values()]],
        columns=list(spots),
        sides=["the light\nin the air", "on the\nfloor"],
    )
    scale, angle = 170 / 2.2, np.deg2rad(np.linspace(0, 25, 20))
    axes, x, y = figure.axes[0], 85.0, 0.2 * scale  # where the lamp is
    axes.plot([x, x], [y, 165], ":", color="black", linewidth=1)
    axes.plot(x + scale * np.sin(angle), y + scale * np.cos(angle), color="black", linewidth=1)
    axes.text(x + 0.26 * scale, y + 1.25 * scale, r"$\theta_l$", ha="center", fontsize=11)
    return figure


def _cards(law: RadialAttenuation, count: int, height: float, shape: tuple[int, int]) -> Picture:
    """Return parallel faces 4, 8, 12... from a lamp that stands before the first."""
    at = np.arange(count)
    middle = np.stack([0.42 * at, 0.3 * at, -4.0 * at - 4.0], -1)
    faces = [Object(Box(center, (1.5, 1.5, 1e-3)), Material(k_d=(0.8, 0.62, 0.4))) for center in middle]
    lamp = PointLight((0, 0, 0), 1 / evaluate(law, np.asarray(4.0)), law)
    x, y, _ = middle.mean(0)
    camera = OrthographicCamera((x, y, 1), target=(x, y, 0), height=height, shape=shape)
    return picture(Scene(faces, lamp, background=DARK), camera)


def light_in_the_air(light: SpotLight) -> Picture:
    """Return the intensity that arrives at each point of an upright plane through the lamp."""
    count = fine(170)
    y, x = np.meshgrid(np.linspace(1.2, -1.0, count), np.linspace(-1.1, 1.1, count), indexing="ij")
    _, arriving = evaluate(SpotLight.arriving, light, Vec3(x, y, np.zeros_like(x)))
    return displayed(0.8 * np.asarray(arriving.stack()))


def light_on_a_floor(light: SpotLight) -> Picture:
    """Return what a lamp lights of a floor."""
    floor = Object(Plane((0, -1, 0)), Material(0.02, 0.8))
    camera = Camera((0, 1.6, 4), target=(0, -1, 0), fov=28, shape=(170, 170))
    return picture(Scene(floor, light), camera)


def _room(light: AbstractLight) -> Picture:
    floor = Object(Plane((0, -1, 0)), Material((0.05, 0.045, 0.04), (0.55, 0.5, 0.45), 0.1, 20))
    wall = Object(Plane((0, 0, -2.5), (0, 0, 1)), Material((0.045, 0.047, 0.05), (0.5, 0.52, 0.55)))
    ball = Object(Sphere((-0.2, -0.2, 0), 0.8), Material((0.05, 0.01, 0.01), (0.6, 0.12, 0.1), 0.8, 60))
    box = Object(
        Box((1.5, -0.5, -0.6), (1, 1, 1), (0, 35, 0)), Material((0.01, 0.035, 0.02), (0.12, 0.4, 0.2), 0.2, 20)
    )
    camera = Camera((0.2, 1.2, 5.5), target=(0.2, -0.1, 0), fov=33, shape=(250, 380))
    return picture(Scene([floor, wall, ball, box], light, background=DARK), camera)
