"""`convert`: materials from one program to another."""

from __future__ import annotations

from pathlib import Path

import click

from .materials import check_out, put_materials, word_of
from .terminal import FILE, SETTINGS, answer, as_json


@click.command(**SETTINGS, epilog="Example: diffshade convert brass.mtl brass.json --name brass")
@click.argument("given", metavar="FROM", type=FILE)
@click.argument("wanted", metavar="TO...", nargs=-1, required=True, type=FILE)
@click.option("--name", metavar="NAME", help="One material of FROM  [default: all]")
@as_json
def convert(given: Path, wanted: tuple[Path, ...], name: str | None, as_json: bool) -> None:
    """Write materials for other programs.

    .mtl Wavefront, .c OpenGL, .json and .js three.js, .py VTK and PyVista, .inc POV-Ray, .gltf (and .glb, only read)
    glTF 2.0, .toml a diffshade scene. All materials of FROM are written, or the one of --name.

    They look the same there: if that program shades differently, a material is refitted, and the remaining error is
    printed and written to the file.
    """
    import diffshade as ds

    check_out(wanted, [given])
    found = ds.read_materials(given) if name is None else {name: ds.read_material(given, name=name)}
    if list(found) == ["material"]:  # a name that no one gave
        found = {word_of(given): found["material"]}
    written = [put_materials(path, found) for path in wanted]
    lines = [str(one) for one in written]
    if len(found) > 1:
        lines += [f"{path}: {len(found)} materials" for path in wanted]
    answer("\n".join(lines), {"materials": list(found), "written": written}, as_json=as_json)
