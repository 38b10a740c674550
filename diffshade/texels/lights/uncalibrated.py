r"""Uncalibrated: lights of which nothing is known, since a matte surface has three numbers a texel under all of them.

The matrix of all observations is a product of the texels' b = k_d n and the lights' s = I l (Hayakawa 1994), up to any
linear map A of the lights. The intensities say A up to a rotation (Woodham, Iwahori and Barman 1991). The rotation is
the one with which the normals are those of a surface,

$$ \partial_y (b_1 / b_3) = \partial_x (b_2 / b_3) $$

(Belhumeur, Kriegman and Yuille 1999), and of the two that are left, the one whose surface bulges towards the camera.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...core.robust_scale import robust_scale
from ...core.thresholds import MINOR, NEGLIGIBLE, SIDE, SLIGHT
from ...inverse.data.views import View, is_grey, lights_on
from ...inverse.forward.losses import CAUCHY
from ...model.scenes import Scene
from ..tiles import LEARNING_SAMPLE, TexelTile, ViewReader
from .matte import ROUNDS, Surface, bright_texels, cells_of, middle_levels, surface_under, texels_under, with_neighbours

STARTS = 8  # turns about the camera's axis
MAX_CURL = 2.0 * SLIGHT  # of unit normals, a cell: a larger one is an edge


def find_uncalibrated(
    scene: Scene, views: Sequence[View], reader: ViewReader, sample: TexelTile, light_of: Int[np.ndarray, " views"]
) -> Float[np.ndarray, "lights 3"]:
    """Return unit vectors towards the lights of the views, by the intensities of the scene.

    Args:
        scene: The lights, of whose directions nothing is used.
        views: The photographs.
        reader: What reads them.
        sample: Texels from all over the object.
        light_of: Which of the lights is on in each view.
    """
    lights: list[Any] = [scene.lights[i] for view in views for i in lights_on(scene, view)]
    strength = np.array([np.atleast_1d(light.intensity) for light in lights])
    power = strength.mean(1)
    colour = np.ones((len(views), 1)) if is_grey(views[0]) else strength / power[:, None]
    cells = cells_of(views, reader, sample, SIDE, colour)
    if not with_neighbours(cells.inside).any():
        raise ValueError("the object has no texel with neighbours. Give photographs of more pixels, or the directions.")
    some = np.linspace(0, cells.inside.sum() - 1, LEARNING_SAMPLE).astype(int)
    y, counts = cells.seen[:, cells.inside][:, some], cells.counts[:, cells.inside][:, some]
    s = factorize(y / power[:, None], counts)
    surface = surface_under(cells, s, power)
    towards = s @ turned_to_surface(of_lengths(s), surface).T
    towards = towards * np.sign(np.median(towards[:, 2]))
    mean = np.stack([towards[light_of == i].mean(0) for i in range(light_of.max() + 1)])
    return mean / np.linalg.norm(mean, axis=-1, keepdims=True)


def factorize(
    y: Float[np.ndarray, "views texels"], counts: Bool[np.ndarray, "views texels"]
) -> Float[np.ndarray, "views 3"]:
    """Return the lights up to a linear map, by alternating least squares of both factors under Cauchy's loss."""
    y, counts = bright_texels(y, counts)
    used, level = middle_levels(y, counts)
    y, weight = y / level, used.astype(float)
    s = np.linalg.svd(np.where(used, y, 1.0), full_matrices=False)[0][:, :3]
    for _ in range(ROUNDS):
        b = texels_under(y, weight, s)
        s = np.linalg.qr(texels_under(y.T, weight.T, b))[0]
        r = s @ texels_under(y, weight, s).T - y
        weight = used / (1.0 + (r / (CAUCHY * max(robust_scale(r[used]), 1e-9))) ** 2)
    return s


def of_lengths(s: Float[np.ndarray, "views 3"]) -> Float[np.ndarray, "3 3"]:
    """Return A with |A s| nearest to 1: |A s|^2 is linear in A^T A, whose root is free to turn."""
    i, j = np.triu_indices(3)
    columns = s[:, i] * s[:, j] * np.where(i == j, 1.0, 2.0)
    first = np.linalg.lstsq(columns, np.ones(len(s)), rcond=None)[0]
    q = least_squares(lambda q: columns @ q - 1.0, first, loss="cauchy", f_scale=MINOR).x
    Q = np.zeros((3, 3))
    Q[i, j] = Q[j, i] = q
    values, axes = np.linalg.eigh(Q)
    return np.sqrt(np.maximum(values, NEGLIGIBLE * values.max()))[:, None] * axes.T


def turned_to_surface(A: Float[np.ndarray, "3 3"], surface: Surface) -> Float[np.ndarray, "3 3"]:
    """Return R A, with the rotation R by which the normals are those of a surface that bulges to the camera."""
    inverse = np.linalg.inv(A)  # b turns as A^-T b
    b, by_x, by_y = (of @ inverse for of in (surface.smooth, surface.by_x, surface.by_y))
    size = (b**2).sum(-1, keepdims=True)
    row, column = np.nonzero(surface.whole)
    place = np.stack([column - column.mean(), row.mean() - row], -1)  # from the middle, right and up
    across_x, across_y = np.cross(b, by_x) / size, np.cross(b, by_y) / size
    upright = Rotation.align_vectors([[0.0, 0.0, 1.0]], [np.mean(b / np.sqrt(size), 0)])[0]
    found: list[tuple[float, np.ndarray]] = []
    for tip, turn in itertools.product((0.0, np.pi), 2.0 * np.pi * np.arange(STARTS) / STARTS):
        begin = Rotation.from_euler("xz", (tip, turn)) * upright

        def turned(by: np.ndarray, begin: Rotation = begin) -> np.ndarray:
            return (Rotation.from_rotvec(by) * begin).as_matrix()

        def curl(by: np.ndarray, turned: Callable[[np.ndarray], np.ndarray] = turned) -> np.ndarray:
            M = turned(by)
            return (across_x @ M[0] + across_y @ M[1]) / MAX_CURL

        end = least_squares(curl, np.zeros(3), loss="cauchy")
        M = turned(end.x)
        M = M * np.sign(np.median(b @ M[2]))
        n = b @ M.T
        if np.sum(n[:, :2] / np.linalg.norm(n, axis=-1, keepdims=True) * place) > 0.0:  # it bulges
            found.append((end.cost, M))
    if not found:
        raise ValueError(
            "no rotation of the lights gives the object a surface that bulges towards the camera. Give the directions, "
            "with light_error."
        )
    return min(found, key=lambda one: one[0])[1] @ A
