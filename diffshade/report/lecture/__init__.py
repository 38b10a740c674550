"""The figures of a lecture on illumination: each shows one idea, drawn by the model itself."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from ...core.extras import check_extra
from ...core.progress import showing
from ...core.words import did_you_mean, listing
from ..figures import SUFFIXES, write_figure
from . import air, diffuse, display, lamps, mirror, rays, specular, transparent, warn, whole
from .dark import darken
from .pictures import SCALE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DRAWN = (
    diffuse.diffuse_over_k_d,
    diffuse.diffuse_over_theta,
    diffuse.ambient_and_diffuse,
    mirror.mirror_direction,
    specular.lobes,
    specular.cosine_powers,
    specular.specular_over_k_s_and_n_s,
    mirror.ideal_mirror,
    specular.fresnel_weight,
    specular.phong_and_blinn,
    specular.viewers,
    whole.terms,
    rays.rays_of_light,
    lamps.kinds_of_light,
    lamps.attenuation_curves,
    lamps.attenuation_at_most_1,
    lamps.parallel_faces,
    lamps.radial_attenuation,
    lamps.spot_cone,
    warn.warn_flaps,
    warn.warn_grid,
    whole.colour_of_light,
    whole.object_colours,
    whole.materials_and_lights,
    whole.teapot_materials,
    transparent.snell,
    transparent.transmission_vector,
    transparent.glass_sphere,
    transparent.transmission,
    transparent.coloured_glass,
    transparent.three_transparent,
    air.visibility,
    air.depth_cueing,
    display.half_of_white,
)
FIGURES = {draw.__name__: draw for draw in _DRAWN}


def write_figures(
    folder: str | Path,
    *,
    only: Iterable[str] | str | None = None,
    suffix: str = ".png",
    dark: bool = False,
    scale: int = 1,
    progress: bool = False,
) -> tuple[Path, ...]:
    """Write the figures of a lecture on illumination: 01_diffuse_over_k_d.png and so on.

    Args:
        folder: The folder to write to; it is created if needed.
        only: Names of figures, without number and suffix; all of them by default.
        suffix: ".png", ".svg" or ".pdf"; ".png" by default. Words and curves of the latter two stay sharp at any size.
        dark: Light words on a dark page; by default dark ones on white. The pictures are the same.
        scale: Pixels in place of each, across, 1 to 4; 1 by default, 120 an inch. 2 is for a projector.
        progress: Show a progress line on the terminal.

    Returns:
        The paths of the figures.

    Raises:
        ValueError: If a name or a suffix is unknown, or the scale is none of 1 to 4; nothing is written then.
        NotADirectoryError: If `folder` is a file.
        TypeError: If an argument has another type.
        ImportError: matplotlib is not installed.
    """
    names = list(FIGURES)
    if not isinstance(folder, str | Path):
        raise TypeError(f"folder must be a path; got {folder!r}. Give the name of a folder.")
    if only is not None and not isinstance(only, Iterable):
        raise TypeError(f"only must hold names of figures; got {only!r}. Give for example {names[0]!r}.")
    if suffix not in SUFFIXES:
        raise ValueError(f"figures are written as {listing(SUFFIXES)}; got {suffix!r}. Give one of them.")
    wanted = names if only is None else [only] if isinstance(only, str) else list(only)
    for name in wanted:
        _check(name, scale)
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"cannot write figures to {folder}: it is not a folder. Give the name of a folder.")
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with showing("figures", show=progress) as report_progress:
        for i, name in enumerate(names):
            if name in wanted:
                report_progress(name, len(paths) / len(wanted))
                paths.append(folder / f"{i + 1:02}_{name}{suffix}")
                write_figure(paths[-1], draw_figure(name, dark=dark, scale=scale))
    return tuple(paths)


def draw_figure(name: str, *, dark: bool = False, scale: int = 1) -> Figure:
    """Draw one of the figures of a lecture on illumination; a notebook shows what is returned.

    Args:
        name: The name of the figure, such as "snell".
        dark: Light words on a dark page; by default dark ones on white. The picture is the same.
        scale: Pixels in place of each, across, 1 to 4; 1 by default, 120 an inch.

    Returns:
        The figure, Matplotlib's; `write_figure` writes it.

    Raises:
        ValueError: If the name is unknown, or the scale is none of 1 to 4.
    """
    _check(name, scale)
    token = SCALE.set(scale)
    try:
        figure = FIGURES[name]()
    finally:
        SCALE.reset(token)
    return darken(figure) if dark else figure


def _check(name: str, scale: int) -> None:
    check_extra("figures", "cannot draw the figures of a lecture", "matplotlib")
    if name not in FIGURES:
        raise ValueError(f"no figure is named '{name}'. {did_you_mean(str(name), FIGURES)}")
    if scale not in (1, 2, 3, 4):
        raise ValueError(f"scale must be 1, 2, 3 or 4; got {scale!r}. Give 2 for a projector.")
