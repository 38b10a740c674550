"""Lamps: measured photometry as lights."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from ...core.fields import Numbers, Vector
from ...core.words import errors_at
from ...model.attenuation import RadialAttenuation
from ...model.measured_lights import MeasuredLight, Profile
from ..parsing import read_text
from .eulumdat import read_eulumdat
from .ies import Tilt, read_ies, read_tilt

READERS = (".ies", ".ldt")
_LOGGER = logging.getLogger("diffshade")


def read_lamp(
    path: str | Path,
    *,
    position: Numbers = (0.0, 0.0, 0.0),
    direction: Numbers = (0.0, -1.0, 0.0),
    side: Numbers = (1.0, 0.0, 0.0),
    lamp_set: int | Literal["all"] | None = None,
    tilt: str | Path | None = None,
) -> MeasuredLight:
    """Read a lamp from an IES (LM-63) or EULUMDAT file; `print` it for a summary.

    The profile is relative to the peak, the intensity is the peak in candela, and the attenuation is 1/d^2. With
    lengths in metres, the light arriving at a surface is in lux. Use `dataclasses.replace(lamp, intensity=1)` for the
    units of other lights. Photometry of types A and B is resampled as type C about its axis, H = V = 0: H grows
    towards `side`, and V a quarter turn further on, as C does. A lamp whose output changes when it is tilted (TILT) is
    multiplied by its factor at the angle between `direction` and straight down, -y. The logger "diffshade" warns, in
    one line each, of what the file holds beyond that. Reading needs at most 64 times the file's size of memory.

    Args:
        path: The file, .ies or .ldt.
        position: The lamp's position, scene units.
        direction: The direction of the lamp's axis; by default downwards.
        side: The direction of the plane C = 0, across the axis; by default +x.
        lamp_set: Of an EULUMDAT file with several sets of lamps, which one is lit, from 0, or "all"; by default the
            first.
        tilt: The file that TILT names, which is not opened unless it is given here.

    Returns:
        The lamp as a light.

    Raises:
        ValueError: If the suffix is unknown, or the file is malformed.
        FileNotFoundError: If the file does not exist.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise ValueError(f"a lamp file must end in .ies or .ldt; got '{path.suffix}'. Rename or convert {path}.")
    if suffix == ".ies" and lamp_set is not None:
        raise ValueError(f"an IES file has one set of lamps; got lamp_set={lamp_set!r} for {path}. Leave it out.")
    text = read_text(path, "lamp file")
    data = read_ies(text, f"{path}") if suffix == ".ies" else read_eulumdat(text, f"{path}", lamp_set)
    factors = data.tilt
    if tilt is not None:
        factors = read_tilt(read_text(tilt, "tilt file"), f"{tilt}")
    for note in (note for note in data.notes if tilt is None or not note.startswith("TILT")):
        _LOGGER.warning("%s: %s", path, note)
    table = data.table
    peak = float(table.candela.max())
    if not (np.isfinite(table.candela).all() and table.candela.min() >= 0 and peak > 0):
        raise ValueError(f"{path}: the intensities must be finite, at least 0 and not all 0. Correct the file.")
    with errors_at(f"{path}"):
        profile = Profile(table.vertical, table.horizontal, table.candela / peak)
        fades = RadialAttenuation(0, 0, 1)
        lamp = MeasuredLight(position, direction, profile, peak, fades, side, data.label)
    return lamp if factors is None else replace(lamp, intensity=peak * _at_tilt(factors, lamp.direction))


def _at_tilt(tilt: Tilt, direction: Vector) -> float:
    """Return the factor of a lamp whose axis is turned from straight down into a direction."""
    axis = np.asarray(direction)
    angle = np.rad2deg(np.arccos(np.clip(-axis[1] / np.linalg.norm(axis), -1.0, 1.0)))
    return float(np.interp(angle, *tilt))
