"""Height meshes: a map of heights as triangles, with fewer of them where a stated error allows it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ...core.fields import check_kind
from ...io.triangles import Triangles, simplified, tracer
from ...model.cameras import AbstractCamera, camera_axes, pixels_of
from .corners import corners_of
from .differences import rays_of
from .map import HeightMap
from .regions import connected, nearest

MIN_TRIANGLES, TRIALS = 16, 7  # triangles that are left; numbers of triangles that are tried


@dataclass(frozen=True, eq=False)
class HeightMesh:
    """A surface as triangles, with a standard error of the height at each corner, from `height_mesh`.

    Attributes:
        corner: Corners, world coordinates, scene units.
        face: Indices of the three corners of each triangle, counter-clockwise seen from the camera.
        normal: Unit normals of the mesh at its corners.
        uv: Place of each corner in the image: u to the right and v down, from 0 to 1.
        errors: Standard errors of the heights at the corners, scene units, as in `HeightMap.errors`.
        camera: The camera of the heights.
        largest: Largest distance from the mesh of all triangles, measured at every pixel: the difference along the line
            of sight, across the surface there, scene units; 0 where no triangle was taken away.
    """

    corner: Float[np.ndarray, "n 3"]
    face: Int[np.ndarray, "m 3"]
    normal: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "n 2"]
    errors: Float[np.ndarray, " n"]
    camera: AbstractCamera
    largest: float

    @property
    def tangent(self) -> Float[np.ndarray, "n 3"]:
        """Unit tangents at the corners: the camera's right, along the surface. The bitangent is normal x tangent."""
        right, *_ = camera_axes(self.camera)
        along = right - (self.normal @ right)[:, None] * self.normal
        return along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)

    def __str__(self) -> str:
        """Return the number of triangles and corners, the median error, and what was measured."""
        finite = self.errors[np.isfinite(self.errors)]
        error = f"{np.median(finite):.2g}" if finite.size else "infinite"
        return (
            f"{len(self.face):,} triangles, {len(self.corner):,} corners, standard error of the heights {error} in the "
            f"median; {self.largest:.2g} scene units off the mesh of all triangles at most"
        )


def height_mesh(heights: HeightMap, *, tolerance: float | None = None, watertight: bool = False) -> HeightMesh:
    """Return heights as a mesh of two triangles a pixel, and of walls where the height jumps.

    A turned surface is therefore whole. Walls are along the lines of sight, between the corners of two neighbours that
    a jump separates. Parts whose relative heights are not determined stand where the median of the seam to their
    neighbours has no jump: an assumption, which `errors` do not contain. The corners of a rim are smooth along it, the
    more the surface turns away there.

    The other corners are those of the pixels, all moved so that each pixel's two triangles face along its own
    normal, which triangles between the centres of pixels, of four normals each, do not. Where the normals contradict a
    continuous surface, as at a crease, few pixels miss theirs (Huber's loss); where they are noisier than the surface
    is twisted, they are smoothed. Texels whose error is infinite are left out where others are finite: parts of few
    texels, of which nothing shows how far from the others they are.

    With a tolerance, edges are collapsed where the surface changes least (quadric error metrics; Garland and Heckbert
    1997), those of the border excepted, and the fewest triangles are kept whose distance from the mesh of all
    triangles, measured at every pixel, is at most the tolerance. Needs fast-simplification, trimesh and embreex (`pip
    install 'diffshade[mesh]'`).

    Args:
        heights: The heights.
        tolerance: Largest distance from the mesh of all triangles, scene units, above 0; None, the default, keeps all
            triangles.
        watertight: Close the mesh by a flat back, a twentieth of the object's width behind its deepest point, as a
            printer needs it; False by default.

    Returns:
        The mesh. Its normals are those of the triangles; `write_mesh` adds the measured ones as a map.

    Raises:
        ValueError: The tolerance is not above 0.
        TypeError: `heights` is no `HeightMap`.
        ImportError: A tolerance is given, and fast-simplification, trimesh or embreex is not installed.
    """
    check_kind("heights", heights, HeightMap, "integrate_normals(normal, camera)")
    if tolerance is not None and not 0.0 < tolerance < np.inf:
        raise ValueError(f"tolerance must be above 0 scene units; got {tolerance}. Leave it out to keep all triangles.")
    heights = _without_specks(heights)
    found = corners_of(heights, back=watertight)
    whole, kept = Triangles(found.position, found.face).used()
    middle = found.position[found.of_pixel[:, 1:3]].mean(1)  # of each pixel, where its two triangles meet
    mesh, largest = (whole, 0.0) if tolerance is None else _fewest(whole, middle, heights, float(tolerance))
    place, normal = pixels_of(mesh.corner, heights.camera), mesh.normals
    shape, errors = np.asarray(heights.camera.shape[::-1]), found.errors[kept]
    if mesh is not whole:
        column, row = np.clip(place.astype(int), 0, shape - 1).T
        errors = np.where(
            normal @ camera_axes(heights.camera)[2] > 0.0, heights.errors[nearest(heights.mask)][row, column], np.inf
        )
    return HeightMesh(mesh.corner, mesh.face, normal, place / shape, errors, heights.camera, largest)


def _without_specks(heights: HeightMap) -> HeightMap:
    """Return heights without texels whose error is infinite and which touch no others, where there are others."""
    region, lost = connected(heights.mask), heights.mask & np.isinf(heights.errors)
    joined = np.unique(region[heights.mask & ~lost])
    specks = lost & ~np.isin(region, joined) if len(joined) else np.zeros_like(lost)
    return replace(heights, part=np.where(specks, -1, heights.part))


def _fewest(
    whole: Triangles, middle: Float[np.ndarray, "pixels 3"], heights: HeightMap, tolerance: float
) -> tuple[Triangles, float]:
    """Return the fewest triangles within the tolerance, and their largest distance from all of them.

    The number of triangles is found by bisection of its logarithm.
    """
    low, high = np.log(MIN_TRIANGLES), np.log(max(len(whole.face), MIN_TRIANGLES + 1))
    best = (whole, 0.0)
    for _ in range(TRIALS):
        trial = 0.5 * (low + high)
        mesh = simplified(whole, int(np.exp(trial)))
        largest = _distance(mesh, middle, heights)
        if largest <= tolerance and (mesh.closed or not whole.closed):
            best, high = (mesh, largest), trial
        else:
            low = trial
    return best


def _distance(mesh: Triangles, middle: Float[np.ndarray, "pixels 3"], heights: HeightMap) -> float:
    """Return the largest distance of a mesh from points of a surface, one a pixel.

    The distance is across the surface, along the line of sight; where that misses the mesh, from the nearest corner.
    """
    from scipy.spatial import KDTree

    start = rays_of(heights.camera).start[heights.mask]
    hits = tracer(mesh)(start, middle - start)
    across = ((hits.point - middle[hits.ray]) * heights.normal[heights.mask][hits.ray]).sum(-1)
    nearest = KDTree(mesh.corner).query(np.delete(middle, hits.ray, 0))[0]
    return float(max(np.abs(across).max(initial=0.0), nearest.max(initial=0.0)))
