"""Transparent objects: refraction and transmission (E12, E13)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.fields import Array, Numbers
from ...model.cameras import Camera, OrthographicCamera, Rays
from ...model.lights import DirectionalLight, PointLight
from ...model.materials import Material
from ...model.patterns import Chequer
from ...model.scenes import Object, Scene
from ...model.surfaces import Box, Plane, Sphere
from ...model.transmission import bend
from ...model.vectors import Vec3, reflect, refract
from .pages import GREY, grid, page
from .pictures import Picture, evaluate, picture, toward
from .sketches import RED, arc, arrow, ray, sheet, vector

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GLASS, GREEN, BLUE, LIGHT, INDEX = "#d7e9f4", "#2a8f5b", "#1f5fa8", "#b07a00", 1.61


def snell() -> Figure:
    """Draw a ray that enters glass, one that passes a slab, and rays that try to leave."""
    figure = page(
        r"Snell's law, $\sin\theta_r = (\eta_i/\eta_r)\,\sin\theta_i$, air and glass of $\eta$ = 1.61", 10.6, 3.9
    )
    for i, (draw, title) in enumerate(
        (
            (_draw_entering, "into glass: towards the normal"),
            (_draw_slab, "through a slab: shifted, but parallel"),
            (_draw_leaving, "out of glass: total reflection beyond 38.4°"),
        )
    ):
        draw(sheet(figure, (0.2 + 3.45 * i, 0.8), (3.3, 2.95), (-1.2, 1.2), (-1.07, 1.07), title))
    return figure


def transmission_vector() -> Figure:
    """Draw T beside n, l and r, and how it follows from l and n."""
    figure = page(r"The transmission vector $T$ is a part of $n$ less a part of $l$", 9.6, 4.6)
    l, n, ratio = toward(-40), toward(0), 1 / INDEX
    T, _ = evaluate(refract, l, n, np.asarray(ratio))
    r = evaluate(reflect, l, n)
    bent = 180 - float(np.rad2deg(np.arctan2(T.x, -T.y)))
    words = r"$T = (\frac{\eta_i}{\eta_r}\cos\theta_i - \cos\theta_r)\,n - \frac{\eta_i}{\eta_r}\,l$"
    for i, title in enumerate(("$l$, $n$, $r$ and $T$ lie in one plane", words)):
        axes = sheet(figure, (0.2 + 4.7 * i, 0.85), (4.5, 3.6), (-1.5, 1.5), (-1.15, 1.25), title, 11)
        axes.fill_between([-1.5, 1.5], -1.15, 0, color=GLASS)
        axes.text(1.45, 0.08, r"$\eta_i$ (air)", ha="right", fontsize=11)
        axes.text(1.45, -0.08, r"$\eta_r$ (glass)", ha="right", va="top", fontsize=11)
        axes.plot([0, 0], [-1.1, 0], ":", color=GREY)
        vector(axes, n, "n")
        vector(axes, l, "l", LIGHT)
        vector(axes, T, "T", RED)
        arc(axes, -40.0, 0.0, 0.4, r"$\theta_i$")
        arc(axes, bent, 180.0, 0.55, r"$\theta_r$")
        if i == 0:
            vector(axes, r, "r", BLUE)
            arc(axes, 0.0, 40.0, 0.4, r"$\theta_i$")
        else:
            part = (-ratio * float(l.x), -ratio * float(l.y))
            arrow(axes, (0, 0), part, LIGHT)
            arrow(axes, part, (float(T.x), float(T.y)), GREEN)
            axes.text(
                part[0] + 0.06, 0.6 * part[1], r"$-\frac{\eta_i}{\eta_r}\,l$", color=LIGHT, ha="left", fontsize=14
            )
            middle = 0.5 * (part[1] + float(T.y))
            name = r"$(\frac{\eta_i}{\eta_r}\cos\theta_i - \cos\theta_r)\,n$"
            axes.text(part[0] + 0.06, middle, name, color=GREEN, ha="left", va="center", fontsize=12)
    return figure


def glass_sphere() -> Figure:
    """Draw a glass ball before a chequered wall, unbent and refracted."""
    indices = {r"simple: $\eta$ = 1": 1.0, r"refracted: $\eta$ = 1.1": 1.1, r"refracted: $\eta$ = 1.5": 1.5}
    row = [_before_chequer(0.9, eta) for eta in indices.values()]
    return grid("A glass ball magnifies what stands behind it, or turns it round", [row], columns=list(indices))


def transmission() -> Figure:
    """Draw a ball before a chequered wall over k_t."""
    values = (0.0, 0.25, 0.5, 0.75, 1.0)
    row = [_before_chequer(k_t, 1.0) for k_t in values]
    title = r"Transparency, $I = (1 - k_t)\,I_{refl} + k_t\,I_{trans}$: from opaque to invisible"
    return grid(title, [row], columns=[f"$k_t$ = {k_t:g}" for k_t in values])


def coloured_glass() -> Figure:
    """Draw balls and panes of coloured glass: k_t of red, green and blue apart."""
    values = ((0.85, 0.85, 0.85), (0.9, 0.25, 0.1), (0.15, 0.75, 0.2))
    row = [_before_chequer(k_t, 1.0, k_d=0.05) for k_t in values]
    labels = [f"$k_t$ = ({', '.join(f'{k:g}' for k in k_t)})" for k_t in values]
    return grid(
        "Coloured glass: a $k_t$ for red, green and blue; what passes two panes is their product",
        [[*row, _filters()]],
        columns=[*labels, "cyan, magenta and yellow"],
    )


def three_transparent() -> Figure:
    """Draw three balls, one behind the other, over k_t and in another order."""
    panels = {
        "$k_t$ = 0, red in front": (0.0, (2, 1, 0)),
        "$k_t$ = 0.3, red in front": (0.3, (2, 1, 0)),
        "$k_t$ = 0.6, red in front": (0.6, (2, 1, 0)),
        "$k_t$ = 0.3, blue in front": (0.3, (0, 1, 2)),
    }
    row = [_balls(k_t, depths) for k_t, depths in panels.values()]
    title = "Three transparent balls, back to front: the nearest weighs most"
    return grid(title, [row], columns=list(panels))


def _before_chequer(k_t: Numbers, eta: float, k_d: Numbers = (0.55, 0.25, 0.15)) -> Picture:
    glass = Material(0.02, k_d, 0.9, 60, k_t=k_t, eta=eta)
    wall = Object(Plane((0, 0, -3), (0, 0, 1)), Material(k_a=Chequer((0.12, 0.2, 0.3), (0.8, 0.8, 0.75), 1.2)))
    red = Object(Sphere((-0.4, 0.45, -2.75), 0.22), Material((0.1, 0.01, 0.01), (0.75, 0.08, 0.06)))
    scene = Scene([Object(Sphere(), glass), wall, red], PointLight((3, 4, 6)))
    return picture(scene, Camera((0, 0, 6), fov=24, shape=(220, 220)))


def _balls(k_t: float, depths: tuple[int, int, int]) -> Picture:
    """Return a red, a green and a blue ball at depths, before white."""
    colours = np.array([(0.9, 0.06, 0.04), (0.08, 0.6, 0.1), (0.05, 0.12, 0.9)])
    materials = [Material(0.4 * k, 0.6 * k, 0.4, 40, k_t=k_t) for k in colours]
    return _three(materials, 0.75, 0.5, depths, lights=DirectionalLight((-0.4, -0.5, -1)), background=0.9)


def _filters() -> Picture:
    """Return three panes of glass before white, each of which keeps back one of red, green and blue."""
    materials = [Material(k_a=0, k_t=np.where(np.arange(3) == i, 0.08, 0.95)) for i in range(3)]
    return _three(materials, 0.72, 0.42, (0, 1, 2), background=0.95)


def _three(
    materials: list[Material], radius: float, apart: float, depths: tuple[int, int, int], **scene: Any
) -> Picture:
    """Return three balls around the axis of a camera, at depths, a larger number nearer."""
    balls = [
        Object(Sphere((apart * np.cos(a), apart * np.sin(a), 2.0 * z), radius), material)
        for a, z, material in zip(np.deg2rad([90, 210, 330]), depths, materials, strict=True)
    ]
    camera = OrthographicCamera((0, 0.1, 8), target=(0, 0.1, 0), height=2.7, shape=(220, 220))
    return picture(Scene(balls, **scene), camera)


def _draw_entering(axes: Axes) -> None:
    axes.fill_between([-1.2, 1.2], -1.1, 0, color=GLASS)
    l = toward(-30)
    T, _ = evaluate(refract, l, toward(0), np.asarray(1 / INDEX))
    theta_r = np.rad2deg(np.arctan2(T.x, -T.y))
    axes.plot([0, 0], [-1, 1], ":", color=GREY)
    axes.plot([0, -float(l.x)], [0, -float(l.y)], "--", color=RED, linewidth=1, alpha=0.6)
    ray(axes, (l.x, l.y), (0, 0), (T.x, T.y))
    arc(axes, -30.0, 0.0, 0.45, "30°")
    arc(axes, 180 - float(theta_r), 180.0, 0.6, "")
    axes.text(-0.08, -0.62, f"{theta_r:.2f}°", ha="right", va="center", fontsize=10)
    axes.text(1.1, 0.08, r"air, $\eta$ = 1", ha="right", fontsize=9)
    axes.text(1.1, -0.16, rf"glass, $\eta$ = {INDEX}", ha="right", fontsize=9)


def _draw_slab(axes: Axes) -> None:
    slab, start = Box(size=(4, 0.9, 4)), Vec3(*(np.asarray(x) for x in (-1.05, 1.0, 0.0)))

    def trace(l: Vec3, eta: Array) -> tuple[Vec3, Vec3, Vec3, Vec3]:
        rays = Rays(start + l * 0.0, -l)
        hit = slab.intersect(rays)
        way, _ = bend(slab, rays, hit, eta)
        enters = rays.origin + rays.direction * hit.distance
        return enters, way.outer.origin, way.outer.origin + way.outer.direction * 0.7, enters - l * 1.75

    enters, leaves, end, straight = evaluate(trace, toward(-50), np.asarray(INDEX))
    axes.fill_between([-1.2, 1.2], -0.45, 0.45, color=GLASS)
    axes.plot([enters.x, straight.x], [enters.y, straight.y], "--", color=RED, linewidth=1, alpha=0.6)
    ray(axes, *((p.x, p.y) for p in (start, enters, leaves, end)))
    for p in (enters, leaves):
        axes.plot([p.x, p.x], [p.y - 0.35, p.y + 0.35], ":", color=GREY)


def _draw_leaving(axes: Axes) -> None:
    axes.fill_between([-1.2, 1.2], -1.1, 0, color=GLASS)
    axes.plot([0, 0], [-1, 1], ":", color=GREY)
    for degrees, colour in ((20, GREEN), (36, BLUE), (50, RED)):
        l, n = toward(180 + degrees), toward(180)
        out, leaves = evaluate(refract, l, n, np.asarray(INDEX))
        on = out if leaves else evaluate(reflect, l, n)
        ray(axes, (l.x, l.y), (0, 0), (on.x, on.y), colour=colour)
        axes.text(1.1 * float(l.x), 1.1 * float(l.y), f"{degrees}°", color=colour, ha="center", va="center", fontsize=9)
