"""Grams: what a Gauss-Newton step needs of any number of residuals."""

from __future__ import annotations

import equinox as eqx
from jaxtyping import Float

from ...core.fields import Array


class Gram(eqx.Module):
    """The cost |r|^2/2, J^T r and J^T J of residuals r, weighted by the loss; a leading axis is that of the views."""

    cost: Float[Array, "..."]
    gradient: Float[Array, "... p"]
    hessian: Float[Array, "... p p"]


class Point(eqx.Module):
    """A point that was tried: theta, and the Gram there, of views and priors together and of each view."""

    theta: Float[Array, " p"]
    total: Gram
    views: Gram
