"""Patterns: the colour of a chequer at a point."""

import jax
import numpy as np
from refusals import refuses

import diffshade as ds
from diffshade.model.vectors import Vec3

A, B = (0.9, 0.8, 0.7), (0.1, 0.2, 0.3)


@jax.jit
def colours(pattern, p):
    return pattern(Vec3.of(p)).stack()


def test_the_squares_are_half_a_period():
    """a where x and y are in squares of one colour of a chessboard, b where not; z does not matter."""
    x = np.array([0.5, 1.5, 2.5, -0.5, 0.5, 0.5, -1.5])
    y = np.array([0.5, 0.5, 0.5, 0.5, 1.5, 2.5, -1.5])
    p = np.stack([x, y, np.arange(7.0)], -1)
    expected = [A, B, A, B, B, A, A]
    np.testing.assert_allclose(colours(ds.Chequer(A, B, 2), p), expected, rtol=1e-15)
    np.testing.assert_allclose(colours(ds.Chequer(A, B, 2), p + np.array([4, -2, 0])), expected, rtol=1e-15)


def test_the_smooth_one_is_a_wave():
    p = np.array([(0.5, 0.5, 0), (0.5, -0.5, 0), (0, 0.3, 9), (1 / 6, 1 / 6, 0)])
    half = np.add(A, B) / 2
    expected = [A, B, half, half + 0.25 * np.subtract(A, B) / 2]
    np.testing.assert_allclose(colours(ds.Chequer(A, B, 2, smooth=True), p), expected, rtol=1e-14)


def test_it_counts_along_u_and_v():
    p = np.random.default_rng(5).normal(size=(50, 3))
    floor = ds.Chequer(A, B, 0.7, u=(1, 0, 0), v=(0, 0, 1))
    np.testing.assert_array_equal(colours(floor, p), colours(ds.Chequer(A, B, 0.7), p[:, [0, 2, 1]]))
    np.testing.assert_allclose(
        colours(ds.Chequer(A, B, 1, smooth=True, u=(0, 2, 0), v=(0, 0, 1)), p),
        colours(ds.Chequer(A, B, 1, smooth=True), p[:, [1, 2, 0]] * [2, 1, 1]),
        rtol=1e-12,
    )


def test_only_the_smooth_one_has_a_derivative():
    p = np.array([[0.2, 0.3, 0.0]])
    for smooth in (False, True):
        slope = jax.jacfwd(lambda p, smooth=smooth: colours(ds.Chequer(A, B, 1.3, smooth), p))(p)
        assert np.any(slope) == smooth
        assert np.isfinite(slope).all()


def test_a_pattern_that_is_none():
    for period in (0.0, -1.0):
        refuses(lambda period=period: ds.Chequer(A, B, period), "Chequer.period", "above 0", f"got {period:g}")
    refuses(lambda: ds.Chequer((), B), "Chequer.a", "colour of 1 or 3 numbers", "(0,)")
    refuses(lambda: ds.Material(k_d=ds.Sphere()), "Material.k_d", "Pattern", "Sphere", "Chequer", error=TypeError)
