"""Pictures that commands draw: checked before any work, written, and told of in one line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .terminal import answer

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float


def check_picture(out: Path, exposure: float, bits: int | None = None) -> None:
    """Refuse a file that cannot be written, or an exposure that is none."""
    from ..io.files import writable
    from ..io.images import dtype_to_write

    dtype_to_write(out, bits)
    writable(out)
    if not 0 < exposure < float("inf"):
        raise ValueError(f"--exposure must be above 0 and finite; got {exposure:g}. Give 1 for unscaled radiance.")


def check_holds_bands(out: Path, bands: int) -> None:
    """Refuse a file of a format that has fewer channels than a picture, or takes its last one for alpha."""
    from ..core.fields import MOST_BANDS
    from ..io.image_formats import format_of

    if bands not in (1, 3) and format_of(out).channels < MOST_BANDS:
        raise ValueError(f"{out} cannot hold {bands} bands. Give a .tif or .npy: -o {out.with_suffix('.tif')}.")


def put_picture(out: Path, image: Float[np.ndarray, "h w c"], *, srgb: bool | None, bits: int | None = None) -> None:
    """Write a picture, and print its size and its range."""
    import diffshade as ds

    ds.write_image(out, image, srgb=srgb, bits=bits)
    height, width = image.shape[:2]
    least, most = float(image.min()), float(image.max())
    answer(
        [f"{out}: {width} x {height} pixels, radiance {least:.3g} to {most:.3g}"],
        {"picture": out, "shape": image.shape, "least": least, "most": most},
    )
