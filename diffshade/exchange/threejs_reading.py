"""three.js, read: the materials of its JSON and of its scenes, as the classic ones nearest to them.

MeshLambertMaterial is a matte material and MeshBasicMaterial an unlit one, exactly; MeshPhongMaterial,
MeshStandardMaterial and MeshPhysicalMaterial are refitted. Numbers and words of a colour are on the sRGB curve.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.words import listing
from ..io.gltf_files import name_of
from ..io.parsing import short
from ..model.lobes import Blinn
from ..model.materials import Material
from .base_colours import CLAMP, MIRROR, REPEAT, BaseColour, ColourPicture, place_of
from .exports import stated
from .lobe_refits import N_S_RANGE, Shape
from .metallic_roughness import classic, metal_of, surface_of, what_of
from .readings import Reading, as_number, as_table, first_of, load_json
from .reference import differences, reference
from .threejs import fresnel, from_hex, highlights

KINDS = (
    "MeshPhongMaterial",
    "MeshStandardMaterial",
    "MeshPhysicalMaterial",
    "MeshLambertMaterial",
    "MeshBasicMaterial",
)
WRAPS = {1000: REPEAT, 1001: CLAMP, 1002: MIRROR}  # as three.js numbers them
_PLACED = {"wrap": 1001, "offset": 0, "repeat": 1}  # and what each of the two numbers is where it is left out
_USUAL = {"rotation": 0, "flipY": True, "channel": 0}  # of a texture that is read
_WORD = re.compile(r"(?:#|0[xX])([0-9a-fA-F]{6}|[0-9a-fA-F]{3})", re.ASCII)
# What the reading uses; what a program keeps for itself; and what has an effect unless it has this value.
_READ = re.compile(
    "type|name|uuid|color|emissive|emissiveIntensity|specular|shininess|opacity|transparent|"
    "roughness|metalness|ior|specularIntensity|specularColor|clearcoat|clearcoatRoughness|transmission"
)
_OWN = re.compile(
    "metadata|userData|version|side|shadowSide|depth\\w*|stencil\\w*|blend[A-Z]\\w*|colorSpace|dithering|fog|toneMapped|"
    "precision|polygonOffset\\w*|premultipliedAlpha|forceSinglePass|alpha(Test|Hash|ToCoverage)|"
    "wireframeLine\\w*|skinning|morph\\w*|overdraw|envMapIntensity|envMapRotation|normalMapType|\\w*Scale|lights|"
    "refractionRatio|reflectivity|combine|aoMapIntensity|lightMapIntensity|displacementBias|attenuation\\w*|"
    "iridescence(IOR|ThicknessRange)|anisotropyRotation|sheenColor|sheenRoughness|images|textures|vertexTangents"
)
_NEUTRAL: dict[str, tuple[Any, ...]] = {
    **dict.fromkeys(("sheen", "iridescence", "anisotropy", "dispersion", "thickness"), (0,)),
    **dict.fromkeys(("wireframe", "vertexColors", "flatShading"), (False,)),
    **dict.fromkeys(("visible", "colorWrite"), (True,)),
    "blending": (1, "NormalBlending"),
    "shading": (2, "smooth"),
}


def read_json(text: str, where: str) -> Reading:
    """Read all materials in the JSON of a material, an object, a scene or the editor."""
    reading, document = Reading(where), load_json(text, where)
    pictures = _pictures(document, Path(where))
    for key, table in _materials_in(document):
        _add(reading, table.get("name") or key or table.get("uuid"), str(table.get("type", "")), table, pictures)
    if not reading.materials and not reading.refused:
        raise ValueError(f"{where} holds no material of three.js. Give the JSON of its toJSON().")
    return reading


def _pictures(document: Any, source: Path) -> dict[str, ColourPicture | str]:
    """Return the pictures of the textures of a material, an object or a scene of the editor, by their uuid.

    Of a texture that is not read: why, as what follows "its map".
    """
    found: dict[str, ColourPicture | str] = {}
    for table in (as_table(document), as_table(as_table(document).get("scene"))):
        urls = {f"{of.get('uuid')}": of.get("url") for of in _tables(table, "images")}
        for of in _tables(table, "textures"):
            try:
                if other := [key for key, usual in _USUAL.items() if of.get(key, usual) != usual]:
                    said = listing([f"{key} {short(json.dumps(of[key]))[1:-1]}" for key in other])
                    found[str(of["uuid"])] = f"has {said}, which {'is' if len(other) == 1 else 'are'} not read"
                    continue
                (u, v), (x, y), (wide, high) = (of.get(key, (usual,) * 2) for key, usual in _PLACED.items())
                wrap, place = (WRAPS[u], WRAPS[v]), place_of((wide, 0.0, x), (0.0, high, 1.0 - high - y))  # v is up
                uri, nearest = urls[of["image"]], of.get("magFilter") == 1003
                if isinstance(uri, str):
                    found[str(of["uuid"])] = ColourPicture(
                        source, name_of(uri), wrap=wrap, nearest=nearest, place=place
                    )
            except (KeyError, TypeError, ValueError):
                continue
    return found


def _tables(table: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """Return the tables of a list in a table."""
    rows = table.get(key)
    return [as_table(of) for of in rows] if isinstance(rows, list) else []


def _materials_in(document: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every table whose type is a material, in its order, with the key that it stands at."""
    stack: list[tuple[str, Any]] = [("", document)]
    while stack:
        key, value = stack.pop()
        if isinstance(value, list):
            stack += [("", item) for item in reversed(value) if isinstance(item, dict | list)]
        elif isinstance(value, dict):
            kind, inside = value.get("type"), value.get("parameters")
            if (
                isinstance(kind, str)
                and kind.endswith("Material")
                and kind not in ("MultiMaterial", "MeshFaceMaterial")
            ):
                yield key, {**value, **inside} if isinstance(inside, dict) else value
            elif "DbgName" in value:
                yield "", {"type": "legacy", "name": value["DbgName"]}
            else:
                stack += [(key, item) for key, item in reversed(value.items()) if isinstance(item, dict | list)]


def _add(
    reading: Reading,
    name: Any,
    kind: str,
    settings: dict[str, Any],
    pictures: Mapping[str, ColourPicture | str],
) -> None:
    name = name if isinstance(name, str) and name else "material"
    name = reading.unused(name)
    reading.add(name, lambda: _read(kind, settings, name, reading))
    found = pictures.get(str(settings.get("map")), "names no picture that is read")
    picture = None if isinstance(found, str) else found
    fields = ("k_e",) if kind == "MeshBasicMaterial" else ("k_d",)
    reading.base.setdefault(name, BaseColour())
    cutoff = settings.get("alphaTest")
    reading.base[name] = reading.base[name]._replace(
        picture=picture,
        fields=fields,
        cutoff=float(cutoff) if isinstance(cutoff, int | float) and cutoff > 0 else None,
        blends=settings.get("transparent") is True and not cutoff,
    )
    if settings.get("map") is not None and picture is None:
        reading.note(name, f"its map {found}; its colour alone is.")


def _read(kind: str, settings: dict[str, Any], name: str, reading: Reading) -> Material:
    where = reading.at(name)
    if kind == "legacy":
        raise ValueError(f"{where} is of three.js's JSON of before 2014 (DbgName). Load and save it with three.js r70.")
    if kind not in KINDS:
        raise ValueError(f"{where}: a {short(kind)[1:-1]} is not read. Use one of {', '.join(KINDS)}.")

    def one(key: str, default: float, most: float = 1e300) -> float:
        return as_number(settings, key, default, where, most=most)

    def colour(key: str, default: int) -> Float[np.ndarray, "3"]:
        return _colour(settings.get(key, default), f"{where}: {key}")

    _note_the_rest(settings, name, reading)
    given: dict[str, Any] = {}
    alpha = one("opacity", 1.0, 1.0)
    if alpha < 1 and settings.get("transparent") is not True:
        reading.note(name, f"opacity {alpha:.3g} has no effect in three.js unless transparent is true; it is not read.")
    elif alpha < 1:
        given["k_t"] = 1.0 - alpha
    base = colour("color", 0xFFFFFF)
    if kind == "MeshBasicMaterial":
        return Material(k_e=base, **given)
    given["k_e"] = colour("emissive", 0) * one("emissiveIntensity", 1.0)
    if kind == "MeshLambertMaterial":
        return Material(k_d=base, lobe=Blinn(), **given)
    if kind == "MeshPhongMaterial":
        return _phong(base, colour("specular", 0x111111), one("shininess", 30.0), name, reading, given)
    roughness, metalness, more = one("roughness", 1.0, 1.0), one("metalness", 0.0, 1.0), dict[str, Any]()
    if kind == "MeshPhysicalMaterial":
        reflectivity = one("reflectivity", 0.5, 1.0)  # by which three.js's own JSON gives the index of refraction
        ior = one("ior", (1.0 + 0.4 * reflectivity) / (1.0 - 0.4 * reflectivity))
        more["edge"] = edge = one("specularIntensity", 1.0, 1.0)
        head_on = ((ior - 1) / (ior + 1)) ** 2 * colour("specularColor", 0xFFFFFF)
        more["dielectric"] = np.minimum(head_on, 1.0) * edge
        more |= {"coat": one("clearcoat", 0.0, 1.0), "coat_roughness": one("clearcoatRoughness", 0.0, 1.0)}
        if (through := one("transmission", 0.0, 1.0)) > 0:
            given |= {"k_t": 1.0 - alpha * (1.0 - through * base), "eta": ior}
            reading.note(name, "transmission is read as k_t, its colour times its factor, without blur.")
    surface = surface_of(base, metalness, roughness, grazing=fresnel, **more)
    reading.base[name] = BaseColour(metal=metal_of(surface, base, metalness))
    return classic(surface, name, what_of(metalness, roughness), reading, **given)


def _colour(value: Any, where: str) -> Float[np.ndarray, "3"]:
    """Return the linear colour of a number or word of sRGB, or of three linear numbers."""
    if isinstance(value, str) and (word := _WORD.fullmatch(value.strip())):
        digits = word.group(1)
        return from_hex(int(digits if len(digits) == 6 else "".join(2 * c for c in digits), 16))
    if type(value) is float and value == int(value):
        value = int(value)
    if type(value) is int and 0 <= value <= 0xFFFFFF:
        return from_hex(value)
    if isinstance(value, list) and len(value) == 3:
        return np.array([as_number({"": x}, "", 0.0, f"{where},") for x in value])
    raise ValueError(
        f"{where} must be a colour, 0 to 16777215, '#rrggbb' or three numbers; got {short(repr(value)[:80])}. Write it "
        "out."
    )


def _note_the_rest(settings: dict[str, Any], name: str, reading: Reading) -> None:
    """Note the settings that are not read and have an effect."""
    rest = [
        key
        for key, value in settings.items()
        if not _READ.fullmatch(key) and not _OWN.fullmatch(key) and value is not None
    ]
    maps = [key for key in rest if key == "map" or key.endswith("Map") or key == "matcap"]
    if maps:
        reading.note_maps(name, maps, ("map",))
    others = [key for key in rest if key not in maps and settings[key] not in _NEUTRAL.get(key, ())]
    if others:
        reading.note(name, f"settings that are not read: {first_of(others)}.")


def _phong(
    base: Float[np.ndarray, "3"],
    specular: Float[np.ndarray, "3"],
    shininess: float,
    name: str,
    reading: Reading,
    given: dict[str, Any],
) -> Material:
    """Return the Blinn material nearest to a MeshPhongMaterial."""
    where = reading.at(name)
    if shininess > N_S_RANGE[1]:
        raise ValueError(f"{where}: shininess must be 0 to 100000; got {shininess:g}. Correct the file.")
    points = reference(shininess)
    target = highlights(points).of(shininess, specular)
    blinn = Shape(points.highlights(Blinn()), N_S_RANGE)
    n_s, k_s = blinn.fit(target)
    rms, largest = differences(target, blinn.of(n_s, k_s))
    reading.note(name, f"MeshPhongMaterial is refitted as Blinn with n_s {n_s:.4g}: {stated(rms, largest)}")
    return Material(0.0, base, k_s, n_s, Blinn(), **given)
