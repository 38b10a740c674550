"""Measured lights: lamps with a measured intensity over angle, as lamp makers publish it."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..core.fields import (
    Array,
    Checked,
    Colour,
    Vector,
    as_array,
    as_colour,
    as_vector,
    check_kind,
    in_short,
    is_concrete,
    parameter,
)
from ..core.thresholds import NEGLIGIBLE, SLIGHT
from ..core.words import listing
from .attenuation import AbstractAttenuation, RadialAttenuation
from .lights import AbstractLamp, Path
from .photometry import beam_angles, flux, symmetry
from .vectors import Vec3, along_one_line, cross, dot, length, normalize, safe_sqrt


class Profile(Checked):
    """Relative intensity over the angle gamma from a lamp's axis and the angle C around it (LM-63, EULUMDAT).

    The intensity is linear between the entries of the table. At gamma = 0 and 180, where all planes meet, their mean is
    used. At each angle of the table the derivative jumps; there it is that of the side of the larger angle, and 0 at
    the poles. At the ends of `vertical` the intensity jumps to 0, which contributes no derivative.

    Args:
        vertical: Angles gamma, degrees, two or more, increasing, within 0 to 180; beyond them it is dark.
        horizontal: Angles C, degrees, increasing from 0 to 360 with both ends, or a single angle for a lamp that is the
            same all around.
        values: Relative intensities, at least 0; one row per horizontal angle.

    Raises:
        ValueError: The angles are not increasing or are out of their range, or the values have another shape, are not
            finite or are below 0.
    """

    vertical: Float[Array, " v"] = eqx.field(converter=as_array)
    horizontal: Float[Array, " h"] = eqx.field(converter=as_array)
    values: Float[Array, "h v"] = eqx.field(converter=as_array)

    def check_together(self) -> None:
        if not is_concrete(self.vertical, self.horizontal, self.values):
            return
        for name, angles, last in (("vertical", self.vertical, 180.0), ("horizontal", self.horizontal, 360.0)):
            rising = (
                isinstance(angles, Array) and np.ndim(angles) == 1 and np.size(angles) and np.isfinite(angles).all()
            )
            if not rising or (np.diff(angles) <= 0).any() or angles[0] < 0 or angles[-1] > last:
                raise ValueError(
                    f"Profile.{name} must be angles that increase from 0 to at most {last:g} degrees; got "
                    f"{in_short(angles)}. Give them in order, each once."
                )
        if np.size(self.vertical) < 2:
            raise ValueError(
                f"Profile.vertical must hold two angles or more; got {in_short(self.vertical)}. Give the axis and more."
            )
        if np.size(self.horizontal) > 1 and not (self.horizontal[0] == 0 and self.horizontal[-1] == 360):
            raise ValueError(
                f"Profile.horizontal must go from 0 to 360 degrees, with both; got {in_short(self.horizontal)}. Close "
                "the circle, or give one angle for a lamp that is the same all around."
            )
        shape = (np.size(self.horizontal), np.size(self.vertical))
        values = self.values
        if (
            not isinstance(values, Array)
            or np.shape(values) != shape
            or not (np.isfinite(values) & (values >= 0)).all()
        ):
            got = f"shape {np.shape(values)}" if isinstance(values, Array) and np.shape(values) != shape else "others"
            raise ValueError(
                f"Profile.values must be finite numbers of at least 0, {shape[0]} x {shape[1]} (horizontal x "
                f"vertical); got {got}. Give one row a horizontal angle."
            )

    def __call__(self, gamma: Float[Array, "..."], C: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return the relative intensity in a direction.

        Args:
            gamma: Angle from the axis, degrees, 0 to 180.
            C: Angle around the axis, degrees, 0 to 360.

        Returns:
            The relative intensity.
        """
        vertical, values = jnp.asarray(self.vertical), self._one_at_the_poles()
        i, t = _between(vertical, gamma)
        if values.shape[0] == 1:
            found = (1.0 - t) * values[0, i] + t * values[0, i + 1]
        else:
            j, s = _between(jnp.asarray(self.horizontal), C)
            near = (1.0 - t) * values[j, i] + t * values[j, i + 1]
            far = (1.0 - t) * values[j + 1, i] + t * values[j + 1, i + 1]
            found = (1.0 - s) * near + s * far
        # rounding of the last angle is no darkness
        return jnp.where((gamma >= vertical[0] - NEGLIGIBLE) & (gamma <= vertical[-1] + NEGLIGIBLE), found, 0.0)

    def _one_at_the_poles(self) -> Float[Array, "h v"]:
        """Return the values with one number at each pole; without it the slope around the pole would be unbounded."""
        vertical, values = jnp.asarray(self.vertical), jnp.asarray(self.values)
        once = values if values.shape[0] == 1 else values[:-1]  # 360 degrees repeats 0 degrees
        pole = (vertical == 0.0) | (vertical == 180.0)
        return jnp.where(pole[None], jnp.mean(once, 0, keepdims=True), values)


class LampLabel(eqx.Module):
    """Who made a lamp, what it is, and what its file states of it.

    Args:
        maker: The maker.
        name: The luminaire.
        source: The lamps in it.
        watts: Power, None if it is not stated.
        lumens: Flux of the luminaire as stated, None if it is not.
        source_lumens: Flux of its lamps as stated, None if it is not.
        unit: Unit of the intensity; cd by default.
    """

    maker: str = eqx.field(static=True, default="")
    name: str = eqx.field(static=True, default="")
    source: str = eqx.field(static=True, default="")
    watts: float | None = eqx.field(static=True, default=None)
    lumens: float | None = eqx.field(static=True, default=None)
    source_lumens: float | None = eqx.field(static=True, default=None)
    unit: str = eqx.field(static=True, default="cd")


def _beams(vertical: Any, horizontal: Any, values: Any) -> tuple[str, list[str]]:
    """Return the beam angles in words, and what is to be said of them: across C0 and C90, or where the peak is."""
    planes = (0.0,) if len(horizontal) == 1 else (0.0, 90.0)
    beams = {C: beam_angles(vertical, horizontal, values, C) for C in planes}
    if not any(map(len, beams.values())):
        C = float(horizontal[values.max(1).argmax()]) % 180.0
        beams[C] = beam_angles(vertical, horizontal, values, C)
    of_plane = {C: f" across C{C:g}" if len(horizontal) > 1 else "" for C in beams}
    words = [(" + ".join(f"{beam:.3g}" for beam in beams[C]) or "-") + of_plane[C] for C in beams]
    said = []
    for C, lobes in beams.items():
        where = f"Across C{C:g} " if len(horizontal) > 1 else ""
        if not values.any():
            said = ["The lamp is dark in all directions, so that it has no beam angle."]
        elif len(lobes) == 0:
            said.append(f"{where}no direction reaches half of the peak, so that no beam angle is defined there.")
        elif len(lobes) > 1:
            said.append(f"{where}{len(lobes)} lobes reach half of the peak, each with a beam angle of its own.")
    return listing(words), said


class MeasuredLight(AbstractLamp):
    r"""A point light with a measured beam, `profile`, around `direction`, attenuated with distance (E2).

    $$ f_{rad}(d) \, profile(\gamma, C) \, I_l $$

    This intensity arrives at distance d. C grows counter-clockwise as seen along `direction` from behind the lamp (type
    C of LM-63, C-planes of EULUMDAT). In a fit the intensity, position and direction can be free; `side` can be free
    only by its own name.

    Args:
        position: Position of the light, scene units.
        direction: Direction of gamma = 0, in which the light travels, of any length except 0.
        profile: Relative intensity over angle.
        intensity: I_l, RGB or grey, a plain multiplier, at least 0; 1 by default.
        attenuation: Law of radial attenuation f_rad; none by default.
        side: Vector on the side of C = 0, not along `direction`; its component along `direction` is ignored; (1, 0, 0)
            by default.
        label: Who made it and what its file states; nothing by default.
        ambient: The light's own ambient colour, RGB or grey, at least 0, which k_a reflects wherever the light reaches,
            whichever way the surface faces, attenuated as the light is; none by default.
        specular: Colour of the light's highlights, RGB or grey, at least 0; `intensity` by default.

    Raises:
        ValueError: A value has the wrong shape, is not finite or is out of its range; the direction is the zero vector;
            or `side` is along it.
        TypeError: A value is of the wrong kind.
    """

    position: Vector = eqx.field(converter=as_vector, metadata=parameter("position"))
    direction: Vector = eqx.field(converter=as_vector, metadata=parameter("direction"))
    profile: Profile
    intensity: Colour = eqx.field(converter=as_colour, default=1.0, metadata=parameter("light", lower=0, gauge=-1))
    attenuation: AbstractAttenuation = eqx.field(default_factory=RadialAttenuation)
    side: Vector = eqx.field(
        converter=as_vector, default=(1.0, 0.0, 0.0), metadata=parameter("direction", by_own_name=True)
    )
    label: LampLabel = eqx.field(default_factory=LampLabel)

    def __str__(self) -> str:
        """Return a summary: name, flux, peak, beam, efficacy and symmetry, and where the file contradicts itself."""
        profile = self.profile
        if not is_concrete(self.intensity, profile.vertical, profile.horizontal, profile.values):
            return repr(self)
        about, unit = self.label, self.label.unit
        whole = "lm" if unit == "cd" else unit.removesuffix("/sr")
        vertical, horizontal = (np.asarray(a, np.float64) for a in (profile.vertical, profile.horizontal))
        values = np.asarray(profile.values, np.float64) * float(np.mean(self.intensity))
        lumens, highest = flux(vertical, horizontal, values), np.unravel_index(values.argmax(), values.shape)
        lines = [", ".join(word for word in (about.maker, about.name, about.source) if word) or "a lamp"]
        stated = [f"{about.lumens:.4g} {whole} stated"] if about.lumens else []
        stated += [f"{about.source_lumens:.4g} {whole} of its lamps"] if about.source_lumens else []
        lines.append(f"flux        {lumens:.4g} {whole} integrated" + "".join(f", {of}" for of in stated))
        at = f"gamma {vertical[highest[1]]:g}" + (f", C {horizontal[highest[0]]:g}" if len(horizontal) > 1 else "")
        lines.append(f"peak        {values.max():.4g} {unit} at {at}")
        beams, of_beams = _beams(vertical, horizontal, values)
        lines.append(f"beam angle  {beams} degrees")
        if about.watts:
            lines.append(f"power       {about.watts:.4g} W, {lumens / about.watts:.3g} {whole}/W")
        lines.append(f"symmetry    {symmetry(horizontal, values)}")
        return "\n".join([*lines, *of_beams, *self._contradictions(lumens, whole)])

    def _contradictions(self, lumens: float, whole: str) -> list[str]:
        """Return where the flux is other than stated."""
        stated, lamps = self.label.lumens, self.label.source_lumens
        if stated and abs(lumens / stated - 1.0) > SLIGHT:
            share = 100 * (lumens / stated - 1.0)
            return [
                f"The file contradicts itself: its table is {share:+.2g} % off the {stated:.4g} {whole} that it states."
            ]
        if lamps and lumens > (1.0 + SLIGHT) * lamps:
            return [f"The file contradicts itself: its table has more than the {lamps:.4g} {whole} of its lamps."]
        return []

    def check_together(self) -> None:
        super().check_together()
        check_kind("MeasuredLight.profile", self.profile, Profile, "Profile([0, 90], [0], [[1, 0]])")
        check_kind("MeasuredLight.label", self.label, LampLabel, "LampLabel()")
        if is_concrete(self.side, self.direction) and along_one_line(self.side, self.direction):
            raise ValueError(
                f"MeasuredLight.side must not be along direction; got {in_short(self.side)} with direction "
                f"{in_short(self.direction)}. Give the side to which the plane C = 0 points."
            )

    @property
    def placement(self) -> tuple[str, ...]:
        """Its position and direction."""
        return ("position", "direction")

    def path(self, p: Vec3 | None) -> Path:
        """Return l = (position - p)/d, d and profile(gamma, C) in the direction from the lamp to p."""
        assert p is not None
        to_light = Vec3.of(self.position) - p
        l = normalize(to_light)
        axis, side = normalize(Vec3.of(self.direction)), Vec3.of(self.side)
        x = normalize(side - axis * dot(side, axis))
        y = cross(x, axis)
        along, across, up = -dot(l, axis), -dot(l, x), -dot(l, y)
        sine = safe_sqrt(across * across + up * up)
        off, somewhere = sine > 0, (sine > 0) | (along != 0)  # atan2(0, 0) has no derivative
        gamma = jnp.arctan2(sine, jnp.where(somewhere, along, 1.0))
        C = jnp.arctan2(jnp.where(off, up, 0.0), jnp.where(off, across, 1.0))
        C = jnp.rad2deg(jnp.where(C < 0, C + 2.0 * jnp.pi, C))
        return Path(l, length(to_light), self.profile(jnp.rad2deg(gamma), C))


def _between(angles: Float[Array, " n"], x: Float[Array, "..."]) -> tuple[Array, Float[Array, "..."]]:
    """Return the interval of a table that contains x, and the position of x within it, 0 to 1."""
    i = jnp.clip(jnp.searchsorted(angles, x, side="right") - 1, 0, angles.shape[0] - 2)
    t = (x - angles[i]) / (angles[i + 1] - angles[i])
    return i, jnp.where(t > 0.0, jnp.where(t < 1.0, t, 1.0), 0.0)
