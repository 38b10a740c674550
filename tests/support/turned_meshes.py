"""How much of a true surface a mesh covers when it is turned, and how much of the mesh is where nothing is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from reliefs import AXIS, Relief

import diffshade as ds
from diffshade.io.triangles import Triangles, tracer


class Coverage(NamedTuple):
    whole: float
    """Share of the rays to the true surface that meet the mesh."""
    beside: float
    """Rays that meet the mesh alone, over those to the true surface."""


def true_surface(of: Relief) -> Triangles:
    """The true points of the pixels as triangles, across jumps too."""
    seen = of.mask[:-1, :-1] & of.mask[1:, :-1] & of.mask[:-1, 1:] & of.mask[1:, 1:]
    number = np.arange(of.mask.size).reshape(of.mask.shape)
    a, b, c, d = (part[seen] for part in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]))
    x, y = (np.arange(n) + 0.5 for n in of.mask.shape[::-1])
    camera = of.camera
    assert isinstance(camera, ds.OrthographicCamera)
    pixel = float(np.asarray(camera.height)) / of.mask.shape[0]
    x, y = np.meshgrid((x - x.size / 2) * pixel, (y.size / 2 - y) * pixel)
    return Triangles(
        np.stack([x, y, of.z], -1).reshape(-1, 3), np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)])
    )


def coverage(mesh: ds.heights.HeightMesh, truth: Triangles, *, degrees: float = 50.0, rays: int = 300) -> Coverage:
    """Both turned to the left, right, up and down; the mesh is moved to the heights of the truth first."""
    true, found = truth.used()[0], Triangles(mesh.corner, mesh.face)
    across, up = (np.ravel(of) for of in np.meshgrid(*2 * [np.linspace(-1.6, 1.6, rays)]))

    def seen(of: Triangles, turned: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """Which rays meet it, and how far along the line of sight from the plane of the target."""
        t = np.deg2rad(degrees) * np.array(turned)
        toward = np.array([np.sin(t[0]), np.sin(t[1]), np.cos(t).prod()])
        right = np.array([toward[2], 0.0, -toward[0]]) / np.hypot(toward[0], toward[2])
        start = across[:, None] * right + up[:, None] * np.cross(toward, right) + 8.0 * toward
        hits = tracer(of)(start, np.broadcast_to(-toward, start.shape))
        met, height = np.zeros(len(start), bool), np.zeros(len(start))
        met[hits.ray], height[hits.ray] = True, hits.point @ toward
        return met, height

    (one, z), (other, z_true) = seen(found, (0, 0)), seen(true, (0, 0))
    found = found._replace(corner=found.corner + np.median((z_true - z)[one & other]) * AXIS)
    views = ((1, 0), (-1, 0), (0, 1), (0, -1))
    mesh_met, true_met = (np.array([seen(of, view)[0] for view in views]) for of in (found, true))
    return Coverage(float(mesh_met[true_met].mean()), float((mesh_met & ~true_met).sum() / true_met.sum()))
