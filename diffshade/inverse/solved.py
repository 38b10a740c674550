"""Solved: a problem and where it was solved, from which verdicts, diagnoses and refits go on."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ..model.scenes import Scene
from .data.view_sets import Masks
from .data.views import View
from .laid_out import LaidOut, lay_out
from .problem import FitProblem, Theta, fit_problem
from .unknowns.slots import put_back
from .unknowns.unknown import Unknown, coordinates


@dataclass(frozen=True, eq=False)
class Solved:
    """A problem and where it was solved. Every array is NumPy; nothing is laid out."""

    problem: FitProblem
    """With the values in its scene and views, the scale that was settled and the steps of files that add to errors."""
    theta: Theta
    """The values, in the solver's coordinates."""
    squares: float
    """The weighted sum of squares of the samples, with which residuals are compared."""

    @classmethod
    def of(cls, problem: FitProblem, values: Float[np.ndarray, " p"], squares: float) -> Solved:
        """Return a problem that was solved at these values, with NumPy's arrays in place of JAX's."""
        scene, views = put_back(problem.scene, problem.data.views, problem.unknowns, values)
        arrays = {name: jax.tree.map(np.asarray, getattr(problem, name)) for name in ("model", "box")}
        data = dataclasses.replace(problem.data, views=tuple(views))
        solved = dataclasses.replace(problem, scene=scene, data=data, **arrays)
        return cls(solved, coordinates(values, problem.unknowns), squares)

    def changed(self, *, theta: Theta | None = None, **parts: Any) -> Solved:
        """Return the problem with some of its parts changed, at the same scale and steps, to be solved again.

        Args:
            theta: Where to begin, by default where the problem was solved.
            parts: Arguments of `fit_problem` that change.
        """
        old = self.problem
        same = ("scene", "data", "unknowns", "loss")
        new = fit_problem(**{name: getattr(old, name) for name in same} | parts)
        likelihood = old.model.likelihood
        new = new.with_scale(float(likelihood.sigma), likelihood.loss).with_rounding(old.model.setting.rounding)
        return Solved(new, self.theta if theta is None else theta, self.squares)

    def beside(self, more: Sequence[Unknown]) -> Solved:
        """Return the problem with more unknowns after its own, by the model that serves any scene."""
        unknowns = (*self.problem.unknowns, *more)
        theta = np.append(self.theta, coordinates(np.array([u.start for u in more]), more))
        return self.changed(theta=theta, unknowns=unknowns, rendered=True)

    def keeping(self, masks: Masks) -> Solved:
        """Return the problem with the pixels that masks keep."""
        return self.changed(data=self.problem.data.keeping(masks))

    def drawn_as(self, scene: Scene, views: Sequence[View]) -> Solved:
        """Return the problem with another scene and other views in pictures of it; what is minimised stays."""
        data = dataclasses.replace(self.problem.data, views=tuple(views))
        return dataclasses.replace(self, problem=dataclasses.replace(self.problem, scene=scene, data=data))

    def laid_out(self, at_most: int | None = None) -> LaidOut:
        """Return the problem with its pixels laid out, or so many at most, weighed where it was solved."""
        return lay_out(self.problem, self.theta, self.squares, at_most)
