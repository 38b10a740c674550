"""Triangles: a mesh with fewer of them, and what rays meet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core.extras import needing
from .vertex_normals import unit

Points = Float[np.ndarray, "n 3"]


class Triangles(NamedTuple):
    """A mesh: its corners, and the three corners of each triangle, counter-clockwise seen from outside."""

    corner: Points
    face: Int[np.ndarray, "faces 3"]

    @property
    def normals(self) -> Points:
        """Unit normals at the corners: means over the triangles around, weighted by their areas, up to the median area.

        So a low wall hardly bends the surface beside it, and a tall one no more than as much surface would.
        """
        a, b, c = np.moveaxis(self.corner[self.face], 1, 0)
        across = np.cross(b - a, c - a)
        area = np.linalg.norm(across, axis=-1)
        weighted = unit(across) * np.minimum(area, np.median(area))[:, None]
        total = np.stack(
            [np.bincount(self.face.ravel(), np.repeat(weighted[:, k], 3), len(self.corner)) for k in range(3)], -1
        )
        return unit(total)

    @property
    def closed(self) -> bool:
        """Whether each edge belongs to two triangles, in opposite directions: whether the mesh is watertight."""
        start, end = self.face.ravel().astype(np.int64), np.roll(self.face, -1, axis=1).ravel()
        count = len(self.corner)
        there, back = np.sort(start * count + end), np.sort(end * count + start)
        return bool((there == back).all() and (np.diff(there) > 0).all())

    def used(self) -> tuple[Triangles, Int[np.ndarray, " kept"]]:
        """Return the mesh without corners of no triangle, and the indices of those that are kept."""
        kept, face = np.unique(self.face, return_inverse=True)
        return Triangles(self.corner[kept], face.reshape(-1, 3)), kept


class Hits(NamedTuple):
    """Where rays first meet a mesh."""

    ray: Int[np.ndarray, " hits"]
    face: Int[np.ndarray, " hits"]
    weight: Float[np.ndarray, "hits 3"]
    """Of the three corners of the triangle at the point (barycentric)."""
    point: Float[np.ndarray, "hits 3"]


def simplified(mesh: Triangles, count: int) -> Triangles:
    """Return the mesh with about so many triangles, its border kept (quadric error metrics; Garland, Heckbert 1997).

    Raises:
        ImportError: fast-simplification is not installed.
    """
    with needing("mesh", "cannot leave triangles out of a mesh"):
        import fast_simplification
    found: Any = fast_simplification.simplify(
        np.ascontiguousarray(mesh.corner, np.float64),
        np.ascontiguousarray(mesh.face, np.int32),
        target_count=count,
        preserve_border=True,
    )
    return Triangles(np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)).used()[0]


def tracer(mesh: Triangles, *, every: bool = False) -> Callable[[Points, Points], Hits]:
    """Return what tells where rays, of these origins and directions, first meet a mesh, by Embree in float32.

    `every`: where they meet it at all, the nearer points of a ray before those behind them, up to 100 of a ray.

    Raises:
        ImportError: trimesh or embreex is not installed.
    """
    with needing("mesh", "cannot trace rays to a mesh"):
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    whole = trimesh.Trimesh(mesh.corner, mesh.face, process=False)
    tree = RayMeshIntersector(whole)

    def hits(start: Points, toward: Points) -> Hits:
        found: Any = tree.intersects_id(start, toward, return_locations=True, multiple_hits=every)
        face, ray, point = (np.asarray(of) for of in found)
        return Hits(ray, face, trimesh.triangles.points_to_barycentric(whole.triangles[face], point), point)

    return hits
