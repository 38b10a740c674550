"""Files of photographs by one camera: they are turned alike, and what they state of their encoding is used or said.

The sensor that tells a camera how it is held is not sure when the camera looks down, as in a dome: files of pictures
that are stored alike then state different orientations. So all files of one stored size are turned as most of them
state.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.words import MAX_NAMED, count, listing
from ...io.images import ReadAs, read_as
from ...io.lazy_images import LazyImage, hold_image, open_image

OPENED = (".npy", ".zarr")  # files of numbers, which may be larger than memory


@dataclass(frozen=True)
class PhotographFiles:
    """Files of photographs by one camera, and how they are read."""

    files: tuple[Path, ...]
    srgb: bool | None
    """Whether they are decoded from the sRGB curve; None: as each states, else by its type."""
    orientations: tuple[int, ...]
    """How each is turned, as EXIF numbers it."""
    read_as: tuple[ReadAs, ...]
    notes: tuple[str, ...]
    """What is not read as it is stated, or not as such files usually are."""

    def read(self, index: int) -> Any:
        """Read a photograph, or open it where it may be larger than memory."""
        image = self.hold(index)
        return image if self.files[index].suffix.lower() in OPENED else image[:]

    def hold(self, index: int) -> LazyImage:
        """Read a photograph, and hold it as it is stored, or open it where it may be larger than memory."""
        file = self.files[index]
        if file.suffix.lower() in OPENED:
            return open_image(file, srgb=self.srgb)
        return hold_image(file, srgb=self.srgb, orientation=self.orientations[index])

    def images(self) -> Iterable[Any]:
        """Read the photographs, one at a time."""
        return (self.read(index) for index in range(len(self.files)))


def photograph_files(
    files: Iterable[Path], *, srgb: bool | None, shape: tuple[int, ...] | None = None
) -> PhotographFiles:
    """Return how the photographs of one camera are read; only their headers are.

    Args:
        files: The photographs.
        srgb: As for `read_image`.
        shape: Height and width of what is laid over the photographs, such as a mask, where it is known.

    Raises:
        FileNotFoundError: If a file does not exist.
        ImportError: As `read_image` raises it.
        OSError: If the header of a file is damaged.
    """
    files = tuple(files)
    for file in files:
        if not file.exists():
            raise FileNotFoundError(f"there is no file {file}. Add it, or correct the folder.")
    taken = tuple(read_as(file, srgb=srgb) for file in files)
    orientations, turned = _orientations(files, taken, shape)
    notes = *_on_encodings(files, taken, forced=srgb is not None), *turned
    return PhotographFiles(files, srgb, orientations, taken, notes)


def _orientations(
    files: Sequence[Path], taken: Sequence[ReadAs], shape: tuple[int, ...] | None
) -> tuple[tuple[int, ...], list[str]]:
    """Return how each photograph is turned, and sentences where that is not plain."""
    stated = [of.statement.orientation for of in taken]
    sizes = [of.statement.size for of in taken]
    most, notes = {}, []
    for size in dict.fromkeys(sizes):
        counts = Counter(o for o, s in zip(stated, sizes, strict=True) if s == size)
        fitting = [of for of in counts if size is None or shape in (None, size[::-1] if of > 4 else size)]
        given = listing([f"{of}" for of in sorted(counts)])
        if not fitting and shape == size:
            most[size] = 1
            notes.append(
                f"the photographs state the EXIF orientation {given}, but the mask or camera has the size of what is "
                "stored: they are not turned."
            )
            continue
        # As many for several: the smallest, so that 1, not turned, comes before the others.
        most[size] = usual = min(fitting or counts, key=lambda of: (-counts[of], of))
        others = [i for i, of in enumerate(stated) if sizes[i] == size and of != usual]
        if others:
            given = listing([f"{of}" for of in sorted({stated[i] for i in others})])
            named = _named([files[i] for i in others])
            notes.append(
                f"{named} {_verb('states', len(others))} the EXIF orientation {given}, and the others {usual}. "
                "One camera has one orientation: all are read as the others are."
            )
        if usual != 1 and size is not None:
            notes.append(
                f"the photographs state the EXIF orientation {usual} and are turned upright; mask, normals and lights "
                "must be of the upright picture."
            )
    return tuple(most[size] for size in sizes), notes


def _on_encodings(files: Sequence[Path], taken: Sequence[ReadAs], *, forced: bool) -> list[str]:
    """Return sentences on what the files state that is not what they are read as, or not what is usual."""
    notes: list[str] = []
    if not taken:
        return notes
    if unused := _counted(taken, lambda of: of.statement.unused):
        told = "; ".join(f"{count(n, 'photograph')} {_verb('states', n)} {what}" for what, n in unused.items())
        read = listing(sorted({of.encoding.name for of in taken if of.statement.unused}))
        notes.append(f"{told}. That is not used: read as {read}.")
    stated = [None if of.statement.encoding is None else of.statement.encoding.name for of in taken]
    names = Counter(of.encoding.name for of in taken)
    (usual, _), *others = names.most_common()
    if forced:
        for name, n in Counter(name for name in stated if name not in (None, usual)).items():
            notes.append(f"{count(n, 'photograph')} {_verb('states', n)} {name}; read as {usual}, as requested.")
    elif others:
        for name, _ in others:
            these = [i for i, of in enumerate(taken) if of.encoding.name == name]
            why = "as stated" if all(stated[i] for i in these) else "by the type of file"
            notes.append(
                f"{_named([files[i] for i in these])} {_verb('is', len(these))} read as {name}, {why}, and the others "
                f"as {usual}. If all are alike, give srgb= (--srgb or --linear)."
            )
    else:
        for type_of, n in _counted(
            taken, lambda of: of.usual.name if of.encoding.name != of.usual.name else ""
        ).items():
            notes.append(
                f"{count(n, 'photograph')} {_verb('states', n)} {usual}, and {_verb('is', n)} read so; such files are "
                f"otherwise read as {type_of}."
            )
    return notes


def _counted(taken: Sequence[ReadAs], what: Callable[[ReadAs], str]) -> Counter[str]:
    return Counter(found for of in taken if (found := what(of)))


def _verb(verb: str, n: int) -> str:
    return verb if n == 1 else {"is": "are", "states": "state"}[verb]


def _named(files: Sequence[Path]) -> str:
    if len(files) <= MAX_NAMED:
        return listing([file.name for file in files])
    return f"{count(len(files), 'photograph')}, such as {files[0].name},"
