"""Meshes: triangle meshes of any file that trimesh reads, as they are or as G-buffers."""

from __future__ import annotations

from pathlib import Path
from typing import Any, overload

import jax
import numpy as np
from jaxtyping import Float

from ..core.backend import in_float64
from ..core.fields import Array, check_kind
from ..model.cameras import AbstractCamera
from ..model.gbuffers import GBuffer
from ..model.meshes import Mesh


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
    if camera is not None:
        check_kind("camera", camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no mesh file {path}. Give the path of an OBJ, PLY, STL or GLB file.")
    try:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    except ImportError as error:
        raise ImportError(
            f"reading a mesh needs trimesh and embreex ({error}). pip install 'diffshade[mesh]'."
        ) from None
    try:
        mesh: Any = trimesh.load_mesh(path, skip_materials=True)
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
    if camera is None:
        return Mesh(corners, faces, normals=mesh.vertex_normals if smooth else None)
    with in_float64(camera) as camera:
        rays = [np.asarray(a) for a in _rays(camera)]
    hits: Any = RayMeshIntersector(mesh).intersects_id(*rays, return_locations=True, multiple_hits=False)
    face, ray, p = hits
    n = mesh.face_normals[face]
    if smooth:
        corners = trimesh.triangles.points_to_barycentric(mesh.triangles[face], p)
        n = np.einsum("rc,rcx->rx", corners, mesh.vertex_normals[mesh.faces[face]])
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
    normal, position = np.zeros((2, len(rays[0]), 3))
    normal[ray], position[ray] = n, p
    mask = np.zeros(len(rays[0]), bool)
    mask[ray] = True
    shape = camera.shape
    return GBuffer(normal.reshape(*shape, 3), position.reshape(*shape, 3), mask.reshape(shape))


@jax.jit
def _rays(camera: AbstractCamera) -> tuple[Float[Array, "rays 3"], Float[Array, "rays 3"]]:
    """Return the origins and directions of the rays of a camera's pixels."""
    row, column = (a.astype(float).ravel() for a in np.indices(camera.shape))
    rays = camera.projection().rays(row, column)
    return rays.origin.stack(), rays.direction.stack()
