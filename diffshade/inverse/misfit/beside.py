"""Beside: what photographs show beside the objects, where the scene has its background alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy import ndimage, special

from ...core.robust_scale import robust_scale
from ...io.lazy_images import LazyImage
from ..data.recording import record
from ..data.views import colours, has_mask
from ..result import Fit

FAR = 4  # pixels: the least distance from the outline at which a pixel shows the background alone
MAX_SAMPLES = 2048  # of a view, so that noise common to many pixels does not count too often
MIN_SAMPLES = 256  # of all views
NOT_DARK = 0.2  # of the object's brightness: what is brighter beside it is no black level
UNIFORM = 1.5  # noises of the object: what scatters more beside it is a thing, no black level


def beside(fit: Fit) -> Float[np.ndarray, " m"] | None:
    """Return some samples beside the objects less the scene's background, if they show nothing but an even level.

    Views with a mask, an alpha channel or a lazy image are not looked at. None if too little is beside the objects, or
    if it is bright or of many levels: then it shows things, of which the scene says nothing.
    """
    found, brightness = [], []
    for view, samples in zip(fit.views, fit.solved.problem.data.samples, strict=True):
        if has_mask(view) or isinstance(view.image, LazyImage) or not len(samples.pixels):
            continue
        pixels = np.flatnonzero(np.logical_not(ndimage.binary_dilation(samples.inside, iterations=FAR)))
        image, width = np.asarray(colours(view)), view.camera.shape[1]
        pixels = pixels[:: max(len(pixels) * image.shape[2] // MAX_SAMPLES, 1)]
        flat = np.broadcast_to(
            np.asarray(fit.scene.background, np.float64), (*view.camera.shape, fit.scene.background.shape[0])
        )
        found.append(
            (image[pixels // width, pixels % width] - record(flat, view)[pixels // width, pixels % width]).ravel()
        )
        brightness.append(float(samples.values(samples.pixels[:: max(len(samples.pixels) // 256, 1)]).mean()))
    shown = np.concatenate(found) if found else np.zeros(0)
    if len(shown) < MIN_SAMPLES or abs(level := float(np.median(shown))) > NOT_DARK * np.mean(brightness):
        return None
    noise = (
        fit.rmse if fit.views[0].noise is None else fit.rmse * np.sqrt(float(fit.views[0].noise.variance(np.zeros(()))))
    )
    return shown if robust_scale(shown - level) <= UNIFORM * noise else None


def p_of_level(shown: Float[np.ndarray, " m"]) -> float:
    """Return the p-value of samples beside the objects to have the mean that the scene says."""
    spread = float(np.std(shown))
    return float(2.0 * special.ndtr(-abs(shown.mean()) / spread * np.sqrt(len(shown)))) if spread > 0 else 1.0
