"""Calibrating: camera, ball and lights from photographs of a ball."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..core.arrays import float64_of
from ..core.fields import check, check_kind
from ..core.progress import showing
from ..model.cameras import AbstractCamera, Camera
from .balls import Ball, find_ball
from .glossy import by_fit
from .matte import by_shading
from .mirror import by_mirrors
from .photographs import Photographs, gather
from .result import Calibration, given_directions

BALLS = ("mirror", "matte", "glossy")


def calibrate(
    photographs: Any,
    *,
    ball: str,
    mask: Any = None,
    circle: Any = None,
    camera: AbstractCamera | None = None,
    radius: float | int | Sequence[float | int] = 1.0,
    directions: Any = None,
    srgb: bool | None = None,
    progress: bool = False,
) -> Calibration:
    """Find a ball in photographs with one light each, and from it the light of each photograph.

    A mirror ball shows each light as a highlight: l = 2 (n.v) n - v. A matte ball is shaded by k_d I max(n.l, 0), or a
    similar law that all photographs share. For a glossy ball, pose, lights and the whole material (k_a, k_d, k_s, n_s)
    are fitted together; see `Calibration.fit`.

    Errors are root mean square, in degrees. For a mirror ball they come from how the highlight's centre depends on the
    threshold, and from the outline, known to .29 pixels at best. For a matte ball they come from the outline, from
    leaving out one of about 32 patches at a time, and from how far other laws of shading turn the light. For a glossy
    ball they are the fit's. A note states the effect of a misplaced mask.

    On two measured balls, directions by shading differed from those by a highlight by 1.6 and 1.8 degrees in the mean.
    Prefer the mirror ball if you have both.

    Args:
        photographs: Photographs by a camera that did not move, linear radiance: a folder (its files in natural order,
            or those in its `filenames.txt`), a file, an array or `LazyImage` (H, W) or (H, W, C), or several of these.
        ball: "mirror" (directions), "matte" (directions and intensities, from one photograph on) or "glossy" (pose,
            lights and material, from one photograph on).
        mask: A file or an array, True on the ball. Several masks are several mirror balls, which together give the
            positions of the lights. By default it is the file with "mask" in its name in the folder, else an alpha
            channel, else the ball is searched for: before a dark background, or a mirror ball by its edge and the
            lights' highlights, for which a picture under room light in the same folder, of another name than the
            photographs, is the best.
        circle: Column, row and radius of the ball in the photographs (pixels, pixel centres at +.5), or of each ball,
            instead of a mask.
        camera: By default a camera far away on +z, with the ball at the origin. With `Camera.from_intrinsics` the
            outline is an ellipse, the ball's place in space is found, and v points to the eye from each of its points.
        radius: The radius of the ball, or of each ball, in scene units; above 0.
        directions: Known directions, for a matte ball, whose intensities alone are then found: (n, 3) towards the
            lights, a text file of them, or the `Calibration` of another ball.
        srgb: Whether to decode files from the sRGB curve, as in `read_image`.
        progress: Show a progress line on the terminal.

    Returns:
        Camera, ball and lights, with errors, and notes on what the photographs do not determine.

    Raises:
        ValueError: If a photograph, mask, circle, radius or direction is unusable, or shows no ball.
        TypeError: If an argument has another type.
        FileNotFoundError: If a file does not exist.
    """
    _check(ball, camera, directions)
    with showing("calibrate", show=progress) as report_progress:
        report_progress("reading the photographs")
        taken = gather(photographs, mask, srgb, mirror=ball == "mirror", circle=circle)
        balls = _balls(taken, ball, camera, radius)
        if ball == "mirror":
            found = by_mirrors(taken, balls, report_progress)
        elif ball == "glossy":
            found = by_fit(taken, balls[0], report_progress)
        else:
            known = None if directions is None else given_directions(directions, taken.names, "directions")
            found = by_shading(taken, balls[0], known, report_progress)
    return dataclasses.replace(found, notes=(*found.notes, *_of_camera(camera)))


def _of_camera(camera: AbstractCamera | None) -> list[str]:
    """Return what was assumed of the camera, or looks wrong with it."""
    if camera is None:
        return [
            "the camera was assumed to be far away. At a distance of 12 ball radii, directions are off by up to 2.5 "
            "degrees, at 25 radii by up to 1.6; the errors do not include this, and a fit puts it into k_a. Give "
            "camera=Camera.from_intrinsics(K, shape=...) if it was nearer."
        ]
    if isinstance(camera, Camera) and camera.principal_point is not None:
        (column, row), (height, width) = np.asarray(camera.principal_point), camera.shape
        if not (0 <= column <= width and 0 <= row <= height):
            return [
                f"the principal point ({column:.4g}, {row:.4g}) lies outside the picture of {width} x {height} pixels: "
                "K seems to be for photographs of another size. Give K for this size."
            ]
    return []


def _check(ball: str, camera: AbstractCamera | None, directions: Any) -> None:
    if ball not in BALLS:
        listed = ", ".join(f"'{choice}'" for choice in BALLS)
        raise ValueError(f"ball must be one of {listed}; got {ball!r}. Give the kind of ball in the photographs.")
    if camera is not None:
        check_kind("camera", camera, AbstractCamera, "Camera.from_intrinsics(K, shape=(480, 640))")
        check(camera)
    if directions is not None and ball != "matte":
        raise ValueError(
            f"directions are for a matte ball, to find the intensities; got ball={ball!r}. Leave them out."
        )


def _balls(taken: Photographs, kind: str, camera: AbstractCamera | None, radius: Any) -> tuple[Ball, ...]:
    """Find the sphere behind every mask."""
    shape = taken.masks[0].shape
    if camera is not None and camera.shape != shape:
        raise ValueError(f"camera.shape must be that of the photographs, {shape}; got {camera.shape}. Resize them.")
    if len(taken.masks) > 1 and (kind != "mirror" or not isinstance(camera, Camera)):
        raise ValueError(
            f"several masks ({len(taken.masks)}) need mirror balls and a camera with known intrinsics, for their "
            f"distances; got ball={kind!r} and {'no camera' if camera is None else type(camera).__name__}. Give one "
            "mask, or camera=Camera.from_intrinsics(K, shape=...)."
        )
    radii = np.ravel(float64_of("radius", radius))
    if not ((radii > 0).all() and np.isfinite(radii).all() and len(radii) in (1, len(taken.masks))):
        raise ValueError(f"radius must be a number above 0, or one per mask; got {radius!r}. Give scene units.")
    radii = np.broadcast_to(radii, len(taken.masks))
    edges = [{"edge": of.points, "apart": of.errors} for of in taken.outlines] or [{}] * len(radii)
    return tuple(
        find_ball(m, camera, float(r), whole=taken.found, **edge)
        for m, r, edge in zip(taken.masks, radii, edges, strict=True)
    )
