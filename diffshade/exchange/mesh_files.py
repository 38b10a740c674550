"""Mesh files: surfaces with their maps for other programs: glTF, OBJ with MTL, PLY."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.fields import check_kind
from ..io.files import replacing, writable
from ..io.image_formats import encode
from ..model.gbuffers import GBuffer
from ..model.lobes import Blinn
from ..model.materials import Material
from ..texels.heights.mesh import HeightMesh
from ..texels.maps import TexelMaps
from . import gltf_mesh
from .lobe_refits import with_lobe
from .map_textures import GREY, PERCENTILE, Difference, difference, refitted, stored, surface_of
from .mtl import HIGHEST

SUFFIXES = (".glb", ".gltf", ".obj", ".ply")


@dataclass(frozen=True)
class ExportedMesh:
    """The files of a mesh, and the difference between the other program's pictures and those of the maps."""

    paths: tuple[Path, ...]
    """The mesh's file last."""
    difference: Difference | None
    """None without maps, and for PLY, whose colours have no meaning that could be compared."""
    notes: tuple[str, ...]
    """What the format cannot hold, and what to do about it; glTF, OBJ and PLY have them in the file."""

    def __str__(self) -> str:
        """Return the notes, each with the name of the file."""
        return "\n".join(f"{self.paths[-1]}: {note}" for note in self.notes)


def write_mesh(path: str | Path, mesh: HeightMesh, *, maps: TexelMaps | None = None) -> ExportedMesh:
    """Write a surface for another program, chosen by the suffix, with its maps as textures.

    Highlights are refitted to the other program's formula; the error that remains is measured by computing its picture
    from the textures as they are stored, beside `TexelMaps.shade` under three lights. Normals are measured ones, in the
    tangent space of the mesh.

    Args:
        path: The file: `.glb` or `.gltf` (glTF 2.0 with KHR_materials_specular; errors of the heights as the attribute
            `_HEIGHT_ERROR`, -1 where infinite), `.obj` (with `.mtl` and pictures beside it) or `.ply` (binary; errors
            as the property `height_error`, colours as k_d in sRGB).
        mesh: The mesh, from `height_mesh`.
        maps: The maps of the same camera; None writes the shape alone.

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
    notes = [f"{mesh}."]
    if suffix == ".ply":
        return ExportedMesh((_write_ply(path, mesh, maps, notes),), None, tuple(notes))
    if suffix == ".obj":
        return _write_obj(path, mesh, maps, notes)
    if maps is None:
        return ExportedMesh(tuple(gltf_mesh.write(path, mesh, {}, None, notes)), None, tuple(notes))
    pictures, material, off = gltf_mesh.textures(maps, mesh)
    notes += [
        f"{off}",
        "multiply the intensity of each light by pi: glTF divides the diffuse term by pi.",
        "the normal map's green is up, along normal x tangent; base colour and specular colour are sRGB.",
        *_notes_on_ambient(maps, "glTF"),
    ]
    return ExportedMesh(tuple(gltf_mesh.write(path, mesh, pictures, material, notes)), off, tuple(notes))


def check_suffix(path: Path) -> str:
    """Return the suffix of a mesh file in lower case; refuse another one."""
    if (suffix := path.suffix.lower()) not in SUFFIXES:
        raise ValueError(f"'{path.suffix}' is not the suffix of a mesh. Use one of {', '.join(SUFFIXES)}.")
    return suffix


def _notes_on_ambient(maps: TexelMaps, program: str) -> list[str]:
    """Return a note that ambient reflection is not written, where there is any."""
    k_a = maps.values.get("k_a", np.asarray(maps.scene.objects[0].material.k_a))
    return [f"{program} has no ambient reflection: k_a is not written."] if np.any(k_a) else []


def _write_ply(path: Path, mesh: HeightMesh, maps: TexelMaps | None, notes: list[str]) -> Path:
    """Write a binary PLY: corners with normals, errors of the heights and colours; triangles."""
    from scipy.ndimage import map_coordinates

    names = ["x", "y", "z", "nx", "ny", "nz", "s", "t", "height_error"]
    kinds = [(name, "<f4") for name in names] + [(name, "u1") for name in ("red", "green", "blue")] * (maps is not None)
    corners = np.zeros(len(mesh.corner), kinds)
    flipped = np.stack([mesh.uv[:, 0], 1.0 - mesh.uv[:, 1]], -1)
    for name, column in zip(
        names, np.concatenate([mesh.corner, mesh.normal, flipped, mesh.errors[:, None]], -1).T, strict=True
    ):
        corners[name] = column
    if maps is not None:
        k_d = surface_of(maps, mesh).k_d
        place = (mesh.uv[:, ::-1] * k_d.shape[:2] - 0.5).T  # from centre to centre
        for i, name in enumerate(("red", "green", "blue")):
            between = map_coordinates(k_d[..., i], place, order=1, mode="nearest")
            corners[name] = stored(between, srgb=True)[0]
        notes.append("a PLY has no highlights: its colours are k_d, in sRGB.")
    faces = np.zeros(len(mesh.face), [("count", "u1"), ("corner", "<i4", 3)])
    faces["count"], faces["corner"] = 3, mesh.face
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {note}" for note in notes)]
    header += [f"element vertex {len(corners)}"]
    header += [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in kinds]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    with replacing(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + corners.tobytes() + faces.tobytes())
    return path


def _write_obj(path: Path, mesh: HeightMesh, maps: TexelMaps | None, notes: list[str]) -> ExportedMesh:
    """Write an OBJ, and with maps an MTL and its pictures."""
    written, off = [], None
    if maps is not None:
        pictures, rows, off = _mtl_maps(maps, mesh, path.stem)
        notes += [
            f"{off}",
            "map_Kd and map_Ks are sRGB, map_Ns and norm are not; norm is in the mesh's tangent space, its green up.",
            "an OBJ has no tangents and no errors: programs compute tangents themselves, and PLY and glTF hold errors.",
            "the error is that of MTL's own formula; three.js reads an MTL as MeshPhongMaterial, without map_Ns.",
        ]
        for name, picture in pictures.items():
            written.append(path.with_name(f"{path.stem}_{name}.png"))
            with replacing(written[-1]) as temporary:
                temporary.write_bytes(encode(".png", picture))
        written.append(path.with_suffix(".mtl"))
        with replacing(written[-1]) as temporary:
            temporary.write_text("".join(f"# {note}\n" for note in notes) + "\n".join(rows) + "\n", encoding="utf-8")
    else:
        notes.append("an OBJ has no errors: PLY and glTF hold those of the heights.")
    face = np.repeat(mesh.face + 1, 3, axis=1)  # place, texture and normal of a corner have one index
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(f"# {note}\n" for note in notes)
        if maps is not None:
            file.write(f"mtllib {path.stem}.mtl\nusemtl maps\n")
        np.savetxt(file, mesh.corner, "v %.9g %.9g %.9g")
        np.savetxt(file, np.stack([mesh.uv[:, 0], 1.0 - mesh.uv[:, 1]], -1), "vt %.9g %.9g")
        np.savetxt(file, mesh.normal, "vn %.6f %.6f %.6f")
        np.savetxt(file, face, "f %d/%d/%d %d/%d/%d %d/%d/%d")
    return ExportedMesh((*written, path), off, tuple(notes))


def _mtl_maps(maps: TexelMaps, mesh: HeightMesh, stem: str) -> tuple[dict[str, np.ndarray], list[str], Difference]:
    """Return the pictures of an MTL, its rows, and how far its formula (Blinn's lobe) is from the maps."""

    def numbers(material: Material) -> tuple[float, float]:
        refit = with_lobe(material, Blinn(), highest_n_s=HIGHEST).material
        return float(np.mean(np.asarray(refit.n_s))), float(np.mean(refit.k_s)) / GREY

    surface = surface_of(maps, mesh)
    n_s, scale = np.moveaxis(refitted(maps, numbers)[0], -1, 0)
    k_s = surface.k_s * scale[..., None]
    most, highest = float(max(np.percentile(k_s[surface.inside], PERCENTILE), 1e-3)), float(np.max(n_s))
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
        h = l + np.array([0.0, 0.0, 1.0])
        n_l, n_h = np.maximum(normal @ l, 0.0), np.maximum(normal @ (h / np.linalg.norm(h)), 0.0)
        highlight = np.where(n_l > 0.0, n_h**exponent, 0.0)[..., None]
        return back["Kd"] * n_l[..., None] + most * back["Ks"] * highlight

    rows = [
        "newmtl maps",
        "Ka 0 0 0",
        "Kd 1 1 1",
        f"Ks {most:.6g} {most:.6g} {most:.6g}",
        f"Ns {highest:.6g}",
        "illum 2",
    ]
    rows += [f"map_{name} {stem}_{name}.png" for name in pictures if name != "norm"] + [f"norm {stem}_norm.png"]
    return pictures, rows, difference(maps, surface, shade)
