"""Image fits: the minimum of a fit as an implicit, pure function of its images, and what these determine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..core import fields
from ..model.cameras import AbstractCamera
from ..model.scenes import Scene, stack_scene
from .forward.gram import Point
from .forward.interface import AbstractForwardModel, Pixels
from .pixels.blocks import Block
from .solve.solvers import BoxConstraints, PriorResiduals, minimum_in_jax, point_of
from .solve.start_search import best_linear
from .unknowns.places import Place
from .unknowns.slots import apart
from .unknowns.unknown import natural

TOGETHER = 16  # fits of a batch that take their steps together: their pixels stay in a core's cache

Samples = Float[Array, "blocks channels pixels"]


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
    model: AbstractForwardModel
    """Of which all samples of a view weigh alike."""
    priors: PriorResiduals
    box: BoxConstraints
    chunk: Block
    index: Int[fields.Array, "blocks channels pixels"]
    """Where each sample is in the images, one after another; -1 for padding."""
    start: Float[fields.Array, " p"]
    groups: tuple[tuple[Int[fields.Array, " m"], Float[fields.Array, "n m"]], ...]
    """For each group of unknowns that a search tries together: which they are, and the values that it tries."""
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
        theta, (converged, gram) = of._minimum(targets)
        values = natural(theta, of.model.setting.slots.logarithmic)
        determined = of._determined(theta, gram, targets)
        by_name = [
            {name: each[at[0]] if len(at) == 1 else each[jnp.array(at)] for name, at in self.quantities}
            for each in (values, determined)
        ]
        return FittedValues(by_name[0], of._cost(theta, targets), converged > 0.0, by_name[1])

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
        return of._residuals(theta, of._targets(images)).ravel()

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
        products = zip(of.model.setting.slots.products[2], of.bases, strict=True)
        constants = [known if base is None else base.whole.value_in(rest, ())[base.channel] for known, base in products]
        model = eqx.tree_at(
            lambda m: (m.setting.setup.scene, m.setting.projections, m.setting.slots.products[2]),
            of.model,
            (stack_scene(rest), jax.tree.map(lambda *each: jnp.stack(each), *projections), jnp.array(constants)),
        )
        there = tuple(of_pixel.astype(int) for of_pixel in of.places)
        pixels = Pixels(*of.places, jax.tree.map(lambda leaf: leaf[there], over_pixels))
        points = model.points(pixels, of.chunk.view, jnp.any(of.index >= 0, 1))
        return eqx.tree_at(lambda f: (f.model, f.chunk.points), of, (model, points))

    def _targets(self, images: Sequence[ArrayLike]) -> Samples:
        """Return the samples of the images in blocks; 0 for padding."""
        shapes = tuple(jnp.shape(image) for image in images)
        if tuple(shape[:2] if shape[2:] == (1,) else shape for shape in shapes) != self.shapes:
            raise ValueError(
                f"this fit function needs images of shapes {self.shapes}; got {shapes}. Give one for each view, or "
                "jax.vmap over the axis of the batch."
            )
        samples = jnp.concatenate([jnp.ravel(jnp.asarray(image, float)) for image in images])
        return jnp.where(self.index >= 0, samples[self.index], 0.0)

    def _residuals(self, theta: Float[Array, " p"], targets: Samples) -> Samples:
        """Return prediction - image over the standard deviation of the noise."""
        predicted = jax.lax.map(lambda block: jnp.stack(self.model.predict(theta, block)), self.chunk)
        return self._whitened(predicted - targets)

    def _cost(self, theta: Float[Array, " p"], targets: Samples) -> Float[Array, ""]:
        """Return half the sum of squares of the residuals."""
        return 0.5 * jnp.sum(self._residuals(theta, targets) ** 2) + self.priors.gram(theta).cost

    def _minimum(self, targets: Samples) -> tuple[Array, tuple[Array, Array]]:
        """Return the minimum, 1 where the solver converged, and J^T J there; with the derivatives of an implicit root.

        The root is that of the gradient, by the unknowns that are not at a bound.
        """

        def gradient(theta: Array) -> Array:
            inside = (theta > self.box.lower) & (theta < self.box.upper)
            cost = jax.grad(lambda q: self._cost(jnp.where(inside, q, jax.lax.stop_gradient(theta)), targets))
            return cost(theta)

        def solved(*_: Any) -> tuple[Array, tuple[Array, Array]]:
            found, converged = _searched(self, targets)
            as_number = jnp.where(converged, 1.0, 0.0)  # whose derivative custom_root makes a zero of its own kind
            return jnp.asarray(found.theta), (as_number, found.total.hessian.as_matrix())

        return jax.lax.custom_root(gradient, jnp.asarray(self.start), solved, _inverse_of, has_aux=True)

    def _search(self, targets: Samples) -> tuple[Point, Array]:
        """Return the minimum and whether the solver converged, from the best of the points that are tried."""
        chunk = eqx.tree_at(lambda c: c.observed.target, self.chunk, targets)
        theta, projects = jnp.asarray(self.start), self.model.projects

        def evaluate(theta: Array) -> Point:
            return point_of(theta, self.model, self.priors, self.box, self.model.summary(theta, chunk))

        def judged(theta: Array) -> tuple[Any, Any]:
            point = evaluate(theta)
            return (point.theta, point.total.cost) if projects else best_linear(point, self.box)

        for members, values in self.groups * min(len(self.groups), 2):
            tried = jax.vmap(theta.at[members].set)(values)
            found, costs = jax.lax.map(lambda at: judged(jnp.clip(at, self.box.lower, self.box.upper)), tried)
            theta = found[jnp.argmin(jnp.where(jnp.isfinite(costs), costs, jnp.inf))]
        return minimum_in_jax(theta, evaluate, self.box, self._squares(targets), projects=projects)

    def _determined(self, theta: Float[Array, " p"], gram: Float[Array, "p p"], targets: Samples) -> Bool[Array, " p"]:
        """Return which unknowns change the prediction by more than rounding, in no direction that changes none.

        Of an unknown that the prediction is linear in, any change will do; another one changes by 1 (of an exponent its
        logarithm) or by its value. Normal equations keep half of the digits.
        """
        half_the_digits = float(jnp.finfo(gram.dtype).eps) ** 0.5
        effect = jnp.sqrt(jnp.diagonal(gram)) * jnp.maximum(1.0, jnp.abs(theta))
        rounding = half_the_digits * jnp.sqrt(self._squares(targets))
        shown = effect > jnp.where(self.box.linear, 0.0, rounding)
        scale = jnp.where(shown, jax.lax.rsqrt(jnp.where(shown, jnp.diagonal(gram), 1.0)), 0.0)
        scaled = gram * jnp.outer(scale, scale) + jnp.diag(jnp.where(shown, 0.0, 1.0))
        size, direction = jnp.linalg.eigh(scaled)
        idle = jnp.where(size < len(gram) * jnp.finfo(gram.dtype).eps, direction, 0.0)
        return shown & jnp.all(jnp.abs(idle) < half_the_digits, -1)

    def _whitened(self, samples: Samples) -> Samples:
        """Return samples over the standard deviation of their view's noise; 0 where none counts."""
        weights = jax.lax.stop_gradient(jax.lax.map(self.model.sample_weights, self.chunk))
        counts = (self.index >= 0) & (weights > 0.0)
        return jnp.where(counts, jnp.sqrt(jnp.where(counts, weights, 1.0)) * samples, 0.0)

    def _squares(self, targets: Samples) -> Float[Array, ""]:
        """Return the sum of squares of the images, with which rounding is compared."""
        return jnp.sum(self._whitened(targets) ** 2)


@jax.custom_batching.custom_vmap
def _searched(fit: FitFunction, targets: Array) -> tuple[Point, Array]:
    return fit._search(targets)


@_searched.def_vmap
def _(size: int, batched: list, fit: FitFunction, targets: Array) -> tuple:
    """Search for a few at once: none of the others then waits for the slowest of all."""
    each, shared = eqx.partition((fit, targets), tuple(batched))

    def search(one: tuple) -> tuple[Point, Array]:
        fit, targets = eqx.combine(one, shared)
        return fit._search(targets)

    found = jax.lax.map(search, each, batch_size=min(size, TOGETHER))
    return found, jax.tree.map(lambda _: True, found)


def _inverse_of(hessian: Callable[[Array], Array], slope: Float[Array, " p"]) -> Float[Array, " p"]:
    """Return H^-1 slope, with 0 for unknowns and along directions that change nothing, given the product by H."""
    H = jax.vmap(hessian)(jnp.eye(len(slope), dtype=slope.dtype))
    D = jnp.diagonal(H)
    seen = jnp.finfo(H.dtype).eps * jnp.max(D) < D
    scale = jnp.where(seen, jax.lax.rsqrt(jnp.where(seen, D, 1.0)), 0.0)
    return scale * (jnp.linalg.pinv(H * jnp.outer(scale, scale), hermitian=True) @ (scale * slope))
