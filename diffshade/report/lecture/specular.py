"""The highlight: its lobe, its exponent, its weight, and the viewer it depends on (E5-E8)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.fields import Array
from ...model.cameras import Camera, OrthographicCamera
from ...model.fresnel import AbstractFresnel, Dielectric, Schlick
from ...model.lights import DirectionalLight, PointLight
from ...model.lobes import Blinn, Phong
from ...model.materials import Material
from ...model.reflection import reflectance
from ...model.scenes import Object, Scene
from ...model.surfaces import Plane, Sphere
from ...model.vectors import Vec3, dot, halfway, positive_power, reflect
from .pages import COLOURS, draw_curves, grid, name_axes, page, place, show
from .pictures import PALE, Picture, ball, evaluate, picture, toward
from .sketches import LETTER, arc, sheet, vector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAVY = (0.05, 0.1, 0.2)
PLASTIC = {"k_a": (0.02, 0.04, 0.08), "k_d": (0.1, 0.2, 0.42), "k_s": 0.5}


def lobes() -> Figure:
    """Draw what a dull and a shiny surface send in each direction, as polar plots."""
    figure = page("A dull surface sends its highlight to many sides, a shiny one to few", 9.4, 3.5)
    phi = np.linspace(-90.0, 90.0, 721)
    l, n, v = toward(-40), toward(np.zeros_like(phi)), toward(phi)
    matte = evaluate(lambda v: _reflectance(Material(k_d=0.35), n, l, v), v)
    for left, name, n_s in ((0.55, "dull", 6), (5.15, "shiny", 120)):
        axes: Any = place(figure, left, -0.65, 3.7, 4.9, projection="polar")
        axes.set(theta_offset=np.pi / 2, theta_direction=-1, thetamin=-90, thetamax=90, rlim=(0, 1))
        axes.set_xticks(np.deg2rad([-90, -60, -30, 0, 30, 60, 90]), ["-90°", "", "", "0°", "", "", "90°"])
        axes.set_yticks([0.25, 0.5, 0.75, 1], [])
        axes.tick_params(labelsize=9)
        total = evaluate(lambda v, n_s=n_s: _reflectance(Material(k_d=0.35, k_s=0.6, n_s=n_s), n, l, v), v)
        axes.fill(np.deg2rad([*phi, 90]), [*total, 0], color=COLOURS[1], alpha=0.25)
        axes.plot(np.deg2rad(phi), total, color=COLOURS[1], linewidth=1.8)
        axes.plot(np.deg2rad(phi), matte, color=COLOURS[0], linewidth=1.8)
        for degrees, letter, tail, tip in ((-40, "l", 1, 0), (40, "r", 0, 1)):
            style = {"arrowstyle": "-|>", "linewidth": 1.4, "color": "black", "shrinkA": 0, "shrinkB": 0}
            angle = np.deg2rad(degrees)
            axes.annotate("", (angle, tip), (angle, tail), arrowprops=style)
            axes.text(angle, 1.1, f"${letter}$", **LETTER)
        figure.text((left + 1.85) / 9.4, 0.2 / 3.5, f"{name}: $n_s$ = {n_s}", ha="center", fontsize=11)
    figure.text(0.5, 0.1, "diffuse alone", color=COLOURS[0], ha="center", fontsize=9)
    figure.text(0.5, 0.04, "with highlight", color=COLOURS[1], ha="center", fontsize=9)
    return figure


def cosine_powers() -> Figure:
    """Draw cos^n_s of the angle between viewer and mirror direction."""
    figure = page(r"$\cos^{n_s}\phi$: the larger $n_s$, the narrower the highlight", 7.4, 4.4)
    axes = place(figure, 0.75, 0.55, 6.4, 3.2)
    phi = np.linspace(-90.0, 90.0, 721)
    exponents = (1, 3, 10, 27, 50, 200)
    mirror = toward(np.zeros_like(phi))

    def power(v: Vec3, n_s: Array) -> Array:
        return positive_power(dot(v, mirror), n_s)

    draw_curves(axes, phi, {f"$n_s$ = {n}": evaluate(power, toward(phi), np.asarray(float(n))) for n in exponents})
    axes.set_xticks(range(-90, 91, 30), [f"{degrees}°" for degrees in range(-90, 91, 30)])
    name_axes(axes, r"$\phi$, the angle between viewer $v$ and mirror direction $r$", r"$\cos^{n_s}\phi$")
    return figure


def specular_over_k_s_and_n_s() -> Figure:
    """Draw a ball over k_s and n_s, with k_a = 0.1 and k_d = 0.45."""
    strengths, exponents = (0.1, 0.25, 0.5), (3, 5, 10, 27, 200)
    return grid(
        "The highlight: $k_s$ is how strong it is, $n_s$ how sharp",
        [[ball(Material(0.1, 0.45, k_s, n_s)) for n_s in exponents] for k_s in strengths],
        columns=[f"$n_s$ = {n_s}" for n_s in exponents],
        sides=[f"$k_s$ = {k_s:g}" for k_s in strengths],
    )


def fresnel_weight() -> Figure:
    """Draw W over the angle of incidence, and a ball lit from behind with and without it."""
    figure = page(r"Fresnel: any surface mirrors grazing light, $W(\theta) \to 1$", 8.6, 4.4)
    axes = place(figure, 0.75, 0.6, 4.6, 3.15)
    theta = np.linspace(0.0, 90.0, 361)
    curves = {f"exact, $\\eta$ = {eta:g}": _weight(Dielectric(), 0.0, eta, theta) for eta in (1.33, 1.5, 2.4)}
    draw_curves(axes, theta, curves)
    for colour, eta in zip(COLOURS, (1.33, 1.5, 2.4), strict=False):
        k_s = ((eta - 1) / (eta + 1)) ** 2
        axes.plot(theta, _weight(Schlick(), k_s, 1.0, theta), "--", color=colour, label=f"Schlick, $k_s$ = {k_s:.2f}")
    axes.legend(fontsize=9, frameon=False)
    axes.set_xticks(range(0, 91, 15), [f"{degrees}°" for degrees in range(0, 91, 15)])
    name_axes(axes, r"$\theta$, the angle between normal and light", r"$W(\theta)$")
    show(figure, 5.75, 0.75, _floor(Material(k_d=NAVY, k_s=0.04, n_s=60)), "$W = k_s$ = 0.04")
    smooth = Material(k_d=NAVY, n_s=60, eta=1.5, fresnel=Dielectric())
    show(figure, 5.75, 2.45, _floor(smooth), r"$W(\theta)$, $\eta$ = 1.5")
    return figure


def phong_and_blinn() -> Figure:
    """Draw r and h for one l and v, and a ball with each highlight."""
    figure = page("Phong looks at the mirror direction $r$, Blinn at the halfway vector $h$: half the angle", 9.6, 3.4)
    l, n, v = toward(-50), toward(0), toward(18)
    r, h = evaluate(reflect, l, n), evaluate(halfway, l, v)
    phi, alpha = _angle(v, r), _angle(n, h)
    axes = sheet(figure, (0.1, 0.5), (4.1, 2.9), (-1.2, 1.2), (-0.32, 1.36))
    axes.fill_between([-1.1, 1.1], -0.08, 0, color="0.8", linewidth=0)
    for direction, name, colour in (
        (l, "l", "#b07a00"),
        (n, "n", "black"),
        (v, "v", "black"),
        (r, "r", COLOURS[1]),
        (h, "h", COLOURS[0]),
    ):
        vector(axes, direction, name, colour)
    arc(axes, 18.0, 18 + phi, 0.62, r"$\phi$")
    arc(axes, 0.0, -alpha, 0.62, r"$\alpha$")
    words = rf"$\phi = \angle(v, r)$ = {phi:.1f}°,   $\alpha = \angle(n, h)$ = {alpha:.1f}° = $\phi/2$"
    axes.text(0, -0.2, words, ha="center", va="center", fontsize=10)
    for i, (name, lobe, n_s) in enumerate((("Phong", Phong(), 20), ("Blinn", Blinn(), 20), ("Blinn", Blinn(), 80))):
        image = ball(Material(**PLASTIC, n_s=n_s, lobe=lobe))
        show(figure, 4.5 + i * 1.6, 1.15, image, f"{name}, $n_s$ = {n_s}")
    return figure


def viewers() -> Figure:
    """Draw balls and a wall with v towards the eye from each point, and with one v for all."""
    wall = Object(Plane((0, 0, -1), (0, 0, 1)), Material(0.05, 0.15, 0.3, 12))
    balls = [Object(Sphere((2.3 * i, 0, 0)), Material(**PLASTIC, n_s=30)) for i in range(-2, 3)]
    scene = Scene([wall, *balls], DirectionalLight((0, -0.25, -1)))
    rows = [
        [picture(scene, OrthographicCamera((0, 0, 4), height=3, shape=(190, 760), local_viewer=local))]
        for local in (True, False)
    ]
    labels = [
        "$v$ from each point: the highlights turn to the eye",
        "one $v$ for all: the same highlight on each ball, ",
    ]
    labels[1] += "and an even wall"
    return grid("One $v$ for all points is cheaper, and right only for a far eye", rows, labels=labels)


def _floor(material: Material) -> Picture:
    """Return a floor that is lit from its far end."""
    scene = Scene(Object(Plane(), material), PointLight((0, 1.2, -10), intensity=1.5), background=PALE)
    return picture(scene, Camera((0, 1.0, 3), target=(0, 0, -3), fov=30, shape=(160, 300)))


def _reflectance(material: Material, n: Vec3, l: Vec3, v: Vec3) -> Array:
    return reflectance(material, material.at(None), n, l, v).x


def _weight(fresnel: AbstractFresnel, k_s: float, eta: float, theta: np.ndarray) -> np.ndarray:
    k, cos = Material(k_s=k_s).at(None).k_s, toward(theta).y
    return evaluate(lambda cos: fresnel.weight(k, np.asarray(eta), cos), cos).x * np.ones_like(cos)


def _angle(a: Vec3, b: Vec3) -> float:
    return float(np.rad2deg(np.arccos(evaluate(dot, a, b))))
