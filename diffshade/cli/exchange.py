"""`convert` and `lamp`: materials and maps for other programs, and what a lamp file holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .maps import integrated
from .materials import check_out, put_materials, word_of
from .terminal import FILE, SETTINGS, OneOf, answer, with_json

PATH = click.Path(path_type=Path)


@click.command(**SETTINGS, epilog="Example: diffshade convert brass.mtl brass.json --name brass")
@click.argument("given", metavar="FROM", type=PATH)
@click.argument("wanted", metavar="TO...", nargs=-1, required=True, type=PATH)
@click.option("--name", metavar="NAME", help="One material of FROM  [default: all]")
@click.option("--tolerance", type=float, help="Of a mesh: merge triangles within so many scene units")
@click.option("--watertight", is_flag=True, help="Of a mesh: close it by a flat back, to print it")
@click.option("--brighten", is_flag=True, help="Of a mesh: k_d and k_s times what makes the brightest k_d 1")
@with_json
def convert(
    given: Path,
    wanted: tuple[Path, ...],
    name: str | None,
    tolerance: float | None,
    watertight: bool,
    brighten: bool,
) -> None:
    """Write materials, or maps, for other programs.

    FROM is .mtl Wavefront, .gltf or .glb glTF 2.0, .json three.js or .toml a diffshade scene; TO is .mtl, .gltf, .json,
    .toml, or code: .c OpenGL, .js three.js, .py VTK and PyVista, .inc POV-Ray. All materials of FROM are written, or
    the one of --name, with the pictures of their base colours (.mtl, .gltf, .json). From a folder of maps: a mesh as
    .glb, .gltf, .json (three.js), .obj, .ply; what viewers show under any light as .ptm (RTIViewer) or, without a
    suffix, a folder (Relight, OpenLIME).

    They look the same there: if that program shades differently, a material is refitted, and the remaining error is
    printed and written to the file.
    """
    if given.is_dir():
        if name is not None:
            raise ValueError(f"--name is for files of materials; {given} is a folder of maps. Leave it out.")
        written: list[Any] = _of_maps(given, wanted, tolerance, watertight=watertight, brighten=brighten)
        answer(written, {"written": written})
        return
    for option, value in (("tolerance", tolerance is not None), ("watertight", watertight), ("brighten", brighten)):
        if value:
            raise ValueError(f"--{option} is for meshes; {given} is no folder of maps. Leave it out.")
    found, written = _of_materials(given, wanted, name)
    several = [f"{path}: {len(found)} materials" for path in wanted if len(found) > 1]
    answer([*written, *several], {"materials": list(found), "written": written})


def _of_materials(given: Path, wanted: tuple[Path, ...], name: str | None) -> tuple[dict[str, Any], list[Any]]:
    """Write the materials of a file, or the one of a name; return them, and what was written."""
    from ..exchange.material_files import read_textured

    check_out(wanted, [given])
    found, bases = read_textured(given, name)
    if list(found) == ["material"]:  # a name that no one gave
        found, bases = {word_of(given): found["material"]}, {word_of(given): base for base in bases.values()}
    return found, [put_materials(path, found, bases) for path in wanted]


def _of_maps(
    folder: Path, wanted: tuple[Path, ...], tolerance: float | None, *, watertight: bool, brighten: bool
) -> list[Any]:
    """Write the maps of a folder as meshes, as `.ptm`, or as RTI folders where there is no suffix."""
    import diffshade as ds

    from ..core.progress import showing
    from ..exchange.mesh_files import check_suffix
    from ..io.files import writable

    for path in wanted:
        if path.suffix:
            if path.suffix.lower() != ".ptm":
                check_suffix(path)
            writable(path)
        elif path.exists():
            raise FileExistsError(f"{path} exists already. Give the name of a new folder.")
    maps, written = ds.read_maps(folder), []
    meshes = [path for path in wanted if path.suffix.lower() not in ("", ".ptm")]
    heights = integrated(maps) if meshes else None
    with showing("convert") as report_progress:
        report_progress("finding the mesh")
        mesh = None if heights is None else ds.heights.height_mesh(heights, tolerance=tolerance, watertight=watertight)
        for path in wanted:
            report_progress(f"writing {path.name}")
            if mesh is None or path not in meshes:
                written.append(ds.exchange.write_rti(path, maps))
            else:
                written.append(ds.exchange.write_mesh(path, mesh, maps=maps, brighten=brighten))
    return written


@click.command(**SETTINGS, epilog="Example: diffshade lamp floodlight.ies --distance 5")
@click.argument("file", type=FILE)
@click.option("-o", "--out", type=FILE, help=".png, .pdf or .svg  [default: the file's name, .png]")
@click.option(
    "--distance",
    type=float,
    default=3.0,
    help="Of a plane, metres; below 0: behind the lamp, as a ceiling  [default: 3]",
)
@click.option("--lamp-set", type=OneOf(("0", "1", "2", "3", "all")), help="The lit lamps of an LDT  [default: 0]")
@click.option("--tilt", type=FILE, help="The file that TILT names in an IES file")
@with_json
def lamp(file: Path, out: Path | None, distance: float, lamp_set: str | None, tilt: Path | None) -> None:
    """Show a lamp (.ies or .ldt): flux, beam and light on a plane.

    The picture has a polar diagram of the intensity, and the lux on a plane across the lamp's axis.
    """
    import diffshade as ds

    from ..io.files import writable
    from ..report.figures import check_figure
    from ..report.lamp_picture import light_on_plane, unit_of_light

    out = out or file.with_suffix(".png")
    check_figure(out)
    writable(out)
    chosen = "all" if lamp_set == "all" else None if lamp_set is None else int(lamp_set)
    found = ds.lamps.read_lamp(file, lamp_set=chosen, tilt=tilt)
    plane = light_on_plane(found, distance, 5)
    ds.write_figure(out, ds.lamps.draw_lamp(found, distance=distance))
    unit = unit_of_light(found.label.unit)
    table = [("C90", plane.across), *zip(plane.across[::-1], plane.light, strict=True)]  # from the side of C90 on
    rows = [f"{at:>7.4}" + "".join(f"{value:10.4g}" for value in row) for at, row in table]
    lines = [
        found,
        f"{unit} on a plane at {distance:g}, over the places along C0 (to the right) and C90 (up):",
        *rows,
        out,
    ]
    data = {
        "summary": str(found).splitlines(),
        "label": found.label,
        "distance": distance,
        "across": plane.across,
        "light": plane.light,
        "picture": out,
    }
    answer(lines, data)
