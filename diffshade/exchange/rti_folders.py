"""RTI folders: maps as coefficients of PTM or HSH, which Relight and OpenLIME show, as museums' viewers do.

`info.json` names size, basis and colour space ("rgb"); `plane_K.jpg` holds the K-th coefficient of red, green and blue,
c from 0 to 1, as (c - bias) scale.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.fields import check_kind
from ..inverse.data.relightable import COUNT, dome
from ..io.encodings import srgb_encode
from ..io.files import replacing
from ..io.image_formats import encode
from ..io.images import read_image
from ..io.rti_files import PTM_TERMS, terms
from ..model.lights import DirectionalLight
from ..texels.heights.mesh import camera_axes
from ..texels.maps import TexelMaps
from ..texels.status import OUTSIDE

COUNTS = {"ptm": PTM_TERMS, "hsh": 9}  # what OpenLIME draws
ORDER = {"ptm": [5, 3, 4, 0, 2, 1], "hsh": list(range(9))}  # 1 x y x^2 xy y^2, where a .ptm begins with x^2
LIGHTS = 2 * COUNT  # that are fitted
OTHERS, MIN_Z = 7, 0.2  # lights for the error; the least z of all of their directions
CLIPPED_PERCENT, QUALITY = 0.05, 95  # of the coefficients that are clipped at either end; of the JPEGs


@dataclass(frozen=True)
class ExportedRti:
    """The files of an RTI folder, and how far its pictures are from those of the maps."""

    paths: tuple[Path, ...]
    """`info.json` last."""
    rms: float
    """Root mean square difference of the pictures as displayed, 1 the brightest, under lights that were not fitted."""
    notes: tuple[str, ...]
    """What the format cannot hold."""

    def __str__(self) -> str:
        """Return the notes, each with the name of the folder."""
        return "\n".join(f"{self.paths[-1].parent}: {note}" for note in self.notes)


def write_rti(folder: str | os.PathLike[str], maps: TexelMaps, *, basis: str = "hsh") -> ExportedRti:
    """Write maps as a folder that Relight and OpenLIME show under any light: `info.json` and planes as JPEG.

    The basis is fitted by least squares to what `TexelMaps.shade` shows under 48 lights, encoded by the sRGB curve,
    since those viewers display the numbers as they are.

    Args:
        folder: The folder; it is made if it does not exist.
        maps: The maps.
        basis: "hsh", nine hemispherical harmonics, the default, or "ptm", a polynomial of six terms.

    Returns:
        The files, the difference that is left, measured from them, and notes.

    Raises:
        ValueError: The basis is another one.
        TypeError: `maps` are no maps.
        OSError: A file cannot be written.
    """
    check_kind("maps", maps, TexelMaps, "read_maps(folder)")
    if basis not in COUNTS:
        raise ValueError(f"basis must be hsh or ptm; got {basis!r}. Give one of them.")
    folder, count = Path(folder), COUNTS[basis]
    axes = np.stack(camera_axes(maps.camera))

    inside, above = maps.status != OUTSIDE, list[float]()

    def shown(toward: Float[np.ndarray, "3"]) -> Float[np.ndarray, "h w 3"]:
        radiance = maps.shade(DirectionalLight(-toward @ axes))
        above.append(float(np.mean(radiance[inside] > 1.0)))
        return np.asarray(srgb_encode(np.clip(radiance, 0.0, 1.0)))

    lights = dome(LIGHTS, MIN_Z)
    solve = np.linalg.pinv(np.stack([terms(basis, count, l) for l in lights]))[ORDER[basis]]
    coefficients = np.zeros((count, *maps.status.shape, 3), np.float32)
    for weight, l in zip(solve.T, lights, strict=True):
        coefficients += weight[:, None, None, None].astype(np.float32) * shown(l).astype(np.float32)
    low, high = np.percentile(coefficients[:, inside], (CLIPPED_PERCENT, 100.0 - CLIPPED_PERCENT), axis=1)  # (terms, 3)
    scale = np.maximum(high - low, 1e-6)
    bias = -low / scale
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"plane_{k}.jpg" for k in range(count)]
    for k, path in enumerate(paths):
        stored = np.rint(255.0 * np.clip(coefficients[k] / scale[k] + bias[k], 0.0, 1.0)).astype(np.uint8)
        with replacing(path) as temporary:
            temporary.write_bytes(encode(".jpg", stored, quality=QUALITY))
    rows, columns = maps.status.shape
    info = {
        "width": columns,
        "height": rows,
        "format": "jpg",
        "type": basis,
        "colorspace": "rgb",
        "lights": lights.ravel().round(4).tolist(),
        "nplanes": 3 * count,
        "quality": QUALITY,
        "materials": [{"scale": scale.ravel().tolist(), "bias": bias.ravel().tolist()}],
    }
    back = np.stack([(read_image(path, srgb=False) - b) * s for path, s, b in zip(paths, scale, bias, strict=True)])
    off = [
        (np.clip(np.tensordot(terms(basis, count, l)[ORDER[basis]], back, 1), 0.0, 1.0) - shown(l))[inside]
        for l in dome(OTHERS, MIN_Z)
    ]
    rms = float(np.sqrt(np.mean(np.square(off))))
    notes = (
        f"under {OTHERS} other lights its pictures, as displayed, differ by {rms:.2g} (rms) from those of the maps.",
        f"{basis.upper()} of {count} terms has no highlight sharper than its basis, and no errors.",
        "its numbers are encoded by the sRGB curve, as viewers display them.",
        *([f"{clipped:.2g} of its pictures is brighter than 1, and clipped."] if (clipped := np.mean(above)) else []),
    )
    with replacing(folder / "info.json") as temporary:
        temporary.write_text(json.dumps(info | {"notes": list(notes)}, indent=1), encoding="utf-8")
    return ExportedRti((*paths, folder / "info.json"), rms, notes)
