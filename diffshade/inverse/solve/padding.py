"""Padding: a task with as many views, lights and unknowns as one of a few sizes has, so that one program serves many.

A padded view, or light, is a copy of the last one that no pixel shows, and nothing depends on a padded unknown.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
from jaxtyping import Int, Shaped

from ...core.fields import Array
from ..forward.interface import AbstractForwardModel
from ..pixels.blocks import few_sizes
from ..unknowns.slots import Setup
from ..unknowns.visibility import Arrow


def padded_count(shown: Int[Array, "views most"] | None, p: int) -> int:
    """Return how many unknowns there are where each padded view has as many of its own as the others have."""
    if shown is None:
        return p
    views, shown = len(shown), np.asarray(shown)
    shared = int((np.bincount(shown[shown < p], minlength=p) == views).sum())
    return shared + -(-(p - shared) * few_sizes(views) // views)


def is_padded(model: AbstractForwardModel, p: int, whole: int) -> bool:
    """Whether a model of p unknowns has other numbers of views, lights or unknowns when it is padded."""
    counts = [len(model.setting.grey), *(len(jax.tree.leaves(of)[0]) for of in model.setting.setup.scene.lights)]
    return whole > p or any(few_sizes(count) > count for count in counts)


def to_few_sizes(tree: Any) -> Any:
    """Return arrays with their last row repeated, up to one of a few numbers of rows."""

    def repeated(leaf: Shaped[np.ndarray, "rows ..."]) -> Shaped[np.ndarray, "more ..."]:
        return np.asarray(leaf)[np.minimum(np.arange(few_sizes(len(leaf))), len(leaf) - 1)]

    return jax.tree.map(repeated, tree)


def moved(tree: Any, p: int, whole: int) -> Any:
    """Return indices of p unknowns as such of `whole`: p, and what is beyond, stands for something else."""
    return jax.tree.map(lambda index: np.where(np.asarray(index) < p, index, index + whole - p), tree)


def padded_model(model: AbstractForwardModel, p: int, whole: int) -> AbstractForwardModel:
    """Return a model of p unknowns as one of `whole`, with padded views and lights."""
    of, slots = model.setting, model.setting.slots
    more = (0, whole - p)
    slots = dataclasses.replace(
        slots,
        indices=moved(_padded_setup(slots.indices), p, whole),
        logarithmic=np.pad(slots.logarithmic, more),
        products=(*moved(to_few_sizes(slots.products[:2]), p, whole), to_few_sizes(slots.products[2])),
        units=to_few_sizes(slots.units),
    )
    by_view = ("projections", "lit", "grey", "half_diagonal", "noise")
    setting = dataclasses.replace(
        of,
        **{name: to_few_sizes(getattr(of, name)) for name in by_view},
        setup=_padded_setup(of.setup),
        slots=slots,
        rounding=dataclasses.replace(of.rounding, **to_few_sizes({"step": of.rounding.step, "srgb": of.rounding.srgb})),
        shown=moved(to_few_sizes(of.shown), p, whole),
        seeds=None if of.seeds is None else (np.pad(of.seeds[0], ((0, 0), more)), to_few_sizes(of.seeds[1])),
    )
    return dataclasses.replace(model, setting=setting)


def padded_arrow(arrow: Arrow | None, p: int, whole: int) -> Arrow | None:
    """Return an arrow with more blocks, which have no unknowns."""
    if arrow is None:
        return None
    more = few_sizes(len(arrow.blocks)) - len(arrow.blocks)
    return Arrow(arrow.border, np.pad(moved(arrow.blocks, p, whole), ((0, more), (0, 0)), constant_values=whole))


def _padded_setup(of: Setup) -> Setup:
    """Return a setup, or indices in the shape of one, of more views and lights."""
    scene = dataclasses.replace(of.scene, lights=to_few_sizes(of.scene.lights))
    return Setup(scene, *to_few_sizes((of.exposure, of.black, of.sensor)))
