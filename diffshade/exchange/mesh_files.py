"""Mesh files: surfaces with their maps for other programs: glTF, three.js, OBJ with MTL, PLY."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.fields import check_kind
from ..core.thresholds import SMALL, UNCLIPPED_PERCENT
from ..io.files import replacing, writable, write_file
from ..model.gbuffers import GBuffer
from ..model.lobes import Blinn
from ..model.materials import Material
from ..texels.heights.mesh import HeightMesh
from ..texels.maps import TexelMaps
from . import gltf_mesh, threejs_mesh
from .exports import plain
from .lobe_refits import with_lobe
from .map_textures import (
    GREY,
    Difference,
    MapSurface,
    Textures,
    difference,
    highlights_of,
    stored,
    surface_of,
    uv_from_below,
    write_pictures,
)
from .mtl import MAX_N_S
from .reference import Reference

SUFFIXES = (".glb", ".gltf", ".json", ".obj", ".ply")

GLTF = (
    "multiply the intensity of each light by pi: glTF divides the diffuse term by pi.",
    "the normal map's green is up, along normal x tangent; base colour and specular colour are sRGB.",
)
THREE = (
    "multiply the intensity of each light by pi, and use no AmbientLight.",
    "MeshPhongMaterial has one shininess and one specular colour for all texels: those nearest to the maps; "
    "specularMap holds the strength. Files of glTF have a roughness and a colour of the highlight at every texel.",
    "the normal map's green is up, along normal x tangent; map is sRGB.",
)
OBJ = (
    "map_Kd and map_Ks are sRGB, map_Ns and norm are not; norm is in the mesh's tangent space, its green up.",
    "an OBJ has no tangents and no errors: programs compute tangents themselves; PLY, glTF and JSON hold errors.",
    "the error is that of MTL's own formula; three.js reads an MTL as MeshPhongMaterial, without map_Ns.",
)


@dataclass(frozen=True)
class ExportedMesh:
    """The files of a mesh, and the difference between the other program's pictures and those of the maps."""

    paths: tuple[Path, ...]
    """The mesh's file last."""
    difference: Difference | None
    """None without maps, and for PLY, whose colours have no meaning that could be compared."""
    notes: tuple[str, ...]
    """What the format cannot hold, and what to do about it; the file has them too."""

    def __str__(self) -> str:
        """Return the notes, each with the name of the file."""
        return "\n".join(f"{self.paths[-1]}: {note}" for note in self.notes)


def write_mesh(
    path: str | Path, mesh: HeightMesh, *, maps: TexelMaps | None = None, brighten: bool = False
) -> ExportedMesh:
    """Write a surface for another program, chosen by the suffix, with its maps as textures.

    Highlights are refitted to the other program's formula; the error that remains is measured by computing its picture
    from the textures as they are stored, beside `TexelMaps.shade` under three lights. Normals are measured ones, in the
    tangent space of the mesh.

    Args:
        path: The file: `.glb` or `.gltf` (glTF 2.0 with KHR_materials_specular; errors of the heights as the attribute
            `_HEIGHT_ERROR`, -1 where infinite), `.json` (three.js: a Mesh with a MeshPhongMaterial, for ObjectLoader,
            with pictures beside it; errors as the attribute `height_error`), `.obj` (with `.mtl` and pictures beside
            it) or `.ply` (binary; errors as the property `height_error`, colours as k_d in sRGB).
        mesh: The mesh, from `height_mesh`.
        maps: The maps of the same camera; None writes the shape alone.
        brighten: Multiply k_d and k_s so that 99.5 % of the texels' k_d are at most 1: how bright photographs are
            depends on their lights and exposures, and so do the maps. A note says the factor. False by default.

    Returns:
        The files, the measured difference, and the notes.

    Raises:
        ValueError: The suffix is another one, or the maps have another camera's shape, or neither normals nor a surface
            that has them; nothing is written then.
        TypeError: An argument has another type.
        ImportError: Maps are given, and trimesh or embreex is not installed.
        OSError: A file cannot be written.
    """
    path = Path(path)
    check_kind("mesh", mesh, HeightMesh, "height_mesh(integrate_normals(normal, camera))")
    suffix = check_suffix(path)
    if maps is not None:
        check_kind("maps", maps, TexelMaps, "fit_texels(scene, views)")
        if maps.status.shape != mesh.camera.shape:
            raise ValueError(
                f"maps must have the shape of the mesh's camera, {mesh.camera.shape}; got {maps.status.shape}. Give "
                "the maps whose normals were integrated."
            )
        if "normal" not in maps.values and not isinstance(maps.scene.objects[0].surface, GBuffer):
            raise ValueError("maps must have normals, or a G-buffer that has them; got neither. Free the normal.")
    writable(path)
    notes, surface, found = [f"{mesh}."], None, None
    if maps is not None:
        surface = surface_of(maps, mesh)
        surface = surface.brightened() if brighten else surface
        notes += _notes_on_maps(maps, surface)
    if suffix == ".ply":
        return ExportedMesh((_write_ply(path, mesh, surface, notes),), None, tuple(notes))
    textures, write, about = {
        ".obj": (_mtl_textures, _write_obj, OBJ),
        ".json": (threejs_mesh.textures, threejs_mesh.write, THREE),
    }.get(suffix, (gltf_mesh.textures, gltf_mesh.write, GLTF))
    if maps is not None and surface is not None:
        found = textures(maps, surface)
        notes += [f"{found.difference}", *about]
    paths = write(path, mesh, found, notes)
    return ExportedMesh(tuple(paths), None if found is None else found.difference, tuple(notes))


def check_suffix(path: Path) -> str:
    """Return the suffix of a mesh file in lower case; refuse another one."""
    if (suffix := path.suffix.lower()) not in SUFFIXES:
        raise ValueError(f"'{path.suffix}' is not the suffix of a mesh. Use one of {', '.join(SUFFIXES)}.")
    return suffix


def _notes_on_maps(maps: TexelMaps, surface: MapSurface) -> list[str]:
    """Return notes on ambient reflection, which no format has, and on k_d that is too large for a picture."""
    notes = []
    if np.any(maps.values.get("k_a", np.asarray(maps.scene.objects[0].material.k_a))):
        notes.append("a mesh has no ambient reflection: k_a is not written.")
    k_d = surface.k_d[surface.inside]
    if surface.brightness != 1.0:
        notes.append(f"k_d and k_s are those of the maps times {surface.brightness:.3g}: the largest k_d is about 1.")
    elif 0.0 < surface.most < SMALL:
        notes.append(
            f"k_d is at most {surface.most:.2g}, so that the mesh is dark under a light of 1. With brighten=True "
            f"(--brighten) k_d and k_s are multiplied by {1.0 / surface.most:.3g}."
        )
    if (above := float(np.mean((k_d > 1.0).any(-1)))) > 0.0:
        notes.append(
            f"k_d is above 1 at {above:.2g} of the texels, and is written as 1 there, the most that pictures hold; its "
            f"largest is {k_d.max():.3g}."
            + (" With brighten=True (--brighten) it is at most 1 at nearly all." if surface.brightness == 1.0 else "")
        )
    return notes


def _write_ply(path: Path, mesh: HeightMesh, surface: MapSurface | None, notes: list[str]) -> Path:
    """Write a binary PLY: corners with normals, errors of the heights and colours; triangles."""
    from scipy.ndimage import map_coordinates

    names = ["x", "y", "z", "nx", "ny", "nz", "s", "t", "height_error"]
    kinds = [(name, "<f4") for name in names] + [(name, "u1") for name in ("red", "green", "blue")] * (
        surface is not None
    )
    corners = np.zeros(len(mesh.corner), kinds)
    columns = np.concatenate([mesh.corner, mesh.normal, uv_from_below(mesh), mesh.errors[:, None]], -1).T
    for name, column in zip(names, columns, strict=True):
        corners[name] = column
    if surface is not None:
        place = (mesh.uv[:, ::-1] * surface.inside.shape - 0.5).T  # from centre to centre
        k_d = [map_coordinates(surface.k_d[..., i], place, order=1, mode="nearest") for i in range(3)]
        (colours,), _ = stored(np.stack(k_d, -1)[None], srgb=True)
        for i, name in enumerate(("red", "green", "blue")):
            corners[name] = colours[:, i]
        beside = " and no emission" if surface.k_e.any() else ""
        notes.append(f"a PLY has no highlights{beside}: its colours are k_d, in sRGB.")
    faces = np.zeros(len(mesh.face), [("count", "u1"), ("corner", "<i4", 3)])
    faces["count"], faces["corner"] = 3, mesh.face
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {note}" for note in notes)]
    header += [f"element vertex {len(corners)}"]
    header += [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in kinds]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    write_file(path, "\n".join(header).encode() + corners.tobytes() + faces.tobytes())
    return path


def _write_obj(path: Path, mesh: HeightMesh, found: Textures | None, notes: list[str]) -> list[Path]:
    """Write an OBJ, and with maps an MTL and its pictures; return the paths."""
    written = []
    if found is None:
        notes.append("an OBJ has no errors: PLY, glTF and JSON hold those of the heights.")
    else:
        named = write_pictures(path, found.pictures)
        rows = ["newmtl maps", *(f"{key} {value}" for key, value in found.material.items())]
        rows += [f"{name if name == 'norm' else f'map_{name}'} {file}" for name, file in named.items()]
        written = [*map(path.with_name, named.values()), path.with_suffix(".mtl")]
        write_file(written[-1], "".join(f"# {note}\n" for note in notes) + "\n".join(rows) + "\n")
    face = np.repeat(mesh.face + 1, 3, axis=1)  # place, texture and normal of a corner have one index
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(f"# {note}\n" for note in notes)
        if found is not None:
            file.write(f"mtllib {path.stem}.mtl\nusemtl maps\n")
        np.savetxt(file, mesh.corner, "v %.9g %.9g %.9g")
        np.savetxt(file, uv_from_below(mesh), "vt %.9g %.9g")
        np.savetxt(file, mesh.normal, "vn %.6f %.6f %.6f")
        np.savetxt(file, face, "f %d/%d/%d %d/%d/%d %d/%d/%d")
    return [*written, path]


def _mtl_textures(maps: TexelMaps, surface: MapSurface) -> Textures:
    """Return the pictures of an MTL, its rows, and how far its formula (Blinn's lobe) is from the maps."""

    def numbers(material: Material) -> tuple[float, float]:
        refit = with_lobe(material, Blinn(), highest_n_s=MAX_N_S).material
        return float(np.mean(np.asarray(refit.n_s))), float(np.mean(refit.k_s)) / GREY

    highlights = highlights_of(maps, surface.brightness)
    found = highlights.at_texels(np.array([numbers(material) for material in highlights.materials]))
    n_s, scale = np.moveaxis(found, -1, 0)
    k_s = surface.k_s * scale[..., None]
    most, highest = float(max(np.percentile(k_s[surface.inside], UNCLIPPED_PERCENT), 1e-3)), float(np.max(n_s))
    pictures, back = {}, {}
    for name, values, srgb in (
        ("Kd", surface.k_d, True),
        ("Ks", k_s / most, True),
        ("norm", 0.5 * (surface.of_mesh + 1.0), False),
        *([("Ns", (n_s / highest)[..., None], False)] if np.ndim(n_s) else []),
    ):
        pictures[name], back[name] = stored(values, srgb=srgb)
    exponent = highest * back["Ns"][..., 0] if "Ns" in back else float(n_s)
    normal = surface.normals_of(back["norm"])

    def shade(l: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w 3"]:
        points = Reference(normal, l)
        highlight = np.where(points.n_l > 0.0, points.n_h**exponent, 0.0)[..., None]
        return back["Kd"] * points.n_l[..., None] + most * back["Ks"] * highlight + surface.k_e

    rows = {"Ka": "0 0 0", "Kd": "1 1 1", "Ks": plain([most] * 3, " "), "Ns": plain(highest), "illum": "2"}
    rows |= {"Ke": plain(surface.k_e, " ")} if surface.k_e.any() else {}
    return Textures(pictures, rows, difference(maps, surface, shade))
