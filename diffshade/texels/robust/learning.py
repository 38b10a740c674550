"""Learning: what the texels of one object have in common, from a sample of them: highlight shape, misfit, brightness.

The rounds alternate between the texels, given the shape, and the shape, given the texels. A step of the shape is
Gauss-Newton with the normals and k_d of all texels eliminated, under weights that are not negative.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import nnls

from ...core.fields import Array
from ...core.robust_scale import MAD
from ...core.thresholds import MINOR, MOST, NEGLIGIBLE, SMALL
from ...model.diffuse_laws import DiffuseLaw
from ..status import ROUNDING
from .observations import BlockObservations
from .reflection_shape import ReflectionShape, first_shape, shape_of
from .robust_descent import DescentState, Weighing, around

SHARPNESS = 0.65  # scale of the loss, in typical residuals: the outliers of real objects are many
FIRST_MISFIT = 0.04  # typical residual that learning begins with, relative to the level of a texel
MIN_SAMPLES = 30  # observations, or texels, from which a median or a quantile is taken
NO_OUTLIERS = 30.0  # factor of the scale at which a robust loss is nearly squares for residuals of up to 20 misfits
RIDGE = 1e-4  # added to curvatures: of a texel of level 1, and of the weights of the shape relative to their mean


class Assumptions(eqx.Module):
    """What may be assumed of an object; `choice` takes what predicts photographs that were left out best."""

    glossy: Bool[Array, ""]
    """Whether texels may have a highlight; else k_s is 0."""
    outliers: Bool[Array, ""]
    """Whether single observations may be far off, as by cast shadows; else all count alike, by squares."""
    dark_is_shadow: Bool[Array, ""]
    """Whether the darkest observations of a texel tell little, for most of them lie in shadow."""
    lambertian: Bool[Array, ""]
    """Whether k_d reflects by Lambert's law; else its `DiffuseLaw` is learned."""


def every_assumption(*, lambertian: bool = True) -> list[Assumptions]:
    """Return all by Lambert's law or another, with a highlight and without in turn; outliers and shadows first."""
    yes = (True, False)
    return [Assumptions(*map(np.asarray, (g, o, d, lambertian))) for o in yes for d in yes for g in yes]


class ObjectModel(eqx.Module):
    """What the texels of an object have in common."""

    assumed: Assumptions
    shape: ReflectionShape
    relative_misfit: Float[Array, ""]
    """Typical residual relative to the level of a texel."""
    absolute_misfit: Float[Array, ""]
    """Typical residual where no light should be, as a reflectance."""
    bounced: Float[Array, ""]
    """The same relative to the level of the typical texel."""
    brightest: Float[Array, ""]
    """k_s of the brightest highlights seen; infinite where too few are seen."""
    loss: str = eqx.field(static=True)

    def weighing(self, level: Float[Array, " texels"]) -> Weighing:
        """Return what the residuals and k_s of texels of these levels are measured by."""
        scale = SHARPNESS * jnp.hypot(self.relative_misfit, self.absolute_misfit / level)
        unlikely = jnp.where(
            self.assumed.glossy, level / (self.softness * SHARPNESS * self.brightest), 1.0 / NEGLIGIBLE
        )
        return Weighing(self.softness * scale, unlikely**2, self.loss)

    @property
    def softness(self) -> Array:
        """Factor of the scale of the loss."""
        return jnp.where(self.assumed.outliers, 1.0, NO_OUTLIERS)


def first_model(loss: str, assumed: Assumptions) -> ObjectModel:
    """Return the model that learning begins with."""
    return ObjectModel(
        assumed,
        first_shape(),
        *(np.asarray(number, np.float32) for number in (FIRST_MISFIT, 0.0, 0.0, np.inf)),
        loss=loss,
    )


class Fitted(NamedTuple):
    """Texels of a sample at their minimum, as learning needs them."""

    residual: Float[Array, "views texels"]
    weight: Float[Array, "views texels"]
    """Of the loss; 0 where an observation is not believed."""
    J: Float[Array, "4 views texels"]
    """Derivatives of the model by both tilts, k_d and k_s."""
    powers: Float[Array, "powers views texels"]
    """Each power of the highlight alone."""
    by_law: Float[Array, "2 views texels"]
    """Derivatives of the model by the numbers of the law of k_d."""
    k_s: Float[Array, " texels"]
    level: Float[Array, " texels"]
    lit: Bool[Array, "views texels"]
    scale: Float[Array, " texels"]
    """A residual of this size begins to be doubted."""


@jax.jit
def fitted(observed: BlockObservations, model: ObjectModel, state: DescentState) -> Fitted:
    """Return what learning needs of a block of texels at their minimum."""
    weighing = model.weighing(observed.level)
    here = around(observed, model.shape, weighing, state)
    powers, lit = observed.lights.shading_of_powers(state.n), observed.lights.reach(state.n)

    def shading(law: DiffuseLaw) -> Array:
        return observed.lights.shading(eqx.tree_at(lambda shape: shape.diffuse, model.shape, law), state.n)[0]

    by_law = state.k_d[None, None] * jnp.stack(jax.jacfwd(shading)(jax.tree.map(jnp.asarray, model.shape.diffuse)))
    J, k_s, level = jnp.stack(here.J), state.k_s, observed.level
    return Fitted(here.residual, here.weight, J, powers, by_law, k_s, level, lit, weighing.scale)


def learned(model: ObjectModel, texels: Fitted, *, to_the_end: bool = False) -> ObjectModel:
    """Return the model that these texels, fitted by the model so far, suggest.

    Args:
        model: The model so far.
        texels: The texels at their minimum.
        to_the_end: Whether k_s of each texel is eliminated too. The shape then converges in a few rounds, but takes
            some of the normals' errors for its own; the slower one, ended early, gives better normals.
    """
    believed = texels.weight > 0.0
    dark = texels.residual * texels.level[None]
    in_shadow = dark[believed & ~texels.lit]
    absolute = MAD * np.median(np.abs(in_shadow)) if len(in_shadow) > MIN_SAMPLES else 0.0
    lit = np.abs(texels.residual[believed & texels.lit])
    relative = max(MAD * float(np.median(lit)) * _of_freedom(model, believed) if len(lit) else 0.0, ROUNDING)
    S = np.tensordot(np.asarray(model.shape.weight), texels.powers, 1)
    seen = (texels.k_s * texels.level)[S.max(0) > MOST]
    brightest = max(float(np.quantile(seen, 1.0 - SMALL)), 1e-6) if len(seen) > MIN_SAMPLES else np.inf
    shape = _next_shape(model, texels, eliminated=4 if to_the_end else 3)
    numbers = relative, absolute, absolute / typical_level(np.asarray(texels.level)), brightest
    return ObjectModel(model.assumed, shape, *(np.asarray(number, np.float32) for number in numbers), loss=model.loss)


def _of_freedom(model: ObjectModel, believed: Bool[Array, "views texels"]) -> float:
    """Return by how much residuals are larger than those that are left after the numbers of each texel are fitted."""
    fitted_to, numbers = float(np.asarray(believed).sum(0).mean()), 4.0 if model.assumed.glossy else 3.0
    return float(np.sqrt(fitted_to / max(fitted_to - numbers, 1.0)))


def typical_level(level: Float[np.ndarray, " texels"]) -> float:
    """Return the median level of the texels that show anything, so that a black background does not count."""
    # what is darker shows no more than a black background
    return float(np.median(level[level >= MINOR * np.quantile(level, 1.0 - SMALL)]))


def _next_shape(model: ObjectModel, texels: Fitted, eliminated: int) -> ReflectionShape:
    """Return the shape after a Gauss-Newton step on what may be learned, the first numbers of each texel eliminated."""
    powers, law = len(model.shape.weight), model.shape.diffuse
    current = np.array([*model.shape.weight, *law], np.float64)
    learns = np.repeat([bool(model.assumed.glossy), not model.assumed.lambertian], [powers, len(law)])
    if not learns.any():
        return model.shape
    root = np.sqrt(texels.weight / texels.scale[None] ** 2).T[..., None]  # (texels, views, 1)
    A = np.concatenate([texels.k_s * texels.powers, texels.by_law])[learns]
    A = np.moveaxis(A, 0, -1).swapaxes(0, 1) * root
    target = A @ current[learns] - texels.residual.T * root[..., 0]
    Q, _ = np.linalg.qr(np.moveaxis(np.asarray(texels.J[:eliminated]), 0, -1).swapaxes(0, 1) * root)
    A = A - Q @ (Q.swapaxes(1, 2) @ A)
    target = target - (Q @ (Q.swapaxes(1, 2) @ target[..., None]))[..., 0]
    A, target = A.reshape(-1, learns.sum()), target.ravel()
    G = A.T @ A
    of_powers, of_law = np.split(np.diag(G), [learns[:powers].sum()])
    mean = np.append(np.full(len(of_powers), of_powers.mean() if len(of_powers) else 0.0), of_law)
    ridge = np.maximum(RIDGE * mean, np.finfo(np.float32).tiny)  # where no texel has a highlight, all is 0
    L = np.linalg.cholesky(G + np.diag(ridge))
    # without k_s, the size of the weights is nobody's: they stay near the current ones
    kept = ridge * current[learns] if eliminated == 4 else 0.0
    found = current.copy()
    found[learns] = nnls(L.T, np.linalg.solve(L, A.T @ target + kept))[0]
    weight, law = np.split(found, [powers])
    return shape_of(weight if weight.sum() > 0.0 else current[:powers], DiffuseLaw(*law))
