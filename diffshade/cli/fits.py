"""`fit`, `report`, `compare`, `plan`: a scene's unknown numbers from photographs, and how far to trust them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .domes import dome, place_of
from .materials import check_out, put_material
from .sources import LOBE, MODEL, ROOM, VIEWS, Asked, Source, asked, by_name, with_lobe
from .terminal import FILE, Names, answer, as_json, asks

if TYPE_CHECKING:
    from ..diagnosis.examination import Examination
    from ..diagnosis.model_choice import ModelChoice
    from ..inverse.result import Fit

MODELS = ("phong", "blinn", "matte")


@click.command(**asks, epilog="Example: diffshade fit ball.toml 0.png 1.png --free k_d,k_s,n_s -o brass.mtl")
@asked(*VIEWS, *MODEL, LOBE, ROOM)
@click.option("-o", "--out", type=FILE, multiple=True, help="Result: .toml, or a material (see convert)")
@click.option(
    "--checkpoint", type=click.Path(path_type=Path), metavar="FOLDER", help="Keep what is found, and go on from there"
)
@as_json
def fit(typed: Asked, out: tuple[Path, ...], checkpoint: Path | None, as_json: bool) -> None:
    """Find numbers and their errors from photographs.

    SOURCE: a scene (.toml), with PHOTOS after it, or a folder of photographs.
    """
    check_out(out, [typed.source, *typed.photos])
    source = typed.read()
    found = typed.fit(source, checkpoint=checkpoint)
    written = [_put(path, found, source, typed.source) for path in out]
    doubt = f"- what is not determined stands in {', '.join(map(str, out))} as one of many values that fit as well."
    said = [
        f"{source.encodings}",
        f"{found}",
        *([doubt] if out and not found.determined.all() else []),
        *map(str, written),
    ]
    answer("\n".join(said), {**_fit_data(found, source), "written": written}, as_json=as_json)


@click.command(**asks, epilog="Example: diffshade report photographs -o ball.html")
@asked(*VIEWS, *MODEL, LOBE)
@click.option("-o", "--out", type=FILE, default=Path("report.html"), help="The page  [default: report.html]")
@click.option("--quick", is_flag=True, help="Without intervals, models and the next photo")
@as_json
def report(typed: Asked, out: Path, quick: bool, as_json: bool) -> None:
    """Fit, and write a page to look at.

    SOURCE: a scene (.toml), with PHOTOS after it, or a folder of photographs.
    """
    import diffshade as ds

    from ..report.page import check_page

    check_page(out)
    source = typed.read()
    found = typed.fit(source)
    more: dict[str, Any] = {}
    if not quick:
        more["examination"] = ds.examine(found, progress=True)
        choice, shots = _models(typed, source, ("phong", "blinn"), found), dome(found)
        more |= {"choice": choice} if choice else {}
        more |= {"plan": ds.plan(found, shots, progress=True)} if shots else {}
    ds.write_report(out, found, titles=[Path(name).name for name in source.names], progress=True, **more)
    data = {**_fit_data(found, source, more.get("examination")), "page": out}
    said = [source.encodings, more.get("examination", found), f"{out}: open it in a browser"]
    answer("\n".join(map(str, said)), data, as_json=as_json)


@click.command(**asks, epilog="Example: diffshade compare photographs --model phong,blinn,matte")
@asked(*VIEWS, *MODEL)
@click.option("--model", type=Names(), default=("phong", "blinn"), help="Also matte  [default: phong,blinn]")
@as_json
def compare(typed: Asked, model: tuple[str, ...], as_json: bool) -> None:
    """Say which model predicts photographs best.

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
    data = {**_photographs(source), "best": choice and choice.best, "choice": choice}
    answer(f"{source.encodings}\n{choice}", data, as_json=as_json)


@click.command(**asks, epilog="Example: diffshade plan ball.toml 0.png 1.png --aim n_s --lights lamps.toml")
@asked(*VIEWS, *MODEL, LOBE)
@click.option("--aim", type=Names(), default=(), help="What to become known  [default: all]")
@click.option("--lights", type=FILE, help="Scene with lights to try  [default: a dome]")
@as_json
def plan(typed: Asked, aim: tuple[str, ...], lights: Path | None, as_json: bool) -> None:
    """Rank the photographs to take next.

    SOURCE: a scene (.toml), with PHOTOS after it, or a folder of photographs.
    """
    import diffshade as ds

    candidates = None if lights is None else ds.read_scene(lights).lights
    source = typed.read()
    found = typed.fit(source)
    shots = dome(found) if candidates is None else [ds.Shot(light=light, name=place_of(light)) for light in candidates]
    if not shots:
        raise ValueError(
            "a dome of lights takes directional or point lights. Give --lights a scene with those you have."
        )
    ranked = ds.plan(found, shots, aim=aim or None, progress=True)
    data = {
        **_photographs(source),
        "order": [ranked.names[i] for i in ranked.order],
        "unknowns": [unknown.name for unknown in ranked.unknowns],
        "now": ranked.now,
        "errors": [ranked.errors[i] for i in ranked.order],
        "gain": [ranked.gain[i] for i in ranked.order],
        "notes": ranked.notes,
    }
    answer(f"{source.encodings}\n{ranked}", data, as_json=as_json)


def _models(typed: Asked, source: Source, names: tuple[str, ...], known: Fit | None = None) -> ModelChoice:
    """Fit each model to the photographs, but for what is fitted already, and compare them."""
    import equinox as eqx
    import numpy as np

    import diffshade as ds

    matte = _without_highlight(typed) if "matte" in names else typed
    fits = {}
    for name in names:
        if name == "matte":
            objects = len(source.scene.objects)
            none = eqx.tree_at(
                lambda s: [item.material.k_s for item in s.objects], source.scene, [np.zeros(3)] * objects
            )
            fits[name] = matte.fit(source, none)
            continue
        scene = with_lobe(source.scene, name)
        same = known is not None and _lobes(known.scene) == _lobes(scene)
        fits[name] = known if known is not None and same else typed.fit(source, scene)
    with by_name(source.names):
        return ds.compare(fits, progress=True)


def _without_highlight(typed: Asked) -> Asked:
    """Return what was typed without k_s and n_s."""

    def glossy(name: str) -> bool:
        return bool({"k_s", "n_s"} & set(name.split(".")))

    for name in typed.free:
        if not glossy(name) and name.split(".")[-1] in ("material", "objects", *map(str, range(100))):
            raise ValueError(
                f"--model matte leaves k_s and n_s out of what is free; got --free {name}. Name them one by one."
            )
    free, tied, grey = (tuple(n for n in names if not glossy(n)) for names in (typed.free, typed.tied, typed.grey))
    if not free:
        raise ValueError(
            f"--model matte has nothing free but k_s and n_s; got --free {','.join(typed.free)}. Free k_d too."
        )
    bounds = tuple(bound for bound in typed.bounds if not glossy(bound[0]))
    return dataclasses.replace(typed, free=free, tied=tied, grey=grey, bounds=bounds)


def _lobes(scene: Any) -> list[type]:
    return [type(item.material.lobe) for item in scene.objects]


def _put(path: Path, found: Fit, source: Source, given: Path) -> Any:
    """Write the fitted scene, or its material, by the file's suffix."""
    import diffshade as ds

    if path.suffix.lower() == ".toml" and source.folder is None:
        ds.write_scene(path, found.scene, camera=found.views[0].camera)
        return path
    written = put_material(path, found.material, about=f"a ball of the material that was fitted to {given}.")
    return f"{written}: a ball of this material, under a lamp of its own" if written == path else written


def _photographs(source: Source) -> dict[str, Any]:
    return {"photographs": source.names, "read_as": source.encodings.names}


def _fit_data(found: Fit, source: Source, examination: Examination | None = None) -> dict[str, Any]:
    """Return what a fit found, and what became of it by an examination."""
    determined = found.determined if examination is None else examination.determined
    errors = found.errors if examination is None else examination.errors
    intervals = [{}] * len(found.unknowns)
    if examination is not None:
        intervals = [
            {"68%": a, "95%": b} for a, b in zip(examination.interval_68, examination.interval_95, strict=True)
        ]
    return {
        **_photographs(source),
        "parameters": [
            {
                "name": unknown.name,
                "value": found.values[j] if determined[j] else None,
                "error": errors[j] if determined[j] else None,
                "plain_error": found.plain_errors[j],
                **intervals[j],
                "determined": bool(determined[j]),
                "at_bound": bool(found.at_bound[j]),
            }
            for j, unknown in enumerate(found.unknowns)
        ],
        "rmse": found.rmse,
        "steps": found.steps,
        "converged": found.converged,
        "condition": found.condition,
        "pixels": found.counts.pixels,
        "samples": found.counts.samples,
        "errors": found.clusters.sentence([u.quantity for u in found.unknowns]),
        "notes": (examination or found).notes,
    }
