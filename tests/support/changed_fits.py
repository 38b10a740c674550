"""Fits of which the scene, the views or another part of the solved problem are other ones, for what is made of fits."""

import dataclasses
from typing import Any

import diffshade as ds


def with_problem(fit: ds.Fit, **parts: Any) -> ds.Fit:
    """Return a fit with some parts of its problem changed."""
    return dataclasses.replace(
        fit, solved=dataclasses.replace(fit.solved, problem=dataclasses.replace(fit.solved.problem, **parts))
    )
