"""VTK and PyVista: the settings of a vtkProperty as Python (Phong's lobe; exponent to 128, coefficients to 1).

vtkProperty clamps its exponent and its coefficients silently; a term is a coefficient times a colour.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..model.lobes import Phong
from ..model.materials import Material
from .exports import Draft, comment, notes_on_glass, notes_on_lights, notes_on_refit, opacity, plain, stated, together
from .lobe_refits import with_lobe
from .names import identifiers, original
from .opengl import MAX_N_S
from .reference import differences, radiance, reference_of


def write_vtk(materials: Mapping[str, Material], lights: Any) -> Draft:
    """Return Python functions `set_NAME(property)`, for a vtkProperty or PyVista's `actor.prop`."""
    names = identifiers(materials)
    return together({name: _written(name, names[name], m, lights) for name, m in materials.items()}, "\n\n")


def _written(name: str, word: str, material: Material, lights: Any) -> Draft:
    refit = with_lobe(material, Phong(), highest_n_s=MAX_N_S, highest_k=1.0)
    m, rms, largest = refit.material, refit.rms, refit.largest
    notes = [
        *original(name, word),
        *notes_on_refit(refit),
        *notes_on_glass(material, "VTK", colour=False, eta=False),
        *notes_on_lights(lights, "VTK"),
    ]
    ambient = np.asarray(m.k_a) + np.asarray(m.k_e)
    if np.any(m.k_e):
        notes.append("VTK has no emission: k_e is added to k_a, which is equivalent for an ambient light of 1.")
    if ambient.max() > 1.0:
        lost, points = ambient - np.minimum(ambient, 1.0), reference_of(material)
        rms, largest = differences(radiance(material, points) + lost, radiance(m, points))
        notes.append(f"VTK clamps the ambient term at 1: {stated(rms, largest)}")
        ambient = ambient - lost
    lines = ["property.SetInterpolationToPhong()"]
    for term, k in (("Ambient", ambient), ("Diffuse", np.asarray(m.k_d)), ("Specular", np.asarray(m.k_s))):
        strength = float(k.max())
        colour = k / strength if strength > 0 else np.ones(3)
        lines += [f"property.Set{term}({strength!r})", f"property.Set{term}Color({plain(colour)})"]
    lines += [f"property.SetSpecularPower({float(m.n_s)!r})", f"property.SetOpacity({opacity(material)!r})"]
    body = "\n".join(f"    {line}" for line in lines)
    return Draft(f"{comment(notes, '#')}\n\ndef set_{word}(property):\n{body}\n", rms, largest, tuple(notes))
