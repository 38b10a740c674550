"""Folders: which files of a folder are its photographs, in which order, which is the mask, and its list of lights.

A folder says so itself by `filenames.txt` (DiLiGenT) or by a list of lights, `NAME.lp` (reflectance transformation
imaging: the count, then a name and x y z a line). Otherwise its photographs are all images but masks and normals, in
natural order, and images that are named unlike most are left out, as reference photographs are. Of a RAW file and what
the camera made of it, which has the same name, the RAW file counts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ...core.words import count, listing
from ...io.image_formats import FORMATS
from ...io.raw_files import SUFFIXES as RAW_SUFFIXES

OTHERS = ("mask", "normal")  # in the names of images that are no photographs
ALIKE = 0.75  # share of the images named alike, digits apart, from which others are left out
SHOWN = 3  # names in a note
UNIT = 0.02  # by which the length of a direction may differ from 1


class Listing(NamedTuple):
    """What a folder holds."""

    names: tuple[str, ...]
    """The photographs."""
    masks: tuple[Path, ...]
    directions: Float[np.ndarray, "photographs 3"] | None
    """Towards the light of each photograph, where a list of lights gives it."""
    extras: tuple[Path, ...]
    """Images that are neither photographs nor masks nor normals, such as a picture under room light."""
    notes: tuple[str, ...]
    """What was left out."""


def list_folder(folder: Path) -> Listing:
    """Return what a folder holds; raise ValueError for one without photographs."""
    images = sorted(
        (file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and not file.name.startswith(".")),
        key=_natural_order,
    )
    masks = tuple(file for file in images if "mask" in file.stem.lower())
    lists = sorted(file for file in folder.iterdir() if file.suffix.lower() == ".lp")
    photographs = [file.name for file in images if not any(word in file.stem.lower() for word in OTHERS)]
    if (folder / "filenames.txt").is_file():
        names = _names_in(folder / "filenames.txt")
        extras = tuple(folder / name for name in photographs if name not in names)
        directions = _of_names(names, *read_lp(lists[0])) if len(lists) == 1 else None
        return Listing(names, masks, directions, extras, ())
    if len(lists) > 1:
        raise ValueError(
            f"{folder} holds several lists of lights, {listing([file.name for file in lists])}. Keep one, or write the "
            "photographs' names to filenames.txt."
        )
    if lists:
        listed, directions = read_lp(lists[0])
        names = _matched(lists[0], listed, [file.name for file in images])
        left = [name for name in photographs if name not in names]
        notes = _left_out(left, f"not in {lists[0].name}")
        return Listing(names, masks, directions, tuple(folder / name for name in left), notes)
    if not photographs:
        raise ValueError(f"{folder} holds no photograph. Give a folder with images: {', '.join(SUFFIXES)}.")
    raw = {Path(name).stem for name in photographs if _is_raw(name)}
    twice = [name for name in photographs if Path(name).stem in raw and not _is_raw(name)]
    photographs = [name for name in photographs if name not in twice]
    alike = Counter(_pattern(name) for name in photographs).most_common(1)[0]
    kept = [name for name in photographs if _pattern(name) == alike[0]]
    if len(kept) < max(ALIKE * len(photographs), 3):
        kept = photographs
    left = [name for name in photographs if name not in kept]
    notes = (
        *_left_out(twice, "the RAW file of the same name is read"),
        *_left_out(left, f"the others are named as {kept[0]}"),
    )
    return Listing(tuple(kept), masks, None, tuple(folder / name for name in left), notes)


def read_lp(path: Path) -> tuple[tuple[str, ...], Float[np.ndarray, "photographs 3"]]:
    """Read a list of lights of reflectance transformation imaging: names, and unit vectors towards the lights.

    Args:
        path: A text file: the count, then a name (which may have spaces and folders, of which the last part counts) and
            x y z a line, x right, y up, z to the camera.

    Returns:
        The names and the directions.

    Raises:
        ValueError: If it is no such list, or a direction is no unit vector.
        FileNotFoundError: If it does not exist.
    """
    rows = [line.split() for line in text_of(path).splitlines() if line.strip()]
    if not rows or len(rows[0]) != 1 or not rows[0][0].isdigit() or int(rows[0][0]) < 1:
        raise ValueError(
            f"{path} must begin with the count of its lights; got {' '.join(rows[0]) if rows else 'nothing'!r}. Write "
            "it on the first line."
        )
    if len(rows) - 1 != int(rows[0][0]):
        raise ValueError(
            f"{path} must have {rows[0][0]} lines after its first, as that says; got {len(rows) - 1}. Correct the list."
        )
    names, directions = [], []
    for number, row in enumerate(rows[1:], 2):
        try:
            l = np.array(row[-3:], np.float64)
        except ValueError:
            l = np.zeros(0)
        if len(row) < 4 or l.shape != (3,) or not np.isfinite(l).all():
            raise ValueError(
                f"{path} must have a name and three numbers a line; got '{' '.join(row)}' on line {number}. Correct it."
            )
        check_unit(path, l, number)
        names.append(PureWindowsPath(" ".join(row[:-3])).name)  # which takes both kinds of slashes
        directions.append(l / np.linalg.norm(l))
    return tuple(names), np.array(directions).reshape(len(names), 3)


def check_unit(path: Path, l: Float[np.ndarray, " 3"], line: int) -> None:
    """Refuse a direction that is no unit vector: it may be a position, or have the light's intensity in it."""
    if not abs(float(np.linalg.norm(l)) - 1.0) <= UNIT:
        raise ValueError(
            f"{path} must hold unit vectors; got one of length {np.linalg.norm(l):.4g} on line {line}. Divide each by "
            "its length if they are directions."
        )


def as_lp(names: Sequence[str], directions: Float[np.ndarray, "photographs 3"]) -> str:
    """Return names and directions as the text of such a list."""
    lines = [f"{name} {' '.join(f'{x:.10g}' for x in l)}\n" for name, l in zip(names, directions, strict=True)]
    return f"{len(names)}\n{''.join(lines)}"


def text_of(path: Path) -> str:
    """Return the text of a file; refuse one that does not exist or is no text."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}. Add it, or correct the folder.")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text: {error}. Write it as UTF-8.") from None


def _names_in(path: Path) -> tuple[str, ...]:
    """Return the names in a `filenames.txt`; refuse one that leads out of its folder."""
    names = tuple(line.strip() for line in text_of(path).splitlines() if line.strip())
    if not names:
        raise ValueError(f"{path} names no photograph. Write one file name a line.")
    for name in names:
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise ValueError(f"{path} must name photographs in its own folder; got '{name}'. Copy or link it there.")
    return names


def _matched(path: Path, listed: Sequence[str], there: Sequence[str]) -> tuple[str, ...]:
    """Return the files that a list names, whatever their case and suffix."""
    exact = {name.lower(): name for name in there}
    stems = {Path(name).stem.lower(): name for name in there}
    found: list[str] = []
    for name in listed:
        file = exact.get(name.lower()) or stems.get(Path(name).stem.lower())
        if file is None:
            raise ValueError(
                f"{path} names '{name}', which is not in its folder. Add the photograph, or correct the list."
            )
        if file in found:
            raise ValueError(f"{path} names '{file}' twice. Give each photograph one light.")
        found.append(file)
    return tuple(found)


def _of_names(
    names: Sequence[str], listed: Sequence[str], directions: Float[np.ndarray, "listed 3"]
) -> Float[np.ndarray, "photographs 3"] | None:
    """Return the directions of photographs from a list, or None where it has not all of them."""
    stems = {Path(name).stem.lower(): l for name, l in zip(listed, directions, strict=True)}
    found = [stems.get(Path(name).stem.lower()) for name in names]
    return None if any(l is None for l in found) else np.array(found)


def _left_out(names: list[str], why: str) -> tuple[str, ...]:
    if not names:
        return ()
    shown = listing(names) if len(names) <= SHOWN else f"{count(len(names), 'image')}, such as {names[0]},"
    return (f"{shown} {'is' if len(names) == 1 else 'are'} left out: {why}.",)


def _is_raw(name: str) -> bool:
    return Path(name).suffix.lower() in RAW_SUFFIXES


def _pattern(name: str) -> str:
    return re.sub(r"\d+", "0", Path(name).stem)


def _natural_order(file: Path) -> list[Any]:
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]


SUFFIXES = tuple(FORMATS)
