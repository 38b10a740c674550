"""Photographs of a relightable image, where those that it was made from are lost."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float

from ...core.arrays import float64_of
from ...core.fields import check_kind
from ...core.masks import as_mask
from ...io.encodings import srgb_decode
from ...io.rti_files import RelightableImage
from ...model.cameras import OrthographicCamera
from ...model.gbuffers import GBuffer
from ...model.lights import DirectionalLight
from ...model.materials import Material
from ...model.scenes import Object, Scene
from .views import View

_LOGGER = logging.getLogger("diffshade")
COUNT, LOWEST = 24, 0.35  # lights that are drawn by default, and the least z of their directions


def dome(count: int, lowest: float) -> Float[np.ndarray, "count 3"]:
    """Return unit vectors to lights spread evenly over the sphere's cap with z from `lowest` (Vogel 1979)."""
    i = np.arange(count) + 0.5
    z = 1.0 - (1.0 - lowest) * i / count
    turn, r = np.pi * (3.0 - np.sqrt(5.0)) * i, np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


def photographs_of(
    image: RelightableImage,
    *,
    toward: Float[ArrayLike, "lights 3"] | None = None,
    mask: Any = None,
    srgb: bool = True,
) -> tuple[Scene, tuple[View, ...]]:
    """Return photographs of a relightable image under some lights, as a scene and views that a fit can start from.

    They show what the basis of the image holds: highlights sharper than it, cast shadows' edges and noise are lost, so
    that n_s is too small, and errors of a fit say how well these pictures are explained, not the object. The logger
    "diffshade" says so.

    Args:
        image: The image, from `read_rti`.
        toward: Directions to the lights, z above 0; by default 24, spread evenly to 70 degrees from the camera.
        mask: (H, W), True where the object is, as for `View`; everywhere by default.
        srgb: Whether the image was made from photographs encoded by the sRGB curve, as JPEGs are, and is decoded.

    Returns:
        The scene, whose normals are (0, 0, 1) and are to be freed, and a view for each light, as `read_photographs`
        returns them.

    Raises:
        ValueError: A direction is not three finite numbers with z above 0, or the mask has another shape.
        TypeError: `image` is no `RelightableImage`.
    """
    check_kind("image", image, RelightableImage, "read_rti(path)")
    directions = dome(COUNT, LOWEST) if toward is None else np.atleast_2d(float64_of("toward", toward))
    inside = np.ones(image.shape, bool) if mask is None else np.asarray(as_mask(mask))
    if inside.shape != image.shape:
        raise ValueError(f"mask must have the shape of the image, {image.shape}; got {inside.shape}. Resize it.")
    camera = OrthographicCamera((0.0, 0.0, 1.0), shape=image.shape, local_viewer=False)
    pictures = [np.clip(image.shade(l), 0.0, 1.0) for l in directions]
    surface = GBuffer(np.broadcast_to((0.0, 0.0, 1.0), (*image.shape, 3)), mask=inside)
    scene = Scene(Object(surface, Material()), [DirectionalLight(-l, 1.0) for l in directions])
    _LOGGER.warning("the pictures are those of a %s: a fit finds n_s too small, and errors too small.", image)
    pictures = [np.asarray(srgb_decode(picture)) if srgb else picture for picture in pictures]
    return scene, tuple(View(picture, camera, inside, lit=(i,)) for i, picture in enumerate(pictures))
