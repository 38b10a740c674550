"""`calibrate` and `find-lights`: the lights of photographs, from a ball in them or from the object itself."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.words import with_names
from .sources import ENCODING, EXIF, INTENSITY_ERROR, LIGHT_ERROR, Encodings, by_name
from .terminal import CIRCLE, FILE, FOLDER, SETTINGS, OneOf, answer, with_json

if TYPE_CHECKING:
    from ..calibration.applying import AppliedLights
    from ..inverse.data.photographs import PhotographFolder
    from ..texels.lights.found import FoundLights

_LOGGER = logging.getLogger("diffshade")
BALLS = ("mirror", "matte", "glossy")


@click.command(**SETTINGS, epilog="Example: diffshade calibrate chrome --ball mirror --apply object -o ready")
@click.argument("photos", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--ball", type=OneOf(BALLS), required=True, help="mirror, matte or glossy")
@click.option("--mask", type=FILE, multiple=True, help="Mask of each ball  [default: the folder's, or found]")
@click.option("--circle", type=CIRCLE, multiple=True, metavar="X,Y,R", help="Or its column, row and radius, pixels")
@ENCODING
@EXIF
@click.option("--camera", type=FILE, help="Scene with the [camera]  [default: far away]")
@click.option("--radius", type=float, default=1.0, help="Radius of the ball, scene units  [default: 1]")
@click.option("--directions", type=FILE, help="Known directions; find only the intensities")
@click.option("--against", type=FILE, help="Compare with these directions")
@click.option("--apply", "thing", type=FOLDER, metavar="FOLDER", help="An object under the same lights, for -o")
@click.option("--apply-mask", "thing_mask", type=FILE, help="Its mask  [default: its folder's, or found]")
@click.option("--apart", type=float, help="Between two balls, units of --radius  [default: as shown, or 4 radii]")
@click.option("--width", type=float, help="Of the object, the same units  [default: as its photos show]")
@click.option("-o", "--out", type=FOLDER, metavar="FOLDER", help="Write photos and lights, for fit, report, texels")
@with_json
def calibrate(
    photos: tuple[Path, ...],
    ball: str,
    mask: tuple[Path, ...],
    circle: tuple[tuple[float, ...], ...],
    srgb: bool | None,
    no_exif: bool,
    camera: Path | None,
    radius: float,
    directions: Path | None,
    against: Path | None,
    thing: Path | None,
    thing_mask: Path | None,
    apart: float | None,
    width: float | None,
    out: Path | None,
) -> None:
    """Find the lights from photographs of a ball: files, or a folder for each."""
    import diffshade as ds

    from ..calibration.result import check_folder, read_directions
    from ..core.extras import check_extra
    from ..core.tables import as_json

    if out is not None or thing is not None:
        check_extra("photographs", "cannot write lights with their picture", "cv2", "matplotlib")
    if out is not None:
        check_folder(out)
    if thing is None and (apart is not None or width is not None):
        raise ValueError("--apart and --width are of two balls and an object beside them. Give --apply FOLDER.")
    if thing is not None and out is None:
        raise ValueError(f"--apply {thing} needs a folder to write. Give -o FOLDER.")
    if mask and circle:
        raise ValueError("--mask and --circle both say where the balls are. Give one of them.")
    balls_and_places = _balls_and_places(photos, mask or circle, beside=thing is not None)
    listed = None if against is None else read_directions(against)
    balls = [
        ds.lights.calibrate(
            path,
            ball=ball,
            **{"circle" if circle else "mask": of},
            camera=None if camera is None else ds.read_camera(camera),
            radius=radius,
            directions=directions,
            srgb=srgb,
            progress=True,
        )
        for path, of in balls_and_places
    ]
    found = balls[0]
    compared = None if listed is None or against is None else found.compare(listed, name=against.name)
    applied = None
    if thing is not None:
        applied = ds.lights.apply_lights(
            balls, thing, mask=thing_mask, srgb=srgb, exif=not no_exif, apart=apart, width=width
        )
    written = []
    if out is not None:
        (found if applied is None else applied).write(out)
        written = [f"{out}: photographs and lights", f"{out / 'lights-shown.png'}: look at the outline"]
        ds.write_figure(out / "lights-shown.png", ds.lights.draw_calibration(balls))
    encodings = _encodings(photos, srgb)
    more = {
        "photographs": found.names,
        "read_as": encodings.names,
        "against": compared and {**as_json(compared), "degrees": compared.angles, "disagrees": compared.disagrees},
        "balls": [{"photographs": one.names, **as_json(one)} for one in balls],
        "applied": applied and _applied_data(applied),
        "folder": out,
    }
    answer([encodings, *balls, compared, applied, *written], found, more)


def _applied_data(applied: AppliedLights) -> dict[str, Any]:
    """Return the lights of an object for JSON."""
    from ..core.tables import as_json

    return {
        "read_as": applied.encodings,
        "photographs": applied.names,
        **applied.lights._asdict(),
        "positions": applied.positions,
        "position_errors": applied.position_errors,
        **as_json(applied),
    }


def _balls_and_places(photos: tuple[Path, ...], places: tuple[Any, ...], *, beside: bool) -> list[tuple[Any, Any]]:
    """Return the photographs of each ball and its mask or circle, or several; `beside`: whether of one object."""
    if len(photos) == 1 or not all(path.is_dir() for path in photos):
        return [
            (photos[0] if len(photos) == 1 else photos, places if len(places) > 1 else places[0] if places else None)
        ]
    if not beside:
        raise ValueError("several folders are balls beside one object. Give its photographs with --apply FOLDER.")
    if len(places) not in (0, len(photos)):
        raise ValueError(
            f"--mask or --circle must be given for each of the {len(photos)} folders, or for none; got {len(places)}."
        )
    return list(zip(photos, places or [None] * len(photos), strict=True))


def _encodings(photos: tuple[Path, ...], srgb: bool | None) -> Encodings:
    """Return how the photographs of files and folders are encoded."""
    from ..inverse.data.folders import list_folder
    from ..io.images import read_as

    folders = [list_folder(path).files if path.is_dir() else [path] for path in photos]
    return Encodings.of([read_as(file, srgb=srgb) for files in folders for file in files], srgb)


@click.command(
    "find-lights", **SETTINGS, epilog="Example: diffshade find-lights photographs --light-error 2 -o refined"
)
@click.argument("photos", metavar="FOLDER", type=FOLDER)
@click.option("--mask", type=FILE, help="Pixels of the object  [default: the folder's]")
@ENCODING
@EXIF
@LIGHT_ERROR
@click.option("--unknown", is_flag=True, help="Find the directions without those of the folder")
@INTENSITY_ERROR
@click.option("--unknown-intensities", is_flag=True, help="The listed intensities may be wrong")
@click.option("-o", "--out", type=FOLDER, metavar="FOLDER", help="Write photos and lights, for texels, fit, report")
@with_json
def find_lights(
    photos: Path,
    mask: Path | None,
    srgb: bool | None,
    no_exif: bool,
    light_error: float | None,
    unknown: bool,
    intensity_error: float | None,
    unknown_intensities: bool,
    out: Path | None,
) -> None:
    """Find the lights from all texels of an object.

    FOLDER: photographs with their lights, which may be wrong.
    """
    import diffshade as ds

    from ..calibration.result import check_folder
    from ..inverse.data.photographs import read_folder

    if out is not None and out.resolve() == photos.resolve():
        raise ValueError(f"-o {out} is the folder of the photographs. Give the name of a new folder.")
    if out is not None:
        check_folder(out)
    read = read_folder(photos, normals=False, lights=not unknown, mask=mask, srgb=srgb, exif=not no_exif)
    names, error = read.names, read.light_errors if light_error is None else light_error
    if error is None and not unknown:
        raise ValueError(
            f"{photos} does not say how exact its directions are. Give --light-error DEGREES, or --unknown to find "
            "them without."
        )
    with by_name(names):
        found = ds.lights.find_lights(
            read.scene,
            read.views,
            light_error=None if unknown else error,
            intensity_error=None if unknown_intensities else intensity_error or 0.0,
            progress=True,
        )
    if out is not None:
        _write_found(out, found, read, photos)
    encodings = Encodings.of(read.read_as, srgb)
    answer(
        [encodings, with_names(f"{found}", names), f"{out}: photographs and lights" if out else None],
        found,
        {"photographs": names, "read_as": encodings.names, "folder": out},
    )


def _write_found(out: Path, found: FoundLights, read: PhotographFolder, photos: Path) -> None:
    """Write the photographs of a folder with the lights that were found."""
    import numpy as np

    from ..inverse.data.folder_lights import write_photographs
    from ..inverse.data.folders import NORMALS

    intensities = np.array([np.broadcast_to(light.intensity, 3) for light in found.scene.lights])  # pyright: ignore[reportAttributeAccessIssue]
    intensities *= [[float(view.exposure)] for view in read.views]  # a folder has no list of exposures
    errors = found.errors if np.isfinite(found.errors).all() else None
    images = (np.asarray(view.image[:], np.float64) for view in read.views)
    inside = np.asarray(found.scene.objects[0].surface.mask)  # pyright: ignore[reportAttributeAccessIssue]
    distances = read.distances if np.isfinite(read.distances).any() else None
    write_photographs(out, read.names, images, inside, found.directions, intensities, errors, distances)
    for name in (name for name in NORMALS if (photos / name).is_file()):
        shutil.copyfile(photos / name, out / name)


@click.command(**SETTINGS, epilog="Example: diffshade mask photographs")
@click.argument("photos", metavar="FOLDER", type=FOLDER)
@click.option("-o", "--out", type=FILE, help="The mask  [default: mask.png in FOLDER]")
@with_json
def mask(photos: Path, out: Path | None) -> None:
    """Find the mask of an object, in several ways that must agree.

    FOLDER: photographs under one light each. Beside the mask, mask-shown.png has its outline and that of each way.
    """
    import diffshade as ds

    from ..core.extras import check_extra
    from ..inverse.data.folders import SHOWN, list_folder
    from ..inverse.data.masks import find_mask
    from ..inverse.data.photograph_files import photograph_files
    from ..report.mask_picture import draw_mask

    check_extra("photographs", "cannot find a mask", "cv2", "matplotlib")
    files = list_folder(photos).files
    out = photos / "mask.png" if out is None else out
    if out.exists():
        raise FileExistsError(f"{out} exists already. Remove it, or give another file with -o.")
    photographs = photograph_files(files, srgb=None)
    for note in photographs.notes:
        _LOGGER.warning("%s: %s", photos, note)
    found = find_mask(photographs.images())
    for note in found.notes:
        _LOGGER.warning("%s: %s", photos, note)
    ds.write_image(out, found.mask[..., None] * 1.0, srgb=False)
    picture = out.with_name(f"mask{SHOWN}.png")
    ds.write_figure(picture, draw_mask(found))
    shares = {name: float(way.mean()) for name, way in found.ways.items()}
    more = {"share": float(found.mask.mean()), "ways": shares, "agreeing": found.agreeing, "notes": found.notes}
    answer(
        [f"{out}: {found}", f"{picture}: look at the outline"],
        {"mask": out, "picture": picture, "agreement": found.agreement, **more},
    )
