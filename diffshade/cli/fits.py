"""`fit`, `report`, `compare`, `plan`: fit parameters to photographs, and check the fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from ..core.words import with_names
from .domes import dome, place_of
from .map_uses import is_maps, report_maps
from .maps import divided, on_bands
from .materials import check_out, put_material
from .sources import (
    INTENSITY_ERROR,
    LIGHT_ERROR,
    LOBE,
    MODEL,
    ROOM,
    VIEWS,
    Options,
    Source,
    by_name,
    swap_lobe,
    with_options,
)
from .terminal import FILE, NAMES, SETTINGS, answer, with_json

if TYPE_CHECKING:
    import diffshade as ds

    from ..diagnosis.examination import Examination
    from ..diagnosis.model_choice import ModelChoice
    from ..diagnosis.prediction_bands import PredictionBands

MODELS = ("phong", "blinn", "matte")


@click.command(**SETTINGS, epilog="Example: diffshade fit ball.toml 0.png 1.png --free k_d,k_s,n_s -o brass.mtl")
@with_options(*VIEWS, *MODEL, LIGHT_ERROR, INTENSITY_ERROR, LOBE, ROOM)
@click.option("-o", "--out", type=FILE, multiple=True, help="Result: .toml, or a material (see convert)")
@click.option("--hold-out", type=int, metavar="N", help="Predict every N-th photo by the others, with bands")
@with_json
def fit(typed: Options, out: tuple[Path, ...], hold_out: int | None) -> None:
    """Fit parameters, with errors. SOURCE: a folder, or a .toml with PHOTOS."""
    check_out(out, [typed.source, *typed.photos])
    source, held, found, bands = _fitted(typed, hold_out)
    inside, data_of_bands = on_bands(bands, held.views, held.names)
    written = [_put(path, found, source, typed.source) for path in out]
    files = ", ".join(map(str, out))
    doubt = f"- for each undetermined parameter, {files} holds one of many values that fit equally well."
    answer(
        [
            source.encodings,
            with_names(f"{found}", source.names),
            inside,
            doubt if out and not found.determined.all() else None,
            *written,
        ],
        _fit_data(found, source),
        {"written": written, "bands": data_of_bands},
    )


def _fitted(typed: Options, hold_out: int | None) -> tuple[Source, Source, ds.Fit, PredictionBands | None]:
    """Return what is fitted, what is left out, the fit and, by fits without groups of views as well, its bands."""
    import diffshade as ds

    every = typed.read()
    source, held = (every.only(which) for which in divided(len(every.views), hold_out))
    if hold_out is None:
        return source, held, typed.fit(source), None

    def fit_some(views: Sequence[ds.View]) -> ds.Fit:
        which = [i for i, view in enumerate(source.views) if any(view is other for other in views)]
        return typed.fit(source.only(which))

    bands = ds.fit_bands(fit_some, source.views)
    return source, held, cast("ds.Fit", bands.result), bands


@click.command(**SETTINGS, epilog="Example: diffshade report photographs -o ball.html")
@with_options(*VIEWS, *MODEL, LIGHT_ERROR, INTENSITY_ERROR, LOBE)
@click.option("-o", "--out", type=FILE, default=Path("report.html"), help="HTML file  [default: report.html]")
@click.option("--quick", is_flag=True, help="Skip intervals, model choice and the plan")
@click.option("--hold-out", type=int, metavar="N", help="Predict every N-th photo; of maps: it was left out")
@click.option("--title", help="Of maps: a title  [default: the folder's name]")
@click.option("--full/--embed", default=None, help="Of maps: every number, or picture and dial alone")
@with_json
def report(typed: Options, out: Path, quick: bool, hold_out: int | None, title: str | None, full: bool | None) -> None:
    """Write an HTML page. SOURCE: a folder, or a scene or maps with PHOTOS."""
    import diffshade as ds

    from ..report.page.checks import check_page

    check_page(out)
    if is_maps(typed.source):
        report_maps(typed, out, hold_out, title or typed.source.resolve().name, quick=quick, full=full)
        return
    if title or full is not None:
        raise ValueError(f"--title, --full and --embed are of maps; got one with {typed.source}. Leave it out.")
    source, held, found, bands = _fitted(typed, hold_out)
    more: dict[str, Any] = {}
    if not quick:
        more["examination"] = ds.examine(found, progress=True)
        choice, shots = _models(typed, source, ("phong", "blinn"), found), dome(found)
        more |= {"choice": choice} if choice else {}
        more |= {"plan": ds.plan(found, shots, progress=True)} if shots else {}
    titles = [Path(name).name for name in (*source.names, *held.names)]
    ds.write_report(out, bands or found, held_out=held.views, titles=titles, progress=True, **more)
    inside, data_of_bands = on_bands(bands, held.views, held.names)
    examination = more.get("examination")
    answer(
        [source.encodings, with_names(f"{examination or found}", source.names), inside, f"{out}: open it in a browser"],
        _fit_data(found, source, examination),
        more,
        {"page": out, "bands": data_of_bands},
    )


@click.command(**SETTINGS, epilog="Example: diffshade compare photographs --model phong,blinn,matte")
@with_options(*VIEWS, *MODEL, LIGHT_ERROR, INTENSITY_ERROR)
@click.option("--model", type=NAMES, default=("phong", "blinn"), help="Of phong,blinn,matte  [default: phong,blinn]")
@with_json
def compare(typed: Options, model: tuple[str, ...]) -> None:
    """Choose the model that predicts photographs best.

    SOURCE: a scene (.toml), with PHOTOS after it, or a folder of photographs.
    """
    from ..core.words import did_you_mean

    for name in model:
        if name not in MODELS:
            raise ValueError(f"no model is named '{name}'. {did_you_mean(name, MODELS)}")
    if len(set(model)) < 2:
        raise ValueError(
            f"--model must name two or more; got {', '.join(model) or 'none'}. Give for example phong,matte."
        )
    source = typed.read()
    choice = _models(typed, source, model)
    answer([source.encodings, choice], _photographs(source), {"best": choice.best, "choice": choice})


@click.command(**SETTINGS, epilog="Example: diffshade plan ball.toml 0.png 1.png --aim n_s --lights lamps.toml")
@with_options(*VIEWS, *MODEL, LIGHT_ERROR, INTENSITY_ERROR, LOBE)
@click.option("--aim", type=NAMES, default=(), help="Parameters to improve  [default: all]")
@click.option("--lights", type=FILE, help="Scene with candidate lights  [default: a dome]")
@with_json
def plan(typed: Options, aim: tuple[str, ...], lights: Path | None) -> None:
    """Rank the photographs to take next.

    SOURCE: a scene (.toml), with PHOTOS after it, or a folder of photographs.
    """
    import numpy as np

    import diffshade as ds

    candidates = None if lights is None else ds.read_scene(lights).lights
    source = typed.read()
    found = typed.fit(source)
    shots = dome(found) if candidates is None else [ds.Shot(light=light, name=place_of(light)) for light in candidates]
    if not shots:
        raise ValueError(
            "a dome of lights needs a directional or point light. Give a scene with candidate lights: --lights FILE."
        )
    ranked = ds.plan(found, shots, aim=aim or None, progress=True)
    of_shots = {
        name: np.asarray(getattr(ranked, name))[list(ranked.order)]
        for name in ("names", "errors", "gain", "rank", "clipped")
    }
    unknowns = [unknown.name for unknown in ranked.unknowns]
    data = {**of_shots, "order": of_shots["names"], "unknowns": unknowns}
    answer([source.encodings, ranked], _photographs(source), ranked, data)


def _models(typed: Options, source: Source, names: tuple[str, ...], known: ds.Fit | None = None) -> ModelChoice:
    """Fit each model to the photographs, unless it is the `known` fit, and compare them."""
    import equinox as eqx
    import numpy as np

    import diffshade as ds

    matte = _without_highlight(typed) if "matte" in names else typed
    fits = {}
    for name in names:
        if name == "matte":
            objects = len(source.scene.objects)
            none = eqx.tree_at(
                lambda s: [item.material.k_s for item in s.objects],
                source.scene,
                [np.zeros(len(source.scene.channels))] * objects,
            )
            fits[name] = matte.fit(source, none)
            continue
        scene = swap_lobe(source.scene, name)
        same = known is not None and _lobes(known.scene) == _lobes(scene)
        fits[name] = known if known is not None and same else typed.fit(source, scene)
    with by_name(source.names):
        return ds.compare(fits, progress=True)


def _without_highlight(typed: Options) -> Options:
    """Return the options without k_s and n_s."""
    from ..inverse.unknowns.names import segments_of

    def glossy(name: str) -> bool:
        return bool({"k_s", "n_s"} & set(segments_of(name)))

    for name in typed.free:
        if not glossy(name) and segments_of(name)[-1] in ("material", "objects", *map(str, range(100))):
            raise ValueError(
                f"--model matte removes k_s and n_s from --free; got --free {name}. Name the parameters one by one."
            )
    free, tied, grey = (tuple(n for n in names if not glossy(n)) for names in (typed.free, typed.tied, typed.grey))
    if not free:
        raise ValueError(
            f"--model matte needs a free parameter besides k_s and n_s; got --free {','.join(typed.free)}. Add k_d."
        )
    bounds = tuple(bound for bound in typed.bounds if not glossy(bound[0]))
    return dataclasses.replace(typed, free=free, tied=tied, grey=grey, bounds=bounds)


def _lobes(scene: Any) -> list[type]:
    return [type(item.material.lobe) for item in scene.objects]


def _put(path: Path, found: ds.Fit, source: Source, given: Path) -> Any:
    """Write the fitted scene, or its material, depending on the suffix."""
    import diffshade as ds

    if path.suffix.lower() == ".toml" and source.folder is None:
        ds.write_scene(path, found.scene, camera=found.views[0].camera)
        return path
    written = put_material(path, found.material, about=f"a ball with the material fitted to {given}.")
    return f"{written}: a scene with a ball of this material and a lamp" if written == path else written


def _photographs(source: Source) -> dict[str, Any]:
    return {"photographs": source.names, "read_as": source.encodings.names}


def _fit_data(found: ds.Fit, source: Source, examination: Examination | None = None) -> dict[str, Any]:
    """Return the results of a fit for JSON, or of its examination: a parameter is null where it is not determined."""
    import numpy as np

    from ..core.tables import as_json

    best = found if examination is None else examination
    columns = {
        "name": found.names,
        "value": np.where(best.determined, found.values, np.nan),
        "error": np.where(best.determined, best.errors, np.nan),
        "plain_error": found.plain_errors,
        "determined": best.determined,
        "at_bound": found.at_bound,
    }
    if examination is not None:
        columns |= {"68%": examination.interval_68, "95%": examination.interval_95}
    return {
        **_photographs(source),
        **as_json(found),
        "parameters": [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
        "pixels": found.counts.pixels,
        "samples": found.counts.samples,
        "errors": found.clusters.sentence([unknown.quantity for unknown in found.unknowns]),
        "notes": [with_names(note, source.names) for note in best.notes],
    }
