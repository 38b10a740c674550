"""Object's lights: the directions of balls, and the distances that two of them show, at an object between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..core.robust_scale import RARE, UNIFORM
from ..core.words import count, listing
from ..model.cameras import OrthographicCamera
from .balls import Vectors
from .object_width import Width
from .result import Calibration, degrees
from .two_balls import MIN_LAMPS, LampPlaces, find_lamps

Numbers = Float[np.ndarray, " photographs"]

APART = 4.0  # ball radii between the balls, where that is not known
ASIDE = 0.25  # of the distance between the balls: a place whose effect is said


class ObjectLights(NamedTuple):
    """The light of each photograph at an object."""

    directions: Vectors
    errors: Numbers
    """Root mean square error of each direction, degrees."""
    distances: Numbers
    """From the middle of the object's picture, scene units; infinite for a lamp that is far away."""
    distance_errors: Numbers
    picture_height: float
    """Scene units; 0 where all lamps are far away."""
    notes: list[str]


FindWidth = Callable[[LampPlaces], Width | None]


def lights_at(
    balls: Sequence[Calibration],
    mask: Bool[np.ndarray, "h w"],
    find_width: FindWidth,
    apart: float | None,
    width: float | None,
) -> ObjectLights:
    """Return the lights at an object: near lamps from two balls, otherwise directions.

    Args:
        balls: The calibration of each ball.
        mask: The object.
        find_width: How wide the object is over the distance between the balls, from its photographs.
        apart: Distance between the balls, scene units, where it is known.
        width: Width of the object, scene units, where it is known.
    """
    if len(balls) != 2 or not all(isinstance(ball.camera, OrthographicCamera) for ball in balls):
        return _far(*between(balls))
    if len(balls[0].names) < MIN_LAMPS:
        return _far(*between(balls))
    one, other = balls
    l = np.stack([_seen(ball) for ball in balls])
    errors = np.stack([ball.errors for ball in balls])
    radius = float(np.mean([float(ball.balls[0].sphere.radius) for ball in balls]))
    pixels = float(np.mean([ball.balls[0].radius for ball in balls]))
    columns = np.flatnonzero(mask.any(0))
    wide = int(columns[-1] - columns[0] + 1)

    def lamps_for(apart: float, baseline: np.ndarray | None = None) -> LampPlaces:
        on_ball = radius / apart if one.ball == "mirror" else 0.0
        return find_lamps(l, errors, on_ball, baseline)

    notes: list[str] = []
    framed = None
    if apart is None and width is None and len({mask.shape, *(ball.balls[0].mask.shape for ball in balls)}) == 1:
        framed = _in_one_frame(one, other, lamps_for)
    if framed is not None:
        apart, lamps, place = framed[0] * radius / pixels, framed[1], framed[2]
        notes.append(
            f"the photographs of the balls and of the object have one size and are taken not to be cropped: the balls "
            f"stood {apart:.3g} apart, {framed[0]:.0f} pixels."
        )
        wide_apart = wide / framed[0]
        lamps = lamps.seen_from(place)
        stood = 0.0
    else:
        notes += [] if apart is not None else [_on_apart(lamps_for, APART * radius)]
        apart = APART * radius if apart is None else apart
        lamps, stood = lamps_for(apart), UNIFORM  # anywhere between the balls
        wide_apart, said = _width(lamps, find_width, apart, width)
        notes += [said] if lamps.near.any() else []
    if not lamps.near.any():
        return _far(*between(balls))
    errors_there = np.hypot(
        lamps.errors,
        np.rad2deg(stood * lamps.nearness * np.linalg.norm(np.cross(lamps.directions, lamps.baseline), axis=-1)),
    )
    notes += [_on_place(lamps, framed=framed is not None), *_on_distances(lamps, one.names, apart, wide_apart)]
    distances = np.where(lamps.near, apart / np.maximum(lamps.nearness, 1e-12), np.inf)
    return ObjectLights(
        lamps.directions,
        errors_there,
        distances,
        np.where(lamps.near, lamps.nearness_errors * distances**2 / apart, np.inf),
        wide_apart * apart * mask.shape[0] / wide,
        notes,
    )


def _far(directions: Vectors, errors: Numbers, notes: list[str]) -> ObjectLights:
    nowhere = np.full(len(errors), np.inf)
    return ObjectLights(directions, errors, nowhere, nowhere, 0.0, notes)


def _seen(ball: Calibration) -> Vectors:
    """Return the directions as the camera sees them: right, up, backward."""
    return ball.directions @ ball.balls[0].axes.T


def _in_one_frame(
    one: Calibration, other: Calibration, lamps_for: Callable[..., LampPlaces]
) -> tuple[float, LampPlaces, np.ndarray] | None:
    """Return the distance of two balls in pixels, the lamps, and where the picture's middle is beside the balls.

    None where the pictures must be cropped: the balls would overlap, or the highlights show another way from one ball
    to the other. Lengths are in distances between the balls.
    """
    (x1, y1), (x2, y2) = one.balls[0].middle, other.balls[0].middle
    step = np.array([x2 - x1, y1 - y2, 0.0])
    pixels = float(np.linalg.norm(step))
    if pixels < one.balls[0].radius:
        return None
    apart = pixels * float(one.balls[0].sphere.radius) / one.balls[0].radius
    free, step = lamps_for(apart), step / pixels
    off = np.rad2deg(np.arccos(np.clip(free.baseline @ step, -1.0, 1.0)))
    if free.near.any() and off > RARE * max(free.baseline_error, 1.0):
        return None
    height, width = one.balls[0].mask.shape
    place = np.array([width / 2 - (x1 + x2) / 2, (y1 + y2) / 2 - height / 2, 0.0]) / pixels
    return pixels, lamps_for(apart, step), place


def _width(lamps: LampPlaces, find_width: FindWidth, apart: float, width: float | None) -> tuple[float, str]:
    """Return the object's width in distances between the balls, and where it is from."""
    if width is not None:
        return width / apart, f"the object is {width:.3g} wide, as given."
    found = find_width(lamps)
    typical = float(np.median(lamps.nearness[lamps.near])) if lamps.near.any() else 0.0
    if found is not None and found.determined:
        return found.width, (
            f"the object's own photographs show how wide it is beside the distances of the lamps: {found.width:.2g} +- "
            f"{found.error:.2g} times the distance between the balls; their misfit is {found.misfit:.2%}, and "
            f"{found.misfit_far:.2%} if all lamps were far away. Give --width to state it."
        )
    return 1.0, (
        "the object is taken to be as wide as the balls are apart, for its photographs do not show it: directions "
        f"differ by {np.rad2deg(typical):.2g} degrees from side to side, and half or twice as much for half or twice "
        "the width. Give --width to state it."
    )


def _on_apart(lamps_for: Callable[..., LampPlaces], apart: float) -> str:
    """Say what the distance between the balls was taken to be, and what another one would change."""
    here = lamps_for(apart).directions
    turned = max(float(degrees(lamps_for(apart * factor).directions, here).mean()) for factor in (0.5, 2.0))
    return (
        f"how far apart the balls stood is not in cropped photographs: their middles are taken to be {APART:g} radii "
        f"({apart:.3g}) apart. All lengths follow from it; half or twice of it turns lights by {turned:.2g} degrees on "
        "average. Give --apart to state it."
    )


def _on_place(lamps: LampPlaces, *, framed: bool) -> str:
    """Say where the object is taken to stand, and what another place would change."""
    deeper = lamps.seen_from(np.array([0.0, 0.0, ASIDE]))
    turned = degrees(deeper.directions, lamps.directions).mean()
    brighter = (lamps.nearness[lamps.near] / deeper.nearness[lamps.near]) ** -2.0 - 1.0
    where = "at the balls' depth, and flat" if framed else "in the middle between the balls, at their depth, and flat"
    beside = lamps.seen_from(ASIDE * lamps.baseline)
    along = degrees(beside.directions, lamps.directions).mean()
    sideways = "" if framed else f" Halfway from there to a ball lights turn by {along:.2g} degrees."
    return (
        f"the object is taken to stand {where}.{sideways} A quarter of the distance between the balls nearer to the "
        f"camera turns lights by {turned:.2g} degrees and brightens them by {brighter.min():.1%} to "
        f"{brighter.max():.1%}."
    )


def _on_distances(lamps: LampPlaces, names: Sequence[str], apart: float, wide: float) -> list[str]:
    """Say how far away the lamps are, how that shows over the object, and which distances are not determined."""
    near, n = lamps.near, len(lamps.near)
    w = float(np.median(lamps.nearness[near]))
    error = float(np.median((lamps.nearness_errors / np.maximum(lamps.nearness, 1e-12))[near]))
    slant = float(np.mean(np.linalg.norm(lamps.directions[near, :2], axis=-1)))
    which = "all" if near.all() else f"{near.sum()} of"
    said = [
        f"{which} {count(n, 'lamp')} are near: {1.0 / w:.3g} times as far away as the balls are apart "
        f"({apart / w:.3g}) in the median, +- {error:.0%}. From side to side of the object their directions differ by "
        f"{np.rad2deg(w * wide):.2g} degrees and their light by {2.0 * w * wide * slant:.0%}.",
        "distances are measured against a camera far away: one at the distance D makes lamps seem farther, by 1/D less "
        "in 1/distance.",
    ]
    if not near.all():
        far = [name for name, known in zip(names, near, strict=True) if not known]
        said.append(f"the distance of the light of {listing(far)} is not determined: its direction alone is used.")
    return said


def between(balls: Sequence[Calibration]) -> tuple[Vectors, Numbers, list[str]]:
    """Return the directions in the middle of several balls, their errors, and what was assumed."""
    each = np.array([_seen(ball) for ball in balls])
    own = np.sqrt(np.mean([ball.errors**2 for ball in balls], 0) / len(balls))
    mean = each.mean(0)
    directions = mean / np.linalg.norm(mean, axis=-1, keepdims=True)
    if len(balls) == 1:
        stands = (
            "the object is taken to stand where the ball stood: beside it, a lamp 10 times as far away is off by "
            "up to 6 degrees. Photograph a ball on either side of the object."
        )
        return directions, own, [stands]
    apart = np.max([degrees(one, directions) for one in each], 0)
    half = float(np.mean(apart))
    notes = [
        f"the object is taken to stand in the middle of the balls. Their directions are {half:.2g} degrees from "
        f"that on average and {apart.max():.2g} at most, so a place halfway from there to one of them turns the "
        f"lights by {half / 2.0:.2g}; the errors contain any place between them.",
        "the lamps' distances are not used: over an object as wide as the balls are apart, directions differ by "
        f"{2.0 * half:.2g} degrees from side to side.",
    ]
    return directions, np.hypot(own, apart / np.sqrt(3.0)), notes
