"""POV-Ray 3.7: a texture with a finish (phong is exactly Phong's lobe, specular Blinn's: E5 and E6).

phong and specular are single numbers. A coloured highlight is POV-Ray's `metallic`, which tints it with the pigment:
1 + metallic (1 - F) (pigment - 1), F = .014567225/(x - 1.12)^2 - .011612903 within 0 and 1, x the angle of the light
over 90 degrees.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.thresholds import SINGLE
from ..model.fresnel import NoFresnel
from ..model.lobes import Blinn, Phong
from ..model.materials import Material
from .exports import Draft, comment, notes_on_lights, notes_on_refit, plain, stated, together
from .lobe_refits import check_plain, lowest, named, with_lobe
from .names import identifiers, original
from .reference import Cosines, Reference, differences, radiance, reference_of


def tint(pigment: Float[np.ndarray, "3"], metallic: float, n_l: Cosines) -> Float[np.ndarray, "n 3"]:
    """Return the colour of a highlight."""
    x = np.arccos(np.clip(n_l, 0.0, 1.0)) / (np.pi / 2)
    F = np.clip(0.014567225 / (x - 1.12) ** 2 - 0.011612903, 0.0, 1.0)
    return 1.0 + metallic * (1.0 - F)[:, None] * (pigment - 1.0)


def write_povray(materials: Mapping[str, Material], lights: Any) -> Draft:
    """Return `#declare NAME = texture {...}` of each material and, with eta, `#declare NAME_interior`."""
    names = identifiers(materials)
    return together({name: _written(name, names[name], m, lights) for name, m in materials.items()}, "\n")


def _written(name: str, word: str, material: Material, lights: Any) -> Draft:
    check_plain(material)
    second = _second(material)  # a finish holds one highlight of each lobe
    if second:
        material = dataclasses.replace(material, highlights=())
    lobe = Blinn() if isinstance(material.lobe, Blinn) else Phong()
    refit = with_lobe(material, lobe)
    m, points = refit.material, reference_of(material)
    k_a, k_d, k_s, k_e = (np.asarray(k) for k in (m.k_a, m.k_d, m.k_s, m.k_e))
    diffuse = float(k_d.max())
    hue = next((k for k in (k_d, k_s) if np.any(k)), np.ones(3))
    # it multiplies ambient and emission, which 0 would remove
    pigment = np.maximum(hue / hue.max(), SINGLE)
    notes, rms, largest = [*original(name, word), *notes_on_refit(refit)], refit.rms, refit.largest
    strength, metallic = float(k_s.max()), 0.0
    if np.ptp(k_s) > 0:
        strength, metallic = _metallic(points, lobe, float(m.n_s), pigment, k_s)
        found = points.n_l[:, None] * k_d + strength * (
            points.highlights(lobe)(float(m.n_s))[:, None] * tint(pigment, metallic, points.n_l)
        )
        rms, largest = differences(radiance(material, points), found)
        notes.append(
            f"POV-Ray colours a highlight only with the pigment; {named(m)} is written with metallic {metallic:.2g}:"
        )
        notes[-1] += f" {stated(rms, largest)}"
    k_t = np.zeros(3) if m.k_t is None else np.asarray(m.k_t)
    transmit = float(k_t.mean())
    if transmit > 0:
        notes.append(
            "POV-Ray does not reduce the highlight by k_t, and transmit has no colour: the mean of k_t is written."
        )
    highlight = _words(lobe, strength, float(m.n_s)) + (f" metallic {metallic!r}" if metallic else "")
    highlight = f"{highlight if np.any(k_s) else ''} {second}".strip()
    rows = [
        f"  pigment {{ rgbt <{plain([*pigment, transmit])}> }}",
        f"  finish {{ ambient rgb <{plain(k_a / pigment)}> emission rgb <{plain(k_e / pigment)}>",
        f"    diffuse {diffuse!r} {highlight} }}",
    ]
    notes.append("set global_settings { assumed_gamma 1 ambient_light rgb 1 }: k_a is for an ambient light of 1.")
    notes += notes_on_lights(lights, "POV-Ray")
    text = "\n".join([f"#declare {word} = texture {{", *rows, "}"]) + "\n"
    if m.eta is not None:
        text += f"#declare {word}_interior = interior {{ ior {plain(m.eta)} }}\n"
    return Draft(f"{comment(notes, '//')}{text}", rms, largest, tuple(notes))


def _second(material: Material) -> str:
    """Return the words of a second highlight, of the other lobe; none where a finish cannot hold it."""
    if len(material.highlights) != 1 or not isinstance(material.fresnel, NoFresnel):
        return ""
    both = (material, material.highlights[0])
    if {type(of.lobe) for of in both} != {Phong, Blinn} or any(np.ptp(of.k_s) > 0 or np.ndim(of.n_s) for of in both):
        return ""
    lobe, k_s, n_s = both[1].lobe, float(np.max(both[1].k_s)), float(both[1].n_s)
    assert isinstance(lobe, Phong | Blinn)
    return _words(lobe, k_s, n_s)


def _words(lobe: Phong | Blinn, strength: float, n_s: float) -> str:
    """Return a highlight as a finish has it."""
    if isinstance(lobe, Phong):
        return f"phong {strength!r} phong_size {n_s!r}"
    return f"specular {strength!r} roughness {1.0 / n_s if n_s > 0 else 1e9!r}"


def _metallic(
    points: Reference, lobe: Phong | Blinn, n_s: float, pigment: Float[np.ndarray, "3"], k_s: Float[np.ndarray, "3"]
) -> tuple[float, float]:
    """Return the strength and the metallic, 0 to 1, of the nearest highlight by least squares."""
    shape = points.highlights(lobe)(n_s)[:, None]
    target = shape * k_s

    def strength(metallic: float) -> float:
        basis = shape * tint(pigment, metallic, points.n_l)
        return float((basis * target).sum() / max(float((basis * basis).sum()), 1e-300))

    def cost(metallic: float) -> float:
        return float(np.sum((strength(metallic) * shape * tint(pigment, metallic, points.n_l) - target) ** 2))

    metallic = min((lowest(cost, 0.0, 1.0), 0.0, 1.0), key=cost)  # of a grey pigment all are alike
    return strength(metallic), metallic
