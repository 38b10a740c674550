"""Lamps from the directions to them from two balls whose places are not known."""

from __future__ import annotations

import numpy as np
import pytest
from directions import unit

from diffshade.calibration.highlights import MIN_DISC, largest_disc, without_streaks
from diffshade.calibration.two_balls import LampPlaces, find_lamps

RADIUS, NOISE = 0.25, 0.15  # in distances between the balls; degrees about each axis
BASELINE = np.array([0.98, 0.15, 0.13]) / np.linalg.norm([0.98, 0.15, 0.13])


def dome(seed: int, lamps: int, low: float, high: float) -> np.ndarray:
    """Return positions of lamps at distances between two bounds."""
    random = np.random.default_rng(seed)
    towards = random.normal(size=(lamps, 3))
    towards[:, 2] = np.abs(towards[:, 2]) + 0.5
    return unit(towards) * random.uniform(low, high, (lamps, 1))


def seen(x: np.ndarray, seed: int) -> np.ndarray:
    """Return the directions of the highlights of lamps on both balls, with noise."""
    random, found = np.random.default_rng(100 + seed), []
    for side in (-0.5, 0.5):
        p = np.broadcast_to(side * BASELINE, x.shape)
        for _ in range(20):  # the point of the ball where its normal halves the angle
            p = side * BASELINE + RADIUS * unit(unit(x - p) + np.array([0.0, 0.0, 1.0]))
        found.append(unit(unit(x - p) + np.deg2rad(NOISE) * random.normal(size=x.shape)))
    return np.array(found)


def found_from(x: np.ndarray, seed: int, baseline: np.ndarray | None = None) -> LampPlaces:
    return find_lamps(seen(x, seed), np.full((2, len(x)), NOISE * np.sqrt(2.0)), RADIUS, baseline)


@pytest.mark.parametrize("known", [False, True])
def test_positions_are_right_within_their_errors(known):
    scores, angles, stated, turned = [], [], [], []
    for seed in range(3):
        x = dome(seed, 16, 10.0, 20.0)
        lamps = found_from(x, seed, BASELINE if known else None)
        distance = np.linalg.norm(x, axis=-1)
        scores.append((lamps.nearness - 1.0 / distance) / lamps.nearness_errors)
        angles.append(np.rad2deg(np.linalg.norm(lamps.directions - unit(x), axis=-1)))
        stated.append(lamps.errors)
        assert lamps.near.mean() > 0.9
        turned.append(
            np.rad2deg(np.arccos(min(float(lamps.baseline @ BASELINE), 1.0))) / max(lamps.baseline_error, 1e-6)
        )
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.3
    assert 0.7 < np.sqrt(np.mean(np.square(angles)) / np.mean(np.square(stated))) < 1.3
    assert max(turned) < (1e-3 if known else 3.0) or known


def test_lamps_far_away_have_no_distance():
    lamps = found_from(dome(0, 16, 1e4, 2e4), 0)
    assert lamps.near.mean() < 0.2


def test_a_lamp_of_which_the_highlights_say_nothing_is_as_near_as_the_others():
    x = dome(1, 16, 12.0, 13.0)
    errors = np.full((2, 16), NOISE * np.sqrt(2.0))
    errors[:, 3] = 30.0
    lamps = find_lamps(seen(x, 1), errors, RADIUS)
    assert lamps.nearness[3] == pytest.approx(1.0 / 12.5, rel=0.2)


def test_lamps_around_another_place():
    x, place = dome(2, 16, 10.0, 20.0), np.array([0.3, -0.2, 0.1])
    lamps = found_from(x, 2, BASELINE).seen_from(place)
    exact = np.linalg.norm(x - place, axis=-1)
    scores = (lamps.nearness - 1.0 / exact) / lamps.nearness_errors
    assert np.sqrt(np.mean(scores**2)) < 1.5
    np.testing.assert_allclose(lamps.directions, unit(x - place), atol=0.01)


def test_a_highlight_loses_its_streaks_and_keeps_its_middle():
    row, column = np.indices((80, 90))
    disc = np.hypot(row - 30, column - 40) < 9
    streaked = disc | ((np.abs(column - 40) < 2) & (row > 30) & (row < 75))
    core = without_streaks(streaked)
    assert np.hypot(*(np.array(np.nonzero(core)).mean(1) - (30, 40))) < 0.5
    assert np.array(np.nonzero(streaked)).mean(1)[0] > 36
    assert largest_disc(streaked) == pytest.approx(9, abs=1)
    assert largest_disc((row < 5) & (column < 5)) < MIN_DISC  # too few pixels for a streak to be seen
