"""Edges: the outline of a mirror ball, which reflects the room, from the photographs themselves.

Its inside differs from picture to picture, and so does the background: what stays is the edge. Circles are proposed by
Hough's transform (Yuen et al. 1990, in OpenCV) on a small picture; the one with the most edge under it is refined by
the place of the steepest slope along its radii.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from .balls import circle, near_one_circle

Picture = Float[np.ndarray, "h w"]
Points = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]

SMALL = 400  # pixels of the longer side of the picture in which circles are proposed
CIRCLES = 8  # that each threshold proposes, and that are refined
RADII = (0.08, 0.75)  # of a ball, over the longer side
ANGLES = 720  # radii on which the edge is searched for: a point each pixel of a ball 230 pixels wide
REACHES = (0.06, 0.03, 0.015)  # of the radius, within which the edge is searched for, from coarse to fine
MIN_REACH = 4.0  # pixels
SIGMA = 1.5  # pixels: standard deviation of the Gaussian whose derivative is the slope
MIN_STRENGTH = 0.4  # root of the slope, over that of most angles, below which an angle shows no edge


def find_edge(pictures: Sequence[Picture]) -> Points | None:
    """Return points (rows, columns; pixel centres at +.5) of the roundest edge that all pictures share, or None."""
    mean = np.mean([np.nan_to_num(picture, posinf=0.0) for picture in pictures], 0)
    shown = np.sqrt(np.clip(mean / max(float(np.quantile(mean, 0.99)), 1e-12), 0.0, 1.0))  # a dark edge counts too
    proposed = sorted(_proposed(shown), key=lambda one: _slopes(shown, one, REACHES[0])[1].sum(), reverse=True)
    found = [_refined(shown, one) for one in proposed[:CIRCLES]]
    best = max((one for one in found if one is not None), key=lambda one: one[0], default=None)
    return None if best is None else best[1]


def _proposed(shown: Picture) -> list[Float[np.ndarray, "3"]]:
    """Return columns, rows and radii of circles."""
    import cv2

    scale = SMALL / max(shown.shape)
    small = cv2.resize((255.0 * shown).astype(np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    circles = []
    for edge in (60, 30, 15):
        found = cv2.HoughCircles(
            small, cv2.HOUGH_GRADIENT, 1.5, 10.0, None, edge, 20.0, *(int(radius * SMALL) for radius in RADII)
        )  # pyright: ignore[reportCallIssue, reportArgumentType]
        circles += [] if found is None else list(found[0, :CIRCLES] / scale)
    return circles


def _slopes(
    shown: Picture, near: Float[np.ndarray, "3"], reach: float
) -> tuple[Float[np.ndarray, "angles 2"], Float[np.ndarray, " angles"]]:
    """Return the columns and rows of the steepest slope along each radius near a circle, and the root of each slope.

    The slope is 0 where the picture ends, or where it is the steepest at an end of the radius.
    """
    column, row, radius = (float(number) for number in near)
    angle = np.linspace(0.0, 2.0 * np.pi, ANGLES, endpoint=False)
    half = max(reach * radius, MIN_REACH)
    radii = np.arange(radius - half, radius + half, 0.5)
    rows, columns = (at + np.outer(of(angle), radii) - 0.5 for at, of in ((row, np.sin), (column, np.cos)))
    along = ndimage.map_coordinates(shown, [rows, columns], order=1, mode="constant", cval=np.nan)
    inside = np.asarray(np.isfinite(along).all(1))
    slope = np.abs(ndimage.gaussian_filter1d(np.where(inside[:, None], along, 0.0), 2.0 * SIGMA, axis=1, order=1))
    at = slope.argmax(1)
    strength = np.where(inside & (at > 0) & (at < len(radii) - 1), slope[np.arange(ANGLES), at], 0.0)
    points = np.stack([column + np.cos(angle) * radii[at], row + np.sin(angle) * radii[at]], -1)
    return points, np.sqrt(strength)


def _refined(shown: Picture, proposed: Float[np.ndarray, "3"]) -> tuple[float, Points] | None:
    """Return how strong and how round the edge near a circle is, and its points."""
    points, strength = np.zeros((0, 2)), np.zeros(0)
    for reach in REACHES:
        points, strength = _slopes(shown, proposed, reach)
        shows = strength > 0.0
        if shows.sum() < ANGLES / 4:
            return None
        shows = shows & (strength > MIN_STRENGTH * np.median(strength[shows]))
        padded = np.column_stack([points, np.zeros(ANGLES)])[shows]
        weight = near_one_circle(padded)
        if weight.sum() < ANGLES / 8:
            return None
        middle, radius, _ = circle(padded, weight)
        proposed = np.array([*middle[:2], radius])
        points, strength = points[shows][weight > 0], strength[shows][weight > 0]
    return float(strength.sum()), (points[:, 1], points[:, 0])


def _circle_of(edge: Points) -> Float[np.ndarray, "3"]:
    """Return column, row and radius of the circle through points of an edge."""
    row, column = edge
    middle, radius, _ = circle(np.column_stack([column, row, np.zeros(len(row))]), np.ones(len(row)))
    return np.array([middle[0], middle[1], radius])


def alike(one: Points, other: Points) -> bool:
    """Whether two edges are of about the same circle."""
    this, that = _circle_of(one), _circle_of(other)
    apart = this - that
    return bool(max(np.hypot(apart[0], apart[1]), abs(apart[2])) < REACHES[0] * this[2])


def disc(edge: Points, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """Return the pixels inside the circle through points of an edge."""
    middle_column, middle_row, radius = _circle_of(edge)
    row, column = np.indices(shape) + 0.5
    return (row - middle_row) ** 2 + (column - middle_column) ** 2 < radius**2
