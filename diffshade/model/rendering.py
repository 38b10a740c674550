"""Rendering: from a scene and a camera to an image of linear radiance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, PRNGKeyArray

from ..core.backend import PLAINLY, SOONER, UNFUSED, check_backend, in_float64, jit_quickly, with_new_arrays
from ..core.fields import Array, check, check_kind, is_concrete
from .bands import in_bands
from .cameras import AbstractCamera, Projection, Rays
from .gbuffers import GBuffer
from .lights import AbstractEmitter, AbstractLight
from .scenes import (
    Object,
    Scene,
    StackedScene,
    check_positions,
    check_shapes,
    over_pixels_and_rest,
    stack_scene,
    together,
)
from .tracing import nearest, radiance
from .vectors import Vec3, where

MANY = 6  # transparent objects; from this number on, compiling with fusion takes longer than it saves
BLOCK = 1 << 17  # pixels that are rendered at once on a CPU, with what lies between them and the image in its cache
FEW = 2 * BLOCK  # up to so many, all are rendered at once
GIVEN = 16 * BLOCK  # the same where little lies between the pixels and the image: a G-buffer under one light, outlines
FAR = 100.0  # times as far from the origin as from the eye: float32 then keeps fewer than five digits of what is seen
MOST_PIXELS = np.iinfo(np.int32).max  # with more XLA ends the process


def render(
    scene: Scene,
    camera: AbstractCamera,
    *,
    lit: Sequence[int] | int | None = None,
    samples: int = 1,
    key: PRNGKeyArray | None = None,
) -> Float[Array, "height width channels"]:
    r"""Render a scene as linear radiance, unclamped, row 0 on top, with one sample at the centre of each pixel.

    $$ I = k_e + k_a I_a + \sum_l f_{rad} f_{ang} I_l (k_d (n \cdot l)_+ + W (v \cdot r)_+^{n_s}) $$

    This is the radiance of the nearest surface (E9). Transparent surfaces transmit what is behind them (E13), and each
    surface is fogged at its own distance (E14). The program is compiled once for each structure and shape. It is
    differentiable in every number of the scene and the camera except at silhouettes and gates, whose jumps have no
    gradient.

    XLA's CPU compiler takes about three times as long for a derivative of your own through transparent objects as it
    does without fusion: `jax.jit(f, compiler_options={"xla_disable_hlo_passes": "fusion"})`.

    Args:
        scene: Objects and lights.
        camera: Camera, whose shape is that of the image.
        lit: Indices of the lights that are on, from 0; all of them by default. Ambient light is always on.
        samples: n, at least 1: a pixel is the mean radiance of n x n rays, through the middles of n x n equal squares
            of it, so edges are smooth. The time grows with n^2, the memory does not. 1 by default. A `GBuffer` has one
            point a pixel, which all its rays meet: its outline stays as it is.
        key: A key of JAX, `jax.random.key(0)`, moves each ray to a random place within its square (Cook 1986), another
            one in each pixel: what regular rays show as moire becomes noise. None, the default, moves none.

    Returns:
        The image, in float32, or float64 if `jax_enable_x64` is on; of a scene of `bands`, a channel for each. What is
        100 times as far from the origin as from the eye, as coordinates of a map are, is computed in float64 and
        returned in float32; within a `jit` or `grad` of your own it is not.

    Raises:
        ValueError: The scene, camera or GBuffer do not fit together, `lit` is not an index of a light or names one
            twice, `samples` is no whole number from 1, or the image has 2^31 or more pixels.
        TypeError: The scene, the camera or the key is something else.
        RuntimeError: The installed jaxlib computes wrong sums.
    """
    return _rendered(scene, camera, lit, samples, key)


def render_once(
    scene: Scene, camera: AbstractCamera, lit: Sequence[int] | int | None = None, samples: int = 1
) -> Float[Array, "height width channels"]:
    """Return `render` for a scene that is drawn once or a few times: a small picture is compiled in half the time.

    The program of such a picture takes nearly twice as long, which is less than what compiling takes.
    """
    return _rendered(scene, camera, lit, samples, None, once=camera.shape[0] * camera.shape[1] <= FEW)


def _rendered(
    scene: Scene,
    camera: AbstractCamera,
    lit: Sequence[int] | int | None,
    samples: int,
    key: PRNGKeyArray | None,
    *,
    once: bool = False,
) -> Float[Array, "height width channels"]:
    check_kind("scene", scene, Scene, "Scene(Object(Sphere()), PointLight((2, 3, 4)))")
    check_kind("camera", camera, AbstractCamera, "Camera(eye=(0, 0, 4))")
    if isinstance(key, int):
        raise TypeError(f"key must be a key of JAX; got {key}. Give jax.random.key({key}).")
    if lit is not None:  # before the checks: a view of a scene of hundreds of lights needs one of them
        scene = eqx.tree_at(lambda s: s.lights, scene, select(scene, lit))
    if not isinstance(samples, int | np.integer) or samples < 1:
        raise ValueError(f"samples must be a whole number from 1; got {samples!r}. 4 gives 4 x 4 rays a pixel.")
    check((scene, camera))
    check_shapes(scene, camera)
    check_positions(scene, camera)
    if (pixels := camera.shape[0] * camera.shape[1]) > MOST_PIXELS:
        raise ValueError(
            f"a picture of {camera.shape[1]} x {camera.shape[0]} has {pixels:,} pixels, more than XLA can count. "
            "Render parts of it."
        )
    check_backend()
    if _is_far_off(scene, camera):
        with in_float64((scene, camera)) as (scene, camera):
            image = np.asarray(render(scene, camera, samples=samples, key=key), np.float32)
        return jnp.asarray(image)
    stacked = stack_scene(scene)
    alone = jax.default_backend() == "cpu" and is_concrete(jnp.zeros(()), *jax.tree.leaves((stacked, camera)))
    program = _render_unfused if alone and _takes_long(stacked) else _render
    most = GIVEN if _is_brief(scene) else FEW
    given, by_rows = (*with_new_arrays((stacked, camera)), key), alone and pixels > most
    if once and program is _render:
        return _render_plainly(*given, by_rows, int(samples))
    return program(*given, by_rows=by_rows, samples=int(samples))


def shade(scene: Scene, gbuffer: GBuffer, camera: AbstractCamera) -> Float[Array, "height width channels"]:
    """Shade a G-buffer with the material of the scene's only object, whatever that object's own shape (E9).

    Everything else is as in `render`. With several objects, put each G-buffer into the scene: `Object(gbuffer,
    material)`.

    Args:
        scene: A scene of one object, whose material and lights are used.
        gbuffer: The surface that is shaded in place of the object's own.
        camera: Camera, of the shape of the G-buffer.

    Returns:
        The image, as `render` returns it.

    Raises:
        ValueError: The scene has several objects, or as `render` raises it.
        RuntimeError: As `render` raises it.
    """
    if len(scene.objects) != 1:
        raise ValueError(
            f"shade needs a scene of one object, whose material it uses; got {len(scene.objects)} objects. "
            "Use render with Object(gbuffer, material) for each."
        )
    return render(eqx.tree_at(lambda s: s.objects[0].surface, scene, gbuffer), camera)


def intersect(scene: Scene, camera: AbstractCamera) -> GBuffer:
    """Return what a camera sees of a scene's surfaces: position, normal and mask of the nearest object's points.

    Args:
        scene: Objects; its lights are not used.
        camera: Camera, whose shape is that of the G-buffer.

    Returns:
        The G-buffer, with lengths in scene units and unit normals on the viewer's side.

    Raises:
        ValueError: The scene, camera or GBuffer do not fit together.
        RuntimeError: The installed jaxlib computes wrong sums.
    """
    check((scene, camera))
    check_shapes(scene, camera)
    check_backend()
    if _is_far_off(scene, camera):
        with in_float64((scene, camera)) as (scene, camera):
            points = jax.tree.map(np.asarray, visible_points(scene.objects, camera))
        return GBuffer(*points)
    return GBuffer(*visible_points(*with_new_arrays((scene.objects, camera))))


def select(scene: Scene, lit: Sequence[int] | int | None) -> tuple[AbstractLight, ...]:
    """Return the lights that are on."""
    if lit is None:
        return scene.lights
    lit = [int(i) for i in np.ravel(lit)]
    for i in lit:
        if not 0 <= i < len(scene.lights):
            raise ValueError(
                f"lit must hold indices of the scene's {len(scene.lights)} lights, from 0; got {i}. "
                "Count the lights, or add the missing one to the scene."
            )
    if len(set(lit)) < len(lit):
        raise ValueError(f"lit must name each light once; got {lit}. Name those that are on.")
    return tuple(scene.lights[i] for i in lit)


def pixel_rays(
    projection: Projection,
    shape: tuple[int, int],
    first_row: Array | float = 0.0,
    off: Float[Array, "2 rows width"] | None = None,
) -> Rays:
    """Return the ray of every pixel of a picture, or of some of its rows; `off`: beside the centre, down and right."""
    rows, columns = first_row + jnp.arange(shape[0], dtype=float), jnp.arange(shape[1], dtype=float)
    rows, columns = jnp.meshgrid(rows, columns, indexing="ij")
    return projection.rays(rows, columns) if off is None else projection.rays(rows + off[0], columns + off[1])


def _image(
    scene: StackedScene,
    camera: AbstractCamera,
    key: PRNGKeyArray | None = None,
    by_rows: bool = False,
    samples: int = 1,
) -> Float[Array, "height width channels"]:
    """Render all pixels at once, or some rows after others, which gives the same bits.

    At once, what lies between the pixels and the image fills the memory: of most scenes above a million pixels, half of
    the time goes into pages that the system has to clear.
    """
    projection, (height, width) = camera.projection(), camera.shape
    if not by_rows:
        return _part(scene, projection, camera.shape, 0.0, key, samples)
    count = min(max(BLOCK // width, 1), height)
    over_pixels, rest = over_pixels_and_rest(scene.objects)

    def first_row(k: Array) -> Array:
        """Return where part `k` begins; the last one begins early, so that all have the same number of rows."""
        return jnp.minimum(k * count, height - count)

    def rows_of(k: Array) -> tuple[Object, ...]:
        return jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, first_row(k), count), over_pixels)

    def add(k: Array, state: tuple[Array, tuple[Object, ...]]) -> tuple[Array, tuple[Object, ...]]:
        """Render some rows, and cut out the next ones.

        Rows that are cut and shaded in the same step are one loop to XLA, which then reads a single number at a time.
        """
        image, here = state
        part = eqx.tree_at(lambda s: s.objects, scene, together(here, rest))
        rendered = _part(part, projection, (count, width), first_row(k), key, samples)
        return jax.lax.dynamic_update_slice_in_dim(image, rendered, first_row(k), 0), rows_of(k + 1)

    none_yet = jnp.zeros((height, width, scene.width))
    return jax.lax.fori_loop(0, -(-height // count), add, (none_yet, rows_of(jnp.zeros((), int))))[0]


def _part(
    scene: StackedScene,
    projection: Projection,
    shape: tuple[int, int],
    first_row: Array | float,
    key: PRNGKeyArray | None,
    samples: int,
) -> Float[Array, "rows width channels"]:
    """Render some rows: with several samples one after another, which takes the memory of one, derivatives included."""

    def along(rays: Rays) -> Float[Array, "rows width channels"]:
        if scene.width == 3:
            return radiance(scene, rays, projection).stack()
        return in_bands(lambda grey: radiance(grey, rays, projection), scene, axis=-1)

    if samples == 1 and key is None:
        return along(pixel_rays(projection, shape, first_row))

    def add(total: Array, k: Array) -> tuple[Array, None]:
        within = jnp.full((2, *shape), 0.5) if key is None else _random_places(key, k, first_row, shape)
        square = jnp.stack([k // samples, k % samples])[:, None, None].astype(float)
        off = (square + within) / samples - 0.5
        return total + along(pixel_rays(projection, shape, first_row, off)), None

    start = jnp.zeros((*shape, scene.width))
    return jax.lax.scan(jax.checkpoint(add), start, jnp.arange(samples**2))[0] / samples**2


def _random_places(
    key: PRNGKeyArray, sample: Array, first_row: Array | float, shape: tuple[int, int]
) -> Float[Array, "2 rows width"]:
    """Return places within the squares of some pixels, from 0 to 1, the same ones however many rows are drawn."""
    of_sample = jax.random.fold_in(key, sample)
    rows = jnp.asarray(first_row).astype(int) + jnp.arange(shape[0])
    return jax.vmap(lambda row: jax.random.uniform(jax.random.fold_in(of_sample, row), (2, shape[1])), out_axes=1)(rows)


_render = jax.jit(_image, static_argnames=("by_rows", "samples"))
_render_unfused = jax.jit(_image, static_argnames=("by_rows", "samples"), compiler_options=UNFUSED)


@partial(jit_quickly, static_argnames=("by_rows", "samples"), options=PLAINLY)
def _render_plainly(
    scene: StackedScene, camera: AbstractCamera, key: PRNGKeyArray | None, by_rows: bool, samples: int
) -> Float[Array, "height width channels"]:
    return _image(scene, camera, key, by_rows, samples)


def _is_far_off(scene: Scene, camera: AbstractCamera) -> bool:
    """Whether float32 would round away what the camera sees, as of coordinates of a map: float64 has to be used."""
    if jnp.zeros(()).dtype == np.float64 or not is_concrete(*jax.tree.leaves((scene, camera))):
        return False
    eye, target = np.asarray(camera.eye, np.float64), np.asarray(camera.target, np.float64)
    return bool(np.linalg.norm(target) > FAR * np.linalg.norm(target - eye))


def _takes_long(scene: StackedScene) -> bool:
    """Whether to compile without fusion; within a program of the caller's, that choice is the caller's."""
    return sum(item.material.k_t is not None for item in scene.objects) >= MANY


def _is_brief(scene: Scene) -> bool:
    """Whether it is one opaque G-buffer under one light: to cut out its rows takes nearly as long as to shade them."""
    item, light = scene.objects[0], scene.lights[0] if len(scene.lights) == 1 else None
    opaque = len(scene.objects) == 1 and item.material.k_t is None
    return opaque and isinstance(item.surface, GBuffer) and isinstance(light, AbstractEmitter) and not scene.bands


def _inside(objects: tuple[Object, ...], rays: Rays) -> Bool[Array, "h w"]:
    """Return which rays meet an object."""
    return jnp.any(jnp.stack([item.surface.intersect(rays).inside for item in objects]), 0)


def silhouette(objects: tuple[Object, ...], camera: AbstractCamera) -> Bool[np.ndarray, "h w"]:
    """Return the pixels that show an object."""
    return _by_rows(objects, camera, _silhouette_of_rows)


def surface_seen(objects: tuple[Object, ...], camera: AbstractCamera) -> Float[np.ndarray, "h w 4"]:
    """Return the normal that each pixel shows, and the number of its object from 1; 0 where there is none."""
    return _by_rows(objects, camera, _surface_of_rows)


def _by_rows(objects: tuple[Object, ...], camera: AbstractCamera, program: Callable[..., Array]) -> np.ndarray:
    """Return what a program gives for a picture; of a large one some rows after others, so that memory stays flat."""
    height, width = camera.shape
    count = min(max(GIVEN // width, 1), height)
    over_pixels, rest = over_pixels_and_rest(objects)
    found = []
    for first in range(0, height, count):
        begin = min(first, height - count)  # the last rows begin early, so that all are as many
        here = jax.tree.map(lambda leaf, begin=begin: leaf[begin : begin + count], over_pixels)
        rows = program(together(here, rest), camera, count, float(begin))
        found.append(np.asarray(rows)[first - begin :])
    return np.concatenate(found)


@partial(jit_quickly, static_argnames="count", options=SOONER)
def _silhouette_of_rows(
    objects: tuple[Object, ...], camera: AbstractCamera, count: int, first: Float[Array, ""] | float
) -> Bool[Array, "count w"]:
    return _inside(objects, pixel_rays(camera.projection(), (count, camera.shape[1]), first))


@partial(jit_quickly, static_argnames="count", options=SOONER)
def _surface_of_rows(
    objects: tuple[Object, ...], camera: AbstractCamera, count: int, first: Float[Array, ""] | float
) -> Float[Array, "count w 4"]:
    rays = pixel_rays(camera.projection(), (count, camera.shape[1]), first)
    hits = [item.surface.intersect(rays) for item in objects]
    found = jnp.zeros((count, camera.shape[1], 4), np.float32)
    for i, (hit, seen) in enumerate(zip(hits, nearest(objects, hits), strict=True)):
        of_object = jnp.concatenate([hit.n.stack(), jnp.full((*seen.shape, 1), i + 1.0)], -1)
        found = jnp.where(seen[..., None], of_object.astype(np.float32), found)
    return found


@jax.jit
def visible_points(
    objects: tuple[Object, ...], camera: AbstractCamera
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w 3"] | None, Bool[Array, "h w"]]:
    """Return the normals and positions of the nearest objects' points, and the pixels that show one."""
    rays = pixel_rays(camera.projection(), camera.shape)
    hits = [item.surface.intersect(rays) for item in objects]
    n = p = Vec3.of(jnp.zeros((*camera.shape, 3)))
    for hit, seen in zip(hits, nearest(objects, hits), strict=True):
        n = where(seen, hit.n, n)
        p = None if hit.p is None or p is None else where(seen, hit.p, p)
    return n.stack(), None if p is None else p.stack(), _inside(objects, rays)
