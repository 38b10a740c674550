"""The outline of a mirror ball: found within its error, or refused in one sentence, and given as a circle."""

import numpy as np
import pytest
from measured import measured
from mirror_balls import KINDS, mirror_ball

import diffshade as ds
from diffshade.calibration.edges import find_edges, shrunk
from diffshade.calibration.result import degrees
from diffshade.io.encodings import brightened

DARK = np.array([356.5, 243.9, 54.3])  # column, row and radius in `dark_ball`, drawn by hand on the brightened mean


def read_dark() -> np.ndarray:
    folder = measured("dark_ball")
    return np.array([ds.read_image(folder / f"{i}.jpg").mean(-1) for i in range(1, 12)])


def test_an_outline_is_found_by_its_edge():
    row, column = np.indices((300, 260)) + 0.5
    off = np.hypot(row - 140.3, column - 121.7) - 90.4
    wall = 0.2 + 0.1 * np.sin(row / 40.0)
    picture = np.where(off < 0, 0.02, wall) + 0.5 * np.exp(-((row - 100) ** 2 + (column - 100) ** 2) / 30.0)
    rows, columns = find_edges(brightened(picture))[0].points
    distances = np.hypot(rows - 140.3, columns - 121.7)
    assert len(rows) > 500
    assert abs(distances.mean() - 90.4) < 0.5
    assert distances.std() < 0.5
    assert find_edges(brightened(np.full((80, 80), 0.3))) == []


def test_a_ball_in_a_dark_room_is_found_and_so_it_is_as_a_circle():
    pictures = read_dark()[..., None]
    found = ds.lights.calibrate(pictures, ball="mirror")
    np.testing.assert_allclose([*found.balls[0].middle, found.balls[0].radius], DARK, atol=0.5)
    given = ds.lights.calibrate(pictures, ball="mirror", circle=DARK)
    np.testing.assert_allclose([*given.balls[0].middle, given.balls[0].radius], DARK, atol=0.01)
    assert degrees(found.directions, given.directions).max() < 1.0
    assert given.errors.max() < 1.5
    assert not any("was found" in note for note in given.notes)


@pytest.mark.thorough
@pytest.mark.parametrize("size", [0.35, 2.0, *(pytest.param(of, marks=pytest.mark.slow) for of in (0.5, 0.75))])
def test_a_dark_ball_is_the_same_at_every_size(size):
    import cv2

    pictures = [cv2.resize(of, None, fx=size, fy=size, interpolation=cv2.INTER_AREA) for of in read_dark()]
    found = ds.lights.calibrate(pictures, ball="mirror")
    assert (
        degrees(found.directions, ds.lights.calibrate(pictures, ball="mirror", circle=size * DARK).directions).max()
        < 2.0
    )


@pytest.mark.thorough
@pytest.mark.parametrize(
    "crop",
    [
        (0, 484, 100, 726),
        (150, 400, 250, 500),
        (170, 310, 280, 430),
        (215, 484, 100, 700),
        *(
            pytest.param(of, marks=pytest.mark.slow)
            for of in ((100, 484, 200, 600), (60, 330, 0, 726), (180, 484, 280, 726), (0, 484, 330, 726))
        ),
    ],
)
def test_a_dark_ball_is_the_same_in_every_crop(crop):
    top, bottom, left, right = crop
    pictures = read_dark()[:, top:bottom, left:right]
    found = ds.lights.calibrate(pictures[..., None], ball="mirror")
    given = ds.lights.calibrate(pictures[..., None], ball="mirror", circle=DARK - [left, top, 0.0])
    assert degrees(found.directions, given.directions).max() < 2.0


def found_in(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return how far the lights of a drawn ball are off, and their errors, degrees; None where it is refused."""
    ball = mirror_ball(kind, seed)
    try:
        found = ds.lights.calibrate(ball.photographs[..., None], ball="mirror")
    except ValueError as refused:
        assert "--circle" in str(refused) or "no highlight" in str(refused)  # noqa: PT017
        return None
    return degrees(found.directions, ball.directions), found.errors


@pytest.mark.thorough
def test_one_ball_of_two_is_found():
    found = found_in("two", 0)
    assert found is not None
    assert (found[0] < 3.0 * found[1]).all()


@pytest.mark.slow
def test_drawn_balls_are_right_within_their_errors_or_refused():
    each = [found for kind in KINDS for seed in range(3) if (found := found_in(kind, seed)) is not None]
    off, errors = np.concatenate([of[0] for of in each]), np.concatenate([of[1] for of in each])
    assert len(each) >= 8
    assert 0.6 < np.mean(off < errors) < 0.9
    assert np.mean([np.median(of / error) < 2.0 for of, error in each]) == 1.0


def test_what_has_no_ball_is_refused():
    random = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"^the ball's outline was not found: .*\(--circle X,Y,R\)[^\n]*$"):
        ds.lights.calibrate(list(random.uniform(0.0, 0.1, (3, 120, 160))), ball="mirror")


@pytest.mark.parametrize("circle", [(1.0, 2.0), (1.0, 2.0, 0.0), (np.nan, 2.0, 3.0)])
def test_no_circle_is_refused(circle):
    with pytest.raises(ValueError, match="circle must be column, row and radius"):
        ds.lights.calibrate(np.ones((20, 20)), ball="mirror", circle=circle)


def test_a_mask_beside_a_circle_is_refused():
    with pytest.raises(ValueError, match="a mask or a circle; got both"):
        ds.lights.calibrate(np.ones((20, 20)), ball="mirror", circle=(10, 10, 5), mask=np.ones((20, 20)))


def test_what_is_small_is_not_enlarged():
    assert shrunk(np.zeros((30, 40)), 800)[1] == 1.0
