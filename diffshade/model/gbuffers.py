"""G-buffers: surfaces as one camera sees them, a point and a normal for each pixel."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool, Float

from ..core.arrays import check_no_bytes, float64_of, numbers
from ..core.fields import Array, as_array, check_kind, is_concrete
from ..core.masks import as_mask
from .cameras import OrthographicCamera, Rays, camera_axes
from .surfaces import AbstractSurface, Hit
from .vectors import Vec3, dot


class GBuffer(AbstractSurface):
    """A surface as one camera sees it: any shape, from a normal map, a mesh or another renderer.

    Outside the mask the numbers are neither checked nor kept. JAX arrays of float32, such as `intersect` returns, stay
    on their device; other arrays are copied there for every render. Only the camera's own rays can hit a G-buffer: a
    scene that contains one cannot contain glass that bends rays.

    Args:
        normal: Unit normals, of length 1 to within 0.001; they are never flipped.
        position: Points of the surface, scene units; None by default. Lights with a position, a local viewer, several
            objects, an atmosphere and patterns need it.
        mask: True where the surface is, as for `View`; by default, where the normal is not zero.

    Raises:
        ValueError: The shapes do not match, or within the mask a normal is not unit or a position is not finite.
        TypeError: What is given is no array of numbers, or a masked array, or in a unit.
    """

    normal: Float[Array, "h w 3"]
    position: Float[Array, "h w 3"] | None
    mask: Bool[Array, "h w"]

    def __init__(self, normal: Array, position: Array | None = None, mask: Any = None):
        normal = as_array(numbers("GBuffer.normal", normal))
        position = None if position is None else as_array(numbers("GBuffer.position", position))
        inside = (normal != 0).any(-1) if mask is None else as_mask(mask, "GBuffer.mask")
        for name, array in (("normal", normal), ("position", position)):
            if array is not None and (inside.ndim != 2 or array.shape != (*inside.shape, 3)):
                raise ValueError(
                    f"GBuffer.{name} must have shape (H, W, 3), with the mask's H and W; got {array.shape} with a mask "
                    f"of shape {inside.shape}. Give one vector a pixel."
                )
        keep = jnp.where if _stays(normal, position) or not is_concrete(normal, position, inside) else _frozen
        self.normal = keep(inside[..., None], normal, 0.0)
        self.position = None if position is None else keep(inside[..., None], position, 0.0)
        self.mask = keep(inside, inside, False)

    def check_together(self) -> None:
        arrays = [_owner(array) for array in (self.normal, self.position, self.mask) if array is not None]
        if not is_concrete(*arrays) or tuple(map(id, arrays)) in _sound:
            return
        squared = np.sum(np.square(self.normal), -1)
        points = self.normal if self.position is None else self.position
        wrong = np.asarray(self.mask) & ~((np.abs(squared - 1.0) < 2e-3) & np.isfinite(points).all(-1))
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise ValueError(
                f"GBuffer needs a unit normal and a finite position at every pixel of its mask; at row {row}, column "
                f"{column} the normal is {self.normal[row, column]} and the position "
                f"{None if self.position is None else self.position[row, column]}. Normalise it or mask it out."
            )
        _remember(arrays)

    def extent(self) -> float:
        """Return half the diagonal of the points' bounding box, in scene units; 0 if the positions are not known."""
        inside = np.asarray(self.mask)
        if self.position is None or not inside.any():
            return 0.0
        return 0.5 * float(np.linalg.norm(np.ptp(np.asarray(self.position)[inside], axis=0)))

    def intersect(self, rays: Rays) -> Hit:
        """Return the buffer's own points: the rays must be those of the camera for which the buffer was made."""
        p = None if self.position is None else Vec3.of(self.position)
        distance = jnp.zeros(self.mask.shape) if p is None else dot(p - rays.origin, rays.direction)
        return Hit(distance, p, Vec3.of(self.normal), self.mask)


_sound: dict[
    tuple[int, ...], list[weakref.ref]
] = {}  # arrays that were checked and cannot change: a check takes 25 ns per pixel


def _owner(array: Array) -> Array:
    """Return the array whose numbers a view shows, all of them and in their order; any other array itself."""
    base = array.base if isinstance(array, np.ndarray) else None
    if not isinstance(array, np.ndarray) or not isinstance(base, np.ndarray) or not base.flags.owndata:
        return array
    same = (base.shape, base.strides, base.dtype) == (array.shape, array.strides, array.dtype)
    return base if same else array


def _remember(arrays: Sequence[Array]) -> None:
    """Remember that the arrays of a G-buffer are sound, by their identity, for as long as all of them live."""
    if any(isinstance(array, np.ndarray) and (array.flags.writeable or not array.flags.owndata) for array in arrays):
        return
    key = tuple(map(id, arrays))
    _sound[key] = [weakref.ref(array, lambda _: _sound.pop(key, None)) for array in arrays]


def _stays(*arrays: Array | None) -> bool:
    """Whether arrays stay JAX's, on their device: of float32. float64 is none where `jax_enable_x64` is off."""
    return all(array is None or (isinstance(array, jax.Array) and array.dtype == np.float32) for array in arrays)


def _frozen(inside: Array, array: Array, outside: float | bool) -> np.ndarray:
    """Return the array where the mask is True, as a copy that cannot be written to."""
    kept = np.where(inside, array, outside)
    kept.flags.writeable = False
    return kept


def _mask_of(noun: str, mask: Any, shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """Return the mask of a map as booleans; refuse one of another shape."""
    inside = np.asarray(as_mask(mask, f"the mask of a {noun}"))
    if inside.shape != shape:
        raise ValueError(f"the mask of a {noun} must have its shape {shape}; got {inside.shape}. Resize it.")
    return inside


def _numbers_of(noun: str, image: Any) -> Float[np.ndarray, "..."]:
    """Return the numbers of a map; refuse a path, which is not read here."""
    if isinstance(image, str | Path):
        raise TypeError(
            f"a {noun} must be an array; got the path {str(image)!r}. Read it with ds.read_image(path, srgb=False)."
        )
    return float64_of(f"a {noun}", image)


def normal_map(image: Float[ArrayLike, "h w 3"], *, mask: Any = None) -> GBuffer:
    """Make the G-buffer of a normal map (Blinn 1978).

    Its colours are $(n + 1) / 2$, with x right, y up and z to the viewer. The normals are normalised. The G-buffer has
    no positions: use directional lights and a camera with `local_viewer=False` that looks along -z.

    Args:
        image: Colours of the map, 0 to 1, not decoded by the sRGB curve: read a file with `read_image(path,
            srgb=False)`.
        mask: (H, W), True where the surface is, as for `View`; by default, where the map is not black.

    Returns:
        The G-buffer, without positions.

    Raises:
        ValueError: The image or the mask has a wrong shape, or the image does not hold unit normals.
        TypeError: `image` is a path.
    """
    check_no_bytes("a normal map", image)
    image = _numbers_of("normal map", image)
    if image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"a normal map must have shape (H, W, 3); got {image.shape}. Give an RGB image.")
    inside = image.any(-1) if mask is None else _mask_of("normal map", mask, image.shape[:2])
    n = 2.0 * image - 1.0
    length = np.linalg.norm(n, axis=-1)
    wrong = inside & ~((length > 0.5) & (length < 1.5))
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise ValueError(
            f"a normal map must hold (n + 1)/2 of unit normals; at row {row}, column {column} the length is "
            f"{length[row, column]:.3g}. Read it without the sRGB curve, or mask the pixel out."
        )
    return GBuffer(n / np.where(length > 0, length, 1.0)[..., None], None, inside)


def height_map(height: Float[ArrayLike, "h w"], camera: OrthographicCamera, *, mask: Any = None) -> GBuffer:
    r"""Make the G-buffer of a relief: the height of each pixel above the plane through the camera's target.

    $$ n \propto (-\partial z / \partial x, -\partial z / \partial y, 1) $$

    The normals come from central differences; at the borders and beside masked pixels, from one-sided differences.

    Args:
        height: Height towards the viewer, scene units.
        camera: Camera that sees the relief; its shape is that of `height`.
        mask: (H, W), True where the surface is, as for `View`; everywhere by default.

    Returns:
        The G-buffer, with positions.

    Raises:
        ValueError: `height` or `mask` does not have the camera's shape, or a height within the mask is not finite.
        TypeError: `camera` is not an `OrthographicCamera`, or `height` is a path.
    """
    check_kind("camera", camera, OrthographicCamera, "OrthographicCamera(eye=(0, 0, 4), height=2.2)")
    height = _numbers_of("height map", height)
    if height.shape != camera.shape:
        raise ValueError(f"a height map must have the camera's shape {camera.shape}; got {height.shape}. Resize it.")
    inside = np.ones(height.shape, bool) if mask is None else _mask_of("height map", mask, height.shape)
    if (wrong := inside & ~np.isfinite(height)).any():
        row, column = np.argwhere(wrong)[0]
        raise ValueError(
            f"a height map must be finite; got {height[row, column]} at row {row}, column {column}. Mask it out."
        )
    pixel = float(camera.height) / camera.shape[0]
    right, up, backward = camera_axes(camera)
    down, across = np.indices(height.shape) + 0.5
    x, y = (across - camera.shape[1] / 2) * pixel, (camera.shape[0] / 2 - down) * pixel
    known = np.where(inside, height, np.nan)
    slope_x, slope_y = _slope(known, 1) / pixel, -_slope(known, 0) / pixel
    n = backward - slope_x[..., None] * right - slope_y[..., None] * up
    z = np.where(inside, height, 0.0)
    p = np.asarray(camera.target) + x[..., None] * right + y[..., None] * up + z[..., None] * backward
    return GBuffer(n / np.linalg.norm(n, axis=-1, keepdims=True), p, inside)


def _slope(height: Float[np.ndarray, "h w"], axis: int) -> Float[np.ndarray, "h w"]:
    """Return the mean of the steps to the next and from the last pixel, of those that are known."""
    step = np.diff(height, axis=axis)
    beyond = [(0, 0), (0, 0)]
    both = []
    for side in ((0, 1), (1, 0)):
        beyond[axis] = side
        both.append(np.pad(step, beyond, constant_values=np.nan))
    known = np.isfinite(both)
    return np.where(known, both, 0.0).sum(0) / np.maximum(known.sum(0), 1)
