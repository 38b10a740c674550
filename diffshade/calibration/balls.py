"""Balls: the sphere behind an outline in an image, and its points and normals at every pixel."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from ..core.masks import Mask
from ..core.robust_scale import UNIFORM, jackknife_error
from ..core.thresholds import SMALL
from ..io.lazy_images import row_tiles
from ..model.cameras import (
    AbstractCamera,
    Camera,
    OrthographicCamera,
    affine_rays,
    camera_axes,
    pixels_of,
    rays_through,
)
from ..model.surfaces import Sphere

Numbers = Float[np.ndarray, " n"]
Points = Float[np.ndarray, "n 3"]
Vectors = Float[np.ndarray, "photographs 3"]

SECTORS = 12  # number of sectors of an outline, left out one at a time to find its errors
MIN_POINTS = 2 * SECTORS  # of an outline: two in each sector
TRIES = 300  # circles through three points of an edge: all miss a circle with 40 % of the points once in 4e8 times
MIN_FRACTION = 0.4  # of an edge on a circle, and of the circle that the edge covers
MIN_N_V = 0.2  # n.v below which pixels of a ball are left out: there the outline matters most


@dataclass(frozen=True, eq=False)
class Ball:
    """A sphere that was found in an image."""

    camera: AbstractCamera
    axes: Float[np.ndarray, "3 3"]
    """The camera's right, up and backward axes, as rows."""
    sphere: Sphere
    mask: Mask
    """The given pixels whose centres see the sphere."""
    errors: Float[np.ndarray, "3"]
    """Standard errors of the apparent centre, to the right and upwards, and of the apparent radius; scene units."""
    pixel: float
    """The width of a pixel at the ball, scene units."""

    @property
    def radius(self) -> float:
        """The apparent radius, in pixels."""
        return float(self.sphere.radius) / self.pixel

    @property
    def middle(self) -> tuple[float, float]:
        """The column and row of the centre in the image, pixel centres at +.5."""
        column, row = pixels_of(np.asarray(self.sphere.center)[None], self.camera)[0]
        return float(column), float(row)

    def moved(self, step: Float[np.ndarray, "3"]) -> Ball:
        """Return the ball for an outline shifted to the right, upwards, and widened, by a step."""
        center = np.asarray(self.sphere.center) + step[:2] @ self.axes[:2]
        return dataclasses.replace(self, sphere=Sphere(center, float(self.sphere.radius) + float(step[2])))

    def seen(self, row: Numbers, column: Numbers) -> tuple[Points, Points, Points]:
        """Return the sphere's points at rows and columns (pixel centres at +.5), the normals, and v there.

        It is the nearest solution of |o + t d - c| = R, or for a ray that misses, the sphere's point nearest to it.
        """
        o, d = rays_through(self.camera, row, column)
        center, radius = np.asarray(self.sphere.center), float(self.sphere.radius)
        nearest = ((center - o) * d).sum(-1)
        across = o + nearest[:, None] * d - center
        half = np.sqrt(np.maximum(radius**2 - (across**2).sum(-1), 0.0))
        n = across - half[:, None] * d
        n = n / np.linalg.norm(n, axis=-1, keepdims=True)
        p = center + radius * n
        v = np.asarray(self.camera.eye) - p if self.camera.local_viewer else np.broadcast_to(self.axes[2], n.shape)
        return p, n, v / np.linalg.norm(v, axis=-1, keepdims=True)

    def normals(self) -> Float[np.ndarray, "h w 3"]:
        """Return the ball's normals at every pixel of its mask, 0 elsewhere."""
        row, column = np.nonzero(self.mask)
        normals = np.zeros((*self.mask.shape, 3))
        normals[self.mask] = self.seen(row + 0.5, column + 0.5)[1]
        return normals


def largest(mask: Mask) -> Mask:
    """Return the largest connected region of a mask."""
    labels, count = ndimage.label(mask)  # pyright: ignore[reportGeneralTypeIssues]
    return labels == 1 + np.bincount(labels.ravel())[1:].argmax() if count else mask


def roundness(mask: Mask) -> float:
    """Return the fraction of a mask's edge that lies on one circle."""
    row, column = outline(mask)
    if len(row) < MIN_POINTS:
        return 0.0
    return float(_near(np.column_stack([column, row, np.zeros(len(row))]), circle, 1.0).mean())


def outline(mask: Mask) -> tuple[Numbers, Numbers]:
    """Return the rows and columns of a mask's edge: halfway between a pixel inside and its neighbour outside.

    Only its largest region counts, with holes filled. The border of the image does not count: it cuts a ball off.
    """
    inside = np.asarray(ndimage.binary_fill_holes(largest(mask)))
    below, right = np.nonzero(inside[1:] != inside[:-1]), np.nonzero(inside[:, 1:] != inside[:, :-1])
    return np.concatenate([below[0] + 1.0, right[0] + 0.5]), np.concatenate([below[1] + 0.5, right[1] + 1.0])


def circle(p: Points, weight: Numbers) -> tuple[Float[np.ndarray, "3"], float, Numbers]:
    """Return the circle nearest to points, as seen along z: its centre, radius, and each point's distance from it.

    x.x = 2 c.x + (R^2 - c.c) is linear in c and in the bracket (Kasa 1976).
    """
    middle = p.mean(0)
    x = (p - middle)[:, :2]
    solution = _solve(np.column_stack([2.0 * x, np.ones(len(x))]), (x**2).sum(-1), weight)
    center = np.array([*solution[:2], 0.0])
    radius = float(np.sqrt(solution[2] + center @ center))
    return center + middle, radius, np.linalg.norm(x - center[:2], axis=-1) - radius


def cone(d: Points, weight: Numbers) -> tuple[Float[np.ndarray, "3"], float, Numbers]:
    """Return the cone nearest to unit vectors d: its axis, half angle, and each vector's angle from it; radians.

    d.axis = cos angle, which is d.w = 1 with w = axis / cos angle.
    """
    w = _solve(d, np.ones(len(d)), weight)
    length = float(np.linalg.norm(w))
    angle = float(np.arccos(min(1.0 / length, 1.0)))
    return w / length, angle, np.arccos(np.clip(d @ w / length, -1.0, 1.0)) - angle


def _solve(A: np.ndarray, b: np.ndarray, weight: np.ndarray) -> np.ndarray:
    some = weight > 0
    return np.linalg.lstsq(A[some] * weight[some, None], b[some] * weight[some], rcond=None)[0]


def _near(points: Points, find: Callable, pixel: float) -> Numbers:
    """Return 1 for points on the ball's outline, and 0 where a shadow or an object in front makes the mask's edge.

    Tries 300 circles (or cones) through three of the points. The best one has the most points within a pixel, or 1 % of
    its radius, minus half the points outside it, since the ball's own points lie inside.
    """
    random, best, most = np.random.default_rng(0), np.zeros(len(points), bool), 0.0
    extent = float(np.ptp(points[:, :2], axis=0).max())
    for three in random.integers(len(points), size=(TRIES, 3)):
        if len(set(three)) < 3:
            continue
        weight = np.zeros(len(points))
        weight[three] = 1.0
        with np.errstate(all="ignore"):
            _, width, off = find(points, weight)
        if not width <= extent:  # nearly a straight line
            continue
        reach = max(pixel, 0.01 * width)
        near = np.abs(off) < reach
        if (score := near.sum() - 0.5 * (off > reach).sum()) > most:
            best, most = near, score
    return best.astype(float)


def near_one_circle(points: Points) -> Numbers:
    """Return 1 for points of an image that lie on one circle, 0 for others."""
    return _near(points, circle, 1.0)


def find_ball(
    mask: Mask,
    camera: AbstractCamera | None,
    radius: float,
    *,
    whole: bool = False,
    edge: tuple[Numbers, Numbers] | None = None,
    apart: Float[np.ndarray, "3"] | float = 0.0,
) -> Ball:
    """Find the sphere whose outline is the edge of a mask.

    From far away the outline is a circle. Parallel rays do not show the sphere's distance, so it is put at the depth of
    the camera's target. Through a pinhole the outline is an ellipse. The rays to it form a cone around the line to the
    centre, and touch the sphere: the sine of the half angle is radius / distance (Daucher, Dhome and Lapreste 1994,
    "Camera calibration from spheres images", ECCV, LNCS 800).

    Circle and cone are found by linear least squares without outliers. Errors are found by leaving out one of 12
    sectors of the outline at a time, and contain how far photographs differ. Those of a mask are at least .29 pixels;
    those of an edge contain as much of the radius, and .1 pixels of the middle.

    Args:
        mask: True on the ball.
        camera: None for a camera far away on +z, with the sphere at the origin.
        radius: The sphere's radius, scene units.
        whole: Whether pixels of the sphere outside the mask, in its own shadow, belong to the ball too.
        edge: Rows and columns of points of the outline; by default those of the mask's edge.
        apart: How far photographs differ in the outline's column, row and radius, pixels; default 0.

    Returns:
        The ball.

    Raises:
        ValueError: If the mask shows no ball.
    """
    row, column = outline(mask) if edge is None else edge
    if len(row) < MIN_POINTS:
        what = "covers the whole picture" if mask.all() else f"shows no ball: its edge has {len(row)} points"
        raise ValueError(f"the mask {what}. Give True (or white) on the ball alone.")
    camera = _far_camera(row, column, mask.shape, radius) if camera is None else camera
    frame = np.stack(camera_axes(camera))
    origin, direction = rays_through(camera, row, column)
    near = isinstance(camera, Camera)
    points, find = (direction @ frame.T, cone) if near else (origin @ frame.T, circle)
    step = float(np.linalg.norm(affine_rays(camera)[int(near)][1]))  # of one pixel: to the next row
    weight = _near(points, find, step)
    _check_some(weight)
    center, width, _ = find(points, weight)
    around = np.arctan2(*(points - center)[:, :2].T) / (2 * np.pi) + 0.5
    sector = (around * SECTORS).astype(int) % SECTORS
    _check_round(sector[weight > 0])
    others = [find(points, weight * (sector != k)) for k in range(SECTORS) if weight[sector == k].any()]
    errors = jackknife_error(np.array([[*c[:2], w] for c, w, _ in others]))
    if near:
        distance = radius / np.sin(width)
        sphere = Sphere(np.asarray(camera.eye) + distance * center @ frame, radius)
        pixel = -distance * center[2] * step
        errors = errors * distance
    else:
        depth = float(np.asarray(camera.target) @ frame[2])
        sphere = Sphere(np.array([*center[:2], depth]) @ frame, width)
        pixel = step
    if edge is None:  # rounded to pixels
        errors = np.maximum(errors, UNIFORM * pixel)
    else:  # of grey values: what lies behind the ball moves the radius, and little the middle
        errors = np.sqrt(errors**2 + (np.square(apart) + np.square([SMALL, SMALL, UNIFORM])) * pixel**2)
    ball = Ball(camera, frame, sphere, mask, errors, pixel)
    return dataclasses.replace(ball, mask=_disc(ball) if whole else mask & _disc(ball))


def _far_camera(row: Numbers, column: Numbers, shape: tuple[int, ...], radius: float) -> OrthographicCamera:
    """Return a camera far away on +z that sees the outline as a circle of this radius around the origin."""
    points = np.column_stack([column, row, np.zeros(len(row))])
    weight = _near(points, circle, 1.0)
    _check_some(weight)
    center, width, _ = circle(points, weight)
    pixel = radius / width
    x, y = (shape[1] / 2 - center[0]) * pixel, (center[1] - shape[0] / 2) * pixel
    return OrthographicCamera(
        (x, y, 4.0 * radius), target=(x, y, 0.0), height=shape[0] * pixel, shape=shape, local_viewer=False
    )


def _disc(ball: Ball) -> Mask:
    """Return the pixels whose rays meet the sphere."""
    disc = np.zeros_like(ball.mask)
    for first, last in row_tiles(*disc.shape):  # a ray takes the memory of thirty samples
        rows = disc[first:last]
        row, column = (index.ravel() + 0.5 for index in np.indices(rows.shape))
        o, d = rays_through(ball.camera, row + first, column)
        to = np.asarray(ball.sphere.center) - o
        t = (to * d).sum(-1)
        rows[:] = (((to**2).sum(-1) - t**2 < float(ball.sphere.radius) ** 2) & (t > 0)).reshape(rows.shape)
    return disc


def _check_some(weight: Numbers) -> None:
    """Refuse an edge with too few points on any one circle."""
    if np.mean(weight) < MIN_FRACTION:
        raise ValueError(
            f"the mask shows no ball: {100 * np.mean(weight):.0f} % of its edge lies on a circle. Give a mask of the "
            "ball alone."
        )


def _check_round(sector: np.ndarray) -> None:
    """Refuse an outline that covers too little of a circle."""
    arc = len(set(sector.tolist())) / SECTORS
    if arc < MIN_FRACTION:
        raise ValueError(
            f"the mask shows too little of a ball: its outline covers {100 * arc:.0f} % of a circle. Give a mask of "
            "the whole ball."
        )
