"""A mesh with maps in three.js's JSON: a BufferGeometry and a MeshPhongMaterial, for THREE.ObjectLoader.

The material has one shininess n and one specular colour c for all texels. A texel has its diffuse colour (map), its
normal (normalMap, in the mesh's tangent space, green along normal x tangent) and, of specularMap's red, a strength s:

    I (n.l) (diffuse + s F (n/2 + 1)/4 (n.h)^n)

F is Schlick's weight of c (see `threejs`).
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.thresholds import UNCLIPPED_PERCENT
from ..io.files import write_file
from ..io.gltf_files import uri_of
from ..texels.heights.mesh import HeightMesh
from ..texels.maps import TexelMaps
from .lobe_refits import N_S_RANGE, Shape, lowest
from .map_textures import (
    GREY,
    MapSurface,
    Textures,
    attributes_of,
    difference,
    highlights_of,
    stored,
    uv_from_below,
    write_pictures,
)
from .reference import Reference, joined, radiance, reference_of
from .threejs import fresnel, from_hex, lobe, to_hex

# three.js's constants: stretched by the mesh's UV, clamped at the edges, linear, and by MIP maps where it is small
SAMPLING = {"mapping": 300, "wrap": [1001, 1001], "minFilter": 1008, "magFilter": 1006}


TWO_SIDED = {"side": 2}  # three.js's constant


def textures(maps: TexelMaps, surface: MapSurface) -> Textures:
    """Return the textures of maps, the material that uses them, and how far it is from the maps."""
    n_s, size = _highlight(maps, surface.brightness)
    k = surface.k_s * size[..., None]
    mean = k[surface.inside].mean(0)
    hue = mean / max(float(mean.max()), 1e-9) if mean.any() else np.ones(3)
    strength = k @ hue / (hue @ hue)
    most = float(np.clip(np.percentile(strength[surface.inside], UNCLIPPED_PERCENT), 1e-3, 1.0))
    pictures, back = {}, {}
    for name, values, srgb in (
        ("map", surface.k_d, True),
        ("normalMap", 0.5 * (surface.of_mesh + 1.0), False),
        ("specularMap", (strength / most)[..., None], False),
    ):
        pictures[name], back[name] = stored(values, srgb=srgb)
    specular = to_hex(most * hue)
    glow = max(1.0, float(surface.k_e.max()))
    material = {
        "type": "MeshPhongMaterial",
        "name": "maps",
        **TWO_SIDED,
        "color": 0xFFFFFF,
        "specular": specular,
        "shininess": n_s,
        "emissive": to_hex(surface.k_e / glow),
        "emissiveIntensity": glow,
    }
    normal, c, k_e = surface.normals_of(back["normalMap"]), from_hex(specular), from_hex(to_hex(surface.k_e / glow))

    def shade(l: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w 3"]:
        points = Reference(normal, l)
        grazing = fresnel(points.v_h)
        weight = back["specularMap"] * (c * (1.0 - grazing) + grazing)
        return points.n_l[..., None] * back["map"] + weight * lobe(points, n_s)[..., None] + glow * k_e

    return Textures(pictures, material, difference(maps, surface, shade))


def _highlight(maps: TexelMaps, brightness: float) -> tuple[float, Float[np.ndarray, "*texels"]]:
    """Return the one shininess that is nearest to the highlights of maps, and the size of its highlight at each texel.

    The size is the strength times the specular colour of a k_s of 1, one number where all texels share it.
    """
    highlights = highlights_of(maps, brightness)
    each = [reference_of(material) for material in highlights.materials]
    points = joined(each)
    diffuse = points.n_l[:, None]
    targets = [radiance(material, points) - diffuse * np.asarray(material.k_d) for material in highlights.materials]
    shape = Shape(partial(lobe, points), N_S_RANGE)

    def cost(log_n: float) -> float:
        n = float(np.exp(log_n))
        off = [np.sum((shape.of(n, shape.weights(n, target)) - target) ** 2) for target in targets]
        return float(np.dot(highlights.light, off))

    n_s = float(np.exp(lowest(cost, *np.log(N_S_RANGE))))
    sizes = np.array([[shape.weights(n_s, target)[0] / GREY] for target in targets])
    return n_s, highlights.at_texels(sizes)[..., 0]


def write(path: Path, mesh: HeightMesh, found: Textures | None, notes: list[str]) -> list[Path]:
    """Write the JSON, and pictures beside it; return the paths."""
    pictures, material = (
        ({}, {"type": "MeshPhongMaterial", **TWO_SIDED}) if found is None else (found.pictures, found.material)
    )
    names = write_pictures(path, pictures)
    attributes = attributes_of(mesh) | {"uv": uv_from_below(mesh)}
    document: dict[str, Any] = {
        "metadata": {"version": 4.6, "type": "Object", "generator": "diffshade"},
        "geometries": [
            {
                "uuid": "surface",
                "type": "BufferGeometry",
                "data": {
                    "attributes": {name: _numbers(array) for name, array in attributes.items()},
                    "index": {"type": "Uint32Array", "array": mesh.face.ravel().tolist()},
                },
            }
        ],
        "materials": [{"uuid": "maps", **material, **{name: name for name in pictures}}],
        "textures": [_texture(name) for name in pictures],
        "images": [{"uuid": name, "url": uri_of(file)} for name, file in names.items()],
        "object": {
            "uuid": "object",
            "type": "Mesh",
            "name": path.stem,
            "geometry": "surface",
            "material": "maps",
            "userData": {"diffshade": notes},
        },
    }
    write_file(path, json.dumps(document, separators=(",", ":"), ensure_ascii=False))
    return [*map(path.with_name, names.values()), path]


def _numbers(array: Float[np.ndarray, "n size"]) -> dict[str, Any]:
    """Return an attribute of a BufferGeometry, to seven digits."""
    digits = [float(f"{x:.7g}") for x in array.ravel()]
    return {"itemSize": array.shape[1], "type": "Float32Array", "array": digits, "normalized": False}


def _texture(name: str) -> dict[str, Any]:
    """Return a texture that shows the picture of the same name."""
    return {
        "uuid": name,
        "name": name,
        "image": name,
        **SAMPLING,
        "flipY": True,
        "colorSpace": "srgb" if name == "map" else "",
    }
