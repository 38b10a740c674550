"""Normals at the corners of triangles: the file's own, and means over the triangles around a point elsewhere."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from ..core.thresholds import SINGLE
from .polygons import NONE, Polygons

Corners = Float[np.ndarray, "t 3 3"]


def unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Return vectors of length 1; 0 where they have no direction."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def have_direction(vectors: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
    """Return which vectors are finite and not 0."""
    return np.isfinite(vectors).all(-1) & (vectors != 0).any(-1)


def corner_normals(of: Polygons, corner: Int[np.ndarray, "t 3"], face: Int[np.ndarray, " t"]) -> Corners:
    """Return unit normals at the corners of the triangles of polygons.

    Where the file has none, or none with a direction, a normal is the mean of those of the triangles around the point,
    weighted by their angles there (Thuermer and Wuethrich 1998): of all that are of one smoothing group, whatever
    their materials and texture coordinates. Of faces back to back, each side has its own.

    Args:
        of: The polygons.
        corner: The corners of each triangle, as indices of the corners of the polygons.
        face: The polygon of each triangle.
    """
    given, point = of.normal[corner], of.point[of.at[corner]]
    known = have_direction(given)[..., None]
    if known.all():
        return unit(given)
    return np.where(known, unit(np.where(known, given, 1.0)), _means(point, _shared(of, corner, face)))


def _means(point: Corners, label: Int[np.ndarray, "t 3"]) -> Corners:
    """Return the mean normal over the corners of one label."""
    side = np.roll(point, -1, axis=1) - point
    flat = np.repeat(unit(np.cross(side[:, 0], side[:, 1]))[:, None], 3, axis=1)
    to, back = unit(side), unit(-np.roll(side, 1, axis=1))
    angle = np.arccos(np.clip((to * back).sum(-1), -1.0, 1.0))
    which = label.ravel()
    total = np.stack([np.bincount(which, (angle * flat[..., k]).ravel()) for k in range(3)], -1)
    weight = np.bincount(which, angle.ravel())
    cancelled = np.linalg.norm(total, axis=-1) <= SINGLE * weight
    return np.where(cancelled[label][..., None], flat, unit(total)[label])


def _shared(of: Polygons, corner: Int[np.ndarray, "t 3"], face: Int[np.ndarray, " t"]) -> Int[np.ndarray, "t 3"]:
    """Return a label for each corner of each triangle: corners of one label have one normal."""
    place = _numbered(*(of.point + 0.0).T)[of.at]
    group = of.group[face][:, None] + np.zeros((1, 3), int)
    own = np.where(group == NONE, np.arange(len(face))[:, None], NONE)
    sheet, turned, doubled = _sheets(of, place)
    side = _sides(place[corner], sheet[face], turned[face], doubled[face]) if doubled.any() else 0 * own
    return _numbered(*(key.ravel() for key in (place[corner], group, own, side))).reshape(corner.shape)


def _numbered(*columns: Num[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return a number for each row, the same for equal rows."""
    return np.unique(np.stack(columns, -1), axis=0, return_inverse=True)[1].ravel()


def _sheets(
    of: Polygons, place: Int[np.ndarray, " corners"]
) -> tuple[Int[np.ndarray, " faces"], Bool[np.ndarray, " faces"], Bool[np.ndarray, " faces"]]:
    """Return for each face a number that faces of the same points share, its side, and whether both sides are there."""
    sheet, area, start = np.zeros(len(of.size), int), of.areas(), 0
    for size in np.unique(of.size):
        faces = np.flatnonzero(of.size == size)
        points = np.sort(place[of.first[faces][:, None] + np.arange(size)], axis=1)
        sheet[faces] = start + _numbered(*points.T)
        start = sheet[faces].max() + 1
    _, first = np.unique(sheet, return_index=True)
    turned = (area * area[first][sheet]).sum(-1) < 0
    return sheet, turned, (np.bincount(sheet, turned) > 0)[sheet]


def _sides(
    place: Int[np.ndarray, "t 3"],
    sheet: Int[np.ndarray, " t"],
    turned: Bool[np.ndarray, " t"],
    doubled: Bool[np.ndarray, " t"],
) -> Int[np.ndarray, "t 3"]:
    """Return a number for each corner: those that edges join, run along in opposite directions, are of one side.

    Only where faces lie back to back; every other corner has the number 0.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    near = np.isin(place, place[doubled])
    some = np.flatnonzero(near.any(1))
    begin, corner = place[some].ravel(), np.arange(place.size).reshape(-1, 3)[some]
    end, next_corner = (np.roll(of, -1, axis=1).ravel() for of in (place[some], corner))
    edge, reverse = begin * (place.max() + 1) + end, end * (place.max() + 1) + begin
    order = np.argsort(edge)
    first, last = (np.searchsorted(edge[order], reverse, side) for side in ("left", "right"))
    many = last - first  # edges that run against each
    against = order[np.arange(many.sum()) + np.repeat(first - (np.cumsum(many) - many), many)]
    one, other = np.repeat(corner.ravel(), many), next_corner[against]  # at one point
    k, m = one // 3, other // 3
    joined = (sheet[k] != sheet[m]) | (turned[k] == turned[m])
    one, other = one[joined], other[joined]
    graph = coo_array((np.ones(len(one), np.int8), (one, other)), (place.size, place.size))
    return np.where(near, 1 + connected_components(graph, directed=False)[1].reshape(place.shape), 0)
