"""`calibrate` and `find-lights`: the lights of photographs, from a ball in them or from the object itself."""

from __future__ import annotations

import shutil
from pathlib import Path

import click

from .sources import ENCODING, Encodings, by_name, with_names
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


@click.command(
    "find-lights", **SETTINGS, epilog="Example: diffshade find-lights photographs --light-error 2 -o refined"
)
@click.argument("photos", metavar="FOLDER", type=FOLDER)
@click.option("--mask", type=FILE, help="Pixels of the object  [default: mask.png]")
@ENCODING
@click.option("--light-error", type=float, metavar="DEGREES", help="Error of the listed directions  [default: unknown]")
@click.option("--intensity-error", type=float, default=0.0, help="Relative error of the intensities  [default: 0]")
@click.option("--unknown-intensities", is_flag=True, help="The listed intensities may be wrong")
@click.option("-o", "--out", type=FOLDER, metavar="FOLDER", help="Write photos and lights, for texels, fit, report")
@as_json
def find_lights(
    photos: Path,
    mask: Path | None,
    srgb: bool | None,
    light_error: float | None,
    intensity_error: float,
    unknown_intensities: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Find the lights from all texels of an object.

    FOLDER: photographs with their lights, which may be wrong.
    """
    import numpy as np

    import diffshade as ds

    from ..calibration.result import check_folder
    from ..inverse.data.photographs import NORMALS, mask_file, photograph_names, write_lights

    if out is not None:
        check_folder(out)
    names = tuple(photograph_names(photos))
    scene, views = ds.read_photographs(photos, normals=False, mask=mask, srgb=srgb)
    with by_name(names):
        found = ds.find_lights(
            scene,
            views,
            light_error=light_error,
            intensity_error=None if unknown_intensities else intensity_error,
            progress=True,
        )
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        intensities = np.array([np.broadcast_to(light.intensity, 3) for light in found.scene.lights])  # pyright: ignore[reportAttributeAccessIssue]
        write_lights(out, found.directions, intensities)
        shutil.copyfile(mask_file(photos) if mask is None else mask, out / "mask.png")
        for name in (*(name for name in NORMALS if (photos / name).is_file()), *names):
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            copy = shutil.copytree if (photos / name).is_dir() else shutil.copyfile
            copy(photos / name, out / name)
        (out / "filenames.txt").write_text("".join(f"{name}\n" for name in names), encoding="utf-8")
    encodings = Encodings.of((photos / name for name in names), srgb)
    lines = [f"{encodings}", with_names(f"{found}", names), *([f"{out}: photographs and lights"] if out else [])]
    data = {
        "photographs": names,
        "read_as": encodings.names,
        "directions": found.directions,
        "errors": [float(error) if np.isfinite(error) else None for error in found.errors],
        "own_errors": found.own_errors,
        "intensities": found.intensities,
        "intensity_errors": found.intensity_errors,
        "moved": found.moved,
        "misfit": found.misfit,
        "notes": found.notes,
        "folder": out,
    }
    answer("\n".join(lines), data, as_json=as_json)
