"""`convert`: a material from one program to another."""

from __future__ import annotations

from pathlib import Path

import click

from .materials import check_out, put_material, word_of
from .terminal import FILE, SETTINGS, answer, as_json


@click.command(**SETTINGS, epilog="Example: diffshade convert brass.mtl brass.json --name brass")
@click.argument("given", metavar="FROM", type=FILE)
@click.argument("wanted", metavar="TO...", nargs=-1, required=True, type=FILE)
@click.option("--name", metavar="NAME", help="The material to convert, if FROM has several")
@as_json
def convert(given: Path, wanted: tuple[Path, ...], name: str | None, as_json: bool) -> None:
    """Write a material for other programs.

    .mtl Wavefront, .c OpenGL, .json and .js three.js, .py VTK and PyVista, .inc POV-Ray, .gltf glTF 2.0 (only
    written), .toml a diffshade scene.

    The material looks the same there: if that program shades differently, the material is refitted, and the remaining
    error is printed and written to the file.
    """
    import diffshade as ds

    check_out(wanted, [given])
    material = ds.read_material(given, name=name)
    written = [put_material(path, material, name=name or word_of(given)) for path in wanted]
    answer("\n".join(map(str, written)), {"written": written}, as_json=as_json)
