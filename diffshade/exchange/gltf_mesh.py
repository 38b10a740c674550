"""glTF 2.0 with a mesh and maps: base colour, normals in the mesh's tangent space, roughness and specular reflectance.

A normal map's red is along the tangent (the camera's right), its green along normal x tangent (up), its blue out of the
mesh. Colours are sRGB. KHR_materials_specular holds the reflectance at normal incidence: its largest channel in alpha,
its hue in the colours.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.thresholds import UNCLIPPED_PERCENT
from ..io.files import write_file
from ..io.gltf_files import uri_of
from ..io.image_formats import encode
from ..model.materials import Material
from ..texels.heights.mesh import HeightMesh
from ..texels.maps import TexelMaps
from .gltf import fitted
from .map_textures import (
    GREY,
    MapSurface,
    Textures,
    attributes_of,
    difference,
    highlights_of,
    stored,
    write_pictures,
)
from .metallic_roughness import F0, MetallicRoughness
from .reference import EDGE, Reference

ATTRIBUTES = ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_0", "_HEIGHT_ERROR")
# What glTF writes for numbers of a kind, and for their use: floats are attributes, unsigned ones indices (section 5).
COMPONENTS = {"f": 5126, "u": 5125}
TARGETS = {"f": 34962, "u": 34963}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


def textures(maps: TexelMaps, surface: MapSurface) -> Textures:
    """Return the textures of maps, the material that uses them, and how far it is from the maps."""
    highlights = highlights_of(maps, surface.brightness)
    numbers = highlights.at_texels(np.array([_numbers(material) for material in highlights.materials]))
    roughness, head_on, base = np.moveaxis(numbers, -1, 0)
    f0 = np.clip(surface.k_s * head_on[..., None], 0.0, 1.0)
    most = f0.max(-1, keepdims=True)
    strength = float(np.clip(np.percentile(most[surface.inside], UNCLIPPED_PERCENT), 1e-3, 1.0))
    hue = np.where(most > 0.0, f0 / np.where(most > 0.0, most, 1.0), 1.0)
    pictures, back = {}, {}
    for name, values, srgb in (
        ("colour", surface.k_d * base[..., None], True),
        ("normal", 0.5 * (surface.of_mesh + 1.0), False),
        ("hue", hue, True),
        ("strength", np.minimum(most / strength, 1.0), False),
    ):
        pictures[name], back[name] = stored(values, srgb=srgb)
    pictures["specular"] = np.concatenate([pictures.pop("hue"), pictures.pop("strength")], -1)
    alone = np.ndim(roughness) == 0
    if not alone:
        filled = np.stack([np.zeros_like(roughness), roughness, np.zeros_like(roughness)], -1)
        pictures["roughness"], back["roughness"] = stored(filled)
    rough = np.broadcast_to(roughness if alone else back["roughness"][..., 1], surface.inside.shape)
    normal = surface.normals_of(back["normal"])

    def shade(l: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w 3"]:
        return reflected(normal, l, back["colour"], back["hue"] * back["strength"] * strength, rough) + surface.k_e

    factors: dict[str, Any] = (
        {"roughnessFactor": float(roughness)} if alone else {"metallicRoughnessTexture": "roughness"}
    )
    material: dict[str, Any] = {
        "name": "maps",
        "doubleSided": True,
        "pbrMetallicRoughness": {"baseColorTexture": "colour", "metallicFactor": 0.0, **factors},
        "normalTexture": "normal",
        "extensions": {
            "KHR_materials_specular": {
                "specularFactor": strength,
                "specularTexture": "specular",
                "specularColorFactor": [1.0 / F0] * 3,
                "specularColorTexture": "specular",
            }
        },
    }
    if surface.k_e.any():
        glow = max(1.0, float(surface.k_e.max()))
        material["emissiveFactor"] = (surface.k_e / glow).tolist()
        material["extensions"] |= {"KHR_materials_emissive_strength": {"emissiveStrength": glow}} if glow > 1.0 else {}
    return Textures(pictures, material, difference(maps, surface, shade))


def _numbers(material: Material) -> tuple[float, float, float]:
    """Return roughness, reflectance at normal incidence over k_s, and base colour over k_d, of a grey material."""
    surface, *_ = fitted(material)
    return surface.roughness, float(surface.head_on.mean()) / GREY, float(surface.base.mean() / np.mean(material.k_d))


def reflected(
    normal: Float[np.ndarray, "h w 3"],
    l: Float[np.ndarray, "3"],
    base: Float[np.ndarray, "h w 3"],
    head_on: Float[np.ndarray, "h w 3"],
    roughness: Float[np.ndarray, "h w"],
) -> Float[np.ndarray, "h w 3"]:
    """Return the radiance of textures under a light of pi in the direction l."""
    n = np.where(normal[..., 2:] > EDGE, normal, [0.0, 0.0, 1.0])
    seen = n @ l > EDGE
    edge = head_on[seen].max(-1, keepdims=True)
    surface = MetallicRoughness(roughness[seen], base[seen], head_on[seen], edge)
    found = np.zeros(normal.shape)
    found[seen] = surface.reflected(Reference(n[seen], np.broadcast_to(l, n[seen].shape)))
    return found


def write(path: Path, mesh: HeightMesh, found: Textures | None, notes: list[str]) -> list[Path]:
    """Write a .glb, which contains all, or a .gltf with .bin and pictures beside it; return the paths."""
    pictures = {} if found is None else found.pictures
    packed, binary, views = path.suffix.lower() == ".glb", bytearray(), []

    def add(data: bytes, **more: int) -> int:
        """Add bytes to the buffer, and return the number of their view."""
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), **more})
        binary.extend(data + bytes(-len(data) % 4))
        return len(views) - 1

    arrays = [of.astype("<f4") for of in attributes_of(mesh).values()] + [mesh.face.reshape(-1, 1).astype("<u4")]
    accessors = [
        {
            "bufferView": add(of.tobytes(), target=TARGETS[of.dtype.kind]),
            "componentType": COMPONENTS[of.dtype.kind],
            "count": len(of),
            "type": KINDS[of.shape[1]],
        }
        for of in arrays
    ]
    accessors[0] |= {"min": arrays[0].min(0).tolist(), "max": arrays[0].max(0).tolist()}  # which the format demands
    if packed:
        parts = {name: add(encode(".png", picture)) for name, picture in pictures.items()}
        images = [{"name": name, "mimeType": "image/png", "bufferView": view} for name, view in parts.items()]
        written = []
    else:
        names = write_pictures(path, pictures)
        images = [{"name": name, "uri": uri_of(file)} for name, file in names.items()]
        written = [path.with_name(file) for file in (f"{path.stem}.bin", *names.values())]
        write_file(written[0], bytes(binary))
    attributes = {name: i for i, name in enumerate(ATTRIBUTES)}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "diffshade", "extras": {"diffshade": notes}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": len(attributes), "material": 0}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    if found is None:
        document["materials"] = [{"doubleSided": True}]
    else:
        index = {name: {"index": i} for i, name in enumerate(pictures)}
        document |= {
            "extensionsUsed": list(found.material["extensions"]),
            "materials": [_with_indices(found.material, index)],
            "textures": [{"source": i, "sampler": 0} for i in range(len(images))],
            "images": images,
            "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        }
    if not packed:
        document["buffers"][0]["uri"] = uri_of(f"{path.stem}.bin")
    write_file(path, _glb(document, bytes(binary)) if packed else json.dumps(document, indent=1))
    return [*written, path]


def _with_indices(value: Any, index: dict[str, Any]) -> Any:
    """Return a material whose textures are indices instead of names."""
    if not isinstance(value, dict):
        return value
    return {
        key: index[item] if key.endswith("Texture") and isinstance(item, str) else _with_indices(item, index)
        for key, item in value.items()
    }


def _glb(document: dict[str, Any], binary: bytes) -> bytes:
    """Return a binary glTF: a header, and the JSON and the numbers as chunks."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
