"""Lights: what arrives at a point. A light knows no material."""

import abc
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .attenuation import RadialAttenuation, angular_attenuation
from .fields import Array, Checked, Colour, Scalar, Vector, as_colour, as_scalar, as_vector, check_kind, is_concrete
from .vectors import Vec3, dot, length, normalize


class Path(NamedTuple):
    """How light reaches a point: what its geometry alone decides."""

    l: Vec3
    """Unit direction from the point to the light."""
    d: Float[Array, "..."] | None
    """Distance to the light; None at infinity."""
    f_ang: Float[Array, "..."] | None
    """Angular attenuation (E3); None where it is 1."""


class AbstractLight(Checked):
    """A light is one function of the point it shines on."""

    @property
    @abc.abstractmethod
    def is_local(self) -> bool:
        """Whether the light stands somewhere, so that it must know where the point is."""

    @abc.abstractmethod
    def path(self, p: Vec3 | None) -> Path:
        """Return how light reaches the point p; None, position unknown, is enough for a light that is not local."""

    @abc.abstractmethod
    def arriving(self, p: Vec3 | None) -> tuple[Vec3, Vec3]:
        """Return the unit direction l from the point p to the light, and the RGB intensity f_rad f_ang I_l there."""


class PointLight(AbstractLight):
    """A light at a position that shines equally to all sides, attenuated with distance (E2).

    `position`: scene units. `intensity`: RGB or grey, at least 0, a plain multiplier. At the light itself (d = 0) it
    gives nothing.
    """

    position: Vector = eqx.field(converter=as_vector)
    intensity: Colour = eqx.field(converter=as_colour, default=1.0, metadata={"lower": 0})
    attenuation: RadialAttenuation = eqx.field(default_factory=RadialAttenuation)

    def check_together(self) -> None:
        check_kind("PointLight.attenuation", self.attenuation, RadialAttenuation, "RadialAttenuation(1, 0, 0)")

    @property
    def is_local(self) -> bool:
        """True."""
        return True

    def path(self, p: Vec3 | None) -> Path:
        """Return l = (position - p)/d and d."""
        assert p is not None
        to_light = Vec3.of(self.position) - p
        return Path(normalize(to_light), length(to_light), None)

    def arriving(self, p: Vec3 | None) -> tuple[Vec3, Vec3]:
        """Return l and f_rad(d) I_l."""
        l, d, _ = self.path(p)
        assert d is not None
        return l, Vec3.of(self.intensity) * self.attenuation(d)


class DirectionalLight(AbstractLight):
    """A light at infinity, so that l = -direction/|direction| everywhere.

    `direction`: the way its light travels, of any length but 0. It has no distance and so no attenuation (E2).
    """

    direction: Vector = eqx.field(converter=as_vector)
    intensity: Colour = eqx.field(converter=as_colour, default=1.0, metadata={"lower": 0})

    def check_together(self) -> None:
        check_direction("DirectionalLight.direction", self.direction)

    @property
    def is_local(self) -> bool:
        """False."""
        return False

    def path(self, p: Vec3 | None) -> Path:
        """Return l = -direction/|direction|, the same at every point."""
        return Path(-normalize(Vec3.of(self.direction)), None, None)

    def arriving(self, p: Vec3 | None) -> tuple[Vec3, Vec3]:
        """Return l and I_l, the same at every point."""
        return self.path(p).l, Vec3.of(self.intensity)


class SpotLight(AbstractLight):
    """A point light that shines into a cone about `direction` (E3), attenuated with distance (E2).

    `cutoff`: half angle of the cone, 0 to 90 degrees. `exponent`: of cos^exponent phi off the axis, at least 0.
    `softness`: width in degrees of the smooth edge inside the cutoff, 0 (the hard edge) to `cutoff`; the cutoff can be
    fitted only if it is above 0.
    """

    position: Vector = eqx.field(converter=as_vector)
    direction: Vector = eqx.field(converter=as_vector)
    intensity: Colour = eqx.field(converter=as_colour, default=1.0, metadata={"lower": 0})
    cutoff: Scalar = eqx.field(converter=as_scalar, default=45.0, metadata={"lower": 0, "upper": 90})
    exponent: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0})
    attenuation: RadialAttenuation = eqx.field(default_factory=RadialAttenuation)
    softness: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0, "upper": 90})

    def check_together(self) -> None:
        check_direction("SpotLight.direction", self.direction)
        check_kind("SpotLight.attenuation", self.attenuation, RadialAttenuation, "RadialAttenuation(1, 0, 0)")
        if is_concrete(self.softness, self.cutoff) and self.softness > self.cutoff:
            raise ValueError(
                f"SpotLight.softness must be at most cutoff; got {self.softness} with cutoff {self.cutoff}. "
                "Make softness smaller or the cutoff larger."
            )

    @property
    def is_local(self) -> bool:
        """True."""
        return True

    def path(self, p: Vec3 | None) -> Path:
        """Return l = (position - p)/d, d and f_ang(phi), with cos phi = -l . direction."""
        assert p is not None
        to_light = Vec3.of(self.position) - p
        l = normalize(to_light)
        cos_phi = -dot(l, normalize(Vec3.of(self.direction)))
        return Path(l, length(to_light), angular_attenuation(cos_phi, self.cutoff, self.exponent, self.softness))

    def arriving(self, p: Vec3 | None) -> tuple[Vec3, Vec3]:
        """Return l and f_rad(d) f_ang(phi) I_l."""
        l, d, f_ang = self.path(p)
        assert d is not None
        assert f_ang is not None
        return l, Vec3.of(self.intensity) * (self.attenuation(d) * f_ang)


def check_direction(name: str, direction: Vector) -> None:
    """Refuse a direction of length 0."""
    if is_concrete(direction) and not np.any(direction):
        raise ValueError(f"{name} must not be the zero vector; got [0, 0, 0]. Give the way the light travels.")
