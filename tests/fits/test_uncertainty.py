"""Uncertainty: error bars that can be had another way too, and sentences about what cannot be known."""

import numpy as np
import pytest
from synthetic import (
    CAMERA,
    FREE,
    MATERIAL,
    TIED,
    forget,
    noisy,
    one_light_each,
    photograph,
    photographs,
    point_lights,
    seen_by,
    standard_scene,
)

import diffshade as ds
from diffshade.inverse.identifiability import condition_number, null_directions
from diffshade.inverse.parameters import put_back
from diffshade.inverse.uncertainty import (
    deciding_view,
    jackknife_covariance,
    lone_views,
    plain_covariance,
    standard_errors,
    without_lone,
)
from diffshade.inverse.views import find_samples

UNITS = 10.0 ** np.array([-4.0, 3.0, 0.0, -2.0, 5.0, 1.0])


def jacobian(*null_space: list[float], rows: int = 40) -> np.ndarray:
    """A random Jacobian of 6 unknowns in units of very different sizes, blind along the given directions."""
    J = np.random.default_rng(0).standard_normal((rows, 6))
    for direction in null_space:
        unit = np.array(direction) / np.linalg.norm(direction)
        J -= np.outer(J @ unit, unit)
    return J / UNITS


# --- the algebra


def test_the_plain_covariance_is_sigma2_times_the_inverse_in_any_units():
    J = jacobian()
    expected = np.linalg.inv((J * UNITS).T @ (J * UNITS)) * np.outer(UNITS, UNITS)
    np.testing.assert_allclose(plain_covariance(J.T @ J, 0.25), 0.25 * expected, rtol=1e-9)


def test_the_condition_number_is_that_of_columns_of_unit_length():
    J = jacobian()
    w = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    np.testing.assert_allclose(condition_number(J.T @ J), w[0] / w[-1], rtol=1e-9)
    blind = jacobian([1, 1, 0, 0, 0, 0])
    assert condition_number(blind.T @ blind) == np.inf


def test_null_directions_of_independent_gauges_name_only_their_own_unknowns():
    J = jacobian([1, 2, -3, 0, 0, 0], [0, 0, 0, 1, 1, 0])
    zero, directions = null_directions(J.T @ J)
    assert not zero.any()
    assert sorted(np.flatnonzero(d).tolist() for d in directions) == [[0, 1, 2], [3, 4]]
    for d, parts in ((d, J * d) for d in directions):
        assert np.linalg.norm(J @ d) < 1e-6 * np.linalg.norm(parts)


def test_a_column_of_zeros_is_told_apart_from_a_direction():
    J = jacobian([1, 1, 0, 0, 0, 0])
    J[:, 5] = 0.0
    zero, directions = null_directions(J.T @ J)
    assert zero.tolist() == [False] * 5 + [True]
    assert [np.flatnonzero(d).tolist() for d in directions] == [[0, 1]]


def test_where_nothing_is_known_every_unknown_is_a_column_of_zeros():
    zero, directions = null_directions(np.zeros((2, 2)))
    assert zero.all()
    assert len(directions) == 0


def test_what_is_determined_has_the_errors_it_has_with_the_gauge_fixed():
    J = jacobian([1, 1, 1, 0, 0, 0])
    fixed = np.delete(J, 0, axis=1)  # one unknown of the gauge is known
    expected = np.diag(plain_covariance(fixed.T @ fixed, 1.0))[2:]
    np.testing.assert_allclose(np.diag(plain_covariance(J.T @ J, 1.0))[3:], expected, rtol=1e-6)


def test_the_jackknife_of_a_mean_is_the_textbooks():
    """The standard error of the mean of G numbers, s / sqrt(G)."""
    y = np.random.default_rng(0).standard_normal(8)
    covariance = jackknife_covariance(np.ones((8, 1, 1)), (y.mean() - y)[:, None], np.zeros((1, 1)), np.zeros(1))
    np.testing.assert_allclose(covariance, [[np.var(y, ddof=1) / 8]], rtol=1e-12)


def test_the_jackknife_of_a_linear_model_is_that_of_fits_without_each_view():
    random = np.random.default_rng(0)
    J, b = random.standard_normal((6, 20, 3)), random.standard_normal((6, 20))
    solve = lambda which: np.linalg.lstsq(np.concatenate(J[which]), np.concatenate(b[which]), rcond=None)[0]  # noqa: E731
    best = solve(np.arange(6))
    H, g = np.einsum("vni,vnj->vij", J, J), np.einsum("vni,vn->vi", J, J @ best - b)
    without = np.array([solve(np.delete(np.arange(6), v)) for v in range(6)])
    deviations = without - without.mean(0)
    np.testing.assert_allclose(
        jackknife_covariance(H, g, np.zeros((3, 3)), np.zeros(3)), 5 / 6 * deviations.T @ deviations, rtol=1e-9
    )


def test_a_view_that_alone_determines_something_is_found():
    H = np.array([np.diag([1.0, 0.0]), np.diag([1.0, 0.0]), np.diag([1.0, 1.0])])
    assert deciding_view(H, np.zeros((2, 2))) == 2
    assert deciding_view(H, np.eye(2)) is None


def test_an_unknown_at_a_bound_adds_nothing_to_the_errors_of_the_others():
    J = jacobian()
    covariance = lambda which: plain_covariance(J[:, which].T @ J[:, which], 1.0)  # noqa: E731
    at_bound = np.array([False, True, False, False, True, False])
    errors = standard_errors(covariance, at_bound)
    np.testing.assert_allclose(errors[~at_bound] ** 2, np.diag(covariance(~at_bound)), rtol=1e-12)
    released = ~at_bound | (np.arange(6) == 4)
    variance_of_4 = np.diag(covariance(released))[np.sum(released[:4])]
    np.testing.assert_allclose(errors[4] ** 2, variance_of_4, rtol=1e-12)


# --- the errors of a fit


@pytest.fixture(scope="module")
def images():
    return noisy(photographs(standard_scene()), 0.02, 0)


@pytest.fixture(scope="module")
def eight_views(images):
    return ds.fit(forget(standard_scene()), one_light_each(images), free=FREE, tied=TIED)


def test_the_covariance_is_that_of_a_jacobian_by_finite_differences(eight_views):
    fit = eight_views
    inside = [find_samples(fit.scene, view).inside for view in fit.views]

    def predictions(values):
        scene, _ = put_back(fit.scene, fit.views, fit.unknowns, values)
        return np.concatenate([image[i].ravel() for image, i in zip(photographs(scene), inside, strict=True)])

    h = 1e-5 * np.diag(fit.values)
    J = np.stack([(predictions(fit.values + e) - predictions(fit.values - e)) / (2 * e.sum()) for e in h], -1)
    data = np.concatenate([view.image[i].ravel() for view, i in zip(fit.views, inside, strict=True)])
    sigma2 = np.sum((predictions(fit.values) - data) ** 2) / (len(data) - len(fit.values))
    expected = sigma2 * np.linalg.inv(J.T @ J)
    errors = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(fit.covariance, expected, atol=1e-5 * np.outer(errors, errors).max(), rtol=1e-4)
    np.testing.assert_allclose(fit.plain_errors, errors, rtol=1e-5)
    np.testing.assert_allclose(fit.plain_errors**2, np.diag(fit.covariance), rtol=1e-12)


def test_the_jackknife_is_that_of_eight_fits_without_one_view_each(eight_views, images):
    """The jackknife of the Gram matrices is the first order of these refits."""
    views = one_light_each(images)
    scene = standard_scene()
    without = np.array(
        [ds.fit(scene, [*views[:v], *views[v + 1 :]], free=FREE, tied=TIED).values for v in range(len(views))]
    )
    G = len(views)
    expected = np.sqrt((G - 1) / G * np.sum((without - without.mean(0)) ** 2, 0))
    np.testing.assert_allclose(eight_views.errors, expected, rtol=0.05)


def test_the_jackknife_sees_what_the_plain_errors_cannot(images, eight_views):
    """An error that a whole view shares, here an exposure that is off, is no independent noise."""
    off = np.random.default_rng(0).uniform(0.9, 1.1, len(images))
    fit = ds.fit(
        standard_scene(),
        one_light_each([e * image for e, image in zip(off, images, strict=True)]),
        free=FREE,
        tied=TIED,
    )
    k_d = [name.startswith("k_d") for name in fit.names]
    truth = fit.values_in(standard_scene())
    assert fit.errors is not None
    assert np.all(fit.errors[k_d] > 5 * fit.plain_errors[k_d])
    assert np.all(np.abs(fit.values - truth)[k_d] < 4 * fit.errors[k_d])


def test_with_three_distances_and_the_constant_fixed_everything_is_determined(eight_views):
    assert eight_views.determined.all()
    assert np.isfinite(eight_views.condition)
    assert np.isfinite(eight_views.errors).all()
    assert not any("determine" in note or "separate" in note for note in eight_views.notes)


# --- what these views cannot tell

ONE_LIGHT = standard_scene(lights=[standard_scene().lights[0]])


def one_photograph(scene: ds.Scene, **options) -> list[ds.View]:
    return [ds.View(noisy([photograph(scene)], 0.005, 0)[0], CAMERA, **options)]


def row(fit: ds.Fit, name: str) -> str:
    (line,) = [line for line in str(fit).splitlines() if line.startswith(f"{name} ")]
    return line.removeprefix(name).strip()


def assert_undetermined(fit: ds.Fit, *names: str) -> None:
    """Neither the table nor the error bars give a number for these; they do for all others."""
    for j, name in enumerate(fit.names):
        unknown = name.removesuffix(".r").removesuffix(".g").removesuffix(".b") in names
        assert fit.determined[j] == (not unknown), name
        assert np.isinf(fit.plain_errors[j]) == unknown, name
        assert fit.errors is None or np.isinf(fit.errors[j]) == unknown, name
        assert (row(fit, name) == "not determined") == unknown, name
        assert not (unknown and fit.covariance[j].any()), name
    assert fit.condition == np.inf


def the_gauges(fit: ds.Fit) -> list[str]:
    return [note for note in fit.notes if "cannot separate" in note or "do not determine" in note]


def test_brightness_of_light_and_material_are_one_gauge():
    fit = ds.fit(forget(ONE_LIGHT, ("k_d", "k_s")), one_photograph(ONE_LIGHT), free=("k_d", "k_s", "intensity"))
    assert_undetermined(fit, "k_d", "k_s", "intensity")
    assert the_gauges(fit) in (
        [
            f"these views cannot separate {pair}: scaling the former up and the latter down by one factor leaves every "
            "pixel unchanged. Fix one, for example intensity."
        ]
        for pair in ("k_d and k_s from intensity", "intensity from k_d and k_s")
    )


def test_material_and_attenuation_with_its_constant_are_one_gauge():
    free = ("k_d", "k_s", "constant", "linear", "quadratic")
    fit = ds.fit(forget(ONE_LIGHT, ("k_d", "k_s")), one_photograph(ONE_LIGHT), free=free)
    assert_undetermined(fit, *free)
    assert fit.notes == (
        "these views cannot separate k_d and k_s from constant, linear and quadratic: scaling all of them together "
        "leaves every pixel unchanged. Fix one, for example constant.",
        "1 view: no errors by jackknife, which needs three or more; the plain errors are right for independent noise "
        "only.",
    )


def test_two_gauges_are_two_sentences_and_touch_nothing_else():
    fit = ds.fit(
        forget(standard_scene()),
        one_light_each(noisy(photographs(standard_scene()), 0.005, 0)),
        free=("k_a", "k_d", "k_s", "n_s", "intensity", "ambient"),
        tied="intensity",
    )
    assert_undetermined(fit, "k_a", "ambient", "k_d", "k_s", "intensity")
    assert abs(fit.values[fit.names.index("n_s")] - 50) < 4 * fit.plain_errors[fit.names.index("n_s")]
    assert len(the_gauges(fit)) == 2
    (ambient,) = [note for note in the_gauges(fit) if "k_a" in note]
    (light,) = [note for note in the_gauges(fit) if "k_d" in note]
    assert "k_s" in light
    assert "intensity" in light
    assert "ambient" in ambient
    assert "intensity" not in ambient


def test_a_constant_of_zero_is_a_gauge_too_and_nothing_is_said_of_the_size_of_what_it_scales():
    """With f_rad = 1/(a1 d + a2 d^2) the material scales with both; that k_d comes out above 1 then means nothing."""
    scene = standard_scene(lights=point_lights(ds.RadialAttenuation(0.0, 0.1, 0.3)))
    fit = ds.fit(forget(scene), one_light_each(noisy(photographs(scene), 0.005, 0)), free=FREE, tied=TIED)
    assert_undetermined(fit, "k_d", "k_s", "linear", "quadratic")
    assert fit.notes == (
        "these views cannot separate k_d and k_s from linear and quadratic: scaling all of them together leaves every "
        "pixel unchanged. Fix one, for example quadratic.",
    )


def test_n_s_of_a_ball_without_a_highlight_is_not_determined():
    """A highlight that takes light away drives every channel of k_s to its bound, whatever the noise."""
    matte, glossy = (
        photographs(standard_scene(ds.Material(MATERIAL.k_a, MATERIAL.k_d, k_s, 20))) for k_s in (0.0, 0.05)
    )
    images = noisy([2 * m - g for m, g in zip(matte, glossy, strict=True)], 0.005, 0)
    fit = ds.fit(forget(standard_scene()), one_light_each(images), free=FREE, tied=TIED)
    assert fit.at_bound[[name.startswith("k_s") for name in fit.names]].all()
    assert_undetermined(fit, "n_s")
    assert fit.notes == (
        "these views do not determine n_s: no pixel changes with it. Fix it, or add a view that shows it.",
        "k_s.r, k_s.g and k_s.b are at their lower bound 0.",
    )


def inside_of_a_sphere() -> ds.Scene:
    """Half a hollow ball lit from its centre: every point is at distance 1 and faces the light."""
    ball = seen_by(CAMERA)
    hollow = ds.GBuffer(-ball.normal, ball.position, ball.mask)
    light = ds.PointLight((0, 0, 0), 1.0, ds.RadialAttenuation(1.0, 0.3, 0.2))
    return ds.Scene(ds.Object(hollow, ds.Material(0.1, (0.6, 0.5, 0.4))), light)


def test_one_distance_does_not_tell_linear_from_quadratic():
    scene = inside_of_a_sphere()
    fit = ds.fit(scene, one_photograph(scene), free=("attenuation",))
    assert_undetermined(fit, "linear", "quadratic")
    assert the_gauges(fit) == [
        "these views cannot separate linear and quadratic: they can be changed together without changing any pixel. "
        "Fix one, for example quadratic, or add views from other distances or directions."
    ]


def test_one_distance_does_not_tell_attenuation_from_the_material_either():
    scene = inside_of_a_sphere()
    fit = ds.fit(forget(scene, ("k_d",)), one_photograph(scene), free=("k_d", "attenuation"))
    assert_undetermined(fit, "k_d", "linear", "quadratic")
    assert all(any(name in note for note in the_gauges(fit)) for name in ("k_d", "linear", "quadratic"))


def test_the_intensity_of_a_light_that_is_never_lit_is_not_determined():
    scene = standard_scene(lights=[*ONE_LIGHT.lights, ds.DirectionalLight((0, 0, -1), 0.5)])
    views = one_photograph(ONE_LIGHT, lit=0)
    fit = ds.fit(forget(scene, ("k_d",)), views, free=("k_d", "lights.1.intensity"))
    assert_undetermined(fit, "lights.1.intensity")
    assert the_gauges(fit) == [
        "these views do not determine lights.1.intensity: no pixel changes with it. Fix it, or add a view that shows "
        "it."
    ]


def test_a_light_that_lights_nothing_is_not_determined_either():
    behind = standard_scene(lights=[*ONE_LIGHT.lights, ds.DirectionalLight((0, 0, 1), 0.5)])
    fit = ds.fit(forget(behind, ("k_d",)), one_photograph(ONE_LIGHT, lit=0), free=("k_d", "lights.1.intensity"))
    assert_undetermined(fit, "lights.1.intensity")


def test_fewer_than_three_views_have_no_jackknife_and_the_fit_says_so(images):
    fit = ds.fit(standard_scene(), one_light_each(images)[:2], free=("k_d",))
    assert fit.errors is None
    assert fit.notes == (
        "2 views: no errors by jackknife, which needs three or more; the plain errors are right for independent noise "
        "only.",
    )
    assert row(fit, "k_d.r").split()[1] == "-"


def test_a_number_that_one_view_alone_shows_has_no_jackknife_and_takes_none_from_the_others(images):
    """Only photograph 2 shows light 2: without it that light's intensity is unknown, and k_d is what it is."""
    views = one_light_each(images)[:4]
    fit = ds.fit(standard_scene(), views, free=("k_d", "lights.2.intensity"))
    assert fit.determined.all()
    assert fit.errors is not None
    np.testing.assert_allclose(fit.errors[3:], fit.plain_errors[3:], rtol=1e-9)
    assert fit.notes == (
        "one view alone shows each of lights.2.intensity, so that there is no jackknife of them; the plain errors are "
        "right for independent noise only.",
    )


def test_eliminating_what_one_view_alone_shows_is_a_fit_in_which_it_follows():
    """Two shared unknowns and one of each view: the jackknife is that of linear fits without a view and its own."""
    random = np.random.default_rng(1)
    A, B, b = (random.standard_normal((5, 30, n)) for n in (2, 1, 1))
    H, g = np.zeros((5, 7, 7)), np.zeros((5, 7))

    def design(v: int) -> np.ndarray:
        J = np.zeros((30, 7))
        J[:, :2], J[:, 2 + v] = A[v], B[v, :, 0]
        return J

    def solve(views: list[int]) -> np.ndarray:
        J, y = np.concatenate([design(v) for v in views]), np.concatenate([b[v, :, 0] for v in views])
        return np.linalg.lstsq(J, y, rcond=None)[0]

    best = solve([*range(5)])
    for v in range(5):
        H[v], g[v] = design(v).T @ design(v), design(v).T @ (design(v) @ best - b[v, :, 0])
    lone = lone_views(H)
    assert lone.tolist() == [-1, -1, 0, 1, 2, 3, 4]
    nothing = np.zeros((7, 7))
    covariance = jackknife_covariance(*without_lone(H, g, nothing, lone), np.zeros((2, 2)), np.zeros(2))
    without = np.array([solve([w for w in range(5) if w != v])[:2] for v in range(5)])
    deviations = without - without.mean(0)
    np.testing.assert_allclose(covariance, 4 / 5 * deviations.T @ deviations, rtol=1e-9)
