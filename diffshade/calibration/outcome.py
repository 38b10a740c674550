"""Outcome: the lights that a ball tells, with their errors, what it cannot tell, and the files others read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.words import count, listing
from ..inverse.data.views import View
from ..inverse.result import Fit
from ..io.files import replacing
from ..io.images import write_image
from ..io.scene_files import write_scene
from ..model.cameras import AbstractCamera, OrthographicCamera
from ..model.scenes import Scene
from .balls import Ball
from .photographs import Photographs

Vectors = Float[np.ndarray, "photographs 3"]

LAYOUT = ("filenames.txt", "light_directions.txt", "light_intensities.txt", "normal_gt.npy")
DIM = 0.1  # of the range of a file, below which 16 bits would round a photograph
CLEAR = 2.0  # standard errors, beyond which two directions disagree


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a ball tells of the lights of photographs; `print` it for the table.

    With `fit(calibration.scene, calibration.views, free=...)` one goes on to the ball's own material.
    """

    ball: str
    names: tuple[str, ...]
    """The photographs."""
    balls: tuple[Ball, ...]
    """Where the ball is seen, or the balls."""
    scene: Scene
    """The ball, of k_d 1 or as it was fitted, and a light for each photograph."""
    views: tuple[View, ...]
    """The photographs; light i is on in photograph i alone."""
    directions: Vectors
    """Unit vectors *towards* the light of each photograph."""
    errors: Float[np.ndarray, " photographs"]
    """Root mean square error of each direction, degrees."""
    notes: tuple[str, ...]
    """What these photographs cannot tell, and what looks wrong: a sentence each."""
    intensities: Vectors | None = None
    """R, G, B of each light, where the ball's k_d is 1 or, of a glossy ball, the first light's intensity; None where
    the ball does not tell them."""
    intensity_errors: Float[np.ndarray, " photographs"] | None = None
    """Relative standard error of each intensity of a matte ball's."""
    positions: Vectors | None = None
    """Where the lights are, scene units, NaN where it is not known: from two mirror balls or more."""
    position_errors: Vectors | None = None
    """Standard errors of the positions."""
    fit: Fit | None = None
    """The fit of pose, light and material, of a glossy ball."""
    fit_errors: Float[np.ndarray, " p"] | None = None
    """Standard errors of its values: by patches of the ball where these disagree more than noise lets them;
    infinite where nothing is determined."""

    @property
    def camera(self) -> AbstractCamera:
        """The camera of all the photographs."""
        return self.views[0].camera

    @property
    def normals(self) -> Float[np.ndarray, "h w 3"]:
        """The normals of the ball at every pixel, 0 outside."""
        return np.sum([ball.normals() for ball in self.balls], 0)

    def compare(self, directions: Any, *, name: str = "the other list") -> Comparison:
        """Say where other directions disagree: by how many degrees, and how many standard errors.

        `directions`: (n, 3) towards the lights, a text file of them (a line with one number, their count, is passed
        over), or another `Calibration`, whose errors then count too. Raises ValueError.
        """
        errors = self.errors
        if isinstance(directions, Calibration):
            errors = np.hypot(errors, directions.errors)
            directions = directions.directions
        elif isinstance(directions, str | Path):
            name = Path(directions).name if name == "the other list" else name
            directions = read_directions(Path(directions))
        other = np.asarray(directions, np.float64)
        if other.shape != self.directions.shape or not (np.linalg.norm(other, axis=-1) > 0).all():
            raise ValueError(
                f"{name} must hold one unit vector for each of the {len(self.names)} photographs; got shape "
                f"{other.shape}. The photographs are {listing(self.names)}: make the two match, if need be with a "
                "filenames.txt in their folder that names those that count, one a line."
            )
        return Comparison(name, self.names, degrees(self.directions, other), errors)

    def write(self, folder: str | Path) -> None:
        """Write photographs and lights as a folder that `read_photographs` reads, in DiLiGenT's layout.

        `filenames.txt`, the photographs (linear, 16 bits; .npy where they pass 1), `mask.png`, `light_directions.txt`
        (towards the light), `light_intensities.txt` and the ball's `normal_gt.npy`; `scene.toml` has ball, lights and
        camera. For a camera near by, which that layout does not know, only the photographs, the mask and `scene.toml`.
        The folder is made. Raises ValueError for several balls seen from near by, FileExistsError for a folder of
        other things, such as the photographs themselves, and OSError.
        """
        folder = check_folder(folder)
        folder.mkdir(parents=True, exist_ok=True)
        for name in LAYOUT:  # of another calibration
            (folder / name).unlink(missing_ok=True)
        names = []
        for i, view in enumerate(self.views):
            image = np.asarray(view.image[:], np.float64)
            names.append(f"{i:03d}.{'png' if image.min() >= 0.0 and DIM <= image.max() <= 1.0 else 'npy'}")
            write_image(folder / names[-1], image, srgb=False, **({"bits": 16} if names[-1].endswith("png") else {}))
        write_image(
            folder / "mask.png", np.logical_or.reduce([ball.mask for ball in self.balls])[..., None] * 1.0, srgb=False
        )
        write_scene(folder / "scene.toml", self.scene, camera=self.camera)
        if isinstance(self.camera, OrthographicCamera):
            self._write_layout(folder)
        with replacing(folder / "filenames.txt") as temporary:  # the last, which says that all is there
            temporary.write_text("".join(f"{name}\n" for name in names), encoding="utf-8")

    def _write_layout(self, folder: Path) -> None:
        """Write what DiLiGenT's layout has of the lights and the ball."""
        intensities = np.ones_like(self.directions) if self.intensities is None else self.intensities
        normals = self.normals
        texts = {
            "light_directions.txt": "".join(" ".join(f"{x:.17g}" for x in row) + "\n" for row in self.directions),
            "light_intensities.txt": "".join(" ".join(f"{x:.17g}" for x in row) + "\n" for row in intensities),
        }
        with replacing(folder / "normal_gt.npy") as temporary:
            np.save(temporary, normals)
        for name, text in texts.items():
            with replacing(folder / name) as temporary:
                temporary.write_text(text, encoding="utf-8")

    def __str__(self) -> str:
        """Return the table of the lights, and below it the notes."""
        where = [f"column {b.middle[0]:.2f}, row {b.middle[1]:.2f}, radius {b.radius:.2f} pixels" for b in self.balls]
        width = max(len("photograph"), *map(len, self.names))
        lines = [
            f"{self.ball} ball in {count(len(self.names), 'photograph')}: {'; '.join(where)}",
            f"{'photograph':<{width}} {'x':>8} {'y':>8} {'z':>8}  {'error':>10}",
        ]
        if self.intensities is not None and self.intensity_errors is not None:
            lines[1] += f" {'R':>8} {'G':>8} {'B':>8} {'error':>7}"
        elif self.positions is not None:
            lines[1] += f" {'position':>26} {'error':>7}"
        for i, name in enumerate(self.names):
            x, y, z = self.directions[i]
            line = f"{name:<{width}} {x:>8.4f} {y:>8.4f} {z:>8.4f}  {self.errors[i]:>6.2f} deg"
            if self.intensities is not None and self.intensity_errors is not None:
                r, g, b = self.intensities[i]
                line += f" {r:>8.4g} {g:>8.4g} {b:>8.4g} {100 * self.intensity_errors[i]:>5.2g} %"
            elif self.positions is not None and self.position_errors is not None:
                p, error = self.positions[i], float(np.linalg.norm(self.position_errors[i]))
                line += f" {p[0]:>8.4g} {p[1]:>8.4g} {p[2]:>8.4g} {error:>7.2g}"
            lines.append(line)
        if self.fit is not None and self.fit_errors is not None:
            width = max(len("parameter"), *map(len, self.fit.names))
            lines.append(f"{'parameter':<{width}} {'value':>12} {'error':>11}")
            lines += [
                f"{name:<{width}} {value:>12.6g} {error:>11.2g}" if known else f"{name:<{width}} {'not determined':>12}"
                for name, value, error, known in zip(
                    self.fit.names, self.fit.values, self.fit_errors, np.isfinite(self.fit_errors), strict=True
                )
            ]
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])


@dataclass(frozen=True, eq=False)
class Comparison:
    """How directions of another list differ from those of a calibration; `print` it for the sentence."""

    name: str
    photographs: tuple[str, ...]
    angles: Float[np.ndarray, " photographs"]
    """Degrees between the two."""
    errors: Float[np.ndarray, " photographs"]
    """Root mean square errors, degrees, of the calibration and, where it is known, of the list."""

    @property
    def disagrees(self) -> list[int]:
        """The photographs in which the two differ by more than two errors."""
        return np.flatnonzero(self.angles > CLEAR * self.errors).tolist()

    def __str__(self) -> str:
        mean = f"on average they differ by {self.angles.mean():.2f} degrees, at most by {self.angles.max():.2f}"
        where = [
            f"{self.photographs[i]} ({self.angles[i]:.1f} degrees, {self.angles[i] / self.errors[i]:.1f} errors)"
            for i in self.disagrees
        ]
        if not where:
            return f"{self.name} agrees within two errors in every photograph; {mean}."
        others = len(self.photographs) - len(where)
        rest = f", and agrees within two errors in the other {others}" if others else ""
        return f"{self.name} disagrees in {listing(where)}{rest}; {mean}."


def check_folder(folder: str | Path) -> Path:
    """Return a folder to write to: a new or an empty one, or that of another calibration."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"cannot write to {folder}: it is no folder. Give the name of a new one.")
    there = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    if there and not {"scene.toml", "filenames.txt"} <= set(there):
        raise FileExistsError(f"{folder} holds other files, such as {there[0]}. Give the name of a new folder.")
    return folder


def views_of(taken: Photographs, balls: tuple[Ball, ...]) -> tuple[View, ...]:
    """Return a view for each photograph, in which the balls count and its own light is on."""
    mask = np.logical_or.reduce([ball.mask for ball in balls])
    return tuple(View(image, balls[0].camera, mask, lit=(i,)) for i, image in enumerate(taken.images))


def degrees(a: Vectors, b: Vectors) -> Float[np.ndarray, " photographs"]:
    """Return the angles between vectors."""
    across = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.rad2deg(np.arctan2(across, (a * b).sum(-1)))


def read_directions(path: Path) -> Float[np.ndarray, "n 3"]:
    """Read three numbers a line, and pass over a first line that counts them."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}. Give a text of three numbers a line.")
    rows = [line.replace(",", " ").split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    rows = rows[1:] if rows and len(rows[0]) == 1 else rows
    try:
        return np.array(rows, np.float64).reshape(len(rows), 3)
    except ValueError:
        raise ValueError(f"{path} must hold three numbers a line, towards each light. Correct it.") from None
