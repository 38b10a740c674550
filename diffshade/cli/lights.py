"""`calibrate`: the lights of photographs from a ball in them."""

from __future__ import annotations

from pathlib import Path

import click

from .sources import ENCODING, Encodings
from .terminal import FILE, FOLDER, SETTINGS, OneOf, answer, as_json

BALLS = ("mirror", "matte", "glossy")


@click.command(**SETTINGS, epilog="Example: diffshade calibrate photographs --ball matte -o ready")
@click.argument("photos", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--ball", type=OneOf(BALLS), required=True, help="mirror, matte or glossy")
@click.option("--mask", type=FILE, multiple=True, help="Mask of each ball  [default: the folder's, or found]")
@ENCODING
@click.option("--camera", type=FILE, help="Scene with the [camera]  [default: far away]")
@click.option("--radius", type=float, default=1.0, help="Radius of the ball, scene units  [default: 1]")
@click.option("--directions", type=FILE, help="Known directions; find only the intensities")
@click.option("--against", type=FILE, help="Compare with these directions")
@click.option("-o", "--out", type=FOLDER, metavar="FOLDER", help="Write photos and lights, for fit, report, texels")
@as_json
def calibrate(
    photos: tuple[Path, ...],
    ball: str,
    mask: tuple[Path, ...],
    srgb: bool | None,
    camera: Path | None,
    radius: float,
    directions: Path | None,
    against: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Find the lights from photographs of a ball.

    PHOTOS: a folder or files. Each has one light; the camera does not move.
    """
    import diffshade as ds

    from ..calibration.photographs import in_folder
    from ..calibration.result import check_folder, read_directions

    if out is not None:
        check_folder(out)
    listed = None if against is None else read_directions(against)
    found = ds.calibrate(
        photos[0] if len(photos) == 1 else photos,
        ball=ball,
        mask=mask if len(mask) > 1 else mask[0] if mask else None,
        camera=None if camera is None else ds.read_camera(camera),
        radius=radius,
        directions=directions,
        srgb=srgb,
        progress=True,
    )
    compared = None if listed is None or against is None else found.compare(listed, name=against.name)
    if out is not None:
        found.write(out)
    files = in_folder(photos[0])[0] if len(photos) == 1 and photos[0].is_dir() else photos
    encodings = Encodings.of(files, srgb)
    lines = [
        f"{encodings}",
        f"{found}",
        *([f"{compared}"] if compared else []),
        *([f"{out}: photographs and lights"] if out else []),
    ]
    data = {
        "photographs": found.names,
        "read_as": encodings.names,
        "directions": found.directions,
        "errors": found.errors,
        "intensities": found.intensities,
        "intensity_errors": found.intensity_errors,
        "positions": found.positions,
        "position_errors": found.position_errors,
        "notes": found.notes,
        "against": compared and {"degrees": compared.angles, "disagrees": compared.disagrees},
        "folder": out,
    }
    answer("\n".join(lines), data, as_json=as_json)
