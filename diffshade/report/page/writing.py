"""Writing: a fit, put together on one HTML page with its images, its uncertainties and a live ball."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.backend import in_float64
from ...core.fields import check_kind
from ...core.progress import showing
from ...diagnosis.examination import Examination
from ...diagnosis.model_choice import ModelChoice
from ...diagnosis.planning import Plan
from ...inverse.data.recording import developed
from ...inverse.result import Fit
from ...io.files import replacing, writable
from . import charts, tables
from .ball import ball_scene, scene_to_render
from .pictures import ball_picture, build_gallery
from .residuals import collect_residuals, curve

HERE = Path(__file__).parent
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
    fit: Fit,
    *,
    examination: Examination | None = None,
    choice: ModelChoice | None = None,
    plan: Plan | None = None,
    titles: Sequence[str] = (),
    progress: bool = False,
) -> None:
    """Write a report of a fit: one HTML file that opens in any browser, offline.

    It shows the fitted material on a live ball, with movable light and parameters; every parameter with its error, and
    what is not determined; photograph, fit and difference of up to 12 views, from the worst fit to the best; the
    residuals over the angles at which a wrong model shows; correlations and convergence. Photographs of more than 800
    pixels are shown smaller.

    Args:
        path: The file, .html or .htm.
        fit: The fit to report.
        examination: The result of `examine(fit)`: adds intervals, profiles and the check of the residuals.
        choice: The result of `compare`: adds the choice of the model.
        plan: The result of `plan(fit, shots)`: adds the next photograph.
        titles: A name for each of the fit's views; by default its index.
        progress: Show a progress line on the terminal.

    Raises:
        ValueError: If the suffix or the number of titles is wrong, or `examination` or `plan` is of another fit.
        TypeError: If an argument has another type.
        FileNotFoundError: If the folder does not exist.
        OSError: If the file cannot be written.
    """
    _check(path, fit, examination, choice, plan, titles)
    names = tuple(titles) or tuple(f"view {i}" for i in range(len(fit.views)))
    with (
        replacing(path) as temporary,
        showing("report", show=progress) as report_progress,
        in_float64(fit) as fit,
    ):
        fit = dataclasses.replace(fit, views=tuple(map(developed, fit.views)))  # the page draws linear light
        residuals = collect_residuals(fit, report_progress)
        which = _spread(residuals.rmse)
        report_progress("drawing")
        gallery = build_gallery(fit, which, names)
        ball, missing = ball_scene(fit, names, gallery.white)
        whole = scene_to_render(fit)
        rms = float(np.sqrt(np.mean(residuals.values**2)))
        curves = (
            ("From the light", "angle between n and l, degrees", curve(residuals, residuals.to_light)),
            ("From the highlight", "angle between v and r, degrees", curve(residuals, residuals.to_mirror, power=2.0)),
        )
        page = _render(
            fit=fit,
            examination=examination,
            notes=fit.notes if examination is None else examination.notes,
            parameters=tables.parameters(fit, examination),
            gallery=gallery,
            shown=len(which),
            ball=ball,
            missing=missing,
            whole=None if whole is None else ball_picture(fit, whole, gallery.white),
            residual_charts=[
                *(charts.over_angle(found, title, label, rms) for title, label, found in curves if found is not None),
                charts.histogram(residuals),
                *([charts.rmse_of_views(residuals, names)] if len(names) > 1 else []),
            ],
            correlations=tables.correlations(fit),
            convergence=charts.convergence(fit),
            profiles=_profiles(examination),
            models=None if choice is None else tables.models(choice),
            best=None if choice is None else choice.best,
            shots=None if plan is None else tables.shots(plan, 0, MOST_SHOTS),
            other_shots=None if plan is None or len(plan.shots) <= MOST_SHOTS else tables.shots(plan, MOST_SHOTS),
        )
        temporary.write_text(page, encoding="utf-8")


def check_page(path: Any) -> None:
    """Refuse, before any work, a path that is not a page or cannot be written."""
    if not isinstance(path, str | Path):
        raise TypeError(f"path must be a path; got {path!r}. Give for example 'fit.html'.")
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{path} has the suffix '{Path(path).suffix}'; a report is an HTML file. Use .html.")
    writable(path)


def _check(path: Any, fit: Any, examination: Any, choice: Any, plan: Any, titles: Sequence[str]) -> None:
    """Refuse arguments of other types, or that belong to another fit."""
    check_page(path)
    check_kind("fit", fit, Fit, "ds.fit(scene, views, free=('k_d',))")
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
    if isinstance(titles, str) or not all(isinstance(title, str) for title in titles):
        raise TypeError(f"titles must hold a string for each view; got {titles!r}. Give for example ['lamp near'].")
    if titles and len(titles) != len(fit.views):
        raise ValueError(
            f"titles must be one for each of the fit's {len(fit.views)} views; got {len(titles)}. Leave them out."
        )


def _same(fit: Fit, other: Fit | Plan) -> bool:
    names = [[u.name for u in of.unknowns] for of in (fit, other)]
    return names[0] == names[1] and np.array_equal(fit.values, other.values)


def _spread(rmse: Float[np.ndarray, " views"]) -> list[int]:
    """Return the views to show, from the worst fit to the best: all of them, or evenly spaced ranks."""
    order = np.argsort(-np.nan_to_num(rmse), kind="stable")
    if len(order) > MOST_VIEWS:
        order = order[np.rint(np.linspace(0, len(order) - 1, MOST_VIEWS)).astype(int)]
    return [int(i) for i in order]


def _profiles(examination: Examination | None) -> list[charts.Chart]:
    """Return the charts of the profiles, those of n_s first."""
    if examination is None:
        return []
    order = sorted(range(len(examination.fit.names)), key=lambda j: examination.fit.unknowns[j].kind != "n_s")
    found = (charts.profile(examination, j) for j in order if examination.fit.determined[j])
    return [chart for chart in found if chart is not None][:MOST_PROFILES]


def _render(**what: Any) -> str:
    """Fill in the template; all values are escaped, and only the page's own scripts and styles may run."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    parts = {name: (HERE / name).read_text(encoding="utf-8") for name in ("page.css", "page.js", "ball.js")}
    environment = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    ball = what.pop("ball")
    emits = any(max(item["material"]["k_e"]) > 0 for item in ball["objects"])
    return environment.get_template("page.html").render(
        **what,
        css=parts["page.css"],
        scripts=[parts["page.js"], parts["ball.js"]],
        shader=shader(ball),
        lobes=["Phong", "Blinn", *(name for name, _ in ball["lobes"])],
        # within a script, only "<" can end the script or start another
        ball=json.dumps(ball, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        ball_views=[view["name"] for view in ball["views"]],
        ball_objects=[item["name"] for item in ball["objects"]],
        sliders=[slider for slider in SLIDERS if slider[0] != "k_e" or emits],
        allowed={name: f"'sha256-{_digest(text)}'" for name, text in parts.items()},
    )


def shader(ball: dict[str, Any]) -> str:
    """Return the live ball's shader, with the highlights of lobes that are not the library's first two."""
    functions = [
        f"vec3 own_{k}(vec3 n, vec3 l, vec3 v, vec3 n_s) {{\n{body}\n}}" for k, (_, body) in enumerate(ball["lobes"])
    ]
    calls = [f"if (lobe == {k + 2}) return own_{k}(n, l, v, n_s);" for k in range(len(functions))]
    text = (HERE / "ball.glsl").read_text(encoding="utf-8")
    return text.replace("// own functions", "\n".join(functions)).replace("// own calls", "\n  ".join(calls))


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
