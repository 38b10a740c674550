"""Alternatives: the fit with one more parameter freed (an exposure or a light's place) or a region excluded.

All have the same layout, so that two compiled programs serve them all: one view's exposure and one light's direction or
position are added to the unknowns of the fit, and each is held unless it is freed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...inverse.data.views import lights_on
from ...inverse.laid_out import LaidOut
from ...inverse.result import Fit
from ...inverse.solve.solvers import evaluate
from ...inverse.statistics.uncertainty import inverse
from ...inverse.unknowns.parameters import find_unknowns
from ...inverse.unknowns.slots import put_back
from ...inverse.unknowns.unknown import Unknown, values_at

PIXELS = 1 << 14  # number of pixels, in all views together, on which alternatives are judged
EXPOSURE_WIDTH = 1.0  # prior width of an exposure over its value: fixes the gauge, too wide to affect what is visible
DISTANCE_WIDTH = 0.3  # prior width of a light's position over its distance
RTOL = 1e-6

Key = tuple[str, int]
"""("exposure", view) or ("light", light)."""
Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class State:
    """A minimum with some parameters freed and some pixels excluded."""

    fit: Fit
    """The fit with the scene, the views and the values of this minimum; its other fields are unchanged."""
    costs: Float[np.ndarray, " views"]
    """The cost of each view; an excluded pixel counts with the mean cost of its view."""
    excluded: tuple[Mask | None, ...]
    """The excluded pixels of each view."""
    freed: tuple[Key, ...] = ()
    """What was freed, in this order."""


@dataclass(frozen=True)
class Step:
    """The effect of freeing a parameter, to first order."""

    key: Key
    gain: float
    """The decrease of the cost."""
    effect: float
    """The factor of an exposure, or the tilt of a light in degrees."""


class Alternatives:
    """A fit, and its minima with more parameters freed or pixels excluded. Runs in float64."""

    def __init__(self, fit: Fit, center: Float[np.ndarray, "3"]):
        """Find the minimum on some of the pixels; `center` is the point that the lights illuminate."""
        self.given, self.center = fit, center
        self.lit = [lights_on(fit.scene, view) for view in fit.views]
        own = {path for u in fit.unknowns for path, _ in u.places}
        self.paths = {path: key for path, key in _paths(fit) if path not in own and self.views_of(key)}
        none = State(fit, np.zeros(len(fit.views)), (None,) * len(fit.views))
        self.base = self._minimise(none, None)

    def views_of(self, key: Key) -> tuple[int, ...]:
        """Return the views that an exposure or a light affects."""
        kind, i = key
        return (i,) if kind == "exposure" else tuple(v for v, lit in enumerate(self.lit) if i in lit)

    def free_parameter(self, state: State, key: Key) -> State:
        """Return the minimum with one parameter freed."""
        return self._minimise(state, key)

    def exclude(self, state: State, masks: Mapping[int, Mask]) -> State:
        """Return the minimum with more pixels of some views excluded."""
        excluded = list(state.excluded)
        for view, mask in masks.items():
            excluded[view] = mask if (known := excluded[view]) is None else mask | known
        return self._minimise(dataclasses.replace(state, excluded=tuple(excluded)), None)

    def settle(self, state: State) -> State:
        """Return the minimum over all that was freed, in turn: each was found before later faults were corrected."""
        for key in state.freed * (2 if len(state.freed) > 1 else 0):
            state = self._minimise(state, key)
        return state

    def first_steps(self, state: State) -> list[Step]:
        """Return the effect of freeing each other exposure and light, to first order, the largest gain first.

        The cost is minimised over the unknowns F of the fit (Rao's score test). With S = H_GG - H_GF H_FF^-1 H_FG and
        s = g_G - H_GF H_FF^-1 g_F, the group G steps by -S^-1 s and the cost falls by s S^-1 s / 2.
        """
        laid, groups = self._lay(state, self.paths)
        if not groups:
            return []
        total = evaluate(laid.theta, laid.task, self._chunks(laid, state)).total
        H, g = np.asarray(total.hessian), np.asarray(total.gradient)
        box = laid.problem.box
        inside = (laid.theta > np.asarray(box.lower)) & (laid.theta < np.asarray(box.upper))
        F = np.flatnonzero(inside[: len(state.fit.unknowns)]).tolist()
        from_F = inverse(H[F][:, F])
        steps = []
        for key, group in groups.items():
            if key in state.freed:
                continue
            to_F = H[group][:, F] @ from_F
            S, s = H[group][:, group] - to_F @ H[F][:, group], g[group] - to_F @ g[F]
            step = -inverse(S) @ s
            steps.append(Step(key, float(-0.5 * s @ step), self._effect(state, key, laid.theta[group] + step)))
        return sorted(steps, key=lambda step: -step.gain)

    def effect(self, state: State, key: Key) -> float:
        """Return a view's exposure over the given one, or by how many degrees a light has turned."""
        kind, i = key
        if kind == "exposure":
            return float(state.fit.views[i].exposure) / float(self.given.views[i].exposure)
        return _degrees(self.towards(self.given, i), self.towards(state.fit, i))

    def towards(self, fit: Fit, light: int) -> Float[np.ndarray, "3"]:
        """Return the unit direction from the scene's centre to a light."""
        return self._towards(light, np.asarray(_place(fit, light), np.float64))

    def _towards(self, light: int, place: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        towards = place - self.center if self.given.scene.lights[light].is_local else -place
        return towards / np.linalg.norm(towards)

    def _effect(self, state: State, key: Key, values: np.ndarray) -> float:
        kind, i = key
        if kind == "exposure":
            return float(values[0]) / float(state.fit.views[i].exposure)
        return _degrees(self.towards(state.fit, i), self._towards(i, values))

    def _minimise(self, state: State, key: Key | None) -> State:
        # A view's exposure and one of its lights are always added to the unknowns: all minima share one program.
        view = next(iter(self.views_of(key) if key is not None else ()), 0)
        light = key[1] if key is not None and key[0] == "light" else next(iter(self.lit[view]), -1)
        added = [path for path, k in self.paths.items() if k in (("exposure", view), ("light", light))]
        laid, groups = self._lay(state, added)
        held = {j: laid.theta[j] for k, group in groups.items() if k != key for j in group}
        end = laid.minimise(held, chunks=self._chunks(laid, state), rtol=RTOL)
        values = values_at(end.theta, laid.problem.unknowns)
        scene, views = put_back(state.fit.scene, state.fit.views, laid.problem.unknowns, values)
        p = len(state.fit.unknowns)
        solved = state.fit.solved.changed(theta=end.theta[:p], scene=scene, views=views)
        fit = dataclasses.replace(state.fit, solved=solved, values=values[:p])
        freed = state.freed if key is None or key in state.freed else (*state.freed, key)
        return State(fit, np.array(end.point.views.cost) * _inflation(laid, state), state.excluded, freed)

    def _lay(self, state: State, paths: Iterable[str]) -> tuple[LaidOut, dict[Key, list[int]]]:
        """Lay a state out with these parameters added to its unknowns, and return their indices."""
        fit, paths = state.fit, tuple(paths)
        added = find_unknowns(fit.scene, fit.views, paths, from_scene=True)
        groups: dict[Key, list[int]] = {}
        for j, unknown in enumerate(added):
            path = unknown.places[0][0]
            groups.setdefault(self.paths[path], []).append(len(fit.unknowns) + j)
            unknown.prior = self._prior(unknown, path)
        noise_known = fit.views[0].noise is not None
        # the noise that a prior's width is relative to
        sigma = fit.rmse if fit.likelihood.loss == "squares" and not noise_known else None
        return fit.solved.beside(added, sigma=sigma).laid_out(PIXELS), groups

    def _prior(self, unknown: Unknown, path: str) -> tuple[float, float] | None:
        kind, i = self.paths[path]
        if kind == "exposure":
            return unknown.start, EXPOSURE_WIDTH * unknown.start
        if path.endswith("position"):
            distance = np.linalg.norm(np.asarray(_place(self.given, i)) - self.center)
            return unknown.start, DISTANCE_WIDTH * max(float(distance), 1e-9)
        return None

    def _chunks(self, laid: LaidOut, state: State) -> list:
        return laid.chunks if all(mask is None for mask in state.excluded) else laid.without(state.excluded)


def share(before: State, after: State, views: Iterable[int] | None = None) -> float:
    """Return the fraction of the cost that is explained, in some views or in all."""
    which = slice(None) if views is None else list(views)
    cost = float(before.costs[which].sum())
    return 1.0 - float(after.costs[which].sum()) / cost if cost > 0 else 0.0


def _paths(fit: Fit) -> list[tuple[str, Key]]:
    """Return what can be freed: its path and its key."""
    found: list[tuple[str, Key]] = [(f"views.{i}.exposure", ("exposure", i)) for i in range(len(fit.views))]
    for i, light in enumerate(fit.scene.lights):
        if light.placement:
            found.append((f"lights.{i}.{light.placement[0]}", ("light", i)))
    return found


def _place(fit: Fit, light: int) -> np.ndarray:
    lamp = fit.scene.lights[light]
    return np.asarray(getattr(lamp, lamp.placement[0]))


def _degrees(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def _inflation(laid: LaidOut, state: State) -> np.ndarray:
    """Return for each view all samples over those that are not excluded."""
    everything, excluded = np.zeros(len(state.excluded)), np.zeros(len(state.excluded))
    for part in laid.parts:
        everything[part.view] += len(part.pixels)
        if (mask := state.excluded[part.view]) is not None:
            excluded[part.view] += mask.reshape(-1)[part.pixels].sum()
    return everything / np.maximum(everything - excluded, 1.0)
