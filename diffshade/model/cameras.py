"""Cameras: from a pixel to its ray, and from a point to its viewer (E8). Right-handed, y up, looking along -z."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..core.backend import in_float64, jit_quickly
from ..core.fields import (
    Array,
    Checked,
    Numbers,
    Pair,
    Scalar,
    Vector,
    as_array,
    as_pair,
    as_scalar,
    as_vector,
    in_short,
    is_concrete,
)
from .vectors import Vec3, along_one_line, cross, dot, length, normalize, where


class Rays(eqx.Module):
    """Rays origin + t direction, t > 0, with unit directions; components of one shape."""

    origin: Vec3
    direction: Vec3


class Projection(eqx.Module):
    """A camera as numbers: the ray of a pixel is affine in its column and row, for every kind of camera alike.

    Cameras of all kinds thus stack into one array, and one compiled program serves them.
    """

    origin: Vec3
    origin_column: Vec3
    origin_row: Vec3
    direction: Vec3
    direction_column: Vec3
    direction_row: Vec3
    eye: Vec3
    backward: Vec3
    local_viewer: Float[Array, "..."]
    parallel: Float[Array, "..."]
    """1 where all rays have one direction, 0 where they begin at the eye."""

    def rays(self, row: Float[Array, "..."], column: Float[Array, "..."]) -> Rays:
        """Return the rays through the centres of pixels, which lie at +.5."""
        column, row = column + 0.5, row + 0.5
        zero = jnp.zeros_like(row)
        origin = self.origin + self.origin_column * column + self.origin_row * row
        direction = self.direction + self.direction_column * column + self.direction_row * row
        return Rays(origin + Vec3(zero, zero, zero), normalize(direction + Vec3(zero, zero, zero)))

    def viewer(self, p: Vec3 | None) -> Vec3:
        """Return v at p: towards the eye with a local viewer, else the camera's backward axis everywhere (E8)."""
        if p is None:
            return self.backward
        return where(self.local_viewer > 0, normalize(self.eye - p), self.backward)

    def depth(self, p: Vec3, *, radial: bool) -> Float[Array, "..."]:
        """Return how far p is from the eye along the view axis or, where `radial` is true, along the ray.

        Parallel rays begin on the plane through the eye, so that along them p is as far as along the axis.
        """
        along_axis = -dot(p - self.eye, self.backward)
        return jnp.where(self.parallel > 0, along_axis, length(p - self.eye)) if radial else along_axis


class AbstractCamera(Checked):
    """The position and projection of a camera. `shape` is (height, width) in pixels; row 0 is on top."""

    eye: eqx.AbstractVar[Vector]
    target: eqx.AbstractVar[Vector]
    up: eqx.AbstractVar[Vector]
    shape: eqx.AbstractVar[tuple[int, int]]
    local_viewer: eqx.AbstractVar[bool]

    def check_together(self) -> None:
        name, shape = type(self).__name__, self.shape
        if not (isinstance(shape, tuple) and len(shape) == 2 and all(isinstance(s, int) and s > 0 for s in shape)):
            raise ValueError(
                f"{name}.shape must be (height, width) in pixels, two whole numbers above 0; got {shape!r}. "
                "Give the image's shape[:2]."
            )
        if not is_concrete(self.eye, self.target, self.up):
            return
        sight = np.asarray(self.target, np.float64) - np.asarray(self.eye, np.float64)
        if not np.any(sight):
            raise ValueError(f"{name}.eye must differ from target; got {self.eye} for both. Move one of them.")
        if along_one_line(sight, self.up):
            raise ValueError(
                f"{name}.up must not be along the line of sight; got up {self.up} for an eye at {self.eye} that looks "
                f"at {self.target}. Give another up, for example (0, 0, -1)."
            )

    @abc.abstractmethod
    def projection(self) -> Projection:
        """Return the camera's rays as affine functions of column and row.

        Returns:
            The projection, which has the same structure for every kind of camera.
        """


def as_shape(value: Sequence[int]) -> Any:
    """Make (height, width); a value that is not two whole numbers is returned unchanged for the check to refuse."""
    try:
        height, width = value
        return (int(height), int(width)) if (height, width) == (int(height), int(width)) else value
    except (TypeError, ValueError, OverflowError):
        return value


class Camera(AbstractCamera):
    r"""A perspective (pinhole) camera at `eye`, looking at `target`.

    The ray of the pixel in row i, column j of an image of H by W pixels has the direction

    $$ forward + 2 \tan(fov/2) [aspect (j + 1/2 - c_x) \, right + (c_y - i - 1/2) \, up] / H $$

    `Camera.from_intrinsics` makes a calibrated camera; its `fov` is 2 atan(H / (2 f_y)), wherever the principal point
    is.

    Args:
        eye: Position of the camera, scene units.
        target: Point that the camera looks at, scene units, different from `eye`; the origin by default.
        up: Upward direction, not along the line of sight; (0, 1, 0) by default.
        fov: Full vertical angle, degrees, above 0 and below 180; 40 by default.
        shape: (height, width) in pixels, whole numbers above 0; (256, 256) by default.
        local_viewer: With True, the default, v points from each point to `eye`; with False, v is the backward axis
            everywhere (E8).
        principal_point: (c_x, c_y), where the line of sight meets the image: column and row in pixels, with pixel
            centres at +.5; the middle of the image by default.
        aspect: Width of a pixel divided by its height, above 0; 1 by default.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range, `eye` equals `target`, or `up` is
            along the line of sight.
        TypeError: A value is not a number, pair or vector of numbers.
    """

    eye: Vector = eqx.field(converter=as_vector)
    target: Vector = eqx.field(kw_only=True, converter=as_vector, default=(0.0, 0.0, 0.0))
    up: Vector = eqx.field(kw_only=True, converter=as_vector, default=(0.0, 1.0, 0.0))
    fov: Scalar = eqx.field(kw_only=True, converter=as_scalar, default=40.0, metadata={"above": 0, "below": 180})
    shape: tuple[int, int] = eqx.field(kw_only=True, converter=as_shape, static=True, default=(256, 256))
    local_viewer: bool = eqx.field(kw_only=True, static=True, default=True)
    principal_point: Pair | None = eqx.field(kw_only=True, converter=as_pair, default=None)
    aspect: Scalar | None = eqx.field(kw_only=True, converter=as_scalar, default=None, metadata={"above": 0})

    @classmethod
    def from_intrinsics(
        cls,
        K: Numbers,
        *,
        shape: Sequence[int],
        eye: Numbers = (0.0, 0.0, 0.0),
        target: Numbers = (0.0, 0.0, -1.0),
        up: Numbers = (0.0, 1.0, 0.0),
        local_viewer: bool = True,
    ) -> "Camera":
        """Make the camera of a calibration matrix K = [[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1]], in pixels.

        A point that lies X to the right, Y above and Z in front of the eye appears at column `c_x + f_x X/Z` and row
        `c_y - f_y Y/Z`, where the centre of the first pixel is (.5, .5), as in COLMAP. OpenCV and MATLAB use other
        conventions: add .5 to both c of a K from OpenCV, whose first centre is (0, 0), and subtract .5 from those of
        MATLAB, (1, 1). Photographs must be free of lens distortion. The result is differentiable in K (Hartley and
        Zisserman 2004, "Multiple View Geometry", eq. 6.9).

        Args:
            K: Calibration matrix without skew, pixels; f_x and f_y above 0.
            shape: (height, width) of the photographs in pixels, at the size for which K was determined.
            eye: Position of the camera, scene units; the origin by default.
            target: Point that the camera looks at, scene units; (0, 0, -1) by default.
            up: Upward direction; (0, 1, 0) by default.
            local_viewer: Whether v points from each point to `eye` (E8), as for `Camera`; True by default.

        Returns:
            The camera. With the default pose it is at the origin and looks along -z.

        Raises:
            ValueError: K is not a 3 x 3 matrix of finite numbers, has skew, a focal length that is not above 0 or a
                last row other than (0, 0, 1); or another value is out of the range that `Camera` states.
            TypeError: `eye`, `target` or `up` is not a vector of numbers.
        """
        matrix = as_array(K)
        check_intrinsics(matrix)
        xp = np if isinstance(matrix, np.ndarray) else jnp
        f_x, f_y = matrix[0, 0], matrix[1, 1]
        shape = as_shape(shape)
        height = max(shape[0], 1) if isinstance(shape, tuple) and shape else 1  # an invalid shape is refused below
        return cls(
            eye,  # pyright: ignore[reportArgumentType]
            target=target,
            up=up,
            fov=xp.rad2deg(2.0 * xp.arctan(0.5 * height / f_y)),
            shape=shape,
            local_viewer=local_viewer,
            principal_point=matrix[:2, 2],
            aspect=f_y / f_x,
        )

    def projection(self) -> Projection:
        """Return rays from the eye that cover the full vertical angle `fov`."""
        right, up, backward = axes(self)
        pixel = 2.0 * jnp.tan(jnp.deg2rad(self.fov) / 2.0) / self.shape[0]
        across = pixel if self.aspect is None else pixel * self.aspect
        middle = (self.shape[1] / 2.0, self.shape[0] / 2.0)
        column, row = middle if self.principal_point is None else self.principal_point
        zero = right * 0.0
        corner = -backward - right * (across * column) + up * (pixel * row)
        eye = Vec3.of(self.eye)
        local_viewer, parallel = jnp.asarray(1.0 * self.local_viewer), jnp.asarray(0.0)
        return Projection(eye, zero, zero, corner, right * across, up * -pixel, eye, backward, local_viewer, parallel)


class OrthographicCamera(AbstractCamera):
    r"""A camera of parallel rays along the line from `eye` to `target`.

    The ray of the pixel in row i, column j of an image of H by W pixels starts at

    $$ eye + height [(2j + 1 - W) \, right + (H - 2i - 1) \, up] / 2H $$

    Args:
        eye: Position of the camera, scene units.
        target: Point that the camera looks at, scene units, different from `eye`; the origin by default.
        up: Upward direction, not along the line of sight; (0, 1, 0) by default.
        height: Height of the image from top to bottom, scene units, above 0; 2.2 by default.
        shape: (height, width) in pixels, whole numbers above 0; pixels are square; (256, 256) by default.
        local_viewer: With True, the default, v points from each point to `eye`, although the rays are parallel; with
            False, v is the backward axis everywhere (E8), as for a distant camera.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range, `eye` equals `target`, or `up` is
            along the line of sight.
        TypeError: A value is not a number or vector of numbers.
    """

    eye: Vector = eqx.field(converter=as_vector)
    target: Vector = eqx.field(kw_only=True, converter=as_vector, default=(0.0, 0.0, 0.0))
    up: Vector = eqx.field(kw_only=True, converter=as_vector, default=(0.0, 1.0, 0.0))
    height: Scalar = eqx.field(kw_only=True, converter=as_scalar, default=2.2, metadata={"above": 0})
    shape: tuple[int, int] = eqx.field(kw_only=True, converter=as_shape, static=True, default=(256, 256))
    local_viewer: bool = eqx.field(kw_only=True, static=True, default=True)

    def projection(self) -> Projection:
        """Return parallel rays that start on the plane through the eye."""
        right, up, backward = axes(self)
        pixel = self.height / self.shape[0]
        zero = right * 0.0
        eye = Vec3.of(self.eye)
        corner = eye - right * (pixel * self.shape[1] / 2.0) + up * (pixel * self.shape[0] / 2.0)
        local_viewer, parallel = jnp.asarray(1.0 * self.local_viewer), jnp.asarray(1.0)
        return Projection(
            corner, right * pixel, up * -pixel, -backward, zero, zero, eye, backward, local_viewer, parallel
        )


def axes(camera: AbstractCamera) -> tuple[Vec3, Vec3, Vec3]:
    """Return the camera's unit axes: right, up, backward."""
    backward = normalize(Vec3.of(camera.eye) - Vec3.of(camera.target))
    right = normalize(cross(Vec3.of(camera.up), backward))
    return right, cross(backward, right), backward


def camera_axes(camera: AbstractCamera) -> tuple[Float[np.ndarray, "3"], ...]:
    """Return the camera's unit axes, right, up and backward, as float64 arrays of the host."""
    with in_float64(camera) as seen_by:
        return tuple(np.asarray(axis) for axis in _stacked_axes(seen_by))


def affine_rays(camera: AbstractCamera) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Return the matrices that take (column, row, 1), pixel centres at +.5, to a ray's origin and its direction."""
    with in_float64(camera) as seen_by:
        origin, direction = _stacked_rays(seen_by)
    return np.array(origin), np.array(direction)


def rays_through(
    camera: AbstractCamera, row: Float[np.ndarray, " n"], column: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return the origins and unit directions of rays through rows and columns, pixel centres at +.5."""
    place = np.stack([column, row, np.ones_like(row)], -1)
    origin, direction = (place @ of for of in affine_rays(camera))
    return origin, direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def pixel_matrix(camera: AbstractCamera) -> Float[np.ndarray, "3 4"]:
    """Return the matrix that takes (x, y, z, 1) to (column w, row w, w), pixel centres at +.5."""
    origin, direction = affine_rays(camera)
    across = np.linalg.inv(np.stack([*(origin + direction)[:2], direction[2]]).T)  # one of the two depends on the pixel
    matrix = np.column_stack([across, -across @ origin[2]])
    if not direction[:2].any():
        matrix[2] = (0.0, 0.0, 0.0, 1.0)
    return matrix


def pixels_of(points: Float[np.ndarray, "n 3"], camera: AbstractCamera) -> Float[np.ndarray, "n 2"]:
    """Return column and row of points in the image of a camera, pixel centres at +.5."""
    found = np.column_stack([points, np.ones(len(points))]) @ pixel_matrix(camera).T
    return found[:, :2] / found[:, 2:]


@jit_quickly
def _stacked_axes(camera: AbstractCamera) -> tuple[Array, ...]:
    return tuple(axis.stack() for axis in axes(camera))


@jit_quickly
def _stacked_rays(camera: AbstractCamera) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    of = camera.projection()
    origin = of.origin_column, of.origin_row, of.origin
    direction = of.direction_column, of.direction_row, of.direction
    return tuple(v.stack() for v in origin), tuple(v.stack() for v in direction)


def check_intrinsics(K: Any) -> None:
    """Refuse a value that is not a calibration matrix, or one with skew."""
    if getattr(K, "shape", None) != (3, 3):
        got = f"shape {K.shape}" if hasattr(K, "shape") else in_short(K)
        raise ValueError(
            f"K must be a matrix of 3 x 3 numbers; got {got}. Give [[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1]]."
        )
    if not is_concrete(K):
        return
    numbers = np.asarray(K)
    if not (np.isfinite(numbers).all() and numbers[0, 0] > 0 and numbers[1, 1] > 0):
        raise ValueError(
            f"K must have focal lengths above 0, and finite numbers; got f_x {numbers[0, 0]:g} and f_y "
            f"{numbers[1, 1]:g}. Give [[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1]] in pixels."
        )
    if numbers[0, 1] != 0 or numbers[1, 0] != 0 or not np.array_equal(numbers[2], (0, 0, 1)):
        raise ValueError(
            f"K must have no skew and end in (0, 0, 1); got skew {numbers[0, 1]:g} and the row {in_short(numbers[2])}. "
            "Calibrate without skew, as OpenCV does."
        )


class SomePixels(AbstractCamera):
    """Some pixels of a camera, as a picture of one row."""

    eye: Vector
    target: Vector
    up: Vector
    local_viewer: bool = eqx.field(static=True)
    shape: tuple[int, int] = eqx.field(static=True)
    camera: AbstractCamera
    row: Float[Array, " n"]
    column: Float[Array, " n"]

    @classmethod
    def of(cls, camera: AbstractCamera, pixels: Int[np.ndarray, " n"]) -> "SomePixels":
        """Return those of some flat indices."""
        row, column = np.divmod(pixels.astype(float), camera.shape[1])
        of = {name: getattr(camera, name) for name in ("eye", "target", "up", "local_viewer")}
        return cls(**of, shape=(1, len(pixels)), camera=camera, row=row, column=column)

    def projection(self) -> Projection:
        """Return that of the camera, whose columns here are places among the pixels."""
        whole: dict[str, Any] = {**vars(self.camera.projection()), "local_viewer": jnp.asarray(1.0 * self.local_viewer)}
        return _ProjectionOfSome(row=self.row, column=self.column, **whole)


class _ProjectionOfSome(Projection):
    row: Float[Array, " n"]
    column: Float[Array, " n"]

    def rays(self, row: Float[Array, "..."], column: Float[Array, "..."]) -> Rays:
        centre = jnp.round(column)  # beside which the rays of several samples are
        place = centre.astype(int)
        first, at = (jnp.asarray(of, centre.dtype)[place] for of in (self.row, self.column))
        return super().rays(first + row, at + (column - centre))
