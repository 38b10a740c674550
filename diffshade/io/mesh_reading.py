"""Mesh files: the triangles of any file, with a normal at each corner and the name of each one's material."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core.extras import needing
from ..core.thresholds import NEGLIGIBLE
from ..core.words import MAX_NAMED, count, listing
from ..model.meshes import wound_against
from .gltf_files import read_gltf
from .obj_files import read_obj
from .ply_files import read_ply
from .polygons import Polygons, indexed, triangulated
from .stl_files import read_stl
from .vertex_normals import corner_normals, have_direction, unit

READERS = {".obj": read_obj, ".ply": read_ply, ".stl": read_stl, ".gltf": read_gltf, ".glb": read_gltf}


class MeshSurface(NamedTuple):
    """Triangles, counter-clockwise seen from the side of their normals."""

    corner: Float[np.ndarray, "t 3 3"]
    normal: Float[np.ndarray, "t 3 3"]
    """Unit normals at the corners."""
    part: Int[np.ndarray, " t"]
    names: tuple[str, ...]
    """Of the materials that parts name."""
    notes: tuple[str, ...]
    """What is not as the file says, in a sentence each."""
    look: Float[np.ndarray, "t 3 6"] | None
    """Texture coordinates and colour at the corners, as `Polygons` have them."""

    @property
    def centre(self) -> Float[np.ndarray, "3"]:
        """The middle of the box around the triangles."""
        return (self.corner.min((0, 1)) + self.corner.max((0, 1))) / 2


def read_surface(path: str | Path) -> MeshSurface:
    """Read the triangles of a mesh file.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: trimesh, embreex or mapbox_earcut is not installed.
        ValueError: The file cannot be read, or has no triangles, or a corner of one is not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no mesh file {path}. Give the path of an OBJ, PLY, STL or GLB file.")
    with needing("mesh", f"cannot read {path}"):
        import embreex  # noqa: F401
        import mapbox_earcut  # noqa: F401
        import trimesh  # noqa: F401
    found = READERS.get(path.suffix.lower(), _of_trimesh)(path)
    if not len(found.size):
        raise ValueError(f"{path} has no triangles. Export the surface as triangles, not as points or curves.")
    if not np.isfinite(found.point[found.at]).all():
        raise ValueError(f"{path} has a face with a corner that is not finite. Export it again.")
    faces, number = found.of_three(), np.flatnonzero(found.size >= 3)
    corner, face = triangulated(faces)
    kept = _with_area(faces.point[faces.at[corner]])
    corner, face = corner[kept], face[kept]
    if not len(corner):
        raise ValueError(f"{path} has no triangle with an area. Export the surface as triangles.")
    normal = corner_normals(faces, corner, face)
    lost = np.setdiff1d(np.arange(len(found.size)), number[face])
    notes = (
        *found.notes,
        *_on_faces(lost, len(found.size), "no area or fewer than three corners", "left out"),
        *_on_faces(number[_crossed(faces, corner, face)], len(found.size), "edges that cross", "drawn with overlaps"),
        *_without_direction(faces, corner),
    )
    point = faces.point[faces.at[corner]]
    turned = wound_against(point, normal)
    corner = np.where(turned[:, None], corner[:, ::-1], corner)
    normal = np.where(turned[:, None, None], normal[:, ::-1], normal)
    look = None if faces.look is None else faces.look[corner]
    return MeshSurface(faces.point[faces.at[corner]], normal, faces.part[face], faces.names, notes, look)


def _of_trimesh(path: Path) -> Polygons:
    """Return the triangles of a file of another format, without normals and names of materials."""
    import trimesh

    try:
        mesh: Any = trimesh.load_mesh(path, process=False, skip_materials=True)
        point, face = np.asarray(mesh.vertices, float).reshape(-1, 3), np.asarray(mesh.faces, int).reshape(-1, 3)
    except Exception as error:  # each of trimesh's readers raises its own kind
        said = " ".join(f"{error}".split())
        raise ValueError(f"{path} is no mesh that trimesh can read: {said}. Export it as OBJ, PLY or GLB.") from None
    return indexed(point, np.full(point.shape, np.nan), np.full(len(face), 3), face.ravel(), f"{path}")


def _with_area(corner: Float[np.ndarray, "t 3 3"]) -> Any:
    """Return which triangles have an area: more than the rounding of their corners would give them."""
    ab, ac = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    longest = np.maximum(np.abs(ab).max(-1), np.abs(ac).max(-1))
    rounding = 4 * np.finfo(float).eps * np.abs(corner).max((1, 2)) * longest
    return np.linalg.norm(np.cross(ab, ac), axis=-1) > rounding


def _crossed(of: Polygons, corner: Int[np.ndarray, "t 3"], face: Int[np.ndarray, " t"]) -> Int[np.ndarray, " crossed"]:
    """Return the faces whose triangles do not cover them once: their areas along the face's normal are not its own."""
    a, b, c = np.moveaxis(of.point[of.at[corner]], 1, 0)
    cross, area = np.cross(b - a, c - a), of.areas()
    own, faces = np.linalg.norm(area, axis=-1), len(of.size)
    along = np.bincount(face, np.abs((cross * unit(area)[face]).sum(-1)), faces)
    whole = np.bincount(face, np.linalg.norm(cross, axis=-1), faces)
    return np.flatnonzero((whole > 0) & ((np.abs(along - own) > NEGLIGIBLE * own) | (own < NEGLIGIBLE * whole)))


def _on_faces(which: Int[np.ndarray, " n"], faces: int, having: str, done: str) -> list[str]:
    if not len(which):
        return []
    one = len(which) == 1
    named = f"face {which[0] + 1}" if one else f"{len(which):,} faces"
    if 1 < len(which) <= MAX_NAMED:
        named = f"faces {listing([f'{number + 1}' for number in which])}"
    return [f"{named} of {faces:,} {'has' if one else 'have'} {having}; {'it is' if one else 'they are'} {done}."]


def _without_direction(of: Polygons, corner: Int[np.ndarray, "t 3"]) -> list[str]:
    given = of.normal[corner]
    wrong = ~np.isnan(given).all(-1) & ~have_direction(given)
    if not wrong.any():
        return []
    corners = count(int(wrong.sum()), "corner")
    return [f"the normals at {corners} of triangles are missing or have no direction; they are computed."]
