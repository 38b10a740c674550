"""A textured ball of two materials under many lamps, drawn by plain NumPy: what a fit of texels is to find again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import diffshade as ds


class Ball(NamedTuple):
    scene: ds.Scene
    views: tuple[ds.View, ...]
    truth: dict[str, np.ndarray]
    """k_d (H, W, 3), k_s (H, W, 3), n_s (H, W), normal (H, W, 3)."""
    mask: np.ndarray


def lights_about(count: int) -> np.ndarray:
    """Directions to lights, spread evenly over 60 degrees about the view."""
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1.0 - 0.5 * i / count), np.pi * (3.0 - np.sqrt(5.0)) * i
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)


def textured_ball(
    size: int = 48,
    lights: int = 20,
    noise: float = 0.01,
    *,
    k_a: float = 0.0,
    intensity: np.ndarray | float = 1.0,
    shadows: float = 0.0,
    gloss: float = 1.0,
    lobe: str = "phong",
    seed: int = 0,
    to_light: np.ndarray | None = None,
    at: np.ndarray | None = None,
) -> Ball:
    """Left a dull red material, right a shiny blue one, both with a texture; every light in a view of its own.

    `shadows`: the share of the observations that something else keeps the light from. `gloss`: times k_s. `to_light`:
    other directions than those of `lights_about`; `at`: places of lamps nearby instead, with a falloff of 1/d^2.
    """
    rng = np.random.default_rng(seed)
    y, x = 1.1 - 2.2 * (np.arange(size)[:, None] + 0.5) / size, -1.1 + 2.2 * (np.arange(size)[None] + 0.5) / size
    z = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    mask = x**2 + y**2 < 0.96
    n = np.stack([x + 0 * y, y + 0 * x, z], -1) * mask[..., None]
    n /= np.where(mask, np.linalg.norm(n, axis=-1), 1.0)[..., None]
    texture = 0.75 + 0.25 * np.sin(9.0 * x) * np.cos(7.0 * y)
    left = (x < 0.1) & np.ones_like(mask)
    k_d = np.where(left[..., None], (0.7, 0.25, 0.2), (0.15, 0.3, 0.6)) * texture[..., None]
    k_s = gloss * np.where(left, 0.3, 0.6)[..., None] * np.ones(3)
    n_s = np.where(left, 12.0, 40.0)
    far_off = lights_about(lights) if to_light is None else to_light / np.linalg.norm(to_light, axis=-1)[:, None]
    v = np.array([0.0, 0.0, 1.0])
    count = len(far_off if at is None else at)
    intensity = np.ones((count, 3)) * np.asarray(intensity)
    camera = ds.OrthographicCamera((0.0, 0.0, 4.0), shape=(size, size), height=2.2, local_viewer=False)
    views = []
    for i in range(count):
        way = far_off[i] + 0.0 * n if at is None else at[i] - n
        far = np.linalg.norm(way, axis=-1)[..., None]
        l = way / far
        n_l = np.sum(n * l, -1)
        h = (l + v) / np.linalg.norm(l + v, axis=-1)[..., None]
        cosine = np.sum(n * h, -1) if lobe == "blinn" else 2.0 * n_l * n[..., 2] - l[..., 2]
        shine = np.where((n_l > 0) & (cosine > 0), np.maximum(cosine, 1e-12) ** n_s, 0.0)
        dark = rng.random((size, size)) < shadows
        light = np.where(dark[..., None], 0.0, k_d * np.maximum(n_l, 0.0)[..., None] + k_s * shine[..., None])
        image = (
            k_a + intensity[i] * light / (1.0 if at is None else far**2) + noise * rng.standard_normal((size, size, 3))
        )
        views.append(ds.View(image, camera, lit=(i,)))
    material = ds.Material(k_a=k_a, lobe=ds.Blinn() if lobe == "blinn" else ds.Phong())
    if at is None:
        lamps = [ds.DirectionalLight(-l, i) for l, i in zip(far_off, intensity, strict=True)]
    else:
        fade = ds.RadialAttenuation(0.0, 0.0, 1.0)
        lamps = [ds.PointLight(p, i, attenuation=fade) for p, i in zip(at, intensity, strict=True)]
    scene = ds.Scene(ds.Object(ds.GBuffer(n, None if at is None else n, mask=mask), material), lamps)
    return Ball(scene, tuple(views), {"k_d": k_d, "k_s": k_s, "n_s": n_s, "normal": n}, mask)


def facing_us(ball: Ball) -> ds.Scene:
    """The scene of one who does not know the ball's shape: every normal towards the camera."""
    flat = np.zeros_like(ball.truth["normal"])
    flat[..., 2] = 1.0
    item = ball.scene.objects[0]
    assert isinstance(item.surface, ds.GBuffer)
    return ds.Scene(
        ds.Object(ds.GBuffer(flat, item.surface.position, mask=ball.mask), item.material), ball.scene.lights
    )


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between unit vectors, degrees."""
    return np.rad2deg(np.arccos(np.clip(np.sum(a * b, -1), -1.0, 1.0)))


def angles_to(scene: ds.Scene, towards: np.ndarray) -> np.ndarray:
    """Return how far each light of a scene is off the unit vector toward it, degrees."""
    found = np.array([-np.asarray(light.direction) for light in scene.lights])  # pyright: ignore[reportAttributeAccessIssue]
    return angle(found / np.linalg.norm(found, axis=-1, keepdims=True), towards)
