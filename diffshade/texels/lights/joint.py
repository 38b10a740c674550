r"""Joint: what the texels of an object say of the lights, with the numbers of every texel eliminated.

Each observation depends on its texel (two tilts of the normal, k_d, k_s) and on its light (two tilts of its direction,
the logarithm of its intensity): normal equations of the shape of an arrow, as in bundle adjustment (Triggs et al.
2000). With H_t of a texel, C_t its coupling to the lights and A that of the lights,

$$ S = A - \sum_t C_t^T H_t^{-1} C_t $$

is small, three numbers a light. Where directions are known, a light has one: the logarithm of its intensity.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...core.fields import Array
from ...core.thresholds import NEGLIGIBLE, ROUNDING, SINGLE
from ...inverse.solve.elimination import eliminate
from ..lighting import LightingSetup
from ..prediction import TexelBlock
from ..robust.block_fits import lowest_state
from ..robust.learning import ObjectModel
from ..robust.observations import BlockObservations, observe
from ..robust.robust_descent import DescentState, around
from ..robust.texel_work import TexelWork
from ..tiles import SQUARE, TexelTile

TILT = NEGLIGIBLE  # radians, over which derivatives in single precision are taken

HELD = 1.0 / ROUNDING  # curvature of a k_s that is 0, which then stays
BLOCK = SQUARE**2  # texels


class Responses(NamedTuple):
    """How the observations of some texels answer to the texels' own numbers and to the lights."""

    residual: Float[Array, "views texels"]
    weight: Float[Array, "views texels"]
    """Of the loss, over its squared scale."""
    by_texel: Float[Array, "4 views texels"]
    """Derivatives by both tilts of the normal, k_d and k_s."""
    by_light: Float[Array, "numbers views texels"]
    """Derivatives by both tilts of the light, so far as they are asked for, and the logarithm of its intensity."""
    curvature: Float[Array, "4 texels"]
    """What is known of the texel's numbers beside its observations."""
    pull: Float[Array, "4 texels"]
    """Its gradient."""


def responses(
    work: TexelWork, sample: TexelTile, models: Sequence[ObjectModel], setups: Sequence[LightingSetup]
) -> Responses:
    """Return how the observations of some texels answer, each texel at its minimum.

    Args:
        work: What works on the texels.
        sample: The texels.
        models: What the texels of each region have in common.
        setups: The lights; and, for derivatives by their tilts, with each of them tilted by `TILT` along one of its
            tangents, and along the other.
    """

    def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Responses:
        observed, *tilted = (observe(setup, work.known, block, model.assumed.dark_is_shadow) for setup in setups)
        return _responses(observed, tilted, model, lowest_state(observed, model))

    return work.each(sample, program, models)


@jax.jit
def _responses(
    observed: BlockObservations, tilted: Sequence[BlockObservations], model: ObjectModel, state: DescentState
) -> Responses:
    weighing = model.weighing(observed.level)
    here = around(observed, model.shape, weighing, state)

    def shown(of: BlockObservations) -> Array:
        D, S = of.lights.shading(model.shape, state.n)
        return state.k_d[None] * D + state.k_s[None] * S

    value = shown(observed)
    by_light = []
    for one in tilted:  # what a texel shows for each unit of light changes too, where a lamp nearby comes nearer
        y = jnp.where(observed.counts, one.y * (one.level / observed.level)[None], 0.0)
        by_light.append((shown(one) - y - value + jnp.where(observed.counts, observed.y, 0.0)) / TILT)
    ridge = weighing.ridge
    held, nothing = jnp.where(state.k_s <= 0.0, HELD, 0.0), jnp.zeros_like(ridge)
    return Responses(
        here.residual,
        here.weight / weighing.scale[None] ** 2,
        jnp.stack(here.J),
        jnp.stack([*by_light, value]),
        jnp.stack([nothing, nothing, nothing, ridge + held]) + SINGLE,
        jnp.stack([nothing, nothing, nothing, ridge * state.k_s]),
    )


class LightEquations(NamedTuple):
    """The normal equations of the lights, with all texels eliminated."""

    S: Float[np.ndarray, "numbers*lights numbers*lights"]
    gradient: Float[np.ndarray, "cells numbers*lights"]
    """By each cell of the image."""


def light_equations(
    texels: Responses, light_of: Int[np.ndarray, " views"], lights: int, cell: Int[np.ndarray, " texels"], cells: int
) -> LightEquations:
    """Return the normal equations of the lights.

    Args:
        texels: The responses of some texels.
        light_of: The light of each view.
        lights: Number of lights.
        cell: Cell of the image that each texel lies in.
        cells: Number of cells.
    """
    numbers = len(texels.by_light)
    S, gradient = np.zeros((lights, numbers, lights, numbers)), np.zeros((cells, lights, numbers))
    on = np.eye(lights)[light_of]  # (views, lights)
    for start in range(0, len(cell), BLOCK):
        of = jax.tree.map(lambda leaf, start=start: np.asarray(leaf[..., start : start + BLOCK], np.float64), texels)
        weighted = of.weight * of.by_texel
        H = np.einsum("ivt,jvt->tij", weighted, of.by_texel, optimize=True)
        H[:, range(4), range(4)] += of.curvature.T
        g = np.einsum("ivt,vt->ti", weighted, of.residual) + of.pull.T
        side = np.einsum("vl,avt,ivt->tila", on, of.by_light, weighted, optimize=True).reshape(len(H), 4, -1)
        _, _, of_matrix, of_right = eliminate(np.linalg.inv(H), side, g[..., None])
        S -= of_matrix.reshape(S.shape)
        A = np.einsum("vl,avt,bvt,vt->lab", on, of.by_light, of.by_light, of.weight, optimize=True)
        S[range(lights), :, range(lights)] += A
        own = np.einsum("vl,avt,vt,vt->tla", on, of.by_light, of.weight, of.residual, optimize=True)
        np.add.at(gradient, cell[start : start + BLOCK], own - of_right.reshape(own.shape))
    S = S.reshape(numbers * lights, numbers * lights)
    return LightEquations(0.5 * (S + S.T), gradient.reshape(cells, -1))
