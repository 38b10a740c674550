"""Edges: circles that may be the outline of a mirror ball, which reflects the room, from a picture of it.

Its inside differs from picture to picture, and so does the background: what stays is the edge. Circles are proposed by
Hough's transform (Yuen et al. 1990, in OpenCV) on a small picture; each is refined by the place of the steepest slope
along its radii.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from ..core.extras import needing
from ..core.thresholds import SIDE, SMALL
from .balls import circle, near_one_circle
from .highlights import Picture

Points = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]
Circle = Float[np.ndarray, "3"]

RADII = (0.03, 0.75)  # of a ball, over the longer side
ANGLES = 720  # radii on which the edge is searched for: a point each pixel of a ball 230 pixels wide
REACHES = (0.12, 0.06, 0.03, 0.015)  # of the radius, within which the edge is searched for, from coarse to fine
MIN_REACH = 4.0  # pixels
SIGMA = 1.5  # pixels: standard deviation of the Gaussian whose derivative is the slope
MIN_STRENGTH = 0.4  # root of the slope, over that of most angles, below which an angle shows no edge


class Edge(NamedTuple):
    """Points of an edge that lie on a circle."""

    circle: Circle
    """Column, row and radius."""
    points: Points
    """Rows and columns, pixel centres at +.5."""


def find_edges(shown: Picture) -> list[Edge]:
    """Return the circles in a brightened picture that edges lie on, each once."""
    found: list[Edge] = []
    for proposed in _proposed(shown):
        edge = refine(shown, proposed)
        if edge is not None and not any(alike(edge.circle, other.circle, REACHES[-1]) for other in found):
            found.append(edge)
    return found


def shrunk(picture: Picture, longest: int) -> tuple[Picture, float]:
    """Return a picture whose longer side has so many pixels at most, and its size over the picture's."""
    with needing("photographs", "cannot search for a ball in photographs"):
        import cv2

    scale = min(1.0, longest / max(picture.shape))
    return cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), scale


def _proposed(shown: Picture) -> list[Circle]:
    """Return circles in a picture without fine grain, and in one of even contrast."""
    import cv2

    small, scale = shrunk(shown, SIDE)
    smooth = (255.0 * small).astype(np.uint8)
    circles, (low, high) = [], (int(radius * SIDE) for radius in RADII)
    for picture in (smooth, cv2.createCLAHE(3.0, (4, 4)).apply(smooth)):
        blurred = cv2.medianBlur(picture, 5)
        for slope in (300.0, 100.0):  # by Scharr's derivative, of an edge
            found = cv2.HoughCircles(blurred, cv2.HOUGH_GRADIENT_ALT, 1.5, 10.0, None, slope, 0.5, low, high)
            circles += [] if found is None else list(found[0].astype(float) / scale)
    return circles


def _slopes(
    shown: Picture, near: Circle, reach: float
) -> tuple[Float[np.ndarray, "angles 2"], Float[np.ndarray, " angles"]]:
    """Return the columns and rows of the steepest slope along each radius near a circle, and the root of each slope.

    The slope is 0 where it is the steepest at an end of the radius, and NaN where the picture ends.
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
    strength = np.where((at > 0) & (at < len(radii) - 1), slope[np.arange(ANGLES), at], 0.0)
    points = np.stack([column + np.cos(angle) * radii[at], row + np.sin(angle) * radii[at]], -1)
    return points, np.where(inside, np.sqrt(strength), np.nan)


def refine(shown: Picture, proposed: Circle, reaches: Sequence[float] = REACHES) -> Edge | None:
    """Return the edge on a circle near the one that is proposed, in a brightened picture; None if there is none."""
    on = np.zeros((0, 3))
    for reach in reaches:
        points, strength = _slopes(shown, proposed, reach)
        shows = strength > 0.0
        if shows.sum() < ANGLES / 4:
            return None
        shows = shows & (strength > MIN_STRENGTH * np.median(strength[shows]))
        on = np.column_stack([points, np.zeros(ANGLES)])[shows]
        weight = near_one_circle(on)
        on = on[weight > 0]
        if len(on) < ANGLES / 8:
            return None
        middle, radius, _ = circle(on, np.ones(len(on)))
        proposed = np.array([*middle[:2], radius])
    return Edge(proposed, (on[:, 1], on[:, 0]))


def share_on(shown: Picture, near: Circle) -> float:
    """Return which share of the slopes near a circle, steepest along their radii, lies on it."""
    points, strength = _slopes(shown, near, SMALL)
    off = np.abs(np.hypot(*(points - near[:2]).T) - near[2])
    strength = np.minimum(np.nan_to_num(strength), 2.0 * np.nanmedian(strength))
    return float(strength[off < max(REACHES[-2] * near[2], 1.0)].sum() / max(strength.sum(), 1e-12))


def alike(one: Circle, other: Circle, within: float) -> bool:
    """Whether two circles differ by less than a share of their radius."""
    apart = one - other
    return bool(max(np.hypot(apart[0], apart[1]), abs(apart[2])) < within * other[2])


def disc(of: Circle, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """Return the pixels inside a circle."""
    column, row, radius = of
    rows, columns = (np.arange(length) + 0.5 for length in shape)
    return (rows[:, None] - row) ** 2 + (columns - column) ** 2 < radius**2
