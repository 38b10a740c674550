"""`convert`: a material from one program to another, and maps to a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .maps import integrated
from .materials import check_out, put_material, word_of
from .terminal import SETTINGS, answer, as_json

ANY, FILE = (click.Path(path_type=Path, dir_okay=folder) for folder in (True, False))


@click.command(**SETTINGS, epilog="Example: diffshade convert brass.mtl brass.json --name brass")
@click.argument("given", metavar="FROM", type=ANY)
@click.argument("wanted", metavar="TO...", nargs=-1, required=True, type=FILE)
@click.option("--name", metavar="NAME", help="The material to convert, if FROM has several")
@click.option("--tolerance", type=float, help="Of a mesh: merge triangles within so many scene units")
@as_json
def convert(given: Path, wanted: tuple[Path, ...], name: str | None, tolerance: float | None, as_json: bool) -> None:
    """Write a material, or maps as a mesh, for other programs.

    .mtl Wavefront, .c OpenGL, .json and .js three.js, .py VTK and PyVista, .inc POV-Ray, .gltf glTF 2.0 (only
    written), .toml a diffshade scene. From a folder of maps: .glb, .gltf, .obj, .ply.

    It looks the same there: if that program shades differently, the material is refitted, and the remaining error is
    printed and written to the file.
    """
    import diffshade as ds

    if given.is_dir():
        written: list[Any] = _meshes(given, wanted, tolerance)
    else:
        if tolerance is not None:
            raise ValueError(f"--tolerance is for meshes; {given} is no folder of maps. Leave it out.")
        check_out(wanted, [given])
        material = ds.read_material(given, name=name)
        written = [put_material(path, material, name=name or word_of(given)) for path in wanted]
    answer("\n".join(map(str, written)), {"written": written}, as_json=as_json)


def _meshes(folder: Path, wanted: tuple[Path, ...], tolerance: float | None) -> list[Any]:
    """Write the maps of a folder as meshes."""
    import diffshade as ds

    from ..exchange.mesh_files import check_suffix
    from ..io.files import writable

    for path in wanted:
        check_suffix(path)
        writable(path)
    maps = ds.read_maps(folder)
    mesh = ds.height_mesh(integrated(maps), tolerance=tolerance)
    return [ds.write_mesh(path, mesh, maps=maps) for path in wanted]
