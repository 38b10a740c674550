"""Material files of other programs: formats by suffix, reading and writing."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.fields import check_kind, in_short
from ..core.words import did_you_mean
from ..io.files import replacing
from ..io.scene_files import read_scene
from ..model.lights import AbstractLight
from ..model.materials import Material
from .gltf import write_gltf
from .mtl import read_mtl, write_mtl
from .opengl import read_opengl, read_opengl_lights, write_opengl
from .parsing import read_text, short
from .povray import read_povray, write_povray
from .threejs import read_js, read_json, write_js, write_json
from .vtk import read_vtk, write_vtk

READERS = {
    ".mtl": read_mtl,
    ".c": read_opengl,
    ".json": read_json,
    ".js": read_js,
    ".py": read_vtk,
    ".inc": read_povray,
}
WRITERS = {
    ".c": write_opengl,
    ".json": write_json,
    ".js": write_js,
    ".py": write_vtk,
    ".inc": write_povray,
    ".gltf": write_gltf,
}


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
    """Write a material for another program, chosen by the suffix, so that it looks the same there.

    If the other program computes something else, the material is refitted. The remaining error is returned, and written
    to the file as a comment.

    Args:
        path: The file: `.mtl` Wavefront, `.c` OpenGL's fixed function, `.json` or `.js` three.js's MeshPhongMaterial,
            `.py` VTK and PyVista, `.inc` POV-Ray, `.gltf` glTF 2.0.
        material: The material; for `.mtl` also several, as a mapping from name to material.
        name: The material's name in the file.
        lights: Lights to write with it, for OpenGL only; by default none.

    Returns:
        The path, the error and the notes.

    Raises:
        ValueError: If the suffix, the name, a coefficient or a light is not possible in this format; nothing is written
            then.
        TypeError: If an argument has another type.
        OSError: If the file cannot be written.
    """
    path, lights = Path(path), (lights,) if isinstance(lights, AbstractLight) else tuple(lights)
    suffix = check_format(path)
    for i, light in enumerate(lights):
        check_kind(f"lights[{i}]", light, AbstractLight, "PointLight((2, 3, 4))")
    if isinstance(material, Mapping) and suffix != ".mtl":
        raise ValueError(f"a {suffix} file holds one material; got {len(material)}. Write one file for each.")
    named = dict(material) if isinstance(material, Mapping) else {name: material}
    for word in named:
        _check_name(word, suffix)
    if not named:
        raise ValueError("a material file needs at least one material; got none. Give a Material.")
    for word, one in named.items():
        check_kind(f"the material {word!r}", one, Material, "Material(k_d=0.7)")
    if suffix == ".mtl":
        draft = write_mtl(named, lights)
    else:
        ((word, one),) = named.items()
        draft = WRITERS[suffix](word, one, lights)
    with replacing(path) as temporary:
        temporary.write_text(draft.text, encoding="utf-8")
    return Exported(path, draft.rms, draft.largest, draft.notes)


def check_format(path: Path, *, also: tuple[str, ...] = ()) -> str:
    """Return the suffix of a material file in lower case; refuse one that is neither written nor in `also`."""
    suffix = path.suffix.lower()
    if suffix not in (".mtl", *WRITERS):
        raise ValueError(
            f"'{path.suffix}' is not the suffix of a material format. Use one of "
            f"{', '.join(['.mtl', *WRITERS, *also])}."
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
    found = read_materials(path)
    if name is None:
        if len(found) > 1:
            raise ValueError(
                f"{path} holds {len(found)} materials. Name one, for example name={short(next(iter(found)))}."
            )
        return next(iter(found.values()))
    if name not in found:
        raise ValueError(f"{path} has no material {in_short(name)}. {did_you_mean(str(name), found)}")
    return found[name]


def read_materials(path: str | Path) -> dict[str, Material]:
    """Read the materials of a file by name.

    Formats with Phong's or Blinn's lobe are read exactly. three.js's MeshPhongMaterial is refitted, and the logger
    "diffshade" warns of the error. It also warns of texture maps, which are never opened. Reading needs at most 64
    times the file's size of memory.

    Args:
        path: The file: `.mtl`, `.c`, `.json`, `.js`, `.py` or `.inc`, as for `write_material`, or a scene (`.toml`, as
            for `write_scene`), whose objects' materials are named as the objects, or else object_0 and so on.

    Returns:
        The materials by name.

    Raises:
        ValueError: If the suffix is unknown, or the file is malformed.
        FileNotFoundError: If the file does not exist.
    """
    path = Path(path)
    if path.suffix.lower() == ".toml":
        return {item.name or f"object_{i}": item.material for i, item in enumerate(read_scene(path).objects)}
    if path.suffix.lower() not in READERS:
        also = " (glTF is only written)" if path.suffix.lower() == ".gltf" else ""
        raise ValueError(
            f"no material can be read from '{path.suffix}'{also}. Use one of {', '.join([*READERS, '.toml'])}."
        )
    return READERS[path.suffix.lower()](read_text(path, "material file"), f"{path}")


def read_lights(path: str | Path) -> tuple[AbstractLight, ...]:
    """Read the lights that C code sets by glLight: position, colour, attenuation and spot (OpenGL's fixed function).

    Args:
        path: A `.c` file.

    Returns:
        The lights, in the order of their numbers.

    Raises:
        ValueError: If the suffix is not .c, or the file is malformed.
        FileNotFoundError: If the file does not exist.
    """
    if Path(path).suffix.lower() != ".c":
        raise ValueError(f"lights are read from C code; got '{Path(path).suffix}'. Give a .c file, or use read_scene.")
    return read_opengl_lights(read_text(path, "C file"), f"{path}")


def _check_name(name: str, suffix: str) -> None:
    good = re.fullmatch(
        r"\S+" if suffix == ".mtl" else r"[A-Za-z_]\w*", name if isinstance(name, str) else "", re.ASCII
    )
    if not good or len(name) > 60 or "#" in name:
        what = "one word" if suffix == ".mtl" else "a name of letters, digits and _"
        raise ValueError(f"a material's name must be {what}; got {short(str(name))}. Rename it.")
