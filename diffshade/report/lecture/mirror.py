"""The mirror: how its direction is found, and what the highlight becomes as n_s grows (E5)."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...core.fields import Array
from ...model.area_lights import AreaLight
from ...model.attenuation import RadialAttenuation
from ...model.cameras import AbstractCamera, Camera
from ...model.materials import Material
from ...model.rendering import intersect, render
from ...model.scenes import Object, Scene
from ...model.surfaces import Sphere
from ...model.vectors import Vec3, cross, dot, normalize, reflect
from .pages import COLOURS, GREY, SCALED, grid, page
from .pictures import Picture, displayed, evaluate, finer, toward
from .sketches import LETTER, arc, arrow, sheet, vector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LIGHT = "#b07a00"
BALL = Object(Sphere(), Material(k_a=0, k_d=0, k_s=1, n_s=1))
# cos phi / d^2 of each spot: equally bright from everywhere, as a window is
WINDOW = AreaLight((-3.2, 0.6, 2.4), (0, 3.2, 0), (3.4, 0, 1.2), exponent=1, attenuation=RadialAttenuation(0, 0, 1))


def mirror_direction() -> Figure:
    """Draw how r follows from the projection of l on n."""
    figure = page(r"The mirror direction $r = 2\,(n \cdot l)\,n - l$, from the projection of $l$ on $n$", 9.6, 4.0)
    l, n = toward(-38), toward(0)
    r, foot = evaluate(reflect, l, n), float(evaluate(dot, n, l))  # (n.l) n ends straight above the point
    x = float(l.x)
    titles = (r"$s = (n \cdot l)\,n - l$ leads from $l$ to the normal", r"$r = (n \cdot l)\,n + s$: as far again")
    for i, title in enumerate(titles):
        axes = sheet(figure, (0.2 + 4.7 * i, 0.75), (4.5, 3.1), (-1.1, 1.1), (-0.16, 1.36), title)
        axes.fill_between([-1.1, 1.1], -0.08, 0, color="0.8", linewidth=0)
        axes.plot([0, 0], [0, foot], color=COLOURS[2], linewidth=4, zorder=1.5)
        axes.plot([-0.06, -0.06, 0], [foot, foot - 0.06, foot - 0.06], color=GREY, linewidth=0.9)
        vector(axes, n, "n")
        vector(axes, l, "l", LIGHT)
        arrow(axes, (x, foot), (0, foot), COLOURS[0])
        axes.text(0.5 * x, foot + 0.09, "$s$", color=COLOURS[0], **LETTER)
        arc(axes, -38.0, 0.0, 0.3, r"$\theta$", gap=0.1)
        if i == 0:
            axes.text(0.05, 0.5 * foot, r"$(n \cdot l)\,n$", color=COLOURS[2], ha="left", va="center", fontsize=11)
        else:
            arrow(axes, (0, foot), (float(r.x), foot), COLOURS[0])
            axes.text(-0.5 * x, foot + 0.09, "$s$", color=COLOURS[0], **LETTER)
            vector(axes, r, "r", COLOURS[1])
            arc(axes, 0.0, 38.0, 0.3, r"$\theta$", gap=0.1)
    return figure


def ideal_mirror() -> Figure:
    """Draw the highlight of a window on a ball over n_s, and the window in an ideal mirror."""
    camera, exponents = Camera((0, 0, 6), fov=21, shape=(168, 168)), (3, 10, 30, 100, 1000)
    row = [*(_highlight(camera, n_s) for n_s in exponents), _mirrored(camera)]
    return grid(
        r"As $n_s$ grows, the highlight becomes the mirror image of the light: here of a bright window",
        [row],
        columns=[*(f"$n_s$ = {n_s}" for n_s in exponents), r"ideal mirror, $n_s \to \infty$"],
        note=f"The highlight alone. {SCALED}",
    )


def _highlight(camera: AbstractCamera, n_s: float) -> Picture:
    """Return the highlight of the window."""
    ball = Object(BALL.surface, Material(k_a=0, k_d=0, k_s=1, n_s=n_s))
    window = dataclasses.replace(WINDOW, samples=24 if n_s > 100 else 16)  # closer than the highlight of each is wide
    image = np.asarray(render(Scene(ball, window), finer(camera)), np.float64)
    return _on_ball(camera, image / image.max())


def _mirrored(camera: AbstractCamera) -> Picture:
    """Return 1 where the mirror direction of the viewer meets the window."""
    seen = intersect(Scene(BALL), finer(camera))
    p, n = (Vec3.of(np.asarray(part, np.float64)) for part in (seen.position, seen.normal))
    inside = evaluate(_meets_window, p, n, Vec3.of(np.asarray(camera.eye)))
    return _on_ball(camera, np.where(inside & np.asarray(seen.mask), 1.0, 0.0)[..., None] * np.ones(3))


def _meets_window(p: Vec3, n: Vec3, eye: Vec3) -> Array:
    r = reflect(normalize(eye - p), n)
    corner, u, v = (Vec3.of(edge) for edge in (WINDOW.corner, WINDOW.edge_u, WINDOW.edge_v))
    facing = cross(u, v)
    t = dot(corner - p, facing) / dot(r, facing)
    on_plane = p + r * t - corner
    a, b = dot(on_plane, u) / dot(u, u), dot(on_plane, v) / dot(v, v)
    return (t > 0) & (a > 0) & (a < 1) & (b > 0) & (b < 1)


def _on_ball(camera: AbstractCamera, image: Float[np.ndarray, "H W 3"]) -> Picture:
    """Return what a dark ball adds to an image."""
    mask = np.asarray(intersect(Scene(BALL), finer(camera)).mask)
    return displayed(0.9 * image + np.where(mask, 0.02, 0.09)[..., None])
