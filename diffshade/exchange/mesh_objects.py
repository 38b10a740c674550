"""Meshes in their own materials: objects that a camera sees, with base colours of textures and vertices."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..core.fields import check_kind
from ..core.words import did_you_mean
from ..io.meshes import Shows, parts_seen
from ..io.parsing import short
from ..model.cameras import AbstractCamera
from ..model.materials import Material
from ..model.named_materials import material as named_material
from ..model.scenes import Object
from .base_colours import BaseColour, Look
from .material_files import read_file, warn
from .names import identifiers, same_name

_LOGGER = logging.getLogger("diffshade")
LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]+)", re.MULTILINE)


def read_mesh_objects(path: str | Path, camera: AbstractCamera) -> list[Object]:
    """Return what a camera sees of a mesh in the file's own materials, an object for each.

    The materials are those of a glTF file, or of the MTL files that an OBJ names by `mtllib`, as `read_materials` reads
    them. Base colours change from pixel to pixel: the material's colour times its picture (`baseColorTexture`,
    `map_Kd`; from sRGB to linear, between the centres of four pixels, repeated, clamped or mirrored) times the colour
    of the vertices (`COLOR_0`). A metal's colour is that of its highlights. Of glTF's alpha modes, MASK leaves points
    out, and BLEND is k_t, behind which the other objects are seen. Faces without a material are grey.

    Pictures are read from the file itself or from its folder. What is not read, or not there, the logger `diffshade`
    says in one line each.

    Args:
        path: The mesh file, as for `read_mesh`.
        camera: Camera that sees the mesh.

    Returns:
        The objects, G-buffers with coefficients over the pixels: `Scene(objects, lights)`. Derivatives by a factor of
        k_d are those of the picture.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: trimesh, embreex or mapbox-earcut is not installed.
        ValueError: As `read_mesh` raises it, or none of the file's materials can be read.
        TypeError: `camera` is not a camera.
    """
    check_kind("camera", camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
    return objects_seen(path)(camera)


def _own_looks(path: str | Path) -> dict[str, Look]:
    """Return the looks of a mesh file's own materials; none of a file without materials."""
    path = Path(path)
    if path.suffix.lower() in (".gltf", ".glb"):
        return _looks_of(path, strict=False)
    found: dict[str, Look] = {}
    if path.suffix.lower() == ".obj" and path.is_file():
        for line in LIBRARY.findall(path.read_bytes()):
            text = line.decode("utf-8", "replace").strip()
            for library in (named := _named(text, path.parent)):
                found |= _looks_of(library, strict=False)
            if not named:
                _LOGGER.warning("%s names the materials of %s, which is not beside it; they are grey.", path, text)
    return found


def _named(line: str, folder: Path) -> list[Path]:
    """Return the files in a folder that a line names: one, whose name may have spaces, or several."""
    for words in ([line], line.split()):
        if found := [path for word in words if (path := folder / re.split(r"[/\\]", word)[-1]).is_file()]:
            return found
    return []


def _looks_of(given: str | Path, *, strict: bool = True) -> dict[str, Look]:
    """Return the materials of a file, or the one of a name, with their base colours; say what of them is left out.

    `strict`: a file of which none can be read is refused.
    """
    path = Path(given)
    if not path.suffix:
        return {f"{given}": Look(named_material(f"{given}"), BaseColour())}
    reading = read_file(path, strict=strict)
    warn(reading, textured=True)
    found, pictures = {}, dict[tuple[str, int], Any]()
    for name, material in reading.materials.items():
        base = reading.base.get(name, BaseColour())
        texels = None
        if base.picture is not None:
            try:
                key = base.picture.uri, base.picture.image
                texels = pictures[key] = pictures[key] if key in pictures else base.picture.texels()
            except (OSError, ValueError) as error:
                _LOGGER.warning("%s: %s Its colour alone is drawn.", reading.at(name), error)
        found[name] = Look(material, base, texels)
    return found


def objects_seen(
    path: str | Path, given: str | None = None, out: Path | None = None
) -> Callable[[AbstractCamera], list[Object]]:
    """Return what shows a mesh to any camera: in its own materials, faces without one grey.

    `out`: what is to be written, which may be no picture of the materials.
    `given`: a file of materials, or the name of one, in place of its own. A single one is that of all faces; of several
    none may lack. A name that a format writes otherwise, such as 'half red' as half_red, is the same name.
    """
    looks = _own_looks(path) if given is None else _looks_of(given)
    for look in looks.values():
        if out is not None and look.is_of(out):
            raise ValueError(f"{out} is a picture of the materials of {path}. Give another name with -o.")
    if whole := given is not None and len(looks) == 1:
        looks = {"": next(iter(looks.values()))}

    def look_of(name: str) -> Look | None:
        own = same_name(name, looks)
        return None if own is None else looks[own]

    def shows(name: str) -> Shows | None:
        look = look_of(name)
        return None if look is None or look.base.cutoff is None else look.shows

    parts = parts_seen(path, whole=whole, shows=shows)
    grey = Look(Material(0.7, 0.7), BaseColour(fields=("k_a", "k_d")))
    chosen = {name: look_of(name) or grey for name in parts}
    if lacking := [name for name in parts if chosen[name] is grey]:
        _say_what_lacks(path, given, lacking, looks)
    for name, look in chosen.items():
        if look.texels is not None and (unplaced := parts[name].unplaced):
            some = "its" if unplaced == parts[name].triangles else f"{unplaced} of its {parts[name].triangles}"
            said = f"{some} triangles have no texture coordinates; its picture is not shown there."
            _LOGGER.warning("%s: %s%s", path, f"{short(name)}: " * bool(name), said)
    names = identifiers(parts)

    def seen_by(camera: AbstractCamera) -> list[Object]:
        found = []
        for name, part in parts.items():
            seen = part.seen(camera)
            found.append(Object(seen.buffer, chosen[name].over(seen.look), names[name] if name else ""))
        return found

    return seen_by


def _say_what_lacks(path: str | Path, given: str | None, names: list[str], looks: Mapping[str, Look]) -> None:
    """Refuse parts of a mesh whose materials lack in a file that is given; say it where its own files lack them."""
    if given and "" in names:
        raise ValueError(
            f"faces of {path} name no material, and {given} has {len(looks)}. Name one for each face in the mesh, or "
            "give a file of one material."
        )
    if given:
        raise ValueError(
            f"a face of {path} names the material '{names[0]}', which {given} lacks. Add it. "
            f"{did_you_mean(names[0], looks)}"
        )
    for name in names if looks else ():
        if name:
            _LOGGER.warning("%s: faces name the material %s, which its files lack; they are grey.", path, short(name))
