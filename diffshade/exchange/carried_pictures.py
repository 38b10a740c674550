"""Pictures of base colours, carried from one material file to another: where they lie, and how formats name them."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.words import listing
from ..io.files import write_file
from ..io.gltf_files import uri_of
from ..io.image_formats import encode
from .base_colours import CLAMP, MIRROR, REPEAT, STARTS, BaseColour, ColourPicture
from .names import identifiers

MIME = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".webp": "image/webp", ".bmp": "image/bmp"}
# Formats that pack pictures, with the suffixes of those that all programs show: glTF 2.0, 3.9; three.js shows what a
# browser does. Pictures of other kinds become PNG there.
SHOWN = {".gltf": (".png", ".jpg", ".jpeg"), ".json": tuple(MIME)}
GLTF_WRAPS = {REPEAT: 10497, CLAMP: 33071, MIRROR: 33648}  # as OpenGL numbers them
THREE_WRAPS = {REPEAT: 1000, CLAMP: 1001, MIRROR: 1002}


def carried(
    bases: Mapping[str, BaseColour], path: Path
) -> tuple[dict[str, BaseColour], dict[Path, bytes], tuple[str, ...]]:
    """Return base colours with the names that their pictures have in a file at another path.

    And the pictures that are to be written beside that file, and notes.

    A name stays where it leads to the same picture from there. Else the picture is packed where it was packed and the
    format packs, or lies beside the new file; as PNG where not all programs show it as it is.
    """
    found: dict[str, BaseColour] = {}
    copies: dict[Path, bytes] = {}
    names: dict[tuple[str, int], tuple[str, str]] = {}
    notes: dict[str, list[str]] = {}
    for (name, base), word in zip(bases.items(), identifiers(bases).values(), strict=True):
        picture = base.picture
        if picture is None:
            continue
        try:
            if (key := (picture.uri, picture.image)) not in names:
                names[key] = _name(picture, path, word, copies)
            uri, note = names[key]
        except (OSError, ValueError) as error:
            kept = not picture.is_packed
            uri, note = picture.uri, f"{error} {'Its name is written all the same.' if kept else 'It is left out.'}"
            picture = picture if kept else None
        if note:
            notes.setdefault(note, []).append(name)
        found[name] = base._replace(picture=picture and picture._replace(source=path, uri=uri))
    return found, copies, tuple(f"{listing(of)}: {note}" for note, of in notes.items())


def _name(picture: ColourPicture, path: Path, word: str, copies: dict[Path, bytes]) -> tuple[str, str]:
    """Return the name of a picture in a file at a path, and a note; what is to lie beside it is added to `copies`."""
    if "://" in picture.uri and not picture.is_packed:
        return picture.uri, ""
    shown, note = SHOWN.get(path.suffix.lower()), ""
    safe = shown or (picture.uri.isprintable() and not picture.uri.startswith("-") and "#" not in picture.uri)
    data = picture.read()
    suffix = picture.suffix_of(data)
    if shown and suffix not in shown:
        note = f"its picture is written as PNG: not all programs that read {path.suffix} show {suffix}."
        data, suffix = encode(".png", picture.stored(data)), ".png"
    elif not picture.is_packed and safe and _reaches(picture, path):
        return picture.uri, ""
    if picture.is_packed and shown:
        return f"data:{MIME[suffix]};base64,{base64.b64encode(data).decode()}", note
    if same := [there.name for there, copied in copies.items() if copied == data]:
        return same[0], note
    if picture.is_packed and suffix not in STARTS.values():
        raise ValueError("the picture that it holds is no PNG, JPEG, WebP or BMP.")
    file = None if picture.is_packed or not safe else picture.file()
    own = [] if file is None else [f"{file.stem}.png" if note else file.name]
    for last in (*own, *(f"{path.stem}_{word}{more}{suffix}" for more in ("", *range(2, 1000)))):
        there = path.parent / last
        if there not in copies and (not there.exists() or (there.is_file() and there.read_bytes() == data)):
            copies[there] = data  # no file of the user's is replaced
            return last, note
    raise ValueError(f"no name is free for its picture in {path.parent}.")


def _reaches(picture: ColourPicture, path: Path) -> bool:
    """Whether the name of a picture leads to it from a file at another path as well.

    A URI that is a whole path, of Windows or from the root, leads to no file beside a page.
    """
    name = picture.uri.replace("\\", "/")
    there = path.parent / name
    whole = path.suffix.lower() in SHOWN and name.startswith("/")
    return not whole and there.is_file() and there.resolve() == picture.file()


def write_copies(copies: Mapping[Path, bytes]) -> None:
    """Write the pictures beside a file, each of them whole; one that is there already stays."""
    for path, data in copies.items():
        if not (path.is_file() and path.read_bytes() == data):
            write_file(path, data)


def notes_on_base(
    base: BaseColour | None, program: str, *, turns: bool, mirrors: bool, metals: bool = True, alpha: bool = True
) -> list[str]:
    """Return notes on what a program does otherwise with a picture."""
    if base is None or base.picture is None:
        return []
    notes = []
    if base.is_metal and not metals:
        notes.append(f"its picture colours a metal's highlight, which {program} has of one colour: it is hardly seen.")
    if not turns and _parts(base.picture)[2]:
        notes.append(f"{program} does not turn pictures: the turn of its picture is not written.")
    if not alpha and (base.blends or base.cutoff is not None):
        notes.append(f"{program} draws the clear points of its picture as well.")
    if not mirrors and MIRROR in base.picture.wrap:
        notes.append(f"{program} does not mirror pictures: its picture is repeated.")
    return notes


def _parts(picture: ColourPicture) -> tuple[float, float, float]:
    """Return the scale along u and v, and the turn in radians, of which the place of a picture consists."""
    (a, b, _), (c, d, _) = picture.place
    wide = float(np.hypot(a, c))
    if not (b or c) or not wide:
        return float(a), float(d), 0.0
    return wide, float(a * d - b * c) / wide, float(np.arctan2(-c, a))


def rows_of_mtl(base: BaseColour | None) -> dict[str, str]:
    """Return the rows of an MTL that name a picture."""
    if base is None or base.picture is None:
        return {}
    picture, (wide, high, _) = base.picture, _parts(base.picture)
    x, y = float(picture.place[0][2]), float(1.0 - high - picture.place[1][2])  # v is up
    options = "-clamp on " if CLAMP in picture.wrap else ""
    options += f"-s {wide!r} {high!r} 1 " if (wide, high) != (1, 1) else ""
    options += f"-o {x!r} {y!r} 0 " if (x, y) != (0, 0) else ""
    keys = {"k_d": "map_Kd", "k_a": "map_Ka", "k_e": "map_Ke"}
    named = [keys[field] for field in base.fields if field in keys] + ["map_Ks"] * base.is_metal
    return dict.fromkeys(named, options + picture.uri)


def into_gltf(document: dict[str, Any], bases: Mapping[str, BaseColour]) -> None:
    """Add the pictures of materials to the document of a glTF file."""
    images, samplers, textures, transforms = [], [], [], False
    for row in document["materials"]:
        base = bases.get(row["name"])
        if base is None or (picture := base.picture) is None:
            continue
        wraps = {"wrapS": GLTF_WRAPS[picture.wrap[0]], "wrapT": GLTF_WRAPS[picture.wrap[1]]}
        filters = {"magFilter": 9728, "minFilter": 9728} if picture.nearest else {}
        texture = {"source": _index(images, {"uri": uri_of(picture.uri)}), "sampler": _index(samplers, wraps | filters)}
        info: dict[str, Any] = {"index": _index(textures, texture)}
        if picture.place != ColourPicture(picture.source).place:
            wide, high, turn = _parts(picture)
            placed = {"offset": [of[2] for of in picture.place], "rotation": turn, "scale": [wide, high]}
            info["extensions"] = {"KHR_texture_transform": placed}
            transforms = True
        extensions, pbr = row["extensions"], row["pbrMetallicRoughness"]
        if "k_e" not in base.fields:
            pbr["baseColorTexture"] = info
        elif any(pbr["baseColorFactor"][:3]) or extensions != {"KHR_materials_specular": {"specularFactor": 0.0}}:
            row["emissiveTexture"] = info
        else:  # emission alone
            colour = [*row.pop("emissiveFactor"), pbr["baseColorFactor"][3]]
            row["pbrMetallicRoughness"] = {"baseColorFactor": colour, "baseColorTexture": info}
            row["extensions"] = {"KHR_materials_unlit": {}}
        if base.is_metal and "specularColorFactor" in extensions["KHR_materials_specular"]:
            extensions["KHR_materials_specular"]["specularColorTexture"] = info
        if base.cutoff is not None:
            row |= {"alphaMode": "MASK", "alphaCutoff": base.cutoff}
        elif base.blends:
            row["alphaMode"] = "BLEND"
    used = {name for row in document["materials"] for name in row["extensions"]}
    document["extensionsUsed"] = sorted(used | ({"KHR_texture_transform"} if transforms else set()))
    document |= {"images": images, "samplers": samplers, "textures": textures} if images else {}


def into_three(tables: list[dict[str, Any]], bases: Mapping[str, BaseColour]) -> dict[str, Any]:
    """Add the pictures of materials to their tables of three.js's JSON; return its lists of textures and images."""
    urls, textures = [], []
    for table in tables:
        base = bases.get(table["name"])
        if base is None or (picture := base.picture) is None:
            continue
        wide, high, _ = _parts(picture)
        texture = {
            "uuid": f"texture_{len(textures)}",
            "image": f"image_{_index(urls, uri_of(picture.uri))}",
            "wrap": [THREE_WRAPS[of] for of in picture.wrap],
            "offset": [picture.place[0][2], 1.0 - high - picture.place[1][2]],
            "repeat": [wide, high],
            "magFilter": 1003 if picture.nearest else 1006,
            "colorSpace": "srgb",
            "flipY": True,
        }
        textures.append(texture)
        if "k_e" in base.fields and (table["color"], table["emissiveIntensity"]) == (0, 1) and "specular" not in table:
            table |= {"type": "MeshBasicMaterial", "color": table.pop("emissive"), "map": texture["uuid"]}
            del table["emissiveIntensity"]
        else:
            table["emissiveMap" if "k_e" in base.fields else "map"] = texture["uuid"]
        table |= {"emissiveMap": texture["uuid"]} if "k_a" in base.fields else {}  # which stands for ambient light
        table |= {"alphaTest": base.cutoff} if base.cutoff is not None else {}
        table |= {"transparent": True} if base.blends else {}
    images = [{"uuid": f"image_{i}", "url": url} for i, url in enumerate(urls)]
    return {"textures": textures, "images": images} if images else {}


def _index(rows: list[Any], row: Any) -> int:
    """Return the index of a row, which is added if it is not there."""
    if row not in rows:
        rows.append(row)
    return rows.index(row)
