"""Fit functions: a small fit as a pure JAX function of its images, for `jax.vmap` and `jax.grad`."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ..core import fields
from ..core.backend import check_backend, in_float64
from ..core.fields import as_float64
from ..model.cameras import AbstractCamera
from ..model.scenes import Scene, stack_scene
from .data.view_sets import ViewSet
from .data.views import View
from .fitting import check_choices, check_free, new_problem
from .forward.interface import Pixels
from .image_fits import ImageFit, Samples
from .pixels.blocks import chunks, rows_and_columns
from .problem import FitProblem
from .solve.start_search import groups_to_try
from .unknowns.constraints import Grey, Proportional
from .unknowns.parameters import find_unknowns
from .unknowns.places import Place
from .unknowns.slots import apart
from .unknowns.unknown import Unknown, coordinates, natural


class FittedValues(eqx.Module):
    """What a fit function returns; under `jax.vmap` every array has the batch's axis first."""

    values: dict[str, Float[Array, "..."]]
    """The unknowns by name, in their own units: `k_d` of colour photographs is an array of 3, in the order of the
    channels."""
    cost: Float[Array, "..."]
    """Half the sum of squares of the residuals: each over its standard deviation where the views have noise."""
    converged: Bool[Array, "..."]
    """Whether the solver ended because no step within the bounds lowers the cost by more than rounding does."""
    determined: dict[str, Bool[Array, "..."]]
    """Whether the images determine an unknown, by name and of the shape of its values. They do not if the prediction is
    the same at its other values, such as those of n_s where k_s is 0, or at other values of several unknowns together.
    The value is then one of many that cost the same."""


class FitFunction(eqx.Module):
    """A fit of one setup as a pure JAX function of its images, and of what is known; `fit_function` makes it.

    `function(*images)` takes one image for each view and returns `FittedValues`; `function.residuals(theta, *images)`
    are the residuals at the unknowns, in the order of `names`. Both take another scene and other cameras, by which the
    values have derivatives.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    """The unknowns: `k_d.r`, and so on."""
    quantities: tuple[tuple[str, tuple[int, ...]], ...] = eqx.field(static=True)
    """Each name of the values, `k_d`, with the places of its unknowns; one place for a number without channels."""
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """The shape of each view's image."""
    scene: Scene
    """The scene and, next, the camera of each view that a call has by default."""
    cameras: tuple[AbstractCamera, ...]
    bases: tuple[Place | None, ...] = eqx.field(static=True)
    """The known number that each `Proportional` multiplies by its unknown factor; None where it multiplies none."""
    fit: ImageFit
    places: tuple[Float[fields.Array, "blocks pixels"], Float[fields.Array, "blocks pixels"]]
    """The row and the column of each pixel; 0 for padding."""

    __hash__ = object.__hash__  # jax.jit looks the program of a function up by it; arrays have none
    __eq__ = object.__eq__

    def __call__(
        self,
        *images: Float[ArrayLike, "..."],
        scene: Scene | None = None,
        cameras: Sequence[AbstractCamera] | AbstractCamera | None = None,
    ) -> FittedValues:
        """Fit the images.

        The start is the best of the points that the search of `fit` tries, each at its best linear unknowns; the steps
        are those of `fit`. The derivatives by the images, the scene and the cameras are those of the minimum (implicit
        function theorem): with C the cost and y any of these numbers, d theta = -(d2C/dtheta2)^-1 d2C/dtheta dy dy.
        They are 0 for an unknown at a bound, for one that changes no prediction, and along a direction that changes
        none.

        Args:
            images: The image of each view, of the shape of the one given to `fit_function`.
            scene: A scene with other known numbers, such as a light's position; all else is as it was given to
                `fit_function`, which is the default. Its values of the unknowns count for nothing.
            cameras: The camera of each view, or the one camera, likewise. Whatever the cameras, the pixels that count
                stay those that counted for `fit_function`, and derivatives are of the fit to these. Where a surface is
                seen from its edge they grow without bound: mask out the outermost pixels.

        Returns:
            The values, the cost, whether the solver converged, and which values the images determine.

        Raises:
            ValueError: An image has another shape, or the scene or the cameras differ by more than their numbers.
        """
        return self._fitted(tuple(jnp.asarray(image, float) for image in images), scene, cameras)

    @jax.jit  # compiled once, also for a caller who compiles nothing
    def _fitted(self, images: Sequence[Array], scene: Scene | None, cameras: Any) -> FittedValues:
        of = self._with(scene, cameras)
        targets = of._targets(images)
        theta, (converged, gram) = of.fit.minimum(targets)
        values = natural(theta, of.fit.model.setting.slots.logarithmic)
        determined = of.fit.determined(theta, gram, targets)
        by_name = [
            {name: each[at[0]] if len(at) == 1 else each[jnp.array(at)] for name, at in self.quantities}
            for each in (values, determined)
        ]
        return FittedValues(by_name[0], of.fit.cost(theta, targets), converged > 0.0, by_name[1])

    def residuals(
        self,
        theta: Float[Array, " p"],
        *images: Float[ArrayLike, "..."],
        scene: Scene | None = None,
        cameras: Sequence[AbstractCamera] | AbstractCamera | None = None,
    ) -> Float[Array, " samples"]:
        """Return prediction - image, over its standard deviation where the views have noise; 0 for padding.

        Args:
            theta: The unknowns, in the order of `names`; exponents as their logarithms.
            images: The image of each view.
            scene: As a fit takes it.
            cameras: As a fit takes them.

        Returns:
            The residuals.

        Raises:
            ValueError: An image has another shape, or the scene or the cameras differ by more than their numbers.
        """
        of = self._with(scene, cameras)
        return of.fit.residuals(theta, of._targets(images)).ravel()

    def _with(self, scene: Scene | None, cameras: Sequence[AbstractCamera] | AbstractCamera | None) -> FitFunction:
        """Return the function with other known numbers, and arrays of the precision of the program that calls it."""
        of: FitFunction = jax.tree.map(jnp.asarray, self)
        if scene is None and cameras is None:
            return of
        cameras = (cameras,) if isinstance(cameras, AbstractCamera) else cameras
        given = self.scene if scene is None else scene, self.cameras if cameras is None else tuple(cameras)
        for name, new, own in zip(("scene", "cameras"), given, (self.scene, self.cameras), strict=True):
            if not eqx.tree_equal(jax.tree.map(np.shape, new), jax.tree.map(np.shape, own)):
                raise ValueError(
                    f"{name} may differ from what fit_function was given by the values of numbers alone; got other "
                    "parts or shapes. Make another fit function of it."
                )
        over_pixels, rest = apart(jax.tree.map(jnp.asarray, given[0]))
        projections = [camera.projection() for camera in jax.tree.map(jnp.asarray, given[1])]
        products = zip(of.fit.model.setting.slots.products[2], of.bases, strict=True)
        constants = [known if base is None else base.whole.value_in(rest, ())[base.channel] for known, base in products]
        model = eqx.tree_at(
            lambda m: (m.setting.setup.scene, m.setting.projections, m.setting.slots.products[2]),
            of.fit.model,
            (stack_scene(rest), jax.tree.map(lambda *each: jnp.stack(each), *projections), jnp.array(constants)),
        )
        there = tuple(of_pixel.astype(int) for of_pixel in of.places)
        pixels = Pixels(*of.places, jax.tree.map(lambda leaf: leaf[there], over_pixels))
        points = model.points(pixels, of.fit.chunk.view, jnp.any(of.fit.index >= 0, 1))
        return eqx.tree_at(lambda f: (f.fit.model, f.fit.chunk.points), of, (model, points))

    def _targets(self, images: Sequence[ArrayLike]) -> Samples:
        """Return the samples of the images in blocks."""
        shapes = tuple(jnp.shape(image) for image in images)
        if tuple(shape[:2] if shape[2:] == (1,) else shape for shape in shapes) != self.shapes:
            raise ValueError(
                f"this fit function needs images of shapes {self.shapes}; got {shapes}. Give one for each view, or "
                "jax.vmap over the axis of the batch."
            )
        return self.fit.targets(jnp.concatenate([jnp.ravel(jnp.asarray(image, float)) for image in images]))


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
    views = (views,) if isinstance(views, View) else tuple(views)
    constraints = (constraints,) if isinstance(constraints, Grey | Proportional) else tuple(constraints)
    check_choices(scene, views, constraints, "squares", "hinge", "search")
    check_backend()
    with in_float64((jax.tree.map(as_float64, scene), views)) as (scene, views):
        data = ViewSet.of(scene, views)
        unknowns = find_unknowns(scene, data.views, free, tied, bounds, constraints, priors, grey=bool(data.grey))
        check_free(unknowns)
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
        image_fit = ImageFit(
            problem.model,
            problem.priors(1.0),
            problem.box,
            chunk,
            chunk.observed.target.astype(int) - 1,
            np.clip(np.where(problem.box.linear, 0.0, told), problem.box.lower, problem.box.upper),
            tuple((np.array(of.members), of.values) for of in groups_to_try(unknowns, scene)),
        )
        made = FitFunction(
            tuple(unknown.name for unknown in unknowns),
            _quantities(unknowns),
            tuple(shape[:2] if shape[2] == 1 else shape for shape in shapes),
            scene,
            tuple(view.camera for view in views),
            tuple(None if unknown.places else x.base for unknown in unknowns for x in unknown.products),
            image_fit,
            places,
        )
        return jax.tree.map(np.asarray, made)


def _quantities(unknowns: Sequence[Unknown]) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """Return the names without channels, each with the places of its unknowns, in the order of the channels."""
    found: dict[str, list[int]] = {}
    for i, unknown in enumerate(unknowns):
        found.setdefault(unknown.quantity, []).append(i)
    return tuple((name, tuple(at)) for name, at in found.items())


def _numbered(problem: FitProblem, shapes: Sequence[tuple[int, ...]]) -> FitProblem:
    """Return the problem with samples that are their own places in the images, one after another, from 1."""
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
    places = [1.0 + np.arange(*of).reshape(shape) for of, shape in zip(itertools.pairwise(ends), shapes, strict=True)]
    samples = tuple(
        dataclasses.replace(of_view, photograph=place[..., : of_view.photograph.shape[2]])
        for of_view, place in zip(problem.data.samples, places, strict=True)
    )
    return dataclasses.replace(problem, data=dataclasses.replace(problem.data, samples=samples))
