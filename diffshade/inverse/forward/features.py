"""Features: the predictions of one material as sums of a few fields, so that a pass over the pixels is one small Gram.

A pixel of one object shows m = c_1 + sum over its lights of c_u u + c_v v, with u = f_rad f_ang (n.l)_+ and
v = f_rad f_ang (cos)_+^n_s (E2-E6). The coefficients c are products of k_a, k_d, k_s, intensities, exposure and black,
and do not depend on the pixel. With the derivatives of u and v beside them, by n_s, by the attenuation and by where the
lights are, F = [1, u, v, ..., dv/dlog n_s, du/da, dv/da, du/dq, dv/dq, ...], every product that a Gauss-Newton step
needs is a sum of F F^T, F y and y^2, and none of these depends on the coefficients: one pass gives J^T J at any k_a,
k_d, k_s at once. Where the lights are known, n.l, log cos, d and f_ang are computed once for a fit; where they move,
the points are. That is variable projection (Golub and Pereyra 1973, in Kaufman's form of 1975):
`solve.solvers.point_of` solves for the linear unknowns exactly, where all samples have one weight (squares, no clipped
sample, noise that is the same at every level).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...core.fields import Array
from ...model.fresnel import NoFresnel
from ...model.lights import AbstractLight
from ...model.lobes import EXPONENT_RANGE, AbstractPowerLobe
from ...model.scenes import Scene, light_kinds
from ...model.vectors import Vec3, dot, normalize, tangents_of
from ..data.views import View, lights_on
from ..pixels.blocks import Block
from ..unknowns.unknown import Unknown
from .gram import ByView
from .interface import AbstractForwardModel, Pixels, Setting
from .lighting import (
    Fields,
    Lit,
    Seen,
    faded,
    fields_at,
    fields_of_chunk,
    intensities_of,
    lit_by,
    points_seen,
    seen_by_chunk,
    shaded,
)
from .losses import Likelihood
from .rendered import costs

MOST_LIGHTS = 4  # on in one view; with more, the model that renders is no slower
PLACES = ("position", "direction")  # of a light; three unknowns each
EXPONENT = ("objects", "material", "n_s")
SERVED = {
    *(("objects", "material", name) for name in ("k_a", "k_d", "k_s", "k_e", "n_s")),
    *(("lights", name) for name in ("intensity", *PLACES)),
    *(("views", name) for name in ("exposure", "black")),
    ("scene", "ambient"),
}


class FeatureModel(AbstractForwardModel):
    """The predictions of one object's material, as sums of features."""

    with_exponent: bool = eqx.field(static=True)
    """Whether n_s is unknown."""
    fading: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    """For each kind of light, which numbers of its attenuation are unknown."""
    placed: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    """For each kind of light, which of `PLACES` a fit moves."""
    shared: bool = eqx.field(static=True)
    """Whether all samples weigh the same, so that one Gram of the features serves all channels and coefficients."""
    grey: bool | None = eqx.field(static=True)
    """Whether the views are grey; None if some are and some are not."""

    @property
    def projects(self) -> bool:
        """Whether one pass gives the Gram at any linear unknowns: where the Gram of the features is shared."""
        return self.shared

    def seen(self, pixels: Pixels, view: Any, counts: Any) -> Seen:
        """Return the points that a chunk's pixels show."""
        return seen_by_chunk(self.setting, pixels, view, counts)

    def lit(self, seen: Seen, view: Any) -> Fields | Seen:
        """Return the fields of a chunk's points; the points themselves where a light moves."""
        return seen if any(self.placed) else fields_of_chunk(self.setting, seen, view)

    def points(self, pixels: Pixels, view: Any, counts: Any) -> Fields | Seen:
        """Return `lit` of `seen` as a part of another program, with derivatives by the scene and the cameras."""
        seen = points_seen(self.setting, pixels, view, counts)
        return seen if any(self.placed) else fields_at(self.setting, seen, view)

    def rows(self, scene: Any, view: Array, points: Fields | Seen) -> list[Any]:
        """Return F of a block: 1, then u and v of each light, then their derivatives for each light."""
        n_s, lobe = scene.objects[0].material.n_s, scene.objects[0].material.lobe
        predicting, slopes = [jnp.where(points.counts, 1.0, 0.0)], []
        for light, (kind, k) in enumerate(self._slots()):
            index = self.setting.lit[kind][0][view, k]
            lamp = jax.tree.map(lambda leaf, i=index: leaf[i], scene.lights[kind])
            if isinstance(points, Fields):
                lit, moves = points.of(light), []
            else:
                lit, moves = self._moved(lamp, self.placed[kind], lobe, points, n_s)
            u, v = shaded(lit, n_s)
            f, fades = faded(lamp, self.fading[kind], lit.distance)
            predicting += [f * u, f * v]
            if self.with_exponent:
                slopes.append(n_s * lit.log_cosine * (f * v))
            slopes += [fade * of for fade in fades for of in (u, v)] + moves
        return predicting + slopes

    def _slots(self) -> list[tuple[int, int]]:
        """Return for each light of a view its kind, and its place among those of its kind."""
        return [(kind, k) for kind, (index, _) in enumerate(self.setting.lit) for k in range(index.shape[1])]

    @staticmethod
    def _moved(lamp: Any, names: tuple[str, ...], lobe: Any, seen: Seen, n_s: Array) -> tuple[Lit, list[Any]]:
        """Return the fields of a light that moves, and the derivatives of u and v by where it is."""

        def features(places: tuple) -> tuple[tuple, Lit]:
            moved = lamp
            for name, place in zip(names, places, strict=True):
                moved = eqx.tree_at(lambda m, name=name: getattr(m, name), moved, place)
            lit = lit_by(moved, lobe, seen)
            f, _ = faded(lamp, (), lit.distance)
            u, v = shaded(lit, n_s)
            return (f * u, f * v), lit

        places = tuple(getattr(lamp, name) for name in names)
        if not places:
            return lit_by(lamp, lobe, seen), []
        _, derivative, lit = jax.linearize(features, places, has_aux=True)
        slopes = []
        for i, (name, place) in enumerate(zip(names, places, strict=True)):
            for axis in axes_of(name, Vec3.of(place)):
                moves = [jnp.stack([axis.x, axis.y, axis.z]) if k == i else jnp.zeros(3) for k in range(len(names))]
                slopes += derivative(tuple(moves))
        return lit, slopes

    def coefficients(self, theta: Float[Array, " p"]) -> tuple[Array, Array]:
        """Return the coefficients of F in each view and channel: of the prediction, and a function with its Jacobian.

        In the second, the derivative of u or v by an unknown has the coefficient of u or v, held constant, times that
        unknown. Its derivatives by theta are the columns of the prediction's Jacobian.
        """
        setting = self.setting
        setup = setting.slots.insert(theta, setting.setup)
        scene, intensity = setup.scene, intensities_of(setup.scene, setting.lit)
        material = scene.objects[0].material
        exposure = setup.exposure[:, None]
        constant = exposure * (material.k_e + material.k_a * scene.ambient)[None] + setup.black[:, None]  # (views, c)
        held = jax.lax.stop_gradient
        predicted, slopes = [constant], []
        for light, (kind, k) in enumerate(self._slots()):
            sent = exposure * intensity[:, light]
            c_u, c_v = sent * material.k_d[None], sent * material.k_s[None]
            predicted += [c_u, c_v]
            if self.with_exponent:
                slopes.append(held(c_v) * jnp.log(material.n_s))
            stack: Any = scene.lights[kind]
            index = setting.lit[kind][0][:, k]
            moving = [getattr(stack.attenuation, name)[index] for name in self.fading[kind]]
            for name in self.placed[kind]:
                place = Vec3.of(getattr(stack, name)[index])
                moving += [dot(place, axis) for axis in axes_of(name, place)]
            slopes += [held(c) * of[:, None] for of in moving for c in (c_u, c_v)]
        none = [jnp.zeros_like(constant)] * len(slopes)
        return self._channels(predicted + none), self._channels(predicted + slopes)

    def _channels(self, coefficients: Sequence[Array]) -> Array:
        """Stack coefficients (views, c) as (views, c, features); a grey view has their mean, in channel 0."""
        stacked = jnp.stack(coefficients, -1)
        if self.grey is False:
            return stacked
        mean = stacked.mean(1, keepdims=True)
        if self.grey:
            return mean
        first = jnp.where(jnp.arange(stacked.shape[1])[None, :, None] == 0, mean, 0.0)
        return jnp.where(self.setting.grey[:, None, None] > 0, first, stacked)

    def predict(self, theta: Float[Array, " p"], block: Block) -> tuple[Float[Array, " pixels"], ...]:
        """Return the predictions of a block, one array a channel."""
        predicted, _ = self.coefficients(theta)
        scene = self.setting.slots.insert(theta, self.setting.setup).scene
        rows = self.rows(scene, block.view, block.points)
        return self._predict(predicted[block.view], rows)

    def _predict(self, coefficients: Array, rows: Sequence[Any]) -> tuple[Any, ...]:
        used = range(1, 1 + 2 * len(self._slots()))
        return tuple(sum((channel[r] * rows[r] for r in used), channel[0] * rows[0]) for channel in coefficients)

    def summary(self, theta: Float[Array, " p"], chunk: Block) -> Any:
        """Return for each view, over the blocks of a chunk, the Gram of [F, y].

        If the samples' weights differ, return instead the cost and, for each channel, F l' and F h F^T with the slopes
        l' and the curvatures h of the loss.
        """
        setting = self.setting
        scene = setting.slots.insert(theta, setting.setup).scene
        predicted, _ = self.coefficients(theta)
        views, channels, features = predicted.shape

        def shared(total: Any, block: Block) -> tuple[Any, None]:
            F = jnp.stack([*self.rows(scene, block.view, block.points), *block.observed.target])
            return total.at[block.view].add(jnp.matmul(F, F.T, precision="highest")), None

        def weighted(total: tuple, block: Block) -> tuple[tuple, None]:
            rows = self.rows(scene, block.view, block.points)
            F = jnp.stack(rows)
            terms = costs(self.likelihood, self._predict(predicted[block.view], rows), block.observed)
            of_block = (
                sum(t.cost.sum() for t in terms),
                jnp.stack([jnp.matmul(F, t.slope, precision="highest") for t in terms]),
                jnp.stack([jnp.matmul(F * t.curvature[None], F.T, precision="highest") for t in terms]),
            )
            return jax.tree.map(lambda t, b: t.at[block.view].add(b), total, of_block), None

        if self.shared:
            size = features + channels
            return jax.lax.scan(shared, jnp.zeros((views, size, size)), chunk)[0]
        zero = (
            jnp.zeros(views),
            jnp.zeros((views, channels, features)),
            jnp.zeros((views, channels, features, features)),
        )
        return jax.lax.scan(weighted, zero, chunk)[0]

    def _slopes(self, theta: Float[Array, " p"]) -> Float[Array, "views channels features m"]:
        """Return the derivatives of the coefficients of each view by the unknowns that it can show."""

        def moving(q: Array) -> Array:
            return self.coefficients(q)[1]

        if self.setting.shown is None or self.setting.seeds is None:
            return jax.jacfwd(moving)(theta)
        seeds, of_view = self.setting.seeds
        along = jax.vmap(lambda seed: jax.jvp(moving, (theta,), (seed,))[1], out_axes=-1)(seeds)
        if of_view is None:
            return along
        S = jnp.take_along_axis(along, of_view[:, None, None, :], -1)
        return jnp.where((self.setting.shown < len(theta))[:, None, None, :], S, 0.0)

    def gram(self, theta: Float[Array, " p"], summary: Any) -> ByView:
        """Return the Gram of each view from the sum of the chunks' summaries.

        Where it is shared, theta may have other linear unknowns than those the pass was made with.
        """
        predicted, _ = self.coefficients(theta)
        S, shown = self._slopes(theta), self.setting.shown
        if not self.shared:
            cost, slope, curvature = summary
            gradient = jnp.einsum("vcfp,vcf->vp", S, slope)
            return ByView(cost, gradient, jnp.einsum("vcfp,vcfg,vcgq->vpq", S, curvature, S), shown)
        features = predicted.shape[2]
        FF, Fy = summary[:, :features, :features], summary[:, :features, features:].transpose(0, 2, 1)
        yy = jnp.trace(summary[:, features:, features:], axis1=1, axis2=2)
        scale = self.view_weights()
        slope = jnp.einsum("vfg,vcg->vcf", FF, predicted) - Fy
        cost = 0.5 * (jnp.einsum("vcf,vcf->v", predicted, slope - Fy) + yy)
        return ByView(
            scale * cost,
            scale[:, None] * jnp.einsum("vcfp,vcf->vp", S, slope),
            scale[:, None, None] * jnp.einsum("vcfp,vfg,vcgq->vpq", S, FF, S),
            shown,
        )


def axes_of(name: str, place: Vec3) -> Sequence[Vec3]:
    """Return the axes along which moving a light changes what it does; the length of a direction changes nothing."""
    if name == "position":
        one, zero = jnp.ones_like(place.x), jnp.zeros_like(place.x)
        return Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one)
    return tangents_of(jax.lax.stop_gradient(normalize(place)))


def features_can_serve(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> bool:
    """Whether this model can serve: one object, few lights at once, and every unknown is one that it knows."""
    free = _fields_of(unknowns)
    material = scene.objects[0].material
    n_s = material.n_s
    return (
        len(scene.objects) == 1
        and free <= SERVED.union(*map(_of_law, scene.lights))
        and isinstance(material.fresnel, NoFresnel)
        and isinstance(material.lobe, AbstractPowerLobe)
        and not material.highlights
        and material.k_t is None
        and not material.patterns
        and not material.maps
        and all(view.sensor is None for view in views)
        and scene.atmosphere is None
        and not scene.shadows
        and np.ndim(n_s) == 0
        and (EXPONENT in free or float(n_s) >= EXPONENT_RANGE[0])
        and max(len(lights_on(scene, view)) for view in views) <= MOST_LIGHTS
        and all(light.is_factored and light.has_one_colour for light in scene.lights)
    )


def feature_model(
    setting: Setting,
    likelihood: Likelihood,
    scene: Scene,
    unknowns: Sequence[Unknown],
    *,
    shared: bool,
    grey: bool | None,
) -> FeatureModel:
    """Return the model with the features that these unknowns need."""
    free = _fields_of(unknowns)
    kinds = [next(scene.lights[i] for i in of) for of in light_kinds(scene.lights)]
    fading = tuple(tuple(of[-1] for of in _of_law(light) if of in free) for light in kinds)
    placed = tuple(
        tuple(name for name in PLACES if ("lights", name) in free and name in light.placement) for light in kinds
    )
    return FeatureModel(setting, likelihood, EXPONENT in free, fading, placed, shared, grey)


def _fields_of(unknowns: Sequence[Unknown]) -> set[tuple[str | int, ...]]:
    """Return the fields, with their owner, of all places that depend on an unknown."""
    return {(place.owner, *place.fields) for unknown in unknowns for place in unknown.all_places}


def _of_law(light: AbstractLight) -> list[tuple[str, str, str]]:
    """Return the fields that are numbers of a light's attenuation."""
    law = getattr(light, "attenuation", None)
    names = [] if law is None else [name for name in law.numbers() if getattr(law, name) is not None]
    return [("lights", "attenuation", name) for name in names]
