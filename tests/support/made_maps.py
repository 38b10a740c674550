"""Maps made up: of a bumpy plane under lights at infinity, and of a ball close to a camera under lamps nearby."""

from __future__ import annotations

import numpy as np
from textured import lights_about

import diffshade as ds
from diffshade.texels.maps import SharedHighlight
from diffshade.texels.unexplained import Interpolation, Unexplained

SHAPE = (40, 56)
LAMPS = (
    ds.PointLight((1.5, 1.0, 2.5), (4.0, 3.0, 2.0), ds.RadialAttenuation(0.4, 0.1, 0.05)),
    ds.SpotLight((-1.5, 1.0, 3.0), (0.5, -0.3, -1.0), 3.0, cutoff=30, exponent=2),
    ds.AreaLight((-2.0, 1.0, 2.0), (1.0, 0.0, 0.0), (0.0, -0.6, 0.8), 0.8, samples=(2, 2)),
)


def bumpy(*, regions: bool = False) -> tuple[ds.TexelMaps, ds.heights.HeightMap, list[ds.View]]:
    """A relief with a shared highlight, or two, and light beyond the model; its heights; photographs of it."""
    random = np.random.default_rng(3)
    camera = ds.OrthographicCamera((0.0, 0.0, 1.0), shape=SHAPE, local_viewer=False)
    height, normal = relief(camera)
    inside = np.hypot(*(np.indices(SHAPE) - np.array(SHAPE)[:, None, None] / 2)) < 25
    toward = lights_about(6)
    lights = [ds.DirectionalLight(-l, intensity=(1.0, 0.9, 0.8)) for l in toward]
    scene = ds.Scene(
        ds.Object(ds.GBuffer(normal, mask=inside), ds.Material(0.1, k_e=0.01, lobe=ds.Blinn())), lights, ambient=0.2
    )
    values = {
        "k_d": random.uniform(0.1, 0.8, (*SHAPE, 3)),
        "k_s": random.uniform(0.0, 0.4, (*SHAPE, 3)),
        "n_s": np.full((*SHAPE, 1), 30.0),
        "normal": normal,
    }
    left = np.arange(SHAPE[1])[None, :, None] < SHAPE[1] // 2
    weights = [0.3 + 0.4 * (left & np.ones((*SHAPE, 1), bool)) if regions else 0.7]
    weights.append(1.0 - weights[0])
    beyond = random.normal(0.0, 0.05, (*SHAPE, 3 * 4)).astype(np.float16)
    given = Interpolation(toward, 0.4, np.ones((4, 6)), random.normal(0.0, 0.5, (6, 4)))
    maps = made(
        values, inside, scene, camera, tuple(map(SharedHighlight, weights, (8.0, 64.0))), Unexplained(given, beyond)
    )
    views = [ds.View(maps.shade(lit=i), camera, inside, lit=(i,), exposure=1.0 + 0.2 * i) for i in range(6)]
    part, none = np.where(inside, 0, -1), np.zeros(SHAPE, bool)
    heights = ds.heights.HeightMap(
        np.where(inside, height, 0.0), np.full(SHAPE, 0.01), part, none, none, normal, camera
    )
    return maps, heights, views


def relief(camera: ds.OrthographicCamera) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights of a ridge on a plane, and their normals."""
    pixel = 2.2 / camera.shape[0]
    x = (np.arange(camera.shape[1]) - camera.shape[1] / 2) * pixel
    height = np.broadcast_to(0.3 * np.exp(-((x / 0.2) ** 2)), camera.shape)
    normal = np.stack([-np.gradient(height, pixel, axis=1), np.zeros_like(height), np.ones_like(height)], -1)
    return height, normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def ball_nearby() -> tuple[ds.TexelMaps, list[ds.View]]:
    """A ball of known shape with its own n_s at each texel, before a camera nearby, under lamps of every kind."""
    random = np.random.default_rng(4)
    camera = ds.Camera((0.3, 0.5, 4.0), fov=38, shape=SHAPE)
    scene = ds.Scene(ds.Object(ds.Sphere((0.1, 0.0, 0.2), 1.1), ds.Material(lobe=ds.Phong())), LAMPS)
    inside = np.asarray(ds.intersect(scene, camera).mask)
    values = {
        "k_d": random.uniform(0.1, 0.8, (*SHAPE, 3)),
        "k_s": random.uniform(0.0, 0.4, (*SHAPE, 3)),
        "n_s": random.uniform(2.0, 60.0, (*SHAPE, 1)),
    }
    maps = made(values, inside, scene, camera)
    return maps, [ds.View(maps.shade(lit=lit), camera, inside, lit=lit) for lit in ((0,), (1,), (0, 1, 2))]


def made(values, inside, scene, camera, highlights=(), unexplained=None) -> ds.TexelMaps:
    values = {name: np.where(inside[..., None], of, 0.0).astype(np.float32) for name, of in values.items()}
    errors = {name: np.full((*SHAPE, of.shape[2]), 0.05, np.float32) for name, of in values.items()}
    if "normal" in errors:
        errors["normal"] = np.full((*SHAPE, 1), 2.0, np.float32)
    errors["k_s"][:5] = np.inf
    status = np.where(inside, 1 + (np.arange(SHAPE[1]) > 30), 0).astype(np.uint8)
    residual = np.full(SHAPE, 0.02, np.float32)
    return ds.TexelMaps(
        values, errors, status, residual, scene, camera, ("a note.",), highlights=highlights, unexplained=unexplained
    )
