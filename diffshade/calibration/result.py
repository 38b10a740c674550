"""Result: the lights found by a calibration, with errors and notes, and the files that it writes for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.robust_scale import GAUSS_95
from ..core.tables import as_text, cells, parameters
from ..core.words import count, listing
from ..inverse.data.folder_lights import clear_folder, write_lights, write_photograph
from ..inverse.data.light_lists import lines_of, numbers_in
from ..inverse.data.views import View
from ..inverse.result import Fit
from ..io.arrays import write_array
from ..io.files import write_file
from ..io.images import write_image
from ..io.lazy_images import HeldImage
from ..io.scene_files import write_scene
from ..model.cameras import AbstractCamera, OrthographicCamera
from ..model.scenes import Scene
from .balls import Ball, Vectors


@dataclass(frozen=True, eq=False)
class Calibration:
    """The lights of photographs of a ball, with errors; `print` it for the table.

    Fit the ball's own material with `fit(calibration.scene, calibration.views, free=...)`.
    """

    ball: str
    names: tuple[str, ...]
    """The names of the photographs."""
    balls: tuple[Ball, ...] = field(repr=False)
    """The ball, or the balls, as found in the photographs."""
    scene: Scene = field(repr=False)
    """The ball, with k_d 1 or as fitted, and a light for each photograph."""
    images: tuple[Any, ...] = field(repr=False)
    """The photographs, read by rows: `image[r0:r1]`; those of a mirror ball are held as their files store them."""
    directions: Vectors
    """Unit vectors *towards* the light of each photograph."""
    errors: Float[np.ndarray, " photographs"]
    """Root mean square error of each direction, degrees: its angle, about both axes."""
    notes: tuple[str, ...]
    """What these photographs do not determine, and what looks wrong: a sentence each."""
    intensities: Vectors | None = None
    """R, G, B of each light, in units where the ball's k_d is 1 (for a glossy ball: the first light's intensity); None
    for a mirror ball."""
    intensity_errors: Float[np.ndarray, " photographs"] | None = None
    """Relative standard error of each intensity, for a matte ball."""
    positions: Vectors | None = None
    """The positions of the lights, scene units, from two mirror balls or more; NaN for a light that is far away."""
    position_errors: Vectors | None = None
    """Standard errors of the positions."""
    fit: Fit | None = field(default=None, repr=False)
    """The fit of pose, lights and material, for a glossy ball."""
    fit_errors: Float[np.ndarray, " p"] | None = None
    """Standard errors of its values, by patches of the ball if these disagree more than noise explains; infinite where
    a value is not determined."""

    @property
    def light_error(self) -> Float[np.ndarray, " photographs"]:
        """The error of each direction about each axis, degrees, for `fit` and `fit_texels(..., light_error=)`."""
        return self.errors / np.sqrt(2.0)

    @cached_property
    def views(self) -> tuple[View, ...]:
        """The photographs, decoded; only light i is on in photograph i."""
        return views_of(self.images, self.balls)

    @property
    def camera(self) -> AbstractCamera:
        """The camera of all the photographs."""
        return self.balls[0].camera

    @property
    def normals(self) -> Float[np.ndarray, "h w 3"]:
        """The normals of the ball at every pixel, 0 outside it."""
        return np.sum([ball.normals() for ball in self.balls], 0)

    def compare(self, directions: Any, *, name: str = "the other list") -> Comparison:
        """Compare other directions with these, in degrees and in standard errors.

        Args:
            directions: (n, 3) towards the lights, a text file of them (a first line with their count is skipped), or
                another `Calibration`, whose errors then count too.
            name: The name of the other directions in the sentence.

        Returns:
            The angles, and the photographs in which the two disagree.

        Raises:
            ValueError: If there is not one direction for each photograph.
            FileNotFoundError: If the file does not exist.
        """
        if isinstance(directions, str | Path) and name == "the other list":
            name = Path(directions).name
        other, errors = given_directions(directions, self.names, name)
        return Comparison(name, self.names, degrees(self.directions, other), np.hypot(self.errors, errors))

    def write(self, folder: str | Path) -> None:
        """Write photographs and lights as a folder that `read_photographs` reads, in DiLiGenT's layout.

        The files are `filenames.txt`, the photographs (linear, 16 bits; .npy if they exceed 1), `mask.png`,
        `light_directions.txt` (towards the light), `light_intensities.txt`, the ball's `normal_gt.npy`, and
        `scene.toml` with ball, lights and camera. DiLiGenT's layout has no pinhole camera: with one, only the
        photographs, the mask and `scene.toml` are written.

        Args:
            folder: The folder to write, a new or empty one or that of another calibration. It is created.

        Raises:
            NotADirectoryError: If `folder` is a file.
            FileExistsError: If `folder` holds other files, such as the photographs themselves.
            OSError: If a file cannot be written.
        """
        folder = check_folder(folder)
        clear_folder(folder)
        names = [
            write_photograph(folder, f"{i:03d}", np.asarray(image[:], np.float64))
            for i, image in enumerate(self.images)
        ]
        write_image(
            folder / "mask.png", np.logical_or.reduce([ball.mask for ball in self.balls])[..., None] * 1.0, srgb=False
        )
        write_scene(folder / "scene.toml", self.scene, camera=self.camera)
        if isinstance(self.camera, OrthographicCamera):
            intensities = np.ones_like(self.directions) if self.intensities is None else self.intensities
            write_array(folder / "normal_gt.npy", self.normals)
            write_lights(folder, self.directions, intensities)
        # written last: its presence marks a complete folder
        write_file(folder / "filenames.txt", "".join(f"{name}\n" for name in names))

    def __str__(self) -> str:
        """Return the table of the lights, and the notes below it."""
        where = [f"column {b.middle[0]:.2f}, row {b.middle[1]:.2f}, radius {b.radius:.2f} pixels" for b in self.balls]
        title = f"{self.ball} ball in {count(len(self.names), 'photograph')}: {'; '.join(where)}"
        columns: dict[str, Any] = {
            "photograph": self.names,
            "x y z": cells(self.directions, np.deg2rad(self.errors)[:, None]),
            "error (deg)": cells(self.errors, self.errors),
        }
        if self.intensities is not None and self.intensity_errors is not None:
            percent = 100.0 * self.intensity_errors
            columns["R G B"] = cells(self.intensities, self.intensities * self.intensity_errors[:, None])
            columns["error (%)"] = cells(percent, percent)
        elif self.positions is not None and self.position_errors is not None:
            errors = np.linalg.norm(self.position_errors, axis=-1)
            columns["position"] = cells(self.positions, errors[:, None])
            columns["error"] = cells(errors, errors)
        fitted = {}
        if self.fit is not None and self.fit_errors is not None:
            fitted = parameters(self.fit.names, self.fit.values, self.fit_errors, np.isfinite(self.fit_errors))
        return as_text(title, columns, fitted, notes=self.notes)


@dataclass(frozen=True, eq=False)
class Comparison:
    """The difference between other directions and those of a calibration; `print` it for a sentence."""

    name: str
    photographs: tuple[str, ...]
    angles: Float[np.ndarray, " photographs"]
    """The angle between the two directions of each photograph, degrees."""
    errors: Float[np.ndarray, " photographs"]
    """Root mean square errors, degrees: the calibration's, combined with the other's where it is known."""

    @property
    def disagrees(self) -> list[int]:
        """The photographs in which the two differ by more than two errors."""
        return np.flatnonzero(self.angles > GAUSS_95 * self.errors).tolist()

    def __str__(self) -> str:
        mean = f"they differ by {self.angles.mean():.2f} degrees on average, and by at most {self.angles.max():.2f}"
        where = [
            f"{self.photographs[i]} ({self.angles[i]:.1f} degrees, {self.angles[i] / self.errors[i]:.1f} errors)"
            for i in self.disagrees
        ]
        if not where:
            return f"{self.name} agrees within two errors in every photograph; {mean}."
        others = len(self.photographs) - len(where)
        if len(where) > 1 and not others:
            ratio = self.angles / self.errors
            every = f"all {len(where)} photographs, by {ratio.min():.0f} to {ratio.max():.0f} errors"
            return f"{self.name} disagrees in {every}; {mean}."
        rest = f", and agrees within two errors in the other {others}" if others else ""
        return f"{self.name} disagrees in {listing(where)}{rest}; {mean}."


def check_folder(folder: str | Path) -> Path:
    """Return a folder to write to: a new or empty one, or that of another calibration."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"cannot write to {folder}: it is not a folder. Give the name of a new folder.")
    there = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    if there and not ("filenames.txt" in there and {"scene.toml", "light_errors.txt"} & set(there)):
        raise FileExistsError(f"{folder} holds other files, such as {there[0]}. Give the name of a new folder.")
    return folder


def views_of(images: Sequence[Any], balls: tuple[Ball, ...]) -> tuple[View, ...]:
    """Return a view for each photograph, masked to the balls and with its own light on."""
    mask = np.logical_or.reduce([ball.mask for ball in balls])
    # to a view, a lazy image is one that is not in memory: what is held is decoded
    whole = (image[:] if isinstance(image, HeldImage) else image for image in images)
    return tuple(View(image, balls[0].camera, mask, lit=(i,)) for i, image in enumerate(whole))


def degrees(a: Vectors, b: Vectors) -> Float[np.ndarray, " photographs"]:
    """Return the angles between vectors."""
    across = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.rad2deg(np.arctan2(across, (a * b).sum(-1)))


def given_directions(
    directions: Any, names: Sequence[str], what: str
) -> tuple[Vectors, Float[np.ndarray, " photographs"]]:
    """Return directions of a list, a file or a calibration as unit vectors, and their errors, 0 where not known.

    Args:
        directions: One towards the light of each photograph.
        names: The names of the photographs.
        what: What the directions are called.
    """
    errors = directions.errors if isinstance(directions, Calibration) else np.zeros(len(names))
    if isinstance(directions, str | Path):
        directions = read_directions(Path(directions))
    found = np.asarray(directions.directions if isinstance(directions, Calibration) else directions, np.float64)
    if found.shape != (len(names), 3):
        raise ValueError(
            f"{what} must hold one vector for each of the {len(names)} photographs; got shape {found.shape}. The "
            f"photographs are {listing(names)}: make the two match, for example with a filenames.txt in the folder "
            "that lists the photographs to use, one per line."
        )
    length = np.linalg.norm(found, axis=-1)
    if (wrong := ~(np.isfinite(length) & (length > 0.0))).any():
        bad = int(wrong.argmax())
        raise ValueError(
            f"{what} must be finite and not zero; got {found[bad].tolist()} for photograph {bad}. Give (x, y, z) "
            "towards its light."
        )
    return found / length[:, None], errors


def read_directions(path: Path) -> Float[np.ndarray, "n 3"]:
    """Read three numbers per line, and skip a first line that holds their count."""
    try:
        rows = [numbers_in(line) for _, line in lines_of(path)]
        rows = rows[1:] if rows and len(rows[0]) == 1 else rows
        return np.array(rows).reshape(len(rows), 3)
    except ValueError:
        raise ValueError(
            f"{path} must hold three numbers per line, the direction towards each light. Correct the file."
        ) from None
