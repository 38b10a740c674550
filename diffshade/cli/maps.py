"""`texels`: a material at every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from ..core.thresholds import MOST
from ..core.words import with_names
from .sources import LIGHT_ERROR, LOSSES, ROOM, VIEWS, Options, Source, by_name, with_options
from .terminal import NAMES, SETTINGS, OneOf, answer, with_json

if TYPE_CHECKING:
    import numpy as np

    import diffshade as ds

    from ..diagnosis.prediction_bands import PredictionBands
    from ..texels.lights.response import FoundResponse

FREE = ("k_d", "k_s", "n_s")
MISPREDICTED = MOST / 2.0  # relative error of predictions that is much: most objects have a tenth
CAUSES = (
    "That is much. Check whether the lights are where they are said to be, whether the files are sRGB or linear, and "
    "whether the camera moved or its exposure changed; of metal and deep things even many photographs leave as much."
)
BANDS = "bands.html"  # the page of the bands, in the folder of the maps


@click.command(**SETTINGS, epilog="Example: diffshade texels photographs -o maps --suffix .png")
@with_options(*VIEWS, ROOM)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    default=Path("maps"),
    metavar="FOLDER",
    help="Results; an interrupted run resumes  [default: maps]",
)
@click.option("--free", type=NAMES, default=(), help="Maps; gamma  [default: k_d,k_s,n_s, maybe normal]")
@click.option("--loss", type=OneOf(LOSSES), help="squares, huber, cauchy, geman-mcclure  [by trial]")
@click.option("--one-n_s", "shared", is_flag=True, help="One n_s for all pixels")
@click.option("--no-neighbours", "alone", is_flag=True, help="No normal is corrected by those around it")
@click.option("--no-exposure", "as_exposed", is_flag=True, help="Exposures, white balance and black level are as told")
@click.option("--no-align", "as_placed", is_flag=True, help="Photographs that are shifted are not moved back")
@LIGHT_ERROR
@click.option("--hold-out", type=int, metavar="N", help="Leave out and predict every N-th photograph")
@click.option("--bands", is_flag=True, help="Bands for those left out, by 8 fits; bands.html")
@click.option("--heights", is_flag=True, help="Integrate the normals: heights and their errors")
@click.option("--suffix", type=OneOf((".exr", ".png")), help="Also write .exr or .png, besides .npy")
@with_json
def texels(
    typed: Options,
    out: Path,
    shared: bool,
    alone: bool,
    as_exposed: bool,
    as_placed: bool,
    hold_out: int | None,
    bands: bool,
    heights: bool,
    suffix: str | None,
) -> None:
    """Find maps: a material a pixel. SOURCE: a folder, or a .toml with PHOTOS."""
    import diffshade as ds

    from ..core.tables import as_json

    _check_extras(heights=heights, suffix=suffix)
    found = typed.read(normals=None)
    free = _free(typed, found, heights=heights)
    if bands and hold_out is None:
        raise ValueError("--bands needs photographs to predict; got no --hold-out. Give for example --hold-out 4.")
    seen, left_out = divided(len(found.views), hold_out)
    names, left_names = ([found.names[i] for i in which] for which in (seen, left_out))
    response = None
    with by_name(tuple(names)):
        if "gamma" in typed.free:
            response = _response(found.scene, [found.views[i] for i in seen])
            sensor = response.views[0].sensor
            found = replace(found, views=tuple(replace(view, sensor=sensor) for view in found.views))
        options: dict[str, Any] = {"neighbours": not alone, "match_exposures": not as_exposed, "align": not as_placed}
        maps, made = _fitted(found, typed, free, seen, out, shared=shared, bands=bands, **options)
    maps = replace(maps, notes=tuple(with_names(note, names) for note in maps.notes))  # as its page names them, too
    maps.describe(out)
    made = None if made is None else replace(made, result=maps)
    held = [found.views[i] for i in left_out]
    relative = maps.relative_errors(held)
    inside, data_of_bands = on_bands(made, held, left_names)
    written = [] if suffix is None else maps.write(out, suffix=suffix)
    if made is not None:
        views, titles = [found.views[i] for i in seen], [*names, *left_names]
        ds.write_report(out / BANDS, made, views=views, held_out=held, titles=titles, progress=True)
        written.append(out / BANDS)
    relief = integrated(maps) if heights else None
    if relief is not None:
        for ending in (".npy",) if suffix is None else (".npy", suffix):
            written += relief.write(out, suffix=ending)
    answer(
        [
            found.encodings,
            maps,
            response,
            relief,
            None if hold_out is None else _on_left_out(relative, left_names),
            inside,
            f"{out}: the maps",
            None if made is None else f"{out / BANDS}: open it in a browser",
        ],
        {
            "photographs": names,
            "left_out": dict(zip(left_names, relative, strict=True)),
            "bands": data_of_bands,
            "read_as": found.encodings.names,
            "gamma": response and {"value": response.gamma, **as_json(response)},
            "folder": out,
            "status": {name: int((maps.status == kind).sum()) for kind, name in enumerate(maps.STATUS)},
            "medians": _medians(maps),
            "notes": maps.notes,
            "heights": relief and {"parts": int(relief.part.max()) + 1, "notes": relief.notes},
            "written": written,
        },
    )


def _check_extras(*, heights: bool, suffix: str | None) -> None:
    """Raise ImportError for what would be missing after a long fit."""
    from ..core.extras import check_extra

    if heights:
        check_extra("photographs", "cannot integrate normals", "pyamg")
    if suffix == ".exr":
        check_extra("exr", "cannot write .exr", "OpenEXR")


def _free(typed: Options, found: Source, *, heights: bool) -> tuple[str, ...]:
    """Return the maps that are fitted: as asked for, or with the normals where the folder has none."""
    import diffshade as ds

    free = tuple(name for name in typed.free if name != "gamma") or (FREE if found.has_normals else (*FREE, "normal"))
    if heights and "normal" not in free and not isinstance(found.scene.objects[0].surface, ds.GBuffer):
        raise ValueError(f"--heights needs a map of normals; got the maps {', '.join(free)}. Add normal to --free.")
    return free


def _medians(maps: ds.TexelMaps) -> dict[str, np.ndarray | None]:
    """Return the median of the trusted texels of each map."""
    import numpy as np

    trusted = {name: value[maps.trusted(name)] for name, value in maps.values.items()}
    return {name: np.median(value, axis=0) if len(value) else None for name, value in trusted.items()}


def _response(scene: ds.Scene, views: list[ds.View]) -> FoundResponse:
    """Return the gamma of photographs, which these must determine."""
    import numpy as np

    import diffshade as ds

    response = ds.lights.find_response(scene, views, progress=True)
    if not np.isfinite(response.error):
        raise ValueError("these photographs do not determine gamma. Leave gamma out of --free.")
    return response


def _fitted(
    found: Source,
    typed: Options,
    free: tuple[str, ...],
    seen: list[int],
    out: Path,
    *,
    shared: bool,
    bands: bool,
    **options: Any,
) -> tuple[ds.TexelMaps, PredictionBands | None]:
    """Return the maps that a command asks for, from the photographs that are `seen`, and the bands."""
    import numpy as np

    import diffshade as ds

    if typed.memory is not None:
        options["memory"] = int(typed.memory * 1e9)
    error: Any = typed.light_error
    if error is None and set(free) == {*FREE, "normal"} and typed.loss != "squares":  # those of the folder can be used
        error = found.light_errors
    views = [found.views[i] for i in seen]
    regions = np.zeros(views[0].camera.shape, int) if shared else None

    def fit_some(some: Sequence[ds.View]) -> ds.TexelMaps:
        kept = out if len(some) == len(views) else None
        more = {"regions": regions, "light_error": error, "out": kept, "progress": True, **options}
        return ds.fit_texels(found.scene, some, free=free, loss=typed.loss, **more)

    if not bands:
        return fit_some(views), None
    made = ds.fit_bands(fit_some, views)
    return cast("ds.TexelMaps", made.result), made


def divided(count: int, hold_out: int | None) -> tuple[list[int], list[int]]:
    """Return the indices of the photographs that are fitted, and of those that are left out."""
    if hold_out is not None and not 2 <= hold_out <= count:
        raise ValueError(
            f"--hold-out must be from 2 to the number of photographs, {count}; got {hold_out}. Give for example 4."
        )
    left_out = [] if hold_out is None else list(range(hold_out - 1, count, hold_out))
    return [i for i in range(count) if i not in left_out], left_out


def _on_left_out(relative: np.ndarray, names: list[str]) -> str:
    """Say how well the photographs that were left out are predicted."""
    import numpy as np

    from ..core.words import count, listing

    dark = [name for name, error in zip(names, relative, strict=True) if np.isnan(error)]
    if len(dark) == len(names):
        return f"left out: {listing(dark)}, which show no light to be predicted"
    worst, typical = int(np.nanargmax(relative)), np.nanmedian(relative)
    said = (
        f"left out: {count(len(names), 'photograph')}, predicted with a relative error of {typical:.1%} in the median, "
        f"{np.nanmean(relative):.1%} in the mean, {relative[worst]:.1%} at most ({names[worst]})"
    )
    return said if typical < MISPREDICTED else f"{said}. {CAUSES}"


def on_bands(
    bands: PredictionBands | None, held: Sequence[ds.View], names: Sequence[str]
) -> tuple[str | None, dict[str, Any] | None]:
    """Return as text and for JSON how many samples of the photographs that were left out lie inside their bands."""
    import numpy as np

    from ..core.tables import as_json
    from ..core.words import count

    if bands is None:
        return None, None
    coverage = bands.coverage(held)
    worst = int(np.nanargmin(coverage))
    said = (
        f"{bands}: they hold {np.nanmean(coverage):.0%} of those of the {count(len(names), 'photograph')} held out, "
        f"{coverage[worst]:.0%} at least ({names[worst]})"
    )
    return said, {**as_json(bands), "inside": dict(zip(names, coverage, strict=True))}


def integrated(maps: ds.TexelMaps) -> ds.heights.HeightMap:
    """Integrate the normals of maps, or the ones that were known."""
    import numpy as np

    import diffshade as ds

    inside = maps.status != maps.STATUS.index("outside")
    if "normal" in maps.values:
        normal, errors = maps.values["normal"], maps.errors["normal"]
    else:
        surface = maps.scene.objects[0].surface
        assert isinstance(surface, ds.GBuffer)
        normal, errors = np.asarray(surface.normal), None
    return ds.heights.integrate_normals(normal, maps.camera, mask=inside, errors=errors, progress=True)
