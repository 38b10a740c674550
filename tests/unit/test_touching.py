"""Things that stand on, against and in each other: what is seen there does not hang on a rounding (E12, E13).

Rendered operation by operation: the structures are many.
"""

import itertools

import jax
import numpy as np
import pytest

import diffshade as ds

SHAPE = (12, 16)
BLUE = (0.0, 0.0, 1.0)  # the background, which shows where a ray slips through
CHEQUER = ds.Chequer(0.1, 0.9, 1.5, smooth=True, u=(1, 0, 0), v=(0, 0.3, 1))
FLOOR = ds.Object(ds.Plane(), ds.Material(k_a=CHEQUER))
WALL = ds.Object(ds.Plane((0, 0, -0.25), (0, 0, 1)), ds.Material(k_a=CHEQUER))
ABOVE = ds.Camera((1, 3, 5), target=(1, 0.3, 0), fov=20, shape=SHAPE)


def glass(surface, eta, k_t=0.7):
    return ds.Object(surface, ds.Material(k_t=k_t, eta=eta))


def box_on_a_floor(eta, gap=0.0):
    return [glass(ds.Box((1, 0.25 + gap, 0), (0.5, 0.5, 0.5)), eta), FLOOR], ABOVE


def turned_box_on_a_floor(eta, gap=0.0):
    return [glass(ds.Box((1, 0.25 + gap, 0), (0.5, 0.5, 0.5), (0, 33, 0)), eta), FLOOR], ABOVE


def ball_on_a_floor(eta, gap=0.0):
    return [glass(ds.Sphere((1, 0.5 + gap, 0), 0.5), eta), FLOOR], ABOVE


def box_against_a_wall(eta, gap=0.0):
    camera = ds.Camera((0.3, 0.4, 5), fov=10, shape=SHAPE)
    return [glass(ds.Box((0, 0, gap), (0.5, 0.5, 0.5)), eta), WALL], camera


def glass_table(eta, gap=0.0):
    """A glass plate with a ball on it, on a floor that touches it from below."""
    ball = ds.Object(ds.Sphere((0, 0.6 + gap, 0), 0.5), ds.Material(k_a=0.9))
    floor = ds.Object(ds.Plane((0, -0.1 - gap, 0)), ds.Material(k_a=(0.9, 0, 0)))
    camera = ds.Camera((1, 3, 5), target=(0, 0.3, 0), fov=40, shape=SHAPE)
    return [glass(ds.Box((0, 0, 0), (3, 0.2, 3)), eta), ball, floor], camera


def thin_pane_on_a_floor(eta, gap=0.0):
    return [glass(ds.Box((1, 0.001 + gap, 0), (0.6, 0.002, 0.6)), eta), FLOOR], ABOVE


def from_within_a_box_on_a_floor(eta, gap=0.0):
    camera = ds.Camera((0.3, 0.4, 0.2), target=(0, 0, 0), fov=70, shape=SHAPE)
    return [glass(ds.Box((0, 0.5 + gap, 0), (1, 1, 1)), eta), FLOOR], camera


def places(*quick, but=()):
    """All places, of which only some are looked at by default."""
    all_of_them = [
        box_on_a_floor,
        turned_box_on_a_floor,
        ball_on_a_floor,
        box_against_a_wall,
        glass_table,
        thin_pane_on_a_floor,
        from_within_a_box_on_a_floor,
    ]
    marks = {place: [pytest.mark.thorough] * (place not in quick) for place in all_of_them if place not in but}
    cases = [pytest.param(place, id=place.__name__, marks=marks[place]) for place in marks]
    return pytest.mark.parametrize("place", cases)


float32_is_thorough = pytest.mark.parametrize(
    "precision", ["float64", pytest.param("float32", marks=pytest.mark.thorough)]
)


def render(objects, camera, **options):
    with jax.disable_jit():
        return np.asarray(ds.render(ds.Scene(objects, background=BLUE, **options), camera))


@pytest.mark.thorough
@places(turned_box_on_a_floor, ball_on_a_floor, box_against_a_wall, thin_pane_on_a_floor)
@float32_is_thorough
def test_glass_of_index_1_where_things_touch_is_as_if_it_did_not_bend(place, precision):
    with jax.enable_x64(precision == "float64"):
        (objects, camera), (straight, _) = place(1.0), place(None)
        tolerance = 1e-9 if precision == "float64" else 2e-3
        np.testing.assert_allclose(render(objects, camera), render(straight, camera), atol=tolerance)


@pytest.mark.thorough
@places(box_on_a_floor, ball_on_a_floor, box_against_a_wall, but=(from_within_a_box_on_a_floor,))
@float32_is_thorough
@pytest.mark.parametrize("eta", [1.3, 1.1])
def test_what_touches_looks_like_what_is_hardly_apart(place, precision, eta):
    apart = render(*place(eta, 1e-7))
    with jax.enable_x64(precision == "float64"):
        image = render(*place(eta))
    wrong = np.abs(image - apart).max(-1) > (1e-2 if precision == "float64" else 2e-2)
    assert wrong.sum() <= (0 if precision == "float64" else 4), np.argwhere(wrong)  # float32: at edges


@pytest.mark.thorough
@places(ball_on_a_floor, box_against_a_wall, but=(thin_pane_on_a_floor, from_within_a_box_on_a_floor))
def test_the_order_of_things_that_touch_changes_nothing(place):
    objects, camera = place(1.3)
    first, *others = (render(list(order), camera) for order in itertools.permutations(objects))
    for image in others:
        np.testing.assert_allclose(image, first, atol=1e-12)


@pytest.mark.thorough
@float32_is_thorough
def test_of_surfaces_that_coincide_the_opaque_one_is_seen(precision):
    clear, solid = ds.Material(k_d=0.3, k_t=0.5, eta=1.4), ds.Material(k_a=0.8)
    pairs = [
        (ds.Object(ds.Sphere(), clear), ds.Object(ds.Sphere(), solid)),
        (ds.Object(ds.Box((0, 0, -0.5)), clear), ds.Object(ds.Plane((0, 0, 0), (0.0, 0, 2)), solid)),
    ]
    camera = ds.Camera((0.3, 0.2, 5), fov=10, shape=SHAPE)
    with jax.enable_x64(precision == "float64"):
        for clear, solid in pairs:
            expected = render([solid], camera)
            np.testing.assert_array_equal(render([clear, solid], camera), expected)
            np.testing.assert_array_equal(render([solid, clear], camera), expected)


# --- thin panes and far cameras


@pytest.mark.thorough
@float32_is_thorough
@pytest.mark.parametrize("distance", [1000.0, *(d for d in (10.0, 100.0))])
def test_a_pane_bends_the_same_however_thin_it_is_beside_its_distance(precision, distance):
    """A slab shifts a ray by t sin(i - r)/cos r, whatever the distance: here a pane of 1/500 of the object's size."""
    wall = ds.Object(ds.Plane((0, 0, -3), (0, 0, 1)), ds.Material(k_a=ds.Chequer(0.1, 0.9, 0.05, smooth=True)))
    camera = ds.OrthographicCamera((distance, 0, distance), height=0.5, shape=SHAPE)
    near = ds.OrthographicCamera((1, 0, 1), height=0.5, shape=SHAPE)
    pane = glass(ds.Box(size=(4, 4, 8e-3)), 1.5, 1.0)
    expected = render([pane, wall], near)
    unbent = render([glass(pane.surface, 1.0, 1.0), wall], near)
    assert np.abs(expected - unbent).max() > 0.1
    with jax.enable_x64(precision == "float64"):
        tolerance = 1e-9 if precision == "float64" else 3e-5 * distance
        np.testing.assert_allclose(render([pane, wall], camera), expected, atol=tolerance)


@pytest.mark.thorough
@pytest.mark.parametrize("distance", [1e2, 1e5, 1e7])
def test_a_ball_bends_the_same_from_afar(distance):
    wall = ds.Object(ds.Plane((0, 0, -3), (0, 0, 1)), ds.Material(k_a=ds.Chequer(0.1, 0.9, 3.0, smooth=True)))
    ball = glass(ds.Sphere(), 1.5, 1.0)
    near, far = (
        render([ball, wall], ds.OrthographicCamera((0, 0, z), height=1.9, shape=SHAPE)) for z in (10, distance)
    )
    np.testing.assert_allclose(far, near, atol=1e-13 * distance**1.5 + 1e-9)
