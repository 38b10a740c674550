"""glTF 2.0: the triangles of a scene, with their normals and the names of their materials."""

from __future__ import annotations

import base64
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote, unquote_to_bytes

import numpy as np
from jaxtyping import Float, Int

from ..core.words import count as counted
from ..core.words import unused
from .parsing import read_glb
from .polygons import BARE, NONE, Polygons, indexed, joined, stated

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
TRIANGLES, STRIP, FAN = range(4, 7)
HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_mesh_quantization", "KHR_xmp", "EXT_texture_")


class Document(NamedTuple):
    """The JSON of a file, and the bytes of its buffers."""

    json: dict[str, Any]
    buffers: list[bytes]


def read_gltf(path: Path) -> Polygons:
    """Read the triangles of a glTF file's scene; of other files only buffers in its own folder.

    Where a primitive has no normals its triangles are flat, as the format has it. Skins and morph targets are not
    applied, which the notes say: such a mesh is as it stands in the file.

    trimesh 5.2 loses the file's own normals, refuses fans, and reads a file that needs an extension without it.

    Raises:
        ValueError: The file is not glTF 2.0, or needs an extension that is not read.
    """
    with _read_strictly(path) as document:
        names, meshes = material_names(document.json.get("materials", [])), document.json.get("meshes", [])
        scene = [(matrix, node, meshes[node["mesh"]]) for matrix, node in _placed(document.json)]
        found = [_primitive(document, of, matrix, names) for matrix, _, mesh in scene for of in mesh["primitives"]]
        skins = sum("skin" in node for _, node, _ in scene)
        morphs = sum(any(node.get("weights", mesh.get("weights", ()))) for _, node, mesh in scene)
        whole = joined(found)
    return whole._replace(
        notes=tuple(
            f"{counted(number, kind)} {'is' if number == 1 else 'are'} not applied; "
            "the mesh is drawn as the file stores it."
            for number, kind in ((skins, "skin"), (morphs, "set of morph weights"))
            if number
        )
    )


@contextmanager
def _read_strictly(path: Path) -> Iterator[Document]:
    """Give what a file holds; what is raised with it becomes one sentence."""
    data, binary = path.read_bytes(), b""
    if data[:4] == b"glTF":
        text, rest = read_glb(path, largest=math.inf)
        data, part = text.encode(), data[rest:]
        if part[4:8] == b"BIN\0":
            binary = part[8 : 8 + int.from_bytes(part[:4], "little")]
    try:
        yield _document(data, binary, path.parent)
    except (AttributeError, IndexError, KeyError, TypeError, RecursionError, OverflowError) as error:
        said = f" ({error})" if isinstance(error, KeyError) else ""
        raise ValueError(
            f"{path} is not glTF 2.0: something is missing or of another type{said}. Export it again."
        ) from None
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as glTF 2.0: {error}"[:2000].replace("\n", " ")) from None


def picture_bytes(path: Path, index: int) -> bytes:
    """Return the bytes of a picture of a glTF file: packed in it, or of a file in its own folder.

    Raises:
        ValueError: There is no such picture.
    """
    with _read_strictly(path) as document:
        row = document.json["images"][index]
        if "uri" in row:
            return _named_bytes(row["uri"], path.parent, "picture")
        view = document.json["bufferViews"][row["bufferView"]]
        start, data = view.get("byteOffset", 0), document.buffers[view["buffer"]]
        return data[max(start, 0) : max(start, 0) + view["byteLength"]]


def base_texture(row: dict[str, Any]) -> dict[str, Any]:
    """Return the texture of a material's base colour, an empty table where it has none."""
    glossy = row.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
    if glossy is not None:
        return glossy.get("diffuseTexture", {})
    return row.get("pbrMetallicRoughness", {}).get("baseColorTexture", {})


def texture_set(texture: dict[str, Any]) -> int:
    """Return which texture coordinates of a mesh a texture is placed by (KHR_texture_transform may say others)."""
    placed = texture.get("extensions", {}).get("KHR_texture_transform", {})
    return placed.get("texCoord", texture.get("texCoord", 0))


def material_names(materials: Sequence[Any]) -> list[str]:
    """Return a name for each material: its own, with a number after it where another one has it already."""
    found = dict[str, None]()
    for i, row in enumerate(materials):
        given = row.get("name") if isinstance(row, dict) else None
        name = given if isinstance(given, str) and given else f"material_{i}"
        found[unused(name, found)] = None
    return list(found)


def _document(data: bytes, binary: bytes, folder: Path) -> Document:
    """Return what the JSON of a file holds, and its buffers."""
    found = json.loads(data)
    if not str(found["asset"]["version"]).startswith("2."):
        raise ValueError(f"it is of version {found['asset']['version']}. Convert it to glTF 2.0.")
    for name in found.get("extensionsRequired", []):
        if not str(name).startswith(HARMLESS):
            raise ValueError(f"it needs the extension {str(name)[:60]}, which is not read. Export it without.")
    buffers = []
    for row in found.get("buffers", []):
        of = binary if "uri" not in row else _named_bytes(row["uri"], folder, "buffer")
        if len(of) < row["byteLength"]:
            raise ValueError(f"a buffer has {len(of)} of its {row['byteLength']} bytes. Export it again.")
        buffers.append(of)
    return Document(found, buffers)


def data_bytes(uri: str) -> bytes:
    """Return the bytes that a name of data: holds.

    Raises:
        ValueError: It says that it is base64, and is not.
    """
    kind, _, text = uri.partition(",")
    try:
        return base64.b64decode(text, validate=True) if kind.endswith(";base64") else unquote_to_bytes(text)
    except ValueError:
        raise ValueError("what follows base64 in a name of data: is no base64. Export the file again.") from None


def name_of(uri: str) -> str:
    """Return the name of a file that a URI stands for: % and two digits are a byte of it (RFC 3986, 2.1)."""
    return uri if _is_whole(uri) else unquote_to_bytes(uri).decode()


def uri_of(name: str) -> str:
    """Return the URI of a file's name."""
    return name if _is_whole(name) else quote(name.replace("\\", "/"), safe="/:")


def _is_whole(uri: str) -> bool:
    """Whether a URI holds a file, or names its place on the web."""
    return uri.startswith("data:") or "://" in uri


def beside(name: str, folder: Path, noun: str) -> Path:
    """Return a file in a folder or below it.

    Raises:
        ValueError: There is no such file.
    """
    path = (folder / name).resolve() if "\0" not in name else folder
    if not path.is_relative_to(folder.resolve()) or not os.path.isfile(path):  # which takes a name of any length
        raise ValueError(f"there is no {noun} {name[:80]!r} in its folder. Put it beside the file.")
    return path


def _named_bytes(uri: str, folder: Path, noun: str) -> bytes:
    """Return the bytes of a buffer or picture: those in its name, or of a file in the folder."""
    if uri.startswith("data:"):
        return data_bytes(uri)
    return beside(name_of(uri), folder, noun).read_bytes()


def _placed(found: dict[str, Any]) -> Iterator[tuple[Float[np.ndarray, "4 4"], dict[str, Any]]]:
    """Yield the nodes of the scene with a mesh, each with the matrix from its mesh to the scene."""
    nodes = found.get("nodes", [])
    if found.get("scenes"):
        roots = found["scenes"][found.get("scene", 0)].get("nodes", [])
    else:
        roots = set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])}
    waiting, met = [(root, np.eye(4)) for root in roots], set[int]()
    while waiting:
        index, parent = waiting.pop(0)
        if index in met or index < 0:
            raise ValueError(f"node {index} is reached twice: it has two parents, or is its own. Export it again.")
        met.add(index)
        node = nodes[index]
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            raise ValueError(f"node {index} needs EXT_mesh_gpu_instancing, which is not read. Export it without.")
        matrix = parent @ _matrix(node)
        waiting += [(child, matrix) for child in node.get("children", [])]
        if "mesh" in node:
            yield np.eye(4) if "skin" in node else matrix, node  # glTF 2.0, 3.7.3.3: that of a skinned one is ignored


def _matrix(node: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    """Return the matrix from a node to its parent (glTF 2.0, 3.5.3)."""
    from scipy.spatial.transform import Rotation

    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    turn = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix()
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), float)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _primitive(document: Document, of: dict[str, Any], matrix: Float[np.ndarray, "4 4"], names: list[str]) -> Polygons:
    """Return the triangles of a primitive in the scene; none of points and lines."""
    point = _accessor(document, of["attributes"]["POSITION"])
    given = of["attributes"].get("NORMAL")
    normal = np.full(point.shape, np.nan) if given is None else stated(_accessor(document, given))
    every = np.arange(len(point))
    index = _accessor(document, of["indices"])[:, 0].astype(int) if "indices" in of else every
    if point.shape[1] != 3 or normal.shape != point.shape:
        raise ValueError(f"a primitive has {len(point)} vertices, and other normals. Export it again.")
    face = _triangles(index, of.get("mode", TRIANGLES))
    linear = matrix[:3, :3]
    mirrored = np.linalg.det(linear) < 0
    cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]]) * (-1.0 if mirrored else 1.0)
    at = (face[:, ::-1] if mirrored else face).ravel()
    group, name = NONE if given is None else 0, names[of["material"]] if "material" in of else ""
    point, normal = point @ linear.T + matrix[:3, 3], normal @ cofactors.T
    look = _looks(document, of, len(point))
    return indexed(point, normal, np.full(len(face), 3), at, "a primitive", group=group, name=name, look=look)


def _looks(document: Document, of: dict[str, Any], count: int) -> Float[np.ndarray, "points 6"] | None:
    """Return where the vertices of a primitive are in its base colour's picture, and their colours."""
    material = document.json["materials"][of["material"]] if "material" in of else {}
    at, colour = f"TEXCOORD_{texture_set(base_texture(material))}", "COLOR_0"
    if not of["attributes"].keys() & {at, colour}:
        return None
    look = np.tile(BARE, (count, 1))
    if at in of["attributes"]:
        look[:, :2] = _accessor(document, of["attributes"][at])
    if colour in of["attributes"]:
        given = _accessor(document, of["attributes"][colour])
        look[:, 2 : 2 + given.shape[1]] = given
    return look


def _triangles(index: Int[np.ndarray, " n"], mode: int) -> Int[np.ndarray, "t 3"]:
    """Return the corners of triangles, of strips and fans too, all wound alike (glTF 2.0, 3.7.2.1)."""
    if mode == TRIANGLES:
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    k = np.arange(max(len(index) - 2, 0))
    if mode == STRIP:
        return index[np.stack([k, k + 1 + k % 2, k + 2 - k % 2], -1)]
    return index[np.stack([k + 1, k + 2, 0 * k], -1)] if mode == FAN else np.zeros((0, 3), int)


def _accessor(document: Document, index: int) -> Float[np.ndarray, "n width"]:
    """Return the numbers of an accessor."""
    of = document.json["accessors"][index]
    kind, width, count = COMPONENTS[of["componentType"]], WIDTHS[of["type"]], of["count"]
    if "bufferView" in of:
        values = _view(document, of, kind, width, count).astype(float)
    elif count * width <= sum(map(len, document.buffers)):
        values = np.zeros((count, width))
    else:
        raise ValueError(f"an accessor has {count} rows and no numbers. Export it again.")
    if "sparse" in of:
        sparse = of["sparse"]
        rows = _view(document, sparse["indices"], COMPONENTS[sparse["indices"]["componentType"]], 1, sparse["count"])
        values[rows[:, 0]] = _view(document, sparse["values"], kind, width, sparse["count"])
    if of.get("normalized") and kind[1] != "f":
        values = np.maximum(values / np.iinfo(kind).max, -1.0)
    return values


def _view(document: Document, of: dict[str, Any], kind: str, width: int, count: int) -> np.ndarray:
    """Return rows of numbers in a buffer, which others may lie between."""
    view = document.json["bufferViews"][of["bufferView"]]
    if any("meshopt" in name for name in view.get("extensions", {})):
        raise ValueError("its numbers are compressed by meshopt, which is not read. Export it without.")
    row = np.dtype(kind).itemsize * width
    step, start = view.get("byteStride", row), of.get("byteOffset", 0)
    first, size, data = view.get("byteOffset", 0), view["byteLength"], document.buffers[view["buffer"]]
    if (
        min(first, start) < 0
        or count < 1
        or step < row
        or start + (count - 1) * step + row > min(size, len(data) - first)
    ):
        raise ValueError(f"an accessor of {count} rows does not fit its {size} bytes. Export it again.")
    return np.ndarray((count, width), kind, data, first + start, (step, np.dtype(kind).itemsize))
