"""Sensors: what a camera makes of the light: vignetting, white balance, a response curve and blur."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...core.fields import Array, Checked, Scalar, as_scalar, check_kind, is_concrete, parameter
from ...model.cameras import Projection
from ...model.vectors import dot, length

TOE = 1e-4  # below this level the response is a straight line, so that its slope is finite in the dark
BENT = 4096  # points of the table that a bent response is inverted by


class Vignetting(Checked):
    r"""The darkening of a photograph towards its corners.

    $$ V = \cos^c\theta \; (1 + v_2 r^2 + v_4 r^4) $$

    r is the distance to the camera's axis over half the image's diagonal, and theta the angle off that axis, 0 for an
    orthographic camera (Goldman, "Vignette and exposure calibration and compensation", PAMI 2010).

    Args:
        second: v_2, such as -.3 for corners that are 30 % darker; default 0.
        fourth: v_4; default 0.
        cosine: c, 4 for a simple lens (the cos^4 law); default 0. Only its own name frees it.
    """

    second: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata=parameter("camera"))
    fourth: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata=parameter("camera"))
    cosine: Scalar = eqx.field(
        converter=as_scalar, default=0.0, metadata=parameter("camera", lower=0, by_own_name=True)
    )


class Sensor(Checked):
    r"""What a camera made of the light before a `View` holds it.

    $$ image = f(exposure \cdot g_c \cdot V \cdot radiance + black) + noise, \quad f(x) = x^{1/\gamma + b x} $$

    The response f is a generalised gamma curve (Ng, Chang and Lee, "Using geometry invariants for camera response
    function estimation", CVPR 2007), with f(1) = 1, and a straight line below x = .0001.

    A fit frees its numbers by name, and `tied=("sensor",)` makes those of all photographs of a camera one:
    `fit(scene, views, free=("k_d", "k_s", "n_s", "sensor.gamma"), tied=("sensor",))`.

    Args:
        gamma: gamma, above 0; default 1, a linear image. Files with the sRGB curve are linear once `read_image` has
            decoded them.
        bend: b, which lifts or lowers the bright half; default 0.
        red: Gain of red over green, above 0; default 1. Grey photographs and bands have no gains.
        blue: Gain of blue over green, above 0; default 1.
        vignetting: V; default none.
        blur: Standard deviation of a Gaussian blur, pixels; default 0. A fit takes sixteen places around each pixel,
            exact for shading that is a polynomial of degree 7, which an outline is not: up to four pixels along edges
            are left out, where the photographs mix them; above a blur of 1 erode the mask by four times the blur.
    """

    gamma: Scalar = eqx.field(
        converter=as_scalar, default=1.0, metadata=parameter("camera", lower=0, fit_range=(0.2, 5.0))
    )
    bend: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata=parameter("camera", fit_range=(-0.3, 1.0)))
    red: Scalar = eqx.field(
        converter=as_scalar, default=1.0, metadata=parameter("camera", lower=0, fit_range=(1e-3, 1e3))
    )
    blue: Scalar = eqx.field(
        converter=as_scalar, default=1.0, metadata=parameter("camera", lower=0, fit_range=(1e-3, 1e3))
    )
    vignetting: Vignetting = eqx.field(default_factory=Vignetting)
    blur: Scalar = eqx.field(
        converter=as_scalar, default=0.0, metadata=parameter("camera", lower=0, start=1.0, fit_range=(0.1, 10.0))
    )

    def check_together(self) -> None:
        check_kind("Sensor.vignetting", self.vignetting, Vignetting, "Vignetting(second=-0.3)")
        for name in ("gamma", "red", "blue"):
            if is_concrete(getattr(self, name)) and not getattr(self, name) > 0:
                raise ValueError(f"Sensor.{name} must be above 0; got {getattr(self, name)}. Give 1 where it is none.")

    def respond(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return f(x)."""
        return jnp.where(x > TOE, self._power(jnp.where(x > TOE, x, TOE)), x * (self._power(jnp.asarray(TOE)) / TOE))

    def _power(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        return jnp.exp((1.0 / self.gamma + self.bend * x) * jnp.log(x))

    def gains(self, grey: Any) -> tuple[Any, Any, Any]:
        """Return the gain of each channel; a grey photograph has none."""
        return jnp.where(grey, 1.0, self.red), 1.0, jnp.where(grey, 1.0, self.blue)


def linear_level(sensor: Sensor, y: np.ndarray) -> np.ndarray:
    """Return x with f(x) = y, the inverse of the response; it is a table's where the response is bent."""
    y = np.asarray(y, np.float64)
    at_toe = float(sensor.respond(jnp.asarray(TOE)))
    bright = np.maximum(y, at_toe)
    if float(sensor.bend) == 0.0:
        x = bright ** float(sensor.gamma)
    else:
        table = np.geomspace(TOE, max(2.0, 2.0 * float(bright.max(initial=0.0)) ** float(sensor.gamma)), BENT)
        f = np.maximum.accumulate(np.asarray(sensor.respond(jnp.asarray(table))))
        x = np.interp(bright, f, table)
    return np.where(y > at_toe, x, y * (TOE / at_toe))


def falloff(
    vignetting: Vignetting,
    projection: Projection,
    half_diagonal: Any,
    row: Float[Array, "..."],
    column: Float[Array, "..."],
) -> Float[Array, "..."]:
    """Return V at pixels, given half the image's diagonal in pixels."""
    column, row = column + 0.5, row + 0.5
    direction = projection.direction + projection.direction_column * column + projection.direction_row * row
    depth = -dot(direction, projection.backward)
    origin = projection.origin + projection.origin_column * column + projection.origin_row * row
    aside = (origin - projection.eye) + direction * (1.0 / depth)
    squared = dot(aside, aside) - dot(aside, projection.backward) ** 2
    pixel = length(projection.origin_column + projection.direction_column * (1.0 / depth))
    r2 = squared / (pixel * half_diagonal) ** 2
    cosine = depth / length(direction)
    return cosine**vignetting.cosine * (1.0 + vignetting.second * r2 + vignetting.fourth * r2**2)
