"""Photographs: a folder of them, in the layout of the DiLiGenT benchmark, read as a scene and its views."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.masks import Mask, as_mask
from ...core.thresholds import MOST, SLIGHT
from ...core.words import count
from ...io.images import ReadAs, read_mask
from ...model.cameras import OrthographicCamera
from ...model.gbuffers import GBuffer
from ...model.materials import Material
from ...model.scenes import Object, Scene
from .exposures import by_light, exposures_of, merge_exposures
from .folder_lights import read_lights
from .folders import NORMALS, Listing, list_folder
from .photograph_files import PhotographFiles, photograph_files
from .views import View

_LOGGER = logging.getLogger("diffshade")


def read_photographs(
    folder: str | Path,
    *,
    normals: bool = True,
    lights: bool = True,
    mask: Any = None,
    srgb: bool | None = None,
    exif: bool = True,
) -> tuple[Scene, tuple[View, ...]]:
    """Read a folder of photographs of one object, each under one light, as a scene and one view a photograph.

    The photographs are those of `filenames.txt` (a name a line; a link may lead out of the folder, a name must not),
    those of a list of lights `NAME.lp` (the count, then a name and x y z a line, as in reflectance transformation
    imaging), or all images but masks, normals and those named unlike most, in natural order. The other files are those
    of DiLiGenT (Shi et al. 2016): `light_directions.txt`, three numbers a line, *towards* the light, x right, y up, z
    to the camera, by default those of the list; `light_intensities.txt`, R G B a line, or one number, by default 1;
    `light_errors.txt`, degrees about each axis, which `light_error=` of fits takes; `light_distances.txt`, a number a
    line, how far a lamp is from the picture's middle in heights of the picture, or inf, by default far away (a near
    lamp's direction and intensity are those in the middle, its light weakens with the square of the distance, and the
    object is taken to be flat); `mask.png`; normals as `normal_gt.npy` or `Normal_gt.mat` (H, W, 3) or `normal.txt` (a
    row a pixel, row by row). What is missing or left out is said as a warning of the logger `diffshade`. The camera is
    far away on +z. Light i is on in photograph i alone. Photographs in .npy and .zarr are opened without being read, as
    by `open_image`: they may be larger than memory.

    Where the photographs' EXIF says that they differ in t ISO / N^2 (exposure time, sensitivity, F-number), that is
    `View.exposure`, 1 for the first. Photographs of different exposures under one light, which have the same direction
    and intensity in the lists, become one view by `merge_exposures`, and the scene has that light once.

    One camera has one orientation: photographs of one stored size are turned as the EXIF of most of them states, and
    those that state another are named. Where the mask has the size of what is stored, they are not turned.

    Args:
        folder: The folder.
        normals: Whether to read the normals; default True. Without, every normal is (0, 0, 1), which
            `fit_texels` can then find.
        lights: Whether to read the directions of the lights; default True. Without, all light comes from the camera,
            and `find_lights` can find where it comes from.
        mask: A file or an array (H, W), in place of `mask.png` or the one image with "mask" in its name.
        srgb: Whether the photographs have the sRGB curve, whatever they state. Default: as each file states, else by
            its type, as for `read_image`.
        exif: Whether to use the exposures that the files state; default True. Without, all are 1.

    Returns:
        The scene and its views.

    Raises:
        FileNotFoundError: Where the folder or one of its files does not exist.
        ValueError: Where a file does not hold what it should; one sentence that names the file and the remedy.
        OSError: Where a photograph is truncated or damaged.
        ImportError: Where a photograph is RAW, or HEIC, and its package is not installed.
    """
    read = read_folder(folder, normals=normals, lights=lights, mask=mask, srgb=srgb, exif=exif)
    if read.light_errors is not None and read.light_errors.any():
        _LOGGER.warning(
            "light_errors.txt, the errors of the directions, is no part of a scene: give them to fits as light_error= "
            "(numpy.loadtxt reads them, a line for each photograph; of merged ones the first line counts)"
        )
    return read.scene, read.views


class PhotographFolder(NamedTuple):
    """A folder of photographs, as it was read; what it has of lights is in the order of the views, one light each."""

    scene: Scene
    views: tuple[View, ...]
    names: tuple[str, ...]
    """The photograph of each view, the first of those that were merged."""
    read_as: tuple[ReadAs, ...]
    """What it was taken for."""
    light_errors: Float[np.ndarray, " views"] | None
    """Of the directions, degrees about each axis; None where the folder does not say."""
    distances: Float[np.ndarray, " views"]
    """Of the lamps from the picture's middle, in heights of the picture; infinite for one far away."""
    has_normals: bool
    """Whether the folder has normals, whether they were read or not."""


def read_folder(
    folder: str | Path,
    *,
    normals: bool | None,
    lights: bool = True,
    mask: Any = None,
    srgb: bool | None = None,
    exif: bool,
) -> PhotographFolder:
    """Read a folder as `read_photographs` does, its normals with None where there are some; return all it says."""
    folder = Path(folder)
    listed = list_folder(folder)
    of = read_lights(listed, known=lights)
    exposures, exposed = exposures_of(listed.files) if exif else (np.ones(len(listed.names)), [])
    rows = [(*l, *i) for l, i in zip(of.directions, of.intensities, strict=True)] if lights else range(len(exposures))
    groups = by_light(rows, exposures)
    if len(groups) < len(listed.names):
        exposed.append(
            f"photographs under one light are merged: {len(listed.names)} become {count(len(groups), 'view')}."
        )
    inside = as_given(listed.mask_file() if mask is None else mask)
    photographs = photograph_files(listed.files, srgb=srgb, shape=inside.shape)
    camera = OrthographicCamera((0.0, 0.0, 1.0), shape=inside.shape, local_viewer=False)
    views = [_view(photographs, group, exposures[group], camera, inside, i) for i, group in enumerate(groups)]
    first = [group[0] for group in groups]
    read_normals = listed.normals is not None if normals is None else normals
    known = _normals(listed, inside.shape) if read_normals else np.broadcast_to((0.0, 0.0, 1.0), (*inside.shape, 3))
    flat = _flat(camera) if np.isfinite(of.distances).any() else None
    lamps = [of.lamp(i, float(camera.height)) for i in first]
    surface = _surface(listed, known, flat, inside, mask)
    for note in (*listed.notes, *of.notes, *exposed, *photographs.notes):
        _LOGGER.warning("%s: %s", folder, note)
    return PhotographFolder(
        scene=Scene(Object(surface, Material()), lamps),
        views=tuple(views),
        names=tuple(listed.names[i] for i in first),
        read_as=tuple(photographs.read_as[i] for i in first),
        light_errors=None if of.errors is None else of.errors[first],
        distances=of.distances[first],
        has_normals=listed.normals is not None,
    )


def _surface(listed: Listing, normals: np.ndarray, points: np.ndarray | None, inside: Mask, mask: Any) -> GBuffer:
    """Return what the photographs show; where its normals are wrong, say in which file and what they look like."""
    try:
        return GBuffer(normals, points, inside)
    except ValueError as error:
        of_mask = listed.mask_file() if mask is None else mask if isinstance(mask, str | Path) else "the given one"
        there, shown = normals[inside], np.any(normals != 0.0, -1)
        said = f"{error}"
        if not shown[inside].any() and np.mean(shown[~inside]) > MOST:
            said = f"there are none inside the mask, {of_mask}, but outside of it: it is inverted. Invert it"
        elif there.size and np.allclose(np.linalg.norm(2.0 * there - 1.0, axis=-1), 1.0, atol=SLIGHT):
            said = "they are stored from 0 to 1, as in pictures. Write 2 n - 1"
        raise ValueError(f"{listed.normals or listed.folder}: {said.rstrip('.')}.") from None


def _flat(camera: OrthographicCamera) -> Float[np.ndarray, "h w 3"]:
    """Return the points of the plane through the origin that a picture shows: near lamps need a place."""
    height, width = camera.shape
    rows, columns = np.indices(camera.shape) + 0.5
    pixel = float(camera.height) / height
    return np.stack([(columns - width / 2) * pixel, (height / 2 - rows) * pixel, np.zeros(camera.shape)], -1)


def _view(
    photographs: PhotographFiles,
    group: Sequence[int],
    exposures: Float[np.ndarray, " group"],
    camera: OrthographicCamera,
    mask: Mask,
    light: int,
) -> View:
    """Return the view of one photograph, or of several under one light, merged."""
    file = photographs.files[group[0]]
    try:
        image, exposure, saturation = photographs.read(group[0]), float(exposures[0]), None
        if len(group) > 1:
            merged = merge_exposures([image, *map(photographs.read, group[1:])], exposures)
            image, exposure, saturation = merged.image, 1.0, merged.saturation
        size = image.shape[:2]
        if size != mask.shape and light == 0:
            raise ValueError(
                f"the mask must have the size of the photographs, {size}; got {mask.shape}. Crop both alike."
            )
        if size != mask.shape:
            raise ValueError(
                f"{file} must have the size of the other photographs, {mask.shape}; got {size}. Crop them alike."
            )
        return View(image, camera, mask, lit=light, exposure=exposure, saturation=saturation)
    except ValueError as error:
        raise ValueError(f"{error}" if f"{file}" in f"{error}" else f"{file}: {error}") from None


def as_given(mask: Any) -> Bool[np.ndarray, "h w"]:
    """Return a mask that is given as a file or an array."""
    found = read_mask(mask) if isinstance(mask, str | Path) else np.asarray(as_mask(mask))
    if found.ndim != 2:
        raise ValueError(f"mask must have shape (H, W); got {found.shape}. Give one number a pixel.")
    return found


def _normals(listed: Listing, shape: tuple[int, ...]) -> Float[np.ndarray, "h w 3"]:
    path = listed.normals
    if path is None:
        raise FileNotFoundError(
            f"{listed.folder} has no normals. Add one of {', '.join(NORMALS)}, or find normals too with `diffshade "
            "texels` (ds.fit_texels, of photographs read with normals=False)."
        )
    try:
        if path.suffix == ".npy":
            normals = np.lib.format.open_memmap(path, "r")
        elif path.suffix == ".mat":
            from scipy.io import loadmat

            normals = loadmat(path, variable_names=["Normal_gt"])["Normal_gt"]
        else:
            normals = np.loadtxt(path).reshape(*shape, 3)
        normals = np.asarray(normals, np.float64)
    except Exception as error:  # an empty or damaged file makes these readers raise anything
        said = " ".join(f"{error}".split())
        raise ValueError(f"{path} holds no normals of shape {(*shape, 3)}: {said}. Write them again.") from None
    if normals.shape != (*shape, 3):
        raise ValueError(f"{path} must have the mask's shape {(*shape, 3)}; got {normals.shape}. Crop both alike.")
    return normals
