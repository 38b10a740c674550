"""Fitting texels: `fit_texels` takes photographs from one camera to maps of the numbers of the material."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import ArrayLike, Float, Int

from ..core.backend import check_backend, in_float64
from ..core.fields import as_float64
from ..core.progress import showing
from ..core.thresholds import MOST, SMALL
from ..core.words import Note
from ..inverse.data.recording import developed
from ..inverse.data.views import View, lights_on
from ..inverse.fitting import check_scale
from ..io.scene_files import scene_document
from ..model.scenes import Scene
from ..parallel.run_folders import fingerprint
from .checks import check_anything_left, checked, checked_light_error
from .conventions import other_light_convention
from .light_directions import note_on_normals
from .lighting import LightErrors
from .lights.exposures import with_exposures
from .lights.gammas import by_gamma_or_law
from .lights.level import without_level
from .lights.shifts import without_shifts
from .lights.taught import Taught
from .maps import FORMAT, TexelMaps
from .robust.calibration import GROUPS
from .robust.choice import own_exponents_predict_better
from .robust.run import RobustRun
from .robust.turned_lights import note_on_turned_lights
from .run import TexelRun
from .status import DETERMINED, UNDETERMINED
from .tile_runner import TileRunner
from .tiles import LEARNING_SAMPLE, ViewReader

_LOGGER = logging.getLogger("diffshade")
MEMORY = 1 << 28  # bytes of the photographs that are read at once
SHARED = {"k_d", "k_s", "n_s", "normal"}  # what is free where texels may share a highlight
UNUSED = Note(
    "the errors of the lights are not in those of the normals: under lights in one plane, or without one of the "
    "channels, texels do not share a highlight.",
    "light error",
)
A_DEGREE = Note(
    "the directions to the lights are taken to be known to a degree, since nothing else is stated: light_error=, or "
    "--light-error, states it; 0 is right for renders.",
    "light error",
)


class Choices(NamedTuple):
    """What is fitted, and how, by the names of the arguments of `fit_texels`."""

    free: tuple[str, ...]
    loss: str | None
    regions: Int[np.ndarray, " pixels"] | None
    neighbours: bool
    light_error: LightErrors | None
    match_exposures: bool
    align: bool


def fit_texels(
    scene: Scene,
    views: Sequence[View] | View,
    *,
    free: Iterable[str] = ("k_d", "k_s", "n_s"),
    regions: Int[np.ndarray, "h w"] | None = None,
    loss: str | None = None,
    neighbours: bool = True,
    light_error: Float[ArrayLike, " lights"] | float | None = None,
    match_exposures: bool = True,
    align: bool = True,
    out: str | os.PathLike[str] | None = None,
    memory: float | int = MEMORY,
    devices: Mesh | None = None,
    progress: bool = False,
) -> TexelMaps:
    r"""Fit a material to every pixel of views that share a camera: maps of k_d, k_s, n_s and the normal.

    $$ \min \sum \rho(exposure \cdot radiance + black - image) $$

    at each texel, over all views. There are two ways. Where k_d, k_s, n_s and normal are free and `loss` is not
    "squares", both are tried on some texels; the first is taken where it clearly predicts photographs it was not shown
    better. With fewer than six views, lights in one plane, or lamps without one of the channels, each texel is fitted
    by itself.

    Each texel by itself, for renders and whatever obeys the model: the coefficients are solved for exactly and are
    never below 0; log n_s and the normal are found by Levenberg-Marquardt on the cost that the best coefficients leave
    (variable projection; Golub and Pereyra 1973), in float64 whatever the global flag. No start is needed: n_s is
    searched for on a grid, and the normal starts at photometric stereo (Woodham 1980) from the observations of middle
    brightness. A texel gets a highlight where one lowers the cost significantly. Elsewhere its k_s and n_s are 0, with
    infinite errors, and its status says so.

    All texels with one highlight, for photographs of things: its shape, a sum of powers of the cosine, is learned from
    the whole object, and k_s is kept small where no view shows a highlight. The lobe is Blinn's unless the scene's fits
    far better. Every normal of a grid is tried, so that no local minimum traps a texel; shadows and bounced light lose
    their weight by the robust loss; a normal is the geometric median of the 3 x 3 around it, where its own may be as
    far off. That there is a highlight, that observations may be far off, and that the darkest tell little is assumed as
    far as it predicts photographs that are left out better; else the object is matte, and all observations count alike.
    Another law of k_d than Lambert's, for rough surfaces (Oren and Nayar 1994) and those that light enters, is assumed
    where it predicts them clearly better. The errors contain what the model leaves out: they follow from the misfit,
    from the scatter of the neighbours, from fits to parts of the lights, and from other normals that fit nearly as
    well. It computes in float32, whose rounding is thousands of times smaller than those errors.

    Args:
        scene: One opaque object, whose surface says where the texels are, and all lights. The values of free numbers
            are not used.
        views: At least 2, of one camera, with `lit`, exposure, black, noise, mask, saturation and floor as in `fit`. A
            `sensor` is undone first, but for its blur; noise that is known is then left out. An
            observation that the sensor clipped is excluded with all its channels, by the rule of `View.saturation`; of
            an image larger than memory, the largest value is taken in each band that is read.
        free: Names of the numbers to fit, of "k_a", "k_d", "k_s", "n_s" and "normal".
        regions: Region of each pixel, whole numbers from 0; the texels of a region share one n_s, or one shape of the
            highlight, so zeros give all texels one. By default every texel has its own n_s, or the object one shape.
        loss: rho: "squares", or "huber", "cauchy" or "geman-mcclure" against outliers such as shadows; the channels of
            an observation are weighted together. By default squares where each texel is fitted by itself, cauchy where
            all share a highlight.
        neighbours: Whether neighbours may correct a normal, where all texels share a highlight. Then bands of rows are
            read with 5 rows of their neighbours.
        light_error: Standard deviation of the scene's directions to the lights about each axis, degrees: one number, or
            one for each light. The errors of the normals then contain it, and all texels share a highlight; where the
            lights do not allow that, a note says so. Highlights and shadows are assumed where they do more than these
            errors would. A view under several lights has the largest of theirs. By default the errors contain a degree,
            and a note says so, where all texels share a highlight; where each is fitted by itself, the lights are taken
            to be exact.
        match_exposures: Whether photographs that are brighter or darker than their exposures say, or of another colour,
            are matched to each other, where all texels share a highlight and each photograph has a light of its own. It
            is done where twelve photographs or more show it, by 15 % in one of them or 5 % in a colour; a note says so.
            And whether what all photographs show where no light reaches the object, a black level or haze, is taken
            off if the texels then agree better with their model.
        align: Whether photographs that are shifted in the picture, as by a hand, are moved back, where all texels share
            a highlight and each photograph has a light of its own. It is done where eight photographs or more show it,
            by half a pixel and three errors, and where photographs that are left out are then predicted better; a note
            says so. Masks stay where they are.
        out: Folder to which the maps are written as they are found, `NAME.npy` and `NAME_error.npy`, with the scene and
            the camera, so that `read_maps` reads them back. The same call resumes from it, whenever it was stopped. By
            default the maps stay in memory.
        memory: Bytes that the photographs at work may take, approximately; larger ones are read in bands of rows, all
            of which are fitted. A run that is resumed keeps the bands of its first call: to use less memory, begin in a
            new folder.
        devices: A `jax.sharding.Mesh` of the devices that share the work; by default all cores. Several processes,
            joined by `jax.distributed.initialize`, each fit their share and write to one `out`, on a disk of the
            machine they run on.
        progress: Show a line of progress on the terminal.

    Returns:
        The maps, their standard errors, and the status of each texel. Where the lights are described in other axes, or
        listed in another order, than the photographs, a note says so and no texel is determined.

    Raises:
        ValueError: An argument is wrong; the message names the view, pixel or parameter and the remedy.
        TypeError: An argument has the wrong type.
        LostProcess: Another process of the fit was lost.
        RuntimeError: This jaxlib adds up wrongly.
    """
    views = (views,) if isinstance(views, View) else tuple(views)
    check_scale(memory, devices)
    if out is not None and not isinstance(out, str | Path):
        raise TypeError(f"out must be the name of a folder; got {out!r}. Give for example 'run.out'.")
    free = checked(scene, views, free, regions, loss)
    sensor = views[0].sensor
    one_sensor = all(eqx.tree_equal(view.sensor, sensor) for view in views)
    views = tuple(map(developed, views))
    known = None if light_error is None else checked_light_error(light_error, scene, views, free, loss)
    if out is not None:
        scene_document(scene, views[0].camera)  # refuses what could not be written beside the maps
    check_backend()
    scene = jax.tree.map(as_float64, scene)
    region_of = None if regions is None else np.unique(np.asarray(regions), return_inverse=True)[1].reshape(-1)
    with (
        showing("texels", show=progress) as report_progress,
        in_float64((scene, views)) as (scene, views),
    ):
        choices = Choices(free, loss, region_of, neighbours, known, match_exposures, align)
        # a run that an older method began cannot be resumed: the second number counts methods
        problem = "" if out is None else fingerprint(FORMAT, 2, scene, views, *choices)
        tiles = TileRunner(scene, views, problem, report_progress, out=out, memory=memory, devices=devices)
        with contextlib.closing(tiles):
            maps = _fit(scene, views, choices, tiles)
            if sensor is not None and one_sensor:
                maps = dataclasses.replace(maps, sensor=sensor)
            if any(isinstance(note, Note) and note.kind == "cause" for note in maps.notes):
                status = np.where(maps.known, UNDETERMINED, maps.status).astype(np.uint8)
                maps = dataclasses.replace(maps, status=status)
            if tiles.store.folder is not None and tiles.store.first:
                maps.describe(tiles.store.folder)
    return maps


def _fit(scene: Scene, views: Sequence[View], choices: Choices, tiles: TileRunner) -> TexelMaps:
    """Fit each texel by itself, or all with the highlight that they share, where that predicts photographs better."""
    free, loss, regions, neighbours, light_error, match_exposures, align = choices
    each = TexelRun(scene, views, free, loss or "squares", regions, tiles)
    if "normal" not in free:
        return each.maps(None, ())
    lights = each.lights()
    other = other_light_convention(scene, views, tiles.reader, each.typical_sample)
    unsuited = lights.coplanar > MOST or _lacks_a_channel(scene, views)
    unused = UNUSED if unsuited and light_error is not None else None
    notes = tuple(note for note in (note_on_normals(lights), other, unused) if note is not None)
    for text in notes:
        _LOGGER.warning(text)  # before the work begins
    few = len(views) < GROUPS and light_error is None
    if set(free) != SHARED or loss == "squares" or unsuited or few:
        on_highlights = () if other is not None else _note_on_highlights(scene, views, each)
        return each.maps(lights, (*notes, *on_highlights))
    sample = tiles.reader.sample(LEARNING_SAMPLE)
    check_anything_left(np.ones(len(sample.pixels)))
    run = RobustRun(
        each.setup, each.known, loss or "cauchy", regions, tiles, neighbours=neighbours, light_error=light_error
    )
    taught = Taught(scene, views, run, run.learn(sample), sample)
    if other is None:
        taught = without_shifts(taught) if align else taught
        if taught.shifts is not None:
            tiles.reader = ViewReader(scene, taught.views)
        taught = with_exposures(without_level(taught)) if match_exposures else taught
        taught = by_gamma_or_law(taught)
        if not any(note.kind == "disagrees" for note in taught.notes):
            taught = taught.noted(*note_on_turned_lights(taught.run, taught.models, taught.sample))
    if taught.views is not views:
        each = TexelRun(scene, taught.views, free, "squares", regions, tiles)
    notes, run, models, sample = (*notes, *taught.notes), taught.run, taught.models, taught.sample
    may_be_own = light_error is None and taught.exposures is None
    if may_be_own and own_exponents_predict_better(run, models, sample, each.setup.lobe, each.estimates):
        maps = each.maps(lights, notes)
    else:
        maps = run.maps(models, sample, notes if light_error is not None else (*notes, A_DEGREE))
    return dataclasses.replace(maps, exposures=taught.exposures, shifts=taught.shifts, black=taught.level)


def _note_on_highlights(scene: Scene, views: Sequence[View], each: TexelRun) -> tuple[Note, ...]:
    """Say where some texels show highlights that they are not fitted with."""
    free = each.options.free
    if "k_s" in free or "k_d" not in free or np.any(scene.objects[0].material.k_s):
        return ()
    glossy = TexelRun(scene, views, tuple(dict.fromkeys((*free, "k_s", "n_s"))), "squares", None, each.tiles)
    sample = each.typical_sample
    share = np.mean(glossy.estimates(sample).status == DETERMINED) if len(sample.pixels) else 0.0
    if share <= SMALL:
        return ()
    text = (
        f"{share:.0%} of the texels show a highlight, and k_s is 0 and not free: k_d and the normals may be off by "
        "more than their errors. Free k_s and n_s too."
    )
    return (Note(text, "missing highlight", ("k_s", "n_s")),)


def _lacks_a_channel(scene: Scene, views: Sequence[View]) -> bool:
    """Whether a light is on that has nothing of one channel: what is grey cannot be told under it."""
    on = {i for view in views for i in lights_on(scene, view)}
    return any(np.min(getattr(scene.lights[i], "intensity", 1.0)) <= 0.0 for i in on)
