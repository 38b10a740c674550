"""RAW files written by hand: the smallest DNG that a reader of RAW takes (Adobe's DNG 1.4)."""

from pathlib import Path

import numpy as np
import tifffile

BLACK, WHITE = 256, 4095
LEAST = 22  # pixels on a side, of which LibRaw takes no fewer


def write_dng(
    path: Path,
    colour: tuple[int, int, int],
    *,
    exposure: tuple[int, int] | None = None,
    orientation: int = 1,
    width: int = LEAST,
) -> Path:
    """Write a DNG of one colour, brighter to the right if it is wider; `exposure` is 1 / time and the F-number.

    The colour is given above black. `orientation` is as in EXIF.
    """
    mosaic = np.full((LEAST, width), BLACK, np.uint16) + np.maximum(np.arange(width, dtype=np.uint16), LEAST) - LEAST
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[row::2, column::2] += colour[channel]
    identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes([0, 1, 1, 2]), True),  # CFAPattern: red, green, green, blue
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50708, "s", 0, "diffshade", True),  # UniqueCameraModel
        (50714, "H", 1, BLACK, True),  # BlackLevel
        (50717, "H", 1, WHITE, True),  # WhiteLevel
        (50721, "2i", 9, identity, True),  # ColorMatrix1
        (50728, "2I", 3, (1, 2, 1, 1, 1, 2), True),  # AsShotNeutral: a white balance that is not applied
    ]
    if orientation != 1:
        tags += [(274, "H", 1, orientation, True)]
    if exposure is not None:
        tags += [(33434, "2I", 1, (1, exposure[0]), True), (33437, "2I", 1, (exposure[1], 1), True)]
    tifffile.imwrite(path, mosaic, photometric="CFA", extratags=tags, metadata=None)
    return path
