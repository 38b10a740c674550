"""VTK and PyVista: the settings of a vtkProperty as Python (Phong's lobe; exponent to 128, coefficients to 1).

vtkProperty clamps its exponent and its coefficients silently; a term is a coefficient times a colour.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..core.fields import Array
from ..io.parsing import NUMBER, number, short
from ..model.lobes import Phong
from ..model.materials import Material
from .exports import Draft, comment, notes_on_glass, notes_on_lights, notes_on_refit, opacity, plain, stated, together
from .lobe_refits import with_lobe
from .names import identifiers, original
from .opengl import MAX_N_S
from .readings import Reading, read_declared
from .reference import differences, radiance, reference_of

_FUNCTION = re.compile(r"^def set_(\w{1,80})\(", re.ASCII | re.MULTILINE)
# What else of a vtkProperty changes how it looks.
_UNREAD = re.compile(
    "InterpolationTo(Flat|PBR)|Metallic|Roughness|BaseIOR|Coat\\w+|Anisotropy|EmissiveFactor|RepresentationTo(Wireframe|"
    "Points)|Lighting|Texture"
)
_SET = re.compile(r"\bSet([A-Za-z]{1,40})\(([^()\n]{0,400})\)", re.ASCII)


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


def read_vtk(text: str, where: str) -> Reading:
    """Read the material that each function set_NAME sets, or else the one that all calls of a vtkProperty set.

    Other parameters have VTK's defaults.
    """
    return read_declared(text, _FUNCTION, where, _read)


def _read(text: str, where: str, note: Callable[[str], None]) -> Material:
    values = {"Ambient": [0.0], "Diffuse": [1.0], "Specular": [0.0], "SpecularPower": [1.0], "Opacity": [1.0]}
    colours = {"AmbientColor": [1.0] * 3, "DiffuseColor": [1.0] * 3, "SpecularColor": [1.0] * 3}
    known, found = values | colours, False
    for key, inside in _SET.findall(re.sub(r"#[^\n]*", "", text)):
        if key not in known:
            if _UNREAD.fullmatch(key):
                note(f"Set{key} is not read.")
            continue
        words = [word.strip() for word in inside.split(",")]
        if not all(NUMBER.fullmatch(word) for word in words) or len(words) != len(known[key]):
            raise ValueError(
                f"{where}: Set{key} must be given {len(known[key])} numbers; got {short(inside)}. Write them out."
            )
        known[key], found = [number(word, f"{where}: {key}") for word in words], True
    if not found:
        raise ValueError(f"{where} sets nothing of a vtkProperty. Give Python code with property.SetDiffuse(...).")

    def k(term: str) -> Array:
        return np.clip(known[term][0], 0.0, 1.0) * np.asarray(known[f"{term}Color"])

    n_s, alpha = float(np.clip(known["SpecularPower"][0], 0.0, MAX_N_S)), known["Opacity"][0]
    glass: dict[str, Any] = {"k_t": 1.0 - alpha} if alpha != 1 else {}
    return Material(k("Ambient"), k("Diffuse"), k("Specular"), n_s, Phong(), **glass)
