"""Features: the predictions of one material as sums of a few fields, so that a pass over the pixels is one small Gram.

If the geometry of the light is known, a pixel shows m = c_1 + sum over its lights of c_u u + c_v v, with
u = f_rad f_ang (n.l)_+ and v = f_rad f_ang (cos)_+^n_s (E2-E6). The fields n.l, log cos, d and f_ang are computed once
for a fit; the coefficients c are products of k_a, k_d, k_s, intensities, exposure and black, and do not depend on the
pixel. With the derivatives of u and v beside them, F = [1, u, v, dv/dlog n_s, du/da, dv/da], every product that a
Gauss-Newton step needs is a sum of F F^T, F y and y^2, and none of these depends on the coefficients: one pass gives
J^T J at any k_a, k_d, k_s at once. That is variable projection (Golub and Pereyra 1973, in Kaufman's form of 1975):
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
from jaxtyping import Bool, Float

from ...core.fields import Array
from ...model.attenuation import NEAREST
from ...model.fresnel import NoFresnel
from ...model.lobes import EXPONENT_RANGE, AbstractPowerLobe
from ...model.materials import Material
from ...model.scenes import Scene
from ...model.vectors import Vec3, dot
from ..data.views import View, lights_on
from ..pixels.blocks import Block
from ..unknowns.slots import together
from ..unknowns.unknown import Unknown
from .gram import Gram
from .interface import AbstractForwardModel, Pixels, Setting
from .losses import Likelihood
from .rendered import costs

DARK = -1e4  # stands for log 0: exp(n_s DARK) is 0, and no derivative is NaN
MOST_LIGHTS = 4  # on in one view; with more, the model that renders is no slower
FADES = ("constant", "linear", "quadratic")  # by the power of the distance
SERVED = {"k_a", "k_d", "k_s", "k_e", "n_s", *FADES, "intensity", "ambient", "exposure", "black"}
HOLDERS = {**dict.fromkeys(("k_a", "k_d", "k_s", "k_e", "n_s"), "material"), **dict.fromkeys(FADES, "attenuation")}


class Fields(eqx.Module):
    """The geometry of a block's pixels under the lights that are on: one row per light."""

    counts: Bool[Array, "... pixels"]
    """False where the block is padded."""
    diffuse: Float[Array, "... lights pixels"]
    """f_ang (n.l)_+."""
    log_cosine: Float[Array, "... lights pixels"]
    """Logarithm of the highlight's base; DARK where there is no highlight."""
    distance: Float[Array, "... lights pixels"] | None
    f_ang: Float[Array, "... lights pixels"] | None


class Lamps(eqx.Module):
    """The lights that are on in each view."""

    intensity: Float[Array, "views lights 3"]
    fade: Float[Array, "views lights 3"]
    """constant, linear, quadratic; (1, 0, 0) at infinity."""
    clamp: Float[Array, "views lights"]


class FeatureModel(AbstractForwardModel):
    """The predictions of one object's material, as sums of features."""

    setting: Setting
    likelihood: Likelihood
    with_exponent: bool = eqx.field(static=True)
    """Whether n_s is unknown."""
    with_fade: tuple[int, ...] = eqx.field(static=True)
    """The unknown coefficients of the attenuation, as indices into `FADES`."""
    shared: bool = eqx.field(static=True)
    """Whether all samples weigh the same, so that one Gram of the features serves all channels and coefficients."""
    grey: bool = eqx.field(static=True)
    """Whether all views are grey."""

    @property
    def projects(self) -> bool:
        """Whether one pass gives the Gram at any linear unknowns: where the Gram of the features is shared."""
        return self.shared

    @property
    def transparent(self) -> bool:
        """Whether light passes through an object: no."""
        return False

    def fields(self, pixels: Pixels, view: Any, counts: Any) -> Fields:
        """Return the fields of a chunk's pixels; they are dark where a pixel does not count or is padding."""
        return _fields(self.setting, pixels, view, counts)

    def rows(self, lamps: Lamps, n_s: Array, view: Array, points: Fields) -> list[Any]:
        """Return F of a block: 1, then u, v and their derivatives for each light."""
        found = [jnp.where(points.counts, 1.0, 0.0)]
        for light in range(points.diffuse.shape[0]):
            u, log = points.diffuse[light], points.log_cosine[light]
            v = jnp.exp(n_s * log)
            if points.f_ang is not None:
                v = v * points.f_ang[light]
            slopes = []
            if points.distance is not None:
                d, (a0, a1, a2) = points.distance[light], (lamps.fade[view, light, k] for k in range(3))
                f = 1.0 / (a0 + d * (a1 + d * a2))
                clamped = (lamps.clamp[view, light] > 0) & (f >= 1.0)
                f = jnp.where(clamped, 1.0, f)
                u, v, slope = f * u, f * v, jnp.where(clamped, 0.0, -f)
                for k in self.with_fade:
                    power = slope * d**k if k else slope
                    slopes += [power * u, power * v]
            elif self.with_fade:
                slopes = [jnp.zeros_like(u)] * (2 * len(self.with_fade))
            found += [u, v, *([n_s * log * v] if self.with_exponent else []), *slopes]
        return found

    def coefficients(self, theta: Float[Array, " p"]) -> tuple[Array, Array]:
        """Return the coefficients of F in each view and channel: of the prediction, and a function with its Jacobian.

        In the second, the derivative of u or v by an unknown has the coefficient of u or v, held constant, times that
        unknown. Its derivatives by theta are the columns of the prediction's Jacobian.
        """
        setting = self.setting
        setup = setting.slots.insert(theta, setting.setup)
        scene, lamps = setup.scene, _lamps(setup.scene, setting.lit)
        material = scene.objects[0].material
        exposure = setup.exposure[:, None]
        constant = exposure * (material.k_e + material.k_a * scene.ambient)[None] + setup.black[:, None]  # (views, 3)
        held = jax.lax.stop_gradient
        zero = jnp.zeros_like(constant)
        predicted, moving = [constant], [constant]
        for light in range(lamps.intensity.shape[1]):
            sent = exposure * lamps.intensity[:, light]
            c_u, c_v = sent * material.k_d[None], sent * material.k_s[None]
            predicted += [c_u, c_v]
            moving += [c_u, c_v]
            if self.with_exponent:
                predicted.append(zero)
                moving.append(held(c_v) * jnp.log(material.n_s))
            for k in self.with_fade:
                fade = lamps.fade[:, light, k][:, None]
                predicted += [zero, zero]
                moving += [held(c_u) * fade, held(c_v) * fade]
        return self._channels(predicted), self._channels(moving)

    def _channels(self, coefficients: Sequence[Array]) -> Array:
        """Stack coefficients (views, 3) as (views, channels, features); a grey view has their mean, in channel 0."""
        stacked = jnp.stack(coefficients, -1)
        mean = stacked.mean(1, keepdims=True)
        if self.grey:
            return mean
        first = jnp.where(jnp.arange(3)[None, :, None] == 0, mean, 0.0)
        return jnp.where(self.setting.grey[:, None, None] > 0, first, stacked)

    def predict(self, theta: Float[Array, " p"], block: Block) -> tuple[Float[Array, " pixels"], ...]:
        """Return the predictions of a block, one array a channel."""
        predicted, _ = self.coefficients(theta)
        scene = self.setting.slots.insert(theta, self.setting.setup).scene
        lamps = _lamps(scene, self.setting.lit)
        rows = self.rows(lamps, scene.objects[0].material.n_s, block.view, block.points)
        return self._predict(predicted[block.view], rows)

    def _predict(self, coefficients: Array, rows: Sequence[Any]) -> tuple[Any, ...]:
        lights = sum(index.shape[1] for index, _ in self.setting.lit)
        each = (len(rows) - 1) // lights if lights else 0
        used = [0, *(1 + light * each + k for light in range(lights) for k in (0, 1))]
        return tuple(sum((channel[r] * rows[r] for r in used[1:]), channel[0] * rows[0]) for channel in coefficients)

    def summary(self, theta: Float[Array, " p"], chunk: Block) -> Any:
        """Return for each view, over the blocks of a chunk, the Gram of [F, y].

        If the samples' weights differ, return instead the cost and, for each channel, F l' and F h F^T with the slopes
        l' and the curvatures h of the loss.
        """
        setting = self.setting
        scene = setting.slots.insert(theta, setting.setup).scene
        lamps, n_s = _lamps(scene, setting.lit), scene.objects[0].material.n_s
        predicted, _ = self.coefficients(theta)
        views, channels, features = predicted.shape

        def shared(total: Any, block: Block) -> tuple[Any, None]:
            F = jnp.stack([*self.rows(lamps, n_s, block.view, block.points), *block.observed.target])
            return total.at[block.view].add(jnp.matmul(F, F.T, precision="highest")), None

        def weighted(total: tuple, block: Block) -> tuple[tuple, None]:
            rows = self.rows(lamps, n_s, block.view, block.points)
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

    def gram(self, theta: Float[Array, " p"], summary: Any) -> Gram:
        """Return the Gram of each view from the sum of the chunks' summaries.

        Where it is shared, theta may have other linear unknowns than those the pass was made with.
        """
        predicted, _ = self.coefficients(theta)
        S = jax.jacfwd(lambda q: self.coefficients(q)[1])(theta)  # (views, channels, features, p)
        if not self.shared:
            cost, slope, curvature = summary
            return Gram(
                cost,
                jnp.einsum("vcfp,vcf->vp", S, slope),
                jnp.einsum("vcfp,vcfg,vcgq->vpq", S, curvature, S),
            )
        features = predicted.shape[2]
        FF, Fy = summary[:, :features, :features], summary[:, :features, features:].transpose(0, 2, 1)
        yy = jnp.trace(summary[:, features:, features:], axis1=1, axis2=2)
        scale = self.view_weights()
        slope = jnp.einsum("vfg,vcg->vcf", FF, predicted) - Fy
        cost = 0.5 * (jnp.einsum("vcf,vcf->v", predicted, slope - Fy) + yy)
        return Gram(
            scale * cost,
            scale[:, None] * jnp.einsum("vcfp,vcf->vp", S, slope),
            scale[:, None, None] * jnp.einsum("vcfp,vfg,vcgq->vpq", S, FF, S),
        )


def features_can_serve(scene: Scene, views: Sequence[View], unknowns: Sequence[Unknown]) -> bool:
    """Whether this model can serve: one object, few lights at once, and every unknown is one that it knows."""
    names = _kinds(unknowns)
    material = scene.objects[0].material
    n_s = material.n_s
    return (
        len(scene.objects) == 1
        and names <= SERVED
        and isinstance(material.fresnel, NoFresnel)
        and isinstance(material.lobe, AbstractPowerLobe)
        and not material.highlights
        and material.k_t is None
        and not material.patterns
        and not material.maps
        and scene.atmosphere is None
        and np.ndim(n_s) == 0
        and ("n_s" in names or float(n_s) >= EXPONENT_RANGE[0])
        and max(len(lights_on(scene, view)) for view in views) <= MOST_LIGHTS
        and all(light.is_factored for light in scene.lights)
    )


def feature_model(
    setting: Setting, likelihood: Likelihood, unknowns: Sequence[Unknown], *, shared: bool, grey: bool
) -> FeatureModel:
    """Return the model with the features that these unknowns need."""
    names = _kinds(unknowns)
    fade = tuple(k for k, name in enumerate(FADES) if name in names)
    return FeatureModel(setting, likelihood, "n_s" in names, fade, shared, grey)


def _kinds(unknowns: Sequence[Unknown]) -> set[str]:
    """Return the last segments of all places that depend on an unknown, or whole paths for users' own numbers."""
    return {_kind(path) for u in unknowns for path, _ in [*u.places, *((x.path, 0) for x in u.products)]}


def _kind(path: str) -> str:
    holder, last = ["", *path.split(".")][-2:]
    return last if holder == HOLDERS.get(last, holder) else path


def _lamps(scene: Any, lit: Any) -> Lamps:
    """Return the lights that are on in each view; padding is dark."""
    intensity, fade, clamp = [], [], []
    for stack, (index, on) in zip(scene.lights, lit, strict=True):
        if not index.shape[1]:
            continue
        intensity.append(stack.intensity[index] * on[..., None])
        ones = jnp.ones(index.shape)
        if not stack.is_local:
            fade.append(jnp.stack([ones, 0.0 * ones, 0.0 * ones], -1))
            clamp.append(0.0 * ones)
        else:
            a = stack.attenuation
            fade.append(jnp.stack([a.constant[index], a.linear[index], a.quadratic[index]], -1))
            clamp.append(ones if a.clamp else 0.0 * ones)
    if not intensity:
        views = lit[0][0].shape[0] if lit else 1
        return Lamps(jnp.zeros((views, 0, 3)), jnp.zeros((views, 0, 3)), jnp.zeros((views, 0)))
    return Lamps(*(jnp.concatenate(of, 1) for of in (intensity, fade, clamp)))


@jax.jit
def _fields(setting: Setting, pixels: Pixels, view: Array, counts: Array) -> Fields:
    """Compute the fields of a chunk's pixels, one block after another."""
    scene = setting.setup.scene
    material: Material = scene.objects[0].material
    lobe = material.lobe
    assert isinstance(lobe, AbstractPowerLobe)  # as `features_can_serve` has seen

    def of_block(block: tuple) -> Fields:
        pixels, view, counts = block
        projection = jax.tree.map(lambda leaf: leaf[view], setting.projections)
        rays = projection.rays(pixels.row, pixels.column)
        (item,) = together(pixels.objects, scene.objects)
        hit = item.surface.intersect(rays)
        v = projection.viewer(hit.p)
        rows: list[tuple] = []
        local = angular = False
        for stack, (index, _) in zip(scene.lights, setting.lit, strict=True):
            for k in range(index.shape[1]):
                light = jax.tree.map(lambda leaf, i=index[view, k]: leaf[i], stack)
                l, d, f_ang = light.path(hit.p)
                local, angular = local or d is not None, angular or f_ang is not None
                l = l + Vec3(*(jnp.zeros_like(hit.n.x) for _ in range(3)))
                n_l, cosine = dot(hit.n, l), lobe.cosine(hit.n, l, v)
                lit = (n_l > 0) & counts
                shines = lit & (cosine > 0)
                one = jnp.ones_like(n_l)
                f_ang = one if f_ang is None else f_ang
                d = one if d is None else jnp.where(d > NEAREST, d, NEAREST)
                log = jnp.where(shines, jnp.log(jnp.where(shines, cosine, 1.0)), DARK)
                rows.append((jnp.where(lit, n_l * f_ang, 0.0), log, d, f_ang))
        if not rows:
            none = jnp.zeros((0, *counts.shape))
            return Fields(counts, none, none, None, None)
        diffuse, log, d, f_ang = (jnp.stack(of) for of in zip(*rows, strict=True))
        return Fields(counts, diffuse, log, d if local else None, f_ang if angular else None)

    return jax.lax.map(of_block, (pixels, view, counts))
