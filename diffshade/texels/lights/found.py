"""Found lights: the result of `find_lights`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from ...core.tables import as_text, cells
from ...core.words import Note, count
from ...model.scenes import Scene

SHOWN = 8  # lights in the table, those that moved most


@dataclass(frozen=True, eq=False)
class FoundLights:
    """Lights that agree with all texels of an object; `print` it for the lights that moved most, and the notes."""

    scene: Scene = field(repr=False)
    """The scene with these lights, for `fit_texels` and `fit`."""
    directions: Float[np.ndarray, "lights 3"]
    """Unit vectors towards the lights, from the middle of the object; NaN for lights on in no view."""
    errors: Float[np.ndarray, " lights"]
    """Standard error of each direction about each axis, degrees; infinite where no direction was stated."""
    own_errors: Float[np.ndarray, " lights"]
    """The part of it that is not shared by all lights: by the photographs alone."""
    intensities: Float[np.ndarray, " lights"]
    """The intensity of each light over the scene's; 1 on average."""
    intensity_errors: Float[np.ndarray, " lights"]
    """Their relative standard errors; 0 where the scene's were taken to be exact."""
    moved: Float[np.ndarray, " lights"]
    """How far each light is from where the scene has it, degrees."""
    light_of: Int[np.ndarray, " views"]
    """The light that is on in each view."""
    misfit: float
    """Typical residual of a texel, relative to its brightness; NaN where the lights stay as they were given."""
    settled: bool
    """Whether the lights stayed where they were at the end."""
    notes: tuple[Note, ...]
    """What the photographs do not tell of the lights: a sentence each."""

    @property
    def light_error(self) -> Float[np.ndarray, " lights"]:
        """The error of each light, degrees, for `fit_texels(..., light_error=)`; 0 of one that is on in no view.

        `fit_texels` takes them as independent of each other, which what all lights share is not.
        Where no direction was stated, that of each light by itself: what all share cannot be known.
        """
        errors = np.where(np.isfinite(self.errors), self.errors, self.own_errors)
        return np.where(np.isin(np.arange(len(errors)), self.light_of), errors, 0.0)

    def __str__(self) -> str:
        """Return the lights that moved most, and the notes below them."""
        used = np.unique(self.light_of)
        shown = used[np.argsort(-self.moved[used])][:SHOWN]
        errors, own, relative = (of[shown] for of in (self.errors, self.own_errors, self.intensity_errors))
        columns = {
            "light": shown,
            "x y z": cells(self.directions[shown], np.deg2rad(own)[:, None]),
            "error (deg)": cells(errors, errors),
            "moved (deg)": cells(self.moved[shown], own),
            "intensity": cells(self.intensities[shown], relative),
            "error (%)": cells(100.0 * relative, 100.0 * relative),
        }
        title = (
            f"{count(len(used), 'light')}, moved by {np.median(self.moved[used]):.2f} degrees in the median and by "
            f"{self.moved[used].max():.2f} at most"
        )
        if not np.isnan(self.misfit):
            title += f"; the misfit of a texel is {100 * self.misfit:.2g} %"
        rest = len(used) - len(shown)
        return as_text(
            title, columns, *([f"and {count(rest, 'light')} that moved less"] * (rest > 0)), notes=self.notes
        )


def notes_on(
    *, stated: bool, exact_directions: bool, exact_intensities: bool, shared: float, settled: bool, spread: float
) -> Sequence[Note]:
    """Return what the photographs do not tell of the lights.

    Args:
        stated: Whether directions were stated.
        exact_directions: Whether they are exact.
        exact_intensities: Whether the intensities are.
        shared: Error of what all lights share, degrees.
        settled: Whether the lights stayed where they were.
        spread: Root mean square of the intensities' logarithms.
    """
    found = []
    if not exact_directions:
        kind = "an orthogonal map (3 numbers)" if exact_intensities else "a linear map (9 numbers)"
        map_ = (
            f"a matte object shows the same if all lights and all normals are changed together by {kind}; so do, "
            "almost, all that a model leaves out."
        )
        if stated:
            found.append(
                f"{map_} That map is taken from the stated directions, not from the photographs, and known to "
                f"{shared:.2g} degrees."
            )
        else:
            left = (
                "leaves only whether the surface bulges or is hollow, and it was taken to bulge"
                if exact_intensities
                else "leaves the generalised bas-relief (3 numbers: depth and two tilts), and the one was taken whose "
                "lights are most equally bright"
            )
            found.append(
                f"{map_} That the normals are those of a surface {left}. How far all lights are off together cannot "
                "be known from these photographs: give directions with light_error=."
            )
    if not exact_intensities:
        found.append(
            "the mean intensity and k_d scale each other: the mean of the intensities is the scene's. They differ from "
            f"it by {100 * spread:.2g} %."
        )
    if not settled:
        found.append("the lights had not settled after the last round: their errors are too small.")
    return [Note(text, "lights") for text in found]
