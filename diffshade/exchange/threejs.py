"""three.js, written: MeshPhongMaterial, or MeshLambertMaterial for a matte one, as JSON or JavaScript.

Under a light of pi I, MeshLambertMaterial computes I (n.l) diffuse, and MeshPhongMaterial I (n.l) (diffuse + F (n_s/2 +
1)/4 (n.h)^n_s), where F is Schlick's weight of the specular colour with (1 - v.h)^5 as 2^((-5.55473 v.h - 6.98316)
v.h). This library has no such lobe, so materials are refitted both ways. JSON holds colours as bytes on the sRGB curve.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ..io.encodings import srgb_decode, srgb_encode
from ..model.materials import Material
from .base_colours import BaseColour
from .carried_pictures import into_three, notes_on_base
from .exports import Draft, comment, notes_on_glass, notes_on_lights, opacity, plain, stated, together
from .lobe_refits import N_S_RANGE, Shape, check_plain, is_matte, named
from .metallic_roughness import Colour3
from .names import identifiers, original
from .reference import Cosines, Radiance, Reference, differences, radiance, reference_of


def to_hex(colour: Float[np.ndarray, "3"]) -> int:
    """Return the nearest 0xRRGGBB of a linear colour, clamped to 0 to 1, on the sRGB curve."""
    r, g, b = (int(x) for x in np.rint(255.0 * np.asarray(srgb_encode(np.clip(colour, 0.0, 1.0)))))
    return (r << 16) + (g << 8) + b


def from_hex(value: int) -> Float[np.ndarray, "3"]:
    """Return the linear colour of 0xRRGGBB."""
    return np.asarray(srgb_decode(np.array([value >> 16, value >> 8 & 255, value & 255]) / 255.0))


def fresnel(cosine: Cosines) -> Cosines:
    """Return three.js's approximation of (1 - cosine)^5."""
    return np.exp2((-5.55473 * cosine - 6.98316) * cosine)


def lobe(points: Reference, n: float) -> Cosines:
    """Return the highlight of MeshPhongMaterial but for its weight, times n.l."""
    return points.n_l * 0.25 * (n / 2 + 1) * points.n_h**n


def highlights(points: Reference) -> Shape:
    """Return the highlights of MeshPhongMaterial, linear in the specular colour."""
    grazing = fresnel(points.v_h)
    return Shape(lambda n: lobe(points, n) * (1 - grazing), N_S_RANGE, 1.0, lambda n: lobe(points, n) * grazing)


def _fitted(
    material: Material, lights: Any, *, bytes_: bool
) -> tuple[str, dict[str, Colour3], dict[str, float], Draft]:
    """Return MeshPhongMaterial or MeshLambertMaterial, its colours and its numbers, and its error and notes."""
    check_plain(material)
    points = reference_of(material)
    target, k_d = radiance(material, points), np.asarray(material.k_d)
    colour, emissive = k_d, np.asarray(material.k_e) + np.asarray(material.k_a)
    strength, matte = max(1.0, float(emissive.max())), is_matte(material)
    shape = highlights(points)
    n_s, specular = (0.0, np.zeros(3)) if matte else shape.fit(target - points.n_l[:, None] * k_d)
    if bytes_:
        colour, specular, glow = (from_hex(to_hex(k)) for k in (colour, specular, emissive / strength))
        emissive = glow * strength
    found: Radiance = points.n_l[:, None] * colour + (0.0 if matte else shape.of(n_s, specular))
    rms, largest = differences(target + np.asarray(material.k_e) + np.asarray(material.k_a), found + emissive)
    notes, kind = [], "MeshLambertMaterial" if matte else "MeshPhongMaterial"
    if not matte:
        notes.append(f"the highlight, {named(material)}, is refitted with shininess {n_s:.4g}: {stated(rms, largest)}")
    elif largest > 0:
        notes.append(f"colours are rounded to bytes: {stated(rms, largest)}")
    notes += [
        "multiply the intensity of each light by pi, and use no AmbientLight: emissive includes k_a for an ambient "
        "light of 1.",
        *notes_on_glass(material, kind, colour=False, eta=False),
        *notes_on_lights(lights, "three.js"),
    ]
    colours = {"color": colour, "emissive": emissive} | ({} if matte else {"specular": specular})
    numbers = ({} if matte else {"shininess": n_s}) | {"opacity": opacity(material)}
    return kind, colours, numbers, Draft("", rms, largest, tuple(notes))


def write_json(materials: Mapping[str, Material], lights: Any, bases: Mapping[str, BaseColour] | None = None) -> Draft:
    """Return the JSON of one material that THREE.MaterialLoader reads, or of several as in a scene's JSON."""
    drafts, tables = {}, []
    for name, material in materials.items():
        kind, colours, numbers, draft = _fitted(material, lights, bytes_=True)
        on_base = notes_on_base((bases or {}).get(name), kind, turns=False, mirrors=True, metals=False)
        drafts[name] = draft._replace(notes=(*draft.notes, *on_base))
        strength = max(1.0, float(colours["emissive"].max()))
        table = {
            "uuid": name,
            "type": kind,
            "name": name,
            **{key: to_hex(k / strength if key == "emissive" else k) for key, k in colours.items()},
            "emissiveIntensity": strength,
            **numbers,
            "transparent": numbers["opacity"] < 1,
            "userData": {"diffshade": drafts[name].notes},
        }
        tables.append(table)
    pictures = into_three(tables, bases or {})
    document = {"metadata": {"version": 4.6, "type": "Material", "generator": "diffshade"}, **tables[0], **pictures}
    draft = together(drafts, "")
    if len(tables) > 1:
        document = {
            "metadata": document["metadata"] | {"type": "Object"},
            "materials": tables,
            **pictures,
            "object": {"uuid": "diffshade", "type": "Group"},
        }
        more = "load them with new THREE.ObjectLoader().parseMaterials(json.materials, {})."
        draft = draft._replace(notes=(*draft.notes, more))
    text = json.dumps(document, indent=2, ensure_ascii=False)
    return draft._replace(text=text + "\n")


def write_js(materials: Mapping[str, Material], lights: Any) -> Draft:
    """Return a JavaScript module that exports the materials."""
    drafts, named_ = {}, identifiers(materials)
    for name, material in materials.items():
        kind, colours, numbers, draft = _fitted(material, lights, bytes_=False)
        rows = [
            f"  {key}: new THREE.Color().setRGB({plain(colour)}, THREE.LinearSRGBColorSpace),"
            for key, colour in colours.items()
        ]
        rows += [f"  {key}: {value!r}," for key, value in numbers.items()]
        rows.append(f"  transparent: {'true' if numbers['opacity'] < 1 else 'false'},")
        notes = (*original(name, named_[name]), *draft.notes)
        opening = f"export const {named_[name]} = new THREE.{kind}({{"
        body = "\n".join([comment(notes, "//"), opening, *rows, "});\n"])
        drafts[name] = draft._replace(text=body, notes=notes)
    draft = together(drafts, "\n")
    return draft._replace(text=f'import * as THREE from "three";\n\n{draft.text}')
