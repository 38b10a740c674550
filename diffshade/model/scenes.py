"""Scenes: objects and lights together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int, Shaped

from ..core.fields import (
    Array,
    Checked,
    Colour,
    as_colour,
    as_surround,
    check_kind,
    is_concrete,
    is_over_pixels,
    parameter,
)
from ..core.words import with_article
from .attenuation import AbstractAtmosphere
from .bands import RGB, as_bands, check_widths, of_bands, widened
from .cameras import AbstractCamera
from .gbuffers import GBuffer
from .lights import AbstractLight
from .lobes import AbstractLobe, AbstractReflectance
from .materials import Material
from .patterns import AbstractPattern
from .surfaces import AbstractSolid, AbstractSurface


class Object(Checked):
    """A surface and its material.

    Args:
        surface: A shape or a `GBuffer`.
        material: Material of the surface; by default `Material()`, whose coefficients are 0.
        name: One word of letters, digits and _ that appears in the names of the object's parameters:
            `objects.ball.material.k_d`, or `ball.material.k_d`, instead of `objects.0.material.k_d`. No name by
            default.

    Raises:
        ValueError: The name is not one word.
        TypeError: The surface or the material is of the wrong kind.
    """

    surface: AbstractSurface
    material: Material = eqx.field(default_factory=Material)
    name: str = eqx.field(static=True, default="")

    def check_together(self) -> None:
        check_kind("Object.surface", self.surface, AbstractSurface, "Sphere(radius=1)")
        check_kind("Object.material", self.material, Material, "Material(k_d=0.7)")
        if self.name and not (isinstance(self.name, str) and self.name.isidentifier()):
            raise ValueError(f"Object.name must be one word, of letters, digits and _; got {self.name!r}. Rename it.")


def as_tuple(value: Any) -> tuple:
    """Make a tuple of one thing or several."""
    return tuple(value) if isinstance(value, Iterable) else (value,)


class Scene(Checked):
    """Objects, the lights that shine on them, and what surrounds them.

    The camera sees the nearest object and, through an object with k_t, what is behind it. Where surfaces coincide, it
    sees an opaque one; of two opaque or two transparent ones, the one that comes first in the list. The cost is linear
    in lights, pixels and opaque objects, and quadratic in transparent ones. A GBuffer (a mesh or a map) cannot be in a
    scene with a `Sphere` or `Box` that bends rays (k_t with an eta other than 1): the GBuffer contains only what its
    camera's own rays see. By default a light reaches every point that faces it, through any object, as in the lectures;
    with `shadows=True` only if nothing opaque stands between. There is no interreflection.

    Args:
        objects: One object or several, in any order, with different names.
        lights: Any number of lights of any kind; none by default.
        ambient: I_a, RGB or grey, at least 0, never attenuated (E1); 1 by default.
        background: What a ray that meets nothing sees, RGB or grey, at least 0, never fogged; 0 (black) by default.
        atmosphere: `DepthCueing` or `Fog` (E14); None by default.
        shadows: Whether opaque objects keep light from what is behind them; False by default. Objects with k_t cast
            none. Where a shadow ends the image jumps, which contributes no derivative: a fit can find materials and
            intensities under shadows, but should not be asked for what moves them.
        bands: What the channels are in place of red, green and blue: how many (1 to 40), their wavelengths in nm,
            or their names, which parameters then bear: `k_d.450nm`. Every colour is then one number, or one for each
            band. RGB by default.

    Raises:
        ValueError: A colour has the wrong shape, another number of channels than the scene, is not finite or is below
            0; there is no object; two objects have the same name; there are two bands or more than 40; or a GBuffer
            cannot be in the scene: it has no positions beside other objects, glass bends rays, or there are shadows.
        TypeError: An object, a light, a colour or the atmosphere is of the wrong kind.
    """

    objects: tuple[Object, ...] = eqx.field(converter=as_tuple)
    lights: tuple[AbstractLight, ...] = eqx.field(converter=as_tuple, default=())
    ambient: Colour = eqx.field(converter=as_surround, default=1.0, metadata=parameter("light", lower=0, gauge=-1))
    background: Colour = eqx.field(converter=as_surround, default=0.0, metadata={"lower": 0})
    atmosphere: AbstractAtmosphere | None = None
    shadows: bool = eqx.field(static=True, default=False)
    bands: tuple[str, ...] = eqx.field(converter=as_bands, static=True, default=())

    def __post_init__(self) -> None:
        self.ambient, self.background = as_colour(self.ambient), as_colour(self.background)
        if (bands := len(as_bands(self.bands))) not in (0, 3):  # greys, which were made RGB, get the scene's bands
            self.objects, self.lights = (widened(as_tuple(of), bands) for of in (self.objects, self.lights))
            self.ambient, self.background = (of_bands(of, bands) for of in (self.ambient, self.background))
            self.atmosphere = widened(self.atmosphere, bands)

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of its channels: "r", "g" and "b", or those of its bands."""
        return self.bands or RGB

    def check_together(self) -> None:
        if not isinstance(self.shadows, bool):
            raise TypeError(f"Scene.shadows must be True or False; got {self.shadows!r}. Give one of the two.")
        for i, item in enumerate(self.objects):
            check_kind(f"Scene.objects[{i}]", item, Object, "Object(Sphere(), Material(k_d=0.7))")
        for i, light in enumerate(self.lights):
            check_kind(f"Scene.lights[{i}]", light, AbstractLight, "PointLight((2, 3, 4))")
            if not hasattr(light, "intensity"):
                raise TypeError(
                    f"Scene.lights[{i}] must have a field named intensity, which is 0 where the light is off; got "
                    f"{with_article(type(light).__name__)} without one. Give the colour of its light that name."
                )
            for j, item in enumerate(self.objects):
                lobe = item.material.lobe
                if light.specular is not None and not isinstance(lobe, AbstractLobe):
                    raise ValueError(
                        f"lights[{i}].specular needs materials that say which part of their reflection is diffuse; got "
                        f"{with_article(type(lobe).__name__)}, a whole reflectance, in objects[{j}]. Leave specular "
                        "out, or derive the lobe from AbstractLobe."
                    )
        if self.atmosphere is not None:
            check_kind("Scene.atmosphere", self.atmosphere, AbstractAtmosphere, "Fog(density=0.1, I_dc=0.5)")
        names = [item.name for item in self.objects if item.name]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"objects must have different names; got {name!r} twice. Rename one of them.")
        if not self.objects:
            raise ValueError("Scene.objects must hold at least one Object; got none. Give one: Object(Sphere()).")
        buffers = [item.surface for item in self.objects if isinstance(item.surface, GBuffer)]
        if len(self.objects) > 1 and any(buffer.position is None for buffer in buffers):
            raise ValueError(
                "a scene of several objects needs to know which is in front; got a GBuffer without positions. "
                "Give GBuffer.position, or make it the only object."
            )
        if self.shadows and buffers:
            raise ValueError(
                "a GBuffer casts no shadow, since only what its camera sees is known of it; got one in a scene with "
                "shadows=True. Give a Mesh, or another shape."
            )
        check_widths(self, self.bands)
        for i, item in enumerate(self.objects):
            _check_maps(i, item)
        seen_as_they_are = buffers or any(item.material.maps for item in self.objects)
        for i, item in enumerate(self.objects if seen_as_they_are else ()):
            if bends(item) and is_concrete(eta := item.material.eta) and eta != 1.0:
                raise ValueError(
                    "a GBuffer, or a coefficient over the pixels, cannot stand in a scene with glass that bends rays, "
                    f"since it knows only what the camera's own rays see; got eta {eta} in objects[{i}]. Give eta=1, "
                    "or a Sphere, Plane or Box for the GBuffer and a Texture for the coefficient."
                )


def _check_maps(i: int, item: Object) -> None:
    """Refuse maps of several shapes, and textures on a surface without texture coordinates."""
    shapes = [np.shape(of)[:2] for of in item.material.maps.values()]
    if len(set(shapes)) > 1:
        raise ValueError(
            f"objects[{i}].material has coefficients over pixels of {shapes[0]} and {shapes[-1]}. Resize one of them."
        )
    if any(pattern.over_texture for pattern in item.material.patterns) and not item.surface.is_textured:
        raise ValueError(
            f"objects[{i}].surface, {with_article(type(item.surface).__name__)}, has no texture coordinates for a "
            "Texture. Give the coefficient as an array over the pixels, or another surface."
        )


def bends(item: Object) -> bool:
    """Whether an object transmits rays and may bend them."""
    material = item.material
    return isinstance(item.surface, AbstractSolid) and material.k_t is not None and material.eta is not None


def check_shapes(scene: Scene, camera: AbstractCamera) -> None:
    """Refuse a G-buffer, or a coefficient over the pixels, that is not of the camera's shape."""
    for i, item in enumerate(scene.objects):
        if isinstance(item.surface, GBuffer) and item.surface.mask.shape != camera.shape:
            raise ValueError(
                f"objects[{i}].surface must have one normal a pixel; got a GBuffer of shape {item.surface.mask.shape} "
                f"for a camera of shape {camera.shape}. Make the two the same."
            )
        for name, of in item.material.maps.items():
            if np.shape(of)[:2] != camera.shape:
                raise ValueError(
                    f"objects[{i}].material.{name} must have one value a pixel; got an array over {np.shape(of)[:2]} "
                    f"for a camera of shape {camera.shape}. Make the two the same."
                )


def check_positions(scene: Scene, camera: AbstractCamera) -> None:
    """Refuse a G-buffer without positions where something needs them."""
    needing = ["a camera with local_viewer=True"] * camera.local_viewer
    needing += [with_article(type(light).__name__) for light in scene.lights if light.is_local]
    needing += [] if scene.atmosphere is None else [with_article(type(scene.atmosphere).__name__)]
    for item in scene.objects:
        if isinstance(item.surface, GBuffer) and item.surface.position is None:
            over_points = [pattern for pattern in item.material.patterns if not pattern.over_texture]
            here = needing + [with_article(type(pattern).__name__) for pattern in over_points]
            if here:
                raise ValueError(
                    f"{here[0]} needs to know where the surface is; got a GBuffer without positions. Give "
                    "GBuffer.position, or use directional lights and a camera with local_viewer=False."
                )


class StackedScene(eqx.Module):
    """A scene as compiled programs take it: the lights of one kind stacked along a leading axis.

    A hundred lights then compile as one. Two lights are of one kind when their tree structures and shapes are
    equal: the same class, the same static fields, and tables of one size.
    """

    objects: tuple[Object, ...]
    lights: tuple[AbstractLight, ...]
    ambient: Shaped[Array, "channels"] = eqx.field(metadata={"colour": True})
    background: Shaped[Array, "channels"] = eqx.field(metadata={"colour": True})
    atmosphere: AbstractAtmosphere | None
    shadows: bool = eqx.field(static=True, default=False)

    @property
    def width(self) -> int:
        """How many channels its colours have."""
        return self.background.shape[-1]


def over_pixels_and_rest(objects: tuple[Object, ...]) -> tuple[tuple[Object, ...], tuple[Object, ...]]:
    """Return what comes with the pixels (G-buffers, coefficients over them) and all else; None where the other is."""
    leaves, structure = jax.tree.flatten(objects, is_leaf=_stays_whole)
    over_pixels = [leaf if _comes_with_pixels(leaf) else None for leaf in leaves]
    rest = [None if of is not None else leaf for of, leaf in zip(over_pixels, leaves, strict=True)]
    return structure.unflatten(over_pixels), structure.unflatten(rest)


def together(over_pixels: tuple[Object, ...], rest: tuple[Object, ...]) -> tuple[Object, ...]:
    """Return objects with what comes with the pixels put back in its place."""
    return eqx.combine(over_pixels, rest, is_leaf=_stays_whole)


def with_pixels(scene: Scene, pixels: Int[np.ndarray, " n"]) -> Scene:
    """Return a scene as `SomePixels` of its camera see it, given by their flat indices."""
    over_pixels, rest = over_pixels_and_rest(scene.objects)
    here = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[pixels][None], over_pixels)
    return eqx.tree_at(lambda s: s.objects, scene, together(here, rest))


def _comes_with_pixels(node: Any) -> bool:
    return isinstance(node, GBuffer) or is_over_pixels(node)


def _stays_whole(node: Any) -> bool:
    """Whether a node is not looked into: the arrays of a pattern or a lobe are not over the pixels."""
    return node is None or isinstance(node, AbstractSurface | AbstractPattern | AbstractReflectance)


def stack_scene(scene: Scene) -> StackedScene:
    """Stack the lights of a scene by kind, kinds in the order of their first lights."""
    kinds = [[scene.lights[i] for i in members] for members in light_kinds(scene.lights)]
    lights = tuple(jax.tree.map(_stack, *kind) for kind in kinds)
    return StackedScene(scene.objects, lights, scene.ambient, scene.background, scene.atmosphere, scene.shadows)


def light_kinds(lights: Sequence[AbstractLight]) -> list[list[int]]:
    """Return the indices of the lights of each kind."""
    kinds: dict[Any, list[int]] = {}
    for i, light in enumerate(lights):
        shapes = tuple(np.shape(leaf) for leaf in jax.tree.leaves(light))
        kinds.setdefault((jax.tree.structure(light), shapes), []).append(i)
    return list(kinds.values())


def _stack(*leaves: Any) -> Any:
    return (jnp if any(isinstance(leaf, jax.Array) for leaf in leaves) else np).stack(leaves)
