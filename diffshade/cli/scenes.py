"""`new`, `render`, `figures`: scenes and pictures of them."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.shell_completion import CompletionItem

from .materials import find_material, put_material
from .pictures import EXPOSED, check_holds_bands, check_picture, put_picture
from .terminal import EXPOSURE, FILE, FOLDER, INDICES, NAMES, SETTINGS, SIZE, OneOf, answer, completions, with_json

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from ..core.progress import ReportProgress


FILL = 0.2  # light from the viewer and ambient light on a mesh, beside the lamp of 1


def _named_materials(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    import diffshade as ds

    return completions((*ds.material_names(), *ds.measured_material_names()), incomplete)


def _figures(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from ..report.lecture import FIGURES

    return completions(FIGURES, incomplete)


@click.command(**SETTINGS, epilog="Example: diffshade new ball.toml --material emerald")
@click.argument("scene", type=FILE)
@click.option(
    "--material",
    metavar="NAME|FILE",
    shell_complete=_named_materials,
    help="emerald, merl_brass ... (shell completion lists them), or a file",
)
@click.option("--force", is_flag=True, help="Overwrite SCENE if it exists")
@with_json
def new(scene: Path, material: str | None, force: bool) -> None:
    """Write a commented scene to start from: a ball under a lamp."""
    import diffshade as ds

    if scene.suffix.lower() != ".toml":
        raise ValueError(f"{scene} has the suffix '{scene.suffix}'; a scene is a TOML file. Use .toml.")
    if scene.exists() and not force:
        raise FileExistsError(f"{scene} exists already. Give another name, or --force to overwrite it.")
    chosen = (
        ds.Material(k_a=0.05, k_d=(0.7, 0.25, 0.2), k_s=0.4, n_s=40) if material is None else find_material(material)
    )
    about = "a ball under a lamp." if material is None else f"a ball of {Path(material).name} under a lamp."
    put_material(scene, chosen, about=about)
    answer([f"{scene}: render it with diffshade render {shlex.quote(str(scene))}"], {"scene": scene})


@click.command(**SETTINGS, epilog="Example: diffshade render ball.toml -o ball.exr --size 640x480 --lit 0")
@click.argument("scene", type=FILE)
@click.option("--material", metavar="NAME|FILE", shell_complete=_named_materials, help="Of a mesh  [default: its own]")
@click.option("-o", "--out", type=FILE, help=".png .jpg .tif .exr .npy .tga  [default: .png]")
@click.option("--size", type=SIZE, metavar="WxH", help="In pixels  [default: the camera's shape]")
@click.option("--lit", type=INDICES, metavar="LIGHTS", help="Lights that are on, as in 0,2  [default: all]")
@click.option(
    "--samples",
    type=click.IntRange(1),
    default=4,
    metavar="N",
    help="N x N rays a pixel; 1 for pictures to be fitted  [default: 4]",
)
@click.option("--exposure", type=EXPOSURE, default=1.0, metavar="X|auto", help=EXPOSED)
@click.option("--srgb/--linear", default=None, help="Write the sRGB curve or not  [default: by file type]")
@click.option("--bits", type=int, help="Bits per sample  [default: 8 in .png, 32 in .exr]")
@with_json
def render(
    scene: Path,
    material: str | None,
    out: Path | None,
    size: tuple[int, int] | None,
    lit: list[int] | None,
    samples: int,
    exposure: float | str,
    srgb: bool | None,
    bits: int | None,
) -> None:
    """Render SCENE (.toml), or a mesh (.obj .ply .glb), to a picture."""
    import dataclasses

    import numpy as np

    import diffshade as ds

    from ..core.progress import showing
    from ..model.rendering import render_once

    out = out or scene.with_suffix(".png")
    check_picture(out, exposure, bits)
    if material is not None and scene.suffix.lower() == ".toml":
        raise ValueError(f"--material is for a mesh; {scene} is a scene, which has its own. Leave it out.")
    with showing("render") as report_progress:
        if scene.suffix.lower() == ".toml":
            world, camera = ds.read_scene(scene), ds.read_camera(scene)
            check_holds_bands(out, len(world.channels))
            if size is not None:
                camera = dataclasses.replace(camera, shape=(size[1], size[0]))
            image = np.asarray(render_once(world, camera, lit, samples), np.float64)
        else:
            image = _of_mesh(scene, material, out, size or (512, 512), lit, samples, report_progress)
    put_picture(out, image, exposure, srgb=srgb, bits=bits)


def _of_mesh(
    mesh: Path,
    material: str | None,
    out: Path,
    size: tuple[int, int],
    lit: list[int] | None,
    samples: int,
    report_progress: ReportProgress,
) -> Float[np.ndarray, "h w 3"]:
    """Return a picture of a mesh in its material, or in those that its faces name, under one light.

    A G-buffer has one point a pixel, so each sample is a picture of its own, by a camera moved within the pixel.
    """
    import dataclasses

    import numpy as np

    import diffshade as ds

    from ..exchange.mesh_objects import objects_seen

    camera = ds.exchange.frame_mesh(mesh, shape=(size[1], size[0]))
    seen = objects_seen(mesh, material, out)
    towards = np.asarray(camera.target) - np.asarray(camera.eye)
    lights = (ds.DirectionalLight((0.5, -1.0, -1.0)), ds.DirectionalLight(towards, FILL))
    image = np.zeros((size[1], size[0], 3))
    for k in range(samples**2):
        report_progress("samples", k / samples**2)
        down, across = (0.5 - (i + 0.5) / samples for i in divmod(k, samples))
        moved = dataclasses.replace(camera, principal_point=(size[0] / 2.0 + across, size[1] / 2.0 + down))
        image += np.asarray(ds.render(ds.Scene(seen(moved), lights, ambient=FILL), moved, lit=lit), np.float64)
    return image / samples**2


@click.command(**SETTINGS, epilog="Example: diffshade figures lecture --only snell,lobes")
@click.argument("folder", type=FOLDER)
@click.option("--only", type=NAMES, metavar="NAMES", shell_complete=_figures, help="Figures to draw  [default: all]")
@click.option("--suffix", type=OneOf((".png", ".svg", ".pdf")), default=".png", help=".png .svg .pdf  [default: .png]")
@click.option("--dark", is_flag=True, help="Light words on a dark page")
@click.option("--scale", type=int, default=1, help="Pixels for each, across, 1 to 4: 2 for a projector  [default: 1]")
@with_json
def figures(folder: Path, only: tuple[str, ...] | None, suffix: str, dark: bool, scale: int) -> None:
    """Write the figures of a lecture to FOLDER."""
    import diffshade as ds

    paths = ds.lecture.write_figures(folder, only=only, suffix=suffix, dark=dark, scale=scale, progress=True)
    answer(paths, {"figures": paths})
