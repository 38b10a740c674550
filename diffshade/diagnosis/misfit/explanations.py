"""Explanations: what, put right, takes much of a fit's residuals away, by refits that must pass tests."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool

from ...inverse.refits import samples_of
from ...inverse.result import Fit
from .alternatives import Alternatives, Key, State, share
from .encodings import Encoding, cost_and_noise, other_encoding
from .regions import Seen, Shadow, cast_shadows, center_of, level, measure_rim, predicted, rims, see

ENCODING, ALONE = 0.7, 0.5  # of the cost beyond noise, that the other encoding explains; if nothing else half as much
ENCODING_ERRORS = 10.0  # standard errors of it, for independent noise
STRUCTURE = 1.05  # of the cost over that of noise, below which encodings are not tried
FACTOR, FACTOR_SHARE = 0.03, 0.1  # an exposure's error, and the part of its view's cost that it explains
TILT, TILT_SHARE = 2.5, 0.15  # degrees, and the part of the cost of its views that a light's place explains
ERRORS = 5.0  # standard errors, for independent noise
SHADOW_SHARE = 0.1  # of its view's cost
RIM, RIM_ERRORS, RIM_SHARE = 0.02, 4.0, 0.1  # excess over the mean brightness, over its error, part of the cost
AGREED = 0.75  # of the views, that must show what all are said to show
PROMISE = 0.5  # of the least effect and share, that the first step must promise for a refit
APART = 4  # lights on in a view whose shadows are looked for one by one
TRIED = 3  # refits of a kind in a round

Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class Explanation:
    """One thing that is other than was said, and the minimum with it put right."""

    kind: str
    share: float
    """Which part of the cost of all views is gone."""
    before: State
    after: State
    key: Key | None = None
    """What was let go; None where pixels were left out."""
    gone: float = 0.0
    """Which part of the cost of its own views is gone."""
    masks: Mapping[int, Mask] = field(default_factory=dict)
    """The pixels of each view that were left out."""


class MisfitSearch:
    """Where explanations are made of a fit: its alternatives, and the pixels of its views."""

    def __init__(self, fit: Fit):
        self.fit = fit
        self.samples, _ = samples_of(fit)
        self.alternatives = Alternatives(fit, center_of(fit.scene.objects, fit.views[0].camera))
        self.rims = [rims(fit.scene.objects, view.camera) for view in fit.views]

    def explanations(self, state: State) -> list[Explanation]:
        """Return all that pass their tests."""
        numbers = self.numbers(state)
        return [*numbers, *self.shadows(state, numbers), *self.rim(state)]

    def encodings(self, others: Iterable[Explanation]) -> list[Encoding]:
        """Return the other encoding where it explains most of the residuals, in most views, and nothing else does."""
        cost, noise = cost_and_noise(self.fit)
        if cost < STRUCTURE * noise:  # nothing that a curve could explain
            return []
        both = [other_encoding(self.fit, noise, decoded=decoded) for decoded in (True, False)]
        rival = max((other.share for other in others), default=0.0)
        certain = [e for e in both if e.errors > ENCODING_ERRORS and e.agreed >= AGREED]
        return [e for e in certain if e.share > rival and e.explained > (ENCODING if e.share < 2.0 * rival else ALONE)]

    def numbers(self, state: State) -> list[Explanation]:
        """Return the exposures and the lights that explain enough, of those that promise most."""
        a, found = self.alternatives, []
        promising = [s for s in a.first_steps(state) if self._promises(state, s.key, s.gain, s.effect)]
        for kind, least in (("exposure", FACTOR_SHARE), ("light", TILT_SHARE)):
            for key in [step.key for step in promising if step.key[0] == kind][:TRIED]:
                after = a.free_parameter(state, key)
                gone = share(state, after, a.views_of(key))
                count = sum(len(self.samples[v].pixels) for v in a.views_of(key))
                certain = gone * count > ERRORS**2 * (1.0 - gone)  # the F test of independent noise
                if gone > least and certain and matters(key, a.effect(after, key)) and self._holds(state, after, key):
                    found.append(Explanation(key[0], share(state, after), state, after, key=key, gone=gone))
        return found

    def shadows(self, state: State, others: Iterable[Explanation]) -> list[Explanation]:
        """Return the cast shadows of all views, where nothing else explains more of the view."""
        regions = {i: self.shadows_of(state, i, state.out[i]) for i in range(len(self.fit.views))}
        masks = {i: union(found) for i, found in regions.items() if found}
        if not masks:
            return []
        after = self.alternatives.leave_out(state, masks)
        rivals = [other.after for other in others]
        told = {
            i: mask
            for i, mask in masks.items()
            if share(state, after, [i]) > max([SHADOW_SHARE, *(share(state, rival, [i]) for rival in rivals)])
        }
        if not told:
            return []
        if len(told) < len(masks):
            after = self.alternatives.leave_out(state, told)
        return [Explanation("shadow", share(state, after), state, after, masks=told)]

    def rim(self, state: State) -> list[Explanation]:
        """Return the rims that are brighter than predicted."""
        first = measure_rim(self.see_rims(state, state.out))
        if first is None or first.excess <= 0 or first.errors < PROMISE * RIM_ERRORS:
            return []
        masks = {i: mask for i, (mask, _) in enumerate(self.rims) if mask.any()}
        after = self.alternatives.leave_out(state, masks)
        rim = measure_rim(self.see_rims(after, state.out))
        gone = share(state, after)
        if rim is None or rim.relative < RIM or rim.errors < RIM_ERRORS or rim.positive < AGREED or gone < RIM_SHARE:
            return []
        return [Explanation("rim", gone, state, after, masks=masks)]

    def _holds(self, state: State, after: State, key: Key) -> bool:
        """Whether an exposure brings most of its view's pixels at least halfway to what is predicted, not a few."""
        kind, i = key
        if kind != "exposure":
            return True
        black = float(self.fit.views[i].black)
        before, now = (level(see(s.fit, s.fit.views[i], self.samples[i], s.out[i]), black) for s in (state, after))
        return bool(abs(np.log(now)) < 0.5 * abs(np.log(before)))

    def factor(self, state: State, i: int) -> float:
        """Return how bright a view is, over the median of all where there are three or more."""
        factors = [self.alternatives.effect(state, ("exposure", k)) for k in range(len(self.fit.views))]
        return factors[i] / (float(np.median(factors)) if len(factors) > 2 else 1.0)

    def _promises(self, state: State, key: Key, gain: float, effect: float) -> bool:
        cost = float(state.costs[list(self.alternatives.views_of(key))].sum())
        least = FACTOR_SHARE if key[0] == "exposure" else TILT_SHARE
        return gain > PROMISE * least * cost and matters(key, effect, PROMISE)

    def shadows_of(self, state: State, i: int, out: Mask | None) -> list[Shadow]:
        """Return the cast shadows of a view, of each of its lights or of all together."""
        fit, view = state.fit, state.fit.views[i]
        lit = self.alternatives.lit[i]
        seen = see(fit, view, self.samples[i], out)
        if not seen.counts.any():
            return []
        off: list[tuple[int, ...]] = [(j,) for j in lit] if len(lit) <= APART else []
        off += [lit] if len(lit) != 1 else []
        return cast_shadows(seen, {js: predicted(fit, view, [k for k in lit if k not in js]) for js in off})

    def see_rims(self, state: State, out: Iterable[Mask | None]) -> list[tuple[Seen, Mask, np.ndarray]]:
        """Return each view beside its prediction, without pixels that are left out, its rim and the rim's sectors."""
        pixels = zip(state.fit.views, self.samples, out, self.rims, strict=True)
        return [(see(state.fit, view, samples, mask), *rim) for view, samples, mask, rim in pixels]


def matters(key: Key, effect: float, part: float = 1.0) -> bool:
    """Whether an exposure's factor or a light's tilt is of a size that matters, or of a part of it."""
    return abs(effect - 1.0) > part * FACTOR if key[0] == "exposure" else effect > part * TILT


def union(shadows: Iterable[Shadow]) -> Mask:
    """Return the pixels that are in any of some shadows."""
    return np.logical_or.reduce([shadow.mask for shadow in shadows])
