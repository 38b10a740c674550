"""Visibility: which unknowns each view can show, so that it is not differentiated by the others.

A light's direction matters only to the views that it is on in, an exposure to its own view. The normal equations of all
views then have the shape of an arrow: a border that all views share, and a small block for each (Triggs et al. 2000).
"""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from ...core.fields import Array
from ...core.thresholds import FEW
from ...model.scenes import Scene
from ..data.views import View, lights_on
from .places import Place
from .unknown import Unknown

NARROW = 0.25  # an unknown that at most this fraction of the views can show belongs to a block


class Arrow(eqx.Module):
    """The unknowns, divided so that no view can show two blocks of them."""

    border: Int[Array, " f"]
    """The indices of the unknowns that many views can show."""
    blocks: Int[Array, "blocks g"]
    """Those of each block, padded with the number of unknowns."""


def views_that_show(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]
) -> Bool[np.ndarray, "unknowns views"]:
    """Return for each unknown which views can show it: none shows what belongs to lights that are always off."""
    on = np.zeros((len(scene.lights), len(views)), bool)
    for v, view in enumerate(views):
        on[list(lights_on(scene, view)), v] = True
    everywhere, alone = np.ones(len(views), bool), np.eye(len(views), dtype=bool)

    def views_of(place: Place) -> Bool[np.ndarray, " views"]:
        item = 0 if place.item is None else place.item
        return on[item] if place.owner == "lights" else alone[item] if place.owner == "views" else everywhere

    shows = np.zeros((len(unknowns), len(views)), bool)
    for j, unknown in enumerate(unknowns):
        for place in unknown.all_places:
            shows[j] |= views_of(place)
        for product in unknown.products:
            if product.other is not None:
                shows[product.other] |= views_of(product.place)
    return shows


def shown_unknowns(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]
) -> Int[np.ndarray, "views most"] | None:
    """Return the indices of the unknowns that each view can show, padded with their number; None where all show all."""
    shows = views_that_show(scene, views, unknowns)
    if shows.all():
        return None
    found = np.full((len(views), int(shows.sum(0).max())), len(unknowns))
    for row, of_view in zip(found, shows.T, strict=True):
        row[: of_view.sum()] = np.flatnonzero(of_view)
    return found


def seeds_of(
    shown: Int[np.ndarray, "views most"] | None, p: int
) -> tuple[Float[np.ndarray, "seeds p"], Int[np.ndarray, "views most"] | None] | None:
    """Return directions that each take several unknowns together, no two of which any view shows; None without `shown`.

    Derivatives along them, few as they are, are those of every view by its own unknowns (Curtis, Powell and Reid 1974).
    Beside them comes which of the directions has each unknown of a view; None where each view has all, in order.
    """
    if shown is None:
        return None
    rows = np.zeros((len(shown), p + 1), bool)
    rows[np.arange(len(shown))[:, None], shown] = True
    seed = np.append(_apart(rows[:, :p]), 0)
    seeds = np.eye(int(seed.max()) + 1)[:, seed[:p]]
    in_order = shown.shape[1] == len(seeds) and (shown < p).all() and (seed[shown] == np.arange(len(seeds))).all()
    return seeds, None if in_order else seed[shown]


def seeds_of_bands(
    scene: Scene, unknowns: Sequence[Unknown]
) -> tuple[Float[np.ndarray, "seeds p"], Int[np.ndarray, "bands seeds"]]:
    """Return directions that each take one unknown of every band together, or one that all bands show.

    Beside them comes which unknown each direction is in each band, padded with their number. As in `seeds_of`,
    derivatives along these few are all that there are: no band shows the unknowns of another.
    """
    p, bands = len(unknowns), scene.channels
    shows = np.array([[of.channel == band or of.channel not in bands for of in unknowns] for band in bands])
    seed = _apart(shows)
    index = np.full((len(bands), seed.max() + 1), p)
    band, unknown = np.nonzero(shows)
    index[band, seed[unknown]] = unknown
    return np.eye(seed.max() + 1)[:, seed], index


def _apart(shows: Bool[np.ndarray, "rows p"]) -> Int[np.ndarray, " p"]:
    """Return for each unknown the first direction that none has which is shown together with it."""
    together = shows.T.astype(float) @ shows > 0
    found = np.zeros(len(together), int)
    for j, others in enumerate(together):
        taken = set(found[:j][others[:j]].tolist())
        found[j] = next(k for k in range(j + 1) if k not in taken)
    return found


def arrow_of(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> Arrow | None:
    """Return the unknowns as border and blocks, such as those of each light; None where that would save nothing."""
    shows = views_that_show(scene, views, unknowns)
    p, narrow = len(unknowns), np.flatnonzero(shows.mean(1) <= NARROW)
    if len(narrow) < FEW:
        return None
    rows, columns = np.nonzero(shows[narrow])
    linked = scipy.sparse.coo_array(
        (np.ones(len(rows)), (rows, len(narrow) + columns)), shape=2 * (len(narrow) + len(views),)
    )
    _, label = scipy.sparse.csgraph.connected_components(linked, directed=False)
    found = [narrow[label[: len(narrow)] == of] for of in np.unique(label[: len(narrow)])]
    largest = max(map(len, found), default=0)
    if len(found) < FEW or (p - len(narrow)) + largest > p / 2:
        return None
    blocks = np.full((len(found), largest), p)
    for row, of in zip(blocks, found, strict=True):
        row[: len(of)] = of
    return Arrow(np.setdiff1d(np.arange(p), narrow), blocks)


def places_apart(unknowns: Sequence[Unknown], arrow: Arrow | None) -> list[list[int]]:
    """Return the x, y and z of each light's free place, for the lights that show in no view with another.

    A spot of which both position and direction are free has two places, which only a search one by one tells apart.
    """
    found = []
    for block in [] if arrow is None else np.sort(arrow.blocks, 1).tolist():
        of = [j for j in block if j < len(unknowns)]
        places = [j for j in of if len(unknowns[j].places) == 1 and unknowns[j].kind in ("direction", "position")]
        if len(places) == 3 and all(unknowns[j].lower < unknowns[j].upper for j in places):  # not held
            found.append(places)
    return found
