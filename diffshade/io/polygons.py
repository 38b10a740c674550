"""Polygons: faces of a mesh file, with what it says of normals and materials, and their triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Num

NONE = -1
"""The group of faces that share their normals with no other."""
BARE = np.array(["nan", "nan", "1", "1", "1", "1"], float)
"""The look of a corner of which a file says nothing: no texture coordinates, and white."""


class Polygons(NamedTuple):
    """Faces as a file has them."""

    point: Float[np.ndarray, "points 3"]
    size: Int[np.ndarray, " faces"]
    """How many corners each face has."""
    at: Int[np.ndarray, " corners"]
    """Index of the point at each corner of each face, counter-clockwise seen from outside."""
    normal: Float[np.ndarray, "corners 3"]
    """The file's own normals, of any length; NaN where it has none."""
    group: Int[np.ndarray, " faces"]
    """Faces of one group share the normals that are computed where they meet; `NONE`: the face is flat."""
    part: Int[np.ndarray, " faces"]
    """Index of the material that each face names."""
    names: tuple[str, ...] = ("",)
    notes: tuple[str, ...] = ()
    """What of the file is not followed, in a sentence each."""
    look: Float[np.ndarray, "corners 6"] | None = None
    """Texture coordinates, v down from the top of the picture, and the linear colour with alpha of the vertex; None
    where the file has neither."""

    @property
    def looks(self) -> Float[np.ndarray, "corners 6"]:
        """The look of every corner."""
        return np.tile(BARE, (len(self.at), 1)) if self.look is None else self.look

    @property
    def first(self) -> Int[np.ndarray, " faces"]:
        """Index of the first corner of each face."""
        return np.cumsum(self.size) - self.size

    @property
    def face(self) -> Int[np.ndarray, " corners"]:
        """Index of the face of each corner."""
        return np.repeat(np.arange(len(self.size)), self.size)

    def of_three(self) -> Polygons:
        """Return the faces that have three corners or more."""
        kept = self.size >= 3
        corners, faces = kept[self.face], (self.group[kept], self.part[kept])
        look = None if self.look is None else self.look[corners]
        of_corners = self.at[corners], self.normal[corners]
        return Polygons(self.point, self.size[kept], *of_corners, *faces, self.names, look=look)

    def areas(self) -> Float[np.ndarray, "faces 3"]:
        """Return twice the area of each face, along its normal (Newell's sum of cross products)."""
        near = self.point[self.at] - np.repeat(self.point[self.at[self.first]], self.size, axis=0)
        cross = np.cross(near[:-1], near[1:])
        cross[self.first[1:] - 1] = 0.0  # between two faces
        return np.add.reduceat(np.concatenate([cross, np.zeros((1, 3))]), self.first)


def check_corners(at: Num[np.ndarray, " corners"], points: int, what: str) -> None:
    """Refuse corners that are no indices of a file's vertices."""
    wrong = at[~((at >= 0) & (at < points) & (at == np.floor(at)))]
    if len(wrong):
        raise ValueError(f"{what} has {points} vertices, and a face names number {wrong[0] + 1:.10g}. Export it again.")


def indexed(
    point: Float[np.ndarray, "points 3"],
    normal: Float[np.ndarray, "points 3"],
    size: Int[np.ndarray, " faces"],
    at: Num[np.ndarray, " corners"],
    what: str,
    *,
    group: int = 0,
    name: str = "",
    look: Float[np.ndarray, "points 6"] | None = None,
) -> Polygons:
    """Return faces of one group and material whose corners have what their vertices have; `what` has them."""
    check_corners(at, len(point), what)
    at, none = at.astype(int), np.zeros(len(size), int)
    return Polygons(point, size, at, normal[at], none + group, none, (name,), look=None if look is None else look[at])


def stated(normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return normals that a file states: 0, which has no direction, where one is not finite."""
    return np.where(np.isfinite(normals).all(-1, keepdims=True), normals, 0.0)


def joined(found: list[Polygons]) -> Polygons:
    """Return the faces of several meshes as those of one; materials are the same where their names are."""
    names = tuple(dict.fromkeys(name for one in found for name in one.names)) or ("",)
    starts = np.cumsum([0, *(len(one.point) for one in found)])
    parts = [np.array([names.index(name) for name in one.names])[one.part] for one in found]
    return Polygons(
        np.concatenate([np.zeros((0, 3)), *(one.point for one in found)]),
        np.concatenate([np.zeros(0, int), *(one.size for one in found)]),
        np.concatenate([np.zeros(0, int), *(one.at + start for one, start in zip(found, starts, strict=False))]),
        np.concatenate([np.zeros((0, 3)), *(one.normal for one in found)]),
        np.concatenate([np.zeros(0, int), *(one.group for one in found)]),
        np.concatenate([np.zeros(0, int), *parts]),
        names,
        look=np.concatenate([one.looks for one in found]) if any(one.look is not None for one in found) else None,
    )


def triangulated(of: Polygons) -> tuple[Int[np.ndarray, "t 3"], Int[np.ndarray, " t"]]:
    """Return the corners of triangles that cover each face once, and the face of each triangle.

    A face of which every corner can be seen from its first is a fan about it, as most programs have it; any other, such
    as one with a notch or with a hole that a double edge leads to, is cut by its ears (mapbox_earcut).
    """
    area, first = of.areas(), of.first
    corners, faces = [np.zeros((0, 3), int)], [np.zeros(0, int)]
    for size in np.unique(of.size[of.size >= 3]):
        face = np.flatnonzero(of.size == size)
        corner = first[face][:, None] + np.arange(size)
        near = of.point[of.at[corner]] - of.point[of.at[corner[:, :1]]]
        across = np.cross(near[:, 1:-1], near[:, 2:])
        seen = ((across @ area[face][:, :, None])[..., 0] >= 0).all(1)
        fan = np.stack([np.zeros(size - 2, int), np.arange(1, size - 1), np.arange(2, size)], -1)
        corners.append(corner[seen][:, fan].reshape(-1, 3))
        faces.append(np.repeat(face[seen], size - 2))
        for one in np.flatnonzero(~seen):
            ears = _ears(near[one], area[face[one]])
            corners.append(corner[one][ears])
            faces.append(np.full(len(ears), face[one]))
    order = np.argsort(found := np.concatenate(faces), kind="stable")
    return np.concatenate(corners)[order], found[order]


def _ears(corner: Float[np.ndarray, "n 3"], area: Float[np.ndarray, "3"]) -> Int[np.ndarray, "t 3"]:
    """Return the triangles of one polygon, wound as it is."""
    from mapbox_earcut import triangulate_float64

    x, y = {0: (1, 2), 1: (2, 0), 2: (0, 1)}[int(np.abs(area).argmax())]  # the plane in which it is largest
    flat = np.ascontiguousarray(corner[:, [x, y]])
    ears = triangulate_float64(flat, np.array([len(flat)], np.uint32)).reshape(-1, 3).astype(int)
    ab, ac = flat[ears[:, 1]] - flat[ears[:, 0]], flat[ears[:, 2]] - flat[ears[:, 0]]
    turned = (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) * area[3 - x - y] < 0
    return np.where(turned[:, None], ears[:, ::-1], ears)
