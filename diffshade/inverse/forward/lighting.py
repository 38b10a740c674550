"""Lighting: how light reaches the pixels of a block, from lights that are known or that a fit moves."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from ...core.backend import SOONER, jit_quickly
from ...core.fields import Array
from ...model.cameras import Projection
from ...model.lobes import AbstractPowerLobe
from ...model.scenes import Object, together
from ...model.vectors import Vec3, dot
from .interface import Pixels, Setting

DARK = -1e4  # stands for log 0: exp(n_s DARK) is 0, and no derivative is NaN

Numbers = Float[Array, "..."]


class Seen(eqx.Module):
    """The points that a block's pixels show."""

    counts: Bool[Array, "... pixels"]
    """False where the block is padded."""
    p: Vec3 | None
    """None where a G-buffer does not say, and all lights are at infinity."""
    n: Vec3
    v: Vec3


class Lit(NamedTuple):
    """What the geometry of a light decides at a block's pixels."""

    diffuse: Numbers
    """f_ang (n.l)_+."""
    log_cosine: Numbers
    """Logarithm of the highlight's base; DARK where there is no highlight."""
    distance: Numbers | None
    """None where the light is at infinity."""
    f_ang: Numbers | None
    """None where it is 1."""


class Fields(eqx.Module):
    """The same for all lights that are on, a row for each."""

    counts: Bool[Array, "... pixels"]
    """False where the block is padded."""
    lit: Lit

    def of(self, light: int) -> Lit:
        """Return the row of one light."""
        return jax.tree.map(lambda rows: rows[light], self.lit)


def intensities_of(scene: Any, lit: Any) -> Float[Array, "views lights channels"]:
    """Return the intensities of the lights that are on in each view; padding is dark."""
    found = [stack.intensity[index] * on[..., None] for stack, (index, on) in zip(scene.lights, lit, strict=True)]
    views = lit[0][0].shape[0] if lit else 1
    return jnp.concatenate([jnp.zeros((views, 0, scene.width)), *found], 1)


def seen_by(objects: tuple[Object, ...], projection: Projection, pixels: Pixels, counts: Array) -> Seen:
    """Return the points that a block's pixels show."""
    rays = projection.rays(pixels.row, pixels.column)
    (item,) = together(pixels.objects, objects)
    hit = item.surface.intersect(rays)
    # a backward axis is one for all pixels
    v = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, pixels.row.shape), projection.viewer(hit.p))
    return Seen(counts, hit.p, hit.n, v)


def lit_by(light: Any, lobe: AbstractPowerLobe, seen: Seen) -> Lit:
    """Return the fields of a light; dark where a pixel is padding."""
    l, d, f_ang = light.path(seen.p)
    l = l + Vec3(*(jnp.zeros_like(seen.n.x) for _ in range(3)))
    n_l, cosine = dot(seen.n, l), lobe.cosine(seen.n, l, seen.v)
    lit = (n_l > 0) & seen.counts
    shines = lit & (cosine > 0)
    diffuse = n_l if f_ang is None else n_l * f_ang
    log = jnp.where(shines, _log(jnp.where(shines, cosine, 1.0)), DARK)
    return Lit(jnp.where(lit, diffuse, 0.0), log, d, f_ang)


@jax.custom_jvp
def _log(x: Array) -> Array:
    """Return log x, with a derivative that divides once for all axes along which a light moves."""
    return jnp.log(x)


@_log.defjvp
def _(primals: tuple, tangents: tuple) -> tuple:
    return jnp.log(primals[0]), tangents[0] * (1.0 / primals[0])


def shaded(lit: Lit, n_s: Array) -> tuple[Numbers, Numbers]:
    """Return the features of a light that nothing attenuates with distance: f_ang (n.l)_+ and f_ang (cos)_+^n_s."""
    v = jnp.exp(n_s * lit.log_cosine)
    return lit.diffuse, v if lit.f_ang is None else v * lit.f_ang


def faded(light: Any, names: Sequence[str], d: Numbers | None) -> tuple[Numbers, list[Numbers]]:
    """Return f_rad of a light at the distances d, and its derivatives by numbers of its law; 1 without a law."""
    law = getattr(light, "attenuation", None)
    if law is None or d is None:
        return jnp.ones(()), []

    def slope(name: str) -> Numbers:
        number = getattr(law, name)
        at = partial(eqx.tree_at, lambda of: getattr(of, name), law)
        return jax.jvp(lambda x: at(x)(d), (number,), (jnp.ones_like(number),))[1]

    return law(d), [slope(name) for name in names]


def _points(objects: tuple[Object, ...], projections: Projection, pixels: Pixels, counts: Array) -> Seen:
    return jax.vmap(partial(seen_by, objects))(projections, pixels, counts)


def points_seen(setting: Setting, pixels: Pixels, view: Any, counts: Array, find: Any = _points) -> Seen:
    """Return the points that a chunk's pixels show; the program that finds them knows no views."""
    projections = jax.tree.map(lambda leaf: leaf[view], setting.projections)
    return find(setting.setup.scene.objects, projections, pixels, counts)


def fields_at(setting: Setting, seen: Seen, view: Array) -> Fields:
    """Return the fields of a chunk's points, which its views' lights decide."""
    scene = setting.setup.scene
    lobe: Any = scene.objects[0].material.lobe

    def of_block(seen: Seen, view: Array) -> Fields:
        one = jnp.ones_like(seen.n.x)
        rows: list[Lit] = []
        for stack, (index, _) in zip(scene.lights, setting.lit, strict=True):
            for k in range(index.shape[1]):
                rows.append(lit_by(jax.tree.map(lambda leaf, i=index[view, k]: leaf[i], stack), lobe, seen))
        if not rows:
            none = jnp.zeros((0, *seen.counts.shape))
            return Fields(seen.counts, Lit(none, none, None, None))
        local, angular = (any(of is not None for of in every) for every in list(zip(*rows, strict=True))[2:])
        filled = [row._replace(distance=_or(row.distance, one), f_ang=_or(row.f_ang, one)) for row in rows]
        diffuse, log, d, f_ang = (jnp.stack(of) for of in zip(*filled, strict=True))
        return Fields(seen.counts, Lit(diffuse, log, d if local else None, f_ang if angular else None))

    return jax.vmap(of_block)(seen, view)


def _or(found: Numbers | None, default: Numbers) -> Numbers:
    return default if found is None else found


# The same, compiled
seen_by_chunk = partial(points_seen, find=jit_quickly(_points, options=SOONER))
fields_of_chunk = jit_quickly(fields_at, options=SOONER)
