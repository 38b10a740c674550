"""Photographs: a folder of them, in the layout of the DiLiGenT benchmark, as a scene and its views."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...io.images import read_image, read_mask
from ...io.lazy_images import open_image
from ...model.cameras import OrthographicCamera
from ...model.gbuffers import GBuffer, as_mask
from ...model.lights import DirectionalLight
from ...model.materials import Material
from ...model.scenes import Object, Scene
from .views import View

NORMALS = ("normal_gt.npy", "Normal_gt.mat", "normal.txt")


def read_photographs(
    folder: str | Path, *, normals: bool = True, mask: Any = None, srgb: bool | None = None
) -> tuple[Scene, tuple[View, ...]]:
    """Read a folder of photographs of one object, each under one distant light, as a scene and one view a photograph.

    The layout is that of DiLiGenT (Shi et al. 2016): `filenames.txt`, one photograph of the folder a line (a link may
    lead out of it, a name must not); `light_directions.txt`, three numbers a line, *towards* the light, x right, y up,
    z to the camera; `light_intensities.txt`, R G B a line, or one number; `mask.png`; normals as `normal_gt.npy` or
    `Normal_gt.mat` (H, W, 3) or `normal.txt` (a row a pixel, row by row). The camera is far away on +z. Light i is on
    in photograph i alone. Photographs in .npy and .zarr are opened without being read, as by `open_image`: they may be
    larger than memory.

    Args:
        folder: The folder.
        normals: Whether to read the normals; default True. Without, every normal is (0, 0, 1), which
            `fit_texels` can then find.
        mask: A file or an array (H, W), in place of `mask.png`.
        srgb: Whether the photographs have the sRGB curve, as for `read_image`. Default: JPEG and 8-bit PNG have it.

    Returns:
        The scene and its views.

    Raises:
        FileNotFoundError: Where the folder or one of its files does not exist.
        ValueError: Where a file does not hold what it should; one sentence that names the file and the remedy.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}. Give a folder of photographs with a filenames.txt.")
    names = photograph_names(folder)
    directions = _numbers(folder / "light_directions.txt", names, (3,))
    intensities = _numbers(folder / "light_intensities.txt", names, (1, 3))
    mask = read_mask(mask_file(folder)) if mask is None else as_given(mask)
    camera = OrthographicCamera((0.0, 0.0, 1.0), shape=mask.shape, local_viewer=False)
    known = _normals(folder, mask.shape) if normals else np.broadcast_to((0.0, 0.0, 1.0), (*mask.shape, 3))
    surface = GBuffer(known, mask=mask)
    lights = [DirectionalLight(-to_light, i) for to_light, i in zip(directions, intensities, strict=True)]
    views = []
    for i, name in enumerate(names):
        try:
            views.append(View(read_photograph(folder / name, srgb=srgb), camera, mask, lit=(i,)))
        except ValueError as error:
            raise ValueError(f"{folder / name}: {error}") from None
    return Scene(Object(surface, Material()), lights), tuple(views)


def photograph_names(folder: Path) -> list[str]:
    """Return the names that a folder's `filenames.txt` gives its photographs; refuse one that leads out of it."""
    names = [line.strip() for line in _text(folder / "filenames.txt").splitlines() if line.strip()]
    if not names:
        raise ValueError(f"{folder / 'filenames.txt'} names no photograph. Write one file name a line.")
    for name in names:
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise ValueError(
                f"{folder / 'filenames.txt'} must name photographs in its own folder; got '{name}'. Copy or link it "
                "there."
            )
    return names


def mask_file(folder: Path) -> Path:
    """Return the mask in a folder of photographs; refuse a folder without one."""
    path = folder / "mask.png"
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no mask {path}. Add one that is white on the object, or give another file with mask= (--mask on "
            "the command line)."
        )
    return path


def as_given(mask: Any) -> Bool[np.ndarray, "h w"]:
    """Return a mask that is given as a file or an array."""
    found = read_mask(mask) if isinstance(mask, str | Path) else np.asarray(as_mask(mask))
    if found.ndim != 2:
        raise ValueError(f"mask must have shape (H, W); got {found.shape}. Give one number a pixel.")
    return found


def has_normals(folder: Path) -> bool:
    """Return whether a folder of photographs says the normals of what they show."""
    return any((folder / name).is_file() for name in NORMALS)


def read_photograph(path: Path, *, srgb: bool | None) -> Any:
    """Read a photograph, or open it where it may be larger than memory."""
    if path.suffix.lower() in (".npy", ".zarr"):
        return open_image(path, srgb=srgb)
    return read_image(_existing(path), srgb=srgb)


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}. Add it, or correct the folder.")
    return path


def _text(path: Path) -> str:
    try:
        return _existing(path).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text: {error}. Write it as UTF-8.") from None


def _numbers(path: Path, names: list[str], widths: tuple[int, ...]) -> Float[np.ndarray, "photographs numbers"]:
    """Read one line of numbers for each photograph."""
    rows = [line.replace(",", " ").split() for line in _text(path).splitlines() if line.strip()]
    if len(rows) != len(names):
        raise ValueError(
            f"{path} must have one line for each of the {len(names)} photographs in filenames.txt; got {len(rows)}. "
            "Make the two lists match."
        )
    for number, row in enumerate(rows, 1):
        if len(row) not in widths or len(row) != len(rows[0]):
            raise ValueError(
                f"{path} must have {' or '.join(map(str, widths))} numbers a line; got {len(row)} on line {number}. "
                "Correct that line."
            )
    try:
        return np.array(rows, np.float64)
    except ValueError as error:
        raise ValueError(f"{path} must hold numbers only: {error}. Correct that line.") from None


def _normals(folder: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "h w 3"]:
    path = next((folder / name for name in NORMALS if (folder / name).is_file()), None)
    if path is None:
        raise FileNotFoundError(
            f"{folder} has no normals. Add one of {', '.join(NORMALS)}, or read with normals=False for ds.fit_texels."
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
