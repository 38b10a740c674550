"""Outlines: the circle that is a mirror ball's, by evidence of several kinds, each of which a wrong one fails.

A circle is accepted where most slopes near it lie on it, where photographs taken apart show it too (or a picture under
room light does), and where each photograph has a small highlight in it, at a place where a light in front of the ball
is reflected, and not always the same. A vignette, a plate or a shadow on the wall lacks one of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.robust_scale import robust_scale
from ..core.thresholds import CLEARLY, FEW, MINOR, MOST, SIDE, SMALL
from ..io.encodings import brightened
from .edges import (
    REACHES,
    Circle,
    Picture,
    Points,
    alike,
    disc,
    find_edges,
    refine,
    share_on,
    shrunk,
)
from .highlights import brightest_piece

JUDGED = 2 * SIDE  # pixels of the longer side of pictures in which circles are judged
FARTHEST = MOST**0.5 + MINOR  # radii from the middle: highlights of lights in front are at sqrt(1/2) at most
REMEDY = (
    "Look at a photograph, and give the ball's column, row and radius there, circle=(x, y, r) (--circle X,Y,R), "
    "or a mask, mask='mask.png' (--mask)."
)


SHARE = attrgetter("share")


class Outline(NamedTuple):
    """The outline of a ball."""

    circle: Circle
    """Column, row and radius."""
    points: Points
    """Points of its edge: rows and columns, pixel centres at +.5."""
    errors: Float[np.ndarray, "3"]
    """How far the circle may be off, by how photographs and sizes of the pictures differ: pixels."""


class _Proposal(NamedTuple):
    picture: Picture
    """In which it was found, in its whole size."""
    circle: Circle
    share: float
    """Of the slopes near it that lie on it."""
    parts: Float[np.ndarray, "parts 3"]
    """The circles near it in the parts of the photographs that show one."""

    @property
    def agreed(self) -> int:
        """How many parts show the same circle."""
        return sum(alike(one, self.circle, REACHES[2]) for one in self.parts)


def find_outline(photographs: Sequence[Picture], mean: Picture, rooms: Sequence[Picture] = ()) -> Outline:
    """Return the outline of a mirror ball.

    Args:
        photographs: Each, shrunk to JUDGED pixels.
        mean: Their mean in its whole size.
        rooms: Pictures under room light, of the same size.

    Raises:
        ValueError: If no circle is accepted, or two that contradict each other.
    """
    parts = [brightened(np.mean(photographs[k::FEW], 0)) for k in range(min(FEW, len(photographs)))]
    scale = max(photographs[0].shape) / max(mean.shape)
    by_room = [found for room in rooms for found in _candidates(room, photographs, parts)]
    own = [found for found in _candidates(mean, photographs, parts) if found.agreed > MOST * len(parts)]
    if not (ranked := [of for found in (by_room, own) for of in sorted(found, key=SHARE, reverse=True)]):
        raise ValueError(
            "the ball's outline was not found: no circle has both an edge that the photographs share and each light's "
            f"highlight in it. {REMEDY}"
        )
    best = ranked[0]
    for other in ranked[1:]:
        close = np.hypot(*(other.circle - best.circle)[:2]) < best.circle[2] + other.circle[2]
        if close and not alike(other.circle, best.circle, REACHES[1]) and other.share * CLEARLY > best.share:
            fit = " and ".join("({:.0f}, {:.0f}, {:.0f})".format(*(of.circle / scale)) for of in (best, other))
            raise ValueError(f"the ball's outline is not certain: circles {fit} fit. {REMEDY}")
    return _in_whole(best, scale)


def _candidates(picture: Picture, photographs: Sequence[Picture], parts: Sequence[Picture]) -> list[_Proposal]:
    """Return the circles in a picture that have an edge and highlights."""
    shown, found = brightened(shrunk(picture, JUDGED)[0]), []
    for circle, _ in find_edges(shown):
        share = share_on(shown, circle)
        if share < MOST or not _lit(photographs, circle):
            continue
        near = [edge.circle for part in parts if (edge := refine(part, circle)) is not None]
        near = [one for one in near if alike(one, circle, REACHES[0])]
        found.append(_Proposal(picture, circle, share, np.reshape(near, (-1, 3))))
    return found


def _lit(photographs: Sequence[Picture], circle: Circle) -> bool:
    """Return whether nearly all photographs have a light's highlight in a circle, and not all at one place."""
    places = np.array([_highlight(photograph, circle) for photograph in photographs])
    known = np.isfinite(places).all(-1)
    inside = known & (np.hypot(*(places - circle[:2]).T) < FARTHEST * circle[2])
    return bool(inside.mean() > 1.0 - SMALL) and (len(places) < 3 or np.ptp(places[inside], axis=0).max() > 1.0)


def _highlight(photograph: Picture, circle: Circle) -> tuple[float, float]:
    """Return column and row of the brightest spot in a circle; NaN where what is bright is large."""
    column, row, radius = circle
    top, left = max(int(row - radius), 0), max(int(column - radius), 0)
    part = photograph[top : int(row + radius) + 1, left : int(column + radius) + 1]
    inside = disc(circle - np.array([left, top, 0.0]), part.shape)
    light = np.where(inside, part, 0.0)
    bright = light >= 0.5 * light.max(initial=0.0)
    if not light.any() or bright.sum() > MINOR * inside.sum():
        return np.nan, np.nan
    rows, columns = np.nonzero(brightest_piece(light)[0])
    return left + float(columns.mean()) + 0.5, top + float(rows.mean()) + 0.5


def _in_whole(best: _Proposal, scale: float) -> Outline:
    """Return the outline in the picture's whole size, and how it differs by size and photograph."""
    column, row, radius = best.circle / scale
    around = (1.0 + 2.0 * REACHES[0]) * radius
    top, left = (max(int(at - around), 0) for at in (row, column))
    part = best.picture[top : int(row + around) + 1, left : int(column + around) + 1]
    corner = np.array([left, top, 0.0])
    sizes = []
    for size in (1.0, MOST, scale):
        small, by = shrunk(part, max(int(size * max(part.shape)), 1))
        sizes.append((by, refine(brightened(small), (best.circle / scale - corner) * by, REACHES[2:])))
    circles = [edge.circle / by + corner for by, edge in sizes if edge is not None]
    by, edge = next((by, edge) for by, edge in sizes if edge is not None)
    points = edge.points[0] / by + top, edge.points[1] / by + left
    return Outline(circles[0], points, _apart(np.array(circles), best.parts / scale))


def _apart(sizes: Float[np.ndarray, "sizes 3"], parts: Float[np.ndarray, "parts 3"]) -> Float[np.ndarray, "3"]:
    """Return how far the first circle may be off: by other sizes, and by the middle of the parts, with its error.

    A part is a photograph or two, which show less than all together: that one of them is off says little.
    """
    square = np.mean((sizes - sizes[0]) ** 2, 0)
    if len(parts):
        middle = np.median(parts, 0)
        spread = np.array([robust_scale(of) for of in (parts - middle).T])
        square = square + (middle - sizes[0]) ** 2 + spread**2 / len(parts)
    return np.sqrt(square)
