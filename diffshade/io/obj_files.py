"""OBJ: polygons of a Wavefront file, with normals, smoothing groups and the names of materials."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from .parsing import number, read_text, short
from .polygons import BARE, NONE, Polygons, check_corners, stated

COMMENT = re.compile(r"(?:^|\s)#")  # a # within a word is part of a name
NOT_FINITE = re.compile(r"[+-]?(?:nan|inf)", re.IGNORECASE)
OF_MICROSOFT = re.compile(r"1\.#(?:IND|INF|QNAN|SNAN)\w*")  # the same, which a comment does not begin in
FLAT = ([], ["off"], ["null"], ["0"])
CONTINUED = re.compile(r"\\[ \t]*(?:\r\n|\r|\n)")


def read_obj(path: Path) -> Polygons:
    """Read the faces of an OBJ file. Curves, lines and points are not read, nor any other file.

    Raises:
        ValueError: The file is no text, or a line that says where a face is cannot be read.
    """
    points: list[list[float]] = []
    normals: list[list[float]] = []
    places: list[list[float]] = []
    size: list[int] = []
    corners: list[int] = []  # its point, its place and its normal
    groups: list[int] = []
    parts: list[int] = []
    names: dict[str, int] = {}
    smooth: dict[str, int] = {}
    name, group = "", 0
    text = OF_MICROSOFT.sub("nan", read_text(path, "Wavefront OBJ file", largest=math.inf))
    for line in re.split("\r\n|\r|\n", CONTINUED.sub(" ", text)):
        key, *words = line.partition("#")[0].split() or [""]
        if key in ("v", "vn"):
            if len(words) < 3:
                raise ValueError(f"{path}: {short(line)} must have three numbers. Export the file again.")
            (points if key == "v" else normals).append([_coordinate(word, f"{path}: {key}") for word in words[:3]])
        elif key == "vt":
            places.append([_coordinate(word, f"{path}: vt") for word in [*words, "0", "0"][:2]])
        elif key in ("f", "fo"):  # as the format was at first
            for word in words:
                point, *others = word.split("/")[:3]
                given = zip([*others, "", ""], (places, normals), strict=False)
                more = [_index(of, len(kind), line, path) if of else NONE for of, kind in given]
                corners += [_index(point, len(points), line, path), *more]
            size.append(len(words))
            groups.append(group)
            parts.append(names.setdefault(name, len(names)))
        elif key == "usemtl":
            name = COMMENT.split(line, maxsplit=1)[0].strip()[len(key) :].strip()
        elif key == "s":
            words = [word.lower() for word in words]
            group = NONE if words in FLAT else smooth.setdefault(words[0], 1 + len(smooth))
    at, of_place, of_normal = np.array(corners, int).reshape(-1, 3).T
    check_corners(at, len(points), f"{path}")
    known = stated(np.array([*normals, [0.0] * 3]))  # 0 for one that is missing,
    known = np.append(known, [[np.nan] * 3], axis=0)  # NaN where a face names none
    return Polygons(
        np.array(points).reshape(-1, 3),
        np.array(size, int),
        at,
        known[np.minimum(of_normal, len(normals))],
        np.array(groups, int),
        np.array(parts, int),
        tuple(names) or ("",),
        look=_looks(places, of_place) if places else None,
    )


def _looks(places: list[list[float]], at: Int[np.ndarray, " corners"]) -> Float[np.ndarray, "corners 6"]:
    """Return the look of each corner, by the place in the picture that it names."""
    look = np.tile(BARE, (len(at), 1))
    named = (at >= 0) & (at < len(places))
    look[named, :2] = np.array(places)[at[named]] * (1.0, -1.0) + (0.0, 1.0)  # v of an OBJ is up
    return look


def _coordinate(word: str, where: str) -> float:
    """Return a number of a vertex or normal, which is no error as NaN where no face uses it."""
    return math.nan if NOT_FINITE.match(word) else number(word, where)


def _index(word: str, count: int, line: str, path: Path) -> int:
    """Return an index from 0: those of the file count from 1, or backward from the last one before the line."""
    try:
        found = int(word)
    except ValueError:
        found = 0
    if found == 0 or found < -count:
        raise ValueError(
            f"{path}: {short(line)} has the index {short(word)}; {count} are defined before it. Export the file again."
        )
    return found - 1 if found > 0 else count + found
