"""`relight`, and `report` of maps: what the maps of `texels` are good for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from .maps import divided
from .pictures import EXPOSED, check_picture, put_picture
from .sources import Options
from .terminal import EXPOSURE, FILE, FOLDER, SETTINGS, TOWARD_LIGHT, answer, with_json

# options that maps do not use
OF_FITS = ("free", "tied", "grey", "bounds", "loss", "noise", "light_error", "intensity_error", "lobe")


@click.command(**SETTINGS, epilog="Example: diffshade relight maps --light 1,1,2 --light=-1,0,1=0.5 -o lit.png")
@click.argument("maps", type=FOLDER)
@click.option(
    "--light",
    "toward",
    type=TOWARD_LIGHT,
    multiple=True,
    help="Direction toward a light at infinity; may be repeated",
)
@click.option("--lights", type=FILE, help="Scene (.toml) whose lights are on")
@click.option("-o", "--out", type=FILE, required=True, help=".png .jpg .tif .exr .npy .tga")
@click.option("--exposure", type=EXPOSURE, default=1.0, metavar="X|auto", help=EXPOSED)
@click.option("--srgb/--linear", default=None, help="Write the sRGB curve or not  [default: by file type]")
@with_json
def relight(
    maps: Path,
    toward: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...],
    lights: Path | None,
    out: Path,
    exposure: float | str,
    srgb: bool | None,
) -> None:
    """Draw the object of MAPS (see texels) under other lights.

    Directions are in scene coordinates: for a folder of photographs x right, y up, z to the camera.
    """
    import diffshade as ds

    from ..core.progress import showing

    check_picture(out, exposure)
    on: list[Any] = [
        ds.DirectionalLight(tuple(-x for x in direction), intensity=intensity) for direction, intensity in toward
    ]
    if lights is not None:
        on += ds.read_scene(lights).lights
    if not on:
        raise ValueError("relight needs a light; got none. Give for example --light 1,1,2, the direction toward it.")
    with showing("relight"):
        image = ds.read_maps(maps).shade(on)
    put_picture(out, image, exposure, srgb=srgb)


def is_maps(source: Path) -> bool:
    """Whether a folder is one of maps, which may be unfinished."""
    return any((source / name).is_file() for name in ("maps.toml", "run.json"))


def report_maps(typed: Options, out: Path, hold_out: int | None, title: str, *, quick: bool, full: bool | None) -> None:
    """Write the page of the maps in a folder, with the folder of their photographs if one is given after it."""
    import diffshade as ds

    plain = Options(typed.source, typed.photos)
    unused = [f"--{name.replace('_', '-')}" for name in OF_FITS if getattr(typed, name) != getattr(plain, name)]
    if unused := unused + ["--quick"] * quick:
        raise ValueError(
            f"{', '.join(unused)} belong to a fit, and maps are not fitted again; got them with the maps "
            f"{typed.source}. Leave them out."
        )
    if len(typed.photos) > 1 or (hold_out is not None and not typed.photos):
        raise ValueError(
            f"maps are reported with the one folder of their photographs, which --hold-out needs; got "
            f"{len(typed.photos)} after {typed.source}. Give for example: report maps photographs --hold-out 4."
        )
    maps = ds.read_maps(typed.source)
    found = replace(typed, source=typed.photos[0], photos=()).read(normals=False) if typed.photos else None
    views, names = ((), ()) if found is None else (found.views, found.names)
    views = tuple(replace(view, sensor=maps.sensor) for view in views)
    seen, left_out = divided(len(views), hold_out)
    ds.write_report(
        out,
        maps,
        views=[views[i] for i in seen],
        held_out=[views[i] for i in left_out],
        titles=[names[i] for i in (*seen, *left_out)],
        title=title,
        full=bool(full),
        embed=full is False,
        progress=True,
    )
    about = {"photographs": [names[i] for i in seen], "left_out": [names[i] for i in left_out], "notes": maps.notes}
    answer([found and found.encodings, maps, f"{out}: open it in a browser"], {**about, "page": out})
