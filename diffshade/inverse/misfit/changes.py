"""Changes: what each fault changes in the pictures to first order: directions of image space, or moves of numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy
from jaxtyping import Float, Int
from numpy.polynomial import legendre
from scipy import ndimage

from ...core.robust_scale import OUTLIER, RARE
from ...model.surfaces import Sphere
from ..data.recording import photograph
from ..data.samples import MIN_PILE
from ..data.views import lights_on
from ..result import Fit
from ..statistics.uncertainty import Vector, over
from ..unknowns.places import Place
from .linearised import BLUR_SIGMAS, Linearised

MAX_ALONE = 4  # spheres of a scene, and lights of a view: of so many each is looked at alone
SMOOTH_DEGREE = 7  # of the changes that have no name: a wave is half as long as the object
SMOOTH_OF_ONE_DEGREE = 3  # of those of one view
MAX_SINGLE_VIEWS = 24  # of more views, changes and shifts of one view are not tested


@dataclass(frozen=True, eq=False)
class Move:
    """How a fault of one amount or several moves the numbers of a set-up."""

    rows: Float[np.ndarray, "k p"]
    """To first order."""
    along: Callable[[Vector, Vector], Vector]
    """The numbers after a move, from those before and the amount."""

    @staticmethod
    def shift(index: Sequence[int], p: int, scale: float = 1.0) -> Move:
        """Return the move that adds amounts to some numbers."""
        rows = scale * np.eye(p)[list(index)]
        return Move(rows, lambda theta, amount: theta + amount @ rows)

    @staticmethod
    def turn(arms: Sequence[tuple[list[int], np.ndarray]], axes: Float[np.ndarray, "k 3"], theta: Vector) -> Move:
        """Return the move that turns places about their centres, by degrees about each axis."""
        rows = np.zeros((len(axes), len(theta)))
        for index, center in arms:
            rows[:, index] = np.deg2rad(np.cross(axes, theta[index] - center))

        def along(theta: Vector, amount: Float[np.ndarray, " k"]) -> Vector:
            there, turned = theta.copy(), scipy.spatial.transform.Rotation.from_rotvec(np.deg2rad(amount @ axes))
            for index, center in arms:
                there[index] = center + turned.apply(theta[index] - center)
            return there

        return Move(rows, along)


@dataclass(frozen=True, eq=False)
class Case:
    """A fault at one place, with one amount or several."""

    which: int
    """The index of the view, light or object, of the blur, or of the second highlight's n_s; else 0."""
    change: Float[np.ndarray, "k n"] | Move
    """The change of each sample by an amount of 1, or the move of the set-up's numbers from which it follows."""
    views: tuple[int, ...] | None = None
    """The views that it affects; None for all."""
    known: bool = False
    """Whether it is there for sure, by an amount of 1, which the residuals need not show."""
    renamed: Vector | None = None
    """What an amount of 1 adds to the fit's own values because they mean something else then: n_s of another lobe."""


def exposures(fit: Fit) -> list[Place]:
    """Return the places of the exposures."""
    return [Place("views", i, ("exposure",)) for i in range(len(fit.views))]


def places(fit: Fit) -> list[Place]:
    """Return the places of where the lights that are on are, and where they point."""
    on = sorted({i for view in fit.views for i in lights_on(fit.scene, view)})
    return [Place("lights", i, (name,)) for i in on for name in fit.scene.lights[i].placement]


def of_spheres(part: str, fit: Fit) -> list[Place]:
    """Return the places of a part of all spheres."""
    items = [(i, item) for i, item in enumerate(fit.scene.objects) if isinstance(item.surface, Sphere)]
    few = items if len(items) <= MAX_ALONE else []
    return [Place("objects", i, ("surface", part), name=item.name) for i, item in few]


def of_vignetting(at: Linearised) -> Iterator[Case]:
    """Yield light that falls by the square of the distance from the image's centre."""
    yield Case(0, -(at.light * _rho2(at))[None])


def of_uneven_light(at: Linearised) -> Iterator[Case]:
    """Yield light that changes smoothly across all pictures alike, in a way that the scene does not have."""
    yield Case(0, _smooth(at, 1, SMOOTH_DEGREE) * at.light)


def of_uneven_view(at: Linearised) -> Iterator[Case]:
    """Yield light that changes smoothly across one picture."""
    if 1 < len(at.fit.views) <= MAX_SINGLE_VIEWS:
        smooth = _smooth(at, 1, SMOOTH_OF_ONE_DEGREE) * at.light
        for i in range(len(at.fit.views)):
            yield Case(i, np.where(at.set_up.view == i, smooth, 0.0), views=(i,))


def of_stray_light(at: Linearised) -> Iterator[Case]:
    """Yield light that is added to all pictures alike: from one side, of any colour, or smoothly changing across them.

    That of one side is dark at the other end, since light is not negative; so its mean is as large as its change.
    """
    (x, y), level = _across(at), _exposure(at) * np.sqrt(np.mean(at.light**2))
    yield Case(0, of_each_channel(at, 0.5 * (1.0 + np.array([x, -x, y, -y])) * level))
    yield Case(1, _smooth(at, 2, SMOOTH_DEGREE) * level)


def of_ambient(at: Linearised) -> Iterator[Case]:
    """Yield light from everywhere, an amount for each channel."""
    yield Case(0, of_each_channel(at, _exposure(at)[None]))


def of_shift(at: Linearised) -> Iterator[Case]:
    """Yield pictures that are shifted, by pixels along a row and along a column: all of them, or one."""
    if at.drawable:
        shift, views = at.looks[len(BLUR_SIGMAS) :][:2], range(len(at.fit.views))
        yield Case(0, shift)
        for i in views if 1 < len(views) <= MAX_SINGLE_VIEWS else ():
            yield Case(i, np.where(at.set_up.view == i, shift, 0.0), views=(i,))


def of_chroma(at: Linearised) -> Iterator[Case]:
    """Yield pictures whose colours, not their brightness, are blurred: red and blue, by some widths."""
    if at.drawable:
        yield Case(0, at.looks[len(BLUR_SIGMAS) + 2 :])


def of_gamma(at: Linearised) -> Iterator[Case]:
    """Yield light raised to a power."""
    yield Case(0, _by_gamma(at))


def of_gamma_of_one(at: Linearised) -> Iterator[Case]:
    """Yield light of one channel raised to a power."""
    channel = at.set_up.channel
    for c in range(int(channel.max()) + 1) if channel.max() else ():
        yield Case(c, np.where(channel == c, _by_gamma(at), 0.0))


def _by_gamma(at: Linearised) -> Float[np.ndarray, "1 n"]:
    return (at.light * np.log(np.maximum(at.light, 1e-6)) * (at.light > 0))[None]


def of_blur(at: Linearised) -> Iterator[Case]:
    """Yield pictures blurred by some widths."""
    for k in range(len(BLUR_SIGMAS)) if at.drawable else ():
        yield Case(k, at.looks[k][None])


def of_pixels(at: Linearised) -> Iterator[Case]:
    """Yield pixels that are averages over their area: 2 x 2 rays have three quarters of its variance, 1/12 each way.

    Where photographs mix what is on both sides of edges, they are known to be averages, as by a Gaussian that reaches
    three deviations far. A blur of the sensor has it already.
    """
    sharp = all(view.sensor is None or not np.any(np.asarray(view.sensor.blur) > 0.0) for view in at.fit.views)
    if sharp:
        change = (at.drawn(partial(photograph, samples=2)) - at.predicted) * 4.0 / 3.0
        reach = np.array([samples.reach for samples in at.fit.solved.problem.data.samples])
        times = 12.0 * (reach / RARE) ** 2 if reach.any() else np.ones(len(reach))
        yield Case(0, (times[at.set_up.view] * change)[None], known=bool(reach.any()))


def of_bound(at: Linearised) -> Iterator[Case]:
    """Yield the changes by the values at bounds other than 0, outwards, as the photographs may want them."""
    if len(which := bounded(at.set_up.fit)):
        outwards = np.where(at.set_up.fit.at_lower[which], -1.0, 1.0)
        yield Case(0, outwards[:, None] * at.jacobian[which].toarray())


def bounded(fit: Fit) -> Int[np.ndarray, " bounded"]:
    """Return which values are at a bound other than 0."""
    return np.flatnonzero(fit.at_bound & (fit.values != 0.0))


def of_black(at: Linearised) -> Iterator[Case]:
    """Yield a level that is added to every sample, one for each channel."""
    yield Case(0, of_each_channel(at, np.ones((1, len(at.predicted)))))


def of_floor(at: Linearised) -> Iterator[Case]:
    """Yield what dark samples gain on average where their noise is cut off at 0."""
    zeros = [samples.zeros for samples in at.fit.solved.problem.data.samples]
    told = [view.floor is not None for view in at.fit.views]
    cut = np.array([n > MIN_PILE and not here for n, here in zip(zeros, told, strict=True)])
    if cut.any():
        sigma = at.fit.rmse if at.fit.views[0].noise is None else np.sqrt(np.median(over(at.weight)))
        true = np.linspace(-OUTLIER, OUTLIER, 1024)
        seen = true * scipy.special.ndtr(true) + np.exp(-0.5 * true**2) / np.sqrt(2.0 * np.pi)  # the mean of max(0, x)
        level = np.maximum(at.predicted / sigma, seen[0])
        above = np.where(level < OUTLIER, level - np.interp(level, seen, true), 0.0)
        yield Case(0, sigma * (above * cut[at.set_up.view])[None], known=True)


def of_colour(at: Linearised) -> Iterator[Case]:
    """Yield light of one channel that changes smoothly across all pictures alike."""
    channel, degree = at.set_up.channel, SMOOTH_OF_ONE_DEGREE
    added = _smooth(at, 2, degree) * np.sqrt(np.mean(at.light**2))  # more evenly it is stray light
    both = np.concatenate([_smooth(at, 1, degree) * at.light, added])
    for c in range(int(channel.max()) + 1) if channel.max() else ():
        yield Case(c, np.where(channel == c, both, 0.0))


def of_highlight_by_colour(at: Linearised) -> Iterator[Case]:
    """Yield highlights that are wider in one channel than in another, where one n_s is fitted to all channels."""
    channel = at.set_up.channel
    for j, unknown in enumerate(at.fit.unknowns):
        if unknown.kind == "n_s" and unknown.logarithmic and channel.any() and not at.fit.at_bound[j]:
            change = at.jacobian[[j]].toarray()
            if len(np.unique(channel[change[0] != 0.0])) > 1:
                yield Case(j, of_each_channel(at, change))


def of_exposure(at: Linearised) -> Iterator[Case]:
    """Yield a view's exposure, relative to the given one."""
    for i, view in enumerate(at.set_up.fit.views):
        if index := at.set_up.places.get(Place("views", i, ("exposure",))):
            yield Case(i, Move.shift(index, len(at.state.theta), float(view.exposure)), views=(i,))


def of_light(at: Linearised) -> Iterator[Case]:
    """Yield a light turned about what it illuminates, by degrees about two axes."""
    lit = at.set_up.lit
    for i in sorted(set().union(*lit)):
        name = next(iter(at.fit.scene.lights[i].placement), "")
        if index := at.set_up.places.get(Place("lights", i, (name,))):
            center = _center(at, name)
            axes = np.linalg.svd((at.set_up.laid.theta[index] - center)[None])[2][1:]
            views = tuple(v for v, of_view in enumerate(lit) if i in of_view)
            yield Case(i, Move.turn([(index, center)], axes, at.state.theta), views=views)


def of_rotation(at: Linearised) -> Iterator[Case]:
    """Yield all lights turned together, by degrees about three axes, if the places of all are known."""
    lights = [(i, at.fit.scene.lights[i].placement) for i in sorted(set().union(*at.set_up.lit))]
    known = at.set_up.places
    arms = [(known.get(Place("lights", i, (name,)), []), _center(at, name)) for i, of in lights for name in of]
    if arms and all(of for _, of in lights) and all(index for index, _ in arms):
        yield Case(0, Move.turn(arms, np.eye(3), at.state.theta))


def of_sphere(part: str, at: Linearised) -> Iterator[Case]:
    """Yield a part of each sphere."""
    for i, item in enumerate(at.fit.scene.objects):
        index = at.set_up.places.get(Place("objects", i, ("surface", part)))
        if index and isinstance(item.surface, Sphere):
            yield Case(i, Move.shift(index, len(at.state.theta)))


def _center(at: Linearised, name: str) -> np.ndarray:
    return np.zeros(3) if name == "direction" else at.set_up.center


def _across(at: Linearised) -> Float[np.ndarray, "2 n"]:
    """Return where each sample is across the object, from -1 to 1 along a row and along a column."""
    view, widths = at.set_up.view, np.array([view.camera.shape[1] for view in at.fit.views])
    row, column = np.divmod(at.set_up.pixel, widths[view])
    across = []
    for index in (column, row):
        first, last = (of(index, view, np.arange(len(widths)))[view] for of in (ndimage.minimum, ndimage.maximum))
        across.append(2.0 * (index - first) / np.maximum(last - first, 1) - 1.0)
    return np.array(across)


def _exposure(at: Linearised) -> Float[np.ndarray, " n"]:
    """Return the exposure of each sample's view."""
    return np.array([float(view.exposure) for view in at.fit.views])[at.set_up.view]


def _smooth(at: Linearised, least: int, degree: int) -> Float[np.ndarray, "k n"]:
    """Return products of Legendre polynomials across the object, so weighted that smooth ones come more easily.

    A constant one of light is its intensity, which no photograph tells from the reflections.
    """
    x, y = (legendre.legvander(of, degree) for of in _across(at))
    of_degrees = [(i, n - i) for n in range(least, degree + 1) for i in range(n + 1)]
    return np.array([x[:, i] * y[:, j] / (1 + i + j) for i, j in of_degrees])


def of_each_channel(at: Linearised, changes: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "kc n"]:
    """Return changes with an amount for each channel."""
    channel = at.set_up.channel
    return np.concatenate([np.where(channel == c, changes, 0.0) for c in range(int(channel.max(initial=0)) + 1)])


def _rho2(at: Linearised) -> Float[np.ndarray, " n"]:
    """Return the square of each sample's distance from the image centre, over that of a corner."""
    h, w = np.array([view.camera.shape for view in at.fit.views])[at.set_up.view].T
    row, column = np.divmod(at.set_up.pixel, w)
    return ((2 * row + 1 - h) ** 2 + (2 * column + 1 - w) ** 2) / (h**2 + w**2)
