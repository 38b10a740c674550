"""`convert`: a material from one program to another, and maps to a mesh or an RTI folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .maps import integrated
from .materials import check_out, put_material, word_of
from .terminal import SETTINGS, answer, as_json

PATH = click.Path(path_type=Path)


@click.command(**SETTINGS, epilog="Example: diffshade convert brass.mtl brass.json --name brass")
@click.argument("given", metavar="FROM", type=PATH)
@click.argument("wanted", metavar="TO...", nargs=-1, required=True, type=PATH)
@click.option("--name", metavar="NAME", help="The material to convert, if FROM has several")
@click.option("--tolerance", type=float, help="Of a mesh: merge triangles within so many scene units")
@as_json
def convert(given: Path, wanted: tuple[Path, ...], name: str | None, tolerance: float | None, as_json: bool) -> None:
    """Write a material, or maps, for other programs.

    .mtl Wavefront, .c OpenGL, .json and .js three.js, .py VTK and PyVista, .inc POV-Ray, .gltf glTF 2.0 (only
    written), .toml a diffshade scene. From a folder of maps: a mesh as .glb, .gltf,
    .obj, .ply, or (no suffix) a folder for the viewers Relight and OpenLIME.

    It looks the same there: if that program shades differently, the material is refitted, and the remaining error is
    printed and written to the file.
    """
    import diffshade as ds

    if given.is_dir():
        written: list[Any] = _of_maps(given, wanted, tolerance)
    else:
        if tolerance is not None:
            raise ValueError(f"--tolerance is for meshes; {given} is no folder of maps. Leave it out.")
        check_out(wanted, [given])
        material = ds.read_material(given, name=name)
        written = [put_material(path, material, name=name or word_of(given)) for path in wanted]
    answer("\n".join(map(str, written)), {"written": written}, as_json=as_json)


def _of_maps(folder: Path, wanted: tuple[Path, ...], tolerance: float | None) -> list[Any]:
    """Write the maps of a folder as meshes, or as RTI folders where there is no suffix."""
    import diffshade as ds

    from ..exchange.mesh_files import check_suffix
    from ..io.files import writable

    for path in wanted:
        if path.suffix:
            check_suffix(path)
            writable(path)
        elif path.exists():
            raise FileExistsError(f"{path} exists already. Give the name of a new folder.")
    maps = ds.read_maps(folder)
    meshes = any(path.suffix for path in wanted)
    mesh = ds.height_mesh(integrated(maps), tolerance=tolerance) if meshes else None
    return [
        ds.write_rti(path, maps) if mesh is None or not path.suffix else ds.write_mesh(path, mesh, maps=maps)
        for path in wanted
    ]
