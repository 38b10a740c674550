"""Applying: the lights of balls carried over to photographs of an object under the same lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..core.words import Note, count
from ..inverse.data.exposures import exposures_of
from ..inverse.data.folders import list_folder
from ..inverse.data.masks import find_mask
from ..inverse.data.photographs import as_given, mask_file, write_photographs
from ..io.images import encoding_of, read_image
from ..texels.lights.encoding import judge_encoding
from .balls import axes
from .result import Calibration, check_folder, degrees

Vectors = Float[np.ndarray, "photographs 3"]


@dataclass(frozen=True, eq=False)
class AppliedLights:
    """Photographs of an object with the lights of balls; `print` it for what was assumed."""

    files: tuple[Path, ...]
    """The photographs of the object."""
    srgb: tuple[bool, ...]
    """Whether each is decoded from the sRGB curve."""
    mask: Bool[np.ndarray, "h w"]
    directions: Vectors
    """Unit vectors towards the light of each photograph, at the object."""
    errors: Float[np.ndarray, " photographs"]
    """Root mean square error of each direction, degrees."""
    intensities: Vectors
    """R, G, B of each, with the photograph's exposure where its EXIF states it."""
    notes: tuple[str, ...]
    """What was assumed, and what looks wrong: a sentence each."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the photographs."""
        return tuple(file.name for file in self.files)

    def write(self, folder: str | Path) -> None:
        """Write a folder that `read_photographs`, `fit`, `report` and `texels` take as it is.

        The files are the photographs (linear, 16 bits; .npy if they exceed 1), `filenames.txt`, `mask.png`,
        `light_directions.txt`, `light_intensities.txt`, `light_errors.txt` (degrees about each axis) and
        `lights.lp`, the same directions for other programs.

        Args:
            folder: The folder to write, a new or empty one. It is created.

        Raises:
            NotADirectoryError: If `folder` is a file.
            FileExistsError: If `folder` holds other files.
            OSError: If a file cannot be written.
        """
        images = (read_image(file, srgb=srgb) for file, srgb in zip(self.files, self.srgb, strict=True))
        about_each = self.errors / np.sqrt(2.0)
        folder = check_folder(folder)
        write_photographs(folder, self.names, images, self.mask, self.directions, self.intensities, about_each)

    def __str__(self) -> str:
        """Return what was applied to what, and the notes below it."""
        lines = [
            f"{count(len(self.names), 'photograph')} of an object, {self.mask.mean():.0%} of the picture; its lights "
            f"are known to {np.median(self.errors):.2g} degrees in the median, {self.errors.max():.2g} at most"
        ]
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])


def apply_lights(
    balls: Sequence[Calibration] | Calibration,
    photographs: str | Path,
    *,
    mask: Any = None,
    srgb: bool | None = None,
    exif: bool = True,
) -> AppliedLights:
    """Carry the lights of one ball, or of several in other places, over to photographs of an object.

    One ball's directions are taken as they are, as if the object stood in its place. Between two balls or more the
    object is assumed to stand in their middle: its directions are their mean, and how far they differ counts as error.

    Args:
        balls: The calibration of each ball. Its photographs are those of the object, in the same order: the first is
            under the same light as the object's first.
        photographs: The object's folder. A list of lights in it is not used.
        mask: A file or an array, True on the object. By default the folder's, else it is found before a darker
            background.
        srgb: Whether to decode files from the sRGB curve. By default as the photographs show: linear ones of a matte
            object are three numbers a texel times three a light; where that is not clear, by their type, as in
            `read_image`.
        exif: Whether exposures that the photographs' EXIF states become part of the intensities of a mirror ball's
            lights; default True. The intensities of another ball have the exposures of its own photographs, and the
            object's are taken to be the same.

    Returns:
        Photographs, mask and lights.

    Raises:
        ValueError: If the numbers of photographs differ, or no mask is found.
        FileNotFoundError: If the folder does not exist.
    """
    balls = (balls,) if isinstance(balls, Calibration) else tuple(balls)
    folder = Path(photographs)
    if not balls:
        raise ValueError("apply_lights needs the calibration of one ball at least; got none. Give ds.calibrate(...).")
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}. Give the photographs of an object.")
    listed = list_folder(folder)
    for ball in balls:
        if len(ball.names) != len(listed.names):
            raise ValueError(
                f"{folder} has {count(len(listed.names), 'photograph')}, and the ball {len(ball.names)}: "
                f"{listed.names[0]} to {listed.names[-1]}, and {ball.names[0]} to {ball.names[-1]}. Give one of each "
                "light, in one order."
            )
    files = tuple(folder / name for name in listed.names)
    shapes = {read_image(file, srgb=False).shape[:2] for file in files}
    if len(shapes) > 1:
        raise ValueError(f"{folder} has photographs of sizes {sorted(shapes)}. Give photographs of one size.")
    notes = [*listed.notes, *_on_names(listed.names, balls)]
    given, how = _mask(folder, files, mask, in_folder=bool(listed.masks))
    if how:
        notes.append(how)
    if given.shape not in shapes:
        raise ValueError(f"the mask must have the photographs' shape {shapes.pop()}; got {given.shape}. Resize it.")
    decode, why = _encodings(files, given, srgb)
    notes += why
    directions, errors, said = between(balls)
    known = [ball.intensities for ball in balls if ball.intensities is not None]
    if known:
        intensities = np.mean(known, 0)
    else:
        exposures, exposed = exposures_of(files) if exif else (np.ones(len(files)), [])
        intensities = exposures[:, None] * np.ones_like(directions)
        notes += ["all lights are taken to have the intensity 1, which a mirror ball does not show.", *exposed]
    if (folder / "light_directions.txt").is_file() or listed.directions is not None:
        notes.append("the list of lights in the folder is not used.")
    return AppliedLights(
        files,
        decode,
        given,
        directions,
        errors,
        intensities,
        tuple(Note(n, "lights") for n in [*notes, *said]),
    )


def _encodings(
    files: Sequence[Path], mask: Bool[np.ndarray, "h w"], srgb: bool | None
) -> tuple[tuple[bool, ...], list[str]]:
    """Return which photographs are decoded from the sRGB curve, and a sentence where they say so themselves."""
    usual = tuple(encoding_of(file, srgb=srgb)[1] for file in files)
    judged = judge_encoding((read_image(file, srgb=False) for file in files), mask) if srgb is None else None
    if judged is None or not judged.clear:
        return usual, []
    names = ("linear", "sRGB") if not judged.srgb else ("sRGB", "linear")
    low, high = sorted(judged.misfits)
    return (judged.srgb,) * len(files), [
        f"the photographs are taken to be {names[0]}, as they show: their misfit is {low:.1%}; it is {high:.1%} as "
        f"{names[1]}."
    ]


def between(balls: Sequence[Calibration]) -> tuple[Vectors, Float[np.ndarray, " photographs"], list[str]]:
    """Return the directions in the middle of several balls, their errors, and what was assumed."""
    each = np.array([ball.directions @ axes(ball.balls[0].projection).T for ball in balls])  # as the camera sees them
    own = np.sqrt(np.mean([ball.errors**2 for ball in balls], 0) / len(balls))
    mean = each.mean(0)
    directions = mean / np.linalg.norm(mean, axis=-1, keepdims=True)
    if len(balls) == 1:
        return (
            directions,
            own,
            [
                "the object is taken to stand where the ball stood: beside it, a lamp 10 times as far away is off by "
                "up to 6 degrees. Photograph a ball on either side of the object."
            ],
        )
    apart = np.max([degrees(one, directions) for one in each], 0)
    half = float(np.mean(apart))
    return (
        directions,
        np.hypot(own, apart / np.sqrt(3.0)),
        [
            f"the object is taken to stand in the middle of the balls. Their directions are {half:.2g} degrees from "
            f"that on average and {apart.max():.2g} at most, so a place halfway from there to one of them turns the "
            f"lights by {half / 2.0:.2g}; the errors contain any place between them.",
            "the lamps' distances are not used: over an object as wide as the balls are apart, directions differ by "
            f"{2.0 * half:.2g} degrees from side to side.",
        ],
    )


def _on_names(names: Sequence[str], balls: Sequence[Calibration]) -> list[str]:
    """Return a note where photographs are paired by their order although their names differ."""
    stems = [Path(name).stem for name in names]
    other = next((ball for ball in balls if [Path(name).stem for name in ball.names] != stems), None)
    if other is None:
        return []
    i = next(i for i, name in enumerate(other.names) if Path(name).stem != stems[i])
    return [f"photographs are paired in their order: {names[i]} is taken to have the light of {other.names[i]}."]


def _mask(folder: Path, files: Sequence[Path], mask: Any, *, in_folder: bool) -> tuple[Bool[np.ndarray, "h w"], str]:
    """Return the mask, and a sentence where it was found."""
    if mask is not None:
        return as_given(mask), ""
    if in_folder:
        return as_given(mask_file(folder)), ""
    found = find_mask(read_image(file, srgb=False) for file in files)
    return found, "the mask was found before a darker background; look at mask.png, or give one with --mask."
