"""PLY: polygons of a Stanford file, ASCII or binary, with the normals of its vertices."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .parsing import short
from .polygons import Polygons, indexed, stated

SIZES = {"char": 1, "short": 2, "int": 4, "int8": 1, "int16": 2, "int32": 4, "int64": 8}
KINDS = {name: f"i{size}" for name, size in SIZES.items()} | {f"u{name}": f"u{size}" for name, size in SIZES.items()}
KINDS |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
HEADER = re.compile(rb"ply[ \t]*(\r\n|\n|\r).*?(?:\r\n|\n|\r)end_header[ \t]*", re.DOTALL)
INDICES = ("vertex_indices", "vertex_index")


class Element(NamedTuple):
    """An element of the header: how many rows it has, and what stands in each."""

    name: str
    rows: int
    properties: dict[str, tuple[str, str]]
    """The types of the length, "" where the property is no list, and of the items."""


class Columns(NamedTuple):
    """The rows of an element, by property."""

    items: dict[str, np.ndarray]
    """Of a list those of all rows, one after another."""
    lengths: dict[str, np.ndarray]
    end: int
    """Where the rows end."""


def read_ply(path: Path) -> Polygons:
    """Read the faces of a PLY file.

    trimesh 5.2 loses the file's own normals, and refuses a binary file with triangles and quads.

    Raises:
        ValueError: The header or the rows are not those of PLY 1.0.
    """
    data = path.read_bytes()
    header = HEADER.match(data)
    if header is None:
        raise ValueError(f"{path} is no PLY file: it lacks the lines from ply to end_header. Export it again.")
    order, elements = _header(header.group().decode("latin-1"), path)
    body, place = data[header.end() :].removeprefix(header.group(1)), 0
    if not order:  # the same rows in float64
        body, order = _numbers(body, path).tobytes(), "="
        for element in elements:
            element.properties.update({name: ("f8" * bool(n), "f8") for name, (n, _) in element.properties.items()})
    found = dict[str, Columns]()
    for element in elements:
        try:
            columns = _rows(element, body, place, order)
        except (ValueError, OverflowError):
            raise ValueError(
                f"{path} does not hold the {element.rows} rows of its element {element.name}. Export it again."
            ) from None
        found[element.name], place = columns, columns.end
    return _polygons(found, path)


def _polygons(found: dict[str, Columns], path: Path) -> Polygons:
    """Return the faces of elements named vertex and face."""
    if "tristrips" in found:
        raise ValueError(f"{path} has its triangles as strips, which are not read. Export it with faces.")
    nothing = Columns({}, {}, 0)
    vertex, face = (found.get(name, nothing) for name in ("vertex", "face"))
    point, normal = np.zeros((0, 3)), np.full((1, 3), np.nan)
    if {"x", "y", "z"} <= vertex.items.keys():
        point = np.stack([vertex.items[name].astype(float) for name in ("x", "y", "z")], -1)
        normal = np.full((len(point), 3), np.nan)
    if {"nx", "ny", "nz"} <= vertex.items.keys():
        normal = stated(np.stack([vertex.items[name].astype(float) for name in ("nx", "ny", "nz")], -1))
    lists = [name for name in (*INDICES, *face.lengths) if name in face.lengths]
    at, size = (face.items[lists[0]], face.lengths[lists[0]]) if lists else (np.zeros(0), np.zeros(0))
    return indexed(point, normal, size.astype(int), at, f"{path}")


def _header(text: str, path: Path) -> tuple[str, list[Element]]:
    """Return the order of bytes, "" for ASCII, and the elements."""
    order, elements = None, list[Element]()
    for line in text.splitlines():
        match line.split():
            case ["format", name, "1.0"] if name in FORMATS:
                order = FORMATS[name]
            case ["element", name, count] if count.isdecimal():
                elements.append(Element(name, int(count), {}))
            case ["property", "list", length, item, name] if elements and {length, item} <= KINDS.keys():
                elements[-1].properties[name] = KINDS[length], KINDS[item]
            case ["property", kind, name] if elements and kind in KINDS:
                elements[-1].properties[name] = "", KINDS[kind]
            case ["format" | "element" | "property", *_]:
                raise ValueError(f"{path} has {short(line)} in its header, which PLY 1.0 does not know. Correct it.")
    if order is None:
        raise ValueError(f"{path} does not state its format: ascii or binary, 1.0. Export it again.")
    return order, elements


def _numbers(body: bytes, path: Path) -> Float[np.ndarray, " n"]:
    try:
        return np.array(body.split(), np.float64)
    except ValueError as error:
        raise ValueError(f"{path} has a word where a number must be: {error}. Export it again.") from None


def _rows(element: Element, data: bytes, place: int, order: str) -> Columns:
    """Return the rows of an element: those that follow each other with lists of the same lengths as one table."""
    lists = [name for name, (length, _) in element.properties.items() if length]
    tables, rows, most = list[Any](), element.rows if element.properties else 0, element.rows
    while rows:
        kind, sizes = _layout(element, data, place, order)
        table: Any = np.frombuffer(data, kind, min(rows, most, (len(data) - place) // kind.itemsize), place)
        if not len(table):
            raise ValueError("the file ends early")
        alike = np.logical_and.reduce([table[f"length of {name}"] == sizes[name] for name in lists] or [True])
        count = len(table) if alike.all() else int(alike.argmin())
        most = 2 * count  # so that a change of lengths every few rows is found among a few rows
        tables.append(table[:count])
        rows, place = rows - count, place + count * kind.itemsize
    items = {name: [np.zeros(0), *(table[name].ravel() for table in tables)] for name in element.properties}
    lengths = {name: [np.zeros(0), *(table[f"length of {name}"] for table in tables)] for name in lists}
    columns, long = ({name: np.concatenate(of) for name, of in found.items()} for found in (items, lengths))
    return Columns(columns, long, place)


def _layout(element: Element, data: bytes, place: int, order: str) -> tuple[np.dtype, dict[str, int]]:
    """Return the type of a row whose lists are as long as those of the row at this place, and their lengths."""
    fields, sizes = list[tuple[Any, ...]](), dict[str, int]()
    for name, (length, item) in element.properties.items():
        if length:
            sizes[name] = int(np.frombuffer(data, order + length, 1, place + np.dtype(fields).itemsize)[0])
            fields.append((f"length of {name}", order + length))
        fields.append((name, order + item, (sizes.get(name, 1),)))
    return np.dtype(fields), sizes
