"""Lights of a folder: what its text files say of the light of each photograph, and what is written there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.thresholds import SMALL
from ...io.files import write_file
from ...io.images import without_alpha, write_image
from ...model.attenuation import RadialAttenuation
from ...model.lights import DirectionalLight, PointLight
from .folders import Listing
from .light_lists import UNIT, as_lp, lines_of, numbers_in, unit_vectors

WRITTEN = (
    "filenames.txt",
    "light_directions.txt",
    "light_intensities.txt",
    "light_errors.txt",
    "light_distances.txt",
    "lights.lp",
    "normal_gt.npy",
    "scene.toml",
)


class FolderLights(NamedTuple):
    """The light of each photograph in a folder."""

    directions: Float[np.ndarray, "photographs 3"]
    """Unit vectors towards the lights."""
    intensities: Float[np.ndarray, "photographs colours"]
    distances: Float[np.ndarray, " photographs"]
    """From the picture's middle, in heights of the picture; infinite for a lamp far away."""
    errors: Float[np.ndarray, " photographs"] | None
    """Of the directions, degrees about each axis; None where they are not known."""
    notes: list[str]
    """What is not said, or said and not used."""

    def lamp(self, photograph: int, height: float) -> DirectionalLight | PointLight:
        """Return the lamp of a photograph, whose light has its direction and intensity in the picture's middle."""
        direction, intensity = self.directions[photograph], self.intensities[photograph]
        if not np.isfinite(self.distances[photograph]):
            return DirectionalLight(-direction, intensity)
        far = self.distances[photograph] * height
        return PointLight(far * direction, intensity, attenuation=RadialAttenuation(0.0, 0.0, far**-2))


def read_lights(listed: Listing, *, known: bool) -> FolderLights:
    """Read the lights of a folder's photographs; where they are not `known`, their intensities alone."""
    number = len(listed.names)
    directions, distances, errors, notes = np.tile([0.0, 0.0, 1.0], (number, 1)), None, None, []
    if known:
        directions, notes = _directions(listed)
        distances, _ = _rows(listed, "light_distances.txt", (1,))
        errors, _ = _rows(listed, "light_errors.txt", (1,))
    if distances is not None and not (distances > 0.0).all():
        raise ValueError(
            f"{listed.folder / 'light_distances.txt'} must hold distances above 0, in heights of the picture; got "
            f"{distances.min():g}. Correct it, or write inf for a lamp far away."
        )
    if errors is not None and not (np.isfinite(errors) & (errors >= 0.0)).all():
        raise ValueError(
            f"{listed.folder / 'light_errors.txt'} must hold degrees, at least 0; got {errors.min():g}. Correct it."
        )
    intensities, _ = _rows(listed, "light_intensities.txt", (1, 3))
    if intensities is None:
        intensities = np.ones((number, 1))
        notes.append("there is no light_intensities.txt: all lights are taken to have the intensity 1.")
    far = np.full(number, np.inf) if distances is None else distances[:, 0]
    return FolderLights(directions, intensities, far, None if errors is None else errors[:, 0], notes)


def _directions(listed: Listing) -> tuple[Float[np.ndarray, "photographs 3"], list[str]]:
    """Return unit vectors towards the lights of the photographs, and what is said of them that is not used."""
    path = listed.folder / "light_directions.txt"
    vectors, lines = _rows(listed, path.name, (3,))
    if vectors is not None:
        directions, notes = unit_vectors(path, vectors, lines)
        if listed.directions is not None and not np.allclose(directions, listed.directions, rtol=0.0, atol=UNIT):
            notes.append("the list of lights (.lp) differs from light_directions.txt and is not used.")
        return directions, notes
    if listed.directions is None:
        raise FileNotFoundError(
            f"there is no file {path}, and no list of lights (.lp) of these photographs. Add one; `diffshade "
            "calibrate` finds the lights from a ball."
        )
    return listed.directions, []


def _rows(
    listed: Listing, name: str, widths: tuple[int, ...]
) -> tuple[Float[np.ndarray, "photographs numbers"] | None, list[int]]:
    """Return the numbers in a file, a row for each photograph, and the line of each; None without that file."""
    path = listed.folder / name
    if not path.is_file():
        return None, []
    lines = lines_of(path)
    if len(lines) != len(listed.names):
        raise ValueError(
            f"{path} must have one line for each of the {len(listed.names)} photographs; got {len(lines)}. "
            "Make the two lists match."
        )
    rows: list[list[float]] = []
    for number, line in lines:
        try:
            row = numbers_in(line)
        except ValueError as error:
            raise ValueError(f"{path} must hold numbers only: {error}. Correct line {number}.") from None
        if len(row) not in widths or len(row) != len([*rows, row][0]):
            raise ValueError(
                f"{path} must have {' or '.join(map(str, widths))} numbers a line; got {len(row)} on line {number}. "
                "Correct that line."
            )
        if np.isnan(row).any():
            raise ValueError(f"{path} must hold numbers only: got nan on line {number}. Correct that line.")
        rows.append(row)
    return np.array(rows), [number for number, _ in lines]


def write_lights(
    folder: Path, directions: Float[np.ndarray, "photographs 3"], intensities: Float[np.ndarray, "photographs 3"]
) -> None:
    """Write the lights of the photographs in a folder as `read_photographs` reads them.

    Args:
        folder: The folder.
        directions: Unit vectors towards the light of each photograph.
        intensities: R, G, B of each.
    """
    for name, rows in (("light_directions.txt", directions), ("light_intensities.txt", intensities)):
        _write(folder / name, (" ".join(f"{x:.17g}" for x in row) for row in rows))


def _write(path: Path, lines: Iterable[str]) -> None:
    write_file(path, "".join(f"{line}\n" for line in lines))


def write_photographs(
    folder: Path,
    names: Sequence[str],
    images: Iterable[Any],
    mask: Bool[np.ndarray, "h w"],
    directions: Float[np.ndarray, "photographs 3"],
    intensities: Float[np.ndarray, "photographs 3"],
    errors: Float[np.ndarray, " photographs"] | None,
    distances: Float[np.ndarray, " photographs"] | None = None,
) -> None:
    """Write photographs of an object and their lights as a folder that `read_photographs` reads.

    Args:
        folder: The folder, which is made; what an earlier run wrote there is replaced.
        names: Names for the photographs, whose suffixes become those of what is written.
        images: The photographs, linear.
        mask: True on the object.
        directions: Unit vectors towards the light of each photograph.
        intensities: R, G, B of each.
        errors: Error of each direction about each axis, degrees; None where it is not known.
        distances: Of the lamps from the picture's middle, in heights of the picture, infinite for one far away; None
            where all are.
    """
    clear_folder(folder)
    stems = [Path(name).stem for name in names]
    stems = stems if len(set(stems)) == len(stems) else [f"{i:03d}" for i in range(len(stems))]
    written = [write_photograph(folder, stem, image) for stem, image in zip(stems, images, strict=True)]
    write_image(folder / "mask.png", mask[..., None] * 1.0, srgb=False)
    write_lights(folder, directions, intensities)
    _write(folder / "lights.lp", as_lp(written, directions))
    if errors is not None:
        _write(folder / "light_errors.txt", (f"{error:.6g}" for error in errors))
    if distances is not None:
        _write(folder / "light_distances.txt", (f"{distance:.10g}" for distance in distances))
    _write(folder / "filenames.txt", written)  # last: it marks a complete folder


def clear_folder(folder: Path) -> None:
    """Make a folder for photographs and lights, without files of an earlier run that would be taken for new ones."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in WRITTEN:
        (folder / name).unlink(missing_ok=True)


def write_photograph(folder: Path, stem: str, image: Float[np.ndarray, "h w c"]) -> str:
    """Write a linear photograph in 16 bits, or as .npy if it exceeds 1 or would lose precision; return its name."""
    image = without_alpha(image)  # the mask says what alpha does
    fits = bool(np.isfinite(image).all() and image.min() >= 0.0 and SMALL <= image.max() <= 1.0)
    name = f"{stem}.{'png' if fits else 'npy'}"
    write_image(folder / name, image, srgb=False, **({"bits": 16} if fits else {}))
    return name
