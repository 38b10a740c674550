"""Tracing: the radiance that arrives along a ray, from the surfaces on its way, front to back (E9, E13, E14)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from ..core.barriers import computed_once
from ..core.fields import Array
from .cameras import Projection, Rays
from .lobes import Coefficients
from .reflection import reflection
from .scenes import Object, StackedScene
from .surfaces import AbstractSolid, AbstractSurface, Hit, touching
from .transmission import Way, bend, straight
from .vectors import Vec3, where


class RayState(eqx.Module):
    """The state of rays on their way from the eye."""

    way: Way
    weight: Vec3
    """How much of what they meet next arrives at the eye."""
    met: tuple[Bool[Array, "..."], ...]
    """For each object whether they have met it: each counts once, at its first hit."""


def radiance(scene: StackedScene, rays: Rays, projection: Projection, *, covered: bool = False) -> Vec3:
    """Return the radiance that arrives along each ray.

    I = (1 - k_t) I_refl + k_t I_trans, where I_trans is the radiance of what the ray meets next, in the end the
    background; the ray is bent if eta is not 1. `covered`: every ray counts as meeting the scene's only object; a ray
    that misses the object meets its nearest point. A fit needs this, since its mask stays while the surface moves.
    """
    objects = scene.objects
    hits = [item.surface.intersect(rays) for item in objects]
    if covered:
        hits = [eqx.tree_at(lambda hit: hit.inside, hits[0], jnp.ones_like(hits[0].inside))]
    seen = nearest(objects, hits)
    clear = sum(item.material.k_t is not None for item in objects)
    if clear:
        hits, seen = computed_once((hits, seen))
    reflected, k = reflected_light(scene, hits, seen, projection)
    if not clear:
        return reflected if covered else where(_any(seen), reflected, Vec3.of(scene.background))
    reflected, k = computed_once((reflected, k))
    one = jnp.ones_like(rays.direction.x)
    never = jnp.zeros(one.shape, bool)
    state = RayState(straight(rays), Vec3(one, one, one), (never,) * len(objects))
    image, state = _pass(objects, state, hits, [never] * len(objects), seen, reflected, k)

    def meet(carry: tuple[Vec3, RayState], _: None) -> tuple[tuple[Vec3, RayState], None]:
        image, state = carry
        inner = computed_once([item.surface.intersect(state.way.inner) for item in objects])
        outer = computed_once([item.surface.intersect(state.way.outer) for item in objects])
        ends = [_end(item.surface, state.way.length) for item in objects]
        within = [hit.inside & (hit.distance < end) for hit, end in zip(inner, ends, strict=True)]
        hits = [_next(*of, state.way) for of in zip(inner, outer, within, state.met, strict=True)]
        hits, seen = computed_once((hits, nearest(objects, hits)))
        reflected, k = computed_once(reflected_light(scene, hits, seen, projection))
        more, state = _pass(objects, state, outer, within, seen, reflected, k)
        return (image + more, state), None

    deeper = min(clear, len(objects) - 1)  # no depth is chosen: each object counts once, at its first hit
    if deeper:  # scanned, so that many transparent objects compile as one
        (image, state), _ = jax.lax.scan(jax.checkpoint(meet), (image, state), length=deeper)
    return image + state.weight * Vec3.of(scene.background)


def nearest(objects: Sequence[Object], hits: Sequence[Hit]) -> list[Bool[Array, "..."]]:
    """Return for each object the rays on which it is the nearest hit.

    If surfaces coincide to within rounding, an opaque one is met before a transparent one, and otherwise the first.
    """
    if len(hits) == 1:  # the distances need not be known
        return [hits[0].inside]
    first = jnp.full(hits[0].distance.shape, jnp.inf)
    index = jnp.full(first.shape, -1)
    before = 1.0 - 16.0 * float(jnp.finfo(first.dtype).eps)
    for i in sorted(range(len(hits)), key=lambda i: objects[i].material.k_t is not None):
        nearer = hits[i].inside & (hits[i].distance < before * first)
        first, index = jnp.where(nearer, hits[i].distance, first), jnp.where(nearer, i, index)
    return [index == i for i in range(len(hits))]


def reflected_light(
    scene: StackedScene, hits: Sequence[Hit], seen: Sequence[Array], projection: Projection
) -> tuple[Vec3, Coefficients]:
    """Return the radiance of the object that each ray sees, as it leaves towards the eye, and the coefficients there.

    Points are chosen before they are shaded, so many objects cost as much as one if their highlights are of one kind.
    """
    image = chosen = None
    for members in _of_one_kind(scene.objects):
        material = scene.objects[members[0]].material
        points = [_point(scene.objects[i], hits[i]) for i in members]
        hit, k = points[0]
        for i, point in zip(members[1:], points[1:], strict=True):
            hit, k = where(seen[i], point, (hit, k))
        v = projection.viewer(hit.p)
        reached = partial(_reached, scene.objects, hit) if scene.shadows else None
        light = reflection(material, k, Vec3.of(scene.ambient), scene.lights, hit.p, hit.n, v, reached)
        if scene.atmosphere is not None:
            assert hit.p is not None
            light = scene.atmosphere(light, projection.depth(hit.p, radial=scene.atmosphere.radial))
        if image is None or chosen is None:
            image, chosen = light, k
        else:
            here = _any([seen[i] for i in members])
            image = where(here, light, image)
            chosen = eqx.tree_at(lambda c: c.k_t, chosen, where(here, k.k_t, chosen.k_t))
    assert image is not None
    assert chosen is not None
    return image, chosen


def _reached(objects: Sequence[Object], hit: Hit, l: Vec3, d: Array | None) -> Array:
    """Return the points that light from the direction l, at the distance d, reaches: nothing opaque stands between.

    What is nearer than rounding to a point, or to the light, is not in between. The jump at the edge of a shadow
    contributes no derivative.
    """
    assert hit.p is not None
    near = touching(hit.distance, hit.distance)
    p, l, near = jax.lax.stop_gradient((hit.p, l, near))
    rays = Rays(p + l * near, l * jnp.ones_like(near))
    room = jnp.inf if d is None else jax.lax.stop_gradient(d) - 2.0 * near
    between = [jax.lax.stop_gradient(item.surface).intersect(rays) for item in objects if item.material.k_t is None]
    return ~_any([hit.inside & (hit.distance < room) for hit in between] or [jnp.zeros(near.shape, bool)])


def _point(item: Object, hit: Hit) -> tuple[Hit, Coefficients]:
    """Return where rays meet an object, with the normal that shades, and the coefficients there."""
    material, texture = item.material, None
    if any(pattern.over_texture for pattern in material.patterns):
        assert hit.p is not None
        texture = item.surface.texture(hit.p, hit.n)
    k = material.at(hit.p, None if texture is None else texture[0])
    return eqx.tree_at(lambda h: h.n, hit, material.shading_normal(hit.n, texture)), k


def _of_one_kind(objects: Sequence[Object]) -> list[list[int]]:
    """Return the indices of the objects that are shaded by one program: of one lobe, Fresnel term and shape of n_s.

    A material whose lobe has numbers of its own, or with several highlights, is shaded by itself.
    """
    kinds: dict[Any, list[int]] = {}
    for i, item in enumerate(objects):
        m = item.material
        alone = i if m.highlights or jax.tree.leaves((m.lobe, m.fresnel)) else None
        per_channel = np.shape(m.n_s)[-1:] == (3,)
        kinds.setdefault((type(m.lobe), type(m.fresnel), per_channel, alone), []).append(i)
    return list(kinds.values())


def _end(surface: AbstractSurface, length: Array) -> Array:
    """Return the distance up to which a surface is met on the inner part of a way: its end, plus or minus rounding.

    It is less for a solid, since one that touches the end is entered from outside. It is more for a wall or a floor,
    since the outer part may begin behind it by a rounding error.
    """
    rounding = touching(length, length)
    return length - rounding if isinstance(surface, AbstractSolid) else length + rounding


def _next(inner: Hit, outer: Hit, within: Array, met: Array, way: Way) -> Hit:
    """Return an object's first hit on the rest of a way, at its distance along the way."""
    hit = where(within, inner, eqx.tree_at(lambda h: h.distance, outer, way.length + outer.distance))
    return eqx.tree_at(lambda h: h.inside, hit, (within | outer.inside) & ~met)


def _pass(
    objects: Sequence[Object],
    state: RayState,
    outer: Sequence[Hit],
    within: Sequence[Array],
    seen: Sequence[Array],
    reflected: Vec3,
    k: Coefficients,
) -> tuple[Vec3, RayState]:
    """Return how much of the light that each ray's next object reflects arrives, and the state behind that object.

    `outer` are the objects' hits on the part of the way that is outside of any solid. A solid that is met there bends
    the ray; one that is met within another is passed straight, since media do not nest. Where Snell's law has no
    solution k_t counts as 0.
    """
    way, through = state.way, jnp.ones(seen[0].shape, bool)
    for item, hit, inside, here in zip(objects, outer, within, seen, strict=True):
        eta = item.material.eta
        if item.material.k_t is not None and eta is not None and isinstance(item.surface, AbstractSolid):
            bent, exists = bend(item.surface, state.way.outer, hit, eta)
            bends = here & ~inside
            way, through = where(bends, (bent, exists), (way, through))
    some = _any(seen)
    k_t = where(some, where(through, k.k_t, 0.0 * k.k_t), Vec3(*(jnp.ones(some.shape) for _ in range(3))))
    image = state.weight * (reflected - reflected * k_t)
    met = tuple(before | here for before, here in zip(state.met, seen, strict=True))
    return image, RayState(way, state.weight * k_t, met)


def _any(masks: Sequence[Array]) -> Array:
    """Return where any of the masks is True."""
    return jnp.any(jnp.stack(masks), 0)
