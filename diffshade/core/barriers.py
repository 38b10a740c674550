"""Barriers: values that are computed once, where XLA's CPU compiler would compute them again for each use."""

from __future__ import annotations

from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
from jax.custom_derivatives import SymbolicZero
from jax.experimental.xla_metadata import set_xla_metadata

T = TypeVar("T")


def computed_once(tree: T) -> T:
    """Return a tree of arrays unchanged, as values that derivatives compute once.

    XLA's fusion on the CPU copies what several results share into each of them. The derivative of a ray through several
    surfaces has hundreds of results, sums over the pixels, that share all that comes before: it would be compiled, and
    computed, again for each. So in derivatives the tree and its tangents are `stored`.

    What is not differentiated is compiled as if this were not there, to the same bits, and so is all that does not run
    on a CPU. Where XLA ignores the attribute, only the time is lost.
    """
    return _computed_once(tree)


@jax.custom_jvp
def _computed_once(tree: Any) -> Any:
    return tree


@partial(_computed_once.defjvp, symbolic_zeros=True)
def _derivative(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    """Return the tree and its tangents behind a barrier each; tangents that are known to be 0 stay so."""
    (tree,), (tangent,) = primals, tangents
    zero, other = eqx.partition(tangent, _is_zero, is_leaf=_is_zero)
    return stored(tree), eqx.combine(zero, stored(other), is_leaf=_is_zero)


def _is_zero(leaf: Any) -> bool:
    return isinstance(leaf, SymbolicZero)


def stored(tree: T) -> T:
    """Return a tree of arrays unchanged, as values that a program computes once and keeps for all that uses them.

    They are passed through a call that XLA's CPU compiler is told not to inline, for what is called is not fused
    across; an `optimization_barrier` alone is removed before fusion. Elsewhere nothing is done.
    """
    if jax.default_backend() != "cpu":
        return tree
    with set_xla_metadata(inlineable="false"):
        return _unchanged(tree)


@jax.jit
def _unchanged(tree: Any) -> Any:
    return jax.lax.optimization_barrier(tree)  # JAX drops a call that does nothing
