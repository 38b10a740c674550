"""Copies: views that no photograph is of, which fill the number of views up to one of a few.

A compiled program is one for its shapes, and the number of views is in the shapes of most of a fit: in those of the
views, and of the lights and the unknowns that each brings. So programs are given the views with copies of the last one,
of the lights that are on in it alone, and of the unknowns of these. No pixel shows a copy. Its unknowns are held where
they begin, and there nothing that is known beforehand pulls at them: what is minimised stays the same.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from ...model.scenes import Scene
from ..data.views import View, lights_on
from ..pixels.blocks import filled
from ..unknowns.places import Place
from ..unknowns.unknown import Unknown, coordinates, unit_vectors
from ..unknowns.visibility import Arrow, arrow_of
from .gram import ByView
from .interface import AbstractForwardModel, Setting
from .rendered import prepare
from .rounding import Rounding


@dataclass(frozen=True, eq=False)
class Copies:
    """What programs are given of the copies, beside the problem's own: arrays of q, the unknowns of the copies."""

    setting: Setting
    """Of the problem and the copies together."""
    arrow: Arrow | None
    """Of the unknowns of both."""
    views: int
    """The problem's own views."""
    more: int
    """The copies."""
    own: Int[np.ndarray, " blocks"]
    """The problem's own blocks among those of the arrow."""
    theta: Float[np.ndarray, " q"]
    """Where the unknowns are held, in the solver's coordinates."""
    linear: Bool[np.ndarray, " q"]
    known: Int[np.ndarray, " k"]
    """Which of them have a prior."""
    units: Int[np.ndarray, "u 3"]
    """Which of them are a unit vector together."""

    def model(self, model: AbstractForwardModel) -> AbstractForwardModel:
        """Return a model of the problem as programs take it."""
        return model.widened(dataclasses.replace(self.setting, rounding=self.rounding(model.setting.rounding)))

    def rounding(self, of: Rounding) -> Rounding:
        """Return the steps of the problem's views, and of the copies."""
        step, srgb = (np.append(each, np.repeat(each[-1:], self.more)) for each in (of.step, of.srgb))
        return Rounding(step, srgb, of.noise)

    def beside(self, own: Any, value: Any = None) -> np.ndarray:
        """Return what the problem's unknowns have, and after it what those of the copies do: by default `theta`."""
        return np.append(own, self.theta if value is None else np.broadcast_to(value, self.theta.shape))

    def without(self, views: ByView, p: int) -> ByView:
        """Return what the problem's own views say of its own p unknowns."""
        cost, gradient, hessian = (np.asarray(of)[: self.views] for of in (views.cost, views.gradient, views.hessian))
        shown = None if views.shown is None else np.minimum(np.asarray(views.shown)[: self.views], p)
        return ByView(cost, gradient, hessian, shown)


def copies_for(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> tuple[Copies | None, Arrow | None]:
    """Return the copies for a problem, None where it needs none; and the arrow of the problem's own unknowns."""
    arrow, more, p = arrow_of(scene, views, unknowns), filled(len(views)) - len(views), len(unknowns)
    if not more:
        return None, arrow
    with_copies, all_views, added = _copied(scene, views, unknowns, more)
    setting, own = prepare(with_copies, all_views, (*unknowns, *added)), np.zeros(0, int)
    wide = None if arrow is None else arrow_of(with_copies, all_views, (*unknowns, *added))
    if wide is None:
        arrow = None
    else:
        own = np.flatnonzero((wide.blocks < p).any(1))
        arrow = Arrow(wide.border, np.minimum(wide.blocks[own], p))
    starts = coordinates(np.array([of.start for of in added]), added)
    known = np.array([j for j, of in enumerate(added) if of.prior is not None], int)
    units = np.array(unit_vectors(added), int).reshape(-1, 3)
    linear = np.array([of.parameter.linear for of in added], bool)
    return Copies(setting, wide, len(views), more, own, starts, linear, known, units), arrow


def _copied(
    scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown], more: int
) -> tuple[Scene, list[View], list[Unknown]]:
    """Return the scene and the views with so many copies of the last view, and the unknowns of the copies."""
    last, lights, lit = len(views) - 1, len(scene.lights), lights_on(scene, views[-1])
    elsewhere = {i for view in views[:-1] for i in lights_on(scene, view)}
    own = [i for i in lit if i not in elsewhere]

    def copy_of(i: int, copy: int) -> int:
        return lights + copy * len(own) + own.index(i) if i in own else i

    def moved(place: Place, copy: int) -> Place:
        """Return where a copy has what the last view, or a light of its own, has at a place."""
        item = last + 1 + copy if place.owner == "views" else copy_of(place.item or 0, copy)
        return dataclasses.replace(place, item=item)

    def alone(place: Place) -> bool:
        return (place.owner == "views" and place.item == last) or (place.owner == "lights" and place.item in own)

    which = [j for j, of in enumerate(unknowns) if all(map(alone, of.all_places))]
    all_views, added = list(views), []
    for copy in range(more):
        index = {j: len(unknowns) + len(added) + k for k, j in enumerate(which)}
        for of in (unknowns[j] for j in which):
            products = tuple(
                dataclasses.replace(
                    x, place=moved(x.place, copy), other=x.other if x.other is None else index.get(x.other, x.other)
                )
                for x in of.products
            )
            places = tuple(moved(place, copy) for place in of.places)
            quantity = f"{of.quantity} of copy {copy}"
            added.append(dataclasses.replace(of, quantity=quantity, places=places, products=products))
        all_views.append(dataclasses.replace(views[-1], lit=tuple(copy_of(i, copy) for i in lit)))
    all_lights = (*scene.lights, *[scene.lights[i] for i in own] * more)
    return eqx.tree_at(lambda s: s.lights, scene, all_lights), all_views, added
