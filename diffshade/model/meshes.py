"""Meshes: triangles that any ray can meet, in boxes of a few each."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.arrays import float64_of, numbers
from ..core.fields import Array, Numbers
from ..core.thresholds import SINGLE
from .cameras import Rays
from .surfaces import AbstractSurface, Hit
from .vectors import Vec3, cross, dot, normalize, where

TINY = 1e-30  # for a component of a ray that is 0
BLOCK, CLUSTER = 1024, 16  # rays and triangles that are tested together


class Mesh(AbstractSurface):
    """A triangle mesh that any ray can meet: that of a camera, one bent by glass, and that to a light.

    Of the ray o + t d and a triangle (a, b, c), t and the barycentric coordinates solve o + t d = a + u (b - a) +
    v (c - a) (Moeller and Trumbore 1997). Normals are on the viewer's side of the triangle. Which triangle a ray meets
    has no derivative; the point and the normal there have one by the ray. Triangles that are neighbours are tested
    together with rays that are, and left out where no such ray meets the box around them: the time is linear in the
    triangles. A `GBuffer` from `read_mesh(path, camera)` is faster, but only its camera's own rays see it.

    Args:
        vertices: Corners of the triangles, (v, 3), scene units.
        faces: For each triangle the indices of its corners, (t, 3), from 0.
        normals: Normals at the vertices, (v, 3), of any length except 0, interpolated over each triangle (Phong
            shading); by default each triangle is flat.

    Raises:
        ValueError: The shapes do not match, there is no triangle, an index is not that of a vertex, or a number is not
            finite.
        TypeError: An argument is no array of real numbers, or carries more than numbers: a unit, masked values.
    """

    corners: Float[Array, "clusters t 3 3"]
    normals: Float[Array, "clusters t 3 3"] | None

    def __init__(
        self,
        vertices: Numbers,
        faces: Numbers,
        *,
        normals: Numbers | None = None,
    ):
        points, faces = float64_of("Mesh.vertices", vertices), np.asarray(numbers("Mesh.faces", faces))
        for name, array in (("vertices", points), ("faces", faces)):
            if array.ndim != 2 or array.shape[1] != 3 or not len(array):
                raise ValueError(f"Mesh.{name} must have shape (n, 3); got {array.shape}. Give rows of three.")
        if faces.dtype.kind not in "iu" or faces.min() < 0 or faces.max() >= len(points):
            raise ValueError(
                f"Mesh.faces must be indices of the {len(points)} vertices; got {faces.min()} to {faces.max()}. "
                "Count the vertices from 0."
            )
        if not np.isfinite(points).all():
            raise ValueError("Mesh.vertices must be finite; got others. Leave those vertices out.")
        at_vertices = None if normals is None else float64_of("Mesh.normals", normals)
        if at_vertices is not None and (at_vertices.shape != points.shape or not (at_vertices != 0).any(-1).all()):
            raise ValueError(
                f"Mesh.normals must be one vector other than 0 for each of the {len(points)} vertices; got shape "
                f"{at_vertices.shape}. Leave them out for flat triangles."
            )
        faces = faces[_along_a_curve(points[faces].mean(1))]
        if at_vertices is not None:
            at_vertices = at_vertices / np.linalg.norm(at_vertices, axis=-1, keepdims=True)
            turned = wound_against(points[faces], at_vertices[faces])
            faces = np.where(turned[:, None], faces[:, ::-1], faces)
        faces = np.pad(faces, ((0, -len(faces) % CLUSTER), (0, 0)), mode="edge").reshape(-1, CLUSTER, 3)
        self.corners = points[faces]
        self.normals = None if at_vertices is None else at_vertices[faces]

    def extent(self) -> float:
        """Return half the diagonal of the box around the mesh."""
        return 0.5 * float(np.linalg.norm(np.ptp(np.reshape(self.corners, (-1, 3)), axis=0)))

    def intersect(self, rays: Rays) -> Hit:
        """Return the nearest triangle's point in front of each ray's origin."""
        index = _first_triangle(*jax.lax.stop_gradient((jnp.asarray(self.corners), rays)))
        met = index >= 0
        a, b, c = _corners_of(self.corners, jnp.where(met, index, 0))
        t, u, v, facing = _meet(rays, a, b, c)
        flat = normalize(cross(b - a, c - a))
        n = flat
        if self.normals is not None:
            n_a, n_b, n_c = (normalize(n) for n in _corners_of(self.normals, jnp.where(met, index, 0)))
            n = normalize(n_a + (n_b - n_a) * u + (n_c - n_a) * v)
        t = jnp.where(met, t, 0.0)
        return Hit(t, rays.origin + rays.direction * t, where(facing > 0, -n, n), met)


def wound_against(corners: Float[np.ndarray, "t 3 3"], normals: Float[np.ndarray, "t 3 3"]) -> Bool[np.ndarray, " t"]:
    """Return which triangles are clockwise, seen from the side of the normals at their corners: files have both."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return (across * normals.sum(1)).sum(-1) < 0


def _along_a_curve(centres: Float[np.ndarray, "t 3"]) -> Int[np.ndarray, " t"]:
    """Return the order of points along a Z-shaped curve (Morton 1966): neighbours on it are neighbours in space."""
    low, high = centres.min(0), centres.max(0)
    cell = np.floor((centres - low) / np.where(high > low, high - low, 1.0) * 1023.999).astype(np.int64)
    key = np.zeros(len(cell), np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")


def _corners_of(triangles: Float[Array, "clusters t 3 3"], index: Int[Array, "..."]) -> tuple[Vec3, Vec3, Vec3]:
    """Return what belongs to the three corners of triangles."""
    chosen = jnp.asarray(triangles).reshape(-1, 3, 3)[index]
    return Vec3.of(chosen[..., 0, :]), Vec3.of(chosen[..., 1, :]), Vec3.of(chosen[..., 2, :])


def _meet(rays: Rays, a: Vec3, b: Vec3, c: Vec3) -> tuple[Array, Array, Array, Array]:
    """Return t, u and v of a ray and a triangle's plane, and the cosine between them times the area; finite always."""
    ab, ac = b - a, c - a
    p = cross(rays.direction, ac)
    det = dot(ab, p)
    meets = det != 0
    inverse = jnp.where(meets, 1.0, 0.0) / jnp.where(meets, det, 1.0)
    off = rays.origin - a
    q = cross(off, ab)
    return dot(ac, q) * inverse, dot(off, p) * inverse, dot(rays.direction, q) * inverse, -det


def _first_triangle(corners: Float[Array, "clusters t 3 3"], rays: Rays) -> Int[Array, "..."]:
    """Return the index of the triangle that each ray meets first in front of its origin; -1 for none."""
    columns = jnp.broadcast_arrays(*jax.tree.leaves(rays))
    shape, count = columns[0].shape, columns[0].size
    padded = [jnp.pad(c.ravel(), (0, -count % BLOCK), mode="edge").reshape(-1, BLOCK) for c in columns]
    blocks = jax.tree.unflatten(jax.tree.structure(rays), padded)
    low, high = corners.min((1, 2)), corners.max((1, 2))
    first = jnp.arange(len(corners)) * corners.shape[1]

    def of_block(block: Rays) -> Int[Array, " rays"]:
        def look(found: tuple, cluster: tuple) -> tuple[tuple, None]:
            near = _enters(block, cluster[0], cluster[1])
            return jax.lax.cond(jnp.any(near < found[0]), test, lambda found, _: found, found, cluster), None

        def test(found: tuple, cluster: tuple) -> tuple:
            nearest, index = found
            _, _, of, number = cluster
            each = jax.tree.map(lambda c: c[None], block)
            t, u, v, facing = _meet(each, *(Vec3.of(of[:, None, i]) for i in range(3)))
            # a little beyond its edges as well, so that no ray slips between two neighbours
            on = (u >= -SINGLE) & (v >= -SINGLE) & (u + v <= 1.0 + SINGLE) & (facing != 0) & (t > 0)
            for k in range(CLUSTER):  # unrolled: a reduction would not be vectorised over the rays
                nearer = on[k] & (t[k] < nearest)
                nearest, index = jnp.where(nearer, t[k], nearest), jnp.where(nearer, number + k, index)
            return nearest, index

        start = jnp.full(BLOCK, jnp.inf, low.dtype), jnp.full(BLOCK, -1, first.dtype)
        return jax.lax.scan(look, start, (low, high, corners, first))[0][1]

    return jax.lax.map(of_block, blocks).ravel()[:count].reshape(shape)


def _enters(rays: Rays, low: Float[Array, "3"], high: Float[Array, "3"]) -> Float[Array, " rays"]:
    """Return where rays enter a box (Kay and Kajiya 1986), to rounding; infinity where they miss it."""
    near, far = -jnp.inf, jnp.inf
    for axis, (o, d) in enumerate(zip(jax.tree.leaves(rays.origin), jax.tree.leaves(rays.direction), strict=True)):
        inverse = 1.0 / jnp.where(jnp.abs(d) > TINY, d, TINY)
        one, other = (low[axis] - o) * inverse, (high[axis] - o) * inverse
        near, far = jnp.maximum(near, jnp.minimum(one, other)), jnp.minimum(far, jnp.maximum(one, other))
    slack = 1e-6 * jnp.abs(far)
    return jnp.where((near <= far + slack) & (far >= 0), near - slack, jnp.inf)
