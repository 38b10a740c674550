"""Calibrating: photographs of a ball in, camera, ball and lights out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.fields import check, check_kind
from ..core.progress import showing
from ..core.words import listing
from ..model.cameras import AbstractCamera, Camera
from .balls import Ball, find_ball
from .glossy import by_fit
from .matte import by_shading
from .mirror import by_mirrors
from .outcome import Calibration, read_directions
from .photographs import Photographs, gather

Vectors = Float[np.ndarray, "photographs 3"]

BALLS = ("mirror", "matte", "glossy")


def calibrate(
    photographs: Any,
    *,
    ball: str,
    mask: Any = None,
    camera: AbstractCamera | None = None,
    radius: float | int | Sequence[float | int] = 1.0,
    directions: Any = None,
    srgb: bool | None = None,
    progress: bool = False,
) -> Calibration:
    """Find the ball in photographs, each under one light, and the light of each photograph from it.

    `ball`: "mirror", whose highlight is the light's image: l = 2 (n.v) n - v; "matte", whose shading is k_d I max(n.l,
    0), or any law like it that all photographs share: directions and intensities, from one photograph on; "glossy", of
    which pose, light and the whole material (k_a, k_d, k_s, n_s) are fitted together, from one photograph on: the
    result's `fit`. Each says in its `notes` what the photographs cannot tell.

    `photographs`: a folder (in the order that people count in, or of its `filenames.txt`), a file, arrays or lazy
    images of linear radiance, or several of them, from a camera that did not move. `srgb`: as for `read_image`.
    `mask`: a file or an array, True on the ball; by default the file with "mask" in its name in that folder, else an
    alpha channel, else the ball is found where it stands out from a dark background, which a mirror ball does not. Two
    or more masks are so many mirror balls, which together tell where a light is.

    `camera`: with `Camera.from_intrinsics` the outline is an ellipse, the sphere stands where it is seen, and v points
    to the eye from each of its points. Without, the camera is far away on +z and the ball about the origin. `radius`:
    of the ball, or of each, in the scene units wanted. `directions`: (n, 3) towards the lights, a text file of them, or
    the `Calibration` of another ball: then a matte ball tells their intensities alone.

    Errors: root mean square, degrees. Of a mirror, from how the highlight's middle depends on its brightness and from
    the outline, known to .29 pixels at best; of a matte ball, from the outline, by leaving out one of about 32 patches
    of it at a time, and from how far other laws of shading turn the light; of a glossy one, of the fit. What a mask
    that is drawn wrongly would change is in a note. On two measured balls the directions by their shading were 1.6 and
    1.8 degrees off those by a highlight, in the mean; where both can be had, believe the mirror.

    Raises ValueError, TypeError, FileNotFoundError: one sentence and the remedy.
    """
    _check(ball, camera, directions)
    with showing("calibrate", show=progress) as report_progress:
        report_progress("reading the photographs")
        taken = gather(photographs, mask, srgb)
        balls = _balls(taken, ball, camera, radius)
        if ball == "mirror":
            found = by_mirrors(taken, balls, report_progress)
        elif ball == "glossy":
            found = by_fit(taken, balls[0], report_progress)
        else:
            known = None if directions is None else _known(directions, taken.names)
            found = by_shading(taken, balls[0], known, report_progress)
    return dataclasses.replace(found, notes=(*found.notes, *_of_camera(camera)))


def _of_camera(camera: AbstractCamera | None) -> list[str]:
    """Say what was taken for granted of the camera."""
    if camera is None:
        return [
            "the camera was taken to be far away: from 12 radii of the ball directions come out up to 2.5 degrees off, "
            "from 25 up to 1.6, which is not in the errors, and a fit makes k_a of it. Give "
            "camera=Camera.from_intrinsics(K, shape=...) where it was nearer."
        ]
    if isinstance(camera, Camera) and camera.principal_point is not None:
        (column, row), (height, width) = np.asarray(camera.principal_point), camera.shape
        if not (0 <= column <= width and 0 <= row <= height):
            return [
                f"the principal point ({column:.4g}, {row:.4g}) lies outside the picture of {width} x {height} pixels: "
                "K looks like that of photographs of another size. Give it for these."
            ]
    return []


def _check(ball: str, camera: AbstractCamera | None, directions: Any) -> None:
    if ball not in BALLS:
        listed = ", ".join(f"'{choice}'" for choice in BALLS)
        raise ValueError(f"ball must be one of {listed}; got {ball!r}. Give what the ball is like.")
    if camera is not None:
        check_kind("camera", camera, AbstractCamera, "Camera.from_intrinsics(K, shape=(480, 640))")
        check(camera)
    if directions is not None and ball != "matte":
        raise ValueError(
            f"directions are for a matte ball, which then tells the intensities; got ball={ball!r}. Leave them out."
        )


def _balls(taken: Photographs, kind: str, camera: AbstractCamera | None, radius: Any) -> tuple[Ball, ...]:
    """Find the sphere behind every mask."""
    shape = taken.masks[0].shape
    if camera is not None and camera.shape != shape:
        raise ValueError(f"camera.shape must be that of the photographs, {shape}; got {camera.shape}. Resize them.")
    if kind == "mirror" and taken.found:
        raise ValueError(
            "a mirror ball shows the room, not its own outline. Give its mask: mask='mask.png', at the terminal --mask."
        )
    if len(taken.masks) > 1 and (kind != "mirror" or not isinstance(camera, Camera)):
        raise ValueError(
            f"{len(taken.masks)} masks are so many mirror balls seen by a camera whose intrinsics are known, since it "
            f"must be known how far away they are; got ball={kind!r} and "
            f"{'no camera' if camera is None else type(camera).__name__}. Give one mask, or "
            "camera=Camera.from_intrinsics(K, shape=...)."
        )
    try:
        radii = np.ravel(np.asarray(radius, np.float64))
    except (TypeError, ValueError):
        raise TypeError(f"radius must be a number above 0, or one a mask; got {radius!r}. Give scene units.") from None
    if not ((radii > 0).all() and np.isfinite(radii).all() and len(radii) in (1, len(taken.masks))):
        raise ValueError(f"radius must be a number above 0, or one a mask; got {radius!r}. Give scene units.")
    radii = np.broadcast_to(radii, len(taken.masks))
    return tuple(find_ball(m, camera, float(r), whole=taken.found) for m, r in zip(taken.masks, radii, strict=True))


def _known(directions: Any, names: Sequence[str]) -> tuple[Vectors, Float[np.ndarray, " photographs"]]:
    """Return directions that are given, as unit vectors, and their errors in degrees."""
    photographs = len(names)
    errors = directions.errors if isinstance(directions, Calibration) else np.zeros(photographs)
    if isinstance(directions, str | Path):
        directions = read_directions(Path(directions))
    found = np.asarray(directions.directions if isinstance(directions, Calibration) else directions, np.float64)
    if found.shape == (photographs, 3) and not (np.isfinite(found).all() and found.any(-1).all()):
        bad = int(np.flatnonzero(~(np.isfinite(found).all(-1) & found.any(-1)))[0])
        raise ValueError(
            f"directions must be finite and not zero; got {found[bad].tolist()} for photograph {bad}. Give (x, y, z) "
            "towards its light."
        )
    if found.shape != (photographs, 3):
        raise ValueError(
            f"directions must be one vector for each of the {photographs} photographs; got shape {found.shape}. The "
            f"photographs are {listing(names)}: make the two match, (x, y, z) towards each light."
        )
    return found / np.linalg.norm(found, axis=-1, keepdims=True), errors
