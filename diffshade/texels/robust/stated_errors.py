r"""Stated errors: what the spreads of the texels become once fits to parts of the lights say how large they are.

$$ spread^2 = b^2 ((misfit \cdot scatter / typical)^2 + bounce^2) $$

misfit is the error by the curvature of the cost, scatter that of the normals around a texel, larger in relief, whose
shadows and bounced light no texel knows of; bounce is what the misfit does not show: how far bounced light turns a
normal that it fits. b is the share of the observations around that are brighter than the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ...core.fields import Array
from ...core.thresholds import MINOR, SMALL, TINY
from ..map_arrays import MapArrays
from ..maps import ANGLE_68
from ..prediction import TexelBlock
from ..status import MAX_NORMAL_ERROR, OUTSIDE, SHADOWED, UNDETERMINED, status_of
from ..tiles import LEARNING_SAMPLE, TexelTile
from .block_fits import Turned, turned
from .calibration import Division, Spreads, calibrated, division_of
from .learning import ObjectModel
from .texel_work import Shared, TexelWork

CALIBRATION_SAMPLE = LEARNING_SAMPLE // 2  # texels that are fitted to parts of the lights


class SpreadColumns(NamedTuple):
    """What is kept of each texel for its errors, infinite where nothing is known."""

    misfit: Float[np.ndarray, "..."]
    """Of the normal by the misfit around and the curvature, times b."""
    scatter: Float[np.ndarray, "..."]
    bounce: Float[np.ndarray, "..."]
    """Turn of the normal by bounced light, times b."""
    k_d: Float[np.ndarray, "..."]
    k_s: Float[np.ndarray, "..."]
    by_lights: Float[np.ndarray, "..."]
    """Standard deviation of the normal that follows from the errors of the lights, radians."""
    by_choice: Float[np.ndarray, "..."]
    """How far the normal may be off because another minimum fits nearly as well, radians."""

    def stacked(self) -> Float[np.ndarray, "... columns"]:
        """Return the columns as one array."""
        return np.stack(self, -1)

    def of_normal(self, typical: float) -> Float[np.ndarray, "..."]:
        """Return the spread of the normals, given the scatter of the typical texel."""
        return np.hypot(self.misfit * (self.scatter / typical), self.bounce)


COLUMNS = len(SpreadColumns._fields)


class PartFits(NamedTuple):
    """Some texels fitted to parts of the lights."""

    sample: TexelTile
    division: Division
    found: Turned

    def held_by(self, spread: Float[np.ndarray, " texels"], difference: Float[Array, "parts texels"]) -> Spreads:
        """Return how many spreads hold the truth, given how far the parts' numbers are from those of all lights."""
        return calibrated(difference, spread, self.found.reached, self.division)


def fit_parts(work: TexelWork, models: Sequence[ObjectModel]) -> PartFits:
    """Fit a sample of the texels to parts of the lights."""
    work.tiles.report_progress("fitting parts of the lights")
    sample = work.tiles.reader.sample(CALIBRATION_SAMPLE)
    division = division_of(work.toward(sample))

    def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Turned:
        return turned(work.observed(block, model), model, division.parts)

    return PartFits(sample, division, work.each(sample, program, models))


def state_errors(
    work: TexelWork, shared: Shared, parts: PartFits, arrays: MapArrays, spread: Float[np.ndarray, "h w columns"]
) -> dict[str, float]:
    """Turn spreads into errors; return how many errors hold the truth 95 % of the time."""
    sample, division, found = parts
    there = SpreadColumns(*spread.reshape(-1, COLUMNS)[sample.pixels].T)
    known = np.isfinite(there.scatter)
    typical = float(np.median(there.scatter[known])) if known.any() else 1.0
    held = {
        "normal": parts.held_by(there.of_normal(typical), found.angle),
        "k_d": parts.held_by(there.k_d, np.abs(found.k_d)),
        "k_s": parts.held_by(there.k_s, np.abs(found.k_s)),
    }
    held["k_s"] = held["k_s"]._replace(errors=max(held["k_s"].errors, 1.0))  # most texels show little of theirs
    region = work.region_of(sample.pixels)
    by_shape = np.array(
        [
            _errors_by_shape(work, sample.part(np.flatnonzero(region == r)), m, division)
            for r, m in enumerate(shared.refined)
        ]
    )
    for t in work.tiles.own:
        rows = slice(*work.tiles.rows_of(t))
        here = SpreadColumns(*np.moveaxis(spread[rows], -1, 0))
        _write_errors(work, arrays.arrays, here, typical, held, by_shape, rows)
    return {name: one.times_95 for name, one in held.items()}


def _write_errors(
    work: TexelWork,
    values: dict[str, np.ndarray],
    here: SpreadColumns,
    typical: float,
    held: dict[str, Spreads],
    by_shape: Float[np.ndarray, "regions 2"],
    rows: slice,
) -> None:
    """Write the errors of some rows, and what they show not to be known into the status."""
    status = values["status"][rows, :, 0]
    inside = status != OUTSIDE
    with np.errstate(invalid="ignore", over="ignore"):
        # groups of lights differ by what the lights' own errors do, too: the larger of the two, not both
        of_groups = here.of_normal(typical) * held["normal"].errors
        normal = np.rad2deg(np.hypot(np.maximum(of_groups, here.by_lights * ANGLE_68), here.by_choice))
        errors = {"normal": np.where(normal <= 90.0, normal, np.inf)[..., None]}
        pixels = np.arange(rows.start * status.shape[1], rows.stop * status.shape[1])
        of_n_s, of_k_d = by_shape[work.region_of(pixels)].T.reshape(2, *status.shape)
        for name, own in (("k_d", here.k_d), ("k_s", here.k_s)):
            value = values[name][rows]
            grey = value.mean(-1, keepdims=True)
            share = np.where(grey > 0.0, value / np.where(grey > 0.0, grey, 1.0), 1.0)  # errs as it reflects
            errors[name] = own[..., None] * held[name].errors * np.maximum(share, MINOR)
        # what the shape takes of the light is white like k_s, whatever the colour of k_d
        errors["k_d"] = np.hypot(errors["k_d"], (of_k_d * values["k_d"][rows].mean(-1))[..., None])
    relative = np.where(np.isinf(here.misfit), np.inf, of_n_s)
    errors["n_s"] = (np.where(inside, relative, 0.0) * np.maximum(values["n_s"][rows, :, 0], 1.0))[..., None]
    for name, error in errors.items():
        values[f"{name}_error"][rows] = np.where(inside[..., None], np.where(np.isnan(error), np.inf, error), 0.0)
    large = values["normal_error"][rows, :, 0] > np.rad2deg(MAX_NORMAL_ERROR)
    shines = np.any(values["k_s"][rows] > values["k_s_error"][rows], -1)
    found = status_of(shines, large | (status == UNDETERMINED), status == SHADOWED)
    status[inside] = found[inside]


def _errors_by_shape(work: TexelWork, sample: TexelTile, model: ObjectModel, division: Division) -> tuple[float, float]:
    """Return the relative errors of n_s, and of k_d by the shape: how far both change as parts of the views teach it.

    The powers of the shape are a factor of 2 apart, so that no n_s is known better than to a part of that. What the
    shape takes from k_d is alike for all texels.
    """
    if not model.assumed.glossy or np.isinf(float(model.brightest)) or not len(sample.pixels):
        return np.inf, 0.0

    def program(block: TexelBlock, model: ObjectModel, _: np.ndarray | None) -> Array:
        observed, state = work.at_minimum(block, model)
        return state.k_d * observed.level

    k_d, each = work.each(sample, program, [model]), []
    for part in division.parts[: division.first]:
        of_part = eqx.tree_at(lambda tile: tile.counts, sample, sample.counts & part[:, None])
        other = work.refined(model, of_part, rounds=2)
        of_k_d = work.each(sample, program, [other]) / np.maximum(k_d, TINY) - 1.0
        each.append((np.log(other.shape.exponent / model.shape.exponent), np.median(of_k_d)))
    changes = np.array(each)
    sizes = np.abs(changes)
    typical = sizes.max(0) if division.first == 2 else np.sqrt(np.square(sizes).mean(0))
    of_n_s, of_k_d = np.sqrt(division.first - 1.0) * typical
    n_s = np.hypot(np.expm1(of_n_s), SMALL)
    k_d_by_n_s = abs(changes[:, 0] @ changes[:, 1]) / max(changes[:, 0] @ changes[:, 0], TINY)  # least squares
    return float(n_s), float(max(of_k_d, k_d_by_n_s * n_s))
