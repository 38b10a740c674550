"""three.js: MeshPhongMaterial as JSON for its MaterialLoader, or as JavaScript.

Under a light of pi I it computes I (n.l) (diffuse + F (n_s/2 + 1)/4 (n.h)^n_s), where F is Schlick's weight of the
specular colour with (1 - v.h)^5 as 2^((-5.55473 v.h - 6.98316) v.h). This library has no such lobe, so materials are
refitted both ways. JSON holds colours as bytes on the sRGB curve.
"""

from __future__ import annotations

import json
import logging
import re
from typing import Any

import numpy as np

from ..model.lobes import Blinn
from ..model.materials import Material
from .exports import Draft, comment, notes_on_glass, notes_on_lights, opacity, plain, stated
from .hex_colours import from_hex, to_hex
from .lobe_refits import N_S_RANGE, Shape, check_plain, named
from .parsing import NUMBER, number, short
from .reference import Cosines, Radiance, Reference, differences, radiance, reference, reference_of

_COLOUR = re.compile(r"\b(color|emissive|specular)\s*:\s*new THREE\.Color\(\)\.setRGB\(([^()]{1,200})\)", re.ASCII)
_NUMBER = re.compile(r"\b(shininess|opacity)\s*:\s*([^,}\s]{1,40})", re.ASCII)
_LOGGER = logging.getLogger("diffshade")


def fresnel(points: Reference) -> Cosines:
    """Return three.js's approximation of (1 - v.h)^5."""
    return np.exp2((-5.55473 * points.v_h - 6.98316) * points.v_h)


def highlights(points: Reference) -> Shape:
    """Return the highlights of MeshPhongMaterial, linear in the specular colour."""
    grazing = fresnel(points)

    def lobe(n: float) -> Cosines:
        return points.n_l * 0.25 * (n / 2 + 1) * points.n_h**n

    return Shape(lambda n: lobe(n) * (1 - grazing), N_S_RANGE, 1.0, lambda n: lobe(n) * grazing)


def _fitted(material: Material, *, bytes_: bool) -> tuple[dict[str, Any], float, float, list[str]]:
    """Return the settings of a MeshPhongMaterial, its error, and the notes."""
    check_plain(material)
    points = reference_of(material)
    target, shape, k_d = radiance(material, points), highlights(points), np.asarray(material.k_d)
    own = target - points.n_l[:, None] * k_d
    n_s, specular = shape.fit(own)
    colour, emissive = k_d, np.asarray(material.k_e) + np.asarray(material.k_a)
    strength = max(1.0, float(emissive.max()))
    notes = []
    if bytes_:
        colour, specular, glow = (from_hex(to_hex(k)) for k in (colour, specular, emissive / strength))
        emissive = glow * strength
    found: Radiance = points.n_l[:, None] * colour + shape.of(n_s, specular)
    if not np.any(own):  # three.js reflects at grazing angles even if the specular colour is black
        found, n_s = points.n_l[:, None] * colour + shape.of(N_S_RANGE[0], specular), N_S_RANGE[0]
    rms, largest = differences(target + np.asarray(material.k_e) + np.asarray(material.k_a), found + emissive)
    notes.append(f"the highlight, {named(material)}, is refitted with shininess {n_s:.4g}: {stated(rms, largest)}")
    notes.append(
        "multiply the intensity of each light by pi, and use no AmbientLight: emissive includes k_a for an ambient "
        "light of 1."
    )
    settings = {"color": colour, "emissive": emissive, "specular": specular, "shininess": n_s}
    return settings | {"strength": strength, "opacity": opacity(material)}, rms, largest, notes


def write_json(name: str, material: Material, lights: Any) -> Draft:
    """Return the JSON that THREE.MaterialLoader reads."""
    settings, rms, largest, notes = _fitted(material, bytes_=True)
    notes += _notes_on_omissions(material, lights)
    strength = settings["strength"]
    document = {
        "metadata": {"version": 4.6, "type": "Material", "generator": "diffshade"},
        "uuid": name,
        "type": "MeshPhongMaterial",
        "name": name,
        "color": to_hex(settings["color"]),
        "emissive": to_hex(settings["emissive"] / strength),
        "emissiveIntensity": strength,
        "specular": to_hex(settings["specular"]),
        "shininess": settings["shininess"],
        "opacity": settings["opacity"],
        "transparent": settings["opacity"] < 1,
        "userData": {"diffshade": notes},
    }
    return Draft(json.dumps(document, indent=2) + "\n", rms, largest, tuple(notes))


def write_js(name: str, material: Material, lights: Any) -> Draft:
    """Return a JavaScript module that exports the material."""
    settings, rms, largest, notes = _fitted(material, bytes_=False)
    notes += _notes_on_omissions(material, lights)
    rows = [
        f"  {key}: new THREE.Color().setRGB({plain(settings[key])}, THREE.LinearSRGBColorSpace),"
        for key in ("color", "emissive", "specular")
    ]
    rows += [f"  {key}: {settings[key]!r}," for key in ("shininess", "opacity")]
    rows.append(f"  transparent: {'true' if settings['opacity'] < 1 else 'false'},")
    body = "\n".join(
        ['import * as THREE from "three";', "", f"export const {name} = new THREE.MeshPhongMaterial({{", *rows]
    )
    return Draft(f"{comment(notes, '//')}\n{body}\n}});\n", rms, largest, tuple(notes))


def _notes_on_omissions(material: Material, lights: Any) -> list[str]:
    return [
        *notes_on_glass(material, "MeshPhongMaterial", colour=False, eta=False),
        *notes_on_lights(lights, "three.js"),
    ]


def read_json(text: str, where: str) -> dict[str, Material]:
    """Read the JSON of a MeshPhongMaterial."""
    try:
        document = json.loads(text)
    except (json.JSONDecodeError, RecursionError, ValueError) as error:
        raise ValueError(f"{where} is not JSON: {short(str(error))}. Correct the file.") from None
    if not isinstance(document, dict) or document.get("type") != "MeshPhongMaterial":
        raise ValueError(f"{where} does not hold a MeshPhongMaterial of three.js. Give the JSON of its toJSON().")

    def one(key: str, default: float) -> float:
        value = document.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
            raise ValueError(
                f"{where}: {key} must be a finite number; got {short(repr(value)[:80])}. Correct the file."
            )
        return float(value)

    def colour(key: str, default: int) -> np.ndarray:
        value = document.get(key, default)
        if type(value) is not int or not 0 <= value <= 0xFFFFFF:
            raise ValueError(
                f"{where}: {key} must be a colour, 0 to 16777215; got {short(repr(value)[:80])}. Correct the file."
            )
        return from_hex(value)

    glow = colour("emissive", 0) * one("emissiveIntensity", 1.0)
    return _as_material(
        colour("color", 0xFFFFFF),
        glow,
        colour("specular", 0x111111),
        one("shininess", 30.0),
        one("opacity", 1.0),
        where,
    )


def read_js(text: str, where: str) -> dict[str, Material]:
    """Read a MeshPhongMaterial as `write_js` writes one."""
    if "MeshPhongMaterial" not in text:
        raise ValueError(
            f"{where} creates no MeshPhongMaterial. Give JavaScript in the form that write_material writes."
        )
    text = re.sub(r"//[^\n]*", "", text)
    values = {"color": [1.0] * 3, "emissive": [0.0] * 3, "specular": list(from_hex(0x111111))}
    for key, inside in _COLOUR.findall(text):
        words = [word.strip() for word in inside.split(",")]
        if words[-1:] != ["THREE.LinearSRGBColorSpace"] or len(words) != 4 or not all(map(NUMBER.fullmatch, words[:3])):
            raise ValueError(
                f"{where}: {key} must be three numbers and LinearSRGBColorSpace; got {short(inside)}. Correct the file."
            )
        values[key] = [number(word, f"{where}: {key}") for word in words[:3]]
    scalars = {"shininess": 30.0, "opacity": 1.0}
    scalars |= {key: number(word, f"{where}: {key}") for key, word in _NUMBER.findall(text)}
    k = {key: np.asarray(value) for key, value in values.items()}
    return _as_material(k["color"], k["emissive"], k["specular"], scalars["shininess"], scalars["opacity"], where)


def _as_material(
    colour: np.ndarray, emissive: np.ndarray, specular: np.ndarray, shininess: float, alpha: float, where: str
) -> dict[str, Material]:
    """Return the Blinn material nearest to a MeshPhongMaterial, and warn of the difference."""
    if not 0 <= shininess <= N_S_RANGE[1] or (specular < 0).any():
        raise ValueError(
            f"{where}: shininess must be 0 to 100000 and specular at least 0; got {shininess:g}. Correct the file."
        )
    points = reference(shininess)
    target = highlights(points).of(shininess, specular)
    blinn = Shape(points.highlights(Blinn()), N_S_RANGE)
    n_s, k_s = blinn.fit(target)
    rms, largest = differences(target, blinn.of(n_s, k_s))
    _LOGGER.warning("%s: MeshPhongMaterial is refitted as Blinn with n_s %.4g: %s", where, n_s, stated(rms, largest))
    glass: dict[str, Any] = {"k_t": 1.0 - alpha} if alpha != 1 else {}
    try:
        return {"material": Material(0.0, colour, k_s, n_s, Blinn(), k_e=emissive, **glass)}
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
