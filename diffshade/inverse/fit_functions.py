"""Fit functions: a small fit as a pure JAX function of its images, for `jax.vmap` and `jax.grad`."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from ..core.backend import check_backend, in_float64
from ..core.fields import as_float64
from ..model.scenes import Scene
from .data.view_sets import ViewSet
from .data.views import View
from .fitting import checked, new_problem
from .image_fits import FitFunction
from .pixels.blocks import chunks, rows_and_columns
from .problem import FitProblem
from .solve.start_search import groups_to_try
from .unknowns.constraints import Grey, Proportional
from .unknowns.parameters import find_unknowns
from .unknowns.unknown import by_quantity, coordinates


def fit_function(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Iterable[str],
    tied: Iterable[str] = (),
    bounds: Mapping[str, Sequence[float | int]] | None = None,
    constraints: Sequence[Grey | Proportional] | Grey | Proportional = (),
    priors: Mapping[str, Sequence[Any]] | None = None,
) -> FitFunction:
    """Return a fit as a pure JAX function: `jax.vmap` fits many images at once, `jax.grad` goes through it.

    The cost is a sum of squares; there is no error bar. Use `fit` for one fit of which more is to be known. The
    function computes in the precision of the program that calls it: in float32 the normal equations keep about three
    digits, so call it under `jax.enable_x64`.

    Args:
        scene: What is known; the free values need not be.
        views: The setup, as in `fit`: cameras, masks, and which lights are on. Their images show which pixels count and
            give the shapes; the function is given others. Their noise, if they have it, must be the same at every
            level: residuals then count by it.
        free: Names of what is fitted, as in `fit`.
        tied: Names of what is one unknown, as in `fit`.
        bounds: Ranges by name, as in `fit`.
        constraints: `Grey` and `Proportional`, as in `fit`.
        priors: Means and standard deviations by name, as in `fit`. They need the views' noise, which says how much they
            count beside the photographs.

    Returns:
        The function f: `f(image, image, ...)`, an argument for each view, returns `FittedValues`: `values` and
        `determined` by name, `cost` and `converged`. `jax.vmap(f)` takes a batch for each argument. `f(image,
        scene=scene, cameras=cameras)` has other known numbers, by which `values` have derivatives, too.

    Raises:
        ValueError: As `fit` raises it; or there are priors without noise; or a view has a sensor, clipped samples or
            noise that grows with the signal, which this function does not know.
        TypeError: As `fit` raises it.
    """
    views, constraints = checked(scene, views, constraints)
    check_backend()
    with in_float64((jax.tree.map(as_float64, scene), views)) as (scene, views):
        data = ViewSet.of(scene, views)
        unknowns = find_unknowns(scene, data.views, free, tied, bounds, constraints, priors, grey=bool(data.grey))
        problem = new_problem(scene, data, unknowns, "squares", "hinge")
        for i, view in enumerate(views):
            if view.sensor is not None:
                raise ValueError(
                    f"a fit function takes linear images; views[{i}] has a sensor. Leave it out and give linear "
                    "images, or use fit."
                )
            if view.noise is not None and not view.noise.is_uniform:
                raise ValueError(
                    f"a fit function knows noise that is the same at every level; that of views[{i}] grows with the "
                    "signal. Give one standard deviation, or use fit."
                )
        if priors and not problem.data.noise_known:
            raise ValueError(
                "priors count beside photographs by their noise, which the views do not have. Give View.noise, or use "
                "fit, which finds it."
            )
        clipped = problem.data.counts.clipped
        if clipped:
            raise ValueError(
                f"a fit function knows no clipped samples; {clipped} of the views' samples are. Mask them "
                "out, or use fit."
            )
        shapes = tuple(np.shape(view.image) for view in views)
        numbered = _numbered(problem, shapes)
        size = numbered.size_for(None)
        parts = numbered.pieces(None, size)
        laid = numbered.lay_out(parts, size), [rows_and_columns(of, size) for of in chunks(parts)]
        chunk, places = (jax.tree.map(lambda *of: np.concatenate(of), *each) for each in laid)
        told = coordinates(np.array([unknown.start for unknown in unknowns]), unknowns)
        made = FitFunction(
            names=tuple(unknown.name for unknown in unknowns),
            quantities=tuple((name, tuple(at)) for name, at in by_quantity(unknowns).items()),
            shapes=tuple(shape[:2] if shape[2] == 1 else shape for shape in shapes),
            scene=scene,
            cameras=tuple(view.camera for view in views),
            bases=tuple(None if unknown.places else x.base for unknown in unknowns for x in unknown.products),
            model=problem.model,
            priors=problem.priors(1.0),
            box=problem.box,
            chunk=chunk,
            index=chunk.observed.target.astype(int) - 1,
            start=np.clip(np.where(problem.box.linear, 0.0, told), problem.box.lower, problem.box.upper),
            groups=tuple((np.array(of.members), of.values) for of in groups_to_try(unknowns, scene)),
            places=places,
        )
        return jax.tree.map(np.asarray, made)


def _numbered(problem: FitProblem, shapes: Sequence[tuple[int, ...]]) -> FitProblem:
    """Return the problem with samples that are their own places in the images, one after another, from 1."""
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    places = [1.0 + np.arange(*of).reshape(shape) for of, shape in zip(itertools.pairwise(ends), shapes, strict=True)]
    samples = tuple(
        dataclasses.replace(of_view, photograph=place[..., : of_view.photograph.shape[2]])
        for of_view, place in zip(problem.data.samples, places, strict=True)
    )
    return dataclasses.replace(problem, data=dataclasses.replace(problem.data, samples=samples))
