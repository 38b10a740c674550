"""Area lights: a rectangle that shines, as a grid of spots (E11)."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..core.fields import Colour, Scalar, Vector, as_colour, as_scalar, as_vector, is_concrete, parameter
from .attenuation import AbstractAttenuation, RadialAttenuation, check_attenuation
from .flaps import Flaps, check_flaps
from .lights import AbstractLight, SpotLight
from .vectors import Vec3, along_one_line, cross


def as_counts(value: Any) -> Any:
    """Make (n_u, n_v) of one number or two; any other value is returned unchanged for the check to refuse."""
    try:
        if np.asarray(value).dtype == bool:
            return value
        n_u, n_v = (value, value) if np.ndim(value) == 0 else value
        return (int(n_u), int(n_v)) if (n_u, n_v) == (int(n_u), int(n_v)) else value
    except (TypeError, ValueError, OverflowError):
        return value


class AreaLight(AbstractLight):
    r"""A rectangle that shines to the side of edge_u x edge_v: a grid of spot emitters (E11; Warn 1983).

    $$ \sum_i f_{rad}(d_i) f_{ang}(\phi_i) I_l / n_u n_v $$

    This intensity arrives at a point. The emitters are at the centres of n_u by n_v cells and share the intensity
    equally. Each is a `SpotLight` along edge_u x edge_v, attenuated with its own distance. As the number of samples
    grows, the light converges to that of the continuous rectangle.

    Args:
        corner: One corner, scene units.
        edge_u: First edge from the corner, scene units.
        edge_v: Second edge from the corner, scene units, not along `edge_u`; edges that are not at right angles span a
            parallelogram.
        intensity: I_l of the whole light, RGB or grey, a plain multiplier, at least 0; 1 by default.
        cutoff: Half angle of each emitter, degrees, 0 to 90; 90 by default.
        exponent: Exponent of each emitter, at least 0; 1 by default.
        attenuation: Law of radial attenuation f_rad; none by default.
        samples: (n_u, n_v), whole numbers above 0, or one number for both; (8, 8) by default.
        ambient: The light's own ambient colour, RGB or grey, at least 0, which k_a reflects wherever the light reaches,
            whichever way the surface faces, attenuated as the light is; none by default.
        specular: Colour of the light's highlights, RGB or grey, at least 0; `intensity` by default.
        flaps: Planes across the axes of the world between which every emitter shines; none by default.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range, or the edges are along one line.
        TypeError: A value is of the wrong kind.
    """

    corner: Vector = eqx.field(converter=as_vector, metadata=parameter("position"))
    edge_u: Vector = eqx.field(converter=as_vector, metadata=parameter("edge"))
    edge_v: Vector = eqx.field(converter=as_vector, metadata=parameter("edge"))
    intensity: Colour = eqx.field(converter=as_colour, default=1.0, metadata=parameter("light", lower=0, gauge=-1))
    cutoff: Scalar = eqx.field(converter=as_scalar, default=90.0, metadata={"lower": 0, "upper": 90})
    exponent: Scalar = eqx.field(converter=as_scalar, default=1.0, metadata={"lower": 0})
    attenuation: AbstractAttenuation = eqx.field(default_factory=RadialAttenuation)
    samples: tuple[int, int] = eqx.field(converter=as_counts, static=True, default=(8, 8))
    flaps: Flaps | None = eqx.field(kw_only=True, default=None)

    def check_together(self) -> None:
        check_attenuation(self)
        check_flaps(self)
        counts = self.samples
        if not (isinstance(counts, tuple) and len(counts) == 2 and all(type(n) is int and n > 0 for n in counts)):
            raise ValueError(
                f"AreaLight.samples must be two whole numbers above 0; got {counts!r}. Give (8, 8), or 8 for both."
            )
        if is_concrete(self.edge_u, self.edge_v) and along_one_line(self.edge_u, self.edge_v):
            raise ValueError(
                f"AreaLight.edge_u and edge_v must span a rectangle; got {self.edge_u} and {self.edge_v}. "
                "Give two edges that are not along one line."
            )

    @property
    def is_local(self) -> bool:
        """True."""
        return True

    def emitters(self) -> SpotLight:
        """Return the n_u n_v spots, as a stack."""
        n_u, n_v = self.samples
        u, v = np.divmod(np.arange(n_u * n_v), n_v)
        u, v = (u + 0.5) / n_u, (v + 0.5) / n_v
        axis = cross(Vec3.of(self.edge_u), Vec3.of(self.edge_v)).stack()

        def at(u: Scalar, v: Scalar) -> SpotLight:
            position = self.corner + u * self.edge_u + v * self.edge_v
            share = self.intensity / (n_u * n_v)
            return SpotLight(position, axis, share, self.cutoff, self.exponent, self.attenuation, flaps=self.flaps)

        return jax.vmap(at)(u, v)
