"""Maps: the result of a fit of texels, to look at, to shade with, and to write."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, UInt8

from ..core.backend import in_float64
from ..core.fields import quantities
from ..core.robust_scale import GAUSS_95
from ..core.tables import as_text, cells
from ..core.thresholds import INTERVALS, UNCLIPPED_PERCENT
from ..inverse.data.sensors import Sensor
from ..inverse.data.views import View
from ..inverse.result import Prediction
from ..io.images import write_image
from ..io.scene_files import scene_document, write_scene
from ..model.cameras import AbstractCamera
from ..model.gbuffers import GBuffer
from ..model.lights import AbstractLight
from ..model.lobes import AbstractLobe
from ..model.materials import Highlight
from ..model.rendering import intersect, render, select
from ..model.scenes import Scene, as_tuple
from .lighting import Exposures, Shifts
from .map_files import map_folder, read_numbers, write_about, write_numbers
from .predictions import prediction_of, relative_error
from .status import DETERMINED, NO_HIGHLIGHT, OUTSIDE, STATUS
from .unexplained import Unexplained

FORMAT = 2  # of the folder, finished or not; `read_maps` refuses others
ABOUT, SCENE, STATUS_PICTURE, WEIGHTS = "maps.toml", "scene.toml", "status.png", "highlight_weights.npy"
LIGHTS = "unexplained_lights.npy"
UNITS = {
    "k_a": "of the ambient light",
    "k_d": "of the light that arrives",
    "k_s": "of the light that arrives",
    "n_s": "none: an exponent",
    "normal": "none: of length 1; x right, y up, z to the camera of a folder of photographs",
}
ANGLE_68, ANGLE_95 = (float(np.sqrt(-2.0 * np.log(1.0 - share))) for share in INTERVALS)  # deviations about two axes
NORMAL_95 = ANGLE_95 / ANGLE_68


class SharedHighlight(NamedTuple):
    """One power of the highlight that the texels of an object or a region share."""

    weight: Float[np.ndarray, "h w 1"] | float
    """Its share of k_s, where regions differ one for each pixel."""
    n_s: float


@dataclass(frozen=True, eq=False)
class TexelMaps:
    """Maps of the numbers of a material, their standard errors, and a status for each texel, from `fit_texels`.

    Row 0 is on top; all numbers are float32. A texel has one of these statuses, the indices of `TexelMaps.STATUS`:

    - outside: no view shows the object there.
    - determined: everything that was free is known.
    - no highlight seen: everything but the highlight is known. Where the normal is free, the errors allow for a
      highlight too weak to be seen.
    - not determined: the views cannot separate the texel's numbers; or its normal is free and the lights that reach it
      lie in one plane, or k_d times the normal has an error over 20 %; or, by the curvature at the minimum, k_s has an
      error over itself or log n_s one over 0.5; or its residuals are much larger than those of most texels.
    - shadowed: the unclipped samples (observations, each with its channels) that a light reaches are no more than the
      numbers; or, with the normal free, it reaches fewer than 3 observations.
    - failed: the fit did not converge, or a number is too large for a map.

    Of several, the last counts.

    Where each texel was fitted by itself and k_s is free, k_s and n_s are 0 with infinite errors unless the status is
    "determined". Where all texels share a highlight, k_s is kept at every texel, small where no view shows a highlight;
    a texel is "determined" where k_s is above its error, and "not determined" where its normal has an error over 11.5
    degrees or its lights lie in one plane.

    Attributes:
        values: k_a, k_d and k_s with a channel for each of the photographs, n_s with one, the normal as a unit vector.
        errors: Standard errors, that of the normal in degrees; infinite where nothing is known, 0 outside. They hold
            the truth about 68 % of the time; where k_s, say, has no upper bound, its error is many times itself. Where
            all texels share a highlight they contain what the model leaves out.
        status: Index into `TexelMaps.STATUS`.
        residual: Root mean square of the residuals, in the photographs' units, or in those of their noise where that
            is known.
        scene: The scene of the fit.
        camera: The camera of the views.
        notes: What the lights leave undetermined, and photographs that disagree with the others.
        times_95: How many errors hold the truth 95 % of the time, by name, where all texels share a highlight.
        highlights: The powers that a shared highlight consists of; none where each texel has its own. The map of n_s
            then has the single power that is half as bright as its peak at the same angle.
        unexplained: What the photographs show beyond the model, where all texels share a highlight and where it can be
            foretold from one light to another.
        sensor: What the camera of all photographs did to the light; None where the views had no `Sensor`, or several.
        exposures: How much more each photograph shows than its exposure says, which was undone; None where it was not.
        shifts: How far each photograph is moved in the picture, and which were moved back; None where none was.
        black: What all photographs show beside the object's light, a black level or haze, which was taken off.
    """

    values: Mapping[str, Float[np.ndarray, "h w _"]]
    errors: Mapping[str, Float[np.ndarray, "h w _"]]
    status: UInt8[np.ndarray, "h w"]
    residual: Float[np.ndarray, "h w"]
    scene: Scene
    camera: AbstractCamera
    notes: tuple[str, ...] = ()
    times_95: Mapping[str, float] = field(default_factory=dict)
    highlights: tuple[SharedHighlight, ...] = ()
    unexplained: Unexplained | None = None
    sensor: Sensor | None = None
    exposures: Exposures | None = None
    shifts: Shifts | None = None
    black: float = 0.0

    STATUS = STATUS

    @property
    def errors_95(self) -> dict[str, Float[np.ndarray, "h w _"]]:
        """What the truth differs by at most 95 % of the time, that of the normal in degrees."""
        return {name: error * self._times_95(name) for name, error in self.errors.items()}

    def _times_95(self, name: str) -> float:
        """Return how many errors of a map hold the truth 95 % of the time."""
        return self.times_95.get(name, NORMAL_95 if name == "normal" else GAUSS_95)

    @property
    def determined(self) -> Bool[np.ndarray, "h w"]:
        """Where everything that was free is known, including the highlight if one was to be fitted."""
        return self.status == DETERMINED

    @property
    def known(self) -> Bool[np.ndarray, "h w"]:
        """Where k_a, k_d and the normal are known, whether or not a highlight was seen."""
        return (self.status == DETERMINED) | (self.status == NO_HIGHLIGHT)

    def trusted(self, name: str) -> Bool[np.ndarray, "h w"]:
        """Return where a map's numbers are known.

        Args:
            name: Name of a map; k_s and n_s are known only where a highlight was seen.

        Returns:
            `determined` for k_s and n_s, else `known`.
        """
        return self.determined if name in ("k_s", "n_s") else self.known

    def shade(
        self, lights: Sequence[AbstractLight] | AbstractLight | None = None, *, lit: Sequence[int] | int | None = None
    ) -> Float[np.ndarray, "h w 3"]:
        r"""Return what a photograph under lights would show: linear radiance (E9).

        $$ k_e + k_a I_a + \sum f_{rad} f_{ang} I (k_d (n \cdot l)_+ + k_s (\cos)_+^{n_s} + u(l)) $$

        u is what the photographs of things show beyond the model, such as shadows and bounced light, interpolated
        between the directions of their lights: see `unexplained`. The model alone is `render` of `as_scene()`.

        Args:
            lights: The lights; by default the scene's.
            lit: Indices of the lights that are on; by default all.

        Returns:
            The image, 0 where no view shows the object.

        Raises:
            ValueError: A light needs positions and the surface has none, or an index belongs to no light.
        """
        scene = self.as_scene()
        if lights is not None:
            scene = eqx.tree_at(lambda s: s.lights, scene, as_tuple(lights))
        with in_float64((scene, self.camera)) as (scene, camera):
            image = np.asarray(render(scene, camera, lit=lit))
            if self.unexplained is not None:
                on = scene.lights if lit is None else select(scene, lit)
                position = intersect(scene, camera).position if any(light.is_local for light in on) else None
                image = np.maximum(image + self.unexplained.light(on, position, self.status != OUTSIDE), 0.0)
        return np.where((self.status != OUTSIDE)[..., None], image, 0.0)

    def predict(self, view: View) -> Prediction:
        """Return a photograph, linear, beside what `shade` says it should be: exposure * radiance + both `black`.

        Args:
            view: A photograph by the camera of the fit, under lights of its scene; its sensor is undone.

        Returns:
            The prediction; all pixels inside the mask, the alpha channel and the maps count, clipped ones too.

        Raises:
            ValueError: The view has another shape than the maps, or its `lit` is not an index of a light.
        """
        return self._predict(view, "the view")

    def _predict(self, view: View, name: str) -> Prediction:
        if view.camera.shape != self.status.shape:
            raise ValueError(
                f"{name} must have the shape of the maps, {self.status.shape}; got {view.camera.shape}. Give "
                "photographs by the camera of the fit."
            )
        return prediction_of(view, self.shade(lit=view.lit), self.status != OUTSIDE, self.black)

    def relative_errors(self, views: Sequence[View] | View) -> Float[np.ndarray, " views"]:
        r"""Return how far `shade` is from photographs, such as ones that were left out of the fit.

        $$ \sqrt{\sum (exposure \cdot shade + black - image)^2 / \sum (image - black)^2} $$

        Args:
            views: Photographs by the camera of the fit, under lights of its scene.

        Returns:
            One number for each view, over all pixels that count in its `predict`; NaN where it shows no light.

        Raises:
            ValueError: A view has another shape than the maps, or its `lit` is not an index of a light.
        """
        seen = [(self._predict(v, f"views[{i}]"), float(v.black) + self.black) for i, v in enumerate(as_tuple(views))]
        return np.array([relative_error(*of) for of in seen])

    def as_scene(self) -> Scene:
        """Return the scene of the fit with the maps as its material, for `render` by the camera of the fit.

        Returns:
            The scene, whose material has the maps as coefficients over the pixels.
        """
        item = self.scene.objects[0]
        maps = {name: np.asarray(value, np.float64) for name, value in self.values.items()}
        if "normal" in maps and isinstance(item.surface, GBuffer):
            surface = GBuffer(maps.pop("normal"), item.surface.position, self.status != OUTSIDE)
            item = dataclasses.replace(item, surface=surface)
        if self.highlights:
            maps |= self._powers(maps["k_s"])
        material = dataclasses.replace(item.material, **maps)
        return dataclasses.replace(self.scene, objects=(dataclasses.replace(item, material=material),))

    def _powers(self, k_s: Float[np.ndarray, "h w _"]) -> dict[str, Any]:
        """Return k_s and n_s of the first power of the shared highlight, and the others as further highlights."""
        lobe = self.scene.objects[0].material.lobe
        assert isinstance(lobe, AbstractLobe)
        (weight, n_s), *others = self.highlights
        further = tuple(Highlight(k_s=w * k_s, n_s=n, lobe=lobe) for w, n in others)
        return {"k_s": weight * k_s, "n_s": n_s, "highlights": further}

    def write(self, folder: str | os.PathLike[str], *, suffix: str = ".exr") -> list[Path]:
        """Write every map to a folder, each file whole or not at all; `read_maps` reads .npy and .exr back.

        The files are:

        - `NAME` and `NAME_error`: each map and its error; as PNG without errors. `NAME_preview.png`, of 8 bits, is
          bright enough to look at.
        - `residual`, except as PNG, and `status.png`, of 8 bits.
        - `scene.toml`: the scene and the camera, as `write_scene` writes them, with the arrays of a G-buffer beside it.
        - `unexplained.npy`, what photographs show beyond the model, where that is known, and `unexplained_lights.npy`,
          a row for each light between which it is interpolated: the unit vector to it, its weight in each number that
          is kept of a texel, and the weight of each number in its light.
        - `highlight_weights.npy`, where regions have different highlights.
        - `maps.toml`, written last: the format, the names of the maps, the levels of the status, the units, the notes,
          how many errors hold the truth 95 % of the time, the exposures and shifts found, the powers of the highlight
          (`weight` is a number, or names the file that has one for each pixel), the width within which unexplained
          light is alike, and the scales of PNGs.

        Args:
            folder: The folder; it is made if it does not exist.
            suffix: ".npy" or ".exr" for the numbers as they are; ".png" for 16 bits, with normals as (n + 1)/2 and any
                other map divided by its scale and clipped. The scale is the 99.5th percentile of the known values, or 1
                if that is larger.

        Returns:
            The paths of the files.

        Raises:
            ValueError: The suffix is another one, or the scene has no form in TOML.
            OSError: A file cannot be written.
        """
        scene_document(self.scene, self.camera)  # refuses what cannot be written
        folder = map_folder(folder, suffix)
        numbers = suffix if suffix != ".png" else self._numbers_in(folder)
        (folder / ABOUT).unlink(missing_ok=True)  # until all is written, the folder holds no maps
        written, scales = [], {}
        for name, value in self.values.items():
            path = folder / f"{name}{suffix}"
            if suffix == ".png":
                scales[name] = 1.0 if name == "normal" else max(1.0, self._percentile(name, UNCLIPPED_PERCENT))
                shown = (value + 1.0) / 2.0 if name == "normal" else value / scales[name]
                write_image(path, np.clip(shown, 0.0, 1.0), srgb=False, bits=16)
                written.append(path)
            else:
                written += [
                    write_numbers(path, value),
                    write_numbers(folder / f"{name}_error{suffix}", self.errors[name]),
                ]
            written.append(self._put_preview(folder / f"{name}_preview.png", name))
        if suffix != ".png":
            written.append(write_numbers(folder / f"residual{suffix}", np.asarray(self.residual)[..., None]))
        if self.unexplained is not None:
            written.append(write_numbers(folder / "unexplained.npy", self.unexplained.parts))
        return [*written, *self.describe(folder, numbers=numbers, scales=scales)]

    def _numbers_in(self, folder: Path) -> str | None:
        """Return the suffix of the numbers of these maps that a folder has already, such as one of a fit, or None."""
        for suffix in (".npy", ".exr"):
            files = {name: folder / f"{name}{suffix}" for name in self.values}
            if all(file.is_file() for file in files.values()) and all(
                np.array_equal(read_numbers(file), self.values[name]) for name, file in files.items()
            ):
                return suffix
        return None

    def describe(
        self, folder: Path, *, numbers: str | None = ".npy", scales: Mapping[str, float] | None = None
    ) -> list[Path]:
        """Write all but the maps: the status, the scene and the camera, the weights of the highlight, and `maps.toml`.

        Args:
            folder: The folder, which exists.
            numbers: Suffix of the maps in it; None if it holds only PNGs.
            scales: What each map of a PNG was divided by.

        Returns:
            The paths of the files.
        """
        write_image(folder / STATUS_PICTURE, self.status[..., None] / 255.0, srgb=False)
        written = [folder / STATUS_PICTURE, *write_scene(folder / SCENE, self.scene, camera=self.camera)]
        units = {name: UNITS[name] for name in self.values}
        units |= {f"{name}_error": "degrees" if name == "normal" else f"those of {name}" for name in self.values}
        about: dict[str, object] = {
            "format": FORMAT,
            "maps": list(self.values),
            **({} if numbers is None else {"numbers": numbers}),
            "status": dict(zip(map(str, range(len(STATUS))), STATUS, strict=True)),
            "units": units | {"residual": "those of the photographs, or their noise where that was given"},
            "errors_95": {name: float(self._times_95(name)) for name in self.values},
        }
        weights = [weight for weight, _ in self.highlights]
        if differ := any(np.ndim(weight) for weight in weights):
            of_pixels = [np.broadcast_to(weight, (*self.status.shape, 1)) for weight in weights]
            written.append(write_numbers(folder / WEIGHTS, np.concatenate(of_pixels, -1)))
        if self.highlights:
            about["highlight"] = [
                {"weight": WEIGHTS if differ else float(weight), "n_s": float(n_s)} for weight, n_s in self.highlights
            ]
        if self.unexplained is not None:
            given = self.unexplained.interpolation
            about["unexplained"] = {"width": float(given.width)}
            written.append(write_numbers(folder / LIGHTS, np.hstack([given.toward, given.taken.T, given.given])))
        optional = {"notes": [str(note) for note in self.notes], "scale": dict(scales or {}), "black": self.black}
        about |= {name: of for name, of in optional.items() if of}
        if self.sensor is not None:
            about["sensor"] = {".".join(map(str, keys)): float(value) for keys, value, _ in quantities(self.sensor)}
        for name, of in (("exposures", self.exposures), ("shifts", self.shifts)):
            about |= {} if of is None else {name: {key: np.asarray(n).tolist() for key, n in of._asdict().items()}}
        return [*written, write_about(folder / ABOUT, about)]

    def _percentile(self, name: str, percent: float) -> float:
        """Return a percentile of a map's known values, 0 if none is known."""
        known = self.values[name][self.trusted(name)]
        return float(np.percentile(known, percent)) if known.size else 0.0

    def _put_preview(self, path: Path, name: str) -> Path:
        """Write a map to look at: a normal as (n + 1)/2, any other in sRGB with white at a high percentile."""
        value = self.values[name]
        shown = (value + 1.0) / 2.0 if name == "normal" else value / (self._percentile(name, UNCLIPPED_PERCENT) or 1.0)
        shown = np.where((self.status != OUTSIDE)[..., None], shown, 0.0)
        write_image(path, np.clip(shown, 0.0, 1.0), srgb=name != "normal", bits=8)
        return path

    @property
    def columns(self) -> dict[str, Any]:
        """Percentiles and median errors where a map is known, at a `share` of the texels; then the error of all."""
        rows, inside = [], self.status != OUTSIDE
        for name, value in self.values.items():
            where, errors = self.trusted(name), self.errors[name]
            for c in range(errors.shape[2] if where.any() else 0):
                error, of_all = np.median(errors[where, c]), np.median(errors[inside, c])
                label = "normal (degrees)" if name == "normal" else f"{name}.{'rgb'[c]}" if value.shape[2] > 1 else name
                spread = [np.nan] * 3 if name == "normal" else np.percentile(value[where, c], (5, 50, 95))
                known = cells([*spread, error, self._times_95(name) * error], error)
                rows.append((label, f"{where.sum() / inside.sum():.0%}", *known, *cells([of_all], of_all)))
        heads = "map", "share", "5 %", "median", "95 %", "error", "error, 95 %", "error, all"
        return dict(zip(heads, zip(*rows, strict=True), strict=False))

    def __str__(self) -> str:
        """Return a table: the number of texels of each status, and percentiles of each map and its median error."""
        numbers = np.bincount(self.status.ravel(), minlength=len(STATUS))
        numbers[OUTSIDE] = 0
        kinds, inside = np.flatnonzero(numbers), int(numbers.sum())
        return as_text(
            f"maps of {inside:,} texels, {self.status.shape[0]} x {self.status.shape[1]} pixels",
            {
                "status": [STATUS[kind] for kind in kinds],
                "texels": numbers[kinds],
                "share": [f"{number / inside:.1%}" for number in numbers[kinds]],
            },
            self.columns,
            notes=self.notes,
        )
