"""Small textured models made as Khronos's samples are: one mesh file with its pictures, and the right colours.

Seven squares side by side, each in a material of its own, and a wall behind two of them: a factor, a picture whose
alpha does not count, colours of vertices on a turned node, alpha modes MASK and BLEND, wrap modes beyond the edge, a
picture that KHR_texture_transform turns, a metal, and one without light.
"""

from __future__ import annotations

import base64
import io
import json
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

import diffshade as ds
from diffshade.io.encodings import srgb_decode

SIZE = 16  # pixels of a square's side, as of its picture: a pixel shows its own texel
NAMES = ("opaque", "vertices", "mask", "blend", "wrapped", "turned", "metal", "unlit")
CAMERA = ds.OrthographicCamera((0, 0, 4), height=2.0, shape=(2 * SIZE, len(NAMES) * SIZE), local_viewer=False)
TURN = 0.3
VERTICES = np.array([[1.0, 0.2, 0.2], [0.2, 1.0, 0.2], [0.2, 0.2, 1.0], [1.0, 1.0, 1.0]])
WALL = np.array([0.2, 0.6, 0.9])
FACTOR = (0.5, 1.0, 0.8, 1.0)
REPEAT, CLAMP, MIRROR = 10497, 33071, 33648


class Picture(NamedTuple):
    texels: np.ndarray
    """(H, W, 4) bytes on the sRGB curve."""

    def png(self) -> bytes:
        file = io.BytesIO()
        Image.fromarray(self.texels).save(file, "PNG")
        return file.getvalue()

    @property
    def linear(self) -> np.ndarray:
        colour = srgb_decode(self.texels[..., :3] / 255.0)
        return np.concatenate([colour, self.texels[..., 3:] / 255.0], -1)


def pictures() -> dict[str, Picture]:
    """One of many colours, whose right half is clear, and one that is smooth, for what turns it."""
    rng = np.random.default_rng(48)
    many = rng.integers(0, 256, (SIZE, SIZE, 4), dtype=np.uint8)
    many[..., 3] = np.where(np.arange(SIZE) < SIZE // 2, 255, 51)
    y, x = (np.indices((64, 64)) + 0.5) / 64
    smooth = np.stack([128 + 90 * np.sin(6.28 * x), 128 + 90 * np.cos(6.28 * y), 200 - 100 * x, 0 * x + 255], -1)
    return {"many": Picture(many), "smooth": Picture(smooth.astype(np.uint8))}


def materials(metallic: float) -> list[dict[str, Any]]:
    def of(name: str, texture: int | None, *, unlit: bool = False, metal: float = 0.0, **more: Any) -> dict[str, Any]:
        row: dict[str, Any] = {"metallicFactor": metal, "roughnessFactor": 0.8}
        row["baseColorFactor"] = more.pop("factor", FACTOR)
        if texture is not None:
            row["baseColorTexture"] = {"index": texture} | more.pop("placed", {})
        matte = {"KHR_materials_unlit": {}} if unlit else {"KHR_materials_specular": {"specularFactor": 0.0}}
        return {"name": name, "pbrMetallicRoughness": row, **({} if metal else {"extensions": matte}), **more}

    placed = {"offset": [0.2, 0.1], "rotation": TURN, "scale": [1.5, 0.7]}
    return [
        of("opaque", 0),
        of("vertices", 0),
        of("mask", 0, alphaMode="MASK", alphaCutoff=0.3),
        of("blend", 0, alphaMode="BLEND", factor=(1.0, 1.0, 1.0, 0.75)),
        of("wrapped", 1),
        of("turned", 2, placed={"extensions": {"KHR_texture_transform": placed}}),
        of("metal", 0, metal=metallic),
        of("unlit", 0, unlit=True),
        of("wall", None, factor=(*WALL.tolist(), 1.0)),
    ]


def right_colours():
    """What each square of the model shows under a light along -z, but for the metal; by hand."""
    picture, n = pictures()["many"].linear, np.arange(SIZE)
    colour, alpha = picture[..., :3] * FACTOR[:3], picture[..., 3:]
    y, x = ((n + 0.5) / SIZE)[::-1, None], ((n + 0.5) / SIZE)[None, :]
    weights = [1 - np.maximum(x, y), np.maximum(x - y, 0), np.minimum(x, y), np.maximum(y - x, 0)]
    beyond = 3 * n - SIZE + 1
    mirrored = np.minimum(beyond % (2 * SIZE), 2 * SIZE - 1 - beyond % (2 * SIZE))
    return {
        "opaque": colour,
        "vertices": colour * sum(w[..., None] * of for w, of in zip(weights, VERTICES, strict=True)),
        "mask": np.where(alpha >= 0.3, colour, WALL),
        "blend": 0.75 * alpha * picture[..., :3] + (1 - 0.75 * alpha) * WALL,
        "wrapped": colour[beyond.clip(0, SIZE - 1)][:, mirrored],
        "unlit": colour,
    }


def square(image, name):
    i = NAMES.index(name) * SIZE
    return np.asarray(image)[:SIZE, i : i + SIZE]


class _Buffer:
    """The numbers of a file, one accessor after another."""

    def __init__(self) -> None:
        self.data, self.views, self.accessors = b"", [], []

    def view(self, data: bytes) -> int:
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data + bytes(-len(data) % 4)
        return len(self.views) - 1

    def add(self, numbers: Any, shape: str) -> int:
        array = np.asarray(numbers, "<f4" if shape != "SCALAR" else "<u2")
        row = {"bufferView": self.view(array.tobytes()), "count": len(array), "type": shape}
        row |= {"componentType": 5126 if shape != "SCALAR" else 5123}
        if shape == "VEC3":
            row |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        self.accessors.append(row)
        return len(self.accessors) - 1


def write(path: Path, *, packed: bool = True, metallic: float = 1.0) -> Path:
    """Write the model as .glb or .gltf: with its pictures in it, or beside it.

    `metallic`: of the metal; 0 makes it as the others, which takes no refit.
    """
    buffer, primitives, nodes = _Buffer(), [], []
    square = np.array([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)], float)
    uv = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], float)
    order, normal = buffer.add([0, 1, 2, 0, 2, 3], "SCALAR"), buffer.add([[0, 0, 1]] * 4, "VEC3")
    meshes = []
    for i, name in enumerate(NAMES):
        placed = 3.0 * uv - 1.0 if name == "wrapped" else uv
        attributes = {"NORMAL": normal, "TEXCOORD_0": buffer.add(placed, "VEC2")}
        at, node = np.array([i - (len(NAMES) - 1) / 2, 0.5, 0.0]), {}
        if name == "vertices":  # half as large and turned by 90 degrees, which its node undoes
            turn = np.array([[0.0, -1.0], [1.0, 0.0]])
            attributes |= {"COLOR_0": buffer.add(VERTICES, "VEC3")}
            node = {"rotation": [0, 0, -(0.5**0.5), 0.5**0.5], "scale": [2, 2, 2], "translation": at.tolist()}
            attributes |= {"POSITION": buffer.add(np.pad(0.5 * square[:, :2] @ turn.T, ((0, 0), (0, 1))), "VEC3")}
            meshes.append([{"attributes": attributes, "indices": order, "material": i}])
        else:
            attributes |= {"POSITION": buffer.add(square + at, "VEC3")}
            primitives.append({"attributes": attributes, "indices": order, "material": i})
            continue
        nodes.append({"mesh": 1} | node)
    wall = square * (2.0, 1.0, 1.0) + (-1.0, 0.5, -1.0)
    primitives.append(
        {"attributes": {"NORMAL": normal, "POSITION": buffer.add(wall, "VEC3")}, "indices": order, "material": 8}
    )
    images = []
    for name, picture in pictures().items():
        data = picture.png()
        if not packed:
            path.with_name(f"{name}.png").write_bytes(data)
            images.append({"uri": f"{name}.png"})
        elif path.suffix == ".glb":
            images.append({"bufferView": buffer.view(data), "mimeType": "image/png"})
        else:
            images.append({"uri": "data:image/png;base64," + base64.b64encode(data).decode()})
    smooth = {"magFilter": 9729, "minFilter": 9729}  # as this library: without smaller copies of a picture
    clamped = {"wrapS": MIRROR, "wrapT": CLAMP, **smooth}
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_specular", "KHR_materials_unlit", "KHR_texture_transform"],
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, *nodes],
        "meshes": [{"primitives": of} for of in (primitives, *meshes)],
        "materials": materials(metallic),
        "samplers": [smooth, clamped],
        "textures": [{"source": 0, "sampler": 0}, {"source": 0, "sampler": 1}, {"source": 1, "sampler": 0}],
        "images": images,
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    if path.suffix == ".gltf":
        document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(buffer.data).decode()
        path.write_text(json.dumps(document))
        return path
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer.data), b"BIN\0") + buffer.data
    )
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    return path


def write_unlit(path: Path) -> None:
    """Write the model with its pictures beside it, all without light, which takes no refit."""
    document = json.loads(write(path, packed=False).read_text())
    for row in document["materials"]:
        row["extensions"] = {"KHR_materials_unlit": {}}
    path.write_text(json.dumps(document))
