"""The map of heights: the result of an integration of normals, to look at, to render, and to write."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core.tables import as_text
from ...core.thresholds import FEW
from ...core.words import Note, count
from ...io.images import write_image
from ...model.cameras import AbstractCamera
from ...model.gbuffers import GBuffer
from ..map_files import map_folder, write_about, write_numbers
from .differences import rays_of


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights of a surface, their standard errors, and the parts they are relative to, from `integrate_normals`.

    Row 0 is on top; numbers are float64.

    Normals determine heights relative to each other within a part, and under a perspective camera only up to a factor.
    The gauge is the plane through the camera's target, across its line of sight: under parallel rays each part's mean
    height is 0; under rays from the eye the geometric mean of each part's depths is the distance to that plane.

    Attributes:
        height: Towards the camera above that plane, along the line of sight, scene units; 0 outside.
        errors: Standard errors of the heights in that gauge, so of the difference from the part's mean (perspective:
            the relative error of the depth, times the depth); 1.96 of them hold the truth 95 % of the time. They follow
            from the errors of the normals, those that all normals share included, given the jumps that were found.
            Infinite in parts of fewer than 8 texels and where no normal is known; 0 outside.
        part: Part of each texel, from 0, the largest first; -1 outside. The heights of different parts relative to
            each other are not determined.
        jump_right: Whether the surface is interrupted between this texel and the next one to the right.
        jump_below: The same for the next one below.
        normal: The unit normals that were integrated, interpolated where they were not known; 0 outside.
        camera: The camera of the normals.
        notes: What is not determined, and what was assumed.
    """

    height: Float[np.ndarray, "h w"]
    errors: Float[np.ndarray, "h w"]
    part: Int[np.ndarray, "h w"]
    jump_right: Bool[np.ndarray, "h w"]
    jump_below: Bool[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    camera: AbstractCamera
    notes: tuple[Note, ...] = ()

    @property
    def mask(self) -> Bool[np.ndarray, "h w"]:
        """Where there are heights."""
        return self.part >= 0

    @property
    def depth(self) -> Float[np.ndarray, "h w"]:
        """Distance of each point from the eye along the line of sight, scene units; 0 outside."""
        return np.where(self.mask, rays_of(self.camera).distance - self.height, 0.0)

    @property
    def position(self) -> Float[np.ndarray, "h w 3"]:
        """Points of the surface in world coordinates, scene units; 0 outside."""
        rays = rays_of(self.camera)
        return np.where(self.mask[..., None], rays.start - self.depth[..., None] * rays.toward, 0.0)

    def as_surface(self) -> GBuffer:
        """Return the surface as its camera sees it, for `render` by that camera.

        Returns:
            The points and the normals that were integrated.
        """
        return GBuffer(self.normal, self.position, self.mask)

    def write(self, folder: str | os.PathLike[str], *, suffix: str = ".exr") -> list[Path]:
        """Write the heights to a folder, each file whole or not at all.

        The files are `height` and, except as PNG, `height_error`; `part.png`, of 16 bits, which holds 0 outside and
        elsewhere the number of the part plus 1; `height_preview.png`, of 8 bits, to look at; and `heights.toml`, which
        states the units, the gauge, the notes, and the scale of a PNG.

        Args:
            folder: The folder; it is made if it does not exist.
            suffix: ".npy" for the numbers as they are; ".exr" for the same in float32; ".png" for 16 bits, from the
                lowest height to the highest.

        Returns:
            The paths of the files.

        Raises:
            ValueError: The suffix is another one.
            OSError: A file cannot be written.
        """
        folder = map_folder(folder, suffix)
        low, high = self._range()
        shown = np.where(self.mask, (self.height - low) / (high - low), 0.0)[..., None]
        about: dict[str, object] = {
            "height": "scene units, towards the camera, above the plane through its target",
            "height_error": "scene units, standard error of the difference from the part's mean",
            "part": "0 outside, else the number of the part, from 1; relative heights of parts are not determined",
            "notes": [str(note) for note in self.notes],
        }
        written = [folder / f"height{suffix}"]
        if suffix == ".png":
            write_image(written[0], shown, srgb=False, bits=16)
            about["scale"] = {"black": low, "white": high}
        else:
            written.append(folder / f"height_error{suffix}")
            for path, numbers in zip(written, (self.height, self.errors), strict=True):
                write_numbers(path, numbers)
        written += [folder / "part.png", folder / "height_preview.png", folder / "heights.toml"]
        write_image(written[-3], np.minimum(self.part + 1, 65535)[..., None] / 65535.0, srgb=False, bits=16)
        write_image(written[-2], shown, srgb=False, bits=8)
        write_about(written[-1], about)
        return written

    def _range(self) -> tuple[float, float]:
        """Return the lowest and the highest height, or two different numbers where they are the same."""
        heights = self.height[self.mask]
        low, high = float(heights.min()), float(heights.max())
        return low, high if high > low else low + 1.0

    def __str__(self) -> str:
        """Return the number of texels and parts, the range of heights, their errors, and the notes."""
        low, high = self._range()
        finite = self.errors[self.mask & np.isfinite(self.errors)]
        parts = int((np.bincount(self.part[self.mask]) >= FEW).sum())
        error = f"{np.median(finite):.2g}" if finite.size else "infinite"
        return as_text(
            f"heights of {int(self.mask.sum()):,} texels in {count(parts, 'part')}, "
            f"{self.part.shape[0]} x {self.part.shape[1]} pixels",
            f"from {low:.4g} to {high:.4g} scene units, standard error {error} in the median",
            notes=self.notes,
        )
