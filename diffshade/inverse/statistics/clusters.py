"""Clusters: views, or patches, whose samples may share an error; whether they agree, and the errors that follow."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool
from scipy import special

from ...core.thresholds import FEW
from ...core.words import listing
from .evidence import Evidence
from .uncertainty import Vector

FALSE_ALARMS = 0.02  # the fraction of fits with independent noise whose clusters are reported to disagree
LEAST_FREEDOM = 1.99  # least degrees of freedom of a jackknife: with fewer, it rests on one or two patches


@dataclass(frozen=True, eq=False)
class Clusters:
    """What the errors of a fit are made of: independent samples, or clusters of them."""

    evidence: Evidence
    count: int
    """The number of clusters; 0 if they are too few to compare."""
    what: str
    scatter: float
    """The variance of the clusters' own optima, over that expected from independent noise: 1 if it is independent."""
    disagree: bool
    """Whether the clusters disagree by more than independent noise explains."""
    by_jackknife: Bool[np.ndarray, " p"]
    """Unknowns whose standard error is by jackknife: the clusters disagree about them, and are enough for one."""
    freedom: Vector
    """Degrees of freedom of the jackknife: clusters - 1, or fewer if a few decide (Bell and McCaffrey 2002)."""

    def standard_errors(self) -> Vector:
        """Return the standard errors: by jackknife where the clusters disagree, else for independent noise.

        The latter are multiplied by the root of the scatter where that is above 1 (Birge 1932), so that they grow
        smoothly with a disagreement too small to be noticed. What rounding adds is in both.
        """
        plain, rounding = self.evidence.plain_errors(), self.evidence.rounding_errors()
        scaled = np.hypot(np.sqrt(max(self.scatter, 1.0)) * plain, rounding)
        if not self.by_jackknife.any():
            return scaled
        return np.where(
            self.by_jackknife, np.maximum(self.evidence.clustered_errors(), np.hypot(plain, rounding)), scaled
        )

    def wide_errors(self) -> Vector:
        """Return `standard_errors` times Student's t over 1.96: the truth is within 1.96 of them 95 % of the time."""
        return self.standard_errors() * self.quantiles(0.95) / special.ndtri(0.975)

    def inflation(self) -> Vector:
        """Return the variances over those of independent noise, with nothing held at a bound."""
        free = self
        if (at_bound := self.evidence.at_bound).any():
            evidence = dataclasses.replace(self.evidence, at_bound=np.zeros_like(at_bound))
            free = dataclasses.replace(self, evidence=evidence)
        plain, errors = free.evidence.plain_errors(), free.standard_errors()
        usable = np.isfinite(plain) & (plain > 0)
        ratio = np.where(usable, errors, 1.0) / np.where(usable, plain, 1.0)
        return np.where(usable, ratio**2, max(self.scatter, 1.0))

    def rises(self) -> Vector:
        """Return for each unknown by how much twice the cost rises if the unknown is held one error away.

        This is sigma^2 times the inflation. The cost of a robust loss curves with psi', while H has the weights rho'.
        """
        return self.evidence.sigma2 * self.inflation() / self.evidence.loss_ratio

    def quantiles(self, level: float) -> Vector:
        """Return how many errors a two-sided interval reaches: Student's t, of `freedom` by jackknife."""
        many = max(float(self.evidence.spread[0]) - len(self.by_jackknife), 1.0)
        freedom = np.where(self.by_jackknife, np.minimum(self.freedom, many), many)
        return special.stdtrit(freedom, 0.5 + 0.5 * level)

    def sentence(self, quantities: Sequence[str]) -> str:
        """Say what the errors are made of, and what is not in them; given the unknowns' quantities."""
        rounding = self._of_rounding()
        noise = f"for independent noise{f' and {rounding}' if rounding else ''}"
        if not self.count:
            return f"{noise}; {self.what} cannot show whether the residuals are correlated."
        factor = np.sqrt(max(self.scatter, 1.0))
        if not self.disagree:
            times = f", times {factor:.3g} for the scatter" if factor > 1.005 else ""
            return f"{noise}{times}; the {self.what} agree within these errors."
        if not self.by_jackknife.any():
            return (
                f"{noise}, times {factor:.3g}, since the {self.what} disagree more than such noise explains and are "
                "too few for a jackknife."
            )
        names = list(dict.fromkeys(q for q, here in zip(quantities, self.by_jackknife, strict=True) if here))
        # where one unknown alone disagrees, the scatter of all together says nothing
        much = f" (their optima have {self.scatter:.3g} times the expected variance)" if self.scatter > 1.0 else ""
        also = f"; and {rounding}" if rounding else ""
        rough = f"; {self.count} are few for a jackknife" if self.count < FEW and "patches" in self.what else ""
        return (
            f"by jackknife over the {self.what}, which disagree about {listing(names)} more than independent noise "
            f"explains{much}{rough}{also}; errors that all of them share, such as texture or wrong normals, are not "
            "included."
        )

    def _of_rounding(self) -> str:
        """Return a phrase for what rounding adds; empty if that is negligible."""
        plain, rounding = self.evidence.plain_errors(), self.evidence.rounding_errors()
        known = np.isfinite(plain) & (plain > 0)
        times = float(np.max(np.hypot(1.0, rounding[known] / plain[known]), initial=1.0))
        return f"for rounding to {self.evidence.steps} (which adds up to a factor {times:.2g})" if times > 1.05 else ""


def compared(evidence: Evidence, count: int, what: str) -> Clusters:
    """Return clusters with the verdict on whether they agree; `what` names them, with their number.

    One test of all unknowns together (`Evidence.scatter`) and one of each (`Evidence.independence_p_values`) share the
    false alarms. A jackknife takes at least three clusters, of which none alone determines something.
    """
    scatter, together = evidence.scatter()
    each, freedom = evidence.independence_p_values()
    each = np.where(freedom < LEAST_FREEDOM, 1.0, each)
    tested = max(int(np.sum(np.isfinite(freedom))), 1)
    alone = each < 0.5 * FALSE_ALARMS / tested
    all_of_them = together < 0.5 * FALSE_ALARMS
    jackknife = count >= 3 and evidence.deciding() is None
    by_jackknife = (all_of_them | alone) & (evidence.single_view < 0) & jackknife
    return Clusters(evidence, count, what, scatter, bool(all_of_them or alone.any()), by_jackknife, freedom)


def independent(evidence: Evidence, what: str) -> Clusters:
    """Return clusters too few to be compared; `what` names them."""
    none = np.zeros(len(evidence.values), bool)
    return Clusters(evidence, 0, what, 1.0, False, none, np.full(len(none), np.inf))
