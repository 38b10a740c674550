"""Faults of a set-up: what each changes in the pictures, its plausible sizes, its words. A new fault is an entry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...core.words import listing
from ...model.lobes import Blinn
from . import changes, regional
from .changes import BLURS, FACTORS
from .found import Fault, Found

FREE_SENSOR = "or give the views a Sensor() and free"
OWN_MASK = "and give each View a mask"

FAULTS = (
    Fault(
        "exposure",
        lambda f: f"views[{f.which}] is {f.size:.3g} times as bright as {_than_what(f)}",
        lambda f: (
            f"Give it exposure={f.size * float(f.given.views[f.which].exposure):.3g} or free "
            f"'views.{f.which}.exposure', and check its lights: a wrong intensity or distance looks the same."
        ),
        changes.of_exposure,
        changes.exposures,
        size=lambda which, amount: 1.0 + float(amount[0]),
        least=0.03,
        relative=True,
        least_share=regional.SHARE,
        confirmed=regional.corrects_most_pixels,
        of_most=lambda found: (
            f"{len(found)} of the {len(found[0].given.views)} views are darker or brighter than the other views "
            f"predict, by factors of {min(f.size for f in found):.3g} to {max(f.size for f in found):.3g}. Check the "
            "lights' intensities, distances and attenuation and whether the material model is complete, or free "
            "'exposure'."
        ),
    ),
    Fault(
        "light",
        lambda f: (
            f"judging by the shading in {named(f.views)}, lights.{f.which} is {f.length:.2g} degrees off as seen from "
            "the surface"
        ),
        lambda f: f"Measure the light again, or free {_place(f)}.",
        changes.of_light,
        changes.places,
        least=2.5,
        least_share=0.15,
        of_most=lambda found: (
            f"{len(found)} of the {len(found[0].given.scene.lights)} lights are "
            f"{min(f.length for f in found):.2g} to {max(f.length for f in found):.2g} degrees off, judging by the "
            "shading. Check the axes of directions and normals, that directions point the way the light travels, and "
            "whether the material model is complete."
        ),
    ),
    Fault(
        "shadow",
        lambda f: f"predicted light is missing, as in a cast shadow: {f.where}",
        lambda f: "Exclude these pixels with View.mask, or fit with loss='cauchy'.",
        least_share=regional.SHARE,
        regions=regional.shadows,
        confirmed=regional.in_shadow,
        described=regional.where_shadows_are,
    ),
    Fault(
        "rim",
        lambda f: f"the rim in {named(f.views)} is brighter than predicted{f.where}",
        lambda f: (
            "Possible causes are interreflection or another form of highlight. Exclude the rim with View.mask, or fit "
            "with loss='cauchy'."
        ),
        least_share=regional.SHARE,
        regions=regional.bright_rims,
        confirmed=regional.at_bright_rims,
        described=regional.how_bright_rims_are,
    ),
    Fault(
        "vignetting",
        lambda f: f"the images darken towards their corners by about {f.size:.0%} (vignetting)",
        lambda f: (
            f"Divide them by 1 - {f.size:.2g} rho^2, with rho the distance from the centre over that of a corner, or "
            f"use a smaller aperture, {FREE_SENSOR} 'sensor.vignetting.second'."
        ),
        changes.of_vignetting,
        plausible=(0.0, 0.9),
    ),
    Fault(
        "gamma",
        lambda f: f"the images look like linear ones raised to the power {f.size:.4g} (gamma)",
        lambda f: (
            f"Raise them to the power {1.0 / f.size:.4g}, read them with the camera's own curve, {FREE_SENSOR} "
            "'sensor.gamma'."
        ),
        changes.of_gamma,
        size=lambda which, amount: 1.0 + float(amount[0]),
        plausible=(0.3, 1.7),
    ),
    Fault(
        "blur",
        lambda f: (
            f"the images are blurred by about {f.size:.2g} pixels (standard deviation), or the highlights have wider "
            "edges than the lobe"
        ),
        lambda f: "Focus, or shrink the images, and exclude the pixels next to outlines with View.mask.",
        changes.of_blur,
        size=lambda which, amount: BLURS[which] * float(np.sqrt(np.maximum(amount[0], 0.0))),
        plausible=(0.0, 4.0),
    ),
    Fault(
        "lobe",
        lambda f: "the highlights fit {1}'s lobe better than {0}'s".format(*_lobes(f)),
        lambda f: f"Give Material(lobe=ds.{_lobes(f)[1]}()), or compare both with ds.compare.",
        changes.of_lobe,
        plausible=(0.4, 1.7),  # 1 is exactly the other lobe
    ),
    Fault(
        "highlight",
        lambda f: f"the highlights have a second, {_wider(f)} part, with n_s near {_exponent(f):.2g}",
        lambda f: f"Give the material highlights=ds.Highlight(k_s=0.1, n_s={_exponent(f):.2g}) and free both.",
        changes.of_second_highlight,
        plausible=(0.0, np.inf),
        yields_to=(
            "vignetting",
            "gamma",
            "blur",
            "lobe",
            "radius",
            "center",
            "rotation",
        ),  # of any width it is like many
    ),
    Fault(
        "radius",
        lambda f: (
            f"{_surface(f)}.radius seems to be about {float(_sphere(f).radius) + f.size:.3g}, but the scene has "
            f"{float(_sphere(f).radius):.3g}"
        ),
        lambda f: f"Measure it again, or free 'surface.radius' {OWN_MASK}.",
        changes.of_radius,
        lambda fit: changes.of_spheres(fit, "radius"),
        at_rims=False,
    ),
    Fault(
        "center",
        lambda f: (
            f"{_surface(f)}.center seems to be off by about {f.length:.2g}, near "
            f"{_numbers(np.asarray(_sphere(f).center) + f.amount, '.3g')}"
        ),
        lambda f: f"Measure it again, or free 'surface.center' {OWN_MASK}.",
        changes.of_center,
        lambda fit: changes.of_spheres(fit, "center"),
        yields_to=("radius",),  # one of its three amounts does nearly what the radius does
        at_rims=False,
    ),
    Fault(
        "rotation",
        lambda f: f"all lights together are turned by about {f.length:.2g} degrees around the axis {_axis(f)}",
        lambda f: f"Check the axes of the lights and of the camera, or free {_places(f)}.",
        changes.of_rotation,
        changes.places,
    ),
)


def named(views: Sequence[int]) -> str:
    """Name some views."""
    names = [f"views[{i}]" for i in views]
    return listing(names) if len(names) <= 4 else f"{len(names)} views ({names[0]} to {names[-1]})"


def _than_what(f: Found) -> str:
    count = len(f.given.views)
    if count == 2:
        return f"views[{1 - f.which}] predicts (or the other view is wrong by the inverse factor)"
    return "the other views predict" if count > 2 else "the scene predicts"


def _place(f: Found) -> str:
    light = (f.given if f.after is None else f.after.fit).scene.lights[f.which]
    what = light.placement[0]
    return f"'lights.{f.which}.{what}', which is near {_numbers(getattr(light, what), '.3g')}"


def _numbers(of: Any, form: str) -> str:
    return f"({', '.join(format(x, form) for x in np.asarray(of))})"


def _lobes(f: Found) -> tuple[str, str]:
    """Return the name of the material's own lobe, and of the other."""
    is_blinn = isinstance(f.given.scene.objects[f.which].material.lobe, Blinn)
    return ("Blinn", "Phong") if is_blinn else ("Phong", "Blinn")


def _wider(f: Found) -> str:
    return "sharper" if FACTORS[f.which] > 1 else "wider"


def _exponent(f: Found) -> float:
    shiny = (x.material.n_s for x in f.given.scene.objects if changes.shines(x.material.k_s))
    return FACTORS[f.which] * float(np.mean(np.asarray(next(shiny))))


def _surface(f: Found) -> str:
    return f"objects.{f.given.scene.objects[f.which].name or f.which}.surface"


def _sphere(f: Found) -> Any:
    return f.given.scene.objects[f.which].surface


def _axis(f: Found) -> str:
    return _numbers(f.amount / max(f.length, 1e-300), ".2g")


def _places(f: Found) -> str:
    names = ("direction", "position")
    return listing([f"'{n}'" for n in names if any(hasattr(light, n) for light in f.given.scene.lights)])
