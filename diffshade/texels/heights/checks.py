"""Checks: what cannot be integrated is refused, in one sentence with the remedy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...core.arrays import float64_of
from ...core.fields import check, check_kind, refuse_traced
from ...core.masks import as_mask
from ...core.thresholds import DEGREE
from ...model.cameras import AbstractCamera
from .differences import TexelRays, rays_of

MAX_AWAY = 0.2  # share of the known normals that may face away from the camera: more are in another frame
MAX_ERROR = 40.0  # degrees; a normal with a larger error is not known


class Given(NamedTuple):
    """What is integrated."""

    normal: Float[np.ndarray, "h w 3"]
    """Unit normals; towards the camera where they are not known."""
    sigma: Float[np.ndarray, "h w"] | None
    """Standard deviation about each of two axes, radians; `None` if no errors were given."""
    inside: Bool[np.ndarray, "h w"]
    known: Bool[np.ndarray, "h w"]
    away: int
    """Number of normals that face away from the camera, and count as not known."""
    camera: AbstractCamera
    rays: TexelRays
    shared: float
    """Standard deviation of what all normals have in common, radians."""
    assumed: bool
    """Whether that was not given."""


def checked(normals: Any, camera: Any, mask: Any, errors: Any, shared_error: Any) -> Given:
    """Raise ValueError or TypeError for arguments of `integrate_normals` that are wrong; return them as arrays."""
    check_kind("camera", camera, AbstractCamera, "OrthographicCamera((0, 0, 4))")
    refuse_traced("an integration of normals", "Integrate outside.", normals=normals, camera=camera, errors=errors)
    check(camera)
    shape = camera.shape
    normals = float64_of("normals", normals)
    _check_shape("normals", normals, (*shape, 3), "Give one vector a pixel, or the camera of these normals.")
    inside = np.asarray(as_mask(mask)) if mask is not None else (normals != 0).any(-1)
    _check_shape("mask", inside, shape, "Resize it.")
    degrees = None if errors is None else _checked_errors(errors, shape, inside)
    known = inside if degrees is None else inside & (degrees <= MAX_ERROR)
    if not known.any():
        raise ValueError(
            f"no normal is left to integrate: mask has {inside.sum()} texels, of which none has an error of at most "
            f"{MAX_ERROR:g} degrees. Check mask and errors."
        )
    length = np.linalg.norm(normals, axis=-1)
    if (wrong := known & ~(np.abs(length - 1.0) < 1e-2)).any():
        row, column = np.argwhere(wrong)[0]
        raise ValueError(
            f"normals must be unit vectors within the mask; at row {row}, column {column} there is "
            f"{normals[row, column]}. Normalise it, mask it out, or give it an infinite error."
        )
    rays = rays_of(camera)
    toward = rays.toward / np.linalg.norm(rays.toward, axis=-1, keepdims=True)
    normals = np.where(known[..., None], normals / np.where(known, length, 1.0)[..., None], toward)
    away = known & (np.sum(normals * toward, -1) < DEGREE)
    if away.sum() > MAX_AWAY * known.sum():
        row, column = np.argwhere(away)[0]
        raise ValueError(
            f"normals must face the camera; {away.sum()} of {known.sum()} do not, the first {normals[row, column]} at "
            f"row {row}, column {column}. Give them in world coordinates, pointing out of the surface, and the camera "
            "that sees them."
        )
    normals = np.where(away[..., None], toward, normals)
    # the error of a normal is that of both axes
    sigma = None if degrees is None else np.deg2rad(np.where(inside, degrees, 0.0)) / np.sqrt(2.0)
    shared = DEGREE if shared_error is None else _checked_shared(shared_error)
    return Given(normals, sigma, inside, known & ~away, int(away.sum()), camera, rays, shared, shared_error is None)


def _check_shape(name: str, array: np.ndarray, shape: tuple[int, ...], remedy: str) -> None:
    """Raise ValueError for an array that has not the camera's shape."""
    if array.shape != shape:
        raise ValueError(f"{name} must have the camera's shape {shape}; got {array.shape}. {remedy}")


def _checked_shared(shared_error: Any) -> float:
    """Return what all normals have in common, radians."""
    degrees = float64_of("shared_error", shared_error)
    if degrees.shape or not 0.0 <= degrees <= MAX_ERROR:
        raise ValueError(
            f"shared_error must be one number of degrees from 0 to {MAX_ERROR:g}; got {shared_error!r}. Give how well "
            "the directions of the lights are known, for example 1."
        )
    return float(np.deg2rad(degrees))


def _checked_errors(errors: Any, shape: tuple[int, int], inside: np.ndarray) -> Float[np.ndarray, "h w"]:
    """Return the errors as one number a texel."""
    degrees = float64_of("errors", errors)
    degrees = degrees[..., 0] if degrees.shape == (*shape, 1) else degrees
    _check_shape("errors", degrees, shape, "Give one number of degrees a texel.")
    if (wrong := inside & ~(degrees > 0)).any():
        row, column = np.argwhere(wrong)[0]
        raise ValueError(
            f"errors must be above 0 degrees within the mask; got {degrees[row, column]} at row {row}, column "
            f"{column}. Give a standard error, infinite where the normal is not known."
        )
    return degrees
