r"""Light directions: which normals the lights that reach a texel can determine, whatever the photographs show.

Under light that arrives as a = sum I f_rad f_ang l, a matte surface shows k_d n.a (Woodham 1980). Its observations
determine b = k_d n as far as the scatter matrix of the lights that reach it does,

$$ S = \sum w \, a a^T $$

over the observations. If these lights lie in one plane, S has rank 2: the tilt of n out of that plane cannot be
separated from k_d, and a highlight leaves at best n and one other normal (Phong's v.r stays the same when n is mirrored
in a plane through v). So a normal counts as determined only where S has full rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import Array
from ..core.thresholds import DEGREE, SLIGHT
from ..model.vectors import Vec3, dot

# Limits of the root mean square sine of the angle between the lights and the plane nearest to them.
MIN_SPREAD = 0.15  # up to this the lights are so close together that a highlight and a tilt look alike

Scatter = Sequence[Sequence[Float[Array, " texels"]]]


def scatter(
    l: Vec3,
    strength: Float[Array, "views lamps emitters _"],
    exposure: Float[Array, " views"],
    weight: Float[Array, "views _ texels"],
    n: Vec3 | None,
    *,
    ambient: bool,
) -> Scatter:
    """Return S of each texel.

    Args:
        l: Directions to the lights, components (views, emitters, texels or 1).
        strength: Intensities of the lights, exposure included.
        exposure: Exposure of each view.
        weight: Weight of each observation.
        n: Normals; lights behind the surface do not count. None counts all lights.
        ambient: Whether k_a is free, which absorbs what all views have in common.
    """
    pairs = [(i, j) for i in range(4) for j in range(i + 1)]

    def add(total: list[Array], view: tuple[Vec3, Array, Array, Array]) -> tuple[list[Array], None]:
        l, strength, exposure, w = view
        s = strength.mean(0)
        if n is not None:
            s = jnp.where(dot(jax.tree.map(lambda c: c[None], n), l) > 0.0, s, 0.0)
        a = [*(jnp.sum(s * c, 0) for c in (l.x, l.y, l.z)), exposure]
        w = w.mean(0)
        return [t + w * a[i] * a[j] for t, (i, j) in zip(total, pairs, strict=True)], None

    zero = jnp.zeros(weight.shape[2])
    lower, _ = jax.lax.scan(add, [zero] * len(pairs), (l, strength, exposure, weight))
    S = [[lower[pairs.index((max(i, j), min(i, j)))] for j in range(4)] for i in range(4)]
    if ambient:
        shared = jnp.where(S[3][3] > 0.0, S[3][3], 1.0)
        S = [[S[i][j] - S[i][3] * S[3][j] / shared for j in range(3)] for i in range(3)]
    return [row[:3] for row in S[:3]]


def out_of_plane(S: Scatter) -> Float[Array, " texels"]:
    """Return the root mean square sine of the angle between the lights and the plane nearest to them.

    It is the root of the smallest eigenvalue of S over its trace, in closed form (Smith 1961).
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


class LightDistribution(NamedTuple):
    """Where the lights of some texels lie."""

    coplanar: float
    """Share of the texels whose lights lie in one plane."""
    off_plane: float
    """Root mean square angle of these lights out of the plane, in degrees."""
    collinear: bool
    """Whether these lights all lie in one direction."""
    plane_normal: Float[np.ndarray, "3"]
    """Normal of the plane, towards +z."""
    narrow: bool
    """Whether the lights of most other texels are close to each other, or close to one plane."""


def light_distribution(S: Float[np.ndarray, "3 3 n"]) -> LightDistribution:
    """Return where the lights lie, from S of some texels."""
    S = np.moveaxis(S, -1, 0)
    trace = np.trace(S, axis1=1, axis2=2)
    S = S[trace > 0.0] / trace[trace > 0.0, None, None]
    values, vectors = np.linalg.eigh(S)
    sine = np.sqrt(np.maximum(values, 0.0))
    coplanar = sine[:, 0] < DEGREE
    narrow = not coplanar.all() and bool(np.median(sine[~coplanar, 0]) < MIN_SPREAD)
    if not coplanar.any():
        return LightDistribution(0.0, 0.0, False, np.zeros(3), narrow)
    off_plane = float(np.rad2deg(np.arcsin(np.sqrt(np.mean(sine[coplanar, 0] ** 2)))))
    normals = vectors[coplanar, :, 0]
    normal = np.linalg.eigh(normals.T @ normals)[1][:, -1]  # their mean up to sign
    normal = normal if normal[2] >= 0.0 else -normal
    collinear = bool(np.median(sine[coplanar, 1]) < DEGREE)
    return LightDistribution(float(coplanar.mean()), off_plane, collinear, normal, narrow)


def note_on_normals(lights: LightDistribution) -> str | None:
    """Return a note on the normals that these lights leave undetermined, with the remedy; None if hardly any."""
    if lights.coplanar < SLIGHT:  # a few at the terminator, whose status says it
        return None
    which = "the texels" if lights.coplanar > 0.995 else f"{lights.coplanar:.0%} of the texels"
    x, y, z = lights.plane_normal
    if lights.collinear:
        return (
            f"the lights of {which} all lie in one direction: these photographs do not determine the normals there, "
            "nor k_d, and no such texel is marked as determined. Add photographs under at least two lights from other "
            "sides that do not lie in one plane with this one, or give the normals."
        )
    return (
        f"the lights of {which} lie in one plane with them ({lights.off_plane:.2g} degrees off it, RMS): "
        "these photographs do not determine how far a normal tilts out of that plane, nor k_d, and no such texel is "
        "marked as determined. Add photographs under lights out of the plane, for example towards "
        f"({x:.2g}, {y:.2g}, {z:.2g}), or give the normals."
    )
