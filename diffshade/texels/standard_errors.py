"""Standard errors: those of every number of a texel, from the curvature of the cost at its minimum."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float

from ..core.fields import Array
from ..core.thresholds import DEGREE, SLIGHT, VAGUE
from .light_directions import out_of_plane, scatter
from .linear_systems import inverse_diagonal
from .minima import TexelMinima
from .normal_equations import NormalEquations, eliminate_coefficients, evaluate

Numbers = Mapping[str, Float[Array, "_ texels"]]
MAX_INFLATION = 1.0 / SLIGHT  # the factor by which an error may grow because the other numbers are unknown too


class NamedNumbers(NamedTuple):
    """The numbers of a block of texels by name, their standard errors, and whether they can be separated."""

    values: dict[str, Float[Array, "_ texels"]]
    errors: dict[str, Float[Array, "_ texels"]]
    """That of the normal in degrees."""
    separable: Bool[Array, " texels"]
    """Whether the coefficients but k_s can be separated from each other and from the rest."""


def named_numbers(minimum: TexelMinima) -> NamedNumbers:
    """Return the numbers of a minimum and their standard errors."""
    problem, found, block = minimum.problem, minimum.descent.found, minimum.problem.block
    coefficients, rest, separable = _deviations(minimum)
    values = dict(zip(problem.known.fitted, found.k, strict=True))
    errors = dict(zip(problem.known.fitted, coefficients, strict=True))
    if problem.fit_exponent:
        values["n_s"] = jnp.exp(found.x)[None]
        errors["n_s"] = values["n_s"] * rest[-1][None]
    elif problem.options.shared:
        values["n_s"] = jnp.exp(block.log_n_s)[None]
        errors["n_s"] = values["n_s"] * block.log_n_s_error[None]
    if problem.fit_normal:
        values["normal"] = jnp.stack([found.n.x, found.n.y, found.n.z])
        errors["normal"] = jnp.rad2deg(jnp.sqrt(rest[0] ** 2 + rest[1] ** 2))[None]
        lights, exposure, ambient = problem.geometry, problem.setup.exposure, "k_a" in problem.known.fitted
        S = scatter(lights.l, lights.strength, exposure, minimum.descent.weight, found.n, ambient=ambient)
        for name in {"k_d", "normal"} & errors.keys():  # coplanar lights: infinite, whatever the linear theory gives
            errors[name] = jnp.where((out_of_plane(S) > DEGREE)[None], errors[name], jnp.inf)
    return NamedNumbers(values, errors, separable)


def _deviations(minimum: TexelMinima) -> tuple[Sequence[Array], Sequence[Array], Bool[Array, " texels"]]:
    """Return the standard deviations of the coefficients and of the other unknowns, and where they can be separated.

    They are the roots of variance times the diagonal of the inverse normal equations, no coefficient held at 0.
    """
    problem, found, size = minimum.problem, minimum.descent.found, len(minimum.descent.found.k)
    log_n_s_error = None
    if problem.options.shared and problem.known.k_s is None:  # a region's n_s is an unknown of its texels too
        free = dataclasses.replace(problem, options=problem.options._replace(free=(*problem.options.free, "n_s")))
        there = evaluate(free, found.n, found.x, minimum.descent.weight)
        found, log_n_s_error = dataclasses.replace(found, B=there.B, P=there.P), problem.block.log_n_s_error
    joint = _joint_system(minimum, found, log_n_s_error)
    inverse = inverse_diagonal(joint)
    deviation = [jnp.sqrt(minimum.variance[None] * v) for v in inverse]
    return deviation[:size], [d[0] for d in deviation[size:]], _separable(minimum, joint, inverse, deviation)


def _joint_system(
    minimum: TexelMinima, found: NormalEquations, log_n_s_error: Float[Array, " texels"] | None
) -> list[list[Array]]:
    """Return, for each channel, the normal equations of its coefficients and of the unknowns that channels share.

    The other channels' coefficients are eliminated. `log_n_s_error` is what its region knows of n_s, the last unknown.
    """
    size, count = len(found.k), len(found.P)
    S, Z = eliminate_coefficients(found, hold_zeros=False)
    if log_n_s_error is not None:
        precision = minimum.variance / jnp.maximum(log_n_s_error, 1e-12) ** 2
        S[-1][-1] = jnp.maximum(S[-1][-1], jnp.where(jnp.isfinite(precision), precision, 0.0))
    # undo the elimination for the channel itself: S + Z^T Z
    corner = [
        [S[i][j][None] + sum((a * b for a, b in zip(Z[i], Z[j], strict=True)), 0.0) for j in range(count)]
        for i in range(count)
    ]
    joint = [[*found.G[i], *found.B[i]] for i in range(size)]
    joint += [[*(found.B[i][j] for i in range(size)), *corner[j]] for j in range(count)]
    zero = jnp.zeros_like(found.B[0][0]) if size and count else jnp.zeros((1, *found.x.shape))
    return [[element + zero for element in row] for row in joint]


def _separable(
    minimum: TexelMinima, joint: list[list[Array]], inverse: Sequence[Array], deviation: Sequence[Array]
) -> Bool[Array, " texels"]:
    """Return where no coefficient but k_s has a large error that comes from the other unknowns.

    The variance inflation factor of unknown i is (A^-1)_ii A_ii.
    """
    found = minimum.descent.found
    separable = jnp.ones(found.x.shape, bool)
    if not found.k:
        return separable
    largest = jnp.max(jnp.stack([jnp.max(k, 0) for k in found.k]), 0)
    for i, name in enumerate(minimum.problem.known.fitted):
        inflated = inverse[i] * joint[i][i] > MAX_INFLATION**2
        if name != "k_s":
            separable = separable & ~((deviation[i] > VAGUE * largest[None]) & inflated).any(0)
    return separable
