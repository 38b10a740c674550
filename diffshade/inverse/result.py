"""Result: the fitted numbers, their errors, and in words what is not known about them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from ..core.backend import in_float64
from ..core.tables import as_text, parameters
from ..core.words import Note, count
from ..model.materials import Material
from ..model.scenes import Scene
from .data.recording import photograph
from .data.samples import find_samples
from .data.view_sets import Counts, ViewSet
from .data.views import View, has_mask
from .forward.losses import Likelihood
from .forward.rounding import Rounding
from .problem import moves_surface
from .solved import Solved
from .statistics.clusters import Clusters
from .statistics.evidence import Evidence
from .statistics.gauges import taken_as_exact
from .unknowns.slots import values_in
from .unknowns.unknown import Unknown


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of a fit; `print` it for the table. Every array is NumPy float64, one entry an unknown."""

    solved: Solved = field(repr=False)
    """The problem that was solved, from which checks and examinations go on."""
    values: Float[np.ndarray, " p"]
    """The fitted values, in the order of `names`: `dict(zip(fit.names, fit.values))` has them by name."""
    errors: Float[np.ndarray, " p"]
    """Standard errors: the true value lies within 1.96 of them 95 % of the time; infinite if it is not determined.
    They are for independent noise if the views agree within it, else by leaving out one view, with all others of its
    camera and lights, at a time, widened by Student's t (`clusters`). If the images are rounded to steps larger than
    their noise, they include the rounding (`rounding`).
    """
    plain_errors: Float[np.ndarray, " p"]
    """Standard errors sigma^2 (J^T J)^-1 for independent noise, of equal size or as the views' `Noise` says; too small
    on real photographs, whose residuals are correlated. Infinite where nothing is determined."""
    covariance: Float[np.ndarray, "p p"]
    """The plain covariance of the determined unknowns that are not at a bound; 0 elsewhere."""
    determined: Bool[np.ndarray, " p"]
    """False where the images do not determine a number: the Gram is singular there, or the error is lost in it
    (`statistics.identifiability`); or a check of the fit withdrew it (`verdicts`)."""
    at_bound: Bool[np.ndarray, " p"]
    at_lower: Bool[np.ndarray, " p"]
    """At the lower of its bounds; an error at a bound is one-sided, into the range."""
    rmse: float
    """Root mean square residual of the samples that were measured, in the images' units; where the noise of the views
    is given, in units of that noise, so that 1 is expected."""
    condition: float
    """Condition number of the Jacobian with columns of unit length; infinite where it is singular."""
    steps: int
    """Passes over all pixels of the last minimisation; the search and the settling of a scale come before."""
    converged: bool
    costs: Float[np.ndarray, " passes"]
    """The cost at the start of the last minimisation, and the lowest after each of its passes."""
    clusters: Clusters = field(repr=False)
    """The Gram of each view, whether the views agree, and the errors that follow."""
    scales: Float[np.ndarray, " p"]
    """The size with which each value is compared, such as the largest reflection of its object; 0 if there is none."""
    notes: tuple[Note, ...]
    """What these views do not determine, what is at a bound, and what was left out: a sentence each."""

    @property
    def scene(self) -> Scene:
        """The scene with the fitted values; a value that is not `determined` is one of many that fit equally well."""
        return self.solved.problem.scene

    @property
    def views(self) -> tuple[View, ...]:
        """The views, with the fitted exposures and blacks."""
        return self.solved.problem.data.views

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The numbers that were free."""
        return tuple(self.solved.problem.unknowns)

    @property
    def counts(self) -> Counts:
        """How many pixels and samples the fit looked at."""
        return self.solved.problem.data.counts

    @property
    def likelihood(self) -> Likelihood:
        """The loss, and the scale of the residuals that it was used with."""
        return self.solved.problem.model.likelihood

    @property
    def clipped(self) -> str:
        """How clipped samples count, as given to the fit."""
        return self.solved.problem.data.clipped

    @property
    def squares(self) -> float:
        """The weighted sum of squares of the samples, with which residuals are compared."""
        return self.solved.squares

    @property
    def rounding(self) -> Rounding:
        """The steps of the views' files where their rounding adds to the errors, else none."""
        return self.solved.problem.model.setting.rounding

    @property
    def evidence(self) -> Evidence:
        """The Gram of each view: what errors, plans and examinations are made of."""
        return self.clusters.evidence

    @property
    def names(self) -> tuple[str, ...]:
        """A short name of each unknown; a colour's channels end in .r, .g, .b."""
        return tuple(unknown.name for unknown in self.unknowns)

    @property
    def material(self) -> Material:
        """The fitted material of the scene's only object; ValueError where there are several."""
        if len(self.scene.objects) != 1:
            raise ValueError(
                f"this scene has {len(self.scene.objects)} objects, so fit.material is ambiguous. "
                "Use fit.scene.objects[i].material."
            )
        return self.scene.objects[0].material

    @property
    def added_errors(self) -> Float[np.ndarray, " p"]:
        """What the checks of the fit add to the errors by its clusters: stated errors of lights, and faults."""
        known = self.determined
        errors, own = (np.where(known, of, 0.0) for of in (self.errors, self.clusters.wide_errors()))
        return np.sqrt(np.maximum(errors**2 - own**2, 0.0))

    @property
    def correlation(self) -> Float[np.ndarray, "p p"]:
        """Correlations of the unknowns, from the plain covariance; 0 where there is none."""
        errors = np.sqrt(np.diag(self.covariance))
        unit = np.where(errors > 0, 1.0 / np.where(errors > 0, errors, 1.0), 0.0)
        return self.covariance * np.outer(unit, unit)

    def holding(self, held: Bool[np.ndarray, " p"]) -> Fit:
        """Return the fit as if some unknowns had been known; its errors still allow for theirs."""
        free = ~held
        clusters = self.clusters
        unknowns = [unknown for unknown, kept in zip(self.unknowns, free, strict=True) if kept]
        return dataclasses.replace(
            self,
            solved=self.solved.changed(theta=self.solved.theta[free], unknowns=unknowns),
            covariance=self.covariance[np.ix_(free, free)],
            clusters=dataclasses.replace(
                clusters,
                evidence=self.evidence.of(free),
                by_jackknife=clusters.by_jackknife[free],
                freedom=clusters.freedom[free],
            ),
            **{
                name: getattr(self, name)[free]
                for name in ("values", "errors", "plain_errors", "determined", "at_bound", "at_lower", "scales")
            },
        )

    def values_in(self, scene: Scene) -> Float[np.ndarray, " p"]:
        """Return what the unknowns are in another scene of the same structure, such as the truth of a test."""
        return values_in(scene, self.views, self.unknowns)

    def predict(self, view: View) -> Prediction:
        """Return a view's photograph together with this fit's prediction of it; the view may be fitted or held out."""
        (view,) = ViewSet.of(self.scene, (view,)).views
        with in_float64((self.scene, view)) as (scene, view):
            samples = find_samples(scene, view, moving=moves_surface(self.unknowns) and has_mask(view))
            image = photograph(scene, view)
        counts = np.zeros(image.shape, bool)
        counts.reshape(-1, image.shape[2])[samples.pixels] = samples.ends() == 0
        return Prediction(samples.photograph[:], image, counts)

    def what_errors_hold(self, clusters: Clusters) -> str:
        """Say what the errors of these clusters are made of, and what is taken as exact."""
        made = clusters.sentence([unknown.quantity for unknown in self.unknowns])
        return f"{made} {taken_as_exact(self.unknowns, len(self.scene.lights), len(self.views))}".rstrip()

    def __str__(self) -> str:
        """Return the table of parameters, and below it the notes."""
        counts = self.counts
        columns = parameters(self.names, self.values, self.errors, self.determined)
        bounded = self.at_bound & self.determined
        side = np.where(bounded, np.where(self.at_lower, "+", "-"), "")  # at a bound, the only way to err
        columns["error"] = np.char.add(side, columns["error"])
        columns[""] = np.where(bounded, "at a bound", "")
        return as_text(
            f"fit of {count(counts.views, 'view')}, {counts.pixels:,} pixels, {counts.samples:,} samples",
            columns,
            f"errors: {self.what_errors_hold(self.clusters)}",
            f"RMSE {self.rmse:.4g}   steps {self.steps}   condition number {self.condition:.3g}",
            notes=self.notes,
        )


@dataclass(frozen=True, eq=False)
class Prediction:
    """A photograph and what a fit says it should be, unclipped: as in `View`, through its `Sensor` where it has one.

    From `PredictionBands.predict` all of these are linear light instead: of the photograph, the prediction and the band
    the sensor's response, gains and vignetting are undone, and `difference` and `rmse` are of those.
    """

    target: Float[np.ndarray, "h w c"]
    """The photograph."""
    image: Float[np.ndarray, "h w c"]
    """What the fit predicts, in the photograph's channels."""
    counts: Bool[np.ndarray, "h w c"]
    """Samples that count: on the object, inside the mask, not mixed along edges, not clipped."""
    lower: Float[np.ndarray, "h w c"] | None = None
    """The lower end of the band of each sample, where `fit_bands` made one."""
    upper: Float[np.ndarray, "h w c"] | None = None
    """The upper end."""

    @property
    def difference(self) -> Float[np.ndarray, "h w c"]:
        """image - target where it counts, else 0."""
        return np.where(self.counts, self.image - np.where(self.counts, self.target, 0.0), 0.0)

    @property
    def rmse(self) -> float:
        """Root mean square of the difference where it counts."""
        return float(np.sqrt(np.sum(self.difference**2) / self.counts.sum()))

    @property
    def coverage(self) -> float:
        """Share of the samples that count which lie inside their bands; NaN without bands, or where none counts."""
        if self.lower is None or self.upper is None or not self.counts.any():
            return np.nan
        return float(np.mean(((self.lower <= self.target) & (self.target <= self.upper))[self.counts]))
