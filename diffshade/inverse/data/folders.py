"""Folders: which files of a folder are its photographs, in which order, which is the mask, and its list of lights.

A folder says so itself by `filenames.txt` (DiLiGenT) or by a list of lights, `NAME.lp` (reflectance transformation
imaging: the count, then a name and x y z a line). Otherwise its photographs are all images but masks and normals, in
natural order, and images that are named unlike most are left out, as reference photographs are. Of a RAW file and what
the camera made of it, which has the same name, the RAW file counts.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ...core.words import MAX_NAMED, count, listing
from ...io.image_formats import FORMATS
from ...io.parsing import read_text
from ...io.raw_files import SUFFIXES as RAW_SUFFIXES
from .light_lists import LightList, read_lp

SUFFIXES = tuple(FORMATS)
NORMALS = ("normal_gt.npy", "Normal_gt.mat", "normal.txt")
SHOWN = "-shown"  # ends the names of pictures of what was found
OTHERS = ("mask", "normal")  # in the names of images that are no photographs
ALIKE = 0.75  # share of the images named alike, digits apart, from which others are left out


class Listing(NamedTuple):
    """What a folder holds."""

    folder: Path
    names: tuple[str, ...]
    """The photographs."""
    masks: tuple[Path, ...]
    directions: Float[np.ndarray, "photographs 3"] | None
    """Towards the light of each photograph, where a list of lights gives it."""
    extras: tuple[Path, ...]
    """Images that are neither photographs nor masks nor normals, such as a picture under room light."""
    notes: tuple[str, ...]
    """What was left out, and what a list of lights says that is not used."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the photographs."""
        return tuple(self.folder / name for name in self.names)

    @property
    def normals(self) -> Path | None:
        """The file of the normals of what the photographs show."""
        return next((self.folder / name for name in NORMALS if (self.folder / name).is_file()), None)

    def mask_file(self) -> Path:
        """Return the mask; refuse a folder without one, or with several."""
        usual = self.folder / "mask.png"
        if usual in self.masks or len(self.masks) == 1:
            return usual if usual in self.masks else self.masks[0]
        if self.masks:
            raise ValueError(
                f"{self.folder} holds several masks, {listing([file.name for file in self.masks])}. Choose one with "
                "mask= (--mask on the command line)."
            )
        raise FileNotFoundError(
            f"there is no mask {usual}. Add one that is white on the object, find one with `diffshade mask "
            f"{self.folder}`, or give another file with mask= (--mask on the command line)."
        )


def list_folder(folder: Path) -> Listing:
    """Return what a folder holds; raise ValueError for one without photographs, FileNotFoundError for none."""
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}. Give a folder of photographs.")
    images = sorted(
        (file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and not file.name.startswith(".")),
        key=lambda file: natural_order(file.name),
    )
    masks = tuple(file for file in images if "mask" in file.stem.lower() and not file.stem.endswith(SHOWN))
    lists = sorted(file for file in folder.iterdir() if file.suffix.lower() == ".lp")
    photographs = [file.name for file in images if not any(word in file.stem.lower() for word in OTHERS)]
    if (folder / "filenames.txt").is_file():
        names = _names_in(folder / "filenames.txt", photographs)
        extras = tuple(folder / name for name in photographs if name not in names)
        directions, notes = _directions_of(names, read_lp(lists[0])) if len(lists) == 1 else (None, ())
        return Listing(folder, names, masks, directions, extras, notes)
    if len(lists) > 1:
        raise ValueError(
            f"{folder} holds several lists of lights, {listing([file.name for file in lists])}. Keep one, or write the "
            "photographs' names to filenames.txt."
        )
    if lists:
        lights = read_lp(lists[0])
        names, notes = _photographs_of(lights, [file.name for file in images], photographs)
        left = [name for name in photographs if name not in names]
        notes = (*_left_out(left, f"not in {lists[0].name}"), *notes)
        return Listing(folder, names, masks, lights.directions, tuple(folder / name for name in left), notes)
    if not photographs:
        raise ValueError(f"{folder} holds no photograph. Give a folder with images: {', '.join(SUFFIXES)}.")
    kept, notes = _alike(photographs)
    left = tuple(folder / name for name in photographs if name not in kept and name not in _made_of_raw(photographs))
    return Listing(folder, kept, masks, None, left, notes)


def _alike(photographs: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the photographs that are named alike, and notes on the others."""
    twice = _made_of_raw(photographs)
    rest = [name for name in photographs if name not in twice]
    alike = Counter(pattern(name) for name in rest).most_common(1)
    kept = [name for name in rest if pattern(name) == alike[0][0]]
    if len(kept) < max(ALIKE * len(rest), 3):
        kept = rest
    left = [name for name in rest if name not in kept]
    notes = (
        *_left_out(twice, "the RAW file of the same name is read"),
        *(_left_out(left, f"the others are named as {kept[0]}") if left else ()),
    )
    return tuple(kept), notes


def _made_of_raw(photographs: Sequence[str]) -> list[str]:
    """Return the photographs beside which there is a RAW file of the same name."""
    raw = {Path(name).stem for name in photographs if is_raw(name)}
    return [name for name in photographs if Path(name).stem in raw and not is_raw(name)]


def _names_in(path: Path, there: Sequence[str]) -> tuple[str, ...]:
    """Return the photographs that a `filenames.txt` names; refuse one that leads out of its folder."""
    names = [line.strip() for line in read_text(path, "list of photographs").splitlines() if line.strip()]
    if not names:
        raise ValueError(f"{path} names no photograph. Write one file name a line.")
    for name in names:
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise ValueError(f"{path} must name photographs in its own folder; got '{name}'. Copy or link it there.")
    found = by_name(names, there)
    return tuple(name if i is None else there[i] for name, i in zip(names, found, strict=True))


def _photographs_of(
    lights: LightList, there: Sequence[str], photographs: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the photograph of each light of a list, and notes."""
    found = by_name(lights.names, there)
    if all(i is None for i in found):
        kept, notes = _alike(photographs) if photographs else ((), ())
        if len(kept) != len(found):
            raise ValueError(
                f"{lights.path} lists {count(len(found), 'light')}, none by the name of one of the "
                f"{count(len(kept), 'photograph')} in its folder. Give each photograph its light, by name or in order."
            )
        order = in_order(lights.names, kept)
        return tuple(kept[i] for i in order), (*notes, *lights.notes, _read_by_order(lights, [kept[i] for i in order]))
    for name, i in zip(lights.names, found, strict=True):
        if i is None:
            raise ValueError(
                f"{lights.path} names '{name}', which is not in its folder; the list has {count(len(found), 'light')}, "
                f"and the folder {count(len(photographs), 'photograph')}. Add the photograph, or correct the list."
            )
        if found.count(i) > 1:
            raise ValueError(f"{lights.path} names '{there[i]}' twice. Give each photograph one light.")
    return tuple(there[i] for i in found if i is not None), lights.notes


def _directions_of(
    names: Sequence[str], lights: LightList
) -> tuple[Float[np.ndarray, "photographs 3"] | None, tuple[str, ...]]:
    """Return the direction of the light of each photograph, None where a list has not all of them; and notes."""
    found = by_name(names, lights.names)
    missing = [name for name, i in zip(names, found, strict=True) if i is None]
    if not missing:
        return lights.directions[[i for i in found if i is not None]], lights.notes
    if len(missing) == len(names) == len(lights.names):
        order = in_order(names, lights.names)
        listed = [lights.names[i] for i in order]
        said = _read_by_order(lights._replace(names=tuple(listed)), names)
        return lights.directions[order], (*lights.notes, said)
    return None, (
        f"{lights.path.name} is not used: of {count(len(lights.names), 'light')}, it has none for {missing[0]}.",
    )


def _read_by_order(lights: LightList, names: Sequence[str]) -> str:
    """Return the note on a list that names other photographs."""
    first, last = (f"{lights.names[i]} is {names[i]}" for i in (0, -1))
    return f"{lights.path.name} has the names of other photographs and is read by order: {first}, to {last}."


def _left_out(names: list[str], why: str) -> tuple[str, ...]:
    if not names:
        return ()
    shown = listing(names) if len(names) <= MAX_NAMED else f"{count(len(names), 'image')}, such as {names[0]},"
    return (f"{shown} {'is' if len(names) == 1 else 'are'} left out: {why}.",)


def is_raw(name: str) -> bool:
    """Whether a file is what a camera's sensor gave."""
    return Path(name).suffix.lower() in RAW_SUFFIXES


def pattern(name: str) -> str:
    """Return what a name has in common with those of one series: all but its digits."""
    return re.sub(r"\d+", "0", Path(name).stem)


def natural_order(name: str) -> list[Any]:
    """Return a key by which 2 comes before 10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def by_name(wanted: Sequence[str], there: Sequence[str]) -> list[int | None]:
    """Return which of the names that are there is meant by each that is wanted; None for none.

    They may differ in case, in blanks, in how accents are composed (by a Mac or by others), and in the suffix. Of a RAW
    file and what the camera made of it, the RAW file counts.
    """
    exact = {name: i for i, name in enumerate(there)}
    alike = {_key(name): i for i, name in enumerate(there)}
    stems: dict[str, int] = {}
    for i, name in enumerate(there):
        if _key(Path(name).stem) not in stems or is_raw(name):
            stems[_key(Path(name).stem)] = i
    places = ((exact, lambda name: name), (alike, _key), (stems, _key), (stems, lambda name: _key(Path(name).stem)))
    return [next((of[key(name)] for of, key in places if key(name) in of), None) for name in wanted]


def _key(name: str) -> str:
    return " ".join(unicodedata.normalize("NFC", name).casefold().split())


def in_order(wanted: Sequence[str], there: Sequence[str]) -> list[int]:
    """Return which of as many other names goes with each name that is wanted.

    Where both are numbered, the order is that of the numbers: a list that was sorted as text has 10 before 2.
    """
    numbered = all(len({pattern(name) for name in names}) == 1 for names in (wanted, there))
    if not numbered:
        return list(range(len(wanted)))
    ranks = [sorted(range(len(names)), key=lambda i, names=names: natural_order(names[i])) for names in (wanted, there)]
    pairs = dict(zip(*ranks, strict=True))
    return [pairs[i] for i in range(len(wanted))]
