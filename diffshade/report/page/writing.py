"""Writing: a fit, put together on one HTML page with its images, its uncertainties and a live ball."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.backend import in_float64
from ...core.fields import check_kind
from ...core.progress import showing
from ...core.words import with_names
from ...diagnosis.examination import Examination
from ...diagnosis.model_choice import ModelChoice
from ...diagnosis.planning import Plan
from ...diagnosis.prediction_bands import PredictionBands
from ...inverse.data.recording import developed
from ...inverse.data.views import View
from ...inverse.result import Fit
from ...io.files import replacing
from ...texels.heights.map import HeightMap
from ...texels.maps import TexelMaps
from ..drawn_bands import drawn_bands
from . import charts, tables
from .ball import ball_scene, scene_to_render
from .checks import check_page, check_titles
from .maps.checks import check_maps
from .maps.writing import PageForm, PagePhotographs, write_maps_page
from .pictures import ball_picture, build_gallery, evenly
from .residuals import collect_residuals, curve
from .shaders import shader
from .spectra import errors_of_bands, spectra
from .template import as_script, fill

MOST_VIEWS = 12  # shown as pictures
MOST_PROFILES = 12
MOST_SHOTS = 8  # shown at once, the others on demand
SLIDERS = (
    ("k_a", "Ambient reflection k_a, its largest channel"),
    ("k_d", "Diffuse reflection k_d, its largest channel"),
    ("k_s", "Specular reflection k_s, its largest channel"),
    ("k_e", "Emission k_e, its largest channel"),
    ("n_s", "Specular exponent n_s, a logarithmic slider"),
)


def write_report(
    path: str | Path,
    result: Fit | TexelMaps | PredictionBands,
    *,
    examination: Examination | None = None,
    choice: ModelChoice | None = None,
    plan: Plan | None = None,
    views: Sequence[View] = (),
    held_out: Sequence[View] = (),
    heights: HeightMap | None = None,
    titles: Sequence[str] = (),
    title: str = "",
    full: bool = False,
    embed: bool = False,
    progress: bool = False,
) -> None:
    """Write a report of a fit, or of maps: one HTML file that opens in any browser, offline.

    That of a fit shows the fitted material on a live ball, with movable light and parameters; every parameter with its
    error, and what is not determined; photograph, fit and difference of up to 12 views, from the worst fit to the best;
    the residuals over the angles at which a wrong model shows; correlations and convergence. Photographs of more than
    800 pixels are shown smaller.

    That of maps shows the object under a light that is moved by hand, as `TexelMaps.shade` computes it, or with shadows
    cast by the heights; overlays of normals, status and errors; each photograph beside the same light; photographs
    beside their predictions. Numbers are rounded to steps so that the page is light enough to be sent; it states them,
    and how far its picture is from that of the maps. Maps of more than 4.2 million texels are reduced by means.

    With bands from `fit_bands`, either shows photographs that were left out beside their predictions, and how many of
    their samples lie inside.

    Args:
        path: The file, .html or .htm.
        result: The fit or the maps to report, or `fit_bands` of them.
        examination: Of a fit: the result of `examine(fit)`, which adds intervals, profiles and the check of the
            residuals.
        choice: Of a fit: the result of `compare`, which adds the choice of the model.
        plan: Of a fit: the result of `plan(fit, shots)`, which adds the next photograph.
        views: Of maps: the photographs that they were fitted to.
        held_out: Of maps or bands: photographs by the same camera that were left out, to be predicted.
        heights: Of maps: the heights; by default the integral of their normals, or the scene's surface.
        titles: A name for each of the fit's views, or for each of `views` and then of `held_out`; by default its index.
        title: Of the page of maps; by default how many texels the object has.
        full: Whether the page of maps keeps its numbers as finely as 33 MB allow; about four times as large.
        embed: Whether the page of maps is its picture and the dial of the light alone, for a frame in another page.
        progress: Show a progress line on the terminal.

    Raises:
        ValueError: If the suffix or the number of titles is wrong, or an argument belongs to another result.
        TypeError: If an argument has another type.
        FileNotFoundError: If the folder does not exist.
        OSError: If the file cannot be written.
    """
    bands, result = (result, result.result) if isinstance(result, PredictionBands) else (None, result)
    if bands is not None and not held_out:
        raise ValueError(
            "bands are reported beside photographs; got no held_out. Give views that the fit has not seen."
        )
    of_fit = {"examination": examination, "choice": choice, "plan": plan}
    of_maps = {
        "views": tuple(views) or None,
        "held_out": (tuple(held_out) or None) if bands is None else None,
        "heights": heights,
        "title": title or None,
        "full": full or None,
        "embed": embed or None,
    }
    check_page(path)
    if isinstance(result, TexelMaps):
        _refuse(of_fit, "a Fit", "maps")
        check_maps(result, views, held_out, heights, titles)
        with replacing(path) as temporary, showing("report", show=progress) as report_progress:
            linear, left_out = (tuple(map(developed, of)) for of in (views, held_out))
            photographs = PagePhotographs(linear, left_out, tuple(titles))
            form = PageForm(title, full, embed)
            write_maps_page(temporary, result, photographs, heights, bands, form, report_progress)
        return
    check_kind("result", result, Fit, "ds.fit(scene, views, free=('k_d',)), or maps of ds.fit_texels")
    _refuse(of_maps, "TexelMaps", "a fit")
    _write_fit(path, result, examination, choice, plan, bands, tuple(held_out), titles, progress=progress)


def _refuse(given: Mapping[str, object], of: str, result: str) -> None:
    """Refuse what belongs to a result of another kind."""
    for name, value in given.items():
        if value is not None:
            raise ValueError(f"{name} belongs to a report of {of}; got it with {result}. Leave it out.")


def _write_fit(
    path: str | Path,
    fit: Fit,
    examination: Examination | None,
    choice: ModelChoice | None,
    plan: Plan | None,
    bands: PredictionBands | None,
    held_out: tuple[View, ...],
    titles: Sequence[str],
    *,
    progress: bool,
) -> None:
    """Write the report of a fit."""
    _check(fit, examination, choice, plan)
    number = len(fit.views)
    check_titles(titles, number + len(held_out), "the fit's")
    names = tuple(titles) or tuple(f"view {i}" for i in range(number + len(held_out)))
    seen = [] if bands is None else [bands.predict(view) for view in held_out]
    with (
        replacing(path) as temporary,
        showing("report", show=progress) as report_progress,
        in_float64(fit) as fit,
    ):
        with_sensor = any(view.sensor is not None for view in fit.views)
        fit = dataclasses.replace(
            fit, solved=fit.solved.drawn_as(fit.scene, tuple(map(developed, fit.views)))
        )  # the page draws linear light
        residuals = collect_residuals(fit, report_progress)
        which = _spread(residuals.rmse)
        report_progress("drawing")
        drawn = drawn_bands(fit.scene.bands)
        gallery = build_gallery([fit.predict(fit.views[i]) for i in which], [names[i] for i in which], drawn)
        fit_drawn = dataclasses.replace(fit, solved=fit.solved.drawn_as(drawn.scene(fit.scene), fit.views))
        ball, missing = ball_scene(fit_drawn, names[:number], gallery.white)
        whole = scene_to_render(fit_drawn)
        rms = float(np.sqrt(np.mean(residuals.values**2)))
        curves = (
            ("From the light", "angle between n and l, degrees", curve(residuals, residuals.to_light)),
            ("From the highlight", "angle between v and r, degrees", curve(residuals, residuals.to_mirror, power=2.0)),
        )
        page = _filled(
            fit=fit,
            examination=examination,
            notes=[with_names(note, names) for note in (fit if examination is None else examination).notes],
            parameters=tables.parameters(fit, examination),
            gallery=gallery,
            with_sensor=with_sensor,
            shown=len(which),
            held=build_gallery(seen, names[number:], drawn) if seen else None,
            bands=None if bands is None else tables.bands(bands, seen),
            ball=ball,
            missing=missing,
            whole=None if whole is None else ball_picture(fit, whole, gallery.white),
            drawn=drawn,
            spectra=spectra(fit, examination),
            residual_charts=[
                *(charts.over_angle(found, title, label, rms) for title, label, found in curves if found is not None),
                charts.histogram(residuals),
                *([charts.errors_of_each(residuals.rmse, names[:number])] if number > 1 else []),
                *([errors_of_bands(residuals.rmse_of_bands, fit.scene.bands)] if len(fit.scene.bands) > 1 else []),
            ],
            correlations=tables.correlations(fit),
            convergence=charts.convergence(fit),
            profiles=_profiles(examination),
            models=choice and tables.shown(choice.columns, choice.notes),
            undecided=() if choice is None else choice.undecided,
            shots=plan and tables.shown(plan.columns, plan.notes, slice(MOST_SHOTS + 1)),  # "now" is a row, too
            other_shots=plan and tables.shown(plan.columns, (), slice(MOST_SHOTS + 1, None)),
        )
        temporary.write_text(page, encoding="utf-8")


def _check(fit: Fit, examination: Any, choice: Any, plan: Any) -> None:
    """Refuse arguments of other types, or that belong to another fit."""
    kinds = (
        ("examination", examination, Examination, "ds.examine(fit)"),
        ("choice", choice, ModelChoice, "ds.compare({'Phong': fit_a, 'Blinn': fit_b})"),
        ("plan", plan, Plan, "ds.plan(fit, shots)"),
    )
    for name, value, kind, example in kinds:
        if value is not None:
            check_kind(name, value, kind, example)
    of = [("examination", getattr(examination, "fit", None), "ds.examine(fit)"), ("plan", plan, "ds.plan(fit, shots)")]
    for name, other, example in of:
        if other is not None and not _same(fit, other):
            raise ValueError(f"{name} must belong to the fit that is reported, not to another. Give {example}.")


def _same(fit: Fit, other: Fit | Plan) -> bool:
    names = [[u.name for u in of.unknowns] for of in (fit, other)]
    return names[0] == names[1] and np.array_equal(fit.values, other.values)


def _spread(rmse: Float[np.ndarray, " views"]) -> list[int]:
    """Return the views to show, from the worst fit to the best: all of them, or evenly spaced ranks."""
    order = np.argsort(-np.nan_to_num(rmse), kind="stable")
    return [int(order[i]) for i in evenly(len(order), MOST_VIEWS)]


def _profiles(examination: Examination | None) -> list[charts.Chart]:
    """Return the charts of the profiles, those of n_s first."""
    if examination is None:
        return []
    order = sorted(range(len(examination.fit.names)), key=lambda j: examination.fit.unknowns[j].kind != "n_s")
    found = (charts.profile(examination, j) for j in order if examination.fit.determined[j])
    return [chart for chart in found if chart is not None][:MOST_PROFILES]


def _filled(ball: dict[str, Any], **what: Any) -> str:
    """Fill in the template."""
    emits = any(max(item["material"]["k_e"]) > 0 for item in ball["objects"])
    return fill(
        "page.html",
        ("page.css",),
        ("webgl.js", "page.js", "ball.js"),
        **what,
        shader=shader("ball.glsl", ball["lobes"], ball["laws"]),
        lobes=["Phong", "Blinn", *(name for name, _ in ball["lobes"])],
        ball=as_script(ball),
        ball_views=[view["name"] for view in ball["views"]],
        ball_objects=[item["name"] for item in ball["objects"]],
        sliders=[slider for slider in SLIDERS if slider[0] != "k_e" or emits],
    )
