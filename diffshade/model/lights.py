"""Lights: the light that arrives at a point. Lights do not depend on materials."""

from __future__ import annotations

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import (
    Array,
    Checked,
    Colour,
    Scalar,
    Vector,
    as_colour,
    as_scalar,
    as_vector,
    is_concrete,
    parameter,
)
from .attenuation import AbstractAttenuation, RadialAttenuation, angular_attenuation, check_attenuation
from .flaps import Flaps, check_flaps, confined
from .vectors import Vec3, dot, length, normalize


class Path(NamedTuple):
    """How light reaches a point: what its geometry alone decides."""

    l: Vec3
    """Unit direction from the point to the light."""
    d: Float[Array, "..."] | None
    """Distance to the light; None at infinity."""
    f_ang: Float[Array, "..."] | None
    """Angular attenuation (E3), or any factor that depends on the point alone; None where it is 1."""


class AbstractLight(Checked):
    """A light source: one emitter or many.

    What arrives is proportional to its field `intensity`. Where `ambient` or `specular` is given, its colours are apart
    as OpenGL's are: k_a ambient + k_d (n.l)_+ intensity + W (cos)_+^n_s specular, all attenuated alike.
    """

    ambient: Colour | None = eqx.field(
        kw_only=True, converter=as_colour, default=None, metadata=parameter("light", lower=0, gauge=-1)
    )
    specular: Colour | None = eqx.field(
        kw_only=True, converter=as_colour, default=None, metadata=parameter("light", lower=0, gauge=-1)
    )

    @property
    def has_one_colour(self) -> bool:
        """Whether its intensity is the colour of all that it sends."""
        return self.ambient is None and self.specular is None

    @property
    @abc.abstractmethod
    def is_local(self) -> bool:
        """Whether the light has a position, so that it needs the position of the point it illuminates."""

    @property
    def is_factored(self) -> bool:
        """Whether what arrives is I_l f_rad f_ang, with f_rad that of its `attenuation`, or 1, and f_ang of its path.

        Fits of such lights are faster, and never call `arriving`; say False where `arriving` does anything else.
        """
        return False

    @property
    def placement(self) -> tuple[str, ...]:
        """The names of the fields that say where the light is, first, and where it points; none if nothing is known.

        Only where a `direction` points may matter, not its length.
        """
        return ()

    @abc.abstractmethod
    def emitters(self) -> AbstractEmitter:
        """Return the emitters that the light consists of, as a stack: one whose leaves have a leading axis.

        A light is open to users as an emitter (see `AbstractEmitter`), or as a number of emitters that this method
        makes: a line is some spot or point lights along it, each with its share of the intensity.

        Returns:
            The stack.
        """

    def bare(self) -> AbstractEmitter:
        """Return an emitter of unit intensity in the same place that nothing attenuates; of several, in their middle.

        Returns:
            The emitter.
        """
        return jax.tree.map(lambda leaf: np.mean(np.asarray(leaf), 0), self.emitters()).bare()


class AbstractEmitter(AbstractLight):
    """A light that reaches each point from one direction."""

    @abc.abstractmethod
    def path(self, p: Vec3 | None) -> Path:
        """Return how light reaches a point.

        Args:
            p: The point, scene units; None (position unknown) is enough for a light that is not local.

        Returns:
            Direction, distance and angular attenuation.
        """

    @abc.abstractmethod
    def arriving(self, p: Vec3 | None) -> tuple[Vec3, Vec3]:
        """Return the direction and the intensity of the light that arrives at a point.

        Args:
            p: The point, scene units; None (position unknown) is enough for a light that is not local.

        Returns:
            The unit direction l from the point to the light, and the RGB intensity f_rad f_ang I_l there.
        """

    def emitters(self) -> AbstractEmitter:
        """Return the emitter itself, as a stack of one."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], self)

    def bare(self) -> AbstractEmitter:
        """Return an emitter of unit intensity whose light comes from the same directions."""
        return BareLight(self)


class BareLight(AbstractEmitter):
    """A light of unit intensity that nothing attenuates, whose light comes from where another's does."""

    light: AbstractEmitter
    intensity: ClassVar[Colour] = np.ones(3)

    @property
    def is_local(self) -> bool:
        """As the other."""
        return self.light.is_local

    def path(self, p: Vec3 | None) -> Path:
        """As the other."""
        return self.light.path(p)

    def arriving(self, p: Vec3 | None) -> tuple[Vec3, Vec3]:
        """Return l and 1."""
        return self.path(p).l, Vec3.of(np.ones(3))


class AbstractLamp(AbstractEmitter):
    """An emitter with a position: what arrives is I_l f_rad f_ang, with its `attenuation` and the f_ang of its path."""

    position: eqx.AbstractVar[Vector]

    def check_together(self) -> None:
        check_attenuation(self)

    @property
    def is_local(self) -> bool:
        """True."""
        return True

    @property
    def is_factored(self) -> bool:
        """True."""
        return True

    @property
    def placement(self) -> tuple[str, ...]:
        """Its position."""
        return ("position",)

    def bare(self) -> AbstractEmitter:
        """Return a point light there of intensity 1, not attenuated."""
        return PointLight(self.position)

    def arriving(self, p: Vec3 | None) -> tuple[Vec3, Vec3]:
        """Return l and f_rad(d) f_ang I_l."""
        lamp: Any = self  # its intensity and attenuation are fields; declared here they would precede its own
        l, d, f_ang = self.path(p)
        f_rad = lamp.attenuation(d)
        return l, Vec3.of(lamp.intensity) * (f_rad if f_ang is None else f_rad * f_ang)


class PointLight(AbstractLamp):
    r"""A light at a position that shines equally in all directions, attenuated with distance (E2).

    $$ l = (position - p) / d, \qquad f_{rad}(d) I_l $$

    These are the direction to the light from a point p at distance d, and the intensity that arrives there. At the
    light itself (d = 0) it contributes nothing.

    Args:
        position: Position of the light, scene units.
        intensity: I_l, RGB or grey, a plain multiplier, at least 0; 1 by default.
        attenuation: Law of radial attenuation f_rad; none by default.
        ambient: The light's own ambient colour, RGB or grey, at least 0, which k_a reflects wherever the light reaches,
            whichever way the surface faces, attenuated as the light is; none by default.
        specular: Colour of the light's highlights, RGB or grey, at least 0; `intensity` by default.
        flaps: Planes across the axes of the world between which the light shines; none by default.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range.
        TypeError: A value is of the wrong kind.
    """

    position: Vector = eqx.field(converter=as_vector, metadata=parameter("position"))
    intensity: Colour = eqx.field(converter=as_colour, default=1.0, metadata=parameter("light", lower=0, gauge=-1))
    attenuation: AbstractAttenuation = eqx.field(default_factory=RadialAttenuation)
    flaps: Flaps | None = eqx.field(kw_only=True, default=None)

    def check_together(self) -> None:
        super().check_together()
        check_flaps(self)

    def path(self, p: Vec3 | None) -> Path:
        """Return l = (position - p)/d, d and the factor of the flaps."""
        assert p is not None
        to_light = Vec3.of(self.position) - p
        return Path(normalize(to_light), length(to_light), confined(None, self.flaps, p))


class DirectionalLight(AbstractEmitter):
    """A light at infinity: l is the same everywhere and nothing fades.

    $$ l = -direction / |direction| $$

    It has no distance and therefore no attenuation (E2).

    Args:
        direction: Direction in which the light travels, of any length except 0.
        intensity: I_l, RGB or grey, a plain multiplier, at least 0; 1 by default.
        ambient: The light's own ambient colour, RGB or grey, at least 0, which k_a reflects wherever the light reaches,
            whichever way the surface faces, attenuated as the light is; none by default.
        specular: Colour of the light's highlights, RGB or grey, at least 0; `intensity` by default.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range, or the direction is the zero
            vector.
        TypeError: A value is of the wrong kind.
    """

    direction: Vector = eqx.field(converter=as_vector, metadata=parameter("direction"))
    intensity: Colour = eqx.field(converter=as_colour, default=1.0, metadata=parameter("light", lower=0, gauge=-1))

    @property
    def is_local(self) -> bool:
        """False."""
        return False

    @property
    def is_factored(self) -> bool:
        """True."""
        return True

    @property
    def placement(self) -> tuple[str, ...]:
        """Its direction."""
        return ("direction",)

    def bare(self) -> AbstractEmitter:
        """Return a directional light of intensity 1, not attenuated."""
        return DirectionalLight(self.direction)

    def path(self, p: Vec3 | None) -> Path:
        """Return l = -direction/|direction|, the same at every point."""
        return Path(-normalize(Vec3.of(self.direction)), None, None)

    def arriving(self, p: Vec3 | None) -> tuple[Vec3, Vec3]:
        """Return l and I_l, the same at every point."""
        return self.path(p).l, Vec3.of(self.intensity)


class SpotLight(AbstractLamp):
    r"""A point light that shines into a cone around `direction`, attenuated with distance (E2, E3; Warn 1983).

    $$ f_{ang} = \cos^a \phi \; S(\cos\phi) \text{ where } \phi \le cutoff, \text{ else } 0 $$

    phi is the angle between the direction and the ray to the point: $\cos\phi = -l \cdot direction$. S is 1 or, with
    softness, the smooth step from cos(cutoff) to cos(cutoff - softness).

    Args:
        position: Position of the light, scene units.
        direction: Direction in which the light travels, of any length except 0.
        intensity: I_l, RGB or grey, a plain multiplier, at least 0; 1 by default.
        cutoff: Half angle of the cone, degrees, 0 to 90; 45 by default. It can be fitted only if `softness` is above 0.
        exponent: a, at least 0; 0 by default.
        attenuation: Law of radial attenuation f_rad; none by default.
        softness: Width of the smooth edge inside the cutoff, degrees, 0 to `cutoff`; 0 (a hard edge) by default.
        ambient: The light's own ambient colour, RGB or grey, at least 0, which k_a reflects wherever the light reaches,
            whichever way the surface faces, attenuated as the light is; none by default.
        specular: Colour of the light's highlights, RGB or grey, at least 0; `intensity` by default.
        flaps: Planes across the axes of the world between which the light shines; none by default.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range, or the direction is the zero
            vector.
        TypeError: A value is of the wrong kind.
    """

    position: Vector = eqx.field(converter=as_vector, metadata=parameter("position"))
    direction: Vector = eqx.field(converter=as_vector, metadata=parameter("direction"))
    intensity: Colour = eqx.field(converter=as_colour, default=1.0, metadata=parameter("light", lower=0, gauge=-1))
    cutoff: Scalar = eqx.field(converter=as_scalar, default=45.0, metadata={"lower": 0, "upper": 90})
    exponent: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0})
    attenuation: AbstractAttenuation = eqx.field(default_factory=RadialAttenuation)
    softness: Scalar = eqx.field(converter=as_scalar, default=0.0, metadata={"lower": 0, "upper": 90})
    flaps: Flaps | None = eqx.field(kw_only=True, default=None)

    def check_together(self) -> None:
        super().check_together()
        check_flaps(self)
        if is_concrete(self.softness, self.cutoff) and self.softness > self.cutoff:
            raise ValueError(
                f"SpotLight.softness must be at most cutoff; got {self.softness} with cutoff {self.cutoff}. "
                "Make softness smaller or the cutoff larger."
            )

    @property
    def placement(self) -> tuple[str, ...]:
        """Its position and direction."""
        return ("position", "direction")

    def path(self, p: Vec3 | None) -> Path:
        """Return l = (position - p)/d, d and f_ang(phi) within the flaps, with cos phi = -l . direction."""
        assert p is not None
        to_light = Vec3.of(self.position) - p
        l = normalize(to_light)
        cos_phi = -dot(l, normalize(Vec3.of(self.direction)))
        f_ang = angular_attenuation(cos_phi, self.cutoff, self.exponent, self.softness)
        return Path(l, length(to_light), confined(f_ang, self.flaps, p))
