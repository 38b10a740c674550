"""Set-up: a fit laid out beside the numbers that faults move (exposures, places of lights, spheres), and its minima."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from ...core.masks import Mask
from ...core.thresholds import SINGLE
from ..data.view_sets import Masks
from ..pixels.blocks import MANY, Block
from ..result import Fit
from ..solve.solvers import NEAR
from ..statistics.uncertainty import Vector
from ..unknowns.parameters import find_unknowns
from ..unknowns.places import Place
from ..unknowns.slots import put_back
from ..unknowns.unknown import values_at
from .beside import beside
from .regions import center_of, rims

MasksOf = Mapping[int, Mask]  # of some views, by their indices


@dataclass(frozen=True, eq=False)
class Corrected:
    """The minimum over a fit's own unknowns, with numbers of the set-up changed and some pixels left out."""

    theta: Vector
    """The fit's unknowns and, after them, the numbers that faults move, in the solver's coordinates."""
    fit: Fit
    """The fit with the scene, the views and the values of this minimum; its other fields are unchanged."""
    costs: Float[np.ndarray, " views"]
    """The cost of each view; a pixel that is left out counts with the mean cost of its view."""
    excluded: Masks
    """The pixels of each view that are left out."""
    amounts: Mapping[tuple[str, int], Vector]
    """By how much each fault was corrected: of which kind, and which case of it."""

    def share(self, after: Corrected, views: Iterable[int] | None = None) -> float:
        """Return the fraction of the cost that another minimum explains, in some views or in all."""
        which = slice(None) if views is None else list(views)
        cost = float(self.costs[which].sum())
        return 1.0 - float(after.costs[which].sum()) / cost if cost > 0 else 0.0


class SetUp:
    """A fit and the minima with some of its faults corrected. Runs in float64; one program serves all minima."""

    def __init__(self, fit: Fit, numbers: Iterable[Place], pixels: int = MANY):
        """Lay the fit out on so many of its pixels; `numbers` are the places of what faults move."""
        data = fit.solved.problem.data
        self.fit, self.samples, self.lit = fit, data.samples, data.lit
        self.center = center_of(fit.scene.objects, fit.views[0].camera)
        own = {place.whole for unknown in fit.unknowns for place in unknown.all_places}
        paths = [place.path for place in dict.fromkeys(numbers) if place not in own]
        added = find_unknowns(fit.scene, fit.views, paths, from_scene=True) if paths else []
        self.laid = fit.solved.beside(added).laid_out(pixels)
        self.own = len(fit.unknowns)
        self.places: dict[Place, list[int]] = {}
        """The index of each number that faults move."""
        for j, unknown in enumerate(added):
            self.places.setdefault(unknown.places[0].whole, []).append(self.own + j)
        shown = self.laid.model.setting.shown
        self.shown = (
            np.tile(np.arange(len(self.laid.theta)), (len(fit.views), 1)) if shown is None else np.asarray(shown)
        )
        samples = [
            np.broadcast_arrays(v, pixels, np.arange(of.photograph.shape[2])[:, None])
            for v, of, pixels in self.laid.parts
        ]
        self.view, self.pixel, self.channel = np.hstack([np.reshape(of, (3, -1)) for of in samples]).astype(int)
        self.first = np.searchsorted(self.view, np.arange(len(fit.views) + 1))
        """The first sample of each view, and their number."""

    @cached_property
    def shown_beside(self) -> list[Vector] | None:
        """What the photographs show beside the objects, less the background, in each channel."""
        return beside(self.fit)

    @cached_property
    def rims(self) -> list[tuple[Mask, np.ndarray]]:
        """The grazing rims of each view, and the sector of each pixel."""
        return [rims(self.fit.scene.objects, view.camera) for view in self.fit.views]

    @cached_property
    def bounds(self) -> tuple[Vector, Vector]:
        """The bounds of the numbers, in the solver's coordinates."""
        box = self.laid.task.box
        return np.asarray(box.lower), np.asarray(box.upper)

    @property
    def given(self) -> Corrected:
        """The fit as it is; its costs are not known."""
        none = (None,) * len(self.fit.views)
        return Corrected(self.laid.theta, self.fit, np.zeros(len(none)), none, {})

    @cached_property
    def base(self) -> Corrected:
        """The minimum on the pixels that are laid out."""
        return self.minimise(self.laid.theta, (None,) * len(self.fit.views), {})

    def exclude(self, state: Corrected, masks: MasksOf) -> Corrected:
        """Return the minimum with more pixels of some views left out."""
        excluded = list(state.excluded)
        for view, mask in masks.items():
            excluded[view] = mask if (known := excluded[view]) is None else mask | known
        return self.minimise(state.theta, tuple(excluded), state.amounts)

    def minimise(self, theta: Vector, excluded: Masks, amounts: Mapping[tuple[str, int], Vector]) -> Corrected:
        """Return the minimum over the fit's own unknowns from theta, which has the values of all other numbers."""
        held = {j: float(theta[j]) for j in range(self.own, len(theta))}
        end = self.laid.minimise(held, theta, self.chunks(excluded), rtol=SINGLE, damping=NEAR)
        costs = np.array(end.point.views.cost) * self._inflation(excluded)
        return Corrected(end.theta, self.drawn(end.theta), costs, excluded, amounts)

    def drawn(self, theta: Vector) -> Fit:
        """Return the fit with the scene, the views and the values of theta."""
        values, fit = values_at(theta, self.laid.problem.unknowns), self.fit
        scene, views = put_back(fit.scene, fit.views, self.laid.problem.unknowns, values)
        return dataclasses.replace(fit, solved=fit.solved.drawn_as(scene, views), values=values[: self.own])

    def chunks(self, excluded: Masks) -> list[Block]:
        """Return the pixels laid out, those that are left out without weight."""
        return self.laid.chunks if all(mask is None for mask in excluded) else self.laid.without(excluded)

    def _inflation(self, excluded: Masks) -> Float[np.ndarray, " views"]:
        """Return for each view all samples over those that are not left out."""
        found = np.ones(len(excluded))
        for view, mask in enumerate(excluded):
            if mask is not None:
                pixels = self.pixel[slice(*self.first[[view, view + 1]])]
                found[view] = 1.0 / max(np.mean(~mask.reshape(-1)[pixels]), 1e-6)
        return found
