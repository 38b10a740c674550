"""Ball: the fitted scene as the numbers that the live ball's shader, `ball.glsl`, takes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import numpy as np

from ...core.fields import as_coefficient, as_colour, is_over_pixels
from ...core.words import listing
from ...inverse.data.views import lights_on
from ...inverse.result import Fit
from ...model.cameras import AbstractCamera, Camera, OrthographicCamera, affine_rays, camera_axes
from ...model.fresnel import Dielectric, NoFresnel, Schlick
from ...model.lights import AbstractEmitter, AbstractLight, DirectionalLight, PointLight, SpotLight
from ...model.lobes import AbstractLobe, AbstractReflectance, Blinn, Phong
from ...model.patterns import AbstractPattern
from ...model.rendering import intersect
from ...model.scenes import Object, Scene
from ...model.surfaces import Sphere

SIZE = 640  # pixels on the longer side
LOBES = (Phong, Blinn)
COLOURS = (as_colour, as_coefficient)
FRESNEL = (NoFresnel, Schlick, Dielectric)
PLAIN = OrthographicCamera((0.0, 0.0, 4.0), height=2.3, local_viewer=False)


def ball_scene(fit: Fit, names: Sequence[str], white: float) -> tuple[dict[str, Any], list[str]]:
    """Return the scene of the live ball, ready for JSON, and the features that the ball does not show.

    Each object becomes a ball: a sphere stays as it is, another shape becomes a sphere of its width in its place, and
    normals without positions become a unit ball. The ball has the camera, lights and exposure of a chosen view, and its
    image is divided by `white`. Runs in float64.
    """
    scene = fit.scene
    balls = [_ball(item, fit.views[0].camera) for item in scene.objects]
    laws: list[str] = []
    emitters = [emitter_rows(light, laws) for light in scene.lights]
    lobes = own_lobes([item.material.lobe for item in scene.objects])
    views = [
        {
            "name": name,
            "cameras": [_camera(view.camera, ball) for ball in balls],
            "lit": [i for i in lights_on(scene, view) if emitters[i] is not None],
            "gain": float(view.exposure) / white,
            "black": float(view.black) / white,
        }
        for name, view in zip(names, fit.views, strict=True)
    ]
    objects = [
        {
            "name": item.name or f"objects.{i}",
            "center": _floats(Sphere().center if ball is None else ball.center),
            "radius": 1.0 if ball is None else float(ball.radius),
            "material": {k: _floats(_plain(getattr(item.material, k))) for k in ("k_a", "k_d", "k_s", "k_e", "n_s")},
            "lobe": lobe_number(item.material.lobe, lobes),
            "fresnel": _number(FRESNEL, item.material.fresnel),
            "eta": 1.0 if item.material.eta is None else float(item.material.eta),
        }
        for i, (item, ball) in enumerate(zip(scene.objects, balls, strict=True))
    ]
    data = {
        "ambient": _floats(scene.ambient),
        "background": _floats(scene.background),
        "lights": [found or [] for found in emitters],
        "views": views,
        "objects": objects,
        "lobes": lobes,
        "laws": laws,
    }
    return data, _not_shown(scene, emitters)


def _not_shown(scene: Scene, emitters: Sequence[list | None]) -> list[str]:
    """Name the features of a scene that the ball does not show."""
    items = scene.objects
    unknown = [f"lights.{i}" for i, found in enumerate(emitters) if found is None]
    lobes = {type(item.material.lobe).__name__ for item in items if not _draws(item.material.lobe)}
    weights = {type(item.material.fresnel).__name__ for item in items if type(item.material.fresnel) not in FRESNEL}
    features = (
        (any(not isinstance(item.surface, Sphere) for item in items), "the surface's own shape (shown as a ball)"),
        (len(items) > 1, "more than one object at a time"),
        (any(item.material.k_t is not None for item in items), "transparency (k_t)"),
        (any(item.material.patterns for item in items), "patterns (shown as the mean of their colours)"),
        (any(item.material.maps for item in items), "coefficients over the pixels (shown as their mean)"),
        (any(item.material.highlights for item in items), "highlights beside the first"),
        (bool(lobes), f"the lobe {listing(sorted(lobes))} (shown as Phong's)"),
        (bool(weights), f"the weight {listing(sorted(weights))} of the highlight (shown as k_s)"),
        (scene.shadows, "cast shadows"),
        (scene.atmosphere is not None, "the atmosphere between the object and the eye"),
        (bool(unknown), f"the light of {listing(unknown)}" if unknown else ""),
    )
    return [words for here, words in features if here]


def scene_to_render(fit: Fit) -> Scene | None:
    """Return the scene of the balls for `render` to draw, where the live ball lacks part of a material or a light.

    None where the live ball has all, or where a ball cannot stand for an object.
    """
    materials = [item.material for item in fit.scene.objects]
    lacks = any(m.patterns or m.highlights or not _draws(m.lobe) for m in materials)
    lacks = lacks or any(emitter_rows(light, []) is None for light in fit.scene.lights)
    balls = [_ball(item, fit.views[0].camera) for item in fit.scene.objects]
    found = [(item, of) for item, of in zip(fit.scene.objects, balls, strict=True) if of is not None]
    if not lacks or len(found) < len(balls) or any(m.maps for m in materials):
        return None
    # stand-in balls would cast shadows that the objects do not
    scene = dataclasses.replace(fit.scene, shadows=False)
    return dataclasses.replace(scene, objects=tuple(dataclasses.replace(item, surface=of) for item, of in found))


def _draws(lobe: AbstractReflectance) -> bool:
    """Return whether the shader draws a lobe: its own, or one that says how."""
    return type(lobe) in LOBES or (isinstance(lobe, AbstractLobe) and lobe.glsl() is not None)


def own_lobes(lobes: Iterable[Any]) -> list[tuple[str, str]]:
    """Return the name and the shader's function body of each lobe that is not the shader's own, each once."""
    own = (of for of in lobes if _draws(of) and type(of) not in LOBES)
    return list(dict.fromkeys((type(of).__name__, of.glsl()) for of in own))


def lobe_number(lobe: AbstractReflectance, own: Sequence[tuple[str, str]]) -> int:
    """Return the shader's number of a lobe; Phong's for one that it does not know."""
    if isinstance(lobe, AbstractLobe) and (type(lobe).__name__, lobe.glsl()) in own:
        return len(LOBES) + own.index((type(lobe).__name__, str(lobe.glsl())))
    return _number(LOBES, lobe)


def _number(kinds: Sequence[type], value: object) -> int:
    """Return the shader's number of a kind; the first kind for one that it does not know."""
    return kinds.index(type(value)) if type(value) in kinds else 0


def _ball(item: Object, camera: AbstractCamera) -> Sphere | None:
    """Return the sphere that represents an object; None if the object's positions are unknown."""
    if isinstance(item.surface, Sphere):
        return item.surface
    seen = intersect(Scene(item), camera)
    if seen.position is None or not np.any(seen.mask):
        return None
    points = np.asarray(seen.position)[np.asarray(seen.mask)]
    radius = 0.5 * min(float(np.ptp(points @ axis)) for axis in camera_axes(camera)[:2])
    return Sphere(points.mean(0), radius) if radius > 0 else None


def _camera(camera: AbstractCamera, ball: Sphere | None) -> dict[str, Any]:
    """Return a camera as numbers, with the size of the ball's image; a camera inside the ball is moved back."""
    if ball is None:
        camera = PLAIN
    else:
        center, (_, up, backward) = np.asarray(ball.center), camera_axes(camera)
        if (np.asarray(camera.eye) - center) @ backward <= 1.001 * float(ball.radius):
            eye = center + 4.0 * float(ball.radius) * backward
            camera = Camera(eye, target=center, up=up, fov=33.0, shape=camera.shape, local_viewer=camera.local_viewer)
    height, width = ball_shape(camera.shape)
    camera = dataclasses.replace(camera, shape=(height, width))
    vectors = {"eye": camera.eye, **dict(zip(("right", "up", "backward"), camera_axes(camera), strict=True))}
    numbers = ray_rows(*affine_rays(camera)) | {name: _floats(vector) for name, vector in vectors.items()}
    return {**numbers, "local_viewer": camera.local_viewer, "height": height, "width": width}


def ray_rows(origin: np.ndarray, direction: np.ndarray) -> dict[str, list[float]]:
    """Return the rows of matrices as of `affine_rays` by the shader's names."""
    kinds, of = (("origin", origin), ("direction", direction)), ("_column", "_row", "")
    return {f"{kind}{name}": _floats(row) for kind, rows in kinds for name, row in zip(of, rows, strict=True)}


def ball_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the height and width of the live ball's image for a camera of this shape."""
    height, width = (max(round(side * SIZE / max(shape)), 1) for side in shape)
    return height, width


def emitter_rows(light: AbstractLight, laws: list[str]) -> list[list[float]] | None:
    """Return a row of 16 numbers for each emitter of a light; None for a light that the shader does not know.

    It knows none whose colours are apart, none with flaps, and none with a law of attenuation that has no `glsl`.

    The row is: position, 1 (or the direction to a light at infinity, 0); intensity, the number of its law; a spot's
    axis, the cosine of its edge; its exponent, the width of its soft edge, 1 for a spot, 0.

    Args:
        light: The light.
        laws: The function bodies of the laws so far, by their numbers; those of the light are added.
    """
    if not light.has_one_colour:
        return None
    if not isinstance(light, AbstractEmitter):
        stack = jax.jit(type(light).emitters)(light)
        number = len(jax.tree.leaves(stack)[0])
        each = [emitter_rows(jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), stack), laws) for i in range(number)]
        return None if None in each else [row for rows in each for row in rows or ()]
    if isinstance(light, DirectionalLight):
        to_light = -np.asarray(light.direction) / np.linalg.norm(light.direction)
        return [[*_floats(to_light), 0.0, *_floats(light.intensity), *[0.0] * 9]]
    if not isinstance(light, PointLight | SpotLight) or light.flaps is not None:
        return None
    law = light.attenuation.glsl()
    if law is None:
        return None
    laws += [] if law in laws else [law]
    row = [*_floats(light.position), 1.0, *_floats(light.intensity), float(laws.index(law))]
    if isinstance(light, PointLight):
        return [[*row, *[0.0] * 8]]
    axis = np.asarray(light.direction) / np.linalg.norm(light.direction)
    edge = max(_cosine(light.cutoff), 0.0)
    width = _cosine(light.cutoff - light.softness) - edge
    return [[*row, *_floats(axis), edge, float(light.exponent), width, 1.0, 0.0]]


def _cosine(degrees: Any) -> float:
    return float(np.sin(np.deg2rad(90.0 - float(degrees))))


def _plain(coefficient: Any) -> np.ndarray:
    """Return three numbers: the mean colour of a pattern or over the pixels, and a single n_s repeated."""
    if isinstance(coefficient, AbstractPattern):
        fields = [f for f in dataclasses.fields(coefficient) if f.metadata.get("converter") in COLOURS]
        colours = [np.asarray(getattr(coefficient, f.name)).reshape(-1, 3).mean(0) for f in fields]
        return np.mean(colours, 0) if colours else np.full(3, 0.5)
    if is_over_pixels(coefficient):
        of = np.asarray(coefficient)
        return np.broadcast_to(of.reshape(-1, *of.shape[2:]).mean(0), 3)
    return np.broadcast_to(np.asarray(coefficient), 3)


def _floats(array: Any) -> list[float]:
    return [float(x) for x in np.asarray(array)]
