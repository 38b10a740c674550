"""Wavefront MTL: Ka Kd Ks Ke Ns Ni d Tf illum, several named materials in a file (Alias|Wavefront 1995; Blinn's lobe).

illum 2 is Ka Ia + sum Ij (Kd (n.l) + Ks (n.h)^Ns), which is E1, E4 and E6. Ns is 0 to 1000. The keys Pr Pm Pc Pcr are
those of PBR programs (tinyobjloader, Blender). Keys are read in any case of letters, as most programs do.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.words import listing
from ..io.obj_files import COMMENT
from ..io.parsing import NUMBER, number, numbers, short
from ..model.lobes import Blinn
from ..model.materials import INDEX, Material
from .base_colours import CLAMP, REPEAT, BaseColour, ColourPicture
from .carried_pictures import notes_on_base, rows_of_mtl
from .exports import Draft, comment, notes_on_lights, notes_on_refit, plain, together
from .lobe_refits import with_lobe
from .metallic_roughness import classic, metal_of, surface_of, what_of
from .names import original, words
from .readings import Reading, first_of

MAX_N_S = 1000.0  # as the format has it
COLOURS = {"Ka": "k_a", "Kd": "k_d", "Ks": "k_s", "Ke": "k_e"}
MAPS = ("map_", "bump", "disp", "decal", "refl", "norm", "occlusion")
BASE = ("map_kd", "map_ka", "map_ks")  # those of the base colour, where they are the same
GLOWS = "map_ke"  # that of the emission, where there is none of k_d
# What the illumination models do beside the highlight, which is read. 0 to 2 do nothing more.
ILLUM = {
    3: "mirrors what surrounds it",
    4: "is glass that mirrors what surrounds it",
    5: "mirrors what surrounds it by Fresnel's law",
    6: "refracts, and mirrors what surrounds it",
    7: "refracts, and mirrors what surrounds it by Fresnel's law",
    8: "mirrors what surrounds it",
    9: "is glass that mirrors what surrounds it",
    10: "catches shadows only",
}
OPAQUE = (0, 1, 2, 3, 5, 8)
UNUSED = {
    "Ps": "sheen",
    "aniso": "brushing",
    "anisor": "the direction of brushing",
    "Km": "the share of a mirror",
    "sharpness": "that of mirror images",
}
ONE = {"1", "1.0", "1.000000"}  # as Blender 2.4 to 4.2 write it
BY_DIFFSHADE = comment((), "#").strip()
READ = ("Ka", "Kd", "Ks", "Ke", "Ns", "Ni", "d", "Tr", "Tf", "illum", "Pr", "Pm", "Pc", "Pcr")
SPELLING = {key.lower(): key for key in (*READ, *UNUSED)}
ETA_RANGE = (INDEX["lower"], INDEX["upper"])  # of refraction


def write_mtl(materials: Mapping[str, Material], lights: Any, bases: Mapping[str, BaseColour] | None = None) -> Draft:
    """Return the text of an MTL file; the error is that of the worst material."""
    named = words(materials)
    drafts = {
        name: _written(name, named[name], material, lights, (bases or {}).get(name))
        for name, material in materials.items()
    }
    return together(drafts, "")


def _written(name: str, word: str, material: Material, lights: Any, base: BaseColour | None) -> Draft:
    refit = with_lobe(material, Blinn(), highest_n_s=MAX_N_S)
    notes = [
        *original(name, word),
        *notes_on_refit(refit),
        *notes_on_base(base, "MTL", turns=False, mirrors=False, alpha=False),
    ]
    m, k_t = refit.material, np.zeros(3) if material.k_t is None else np.asarray(material.k_t)
    if any(np.max(np.asarray(k)) > 1 for k in (m.k_a, m.k_d, m.k_s)):
        notes.append("coefficients above 1 are written unchanged; many programs clamp them to 1.")
    most = float(k_t.max())
    rows = {key: plain(getattr(m, field), " ") for key, field in COLOURS.items()}
    rows |= {"Ns": plain(m.n_s, " "), "d": plain(1.0 - most, " ")}
    if most > 0 and np.ptp(k_t) > 0:
        rows["Tf"] = plain(k_t / most, " ")  # k_t = (1 - d) Tf
    if m.eta is not None:
        rows["Ni"] = plain(m.eta, " ")
    rows["illum"] = "9" if most == 1 else "2" if np.any(m.k_s) else "1"  # d 0 is read as a slip of an opaque illum
    rows |= rows_of_mtl(base)
    text = comment(notes, "#") + f"newmtl {word}\n" + "".join(f"{key} {row}\n" for key, row in rows.items()) + "\n"
    return Draft(text, refit.rms, refit.largest, (*notes_on_lights(lights, "MTL"), *notes))


def read_mtl(text: str, where: str) -> Reading:
    """Read the materials of an MTL file by name. Maps are named in a note and never opened."""
    reading, found = Reading(where), dict[str, dict[str, list[str]]]()
    rows: dict[str, list[str]] | None = None
    before: list[str] = []
    for line in text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        key, _, rest = COMMENT.split(line, 1)[0].strip().replace("\t", " ").partition(" ")
        if key.lower() == "newmtl":
            name = rest.strip() or "material"
            if not rest.strip():
                reading.note(name, "its newmtl line has no name; it is named 'material'.")
            if key != "newmtl":
                reading.note(name, f"{short(key)} is read as newmtl, as most programs do.")
            if name in found:
                reading.note(name, "it is defined more than once; the last definition is read, as most programs do.")
            rows = found[name] = {}
        elif key and rows is not None:
            rows[SPELLING.get(key.lower(), key)] = rest.split()
        elif key:
            before.append(key)
    if not found:
        raise ValueError(f"{where} has no newmtl line, hence no material. Give an MTL file.")
    if before:
        reading.note("", f"what stands before the first newmtl line is not read: {first_of(before)}.")
    idle = _idle_ambient(text.lstrip("\ufeff \r\n"), found)
    for name, rows in found.items():
        if idle and _is_white(rows, "Ka"):
            del rows["Ka"]
            reading.note(name, f"{idle}; it is not read.")
        reading.add(name, lambda rows=rows, name=name: _read(rows, name, reading))
    return reading


def _idle_ambient(text: str, found: Mapping[str, Mapping[str, list[str]]]) -> str:
    """Return why Ka 1 1 1 is no statement of a file, or "".

    Exporters write it where they know nothing of ambient light. No one means white ambient reflection of every
    material, be it red, blue or a picture; white of white, or of a map of its own, may be meant.
    """
    if text.startswith("# Blender"):
        return "Blender has no ambient light, and writes Ka 1 1 1 all the same"
    plain = all(_is_white(rows, "Ka") and not _has(rows, "map_ka") for rows in found.values())
    colourless = all(
        (_is_white(rows, "Kd") or "Kd" not in rows) and not _has(rows, "map_kd") for rows in found.values()
    )
    if text.startswith(BY_DIFFSHADE) or colourless or not plain:
        return ""
    return "Ka 1 1 1 of every material, whatever its colour, is what exporters write that know no ambient light"


def _has(rows: Mapping[str, list[str]], key: str) -> bool:
    """Whether a material has a row of a key, which is given in small letters."""
    return any(given.lower() == key for given in rows)


def _is_white(rows: Mapping[str, list[str]], key: str) -> bool:
    return key in rows and ONE.issuperset(rows[key])


def _read(rows: Mapping[str, list[str]], name: str, reading: Reading) -> Material:
    where = reading.at(name)

    def one(key: str, default: float) -> float:
        row = [word for word in rows.get(key, []) if word != "-halo"]
        return number(" ".join(row), f"{where}: {key}") if key in rows else default

    def colour(key: str, default: float) -> list[float]:
        row = rows.get(key, [repr(default)] * 3)
        if len(row) not in (1, 3) or row[0] in ("spectral", "xyz"):
            raise ValueError(
                f"{where}: {key} must be one number or three; got {short(' '.join(row))}. Spectral files and CIE XYZ "
                "are not read; write RGB."
            )
        found = numbers(row, f"{where}: {key}")
        return found * 3 if len(found) == 1 else found

    n_s = one("Ns", 10.0)
    if n_s < 0:
        reading.note(name, f"Ns {n_s:g} is below 0; it is read as 0, as programs clamp it.")
    illum = _illum(rows, one, name, reading)
    glass = _glass(rows, one, colour, illum, name, reading)
    picture, *others = (_picture(rows, name, reading, key) for key in BASE)
    of_ambient, of_highlight = (picture is not None and picture == other for other in others)
    fields = ("k_e",) if illum == 0 else ("k_d", "k_a") if of_ambient else ("k_d",)
    reading.base[name] = base = BaseColour(picture, fields, metal=float(of_highlight))
    if picture is None and (glowing := _picture(rows, name, reading, GLOWS)) is not None:
        reading.base[name] = base = BaseColour(glowing, ("k_e",))
    given: dict[str, Any] = {field: colour(key, 0.0) for key, field in COLOURS.items()}
    if "Kd" not in rows:
        given["k_d"] = [_without_colour(rows, name, reading)] * 3
    _note_the_rest(rows, name, reading)
    if illum == 0:  # the colour alone, unlit
        return Material(k_e=given["k_d"], n_s=max(n_s, 0.0), lobe=Blinn(), **glass)
    if _is_physical(rows):
        roughness, metallic = one("Pr", 0.5), one("Pm", 0.0)
        coat = {"coat": one("Pc", 0.0), "coat_roughness": one("Pcr", 0.0)}
        for key, value in {"Pr": roughness, "Pm": metallic, "Pc": coat["coat"], "Pcr": coat["coat_roughness"]}.items():
            if not 0 <= value <= 1:
                raise ValueError(f"{where}: {key} must be 0 to 1; got {value:g}. Correct the file.")
        surface = surface_of(np.asarray(given["k_d"]), metallic, roughness, **coat)
        reading.base[name] = base._replace(metal=metal_of(surface, np.asarray(given["k_d"]), metallic))
        more = {"k_a": given["k_a"], "k_e": given["k_e"], **glass}
        return classic(surface, name, what_of(metallic, roughness), reading, **more)
    if illum == 1:
        if np.any(given["k_s"]):
            reading.note(name, "illum 1 has no highlight; Ks is not read.")
        given["k_s"] = 0.0
    return Material(**given, n_s=max(n_s, 0.0), lobe=Blinn(), **glass)


def _picture(rows: Mapping[str, list[str]], name: str, reading: Reading, key: str) -> ColourPicture | None:
    """Return the picture of a map, placed as its options -s and -o say; others are not read."""
    words = next((list(row) for given, row in rows.items() if given.lower() == key), [])
    scale, off, clamps = [1.0, 1.0], [0.0, 0.0], False
    while words and words[0].startswith("-"):
        option, most = words.pop(0).lower(), {"-o": 3, "-s": 3, "-t": 3, "-mm": 2}
        values = []
        while words and len(values) < most.get(option, 1) and (NUMBER.fullmatch(words[0]) or option not in most):
            values.append(words.pop(0))
        if option in ("-s", "-o"):
            found = scale if option == "-s" else off
            found[: len(values[:2])] = numbers(values[:2], f"{reading.at(name)}: {option} of {key}")
        clamps |= option == "-clamp" and values == ["on"]
    if not words:
        return None
    place = ((scale[0], 0.0, off[0]), (0.0, scale[1], 1.0 - scale[1] - off[1]))  # v of an OBJ is up
    return ColourPicture(
        Path(reading.where), " ".join(words), wrap=(CLAMP, CLAMP) if clamps else (REPEAT, REPEAT), place=place
    )


def _without_colour(rows: Mapping[str, list[str]], name: str, reading: Reading) -> float:
    """Return k_d of a material without Kd: 1, which a map multiplies, or 0."""
    if _has(rows, "map_kd"):
        reading.note(name, "map_Kd stands without Kd; it is read as 1, which the map multiplies.")
        return 1.0
    reading.note(name, "it has no Kd, for which each program has a grey of its own; it is read as 0.")
    return 0.0


def _is_physical(rows: Mapping[str, list[str]]) -> bool:
    """Return whether only PBR keys describe the highlight."""
    return bool(rows.keys() & {"Pr", "Pm"}) and not rows.keys() & {"Ks", "Ns"}


def _illum(rows: Mapping[str, list[str]], one: Any, name: str, reading: Reading) -> float:
    """Return the illumination model, and note what it does beyond this one."""
    illum = one("illum", 2.0)
    if illum in ILLUM:
        reading.note(name, f"illum {illum:g} {ILLUM[int(illum)]}, which is not modelled; its other terms are read.")
    elif illum not in (0, 1, 2):
        reading.note(name, f"illum {illum:g} is no illumination model, 0 to 10; it is read as 2.")
    return illum


def _glass(
    rows: Mapping[str, list[str]], one: Any, colour: Any, illum: float, name: str, reading: Reading
) -> dict[str, Any]:
    """Return k_t and eta."""
    for key in ("d", "Tr"):
        if not 0 <= one(key, 0.0) <= 1:
            raise ValueError(f"{reading.at(name)}: {key} must be 0 to 1; got {one(key, 0.0):g}. Correct the file.")
    through = 1.0 - one("d", 1.0) if "d" in rows else one("Tr", 0.0)
    if "-halo" in rows.get("d", []):
        reading.note(name, "-halo makes the middle of a surface clearer; its d is read as that of all angles.")
    if "d" in rows and "Tr" in rows and abs(one("Tr", 0.0) - through) > 1e-3:
        reading.note(name, f"Tr {one('Tr', 0.0):g} contradicts d {1.0 - through:g}; d is read.")
    if through == 1 and illum in OPAQUE:
        given = "d 0" if "d" in rows else "Tr 1"
        reading.note(
            name, f"{given} with the opaque illum {illum:g} is read as opaque, as the programs mean that write it."
        )
        through = 0.0
    found: dict[str, Any] = {}
    if through != 0:
        found["k_t"] = [through * filtered for filtered in colour("Tf", 1.0)]
    elif set(colour("Tf", 1.0)) != {1.0}:
        reading.note(name, "Tf filters what passes through, and by d and Tr nothing does; it is not read.")
    eta = one("Ni", 1.0)
    if not ETA_RANGE[0] <= eta <= ETA_RANGE[1]:
        reading.note(
            name, f"Ni {eta:g} is no index of refraction, {ETA_RANGE[0]:g} to {ETA_RANGE[1]:g}; it is not read."
        )
    elif "Ni" in rows:
        found["eta"] = eta
    return found


def _note_the_rest(rows: Mapping[str, list[str]], name: str, reading: Reading) -> None:
    """Note the keys that are not read."""
    maps = [key for key in rows if key.lower().startswith(MAPS)]
    if maps:
        of = {key.lower(): rows[key] for key in maps}
        same = [key for key in maps if key.lower() in BASE and rows[key] == of.get("map_kd")]
        reading.note_maps(name, maps, same or [key for key in maps if key.lower() == GLOWS])
    for key, meaning in UNUSED.items():
        if set("".join(rows.get(key, []))) - set("0.+-"):
            reading.note(name, f"{key}, {meaning}, is not modelled.")
    physical = [key for key in ("Pr", "Pm", "Pc", "Pcr") if key in rows]
    if physical and not _is_physical(rows):
        reading.note(name, f"{listing(physical)} describe the surface for PBR programs; Ks and Ns are read instead.")
    unknown = [key for key in rows if key not in (*READ, *UNUSED, *maps)]
    if unknown:
        reading.note(name, f"unknown keys are not read: {first_of(unknown)}.")
