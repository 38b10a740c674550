"""The figures of a lecture on illumination: each shows one idea, drawn by the model itself."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from ...core.extras import check_extra
from ...core.progress import showing
from ...core.words import did_you_mean
from ...io.files import replacing
from . import air, diffuse, display, lamps, mirror, rays, specular, transparent, warn, whole

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
    lamps.parallel_faces,
    lamps.radial_attenuation,
    lamps.spot_cone,
    warn.warn_flaps,
    warn.warn_grid,
    whole.colour_of_light,
    whole.materials_and_lights,
    whole.teapot_materials,
    transparent.snell,
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
    folder: str | Path, *, only: Iterable[str] | str | None = None, progress: bool = False
) -> tuple[Path, ...]:
    """Write the figures of a lecture on illumination as PNG: 01_diffuse_over_k_d.png and so on.

    Args:
        folder: The folder to write to; it is created if needed.
        only: Names of figures, without number and suffix; all of them by default.
        progress: Show a progress line on the terminal.

    Returns:
        The paths of the figures.

    Raises:
        ValueError: If a name is unknown; nothing is written then.
        NotADirectoryError: If `folder` is a file.
        TypeError: If an argument has another type.
        ImportError: matplotlib is not installed.
    """
    names = list(FIGURES)
    if not isinstance(folder, str | Path):
        raise TypeError(f"folder must be a path; got {folder!r}. Give the name of a folder.")
    if only is not None and not isinstance(only, Iterable):
        raise TypeError(f"only must hold names of figures; got {only!r}. Give for example {names[0]!r}.")
    wanted = names if only is None else [only] if isinstance(only, str) else list(only)
    for name in wanted:
        _check(name)
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"cannot write figures to {folder}: it is not a folder. Give the name of a folder.")
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with showing("figures", show=progress) as report_progress:
        for i, name in enumerate(names):
            if name in wanted:
                report_progress(name, len(paths) / len(wanted))
                paths.append(folder / f"{i + 1:02}_{name}.png")
                with replacing(paths[-1]) as temporary:
                    draw_figure(name).savefig(temporary)
    return tuple(paths)


def draw_figure(name: str) -> Figure:
    """Draw one of the figures of a lecture; a notebook displays it. Raises ValueError for an unknown name."""
    _check(name)
    return FIGURES[name]()


def _check(name: str) -> None:
    check_extra("figures", "cannot draw the figures of a lecture", "matplotlib")
    if name not in FIGURES:
        raise ValueError(f"no figure is named '{name}'. {did_you_mean(str(name), FIGURES)}")
