"""Applying: the lights of balls carried over to photographs of an object under the same lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ..core.tables import as_text, cells
from ..core.words import Note, count, listing
from ..inverse.data.exposures import exposures_of
from ..inverse.data.folder_lights import write_photographs
from ..inverse.data.folders import list_folder
from ..inverse.data.masks import find_mask
from ..inverse.data.photograph_files import PhotographFiles, photograph_files
from ..inverse.data.photographs import as_given
from ..io.images import without_alpha
from ..texels.lights.encoding import FileEncoding, judge_encoding
from .balls import Vectors
from .object_lights import ObjectLights, between, lights_at
from .object_width import Width, find_width, picture_points, sample_of
from .result import Calibration, check_folder
from .two_balls import LampPlaces


@dataclass(frozen=True, eq=False)
class AppliedLights:
    """Photographs of an object with the lights of balls; `print` it for what was assumed."""

    photographs: PhotographFiles = field(repr=False)
    """The files of the object, and how they are read."""
    mask: Bool[np.ndarray, "h w"] = field(repr=False)
    lights: ObjectLights = field(repr=False)
    """Directions and distances of the lights at the object, with errors."""
    intensities: Vectors
    """R, G, B of each, with the photograph's exposure where its EXIF states it."""
    notes: tuple[str, ...]
    """What was assumed, and what looks wrong: a sentence each."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the photographs."""
        return tuple(file.name for file in self.photographs.files)

    @property
    def encodings(self) -> tuple[str, ...]:
        """What each photograph is read as: sRGB, linear, or the name of a colour profile."""
        return tuple(of.encoding.name for of in self.photographs.read_as)

    @property
    def directions(self) -> Vectors:
        """Unit vectors towards the light of each photograph, at the object."""
        return self.lights.directions

    @property
    def errors(self) -> Float[np.ndarray, " photographs"]:
        """Root mean square error of each direction, degrees: its angle, about both axes."""
        return self.lights.errors

    @property
    def light_error(self) -> Float[np.ndarray, " photographs"]:
        """The error of each direction about each axis, degrees, for `fit` and `fit_texels(..., light_error=)`."""
        return self.errors / np.sqrt(2.0)

    @property
    def positions(self) -> Vectors:
        """Positions of the lamps from the middle of the object's picture, scene units: right, up, to the camera.

        NaN for a lamp that is far away.
        """
        known = np.isfinite(self.lights.distances)[:, None]
        return np.where(known, self.lights.directions * np.where(known, self.lights.distances[:, None], 1.0), np.nan)

    @property
    def position_errors(self) -> Vectors:
        """Standard errors of the positions, from those of direction and distance; infinite for a lamp far away."""
        l, far = self.lights.directions, self.lights.distances[:, None]
        across = np.deg2rad(self.light_error)[:, None] * far * np.sqrt(1.0 - l**2)
        return np.hypot(across, self.lights.distance_errors[:, None] * np.abs(l))

    def write(self, folder: str | Path) -> Path:
        """Write a folder that `read_photographs`, `fit`, `report` and `texels` take as it is.

        The files are the photographs (linear, 16 bits; .npy if they exceed 1), `filenames.txt`, `mask.png`,
        `light_directions.txt`, `light_intensities.txt`, `light_errors.txt` (degrees about each axis),
        `light_distances.txt` where lamps are near (heights of the picture from its middle; inf: far away) and
        `lights.lp`, the same directions for other programs.

        Args:
            folder: The folder to write, a new or empty one. It is created.

        Returns:
            The folder.

        Raises:
            NotADirectoryError: If `folder` is a file.
            FileExistsError: If `folder` holds other files.
            OSError: If a file cannot be written.
        """
        folder, height = check_folder(folder), self.lights.picture_height
        images = (np.asarray(image[:], np.float64) for image in self.photographs.images())
        distances = self.lights.distances / height if height else None
        lights = self.directions, self.intensities, self.light_error, distances
        write_photographs(folder, self.names, images, self.mask, *lights)
        return folder

    def __str__(self) -> str:
        """Return what was applied to what, and the notes below it."""
        title = (
            f"{count(len(self.names), 'photograph')} of an object, {self.mask.mean():.0%} of the picture; its lights "
            f"are known to {np.median(self.errors):.2g} degrees in the median, {self.errors.max():.2g} at most"
        )
        columns = {}
        if self.lights.picture_height:
            columns["photograph"] = self.names
            columns["position"] = cells(self.positions, self.position_errors)
            columns["error"] = cells(self.position_errors, self.position_errors)
        return as_text(title, columns, notes=self.notes)


def apply_lights(
    balls: Sequence[Calibration] | Calibration,
    photographs: str | Path,
    *,
    mask: Any = None,
    srgb: bool | None = None,
    exif: bool = True,
    apart: float | None = None,
    width: float | None = None,
) -> AppliedLights:
    r"""Carry the lights of one ball, or of several in other places, over to photographs of an object.

    One ball's directions are taken as they are, as if the object stood in its place. Two balls also show how far away
    near lamps are, in units of the distance between the balls:

    $$ l_{\pm} \propto m - w (\pm b/2 + r n) $$

    m is the direction from the middle between the balls, w the nearness (1 over the distance), b the unit vector from
    ball to ball, r n the highlight's place on a ball (see `diffshade.calibration.two_balls`). b is found from the
    highlights of all lamps. The object is assumed to stand in the middle, flat and facing the camera. Between more
    balls, or where no lamp is near, its directions are the mean, and how far they differ counts as error.

    Args:
        balls: The calibration of each ball. Its photographs are those of the object, in the same order: the first is
            under the same light as the object's first.
        photographs: The object's folder. A list of lights in it is not used.
        mask: A file or an array, True on the object. By default the folder's, else it is found in the photographs, in
            four ways that must agree.
        srgb: Whether to decode files from the sRGB curve. By default as the files state, else as they show: three
            numbers a texel explain linear photographs of a matte object; where that is not clear, by their type, as in
            `read_image`, and a note asks which they are.
        exif: Whether exposures that the photographs' EXIF states become part of the intensities of a mirror ball's
            lights; default True. The intensities of another ball have the exposures of its own photographs, and the
            object's are taken to be the same.
        apart: Distance between the middles of two balls, scene units (those of the balls' radius), above 0. By default
            that in the photographs if all have one size and the highlights do not contradict, else 4 radii.
        width: Width of the object, scene units, above 0. By default that in such photographs, else the one with which
            near lamps explain the object's photographs best, else as much as the balls are apart.

    Returns:
        Photographs, mask and lights.

    Raises:
        ValueError: If the numbers of photographs differ, no mask is found, or a length is not above 0.
        FileNotFoundError: If the folder does not exist.
    """
    balls = (balls,) if isinstance(balls, Calibration) else tuple(balls)
    folder = Path(photographs)
    if not balls:
        raise ValueError(
            "apply_lights needs the calibration of one ball at least; got none. Give ds.lights.calibrate(...)."
        )
    for name, length in (("apart", apart), ("width", width)):
        if length is not None and not (np.isfinite(length) and length > 0.0):
            raise ValueError(f"{name} must be above 0; got {length:g}. Give it in the units of the balls' radius.")
    listed = list_folder(folder)
    for ball in balls:
        if len(ball.names) != len(listed.names):
            raise ValueError(
                f"{folder} has {count(len(listed.names), 'photograph')}, and the ball {len(ball.names)}: "
                f"{listed.names[0]} to {listed.names[-1]}, and {ball.names[0]} to {ball.names[-1]}. Give one of each "
                "light, in one order."
            )
    given = as_given(listed.mask_file() if mask is None else mask) if mask is not None or listed.masks else None
    read = photograph_files(listed.files, srgb=srgb, shape=None if given is None else given.shape)
    shapes = {image.shape[:2] for image in read.images()}
    if len(shapes) > 1:
        raise ValueError(f"{folder} has photographs of sizes {sorted(shapes)}. Give photographs of one size.")
    notes = [*listed.notes, *_on_names(listed.names, balls)]
    if given is None:
        found = find_mask(replace(read, srgb=False).images())
        given = found.mask
        notes += [
            "the mask was found in the photographs; look at mask.png, or give one with --apply-mask.",
            *found.notes,
        ]
    if given.shape not in shapes:
        raise ValueError(f"the mask must have the photographs' shape {shapes.pop()}; got {given.shape}. Resize it.")
    if not given.any():
        raise ValueError(f"the mask of {folder} shows no pixel of an object. Give one that is white on it, with mask=.")
    read, judged = _judged(read, given, between(balls)[0])
    notes += read.notes
    known = [ball.intensities for ball in balls if ball.intensities is not None]
    if known:
        intensities = np.mean(known, 0)
    else:
        exposures, exposed = exposures_of(listed.files) if exif else (np.ones(len(listed.files)), [])
        intensities = exposures[:, None] * np.ones(3)
        notes += ["all lights are taken to have the intensity 1, which a mirror ball does not show.", *exposed]
    if (folder / "light_directions.txt").is_file() or listed.directions is not None:
        notes.append("the list of lights in the folder is not used.")

    def width_for(lamps: LampPlaces) -> Width | None:
        rows, columns = sample_of(given)
        shown = np.stack([without_alpha(image[:])[rows, columns].mean(-1) for image in read.images()], -1)
        return find_width(shown, picture_points(given)[rows, columns], lamps, intensities.mean(-1))

    lights = lights_at(balls, given, width_for, apart, width)
    notes += [*_on_encoding(read, judged), *lights.notes]
    return AppliedLights(read, given, lights, intensities, tuple(Note(n, "lights") for n in notes))


def _judged(
    read: PhotographFiles, mask: Bool[np.ndarray, "h w"], towards: Vectors
) -> tuple[PhotographFiles, FileEncoding | None]:
    """Return how photographs that state no encoding are read, and what they show of it themselves."""
    if read.srgb is not None or any(of.statement.encoding for of in read.read_as):
        return read, None
    judged = judge_encoding(replace(read, srgb=False).images(), mask, towards)
    if judged is None or not judged.clear:
        return read, judged
    return photograph_files(read.files, srgb=judged.srgb, shape=mask.shape), judged


def _on_encoding(read: PhotographFiles, judged: FileEncoding | None) -> list[str]:
    """Return what photographs show of their encoding, and what the other choice would change."""
    if judged is None:
        return []
    low, high = sorted(judged.misfits)
    turned = f"the other choice turns normals by {judged.turned:.2g} degrees in the median."
    if judged.clear:
        one, other = ("sRGB", "linear") if judged.srgb else ("linear", "sRGB")
        return [
            f"the photographs are taken to be {one}, as they show: of the values in the files, {low:.1%} stays "
            f"unexplained, and {high:.1%} as {other}; {turned}"
        ]
    names = listing(sorted({of.encoding.name for of in read.read_as}))
    return [
        "the photographs do not state whether they are linear or sRGB, and do not show it clearly: of the values in "
        "the files, {:.1%} stays unexplained as linear, and {:.1%} as sRGB. ".format(*judged.misfits)
        + f"They are read as {names} by type of file; {turned} Say which they are, with --srgb or --linear."
    ]


def _on_names(names: Sequence[str], balls: Sequence[Calibration]) -> list[str]:
    """Return a note where photographs are paired by their order although their names differ."""
    stems = [Path(name).stem for name in names]
    other = next((ball for ball in balls if [Path(name).stem for name in ball.names] != stems), None)
    if other is None:
        return []
    i = next(i for i, name in enumerate(other.names) if Path(name).stem != stems[i])
    return [f"photographs are paired in their order: {names[i]} is taken to have the light of {other.names[i]}."]
