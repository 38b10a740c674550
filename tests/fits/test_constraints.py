"""What a user knows beside the photographs: equal channels, proportions, priors and bounds."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from synthetic import CAMERA, forget, noisy, one_light_each, photographs, point_lights, seen_by, standard_scene
from unexplained import unexplained  # noqa: F401

import diffshade as ds

LIGHTS = point_lights()[:3]
OF_MATERIAL = ("k_a", "k_d", "k_s", "n_s")
COLOURS = np.array([0.6, 0.4, 0.2])
TRUTH = standard_scene(ds.Material(0.1, COLOURS, 0.5 * COLOURS, 50), LIGHTS)
SIGMA = 0.005

pytestmark = pytest.mark.usefixtures("unexplained")


@cache
def images() -> list[np.ndarray]:
    return noisy(photographs(TRUTH), SIGMA, 0)


@cache
def inside() -> np.ndarray:
    return np.asarray(seen_by(CAMERA).mask)


def fit(free: Sequence[str] = OF_MATERIAL, *, scene: ds.Scene | None = None, noise: Any = None, **options: Any):
    told = forget(TRUTH, free) if scene is None else scene
    return ds.fit(told, one_light_each(images(), noise=noise), free=free, **options)


@cache
def plain() -> ds.Fit:
    return fit()


@cache
def of_known_noise() -> ds.Fit:
    return fit(noise=SIGMA)


@cache
def of_grey_and_proportional() -> ds.Fit:
    return fit(constraints=[ds.Grey("k_a"), ds.Proportional("k_s", "k_d")])


def error(fit: ds.Fit, name: str) -> float:
    return float(fit.plain_errors[fit.names.index(name)])


def value(fit: ds.Fit, name: str) -> float:
    return float(fit.values[fit.names.index(name)])


# --- equal channels and proportions


@pytest.mark.thorough
def test_a_grey_colour_is_one_unknown_the_mean_of_its_channels():
    three, one = plain(), of_grey_and_proportional()
    assert [name for name in one.names if name.startswith("k_a")] == ["k_a"]
    assert len(one.names) == len(three.names) - 4
    np.testing.assert_array_equal(one.material.k_a, np.full(3, value(one, "k_a")))
    assert abs(value(one, "k_a") - 0.1) < 4.5 * error(one, "k_a")
    assert error(one, "k_a") < 0.8 * error(three, "k_a.r")
    apart = [value(three, f"k_a.{c}") for c in "rgb"]
    assert min(apart) < value(one, "k_a") < max(apart)


def test_two_colours_in_an_unknown_proportion_share_one_factor():
    found = of_grey_and_proportional()
    assert [name for name in found.names if "k_s" in name] == ["k_s/k_d"]
    factor = value(found, "k_s/k_d")
    assert abs(factor - 0.5) < 4.5 * error(found, "k_s/k_d")
    np.testing.assert_allclose(found.material.k_s, factor * np.asarray(found.material.k_d), rtol=1e-12)
    off = found.values - found.values_in(TRUTH)
    assert found.values_in(TRUTH)[found.names.index("k_s/k_d")] == pytest.approx(0.5)
    assert np.abs(off / found.plain_errors).max() < 4.5
    assert error(found, "k_d.r") < error(plain(), "k_d.r")


@pytest.mark.thorough
def test_a_given_proportion_fixes_one_colour_to_another():
    found = fit(("k_a", "k_d", "n_s"), scene=forget(TRUTH), constraints=[ds.Proportional("k_s", "k_d", 0.5)])
    assert not any("k_s" in name for name in found.names)
    np.testing.assert_allclose(found.material.k_s, 0.5 * np.asarray(found.material.k_d), rtol=1e-12)
    assert np.abs((found.values - found.values_in(TRUTH)) / found.plain_errors).max() < 4.5
    wrong = fit(("k_a", "k_d", "n_s"), scene=forget(TRUTH), constraints=[ds.Proportional("k_s", "k_d", 0.8)])
    np.testing.assert_allclose(wrong.material.k_s, 0.8 * np.asarray(wrong.material.k_d), rtol=1e-12)
    assert wrong.rmse > 1.1 * found.rmse


@pytest.mark.thorough
def test_a_colour_in_proportion_to_a_known_one_has_the_factor_alone():
    found = fit(("k_s", "n_s"), constraints=[ds.Proportional("k_s", "k_d")])
    assert found.names == ("n_s", "k_s/k_d")
    np.testing.assert_allclose(found.material.k_s, value(found, "k_s/k_d") * COLOURS, rtol=1e-12)
    assert np.abs((found.values - found.values_in(TRUTH)) / found.plain_errors).max() < 4.5


# --- priors


def test_a_tight_prior_pins_what_it_names_and_the_error_is_its_width():
    free, width = of_known_noise(), 1e-4
    pinned = fit(noise=SIGMA, priors={"n_s": (60.0, width), "k_a": ((0.2, 0.3, 0.4), 1e-6)})
    np.testing.assert_allclose(pinned.material.k_a, (0.2, 0.3, 0.4), atol=1e-4)  # one may be a colour
    assert error(free, "n_s") / 50 > 20 * width
    assert value(pinned, "n_s") == pytest.approx(60, rel=20 * width)
    assert error(pinned, "n_s") == pytest.approx(60 * width, rel=0.05)
    assert error(pinned, "k_s.r") < error(free, "k_s.r")
    wide = fit(noise=SIGMA, priors={"n_s": (60.0, 100.0)})
    np.testing.assert_allclose(wide.values, free.values, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(wide.plain_errors, free.plain_errors, rtol=1e-4)


def test_with_noise_unknown_a_prior_is_weighed_against_the_residuals_of_the_photographs():
    known, unknown = (fit(noise=noise, priors={"n_s": (60.0, 0.02)}) for noise in (SIGMA, None))
    assert 50.5 < value(known, "n_s") < 59.5  # between the two
    np.testing.assert_allclose(unknown.values, known.values, rtol=0.02)
    np.testing.assert_allclose(unknown.plain_errors, known.plain_errors, rtol=0.08)


def test_a_prior_of_a_linear_unknown_is_combined_with_known_noise_as_a_precision_weighted_mean():
    told = forget(TRUTH, ("k_d",))
    material = TRUTH.objects[0].material
    without, with_one = (
        photographs(standard_scene(ds.Material(material.k_a, k_d, material.k_s, material.n_s), LIGHTS))
        for k_d in (0.0, 1.0)
    )
    J = [(b - a)[inside()] for a, b in zip(without, with_one, strict=True)]
    y = [(image - a)[inside()] for a, image in zip(without, images(), strict=True)]
    precision = np.sum([(j * j).sum(0) for j in J], 0) / SIGMA**2
    alone = np.sum([(j * z).sum(0) for j, z in zip(J, y, strict=True)], 0) / SIGMA**2 / precision
    prior, width = 0.3, 1.0 / np.sqrt(precision.mean())  # about as good as the photographs
    plain = fit(("k_d",), scene=told, noise=SIGMA)
    np.testing.assert_allclose(plain.values, alone, rtol=1e-9)
    np.testing.assert_allclose(plain.plain_errors, precision**-0.5, rtol=1e-9)
    both = fit(("k_d",), scene=told, noise=SIGMA, priors={"k_d": (prior, width)})
    total = precision + width**-2
    np.testing.assert_allclose(both.values, (precision * alone + prior / width**2) / total, rtol=1e-9)
    np.testing.assert_allclose(both.plain_errors, total**-0.5, rtol=1e-9)


@pytest.mark.thorough
def test_a_prior_determines_what_the_photographs_do_not():
    free, tied = ("k_d", "k_s", "n_s", "intensity"), ("intensity",)
    told = forget(TRUTH, ("k_d", "k_s", "n_s"))
    without = fit(free, scene=told, tied=tied, noise=SIGMA)
    assert [name for name, known in zip(without.names, without.determined, strict=True) if known] == ["n_s"]
    width = 0.01
    known = fit(free, scene=told, tied=tied, noise=SIGMA, priors={"intensity": (1.0, width)})
    assert known.determined.all()
    for c, k_d in zip("rgb", COLOURS, strict=True):
        assert error(known, f"intensity.{c}") == pytest.approx(width, rel=1e-3)
        assert value(known, f"intensity.{c}") == pytest.approx(1.0, abs=1e-4)
        assert error(known, f"k_d.{c}") == pytest.approx(width * k_d, rel=0.1)


# --- bounds


def row(fit: ds.Fit, name: str) -> list[str]:
    """Return the columns of an unknown's line of the table."""
    (line,) = [line for line in str(fit).splitlines() if line.split()[:1] == [name]]
    return line.split()


@pytest.mark.parametrize(
    ("bounds", "bound", "sign", "side"),
    [((0.61, 0.9), 0.61, "+", "lower"), ((0.1, 0.59), 0.59, "-", "upper")],
    ids=["lower", "upper"],
)
def test_the_error_of_a_value_at_a_bound_is_printed_as_one_sided(bounds, bound, sign, side):
    # k_d.r is 0.6; the other channels are held by no bound that matters
    lower, upper = bounds
    told = standard_scene(ds.Material(0.1, 0.6, 0.3, 50), LIGHTS)
    images = noisy(photographs(told), SIGMA, 1)
    found = ds.fit(forget(told), one_light_each(images), free=OF_MATERIAL, bounds={"k_d": (lower, upper)})
    for name in ("k_d.r", "k_d.g", "k_d.b"):
        j = found.names.index(name)
        assert found.values[j] == bound
        assert found.at_bound[j]
        assert found.at_lower[j] == (side == "lower")
        assert np.isfinite(found.plain_errors[j])
        assert found.plain_errors[j] > 0
        cells = row(found, name)
        assert cells[2].startswith(sign)
        assert cells[-3:] == ["at", "a", "bound"]
    free = found.determined & ~found.at_bound
    inside = row(found, found.names[int(np.argmax(free))])
    assert inside[2][0].isdigit()
    assert len(inside) == 3
    assert "bound" not in inside
    assert f"k_d.r, k_d.g and k_d.b are at their {side} bound {bound:g}." in found.notes


# --- names as the table prints them


def test_a_bound_or_a_prior_may_name_one_channel():
    found = fit(bounds={"k_d.r": (0.0, 0.5)}, priors={"k_a.g": (0.11, 1e-6)})
    assert value(found, "k_d.r") == 0.5
    assert list(found.at_bound) == [name == "k_d.r" for name in found.names]
    assert value(found, "k_a.g") == pytest.approx(0.11, abs=1e-4)
    assert abs(value(found, "k_a.b") - 0.1) < 0.005


def test_an_unknown_factor_can_be_bounded_by_its_printed_name():
    found = fit(constraints=[ds.Grey("k_a"), ds.Proportional("k_s", "k_d")], bounds={"k_s/k_d": (0.0, 0.4)})
    assert value(found, "k_s/k_d") == 0.4
    assert found.at_bound[found.names.index("k_s/k_d")]
