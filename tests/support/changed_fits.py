"""Fits of which the scene, the views or another part of the solved problem are other ones, for what is made of fits."""

import dataclasses
from typing import Any

import diffshade as ds
from diffshade.inverse.data.view_sets import ViewSet


def with_problem(fit: ds.Fit, views: Any = None, clipped: str | None = None, **parts: Any) -> ds.Fit:
    """Return a fit with its views, or some other parts of its problem, changed."""
    problem = fit.solved.problem
    own = ViewSet.of(parts.get("scene", problem.scene), fit.views if views is None else views)
    data = dataclasses.replace(problem.data, views=own.views, lit=own.lit, clipped=clipped or problem.data.clipped)
    problem = dataclasses.replace(problem, data=data, **parts)
    return dataclasses.replace(fit, solved=dataclasses.replace(fit.solved, problem=problem))
