r"""Geometry: what the lights that reach a texel can tell of its normal, whatever they show.

A matte surface shows k_d n.a under light that arrives as a = sum I f_rad f_ang l (Woodham 1980): it tells of b = k_d n
what the scatter matrix of the lights that reach it does,

$$ S = \sum w \, a a^T $$

over its observations. Where these lie in one plane, S has no third dimension: how far n leans out of that plane is not
told from how light the surface is, and a highlight leaves at best n and one other normal (of Phong's lobe v.r stays the
same where n turns to the other side of a plane through v). So a normal is believed only where S has three dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import Array
from ..model.vectors import Vec3, dot
from .lighting import LightingGeometry, LightingSetup, sights_of

# Sines of the angle to the plane nearest to all lights, root mean square.
FLAT = 0.02  # up to which they count as in it: about a degree, which is how well directions of lamps are known
NARROW = 0.15  # up to which they come from so near each other that a highlight and a tilt look alike

Scatter = Sequence[Sequence[Float[Array, " texels"]]]


def scatter(
    setup: LightingSetup, lighting: LightingGeometry, weight: Array, n: Vec3 | None, *, ambient: bool
) -> Scatter:
    """Return S of each texel, of the lights that n faces, or of all where it is not known.

    `weight`: of each observation, (views, _, texels). `ambient`: whether k_a is free, which takes what is the same in
    all views.
    """
    pairs = [(i, j) for i in range(4) for j in range(i + 1)]

    def add(total: list[Array], view: Any) -> tuple[list[Array], None]:
        (l, strength), exposure, w = view
        s = strength.mean(0)
        if n is not None:
            s = jnp.where(dot(jax.tree.map(lambda c: c[None], n), l) > 0.0, s, 0.0)
        a = [*(jnp.sum(s * c, 0) for c in (l.x, l.y, l.z)), exposure]
        w = w.mean(0)
        return [t + w * a[i] * a[j] for t, (i, j) in zip(total, pairs, strict=True)], None

    zero = jnp.zeros(weight.shape[2])
    lower, _ = jax.lax.scan(add, [zero] * len(pairs), (lighting.views, setup.exposure, weight))
    S = [[lower[pairs.index((max(i, j), min(i, j)))] for j in range(4)] for i in range(4)]
    if ambient:
        shared = jnp.where(S[3][3] > 0.0, S[3][3], 1.0)
        S = [[S[i][j] - S[i][3] * S[3][j] / shared for j in range(3)] for i in range(3)]
    return [row[:3] for row in S[:3]]


def out_of_plane(S: Scatter) -> Float[Array, " texels"]:
    """Return the root mean square sine of the angle between the lights and the plane nearest to them.

    The root of the smallest eigenvalue over the trace, in closed form (Smith 1961).
    """
    trace = S[0][0] + S[1][1] + S[2][2]
    safe = jnp.where(trace > 0.0, trace, 1.0)
    A = [[S[i][j] / safe - (1.0 / 3.0) * (i == j) for j in range(3)] for i in range(3)]
    p = jnp.sqrt(sum((A[i][j] ** 2 for i in range(3) for j in range(3)), jnp.zeros_like(trace)) / 6.0)
    B = [[a / jnp.where(p > 0.0, p, 1.0) for a in row] for row in A]
    determinant = (
        B[0][0] * (B[1][1] * B[2][2] - B[1][2] * B[2][1])
        - B[0][1] * (B[1][0] * B[2][2] - B[1][2] * B[2][0])
        + B[0][2] * (B[1][0] * B[2][1] - B[1][1] * B[2][0])
    )
    turn = jnp.arccos(jnp.clip(0.5 * determinant, -1.0, 1.0)) / 3.0
    smallest = 1.0 / 3.0 + 2.0 * p * jnp.cos(turn + 2.0 * jnp.pi / 3.0)
    return jnp.where(trace > 0.0, jnp.sqrt(jnp.maximum(smallest, 0.0)), 0.0)


@partial(jax.jit, static_argnames="ambient")
def scatter_of_block(setup: LightingSetup, block: Any, ambient: bool) -> Float[Array, "3 3 texels"]:
    """Return S of each texel of a block, of all the lights of the views in which it counts."""
    lighting = sights_of(setup, block.p, block.v)
    weight = jnp.where(block.seen.counts[:, None], 1.0, 0.0)
    return jnp.asarray(scatter(setup, lighting, weight, None, ambient=ambient))


class Plane(NamedTuple):
    """How the lights lie about some texels."""

    share: float
    """Of the texels with lights in one plane."""
    off: float
    """Their root mean square angle out of it, in degrees."""
    line: bool
    """Whether they all lie in one direction."""
    normal: Float[np.ndarray, "3"]
    """Of the plane; towards +z."""
    narrow: bool
    """Whether the lights of most other texels come from near each other, or near one plane."""


def plane_of(S: Float[np.ndarray, "3 3 n"]) -> Plane:
    """Say how the lights lie, from S of some texels."""
    S = np.moveaxis(S, -1, 0)
    trace = np.trace(S, axis1=1, axis2=2)
    S = S[trace > 0.0] / trace[trace > 0.0, None, None]
    values, vectors = np.linalg.eigh(S)
    sine = np.sqrt(np.maximum(values, 0.0))
    flat = sine[:, 0] < FLAT
    narrow = not flat.all() and bool(np.median(sine[~flat, 0]) < NARROW)
    if not flat.any():
        return Plane(0.0, 0.0, False, np.zeros(3), narrow)
    off = float(np.rad2deg(np.arcsin(np.sqrt(np.mean(sine[flat, 0] ** 2)))))
    across = vectors[flat, :, 0]
    normal = np.linalg.eigh(across.T @ across)[1][:, -1]  # whichever sign each has
    normal = normal if normal[2] >= 0.0 else -normal
    return Plane(float(flat.mean()), off, bool(np.median(sine[flat, 1]) < FLAT), normal, narrow)


def note_of(plane: Plane) -> str | None:
    """Say what the lights cannot tell of normals, with the remedy, or nothing."""
    if plane.share == 0.0:
        return None
    of = "the texels" if plane.share > 0.995 else f"{plane.share:.0%} of the texels"
    x, y, z = plane.normal
    if plane.line:
        return (
            f"the lights of {of} all lie in one direction: these photographs do not tell their normals, nor k_d apart "
            "from them, and none is called determined. Add photographs under at least two lights at other sides, not "
            "in one plane with this one, or give the normals."
        )
    return (
        f"the lights of {of} lie in one plane with them ({plane.off:.2g} degrees off it in the mean): how far a normal "
        "leans out of that plane, and k_d with it, these photographs do not tell, and none is called determined. Add "
        f"photographs under lights out of the plane, such as towards ({x:.2g}, {y:.2g}, {z:.2g}), or give the normals."
    )
