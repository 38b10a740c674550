"""Stated errors: what the spreads of the texels become once fits to parts of the lights say how large they are."""

from __future__ import annotations

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from ..blocks import TexelBlock
from ..map_arrays import MapArrays
from ..status import DETERMINED, MAX_NORMAL_ERROR, NO_HIGHLIGHT, OUTSIDE, UNDETERMINED
from ..tiles import TexelTile
from .block_fits import Turned, turned
from .calibration import Spreads, calibrated, parts_of
from .learning import ObjectModel
from .texel_work import Shared, TexelWork

CALIBRATION_SAMPLE = 1024  # texels that are fitted to parts of the lights
LEAST_EXPONENT_ERROR = 0.1  # of n_s, relative
LEAST_SHARE = 0.05  # of the grey error that a channel has at least
ANGLE_68 = float(np.sqrt(-2.0 * np.log(0.32)))  # standard deviations about two axes within which 68 % lie


def state_errors(
    work: TexelWork, shared: Shared, arrays: MapArrays, spread: Float[np.ndarray, "h w 4"]
) -> dict[str, float]:
    """Turn spreads into errors; return how many errors hold the truth 95 % of the time."""
    sample = work.tiles.reader.sample(CALIBRATION_SAMPLE)
    parts = parts_of(work.toward(sample))

    def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Turned:
        return turned(work.setup, work.known, block, model, parts)

    found = work.each(sample, program, shared.models)
    there = spread.reshape(-1, 4)[sample.pixels].T
    held = {
        "normal": calibrated(found.angle, there[0], found.reached),
        "k_d": calibrated(np.abs(found.k_d), there[1], found.reached),
        "k_s": calibrated(np.abs(found.k_s), there[2], found.reached),
    }
    held["k_s"] = held["k_s"]._replace(errors=max(held["k_s"].errors, 1.0))  # most texels show little of theirs
    region = work.region_of(sample.pixels)
    exponents = np.array(
        [
            _exponent_error(work, sample.part(np.flatnonzero(region == r)), m, parts)
            for r, m in enumerate(shared.refined)
        ]
    )
    for t in work.tiles.own:
        rows = slice(*work.tiles.rows_of(t))
        _write_errors(work, arrays.arrays, spread, held, exponents, rows)
    return {name: one.times_95 for name, one in held.items()}


def _write_errors(
    work: TexelWork,
    values: dict[str, np.ndarray],
    spread: Float[np.ndarray, "h w 4"],
    held: dict[str, Spreads],
    exponents: Float[np.ndarray, " regions"],
    rows: slice,
) -> None:
    """Write the errors of some rows, and what they show not to be known into the status."""
    status, here = values["status"][rows, :, 0], spread[rows]
    inside = status != OUTSIDE
    with np.errstate(invalid="ignore", over="ignore"):
        normal = np.rad2deg(np.hypot(here[..., 0] * held["normal"].errors, here[..., 3] * ANGLE_68))
        errors = {"normal": np.where(normal <= 90.0, normal, np.inf)[..., None]}
        for i, name in ((1, "k_d"), (2, "k_s")):
            value = values[name][rows]
            grey = value.mean(-1, keepdims=True)
            share = np.where(grey > 0.0, value / np.where(grey > 0.0, grey, 1.0), 1.0)  # errs as it reflects
            errors[name] = here[..., i, None] * held[name].errors * np.maximum(share, LEAST_SHARE)
    pixels = np.arange(rows.start * status.shape[1], rows.stop * status.shape[1])
    exponent = exponents[work.region_of(pixels)].reshape(status.shape)
    relative = np.where(np.isinf(here[..., 0]), np.inf, exponent)
    errors["n_s"] = (np.where(inside, relative, 0.0) * np.maximum(values["n_s"][rows, :, 0], 1.0))[..., None]
    for name, error in errors.items():
        values[f"{name}_error"][rows] = np.where(inside[..., None], np.where(np.isnan(error), np.inf, error), 0.0)
    large = values["normal_error"][rows, :, 0] > np.rad2deg(MAX_NORMAL_ERROR)
    dull = (values["k_s"][rows] <= values["k_s_error"][rows]).all(-1)
    status[(status == DETERMINED) & dull] = NO_HIGHLIGHT
    status[((status == DETERMINED) | (status == NO_HIGHLIGHT)) & large] = UNDETERMINED


def _exponent_error(
    work: TexelWork, sample: TexelTile, model: ObjectModel, parts: Bool[np.ndarray, "parts views"]
) -> float:
    """Return the relative error of n_s: by how much it changes when parts of the views alone are learned from.

    The powers of the shape are a factor of 2 apart, so that no n_s is known better than to a part of that.
    """
    if np.isinf(float(model.brightest)) or not len(sample.pixels):
        return np.inf
    changes = []
    for part in parts:
        of_part = eqx.tree_at(lambda tile: tile.counts, sample, sample.counts & part[:, None])
        other = work.refined(model, of_part, rounds=2)
        changes.append(abs(np.log(other.shape.exponent / model.shape.exponent)))
    return float(np.hypot(np.expm1(np.sqrt(len(parts) - 1.0) * max(changes)), LEAST_EXPONENT_ERROR))
