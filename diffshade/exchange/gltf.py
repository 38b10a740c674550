"""glTF 2.0, and its binary form: metallic-roughness surfaces, with extensions (glTF 2.0; the KHR_materials_* family).

f0 = min(.04 specularColor, 1) specular and f90 = specular (KHR_materials_specular). This library has no GGX lobe, so
materials are refitted both ways.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from ..core.fields import in_short
from ..core.thresholds import SINGLE, TINY
from ..io.gltf_files import base_texture, material_names, name_of
from ..io.parsing import short
from ..model.materials import INDEX, Material
from .base_colours import CLAMP, MIRROR, REPEAT, BaseColour, ColourPicture, place_of
from .carried_pictures import into_gltf, notes_on_base
from .exports import Draft, notes_on_glass, notes_on_lights, opacity, stated, together
from .lobe_refits import check_plain, is_matte, named
from .metallic_roughness import F0, ROUGHNESS, MetallicRoughness, classic, metal_of, surface_of, what_of
from .readings import Reading, as_number, as_numbers, as_table, first_of, load_json
from .reference import as_blinn, differences, radiance, reference_of

PREFIX = "KHR_materials_"
# The extensions that are read, with their keys; and the keys of a material and of its metallic-roughness table.
READ = {
    "specular": ("specularFactor", "specularColorFactor"),
    "ior": ("ior",),
    "emissive_strength": ("emissiveStrength",),
    "transmission": ("transmissionFactor",),
    "unlit": (),
    "clearcoat": ("clearcoatFactor", "clearcoatRoughnessFactor"),
    "pbrSpecularGlossiness": ("diffuseFactor", "specularFactor", "glossinessFactor"),
}
ROW = ("name", "pbrMetallicRoughness", "emissiveFactor", "alphaMode", "alphaCutoff", "doubleSided")
PBR = ("baseColorFactor", "metallicFactor", "roughnessFactor")
WRAPS = {10497: REPEAT, 33071: CLAMP, 33648: MIRROR}  # as OpenGL numbers them
MAX_TABLES = 100  # tables of a material that are searched for textures; its own are a few dozen


def fitted(material: Material) -> tuple[MetallicRoughness, float, float]:
    """Return the surface nearest to a material by least squares, and the error."""
    check_plain(material)
    if is_matte(material) and np.max(material.k_d) <= 1:
        return MetallicRoughness(ROUGHNESS[1], np.asarray(material.k_d), np.zeros(3), 0.0), 0.0, 0.0
    points = reference_of(material)
    target = radiance(material, points)
    # D and Blinn's lobe then have the same curvature at the peak
    alpha = np.sqrt(2.0 / (as_blinn(material.n_s, material.lobe) + 2.0))
    head_on = np.clip(4.0 * alpha**2 * np.asarray(material.k_s), 1e-4, 0.9)
    start = [np.log(np.clip(np.sqrt(alpha), 0.05, 0.99)), *np.clip(np.asarray(material.k_d), 1e-3, 0.99), *head_on]

    def surface(x: np.ndarray) -> MetallicRoughness:
        return MetallicRoughness(float(np.exp(x[0])), x[1:4], x[4:], float(np.max(x[4:])))

    bounds = ([np.log(ROUGHNESS[0]), *np.zeros(6)], [np.log(ROUGHNESS[1]), *np.ones(6)])
    found = scipy.optimize.least_squares(
        lambda x: (surface(x).reflected(points) - target).ravel(), start, bounds=bounds, xtol=1e-12
    )
    best = surface(found.x)
    return best, *differences(target, best.reflected(points))


def write_gltf(materials: Mapping[str, Material], lights: Any, bases: Mapping[str, BaseColour] | None = None) -> Draft:
    """Return a glTF file with materials only."""
    drafts, rows = {}, []
    for name, material in materials.items():
        row, draft = _written(name, material, lights)
        on_base = notes_on_base((bases or {}).get(name), "glTF", turns=True, mirrors=True)
        drafts[name] = draft._replace(notes=(*draft.notes, *on_base))
        rows.append(row)
    draft = together(drafts, "")
    asset = {"version": "2.0", "generator": "diffshade", "extras": {"diffshade": draft.notes}}
    document: dict[str, Any] = {"asset": asset, "materials": rows}
    into_gltf(document, bases or {})
    return draft._replace(text=json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def _written(name: str, material: Material, lights: Any) -> tuple[dict[str, Any], Draft]:
    """Return a material of a glTF file, and its error and notes."""
    surface, rms, largest = fitted(material)
    notes = []
    if largest > 0:
        notes.append(f"the highlight, {named(material)}, is refitted as GGX with roughness {surface.roughness:.3g}:")
        notes[0] += f" {stated(rms, largest)}"
    if np.any(material.k_a):
        notes.append(f"glTF has no ambient reflection: k_a {in_short(material.k_a)} is not written.")
    if lights:
        notes += notes_on_lights(lights, "glTF")
        notes.append("KHR_lights_punctual, glTF's lights, has only the falloff 1/d^2.")
    base, through, ior = _glass(material, surface)
    notes += notes_on_glass(material, "glTF without transmission", colour=through > 0, eta=ior > 0)
    if through > 0:
        bends = ", and eta as KHR_materials_ior, which bends light only in a volume, which is not written" * (ior > 0)
        notes.append(f"k_t is written as KHR_materials_transmission, which is blurred by the roughness{bends}.")
    notes.append("multiply the intensity of each light by pi: glTF divides the diffuse term by pi.")
    k_e, strength = np.asarray(material.k_e), max(1.0, float(np.max(material.k_e)))
    alpha = 1.0 if through else opacity(material)
    head_on = surface.head_on * (1.0 - (material.k_t if through and material.k_t is not None else 0.0))
    specular, f0 = min(surface.edge, float(head_on.max())), ((ior - 1.0) / (ior + 1.0)) ** 2 if ior else F0
    extensions: dict[str, Any] = {"KHR_materials_specular": {"specularFactor": specular}}
    if specular > 0:
        extensions["KHR_materials_specular"]["specularColorFactor"] = [float(f) / specular / f0 for f in head_on]
    if through:
        extensions["KHR_materials_transmission"] = {"transmissionFactor": through}
    if ior:
        extensions["KHR_materials_ior"] = {"ior": ior}
    if strength > 1:
        extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
    row = {
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*map(float, base), alpha],
            "metallicFactor": 0.0,
            "roughnessFactor": ROUGHNESS[0] if through and not specular else surface.roughness,
        },
        "emissiveFactor": [float(k) for k in k_e / strength],
        "alphaMode": "BLEND" if alpha < 1 else "OPAQUE",
        "extensions": extensions,
    }
    return row, Draft("", rms, largest, tuple(notes))


def _glass(material: Material, surface: MetallicRoughness) -> tuple[Float[np.ndarray, "3"], float, float]:
    """Return the base colour, KHR_materials_transmission's factor and KHR_materials_ior's index; 0 for none of them.

    That factor t of the base colour c passes and 1 - t is diffused: t c = k_t, and (1 - t) c = (1 - k_t) k_d. This has
    a solution where t is the same in all colours. What neither bends nor has a colour is alpha, which means k_t.
    """
    eta = 0.0 if material.eta is None else float(material.eta)
    ior = eta if eta > 1 else 0.0
    if material.k_t is None or not np.any(material.k_t) or not (ior or np.ptp(material.k_t) > 0):
        return surface.base, 0.0, ior
    k_t = np.asarray(material.k_t)
    base = k_t + (1.0 - k_t) * surface.base
    through = (k_t / np.maximum(base, TINY))[base > 0]
    if np.ptp(through) > SINGLE:
        return surface.base, 0.0, 0.0
    return base, min(float(through.mean()), 1.0), ior


def read_gltf(text: str, where: str) -> Reading:
    """Read the materials of a glTF 2.0 file. Textures are named in a note and never opened."""
    document = as_table(load_json(text, where))
    version = as_table(document.get("asset")).get("version")
    if not isinstance(version, str) or not version.startswith("2"):
        raise ValueError(f"{where} is not glTF 2.0; its asset has the version {short(repr(version))}. Convert it.")
    rows = document.get("materials", [])
    reading = Reading(where)
    for name, row in zip(material_names(rows), rows, strict=True) if isinstance(rows, list) else ():
        reading.add(name, lambda row=row, name=name: _read(row, name, reading, document))
    return reading


def _read(row: Any, name: str, reading: Reading, document: dict[str, Any]) -> Material:
    at = reading.at(name)
    row = _table({"material": row}, "material", at)
    more, pbr = _table(row, "extensions", at), _table(row, "pbrMetallicRoughness", at)
    found = {key.removeprefix(PREFIX): _table(more, key, at) for key in more if key.removeprefix(PREFIX) in READ}
    _note_the_rest(row, pbr, more, found, name, reading)
    glow = as_numbers(row, "emissiveFactor", (0, 0, 0), 3, at)
    given: dict[str, Any] = {"k_e": glow * as_number(found.get("emissive_strength", {}), "emissiveStrength", 1.0, at)}
    glossy = found.get("pbrSpecularGlossiness")
    colour = as_numbers(pbr, "baseColorFactor", (1, 1, 1, 1), 4, at)
    if glossy is not None:
        colour = as_numbers(glossy, "diffuseFactor", (1, 1, 1, 1), 4, at)
    alpha = _alpha(row, float(colour[3]), name, reading)
    base = _base(row, float(colour[3]), name, reading, document)
    reading.base[name] = base
    through = as_number(found.get("transmission", {}), "transmissionFactor", 0.0, at, most=1.0)
    if through > 0:
        given["k_t"] = 1.0 - alpha * (1.0 - through * np.minimum(colour[:3], 1.0))
        reading.base[name] = base._replace(fields=("k_d", "k_t"))
        reading.note(name, "transmission is read as k_t, its base colour times its factor, without blur.")
    elif alpha < 1:
        given["k_t"] = 1.0 - alpha
    ior = as_number(found.get("ior", {}), "ior", 1.5, at)
    if (through > 0 or "ior" in found) and INDEX["lower"] <= ior <= INDEX["upper"]:
        given["eta"] = ior
    if "unlit" in found:
        given["k_e"] = colour[:3]  # all else is for programs that do not know the extension
        reading.base[name] = base._replace(fields=("k_e",))
        return Material(**given)
    coat = found.get("clearcoat", {})
    weight = as_number(coat, "clearcoatFactor", 0.0, at, most=1.0)
    width = as_number(coat, "clearcoatRoughnessFactor", 0.0, at, most=1.0)
    if glossy is not None:
        specular = as_numbers(glossy, "specularFactor", (1, 1, 1), 3, at)
        rough = 1.0 - as_number(glossy, "glossinessFactor", 1.0, at, most=1.0)
        diffuse = colour[:3] * max(0.0, 1.0 - float(specular.max()))
        head_on = np.minimum(specular, 1.0)
        surface = MetallicRoughness(float(np.clip(rough, *ROUGHNESS)), diffuse, head_on, 1.0, weight, width)
        return classic(surface, name, f"specular-glossiness surface of roughness {rough:.3g}", reading, **given)
    metallic = as_number(pbr, "metallicFactor", 1.0, at, most=1.0)
    rough = as_number(pbr, "roughnessFactor", 1.0, at, most=1.0)
    specular = found.get("specular", {})
    f0 = 1.0 if ior == 0 else ((ior - 1.0) / (ior + 1.0)) ** 2  # KHR_materials_ior: 0 stands for no refraction, F = 1
    edge = as_number(specular, "specularFactor", 1.0, at, most=1.0)
    dielectric = np.minimum(f0 * as_numbers(specular, "specularColorFactor", (1, 1, 1), 3, at), 1.0) * edge
    surface = surface_of(colour[:3], metallic, rough, dielectric, edge, coat=weight, coat_roughness=width)
    tints = base.picture is not None and specular.get("specularColorTexture") == base_texture(row)
    metal = 1.0 if tints else metal_of(surface, colour[:3], metallic)
    reading.base[name] = reading.base[name]._replace(metal=metal)
    if not through:
        return classic(surface, name, what_of(metallic, rough), reading, **given)
    left = np.maximum(1.0 - given["k_t"], TINY)  # times (1 - through) base, and times the highlight as it is there
    surface = surface._replace(base=np.minimum(surface.base * alpha * (1.0 - through) / left, 1.0))
    found = classic(surface, name, what_of(metallic, rough), reading, **given)
    shown = np.where(given["k_t"] < 1, 1.0 / left, 1.0)
    more = tuple(dataclasses.replace(of, k_s=of.k_s * shown) for of in found.highlights)
    return dataclasses.replace(found, k_s=found.k_s * shown, highlights=more)


def _base(row: dict[str, Any], alpha: float, name: str, reading: Reading, document: dict[str, Any]) -> BaseColour:
    """Return how the file colours the points of a material."""
    cutoff = as_number(row, "alphaCutoff", 0.5, reading.at(name)) if row.get("alphaMode") == "MASK" else None
    base = BaseColour(alpha=alpha, cutoff=cutoff, blends=row.get("alphaMode") == "BLEND")
    if not (texture := as_table(base_texture(row))):
        return base
    try:
        return base._replace(picture=_picture(texture, document, Path(reading.where)))
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        reading.note(name, "the texture of its base colour leads to no picture that is read; the colour alone is read.")
        return base


def _picture(texture: dict[str, Any], document: dict[str, Any], source: Path) -> ColourPicture:
    """Return the picture that a texture shows (glTF 2.0, 5.27 and 5.29), placed as KHR_texture_transform says."""
    of = document["textures"][texture["index"]]
    index = of.get("extensions", {}).get("EXT_texture_webp", of)["source"]
    sampler = document["samplers"][of["sampler"]] if "sampler" in of else {}
    placed = texture.get("extensions", {}).get("KHR_texture_transform", {})
    (x, y), (wide, high), turn = placed.get("offset", (0, 0)), placed.get("scale", (1, 1)), placed.get("rotation", 0)
    c, s = np.cos(turn), np.sin(turn)
    wrap = WRAPS[sampler.get("wrapS", 10497)], WRAPS[sampler.get("wrapT", 10497)]
    place = place_of((wide * c, high * s, x), (-wide * s, high * c, y))  # counter-clockwise, where v is down
    uri = name_of(document["images"][index].get("uri", ""))
    return ColourPicture(source, uri, index, wrap, sampler.get("magFilter") == 9728, place)


def _alpha(row: dict[str, Any], alpha: float, name: str, reading: Reading) -> float:
    """Return the opacity that the alpha mode makes of the base colour's fourth number."""
    mode = row.get("alphaMode", "OPAQUE")
    if mode == "BLEND":
        return min(alpha, 1.0)
    if mode == "MASK":
        return float(alpha >= as_number(row, "alphaCutoff", 0.5, reading.at(name)))
    if alpha < 1:
        reading.note(name, f"the alpha {alpha:.3g} has no effect in glTF while alphaMode is OPAQUE; it is not read.")
    return 1.0


def _table(table: dict[str, Any], key: str, where: str) -> dict[str, Any]:
    """Return a table within a table; one that is not there is empty."""
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise ValueError(f"{where}: {key} must be a table; got {short(repr(value)[:80])}. Correct the file.")
    return value


def _note_the_rest(
    row: dict[str, Any],
    pbr: dict[str, Any],
    more: dict[str, Any],
    read: dict[str, dict[str, Any]],
    name: str,
    reading: Reading,
) -> None:
    """Note textures, extensions and keys that are not read."""
    _note_textures(row, name, reading)
    for key in more:
        if key.removeprefix(PREFIX) not in READ:
            reading.note(name, f"the extension {short(key)} is not read.")
    known = [(row, ROW), (pbr, PBR), *((table, READ[key]) for key, table in read.items())]
    unknown = [
        key
        for table, keys in known
        for key in table
        if key not in (*keys, "extensions", "extras") and not key.endswith("Texture")
    ]
    if unknown:
        reading.note(name, f"unknown keys are not read: {first_of(unknown)}.")


def _note_textures(row: dict[str, Any], name: str, reading: Reading) -> None:
    """Note the names of all textures of a material, which are not read."""
    tables, found = [row], []
    for table in tables:  # grows: a material's tables are nested a few deep
        for key, value in table.items():
            if isinstance(value, dict) and len(tables) < MAX_TABLES:
                found += [key] if key.endswith("Texture") else []
                tables.append(value)
    specular = as_table(as_table(row.get("extensions")).get(f"{PREFIX}specular")).get("specularColorTexture")
    tints = specular is not None and specular == base_texture(row)
    own = ("baseColorTexture", "diffuseTexture", *["specularColorTexture"] * tints)
    reading.note_maps(name, list(dict.fromkeys(found)), own)
