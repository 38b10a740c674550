"""Pictures that commands draw: checked before any work, written, and told of in one line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .terminal import answer

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float


EXPOSED = "Factor from radiance to picture; auto: so that the brightest are white  [default: 1]"


def check_picture(out: Path, exposure: float | str, bits: int | None = None) -> None:
    """Refuse a file that cannot be written, or an exposure that is none."""
    from ..io.files import writable
    from ..io.images import dtype_to_write

    dtype_to_write(out, bits)
    writable(out)
    if isinstance(exposure, float) and not 0 < exposure < float("inf"):
        raise ValueError(f"--exposure must be above 0 and finite; got {exposure:g}. Give 1 for unscaled radiance.")


def check_holds_bands(out: Path, bands: int) -> None:
    """Refuse a file of a format that has fewer channels than a picture, or takes its last one for alpha."""
    from ..core.fields import MOST_BANDS
    from ..io.image_formats import format_of

    if bands not in (1, 3) and format_of(out).channels < MOST_BANDS:
        raise ValueError(f"{out} cannot hold {bands} bands. Give a .tif or .npy: -o {out.with_suffix('.tif')}.")


def put_picture(
    out: Path,
    radiance: Float[np.ndarray, "h w c"],
    exposure: float | str,
    *,
    srgb: bool | None,
    bits: int | None = None,
) -> None:
    """Write radiance times an exposure, or times the one that is found, and print the picture's size and its range."""
    import numpy as np

    import diffshade as ds

    from ..core.thresholds import UNCLIPPED_PERCENT
    from ..io.images import dtype_to_write

    said, factor = None, exposure
    if isinstance(factor, str):
        brightest = radiance.max(-1)
        lit = brightest[brightest > 0.0]
        factor = 1.0 / float(np.percentile(lit, UNCLIPPED_PERCENT)) if lit.size else 1.0
        said = f"exposure {factor:.4g}: {UNCLIPPED_PERCENT:g} % of the pixels that are not black are not above 1"
    image = radiance * factor
    clips = said is not None and dtype_to_write(out, bits).kind == "u"
    ds.write_image(out, np.minimum(image, 1.0) if clips else image, srgb=srgb, bits=bits)  # as `said` says
    height, width = image.shape[:2]
    least, most = float(image.min()), float(image.max())
    answer(
        [f"{out}: {width} x {height} pixels, radiance {least:.3g} to {most:.3g}", said],
        {"picture": out, "shape": image.shape, "least": least, "most": most, "exposure": factor},
    )
