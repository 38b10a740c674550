"""Visibility: which unknowns each view can show, so that no view is asked of what it cannot know.

A light's direction matters only to the views that it is on in, an exposure to its own view. The normal equations of all
views then have the shape of an arrow: a border that all views share, and a small block for each (Triggs et al. 2000).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from ...core.fields import Array
from ...model.scenes import Scene
from ..data.views import View, lights_on
from .unknown import Unknown

FEWEST_BLOCKS = 8  # with fewer, the dense solution is as fast
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
        on[[i for i in lights_on(scene, view) if i < len(on)], v] = True  # a wrong index is refused elsewhere
    everywhere, alone = np.ones(len(views), bool), np.eye(len(views), dtype=bool)

    def views_of(path: str) -> Bool[np.ndarray, " views"]:
        head, number, *_ = [*path.split("."), "", ""]
        return on[int(number)] if head == "lights" else alone[int(number)] if head == "views" else everywhere

    shows = np.zeros((len(unknowns), len(views)), bool)
    for j, unknown in enumerate(unknowns):
        for path, _ in unknown.places:
            shows[j] |= views_of(path)
        for product in unknown.products:
            for factor in (j, j if product.other is None else product.other):
                shows[factor] |= views_of(product.path)
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
    views_of: list[list[int]] = [[] for _ in range(p + 1)]
    for v, row in enumerate(shown):
        for j in row:
            views_of[j].append(v)
    taken: list[set[int]] = [set() for _ in shown]
    seed = np.zeros(p + 1, int)
    for j in range(p):
        used = set().union(*(taken[v] for v in views_of[j]))
        seed[j] = next(k for k in range(p) if k not in used)
        for v in views_of[j]:
            taken[v].add(int(seed[j]))
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
    own = [unknown.name[len(unknown.quantity) + 1 :] for unknown in unknowns]
    common = [j for j, band in enumerate(own) if band not in bands]
    alone = [[j for j, of in enumerate(own) if of == band] for band in bands]
    index = np.full((len(bands), len(common) + max(map(len, alone))), p)
    for row, of_band in zip(index, alone, strict=True):
        row[: len(common)] = common
        row[len(common) : len(common) + len(of_band)] = of_band
    seeds = np.zeros((index.shape[1], p + 1))
    seeds[np.arange(index.shape[1]), index] = 1.0
    return seeds[:, :p], index


def part_of(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown], some: Sequence[int], members: Sequence[int]
) -> tuple[Scene, tuple[View, ...], list[Unknown]]:
    """Return some of the views with the lights alone that are on in them, and some unknowns at their places there.

    Args:
        scene: The scene.
        views: All views.
        unknowns: All unknowns.
        some: The indices of the views.
        members: Those of the unknowns; all that these views show are among them.
    """
    on = sorted({i for v in some for i in lights_on(scene, views[v])})
    number = {"lights": {i: k for k, i in enumerate(on)}, "views": {v: k for k, v in enumerate(some)}}

    def there(path: str) -> str | None:
        head, *rest = path.split(".")
        if head not in number:
            return path
        k = number[head].get(int(rest[0]))
        return None if k is None else ".".join([head, str(k), *rest[1:]])

    def of(unknown: Unknown) -> Unknown:
        places = [(path, channel) for old, channel in unknown.places if (path := there(old)) is not None]
        products = [
            dataclasses.replace(x, path=path, other=None if x.other is None else list(members).index(x.other))
            for x in unknown.products
            if (path := there(x.path)) is not None
        ]
        return dataclasses.replace(unknown, places=places, products=products)

    lit = [tuple(number["lights"][i] for i in lights_on(scene, views[v])) for v in some]
    return (
        dataclasses.replace(scene, lights=[scene.lights[i] for i in on]),
        tuple(dataclasses.replace(views[v], lit=of_view) for v, of_view in zip(some, lit, strict=True)),
        [of(unknowns[j]) for j in members],
    )


def arrow_of(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> Arrow | None:
    """Return the unknowns as border and blocks, such as those of each light; None where that would save nothing."""
    shows = views_that_show(scene, views, unknowns)
    p, narrow = len(unknowns), np.flatnonzero(shows.mean(1) <= NARROW)
    if len(narrow) < FEWEST_BLOCKS:
        return None
    rows, columns = np.nonzero(shows[narrow])
    linked = scipy.sparse.coo_array(
        (np.ones(len(rows)), (rows, len(narrow) + columns)), shape=2 * (len(narrow) + len(views),)
    )
    _, label = scipy.sparse.csgraph.connected_components(linked, directed=False)
    found = [narrow[label[: len(narrow)] == of] for of in np.unique(label[: len(narrow)])]
    largest = max(map(len, found), default=0)
    if len(found) < FEWEST_BLOCKS or (p - len(narrow)) + largest > p / 2:
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
        places = [j for j in of if re.fullmatch(r"lights\.\d+\.(direction|position)", unknowns[j].quantity)]
        if len(places) == 3 and all(unknowns[j].lower < unknowns[j].upper for j in places):  # not held
            found.append(places)
    return found
