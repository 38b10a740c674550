"""Balls in photographs that are rendered: a camera far away and one nearby, four lights, and silhouettes."""

import jax
import numpy as np

import diffshade as ds
from diffshade.model.cameras import AbstractCamera

SHAPE = (120, 128)
FAR = ds.OrthographicCamera((0.1, 0.05, 4), target=(0.1, 0.05, 0), height=2.6, shape=SHAPE, local_viewer=False)
K = ((250.0, 0, 62.3), (0, 252.0, 59.1), (0, 0, 1))
NEAR = ds.Camera.from_intrinsics(K, shape=SHAPE)
DIRECTIONS = np.array([(0.5, 0.4, 0.8), (-0.3, 0.5, 0.9), (0.1, -0.3, 0.7), (-0.6, -0.1, 0.6)])
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=-1, keepdims=True)


def photographs(scene: ds.Scene, camera: AbstractCamera, *, noise: float = 0.0, bits: int | None = None) -> np.ndarray:
    """Render one photograph a light, with noise, clipped and rounded as a file of so many bits."""
    random = np.random.default_rng(0)
    with jax.enable_x64(True):
        images = np.array([ds.render(scene, camera, lit=i) for i in range(len(scene.lights))])
    images = images + noise * random.standard_normal(images.shape)
    return images if bits is None else np.rint(np.clip(images, 0, 1) * (2**bits - 1)) / (2**bits - 1)


def silhouette(camera: AbstractCamera, *spheres: ds.Sphere) -> np.ndarray:
    with jax.enable_x64(True):
        return np.asarray(ds.intersect(ds.Scene([ds.Object(sphere) for sphere in spheres]), camera).mask)


def disc(column: float, row: float, radius: float) -> np.ndarray:
    rows, columns = np.indices(SHAPE) + 0.5
    return np.hypot(columns - column, rows - row) < radius


def lit_by(directions: np.ndarray, material: ds.Material, surface: ds.Sphere | None = None) -> ds.Scene:
    return ds.Scene(ds.Object(surface or ds.Sphere(), material), [ds.DirectionalLight(-l) for l in directions])
