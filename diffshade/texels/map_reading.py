"""Reading maps: `read_maps` returns what `TexelMaps.write`, or a fit with `out`, wrote to a folder."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from ..inverse.data.sensors import Sensor, Vignetting
from ..io.arrays import read_array
from ..io.images import read_image
from ..io.scene_files import read_camera, read_scene
from .lighting import Exposures, Shifts
from .map_files import read_numbers
from .maps import ABOUT, FORMAT, LIGHTS, SCENE, STATUS_PICTURE, WEIGHTS, SharedHighlight, TexelMaps
from .status import STATUS
from .unexplained import Interpolation, Unexplained


def read_maps(folder: str | os.PathLike[str]) -> TexelMaps:
    """Return the maps of a folder, whole: numbers, errors, status, camera, lights, shared highlight, unexplained light.

    The folder is one that `fit_texels(..., out=folder)`, `diffshade texels -o` or `TexelMaps.write` has written; its
    layout is described there. Numbers in .npy are mapped from disk, not read.

    Args:
        folder: The folder.

    Returns:
        The maps, as they were written. Own classes of lights must have been imported.

    Raises:
        FileNotFoundError: There is no such folder, or one of its files is missing.
        ValueError: The folder holds no maps, unfinished ones, or only pictures of maps, or a file is damaged.
        OSError: A file is damaged.
    """
    folder = Path(folder)
    about = _about(folder)
    scene, camera = read_scene(folder / SCENE), read_camera(folder / SCENE)
    try:
        return _maps(folder, about, scene, camera)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{folder / ABOUT} is damaged: {' '.join(f'{error!r}'.split())[:200]}. Write the maps again."
        ) from None


def _about(folder: Path) -> dict[str, Any]:
    """Return what the folder says of its maps."""
    path = folder / ABOUT
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}. Give the one that diffshade texels -o wrote.")
    if not path.is_file():
        rest = (
            "the maps of an unfinished fit of texels. Finish it with the command or call that began it: it goes on "
            "where it stopped."
            if (folder / "run.json").is_file()
            else f"no {ABOUT}, so no maps. Give the folder that diffshade texels -o wrote."
        )
        raise ValueError(f"{folder} holds {rest}")
    try:
        about = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged: {' '.join(f'{error}'.split())}. Write the maps again.") from None
    version = about.get("format")
    if version != FORMAT:
        raise ValueError(
            f"{path} has the format {version!r}, and this version of diffshade reads {FORMAT}. Fit the photographs "
            "again, into a new folder."
        )
    if "numbers" not in about:
        raise ValueError(
            f"{folder} holds maps as PNGs alone, which have no errors and are rounded. Write them as .npy or .exr."
        )
    return about


def _maps(folder: Path, about: dict[str, Any], scene: Any, camera: Any) -> TexelMaps:
    shape, suffix = camera.shape, about["numbers"]

    def numbers(name: str) -> np.ndarray:
        found = read_numbers(folder / f"{name}{suffix}")
        if found.ndim != 3 or found.shape[:2] != shape:
            raise ValueError(
                f"{folder / name}{suffix} has the shape {found.shape}, and the camera {shape}. Write the maps again."
            )
        return found

    status = np.rint(255.0 * read_image(folder / STATUS_PICTURE, srgb=False)[..., 0]).astype(np.uint8)
    if status.shape != shape or status.max() >= len(STATUS):
        raise ValueError(f"{folder / STATUS_PICTURE} is no map of the status of {shape} texels. Write the maps again.")
    names = [f"{name}" for name in about["maps"]]
    return TexelMaps(
        {name: numbers(name) for name in names},
        {name: numbers(f"{name}_error") for name in names},
        status,
        numbers("residual")[..., 0],
        scene,
        camera,
        tuple(f"{note}" for note in about.get("notes", ())),
        {name: float(times) for name, times in about["errors_95"].items()},
        _highlights(folder, about.get("highlight", ()), shape),
        _unexplained(folder, about["unexplained"], shape) if "unexplained" in about else None,
        **{name: read(about[name]) for name, read in OPTIONAL.items() if name in about},
    )


def _exposures(about: dict[str, Any]) -> Exposures:
    return Exposures(*(np.array(about[name], np.float64) for name in Exposures._fields))


def _shifts(about: dict[str, Any]) -> Shifts:
    return Shifts(*(np.array(about[name]) for name in Shifts._fields))


def _sensor(about: dict[str, float]) -> Sensor:
    """Return the sensor whose numbers have these dotted names."""
    parts = {name.rpartition(".")[2]: float(value) for name, value in about.items() if name.startswith("vignetting.")}
    own = {name: float(value) for name, value in about.items() if "." not in name}
    return Sensor(**own, vignetting=Vignetting(**parts))


# what maps may have beside numbers, by the names of `TexelMaps`
OPTIONAL = {"sensor": _sensor, "exposures": _exposures, "shifts": _shifts, "black": float}


def _highlights(folder: Path, powers: Any, shape: tuple[int, int]) -> tuple[SharedHighlight, ...]:
    """Return the powers of the shared highlight, with weights for each pixel where regions differ."""
    if not any(one["weight"] == WEIGHTS for one in powers):
        return tuple(SharedHighlight(float(one["weight"]), float(one["n_s"])) for one in powers)
    weights = read_array(folder / WEIGHTS)
    if weights.shape != (*shape, len(powers)):
        raise ValueError(
            f"{folder / WEIGHTS} has the shape {weights.shape}, and {ABOUT} needs {(*shape, len(powers))}. Write the "
            "maps again."
        )
    return tuple(SharedHighlight(weights[..., [j]], float(one["n_s"])) for j, one in enumerate(powers))


def _unexplained(folder: Path, about: Any, shape: tuple[int, int]) -> Unexplained:
    """Return what photographs show beyond the model."""
    lights, parts = read_array(folder / LIGHTS), read_array(folder / "unexplained.npy")
    count = lights.shape[1] // 2 - 1 if lights.ndim == 2 else 0  # columns: a vector, and twice what is kept of a texel
    whole = count > 0 and lights.shape[1] == 3 + 2 * count
    if not whole or parts.shape[:2] != shape or parts.shape[2:] not in ((count,), (3 * count,)):
        raise ValueError(f"{folder / 'unexplained.npy'} and {LIGHTS} do not belong together. Write the maps again.")
    toward, taken, given = np.split(np.asarray(lights, np.float64), (3, 3 + count), 1)
    return Unexplained(Interpolation(toward, float(about["width"]), taken.T, given), parts)
