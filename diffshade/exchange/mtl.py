"""Wavefront MTL: Ka Kd Ks Ke Ns Ni d Tf illum, several named materials in a file (Alias|Wavefront 1995; Blinn's lobe).

illum 2 is Ka Ia + sum Ij (Kd (n.l) + Ks (n.h)^Ns), which is E1, E4 and E6. Ns is 0 to 1000.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.words import count
from ..model.lobes import Blinn
from ..model.materials import Material
from .exports import Draft, comment, notes_on_lights, notes_on_refit, plain
from .lobe_refits import with_lobe
from .parsing import number, numbers, short

HIGHEST = 1000.0
COLOURS = {"Ka": "k_a", "Kd": "k_d", "Ks": "k_s", "Ke": "k_e"}
_LOGGER = logging.getLogger("diffshade")


def write_mtl(materials: Mapping[str, Material], lights: Any) -> Draft:
    """Return the text of an MTL file; the error is that of the worst material."""
    text, notes, errors = "", notes_on_lights(lights, "MTL"), [(0.0, 0.0)]
    for name, material in materials.items():
        refit = with_lobe(material, Blinn(), highest_n_s=HIGHEST)
        own = notes_on_refit(refit)
        m, k_t = refit.material, np.zeros(3) if material.k_t is None else np.asarray(material.k_t)
        if any(np.max(np.asarray(k)) > 1 for k in (m.k_a, m.k_d, m.k_s)):
            own.append("coefficients above 1 are written unchanged; many programs clamp them to 1.")
        most = float(k_t.max())
        rows = {key: plain(getattr(m, field), " ") for key, field in COLOURS.items()}
        rows |= {"Ns": plain(m.n_s, " "), "d": plain(1.0 - most, " ")}
        if most > 0 and np.ptp(k_t) > 0:
            rows["Tf"] = plain(k_t / most, " ")  # k_t = (1 - d) Tf
        if m.eta is not None:
            rows["Ni"] = plain(m.eta, " ")
        rows["illum"] = "2" if np.any(m.k_s) else "1"
        text += comment(own, "#") + f"newmtl {name}\n" + "".join(f"{key} {row}\n" for key, row in rows.items()) + "\n"
        notes += [f"{name}: {note}" for note in own] if len(materials) > 1 else own
        errors.append((refit.rms, refit.largest))
    rms, largest = (max(of) for of in zip(*errors, strict=True))
    return Draft(text, rms, largest, tuple(notes))


def read_mtl(text: str, where: str) -> dict[str, Material]:
    """Read the materials of an MTL file by name. Maps are named in a warning and never opened."""
    found: dict[str, dict[str, list[str]]] = {}
    rows: dict[str, list[str]] | None = None
    maps = 0  # texture maps
    for i, line in enumerate(text.replace("\\\n", " ").splitlines(), 1):
        key, _, rest = line.partition("#")[0].strip().replace("\t", " ").partition(" ")
        if key == "newmtl":
            name = rest.strip()
            if not name or name in found:
                raise ValueError(f"{where}: line {i} must name a new material; got {short(name)}. Name each once.")
            rows = found[name] = {}
        elif key and rows is not None:
            maps += key.startswith(("map_", "bump", "disp", "decal", "refl", "norm"))
            rows[key] = rest.split()
    if not found:
        raise ValueError(f"{where} has no newmtl line, hence no material. Give an MTL file.")
    if maps:
        _LOGGER.warning("%s: %s ignored; only colours are read.", where, count(maps, "texture map"))
    return {name: _material(rows, f"{where}: {short(name)}") for name, rows in found.items()}


def _material(rows: Mapping[str, list[str]], where: str) -> Material:
    def one(key: str, default: float) -> float:
        words = [word for word in rows.get(key, []) if word != "-halo"]
        return number(" ".join(words), f"{where}: {key}") if key in rows else default

    def colour(key: str, default: float) -> list[float]:
        words = rows.get(key, [repr(default)] * 3)
        if len(words) not in (1, 3) or words[0] in ("spectral", "xyz"):
            raise ValueError(
                f"{where}: {key} must be one number or three; got {short(' '.join(words))}. Spectral files and CIE XYZ "
                "are not read; write RGB."
            )
        found = numbers(words, f"{where}: {key}")
        return found * 3 if len(found) == 1 else found

    given: dict[str, Any] = {field: colour(key, 0.0) for key, field in COLOURS.items()}
    illum = one("illum", 2.0)
    if illum == 0:  # the colour alone, unlit
        given = {"k_e": given["k_d"]}
    elif illum == 1:
        given["k_s"] = 0.0
    through = 1.0 - one("d", 1.0) if "d" in rows else one("Tr", 0.0)
    if through != 0:
        given["k_t"] = [through * filtered for filtered in colour("Tf", 1.0)]
    if "Ni" in rows:
        given["eta"] = one("Ni", 1.0)
    try:
        return Material(**given, n_s=one("Ns", 10.0), lobe=Blinn())
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
