"""Material files of other programs: formats by suffix, reading and writing."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.fields import check_kind, in_short
from ..core.words import did_you_mean, listing
from ..io.files import write_file
from ..io.parsing import read_glb, read_text, short
from ..io.scene_files import read_scene
from ..model.bands import check_rgb
from ..model.lights import AbstractLight
from ..model.materials import Material
from .base_colours import BaseColour
from .carried_pictures import carried, write_copies
from .gltf import read_gltf, write_gltf
from .mtl import read_mtl, write_mtl
from .opengl import write_opengl
from .povray import write_povray
from .readings import Reading
from .threejs import write_js, write_json
from .threejs_reading import read_json
from .vtk import write_vtk

READERS = {
    ".mtl": read_mtl,
    ".json": read_json,
    ".gltf": read_gltf,
    ".glb": read_gltf,
}
WRITERS = {
    ".mtl": write_mtl,
    ".c": write_opengl,
    ".json": write_json,
    ".js": write_js,
    ".py": write_vtk,
    ".inc": write_povray,
    ".gltf": write_gltf,
}
TEXTURED = {".mtl": write_mtl, ".gltf": write_gltf, ".json": write_json}  # those that name pictures
_LOGGER = logging.getLogger("diffshade")


@dataclass(frozen=True)
class Exported:
    """A written file, and the difference between the other program's picture and this one's."""

    path: Path
    rms: float
    """Root mean square difference of diffuse reflection and highlight over the reference (see `with_lobe`), under a
    light of intensity 1; the largest of several materials."""
    largest: float
    """The largest difference."""
    notes: tuple[str, ...]
    """The differences there, and what to do about them; the file has them as comments."""

    def __str__(self) -> str:
        exact = "the diffuse reflection and the highlight are" if self.notes else "the material is"
        same = [] if self.largest else [f"{exact} written exactly."]
        return "\n".join([f"{self.path}: {note}" for note in (*same, *self.notes)])


def write_material(
    path: str | Path,
    material: Material | Mapping[str, Any],
    *,
    name: str = "material",
    lights: Sequence[AbstractLight] | AbstractLight = (),
) -> Exported:
    """Write a material, or several, for another program, chosen by the suffix, so that they look the same there.

    If the other program computes something else, the material is refitted. The remaining error is returned, and written
    to the file as a comment.

    Args:
        path: The file: `.mtl` Wavefront, `.c` OpenGL's fixed function, `.json` or `.js` three.js's MeshPhongMaterial
            and MeshLambertMaterial, `.py` VTK and PyVista, `.inc` POV-Ray, `.gltf` glTF 2.0.
        material: The material; or several, as a mapping from name to material.
        name: The material's name in the file. Any name is possible: where a language needs an identifier, or MTL one
            word, the name is changed to one, and a comment keeps the original.
        lights: Lights to write with it, for OpenGL only; by default none.

    Returns:
        `path`, the `rms` and `largest` error of the highlight as it is written, and `notes`; of several materials, the
        largest errors.

    Raises:
        ValueError: If the suffix, a coefficient or a light is not possible in this format; nothing is written then.
        TypeError: If an argument has another type.
        OSError: If the file cannot be written.
    """
    named = dict(material) if isinstance(material, Mapping) else {name: material}
    return write_textured(path, named, {}, (lights,) if isinstance(lights, AbstractLight) else tuple(lights))


def write_textured(
    path: str | Path,
    named: Mapping[str, Any],
    bases: Mapping[str, BaseColour],
    lights: Sequence[AbstractLight] = (),
) -> Exported:
    """Write materials as `write_material` does, with the pictures of their base colours where the format names any."""
    path = Path(path)
    suffix = check_format(path)
    for i, light in enumerate(lights):
        check_kind(f"lights[{i}]", light, AbstractLight, "PointLight((2, 3, 4))")
    if not named:
        raise ValueError("a material file needs at least one material; got none. Give a Material.")
    for word, one in named.items():
        if not isinstance(word, str) or not word.strip():
            raise ValueError(f"a material's name must be a word; got {in_short(word)}. Give for example 'gold'.")
        check_kind(f"the material {word!r}", one, Material, "Material(k_d=0.7)")
        check_rgb(f"the material {word!r}", one)
    bases = {name: base for name, base in bases.items() if base.picture is not None and name in named}
    if suffix in TEXTURED:
        there, copies, notes = carried(bases, path)
        draft = TEXTURED[suffix](named, lights, there)
        write_copies(copies)
    else:
        draft, notes = WRITERS[suffix](named, lights), ()
        if bases:
            notes = (f"{listing(list(bases))}: {suffix} names no pictures; the colour of the material is written.",)
    write_file(path, draft.text)
    return Exported(path, draft.rms, draft.largest, (*draft.notes, *notes))


def check_format(path: Path, *, also: tuple[str, ...] = ()) -> str:
    """Return the suffix of a material file in lower case; refuse one that is neither written nor in `also`."""
    suffix = path.suffix.lower()
    if suffix not in WRITERS:
        raise ValueError(
            f"'{path.suffix}' is not the suffix of a material format. Use one of {', '.join([*WRITERS, *also])}."
        )
    return suffix


def read_material(path: str | Path, *, name: str | None = None) -> Material:
    """Read a material of another program from a file; see `read_materials` for the formats.

    Args:
        path: The file.
        name: The material's name; may be omitted if the file holds only one.

    Returns:
        The material.

    Raises:
        ValueError: If the file is malformed, holds several materials and no name is given, or holds none of this name.
        FileNotFoundError: If the file does not exist.
    """
    reading = read_file(Path(path))
    found = reading.materials
    chosen = _chosen(path, reading, name)
    warn(reading, name)
    return found[chosen]


def read_textured(path: str | Path, name: str | None = None) -> tuple[dict[str, Material], dict[str, BaseColour]]:
    """Return the materials of a file, or the one of a name, and how pictures colour them."""
    reading = read_file(Path(path))
    chosen = list(reading.materials) if name is None else [_chosen(path, reading, name)]
    warn(reading, name, textured=True)
    return {of: reading.materials[of] for of in chosen}, {of: reading.base[of] for of in chosen if of in reading.base}


def _chosen(path: str | Path, reading: Reading, name: str | None) -> str:
    """Return the name of the one material of a file, or of the one that is asked for."""
    found = reading.materials
    if name is None:
        if len(found) + len(reading.refused) > 1:
            raise ValueError(
                f"{path} holds {len(found) + len(reading.refused)} materials. Name one, for example "
                f"name={short(next(iter({**found, **reading.refused})))}."
            )
        return next(iter(found))
    if name in reading.refused:
        raise ValueError(reading.refused[name])
    if name not in found:
        raise ValueError(f"{path} has no material {in_short(name)}. {did_you_mean(str(name), found)}")
    return name


def read_materials(path: str | Path) -> dict[str, Material]:
    """Read the materials of a file by name.

    Formats with Phong's or Blinn's lobe are read exactly. Metallic-roughness surfaces (glTF, MeshStandardMaterial,
    MeshPhysicalMaterial, PBR keys of MTL) and MeshPhongMaterial are refitted, with two highlights where one does not
    look the same. The logger "diffshade" warns, in one line each, of the error, of what is not read (texture maps,
    unknown keys), and of a material that cannot be read while others can. A map is never opened. Reading needs at most
    64 times the file's size of memory.

    Args:
        path: The file: `.mtl`, `.json` or `.gltf`, as for `write_material`, also `.glb`, a scene of three.js (`.json`),
            or a scene (`.toml`, as for `write_scene`), whose objects' materials are named as the objects, or else
            object_0 and so on.

    Returns:
        The materials by name; one without a name is named material, or material_0 and so on.

    Raises:
        ValueError: If the suffix is unknown, the file is malformed, or none of its materials can be read.
        FileNotFoundError: If the file does not exist.
    """
    reading = read_file(Path(path))
    warn(reading)
    return reading.materials


def read_file(path: Path, *, strict: bool = True) -> Reading:
    """Read all materials of a file; where `strict`, refuse a file of which none can be read."""
    suffix = path.suffix.lower()
    if suffix == ".toml":
        reading = Reading(f"{path}")
        for i, item in enumerate(read_scene(path).objects):
            reading.materials[item.name or f"object_{i}"] = item.material
        return reading
    if suffix not in READERS:
        raise ValueError(f"no material can be read from '{path.suffix}'. Use one of {', '.join([*READERS, '.toml'])}.")
    text = read_glb(path)[0] if suffix == ".glb" else read_text(path, "material file")
    reading = READERS[suffix](text, f"{path}")
    if strict and not reading.materials:
        nothing = f"{path} has no materials. Give a file with a list of materials."
        raise ValueError(next(iter(reading.refused.values()), nothing))
    return reading


def warn(reading: Reading, name: str | None = None, *, textured: bool = False) -> None:
    """Log what was lost in reading all materials, or one, and which of them could not be read.

    `textured`: the pictures of base colours are not lost.
    """
    for note in reading.notes_on(name, textured=textured):
        _LOGGER.warning("%s", note)
    for sentence in reading.refused.values() if name is None else ():
        _LOGGER.warning("%s This material is left out.", sentence)
