"""Explanations: corrections that explain much of a fit's residuals, found by refits and accepted by tests."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool

from ...inverse.result import Fit
from .alternatives import Alternatives, Key, State, share
from .encodings import Encoding, cost_and_noise, other_encoding
from .regions import Seen, Shadow, cast_shadows, center_of, level, measure_rim, predicted, rims, see

# Each explanation must exceed its thresholds.
ENCODING, ALONE = 0.7, 0.5  # fraction of the cost beyond noise by the other encoding; ALONE if no rival has half of it
ENCODING_ERRORS = 10.0  # its significance in standard errors, for independent noise
STRUCTURE = 1.05  # the cost over that of noise; below it encodings are not tried
FACTOR, FACTOR_SHARE = 0.03, 0.1  # an exposure's relative error, and the fraction of its view's cost
TILT, TILT_SHARE = 2.5, 0.15  # a light's error in degrees, and the fraction of the cost of its views
ERRORS = 5.0  # standard errors, for independent noise
SHADOW_SHARE = 0.1  # fraction of the view's cost
RIM, RIM_ERRORS, RIM_SHARE = 0.02, 4.0, 0.1  # excess over the mean brightness, in errors, fraction of the cost
AGREED = 0.75  # fraction of the views that must agree on a fault of all views
PROMISE = 0.5  # fraction of these thresholds that the first-order step must reach for a refit
APART = 4  # up to so many lights in a view, the shadow of each is searched for
REFITS = 3  # refits per kind and round

Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Explanation:
    """One fault of the scene description, and the minimum with it corrected."""

    kind: str
    share: float
    """The fraction of the cost of all views that it explains."""
    before: State
    after: State
    key: Key | None = None
    """What was freed; None if pixels were excluded."""
    own_share: float = 0.0
    """The fraction of the cost of its own views that it explains."""
    masks: Mapping[int, Mask] = field(default_factory=dict)
    """The pixels of each view that were excluded."""


class MisfitSearch:
    """The search for explanations of a fit's residuals."""

    def __init__(self, fit: Fit):
        self.fit = fit
        self.samples = fit.solved.problem.samples
        self.alternatives = Alternatives(fit, center_of(fit.scene.objects, fit.views[0].camera))
        self.rims = [rims(fit.scene.objects, view.camera) for view in fit.views]

    def explanations(self, state: State) -> list[Explanation]:
        """Return all explanations that pass their tests."""
        parameters = self.parameters(state)
        return [*parameters, *self.shadows(state, parameters), *self.rim(state)]

    def encodings(self, others: Iterable[Explanation]) -> list[Encoding]:
        """Return the other encoding if it explains most of the residuals, in most views, and nothing else does."""
        cost, noise = cost_and_noise(self.fit)
        if cost < STRUCTURE * noise:  # no structure that a curve could explain
            return []
        both = [other_encoding(self.fit, noise, decoded=decoded) for decoded in (True, False)]
        rival = max((other.share for other in others), default=0.0)
        certain = [e for e in both if e.errors > ENCODING_ERRORS and e.agreed >= AGREED]
        return [e for e in certain if e.share > rival and e.explained > (ENCODING if e.share < 2.0 * rival else ALONE)]

    def parameters(self, state: State) -> list[Explanation]:
        """Return the exposures and lights that explain enough, among the most promising by first order."""
        a, found = self.alternatives, []
        promising = [s for s in a.first_steps(state) if self._promises(state, s.key, s.gain, s.effect)]
        for kind, least in (("exposure", FACTOR_SHARE), ("light", TILT_SHARE)):
            for key in [step.key for step in promising if step.key[0] == kind][:REFITS]:
                after = a.free_parameter(state, key)
                own = share(state, after, a.views_of(key))
                count = sum(len(self.samples[v].pixels) for v in a.views_of(key))
                certain = own * count > ERRORS**2 * (1.0 - own)  # F test for independent noise
                if (
                    own > least
                    and certain
                    and matters(key, a.effect(after, key))
                    and self._corrects_most_pixels(state, after, key)
                ):
                    found.append(Explanation(key[0], share(state, after), state, after, key=key, own_share=own))
        return found

    def shadows(self, state: State, others: Iterable[Explanation]) -> list[Explanation]:
        """Return the cast shadows of all views, where nothing else explains more of the view."""
        regions = {i: self.shadows_of(state, i, state.excluded[i]) for i in range(len(self.fit.views))}
        masks = {i: union(found) for i, found in regions.items() if found}
        if not masks:
            return []
        after = self.alternatives.exclude(state, masks)
        rivals = [other.after for other in others]
        accepted = {
            i: mask
            for i, mask in masks.items()
            if share(state, after, [i]) > max([SHADOW_SHARE, *(share(state, rival, [i]) for rival in rivals)])
        }
        if not accepted:
            return []
        if len(accepted) < len(masks):
            after = self.alternatives.exclude(state, accepted)
        return [Explanation("shadow", share(state, after), state, after, masks=accepted)]

    def rim(self, state: State) -> list[Explanation]:
        """Return the rims that are brighter than predicted."""
        first = measure_rim(self.see_rims(state, state.excluded))
        if first is None or first.excess <= 0 or first.errors < PROMISE * RIM_ERRORS:
            return []
        masks = {i: mask for i, (mask, _) in enumerate(self.rims) if mask.any()}
        after = self.alternatives.exclude(state, masks)
        rim = measure_rim(self.see_rims(after, state.excluded))
        explained = share(state, after)
        if rim is None or rim.relative < RIM or rim.errors < RIM_ERRORS or rim.positive < AGREED:
            return []
        if explained < RIM_SHARE:
            return []
        return [Explanation("rim", explained, state, after, masks=masks)]

    def _corrects_most_pixels(self, state: State, after: State, key: Key) -> bool:
        """Whether an exposure moves most of its view's pixels, not a few, at least halfway to the prediction."""
        kind, i = key
        if kind != "exposure":
            return True
        black = float(self.fit.views[i].black)
        before, now = (level(see(s.fit, s.fit.views[i], self.samples[i], s.excluded[i]), black) for s in (state, after))
        return bool(abs(np.log(now)) < 0.5 * abs(np.log(before)))

    def factor(self, state: State, i: int) -> float:
        """Return a view's brightness, relative to the median of all views if there are at least three."""
        factors = [self.alternatives.effect(state, ("exposure", k)) for k in range(len(self.fit.views))]
        return factors[i] / (float(np.median(factors)) if len(factors) > 2 else 1.0)

    def _promises(self, state: State, key: Key, gain: float, effect: float) -> bool:
        cost = float(state.costs[list(self.alternatives.views_of(key))].sum())
        least = FACTOR_SHARE if key[0] == "exposure" else TILT_SHARE
        return gain > PROMISE * least * cost and matters(key, effect, PROMISE)

    def shadows_of(self, state: State, i: int, excluded: Mask | None) -> list[Shadow]:
        """Return the cast shadows in a view, from each of its lights or from all together."""
        fit, view = state.fit, state.fit.views[i]
        lit = self.alternatives.lit[i]
        seen = see(fit, view, self.samples[i], excluded)
        if not seen.counts.any():
            return []
        off: list[tuple[int, ...]] = [(j,) for j in lit] if len(lit) <= APART else []
        off += [lit] if len(lit) != 1 else []
        return cast_shadows(seen, {js: predicted(fit, view, [k for k in lit if k not in js]) for js in off})

    def see_rims(self, state: State, excluded: Iterable[Mask | None]) -> list[tuple[Seen, Mask, np.ndarray]]:
        """Return for each view photograph and prediction without excluded pixels, the rim, and the rim's sectors."""
        pixels = zip(state.fit.views, self.samples, excluded, self.rims, strict=True)
        return [(see(state.fit, view, samples, mask), *rim) for view, samples, mask, rim in pixels]


def matters(key: Key, effect: float, part: float = 1.0) -> bool:
    """Whether an exposure's factor or a light's tilt exceeds its threshold, or a part of the threshold."""
    return abs(effect - 1.0) > part * FACTOR if key[0] == "exposure" else effect > part * TILT


def union(shadows: Iterable[Shadow]) -> Mask:
    """Return the pixels that are in any of the shadows."""
    return np.logical_or.reduce([shadow.mask for shadow in shadows])
