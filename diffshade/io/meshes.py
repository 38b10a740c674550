"""Meshes: triangle meshes of any file that trimesh reads, as they are or as G-buffers."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, overload

import jax
import numpy as np
from jaxtyping import Float

from ..core.backend import in_float64
from ..core.fields import Array, check_kind
from ..model.cameras import AbstractCamera, Camera
from ..model.gbuffers import GBuffer
from ..model.meshes import Mesh
from .triangles import Triangles, first_hits

FROM = (0.5, 0.4, 1.0)  # the direction from which a mesh is seen that no camera was given for
MARGIN = 1.02  # of the distance at which a mesh's sphere just fits


@overload
def read_mesh(path: str | Path, camera: AbstractCamera, *, smooth: bool = True) -> GBuffer: ...


@overload
def read_mesh(path: str | Path, camera: None, *, smooth: bool = True) -> Mesh: ...


def read_mesh(path: str | Path, camera: AbstractCamera | None, *, smooth: bool = True) -> GBuffer | Mesh:
    """Return the triangle mesh in a file, or what a camera sees of it: the nearest points and their normals.

    For a G-buffer, rays are cast by Embree in float32, so that positions are accurate to about 1e-6 of their size.
    Needs trimesh and embreex (`pip install 'diffshade[mesh]'`).

    Args:
        path: The mesh file (OBJ, PLY, STL, GLB, ...).
        camera: Camera that sees the mesh. With None the mesh itself is returned: any ray can meet it, so it casts
            shadows and stands behind glass.
        smooth: With True, the default, normals are interpolated between those of the vertices (Phong shading); with
            False they are those of the triangles.

    Returns:
        The G-buffer, of the camera's shape; or the `Mesh`.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: trimesh or embreex is not installed.
        ValueError: trimesh cannot read the file, or the file has no triangles or has invalid corners.
        TypeError: `camera` is not a camera.
    """
    if camera is None:
        mesh = _load(Path(path))
        return Mesh(mesh.vertices, mesh.faces, normals=mesh.vertex_normals if smooth else None)
    check_kind("camera", camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
    return _seen(_load(Path(path)), camera, smooth)


def read_mesh_parts(path: str | Path, camera: AbstractCamera) -> dict[str, GBuffer]:
    """Return what a camera sees of each material's part of a mesh, by the names that `usemtl` of an OBJ file gives.

    A file of another format, and an OBJ file without `usemtl`, is one part named "".

    Args:
        path: The mesh file, as for `read_mesh`.
        camera: Camera that sees the mesh.

    Returns:
        The G-buffer of each part, of the camera's shape.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: trimesh or embreex is not installed.
        ValueError: trimesh cannot read the file, or a part has no triangles or has invalid corners.
        TypeError: `camera` is not a camera.
    """
    check_kind("camera", camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
    path = Path(path)
    parts = _obj_parts(path) if path.suffix.lower() == ".obj" and path.is_file() else {}
    if not parts:
        return {"": read_mesh(path, camera)}
    return {name: _seen(_load(path, text), camera, True) for name, text in parts.items()}


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
        ImportError: trimesh or embreex is not installed.
        ValueError: trimesh cannot read the file.
    """
    corners = np.asarray(_load(Path(path)).vertices)
    center = (corners.min(0) + corners.max(0)) / 2
    radius = max(float(np.linalg.norm(corners - center, axis=-1).max()), 1e-12)
    narrow = np.tan(np.deg2rad(fov / 2)) * min(1.0, shape[1] / shape[0])  # of the half angles
    away = MARGIN * radius / np.sin(np.arctan(narrow))
    return Camera(center + away * np.array(FROM) / np.linalg.norm(FROM), target=center, fov=fov, shape=shape)


def _obj_parts(path: Path) -> dict[str, bytes]:
    """Return the OBJ text of each material's faces, with all vertices."""
    shared: list[bytes] = []
    faces: dict[str, list[bytes]] = {}
    name = ""
    for line in path.read_bytes().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        key, _, rest = line.strip().partition(b" ")
        if key in (b"v", b"vt", b"vn"):
            shared.append(line)
        elif key == b"f":
            faces.setdefault(name, []).append(line)
        elif key == b"usemtl":
            name = rest.strip().decode("utf-8", "replace")
    return {} if list(faces) == [""] else {of: b"\n".join([*shared, *own]) for of, own in faces.items()}


def _load(path: Path, text: bytes | None = None) -> Any:
    """Return the triangles of a mesh file, or of an OBJ text from it."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no mesh file {path}. Give the path of an OBJ, PLY, STL or GLB file.")
    try:
        import embreex  # noqa: F401
        import trimesh
    except ImportError as error:
        raise ImportError(
            f"reading a mesh needs trimesh and embreex ({error}). pip install 'diffshade[mesh]'."
        ) from None
    try:
        if text is None:
            mesh: Any = trimesh.load_mesh(path, skip_materials=True)
        else:
            mesh = trimesh.load_mesh(io.BytesIO(text), file_type="obj", skip_materials=True)
    except Exception as error:  # each of trimesh's readers raises its own kind
        said = " ".join(f"{error}".split())
        raise ValueError(f"{path} is no mesh that trimesh can read: {said}. Export it as OBJ, PLY or GLB.") from None
    if not len(getattr(mesh, "faces", ())):
        raise ValueError(f"{path} has no triangles. Export the surface as triangles, not as points or curves.")
    corners, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if (
        corners.shape[1:] != (3,)
        or not 0 <= faces.min() <= faces.max() < len(corners)
        or not np.isfinite(corners).all()
    ):
        raise ValueError(f"{path} has triangles with a corner that is no point of three numbers. Export it again.")
    return mesh


def _seen(mesh: Any, camera: AbstractCamera, smooth: bool) -> GBuffer:
    """Return the nearest points of a mesh and their normals."""
    with in_float64(camera) as camera:
        rays = [np.asarray(a) for a in _rays(camera)]
    hits = first_hits(Triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces)), rays[0], rays[1])
    n = mesh.face_normals[hits.face]
    if smooth:
        n = np.einsum("rc,rcx->rx", hits.weight, mesh.vertex_normals[mesh.faces[hits.face]])
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
    normal, position = np.zeros((2, len(rays[0]), 3))
    normal[hits.ray], position[hits.ray] = n, hits.point
    mask = np.zeros(len(rays[0]), bool)
    mask[hits.ray] = True
    shape = camera.shape
    return GBuffer(normal.reshape(*shape, 3), position.reshape(*shape, 3), mask.reshape(shape))


@jax.jit
def _rays(camera: AbstractCamera) -> tuple[Float[Array, "rays 3"], Float[Array, "rays 3"]]:
    """Return the origins and directions of the rays of a camera's pixels."""
    row, column = (a.astype(float).ravel() for a in np.indices(camera.shape))
    rays = camera.projection().rays(row, column)
    return rays.origin.stack(), rays.direction.stack()
