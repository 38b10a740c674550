"""RTI: maps as coefficients of PTM or HSH, in folders (Relight, OpenLIME) or as a `.ptm` file (RTIViewer).

In a folder `info.json` names size, basis and colour space ("rgb"); `plane_K.jpg` holds the K-th coefficient of red,
green and blue, c from 0 to 1, as (c - bias) scale. A `.ptm` file has a polynomial for each channel
(`PTM_FORMAT_RGB`): that of one brightness times one colour (LRGB) takes half the room, and changes colours where
a highlight or a coloured light has its own.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.fields import check_kind
from ..inverse.data.relightable import COUNT, dome
from ..io.encodings import srgb_encode
from ..io.files import write_file
from ..io.image_formats import encode
from ..io.images import read_image
from ..io.rti_files import PTM_TERMS, ptm_file, read_rti, terms
from ..model.cameras import camera_axes
from ..model.lights import DirectionalLight
from ..texels.maps import TexelMaps
from ..texels.status import OUTSIDE

COUNTS = {"ptm": PTM_TERMS, "hsh": 9}  # what OpenLIME draws
ORDER = {"ptm": [5, 3, 4, 0, 2, 1], "hsh": list(range(9))}  # 1 x y x^2 xy y^2, where a .ptm begins with x^2
LIGHTS = 2 * COUNT  # that are fitted
OTHERS, MIN_Z = 7, 0.2  # lights for the error; the least z of all of their directions
CLIPPED_PERCENT, QUALITY = 0.05, 95  # of the coefficients that are clipped at either end; of the JPEGs


@dataclass(frozen=True)
class ExportedRti:
    """The files of an RTI folder, or a `.ptm` file, and how far its pictures are from those of the maps."""

    paths: tuple[Path, ...]
    """The `.ptm` file, or the folder's files with `info.json` last."""
    rms: float
    """Root mean square difference of the pictures as displayed, 1 the brightest, under lights that were not fitted."""
    notes: tuple[str, ...]
    """What the format cannot hold."""

    def __str__(self) -> str:
        """Return the notes, each with the name of the folder or file."""
        name = self.paths[0] if self.paths[0].suffix == ".ptm" else self.paths[-1].parent
        return "\n".join(f"{name}: {note}" for note in self.notes)


class _Pictures:
    """The maps' pictures as viewers display them, encoded by the sRGB curve, and how much of them is clipped."""

    def __init__(self, maps: TexelMaps) -> None:
        self.maps, self.inside, self.above = maps, maps.status != OUTSIDE, list[float]()
        self.axes = np.stack(camera_axes(maps.camera))

    def shown(self, toward: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w 3"]:
        radiance = self.maps.shade(DirectionalLight(-toward @ self.axes))
        self.above.append(float(np.mean(radiance[self.inside] > 1.0)))
        return np.asarray(srgb_encode(np.clip(radiance, 0.0, 1.0)))

    def coefficients(self, basis: str) -> Float[np.ndarray, "terms h w 3"]:
        """Return the coefficients by least squares, in the order of `terms`."""
        lights, count = dome(LIGHTS, MIN_Z), COUNTS[basis]
        solve = np.linalg.pinv(np.stack([terms(basis, count, l) for l in lights]))
        found = np.zeros((count, *self.maps.status.shape, 3), np.float32)
        for weight, l in zip(solve.T, lights, strict=True):
            found += weight[:, None, None, None].astype(np.float32) * self.shown(l).astype(np.float32)
        return found

    def difference(self, drawn: Callable[[Float[np.ndarray, "3"]], np.ndarray]) -> float:
        """Return the root mean square difference of what a viewer draws, under lights that were not fitted."""
        off = [(np.clip(drawn(l), 0.0, 1.0) - self.shown(l))[self.inside] for l in dome(OTHERS, MIN_Z)]
        return float(np.sqrt(np.mean(np.square(off))))

    def notes(self, basis: str, rms: float) -> tuple[str, ...]:
        clipped = np.mean(self.above)
        return (
            f"under {OTHERS} other lights its pictures, as displayed, differ by {rms:.2g} (rms) from those of the "
            "maps.",
            f"{basis.upper()} of {COUNTS[basis]} terms has no highlight sharper than its basis, and no errors.",
            "its numbers are encoded by the sRGB curve, as viewers display them.",
            *([f"{clipped:.2g} of its pictures is brighter than 1, and clipped."] if clipped else []),
        )


def write_rti(path: str | os.PathLike[str], maps: TexelMaps, *, basis: str | None = None) -> ExportedRti:
    """Write maps so that viewers of RTI show them under any light: a folder, or a `.ptm` file.

    The basis is fitted by least squares to what `TexelMaps.shade` shows under 48 lights, encoded by the sRGB curve,
    since viewers display the numbers as they are.

    Args:
        path: A folder for Relight and OpenLIME (`info.json` and planes as JPEG), made if it does not exist; or a file
            that ends in `.ptm`, for RTIViewer: PTM 1.2, a polynomial for each channel (Malzbender, Gelb and Wolters
            2001).
        maps: The maps.
        basis: Of a folder: "hsh", nine hemispherical harmonics, the default, or "ptm", a polynomial of six terms, which
            a `.ptm` file always has.

    Returns:
        The files, the difference that is left, measured from them, and notes.

    Raises:
        ValueError: The basis is another one.
        TypeError: `maps` are no maps.
        OSError: A file cannot be written.
    """
    check_kind("maps", maps, TexelMaps, "read_maps(folder)")
    path, of_file = Path(path), Path(path).suffix.lower() == ".ptm"
    basis = ("ptm" if of_file else "hsh") if basis is None else basis
    if basis not in COUNTS:
        raise ValueError(f"basis must be hsh or ptm; got {basis!r}. Give one of them.")
    if of_file and basis != "ptm":
        raise ValueError(f"{path} is a PTM, whose basis is ptm; got {basis!r}. Leave basis out, or name a folder.")
    return _write_ptm(path, _Pictures(maps)) if of_file else _write_folder(path, _Pictures(maps), basis)


def _ranges(coefficients: np.ndarray, inside: np.ndarray, axis: int | tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest of the coefficients, but for those few that are clipped."""
    low, high = np.percentile(coefficients[:, inside], (CLIPPED_PERCENT, 100.0 - CLIPPED_PERCENT), axis=axis)
    return low, high


def _write_ptm(path: Path, pictures: _Pictures) -> ExportedRti:
    coefficients = pictures.coefficients("ptm")
    low, high = _ranges(coefficients, pictures.inside, (1, 2))
    write_file(path, ptm_file(np.moveaxis(coefficients, 0, -1), low, high))
    rms = pictures.difference(read_rti(path).shade)
    return ExportedRti((path,), rms, pictures.notes("ptm", rms))


def _write_folder(folder: Path, pictures: _Pictures, basis: str) -> ExportedRti:
    count, order = COUNTS[basis], ORDER[basis]
    coefficients = pictures.coefficients(basis)[order]
    low, high = _ranges(coefficients, pictures.inside, 1)  # (terms, 3)
    scale = np.maximum(high - low, 1e-6)
    bias = -low / scale
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"plane_{k}.jpg" for k in range(count)]
    for k, path in enumerate(paths):
        stored = np.rint(255.0 * np.clip(coefficients[k] / scale[k] + bias[k], 0.0, 1.0)).astype(np.uint8)
        write_file(path, encode(".jpg", stored, quality=QUALITY))
    rows, columns = pictures.maps.status.shape
    info = {
        "width": columns,
        "height": rows,
        "format": "jpg",
        "type": basis,
        "colorspace": "rgb",
        "lights": dome(LIGHTS, MIN_Z).ravel().round(4).tolist(),
        "nplanes": 3 * count,
        "quality": QUALITY,
        "materials": [{"scale": scale.ravel().tolist(), "bias": bias.ravel().tolist()}],
    }
    back = np.stack([(read_image(path, srgb=False) - b) * s for path, s, b in zip(paths, scale, bias, strict=True)])
    rms = pictures.difference(lambda l: np.tensordot(terms(basis, count, l)[order], back, 1))
    notes = pictures.notes(basis, rms)
    write_file(folder / "info.json", json.dumps(info | {"notes": list(notes)}, indent=1))
    return ExportedRti((*paths, folder / "info.json"), rms, notes)
