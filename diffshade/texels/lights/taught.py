"""Taught: what texels of an object teach, and how its photographs were found to differ from what is said of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...core.words import Note
from ...inverse.data.views import View
from ...model.scenes import Scene
from ..lighting import Exposures, LightErrors, Shifts, lighting_setup
from ..robust.choice import errors_of_shared, fewer
from ..robust.learning import Assumptions, ObjectModel
from ..robust.run import RobustRun
from ..tiles import TexelTile


class Taught(NamedTuple):
    """What a sample of the texels of an object has taught, with what was found of the photographs undone."""

    scene: Scene
    """One object and its lights."""
    views: Sequence[View]
    run: RobustRun
    models: Sequence[ObjectModel]
    """Of the object's regions."""
    sample: TexelTile
    shifts: Shifts | None = None
    exposures: Exposures | None = None
    level: float = 0.0
    """What all photographs show beside the object's light."""
    notes: tuple[Note, ...] = ()
    """What was found, in words."""

    def under(
        self,
        scene: Scene,
        views: Sequence[View],
        *,
        sample: TexelTile | None = None,
        light_error: LightErrors | None = None,
        assumed: Assumptions | None = None,
    ) -> Taught:
        """Return what the same object teaches where its photographs, or what is said of them, are others."""
        run, sample = self.run.under(lighting_setup(scene, views), light_error), sample or self.sample
        return self._replace(scene=scene, views=views, run=run, models=run.learn(sample, assumed), sample=sample)

    def noted(self, *notes: Note) -> Taught:
        """Return the same with more notes."""
        return self._replace(notes=(*self.notes, *notes))

    @property
    def errors(self) -> Float[np.ndarray, " views"]:
        """How far each photograph is from what the others predict."""
        return errors_of_shared(self.run, fewer(self.sample), self.models)

    @property
    def misfit(self) -> float:
        """The typical residual, relative to the level of a texel."""
        return float(np.mean([model.relative_misfit for model in self.models]))
