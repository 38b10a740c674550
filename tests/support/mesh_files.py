"""Small mesh files whose right picture is known, as text."""

import json
import struct

import numpy as np

QUAD = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\n"
TILTED = "vn -0.6 0 0.8\nvn 0.6 0 0.8\nvn 0.6 0 0.8\nvn -0.6 0 0.8\n"
TWO = (
    "v -2 -1 0\nv 0 -1 0\nv 0 1 0\nv -2 1 0\nusemtl red\nf {0}\n"
    "v 0 -1 0\nv 2 -1 0\nv 2 1 0\nv 0 1 0\nusemtl blue\nf {1}\n"
)
TWO_MTL = "newmtl red\nKd 0.8 0.1 0.1\nillum 1\nnewmtl blue\nKd 0.1 0.1 0.8\nillum 1\n"
ABSOLUTE, RELATIVE = TWO.format("1 2 3 4", "5 6 7 8"), TWO.format("-4 -3 -2 -1", "-4 -3 -2 -1")
NOTCH = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 1 0.5 0\nv 0 2 0\nf 1 2 3 4 5\n"
CARD = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nf 1 2 3\nf 3 2 1\n"
# a wall of 6 x 3 with two windows of 1 x 1, each reached by a double edge
WALL = (
    "v 0 0 0\nv 6 0 0\nv 6 3 0\nv 0 3 0\nv 1 1 0\nv 2 1 0\nv 2 2 0\nv 1 2 0\nv 4 1 0\nv 5 1 0\nv 5 2 0\nv 4 2 0\n"
    "f 1 5 8 7 6 5 1 2 10 9 12 11 10 2 3 4\n"
)

PLY = """ply
format {form} 1.0
comment made here
element vertex 4
property float x
property float y
property float z
property float nx
property float ny
property float nz
element face {faces}
property list uchar int {name}
element edge 0
property int vertex1
end_header
"""
POINTS = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
NORMALS = np.array([(-0.6, 0, 0.8), (0.6, 0, 0.8), (0.6, 0, 0.8), (-0.6, 0, 0.8)])
ROWS = np.concatenate([POINTS, NORMALS], -1)


def ply(form: str, faces: list[tuple[int, ...]], name: str = "vertex_indices", end: str = "\n") -> bytes:
    """The tilted square as PLY: ascii, binary_little_endian or binary_big_endian."""
    head = PLY.format(form=form, faces=len(faces), name=name).replace("\n", end).encode()
    if form == "ascii":
        rows = [*ROWS.tolist(), *((len(face), *face) for face in faces)]
        return head + "".join(" ".join(f"{x:g}" for x in row) + end for row in rows).encode()
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    return head + ROWS.astype(f"{order}f4").tobytes() + body


def gltf(primitives: list[dict], arrays: list[tuple[np.ndarray, str]], node: dict | None = None, **more) -> bytes:
    """A binary glTF of one mesh; arrays are its accessors, in order."""
    binary, views, accessors = b"", [], []
    kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
    for array, shape in arrays:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        kind = kinds[array.dtype.str[1:]]
        accessors.append({"bufferView": len(views) - 1, "componentType": kind, "count": len(array), "type": shape})
        binary += array.tobytes() + bytes(-array.nbytes % 4)
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0} | (node or {})],
        "meshes": [{"primitives": primitives}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    } | more
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
