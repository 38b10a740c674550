"""Photographs: a folder of them, in the layout of the DiLiGenT benchmark, as a scene and its views."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.masks import as_mask
from ...core.words import count, listing
from ...io.files import replacing
from ...io.images import ReadAs, read_mask, without_alpha, write_image
from ...model.attenuation import RadialAttenuation
from ...model.cameras import OrthographicCamera
from ...model.gbuffers import GBuffer
from ...model.lights import DirectionalLight, PointLight
from ...model.materials import Material
from ...model.scenes import Object, Scene
from .exposures import by_light, exposures_of, merge_exposures
from .folders import Listing, list_folder
from .light_lists import UNIT, as_lp, lines_of, numbers_in, unit_vectors
from .photograph_files import PhotographFiles, photograph_files
from .views import View

_LOGGER = logging.getLogger("diffshade")
DIM = 0.1  # a photograph darker than this fraction of a file's range would lose precision in 16 bits
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
NORMALS = ("normal_gt.npy", "Normal_gt.mat", "normal.txt")


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
    `light_distances.txt`, a number a line, how far a lamp is from the picture's middle in heights of the picture, or
    inf, by default far away (a near lamp's direction and intensity are those in the middle, its light weakens with the
    square of the distance, and the object is taken to be flat); `mask.png`; normals as `normal_gt.npy` or
    `Normal_gt.mat` (H, W, 3) or `normal.txt` (a row a pixel, row by row). What is missing or left out is said as a
    warning of the logger `diffshade`. The camera is far away on +z. Light i is on in photograph i alone. Photographs in
    .npy and .zarr are opened without being read, as by `open_image`: they may be larger than memory.

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
    return read.scene, read.views


class PhotographFolder(NamedTuple):
    """A folder of photographs, as it was read."""

    scene: Scene
    views: tuple[View, ...]
    names: tuple[str, ...]
    """The photograph of each view, the first of those that were merged."""
    indices: tuple[int, ...]
    """Which of the folder's photographs that is."""
    read_as: tuple[ReadAs, ...]
    """What it was taken for."""


def read_folder(
    folder: str | Path, *, normals: bool, lights: bool = True, mask: Any = None, srgb: bool | None = None, exif: bool
) -> PhotographFolder:
    """Read a folder as `read_photographs` does, and return which photograph each view is."""
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}. Give a folder of photographs.")
    listed = list_folder(folder)
    names = listed.names
    directions, said = _directions(folder, listed) if lights else (np.tile([0.0, 0.0, 1.0], (len(names), 1)), [])
    notes = [*listed.notes, *said]
    if (folder / "light_intensities.txt").is_file():
        intensities = _numbers(folder / "light_intensities.txt", names, (1, 3))
    else:
        intensities = np.ones((len(names), 1))
        notes.append("there is no light_intensities.txt: all lights are taken to have the intensity 1.")
    files = [folder / name for name in names]
    exposures, said = exposures_of(files) if exif else (np.ones(len(names)), [])
    rows = [(*l, *i) for l, i in zip(directions, intensities, strict=True)] if lights else range(len(names))
    groups = by_light(rows, exposures)
    if len(groups) < len(names):
        said.append(f"photographs under one light are merged: {len(names)} become {count(len(groups), 'view')}.")
    mask = read_mask(mask_file(folder)) if mask is None else as_given(mask)
    photographs = photograph_files(files, srgb=srgb, shape=mask.shape)
    said += photographs.notes
    camera = OrthographicCamera((0.0, 0.0, 1.0), shape=mask.shape, local_viewer=False)
    indices = [group[0] for group in groups]
    distances = light_distances(folder, names) if lights else np.full(len(names), np.inf)
    lamps = [_lamp(directions[i], intensities[i], distances[i], float(camera.height)) for i in indices]
    views = []
    for i, group in enumerate(groups):
        file = files[group[0]]
        try:
            image, exposure, saturation = _exposed(photographs, group, exposures[group])
            _check_size(file, image.shape[:2], mask.shape, views)
            views.append(View(image, camera, mask, lit=(i,), exposure=exposure, saturation=saturation))
        except ValueError as error:
            raise ValueError(f"{error}" if f"{file}" in f"{error}" else f"{file}: {error}") from None
    known = _normals(folder, mask.shape) if normals else np.broadcast_to((0.0, 0.0, 1.0), (*mask.shape, 3))
    flat = _flat(camera) if np.isfinite(distances).any() else None
    scene = Scene(Object(GBuffer(known, flat, mask), Material()), lamps)
    for note in (*notes, *said):
        _LOGGER.warning("%s: %s", folder, note)
    taken = tuple(photographs.read_as[i] for i in indices)
    return PhotographFolder(scene, tuple(views), tuple(names[i] for i in indices), tuple(indices), taken)


def _directions(folder: Path, listed: Listing) -> tuple[Float[np.ndarray, "photographs 3"], list[str]]:
    """Return unit vectors towards the lights of the photographs, and what is said of them that is not used."""
    path = folder / "light_directions.txt"
    if not path.is_file():
        if listed.directions is None:
            raise FileNotFoundError(
                f"there is no file {path}, and no list of lights (.lp) of these photographs. Add one; `diffshade "
                "calibrate` finds the lights from a ball."
            )
        return listed.directions, []
    directions, notes = unit_vectors(path, _numbers(path, listed.names, (3,)), [number for number, _ in lines_of(path)])
    if listed.directions is not None and not np.allclose(directions, listed.directions, rtol=0.0, atol=UNIT):
        notes.append("the list of lights (.lp) differs from light_directions.txt and is not used.")
    return directions, notes


def _flat(camera: OrthographicCamera) -> Float[np.ndarray, "h w 3"]:
    """Return the points of the plane through the origin that a picture shows: near lamps need a place."""
    height, width = camera.shape
    rows, columns = np.indices(camera.shape) + 0.5
    pixel = float(camera.height) / height
    return np.stack([(columns - width / 2) * pixel, (height / 2 - rows) * pixel, np.zeros(camera.shape)], -1)


def _check_size(file: Path, size: tuple[int, ...], mask: tuple[int, ...], before: Sequence[View]) -> None:
    """Refuse a photograph of another size than the mask and the photographs before it."""
    if size != mask and before:
        raise ValueError(f"{file} must have the size of the other photographs, {mask}; got {size}. Crop them alike.")
    if size != mask:
        raise ValueError(f"the mask must have the size of the photographs, {size}; got {mask}. Crop both alike.")


def _exposed(
    photographs: PhotographFiles, group: Sequence[int], exposures: Float[np.ndarray, " group"]
) -> tuple[Any, float, float | None]:
    """Return one photograph, or several of one light merged, with its exposure and saturation."""
    images = [photographs.read(k) for k in group]
    if len(images) == 1:
        return images[0], float(exposures[0]), None
    merged = merge_exposures(images, exposures)
    return merged.image, 1.0, merged.saturation


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
        with replacing(folder / name) as temporary:
            text = "".join(" ".join(f"{x:.17g}" for x in row) + "\n" for row in rows)
            temporary.write_text(text, encoding="utf-8")


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
    texts = {"lights.lp": as_lp(written, directions)}
    if errors is not None:
        texts["light_errors.txt"] = "".join(f"{error:.6g}\n" for error in errors)
    if distances is not None:
        texts["light_distances.txt"] = "".join(f"{distance:.10g}\n" for distance in distances)
    texts["filenames.txt"] = "".join(f"{name}\n" for name in written)  # last: it marks a complete folder
    for name, text in texts.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def clear_folder(folder: Path) -> None:
    """Make a folder for photographs and lights, without files of an earlier run that would be taken for new ones."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in WRITTEN:
        (folder / name).unlink(missing_ok=True)


def write_photograph(folder: Path, stem: str, image: Float[np.ndarray, "h w c"]) -> str:
    """Write a linear photograph in 16 bits, or as .npy if it exceeds 1 or would lose precision; return its name."""
    image = without_alpha(image)  # the mask says what alpha does
    fits = bool(np.isfinite(image).all() and image.min() >= 0.0 and DIM <= image.max() <= 1.0)
    name = f"{stem}.{'png' if fits else 'npy'}"
    write_image(folder / name, image, srgb=False, **({"bits": 16} if fits else {}))
    return name


def light_errors(folder: Path) -> Float[np.ndarray, " photographs"] | None:
    """Return the errors of the directions in a folder's `light_errors.txt`, degrees, or None without that file."""
    if not (folder / "light_errors.txt").is_file():
        return None
    errors = _numbers(folder / "light_errors.txt", photograph_names(folder), (1,))[:, 0]
    if not (np.isfinite(errors) & (errors >= 0.0)).all():
        raise ValueError(
            f"{folder / 'light_errors.txt'} must hold degrees, at least 0; got {errors.min():g}. Correct it."
        )
    return errors


def light_distances(folder: Path, names: Sequence[str]) -> Float[np.ndarray, " photographs"]:
    """Return the distances of lamps in a folder's `light_distances.txt`, heights of the picture, or infinite ones."""
    path = folder / "light_distances.txt"
    if not path.is_file():
        return np.full(len(names), np.inf)
    distances = _numbers(path, names, (1,))[:, 0]
    if not (distances > 0.0).all():
        raise ValueError(
            f"{path} must hold distances above 0, in heights of the picture; got {distances.min():g}. Correct it, or "
            "write inf for a lamp far away."
        )
    return distances


def _lamp(
    direction: Float[np.ndarray, "3"], intensity: Float[np.ndarray, " colours"], distance: float, height: float
) -> DirectionalLight | PointLight:
    """Return a lamp whose light has this direction and intensity in the middle of a picture."""
    if not np.isfinite(distance):
        return DirectionalLight(-direction, intensity)
    far = distance * height
    return PointLight(far * direction, intensity, attenuation=RadialAttenuation(0.0, 0.0, far**-2))


def photograph_names(folder: Path) -> tuple[str, ...]:
    """Return the names of the photographs in a folder."""
    return list_folder(folder).names


def mask_file(folder: Path) -> Path:
    """Return the mask in a folder of photographs; refuse a folder without one, or with several."""
    masks = list_folder(folder).masks
    if (folder / "mask.png") in masks or len(masks) == 1:
        return folder / "mask.png" if (folder / "mask.png") in masks else masks[0]
    if masks:
        raise ValueError(
            f"{folder} holds several masks, {listing([file.name for file in masks])}. Choose one with mask= (--mask on "
            "the command line)."
        )
    raise FileNotFoundError(
        f"there is no mask {folder / 'mask.png'}. Add one that is white on the object, find one with `diffshade mask "
        f"{folder}`, or give another file with mask= (--mask on the command line)."
    )


def as_given(mask: Any) -> Bool[np.ndarray, "h w"]:
    """Return a mask that is given as a file or an array."""
    found = read_mask(mask) if isinstance(mask, str | Path) else np.asarray(as_mask(mask))
    if found.ndim != 2:
        raise ValueError(f"mask must have shape (H, W); got {found.shape}. Give one number a pixel.")
    return found


def has_normals(folder: Path) -> bool:
    """Return whether a folder of photographs says the normals of what they show."""
    return any((folder / name).is_file() for name in NORMALS)


def _numbers(path: Path, names: Sequence[str], widths: tuple[int, ...]) -> Float[np.ndarray, "photographs numbers"]:
    """Read one line of numbers for each photograph."""
    lines = lines_of(path)
    if len(lines) != len(names):
        raise ValueError(
            f"{path} must have one line for each of the {len(names)} photographs; got {len(lines)}. "
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
        rows.append(row)
    return np.array(rows)


def _normals(folder: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "h w 3"]:
    path = next((folder / name for name in NORMALS if (folder / name).is_file()), None)
    if path is None:
        raise FileNotFoundError(
            f"{folder} has no normals. Add one of {', '.join(NORMALS)}, or find normals too with `diffshade texels` "
            "(ds.fit_texels, of photographs read with normals=False)."
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
