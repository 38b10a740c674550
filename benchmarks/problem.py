"""The problem that every fit in the comparison solves: a ball under one lamp in 1 or 8 places, 12 unknowns, float64.

The others are given what diffshade computes for itself: n.l, log cos and the distance at every pixel that shows the
ball, a residual function and its exact Jacobian, both compiled by JAX. They start at k = 0.3 and n_s = 10.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import diffshade as ds

FREE = ("k_a", "k_d", "k_s", "n_s", "attenuation")
TIED = ("attenuation",)
SIGMA = 0.005
START = np.array([0.3] * 9 + [np.log(10.0), 0.0, 0.0])  # k_a, k_d, k_s in R, G, B; log n_s, linear, quadratic


class Problem(NamedTuple):
    """A scene, its photographs, and the truth."""

    scene: ds.Scene
    views: list[ds.View]


class Fields(NamedTuple):
    """What the others need: fields (samples) and photographs (3, samples) of the pixels that show the ball."""

    n_l: jax.Array
    log_cosine: jax.Array
    distance: jax.Array
    target: jax.Array


def make(size: int, count: int) -> Problem:
    """Render the ball in `count` views of size x size and add noise."""
    i = np.arange(count)
    distance = np.linspace(2.0, 5.0, count)[(3 * i) % count] if count > 1 else np.array([3.3])
    azimuth, polar = 2.0 * np.pi * i / count, np.deg2rad(20.0 + 5.0 * (5 * i % 8))
    towards = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    material = ds.Material(k_a=(0.10, 0.08, 0.06), k_d=(0.60, 0.40, 0.25), k_s=(0.50, 0.50, 0.45), n_s=50)
    fade = ds.RadialAttenuation(1.0, 0.09, 0.032)
    scene = ds.Scene(
        ds.Object(ds.Sphere(), material),
        [ds.PointLight(p, attenuation=fade) for p in distance[:, None] * towards],
    )
    camera = ds.Camera(eye=(0, 0, 4), fov=32, shape=(size, size))
    # with seed 0 the views disagree by chance, as in 2 % of fits, and such a fit is repeated
    random = np.random.default_rng(1)
    views = []
    for k in range(count):
        image = np.array(ds.render(scene, camera, lit=k), np.float64)
        for row in image:  # row by row, so that the noise needs no memory of its own
            row += SIGMA * random.standard_normal(row.shape)
        views.append(ds.View(image, camera, lit=k))
    return Problem(scene, views)


def fields(problem: Problem) -> Fields:
    """Compute the fields of every pixel that shows the ball."""
    rows = []
    for k, view in enumerate(problem.views):
        seen = ds.intersect(problem.scene, view.camera)
        inside = np.asarray(seen.mask)
        n, p = (np.asarray(a)[inside] for a in (seen.normal, seen.position))
        to_light = np.asarray(problem.scene.lights[k].position) - p  # pyright: ignore[reportAttributeAccessIssue]
        d = np.linalg.norm(to_light, axis=-1)
        l = to_light / d[:, None]
        v = np.asarray(view.camera.eye) - p
        v /= np.linalg.norm(v, axis=-1, keepdims=True)
        n_l = np.sum(n * l, -1)
        cosine = np.sum((2.0 * n_l[:, None] * n - l) * v, -1)
        bright = (n_l > 0) & (cosine > 0)
        log = np.where(bright, np.log(np.where(bright, cosine, 1.0)), -1e4)
        rows.append((np.maximum(n_l, 0.0), log, d, view.image[inside].T))
    return Fields(*(jnp.asarray(np.concatenate(part, -1)) for part in zip(*rows, strict=True)))


def residuals(theta: jax.Array, data: Fields) -> jax.Array:
    """Return exposure * radiance - image of every sample."""
    k_a, k_d, k_s = (theta[i : i + 3, None] for i in (0, 3, 6))
    f = 1.0 / (1.0 + data.distance * (theta[10] + data.distance * theta[11]))
    highlight = jnp.exp(jnp.exp(theta[9]) * data.log_cosine)
    return (k_a + f[None] * (k_d * data.n_l[None] + k_s * highlight[None]) - data.target).reshape(-1)


compiled_residuals = jax.jit(residuals)
compiled_jacobian = jax.jit(jax.jacfwd(residuals))
compiled_cost = jax.jit(lambda theta, data: 0.5 * jnp.sum(residuals(theta, data) ** 2))
