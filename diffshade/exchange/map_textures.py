"""Textures of maps: what every pixel of a mesh shows in another program, and how far that is from the maps.

Highlights are refitted for a few exponents, as for a material without maps, and interpolated between them. The error is
measured by computing the other program's picture, from the textures as they are stored, under three lights.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ..core.thresholds import UNCLIPPED_PERCENT
from ..io.encodings import srgb_decode, srgb_encode
from ..io.files import write_file
from ..io.image_formats import encode
from ..io.triangles import Triangles, tracer
from ..model.cameras import camera_axes
from ..model.lights import DirectionalLight
from ..model.lobes import AbstractLobe
from ..model.materials import Highlight, Material
from ..texels.heights.differences import rays_of
from ..texels.heights.mesh import HeightMesh
from ..texels.maps import TexelMaps
from ..texels.status import OUTSIDE

LIGHTS = ((0.0, 0.0, 1.0), (-0.6, 0.4, 0.69282), (0.8, 0.0, 0.6))  # toward the light, in the camera's axes
EXPONENTS = 6  # n_s for which a highlight is refitted, where every texel has its own
GREY = 0.1  # k_s at which a highlight is refitted where a program is not linear in it

Image = Float[np.ndarray, "h w c"]


class MapSurface(NamedTuple):
    """What maps show at each pixel, in the camera's axes: right, up, toward the camera."""

    inside: Bool[np.ndarray, "h w"]
    k_d: Float[np.ndarray, "h w 3"]
    k_s: Float[np.ndarray, "h w 3"]
    k_e: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "h w 3"]
    frame: Float[np.ndarray, "h w 3 3"]
    """Tangent, bitangent and normal of the mesh."""
    brightness: float = 1.0
    """By which k_d and k_s were multiplied, as lights of this intensity would do."""

    @property
    def most(self) -> float:
        """The largest k_d, but for a few texels."""
        return float(np.percentile(self.k_d[self.inside].max(-1), UNCLIPPED_PERCENT))

    def brightened(self) -> MapSurface:
        """Return the surface with k_d and k_s multiplied by 1 over the largest k_d, as nothing where all is black."""
        by = 1.0 / self.most if self.most > 0.0 else 1.0
        return self._replace(k_d=by * self.k_d, k_s=by * self.k_s, brightness=by)

    @property
    def of_mesh(self) -> Float[np.ndarray, "h w 3"]:
        """The measured normals in the mesh's tangent space."""
        return np.einsum("hwij,hwj->hwi", self.frame, self.normal)

    def normals_of(self, stored: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
        """Return the normals, in the camera's axes, that a stored normal map has on the mesh."""
        n = np.einsum("hwij,hwi->hwj", self.frame, 2.0 * stored - 1.0)
        return n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-9)


def surface_of(maps: TexelMaps, mesh: HeightMesh) -> MapSurface:
    """Return what maps show at each pixel of a mesh; outside the object, what its nearest pixel shows."""
    from scipy.ndimage import distance_transform_edt

    item: Any = maps.scene.objects[0]
    inside = maps.status != OUTSIDE
    near = tuple(np.asarray(distance_transform_edt(~inside, return_distances=False, return_indices=True)))
    shape = inside.shape

    def coefficient(name: str) -> Float[np.ndarray, "h w 3"]:
        value = maps.values.get(name, np.asarray(getattr(item.material, name)))
        return np.broadcast_to(np.asarray(value, np.float64), (*shape, 3))[near]

    axes = np.stack(camera_axes(maps.camera))
    free = maps.values.get("normal")
    normal = item.surface.normal if free is None else free  # of a G-buffer, where it was known
    frame = np.stack(_frames(mesh, inside.shape), -2)[near] @ axes.T
    k_e = np.broadcast_to(np.asarray(item.material.k_e, np.float64), (3,))
    normal = (np.asarray(normal, np.float64) @ axes.T)[near]
    return MapSurface(inside, coefficient("k_d"), coefficient("k_s"), k_e, normal, frame)


def _frames(mesh: HeightMesh, shape: tuple[int, int]) -> tuple[Float[np.ndarray, "h w 3"], ...]:
    """Return tangent, bitangent and normal of the mesh at each pixel, world coordinates, interpolated."""
    from scipy.spatial import KDTree

    rays = rays_of(mesh.camera)
    start, toward = rays.start.reshape(-1, 3), -rays.toward.reshape(-1, 3)
    hits = tracer(Triangles(mesh.corner, mesh.face))(start, toward)
    place = (np.indices(shape).reshape(2, -1).T + 0.5) / shape
    ahead = np.flatnonzero(mesh.normal @ camera_axes(mesh.camera)[2] > 0.0)
    corner = ahead[KDTree(mesh.uv[ahead, ::-1]).query(place)[1]]  # for pixels at the border, whose rays miss
    found = []
    for of in (mesh.normal, mesh.tangent):
        at = of[corner]
        at[hits.ray] = np.einsum("rc,rcx->rx", hits.weight, of[mesh.face[hits.face]])
        found.append((at / np.maximum(np.linalg.norm(at, axis=-1, keepdims=True), 1e-12)).reshape(*shape, 3))
    n, t = found
    return t, np.cross(n, t), n


class Highlights(NamedTuple):
    """A few grey materials whose highlights stand for those of all texels; k_d is typical, k_s is `GREY`."""

    materials: tuple[Material, ...]
    place: Float[np.ndarray, "h w"] | None
    """Of each texel among them, 0 for the first; None where one stands for all."""
    light: Float[np.ndarray, " materials"]
    """Sum of the squares of k_s of the texels that each stands for."""

    def at_texels(
        self, numbers: Float[np.ndarray, "materials numbers"]
    ) -> Float[np.ndarray, "h w numbers"] | Float[np.ndarray, " numbers"]:
        """Return numbers of each material at each texel, interpolated; those of the one that stands for all."""
        if self.place is None:
            return numbers[0]
        at = np.arange(len(numbers))
        return np.stack([np.interp(self.place, at, column) for column in numbers.T], -1)


def highlights_of(maps: TexelMaps, brightness: float = 1.0) -> Highlights:
    """Return materials for the one highlight of all texels; or for a few n_s, where every texel has its own."""
    material = maps.scene.objects[0].material
    lobe = material.lobe
    assert isinstance(lobe, AbstractLobe)
    k_d = brightness * maps.values.get("k_d", np.asarray(material.k_d)[None])
    known = maps.known if maps.known.any() else maps.status != OUTSIDE
    plain: dict[str, Any] = {
        "k_d": float(np.clip(np.median(k_d[known] if k_d.ndim == 3 else k_d), 1e-3, 0.9)),
        "lobe": lobe,
    }

    def one(**highlight: Any) -> Highlights:
        return Highlights((Material(**highlight, **plain),), None, np.ones(1))

    if maps.highlights:
        (weight, n_s), *others = ((float(np.mean(w)), n) for w, n in maps.highlights)
        further = tuple(Highlight(k_s=GREY * w, n_s=n, lobe=lobe) for w, n in others)
        return one(k_s=GREY * weight, n_s=n_s, highlights=further)
    if "n_s" not in maps.values:
        return one(k_s=GREY, n_s=float(np.mean(np.asarray(material.n_s))))
    n_s = np.asarray(maps.values["n_s"][..., 0], np.float64)
    shines = maps.determined & (n_s > 0)
    if not shines.any():
        return one(k_s=GREY, n_s=10.0)
    low, high = (float(n) for n in np.maximum(np.percentile(n_s[shines], (0.5, UNCLIPPED_PERCENT)), 1.0))
    knots = np.unique(np.geomspace(low, high, EXPONENTS))
    place = np.interp(np.log(np.clip(n_s, knots[0], knots[-1])), np.log(knots), np.arange(len(knots)))
    k_s = np.broadcast_to(maps.values.get("k_s", np.asarray(material.k_s)), (*n_s.shape, 3))
    light = np.bincount(np.rint(place[shines]).astype(int), (k_s[shines] ** 2).sum(-1), len(knots))
    return Highlights(tuple(Material(k_s=GREY, n_s=float(n), **plain) for n in knots), place, light)


def stored(values: Image, *, srgb: bool = False) -> tuple[UInt8[np.ndarray, "h w c"], Image]:
    """Return values from 0 to 1 as 8 bits, and what they are read back as."""
    values = np.clip(values, 0.0, 1.0)
    bytes_ = np.rint(255.0 * (np.asarray(srgb_encode(values)) if srgb else values)).astype(np.uint8)
    back = bytes_ / 255.0
    return bytes_, np.asarray(srgb_decode(back)) if srgb else back


class Textures(NamedTuple):
    """What a format holds of maps, and how far it is from them."""

    pictures: dict[str, UInt8[np.ndarray, "h w c"]]
    material: dict[str, Any]
    """The material that shows them, by the format's own names."""
    difference: Difference


class Difference(NamedTuple):
    """How far another program's pictures are from those of maps, over pixels, channels and three lights."""

    rms: float
    largest: float
    radiance: float
    """Root mean square of the maps' own radiance."""
    unexplained: float
    """Root mean square of the light that no material explains."""

    def __str__(self) -> str:
        """Return the sentence that states it."""
        beyond = (
            f" {self.unexplained:.2g} of it is light beyond the model, interpolated, which no material holds."
            if self.unexplained
            else ""
        )
        return (
            f"under three lights of intensity 1 the radiance differs from that of the maps by {self.rms:.2g} (rms) and "
            f"{self.largest:.2g} (at most), where it is {self.radiance:.2g} (rms).{beyond}"
        )


def attributes_of(mesh: HeightMesh) -> dict[str, Float[np.ndarray, "n size"]]:
    """Return what a file holds of each corner of a mesh; the error of a height is -1 where it is infinite."""
    return {
        "position": mesh.corner,
        "normal": mesh.normal,
        "tangent": np.concatenate([mesh.tangent, np.ones((len(mesh.corner), 1))], -1),
        "uv": mesh.uv,
        "height_error": np.where(np.isfinite(mesh.errors), mesh.errors, -1.0)[:, None],
    }


def uv_from_below(mesh: HeightMesh) -> Float[np.ndarray, "n 2"]:
    """Return the place of each corner in the image with v up."""
    return np.stack([mesh.uv[:, 0], 1.0 - mesh.uv[:, 1]], -1)


def write_pictures(path: Path, pictures: Mapping[str, UInt8[np.ndarray, "h w c"]]) -> dict[str, str]:
    """Write pictures as PNG beside the file of a mesh, and return what they are named there."""
    names = {name: f"{path.stem}_{name}.png" for name in pictures}
    for name, picture in pictures.items():
        write_file(path.with_name(names[name]), encode(".png", picture))
    return names


def difference(
    maps: TexelMaps, surface: MapSurface, shade: Callable[[Float[np.ndarray, "3"]], Float[np.ndarray, "h w 3"]]
) -> Difference:
    """Return how far another program's pictures are from those of maps.

    Args:
        maps: The maps.
        surface: What they show.
        shade: Returns the program's radiance under a light in this direction, in the camera's axes, of intensity 1.
    """
    axes, off, own, beyond = np.stack(camera_axes(maps.camera)), [], [], []
    plain = dataclasses.replace(maps, unexplained=None)
    for toward in LIGHTS:
        light = DirectionalLight(-np.asarray(toward) @ axes, surface.brightness)
        given = maps.shade(light)[surface.inside]
        off.append(shade(np.asarray(toward) / np.linalg.norm(toward))[surface.inside] - given)
        own.append(given)
        beyond.append(given - plain.shade(light)[surface.inside] if maps.unexplained is not None else 0.0 * given)
    rms, size, rest = (float(np.sqrt(np.mean(np.square(of)))) for of in (off, own, beyond))
    return Difference(rms, float(np.abs(off).max()), size, rest)
