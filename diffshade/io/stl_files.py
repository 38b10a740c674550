"""STL: triangles of a stereolithography file, ASCII or binary."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .parsing import numbers
from .polygons import NONE, Polygons, indexed

HEAD = 84  # bytes of a binary file before its triangles
TRIANGLE = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("more", "<u2")])
LOOP = re.compile(rb"outer\s+loop\b(.*?)\bendloop\b", re.DOTALL | re.IGNORECASE)


def read_stl(path: Path) -> Polygons:
    """Read the triangles of an STL file, which are flat; which side is outside is said by the order of their corners.

    trimesh 5.2 refuses a binary file with bytes after its triangles, lines that end in CR and a name with the word
    vertex, and takes an ASCII file that ends too early for one of fewer triangles.

    Raises:
        ValueError: The file is neither a whole binary STL nor a whole ASCII one.
    """
    data = path.read_bytes()
    count = int.from_bytes(data[80:HEAD], "little")
    size = HEAD + count * TRIANGLE.itemsize
    if len(data) == size or b"\0" in data:  # a binary file may begin with "solid" too
        if len(data) < size or len(data) < HEAD:
            raise ValueError(f"{path} has {len(data)} bytes, fewer than its {count} triangles take. Export it again.")
        corner = np.frombuffer(data, TRIANGLE, count, HEAD)["corner"].astype(float).reshape(-1, 3)
    else:
        if b"endsolid" not in data.lower():
            raise ValueError(f"{path} is no whole ASCII STL: it lacks a line endsolid. Export it again.")
        corner = np.array([_corners(loop, path) for loop in LOOP.findall(data)], float).reshape(-1, 3)
    every, missing = np.arange(len(corner)), np.full(corner.shape, np.nan)
    return indexed(corner, missing, np.full(len(corner) // 3, 3), every, f"{path}", group=NONE)


def _corners(loop: bytes, path: Path) -> list[float]:
    """Return the nine numbers of a triangle."""
    words = loop.decode("latin-1").lower().split()
    if len(words) != 12 or words[::4] != ["vertex"] * 3:
        raise ValueError(f"{path} has a loop of other than three vertices of three numbers. Export it again.")
    return numbers([word for i, word in enumerate(words) if i % 4], f"{path}: vertex")
