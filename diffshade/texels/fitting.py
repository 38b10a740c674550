"""Fitting texels: `fit_texels` takes photographs from one camera to maps of the numbers of the material."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Sequence

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Int

from ..core.backend import check_backend, in_float64
from ..core.fields import as_float64
from ..core.progress import showing
from ..inverse.data.views import View
from ..inverse.fitting import check_scale
from ..model.scenes import Scene
from ..parallel.run_folders import fingerprint
from .checks import checked
from .maps import TexelMaps
from .run import TexelRun
from .tile_runner import TileRunner

MEMORY = 1 << 28


def fit_texels(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Iterable[str] = ("k_d", "k_s", "n_s"),
    regions: Int[np.ndarray, "h w"] | None = None,
    loss: str = "squares",
    out: str | os.PathLike[str] | None = None,
    memory: int = MEMORY,
    mesh: Mesh | None = None,
    progress: bool = False,
) -> TexelMaps:
    r"""Fit a material to every pixel of views that share a camera: maps of k_d, k_s, n_s and the normal.

    $$ \min \sum \rho(exposure \cdot radiance + black - image) $$

    at each texel, over all views. The coefficients are solved for exactly and are never below 0; log n_s and the normal
    are found by Levenberg-Marquardt on the cost that the best coefficients leave (variable projection; Golub and
    Pereyra 1973), in float64 whatever the global flag. No start is needed: n_s is searched for on a grid, and the
    normal starts at photometric stereo (Woodham 1980) from the observations of middle brightness.

    A texel gets a highlight where one lowers the cost significantly. Elsewhere its k_s and n_s are 0, with infinite
    errors, and its status says so.

    Args:
        scene: One opaque object, whose surface says where the texels are, and all lights. The values of free numbers
            are not used.
        views: At least 2, of one camera, with `lit`, exposure, black, noise, mask, saturation and floor as in `fit`. An
            observation that the sensor clipped is excluded with all its channels; without a saturation, a sample of 1
            exactly counts as clipped.
        free: Names of the numbers to fit, of "k_a", "k_d", "k_s", "n_s" and "normal".
        regions: Region of each pixel, whole numbers from 0; the texels of a region share one n_s, so zeros give all
            texels one. By default every texel has its own.
        loss: rho: "squares", or "huber", "cauchy" or "geman-mcclure" against outliers such as shadows; the channels of
            an observation are weighted together.
        out: Folder to which the maps are written as they are found, `NAME.npy` and `NAME_error.npy`. The same call
            resumes from it, whenever it was stopped. By default the maps stay in memory.
        memory: Bytes that the photographs at work may take, approximately; larger ones are read in bands of rows. A run
            that is resumed keeps the bands of its first call: to use less memory, begin in a new folder.
        mesh: Devices that share the work. Several processes, joined by `jax.distributed.initialize`, each fit their
            share and write to one `out`, on a disk of the machine they run on. By default all cores.
        progress: Show a line of progress on the terminal.

    Returns:
        The maps, their standard errors, and the status of each texel.

    Raises:
        ValueError: An argument is wrong; the message names the view, pixel or parameter and the remedy.
        TypeError: An argument has the wrong type.
        LostProcess: Another process of the fit was lost.
        RuntimeError: This jaxlib adds up wrongly.
    """
    views = (views,) if isinstance(views, View) else tuple(views)
    check_scale(memory, out, mesh, "out")
    free = checked(scene, views, free, regions, loss)
    check_backend()
    scene = jax.tree.map(as_float64, scene)
    region_of = None if regions is None else np.unique(np.asarray(regions), return_inverse=True)[1].reshape(-1)
    with (
        showing("texels", show=progress) as report_progress,
        in_float64((scene, views)) as (scene, views),
    ):
        problem = "" if out is None else fingerprint(scene, views, free, region_of, loss)
        tiles = TileRunner(scene, views, problem, report_progress, out=out, memory=memory, mesh=mesh)
        with contextlib.closing(tiles):
            return TexelRun(scene, views, free, loss, region_of, tiles).maps()
