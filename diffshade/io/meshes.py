"""Meshes: triangle meshes of files, as they are or as G-buffers."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, overload

import numpy as np
from jaxtyping import Bool, Float

from ..core.fields import check_kind
from ..model.cameras import AbstractCamera, Camera, rays_through
from ..model.gbuffers import GBuffer
from ..model.meshes import Mesh
from .mesh_reading import MeshSurface, read_surface
from .polygons import BARE
from .triangles import Hits, Triangles, tracer
from .vertex_normals import unit

_LOGGER = logging.getLogger("diffshade")
FROM = (0.5, 0.4, 1.0)  # the direction from which a mesh is seen that no camera was given for
MARGIN = 1.02  # of the distance at which a mesh's sphere just fits


@overload
def read_mesh(path: str | Path, camera: AbstractCamera, *, smooth: bool = True) -> GBuffer: ...


@overload
def read_mesh(path: str | Path, camera: None, *, smooth: bool = True) -> Mesh: ...


def read_mesh(path: str | Path, camera: AbstractCamera | None, *, smooth: bool = True) -> GBuffer | Mesh:
    """Return the triangle mesh in a file, or what a camera sees of it: the nearest points and their normals.

    Normals are the file's own. Where it has none they are means over the triangles around each point, weighted by their
    angles there, of all that are of one smoothing group of an OBJ, across borders of materials and of textures. An STL,
    and glTF without normals, is flat. Normals are on the viewer's side; of faces back to back, each side has its own.
    Faces without area are left out, which the logger `diffshade` says.

    For a G-buffer, rays are cast by Embree in float32 about the mesh's centre, so that positions are accurate to about
    1e-6 of its size. Needs trimesh, embreex and mapbox-earcut (`pip install 'diffshade[mesh]'`).

    Args:
        path: The mesh file: OBJ, PLY, STL, GLB or glTF, or another one that trimesh reads, without its normals.
        camera: Camera that sees the mesh. With None the mesh itself is returned: any ray can meet it, so it casts
            shadows and stands behind glass.
        smooth: With True, the default, normals are interpolated over each triangle (Phong shading); with False they are
            those of the triangles.

    Returns:
        The G-buffer, of the camera's shape; or the `Mesh`.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: trimesh, embreex or mapbox-earcut is not installed.
        ValueError: The file cannot be read or has no triangles, or a face names a corner or normal that is not there.
        TypeError: `camera` is not a camera.
    """
    if camera is not None:
        check_kind("camera", camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
        return _seen(_surface(path), smooth)(camera).buffer
    found = _surface(path)
    corners = found.corner.reshape(-1, 3)
    normals = found.normal.reshape(-1, 3) if smooth else None
    return Mesh(corners, np.arange(len(corners)).reshape(-1, 3), normals=normals)


def read_mesh_parts(path: str | Path, camera: AbstractCamera) -> dict[str, GBuffer]:
    """Return what a camera sees of each material's part of a mesh, by the names that its file gives.

    In an OBJ these are the names of `usemtl`; in glTF, those of the materials of its primitives, as `read_materials`
    has them. Faces that name no material are the part "", as are all of a file of another format. Normals are those of
    the whole mesh. Parts do not hide each other, since one may be glass: where several are seen, the nearest counts.

    Args:
        path: The mesh file, as for `read_mesh`.
        camera: Camera that sees the mesh.

    Returns:
        The G-buffer of each part, of the camera's shape.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: trimesh, embreex or mapbox-earcut is not installed.
        ValueError: As `read_mesh` raises it.
        TypeError: `camera` is not a camera.
    """
    check_kind("camera", camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
    return {name: part.seen(camera).buffer for name, part in parts_seen(path).items()}


class SeenPart(NamedTuple):
    """What a camera sees of a part of a mesh, and the looks of its points, as `Polygons` have them."""

    buffer: GBuffer
    look: Float[np.ndarray, "h w 6"] | None


class MeshPart(NamedTuple):
    """A part of a mesh, which any camera may see."""

    seen: Callable[[AbstractCamera], SeenPart]
    triangles: int
    unplaced: int
    """How many of its triangles have no texture coordinates."""


Shows = Callable[[Float[np.ndarray, "points 6"]], Bool[np.ndarray, " points"]]
"""Which points of a part are there, by their looks."""


def parts_seen(
    path: str | Path, *, whole: bool = False, shows: Callable[[str], Shows | None] = lambda name: None
) -> dict[str, MeshPart]:
    """Return each part of a mesh by its name, or all as one part, the file being read once.

    `shows`: of the part of a name, which points are there, None for all; rays go on through the others.
    """
    found = _surface(path)

    def part(name: str, of: Bool[np.ndarray, " t"] | slice) -> MeshPart:
        look = None if found.look is None else found.look[of]
        surface = found._replace(corner=found.corner[of], normal=found.normal[of], look=look)
        count = len(surface.corner)
        unplaced = count if look is None else int(np.isnan(look[..., :2]).any((1, 2)).sum())
        return MeshPart(_seen(surface, True, shows(name)), count, unplaced)

    if whole:
        return {"": part("", slice(None))}
    of_part = [found.part == i for i in range(len(found.names))]
    return {name: part(name, of) for name, of in zip(found.names, of_part, strict=True) if of.any()}


def frame_mesh(path: str | Path, *, shape: tuple[int, int] = (512, 512), fov: float = 35.0) -> Camera:
    """Return a camera that sees a whole mesh from the front, a little from the right and from above.

    Args:
        path: The mesh file, as for `read_mesh`.
        shape: Height and width of the picture, pixels; 512 by default.
        fov: The full vertical angle, degrees; 35 by default.

    Returns:
        The camera.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: trimesh, embreex or mapbox-earcut is not installed.
        ValueError: As `read_mesh` raises it.
    """
    found = read_surface(path)
    center = found.centre
    radius = float(np.linalg.norm(found.corner - center, axis=-1).max())
    narrow = np.tan(np.deg2rad(fov / 2)) * min(1.0, shape[1] / shape[0])  # of the half angles
    away = MARGIN * radius / np.sin(np.arctan(narrow))
    return Camera(center + away * np.array(FROM) / np.linalg.norm(FROM), target=center, fov=fov, shape=shape)


def _surface(path: str | Path) -> MeshSurface:
    """Return the triangles of a mesh file, and say what of it is not as the file says."""
    found = read_surface(path)
    for note in found.notes:
        _LOGGER.warning("%s: %s", path, note)
    return found


def _seen(surface: MeshSurface, smooth: bool, shows: Shows | None = None) -> Callable[[AbstractCamera], SeenPart]:
    """Return what gives the nearest points of a mesh to a camera, and their normals, on the viewer's side."""
    centre = surface.centre
    corner = surface.corner - centre  # which Embree rounds to float32
    hits_of = tracer(Triangles(corner.reshape(-1, 3), np.arange(3 * len(corner)).reshape(-1, 3)), every=bool(shows))
    looks = np.broadcast_to(BARE, corner.shape[:2] + BARE.shape) if surface.look is None else surface.look

    def seen_by(camera: AbstractCamera) -> SeenPart:
        start, toward = rays_through(camera, *(of.ravel() + 0.5 for of in np.indices(camera.shape)))
        hits = hits_of(start - centre, toward)
        look = None
        if surface.look is not None or shows is not None:
            look = np.einsum("rc,rcx->rx", hits.weight, looks[hits.face])
        if look is not None and shows is not None:
            there = np.flatnonzero(shows(look))
            there = there[np.unique(hits.ray[there], return_index=True)[1]]  # of each ray the first
            hits, look = Hits(*(of[there] for of in hits)), look[there]
        a, b, c = np.moveaxis(corner[hits.face], 1, 0)
        flat = n = unit(np.cross(b - a, c - a))
        if smooth:
            n = unit(np.einsum("rc,rcx->rx", hits.weight, surface.normal[hits.face]))
            n = np.where((n != 0).any(-1, keepdims=True), n, flat)
        away = (flat * toward[hits.ray]).sum(-1, keepdims=True) > 0
        normal, position = np.zeros((2, len(start), 3))
        normal[hits.ray], position[hits.ray] = np.where(away, -n, n), hits.point + centre
        mask = np.zeros(len(start), bool)
        mask[hits.ray] = True
        shape = camera.shape
        of_pixels = None
        if look is not None:
            of_pixels = np.tile(BARE, (len(start), 1))
            of_pixels[hits.ray] = look
            of_pixels = of_pixels.reshape(*shape, -1)
        return SeenPart(GBuffer(normal.reshape(*shape, 3), position.reshape(*shape, 3), mask.reshape(shape)), of_pixels)

    return seen_by
