"""Response: the gamma of photographs whose camera did not say it, from all texels of an object under known lights.

Through a wrong gamma, no normal and no highlight explains what a texel shows under lights of known strength.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import equinox as eqx
import jax
import numpy as np

from ...core.backend import check_backend, in_float64
from ...core.fields import as_float64
from ...core.progress import ReportProgress, showing, silent
from ...core.robust_scale import jackknife_error
from ...core.tables import as_text, with_error
from ...core.thresholds import MINOR
from ...core.words import Note
from ...inverse.data.sensors import Sensor
from ...inverse.data.views import View
from ...model.scenes import Scene
from ..between_lights import MIN_VIEWS
from ..checks import checked
from ..fitting import MEMORY
from ..robust.run import RobustRun
from ..robust.stated_errors import CALIBRATION_SAMPLE
from ..run import TexelRun
from ..tile_runner import TileRunner
from ..tiles import TexelTile
from .finding import FREE
from .gammas import Misfit, lowest, misfit_through

GAMMAS = np.geomspace(0.45, 3.2, 9)  # gammas that are tried first
CLEAR_RATIO = 1.25  # of the misfits of the outermost gammas to the least one, from which that is believed
GROUPS = 4  # of the views, left out in turn


@dataclass(frozen=True, eq=False)
class FoundResponse:
    """The gamma that all texels of an object agree with; `print` it."""

    gamma: float
    """Exponent that makes the photographs linear, as in `Sensor`; 1 where they do not determine it."""
    error: float
    """Its standard error: the scatter and the shift when groups of photographs are left out, and the misfit; infinite
    where these photographs do not determine it."""
    views: tuple[View, ...] = field(repr=False)
    """The views with this gamma as their sensor, for `fit_texels` and `fit`."""
    misfit: float
    """Typical residual of a texel with this gamma, relative to its brightness in the file."""
    misfit_linear: float
    """The same if the photographs are taken to be linear."""
    notes: tuple[Note, ...]

    def __str__(self) -> str:
        """Return the gamma, how much it reduces the misfit, and the notes."""
        return as_text(
            f"gamma {with_error(self.gamma, self.error)}; the misfit of a texel is {100 * self.misfit:.2g} %, and "
            f"{100 * self.misfit_linear:.2g} % if the photographs are taken to be linear",
            notes=self.notes,
        )


def find_response(scene: Scene, views: Sequence[View], *, progress: bool = False) -> FoundResponse:
    r"""Find the gamma of photographs of an object of unknown shape, from the agreement of its texels.

    $$ image = f^\gamma, \quad m(\gamma) = \min $$

    m is the typical residual of a texel relative to its brightness, both as in the file, after the robust fit of
    `fit_texels` to the photographs raised to gamma. As in
    calibration from radiometric consistency (Lin, Gu, Yamazaki and Shum, CVPR 2004), but by the shading of one object.

    Lights of unequal known strengths tell it best. A gamma that is found in place of one that is known costs accuracy:
    give linear photographs where there are any.

    Args:
        scene: One opaque object and all lights, as for `fit_texels`.
        views: At least 12 photographs of one camera, black at 0 and without a sensor; sRGB ones are decoded as usual.
        progress: Show a line of progress on the terminal.

    Returns:
        The gamma with its error, and the views with it.

    Raises:
        ValueError: An argument is wrong; the message has the remedy.
        TypeError: An argument has the wrong type.
    """
    views = tuple(views)
    checked(scene, views, FREE, None, "cauchy")
    _check(views)
    check_backend()
    scene = jax.tree.map(as_float64, scene)
    plain = tuple(dataclasses.replace(view, noise=None) for view in views)
    with (
        showing("response", show=progress) as report_progress,
        in_float64((scene, plain)) as (inner, plain),
    ):
        tiles = TileRunner(inner, plain, "", silent, out=None, memory=MEMORY, devices=None)
        with contextlib.closing(tiles):
            each = TexelRun(inner, plain, FREE, "cauchy", None, tiles)
            run = RobustRun(each.setup, each.known, "cauchy", None, tiles, neighbours=False)

            return _found(views, partial(misfit_through, run), tiles.reader.sample(CALIBRATION_SAMPLE), report_progress)


def _found(
    views: tuple[View, ...], misfit: Misfit, sample: TexelTile, report_progress: ReportProgress
) -> FoundResponse:
    """Return the gamma of the least misfit, and its error by a jackknife over groups of views."""
    tried = []
    for k, gamma in enumerate(GAMMAS):
        report_progress("trying gammas", 0.3 * k / len(GAMMAS))
        tried.append(misfit(sample, gamma))
    k = int(np.clip(np.argmin(tried), 1, len(GAMMAS) - 2))
    bounds = np.log(GAMMAS[[k - 1, k + 1]])
    gamma, least = lowest(misfit, sample, bounds)
    linear = misfit(sample, 1.0)
    clear = min(tried[0], tried[-1]) > CLEAR_RATIO * least and GAMMAS[0] < gamma < GAMMAS[-1]
    left_out = []
    for group in range(GROUPS):
        report_progress("leaving out photographs", 0.5 + 0.5 * group / GROUPS)
        counts = sample.counts & (np.arange(len(views)) % GROUPS != group)[:, None]
        without = eqx.tree_at(lambda tile: tile.counts, sample, counts)
        left_out.append(np.log(lowest(misfit, without, bounds)[0]))
    spread = float(jackknife_error(np.array(left_out)))
    notes = []
    if not clear:
        notes.append(
            Note("the misfit hardly depends on gamma: these photographs do not determine it.", "gamma", ("gamma",))
        )
    gamma = gamma if clear else 1.0
    taken = tuple(dataclasses.replace(view, sensor=Sensor(gamma=gamma)) for view in views)
    # what the model leaves out may be proportional to the logarithm of the brightness, as a change of gamma is
    bias = (GROUPS - 1) * (np.mean(left_out) - np.log(gamma))  # with few photographs noise makes gammas too large
    parts = (spread, bias, least / scatter_of_logarithms(sample))
    error = gamma * float(np.linalg.norm(parts)) if clear else np.inf
    return FoundResponse(gamma, error, taken, least, linear, tuple(notes))


def scatter_of_logarithms(sample: TexelTile) -> float:
    """Return the typical scatter, over the views, of the logarithm of what a texel shows."""
    y = sample.target.mean(1)
    lit = sample.counts & (y > MINOR * y.max(0))
    logarithm = np.where(lit, np.log(np.where(lit, y, 1.0)), np.nan)
    return float(np.nanmedian(np.nanstd(logarithm[:, lit.sum(0) > 1], 0)))


def _check(views: Sequence[View]) -> None:
    if len(views) < MIN_VIEWS:
        raise ValueError(
            f"find_response needs at least {MIN_VIEWS} views; got {len(views)}. Add photographs, or give "
            "View(sensor=Sensor(gamma=...))."
        )
    for i, view in enumerate(views):
        if view.sensor is not None or float(view.black) != 0.0:
            raise ValueError(
                f"find_response takes views without a sensor and with black 0; views[{i}] has "
                f"{'a sensor' if view.sensor is not None else f'black {float(view.black):g}'}. Leave it out."
            )
